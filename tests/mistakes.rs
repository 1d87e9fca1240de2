//! Mistakes that users make, and what the program then says.
//!
//! Some tests copy the small graph of `tests/graphs/two_steps`, break it, run the program on it and compare the whole
//! standard error. The golden files of the framework have the other mistakes in graphs.

use crate::place::Place;
use std::fs;

const GRAPH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/graphs/two_steps");

/// Copies the graph's folder and applies `changes`: a file, a text in it, and the replacement.
fn changed(changes: &[(&str, &str, &str)]) -> Place {
    let place = Place::empty();
    for entry in fs::read_dir(GRAPH).expect("the graph's folder") {
        let entry = entry.expect("a file");
        fs::copy(entry.path(), place.at(entry.file_name())).expect("copied");
    }
    for (file, from, to) in changes {
        place.edit(file, from, to);
    }
    place
}

fn assert_shown(changes: &[(&str, &str, &str)], line: &str, expected: &str) {
    let errors = changed(changes).fails(line, 1);
    // In the source, each expected text begins on a new line.
    assert_eq!(
        errors.trim_end(),
        expected.trim_start_matches('\n').trim_end(),
        "what was printed:\n{errors}"
    );
}

#[test]
fn a_graph_without_mistakes_is_said_to_be_right() {
    assert_eq!(changed(&[]).said("check graph.ron").1, "");
}

#[test]
fn a_misspelt_resource() {
    assert_shown(
        &[("graph.ron", r#""Keys": "keys", "image""#, r#""Keys": "kesy", "image""#)],
        "check graph.ron",
        r#"
error: there is no resource `kesy`
  --> graph.ron:11:85
   |
11 |     Dispatch(name: "show", shader: "show.comp", size: Threads(64), bind: { "Keys": "kesy", "image": "image" }),
   |                                                                                     ^^^^ not declared
   |
   = help: did you mean `keys`?
"#,
    );
}

#[test]
fn a_parameter_that_the_graph_does_not_have() {
    assert_shown(
        &[],
        "dump graph.ron --set widht=4",
        r#"
error: the graph has no parameter `widht`
 --> --set:1:1
  |
1 | widht=4
  | ^^^^^ set here
  |
  = help: did you mean `width`?
"#,
    );
}

#[test]
fn mistakes_of_a_beginner_are_answered_with_the_way_to_go() {
    let place = Place::demo(500);
    let render = "render scene.ply -o a.png --size 32x18";
    place.refuses(
        "",
        &[
            ("view scene.ply other.ply", 2, "add `--compare-scene other.ply`"),
            ("view scene.ply --compare other.ply", 2, "found the scene other.ply: use --compare-scene"),
            ("render scen.ply -o a.png", 1, "did you mean scene.ply?"),
        ],
    );
    let errors = place.fails(&format!("{render} --flip"), 2);
    assert!(errors.contains("'--flip'") && !errors.contains("as a value"), "{errors}");
    for backend in ["", " --backend reference"] {
        let seen = place.run(&format!("{render} --eye 0,0,-90 --target 0,0,-99{backend}"));
        let errors = String::from_utf8_lossy(&seen.stderr);
        assert!(errors.contains("1 of 1 cameras see no splat: most splats are in the box"), "{errors}");
        // A panorama has no --fov.
        assert!(errors.contains("; `--orbit 1`, without --cameras, --eye and --target, frames"), "{errors}");
        let seen = place.run(&format!("{render} --eye 0,0,-90{backend}"));
        assert!(!String::from_utf8_lossy(&seen.stderr).contains("see no splat"));
    }
    // Splats that the low pass removes are in the view.
    for rule in ["--set low_pass=compensated", "--backend reference --rule low_pass=0.3*compensated"] {
        let seen = place.run(&format!("{render} --eye 0,0,-900000 --target 0,0,0 {rule}"));
        let errors = String::from_utf8_lossy(&seen.stderr);
        assert!(errors.contains("1 of 1 cameras see no splat: the centres of "), "{errors}");
        assert!(errors.contains(" are in the picture, but `low_pass`, unless"), "{errors}");
        assert!(!errors.contains("--orbit") && !errors.contains("alpha_cap"), "{errors}");
    }
    // A scene in metres that is a few centimetres large.
    place.done("convert scene.ply tiny.ply --transform scale:0.003");
    let tiny = |distance: &str| {
        place.said(&format!("render tiny.ply -o a.png --size 32x18 --eye 0,0,-{distance} --target 0,0,0")).1
    };
    let (all, some) = (tiny("0.1"), tiny("0.2"));
    assert!(all.contains(" are in the picture, but nearer than the near plane, 0.2 units; enlarge"), "{all}");
    assert!(some.contains("1 of 1 cameras lose a large part of their picture, up to "), "{some}");
    let framed = |options: &str| place.said(&format!("render tiny.ply -o a.png --size 32x18 {options}")).1;
    let (small, whole) = (framed("--fov 60"), framed("--orbit 1"));
    assert!(
        small.starts_with("with --fov 60, the scene spans ") && !whole.contains("spans"),
        "{small}{whole}"
    );
    let place_cameras = "render tiny.ply --eye 0,0,-0.2 --target 0,0,0 -o a.png --write-cameras near.json";
    place.done(place_cameras);
    let said = place
        .said("convert tiny.ply half.ply --transform scale:0.5 -c near.json --write-cameras half.json")
        .1;
    assert!(said.contains("1 of 1 cameras lose a large part of their picture"), "{said}");
}

#[test]
fn a_graph_that_includes_itself_is_the_error_whatever_asks_for_its_parameters() {
    let place = Place::empty();
    let graph =
        r#"Graph(version: 1, summary: "itself", passes: [Include(graph: "auto", name: "a", expose: All)])"#;
    place.write("auto.ron", graph);
    for line in ["params", "params auto", "render --size 32x18 -o a.png --set grey=1"] {
        let errors = place.fails(line, 1);
        assert!(
            errors.contains("this graph includes itself")
                && errors
                    .contains("auto.ron takes precedence over the built-in `auto`: give it another name"),
            "{line}: {errors}"
        );
    }
}

#[test]
fn cameras_with_equal_names_keep_them_where_they_can_and_a_name_of_several_is_told() {
    let place = Place::demo(300);
    let camera = |name: &str| {
        format!(
            r#"{{"id":0,"img_name":"{name}","width":32,"height":18,"position":[0,0,-9],
            "rotation":[[1,0,0],[0,1,0],[0,0,1]],"fx":24,"fy":24}}"#
        )
    };
    place.write("c.json", format!("[{}]", ["t 0/a", "t 0/b", "t 0/b"].map(camera).join(",")));
    place.done("render scene.ply -c c.json -o o/ --json=s.json");
    let stats = place.json("s.json");
    assert_eq!([0, 1, 2].map(|view| &stats[view]["camera"]), ["t 0/a", "t 0/b", "t 0/b-2"]);
    let said = place.said("render scene.ply -c 'c.json#t 0/b' -o b.png").1;
    assert!(said.contains("2 cameras have the name t 0/b: the first is taken; #2 is the next"), "{said}");
}

#[test]
fn pictures_without_a_splat_are_not_compared() {
    let place = Place::demo(300);
    let camera = |name: &str, forward: i32| {
        format!(
            r#"{{"id":0,"img_name":"{name}","width":32,"height":18,"position":[0,0,-90],
            "rotation":[[{forward},0,0],[0,1,0],[0,0,{forward}]],"fx":24,"fy":24}}"#
        )
    };
    let (ahead, away) = (camera("ahead", 1), camera("away", -1));
    place.write("away.json", format!("[{away}]").as_bytes());
    place.write("both.json", format!("[{ahead},{away}]").as_bytes());
    let blind = "1 of 1 cameras see no splat: most splats are in the box";
    for command in [
        "convert",
        "advise --psnr 40",
        "sweep --steps 2",
        "trade --rounds 1 --frames 1",
        "experiment order -o order",
    ] {
        let price = if command == "convert" { "--price" } else { "" };
        let errors = place.fails(&format!("{command} scene.ply {price} -c away.json"), 1);
        assert!(
            errors.contains(blind) && errors.contains("no picture can be compared"),
            "{command}: {errors}"
        );
    }
    place.write("path.json", format!("[{away},{}]", away.replace("-90", "-91")).as_bytes());
    let errors = place.fails("popping scene.ply -c path.json -o pop", 1);
    assert!(errors.contains("2 of 2 cameras see no splat: most splats are in the box"), "{errors}");
    let errors = place.said("bench scene.ply -c away.json --rounds 1 --frames 1 -p unsorted").1;
    assert!(errors.contains(blind) && !errors.contains("compared"), "{errors}");
    let (prices, errors) = place.said("convert scene.ply --price -c both.json --json");
    assert!(errors.contains("1 of 2 cameras see no splat") && errors.contains("left out"), "{errors}");
    assert!(prices.contains("\"ahead\"") && !prices.contains("\"away\""), "{prices}");
    let film = "video scene.ply --eye 0,0,-90 --target 0,0,-99 --seconds 0.1 --size 32x18 -o away.gif";
    assert!(place.said(film).1.contains(" of 3 cameras see no splat"));
    let errors = place.said("sweep scene.ply --steps 2 -c both.json").1;
    assert!(
        errors.contains("1 of 2 cameras see no splat") && errors.contains("nothing has an error"),
        "{errors}"
    );
    place.done("synth --photograph scene.ply --dataset ds --views 3 --size 32x18");
    place.done("convert scene.ply gone.ply --transform move:0,9000,0");
    assert!(place.said("evaluate gone.ply -c ds --all").1.contains("3 of 3 cameras see no splat"));
}

#[test]
fn a_scene_that_is_none_is_an_error_and_no_panic() {
    let place = Place::empty();
    let short = "ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty float x\nend_header\n";
    for (name, bytes) in
        [("empty.ply", &b""[..]), ("picture.ply", b"\x89PNG\r\n\x1a\n"), ("short.ply", short.as_bytes())]
    {
        place.write(name, bytes);
        let errors = place.fails(&["info", name], 1);
        assert!(errors.starts_with("error: ") && errors.contains(name), "{name}: {errors}");
    }
}

#[test]
fn an_unknown_graph_is_shown_with_the_nearest_name_and_where_it_was_looked_for() {
    let errors = Place::empty().fails("check splt", 1);
    assert!(errors.starts_with("error: there is no graph `splt`\n --> command line:1:1"), "{errors}");
    assert_eq!(errors.matches("did you mean `splat`?").count(), 1, "{errors}");
}

#[test]
fn a_filter_may_give_live_parameters_names_of_built_in_shaders_and_include_a_header_twice() {
    let place = Place::demo(300);
    place.write(
        "filter.ron",
        r#"Graph(
            version: 1, summary: "", output: "to",
            params: {
                "opacity": Live(Float(default: 1.0, range: (0.0, 1.0))),
                "picture": Live(Float(default: 1.0, range: (0.0, 1.0))),
                "turn": Live(Float(default: 1.0, range: (0.0, 1.0))),
            },
            resources: { "to": Image(format: "rgba32f", size: ("viewport.width", "viewport.height")) },
            passes: [
                Include(graph: "auto", name: "scene", expose: All),
                Dispatch(name: "fade", shader: "fade.comp", size: Threads("viewport.width", "viewport.height"),
                    bind: { "from": "scene.picture", "to": "to" }),
            ],
        )"#,
    );
    let headers = ["live", "camera", "groups", "splat", "args"];
    let includes =
        headers.map(|name| format!("#include \"{name}.glsl\"\n#include \"{name}.glsl\"\n")).concat();
    let begin = "#version 460\n#extension GL_GOOGLE_include_directive : require\n";
    let end = "layout(local_size_x = 8, local_size_y = 8) in;
        layout(set = 0, binding = 0, rgba32f) readonly uniform image2D from;
        layout(set = 0, binding = 1, rgba32f) writeonly uniform image2D to;
        void main() {
            ivec2 at = ivec2(gl_GlobalInvocationID.xy);
            imageStore(to, at, imageLoad(from, at) * opacity * picture * turn);
        }";
    place.write("fade.comp", format!("{begin}{includes}{end}"));
    for graph in ["filter.ron", "auto"] {
        place.done(&format!(
            "render scene.ply -c cameras.json#0 --size 64x48 --set stop=0.1 -p {graph} -o {graph}.npy"
        ));
    }
    // The parameters of `auto` are in other places of the block, and its passes read the same values.
    assert!(place.bytes("filter.ron.npy") == place.bytes("auto.npy"));
}

#[test]
fn a_shader_includes_no_file_of_the_system() {
    let place = changed(&[("make.comp", "\"hash.glsl\"", "\"/etc/passwd\"")]);
    let refused = place.fails("check graph.ron", 1);
    assert!(refused.contains("/etc/passwd is outside the graph's folder, "), "{refused}");
    // With the folder allowed, the file is read; it is not GLSL.
    let allowed = place.fails("check graph.ron --include-root /etc", 1);
    assert!(allowed.contains("/etc/passwd:1:") && !allowed.contains("is outside"), "{allowed}");
}

#[cfg(target_os = "linux")]
#[test]
fn the_job_of_another_process_may_use_the_folders_that_its_line_allows() {
    let (place, other) = (changed(&[]), Place::empty());
    place.done("synth demo --count 300 -o scene.ply --cameras cameras.json");
    other.write("hash.glsl", place.bytes("hash.glsl"));
    place.edit("make.comp", "\"hash.glsl\"", &format!("\"{}\"", other.named("hash.glsl")));
    let [scene, cameras, graph, out] =
        ["scene.ply", "cameras.json#0", "graph.ron", "out"].map(|name| place.named(name));
    let root = other.named("");
    let line = ["render", &scene, "-c", &cameras, "-p", &graph, "-o", &out, "--include-root", &root];
    let line: Vec<_> =
        line.map(Into::into).into_iter().chain(crate::common::device_option().map(Into::into)).collect();
    let ran = splatgraph::cli::job(&line).expect("a job").run(&[0]).expect("it runs");
    assert_eq!((ran.done.as_slice(), ran.failed.as_slice()), (&[0][..], &[][..]));
}

#[cfg(unix)]
#[test]
fn a_pipe_in_the_place_of_a_graph_is_refused_at_once() {
    let place = Place::empty();
    let made = std::process::Command::new("mkfifo").arg(place.at("pipe.ron")).status();
    assert!(made.expect("mkfifo runs").success());
    let errors = place.fails("check pipe.ron", 1);
    assert!(errors.contains("is a pipe, not a file"), "{errors}");
}

#[test]
fn macros_that_grow_without_end_are_an_error_at_the_shader() {
    let lines: String = (1..40).map(|i| format!("#define M{i} M{0} + M{0}\n", i - 1)).collect();
    let place = changed(&[]);
    let text = place.text("hash.glsl");
    // With a long name, memory runs out before time.
    let name = "x".repeat(1000);
    let bomb =
        format!("#define M0 {name}\n{lines}uint bomb(uint x) {{ return M39; }}\n#if 1\n{text}#endif\n");
    place.write("hash.glsl", bomb);
    let errors = place.fails("check graph.ron", 1);
    let told = ["the compiler took over ", "the compiler ran out of its "];
    // On systems other than Linux, time may run out first: Windows limits nothing else.
    let told = if cfg!(target_os = "linux") { &told[..1] } else { &told[..] };
    assert!(told.iter().any(|limit| errors.contains(limit)), "{errors}");
}
