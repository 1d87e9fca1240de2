use super::*;
use crate::draw::planner::testing;

fn checked(planner: &mut Planner, graph: &str, splats: u64) -> CheckResult {
    let smallest = facts::SUBGROUP_SIZES.map(smallest);
    check(planner, graph, &[], splats, On::Smallest(&smallest), &mut |_| {})
}

fn right(result: CheckResult) -> String {
    match result.expect("no error") {
        Verdict::Right(lines) => lines,
        other => panic!("expected a graph without mistakes, found {other:?}"),
    }
}

#[test]
fn what_a_named_device_lacks_is_an_error_that_names_the_need() {
    let planner = &mut Planner::default();
    let mut on = |graph: &str, device: &str| {
        let device = options::target(Some(device)).expect("a device of the catalogue");
        check(planner, graph, &[], 1_000_000, On::Named(&device), &mut |_| {}).expect("no error")
    };
    let lacking = |verdict: Verdict| match verdict {
        Verdict::Lacking(line) => line,
        other => panic!("expected a need that is not met, found {other:?}"),
    };
    let line = lacking(on("tiled", "webgpu"));
    assert!(
        line.contains("device.subgroup_") && line.ends_with("= false), and there is no fallback"),
        "{line}"
    );
    let line = lacking(on("auto", "webgpu"));
    let (skipped, unmet) = line.split_once("; `splat` needs ").expect("both");
    assert!(skipped.contains("`splat` is used instead of `tiled_cpu`, which needs"), "{line}");
    assert_eq!(unmet, "sums over subgroups (device.subgroup_arithmetic = false), and there is no fallback");
    let line = lacking(on("splat", "webgpu-subgroups"));
    assert!(
        line.starts_with("expected at most 8 storage buffers in a shader, found: project.comp binds "),
        "{line}"
    );
    for device in ["lavapipe", "raspberry-pi-5", "adreno", "mali", "intel", "amd", "apple"] {
        let verdict = on("auto", device);
        assert!(
            matches!(&verdict, Verdict::Right(lines) if lines.starts_with("OK\n  ")),
            "{device}: {verdict:?}"
        );
    }
    let error = options::target(Some("no-such-device")).expect_err("there is none").to_string();
    assert!(error.ends_with("found `no-such-device`"), "{error}");
}

#[test]
fn the_plans_that_are_verified_have_both_sorts() {
    for (lanes, sort) in [(4, "serial"), (8, "serial"), (16, "subgroup"), (32, "subgroup"), (64, "subgroup")]
    {
        let plan = testing::plan("splat", &[], lanes);
        let sorter = plan.params.iter().find(|param| param.name == "sorter").expect("a parameter");
        assert_eq!(sorter.value.to_string(), sort, "{lanes} lanes");
        assert!(verify(&plan, &sync::barriers(&plan).expect("some")).is_ok(), "{lanes} lanes");
    }
}

#[test]
fn a_scene_too_large_for_the_smallest_device_is_answered_with_one_that_fits() {
    let planner = &mut Planner::default();
    let errors = checked(planner, "unsorted", 5_000_000).expect_err("the splats exceed a storage buffer");
    assert!(
        errors.to_string().contains("`splats` has 152.6 MiB, and the device binds at most 128.0 MiB"),
        "{errors}"
    );
    let fit =
        too_large(planner, "unsorted", &[], 5_000_000, &Target::nominal()).expect("it is only too large");
    assert!(
        fit.most_splats
            .is_some_and(|most| matches!(checked(planner, "unsorted", most), Ok(Verdict::Right(_)))),
        "{fit}"
    );
    assert_eq!(too_large(planner, "unsorted", &[], 1_000_000, &Target::nominal()), None);
}

#[test]
fn a_graph_beyond_the_limits_of_desktop_gpus_fails_without_a_device_too() {
    let large = graph("", "good.comp", "8, 8").replace("size: (8, 8)", "size: (16385, 8)");
    let buffer = |i: u32| format!("\"b{i}\": Buffer(stride: 4, count: 1)");
    let binding = |i: u32| format!("\"B{i}\": \"b{i}\"");
    // Binding 31 is reserved.
    let block = |i: u32| {
        let binding = i + 1 + i / 30;
        format!("layout(set = 0, binding = {binding}, std430) buffer B{i} {{ uint b{i}; }};\n")
    };
    let all =
        |each: &dyn Fn(u32) -> String, between: &str| (0..32).map(each).collect::<Vec<_>>().join(between);
    let many = graph("", "many.comp", "8, 8")
        .replace("resources: {", &format!("resources: {{ {},", all(&buffer, ", ")))
        .replace("bind: {", &format!("bind: {{ {},", all(&binding, ", ")));
    let folder = folder(&[("large.ron", &large), ("many.ron", &many)]);
    let stores = all(&|i| format!("b{i} = 1;"), " ");
    let shader = format!(
        "#version 460\nlayout(local_size_x = 8, local_size_y = 8) in;\n\
         layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;\n{}\
         void main() {{ {stores} imageStore(image, ivec2(0), vec4(1.0)); }}\n",
        all(&block, "")
    );
    std::fs::write(folder.path().join("many.comp"), shader).expect("writable");
    let errors = result(&folder, "large.ron").expect_err("too large").to_string();
    assert!(errors.contains("expected at most 16384, found 16385"), "{errors}");
    let found = result(&folder, "many.ron").expect("no error");
    let why = "expected at most 31 storage buffers in a shader, found: ";
    assert!(matches!(&found, Verdict::Lacking(line) if line.starts_with(why)), "{found:?}");
}

/// Creates a folder with these files (name and text), and with the shaders good.comp and bad.comp, which does not
/// compile.
fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let shader = |value: &str| {
        format!(
            "#version 460\nlayout(local_size_x = 8, local_size_y = 8) in;\n\
             layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;\n\
             void main() {{ imageStore(image, ivec2(0), {value}); }}\n"
        )
    };
    let shaders = [("good.comp", shader("vec4(1.0)")), ("bad.comp", shader("unknown"))];
    let graphs = files.iter().map(|(name, text)| (*name, (*text).to_owned()));
    for (name, text) in graphs.chain(shaders) {
        std::fs::write(folder.path().join(name), text).expect("writable");
    }
    folder
}

/// Formats a graph with one pass.
fn graph(require: &str, shader: &str, size: &str) -> String {
    format!(
        "Graph(version: 1, summary: \"\", output: \"image\", require: [{require}],\n  \
         resources: {{ \"image\": Image(format: \"rgba8\", size: (8, 8)) }},\n  \
         passes: [Dispatch(name: \"paint\", shader: \"{shader}\", size: Threads({size}), bind: {{ \"image\": \"image\" }})])"
    )
}

const LONGS: &str = r#"("device.int64", "64-bit integers")"#;

fn result(folder: &tempfile::TempDir, name: &str) -> CheckResult {
    let path = folder.path().join(name).display().to_string();
    checked(&mut Planner::default(), &path, 1000)
}

#[test]
fn a_graph_that_needs_more_than_the_smallest_device_is_no_error_and_all_else_is_checked() {
    let folder = folder(&[
        ("longs.ron", &graph(LONGS, "good.comp", "8, 8")),
        ("divides.ron", &graph(LONGS, "good.comp", "\"8 / 0\", 8")),
        ("shader.ron", &graph(LONGS, "bad.comp", "8, 8")),
        ("never.ron", &graph(r#"("device.max_groups_x < 0", "no workgroups")"#, "bad.comp", "8, 8")),
    ]);
    let text = right(result(&folder, "longs.ron"));
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(
        lines[..2],
        [
            "not for the least capable supported device",
            "  4, 8, 16, 32, 64, 128 lanes: the graph needs 64-bit integers (device.int64 = false), and there is no fallback"
        ]
    );
    let checked =
        "  4, 8, 16, 32, 64, 128 lanes: the graph with device.int64 = true: 2 passes (0 once, 2 every frame)";
    assert!(lines.len() == 3 && lines[2].starts_with(checked), "{text}");
    let errors = result(&folder, "divides.ron").expect_err("a division by zero");
    assert!(errors.to_string().contains("division by zero"), "{errors}");
    let errors = result(&folder, "shader.ron").expect_err("an unknown name");
    assert!(errors.to_string().contains("`unknown`"), "{errors}");
    let never = result(&folder, "never.ron");
    let Ok(Verdict::Unchecked(text, errors)) = &never else { panic!("expected no verdict, found {never:?}") };
    let last = "\n  the graph was not checked: no facts were found with which it has no workgroups (device.max_groups_x = 65535)";
    assert!(text.ends_with(last), "{text}");
    assert!(errors.to_string().contains("this graph needs no workgroups"), "{errors}");
    let json = as_json("never.ron", None, &never, Vec::new(), &[]);
    assert_eq!((&json["ok"], &json["diagnostics"][0]["line"]), (&json!(false), &json!(1)), "{json:#}");
}

/// Lists the warnings about the plans of a correct graph.
fn warnings(graph: &str, devices: &[Target]) -> Vec<PlainDiagnostic> {
    let mut found = Vec::new();
    let mut warn = |warning| {
        if let Warning::Plan { plain, .. } = warning {
            found.extend(plain);
        }
    };
    right(check(&mut Planner::default(), graph, &[], 1000, On::Smallest(devices), &mut warn));
    found
}

#[test]
fn parameters_that_nothing_mentions_give_warnings_and_parameters_that_are_only_idle_give_none() {
    let params = r#"params: {
  "never": Live(Int(default: 1, range: (1, 9))),
  "nor_this": Const(Int(default: 1, range: (1, 9))),
  "other": Const(Bool(default: false)), "tint": Live(Float(default: 1, range: (0, 1))),
  "of_a_let": Const(Int(default: 1, range: (1, 9))), "of_an_if": Const(Int(default: 1, range: (1, 9))) },
  let: { "twice": "2 * of_a_let" }, passes:"#;
    let shader = "\"other ? 'other.comp' : 'good.comp'\"";
    let text = graph("", "good.comp", "8, 8").replace("passes:", params).replace("\"good.comp\"", shader);
    let folder = folder(&[("graph.ron", &text)]);
    let good = std::fs::read_to_string(folder.path().join("good.comp")).expect("text");
    let other =
        good.replace("vec4(1.0)", "vec4(tint)").replace("layout(l", "#include \"live.glsl\"\nlayout(l");
    std::fs::write(folder.path().join("other.comp"), other).expect("writable");
    let good = good.replace("}", "\n#if 0\nOF_AN_IF\n#endif\n} // never, NOR_THIS");
    std::fs::write(folder.path().join("good.comp"), good).expect("writable");
    let path = folder.path().join("graph.ron").display().to_string();
    let found = warnings(&path, &facts::SUBGROUP_SIZES.map(smallest));
    let found: Vec<_> = found.iter().map(|w| (w.line, w.column, w.end_column, w.message.as_str())).collect();
    let message = ["nothing uses the parameter `never`", "nothing uses the parameter `nor_this`"];
    assert_eq!(found, [(4, 4, 9, message[0]), (5, 4, 12, message[1])]);
}

#[test]
fn subgroups_that_are_wider_than_the_workgroup_give_one_warning_for_all_devices() {
    let params = "params: { \"never\": Const(Int(default: 1, range: (1, 9))) }, passes:";
    let text = graph("", "good.comp", "8, 8").replace("passes:", params);
    let folder = folder(&[("graph.ron", &text)]);
    let path = folder.path().join("graph.ron").display().to_string();
    let widths = facts::SUBGROUP_SIZES.map(smallest);
    let with_size = |local_size: &str, devices: &[Target]| {
        let text = format!(
            "#version 460\n#extension GL_KHR_shader_subgroup_arithmetic : require\nlayout({local_size}) in;\n\
             layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;\n\
             void main() {{ imageStore(image, ivec2(0), vec4(subgroupAdd(1.0))); }}\n"
        );
        std::fs::write(folder.path().join("good.comp"), text).expect("writable");
        warnings(&path, devices)
    };
    let square = "local_size_x = 8, local_size_y = 8";
    let found = with_size(square, &widths);
    let message = "`good.comp` uses subgroup operations in workgroups of 8 x 8 x 1";
    // All devices have the first warning, and only the wide ones the second.
    let found: Vec<_> = found.iter().map(|warning| (warning.message.as_str(), warning.line)).collect();
    assert_eq!(found, [("nothing uses the parameter `never`", 3), (message, 3)]);
    assert_eq!(with_size(square, &widths[..2]).len(), 1);
    assert_eq!(with_size("local_size_x = 128", &widths).len(), 1);
    for graph in ["splat", "tiled", "tiled_cpu"] {
        assert!(warnings(graph, &widths).is_empty(), "{graph}");
    }
}

#[test]
fn a_graph_that_requires_sums_over_subgroups_has_a_fallback_on_a_device_without_subgroups() {
    let sums = graph(r#"("device.subgroup_arithmetic", "sums over subgroups")"#, "sum.comp", "8, 8");
    let choice = r#"Choice(summary: "", of: [(graph: "sums.ron"), (graph: "plain.ron")])"#;
    let plain = graph("", "good.comp", "8, 8");
    let folder = folder(&[("sums.ron", &sums), ("plain.ron", &plain), ("choice.ron", choice)]);
    let shader = "#version 460\n#extension GL_KHR_shader_subgroup_arithmetic : require\n\
        layout(local_size_x = 64) in;\n\
        layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;\n\
        void main() { imageStore(image, ivec2(0), vec4(subgroupAdd(1.0))); }\n";
    std::fs::write(folder.path().join("sum.comp"), shader).expect("writable");
    let device = options::target(Some("webgpu")).expect("a device of the catalogue");
    let path = folder.path().join("choice.ron").display().to_string();
    let found = check(&mut Planner::default(), &path, &[], 1000, On::Named(&device), &mut |_| {});
    assert!(right(found).contains("`plain.ron` is used instead of `sums.ron`"));
}

#[test]
fn float_atomics_can_be_required_and_have_a_fallback() {
    let needs = r#"("device.buffer_float_atomic_add", "sums of floats")"#;
    let sums = |require: &str| {
        let text = graph(require, "sum.comp", "8, 8").replace("bind: {", "bind: { \"Sums\": \"sums\",");
        text.replace("resources: {", "resources: { \"sums\": Buffer(stride: 4, count: 64),")
    };
    let choice = r#"Choice(summary: "", of: [(graph: "sums.ron"), (graph: "plain.ron")])"#;
    let folder = folder(&[
        ("sums.ron", &sums(needs)),
        ("bare.ron", &sums("")),
        ("plain.ron", &graph("", "good.comp", "8, 8")),
        ("choice.ron", choice),
    ]);
    let shader = "#version 460\n#extension GL_EXT_shader_atomic_float : require\n\
        layout(local_size_x = 8, local_size_y = 8) in;\n\
        layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;\n\
        layout(set = 0, binding = 1, std430) buffer Sums { float sums[]; };\n\
        void main() { imageStore(image, ivec2(0), vec4(atomicAdd(sums[0], 1.0))); }\n";
    std::fs::write(folder.path().join("sum.comp"), shader).expect("writable");
    let text = right(result(&folder, "sums.ron"));
    assert!(text.contains("the graph with device.buffer_float_atomic_add = true: "), "{text}");
    let text = right(result(&folder, "choice.ron"));
    assert!(text.contains("`plain.ron` is used instead of `sums.ron`, which needs sums of floats"), "{text}");
    let errors = result(&folder, "bare.ron").expect_err("a need that is not required").to_string();
    let help = r#"`require: [("device.buffer_float_atomic_add", "atomic float additions in buffers")]`"#;
    assert!(errors.contains(help), "{errors}");
    let lavapipe = options::target(Some("lavapipe")).expect("a device of the catalogue");
    let path = folder.path().join("bare.ron").display().to_string();
    right(check(&mut Planner::default(), &path, &[], 1000, On::Named(&lavapipe), &mut |_| {}));
}

#[test]
fn errors_of_every_graph_of_a_choice_are_found_and_a_fallback_is_fine() {
    let choice = |of: &str| format!("Choice(summary: \"\", of: [{of}])");
    let folder = folder(&[
        ("good.ron", &graph("", "good.comp", "8, 8")),
        ("bad.ron", &graph("", "bad.comp", "8, 8")),
        ("longs.ron", &graph(LONGS, "good.comp", "8, 8")),
        ("after.ron", &choice(r#"(graph: "good.ron"), (graph: "bad.ron")"#)),
        ("before.ron", &choice(&format!(r#"(graph: "bad.ron", require: [{LONGS}]), (graph: "good.ron")"#))),
        ("last.ron", &choice(r#"(graph: "longs.ron"), (graph: "bad.ron")"#)),
        (
            "small.ron",
            &choice(r#"(graph: "bad.ron", require: [("scene.count < 9", "few")]), (graph: "good.ron")"#),
        ),
        ("fine.ron", &choice(r#"(graph: "longs.ron"), (graph: "good.ron")"#)),
    ]);
    for name in ["after.ron", "before.ron", "last.ron", "small.ron"] {
        let errors = result(&folder, name).expect_err(name);
        assert!(errors.to_string().contains("`unknown`"), "{name}: {errors}");
        let which = match name {
            "last.ron" => "is drawn with device.subgroup_size = 4",
            _ => "is not drawn here",
        };
        let note = format!("the choice's graph `bad.ron`, which {which}, has this error");
        assert_eq!(errors.found[0].help.last(), Some(&note), "{name}: {errors}");
    }
    let text = right(result(&folder, "fine.ron"));
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!((lines[0], lines.len()), ("OK", 3), "{text}");
    let drawn = "  4, 8, 16, 32, 64, 128 lanes: `good.ron` is used instead of `longs.ron`, which needs 64-bit integers \
                 (device.int64 = false); 2 passes";
    assert!(lines[1].starts_with(drawn), "{text}");
    assert!(
        lines[2].starts_with("  4, 8, 16, 32, 64, 128 lanes: `longs.ron` with device.int64 = true: 2 passes"),
        "{text}"
    );
}

#[test]
fn a_graph_of_a_choice_that_cannot_be_checked_is_a_warning() {
    let folder = folder(&[
        ("good.ron", &graph("", "good.comp", "8, 8")),
        ("bad.ron", &graph("", "bad.comp", "8, 8")),
        (
            "choice.ron",
            r#"Choice(summary: "", of: [(graph: "bad.ron", require: [("1 > 2", "a wonder")]), (graph: "good.ron")])"#,
        ),
        (
            "none.ron",
            r#"Choice(summary: "", of: [(graph: "bad.ron", require: [("1 > 2", "one")]), (graph: "good.ron", require: [("2 > 3", "two")])])"#,
        ),
    ]);
    let path = folder.path().join("choice.ron").display().to_string();
    let mut found = Vec::new();
    let mut warn = |warning| match warning {
        Warning::Unchecked(plain) => found.extend(plain),
        _ => panic!("expected one warning, found another"),
    };
    let smallest = facts::SUBGROUP_SIZES.map(smallest);
    let text = right(check(&mut Planner::default(), &path, &[], 1000, On::Smallest(&smallest), &mut warn));
    let last = "`bad.ron` was not checked: no facts were found with which it has a wonder (`1 > 2` is false)";
    assert!(text.contains(last), "{text}");
    let found: Vec<&str> = found.iter().map(|warning| warning.message.as_str()).collect();
    assert_eq!(found, ["this graph needs a wonder"]);
    let none = result(&folder, "none.ron");
    let Ok(Verdict::Unchecked(_, errors)) = &none else { panic!("expected no verdict, found {none:?}") };
    let found: Vec<_> = errors.found.iter().map(|error| (error.message.as_str(), &error.help[1])).collect();
    let note =
        |name: &str| format!("the choice's graph `{name}`, which was not checked, has this requirement");
    assert_eq!(
        found,
        [("this graph needs one", &note("bad.ron")), ("this graph needs two", &note("good.ron"))]
    );
    let text = errors.to_string();
    assert!(text.contains("this graph needs one") && text.contains("this graph needs two"), "{text}");
}

#[test]
fn json_has_the_place_of_a_mistake_and_what_helps() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("graph.ron");
    let text = "Graph(version: 1, summary: \"\", output: \"image\",\n  \
                resources: { \"image\": Image(format: \"RGBA8Unorm\", size: (8, 8)) }, passes: [])";
    std::fs::write(&path, text).expect("writable");
    let graph = path.display().to_string();
    let result = checked(&mut Planner::default(), &graph, 1000);
    let json = as_json(&graph, None, &result, Vec::new(), &[]);
    assert_eq!(json["ok"], false);
    let found = &json["diagnostics"][0];
    assert_eq!((&found["line"], &found["column"]), (&json!(2), &json!(40)), "{json:#}");
    assert_eq!((&found["end_line"], &found["end_column"]), (&json!(2), &json!(50)), "{json:#}");
    assert_eq!((&found["severity"], &found["help"][0]), (&json!("error"), &json!("did you mean `rgba8`?")));
    assert!(found["file"].as_str().is_some_and(|file| file.ends_with("graph.ron")), "{json:#}");
}

#[test]
fn a_barrier_too_few_and_a_barrier_too_many_fail() {
    let plan = testing::plan("splat", &[], 8);
    let barriers = sync::barriers(&plan).expect("some");
    let at = plan.frame.iter().position(|pass| !barriers.at(Some(*pass)).is_empty());
    let at = Some(plan.frame[at.expect("a barrier")]);
    let mut fewer = barriers.clone();
    fewer.at_mut(at).clear();
    let text = verify(&plan, &fewer).expect_err("a hazard");
    assert!(!text.contains("needless"), "{text}");
    let mut more = barriers.clone();
    let twice = more.at(at)[0].clone();
    more.at_mut(at).push(twice);
    let text = verify(&plan, &more).expect_err("a needless barrier");
    assert!(text.lines().all(|line| line.starts_with("needless: ")), "{text}");
}

#[test]
fn a_mistake_in_a_pass_that_only_an_output_needs_is_found() {
    let with_output = |shader: &str| {
        let more = "outputs: { \"more\": \"more\" }, resources: { \"more\": Image(format: \"rgba8\", size: (8, 8)), ";
        let pass = format!(
            "passes: [Dispatch(name: \"more\", shader: \"{shader}\", when: \"outputs.more\", size: Threads(8, 8), \
             bind: {{ \"image\": \"more\" }}), "
        );
        graph("", "good.comp", "8, 8").replace("resources: { ", more).replace("passes: [", &pass)
    };
    let folder = folder(&[("good.ron", &with_output("good.comp")), ("bad.ron", &with_output("bad.comp"))]);
    let text = right(result(&folder, "good.ron"));
    let lines: Vec<&str> = text.lines().skip(1).collect();
    let lanes = "  4, 8, 16, 32, 64, 128 lanes: ";
    assert!(lines[0].starts_with(&format!("{lanes}2 passes")), "{text}");
    assert!(lines[1].starts_with(&format!("{lanes}with every output: 3 passes")), "{text}");
    let errors = result(&folder, "bad.ron").expect_err("an unknown name").to_string();
    assert!(
        errors.contains("`unknown`") && errors.trim_end().ends_with("with every output requested: more"),
        "{errors}"
    );
}
