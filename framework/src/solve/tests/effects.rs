//! Tests which passes depend on a parameter, for each kind of dependency, and the reasons for having no effect.

use crate::plan::Plan;
use crate::testing::{dispatch, graph, make, plan, plan_of, plan_with_capacities, show};

const P: &str = r#""p": Const(Int(default: 8, range: (1, 64))),"#;
const P_AND_Q: &str = r#""p": Const(Int(default: 8, range: (1, 64))), "q": Const(Bool(default: false)),"#;

/// Returns the passes that depend on a parameter, after `+` if it decides which passes exist; or why it has no effect.
fn effect_in(plan: &Plan, parameter: &str) -> String {
    let effect = plan.effect(parameter).expect("a parameter of the graph");
    let names: Vec<&str> = effect.passes.iter().map(|id| plan.pass(*id).name.as_str()).collect();
    assert_eq!(effect.none.is_some(), names.is_empty() && !effect.shape, "a reason where there is no effect");
    match &effect.none {
        Some(why) => why.clone(),
        None => (if effect.shape { "+ " } else { "" }).to_string() + &names.join(" "),
    }
}

fn effect_with(text: &str, set: &[(&str, &str)], more: &[(&str, &str)]) -> String {
    effect_in(&plan_of(&[more, &[("graph.ron", text)]].concat(), set), "p")
}

fn effect(passes: &[String]) -> String {
    effect_with(&graph(P, &passes.join("\n")), &[], &[])
}

const NONE: &str = "nothing in this plan depends on it";

#[test]
fn a_pass_depends_on_what_its_size_its_push_constants_its_offsets_and_its_words_are_computed_from() {
    assert_eq!(effect(&[make(), show()]), NONE);
    assert_eq!(effect(&[make().replace("64", "\"8 * p\""), show()]), "make");
    assert_eq!(effect(&[make().replace("Threads(64)", "Groups(1, \"p\")"), show()]), "make");
    let push = make().replace("make.comp", "push.comp").replace("size:", r#"push: {"shift": "p"}, size:"#);
    assert_eq!(effect(&[push, show()]), "make");
    let indirect = show().replace("Threads(64)", r#"Indirect("a", "4 * p")"#);
    assert_eq!(effect(&[make(), indirect]), "show");
    let fill = r#"Fill(name: "fill", buffer: "a", value: "p"),"#.to_string();
    assert_eq!(effect(&[fill, show()]), "fill");
    let draw = r#"Draw(name: "draw", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleList,
        call: Direct(vertices: 4, instances: "p"), bind: {"In": "a"}, targets: [Target(image: "image", load: Clear(0, 0, 0, 0), blend: Replace)]),"#;
    assert_eq!(effect(&[make(), draw.to_string()]), "draw");
}

#[test]
fn a_value_is_followed_through_lets_and_the_defaults_of_other_parameters() {
    let passes = [make().replace("64", "\"more\""), show()].join("\n");
    let with = |params: &str, lets: &str, set: &[(&str, &str)]| {
        let text = graph(params, &passes).replace("resources:", &format!("let: {{{lets}}}, resources:"));
        effect_with(&text, set, &[])
    };
    assert_eq!(with(P, r#""twice": "2 * p", "more": "twice + 1""#, &[]), "make");
    assert_eq!(with(P, r#""twice": "2 * p", "more": "64""#, &[]), NONE, "a `let` that nothing uses");
    let params = format!(r#"{P} "r": Const(Int(default: "p + 1", range: (1, 64))),"#);
    assert_eq!(with(&params, r#""more": "r""#, &[]), "make");
    assert_eq!(with(&params, r#""more": "r""#, &[("r", "9")]), NONE, "the default is not used");
    // A range rejects values, but changes none.
    let params = format!(r#"{P} "r": Const(Int(default: 5, range: (1, "p"))),"#);
    assert_eq!(with(&params, r#""more": "r""#, &[]), NONE);
}

#[test]
fn the_setting_of_a_preset_is_followed_and_the_end_of_the_range_that_a_value_grows_to() {
    let params = format!(r#"{P} "r": Const(Int(default: 5, range: (1, "8 * p"), grows: "needed")),"#);
    let text = graph(&params, &[make().replace("64", "\"r\""), show()].join("\n"))
        .replace("output:", r#"stats: {"needed": ("a", 0)}, output:"#);
    let preset = r#"Preset(graph: "base", summary: "", set: {"r": "p"})"#;
    let plan = plan_of(&[("base.ron", text.as_str()), ("graph.ron", preset)], &[]);
    assert_eq!(effect_in(&plan, "p"), "make");
    let capacities =
        |capacities: &[(&str, i64)]| effect_in(&plan_with_capacities(&text, &[], capacities), "p");
    assert_eq!(capacities(&[]), NONE);
    assert_eq!(capacities(&[("r", 1000)]), "make");
}

#[test]
fn a_define_counts_where_the_text_of_a_shader_depends_on_it() {
    let with = |pass: &String, lets: &str, shader: &str| {
        let text = graph(P, &[pass.clone(), show()].join("\n"))
            .replace("resources:", &format!("let: {{{lets}}}, resources:"))
            .replace("make.comp", "text.comp");
        effect_with(&text, &[], &[("text.comp", &format!("w Out 4\n{shader}"))])
    };
    assert_eq!(with(&make(), "", "P"), "make");
    assert_eq!(with(&make(), "", "Q"), NONE);
    let skipped = format!("{NONE}; the shader of `make` uses it only where an `#if` is false");
    assert_eq!(with(&make(), "", "#if 0 P"), skipped);
    assert_eq!(with(&make(), r#""half_p": "p / 2""#, "HALF_P"), "make");
    // A text has no define. Still, a shader that mentions the name counts as depending on its value.
    assert_eq!(with(&make(), r#""kind": "p > 4 ? 'many' : 'few'""#, "KIND"), "make");
    let of_both = r#""k": "p > 4 ? 'many' : 'few'""#;
    assert_eq!(with(&make(), of_both, "K P"), "make");
}

#[test]
fn a_live_parameter_counts_where_a_shader_reads_its_member() {
    let params = r#""p": Const(Int(default: 1, range: (1, 9))), "stop": Live(Float(default: "float(p)", range: (0.0, 9.0))), "go": Live(Float(default: 1.0, range: (0.0, 9.0))),"#;
    let text = graph(params, &[make(), show()].join("\n")).replace("make.comp", "live.comp");
    let files = [("graph.ron", text.as_str()), ("live.comp", "w Out 4\nlive stop")];
    let plan = plan_of(&files, &[]);
    assert_eq!(effect_in(&plan, "stop"), "make");
    assert_eq!(effect_in(&plan, "go"), NONE);
    assert_eq!(effect_in(&plan, "p"), "make", "its value is the default of the live one");
    let plan = plan_of(&files, &[("stop", "2.0")]);
    assert_eq!(effect_in(&plan, "p"), NONE);
}

#[test]
fn the_passes_that_use_a_resource_depend_on_its_declaration() {
    let sized = |change: &[(&str, &str)]| {
        let mut text = graph(P, &[make(), show()].join("\n"));
        change.iter().for_each(|(from, to)| text = text.replace(from, to));
        effect_with(&text, &[], &[])
    };
    let buffer = |name: &str| format!("\"{name}\": Buffer(stride: 4, count: 64");
    let counted = |name: &str| format!("\"{name}\": Buffer(stride: 4, count: \"64 * p\"");
    assert_eq!(sized(&[(&buffer("a"), &counted("a"))]), "make show");
    assert_eq!(sized(&[(&buffer("b"), &counted("b"))]), NONE, "nothing uses it");
    let image =
        (r#""image": Image(format: "rgba16f""#, r#""image": Image(format: "p > 4 ? 'rgba16f' : 'rgba8'""#);
    assert_eq!(sized(&[image]), "show export");
    let history = format!("{}, history: \"p > 4\"", buffer("a"));
    let change = [("make.comp", "change.comp"), (&buffer("a"), &*history)];
    assert_eq!(sized(&change), "start(a) make show");
    let planes = r#"imports: {"sh": Import(from: "scene.sh", planes: "p / 8")}, resources:"#;
    let copies = dispatch("copy", "sh.comp", r#""Sh": "sh", "Out": "a""#);
    let text = graph(P, &[copies, show()].join("\n")).replace("resources:", planes);
    assert_eq!(effect_with(&text, &[], &[("sh.comp", "r Sh 16\nw Out 4")]), "copy");
}

#[test]
fn the_choice_of_a_resource_counts_for_the_pass_that_uses_it() {
    let both = [make(), make().replace("make\"", "other\"").replace("\"a\"", "\"b\"")].join("\n");
    let chosen = show().replace(r#""In": "a""#, r#""In": "p > 4 ? 'a' : 'b'""#);
    // `other` is culled here; with another value of `p`, `make` would be.
    assert_eq!(effect(&[both.clone(), chosen]), "show");
    let named = graph(P, &[both, show().replace(r#""In": "a""#, r#""In": "from""#)].join("\n"))
        .replace("resources:", r#"let: {"from": "p > 4 ? 'a' : 'b'"}, resources:"#);
    assert_eq!(effect_with(&named, &[], &[]), "show");
}

#[test]
fn conditions_and_repeats_decide_which_passes_there_are() {
    let when = |condition: &str| make().replace("size:", &format!("when: \"{condition}\", size:"));
    let other = make().replace("\"make\"", "\"other\"");
    assert_eq!(effect(&[when("p > 4"), show()]), "+ make");
    assert_eq!(effect(&[other.clone(), when("p > 8"), show()]), "+ ", "a pass that is not there");
    let repeat = format!(r#"Repeat(var: "i", count: "p - 7", body: [{}]),"#, make());
    assert_eq!(effect(&[repeat.clone(), show()]), "+ make[0]");
}

#[test]
fn a_value_is_followed_into_an_included_graph() {
    let include = r#"Graph(version: 1, summary: "steps",
        params: {"times": Const(Int(default: 2, range: (1, 9))), "size": Const(Int(default: 64, range: (1, 4096)))},
        let: {"all": "2 * size"},
        ports: {"data": Buffer(stride: 4)}, resources: {"own": Buffer(stride: 4, count: "size")},
        passes: [
            Dispatch(name: "first", shader: "make.comp", size: Threads(64), bind: {"Out": "own"}),
            Repeat(var: "i", count: "times", body: [
                Dispatch(name: "step", shader: "copy.comp", size: Threads("all"), bind: {"In": "own", "Out": "data"}),
            ]),
        ])"#;
    let with = |set: &str, when: &str| {
        let passes = [
            make(),
            format!(r#"Include(graph: "steps", name: "s", {when} with: {{"data": "a"}}, set: {{{set}}}),"#),
            show(),
        ];
        effect_with(&graph(P, &passes.join("\n")), &[], &[("steps.ron", include)])
    };
    assert_eq!(with("", ""), NONE);
    assert_eq!(
        with(r#""size": "8 * p""#, ""),
        "s.first s.step[0] s.step[1]",
        "the size of `own`, and of `step`"
    );
    assert_eq!(with(r#""times": "p / 8""#, ""), "+ s.step[0]");
    assert_eq!(with("", r#"when: "p > 4","#), "+ s.first s.step[0] s.step[1]");
    assert_eq!(
        with(r#""size": "8 * p""#, "when: \"scene.count < 0\","),
        format!("{NONE}; it is used where `scene.count < 0` (graph.ron:16), and here scene.count = 1000")
    );
}

#[test]
fn what_is_not_evaluated_does_not_count_and_the_condition_does() {
    let with = |expression: &str| {
        let passes = [make().replace("64", &format!("\"{expression}\"")), show()].join("\n");
        let plan = plan(&graph(P_AND_Q, &passes), &[]);
        (effect_in(&plan, "p"), effect_in(&plan, "q"))
    };
    let (none, make) = (NONE.to_string(), "make".to_string());
    assert_eq!(with("q ? p : 64"), (none.clone(), make.clone()));
    assert_eq!(with("q ? 64 : p"), (make.clone(), make.clone()));
    assert_eq!(with("q && p > 4 ? 64 : 32"), (none, make.clone()));
    assert_eq!(with("p > 4 || q ? 64 : 32"), (make.clone(), NONE.to_string()));
    assert_eq!(with("0 * p + 64").0, make, "a value that cannot change the result counts all the same");
}

#[test]
fn the_end_of_the_frame_depends_on_what_the_output_and_the_statistics_name() {
    let with = |from: &str, to: &str| {
        effect_with(&graph(P, &[make(), show()].join("\n")).replace(from, to), &[], &[])
    };
    assert_eq!(with("output:", r#"stats: {"count": ("a", "4 * p")}, output:"#), "export host");
    assert_eq!(with("output: \"image\"", "output: \"p > 4 ? 'image' : 'color'\""), "export");
}

#[test]
fn a_pass_that_is_left_out_counts_as_far_as_its_accesses_go() {
    let unread =
        |more: &str| make().replace("make\"", "unread\"").replace("\"a\"", "\"b\"").replace("size:", more);
    let why = format!("{NONE}; it is used by `unread`, and nothing reads what it writes");
    assert_eq!(effect(&[make(), unread("size:").replace("64", "\"p\""), show()]), why);
    let twice = unread("size:").replace("64", "\"p\"");
    assert_eq!(
        effect(&[make(), twice.replace("unread", "first"), twice, show()]),
        format!("{NONE}; it is used by `first` and others, and nothing reads what they write")
    );
    // `p` decides whether the culled pass exists, or which resources it accesses: it shapes the plan (`+`).
    assert_eq!(effect(&[make(), unread("when: \"p > 4\", size:"), show()]), "+ ");
    assert_eq!(effect(&[make(), unread("size:").replace("\"b\"", "\"p > 4 ? 'b' : 'a'\""), show()]), "+ ");
    let text = graph(P, &[make(), unread("size:").replace("make.comp", "text.comp"), show()].join("\n"));
    assert_eq!(effect_with(&text, &[], &[("text.comp", "w Out 4\nP")]), "+ ");
}

#[test]
fn the_reason_names_the_condition_under_which_a_parameter_would_be_used() {
    let params = format!(r#"{P_AND_Q} "r": Const(Choice(default: "few", of: ["few", "many"])),"#);
    let with = |pass: &str| {
        let text = graph(&params, &[make(), pass.to_string(), show()].join("\n"))
            .replace("resources:", r#"let: {"wanted": "q || r == 'many'", "twice": "2 * p"}, resources:"#);
        effect_with(&text, &[], &[])
    };
    let pass = r#"Dispatch(name: "more", when: "wanted", shader: "change.comp", size: Threads("twice"), bind: {"Out": "a"}),"#;
    let why = format!("{NONE}; it is used where `wanted` (graph.ron:16), and here q = false, r = few");
    assert_eq!(with(pass), why);
    assert_eq!(with(&pass.replace("\"twice\"", "64").replace("\"a\"", "\"p > 4 ? 'a' : 'b'\"")), why);
    assert_eq!(with(&pass.replace("\"twice\"", "64")), NONE, "it would not be used there, either");
    assert_eq!(
        with(&pass.replace("\"wanted\"", "false")),
        format!("{NONE}; it is used where `false` (graph.ron:16)")
    );
    let repeated = pass.replace("when: \"wanted\", ", "");
    assert_eq!(
        with(&format!(r#"Repeat(var: "i", count: "wanted ? 2 : 0", body: [{repeated}]),"#)),
        format!(
            "{NONE}; it is used where `wanted ? 2 : 0` is above 0 (graph.ron:16), and here q = false, r = few"
        )
    );
    let text = graph(&params, &[make().replace("64", "\"size\""), show()].join("\n"))
        .replace("resources:", r#"let: {"size": "r == 'many' && q ? 3 * p : 64"}, resources:"#);
    let why = format!("{NONE}; `size` (graph.ron:2) leaves it out, as r = few");
    assert_eq!(effect_with(&text, &[], &[]), why);
    let params = params + r#""s": Const(Int(default: "q ? p : 64", range: (1, 64))),"#;
    let text = graph(&params, &[make().replace("64", "\"s\""), show()].join("\n"));
    assert_eq!(
        effect_with(&text, &[], &[]),
        format!("{NONE}; `s` (graph.ron:1) leaves it out, as q = false")
    );
}
