//! The table of extreme cases.

use splatgraph_assets::{Camera, Scene, Splat, synth};

/// A scene with extreme values, and bounds on the errors of its pictures.
pub struct Case {
    pub name: &'static str,
    /// Makes the scene and the camera.
    pub scene: fn() -> (Scene, Camera),
    /// True to draw it with `covariance=factored` as well.
    pub factored: bool,
    pub bounds: Bounds,
}

/// Minimum PSNR in dB by kind of preset, and the largest error of a pixel.
pub struct Bounds {
    /// Quads in the right order, blended in 32-bit floats.
    pub exact: f64,
    /// Largest pixel error of the pictures that `exact` bounds.
    pub worst: f64,
    /// Tiles in 32-bit floats.
    pub tiled_exact: f64,
    /// Tiles with half-float attributes and narrower keys. The bound of the preset `tiled` is 10 dB lower.
    pub tiled: f64,
    /// Half-float targets, which lavapipe truncates, blended in either order.
    pub half: f64,
    /// 8-bit targets; `None` if they are not drawn.
    pub bytes: Option<f64>,
    /// Depth keys of 16 bits.
    pub key16: f64,
    /// Quads blended in the file's order, without a sort.
    pub unsorted: f64,
    /// Quads sorted front to back, with the blend operator for back to front.
    pub naive: f64,
}

const SIZE: (u32, u32) = (96, 54);

pub fn small(camera: Camera) -> Camera {
    camera.resized(SIZE.0, SIZE.1)
}

/// Generates a scene for thousands of splats per pixel, and a camera with half the usual width and height.
fn halved(name: &str, count: u32) -> (Scene, Camera) {
    let (scene, camera) = generated(name, count);
    (scene, camera.resized(SIZE.0 / 2, SIZE.1 / 2))
}

/// Generates a scene of `count` splats; returns it with the generator's first camera, resized.
fn generated(name: &str, count: u32) -> (Scene, Camera) {
    let generator = synth::generators().iter().find(|generator| generator.name == name).expect("a generator");
    let camera = (generator.cameras)().swap_remove(0);
    (synth::generate(name, count, 0).expect("it fits in memory"), small(camera))
}

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

/// Returns a view of a ball of splats from `distance` away, `degrees` wide.
fn ball(distance: f64, degrees: f64) -> (Scene, Camera) {
    let (scene, _) = generated("uniform", 2000);
    (scene, Camera::looking_at([0.0, 0.0, -distance], [0.0; 3], degrees, SIZE))
}

/// Returns a view of needles, `width` x `height` pixels, with the horizontal field of view of the generator's camera.
fn shaped(width: u32, height: u32) -> (Scene, Camera) {
    let (scene, camera) = generated("needles", 500);
    let focal = camera.fx * f64::from(width) / f64::from(camera.width);
    (scene, Camera { width, height, fx: focal, fy: focal, ..camera })
}

#[rustfmt::skip]
pub const CASES: &[Case] = &[
    Case {
        name: "giants", scene: || generated("giants", 500), factored: true,
        bounds: Bounds { exact: 105.0, worst: 1e-3, tiled_exact: 113.0, tiled: 76.0, half: 28.0, bytes: None, key16: 90.0, unsorted: 10.0, naive: 11.0 },
    },
    Case {
        name: "needles", scene: || generated("needles", 2000), factored: true,
        bounds: Bounds { exact: 125.0, worst: 1e-5, tiled_exact: 128.0, tiled: 84.0, half: 35.0, bytes: None, key16: 80.0, unsorted: 13.0, naive: 12.0 },
    },
    Case {
        name: "quaternions", scene: || generated("quaternions", 2000), factored: false,
        bounds: Bounds { exact: 130.0, worst: 1e-5, tiled_exact: 134.0, tiled: 81.0, half: 42.0, bytes: None, key16: 100.0, unsorted: 13.0, naive: 9.0 },
    },
    Case {
        name: "logits", scene: || generated("logits", 2000), factored: false,
        bounds: Bounds { exact: 125.0, worst: 1e-5, tiled_exact: 131.0, tiled: 80.0, half: 50.0, bytes: None, key16: 100.0, unsorted: 16.0, naive: 12.0 },
    },
    Case {
        name: "coincident", scene: || halved("coincident", 10_000), factored: false,
        bounds: Bounds { exact: 115.0, worst: 1e-5, tiled_exact: 120.0, tiled: 87.0, half: 27.0, bytes: None, key16: 125.0, unsorted: 125.0, naive: 16.0 },
    },
    Case {
        name: "ties", scene: || generated("ties", 2000), factored: false,
        bounds: Bounds { exact: 128.0, worst: 1e-5, tiled_exact: 133.0, tiled: 80.0, half: 41.0, bytes: None, key16: 130.0, unsorted: 15.0, naive: 12.0 },
    },
    Case {
        name: "near-plane", scene: || generated("near-plane", 2000), factored: false,
        bounds: Bounds { exact: 125.0, worst: 2e-5, tiled_exact: 136.0, tiled: 80.0, half: 42.0, bytes: None, key16: 100.0, unsorted: 16.0, naive: 12.0 },
    },
    Case {
        name: "far", scene: || generated("far", 2000), factored: false,
        bounds: Bounds { exact: 125.0, worst: 1e-5, tiled_exact: 133.0, tiled: 82.0, half: 47.0, bytes: None, key16: 75.0, unsorted: 17.0, naive: 13.0 },
    },
    Case {
        name: "remote", scene: || generated("remote", 2000), factored: false,
        bounds: Bounds { exact: 125.0, worst: 1e-5, tiled_exact: 133.0, tiled: 82.0, half: 47.0, bytes: None, key16: 100.0, unsorted: 17.0, naive: 13.0 },
    },
    Case {
        name: "two-clouds", scene: || generated("two-clouds", 3000), factored: false,
        bounds: Bounds { exact: 130.0, worst: 1e-5, tiled_exact: 130.0, tiled: 80.0, half: 45.0, bytes: None, key16: 100.0, unsorted: 15.0, naive: 12.0 },
    },
    Case {
        name: "telephoto", scene: || generated("telephoto", 2000), factored: false,
        bounds: Bounds { exact: 92.0, worst: 2e-3, tiled_exact: 92.0, tiled: 80.0, half: 40.0, bytes: None, key16: 40.0, unsorted: 5.0, naive: 5.0 },
    },
    Case {
        name: "millionth", scene: || generated("millionth", 2000), factored: false,
        bounds: Bounds { exact: 110.0, worst: 1e-5, tiled_exact: 110.0, tiled: 70.0, half: 40.0, bytes: None, key16: 40.0, unsorted: 5.0, naive: 5.0 },
    },
    Case {
        name: "askew", scene: || halved("askew", 20_000), factored: false,
        bounds: Bounds { exact: 110.0, worst: 1e-5, tiled_exact: 110.0, tiled: 70.0, half: 20.0, bytes: None, key16: 5.0, unsorted: 5.0, naive: 5.0 },
    },
    Case {
        name: "fov-1", scene: || ball(120.0, 1.0), factored: false,
        bounds: Bounds { exact: 125.0, worst: 1e-5, tiled_exact: 133.0, tiled: 80.0, half: 41.0, bytes: None, key16: 100.0, unsorted: 12.0, naive: 8.0 },
    },
    Case {
        name: "fov-170", scene: || ball(1.5, 170.0), factored: false,
        bounds: Bounds { exact: 140.0, worst: 1e-5, tiled_exact: 149.0, tiled: 99.0, half: 58.0, bytes: None, key16: 120.0, unsorted: 28.0, naive: 26.0 },
    },
    Case {
        name: "one-pixel", scene: || shaped(1, 1), factored: false,
        bounds: Bounds { exact: 120.0, worst: 1e-5, tiled_exact: 139.0, tiled: 76.0, half: 40.0, bytes: None, key16: 100.0, unsorted: 5.0, naive: 5.0 },
    },
    Case {
        name: "one-row", scene: || shaped(16_384, 1), factored: false,
        bounds: Bounds { exact: 100.0, worst: 1e-3, tiled_exact: 109.0, tiled: 85.0, half: 30.0, bytes: None, key16: 80.0, unsorted: 10.0, naive: 10.0 },
    },
    Case {
        name: "layers-opaque", scene: || halved("layers-opaque", 4096), factored: false,
        bounds: Bounds { exact: 135.0, worst: 1e-5, tiled_exact: 139.0, tiled: 75.0, half: 60.0, bytes: Some(50.0), key16: 135.0, unsorted: 135.0, naive: 3.0 },
    },
    Case {
        name: "layers-faint", scene: || halved("layers-faint", 4096), factored: false,
        bounds: Bounds { exact: 100.0, worst: 1e-4, tiled_exact: 104.0, tiled: 91.0, half: 15.0, bytes: Some(6.0), key16: 100.0, unsorted: 100.0, naive: 4.0 },
    },
    Case {
        name: "harmonics", scene: || generated("harmonics", 2000), factored: false,
        bounds: Bounds { exact: 135.0, worst: 5e-5, tiled_exact: 140.0, tiled: 76.0, half: 80.0, bytes: Some(13.0), key16: 120.0, unsorted: 45.0, naive: 45.0 },
    },
    Case {
        name: "cover", scene: || generated("huge", 1), factored: false,
        bounds: Bounds { exact: 140.0, worst: 1e-5, tiled_exact: 150.0, tiled: 84.0, half: 68.0, bytes: Some(50.0), key16: 140.0, unsorted: 140.0, naive: 140.0 },
    },
    Case {
        name: "huge", scene: || generated("huge", 2000), factored: false,
        bounds: Bounds { exact: 130.0, worst: 1e-5, tiled_exact: 136.0, tiled: 82.0, half: 46.0, bytes: None, key16: 110.0, unsorted: 21.0, naive: 12.0 },
    },
    Case {
        name: "faint", scene: || generated("faint", 2000), factored: false,
        bounds: Bounds { exact: 150.0, worst: 1e-5, tiled_exact: 171.0, tiled: 171.0, half: 90.0, bytes: None, key16: 150.0, unsorted: 150.0, naive: 150.0 },
    },
    Case {
        name: "floor", scene: || halved("floor", 4096), factored: false,
        bounds: Bounds { exact: 115.0, worst: 1e-5, tiled_exact: 115.0, tiled: 93.0, half: 14.0, bytes: None, key16: 115.0, unsorted: 115.0, naive: 6.0 },
    },
    Case {
        name: "layers-dark", scene: || halved("layers-dark", 5000), factored: false,
        bounds: Bounds { exact: 200.0, worst: 1e-9, tiled_exact: 200.0, tiled: 200.0, half: 150.0, bytes: None, key16: 200.0, unsorted: 200.0, naive: 200.0 },
    },
    Case {
        name: "bright", scene: || generated("bright", 2000), factored: false,
        bounds: Bounds { exact: 145.0, worst: 1e-4, tiled_exact: 145.0, tiled: 145.0, half: 80.0, bytes: Some(13.0), key16: 140.0, unsorted: 30.0, naive: 30.0 },
    },
    Case {
        name: "crossing", scene: || generated("crossing", 18), factored: false,
        bounds: Bounds { exact: 135.0, worst: 1e-5, tiled_exact: 135.0, tiled: 78.0, half: 50.0, bytes: None, key16: 130.0, unsorted: 8.0, naive: 8.0 },
    },
    Case {
        name: "empty-view", scene: || generated("empty-view", 2000), factored: false,
        bounds: Bounds { exact: f64::INFINITY, worst: 0.0, tiled_exact: f64::INFINITY, tiled: f64::INFINITY, half: f64::INFINITY, bytes: None, key16: f64::INFINITY, unsorted: f64::INFINITY, naive: f64::INFINITY },
    },
];

pub fn find(name: &str) -> &'static Case {
    CASES.iter().find(|case| case.name == name).unwrap_or_else(|| panic!("there is no case {name}"))
}
