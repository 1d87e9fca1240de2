//! Mistakes in graphs, with the whole text that a person sees, and the constructs that lowering resolves.

use crate::ir::{Shape, Source, Value, Work};
use crate::testing::{SHADERS, dispatch, graph, plan, plan_of};

fn error(graph: &str, set: &[(&str, &str)]) -> String {
    match plan(graph, set) {
        Ok(plan) => panic!("no error:\n{}", crate::dump::text(&crate::dump::dump(&plan))),
        Err(error) => error,
    }
}

fn shown(name: &str) -> String {
    dispatch(name, "show.comp", r#""In": "a", "Image": "image""#)
}

fn make() -> String {
    dispatch("make", "make.comp", r#""Out": "a""#)
}

const WIDTH: &str = r#""width": Const(Int(default: 8, range: (1, 11), label: "digit width")),"#;

#[test]
fn a_misspelt_resource_is_underlined_and_the_nearest_one_offered() {
    let passes = format!("{}\n{}", make(), dispatch("show", "show.comp", r#""In": "ke", "Image": "imag""#));
    let text = error(&graph("", &passes), &[]);
    assert!(text.contains("there is no resource `imag`"), "{text}");
    assert!(text.contains("graph.ron:1"), "{text}");
    assert!(text.contains("^^^^ not declared"), "{text}");
    assert!(text.contains("did you mean `image`?"), "{text}");
}

#[test]
fn a_cycle_names_its_passes_and_what_each_waits_for() {
    let passes = [
        dispatch("one", "copy.comp", r#""In": "b", "Out": "a""#),
        dispatch("two", "copy.comp", r#""In": "a", "Out": "b""#),
        shown("show"),
    ]
    .join("\n");
    let text = error(&graph("", &passes), &[]);
    assert!(text.contains("these passes wait for each other: `one`, `two`"), "{text}");
    assert!(text.contains("`one` needs `two` first, for `b`"), "{text}");
}

#[test]
fn an_unknown_parameter_in_set_is_shown_with_the_nearest_one() {
    let text = error(&graph(WIDTH, &[make(), shown("show")].join("\n")), &[("widht", "4")]);
    assert!(text.contains("the graph has no parameter `widht`"), "{text}");
    assert!(text.contains("widht=4"), "{text}");
    assert!(text.contains("did you mean `width`?"), "{text}");
}

#[test]
fn a_parameter_outside_its_range_is_refused_with_the_range() {
    let text = error(&graph(WIDTH, &[make(), shown("show")].join("\n")), &[("width", "12")]);
    assert!(text.contains("12 is not in 1 to 11"), "{text}");
}

#[test]
fn a_resource_whose_writer_is_left_out_says_which_condition_removed_it() {
    let passes = [
        r#"Dispatch(name: "make", when: "width > 8", shader: "make.comp", size: Threads(64), bind: {"Out": "a"}),"#.to_string(),
        shown("show"),
    ]
    .join("\n");
    let text = error(&graph(WIDTH, &passes), &[]);
    assert!(text.contains("`show` reads `a`, which no pass writes"), "{text}");
    assert!(text.contains("`make` uses it, but is left out because this is false"), "{text}");
    assert!(plan(&graph(WIDTH, &passes), &[("width", "9")]).is_ok());
}

#[test]
fn a_live_parameter_cannot_decide_the_plan() {
    let live = r#""share": Live(Float(default: 1.0, range: (0.0, 1.0))),"#;
    let passes = [
        r#"Dispatch(name: "make", shader: "make.comp", size: Threads("64 * share"), bind: {"Out": "a"}),"#
            .to_string(),
        shown("show"),
    ]
    .join("\n");
    let text = error(&graph(live, &passes), &[]);
    assert!(text.contains("`share` is a live parameter"), "{text}");
    assert!(text.contains("declare it `Const`"), "{text}");
}

#[test]
fn a_stride_that_does_not_fit_shows_both_sides() {
    let graph = graph("", &[make(), shown("show")].join("\n"))
        .replace(r#""a": Buffer(stride: 4, count: 64)"#, r#""a": Buffer(stride: 8, count: 64)"#);
    let text = error(&graph, &[]);
    assert!(text.contains("`Out` of `make.comp` has elements of 4 bytes"), "{text}");
    assert!(text.contains("`a` has elements of 8 bytes"), "{text}");
    assert!(text.contains("declared here"), "{text}");
}

#[test]
fn a_binding_that_the_shader_lacks_and_a_block_that_is_not_bound_are_both_errors() {
    let passes = [dispatch("make", "make.comp", r#""Outt": "a""#), shown("show")].join("\n");
    let text = error(&graph("", &passes), &[]);
    assert!(text.contains("nothing is bound to the block `Out` of `make.comp`"), "{text}");
    assert!(text.contains("`make.comp` has no block `Outt`"), "{text}");
    assert!(text.contains("did you mean `Out`?"), "{text}");
}

#[test]
fn a_misspelt_field_is_shown_at_its_place() {
    let passes = [make().replace("shader:", "shadr:"), shown("show")].join("\n");
    let text = error(&graph("", &passes), &[]);
    assert!(text.contains("shadr"), "{text}");
    assert!(text.contains("shader"), "{text}");
}

#[test]
fn an_expression_that_divides_by_zero_is_underlined_inside_the_string() {
    let passes = [make().replace("Threads(64)", r#"Threads("64 / (width - 8)")"#), shown("show")].join("\n");
    let text = error(&graph(WIDTH, &passes), &[]);
    assert!(text.contains("zero"), "{text}");
}

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
    let mut files = SHADERS.to_vec();
    files.push(("graph.ron", &graph));
    files.push(("steps.ron", include));
    let plan = plan_of(&files, &[]).unwrap_or_else(|e| panic!("{e}"));
    let names: Vec<&str> = plan.passes.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["make", "s.step[0]", "s.step[1]", "s.step[2]", "show", "export"]);

    let wrong = graph.replace(r#""data": "keys""#, r#""dta": "keys""#);
    files[SHADERS.len()] = ("graph.ron", &wrong);
    let text = plan_of(&files, &[]).expect_err("the port is misspelt");
    assert!(text.contains("nothing is given for the port `data`"), "{text}");
}

#[test]
fn a_mistake_in_an_included_file_is_shown_in_that_file() {
    let passes =
        [make(), r#"Include(graph: "steps", name: "s", with: {}),"#.to_string(), shown("show")].join("\n");
    let graph = graph("", &passes);
    let mut files = SHADERS.to_vec();
    files.push(("graph.ron", &graph));
    files.push(("steps.ron", "Graph(version: 1, summary: \"s\",\n  passes: [Swap(\"nothing\")])"));
    let text = plan_of(&files, &[]).expect_err("there is no such resource");
    assert!(text.contains("steps.ron:2:18"), "{text}");
}

#[test]
fn presets_lay_their_settings_over_each_other_and_the_command_line_over_all() {
    let base = graph(WIDTH, &[make(), shown("show")].join("\n"));
    let mut files = SHADERS.to_vec();
    files.push(("base.ron", &base));
    files.push(("middle.ron", r#"Preset(graph: "base", summary: "five", set: {"width": 5})"#));
    files.push(("graph.ron", r#"Preset(graph: "middle", summary: "six", set: {"width": "5 + 1"})"#));
    let width = |set: &[(&str, &str)]| {
        let plan = plan_of(&files, set).unwrap_or_else(|e| panic!("{e}"));
        (plan.summary.clone(), plan.params[0].value.clone(), plan.params[0].default.clone())
    };
    assert_eq!(width(&[]), ("six".into(), Value::Int(6), Value::Int(8)));
    assert_eq!(width(&[("width", "7")]).1, Value::Int(7));
}

#[test]
fn presets_that_lead_back_to_themselves_are_an_error() {
    let files = [
        ("graph.ron", r#"Preset(graph: "other", summary: "", set: {})"#),
        ("other.ron", r#"Preset(graph: "graph", summary: "", set: {})"#),
    ];
    let text = plan_of(&files, &[]).expect_err("a circle");
    assert!(text.contains("these presets are based on each other"), "{text}");
}

#[test]
fn dispatches_beyond_the_limit_in_x_are_folded_into_y() {
    let passes = [make().replace("Threads(64)", "Threads(10000000)"), shown("show")].join("\n");
    let plan = plan(&graph("", &passes), &[]).unwrap_or_else(|e| panic!("{e}"));
    let Work::Dispatch { groups: crate::ir::Groups::Direct([x, y, 1]), .. } = plan.passes[0].work else {
        panic!("{:?}", plan.passes[0].work)
    };
    assert_eq!((x, y), (52084, 3), "156250 groups in three rows, hardly any idle");
    assert!(x as u64 * y as u64 * 64 >= 10_000_000);
}

#[test]
fn push_constants_are_checked_by_name_and_written_in_place() {
    let pass = r#"Dispatch(name: "make", shader: "push.comp", size: Threads(64), bind: {"Out": "a"}, push: {"shift": "3 * width"}),"#;
    let good = graph(WIDTH, &[pass.to_string(), shown("show")].join("\n"));
    let plan = plan(&good, &[]).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(plan.passes[0].push, 24u32.to_le_bytes());
    let text = error(&good.replace(r#""shift":"#, r#""shft":"#), &[]);
    assert!(text.contains("the push constant `shift` of `push.comp` is not given"), "{text}");
    assert!(text.contains("no shader of this pass has a push constant `shft`"), "{text}");
}

#[test]
fn a_buffer_larger_than_the_device_binds_is_named_with_both_sizes() {
    let graph = graph("", &[make(), shown("show")].join("\n"))
        .replace("\"a\": Buffer(stride: 4, count: 64)", "\"a\": Buffer(stride: 4, count: 50000000)");
    let text = error(&graph, &[]);
    assert!(text.contains("`a` has 191 MiB, and the device binds at most 128"), "{text}");
}

#[test]
fn two_passes_of_one_name_are_an_error_that_shows_both() {
    let text = error(&graph("", &[make(), make(), shown("show")].join("\n")), &[]);
    assert!(text.contains("two passes are called `make`"), "{text}");
    assert!(text.contains("the first"), "{text}");
}

#[test]
fn a_target_that_is_kept_and_was_never_written_is_an_error() {
    let passes = [
        make(),
        r#"Draw(name: "draw", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
            bind: {"In": "a"}, targets: [Target(image: "image", load: Keep, blend: Replace)]),"#.to_string(),
    ]
    .join("\n");
    let text = error(&graph("", &passes), &[]);
    assert!(text.contains("`draw` reads `image`, which no pass writes"), "{text}");
}

#[test]
fn a_pass_that_runs_once_cannot_read_what_changes_with_every_frame() {
    let pass = r#"Dispatch(name: "make", run: Once, shader: "camera.comp", size: Threads(64), bind: {"Camera": "camera", "Out": "a"}),"#;
    let graph = graph("", &[pass.to_string(), shown("show")].join("\n"))
        .replace("resources:", r#"imports: {"camera": Import(from: "frame.camera")}, resources:"#);
    let text = error(&graph, &[]);
    assert!(text.contains("`make` runs once, and reads what changes with every frame"), "{text}");
    assert!(plan(&graph.replace("run: Once, ", ""), &[]).is_ok());
}

#[test]
fn a_buffer_that_comes_with_every_frame_is_read_as_a_storage_buffer_and_written_by_no_pass() {
    let imported = |passes: &str| {
        graph("", passes)
            .replace("resources:", r#"imports: {"words": Import(from: "frame.words")}, resources:"#)
    };
    let read = [dispatch("copy", "copy.comp", r#""In": "words", "Out": "a""#), shown("show")].join("\n");
    let plan = plan(&imported(&read), &[]).unwrap_or_else(|error| panic!("{error}"));
    let words = plan.resource(plan.find_resource("words").unwrap());
    assert_eq!(words.source, Source::HostBuffer { buffer: "frame.words".to_string() });
    assert_eq!(words.shape, Shape::Buffer { stride: 4, count: 4 });

    let written = [dispatch("make", "make.comp", r#""Out": "words""#), shown("show")].join("\n");
    let text = error(&imported(&written), &[]);
    assert!(text.contains("`words` is given to every frame and cannot be written"), "{text}");
    let once = read.replace(r#"name: "copy""#, r#"name: "copy", run: Once"#);
    let text = error(&imported(&once), &[]);
    assert!(text.contains("`copy` runs once, and reads what changes with every frame"), "{text}");
}

#[test]
fn repeats_without_end_are_refused_before_they_eat_the_machine() {
    let passes = [
        r#"Repeat(var: "i", count: 20000, body: [Repeat(var: "j", count: 20000, body: [Swap("keys")])]),"#
            .to_string(),
        make(),
        shown("show"),
    ]
    .join("\n");
    let text = error(&graph("", &passes), &[]);
    assert!(text.contains("steps, its repeats counted"), "{text}");
}

#[test]
fn a_long_chain_of_passes_is_solved() {
    let passes = [
        make(),
        r#"Repeat(var: "i", count: 5000, body: [Dispatch(name: "step", shader: "change.comp", size: Threads(64), bind: {"Out": "a"})]),"#.to_string(),
        shown("show"),
    ]
    .join("\n");
    let plan = plan(&graph("", &passes), &[]).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(plan.frame.len(), 5003);
}

#[test]
fn names_that_would_meet_are_refused() {
    let text = error(&graph("", &[make().replace("\"make\"", "\"export\""), shown("show")].join("\n")), &[]);
    assert!(text.contains("two passes are called `export`"), "{text}");
    let twice = graph("", &[make(), shown("show")].join("\n"))
        .replace(r#""keys": Buffer("#, r#""keys#1": Buffer(stride: 4, count: 4), "keys": Buffer("#);
    let text = error(&twice, &[]);
    assert!(text.contains("two resources are called `keys#1`"), "{text}");
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
