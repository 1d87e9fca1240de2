//! One picture by every backend: the same plans draw the same on each API, within a stated bound.
//!
//! Machines with two APIs are rare. So Vulkan's pictures, drawn by lavapipe, are stored in `tests/parity/`, and each
//! backend of the machine is compared with them. With Vulkan, this finds stored pictures that are out of date; with
//! Metal, it compares Metal with Vulkan without a Vulkan driver. That takes a real Mac: the virtual GPUs of hosted
//! runners are refused (docs/metal.md).

use splatgraph::draw::backend::{Api, Backend, Validation};
use splatgraph::draw::session::Session;
use splatgraph::io::image::Image;
use splatgraph_assets::{Scene, synth};
use std::path::PathBuf;
use std::sync::Arc;

use crate::{common, images};

const SIZE: (u32, u32) = (192, 108);
const SPLATS: u32 = 20_000;
const PRESETS: [&str; 3] = ["splat", "front_to_back", "tiled"];

/// Minimum PSNR, in decibels.
///
/// The stored pictures have 8 bits. APIs may differ in the last bits of exponentials, and in the rounding of
/// half-float targets.
const MIN_DB: f64 = 50.0;
/// Maximum difference in any channel of any pixel, in 8-bit steps.
const MAX_STEPS: f32 = 3.0;

/// Environment variable: if it is set, the stored pictures are redrawn.
const WRITE: &str = "SPLATGRAPH_WRITE_PARITY";

fn stored(preset: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/parity")).join(format!("{preset}.png"))
}

fn draw(api: Api, scene: &Arc<Scene>, preset: &str) -> Image {
    let mut options = common::options(Validation::Synchronization);
    if api != Api::default() {
        options.device = None;
    }
    let device = Backend::open(api, &options).unwrap_or_else(|error| panic!("{api}: {error}"));
    let mut session: Session = Session::new(device, scene.clone(), preset, &[]);
    let camera = synth::demo_cameras().swap_remove(0).resized(SIZE.0, SIZE.1);
    let image = images::picture(&mut session, &camera, [0.0; 3]);
    common::assert_silent(session.device(), preset);
    image
}

fn worst(a: &Image, b: &Image) -> f32 {
    let channels = a.rgb.iter().flatten().zip(b.rgb.iter().flatten());
    channels.map(|(a, b)| (a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).abs() * 255.0).fold(0.0, f32::max)
}

fn has(api: Api) -> bool {
    api.devices().is_ok_and(|devices| devices.iter().any(|device| device.unfit.is_none()))
}

#[test]
fn every_backend_of_the_machine_draws_the_pictures_of_vulkan() {
    const TEST: &str = "every_backend_of_the_machine_draws_the_pictures_of_vulkan";
    let scene = Arc::new(synth::generate("demo", SPLATS, 0).expect("the scene is generated"));
    let drawing = Api::ALL.into_iter().filter(|api| *api != Api::Null);
    let (there, missing): (Vec<Api>, Vec<Api>) = drawing.partition(|api| has(*api));
    assert!(there.contains(&Api::default()), "the machine has no device that draws");
    for api in &missing {
        common::not_run(TEST, &format!("a device of {api}, for its part"));
    }
    if !Api::ALL.iter().any(|api| api.name() == "metal") {
        common::not_run(TEST, "a Mac, for Metal's part");
    }
    for preset in PRESETS {
        if std::env::var_os(WRITE).is_some() {
            draw(Api::Vulkan, &scene, preset).save(&stored(preset)).expect("it is written");
        }
        let expected = Image::load(&stored(preset)).expect("a picture of Vulkan's");
        for api in &there {
            let drawn = draw(*api, &scene, preset);
            let found = images::psnr(&drawn.clone().clamped(), &expected);
            let steps = worst(&drawn, &expected);
            println!("{preset} by {api}: {found:.1} dB, at most {steps:.2} steps of 8 bits");
            assert!(
                found >= MIN_DB && steps <= MAX_STEPS,
                "{preset} by {api}: expected {MIN_DB} dB and at most {MAX_STEPS} steps of 8 bits, found {found:.1} dB and \
                 {steps:.2} (after a change of the preset, draw Vulkan's anew: {WRITE}=1)"
            );
        }
    }
}
