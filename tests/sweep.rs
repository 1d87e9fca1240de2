//! `sweep` as a command: quality and time with decreasing numbers of splats.

use crate::place::Place;
use serde_json::{Value, json};
use splatgraph_assets::synth;
use splatgraph_assets::{Camera, FileNotes, Filter, Projection, Scene, Splat};
use splatgraph_reference::{Rules, render};

const SHORT: &str = "sweep scene.ply --size 64x48 --steps 3 --rounds 1 --frames 1";

#[test]
fn a_sweep_holds_every_choice_against_the_truth_and_writes_what_it_found() {
    let place = Place::new();
    let table = place.done(&format!("{SHORT} --set alpha_cap=0.99 -o out"));
    let swept = place.json("out/sweep.json");
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
    // `screen_size` drops splats before the keys, so they do not count as visible. `nearest` drops them after the sort.
    let number = |step: &Value, name: &str| step[name].as_u64().expect("a count");
    let visible = number(all, "visible");
    assert!(number(step("screen_size", 50), "visible") <= 50);
    assert_eq!(number(step("nearest", 50), "visible"), visible);
    assert_eq!(number(step("nearest", 50), "drawn"), visible / 4);
    assert_eq!(swept["closer"].as_array().map(Vec::len), Some(8));

    let csv = place.text("out/sweep.csv");
    assert_eq!(csv.lines().count(), 10, "{csv}");
    // All phases, including those that do not depend on the number of splats.
    let header: Vec<&str> = table.lines().next().expect("a header").split_whitespace().collect();
    let phases = all["time"]["phases"].as_object().expect("phases");
    assert!(phases.len() > 3 && phases.keys().all(|phase| header.contains(&phase.as_str())), "{table}");
    assert!(table.contains("only the GPU ms of whole frames are reliable"), "{table}");
    let origin = &swept["origin"];
    assert_eq!(
        (&origin["set"], &origin["rounds"], &origin["cameras"][0]["width"], &swept["missing"]),
        (&json!([["alpha_cap", "0.99"]]), &1.into(), &64.into(), &json!([]))
    );
    assert!(swept["command"].as_str().is_some_and(|command| command.contains("alpha_cap=0.99")), "{swept}");
    for (line, step) in csv.lines().skip(1).zip(steps) {
        let choice = step["choice"].as_str().unwrap_or("all");
        assert!(line.starts_with(&format!("\"{choice}\",")), "{choice}: {line}");
    }
    for name in ["quality", "times", "trade", "shares", "approach"] {
        place.image(&format!("out/{name}.png"));
        assert!(place.text(&format!("out/{name}.svg")).contains("</svg>"));
    }
    let picture = place.image("out/pictures/screen_size-50.png");
    assert_eq!((picture.width, picture.height), (64, 48));
    let page = place.text("out/sweep.html");
    assert_eq!(page.matches("<img").count(), 4 * 3, "all, and two steps, of each choice");
    let device = origin["device"].as_str().expect("a name");
    assert!(page.contains(device) && page.contains("alpha_cap=0.99") && csv.contains(device), "{page}");
}

#[test]
fn the_nearest_splats_are_compared_with_all_splats_of_their_own_plan() {
    let place = Place::new();
    let table = place.done(&format!("{SHORT} -p tiled --set sorted=pairs -o out"));
    let swept = place.json("out/sweep.json");
    let steps = swept["steps"].as_array().expect("steps");
    let phases = |step: &Value| -> Vec<String> {
        step["time"]["phases"].as_object().expect("phases").keys().cloned().collect()
    };
    let nearest: Vec<&Value> = steps.iter().filter(|step| step["choice"] == "nearest").collect();
    let counts: Vec<&Value> = nearest.iter().map(|step| &step["count"]).collect();
    assert_eq!(json!(counts), json!([200, 100, 50]));
    assert!(nearest.iter().all(|step| phases(step) == phases(nearest[0])), "{swept}");
    assert!(phases(nearest[0]) != phases(&steps[0]), "{swept}");
    // The baseline of a curve is its first step.
    let exact_ms = |step: &Value| step["time"]["exact_ms"].as_f64().expect("a time");
    assert!(nearest.iter().all(|step| exact_ms(step) == exact_ms(nearest[0])), "{swept}");
    let row = table.lines().find(|line| line.starts_with("nearest")).expect("a row");
    assert!(
        row.contains(&format!(" {:.3} ", nearest[0]["time"]["gpu_ms"].as_f64().expect("a time"))),
        "{table}"
    );
    assert_eq!(place.text("out/sweep.html").matches("<img").count(), 4 * 3);
}

#[test]
fn a_part_of_a_scene_is_drawn_by_the_rules_of_the_whole() {
    let place = Place::empty();
    // The second half is invisible, so the first half of the file looks like the whole.
    let demo = synth::generate("demo", 200, 0).expect("the scene is generated");
    let splat = |index: usize| {
        let splat = demo.splat(index % 200);
        Splat { opacity: if index < 200 { splat.opacity } else { 0.0 }, ..splat }
    };
    let notes = FileNotes { low_pass: Filter::Mip, ..FileNotes::default() };
    let scene = Scene::generate(400, demo.stored_degree(), splat).with_notes(notes);
    scene.write_ply(place.at("scene.ply")).expect("the scene is written");
    place.done("sweep scene.ply --size 64x48 --steps 2 --rounds 1 --frames 1 -o out");
    let swept = place.json("out/sweep.json");
    let steps = swept["steps"].as_array().expect("steps");
    let half = steps.iter().find(|step| step["choice"] == "file_order").expect("a step");
    assert!(half["error"]["psnr_db"].as_f64().is_none_or(|psnr| psnr > 60.0), "{half}");
}

#[test]
fn the_fragments_of_the_approach_are_those_of_the_timed_pictures() {
    let place = Place::empty();
    let scene = place.scene("scene.ply", "uniform", 300, 0);
    let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 90.0, (64, 32));
    let camera = camera.with_projection(Projection::Equirectangular, [0.0; 3]);
    Camera::save(std::slice::from_ref(&camera), place.at("around.json")).expect("written");
    let line = "sweep scene.ply -p equirectangular -c around.json --steps 2 --rounds 1 --frames 1 -o out";
    place.done(&format!("{line} --set alpha_floor=0.02 --set low_pass=none"));
    let mut rules = Rules::of_view(&scene, &camera);
    rules.set("alpha_floor", "0.02").expect("a rule");
    rules.set("low_pass", "none").expect("a rule");
    let exact = render(&scene, &camera, [0.0; 3], &rules, &|_, _| {});
    assert_eq!(
        place.json("out/sweep.json")["closer"][0]["fragments"],
        exact.contributors.iter().sum::<u32>()
    );
}

#[test]
fn mistakes_are_told_and_no_input_is_written_over() {
    let place = Place::new();
    place.refuses(
        SHORT,
        &[
            ("--steps 1", 2, "--steps"),
            ("--set alpha_flor=0.1", 1, "did you mean `alpha_floor`"),
            ("-o scene.ply", 2, "scene.ply/sweep.html, which cannot be written"),
        ],
    );
    place.write("sweep.json", place.bytes("scene.ply"));
    place.refuses("sweep sweep.json", &[("-o .", 2, "sweep.json")]);
    place.write("out/pictures", "a file");
    place.refuses(SHORT, &[("-o out", 2, "out/pictures")]);
}
