//! Outputs besides the picture: graphs' outputs against the exact renderer's, and plans without outputs.

use crate::common::{self, EXACT_TILES, Graph, OPEN, QUADS, settings};
use crate::golden::Golden;
use splatgraph::draw::facts;
use splatgraph::draw::inspect::Words;
use splatgraph::draw::outputs::{self, NAMES, Output};
use splatgraph::draw::planner::Planner;
use splatgraph::draw::session::Session;
use splatgraph::draw::truth::{Truth, rules};
use splatgraph_assets::{Camera, Projection, Scene, synth};
use splatgraph_reference::Rules;
use std::sync::Arc;

/// Largest relative difference of a depth, an alpha or a normal.
const TOLERANCE: f64 = 1e-4;

/// The outputs that quads can draw too.
const SUMS: [&str; 3] = ["alpha", "depth", "expected_depth"];

/// Returns scenes with cameras of 160 x 90 pixels. They are a capture if there is one, the scene of the rules' edge
/// cases, a random scene, and a scene with wide positions.
fn scenes() -> Vec<(&'static str, Arc<Scene>, Camera)> {
    let mut found = Vec::new();
    for golden in Golden::all("outputs of captures").into_iter().filter(|golden| golden.name != "biker") {
        let camera = golden.cameras()[0].resized(160, 90);
        found.push((golden.name, golden.scene(), camera));
    }
    let random = synth::generate("uniform", 3000, 5).expect("it is generated");
    let camera = Camera::framing(&random, 160, 90);
    found.push(("random", Arc::new(random), camera));
    // In f32, its positions would be rounded by more than the distance of its splats from the camera.
    let wide = synth::generate("two-clouds", 2000, 0).expect("it is generated");
    assert!(wide.is_wide());
    let generator = synth::generators().iter().find(|generator| generator.name == "two-clouds");
    let camera = (generator.expect("a generator").cameras)()[0].relative_to(wide.offset()).resized(160, 90);
    found.push(("wide", Arc::new(wide), camera));
    found
}

fn drawn(session: &mut Session, camera: &Camera, graph: Graph, more: &[(&str, &str)]) -> Vec<Output> {
    session.set_graph(graph.0, &settings(&[graph.1, more].concat()));
    let names: Vec<String> = match graph.0 {
        "splat" => SUMS.map(str::to_owned).into(),
        _ => NAMES.map(|(name, _)| name.to_owned()).into(),
    };
    session.set_outputs(&names);
    outputs::draw(session, camera, [0.2, 0.4, 0.6]).unwrap_or_else(|error| panic!("{error}")).outputs
}

fn numbers(output: &Output) -> Vec<f64> {
    match &output.words {
        Words::Float(values) => values.iter().map(|v| f64::from(*v)).collect(),
        Words::Uint(values) => values.iter().map(|v| f64::from(*v)).collect(),
    }
}

/// Counts the pixels at which an output differs from the exact one beyond the tolerance, which integers lack. Only the
/// pixels that `counts` marks are compared; an output has several values per pixel if it is a vector.
fn differing(found: &Output, exact: &Output, counts: &[bool]) -> usize {
    assert_eq!((&found.name, &found.shape), (&exact.name, &exact.shape));
    let channels = found.words.len() / counts.len();
    let (found_values, exact_values) = (numbers(found), numbers(exact));
    let is_integer = matches!(found.words, Words::Uint(_));
    let differs = |pixel: &usize| {
        let values = pixel * channels..(pixel + 1) * channels;
        let size = exact_values[values.clone()].iter().map(|v| v * v).sum::<f64>().sqrt();
        let off = values.map(|i| (found_values[i] - exact_values[i]).powi(2)).sum::<f64>().sqrt();
        if is_integer { off > 0.0 } else { off > TOLERANCE * size }
    };
    (0..counts.len()).filter(|pixel| counts[*pixel]).filter(differs).count()
}

/// Compares a graph's outputs with the exact ones under equal rules.
///
/// A splat at the alpha floor in f32 may be below it in f64. So pixels where the number of contributors differs are
/// left out, at most 1%. Quads do not output this number: all their pixels are compared.
fn compare(name: &str, graph: Graph, found: &[Output], truth: &Truth) {
    let pixels = truth.picture.color.len();
    let exact = |name: &str| truth.output(name).expect("an output");
    let counts: Vec<bool> = match found.iter().find(|output| output.name == "contributors") {
        Some(own) => numbers(own).iter().zip(numbers(&exact("contributors"))).map(|(a, b)| *a == b).collect(),
        None => vec![true; pixels],
    };
    let left_out = counts.iter().filter(|counts| !**counts).count();
    assert!(100 * left_out <= pixels, "{name}, {}: {left_out} of {pixels} pixels have other splats", graph.0);
    for output in found.iter().filter(|output| output.name != "contributors") {
        let off = differing(output, &exact(&output.name), &counts);
        println!("{name}, {}: {} differs at {off} pixels, {left_out} left out", graph.0, output.name);
        // Two splats can be equal except for rounding: the median depth and the largest weight may then be either's.
        let most = if graph.0 == "splat" { pixels / 100 } else { pixels / 1000 };
        assert!(off <= most, "{name}, {}: {} differs at {off} of {pixels} pixels", graph.0, output.name);
    }
}

#[test]
fn alpha_depths_normals_and_ranks_are_those_of_the_exact_renderer() {
    let quads = rules(Rules::PUBLISHED, &settings(&OPEN)).expect("rules");
    let published = Rules::PUBLISHED;
    let by_quads: [(Graph, &[(&str, &str)]); 4] = [
        (QUADS, &[]),
        (("tiled", &[]), &[("stop", "0.0")]),
        // Small segments, so that most tiles composite several.
        (("tiled", &[]), &[("stop", "0.0"), ("segment", "32"), ("entries", "20000")]),
        (("tiled_cpu", &[]), &[("stop", "0.0")]),
    ];
    for (name, scene, camera) in scenes() {
        let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
        let truth = Truth::draw(&scene, &camera, [0.2, 0.4, 0.6], &quads).unwrap();
        for (graph, set) in by_quads {
            let found = drawn(&mut session, &camera, graph, set);
            compare(name, graph, &found, &truth);
        }
        let truth = Truth::draw(&scene, &camera, [0.2, 0.4, 0.6], &published).unwrap();
        for graph in EXACT_TILES {
            let found = drawn(&mut session, &camera, graph, &[]);
            compare(name, graph, &found, &truth);
        }
        // Wherever the loop over the splats ends, the splats in front of the early stop are counted.
        let chunks: [(Graph, &[(&str, &str)]); 3] = [
            (EXACT_TILES[0], &[("stop_after", "chunk")]),
            (EXACT_TILES[0], &[("stop_after", "chunk"), ("segment", "32"), ("entries", "20000")]),
            (EXACT_TILES[1], &[("stop_after", "chunk")]),
        ];
        for (graph, set) in chunks {
            let found = drawn(&mut session, &camera, graph, set);
            let counts = found.iter().find(|output| output.name == "contributors").expect("it was requested");
            let exact = truth.output("contributors").expect("an output");
            let off = differing(counts, &exact, &vec![true; truth.picture.color.len()]);
            assert!(
                100 * off <= truth.picture.color.len(),
                "{name}, {}: {off} pixels have other counts",
                graph.0
            );
        }
        common::assert_silent(session.device(), name);
    }
}

#[test]
fn normals_of_an_orthographic_view_are_the_same_wherever_on_its_axis_the_camera_is() {
    let scene = Arc::new(synth::generate("uniform", 500, 5).expect("it is generated"));
    let middle = scene.bounds().center();
    // The nearer camera is close to splats that it sees from the side.
    let cameras = [12.0, 2000.0].map(|distance| {
        let eye = [middle[0], middle[1], middle[2] - distance];
        let pinhole = Camera::looking_at(eye, middle, 60.0, (160, 90));
        Camera { projection: Projection::Orthographic, fx: 12.0, fy: 12.0, ..pinhole }
    });
    let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
    let normals = cameras.each_ref().map(|camera| {
        let rules = Rules::of_view(&scene, camera);
        let truth = Truth::draw(&scene, camera, [0.2, 0.4, 0.6], &rules).unwrap();
        for graph in EXACT_TILES {
            let found = drawn(&mut session, camera, graph, &[("projection", "orthographic")]);
            compare("orthographic", graph, &found, &truth);
        }
        truth.output("normal").expect("an output")
    });
    let off = differing(&normals[0], &normals[1], &[true; 160 * 90]);
    assert!(off <= 14, "{off} pixels differ");
}

#[test]
fn a_plan_without_outputs_has_nothing_for_them_and_one_with_some_has_their_passes_alone() {
    let facts = common::facts_of(&facts::portable_device(32));
    let catalog = facts::nominal_catalog();
    let mut planner = Planner::default();
    let mut plan = |graph: &str, names: &[&str]| {
        planner.outputs = names.iter().map(|name| (*name).to_owned()).collect();
        planner.plan(graph, &[], &facts, &catalog)
    };
    for graph in ["splat", "tiled"] {
        let without = plan(graph, &[]).unwrap_or_else(|error| panic!("{error}"));
        assert!(without.outputs.is_empty() && without.find_resource("pixels").is_none(), "{graph}");
        let depth = plan(graph, &["depth"]).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(depth.frame.len(), without.frame.len() + 1, "{graph}: the pass that makes the image");
        assert!(depth.find_resource("more.depth").is_some() && depth.find_resource("more.alpha").is_none());
    }
    let error = plan("splat", &["normal"]).expect_err("quads have no normals").to_string();
    assert!(error.contains("this graph has no output `normal`"), "{error}");
    assert!(error.contains("outputs alpha, depth, expected_depth besides its picture"), "{error}");
    assert!(
        error.contains("built-in graphs with this output, and their presets: tiled, tiled_cpu"),
        "{error}"
    );
    let error = plan("tiled", &["dept"]).expect_err("no output").to_string();
    assert!(error.contains("`depth`"), "{error}");
}
