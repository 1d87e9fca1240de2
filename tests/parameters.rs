//! The parameters of `splat`: each draws what the exact renderer draws with the same rule changed.

use crate::common;
use splatgraph::image::Image;
use splatgraph::session::Session;
use splatgraph::truth::{Truth, rules};
use splatgraph::{metrics, shot};
use splatgraph_assets::{Camera, Scene, Splat, synth};
use splatgraph_vulkan::Vulkan;
use std::sync::Arc;

/// The demo scene in small, with splats beside the picture that reach into it, and many narrower than a pixel.
fn scene() -> (Arc<Scene>, Camera) {
    let demo = synth::generate("demo", 1500, 0).expect("it is generated");
    let camera = synth::demo_cameras().swap_remove(0).resized(128, 72);
    let [right, _, forward] = camera.axes();
    let beside = |i: usize| {
        // At 1.5 to 2 times the half field of view, and large. At equal depths, the order would be the device's.
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

fn drawn(session: &mut Session<Vulkan>, camera: &Camera, set: &[(&str, &str)]) -> Image {
    let set: Vec<(String, String)> = set.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned())).collect();
    session.set_graph("splat", &[vec![("target".into(), "rgba32f".into())], set].concat());
    session.prepare((camera.width, camera.height), &mut |_| {}).expect("it is prepared");
    shot::take(session, camera).expect("a picture").image
}

fn psnr(a: &Image, b: &Image) -> f64 {
    metrics::compare(a, b).expect("of one size and finite").psnr()
}

#[test]
fn a_parameter_that_is_a_rule_draws_what_the_exact_renderer_draws_by_that_rule() {
    let (scene, camera) = scene();
    // Quads have no tiles and do not stop early.
    let exact = |rule: &str, value: &str| {
        let changes = [("extent", "unbounded"), ("stop", "none"), (rule, value)];
        let rules = rules(&changes.map(|(n, v)| (n.to_owned(), v.to_owned()))).expect("rules");
        Truth::draw(&scene, &camera, [0.0; 3], &rules).image()
    };
    let published = exact("near", "0.2");
    let mut session = Session::new(common::device(), scene.clone(), "splat", &[]);
    for (rule, value, name, setting) in [
        ("near", "0.2", "budget", "1.0"),
        ("low_pass", "none", "low_pass", "none"),
        ("low_pass", "0.3*compensated", "low_pass", "compensated"),
        ("alpha_floor", "0.03", "alpha_floor", "0.03"),
        ("alpha_cap", "0.7", "alpha_cap", "0.7"),
        ("jacobian_clamp", "1.7", "jacobian_limit", "1.7"),
        ("sh_degree", "1", "sh_degree", "1"),
    ] {
        let by_rule = exact(rule, value);
        let found = drawn(&mut session, &camera, &[(name, setting)]);
        let (near, far) = (psnr(&found, &by_rule), psnr(&found, &published));
        assert!(near > 100.0, "{name}={setting}: {near:.1} dB from the rule {rule}={value}");
        // The rule makes a difference here, and the parameter makes the same one.
        assert!(
            name == "budget" || near > far + 30.0,
            "{name}={setting}: {near:.1} dB, {far:.1} dB from the published"
        );
    }
    common::assert_silent(session.device(), "parameters");
}

#[test]
fn half_floats_cost_some_accuracy_and_change_nothing_else() {
    let (scene, camera) = scene();
    let mut session = Session::new(common::device(), scene, "splat", &[]);
    let single = drawn(&mut session, &camera, &[]);
    for (name, setting, least, most) in [
        ("covariance", "factored", 90.0, f64::INFINITY),
        ("covariance", "half", 50.0, 90.0),
        ("sh_storage", "f16", 50.0, 90.0),
    ] {
        let found = psnr(&drawn(&mut session, &camera, &[(name, setting)]), &single);
        assert!((least..=most).contains(&found), "{name}={setting}: {found:.1} dB");
    }
    // All degrees have planes of their own number.
    for degree in ["0", "1", "2"] {
        let of = |storage: &'static str| [("sh_degree", degree), ("sh_storage", storage)];
        let (half, single) =
            (drawn(&mut session, &camera, &of("f16")), drawn(&mut session, &camera, &of("f32")));
        let found = psnr(&half, &single);
        assert!((50.0..100.0).contains(&found), "degree {degree}: {found:.1} dB");
    }
    common::assert_silent(session.device(), "half floats");
}
