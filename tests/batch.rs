//! Many pictures in one run: drawing overlaps with encoding, with the same files and messages as without overlap.

use crate::place::Place;
use serde_json::{Value, json};
#[cfg(target_os = "linux")]
use std::fs;

/// Number of views of the demo scene. The picture size changes after every third view.
const VIEWS: usize = 12;

fn scene() -> Place {
    let place = Place::empty();
    place.done("synth demo --count 4000 -o scene.ply --cameras four.json");
    let four = place.json("four.json");
    let four = four.as_array().expect("a list");
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
    place.write("views.json", serde_json::to_string(&views).expect("JSON"));
    place
}

/// Returns the picture's name from each line of the output that reports a picture.
fn named((text, errors): &(String, String)) -> Vec<String> {
    let text = errors.clone() + text;
    let lines = text.lines().filter(|line| line.contains("view") && line.contains(" x "));
    lines.filter_map(|line| Some(line.split_once(':')?.0.to_owned())).collect()
}

#[test]
fn a_batch_has_the_files_and_the_messages_of_one_picture_after_the_other() {
    let place = scene();
    for (jobs, out) in [("1", "one"), ("5", "many")] {
        let line =
            format!("render scene.ply -c views.json -o {out} --jobs {jobs} --json={out}.json --validate");
        let said = place.said(&line);
        let expected: Vec<String> = (0..VIEWS).map(|view| format!("{out}/view{view:02}.png")).collect();
        assert_eq!(named(&said), expected);
        let stats = place.json(&format!("{out}.json"));
        let names: Vec<&str> = (0..VIEWS).filter_map(|view| stats[view]["camera"].as_str()).collect();
        assert_eq!(names.len(), VIEWS);
        assert!(names.is_sorted(), "{names:?}");
        let files: Vec<&str> =
            (0..VIEWS).filter_map(|view| stats[view]["files"]["picture"].as_str()).collect();
        assert_eq!(files, expected);
    }
    for view in 0..VIEWS {
        let name = format!("view{view:02}.png");
        let picture = place.bytes(&format!("many/{name}"));
        assert!(picture == place.bytes(&format!("one/{name}")), "{name}");
        if view % 4 == 1 {
            place.done(&format!("render scene.ply -c views.json#{view} -o alone.png"));
            assert!(picture == place.bytes("alone.png"), "{name}");
        }
    }
}

#[test]
fn a_camera_that_fails_costs_no_statistics_of_those_before_it() {
    let place = scene();
    let mut views = place.json("views.json");
    // Larger than the largest image of the tests' devices.
    for side in ["width", "height"] {
        views[2][side] = 32_768.into();
    }
    place.write("views.json", views.to_string());
    place.fails("render scene.ply -c views.json --output alpha=a.npy --json=stats.json", 1);
    let stats = place.json("stats.json");
    assert_eq!(stats.as_array().map(Vec::len), Some(2));
    assert_eq!(stats[1]["files"], json!({ "alpha": "a-view01.npy" }));
}

#[test]
#[cfg(target_os = "linux")]
fn a_picture_that_cannot_be_written_ends_the_batch_and_those_before_it_are_told_and_whole() {
    let place = scene();
    fs::create_dir(place.at("out")).expect("made");
    std::os::unix::fs::symlink("/dev/full", place.at("out/view04.png")).expect("made");
    let output = place.run("render scene.ply -c views.json -o out --jobs 3");
    let [text, errors] =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(errors.contains("view04.png: cannot be written"), "{errors}");
    let told: Vec<String> = (0..4).map(|view| format!("out/view{view:02}.png")).collect();
    assert_eq!(named(&(text, errors))[..4], told);
    for entry in fs::read_dir(place.at("out")).expect("a folder") {
        let entry = entry.expect("an entry");
        if entry.file_type().expect("a type").is_file() {
            let read = splatgraph::io::image::Image::load(&entry.path());
            assert!(read.is_ok(), "not whole: {read:?}");
        }
    }
}
