//! Failures around the real window: command lines, missing and vanishing displays, and slow passes.

use super::program::{Program, middle};
use super::screen::comes;
use crate::place::Place;
use std::process::Command;
use std::time::{Duration, Instant};

#[test]
fn values_without_a_meaning_are_refused_before_anything_is_loaded() {
    for (options, expected) in [
        ("--split 2", "expected --split from 0 to 1, found 2"),
        ("--split nan", "expected --split from 0 to 1, found NaN"),
        ("--gain nan", "expected --gain from 0 to 65536, found NaN"),
        ("--gain=-1", "expected --gain from 0 to 65536, found -1"),
        ("--gain inf", "expected --gain from 0 to 65536, found inf"),
        ("--scale 0", "expected --scale from 0.05 to 4, found 0"),
        ("--scale nan", "expected --scale from 0.05 to 4, found NaN"),
        ("--size 20000x1", "expected --size up to 16384x16384, found 20000x1"),
        ("--frames 0", "expected --frames of at least 1, found 0"),
        ("--show none,graph", "expected --show none alone"),
        ("--background 0,2,0", "expected values from 0 to 1 (255 is 1), found 2"),
        ("--background 0,1.5,0", "expected the channels of --background from 0 to 1, found 1.5"),
    ] {
        // The scene is missing, too, but the option's error comes first.
        let errors = Place::empty().fails(&format!("view nothing.ply {options}"), 2);
        let told = errors.lines().filter(|line| line.contains(expected)).count();
        assert!(told == 1 && !errors.contains("nothing.ply"), "{options}: {errors}");
    }
}

#[test]
fn a_script_is_told_that_what_it_asked_for_cannot_be_shown() {
    for (args, expected) in [
        ("--pipeline broken.ron", "broken.ron:1:"),
        ("--compare nope", "`nope`"),
        ("--inspect nope@nope", "no pass `nope` runs"),
        ("--select pass:nope", "the plan has no pass `nope`"),
        ("--select barrier:999", "the plan has no barrier 999"),
    ] {
        let line = format!("--size 320x200 --show none --screenshot shot.png {args}");
        let program = Program::launch(100, &line, |place| place.write("broken.ron", "Graph("));
        let picture = program.place.at("shot.png");
        let (status, errors) = program.end_before(|| assert!(!picture.exists(), "{args:?} writes a picture"));
        assert_eq!(status.code(), Some(1), "{args:?}: {errors}");
        assert!(errors.contains(expected) && !errors.contains("panicked"), "{args:?}: {errors}");
    }
}

#[test]
fn without_a_display_the_program_says_so_and_with_one_of_two_it_takes_that() {
    let nowhere = |command: &mut Command| {
        command.env("WAYLAND_DISPLAY", "wayland-nowhere").env("XDG_RUNTIME_DIR", std::env::temp_dir());
    };
    let program = Program::launch_with(100, "--frames 3", nowhere, |_| {});
    let (status, errors) = program.end();
    assert!(status.success(), "{status}\n{errors}");

    let place = Place::new();
    for (display, wayland) in [(None, false), (Some(":4711"), false), (None, true), (Some(":4711"), true)] {
        let mut command = place.program("view scene.ply");
        if wayland {
            nowhere(&mut command);
        }
        let output = command.envs(display.map(|name| ("DISPLAY", name))).output().expect("the program runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{errors}");
        assert!(errors.starts_with("error: there is no display to open a window on ("), "{errors}");
        assert!(errors.contains("`splatgraph render` draws without a window"), "{errors}");
    }
}

#[test]
fn without_a_driver_the_window_says_so_rather_than_blame_the_window_system() {
    for (file, expected) in [("/nowhere.json", "finds no driver that works in "), ("", "is set, but empty")] {
        let hide = |command: &mut Command| {
            command.env("VK_DRIVER_FILES", file).env("VK_ICD_FILENAMES", file);
        };
        let (status, errors) = Program::launch_with(100, "--frames 3", hide, |_| {}).end();
        assert_eq!(status.code(), Some(1), "{errors}");
        assert!(errors.contains(expected), "{errors}");
    }
}

#[test]
fn a_window_is_no_larger_than_the_display_and_ends_with_it() {
    let mut program = Program::launch(100, "--continuous", |_| {});
    assert!(program.window.appears(), "no window came");
    assert_eq!(program.window.size(), (1280, 828));
    program.frames(3);
    program.lose_display();
    let (status, errors) = program.end();
    assert_eq!(status.code(), Some(1), "{errors}");
    assert!(!errors.contains("panicked"), "{errors}");
}

#[test]
fn pictures_that_take_longer_than_the_window_waits_are_shown_all_the_same() {
    // On a CPU, a picture takes several tenths of a second. The window stops submitting while one in flight is that
    // old.
    let line = "--continuous --pipeline pipelines/splat.ron --size 900x720 --show none";
    let mut program = Program::launch(100_000, line, |_| {});
    assert!(program.window.appears(), "no window came");
    program.until(0, "the plan", |event| event["event"] == "swapped" && event["renderer"] == "a");
    let since = program.now();
    let number = |event: &serde_json::Value| (event["event"] == "frame").then(|| event["number"].as_u64());
    let first = program.until(since, "a frame", |event| number(event).is_some());
    let first = number(&first).flatten().expect("it has a number");
    program.until(since, "more frames", |event| number(event).flatten() >= Some(first + 4));
    program.close();
}

fn slow_graph(groups: u32) -> String {
    format!(
        "Graph(version: 1, summary: \"\", output: \"color\", \
         resources: {{ \"color\": Image(format: \"rgba8\", size: (64, 64)) }}, \
         passes: [Dispatch(name: \"slow\", shader: \"slow.comp\", size: Groups({groups}), bind: {{ \"color\": \"color\" }})])"
    )
}

fn slow_shader(iterations: u32) -> String {
    format!(
        "#version 460\nlayout(local_size_x = 64) in;\n\
         layout(set = 0, binding = 0, rgba8) writeonly uniform image2D color;\n\
         void main() {{\n    float slow = 1.0;\n    \
         for (int i = 0; i < {iterations}; i++) slow = sin(slow) + float(i);\n    \
         imageStore(color, ivec2(gl_GlobalInvocationID.x, 0), vec4(slow));\n}}\n"
    )
}

/// Starts the program with [`slow_graph`] and a shader that ends at once. Waits for a picture.
fn quick(groups: u32, show: &str) -> Program {
    let line = format!("--pipeline slow.ron --size 900x600 --show {show}");
    let mut program = Program::launch(100, &line, |place| {
        place.write("slow.ron", slow_graph(groups));
        place.write("slow.comp", slow_shader(1));
    });
    assert!(program.window.appears(), "no window came");
    program.window.focus();
    program.until(0, "a picture", |event| event["event"] == "frame" && event["busy"] == false);
    program
}

#[test]
fn while_a_pass_runs_for_long_the_window_says_so_is_used_and_can_be_closed() {
    let mut program = quick(60_000, "parameters");
    // With this shader, the pass takes many minutes.
    program.place.write("slow.comp", slow_shader(60_000));
    let named = comes(|| program.window.title().contains("has been running for"));
    assert!(named, "the title is {}", program.window.title());
    program.until(0, "the slow pass", |event| event["event"] == "slow");
    // The panels still react, and the window can be resized.
    let toggle = middle(program.control("panel:Inspector"));
    let mut since = program.now();
    program.window.point(toggle);
    program.frame_after(since);
    since = program.now();
    program.window.key('h'.into());
    program.until(since, "the picture alone", |event| event["event"] == "control_gone");
    since = program.now();
    program.window.resize(700, 500);
    program.until(since, "the new size", |event| event["event"] == "window" && event["width"] == 700);
    program.frame_after(since);
    since = program.now();
    program.window.key('h'.into());
    program.until(since, "the panels", |event| event["name"] == "panel:Inspector");
    assert!(program.window.title().contains("has been running for"), "the pass has ended");
    let begun = Instant::now();
    program.window.ask_to_close();
    let (status, errors) = program.end();
    assert!(begun.elapsed() < Duration::from_secs(30), "closing takes {:?}", begun.elapsed());
    assert!(status.success(), "{status}\n{errors}");
    assert!(errors.contains("closed while") && errors.contains("was still running"), "{errors}");
}

#[test]
fn a_graph_that_is_mended_while_its_pass_runs_for_long_is_drawn_when_that_ends() {
    let mut program = quick(600, "none");
    program.place.write("slow.comp", slow_shader(60_000));
    let named = comes(|| program.window.title().contains("has been running for"));
    assert!(named, "the title is {}", program.window.title());
    let since = program.now();
    program.place.write("slow.comp", slow_shader(2));
    program.swapped(since, "a", "slow.comp");
    let alone = comes(|| program.window.title() == "scene.ply - splatgraph");
    assert!(alone, "the title is {}", program.window.title());
    program.rests();
    program.close();
}
