//! Parameters of the graphs: each draws what the exact renderer draws with the changed rule, or with the rounded scene.

use crate::common::{self, EXACT_TILES, Graph, OPEN, OPEN_TILES, QUADS, settings};
use crate::images::{self, psnr};
use splatgraph::draw::session::Session;
use splatgraph::draw::truth::{Truth, rules};
use splatgraph::io::image::Image;
use splatgraph_assets::{Camera, Scene, Splat, synth};
use splatgraph_reference::Rules;
use std::sync::Arc;

/// Returns a small demo scene, with splats outside the picture that reach into it, and many narrower than a pixel.
fn scene() -> (Arc<Scene>, Camera) {
    let demo = synth::generate("demo", 1500, 0).expect("it is generated");
    let camera = synth::demo_cameras().swap_remove(0).resized(128, 72);
    let [right, _, forward] = camera.axes();
    let beside = |i: usize| {
        // Large, and centred at 1.5 to 2 times the half field of view. Depths differ: among equal depths, devices may
        // differ.
        let depth = 3.0 + 0.1 * i as f64;
        let side = (1.5 + 0.05 * i as f64) * 0.5 * f64::from(camera.width) / camera.fx;
        let position =
            std::array::from_fn(|c| (camera.position[c] + depth * (forward[c] + side * right[c])) as f32);
        Splat { position, scale: [0.8, 0.1, 0.1], opacity: 0.6, ..demo.splat(i) }
    };
    let count = demo.count() + 10;
    let scene = Scene::generate(count, 3, |i| {
        let at = i.checked_sub(demo.count() as usize);
        at.map_or_else(|| demo.splat(i), beside)
    });
    (Arc::new(scene), camera)
}

fn drawn(session: &mut Session, camera: &Camera, set: &[(&str, &str)]) -> Image {
    drawn_by(session, camera, QUADS, set)
}

/// Quads, and the tile renderers for CPUs and for GPUs.
const ALL: [Graph; 3] = [QUADS, EXACT_TILES[1], EXACT_TILES[0]];

fn drawn_by(session: &mut Session, camera: &Camera, graph: Graph, set: &[(&str, &str)]) -> Image {
    let of_quads: &[_] = if graph.0 == "splat" { &[] } else { &OPEN_TILES };
    images::drawn(session, camera, graph.0, &common::with(graph, &[of_quads, set].concat()))
}

#[test]
fn a_parameter_that_is_a_rule_draws_what_the_exact_renderer_draws_by_that_rule() {
    let (scene, camera) = scene();
    // Quads have no tiles and do not stop early.
    let exact = |rule: &str, value: &str| {
        let changes = settings(&[&OPEN[..], &[(rule, value)]].concat());
        let rules = rules(Rules::PUBLISHED, &changes).expect("rules");
        Truth::draw(&scene, &camera, [0.0; 3], &rules).unwrap().image()
    };
    let published = exact("near", "0.2");
    let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
    for (rule, value, name, setting) in [
        ("near", "0.2", "budget", "1.0"),
        ("low_pass", "none", "low_pass", "none"),
        ("low_pass", "0.3*compensated", "low_pass", "compensated"),
        ("low_pass", "0.1*compensated", "low_pass", "mip"),
        ("key_of", "distance", "key_of", "distance"),
        ("alpha_floor", "0.03", "alpha_floor", "0.03"),
        ("alpha_cap", "0.7", "alpha_cap", "0.7"),
        ("jacobian_clamp", "1.7", "jacobian_limit", "1.7"),
        ("sh_degree", "1", "sh_degree", "1"),
    ] {
        let by_rule = exact(rule, value);
        let found = drawn(&mut session, &camera, &[(name, setting)]);
        let (near, far) = (psnr(&found, &by_rule), psnr(&found, &published));
        assert!(near > 100.0, "{name}={setting}: {near:.1} dB from the rule {rule}={value}");
        // The changed rule must change the picture, or agreement would prove nothing. `budget=1.0` changes no rule.
        assert!(
            name == "budget" || near > far + 30.0,
            "{name}={setting}: {near:.1} dB, {far:.1} dB from the published"
        );
    }
    common::assert_silent(session.device(), "parameters");
}

#[test]
fn a_cutoff_is_half_the_sides_of_a_quad_whose_corners_are_drawn() {
    let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (64, 48));
    let scale = [0.25, 0.1, 0.1];
    let splat = Splat {
        position: [0.0, 0.0, 2.0],
        scale,
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 1.0,
        sh: [1.0; 48],
    };
    let mut session = Session::new(common::device(), Scene::generate(1, 0, |_| splat), "splat", &[]);
    let whole = drawn(&mut session, &camera, &[]);
    let cut = drawn(&mut session, &camera, &[("cutoff", "1.5")]);
    let deviation = |scale: f32| (f64::from(scale) * camera.fx / 2.0).hypot(0.3f64.sqrt());
    let mut corners = 0;
    for (x, y) in (0..48).flat_map(|y| (0..64).map(move |x| (x, y))) {
        let [u, v] = [(x as f64 - 31.5) / deviation(scale[0]), (y as f64 - 23.5) / deviation(scale[1])];
        let in_quad = u.abs() <= 1.5 && v.abs() <= 1.5;
        corners += u32::from(in_quad && u.hypot(v) > 1.5);
        assert_eq!(cut.at(x, y), if in_quad { whole.at(x, y) } else { [0.0; 3] }, "pixel {x}, {y}");
    }
    assert!(corners > 0);
    common::assert_silent(session.device(), "the cutoff");
}

#[test]
fn fewer_bits_cost_some_accuracy_and_change_nothing_else() {
    let (scene, camera) = scene();
    let mut session = Session::new(common::device(), scene, "splat", &[]);
    let single = drawn(&mut session, &camera, &[]);
    for (name, setting, least, most) in [
        ("covariance", "factored", 90.0, f64::INFINITY),
        ("covariance", "half", 50.0, 90.0),
        ("sh_storage", "f16", 50.0, 90.0),
        ("sh_storage", "q8", 40.0, 80.0),
        ("position_storage", "fixed16", 30.0, 80.0),
    ] {
        let found = psnr(&drawn(&mut session, &camera, &[(name, setting)]), &single);
        assert!((least..=most).contains(&found), "{name}={setting}: {found:.1} dB");
    }
    // The number of planes depends on the degree.
    for degree in ["0", "1", "2"] {
        let of = |storage: &'static str| [("sh_degree", degree), ("sh_storage", storage)];
        let (half, single) =
            (drawn(&mut session, &camera, &of("f16")), drawn(&mut session, &camera, &of("f32")));
        let found = psnr(&half, &single);
        assert!((50.0..100.0).contains(&found), "degree {degree}: {found:.1} dB");
    }
    common::assert_silent(session.device(), "fewer bits");
}

/// Rounds positions as `position_storage=fixed16` does: 65,535 steps in the box of each 256 splats.
fn with_rounded_positions(scene: &Scene) -> Scene {
    let boxes: Vec<[[f32; 2]; 3]> = scene
        .positions()
        .chunks(256)
        .map(|block| {
            [0, 1, 2].map(|axis| {
                let of = block.iter().map(|p| p[axis]);
                of.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
            })
        })
        .collect();
    Scene::generate(scene.count(), 3, |i| {
        let splat = scene.splat(i);
        let rounded = |axis: usize| {
            let [low, high] = boxes[i / 256][axis].map(f64::from);
            let step = ((f64::from(splat.position[axis]) - low) / (high - low) * 65535.0).round();
            (low + (high - low) * step / 65535.0) as f32
        };
        Splat { position: [0, 1, 2].map(rounded), ..splat }
    })
}

/// Rounds harmonics as `sh_storage=q8` does. Degree 0 is rounded to half floats, the others to multiples of 1/127 of
/// the largest of them, which is itself rounded to a half float.
fn with_rounded_harmonics(scene: &Scene) -> Scene {
    let half = |v: f32| half::f16::from_f32(v).to_f32();
    Scene::generate(scene.count(), 3, |i| {
        let mut splat = scene.splat(i);
        let scale = half(splat.sh[3..].iter().fold(0.0, |most: f32, c| most.max(c.abs())));
        for (at, c) in splat.sh.iter_mut().enumerate() {
            *c = match at {
                0..3 => half(*c),
                _ if scale > 0.0 => ((*c / scale).clamp(-1.0, 1.0) * 127.0).round() / 127.0 * scale,
                _ => 0.0,
            };
        }
        splat
    })
}

#[test]
fn rounded_storage_draws_the_scene_with_its_numbers_rounded() {
    let (scene, camera) = scene();
    let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
    for (rounded, name, value) in [
        (with_rounded_positions(&scene), "position_storage", "fixed16"),
        (with_rounded_harmonics(&scene), "sh_storage", "q8"),
    ] {
        let mut of_rounded = Session::new(common::device(), rounded, "splat", &[]);
        for graph in ALL {
            let found = drawn_by(&mut session, &camera, graph, &[(name, value)]);
            let expected = drawn_by(&mut of_rounded, &camera, graph, &[]);
            let (near, far) =
                (psnr(&found, &expected), psnr(&found, &drawn_by(&mut session, &camera, graph, &[])));
            assert!(
                near > 75.0 && near > far + 15.0,
                "{name}, {graph:?}: {near:.1} dB, {far:.1} from the scene as it is"
            );
        }
    }
    common::assert_silent(session.device(), "rounded storage");
}

#[test]
fn a_cull_margin_leaves_out_the_splats_whose_centre_is_beyond_it() {
    let (scene, camera) = scene();
    // Tangents of the angles to the margin's edges: 30% of the picture's size beyond each side.
    let size = [(camera.width, camera.fx), (camera.height, camera.fy)];
    let border = size.map(|(side, focal)| (1.0 + 2.0 * 0.3) * 0.5 * f64::from(side) / focal);
    let inside = |i: &usize| {
        let [x, y, z] = camera.to_view(scene.positions()[*i].map(f64::from));
        x.abs() <= border[0] * z && y.abs() <= border[1] * z
    };
    let kept: Vec<usize> = (0..scene.count() as usize).filter(inside).collect();
    let fewer = Scene::generate(kept.len() as u32, 3, |at| scene.splat(kept[at]));
    let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
    let mut of_fewer = Session::new(common::device(), fewer, "splat", &[]);
    for graph in ALL {
        let whole = drawn_by(&mut session, &camera, graph, &[]);
        let culled = drawn_by(&mut session, &camera, graph, &[("cull_margin", "0.3")]);
        let near = psnr(&culled, &drawn_by(&mut of_fewer, &camera, graph, &[]));
        let far = psnr(&culled, &whole);
        assert!(near > 100.0 && far < 60.0, "{graph:?}: {near:.1} dB from the rest, {far:.1} from the whole");
    }
    common::assert_silent(session.device(), "the cull margin");
}

#[test]
fn equalised_keys_are_right_where_they_are_wide_and_the_nearest_to_right_where_they_are_narrow() {
    let (scene, camera) = scene();
    // A distant outlier stretches the range of depths, which leaves fewer key values for the other splats.
    let count = scene.count();
    let far = Splat { position: [0.0, 0.0, 1e6], ..scene.splat(0) };
    let scene = Scene::generate(count + 1, 3, |i| if i < count as usize { scene.splat(i) } else { far });
    let mut session = Session::new(common::device(), scene, "splat", &[]);
    let tiles = ("tiled", &[("sorted", "pairs"), ("record", "f32"), ("sh_storage", "f32")][..]);
    for graph in ALL.into_iter().chain([tiles]) {
        let right = drawn_by(&mut session, &camera, graph, &[("key_bits", "32")]);
        let mut at = |map: &str, bits: &str| {
            psnr(&drawn_by(&mut session, &camera, graph, &[("key_map", map), ("key_bits", bits)]), &right)
        };
        let wide = at("equalised", "22");
        assert!(wide > 85.0, "{graph:?}: {wide:.1} dB");
        let (equalised, bits) = (at("equalised", "9"), at("float_bits", "9"));
        assert!(equalised > bits + 3.0, "{graph:?}: {equalised:.1} dB, {bits:.1} by the bits of floats");
    }
    common::assert_silent(session.device(), "equalised keys");
}
