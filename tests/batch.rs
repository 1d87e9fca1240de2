//! Many pictures in one run: drawing overlaps with encoding, and neither files nor messages show it.

use crate::common;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Views of the demo scene, in two sizes that alternate in threes.
const VIEWS: usize = 12;

fn splatgraph(folder: &Path, args: &[&str]) -> Output {
    let device = common::device_option();
    Command::new(env!("CARGO_BIN_EXE_splatgraph"))
        .args(args)
        .args(device.as_deref().filter(|_| args[0] == "render"))
        .current_dir(folder)
        .output()
        .expect("the program runs")
}

fn scene() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let args = ["synth", "demo", "--count", "4000", "-o", "scene.ply", "--cameras", "four.json"];
    assert!(splatgraph(folder.path(), &args).status.success());
    let four: Vec<Value> =
        serde_json::from_str(&fs::read_to_string(folder.path().join("four.json")).expect("written"))
            .expect("a list");
    let views = (0..VIEWS).map(|at| {
        let mut view = four[at % four.len()].clone();
        let scale = if at / 3 % 2 == 0 { 0.05 } else { 0.08 };
        for key in ["width", "height"] {
            view[key] = json!((view[key].as_f64().expect("a number") * scale).round() as u64);
        }
        for key in ["fx", "fy"] {
            view[key] = json!(view[key].as_f64().expect("a number") * scale * (1.0 + at as f64 / 50.0));
        }
        view["img_name"] = json!(format!("view{at:02}"));
        view["id"] = json!(at);
        view
    });
    let views: Vec<Value> = views.collect();
    fs::write(folder.path().join("views.json"), serde_json::to_string(&views).expect("JSON"))
        .expect("written");
    folder
}

/// Returns the first words of the lines, which name the pictures.
fn named(output: &Output) -> Vec<String> {
    let text =
        String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
    let lines = text.lines().filter(|line| line.contains("view") && line.contains(" x "));
    lines.filter_map(|line| Some(line.split_once(':')?.0.to_owned())).collect()
}

#[test]
fn a_batch_has_the_files_and_the_messages_of_one_picture_after_the_other() {
    let folder = scene();
    let at = |name: &str| folder.path().join(name);
    for (jobs, out) in [("1", "one"), ("5", "many")] {
        let args = ["render", "scene.ply", "-c", "views.json", "-o", out, "--jobs", jobs, "--json"];
        let stats = format!("{out}.json");
        let output = splatgraph(folder.path(), &[&args[..], &[&stats, "--validate"]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let expected: Vec<String> = (0..VIEWS).map(|view| format!("{out}/view{view:02}.png")).collect();
        assert_eq!(named(&output), expected);
        let stats: Value =
            serde_json::from_str(&fs::read_to_string(at(&stats)).expect("written")).expect("JSON");
        let names: Vec<&str> = (0..VIEWS).filter_map(|view| stats[view]["camera"].as_str()).collect();
        assert_eq!(names.len(), VIEWS);
        assert!(names.is_sorted(), "{names:?}");
    }
    for view in 0..VIEWS {
        let name = format!("view{view:02}.png");
        let picture = fs::read(at("many").join(&name)).expect("written");
        assert!(picture == fs::read(at("one").join(&name)).expect("written"), "{name}");
        if view % 4 == 1 {
            let camera = format!("views.json#{view}");
            let args = ["render", "scene.ply", "-c", &camera, "-o", "alone.png"];
            assert!(splatgraph(folder.path(), &args).status.success());
            assert!(picture == fs::read(at("alone.png")).expect("written"), "{name}");
        }
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_picture_that_cannot_be_written_ends_the_batch_and_those_before_it_are_told_and_whole() {
    let folder = scene();
    fs::create_dir(folder.path().join("out")).expect("made");
    std::os::unix::fs::symlink("/dev/full", folder.path().join("out/view04.png")).expect("made");
    let args = ["render", "scene.ply", "-c", "views.json", "-o", "out", "--jobs", "3"];
    let output = splatgraph(folder.path(), &args);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(errors.contains("view04.png: cannot be written"), "{errors}");
    let told: Vec<String> = (0..4).map(|view| format!("out/view{view:02}.png")).collect();
    assert_eq!(named(&output)[..4], told);
    for entry in fs::read_dir(folder.path().join("out")).expect("a folder") {
        let entry = entry.expect("an entry");
        if entry.file_type().expect("a type").is_file() {
            let read = splatgraph::io::image::Image::load(&entry.path());
            assert!(read.is_ok(), "not whole: {read:?}");
        }
    }
}
