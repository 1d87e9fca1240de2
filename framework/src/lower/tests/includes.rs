//! Tests includes: ports, parameters that an include sets, exposes, shares or hides, and pictures of other graphs.

use crate::ir::Value;
use crate::testing::{dispatch, graph, make, plan_of, show, try_plan_of};

use super::WIDTH;

#[test]
fn an_included_graph_takes_its_ports_and_parameters_from_the_includer() {
    let include = r#"Graph(version: 1, summary: "steps", params: {"times": Const(Int(default: 1, range: (1, 9)))},
        ports: {"data": Buffer(stride: 4, ping_pong: true)},
        passes: [Repeat(var: "i", count: "times", body: [
            Dispatch(name: "step", shader: "copy.comp", size: Threads(64), bind: {"In": "front(data)", "Out": "back(data)"}),
            Swap("data"),
        ])])"#;
    let passes = [
        dispatch("make", "make.comp", r#""Out": "keys""#),
        r#"Include(graph: "steps", name: "s", with: {"data": "keys"}, set: {"times": "width - 5"}),"#
            .to_string(),
        dispatch("show", "show.comp", r#""In": "keys", "Image": "image""#),
    ]
    .join("\n");
    let graph = graph(WIDTH, &passes);
    let plan = plan_of(&[("graph.ron", &graph), ("steps.ron", include)], &[]);
    let names: Vec<&str> = plan.passes.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["make", "s.step[0]", "s.step[1]", "s.step[2]", "show", "export"]);
}

#[test]
fn a_statistic_of_a_name_in_use_has_the_name_of_its_include_before_it() {
    let counted = r#"Graph(version: 1, summary: "", resources: { "words": Buffer(stride: 4, count: 4) },
        passes: [Dispatch(name: "make", shader: "make.comp", size: Threads(4), bind: {"Out": "words"})],
        stats: { "made": ("words", 4) })"#;
    let names = |plan: &crate::plan::Plan| {
        let stats = plan.stats.iter();
        stats.map(|s| (s.name.clone(), s.grows.join(" "))).collect::<Vec<_>>()
    };
    let named = |all: &[(&str, &str)]| {
        all.iter().map(|(name, grows)| (name.to_string(), grows.to_string())).collect::<Vec<_>>()
    };
    let include = r#"
        Include(graph: "counted", name: "first"),
        Include(graph: "maker", name: "other", expose: All),
        Include(graph: "maker", name: "maker", expose: All),
        Include(graph: "maker", name: "fixed", expose: All, set: {"room": 9}),
        Repeat(var: "i", count: 2, body: [Include(graph: "counted", name: "again")]),"#;
    let files =
        [("graph.ron", including(include)), ("maker.ron", MAKER.into()), ("counted.ron", counted.into())];
    let files = files.each_ref().map(|(name, text)| (*name, text.as_str()));
    let plan = try_plan_of(&files, &[]).unwrap_or_else(|errors| panic!("{errors}"));
    let expected = [
        ("made", ""),
        ("other.made", "room"),
        ("maker.made", "room"),
        ("fixed.made", ""),
        ("again[0].made", ""),
        ("again[1].made", ""),
    ];
    assert_eq!(names(&plan), named(&expected));
    let room = plan.params.iter().find(|param| param.name == "room").expect("a parameter");
    assert_eq!(room.grows.as_deref(), Some("other.made"));
}

/// A part, which [`including`] includes.
const MAKER: &str = r#"Graph(version: 1, summary: "makes", params: {
        "size": Const(Int(default: 64, range: (1, 128))),
        "times": Const(Int(default: 1, range: (1, 9), help: "How often\n      it is made.")),
        "share": Live(Float(default: 0.5, range: (0.0, 1.0))),
        "room": Const(Int(default: 64, range: (1, 1024), grows: "made")),
    },
    let: { "result": "times > 1 ? 'b' : 'a'" },
    resources: { "a": Buffer(stride: 4, count: "size"), "b": Buffer(stride: 4, count: "size") },
    passes: [
        Dispatch(name: "make", shader: "make.comp", size: Threads("size"), bind: {"Out": "a"}),
        Dispatch(name: "more", shader: "copy.comp", size: Threads("size"), when: "times > 1", bind: {"In": "a", "Out": "b"}),
    ],
    stats: {"made": ("a", 0)},
)"#;

fn including(include: &str) -> String {
    format!(
        r#"Graph(version: 1, summary: "whole", output: "image",
            params: {{ "width": Const(Int(default: 8, range: (1, 11))) }},
            resources: {{ "image": Image(format: "rgba16f", size: (8, 8)) }},
            passes: [
                {include}
                Dispatch(name: "show", shader: "show.comp", size: Threads(64), bind: {{"In": "maker.result", "Image": "image"}}),
            ])"#
    )
}

fn plan_of_parts(include: &str, set: &[(&str, &str)]) -> Result<crate::plan::Plan, String> {
    try_plan_of(&[("graph.ron", &including(include)), ("maker.ron", MAKER)], set)
}

#[test]
fn a_part_has_resources_statistics_and_parameters_that_its_includer_binds() {
    let include = r#"Include(graph: "maker", name: "maker", set: {"times": "width > 4 ? 2 : 1", "size": 64}, expose: Only(["times", "share", "room"])),"#;
    let shows = |set: &[(&str, &str)]| {
        let plan = plan_of_parts(include, set).unwrap_or_else(|e| panic!("{e}"));
        let params: Vec<String> = plan.params.iter().map(|p| format!("{}={}", p.name, p.value)).collect();
        let show = plan.passes.iter().find(|pass| pass.name == "show").expect("the last pass");
        let stats: Vec<&str> = plan.stats.iter().map(|stat| stat.name.as_str()).collect();
        assert_eq!(stats, ["made"]);
        (params.join(" "), plan.resource(show.bindings[0].resource).name.clone())
    };
    assert_eq!(shows(&[]), ("width=8 times=2 share=0.5 room=64".into(), "maker.b".into()));
    assert_eq!(shows(&[("width", "4")]), ("width=4 times=1 share=0.5 room=64".into(), "maker.a".into()));
    assert_eq!(shows(&[("times", "1")]), ("width=8 times=1 share=0.5 room=64".into(), "maker.a".into()));

    let all = plan_of_parts(
        r#"Include(graph: "maker", name: "maker", set: {"times": 1}, expose: All),"#,
        &[("size", "65")],
    );
    let all = all.unwrap_or_else(|e| panic!("{e}"));
    let names: Vec<&str> = all.params.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["width", "size", "share", "room"], "`All` leaves out what `set` decides");
    assert_eq!(all.params[3].grows.as_deref(), Some("made"));
    let refused = plan_of_parts(r#"Include(graph: "maker", name: "maker"),"#, &[]).unwrap_err();
    assert!(refused.contains("found `share`, `room` only in the included graph"), "{refused}");
    let live = MAKER.replacen(
        "\"times\": Const",
        "\"more\": Live(Float(default: 1, range: (0, 1))),\n\"times\": Const",
        1,
    );
    let include = r#"Include(graph: "maker", name: "maker", expose: Only(["times"])),"#;
    let refused = try_plan_of(&[("graph.ron", &including(include)), ("maker.ron", &live)], &[]).unwrap_err();
    let all = [
        "found `more`, `share`, `room` only in the included graph",
        r#"Only(["times", "more", "share", "room"])"#,
    ];
    assert!(all.iter().all(|text| refused.contains(text)), "{refused}");
}

#[test]
fn includes_of_one_name_under_opposite_conditions_keep_their_parameters_apart() {
    let include = r#"
        Include(graph: "maker", name: "maker", when: "width > 8", expose: All),
        Include(graph: "maker", name: "maker", when: "width <= 8", set: {"times": 3}, expose: Only(["share", "room"])),"#;
    let made = |width: &str| {
        let plan = plan_of_parts(include, &[("width", width)]).unwrap_or_else(|e| panic!("{e}"));
        plan.passes.iter().filter(|pass| pass.name.starts_with("maker.")).count()
    };
    assert_eq!((made("8"), made("9")), (2, 1), "`times` is 3 in the one, and 1 in the other");
}

#[test]
fn a_parameter_that_two_includes_share_has_one_default() {
    let whole = including(
        r#"Include(graph: "maker", name: "maker", expose: All),
        Include(graph: "often", name: "other", expose: Only(["times"]), set: {"size": "size"}),"#,
    );
    let often = r#"Preset(graph: "maker", summary: "", set: {"times": 9})"#;
    let files = [("graph.ron", whole.as_str()), ("maker.ron", MAKER), ("often.ron", often)];
    let refused = try_plan_of(&files, &[]).unwrap_err();
    assert!(refused.contains("this graph already has the parameter `times`"), "{refused}");
}

#[test]
fn includes_with_equal_defaults_share_a_parameter() {
    let part = r#"Graph(version: 1, summary: "", passes: [], params: {"q": Const(Int(default: 2, range: (1, 99)))})"#;
    let shared = |first: &str, second: &str| {
        let include = |name: &str, set: &str| {
            format!(r#"Include(graph: "part", name: "{name}", set: {{{set}}}, expose: Only(["q"])),"#)
        };
        let maker = r#"Include(graph: "maker", name: "maker", expose: All),"#;
        let repeat = format!(r#"Repeat(var: "i", count: 1, body: [{}]),"#, include("two", second));
        let whole = including(&format!("{maker} {} {repeat}", include("one", first)));
        try_plan_of(&[("graph.ron", &whole), ("maker.ron", MAKER), ("part.ron", part)], &[])
    };
    for (first, second) in
        [(r#""q": 3"#, r#""q": 3"#), (r#""q": "2 * width""#, r#""q": "2 * width""#), ("", r#""q": 2"#)]
    {
        let plan = shared(first, second).unwrap_or_else(|error| panic!("{first}, {second}: {error}"));
        assert_eq!(plan.params.iter().filter(|param| param.name == "q").count(), 1);
    }
    for (first, second) in [(r#""q": 3"#, r#""q": 4"#), ("", r#""q": 3"#)] {
        let refused = shared(first, second).map(drop).unwrap_err();
        assert!(refused.contains("already has the parameter `q` with another default"), "{refused}");
    }
    // Equal texts with names that mean something else in each: a `let` of each graph, and a hidden parameter.
    let of = |value: &str| {
        format!(
            r#"Graph(version: 1, summary: "", let: {{"k": {value}}}, passes: [
                Include(graph: "part", name: "p", set: {{"q": "k"}}, expose: Only(["q"]))])"#
        )
    };
    let hides = part.replace("params: {", r#"params: {"width": Const(Int(default: 3, range: (1, 9))), "#);
    let hides = hides.replace("default: 2,", r#"default: "width","#);
    let maker = r#"Include(graph: "maker", name: "maker", expose: All),"#;
    for (includes, part) in [
        (
            r#"Include(graph: "a", name: "a", expose: All), Include(graph: "b", name: "b", expose: All),"#,
            part,
        ),
        (
            r#"Include(graph: "part", name: "a", set: {"q": "width"}, expose: Only(["q"])),
            Include(graph: "part", name: "b", expose: Only(["q"])),"#,
            hides.as_str(),
        ),
    ] {
        let whole = including(&format!("{maker} {includes}"));
        let files = [
            ("graph.ron", whole.as_str()),
            ("maker.ron", MAKER),
            ("part.ron", part),
            ("a.ron", &of("3")),
            ("b.ron", &of("4")),
        ];
        let refused = try_plan_of(&files, &[]).map(drop).unwrap_err();
        assert!(refused.contains("already has the parameter `q` with another default"), "{refused}");
    }
}

#[test]
fn a_parameter_that_chooses_a_resource_of_a_part_decides_for_its_readers() {
    let include = r#"Include(graph: "maker", name: "maker", set: {"size": 64}, expose: All),"#;
    let plan = plan_of_parts(include, &[]).unwrap_or_else(|e| panic!("{e}"));
    let said = plan.effect_text("times").expect("an effect");
    assert!(said.contains("show"), "{said}");
}

#[test]
fn a_graph_builds_on_the_picture_of_another_whichever_a_choice_takes() {
    let scene = including(r#"Include(graph: "maker", name: "maker", expose: All),"#);
    let never = r#"Preset(graph: "scene", summary: "", set: {}, require: [("false", "a miracle")])"#;
    let choice = r#"Choice(summary: "", of: [(graph: "never"), (graph: "scene")])"#;
    let edges = r#"Graph(version: 1, summary: "edges", output: "image",
        resources: { "image": Image(format: "rgba16f", size: (8, 8)) },
        passes: [
            Include(graph: "choice", name: "scene", expose: All),
            Dispatch(name: "filter", shader: "filter.comp", size: Threads(64), bind: {"Picture": "scene.picture", "Image": "image"}),
        ])"#;
    let filter = "local 64 1 1
image r Picture rgba16f
image w Image rgba16f";
    let files = [
        ("graph.ron", edges),
        ("choice.ron", choice),
        ("never.ron", never),
        ("filter.comp", filter),
        ("scene.ron", &scene),
        ("maker.ron", MAKER),
    ];
    let plan = plan_of(&files, &[("times", "2")]);
    let names: Vec<&str> = plan.passes.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["scene.maker.make", "scene.maker.more", "scene.show", "filter", "export", "host"]);
    let filter = plan.passes.iter().find(|pass| pass.name == "filter").expect("a pass");
    assert_eq!(plan.resource(filter.bindings[0].resource).name, "scene.image");
    let pictures = plan.pictures.iter().map(|picture| (picture.name.as_str(), picture.image));
    assert_eq!(pictures.collect::<Vec<_>>(), [("scene.picture", filter.bindings[0].resource)]);
    let params: Vec<&str> = plan.params.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(params, ["width", "size", "times", "share", "room"]);
}

#[test]
fn the_default_of_an_exposed_parameter_sees_what_its_include_sets_at_every_depth() {
    let part = r#"Graph(version: 1, summary: "part", params: {
            "width": Const(Int(default: 3, range: (1, 100))),
            "room": Const(Int(default: "2 * width", range: ("width", "10 * width"))),
        }, resources: {"words": Buffer(stride: 4, count: "room")},
        passes: [Dispatch(name: "make", shader: "make.comp", size: Threads("room"), bind: {"Out": "words"})])"#;
    let middle = r#"Graph(version: 1, summary: "middle", params: {"base": Const(Int(default: 1, range: (1, 100)))},
        passes: [Include(graph: "part", name: "part", set: {"width": "base + 1"}, expose: All)])"#;
    let words = |include: &str, set: &[(&str, &str)]| {
        let passes = [include, &dispatch("show", "show.comp", r#""In": "p.part.words", "Image": "image""#)];
        let passes = passes
            .join("\n")
            .replace("p.part.words", if include.contains("middle") { "p.part.words" } else { "p.words" });
        // The includer has a `width` of its own.
        let graph = graph(WIDTH, &passes);
        let files = [("graph.ron", graph.as_str()), ("part.ron", part), ("middle.ron", middle)];
        let plan = plan_of(&files, set);
        let words = plan.resources.iter().find(|r| r.name.ends_with("words")).expect("the part's buffer");
        let room = plan.params.iter().find(|param| param.name == "room").expect("it is exposed");
        (room.value.clone(), words.bytes() / 4, plan.effect_text("width"))
    };
    let include = r#"Include(graph: "part", name: "p", set: {"width": 7}, expose: Only(["room"])),"#;
    let (room, count, width) = words(include, &[]);
    assert_eq!((room, count), (Value::Int(14), 14), "twice the 7 that are set, not twice the includer's 8");
    assert!(width.is_some_and(|text| text.contains("no effect")), "the includer's `width` is another");
    let passed = r#"Include(graph: "part", name: "p", set: {"width": "width + 2"}, expose: All),"#;
    let (room, count, width) = words(passed, &[("width", "9")]);
    assert_eq!((room, count), (Value::Int(22), 22), "a value of `set` is over the includer's names");
    assert!(width.is_some_and(|text| !text.contains("no effect")), "which the size depends on");
    let deep = r#"Include(graph: "middle", name: "p", set: {"base": "3 * width"}, expose: All),"#;
    assert_eq!(words(deep, &[("width", "10")]).0, Value::Int(62));
    assert_eq!(words(deep, &[("room", "70")]).1, 70, "what is set on the command line wins");
}

#[test]
fn a_default_in_set_of_what_is_exposed_is_over_the_includers_names() {
    let part = r#"Graph(version: 1, summary: "part", params: {
            "width": Const(Int(default: 3, range: (1, 100))), "room": Const(Int(default: 5, range: (1, 100))),
        }, passes: [])"#;
    let include = r#"Include(graph: "part", name: "p", set: {"width": 7, "room": "2 * width"}, expose: Only(["room"])),"#;
    let passes = [include, &make(), &show()].join("\n");
    let graph = graph(WIDTH, &passes);
    let plan = plan_of(&[("graph.ron", graph.as_str()), ("part.ron", part)], &[]);
    let room = plan.params.iter().find(|param| param.name == "room").expect("it is exposed");
    assert_eq!(room.value, Value::Int(16));
}

#[test]
fn names_that_a_condition_removes_with_the_pass_are_no_mistake() {
    let inner = r#"Graph(version: 1, summary: "inner", resources: {"own": Buffer(stride: 4, count: 64)},
        params: {"deep": Const(Bool(default: false)),
            "source": Const(Choice(default: "nothing", of: ["nothing", "own"]))},
        let: {"result": "deep ? 'maker.a' : 'none.a'"},
        passes: [Include(graph: "maker", name: "maker", when: "deep", expose: Only(["share", "room"])),
            Include(graph: "maker", name: "none", when: "!deep", expose: Only(["share", "room"]))])"#;
    let narrow = r#"Graph(version: 1, summary: "narrow", resources: {"small": Buffer(stride: 4, count: 64)}, passes: [])"#;
    let wide = r#"Graph(version: 1, summary: "wide", params: {"extra": Const(Int(default: 1, range: (1, 4)))},
        resources: {"large": Buffer(stride: 4, count: 64),
        "image": Image(format: "rgba8", size: (8, 8))}, passes: [], output: "image")"#;
    let choice = r#"Choice(summary: "", of: [(graph: "wide", require: [("device.subgroup_size > 8", "a GPU")]), (graph: "narrow")])"#;
    let bind =
        |bind: &str| dispatch("slow", "copy.comp", bind).replace("shader:", r#"when: "width > 8", shader:"#);
    let result = |bound: &str| {
        let passes = [
            r#"Include(graph: "maker", name: "m", when: "width > 8", expose: Only(["share", "room"])),
               Include(graph: "inner", name: "i", set: {"deep": "width > 8"}, expose: Only(["share", "room"])),
               Include(graph: "choice", name: "c"),
               Include(graph: "choice", name: "d", when: "width > 8", set: {"extra": 2}),"#,
            &make(),
            &bind(bound),
            &show(),
        ];
        let graph = graph(WIDTH, &passes.join("\n"))
            .replace("passes: [", r#"let: {"kept": "width > 8 ? 'last(old)' : 'nothing'"}, passes: ["#)
            .replacen(
                "resources: {",
                r#"resources: {"old": Buffer(stride: 4, count: 64, history: "width > 8"),"#,
                1,
            );
        let files = [
            ("graph.ron", graph.as_str()),
            ("maker.ron", MAKER),
            ("inner.ron", inner),
            ("choice.ron", choice),
            ("wide.ron", wide),
            ("narrow.ron", narrow),
        ];
        try_plan_of(&files, &[])
    };
    for fine in [
        r#""In": "m.a""#,
        r#""In": "i.maker.a", "Out": "i.result""#,
        r#""In": "i.source", "Out": "c.picture""#,
        r#""In": "c.large", "Out": "c.small""#,
        r#""In": "last(old)", "Out": "kept""#,
        r#""In": "width > 8 ? 'front(keys)' : 'a'", "Out": "back(keys)""#,
        r#""In": "width > 8 ? 'b' : 'none'""#,
    ] {
        assert!(result(fine).is_ok(), "{}", result(fine).unwrap_err());
    }
    for wrong in ["x.a", "c.middle", "i.reslut", "odl", "lsat(old)"] {
        let error = result(&format!(r#""In": "{wrong}""#)).expect_err(wrong);
        assert!(error.contains("resource") && error.contains(r#""In": ""#), "{error}");
    }
}
