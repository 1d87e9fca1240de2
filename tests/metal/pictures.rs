//! The kernels that draw: both tile renderers, and the quads up to their draw, which is skipped.

use super::clang::Library;
use super::cpu::Cpu;
use super::parity::{Loose, compare};
use super::{alone, at_every_width_of_lavapipe, lavapipe, shaders, translated};
use crate::common::{self, Upload, settings};
use splatgraph::draw::camera;
use splatgraph::draw::facts::{self, SceneFacts};
use splatgraph::draw::planner::Planner;
use splatgraph_api::{Device, FrameInputs};
use splatgraph_assets::{Camera, Scene, Splat, synth};
use splatgraph_framework::ir::DeviceFacts;
use splatgraph_framework::plan::Plan;
use std::path::Path;

const SIZE: (u32, u32) = (160, 90);

/// A small scene, its camera, and a planner whose plans do not alias resources.
struct Stage {
    scene: Scene,
    camera: Camera,
    planner: Planner,
}

impl Stage {
    fn new() -> Stage {
        let demo = synth::generate("demo", 2_000, 0).expect("a scene");
        // Every 32nd splat is at the same place, in one of three colours: their order in the file decides the colour.
        let scene = Scene::generate(2_000, demo.stored_degree(), |at| match at % 32 {
            0 => Splat {
                opacity: 0.3,
                sh: std::array::from_fn(|i| if i == at / 32 % 3 { 1.0 } else { 0.0 }),
                ..demo.splat(0)
            },
            _ => demo.splat(at),
        });
        let camera = synth::demo_cameras().swap_remove(0).resized(SIZE.0, SIZE.1);
        let mut planner = Planner::default();
        planner.share_memory = false;
        Stage { scene, camera, planner }
    }

    fn plan(&mut self, graph: &str, set: &[(&str, &str)], device: &DeviceFacts) -> Plan {
        let facts = facts::facts(&SceneFacts::of(&self.scene), device, SIZE);
        let plan = self.planner.plan(graph, &settings(set), &facts, &facts::catalog(&self.scene));
        translated(plan.unwrap_or_else(|error| panic!("{graph}, {set:?}: {error}")))
    }

    fn planes(&self) -> Upload<'_> {
        Upload(&self.scene, 1)
    }

    fn inputs(&self, plan: &Plan) -> FrameInputs {
        FrameInputs {
            uniforms: camera::frame_uniforms(&self.camera, &self.scene.bounds(), [0.1, 0.2, 0.3], 0),
            live: plan.live_bytes(),
            ..FrameInputs::default()
        }
    }

    /// Executes a plan on the CPU, up to its draw if it has one. Returns the bytes of its output, or of the draw's
    /// inputs.
    fn run(&self, plan: &Plan, library: &Library, reversed: bool) -> Vec<u8> {
        let mut cpu = Cpu::new(plan, library, &self.planes(), &self.inputs(plan));
        for id in plan.order() {
            let pass = plan.pass(id);
            let ran = cpu.run(id, reversed).unwrap_or_else(|error| panic!("{}: {error}", pass.name));
            if !ran {
                // `Args` contains the number of sort blocks, which depends on the device.
                let drawn = pass.bindings.iter().filter(|bound| bound.name != "Args");
                return drawn.flat_map(|bound| cpu.bytes(bound.resource).to_vec()).collect();
            }
        }
        cpu.bytes(plan.output).to_vec()
    }
}

/// Graphs that together use the kernels for GPUs and for CPUs, with many forms of their parameters.
const GRAPHS: [(&str, &[(&str, &str)]); 9] = [
    ("tiled", &[SUBGROUP, ROOM]),
    ("tiled", &[SUBGROUP, ROOM, ("segment", "64"), ("pair_bits", "18")]),
    ("tiled_cpu", &[ROOM, ("sh_storage", "q8"), ("position_storage", "fixed16")]),
    (
        "tiled",
        &[
            SUBGROUP,
            ROOM,
            ("record", "f32"),
            ("extent", "tiles"),
            ("sorted", "splats"),
            ("segment", "16384"),
            ("stop_after", "splat"),
        ],
    ),
    (
        "tiled_cpu",
        &[
            ROOM,
            ("record", "f32"),
            ("extent", "tiles"),
            ("stop_after", "splat"),
            ("key_map", "equalised"),
            ("key_bits", "20"),
        ],
    ),
    ("splat", &[SUBGROUP, ("covariance", "factored"), ("key_map", "linear"), ("key_bits", "16")]),
    (
        "splat",
        &[
            SUBGROUP,
            ("covariance", "half"),
            ("key_map", "logarithmic"),
            ("key_bits", "16"),
            ("target", "rgba8"),
        ],
    ),
    ("splat", &[SUBGROUP, ("low_pass", "compensated"), ("cull_margin", "0.1"), ("key_map", "equalised")]),
    ("splat", &[("low_pass", "none"), ("target", "rgba16f"), ("digit_bits", "11")]),
];
const SUBGROUP: (&str, &str) = ("sorter", "subgroup");
const ROOM: (&str, &str) = ("entries", "20000");

/// Tolerances for the effect of exp2(), log2() and log(), which lavapipe and the C library round differently.
const POWERS: [Loose; 4] = [
    // The reach of a splat is the square root of a logarithm.
    Loose { resource: "splats", words: (8, &[6]), halves: false, by: 1e-6 },
    // The logarithm of the opacity, in both forms of a record.
    Loose { resource: "splats.records", words: (4, &[1]), halves: false, by: 1e-6 },
    // Sums of colours times opacities, which are powers. Half floats near 1 are 5e-4 apart.
    Loose { resource: "sums", words: (1, &[0]), halves: true, by: 1e-3 },
    Loose { resource: "final", words: (1, &[0]), halves: false, by: 1e-5 },
];

/// Compares the plans of `graphs` with lavapipe. `folder` is put before the graphs' names; if empty, they are built-in.
/// If `loose` has tolerances, each plan must need them.
fn compare_all(folder: &str, graphs: &[(&str, &[(&str, &str)])], loose: &[Loose]) {
    let (mut stage, mut device) = (Stage::new(), lavapipe());
    // Metal has no doubles, so its kernels use fma(). Lavapipe's fma() and the header's both round the product.
    let facts = DeviceFacts { fused_fma: true, ..device.info().facts };
    let plans: Vec<Plan> =
        graphs.iter().map(|(graph, set)| stage.plan(&format!("{folder}{graph}"), set, &facts)).collect();
    let library = Library::new(&shaders(&plans));
    for (plan, (graph, set)) in std::iter::zip(&plans, graphs) {
        let found = compare(&mut device, &library, plan, &stage.planes(), &stage.inputs(plan), loose);
        println!(
            "{graph}, {set:?}: {} kernels, {} words equal, {} near",
            found.kernels, found.equal, found.near
        );
        // A tolerance must be needed.
        assert_eq!(found.near > 0, !loose.is_empty(), "{graph}, {set:?}");
    }
}

#[test]
fn shipped_kernels_give_the_words_of_lavapipe_but_for_powers_and_logarithms() {
    alone(
        "metal::pictures::shipped_kernels_give_the_words_of_lavapipe_but_for_powers_and_logarithms",
        || {
            compare_all("", &[GRAPHS[0], GRAPHS[3], GRAPHS[8]], &POWERS);
        },
    );
}
/// exp2() and log2() as polynomials. Their accuracy matters little: both sides compute them in the same order.
const WRITTEN_OUT: &str = "
float written_exp2(float x) {
    float c = clamp(x, -126.0, 127.0);
    float whole = floor(c + 0.5);
    float f = c - whole;
    float power = 1.0 + f * (0.6931472 + f * (0.2402265 + f * (0.0555041 + f * (0.0096181 + f * 0.0013334))));
    return x < -126.0 ? 0.0 : power * intBitsToFloat((int(whole) + 127) << 23);
}
float written_log2(float x) {
    int bits = floatBitsToInt(x);
    float m = intBitsToFloat((bits & 0x7fffff) | 0x3f800000);
    float t = (m - 1.0) / (m + 1.0);
    return float((bits >> 23) - 127) + 2.885390 * t * (1.0 + t * t * (0.3333333 + t * t * (0.2 + t * t * 0.1428571)));
}
#define exp2(x) written_exp2(x)
#define log2(x) written_log2(x)
#define log(x) (0.6931472 * written_log2(x))
";

/// Copies the shipped graphs and shaders that draw splats to `to`, with [`WRITTEN_OUT`] in every compute shader.
fn write_out(to: &Path) {
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for folder in ["pipelines", "pipelines/parts", "shaders", "shaders/sort", "shaders/tiles"] {
        std::fs::create_dir_all(to.join(folder)).expect("a folder");
        for entry in std::fs::read_dir(from.join(folder)).expect("the shipped files").flatten() {
            let path = entry.path();
            let Ok(mut text) = std::fs::read_to_string(&path) else { continue };
            if path.extension().is_some_and(|e| e == "comp") {
                // Inserts the functions after the version and the extensions, which must come first.
                let last = text
                    .lines()
                    .filter(|line| line.starts_with('#'))
                    .take_while(|line| line.starts_with("#version") || line.starts_with("#extension"));
                let at = text.find(last.last().expect("a version")).expect("it is there");
                let end = at + text[at..].find('\n').expect("a line");
                text.insert_str(end, WRITTEN_OUT);
            }
            std::fs::write(to.join(folder).join(entry.file_name()), text).expect("written");
        }
    }
}

#[test]
fn kernels_with_their_powers_and_logarithms_written_out_give_every_byte_of_lavapipe() {
    const NAME: &str =
        "metal::pictures::kernels_with_their_powers_and_logarithms_written_out_give_every_byte_of_lavapipe";
    at_every_width_of_lavapipe(NAME, || {
        let folder = tempfile::tempdir().expect("a folder");
        write_out(folder.path());
        compare_all(&format!("{}/pipelines/", folder.path().display()), &GRAPHS, &[]);
    });
}

/// Runs kernels at several SIMD-group widths: Macs have 32 threads, more than lavapipe's subgroups.
///
/// Neither the width nor the execution order of groups and lanes may change a result.
#[test]
fn kernels_give_the_same_bytes_at_every_width_of_simd_groups_and_in_every_order_of_threads() {
    const NAME: &str = "metal::pictures::kernels_give_the_same_bytes_at_every_width_of_simd_groups_and_in_every_order_of_threads";
    alone(NAME, || {
        let mut stage = Stage::new();
        // The height of bins decides how many lanes share a cell, which changes the rounding of its sums.
        let heights = ["1", "2"].map(|halvings| [GRAPHS[3].1, &[("bin_halvings", halvings)]].concat());
        let square = [GRAPHS[1].1, &[("bin_halvings", "0")]].concat();
        let graphs = [
            (GRAPHS[1].0, &square, [8, 32, 64]),
            (GRAPHS[3].0, &heights[0], [8, 32, 64]),
            (GRAPHS[3].0, &heights[1], [16, 32, 64]),
            (GRAPHS[7].0, &GRAPHS[7].1.to_vec(), [8, 32, 64]),
        ];
        let plans = graphs.map(|(graph, set, widths)| {
            widths.map(|lanes| {
                stage.plan(graph, set, &DeviceFacts { subgroup_size: lanes, ..facts::apple_device() })
            })
        });
        // One library, since the graphs share kernels.
        let library = Library::new(&shaders(plans.iter().flatten()));
        for ((graph, set, widths), plans) in std::iter::zip(graphs, &plans) {
            let expected = stage.run(&plans[0], &library, false);
            let runs =
                std::iter::zip(plans, widths).flat_map(|run| [false, true].map(|reversed| (run, reversed)));
            for ((plan, lanes), reversed) in runs.skip(1) {
                let found = stage.run(plan, &library, reversed);
                assert!(
                    found == expected,
                    "{graph}, {set:?}, {lanes} lanes, reversed {reversed}: other bytes"
                );
            }
        }
    });
}

/// Bounds on the difference of a channel if more lanes, which round in other places, draw the picture.
const MORE_LANES: [(common::Graph, f32); 2] = [(common::FAST_TILES[1], 2e-4), (common::EXACT_TILES[1], 2e-6)];

/// Compares the rasteriser for CPUs at a Mac's width with 8 lanes, where its bytes equal lavapipe's.
///
/// No preset uses it on a Mac.
#[test]
fn the_serial_rasteriser_draws_the_same_picture_at_the_width_of_simd_groups_of_macs() {
    const NAME: &str =
        "metal::pictures::the_serial_rasteriser_draws_the_same_picture_at_the_width_of_simd_groups_of_macs";
    alone(NAME, || {
        let mut stage = Stage::new();
        let plans = MORE_LANES.map(|(graph, _)| {
            let set = common::with(graph, &[SUBGROUP, ROOM]);
            [facts::portable_device(8), facts::apple_device()]
                .map(|device| stage.plan(graph.0, &set, &device))
        });
        let library = Library::new(&shaders(plans.iter().flatten()));
        for ((graph, bound), plans) in std::iter::zip(MORE_LANES, &plans) {
            let expected = stage.run(&plans[0], &library, false);
            for reversed in [false, true] {
                let found = stage.run(&plans[1], &library, reversed);
                let [found, expected] =
                    [&found, &expected].map(|bytes| bytemuck::pod_collect_to_vec::<u8, f32>(bytes));
                assert_eq!(found.len(), expected.len());
                let pairs = || std::iter::zip(&found, &expected);
                assert!(pairs().all(|(found, expected)| found.is_finite() && expected.is_finite()));
                let most = pairs().map(|(found, expected)| (found - expected).abs()).fold(0.0, f32::max);
                let other = pairs().filter(|(found, expected)| found != expected).count();
                println!("{}, reversed {reversed}: {other} words differ, by {most:e} at most", graph.0);
                assert!(most <= bound, "{}, reversed {reversed}: {most:e}", graph.0);
            }
        }
    });
}
