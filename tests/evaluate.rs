//! Datasets of cameras and photographs: a scene is rendered to photographs, and scored against them.

use crate::commands::{done, scene, splatgraph};
use serde_json::Value;
use std::path::Path;

/// Photographs the scene of a folder into `views/`, 9 of 96 x 54 pixels.
fn photographed(folder: &Path) {
    let line =
        ["synth", "--photograph", "scene.ply", "--dataset", "views", "--views", "9", "--size", "96x54"];
    done(folder, &line);
}

fn scored(folder: &Path, more: &[&str]) -> Value {
    let line = ["evaluate", "scene.ply", "-c", "views", "--json"];
    serde_json::from_str(&done(folder, &[&line[..], more].concat())).expect("JSON")
}

#[test]
fn a_photographed_scene_scores_as_well_as_8_bits_allow_and_another_scene_does_not() {
    let folder = scene();
    let folder = folder.path();
    photographed(folder);
    let exact = scored(folder, &["--backend", "reference", "-o", "scores"]);
    // Every eighth of nine, starting with the first.
    let views: Vec<&str> =
        exact["views"].as_array().expect("views").iter().map(|v| v["view"].as_str().unwrap()).collect();
    assert_eq!(views, ["view-0000.png", "view-0008.png"]);
    // Rounding to 8 bits is an error of 1 / (255 sqrt(12)), 58.9 dB.
    let psnr = |found: &Value| found["mean"]["psnr_db"].as_f64().expect("a number");
    assert!((58.0..60.0).contains(&psnr(&exact)), "{exact:#}");
    assert!(exact["mean"]["ssim"].as_f64() > Some(0.998), "{exact:#}");
    for name in ["renders/view-0000", "photographs/view-0008", "differences/view-0000"] {
        assert!(folder.join(format!("scores/{name}.png")).is_file(), "{name}");
    }
    let drawn = scored(folder, &["--all"]);
    assert_eq!(drawn["views"].as_array().map(Vec::len), Some(9));
    assert!(psnr(&drawn) > 50.0, "{drawn:#}");
    let half = scored(folder, &["--backend", "reference", "--downscale", "2"]);
    assert_eq!(
        (half["views"][0]["width"].as_u64(), half["views"][0]["height"].as_u64()),
        (Some(48), Some(27))
    );
    // The mean of four pixels is not the pixel of twice the size.
    assert!((20.0..psnr(&exact)).contains(&psnr(&half)), "{half:#}");
    // Fewer splats give another scene.
    done(folder, &["synth", "demo", "--count", "300", "--seed", "3", "-o", "other.ply"]);
    let other = done(folder, &["evaluate", "other.ply", "-c", "views/sparse/0", "--backend", "reference"]);
    let mean = other.lines().last().expect("a row").split_whitespace().nth(1).expect("a number");
    assert!(mean.parse::<f64>().expect("a number") < 30.0, "{other}");
}

#[test]
fn the_cameras_of_a_dataset_are_drawn_by_render_and_mistakes_are_told() {
    let folder = scene();
    let folder = folder.path();
    photographed(folder);
    let render = ["render", "scene.ply", "--backend", "reference", "-o"];
    done(folder, &[&render[..], &["all", "-c", "views"]].concat());
    assert_eq!(std::fs::read_dir(folder.join("all")).expect("pictures").count(), 9);
    let compared = done(folder, &["compare", "all", "views/images", "--min-psnr", "55"]);
    assert!(compared.contains("view-0008"), "{compared}");
    let look = ["orbit", "--orbit", "3", "--eye", "0,-1,-6", "--fov", "45", "--size", "40x30"];
    done(folder, &[&render[..], &look].concat());
    assert_eq!(std::fs::read_dir(folder.join("orbit")).expect("pictures").count(), 3);

    std::fs::remove_file(folder.join("views/images/view-0008.png")).expect("it is there");
    std::fs::create_dir(folder.join("empty")).expect("a folder");
    for (args, code, expected) in [
        (&["evaluate", "scene.ply", "-c", "views"][..], 1, "expected the photograph "),
        (&["evaluate", "scene.ply", "-c", "cameras.json"], 2, "name it with --photographs"),
        (&["evaluate", "scene.ply", "-c", "empty"], 1, "expected cameras.json, transforms.json"),
        (
            &["evaluate", "scene.ply", "-c", "views", "--backend", "reference", "--set", "cutoff=3"],
            2,
            "--set is for graphs",
        ),
        (&["synth", "--photograph", "scene.ply"], 2, "--dataset"),
        (&["render", "scene.ply", "--orbit", "2", "-o", "one.png"], 2, "expected one camera for the picture"),
    ] {
        let output = splatgraph(folder, args);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(said.contains(expected), "{said}");
    }
    let wrong = std::fs::read_to_string(folder.join("views/sparse/0/cameras.txt")).expect("text");
    std::fs::write(folder.join("views/sparse/0/cameras.txt"), wrong.replacen("PINHOLE", "OPENCV", 1))
        .expect("written");
    let output = splatgraph(folder, &["render", "scene.ply", "-c", "views", "-o", "x"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("cameras.txt:2: `k1`: expected a value, found the end of the line"), "{said}");
}
