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
fn cameras_that_cannot_be_drawn_are_listed_and_the_others_are_drawn() {
    let place = scene();
    let mut views = place.json("views.json");
    // Larger than the largest image of the tests' devices.
    for (view, side) in [(2, "width"), (2, "height"), (7, "width"), (7, "height")] {
        views[view][side] = 32_768.into();
    }
    place.write("views.json", views.to_string());
    let draw = "render scene.ply --output alpha=a.npy --json=stats.json -c views.json";
    let error = place.fails(draw, 1);
    assert!(error.contains("2 of 12 cameras are not drawn:\nview02, view07: "), "{error}");
    let stats = place.json("stats.json");
    assert_eq!(stats.as_array().map(Vec::len), Some(VIEWS - 2));
    assert_eq!(stats[2]["files"], json!({ "alpha": "a-view03.npy" }));
    let alone = place.fails(&format!("{draw}#2"), 1);
    assert!(alone.starts_with("error: `pixels` has 8.00 GiB"), "{alone}");
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
    let mut written = 0;
    for entry in fs::read_dir(place.at("out")).expect("a folder") {
        let entry = entry.expect("an entry");
        if entry.file_type().expect("a type").is_file() {
            let read = splatgraph::io::image::Image::load(&entry.path());
            assert!(read.is_ok(), "not whole: {read:?}");
            written += 1;
        }
    }
    // Frames in flight and jobs may be ahead of the picture that fails.
    assert!((4..VIEWS - 1).contains(&written), "{written}");
}

#[test]
fn a_cutout_over_a_background_is_the_picture_with_this_background() {
    let place = Place::demo(2000);
    for renderer in ["--pipeline auto", "--pipeline splat", "--backend reference"] {
        let draw = format!("render scene.ply -c cameras.json#0 --size 96x72 {renderer} --background");
        place.done(&format!("{draw} 1,0.5,0 -o over.exr --output alpha=alpha.exr --output rgba=cut.png"));
        place.done(&format!("{draw} 0,0.25,1 --output rgba=cut.exr"));
        let [over, alpha, cut] = ["over.exr", "alpha.exr", "cut.exr"].map(|name| place.image(name));
        let straight = place.image("cut.png");
        for (at, pixel) in over.rgb.iter().enumerate() {
            let alpha = alpha.rgb[at][0];
            for (c, background) in [1.0, 0.5, 0.0].into_iter().enumerate() {
                let found = cut.rgb[at][c] + (1.0 - alpha) * background;
                // The blending target of `splat` holds half floats.
                assert!((found - pixel[c]).abs() < 4e-3, "{renderer}, pixel {at}: {found}, {}", pixel[c]);
                // A straight colour above 1 is clamped.
                let (found, expected) = (straight.rgb[at][c] * alpha, cut.rgb[at][c].min(alpha));
                assert!((found - expected).abs() < 8e-3, "{renderer}, pixel {at}: {found}, {expected}");
            }
        }
        assert!(alpha.rgb.iter().any(|a| a[0] < 0.9), "{renderer}");
    }
    place.done("synth ring -o ring.glb");
    let error = place.fails("render scene.ply --size=16x8 -o take=2/out.png", 2);
    assert!(error.contains("this graph has no output `take`"), "{error}");
    assert!(error.contains("= help: for a picture with that name, write ./take=2/out.png"), "{error}");
    let error = place.fails("render scene.ply ring.glb --output rgba=cut.png", 2);
    assert!(error.contains("expected a scene without a mesh for the output `rgba`"), "{error}");
    // A shard builds its first plan before it draws.
    let error = place.fails("render scene.ply ring.glb -o out/ --output rgba=cut.png --shard 0/1", 2);
    assert!(error.contains("expected a scene without a mesh for the output `rgba`"), "{error}");
    let draw = "render scene.ply ring.glb -c cameras.json#0 --size 32x24 -o picture.png --output";
    let note = "`depth`: of the splats in front of the mesh, without the mesh itself";
    for (more, is_told) in [("", true), (" --set mesh=false", false), (" --backend reference", true)] {
        let told = place.said(&format!("{draw} depth=d.npy{more}")).1;
        assert_eq!(told.contains(note), is_told, "{more}: {told}");
    }
    place.done(&format!("{draw} rgba=cut.png --set mesh=false"));
}

#[test]
fn depths_that_are_distances_are_reported() {
    let place = Place::demo(500);
    // A glTF file sorts splats by distance.
    place.done("convert scene.ply scene.glb");
    for (renderer, change) in
        [("--pipeline auto", "--set key_of=depth"), ("--backend reference", "--rule key_of=depth")]
    {
        let draw = format!(
            "render scene.glb -c cameras.json#0 --size 32x24 {renderer} --output expected_depth=d.npy"
        );
        let note = format!(
            "`expected_depth`: distances from the camera, not view depths, because the scene's splats are sorted by distance; {change}"
        );
        assert!(place.said(&draw).1.contains(&note), "{draw}");
        assert!(!place.said(&format!("{draw} {change}")).1.contains("distances"), "{draw} {change}");
    }
}
