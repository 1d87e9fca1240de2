//! The tiles for CPUs compared with those for GPUs and with quads, for lists longer than one rasteriser pass.

use splatgraph::io::image::Image;
use splatgraph::studies::metrics;

use crate::common;
use crate::files::Place;

#[test]
fn serial_tiles_draw_a_stack_deeper_than_one_pass_like_the_other_renderers() {
    let place = Place::new();
    let run = |args: &[&str]| {
        let (code, errors) = place.code(args);
        assert_eq!(code, Some(0), "{args:?}: {errors}");
    };
    run(&["synth", "layers-faint", "--count", "12000", "-o", "stack.ply", "--cameras", "stack.json"]);
    let draw = |name: &str, set: &[&str]| {
        run(&[&["render", "stack.ply", "-c", "stack.json#0", "--size", "64x48", "-o", name], set].concat());
        Image::load(&place.at(name)).expect("a picture")
    };
    let tiles = |graph: common::Graph, more: &[(&str, &str)]| {
        let set = common::with(graph, more);
        let set: Vec<String> = set.iter().map(|(name, value)| format!("--set={name}={value}")).collect();
        let set = set.iter().map(String::as_str);
        let args: Vec<&str> = ["--pipeline", graph.0, "--validate"].into_iter().chain(set).collect();
        draw("tiles.npy", &args)
    };
    let [cells, serial] = common::EXACT_TILES.map(|graph| tiles(graph, &[("stop", "0")]));
    let quads = draw("quads.npy", &["--pipeline", "splat", "--set", "target=rgba32f"]);
    for (name, other) in [("cells", cells), ("quads", quads)] {
        let found = metrics::compare(&serial, &other).expect("of one size");
        assert!(found.psnr() > 80.0, "{name}: {found:?}");
    }
    let [cells, serial] = common::FAST_TILES;
    let (cells, serial) =
        (tiles(cells, &[("stop", "0"), ("sorted", "splats")]), tiles(serial, &[("stop", "0")]));
    let found = metrics::compare(&serial, &cells).expect("of one size");
    assert!(found.psnr() > 80.0, "packed: {found:?}");
}

#[test]
fn serial_tiles_draw_the_same_stack_with_subgroups_of_4_lanes() {
    common::again_with_vectors_of(
        128,
        "serial_tiles::serial_tiles_draw_a_stack_deeper_than_one_pass_like_the_other_renderers",
    );
}

#[test]
fn serial_tiles_draw_the_same_stack_with_subgroups_of_16_lanes() {
    common::again_with_vectors_of(
        512,
        "serial_tiles::serial_tiles_draw_a_stack_deeper_than_one_pass_like_the_other_renderers",
    );
}
