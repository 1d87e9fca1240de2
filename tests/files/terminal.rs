//! Closed pipes, full devices, and names in files with terminal escapes.

use crate::place::{DRAW, Place};
use std::fs::{self, File};
use std::process::{Command, Stdio};

fn printed(mut command: Command, to: impl Into<Stdio>) -> (Option<i32>, String) {
    let output = command.stdout(to).stderr(Stdio::piped()).output().expect("the program runs");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn into_closed_pipe(command: Command) -> (Option<i32>, String) {
    let (_, writer) = std::io::pipe().expect("a pipe");
    printed(command, writer)
}

fn full_device() -> File {
    File::options().write(true).open("/dev/full").expect("Linux has it")
}

fn onto_full_device(command: Command) -> (Option<i32>, String) {
    printed(command, full_device())
}

#[test]
fn lines_that_nobody_reads_do_not_stop_the_work() {
    let place = Place::new();
    let names: Vec<String> = (0..12).map(|index| format!("camera{index}")).collect();
    place.cameras(&names.iter().map(String::as_str).collect::<Vec<_>>());
    for run in [into_closed_pipe, onto_full_device] {
        let (code, errors) = run(place.program(&format!("{DRAW} out")));
        assert_eq!((code, place.files("out").len()), (Some(0), 12), "{errors}");
        fs::remove_dir_all(place.at("out")).expect("removed");
        let args = "synth demo --count 10 -o new.ply --cameras new.json";
        let (code, errors) = run(place.program(args));
        assert_eq!((code, place.at("new.json").exists()), (Some(0), true), "{errors}");
        fs::remove_file(place.at("new.json")).expect("removed");
    }
}

#[test]
fn where_standard_output_is_the_product_a_closed_pipe_ends_it_and_a_full_device_is_an_error() {
    let place = Place::new();
    let text = |name: &str| fs::read_to_string(place.at(name)).unwrap_or_default();
    place.write("broken.ron", "Graph(");
    for args in [
        "dump unsorted",
        "dump unsorted -o -",
        "synth",
        "synth demo --count 10 -o -",
        "--help",
        "info scene.ply",
    ] {
        let (code, errors) = into_closed_pipe(place.program(args));
        assert_eq!((code, errors.contains("error")), (Some(0), false), "{args:?}: {errors}");
        let (code, errors) = onto_full_device(place.program(args));
        assert_eq!(code, Some(1), "{args:?}: {errors}");
        assert!(errors.contains("standard output cannot be written: No space left"), "{args:?}: {errors}");
    }
    // A failed check keeps its exit code even if nobody reads its output.
    assert_eq!(into_closed_pipe(place.program("check broken.ron")).0, Some(1));
    assert_eq!(text("-"), "", "`-` is no file");
}

#[test]
fn an_error_that_cannot_be_written_is_an_exit_code_and_no_panic() {
    let place = Place::new();
    place.write("broken.ron", "Graph(");
    for (args, expected) in [
        ("info missing.ply", 1),
        ("check broken.ron", 1),
        ("render scene.ply", 2),
        ("nope", 2),
        ("synth demo -o scene.txt", 2),
    ] {
        let mut command = place.program(args);
        let status = command.stdout(Stdio::null()).stderr(full_device()).status().expect("the program runs");
        assert_eq!(status.code(), Some(expected), "{args:?}");
    }
}

#[test]
fn a_picture_or_a_scene_on_standard_output_is_alone_there() {
    let place = Place::new();
    place.cameras(&["one"]);
    let args = format!("{DRAW} -");
    let output = place.run(&args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stdout.starts_with(b"\x89PNG") && output.stdout.ends_with(b"IEND\xaeB`\x82"));
    // Outputs larger than a pipe's buffer.
    let scene = "synth demo --count 20000 -o -";
    assert_eq!(into_closed_pipe(place.program(scene)).0, Some(0));
    let picture = format!("{DRAW} - --format exr --size 640x480");
    assert_eq!(into_closed_pipe(place.program(&picture)).0, Some(0));
    let made = place.run("synth demo --count 10 -o -");
    assert!(made.stdout.starts_with(b"ply\n") && made.stdout.len() > 2480, "{} bytes", made.stdout.len());
}

#[test]
fn other_names_of_standard_output_are_standard_output() {
    let place = Place::new();
    place.cameras(&["one"]);
    std::os::unix::fs::symlink("/dev/stdout", place.at("link")).expect("made");
    for name in ["/dev/stdout", "/dev/fd/1", "link"] {
        let told = place.told(&format!("{DRAW} a.png --json={name}"));
        assert_eq!(told[0]["camera"], "one", "{name}: {told}");
        place.write("log", "what was there\n");
        let log = File::options().append(true).open(place.at("log")).expect("a file");
        let (code, errors) = printed(place.program(&format!("dump unsorted --format json -o {name}")), log);
        assert_eq!(code, Some(0), "{name}: {errors}");
        let text = place.text("log");
        assert!(text.starts_with("what was there\n{"), "{name}: {text}");
    }
    let both = place.fails(&format!("{DRAW} - --json=link"), 2);
    assert!(both.contains("both go to standard output"), "{both}");
}

/// Returns the first character that a terminal would act on, besides line breaks and tabs, if any.
fn acts(text: &str) -> Option<char> {
    text.chars().find(|c| {
        !matches!(c, '\n' | '\t')
            && (c.is_control()
                || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{200e}' | '\u{200f}'))
    })
}

/// A name that would clear the screen, colour it, change its title, move the cursor back, and reverse the text.
const EVIL: &str = "e\x1b[2J\x1b[31m\x1b]0;owned\x07\u{9b}1m\r\u{8}\u{7f}\u{202e}x";

#[test]
fn no_name_in_a_file_reaches_the_terminal_raw() {
    let place = Place::new();
    let ply = place.bytes("scene.ply");
    let end = ply.windows(11).position(|part| part == b"end_header\n").expect("a header");
    let with = |line: &str| [&ply[..end], line.as_bytes(), &ply[end..]].concat();
    place.write("comment.ply", with(&format!("comment {EVIL}\n")));
    place.write("property.ply", with(&format!("property float {EVIL}\n")));
    place.write("element.ply", with(&format!("element {EVIL} 1\nproperty float x\n")));
    place.write("format.ply", [b"ply\nformat ", EVIL.as_bytes(), b"\n", &ply[end..]].concat());
    place.write(&format!("{EVIL}.ply"), &ply);
    place.cameras(&[EVIL, "two"]);
    place.write("broken.json", format!(r#"[{{"{EVIL}": }}"#));
    place.write("names.ron", format!("Graph(params: {{\"{EVIL}\": Const(1, 0, 2)}}, output: \"{EVIL}\")"));
    place.write("unknown.ron", format!("Graph({EVIL}: 1)"));
    place.write("preset.ron", format!("Preset(graph: \"{EVIL}\", set: {{}})"));
    place.write("set.ron", format!("Preset(graph: \"splat\", set: {{\"{EVIL}\": 1}})"));
    place.write(&format!("{EVIL}.ron"), "Graph(");
    place.write(
        "shader.comp",
        format!("#version 460\n#error {EVIL}\n#include \"{EVIL}\"\n{EVIL}\nvoid main() {{ {EVIL}(); }}\n"),
    );
    place.write(
        "shader.ron",
        "Graph(\n  buffers: {\"b\": (stride: 4, count: 4)},\n  passes: [Dispatch(name: \"p\", shader: \"shader.comp\", groups: (1, 1, 1))],\n  output: \"b\",\n)",
    );
    place.write("stats.json", format!(r#"[{{"pipeline": "{}", "passes": []}}]"#, "e\\u001b[2J"));
    let mut shown = 0;
    for args in [
        "info comment.ply",
        "info property.ply",
        "info element.ply",
        "info format.ply",
        &format!("info {EVIL}.ply"),
        "info property.ply --json",
        &format!("info {EVIL}.missing"),
        &format!("render {EVIL}.ply --cameras cameras.json -p unsorted --device llvmpipe --json"),
        "render scene.ply -c cameras.json -p unsorted --device llvmpipe --inspect order@compact",
        "render scene.ply -c cameras.json -p unsorted --device llvmpipe -o out",
        "render scene.ply -c cameras.json#9 -o a.png",
        "render scene.ply -c broken.json -o a.png",
        &format!("render scene.ply --device {EVIL} -o a.png"),
        &format!("render scene.ply -p splat --set {EVIL}=1 -o a.png --device llvmpipe"),
        &format!("render scene.ply -o {EVIL} --format {EVIL}"),
        &format!("check names.ron unknown.ron preset.ron set.ron shader.ron {EVIL}.ron {EVIL}"),
        "dump names.ron",
        &format!("dump splat --set {EVIL}=1"),
        "dump splat --times stats.json",
        &format!("compare {EVIL} {EVIL}"),
        &format!("synth {EVIL} -o a.ply"),
        &format!("synth demo --count 10 -o {EVIL}2.ply"),
        EVIL,
        &format!("render --{EVIL}"),
    ] {
        let output = place.run(args);
        let code = output.status.code();
        assert!(code.is_some_and(|code| code <= 2), "{args:?} ends with {}", output.status);
        for stream in [output.stdout, output.stderr] {
            let text = String::from_utf8_lossy(&stream);
            assert_eq!(acts(&text), None, "{args:?}:\n{text:?}");
            shown += usize::from(text.contains("\\u001b") || text.contains('\u{241b}'));
        }
    }
    // Most messages must show the name, or the test would prove nothing.
    assert!(shown >= 14, "{shown} of the messages show the name");
}
