//! `sweep` as a command: quality and time with decreasing numbers of splats.

use crate::files::Place;
use serde_json::Value;
use splatgraph::io::image::Image;
use std::fs;

/// Three steps with the minimum number of frames.
const SHORT: [&str; 9] =
    ["sweep", "scene.ply", "--size", "64x48", "--steps", "3", "--rounds", "1", "--frames"];

#[test]
fn a_sweep_holds_every_choice_against_the_truth_and_writes_what_it_found() {
    let place = Place::new();
    let output = place.run(&[&SHORT[..], &["1", "-o", "out"]].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let text = fs::read(place.at("out/sweep.json")).expect("it is written");
    let swept: Value = serde_json::from_slice(&text).expect("JSON");
    let steps = swept["steps"].as_array().expect("steps");
    // All splats, then two steps of four choices.
    assert_eq!(steps.len(), 1 + 4 * 2);
    let step = |choice: &str, count: u64| {
        let found = steps.iter().find(|s| s["choice"] == choice && s["count"] == count);
        found.unwrap_or_else(|| panic!("{choice}, {count}: {swept}"))
    };
    let psnr = |step: &Value| step["error"]["psnr_db"].as_f64().expect("not equal");
    let all = &steps[0];
    assert!(all["choice"].is_null() && psnr(all) > 60.0, "{all}");
    for choice in ["file_order", "world_size", "screen_size", "nearest"] {
        let (half, quarter) = (step(choice, 100), step(choice, 50));
        assert!(psnr(all) > psnr(half) + 10.0 && psnr(half) > psnr(quarter), "{choice}: {swept}");
        assert!(half["time"]["gpu_ms"].as_f64() > Some(0.0), "{half}");
    }
    assert!(psnr(step("screen_size", 50)) > psnr(step("file_order", 50)), "what counts is kept: {swept}");
    // Splats cut before the keys are not visible; splats cut after the sort are.
    let number = |step: &Value, name: &str| step[name].as_u64().expect("a count");
    let visible = number(all, "visible");
    assert!(number(step("screen_size", 50), "visible") <= 50);
    assert_eq!(number(step("nearest", 50), "visible"), visible);
    assert_eq!(number(step("nearest", 50), "drawn"), visible / 4);
    assert_eq!(swept["closer"].as_array().map(Vec::len), Some(8));

    let csv = fs::read_to_string(place.at("out/sweep.csv")).expect("it is written");
    assert_eq!(csv.lines().count(), 10, "{csv}");
    for name in ["quality", "times", "trade", "shares", "approach"] {
        Image::load(&place.at(&format!("out/{name}.png"))).expect("a plot");
        assert!(fs::read_to_string(place.at(&format!("out/{name}.svg"))).expect("a plot").contains("</svg>"));
    }
    let picture = Image::load(&place.at("out/pictures/screen-size-50.png")).expect("a picture");
    assert_eq!((picture.width, picture.height), (64, 48));
    let page = fs::read_to_string(place.at("out/sweep.html")).expect("it is written");
    assert_eq!(page.matches("<img").count(), 4 * 3, "all, and two steps, of each choice");
}

#[test]
fn mistakes_are_told_and_no_input_is_written_over() {
    let place = Place::new();
    let short = |more: &[&str]| place.code(&[&SHORT[..], &["1"], more].concat());
    for (more, code, why) in [
        (&["--steps", "1"][..], 2, "--steps"),
        (&["--set", "alpha_flor=0.1"], 1, "did you mean `alpha_floor`"),
        (&["-o", "scene.ply"], 2, "scene.ply/sweep.html, which cannot be written"),
    ] {
        let found = short(more);
        assert!(found.0 == Some(code) && found.1.contains(why), "{more:?}: {found:?}");
    }
    let before = fs::read(place.at("scene.ply")).expect("the scene");
    fs::write(place.at("sweep.json"), &before).expect("a copy");
    let (code, errors) = place.code(&["sweep", "sweep.json", "-o", "."]);
    assert!(code == Some(2) && errors.contains("sweep.json"), "no output over an input: {errors}");
    assert_eq!(fs::read(place.at("sweep.json")).expect("the copy"), before);
}
