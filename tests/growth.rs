//! Graphs with growing parameters: a list that is too small at first grows until the picture is complete.

use crate::images;
use crate::place::Place;
use splatgraph::draw::session::{FrameOptions, image_of};
use splatgraph::io::image::Image;
use splatgraph_assets::{Camera, synth};
use std::fs;
use std::path::Path;

const GRAPH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/graphs/growing/graph.ron");

const SUMS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/graphs/growing/sums.ron");

fn white(image: &Image) -> usize {
    image.rgb.iter().filter(|pixel| **pixel == [1.0; 3]).count()
}

#[test]
fn every_frame_of_a_session_is_whole_also_those_in_flight() {
    let scene = synth::generate("demo", 10, 0).expect("a scene");
    let camera = Camera::framing(&scene, 61, 33);
    let mut session = images::session(scene, GRAPH, &[]);
    let request = FrameOptions { read_output: true, ..FrameOptions::default() };
    for (size, entries) in [((61, 33), 2516), ((64, 40), 3200), ((8, 8), 3200)] {
        let camera = camera.resized(size.0, size.1);
        session.prepare(size, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
        let frames = [(); 2].map(|()| session.submit(&camera, &request).expect("submitted"));
        for frame in frames {
            let result = session.wait(frame).unwrap_or_else(|error| panic!("{error}"));
            let image = image_of(&result.output.expect("asked for")).expect("colours");
            assert_eq!(white(&image), (size.0 * size.1) as usize, "{size:?}");
        }
        let value = &session.plan().expect("a plan").params[0].value;
        assert_eq!(value.to_string(), entries.to_string(), "the need and a quarter");
    }
    assert_eq!(session.growths(), 2);
    images::close(session, GRAPH);
}

#[test]
fn a_frame_that_is_drawn_again_is_in_a_history_once_and_one_that_cannot_be_drawn_is_not() {
    let scene = synth::generate("demo", 10, 0).expect("a scene");
    let camera = Camera::framing(&scene, 61, 33);
    let mut session = images::session(scene, SUMS, &[]);
    let request = FrameOptions { read_output: true, ..FrameOptions::default() };
    // The word's history continues with another size, and the image's starts anew.
    let mut total = 0;
    for size in [(61, 33), (80, 60), (64, 40)] {
        let camera = camera.resized(size.0, size.1);
        session.prepare(size, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
        // More frames than a device has in flight.
        let frames = [(); 3].map(|()| session.submit(&camera, &request).expect("submitted"));
        for (frame, shade) in frames.into_iter().zip([0.25, 0.5, 0.75]) {
            let result = match (session.wait(frame), size) {
                (Err(error), (80, 60)) => {
                    assert!(error.to_string().contains("found one that needs 4800"), "{error}");
                    continue;
                }
                (result, _) => result.unwrap_or_else(|error| panic!("{error}")),
            };
            total += size.0 * size.1;
            assert_eq!(result.stats[1], ("total".to_owned(), total), "{size:?}");
            let image = image_of(&result.output.expect("asked for")).expect("colours");
            assert!(image.rgb.iter().all(|pixel| *pixel == [shade; 3]), "{size:?}: {:?}", image.rgb[0]);
        }
    }
    assert_eq!(session.growths(), 2);
    images::close(session, SUMS);
}

#[test]
fn what_a_once_pass_starts_and_frames_change_is_state_with_or_without_a_history() {
    for history in ["", ", history: true"] {
        let place = Place::new();
        place.cameras(&["one", "two", "three"]);
        let folder = Path::new(SUMS).parent().expect("a folder");
        for name in ["steps.ron", "seed.comp", "step.comp", "show.comp"] {
            fs::copy(folder.join(name), place.at(name)).expect("copied");
        }
        for resource in
            ["\"count\": Buffer(stride: 4, count: 1", "\"trail\": Image(format: \"r32f\", size: (1, 1)"]
        {
            place.edit("steps.ron", resource, &format!("{resource}{history}"));
        }
        let counts = |more: &str| {
            place.done(&format!("render scene.ply -p steps.ron --json=out.json {more}"));
            let stats = place.json("out.json");
            stats
                .as_array()
                .expect("a list")
                .iter()
                .map(|stats| stats["counts"]["count"].clone())
                .collect::<Vec<_>>()
        };
        assert_eq!(counts("--size 8x8 --repeat 3"), [8], "no warm-up");
        // A list that grows does not start it again.
        for room in [100, 13] {
            assert_eq!(counts(&format!("-c cameras.json -o out/ --set room={room}")), [6, 7, 8], "{room}");
            let colours = ["one", "two", "three"].map(|name| place.image(&format!("out/{name}.png")).rgb[0]);
            assert_eq!(
                colours,
                [6.0, 7.0, 8.0].map(|steps: f32| [steps / 255.0, steps / 255.0, 0.0]),
                "{room}"
            );
        }
        let told = place.fails("render scene.ply -p steps.ron -c cameras.json -o shards --shard 0/3", 2);
        assert!(told.contains("`steps.ron`, whose frames depend on those before them"), "{told}");
        // Views do not depend on each other.
        place.done("synth --photograph scene.ply --dataset views --views 2 --size 32x24");
        let (_, notes) = place.said("evaluate scene.ply -c views --all -p steps.ron -o scores");
        assert!(notes.contains("frame 2 of each view is scored"), "{notes}");
        let drawn: Vec<_> = place.files("scores/renders").into_values().collect();
        assert!(drawn.len() == 2 && drawn[0] == drawn[1]);
    }
}

#[test]
fn a_picture_on_disk_is_whole_or_not_there() {
    let place = Place::new();
    let render = format!("render scene.ply --pipeline {GRAPH} -o out.png --json=out.json");
    place.done(&format!("{render} --size 64x48 --repeat 5 --set entries=7 --inspect list@list=list.npy"));
    assert_eq!(white(&place.image("out.png")), 64 * 48);
    let stats = place.json("out.json");
    assert_eq!(stats[0]["parameters"]["entries"], 3840, "{stats}");
    assert_eq!((&stats[0]["counts"]["entries_needed"], &stats[0]["frames"]), (&3072.into(), &5.into()));
    assert_eq!(stats[0]["inspected"][0]["shape"][0], 3840, "{stats}");
    for name in ["out.png", "out.json", "list.npy"] {
        fs::remove_file(place.at(name)).expect("it was written");
    }
    for why in ["needs at most 4096 entries", "found one that needs 4800"] {
        place.refuses(&render, &[("--size 80x60", 1, why)]);
    }
}
