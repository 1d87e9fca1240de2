//! The table of extreme cases.

use splatgraph_assets::{Camera, Scene, Splat, synth};

/// A scene at an extreme, with bounds on the errors of its pictures.
pub struct Case {
    pub name: &'static str,
    /// Makes the scene and the camera.
    pub scene: fn() -> (Scene, Camera),
    pub bounds: Bounds,
}

/// Least PSNR in dB, measured on lavapipe and rounded down, and the largest error of a pixel.
pub struct Bounds {
    /// Of every preset with the right order, blending in 32-bit floats.
    pub exact: f64,
    /// The worst pixel of those.
    pub worst: f64,
    /// Of half floats, which lavapipe truncates.
    pub half: f64,
    /// Of 8 bits.
    pub bytes: f64,
    /// Of depth keys of 16 bits.
    pub key16: f64,
    /// Of the order of the file, which is wrong.
    pub unsorted: f64,
    /// Of blending in the wrong direction.
    pub naive: f64,
}

/// The size of the pictures.
const SIZE: (u32, u32) = (96, 54);

/// Makes the camera's picture small.
pub fn small(camera: Camera) -> Camera {
    camera.resized(SIZE.0, SIZE.1)
}

/// A generated scene of `count` splats and its first camera, in a small picture.
fn generated(name: &str, count: u32) -> (Scene, Camera) {
    let generator = synth::generators().iter().find(|generator| generator.name == name).expect("a generator");
    let camera = (generator.cameras)().swap_remove(0);
    (synth::generate(name, count, 0).expect("it fits in memory"), small(camera))
}

/// A splat in front of a camera at the origin, another for each index.
pub fn plain(index: usize) -> Splat {
    let t = index as f32;
    let mut sh = [0.0; 48];
    (sh[0], sh[1], sh[2]) = (t.sin(), (1.7 * t).sin(), (2.3 * t).cos());
    Splat {
        position: [2.0 * (0.7 * t).sin(), (1.1 * t).cos(), 3.0 + (0.3 * t).sin()],
        scale: [0.1, 0.05, 0.2],
        rotation: [1.0, t.sin(), 0.0, 0.5],
        opacity: 0.5,
        sh,
    }
}

/// A view of the ball from `distance` away.
fn ball(distance: f64, degrees: f64) -> (Scene, Camera) {
    let (scene, _) = generated("uniform", 2000);
    (scene, Camera::looking_at([0.0, 0.0, -distance], [0.0; 3], degrees, SIZE))
}

/// A view of a cloud in a picture of another shape.
fn shaped(width: u32, height: u32) -> (Scene, Camera) {
    let (scene, camera) = generated("needles", 2000);
    let focal = camera.fx * f64::from(width) / f64::from(camera.width);
    (scene, Camera { width, height, fx: focal, fy: focal, ..camera })
}

const NONE: Bounds =
    Bounds { exact: 0.0, worst: 1.0, half: 0.0, bytes: 0.0, key16: 0.0, unsorted: 0.0, naive: 0.0 };

#[rustfmt::skip]
pub const CASES: &[Case] = &[
    Case { name: "giants", scene: || generated("giants", 2000), bounds: NONE },
    Case { name: "needles", scene: || generated("needles", 2000), bounds: NONE },
    Case { name: "quaternions", scene: || generated("quaternions", 2000), bounds: NONE },
    Case { name: "logits", scene: || generated("logits", 2000), bounds: NONE },
    Case { name: "coincident", scene: || generated("coincident", 10_000), bounds: NONE },
    Case { name: "ties", scene: || generated("ties", 2000), bounds: NONE },
    Case { name: "near-plane", scene: || generated("near-plane", 2000), bounds: NONE },
    Case { name: "far", scene: || generated("far", 2000), bounds: NONE },
    Case { name: "remote", scene: || generated("remote", 2000), bounds: NONE },
    Case { name: "fov-1", scene: || ball(120.0, 1.0), bounds: NONE },
    Case { name: "fov-170", scene: || ball(1.5, 170.0), bounds: NONE },
    Case { name: "one-pixel", scene: || shaped(1, 1), bounds: NONE },
    Case { name: "one-row", scene: || shaped(16_384, 1), bounds: NONE },
    Case { name: "layers-opaque", scene: || generated("layers-opaque", 4096), bounds: NONE },
    Case { name: "layers-faint", scene: || generated("layers-faint", 4096), bounds: NONE },
    Case { name: "harmonics", scene: || generated("harmonics", 2000), bounds: NONE },
    Case { name: "cover", scene: || generated("huge", 1), bounds: NONE },
    Case { name: "huge", scene: || generated("huge", 2000), bounds: NONE },
    Case { name: "faint", scene: || generated("faint", 2000), bounds: NONE },
    Case { name: "empty-view", scene: || generated("empty-view", 2000), bounds: NONE },
];

/// Finds a case by its name.
pub fn find(name: &str) -> &'static Case {
    CASES.iter().find(|case| case.name == name).unwrap_or_else(|| panic!("there is no case {name}"))
}
