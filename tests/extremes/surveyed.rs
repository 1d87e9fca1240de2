//! A scene ten million units from the origin: its file stores doubles, and the picture keeps their precision.

use super::{Error, exact};
use crate::common::OPEN;
use crate::place::Place;
use splatgraph_assets::{Camera, Scene, synth};
use splatgraph_reference::{Gaussian, Splats};

const SIZE: (u32, u32) = (96, 54);

/// Returns the splats and the camera in world coordinates, in f64, and the scene as generated.
fn world() -> (Vec<Gaussian>, Camera, Scene) {
    let scene = synth::generate("surveyed", 1000, 0).expect("it fits in memory");
    let offset = scene.offset();
    let generator = synth::generators().iter().find(|generator| generator.name == "surveyed");
    let local = (generator.expect("a generator").cameras)().swap_remove(0).resized(SIZE.0, SIZE.1);
    let moved = |index| {
        let splat: Gaussian = scene.get(index);
        Gaussian { position: std::array::from_fn(|axis| splat.position[axis] + offset[axis]), ..splat }
    };
    ((0..1000).map(moved).collect(), local.relative_to(offset.map(|v| -v)), scene)
}

#[test]
fn a_scene_in_doubles_is_drawn_as_exactly_as_one_at_the_origin() {
    let (splats, camera, made) = world();
    assert!(made.offset().iter().all(|v| v.abs() > 9e6));
    // The truth needs f64 depths: depths computed in f32 from world coordinates have no correct digits.
    let rules = [&OPEN[..], &[("depth", "f64")]].concat();
    let truth = exact(splats.as_slice(), &camera, &rules);
    let place = Place::new();
    place.done("synth surveyed --count 1000 -o far.ply --cameras far.json");
    let loaded = Scene::load(place.at("far.ply"), splatgraph_assets::QUIET).expect("it loads");
    assert_eq!(loaded.offset(), made.offset(), "the reader finds the origin that the writer had");
    let off = loaded.positions().iter().flatten().zip(made.positions().iter().flatten());
    // World coordinates in f64 have a resolution of 2^-29.
    assert!(off.fold(0.0f32, |most, (a, b)| most.max((a - b).abs())) < 3e-9);
    let written = Camera::load(place.at("far.json")).expect("cameras");
    assert_eq!(written[0].position, camera.position);

    let (width, height) = SIZE;
    let render = format!("render far.ply --size {width}x{height} --background 0.2,0.3,0.4 -p splat");
    let draw = |more: &str, out: &str| {
        place.done(&format!("{render} --set target=rgba32f {more} -o {out}"));
        place.image(out)
    };
    let found = Error::of("surveyed", &draw("-c far.json", "far.npy"), &truth);
    println!("surveyed, recentred: {:.1} dB, worst pixel {:.5}", found.db, found.worst);
    assert!(found.db > 90.0, "{found:?}");

    // For comparison: world coordinates rounded to f32.
    let rounded: Vec<Gaussian> = (splats.iter())
        .map(|splat| Gaussian { position: splat.position.map(|v| f64::from(v as f32)), ..*splat })
        .collect();
    let before = Error::of("surveyed, rounded", &exact(rounded.as_slice(), &camera, &rules), &truth);
    println!("surveyed, rounded to f32: {:.1} dB, worst pixel {:.5}", before.db, before.worst);
    assert!(before.db < 30.0, "{before:?}");

    // Without a camera file, the scene is framed, and must be visible.
    let framed = draw("", "framed.npy");
    let lit = framed.rgb.iter().filter(|pixel| (pixel[0] - 0.2).abs() > 0.05).count();
    assert!(lit > 200, "only {lit} pixels show anything");
}

#[test]
fn the_origin_of_a_scene_is_shown_and_that_of_others_is_not() {
    let place = Place::new();
    place.done("synth surveyed --count 50 -o far.ply --cameras far.json");
    let text = place.done("info far.ply -c far.json");
    let origin = text.lines().find(|line| line.contains("origin")).expect("a line");
    assert!(origin.contains("(9999360, -9999360, 9999360), subtracted from positions and cameras"), "{text}");
    let depth = text.lines().find(|line| line.contains("depth                 origin: ")).expect("a line");
    assert!(depth.contains("lost to outliers"), "the camera sees the scene: {text}");
    assert!(!place.done("info scene.ply").contains("subtracted"));
    let json = place.told("info far.ply --json");
    assert_eq!(json["report"]["place"]["offset"][0], 9_999_360.0);
}
