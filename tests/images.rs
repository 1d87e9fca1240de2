//! The presets on `rules` and on captured scenes, compared with images of the published CUDA rasteriser and with each
//! other.

use splatgraph::draw::inspect;
use splatgraph::draw::session::{FrameOptions, Session, image_of};
use splatgraph::io::image::Image;
use splatgraph_api::FrameResult;
use splatgraph_assets::{Camera, Scene};
use splatgraph_reference::metrics;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::common::{self, settings};
use crate::golden::Golden;

fn draw(golden: &Golden, preset: &str, background: [f32; 3]) -> Vec<Image> {
    draw_scene(golden.scene(), &golden.cameras(), preset, background, &[])
}

/// Draws a golden scene with `splat`, from all its cameras. Tests share the pictures.
fn by_splat(golden: &Golden) -> Arc<Vec<Image>> {
    static DRAWN: Mutex<BTreeMap<&str, Arc<Vec<Image>>>> = Mutex::new(BTreeMap::new());
    let mut drawn = DRAWN.lock().unwrap_or_else(PoisonError::into_inner);
    drawn.entry(golden.name).or_insert_with(|| Arc::new(draw(golden, "splat", [0.0; 3]))).clone()
}

pub fn session(scene: impl Into<Arc<Scene>>, graph: &str, set: &[(&str, &str)]) -> Session {
    Session::new(common::device(), scene, graph, &settings(set))
}

pub fn frame(session: &mut Session, camera: &Camera, request: &FrameOptions) -> FrameResult {
    let size = (camera.width, camera.height);
    session.prepare(size, &mut |_| {}).unwrap_or_else(|error| panic!("it is prepared: {error}"));
    let frame = session.submit(camera, request).expect("submitted");
    session.wait(frame).expect("drawn")
}

pub fn picture(session: &mut Session, camera: &Camera, background: [f32; 3]) -> Image {
    let request = FrameOptions { background, read_output: true, ..FrameOptions::default() };
    image_of(&frame(session, camera, &request).output.expect("asked for")).expect("colours")
}

/// Changes the graph of an open session, and draws it on black.
pub fn drawn(session: &mut Session, camera: &Camera, graph: &str, set: &[(&str, &str)]) -> Image {
    session.set_graph(graph, &settings(set));
    picture(session, camera, [0.0; 3])
}

pub fn close(mut session: Session, what: &str) {
    common::assert_silent(session.device(), what);
    assert_eq!(session.into_device().close(), Vec::<String>::new(), "{what}: closing the device");
}

pub fn draw_scene(
    scene: impl Into<Arc<Scene>>,
    cameras: &[Camera],
    preset: &str,
    background: [f32; 3],
    set: &[(&str, &str)],
) -> Vec<Image> {
    let mut session = session(scene, preset, set);
    let images = cameras.iter().map(|camera| picture(&mut session, camera, background)).collect();
    close(session, preset);
    images
}

/// Draws one camera's picture, on black.
pub fn draw_one(scene: impl Into<Arc<Scene>>, camera: &Camera, graph: &str, set: &[(&str, &str)]) -> Image {
    draw_scene(scene, std::slice::from_ref(camera), graph, [0.0; 3], set).swap_remove(0)
}

/// Draws a frame and returns the bytes of `what`, a resource after a pass: `resource@pass`.
pub fn inspected(
    scene: impl Into<Arc<Scene>>,
    camera: &Camera,
    preset: &str,
    set: &[(&str, &str)],
    what: &str,
) -> Vec<u8> {
    let mut session = session(scene, preset, set);
    session.prepare((camera.width, camera.height), &mut |_| {}).expect("prepared");
    let (resource, pass) = what.split_once('@').expect("resource@pass");
    let target =
        inspect::resolve(session.plan().expect("a plan"), resource, pass).expect("the pass and its buffer");
    let request = FrameOptions { inspect: vec![target], ..FrameOptions::default() };
    let mut result = frame(&mut session, camera, &request);
    common::assert_silent(session.device(), what);
    result.inspected.swap_remove(0)
}

pub fn psnr(a: &Image, b: &Image) -> f64 {
    metrics::compare(a.into(), b.into()).expect("of one size").psnr()
}

pub fn bytes(image: &Image) -> Vec<u32> {
    image.rgb.iter().flatten().map(|v| v.to_bits()).collect()
}

#[test]
fn splat_agrees_with_the_published_rasteriser() {
    for golden in Golden::all("splat_agrees_with_the_published_rasteriser") {
        let (scene, bound) = (golden.name, if golden.name == "rules" { 55.0 } else { 70.0 });
        for (i, image) in by_splat(&golden).iter().enumerate() {
            let db = golden.compare(image, &format!("camera{i}")).psnr();
            println!("{scene} camera {i}: {db:.2} dB");
            assert!(db >= bound, "{scene}, camera {i}: {db:.2} dB, and {bound} are needed");
        }
    }
}

#[test]
fn a_background_shows_where_nothing_covers_it() {
    let Some(data) = common::data("a_background_shows_where_nothing_covers_it") else { return };
    let golden = Golden::whole(&data, "playbot-31k");
    let images = draw(&golden, "splat", [1.0, 0.5, 0.25]);
    let db = golden.compare(&images[0], "camera0-background").psnr();
    assert!(db >= 70.0, "{db:.2} dB");
}

#[test]
fn digits_of_4_8_and_11_bits_give_the_same_bytes_and_so_do_two_runs() {
    for golden in Golden::all("digits_of_4_8_and_11_bits_give_the_same_bytes_and_so_do_two_runs") {
        let scene = golden.name;
        let camera = &golden.cameras()[0];
        let drawn = |preset| bytes(&draw_one(golden.scene(), camera, preset, &[]));
        let first = drawn("digit8");
        for preset in ["digit8", "digit4", "digit11"] {
            assert!(drawn(preset) == first, "{scene}: {preset} differs from digit8");
        }
    }
}

#[test]
fn both_correct_blending_orders_agree_and_the_naive_one_does_not() {
    for golden in Golden::all("both_correct_blending_orders_agree_and_the_naive_one_does_not") {
        let scene = golden.name;
        let back = by_splat(&golden);
        let front = draw(&golden, "front_to_back", [0.0; 3]);
        let naive = draw(&golden, "front_to_back_naive", [0.0; 3]);
        for i in 0..back.len() {
            let (right, wrong) = (psnr(&back[i], &front[i]), psnr(&back[i], &naive[i]));
            println!("{scene} camera {i}: front to back {right:.1} dB, naive {wrong:.1} dB");
            assert!(right > 55.0, "{scene}, camera {i}: front to back is {right:.1} dB from back to front");
            assert!(wrong < 45.0, "{scene}, camera {i}: the naive order is only {wrong:.1} dB away");
        }
    }
}

#[test]
fn narrow_keys_and_no_sort_cost_accuracy() {
    for golden in Golden::all("narrow_keys_and_no_sort_cost_accuracy") {
        let scene = golden.name;
        let right = by_splat(&golden);
        for preset in ["key16", "unsorted"] {
            let images = draw(&golden, preset, [0.0; 3]);
            let differences: Vec<f64> = images.iter().zip(&*right).map(|(a, b)| psnr(a, b)).collect();
            println!("{scene}: {preset} {differences:.1?} dB");
            let (worst, best) = if preset == "key16" { (55.0, f64::INFINITY) } else { (15.0, 42.0) };
            assert!(
                differences.iter().all(|db| (worst..=best).contains(db)),
                "{scene}: {preset} {differences:.1?} dB"
            );
            assert!(differences.iter().any(|db| *db < 130.0), "{scene}: {preset} changed nothing");
        }
    }
}

#[test]
fn serial_and_subgroup_sorts_and_the_factored_covariance_draw_the_same() {
    let Some(data) = common::data("serial_and_subgroup_sorts_and_the_factored_covariance_draw_the_same")
    else {
        return;
    };
    let golden = Golden::whole(&data, "playbot-31k");
    let camera = golden.cameras().swap_remove(0);
    let draw = |set| draw_one(golden.scene(), &camera, "splat", &[set]);
    let first = draw(("sorter", "serial"));
    assert!(bytes(&first) == bytes(&draw(("sorter", "subgroup"))), "the two sorters differ");
    let db = psnr(&first, &draw(("covariance", "factored")));
    assert!(db > 60.0, "the factored covariance is {db:.1} dB away");
}

/// Validates every preset with the demo scene, which needs no download.
#[test]
fn every_preset_draws_a_generated_scene_without_a_validation_message() {
    let scene = splatgraph_assets::synth::generate("demo", 20_000, 1).expect("a generator");
    let camera = Camera::framing(&scene, 160, 90);
    // One device, whose plans share pipelines.
    let mut session = session(scene, "splat", &[]);
    for preset in splatgraph::draw::builtin::presets() {
        // Two frames: a preset may use results of the previous frame.
        drawn(&mut session, &camera, preset.name, &[]);
        let image = picture(&mut session, &camera, [0.0; 3]);
        let lit = image.rgb.iter().filter(|p| p.iter().any(|v| *v > 0.05)).count();
        assert!(lit > 160 * 90 / 20, "{}: only {lit} pixels show anything", preset.name);
        common::assert_silent(session.device(), preset.name);
    }
    close(session, "the presets");
}

#[test]
fn every_preset_draws_with_subgroups_of_4_and_of_16_lanes() {
    for bits in [128, 512] {
        common::again_with_vectors_of(
            bits,
            "images::every_preset_draws_a_generated_scene_without_a_validation_message",
        );
    }
}

/// Draws with `stale_order`, which uses the previous frame's order. The first frame draws nothing, and a repeated view
/// is correct.
#[test]
fn the_order_of_the_last_frame_draws_a_view_that_it_has_seen_as_the_order_of_this_one_does() {
    let scene = || splatgraph_assets::synth::generate("demo", 20_000, 1).expect("a generator");
    let camera = Camera::framing(&scene(), 160, 90);
    // From the side: a camera that only moves sees splats in the same order.
    let [x, y, z] = camera.position;
    let elsewhere = Camera::looking_at([z, y, x], [0.0; 3], 60.0, (160, 90));
    let draw = |preset, views: &[&Camera]| {
        let views: Vec<Camera> = views.iter().map(|view| (*view).clone()).collect();
        draw_scene(scene(), &views, preset, [0.0; 3], &[])
    };
    let right = draw("splat", &[&camera, &elsewhere]);
    let stale = draw("stale_order", &[&camera, &camera, &elsewhere, &elsewhere]);
    let dark = stale[0].rgb.iter().all(|pixel| *pixel == [0.0; 3]);
    assert!(dark, "the first frame has no order to draw with");
    assert!(bytes(&stale[1]) == bytes(&right[0]), "the second frame from the same view is another picture");
    assert!(bytes(&stale[2]) != bytes(&right[1]), "a new view is drawn in the order of the last one");
    assert!(bytes(&stale[3]) == bytes(&right[1]), "and then in its own");
}
