//! The tile renderer for CPUs, compared with the tile renderer for GPUs and with quads. Lists need more than one pass
//! of the rasteriser.

use crate::common;
use crate::images::psnr;
use crate::place::Place;
use splatgraph::draw::facts::{self, SceneFacts};
use splatgraph::draw::planner::Planner;

const TEST: &str = "serial_tiles::serial_tiles_draw_a_stack_deeper_than_one_pass_like_the_other_renderers";

#[test]
fn serial_tiles_draw_a_stack_deeper_than_one_pass_like_the_other_renderers() {
    let place = Place::empty();
    place.done("synth layers-faint --count 12000 -o stack.ply --cameras stack.json");
    let draw = |name: &str, set: &str| {
        place.done(&format!("render stack.ply -c stack.json#0 --size 64x48 -o {name} {set}"));
        place.image(name)
    };
    let tiles = |graph: common::Graph, more: &[(&str, &str)]| {
        let set = common::with(graph, more);
        let set: String = set.iter().map(|(name, value)| format!(" --set={name}={value}")).collect();
        draw("tiles.npy", &format!("--pipeline {} --validate{set}", graph.0))
    };
    let [cells, serial] = common::EXACT_TILES.map(|graph| tiles(graph, &[("stop", "0")]));
    let quads = draw("quads.npy", "--pipeline splat --set target=rgba32f");
    for (name, other) in [("cells", cells), ("quads", quads)] {
        let db = psnr(&serial, &other);
        assert!(db > 80.0, "{name}: {db:.1} dB");
    }
    let [cells, serial] = common::FAST_TILES;
    let (cells, serial) =
        (tiles(cells, &[("stop", "0"), ("sorted", "splats")]), tiles(serial, &[("stop", "0")]));
    let db = psnr(&serial, &cells);
    assert!(db > 80.0, "packed: {db:.1} dB");
}

#[test]
fn serial_tiles_draw_the_same_stack_with_subgroups_of_4_lanes() {
    common::again_with_vectors_of(128, TEST);
}

#[test]
fn serial_tiles_draw_the_same_stack_with_subgroups_of_16_lanes() {
    common::again_with_vectors_of(512, TEST);
}

/// Plans a picture of 256 x 256 bins. The table has a word for each bin and block of pairs.
#[test]
fn serial_tiles_of_a_large_picture_have_a_plan_on_the_least_capable_device() {
    let facts = facts::facts(&SceneFacts::NOMINAL, &facts::portable_device(8), (4096, 4096));
    let set = [("entries".to_string(), "29000000".to_string())];
    let plan = Planner::default().plan("tiled_cpu", &set, &facts, &common::catalog());
    plan.unwrap_or_else(|errors| panic!("{errors}"));
}

#[test]
fn the_lists_of_serial_tiles_hold_at_most_what_the_device_can_bind() {
    let (facts, catalog) = (common::facts_of(&facts::portable_device(4)), common::catalog());
    let plan = |entries: &str| {
        let set = [("entries".to_string(), entries.to_string())];
        Planner::default().plan("tiled_cpu", &set, &facts, &catalog)
    };
    assert!(plan("33554432").is_ok(), "128 MiB");
    let error = plan("33554433").expect_err("more than 128 MiB").to_string();
    assert!(error.contains("33554433 is not in 1 to 33554432"), "{error}");
}
