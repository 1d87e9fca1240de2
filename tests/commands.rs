//! The program as a user runs it: a scene is generated, inspected, drawn and compared, each by its command.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

use crate::common;

pub fn splatgraph(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_splatgraph"))
        .args(args)
        .current_dir(folder)
        .output()
        .expect("the program runs")
}

/// Standard output of a command that succeeds.
pub fn done(folder: &Path, args: &[&str]) -> String {
    let output = splatgraph(folder, args);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "splatgraph {}: {errors}", args.join(" "));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// A folder with a generated scene and its cameras.
pub fn scene() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    done(
        folder.path(),
        &["synth", "demo", "--count", "5000", "-o", "scene.ply", "--cameras", "cameras.json"],
    );
    folder
}

#[test]
fn the_sorted_keys_of_tiles_are_judged_under_the_same_short_name() {
    let folder = scene();
    for graph in ["tiled", "tiled_cpu"] {
        let mut args = vec!["render", "scene.ply", "--pipeline", graph, "--size", "160x90", "-o", "out.png"];
        args.extend(["--inspect", "keys@scatter"]);
        let device = common::device_option();
        args.extend(device.as_deref());
        let text = done(folder.path(), &args);
        let verdict = text.split("monotonic: the first ").nth(1).unwrap_or_else(|| panic!("{graph}: {text}"));
        let keys = verdict.split(' ').next().and_then(|n| n.parse::<u64>().ok());
        assert!(keys.is_some_and(|keys| keys > 1000), "{graph}: {text}");
        assert!(!text.contains("not monotonic"), "{graph}: {text}");
        std::fs::remove_file(folder.path().join("out.png")).expect("the picture");
    }
}

#[test]
fn a_scene_is_drawn_from_every_camera_with_statistics_and_sorted_keys() {
    let folder = scene();
    let mut args = vec![
        "render",
        "scene.ply",
        "--pipeline",
        "splat",
        "--cameras",
        "cameras.json",
        "--size",
        "160x90",
        "--format",
        "npy",
        "-o",
        "out",
        "--json",
        "stats.json",
        "--inspect",
        "keys@scatter",
        "--inspect",
        "order@scatter=order.npy",
        "--validate",
    ];
    let device = common::device_option();
    args.extend(device.as_deref());
    let text = done(folder.path(), &args);
    assert!(!text.contains("not monotonic"), "the keys are not sorted:\n{text}");
    let stats: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("stats.json")).expect("written"))
            .expect("JSON");
    let cameras = stats.as_array().expect("one entry per camera");
    assert_eq!(cameras.len(), 4);
    assert_eq!(text.matches("\n  monotonic: ").count(), 4, "{text}");
    for camera in cameras {
        for key in ["device", "parameters", "counts", "passes", "phases", "buffers"] {
            assert!(!camera[key].is_null(), "no {key} in {camera}");
        }
        let count =
            |name: &str| camera["counts"][name].as_u64().unwrap_or_else(|| panic!("no {name} in {camera}"));
        assert_eq!(count("loaded"), 5000);
        assert!(count("visible") <= 5000 && count("drawn") == count("visible") && count("drawn") > 0);
        let sorted = format!("\n  monotonic: the first {} keys ascend\n", count("visible"));
        assert!(text.contains(&sorted), "not every visible key is said to be sorted:\n{text}");
        for phase in ["project", "key", "sort", "draw"] {
            assert!(
                camera["phases"][phase].as_f64().is_some_and(|ms| ms > 0.0),
                "no time for {phase} in {camera}"
            );
        }
        let pass = &camera["passes"][0];
        assert!(
            pass["name"].is_string() && pass["phase"].is_string() && pass["gpu_ms"].is_number(),
            "{pass}"
        );
        let buffers = camera["buffers"].as_array().expect("a list");
        assert!(buffers.iter().any(|b| b["name"] == "order.keys#0" && b["bytes"] == 20_000), "{buffers:?}");
    }
    for name in ["pond", "knot", "lotus", "lee"] {
        let image = splatgraph::io::image::Image::load(&folder.path().join(format!("out/{name}.npy")))
            .expect("a picture");
        assert_eq!((image.width, image.height), (160, 90));
    }
}

#[test]
fn a_picture_is_the_same_in_every_format_and_compares_as_such() {
    let folder = scene();
    for picture in ["a.npy", "b.exr", "c.png"] {
        let args = ["render", "scene.ply", "--cameras", "cameras.json#0", "--size", "96x54", "-o", picture];
        done(folder.path(), &args);
    }
    assert!(done(folder.path(), &["compare", "a.npy", "b.exr"]).contains("inf"), "the floats are the same");
    done(folder.path(), &["compare", "a.npy", "c.png", "--min-psnr", "50"]);
    let other = ["render", "scene.ply", "--cameras", "cameras.json#1", "--size", "96x54", "-o", "d.npy"];
    done(folder.path(), &other);
    let worse = splatgraph(folder.path(), &["compare", "a.npy", "d.npy", "--min-psnr", "50"]);
    assert_eq!(worse.status.code(), Some(1), "another camera gives another picture");
}

#[test]
fn dumps_show_eight_four_and_three_digits() {
    let folder = tempfile::tempdir().expect("a folder");
    for (preset, digits) in [("digit4", 8), ("digit8", 4), ("digit11", 3), ("key16", 2), ("unsorted", 0)] {
        let dump: Value =
            serde_json::from_str(&done(folder.path(), &["dump", preset, "--format", "json"])).expect("JSON");
        let passes = dump["passes"].as_array().expect("a list");
        for step in ["histogram", "scan", "scatter"] {
            let prefix = format!("order.sort.{step}[");
            let found =
                passes.iter().filter(|p| p["name"].as_str().is_some_and(|n| n.starts_with(&prefix))).count();
            assert_eq!(found, digits, "{preset}: dispatches of {step}");
        }
    }
    assert!(done(folder.path(), &["dump", "splat", "--format", "dot"]).starts_with("digraph"));
}

#[test]
fn the_accounts_of_a_file_and_of_a_plan_are_complete() {
    let folder = scene();
    let bytes = std::fs::metadata(folder.path().join("scene.ply")).expect("there").len();
    let text = done(folder.path(), &["info", "scene.ply", "--pipeline", "splat"]);
    assert!(text.contains(&format!("{} bytes", splatgraph_assets::grouped(bytes))), "{text}");
    for name in ["scene.covariances", "order.keys#1", "order.sort.table"] {
        assert!(text.contains(name), "no {name} in\n{text}");
    }
}

#[test]
fn every_preset_passes_its_check() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = done(folder.path(), &["check"]);
    let (verdicts, widths): (Vec<&str>, Vec<&str>) = text.lines().partition(|line| !line.starts_with(' '));
    assert_eq!(
        verdicts.len(),
        splatgraph::draw::builtin::names().len()
            + splatgraph::draw::builtin::filters().len()
            + splatgraph::studies::bench::GRAPHS.len()
            + 1,
        "{text}"
    );
    assert!(verdicts.iter().all(|line| line.ends_with(": OK")), "{text}");
    for line in widths {
        let removals = line.split_once("any bit of one (").and_then(|(_, rest)| rest.split_once(" ways)"));
        assert!(
            removals.is_some_and(|(count, _)| count.parse::<u32>().is_ok_and(|count| count > 0)),
            "{line}"
        );
    }
    for lanes in ["4", "8", "16", "32", "64"] {
        let has = |line: &&str| {
            line.split_once(" lanes: ").is_some_and(|(all, _)| all.trim().split(", ").any(|l| l == lanes))
        };
        assert_eq!(text.lines().filter(has).count(), verdicts.len(), "{lanes} lanes in\n{text}");
    }
    assert!(text.contains("view/window: OK"), "{text}");
}

/// Lists the commands in the program's help.
fn listed_commands(help: &str) -> Vec<&str> {
    let (_, list) = help.split_once("\nCommands:\n").expect("a list of commands");
    // Longer descriptions continue on lines of their own, indented further.
    let names = list.lines().take_while(|line| !line.is_empty()).filter_map(|line| line.strip_prefix("  "));
    names.filter(|line| !line.starts_with(' ')).filter_map(|line| line.split(' ').next()).collect()
}

#[test]
fn every_command_teaches_by_examples() {
    let folder = tempfile::tempdir().expect("a folder");
    let help = done(folder.path(), &["--help"]);
    let commands = listed_commands(&help);
    for known in ["view", "render", "bench", "sweep", "advise"] {
        assert!(commands.contains(&known), "{commands:?}");
    }
    // `help` is clap's own.
    for command in commands.into_iter().filter(|command| *command != "help") {
        let help = done(folder.path(), &[command, "--help"]);
        assert!(help.contains("Examples:"), "{command} has no examples:\n{help}");
    }
}

/// Shaders for graphs with mistakes: `next.comp` counts in place, `half.vert` reads what `half.frag` writes.
const SHADERS: [(&str, &str); 6] = [
    (
        "next.comp",
        "layout(local_size_x = 64) in;
        layout(set = 0, binding = 0, std430) buffer Words { uint words[]; };
        void main() { words[gl_LocalInvocationIndex] += 1; }",
    ),
    (
        "copy.comp",
        "layout(local_size_x = 64) in;
        layout(set = 0, binding = 0, std430) readonly buffer From { uint from[]; };
        layout(set = 0, binding = 1, std430) writeonly buffer To { uint to[]; };
        void main() { to[gl_LocalInvocationIndex] = from[gl_LocalInvocationIndex]; }",
    ),
    (
        "show.comp",
        "layout(local_size_x = 64) in;
        layout(set = 0, binding = 0, std430) readonly buffer Words { uint words[]; };
        layout(set = 0, binding = 1, rgba8) uniform writeonly image2D Image;
        void main() { imageStore(Image, ivec2(gl_LocalInvocationIndex % 8, gl_LocalInvocationIndex / 8), vec4(words[0])); }",
    ),
    (
        "half.vert",
        "layout(set = 0, binding = 0, std430) readonly buffer Words { uint words[]; };
        void main() { gl_Position = vec4(words[gl_VertexIndex]); }",
    ),
    ("flat.vert", "void main() { gl_Position = vec4(gl_VertexIndex); }"),
    (
        "half.frag",
        "layout(set = 0, binding = 0, std430) buffer Words { uint words[]; };
        layout(location = 0) out vec4 color;
        void main() { color = vec4(1); words[0] = 1; }",
    ),
];

/// Checks a graph of these passes, over the buffers `words` and `past`, the ping-pong buffer `keys` and the image `image`.
fn checked(passes: &str, output: &str) -> (tempfile::TempDir, Output) {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: String| std::fs::write(folder.path().join(name), text).expect("writable");
    for (name, text) in SHADERS {
        write(name, format!("#version 460\n{text}\n"));
    }
    write(
        "graph.ron",
        format!(
            r#"Graph(version: 1, summary: "a mistake", output: "{output}",
    resources: {{
        "words": Buffer(stride: 4, count: 64),
        "past": Buffer(stride: 4, count: 64, history: true),
        "keys": Buffer(stride: 4, count: 64, ping_pong: true),
        "image": Image(format: "rgba8", size: (8, 8), history: true),
    }},
    passes: [{passes}],
)"#
        ),
    );
    write(
        "copies.ron",
        r#"Graph(version: 1, summary: "copies", ports: { "data": Buffer(stride: 4, ping_pong: true) }, passes: [
    Dispatch(name: "copy", shader: "copy.comp", size: Threads(64), bind: { "From": "front(data)", "To": "back(data)" }),
])"#
        .to_string(),
    );
    let output = splatgraph(folder.path(), &["check", "graph.ron"]);
    (folder, output)
}

const CLEAR: &str = r#"Fill(name: "clear", buffer: "words", value: 1),"#;
const SHOW: &str = r#"Dispatch(name: "show", shader: "show.comp", size: Threads(64), bind: { "Words": "words", "Image": "image" }),"#;

#[test]
fn check_refuses_what_no_barrier_can_mend_and_results_of_another_frame() {
    let draw = |vertex: &str, call: &str| {
        format!(
            r#"{CLEAR} Draw(name: "draw", vertex: "{vertex}.vert", fragment: "half.frag", topology: TriangleList, call: {call},
                bind: {{ "Words": "words" }}, targets: [Target(image: "image", load: Clear(0, 0, 0, 0), blend: Replace)]),"#
        )
    };
    let next = r#"Dispatch(name: "next", shader: "next.comp", size: Indirect("words", 0), bind: { "Words": "words" }),"#;
    let last = SHOW.replace("\"Words\": \"words\"", "\"Words\": \"last(past)\"");
    let cases = [
        (format!("{CLEAR} {next} {SHOW}"), "image", "which its own arguments are in"),
        (draw("flat", r#"Indirect("words", 16)"#), "image", "which its own arguments are in"),
        (
            draw("half", "Direct(vertices: 3, instances: 1)"),
            "image",
            "`half.vert` reads `Words` while `half.frag`",
        ),
        (format!("{CLEAR} {SHOW}"), "last(image)", "a frame's results are what it leaves itself"),
        (last, "image", "`show` reads `past`, which no pass writes"),
    ];
    for (passes, output, expected) in cases {
        let (folder, found) = checked(&passes, output);
        let text = String::from_utf8_lossy(&found.stderr).into_owned();
        assert_eq!(found.status.code(), Some(1), "{passes}: {text}");
        assert!(text.contains(expected), "{passes}: {text}");
        // A dump shows the warning as well, once.
        let dump = splatgraph(folder.path(), &["dump", "graph.ron"]);
        let text = String::from_utf8_lossy(&dump.stderr).into_owned();
        assert_eq!((dump.status.code(), text.contains(expected)), (Some(1), true), "{passes}: {text}");
    }
}

#[test]
fn check_and_dump_count_what_is_left_out_and_warn_where_a_result_was_asked_for() {
    let fill = r#"Fill(name: "clear", buffer: "keys", value: 1), Include(graph: "copies.ron", name: "sort", with: { "data": "keys" }),"#;
    let passes = format!("{fill} {}", SHOW.replace("\"words\"", "\"keys\""));
    let (folder, found) = checked(&passes, "image");
    let [out, err] = [&found.stdout, &found.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(found.status.success(), "{err}");
    assert_eq!(err.matches("warning: a pass is left out of the include `sort`").count(), 1, "{err}");
    assert!(err.contains("is a `Swap` missing?"), "{err}");
    assert!(out.contains("; 1 pass left out: nothing reads what it writes"), "{out}");
    let text = done(folder.path(), &["dump", "graph.ron"]);
    assert!(text.contains("\n1 pass left out: nothing reads what it writes\nwarning: a pass"), "{text}");
    let json: Value =
        serde_json::from_str(&done(folder.path(), &["dump", "graph.ron", "--format", "json"])).expect("JSON");
    assert_eq!(json["left_out"].as_array().map(Vec::len), Some(1));
    assert!(json["warnings"][0]["help"][0].as_str().is_some_and(|help| help.contains("Swap")), "{json}");

    let next =
        r#"Dispatch(name: "next", shader: "next.comp", size: Threads(64), bind: { "Words": "words" }),"#;
    for (clear, warnings) in [("", 1), (CLEAR, 0)] {
        let (_, found) = checked(&format!("{clear} {next} {SHOW}"), "image");
        let text = String::from_utf8_lossy(&found.stderr).into_owned();
        assert!(found.status.success(), "{text}");
        assert_eq!(text.matches("`next` reads and writes `words`").count(), warnings, "{text}");
    }
}

#[test]
fn what_is_drawn_in_place_of_a_graph_and_what_facts_chose_is_said_with_the_reasons() {
    let folder = scene();
    let needs = r#"require: [("device.max_groups_x < 1", "a device without workgroups")]"#;
    let odd = format!(r#"Preset(graph: "tiled", summary: "an odd one", set: {{}}, {needs})"#);
    let choice = r#"Choice(summary: "an odd one or quads", of: [(graph: "odd"), (graph: "splat")])"#;
    std::fs::write(folder.path().join("odd.ron"), odd).expect("writable");
    std::fs::write(folder.path().join("either.ron"), choice).expect("writable");
    let draw = |pipeline: &str| {
        let args = ["render", "scene.ply", "-p", pipeline, "-c", "cameras.json#0", "--size", "64x36"];
        let device = common::device_option();
        let args = [&args[..], &["--json", "stats.json"]].concat();
        let args: Vec<&str> = args.into_iter().chain(device.as_deref()).collect();
        let output = splatgraph(folder.path(), &args);
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{errors}");
        let text = std::fs::read_to_string(folder.path().join("stats.json")).expect("statistics");
        let stats: Value = serde_json::from_str(&text).expect("JSON");
        (errors, stats[0].clone())
    };
    let (errors, stats) = draw("either.ron");
    assert_eq!(
        errors
            .matches(
                "`splat` stands in for `odd`, which needs a device without workgroups (device.max_groups_x = "
            )
            .count(),
        1,
        "{errors}"
    );
    assert_eq!(
        (&stats["pipeline"], &stats["fallbacks"][0]["taken"]),
        (&"either.ron".into(), &"splat".into())
    );
    assert!(stats["phases"]["draw"].is_number(), "quads are drawn: {stats}");
    let text = done(folder.path(), &["dump", "either.ron"]);
    assert!(text.contains("\n`splat` stands in for `odd`, which needs"), "{text}");
    let text = done(folder.path(), &["check", "odd.ron"]);
    assert!(text.starts_with("odd.ron: not for the smallest supported device\n"), "{text}");

    let (errors, stats) = draw("auto");
    assert!(!errors.contains("stands in"), "{errors}");
    let fallback = &stats["fallbacks"][0];
    let reason = match stats["based_on"][0].as_str() {
        Some("tiled_cpu") => &fallback["unmet"][0]["reason"],
        other => panic!("expected the tiles of CPUs, found {other:?}"),
    };
    assert_eq!((&fallback["wanted"], &fallback["preference"]), (&"tiled".into(), &true.into()));
    assert!(
        reason["expression"].as_str().is_some_and(|text| text.contains("device.subgroup_size >= 16")),
        "{stats}"
    );
    assert!(reason["values"]["device.subgroup_size"].is_number(), "{stats}");
    let text = done(folder.path(), &["dump", "auto"]);
    assert!(text.contains("\nbased on tiled\n"), "{text}");
    assert!(
        text.contains(
            "\nparameter sorter=subgroup, because device.shared_bytes = 16384, device.subgroup_size = 32 ("
        ),
        "{text}"
    );
}

#[test]
fn without_a_display_there_is_no_window_and_the_program_says_what_to_do() {
    let folder = scene();
    for display in [None, Some(":4321")] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_splatgraph"));
        for name in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
            command.env_remove(name);
        }
        command.envs(display.map(|display| ("DISPLAY", display)));
        let output = command.args(["view", "scene.ply"]).current_dir(folder.path()).output();
        let output = output.expect("the program runs");
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.starts_with("error: there is no display to open a window on ("), "{text}");
        assert!(text.contains("`splatgraph render` draws without one"), "{text}");
    }
}

#[test]
fn the_backend_that_executes_nothing_draws_black_pictures_is_measured_and_compares_none() {
    let folder = scene();
    let null = ["--backend", "null"];
    let render = ["render", "scene.ply", "--cameras", "cameras.json#0", "--size", "96x54", "-o", "a.npy"];
    done(folder.path(), &[&render[..], &null].concat());
    let image = splatgraph::io::image::Image::load(&folder.path().join("a.npy")).expect("a picture");
    assert_eq!((image.width, image.height), (96, 54));
    assert!(image.rgb.iter().all(|pixel| *pixel == [0.0; 3]), "it is black");

    let bench = ["bench", "scene.ply", "--sizes", "96x54", "--rounds", "1", "--frames", "1", "--json", "-"];
    let measured = done(folder.path(), &[&bench[..], &null].concat());
    let measured: Value = serde_json::from_str(&measured).expect("JSON");
    assert!(measured.to_string().contains("\"null"), "the device is named: {measured}");

    let refused = |args: &[&str]| {
        let output = splatgraph(folder.path(), args);
        assert!(!output.status.success(), "{args:?} is refused");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    for command in [&["trade"][..], &["sweep"], &["advise"], &["popping"], &["experiment", "order"]] {
        let text = refused(&[command, &null].concat());
        assert!(text.contains("found null: pictures are compared"), "{command:?}: {text}");
    }
    let text = refused(&[&render[..], &null, &["--validate"]].concat());
    assert!(text.contains("expected a backend with validation, found null"), "{text}");
    if cfg!(not(target_vendor = "apple")) {
        for (command, expected) in [(&bench[..], "vulkan or null"), (&render, "vulkan, null or reference")] {
            let text = refused(&[command, &["--backend", "metal"]].concat());
            assert!(text.contains(&format!("expected {expected}, found metal")), "{text}");
        }
    }
}

/// Hides Vulkan's drivers, so that its devices cannot be listed.
#[cfg(target_os = "linux")]
#[test]
fn without_a_vulkan_driver_the_other_devices_are_listed_and_the_exit_code_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut command = Command::new(env!("CARGO_BIN_EXE_splatgraph"));
    for name in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        command.env(name, folder.path().join("none.json"));
    }
    let output = command.arg("devices").output().expect("the program runs");
    let (text, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{text}{errors}");
    assert!(text.starts_with("null 0: null"), "{text}");
    assert!(errors.starts_with("error: "), "{errors}");
}
