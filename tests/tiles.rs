//! Tile renderers, compared with images of the published CUDA rasteriser and with each other. Some lists are long, or
//! begin with too little capacity.

use crate::common::{self, EXACT_TILES, FAST_TILES, Graph, settings, with};
use crate::golden::Golden;
use crate::images::{self, bytes, draw_one, draw_scene, inspected, psnr};
use splatgraph::draw::facts::{self, SceneFacts};
use splatgraph::draw::planner::Planner;
use splatgraph::draw::session::Session;
use splatgraph::draw::truth::Truth;
use splatgraph::io::image::Image;
use splatgraph_assets::{Camera, Scene, Splat, synth};
use splatgraph_framework::ir::{DeviceFacts, Value};
use splatgraph_framework::lower;
use splatgraph_reference::Rules;
use std::sync::Arc;

const GPU: Graph = EXACT_TILES[0];
const CPU: Graph = EXACT_TILES[1];

fn least_psnr(graphs: [Graph; 2], golden: &Golden) -> f64 {
    let (scene, loaded, cameras) = (golden.name, golden.scene(), golden.cameras());
    let mut least = f64::INFINITY;
    for graph in graphs {
        let images = draw_scene(loaded.clone(), &cameras, graph.0, [0.0; 3], graph.1);
        for (i, image) in images.iter().enumerate() {
            let db = golden.compare(image, &format!("camera{i}")).psnr();
            println!("{graph:?}, {scene}, camera {i}: {db:.2} dB");
            least = least.min(db);
        }
    }
    least
}

#[test]
fn exact_tiles_agree_with_the_published_rasteriser_to_98_decibels() {
    for golden in Golden::all("exact_tiles_agree_with_the_published_rasteriser_to_98_decibels") {
        let (scene, db) = (golden.name, least_psnr(EXACT_TILES, &golden));
        // A higher bound would fail: rounding decides whether a pixel at the alpha floor blends a splat.
        assert!(db >= 98.0, "{scene}: {db:.2} dB, expected 98 or more");
    }
}

#[test]
fn fast_tiles_agree_with_the_published_rasteriser_to_75_decibels_on_captures() {
    for golden in Golden::all("fast_tiles_agree_with_the_published_rasteriser_to_75_decibels_on_captures") {
        let (scene, db) = (golden.name, least_psnr(FAST_TILES, &golden));
        let bound = if scene == "rules" { 57.0 } else { 75.0 };
        assert!(db >= bound, "{scene}: {db:.2} dB, expected {bound} or more");
    }
}

fn demo(splats: u32, size: (u32, u32)) -> (Arc<Scene>, Vec<Camera>) {
    let scene = Arc::new(synth::generate("demo", splats, 0).expect("a scene"));
    let cameras = synth::demo_cameras().into_iter().take(2).map(|camera| camera.resized(size.0, size.1));
    (scene, cameras.collect())
}

/// Opens a session whose plans share a device, and returns it with its cameras.
fn bench() -> (Session, Vec<Camera>) {
    let (scene, cameras) = demo(20_000, (400, 225));
    (images::session(scene, GPU.0, &[]), cameras)
}

fn drawn(bench: &mut (Session, Vec<Camera>), graph: Graph, more: &[(&str, &str)]) -> Vec<Image> {
    let (session, cameras) = bench;
    session.set_graph(graph.0, &settings(&with(graph, more)));
    cameras.iter().map(|camera| images::picture(session, camera, [0.1, 0.2, 0.3])).collect()
}

fn drawn_bytes(bench: &mut (Session, Vec<Camera>), graph: Graph, more: &[(&str, &str)]) -> Vec<Vec<u32>> {
    drawn(bench, graph, more).iter().map(bytes).collect()
}

fn assert_close(what: &str, found: &Image, expected: &Image, bound: f64) {
    let db = psnr(found, expected);
    println!("{what}: {db:.1} dB");
    assert!(db >= bound, "{what}: {db:.1} dB, expected {bound} or more");
}

fn assert_all_close(what: &str, found: &[Image], expected: &[Image], bound: f64) {
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert_close(&format!("{what}, camera {i}"), found, expected, bound);
    }
}

#[test]
fn every_variant_of_tiles_draws_the_same_picture() {
    let mut bench = bench();
    let expected = drawn(&mut bench, CPU, &[]);
    // Segments, sorters and digit widths change only the rounding of sums.
    for (graph, set) in [
        (GPU, &[][..]),
        (GPU, &[("sorted", "splats")]),
        (GPU, &[("segment", "64"), ("entries", "100000")]),
        (GPU, &[("sorter", "subgroup")]),
        (GPU, &[("digit_bits", "5")]),
        (CPU, &[("sorter", "subgroup")]),
    ] {
        assert_all_close(&format!("{} {set:?}", graph.0), &drawn(&mut bench, graph, set), &expected, 75.0);
    }
    // These differ more: in the records, or in the splat at which blending stops.
    for (graph, set) in [
        (GPU, ("record", "packed")),
        (GPU, ("stop_after", "chunk")),
        (CPU, ("record", "packed")),
        (CPU, ("stop_after", "chunk")),
    ] {
        assert_all_close(&format!("{} {set:?}", graph.0), &drawn(&mut bench, graph, &[set]), &expected, 65.0);
    }
    images::close(bench.0, "variants");
}

#[test]
fn the_height_of_bins_changes_no_byte_of_an_exact_picture() {
    // Splats wrap around the edges of a panorama: the columns of their bins have fewer bits if bins are halved.
    let mut bench = bench();
    for projection in ["pinhole", "equirectangular"] {
        let [high, low] = ["0", "1"].map(|halvings| {
            drawn_bytes(&mut bench, GPU, &[("bin_halvings", halvings), ("projection", projection)])
        });
        assert!(high == low, "{projection}");
    }
    images::close(bench.0, "bins");
}

#[test]
fn the_digit_width_changes_every_sort_of_tiles_and_no_byte_of_the_picture() {
    let (scene, cameras) = demo(5000, (200, 113));
    // One device: its plans share the pipelines of passes without a digit width.
    let mut session = images::session(scene, GPU.0, &[]);
    let mut drawn = |graph: Graph, set: &[(&str, &str)]| {
        bytes(&images::drawn(&mut session, &cameras[0], graph.0, &with(graph, set)))
    };
    for graph in [FAST_TILES[0], FAST_TILES[1], GPU] {
        for sorter in ["subgroup", "serial"] {
            let expected = drawn(graph, &[("sorter", sorter)]);
            for width in ["1", "4", "8", "11"] {
                let found = drawn(graph, &[("sorter", sorter), ("digit_bits", width)]);
                assert!(
                    found == expected,
                    "{graph:?}, {sorter}: digits of {width} bits draw another picture"
                );
            }
        }
    }
    images::close(session, "digit widths");
}

/// Returns parameters that sort pairs with the subgroup sorter, by `bits` bits of bin and depth.
fn by_pairs(bits: &'static str) -> [(&'static str, &'static str); 3] {
    [("sorter", "subgroup"), ("sorted", "pairs"), ("pair_bits", bits)]
}

/// Draws a frame; returns its bytes, and true if the plan's passes sort the splats themselves.
fn drawn_by_splats(session: &mut Session, camera: &Camera, set: &[(&str, &str)]) -> (Vec<u32>, bool) {
    let picture = images::drawn(session, camera, GPU.0, &with(GPU, set));
    let plan = session.plan().expect("a plan");
    (bytes(&picture), plan.passes.iter().any(|pass| pass.name == "bins.count_pairs"))
}

#[test]
fn pairs_that_the_radix_sort_leaves_tied_are_ordered_as_exactly_as_splats() {
    let (mut session, cameras) = bench();
    for camera in &cameras {
        let (expected, _) =
            drawn_by_splats(&mut session, camera, &[("sorter", "subgroup"), ("sorted", "splats")]);
        // 28-bit keys are scaled up to the full range, which must not merge depths.
        for (bits, key_bits) in [("32", "32"), ("24", "32"), ("20", "32"), ("24", "28")] {
            let set = [&by_pairs(bits)[..], &[("key_bits", key_bits)]].concat();
            let (found, by_splats) = drawn_by_splats(&mut session, camera, &set);
            assert!(!by_splats, "{bits} of {key_bits} bits: splats were sorted");
            assert!(
                found == expected,
                "pairs sorted by {bits} of {key_bits} bits are blended in another order"
            );
        }
    }
    images::close(session, "tied pairs");
}

#[test]
fn splats_are_sorted_where_pairs_need_an_order_that_a_sort_of_pairs_does_not_give() {
    let (mut session, cameras) = bench();
    let mut drawn = |set: &[(&str, &str)]| drawn_by_splats(&mut session, &cameras[0], set);
    let mut sorts_splats = |set: &[(&str, &str)]| {
        let (found, sorts_splats) = drawn(set);
        let (expected, _) = drawn(&[set, &[("sorted", "splats")]].concat());
        assert!(found == expected, "{set:?}: pairs are blended in another order than splats");
        sorts_splats
    };
    assert!(!sorts_splats(&by_pairs("20")));
    assert!(sorts_splats(&by_pairs("16")), "9 bits of depth leave long runs of tied pairs");
    assert!(sorts_splats(&[&by_pairs("16")[..], &[("entries", "100")]].concat()), "and too few entries");
    assert!(sorts_splats(&[("key_bits", "10")]), "keys too narrow for the scene");
    assert!(sorts_splats(&[("key_map", "equalised")]), "keys that depend on all depths");
    // The budget has no effect on pairs, and must have none after a frame with tied pairs.
    let budget = [&by_pairs("16")[..], &[("budget", "0.5")]].concat();
    assert!(drawn(&budget) == drawn(&by_pairs("16")), "tied pairs let the budget take effect");
    images::close(session, "orders");
}

#[test]
fn a_run_of_128_pairs_is_ordered_and_for_one_of_129_splats_are_sorted() {
    let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (64, 48));
    // Ordered from far to near in the file. Splat 0 is far behind and stretches the depth range, so that all others
    // share one class of 14 depth bits.
    let scene = |run: usize| {
        let splat = |at: usize| Splat {
            position: if at == 0 { [0.0, 0.0, 100.0] } else { [-0.25, -0.2, 1.0 + 2e-6 * (run - at) as f32] },
            scale: [0.02; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity: 0.05,
            sh: std::array::from_fn(|i| if i == at % 3 { 1.0 } else { 0.0 }),
        };
        Arc::new(Scene::generate(run as u32 + 1, 0, splat))
    };
    let sorted = [("sorter", "subgroup"), ("sorted", "splats")];
    let mut session = images::session(scene(1), GPU.0, &[]);
    for (run, sorts_splats) in [(128, false), (129, true)] {
        session.set_scene(scene(run));
        let (found, by_splats) = drawn_by_splats(&mut session, &camera, &by_pairs("16"));
        let (expected, _) = drawn_by_splats(&mut session, &camera, &sorted);
        assert!(found == expected, "{run} pairs are blended in another order");
        assert_eq!(by_splats, sorts_splats, "{run} pairs");
    }
    images::close(session, "runs of pairs");
}

#[test]
fn splats_of_equal_depth_keep_the_order_of_the_file_wherever_the_projection_writes_their_pairs() {
    // Splats at the same place, in three colours: their order decides the colour.
    let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (64, 48));
    let splat = |at: usize| Splat {
        position: [0.0, 0.0, 2.0],
        scale: [2.0, 2.0, 0.01],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 0.1,
        sh: std::array::from_fn(|i| if i == at % 3 { 1.0 } else { 0.0 }),
    };
    // More than a workgroup of 256, with invisible splats between those that are seen.
    let hidden = |at: usize| Splat { position: [0.0, 0.0, -2.0], ..splat(at) };
    let scene = Arc::new(Scene::generate(3000, 0, |at| if at % 50 == 0 { splat(at) } else { hidden(at) }));
    let mut session = images::session(scene, GPU.0, &[]);
    let (expected, _) = drawn_by_splats(&mut session, &camera, &[("sorted", "splats")]);
    for run in 0..3 {
        let (found, by_splats) = drawn_by_splats(&mut session, &camera, &[]);
        assert!(!by_splats && found == expected, "run {run}: equal depths are blended in another order");
    }
    images::close(session, "equal depths");
}

/// Returns splats spread over a picture in many orientations, and the picture's camera.
///
/// Splats cycle through `scales`. `colour` maps a number from 0 to 1 to a coefficient.
fn scattered(count: u32, scales: &[[f32; 3]], colour: impl Fn(f32) -> f32 + Sync) -> (Arc<Scene>, Camera) {
    // Multiples of irrational numbers, modulo 1, spread positions and orientations evenly.
    let share = |at: usize, step: f64| (at as f64 * step).fract() as f32;
    let scene = Scene::generate(count, 0, |at| {
        let [x, y, z] = [share(at, 0.618_034) - 0.5, share(at, 0.754_877_7) - 0.5, share(at, 0.569_840_3)];
        let turn = std::f32::consts::TAU * share(at, 0.324_717_9);
        Splat {
            position: [4.0 * x, 2.0 * y, 2.0 + 2.0 * z],
            scale: scales[at % scales.len()],
            rotation: [(turn / 2.0).cos(), 0.0, 0.0, (turn / 2.0).sin()],
            opacity: 0.9,
            sh: std::array::from_fn(|i| {
                if i < 3 { colour(share(at, 0.445_041_9 * (i + 1) as f64)) } else { 0.0 }
            }),
        }
    });
    (Arc::new(scene), Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (160, 90)))
}

#[test]
fn needles_far_narrower_than_a_pixel_are_no_brighter_than_their_colour_in_serial_tiles() {
    let (scene, camera) = scattered(1000, &[[0.3, 1e-6, 1e-6]], |_| 1.0);
    let draw =
        |graph: Graph| draw_one(scene.clone(), &camera, graph.0, &with(graph, &[("low_pass", "none")]));
    let [cells, serial] = EXACT_TILES.map(draw);
    assert_close("needles", &serial, &cells, 60.0);
    let least = serial.rgb.iter().flatten().copied().fold(f32::INFINITY, f32::min);
    assert!(least >= 0.0, "a colour of {least}");
}

#[test]
fn a_falloff_by_products_is_that_by_powers_of_2() {
    let point = [1e-6; 3];
    let needle = [0.3, 1e-6, 1e-6];
    let plate = [0.1, 0.02, 1e-6];
    let (scene, camera) =
        scattered(100, &[point, needle, plate, [0.05; 3], [0.2, 0.1, 0.02]], |share| 3.0 * share - 1.5);
    for low_pass in ["dilated", "compensated"] {
        // The lowest alpha floor, so that faint alphas count. Order, early stop and records are the same in both
        // graphs.
        let rules = [("low_pass", low_pass), ("alpha_floor", "0.001"), ("stop", "0"), ("key_bits", "32")];
        let draw = |name: &str, more: &[(&str, &str)]| {
            draw_one(scene.clone(), &camera, name, &[&rules[..], more].concat())
        };
        let (powers, products) = (draw("tiled", &[("sorted", "splats")]), draw("tiled_cpu", &[]));
        assert_close(low_pass, &products, &powers, 110.0);
    }
    if common::lanes_are_usual() {
        common::again_with_vectors_of(128, "tiles::a_falloff_by_products_is_that_by_powers_of_2");
    }
}

#[test]
fn pictures_wider_than_256_bins_have_larger_ones() {
    let scene = Arc::new(synth::generate("demo", 3000, 0).expect("a scene"));
    let camera = synth::demo_cameras().swap_remove(0).resized(8200, 40);
    let truth = Truth::draw(&scene, &camera, [0.0; 3], &Rules::PUBLISHED).unwrap().image();
    for graph in EXACT_TILES {
        let image = draw_one(scene.clone(), &camera, graph.0, graph.1);
        assert_close(graph.0, &image, &truth, 95.0);
    }
}

/// Plans `tiled`, with an extra output if `output` names one. Returns the segment length, `SEGMENT_ENTRIES`.
fn segment(device: DeviceFacts, size: (u32, u32), output: Option<&str>, set: &[(&str, &str)]) -> String {
    let mut facts = facts::facts(&SceneFacts::NOMINAL, &device, size);
    facts.host.extend(output.map(|name| (format!("outputs.{name}"), Value::Bool(true))));
    let set: Vec<_> = set.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect();
    let plan = Planner::default().plan("tiled", &set, &facts, &common::catalog());
    let plan = plan.unwrap_or_else(|errors| panic!("{errors}"));
    let mut defines = plan.shaders.iter().flat_map(|shader| &shader.defines);
    defines.find(|(name, _)| name == "SEGMENT_ENTRIES").expect("a shader of segments").1.clone()
}

#[test]
fn segments_are_longer_than_asked_where_the_device_has_no_buffer_for_the_sums_of_so_many() {
    let device = |max_storage_bytes| DeviceFacts { max_storage_bytes, ..facts::portable_device(32) };
    let set = [("segment", "256"), ("entries", "14000000")];
    let of = |mib: u64, output| segment(device(mib << 20), (4096, 4096), output, &set);
    assert_eq!([2048, 1024, 512].map(|mib| of(mib, None)), ["256", "256", "285"]);
    assert_eq!([2048, 1024, 512].map(|mib| of(mib, Some("index"))), ["256", "513", "1282"]);
}

/// Plans long segments at several subgroup sizes. Narrow subgroups have shorter segments, because lavapipe ends long
/// loops.
#[test]
fn segments_are_as_long_as_asked_on_subgroups_of_32_lanes() {
    let of = |lanes| {
        let device = DeviceFacts { shared_bytes: 32 << 10, ..facts::portable_device(lanes) };
        segment(device, (8200, 40), None, &[("segment", "16384")])
    };
    assert_eq!([8, 16, 32, 64].map(of), ["7168", "7168", "16384", "16384"]);
}

#[test]
fn pictures_whose_bins_need_more_shared_memory_than_the_device_has_are_drawn_in_quads() {
    let graph = |kib: u32, width| {
        let limits = facts::portable_device(32);
        let device = DeviceFacts { shared_bytes: kib << 10, max_image_size: 1 << 15, ..limits };
        let facts = facts::facts(&SceneFacts::NOMINAL, &device, (width, 40));
        let set = [("record".to_string(), "f32".to_string())];
        let mut planner = Planner::default();
        let choice = planner
            .ask(("auto", &[]), &facts, &common::catalog(), lower::standing)
            .unwrap_or_else(|errors| panic!("{errors}"));
        if choice.fallbacks.is_empty() {
            let plan = planner.plan("auto", &set, &facts, &common::catalog());
            plan.unwrap_or_else(|errors| panic!("{errors}"));
        }
        choice.fallbacks.len()
    };
    let widths = [8192, 8193, 16384, 16385];
    assert_eq!(widths.map(|width| graph(16, width)), [0, 2, 2, 2]);
    assert_eq!(widths.map(|width| graph(32, width)), [0, 0, 0, 2]);
    assert_eq!(widths.map(|width| graph(48, width)), [0; 4]);
}

#[test]
fn tiles_are_right_on_subgroups_of_4_8_and_16() {
    let scene = Arc::new(synth::generate("demo", 3000, 0).expect("a scene"));
    let camera = synth::demo_cameras().swap_remove(0).resized(160, 90);
    let truth = Truth::draw(&scene, &camera, [0.0; 3], &Rules::PUBLISHED).unwrap().image();
    for graph in EXACT_TILES {
        let image = draw_one(scene.clone(), &camera, graph.0, graph.1);
        assert_close(graph.0, &image, &truth, 95.0);
    }
    if common::lanes_are_usual() {
        for bits in [128, 512] {
            common::again_with_vectors_of(bits, "tiles::tiles_are_right_on_subgroups_of_4_8_and_16");
        }
    }
}

#[test]
fn a_long_list_is_left_to_the_deep_pass_once_where_workgroups_fill_several_rows() {
    // 8,000 splats near the upper left corner of a picture that takes three rows of workgroups on devices with the
    // minimum limit in x.
    let scene = Scene::generate(8000, 0, |at| Splat {
        position: [-0.999, -0.999, 1.0 + at as f32 * 1e-6],
        scale: [1e-6; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 0.5,
        sh: [0.0; 48],
    });
    let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 90.0, (4097, 4096));
    let deep = inspected(scene, &camera, "tiled_cpu", &[], "deep@rasterise");
    let [x, y, z, tiles] =
        [0, 4, 8, 12].map(|at| u32::from_le_bytes(*deep[at..].first_chunk().expect("a word")));
    // Lists belong to bins, and this bin has four tiles.
    assert_eq!((x, y, z, tiles), (4, 4, 1, 4), "blocks, and the tiles that are left: in y, in z and in all");
}

#[test]
fn fast_tiles_give_the_same_bytes_in_every_run() {
    let mut bench = bench();
    for graph in FAST_TILES {
        let mut run = || drawn_bytes(&mut bench, graph, &[]);
        assert!(run() == run(), "{graph:?}: two runs differ");
    }
    images::close(bench.0, "two runs");
}

#[test]
fn lists_without_room_grow_until_the_picture_is_whole() {
    let mut bench = bench();
    for graph in EXACT_TILES {
        let mut with = |entries| drawn_bytes(&mut bench, graph, &[("entries", entries)]);
        assert!(with("1000000") == with("100"), "{graph:?}: the picture depends on the room at first");
    }
    images::close(bench.0, "lists without room");
}

/// Draws lists far longer than a segment. Faint small splats cover the whole picture at nearly equal depths, so that no
/// pixel stops early.
#[test]
fn long_lists_are_blended_to_their_end() {
    const COUNT: usize = 90_000;
    let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (64, 36));
    let sample = synth::generate("demo", 1, 0).expect("a scene").splat(0);
    let scene = Arc::new(Scene::generate(COUNT as u32, 0, |i| {
        let depth = 2.0 + i as f32 * 1e-5;
        // Visits every pixel, in an order unrelated to depth.
        let at = (i * 7919) % (64 * 36);
        let [x, y] = [(at % 64) as f32 / 64.0 - 0.5, (at / 64) as f32 / 64.0 - 36.0 / 128.0];
        Splat {
            position: [x * depth * 1.15, y * depth * 1.15, depth],
            scale: [0.01; 3],
            opacity: 0.02,
            sh: std::array::from_fn(|k| if i > COUNT / 2 { [1.0, 0.2, -0.5][k % 3] } else { 0.0 }),
            ..sample
        }
    }));
    let truth = Truth::draw(&scene, &camera, [0.0; 3], &Rules::PUBLISHED).unwrap().image();
    for graph in EXACT_TILES.into_iter().chain(FAST_TILES) {
        let image = draw_one(scene.clone(), &camera, graph.0, graph.1);
        assert_close(&format!("{graph:?}"), &image, &truth, 60.0);
    }
}
