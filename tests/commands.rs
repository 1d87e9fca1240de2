//! The program as a user runs it: a scene is generated, inspected, drawn and compared, each by its command.

use crate::place::Place;
use splatgraph::io::image::Image;
use splatgraph_assets::Camera;
use std::process::Output;

#[test]
fn the_sorted_keys_of_tiles_are_judged_under_the_same_short_name() {
    let place = Place::demo(5000);
    let text = place.done("render scene.ply --pipeline tiled --size 160x90 -o a.png --inspect keys@scatter");
    let verdict = text.split("monotonic: the first ").nth(1).unwrap_or_else(|| panic!("{text}"));
    let keys = verdict.split(' ').next().and_then(|n| n.parse::<u64>().ok());
    assert!(keys.is_some_and(|keys| keys > 1000), "{text}");
    assert!(!text.contains("not monotonic"), "{text}");
    assert!(place.at("a.png").is_file());
}

#[test]
fn a_scene_is_drawn_from_every_camera_with_statistics_and_sorted_keys() {
    let place = Place::demo(5000);
    let text = place.done(
        "render scene.ply --pipeline splat --cameras cameras.json --size 160x90 --format npy -o out --json=stats.json \
         --inspect keys@scatter --inspect order@scatter=order.npy --validate",
    );
    assert!(!text.contains("not monotonic"), "the keys are not sorted:\n{text}");
    let stats = place.json("stats.json");
    let cameras = stats.as_array().expect("one entry per camera");
    assert_eq!(cameras.len(), 4);
    assert_eq!(text.matches("\n  monotonic: ").count(), 4, "{text}");
    for camera in cameras {
        for key in ["device", "parameters", "counts", "passes", "phases", "once", "buffers"] {
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
        let image = place.image(&format!("out/{name}.npy"));
        assert_eq!((image.width, image.height), (160, 90));
    }
}

#[test]
fn pixels_that_a_file_cannot_hold_are_counted() {
    let place = Place::demo(50);
    place.write(
        "nan.comp",
        "#version 460\nlayout(local_size_x = 64) in;\n\
         layout(set = 0, binding = 0, rgba32f) writeonly uniform image2D image;\n\
         void main() {\n\
             int x = int(gl_GlobalInvocationID.x);\n\
             imageStore(image, ivec2(x, 0), vec4(uintBitsToFloat(x == 5 ? 0x7fc00000u : 0u), 0.5, 0.5, 1.0));\n\
             imageStore(image, ivec2(x, 1), vec4(0.5, 0.5, uintBitsToFloat(x == 9 ? 0x7f800000u : 0u), 1.0));\n\
         }",
    );
    place.write(
        "nan.ron",
        r#"Graph(
          version: 1, summary: "NaN and infinity",
          resources: { "image": Image(format: "rgba32f", size: (64, 2)) },
          passes: [Dispatch(name: "fill", shader: "nan.comp", size: Threads(64), bind: { "image": "image" })],
          output: "image",
        )"#,
    );
    let line = "scene.ply -p nan.ron --size 64x2 -o";
    let counted = "2 of 128 pixels are NaN or infinite";
    let (_, errors) = place.said(&format!("render {line} a.png --json=a.json"));
    assert!(errors.contains(&format!("a.png: {counted}")), "{errors}");
    assert_eq!(place.json("a.json")[0]["not_finite"], 2);
    let (_, errors) = place.said(&format!("render {line} a.npy --json=a.json"));
    assert!(!errors.contains("NaN") && place.json("a.json")[0].get("not_finite").is_none(), "{errors}");
    for (output, name) in [("a.apng", "frame 0"), ("frames", "00000.png")] {
        let (_, errors) = place.said(&format!("video {line} {output} --orbit=1 --fps=1"));
        assert!(errors.contains(&format!("{name}: {counted}")), "{errors}");
    }
}

#[test]
fn outputs_of_a_users_graph_keep_their_channels_and_integers_need_a_format_for_them() {
    let place = Place::demo(50);
    place.write(
        "own.comp",
        "#version 460\nlayout(local_size_x = 64) in;\n\
         layout(set = 0, binding = 0, rgba32f) writeonly uniform image2D image;\n\
         layout(set = 0, binding = 1, r32ui) writeonly uniform uimage2D hits;\n\
         void main() {\n\
             imageStore(image, ivec2(gl_GlobalInvocationID.x, 0), vec4(0.2, 0.4, 0.6, 0.0));\n\
             imageStore(hits, ivec2(gl_GlobalInvocationID.x, 0), uvec4(7));\n\
         }",
    );
    place.write(
        "own.ron",
        r#"Graph(
          version: 1, summary: "Outputs",
          resources: { "image": Image(format: "rgba32f", size: (64, 1)), "hits": Image(format: "r32ui", size: (64, 1)) },
          passes: [
            Dispatch(name: "own", shader: "own.comp", size: Threads(64), bind: { "image": "image", "hits": "hits" }),
          ],
          output: "image", outputs: { "motion": "image", "hits": "hits" },
        )"#,
    );
    let line = "render scene.ply -p own.ron --size 64x1 --output";
    let integers = "expected the extension .npy or .exr: PNG cannot store 32-bit integers (output `hits`)";
    place.refuses(&format!("{line} a.png --output"), &[("hits=h.png", 2, integers)]);
    place.refuses(&format!("{line} a.png --format png --output"), &[("hits=h/", 2, integers)]);
    assert!(!place.at("a.png").exists(), "it is refused before a frame is drawn");
    place.done(&format!(
        "{line} motion=m.npy --output motion=m.exr --output motion=m.png --output hits=h.exr"
    ));
    let header = String::from_utf8_lossy(&place.bytes("m.npy")[..100]).into_owned();
    assert!(header.contains("(1, 64, 4,"), "{header}");
    assert!(Image::header(&place.at("m.exr")).expect("a picture").has_alpha);
    assert!(place.image("m.png").at(0, 0).iter().zip([0.2, 0.4, 0.6]).all(|(a, b)| (a - b).abs() < 1e-6));
}

#[test]
fn a_picture_is_the_same_in_every_format_and_compares_as_such() {
    let place = Place::demo(5000);
    for picture in ["a.npy", "b.exr", "c.png"] {
        place.done(&format!("render scene.ply --cameras cameras.json#0 --size 96x54 -o {picture}"));
    }
    assert!(place.done("compare a.npy b.exr").contains("inf"), "the floats are the same");
    place.done("compare a.npy c.png --min-psnr 50");
    place.done("render scene.ply --cameras cameras.json#1 --size 96x54 -o d.npy");
    place.fails("compare a.npy d.npy --min-psnr 50", 1);
}

#[test]
fn info_shows_the_bytes_of_a_file_and_the_buffers_of_a_plan() {
    let place = Place::demo(5000);
    let bytes = std::fs::metadata(place.at("scene.ply")).expect("there").len();
    let text = place.done("info scene.ply --pipeline splat");
    assert!(text.contains(&format!("{} bytes", splatgraph_assets::grouped(bytes))), "{text}");
    for name in ["scene.covariances", "order.keys#1", "order.sort.table"] {
        assert!(text.contains(name), "no {name} in\n{text}");
    }
    let needed = place.told("info scene.ply --pipeline splat --json")["fits"][0]["needed_bytes"].as_u64();
    let needed = splatgraph_assets::grouped(needed.expect("a number"));
    assert!(text.contains(&format!(" bytes; with shared memory, {needed}, and ")), "{needed} in {text}");
}

#[test]
fn the_default_key_width_of_a_scene_sorted_by_distance_promises_no_exact_order() {
    let place = Place::demo(300);
    place.done("convert scene.ply by.glb");
    for (name, promised) in [("scene.ply", true), ("by.glb", false)] {
        let text = place.done(&format!("info {name}"));
        let line = text.lines().find(|line| line.contains("default key width")).expect("a line");
        let bits = place.told(&format!("info {name} --json"))["key_bits"].as_u64().expect("a number");
        assert!(
            line.contains(&format!(" {bits} bits")) && line.contains("exact order") == promised,
            "{line}"
        );
        assert!(promised || bits == 32, "{bits}");
    }
}

#[test]
fn every_preset_passes_its_check() {
    let place = Place::empty();
    let text = place.done("check");
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
        // A graph that is not drawn is named: "`splat`: ...". Graphs with outputs have one more line.
        let has = |line: &&str| {
            line.split_once(" lanes: ").is_some_and(|(all, rest)| {
                let is_other = rest.starts_with('`') || rest.starts_with("with every output: ");
                all.trim().split(", ").any(|l| l == lanes) && !is_other
            })
        };
        assert_eq!(text.lines().filter(has).count(), verdicts.len(), "{lanes} lanes in\n{text}");
    }
    assert!(text.contains("view/window: OK"), "{text}");
}

fn listed_commands(help: &str) -> Vec<&str> {
    let (_, list) = help.split_once("\nCommands:\n").expect("a list of commands");
    // Longer descriptions continue on further lines, indented more deeply.
    let names = list.lines().take_while(|line| !line.is_empty()).filter_map(|line| line.strip_prefix("  "));
    names.filter(|line| !line.starts_with(' ')).filter_map(|line| line.split(' ').next()).collect()
}

#[test]
fn every_command_has_completions_and_a_manual_page() {
    let place = Place::empty();
    let help = place.done("--help");
    let commands: Vec<&str> = listed_commands(&help).into_iter().filter(|name| *name != "help").collect();
    assert!(
        ["view", "render", "bench", "sweep", "advise"].iter().all(|name| commands.contains(name)),
        "{help}"
    );
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = place.done(&["completions", shell]);
        for word in commands.iter().chain(&["pipeline", "fish"]) {
            assert!(script.contains(word), "{shell}: no {word}");
        }
    }
    let script = place.done("completions bash");
    for values in [r#"-W "png exr npy""#, "null reference", " askew "] {
        assert!(script.contains(values), "no {values}");
    }
    // The second run replaces the pages.
    for _ in 0..2 {
        place.done("man pages");
        for command in &commands {
            let page = place.text(&format!("pages/splatgraph-{command}.1"));
            // Examples are not filled, so a command stays on its line.
            for part in [&*format!("\n\\fBsplatgraph {command}\\fR "), "\n.SH EXAMPLES\n.EX\n  splatgraph "] {
                assert!(page.contains(part), "{command}: no {part:?}: {page}");
            }
            assert!(!page.contains("EXTRA"), "{page}");
        }
        let page = place.text("pages/splatgraph.1");
        for heading in ["\"EXIT STATUS\"", "ENVIRONMENT"] {
            assert!(page.contains(&format!("\n.SH {heading}\n.EX\n  ")), "no {heading}: {page}");
        }
        assert!(page.contains("splatgraph\\-render(1)"), "{page}");
        let rows = include_str!("../README.md").split_once("| environment variable | effect |\n|---|---|\n");
        let rows = rows.expect("a table").1.lines().map_while(|line| line.strip_prefix("| `"));
        let variables: Vec<&str> = rows.filter_map(|row| row.split(['=', '`']).next()).collect();
        assert!(
            variables.len() > 5 && variables.iter().all(|name| page.contains(name)),
            "{variables:?}: {page}"
        );
    }
    place.fails("man pages/splatgraph.1", 2);
    let errors = place.fails("man -", 2);
    assert!(errors.contains("expected a folder for the pages, found `-`"), "{errors}");
    assert!(!place.at("-").exists());
}

#[test]
fn the_version_names_the_commit_the_features_and_the_program() {
    let place = Place::empty();
    let short = place.done("-V");
    let number = concat!("splatgraph ", env!("CARGO_PKG_VERSION"));
    let commit = short.trim_end().strip_prefix(number).unwrap_or_else(|| panic!("{short}"));
    assert!(commit.is_empty() || commit.starts_with(" (") && commit.ends_with(')'), "{short}");
    let long = place.done("--version");
    let lines: Vec<&str> = long.lines().collect();
    assert_eq!(lines[0], short.trim_end());
    assert!(lines[1].starts_with("features: ") && lines[1].contains("window"), "{long}");
    let hash = lines[2].strip_prefix("program: ").unwrap_or_else(|| panic!("{long}"));
    assert!(hash.len() == 16 && hash.chars().all(|c| c.is_ascii_hexdigit()), "{long}");
}

/// Shaders for graphs with mistakes. Among them, `next.comp` counts in place, and `half.vert` reads what `half.frag`
/// writes.
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

/// Runs `check` on a graph of these passes. It has the buffers `words` and `past`, the ping-pong buffer `keys` and the
/// image `image`; `past` and `image` are histories. Returns the folder and what the program printed.
fn checked(passes: &str, output: &str) -> (Place, Output) {
    let place = Place::empty();
    for (name, text) in SHADERS {
        place.write(name, format!("#version 460\n{text}\n"));
    }
    place.write(
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
    place.write(
        "copies.ron",
        r#"Graph(version: 1, summary: "copies", ports: { "data": Buffer(stride: 4, ping_pong: true) }, passes: [
    Dispatch(name: "copy", shader: "copy.comp", size: Threads(64), bind: { "From": "front(data)", "To": "back(data)" }),
])"#,
    );
    let output = place.run("check graph.ron");
    (place, output)
}

#[test]
fn a_graph_with_a_history_draws_no_frames_before_the_repeated_ones() {
    let place = Place::demo(500);
    place.write(
        "graph.ron",
        r#"Graph(version: 1, summary: "counts its frames", output: "image", stats: { "drawn": ("count", 0) },
    resources: {
        "count": Buffer(stride: 4, count: 1, history: true),
        "image": Image(format: "rgba8", size: ("viewport.width", "viewport.height")),
    },
    passes: [
        Dispatch(name: "add", shader: "add.comp", size: Groups(1), bind: { "Count": "count" }),
        Dispatch(name: "show", shader: "show.comp", size: Groups("viewport.width", "viewport.height"),
            bind: { "Count": "count", "image": "image" }),
    ],
)"#,
    );
    let head = "#version 460\nlayout(local_size_x = 1) in;\nlayout(set = 0, binding = 0, std430)";
    place.write(
        "add.comp",
        format!("{head} buffer Count {{ uint count; }};\nvoid main() {{ count += 1; }}\n"),
    );
    place.write(
        "show.comp",
        format!(
            "{head} readonly buffer Count {{ uint count; }};\n\
             layout(set = 0, binding = 1, rgba8) writeonly uniform image2D image;\n\
             void main() {{ imageStore(image, ivec2(gl_WorkGroupID.xy), vec4(float(count) / 255.0)); }}\n"
        ),
    );
    for frames in [1, 3] {
        let render = format!("render scene.ply -p graph.ron --size 8x8 --repeat {frames}");
        place.done(&format!("{render} --json=out.json"));
        let stats = place.json("out.json");
        assert_eq!((&stats[0]["counts"]["drawn"], &stats[0]["frames"]), (&frames.into(), &frames.into()));
    }
    // Measured pictures do not contain the frames before them, which other settings and the timing have drawn.
    place.edit(
        "graph.ron",
        "    resources",
        r#"    params: { "step": Const(Int(default: 1, range: (1, 5), exact: 1, label: "step")) },
    resources"#,
    );
    place.edit("graph.ron", r#"size: Groups(1)"#, r#"size: Groups("step")"#);
    place.edit("add.comp", "count += 1", "atomicAdd(count, 1u)");
    let found = [1, 3].map(|rounds| {
        let folder = format!("ledger-{rounds}");
        place.done(&format!(
            "trade scene.ply -p graph.ron --size 8x8 --only step --frames 1 --rounds {rounds} -o {folder}"
        ));
        place.files(&format!("{folder}/pictures")).into_values().collect::<Vec<_>>()
    });
    assert!(found[0] == found[1] && found[0].len() > 2);
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
        (format!("{CLEAR} {next} {SHOW}"), "image", "which holds its own arguments"),
        (draw("flat", r#"Indirect("words", 16)"#), "image", "which holds its own arguments"),
        (
            draw("half", "Direct(vertices: 3, instances: 1)"),
            "image",
            "`half.vert` reads `Words` while `half.frag`",
        ),
        (format!("{CLEAR} {SHOW}"), "last(image)", "a frame's results must come from the frame itself"),
        (last, "image", "`show` reads `past`, which no pass writes"),
    ];
    for (passes, output, expected) in cases {
        let (place, found) = checked(&passes, output);
        let text = String::from_utf8_lossy(&found.stderr).into_owned();
        assert_eq!(found.status.code(), Some(1), "{passes}: {text}");
        assert!(text.contains(expected), "{passes}: {text}");
        place.refuses("", &[("dump graph.ron", 1, expected)]);
    }
}

#[test]
fn check_and_dump_count_what_is_left_out_and_warn_where_a_result_was_asked_for() {
    let fill = r#"Fill(name: "clear", buffer: "keys", value: 1), Include(graph: "copies.ron", name: "sort", with: { "data": "keys" }),"#;
    let passes = format!("{fill} {}", SHOW.replace("\"words\"", "\"keys\""));
    let (place, found) = checked(&passes, "image");
    let [out, err] = [&found.stdout, &found.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(found.status.success(), "{err}");
    assert_eq!(err.matches("warning: a pass is left out of the include `sort`").count(), 1, "{err}");
    assert!(err.contains("is a `Swap` missing?"), "{err}");
    assert!(out.contains("; 1 pass left out: nothing reads what it writes; unread: sort.copy\n"), "{out}");
    let text = place.done("dump graph.ron");
    assert!(text.contains("\n1 pass left out: nothing reads what it writes\nwarning: a pass"), "{text}");
    let json = place.told("dump graph.ron --format json");
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

    // Larger pictures have two warnings, one of which was printed for the smaller ones.
    let more = [r#"name: "next""#, r#"name: "more", when: "viewport.width > 16""#];
    let more = next.replace(more[0], more[1]).replace("\"words\" }", "\"keys\" }");
    let copy = r#"Dispatch(name: "copy", when: "viewport.width > 16", shader: "copy.comp", size: Threads(64), bind: { "From": "keys", "To": "words" }),"#;
    let (place, _) = checked(&format!("{next} {more} {copy} {SHOW}"), "image");
    place.edit("graph.ron", "(8, 8)", r#"("viewport.width", "viewport.height")"#);
    place.scene("scene.ply", "demo", 20, 0);
    let first = &splatgraph_assets::synth::demo_cameras()[0];
    let camera = |side| Camera { img_name: format!("{side}"), ..first.resized(side, side) };
    Camera::save(&[16, 32].map(camera), place.at("cameras.json")).expect("cameras are written");
    let text = place.said("render scene.ply -p graph.ron -c cameras.json -o out").1;
    let counts = ["`next` reads and writes `words`", "`more` reads and writes `keys"];
    assert_eq!(counts.map(|warning| text.matches(warning).count()), [1, 1], "{text}");
}

#[test]
fn a_built_in_graph_that_is_drawn_instead_of_a_file_is_told() {
    let place = Place::demo(100);
    let told = "warning: there is no file pipelines/splat.ron: the built-in graph of this name is drawn\n";
    let count = |graph: &str| {
        let line = format!("render scene.ply -p {graph} -c cameras.json#0 --size 64x36 -o a.png");
        place.said(&line).1.matches(told).count()
    };
    assert_eq!(count("pipelines/splat.ron"), 1);
    assert_eq!(count("splat"), 0);
    place.write("pipelines/splat.ron", crate::place::shipped("pipelines/splat.ron"));
    assert_eq!(count("pipelines/splat.ron"), 0);
}

#[test]
fn what_is_drawn_in_place_of_a_graph_and_what_facts_chose_is_said_with_the_reasons() {
    let place = Place::demo(5000);
    let needs = r#"require: [("device.max_groups_x < 1", "a device without workgroups")]"#;
    let odd = format!(r#"Preset(graph: "tiled", summary: "an odd one", set: {{}}, {needs})"#);
    let choice = r#"Choice(summary: "an odd one or quads", of: [(graph: "odd"), (graph: "splat")])"#;
    place.write("odd.ron", odd);
    place.write("either.ron", choice);
    let draw = |pipeline: &str| {
        let line = format!("render scene.ply -p {pipeline} -c cameras.json#0 --size 64x36 --json=stats.json");
        let (_, errors) = place.said(&line);
        (errors, place.json("stats.json")[0].clone())
    };
    let (errors, stats) = draw("either.ron");
    let told =
        "`splat` is used instead of `odd`, which needs a device without workgroups (device.max_groups_x = ";
    assert_eq!(errors.matches(told).count(), 1, "{errors}");
    assert_eq!(
        (&stats["pipeline"], &stats["fallbacks"][0]["taken"]),
        (&"either.ron".into(), &"splat".into())
    );
    assert!(stats["phases"]["draw"].is_number(), "quads are drawn: {stats}");
    let text = place.done("dump either.ron");
    assert!(text.contains("\n`splat` is used instead of `odd`, which needs"), "{text}");
    let text = place.done("check odd.ron");
    assert!(text.starts_with("odd.ron: not for the least capable supported device\n"), "{text}");

    let (errors, stats) = draw("auto");
    assert!(!errors.contains("is used instead of"), "{errors}");
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
    let (_, errors) = place.said("dump auto --device webgpu-subgroups");
    let warning = "warning: auto does not run on webgpu-subgroups: expected at most 8 storage buffers in a shader, found: ";
    assert_eq!(errors.matches(warning).count(), 1, "{errors}");
    let text = place.done("dump auto");
    assert!(text.contains("\nbased on tiled\n"), "{text}");
    assert!(
        text.contains(
            "\nparameter sorter=subgroup, because device.shared_bytes = 16384, device.subgroup_size = 32 ("
        ),
        "{text}"
    );
}

#[test]
fn the_backend_that_executes_nothing_draws_black_pictures_is_measured_and_compares_none() {
    let place = Place::demo(5000);
    let null = "--backend null";
    let render = "render scene.ply --cameras cameras.json#0 --size 96x54 -o a.npy";
    place.done(&format!("{render} {null}"));
    let image = place.image("a.npy");
    assert_eq!((image.width, image.height), (96, 54));
    assert!(image.rgb.iter().all(|pixel| *pixel == [0.0; 3]), "it is black");

    let bench = "bench scene.ply --sizes 96x54 --rounds 1 --frames 1 --json";
    let measured = place.told(&format!("{bench} {null}"));
    assert!(measured.to_string().contains("\"null"), "the device is named: {measured}");

    for command in ["trade", "sweep", "advise", "popping", "experiment order"] {
        place.refuses(command, &[(null, 2, "found null: it draws no pictures to compare")]);
    }
    place.refuses(
        render,
        &[("--backend null --validate", 1, "expected a backend with validation, found null")],
    );
    if cfg!(not(target_vendor = "apple")) {
        for (command, expected) in [(bench, "vulkan or null"), (render, "vulkan, null or reference")] {
            place.refuses(command, &[("--backend metal", 2, &format!("expected {expected}, found metal"))]);
        }
    }
}

#[cfg(target_os = "linux")]
#[test]
fn without_a_vulkan_driver_the_other_devices_are_listed_and_the_exit_code_says_so() {
    let place = Place::empty();
    let mut command = place.program("devices");
    let none = place.at("none.json");
    let output =
        command.env("VK_DRIVER_FILES", &none).env("VK_ICD_FILENAMES", &none).output().expect("it runs");
    let (text, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{text}{errors}");
    assert!(text.starts_with("null 0: null"), "{text}");
    assert!(errors.starts_with("error: "), "{errors}");
}

#[test]
fn the_camera_beside_the_scene_is_named_once_and_only_where_it_is_used() {
    let place = Place::demo(300);
    let draw = "render scene.ply -p unsorted --size 32x18 -o a.png";
    let told = |line: &str| place.said(line).1.matches("the camera is the first of").count();
    assert_eq!(told(draw), 1);
    for look in ["--eye 0,0,-3", "--orbit 1", "--fov 40", "--target 0,0,0"] {
        assert_eq!(told(&format!("{draw} {look}")), 0, "{look}");
    }
    let sweep = "sweep scene.ply -p unsorted --steps 2 --rounds 1 --frames 1 --size 32x18 -o swept";
    assert_eq!(told(sweep), 1);
}
