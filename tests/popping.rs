//! `popping` as a command: how much the error of each variant changes from frame to frame.

use crate::place::Place;
use serde_json::Value;
use splatgraph_assets::{Camera, Projection, synth};

fn popping(place: &Place, more: &str) -> Value {
    place.done(&format!("popping scene.ply --device llvmpipe --validate --json=popping.json {more}"));
    place.json("popping.json")
}

fn of(found: &Value, name: &str, key: &str) -> f64 {
    let all = found["variants"].as_array().expect("a list");
    let row =
        all.iter().find(|row| row["summary"]["name"] == name).unwrap_or_else(|| panic!("{name}: {all:?}"));
    row["summary"][key].as_f64().unwrap_or_else(|| panic!("{name} has no {key}: {row}"))
}

#[test]
fn a_coarser_order_pops_more_and_an_order_that_stays_changes_no_pair() {
    let place = Place::new();
    synth::generate("demo", 3000, 0).expect("a scene").write_ply(place.at("scene.ply")).expect("written");
    let graphs = "-p splat,front_to_back -p unsorted -p stale_order";
    let bits = "--with key_bits=8 --with key_bits=12 --with key_bits=32";
    let found = popping(&place, &format!("--frames 4 --step 2 --size 96x64 -o out {graphs} {bits}"));
    let pop = |name: &str| of(&found, name, "pop");

    // Each number is given per step and per degree, together with the step's size.
    for row in found["variants"].as_array().expect("a list") {
        let number = |key: &str| row["summary"][key].as_f64().expect("a number");
        assert!((number("step_degrees") - 2.0).abs() < 1e-9, "{row}");
        assert!((number("pop_per_degree") - number("pop") / 2.0).abs() < 1e-12, "{row}");
    }
    assert!(
        found["notes"].as_str().is_some_and(|notes| notes.contains("0 by definition: the published order"))
    );

    // Both presets draw in the true order. The small error that remains comes from the edges of the quads.
    assert!(pop("splat") < 1e-4 && (pop("splat") / pop("front_to_back") - 1.0).abs() < 0.1, "{found:#}");
    assert!(pop("key_bits=8") > 5.0 * pop("splat"), "{found:#}");
    assert!(pop("key_bits=12") < pop("key_bits=8"), "{found:#}");
    assert!(pop("stale_order") > pop("splat"), "{found:#}");

    // The file's order never changes. 32-bit keys change the order exactly when the true order changes.
    let changes = |name: &str, key: &str| of(&found, name, key);
    assert_eq!(changes("unsorted", "order_changes"), 0.0);
    assert!(changes("unsorted", "true_order_changes") > 100.0, "{found:#}");
    assert_eq!(changes("key_bits=32", "order_changes"), changes("key_bits=32", "true_order_changes"));

    // With a constant order the error drifts instead of popping: at 1/100 of the step, pixels change little.
    let finer = "--frames 3 --step 0.02 --size 96x64 -p unsorted";
    let worst = |found: &Value| {
        found["variants"].as_array().expect("a list").iter().find_map(|row| {
            (row["summary"]["name"] == "unsorted")
                .then(|| row["summary"]["worst"]["difference"].as_f64())
                .flatten()
        })
    };
    let (coarse, fine) =
        (worst(&found).expect("a number"), worst(&popping(&place, finer)).expect("a number"));
    assert!(fine > 0.0 && fine < 0.1 * coarse, "{fine} of {coarse}");

    for row in found["variants"].as_array().expect("a list") {
        let steps = row["track"]["steps"].as_array().expect("a list");
        assert_eq!(steps.len(), 3);
        for step in steps {
            let number = |key: &str| step[key].as_f64().expect("a number");
            assert!(number("excess") <= number("pop"), "{step}");
            assert!(step["worst"]["difference"].as_f64() >= Some(number("pop")), "{step}");
            assert!(number("true_change") > 0.0, "the camera moves: {step}");
        }
    }
    // The exact renderer draws the same projection.
    let lens = popping(&place, "--frames 3 --step 2 --size 96x48 -p equirectangular");
    assert!(of(&lens, "equirectangular", "pop") < 1e-5, "{lens:#}");
    let csv = place.text("out/popping.csv");
    assert_eq!(csv.lines().count(), 1 + 7 * 3, "{csv}");
    assert!(place.text("out/popping.svg").contains("key_bits=8"));
    assert!(place.bytes("out/popping.png").starts_with(b"\x89PNG"));
}

#[test]
fn against_the_order_of_each_pixel_the_published_order_pops_and_a_window_pops_less() {
    let place = Place::new();
    synth::generate("demo", 3000, 0).expect("a scene").write_ply(place.at("scene.ply")).expect("written");
    let graphs = "--frames 3 --step 0.5 --size 160x90 -p tiled,pixel_order -o out";
    let published = of(&popping(&place, graphs), "tiled", "pop");
    let found = popping(&place, &format!("{graphs} --rule order=pixel"));
    let [tiled, window] = ["tiled", "pixel_order"].map(|name| of(&found, name, "pop"));
    assert!(tiled > 5.0 * published, "pops of the published order: {tiled}, of its errors: {published}");
    assert!(window < 0.5 * tiled, "{window}, without a window {tiled}");
    assert_eq!(found["rules"][0][1], "pixel");
    assert!(
        place
            .text("out/popping.csv")
            .lines()
            .all(|line| line.contains("rules") || line.contains("order=pixel"))
    );
    place.refuses(
        "popping scene.ply",
        &[("--rule order=middle", 2, "expected `centre` or `pixel`, found `middle`")],
    );
}

#[test]
fn a_camera_at_rest_pops_in_no_order() {
    let place = Place::new();
    place.cameras(&["one", "two", "three"]);
    let found = popping(&place, "-c cameras.json -p unsorted -p stale_order --with key_bits=8");
    for name in ["unsorted", "stale_order", "key_bits=8"] {
        assert_eq!((of(&found, name, "pop"), of(&found, name, "worst_step")), (0.0, 0.0), "{found:#}");
    }
    assert_eq!(of(&found, "key_bits=8", "order_changes"), 0.0);
    let rows = found["variants"].as_array().expect("a list");
    assert!(rows.iter().all(|row| row["summary"]["pop_per_degree"].is_null()), "a camera at rest: {found:#}");
}

#[test]
fn a_variant_begins_without_the_histories_of_the_one_before_and_a_warm_average_does_not_pop() {
    let place = Place::new();
    place.cameras(&["one", "two", "three"]);
    place.average();
    let line =
        "popping scene.ply --device llvmpipe -c cameras.json -p mean.ron,again.ron --json=popping.json";
    let (_, errors) = place.said(line);
    let note = "mean.ron: keeps an image from frame to frame; an average that has not converged after the first \
                camera's 2 frames counts as popping (--warm-up)";
    assert!(errors.contains(note), "{errors}");
    let found = place.json("popping.json");
    let pop = |found: &Value| ["mean.ron", "again.ron"].map(|name| of(found, name, "pop"));
    let [first, second] = pop(&found);
    assert!(first > 1e-4 && first == second, "{found:#}");
    let [first, second] = pop(&popping(&place, "-c cameras.json -p mean.ron,again.ron --warm-up 24"));
    assert!(first < 1e-6 && first == second, "{first} {second}");
}

#[test]
fn mistakes_on_a_path_are_told_before_anything_is_drawn() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    let mut cameras = Camera::load(place.at("cameras.json")).expect("cameras");
    let lens = |camera: &Camera| Camera { projection: Projection::Fisheye, ..camera.clone() };
    let fisheyes: Vec<Camera> = cameras.iter().map(lens).collect();
    Camera::save(&fisheyes, place.at("fisheyes.json")).expect("written");
    cameras[1] = cameras[1].resized(32, 24);
    Camera::save(&cameras, place.at("sizes.json")).expect("written");
    place.write("broken.ron", "Graph(");
    place.refuses(
        "popping scene.ply",
        &[
            ("-c sizes.json", 1, "expected pictures of the same size along the path"),
            ("-p splatt", 1, "splatt"),
            ("-c fisheyes.json -p broken.ron -p fisheye", 1, "broken.ron:1:"),
            (
                "-p splat -p fisheye",
                2,
                "expected graphs with one projection, found splat (pinhole) and fisheye (fisheye)",
            ),
            ("-p splat,unsorted,splat", 2, "--pipeline: expected each value once, found `splat` twice"),
            (
                "--with key_bits=8 --with key_bits=8",
                2,
                "--with: expected each value once, found `key_bits=8` twice",
            ),
            ("--with key_bits", 2, "NAME=VALUE"),
            ("--with key_bitz=8", 1, "key_bitz"),
            ("--frames 1", 2, "--frames"),
            ("--step many", 2, "degrees"),
            ("--json=scene.ply", 2, "would overwrite the scene"),
            ("-c cameras.json --json=cameras.json", 2, "would overwrite the cameras"),
            ("--size 16384x16384", 1, "expected true pictures of at most 4096 MiB"),
        ],
    );
}
