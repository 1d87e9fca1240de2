//! Tests the constructs that lowering resolves. Diagnostics are tested in `tests/golden`.

mod includes;

use crate::ir::{Facts, Request, Shape, Source, Value, Work};
use crate::source::{Library, SourceMap};
use crate::testing::{
    ListCompiler, dispatch, graph, make, plan, plan_of, plan_with_capacities, show, try_plan_of,
};

const WIDTH: &str = r#""width": Const(Int(default: 8, range: (1, 11), label: "digit width")),"#;

#[test]
fn a_pass_is_there_where_its_condition_holds() {
    let passes = [
        make().replace("shader:", r#"when: "width > 8", shader:"#),
        make().replace("\"make\"", r#""other", when: "width <= 8""#),
        show(),
    ];
    let names = |width| -> Vec<String> {
        let plan = plan(&graph(WIDTH, &passes.join("\n")), &[("width", width)]);
        plan.passes.into_iter().map(|pass| pass.name).collect()
    };
    assert_eq!(names("8"), ["other", "show", "export"]);
    assert_eq!(names("9"), ["make", "show", "export"]);
}

#[test]
fn threads_and_groups_have_up_to_three_dimensions_and_threads_are_divided_in_each() {
    let square = "local 8 4 1\nimage w Image rgba16f";
    let groups = |size: &str| {
        let pass = format!(
            r#"Dispatch(name: "paint", shader: "square.comp", size: {size}, bind: {{"Image": "image"}}),"#
        );
        let graph = graph(WIDTH, &pass);
        let plan = try_plan_of(&[("graph.ron", &graph), ("square.comp", square)], &[])?;
        let Work::Dispatch { groups: crate::ir::Groups::Direct(groups), .. } = plan.passes[0].work else {
            panic!("a dispatch of known size");
        };
        Ok::<_, String>(groups)
    };
    assert_eq!(groups(r#"Threads("viewport.width + 1", "viewport.height")"#), Ok([9, 8, 1]));
    assert_eq!(groups("Threads(8, 5, 3)"), Ok([1, 2, 3]));
    assert_eq!(groups("Groups(8, 5)"), Ok([8, 5, 1]));
    assert_eq!(groups("Groups(8, 5, 3)"), Ok([8, 5, 3]));
    // In one dimension, groups beyond the limit continue in y, in rows that leave few idle.
    assert_eq!(groups("Groups(70000)"), Ok([35000, 2, 1]));
    assert_eq!(groups("Groups(156250)"), Ok([52084, 3, 1]));
    let refused = groups("Groups(5, 70000)").unwrap_err();
    assert!(refused.contains("70000 workgroups in y; 65535 are possible"), "{refused}");
    let refused = groups("Threads(32)").unwrap_err();
    assert!(refused.contains("a workgroup here is 8 x 4 x 1"), "{refused}");
}

#[test]
fn a_choice_draws_the_first_graph_whose_needs_hold_and_says_why_it_passed_others_over() {
    let base = |require: &str| {
        graph(WIDTH, &[make(), show()].join("\n")).replace("summary:", &format!("{require} summary:"))
    };
    let wide = base(
        r#"require: [("device.max_groups_x >= 70000", "dispatches of 70000 workgroups"), ("true", "nothing")],"#,
    );
    let middle = r#"Preset(graph: "narrow", summary: "Narrower", set: {"width": 5}, require: [("device.subgroup_size > 4096", "wide subgroups")])"#;
    let narrow = base("");
    let plan = |choice: &str| {
        let graphs = [("wide.ron", &*wide), ("middle.ron", middle), ("narrow.ron", &narrow)];
        plan_of(&[&graphs[..], &[("graph.ron", choice)]].concat(), &[])
    };
    let found =
        plan(r#"Choice(summary: "the best", of: [(graph: "wide"), (graph: "middle"), (graph: "narrow")])"#);
    assert_eq!((found.name.as_str(), found.summary.as_str()), ("graph.ron", "the best"));
    let said: Vec<String> = found.fallbacks.iter().map(ToString::to_string).collect();
    let expected = [
        "`middle` is used instead of `wide`, which needs dispatches of 70000 workgroups (device.max_groups_x = 65535)",
        "`narrow` is used instead of `middle`, which needs wide subgroups (device.subgroup_size = 8)",
    ];
    assert_eq!(said, expected);
    assert!(found.fallbacks.iter().all(|fallback| !fallback.preference));
    // The setting of the rejected preset does not apply.
    assert_eq!(found.params[0].value, Value::Int(8));

    let preferred = plan(
        r#"Choice(summary: "", of: [(graph: "narrow", require: [("device.subgroup_size >= 16", "a GPU")]), (graph: "narrow")])"#,
    );
    assert!(preferred.fallbacks[0].preference, "{:?}", preferred.fallbacks);
    assert_eq!(preferred.based_on, ["narrow"]);
    // A preset of a choice applies to the chosen graph.
    let choice = r#"Choice(summary: "", of: [(graph: "wide"), (graph: "narrow")])"#;
    let preset = r#"Preset(graph: "choice", summary: "", set: {"width": 3})"#;
    let graphs = [("choice.ron", choice), ("wide.ron", &wide), ("narrow.ron", &narrow)];
    let found = plan_of(&[&graphs[..], &[("graph.ron", preset)]].concat(), &[]);
    assert_eq!((&found.params[0].value, found.fallbacks[0].taken.as_str()), (&Value::Int(3), "narrow"));
}

#[test]
fn a_value_that_an_expression_gave_carries_the_values_that_its_evaluation_reached() {
    let params = r#"
        "variant": Const(Choice(default: "device.subgroup_size < 16 ? 'serial' : scene.count < 5 ? 'few' : 'many'", of: ["serial", "few", "many"])),
        "plain": Const(Choice(default: "many", of: ["serial", "few", "many"])),
        "after": Const(Choice(default: "variant", of: ["serial", "few", "many"])),
        "room": Const(Int(default: "max(2 * device.subgroup_size, 5)", range: (1, 1000), grows: "visible")),
        "exact": Const(Bool(default: "device.subgroup_size == 8")),
        "cutoff": Live(Float(default: 3.33, range: (1.0, 4.0))),"#;
    let text = graph(params, &[make(), show()].join("\n"))
        .replace("output:", r#"stats: {"visible": ("a", 0)}, output:"#);
    let reasons = |set: &[(&str, &str)], capacities: &[(&str, i64)]| -> Vec<String> {
        let plan = plan_with_capacities(&text, set, capacities);
        let mut all: Vec<String> = plan
            .params
            .iter()
            .filter_map(|p| Some(format!("{} = {}: {}", p.name, p.value, p.reason.as_ref()?)))
            .collect();
        all.extend(plan.decisions());
        all
    };
    let lanes = "device.subgroup_size = 8";
    assert_eq!(
        reasons(&[], &[]),
        [
            &format!("variant = serial: {lanes}"),
            "after = serial: variant = serial",
            &format!("room = 16: {lanes}"),
            &format!("exact = true: {lanes}"),
            &format!("variant = serial and exact = true, because {lanes}"),
        ]
    );
    assert_eq!(
        reasons(&[("variant", "few"), ("exact", "true")], &[("room", 40)]),
        ["after = few: variant = few"],
        "what is set or grown has no reason in the file"
    );
}

#[test]
fn presets_lay_their_settings_over_each_other_and_the_command_line_over_all() {
    let base = graph(WIDTH, &[make(), show()].join("\n"));
    let files = [
        ("base.ron", base.as_str()),
        ("middle.ron", r#"Preset(graph: "base", summary: "five", set: {"width": 5})"#),
        ("graph.ron", r#"Preset(graph: "middle", summary: "six", set: {"width": "5 + 1"})"#),
    ];
    let width = |set: &[(&str, &str)]| {
        let plan = plan_of(&files, set);
        (plan.summary.clone(), plan.params[0].value.clone(), plan.params[0].default.clone())
    };
    assert_eq!(width(&[]), ("six".into(), Value::Int(6), Value::Int(8)));
    assert_eq!(width(&[("width", "7")]).1, Value::Int(7));
}

#[test]
fn a_parameter_that_grows_takes_the_largest_of_its_value_and_what_frames_needed_within_its_range() {
    let params = r#"
        "room": Const(Int(default: "scene.count", range: (1, 5000), grows: "needed")),
        "fixed": Const(Int(default: 3, range: (1, 5000))),"#;
    let graph = graph(params, &[make(), show()].join("\n"))
        .replace(r#""a": Buffer(stride: 4, count: 64)"#, r#""a": Buffer(stride: 4, count: "room")"#)
        .replace("output:", r#"stats: {"needed": ("a", 0)}, output:"#);
    let built = |set: &[(&str, &str)], capacities: &[(&str, i64)]| {
        let plan = plan_with_capacities(&graph, set, capacities);
        let a = plan.resource(plan.find_resource("a").expect("it is read"));
        assert_eq!(Value::Int(a.bytes() as i64 / 4), plan.params[0].value, "sizes follow");
        assert_eq!(plan.params[0].grows.as_deref(), Some("needed"));
        assert_eq!(plan.params[0].default, Value::Int(1000));
        (plan.params[0].value.clone(), plan.params[1].value.clone())
    };
    let room = |set, capacities| built(set, capacities).0;
    assert_eq!(room(&[], &[]), Value::Int(1000));
    assert_eq!(room(&[], &[("room", 900)]), Value::Int(1000), "the default is larger");
    assert_eq!(room(&[], &[("room", 1200)]), Value::Int(1200));
    assert_eq!(room(&[("room", "2000")], &[("room", 1200)]), Value::Int(2000), "a setting is larger");
    assert_eq!(room(&[("room", "20")], &[("room", 1200)]), Value::Int(1200), "and smaller");
    assert_eq!(room(&[], &[("room", 1 << 40)]), Value::Int(5000), "held to the range");
    let (room, fixed) = built(&[], &[("fixed", 7), ("gone", 8)]);
    assert_eq!((room, fixed), (Value::Int(1000), Value::Int(3)), "only what grows");
}

#[test]
fn push_constants_are_written_in_place() {
    let pass = r#"Dispatch(name: "make", shader: "push.comp", size: Threads(64), bind: {"Out": "a"}, push: {"shift": "3 * width"}),"#;
    let good = graph(WIDTH, &[pass.to_string(), show()].join("\n"));
    let plan = plan(&good, &[]);
    assert_eq!(plan.passes[0].push, 24u32.to_le_bytes());
}

#[test]
fn a_buffer_that_comes_with_every_frame_is_read_as_a_storage_buffer() {
    let read = [dispatch("copy", "copy.comp", r#""In": "words", "Out": "a""#), show()].join("\n");
    let graph = graph("", &read)
        .replace("resources:", r#"imports: {"words": Import(from: "frame.words")}, resources:"#);
    let plan = plan(&graph, &[]);
    let words = plan.resource(plan.find_resource("words").unwrap());
    assert_eq!(words.source, Source::HostBuffer { buffer: "frame.words".to_string() });
    assert_eq!(words.shape, Shape::Buffer { stride: 4, count: 4 });
}

#[test]
fn a_long_chain_of_lets_in_the_wrong_order_is_refused_at_once() {
    let lets: String = (0..4000).map(|i| format!("\"p{i}\": \"min(p{0}, p{0})\", ", i + 1)).collect();
    let text = graph("", &[make(), show()].concat()).replacen(
        "resources:",
        &format!("let: {{ {lets}\"p4000\": 1 }}, resources:"),
        1,
    );
    let begun = std::time::Instant::now();
    let error = try_plan_of(&[("graph.ron", &text)], &[]).expect_err("they are declared below");
    assert!(error.contains("a `let` can use only those above it"), "{error}");
    // With a walk over all others per `let`, it takes half a minute.
    assert!(begun.elapsed().as_secs() < 10, "{:?}", begun.elapsed());
}

#[test]
fn a_long_chain_of_passes_is_solved() {
    let passes = [
        make(),
        r#"Repeat(var: "i", count: 5000, body: [Dispatch(name: "step", shader: "change.comp", size: Threads(64), bind: {"Out": "a"})]),"#.to_string(),
        show(),
    ]
    .join("\n");
    let plan = plan(&graph("", &passes), &[]);
    assert_eq!(plan.frame.len(), 5003);
}

#[test]
fn a_settings_text_is_read_as_the_parameters_domain() {
    use crate::ir::Domain;
    use crate::lower::parse_value;
    let int = Domain::Int { min: 1, max: 4 };
    let float = Domain::Float { min: 0.0, max: 4.0, step: 0.1 };
    assert_eq!(parse_value("4", &int), Ok(Value::Int(4)));
    assert_eq!(parse_value("4", &float), Ok(Value::Float(4.0)));
    assert_eq!(parse_value("true", &Domain::Bool), Ok(Value::Bool(true)));
    assert_eq!(parse_value("a", &Domain::Choice(vec!["a".into()])), Ok(Value::Text("a".into())));
    for text in ["on", "1", "yes", "True"] {
        assert_eq!(parse_value(text, &Domain::Bool), Err("is not true or false".into()));
    }
    assert!(parse_value("5", &int).is_err() && parse_value("1.5", &int).is_err());
    assert!(
        parse_value("inf", &float).is_err() && parse_value("b", &Domain::Choice(vec!["a".into()])).is_err()
    );
}

/// Calls `question` with a request for `graph.ron` of `files`, and with `outputs` requested.
fn asked<T>(
    files: &[(&str, &str)],
    set: &[(&str, &str)],
    outputs: &[&str],
    question: impl FnOnce(&Request, &mut SourceMap) -> T,
) -> T {
    let mut facts = crate::testing::facts();
    facts.host.extend(outputs.iter().map(|name| (format!("outputs.{name}"), Value::Bool(true))));
    asked_of(&facts, files, set, question)
}

/// Calls `question` as [`asked`] does, with other facts.
fn asked_of<T>(
    facts: &Facts,
    files: &[(&str, &str)],
    set: &[(&str, &str)],
    question: impl FnOnce(&Request, &mut SourceMap) -> T,
) -> T {
    let memory = files.iter().map(|(path, text)| (path.to_string(), text.to_string())).collect();
    let mut files = SourceMap::new(Library { memory, ..Library::default() });
    let catalog = crate::testing::catalog();
    let set: Vec<_> = set.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect();
    let request = Request { set: &set, ..Request::new("graph.ron", facts, &catalog) };
    question(&request, &mut files)
}

#[test]
fn the_settings_that_a_graph_rejects_are_listed_and_do_not_count_for_the_ranges_of_others() {
    let graph = r#"Graph(version: 1, summary: "", output: "missing", passes: [],
        params: {
            "width": Const(Int(default: 8, range: (1, 11))),
            "rows": Const(Int(default: 2, range: (1, "width"))),
            "cutoff": Live(Float(default: 1.0, range: (0.0, 2.0))),
        })"#;
    let rejected_by = |graph: &str, set: &[(&str, &str)]| {
        asked(&[("graph.ron", graph)], set, &[], super::rejected_settings)
    };
    let rejected = |set: &[(&str, &str)]| rejected_by(graph, set);
    assert!(rejected(&[("width", "4"), ("rows", "4"), ("cutoff", "2")]).is_empty());
    assert_eq!(rejected(&[("rows", "8"), ("width", "12"), ("wdth", "4"), ("wdth", "5")]), ["wdth", "width"]);
    assert_eq!(rejected(&[("width", "4"), ("rows", "8"), ("cutoff", "high")]), ["rows", "cutoff"]);
    // A mistake in the graph hides none of them.
    let mistaken = graph.replace("default: 1.0", "default: 3.0");
    assert_eq!(rejected_by(&mistaken, &[("width", "12"), ("wdth", "4")]), ["wdth", "width"]);
}

#[test]
fn the_names_of_a_graphs_expressions_have_values_without_its_passes() {
    let graph = r#"Graph(version: 1, summary: "", output: "missing",
        params: { "width": Const(Int(default: 8, range: (1, 11))), "cutoff": Live(Float(default: 1.0, range: (0.0, 2.0))) },
        let: { "words": "scene.count / width", "wrong": "1 / 0", "next": "words + 1" }, passes: [])"#;
    let set = [("width", "10")];
    let names = asked(&[("graph.ron", graph)], &set, &[], super::expression_names).expect("names");
    assert_eq!(names.get("next"), Some(&Value::Int(101)));
    assert_eq!((names.get("wrong"), names.get("cutoff")), (None, None));
    assert!(names.iter().any(|(name, value)| (name, value) == ("scene.count", &Value::Int(1000))));
    assert_eq!(names.evaluate("ceil_div(scene.count, 256) << 1"), Some(Value::Int(8)));
    for none in ["words +", "i + 1", "1 / 0"] {
        assert_eq!(names.evaluate(none), None, "{none}");
    }
}

#[test]
fn an_output_is_a_result_where_it_is_asked_for_and_elsewhere_leaves_nothing_in_the_plan() {
    let graph = r#"Graph(version: 1, summary: "", output: "image", outputs: {"depth": "depth", "alpha": "image"},
        let: {"deep": "outputs.depth || outputs.elsewhere"},
        resources: {"image": Image(format: "rgba8", size: (8, 8)), "depth": Image(format: "r32f", size: (8, 8))},
        passes: [
            Dispatch(name: "paint", shader: "paint.comp", size: Threads(64), bind: {"Image": "image"}),
            Draw(name: "quad", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip,
                call: Direct(vertices: 4, instances: 1), when: "deep",
                targets: [Target(image: "depth", load: Clear(0, 0, 0, 0), blend: Replace, when: "deep"),
                    Target(image: "image", load: Keep, blend: Replace, when: "!deep")]),
        ])"#;
    let files = [
        ("graph.ron", graph),
        ("paint.comp", "image w Image rgba8"),
        ("quad.vert", ""),
        ("quad.frag", "out depth"),
    ];
    let plan = |outputs: &[&str]| {
        asked(&files, &[], outputs, |request, files| {
            crate::build(request, files, &mut ListCompiler)
                .map_err(|errors| crate::source::render(files, &errors, false))
        })
    };
    let names = |plan: &crate::plan::Plan| -> Vec<String> {
        plan.frame.iter().map(|id| plan.pass(*id).name.clone()).collect()
    };
    let picture = plan(&[]).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((names(&picture).join(" "), picture.outputs.len()), ("paint export".into(), 0));
    assert_eq!(picture.find_resource("depth"), None);
    let deep = plan(&["depth", "alpha"]).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(names(&deep).join(" "), "paint quad export");
    let outputs: Vec<(&str, &str)> =
        deep.outputs.iter().map(|o| (o.name.as_str(), deep.resource(o.image).name.as_str())).collect();
    assert_eq!(outputs, [("depth", "depth"), ("alpha", "image")]);
    let error = plan(&["dept"]).expect_err("there is none");
    assert!(
        error.contains("this graph has no output `dept`") && error.contains("did you mean `depth`?"),
        "{error}"
    );
    assert!(error.contains("outputs depth, alpha besides its picture"), "{error}");
    assert_eq!(
        (picture.offered, deep.offered),
        (vec!["depth".into(), "alpha".into()], vec!["depth".into(), "alpha".into()])
    );
}

#[test]
fn a_text_that_a_fact_never_is_is_an_error() {
    let graph = |text: &str| {
        let graph = graph("", &[make(), show()].join("\n"));
        graph.replace(
            "passes: [",
            &format!(r#"let: {{"own": "scene.key_of", "x": "own == '{text}'"}}, passes: ["#),
        )
    };
    let mut facts = crate::testing::facts();
    facts.host.insert("scene.key_of".into(), Value::Text("depth".into()));
    facts.texts.insert("scene.key_of".into(), vec!["depth".into(), "distance".into()]);
    let lowered = |text: &str| {
        asked_of(&facts, &[("graph.ron", &graph(text))], &[], |request, files| {
            super::lower(request, None, files)
        })
        .map_err(|errors| errors[0].primary.text.clone())
    };
    assert!(lowered("distance").is_ok());
    assert_eq!(lowered("depht").map(drop), Err("expected `depth` or `distance`, found `depht`".into()));
}
