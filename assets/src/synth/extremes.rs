//! Generates scenes that each take one property to its limit, small enough for tests.
//!
//! All but `uniform` are seen from [`camera`]: at the origin, looking along +z.

use super::{Made, random::Random};
use crate::camera::Camera;
use crate::scene::{Scene, Splat};

/// Makes a camera at the origin that looks along +z, so that view depth is exactly z.
pub(super) fn camera() -> Camera {
    Camera { img_name: "origin".into(), ..Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 79.0, (960, 540)) }
}

/// Makes a camera that looks at the unit ball from outside.
pub(super) fn outside() -> Camera {
    Camera { img_name: "outside".into(), ..Camera::looking_at([0.0, -0.6, -2.6], [0.0; 3], 60.0, (960, 540)) }
}

/// Computes the spherical harmonics of a colour (0 to 1) that is the same from every direction.
fn flat(color: [f64; 3]) -> [f32; 48] {
    let y0 = crate::harmonics::basis([0.0, 0.0, 1.0])[0];
    let mut sh = [0.0; 48];
    for (c, value) in color.into_iter().enumerate() {
        sh[c] = ((value - 0.5) / y0) as f32;
    }
    sh
}

/// Evaluates a colour that changes smoothly with position.
fn hue(p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|c| 0.5 + 0.42 * (2.6 * p[c] + 1.3 * p[(c + 1) % 3] + c as f64).sin())
}

fn single(values: [f64; 3]) -> [f32; 3] {
    values.map(|v| v as f32)
}

/// Generates a splat of a cloud in front of [`camera`], between depths 2 and 7.
fn cloud(random: &mut Random, count: u32) -> Splat {
    let [x, y, z] = random.in_ball();
    let position = [3.0 * x, 1.6 * y, 4.5 + 2.5 * z];
    let size = 1.2 * f64::from(count.max(1)).powf(-1.0 / 3.0);
    Splat {
        position: single(position),
        scale: std::array::from_fn(|_| (size * random.range(0.3, 1.0)) as f32),
        rotation: random.rotation(),
        opacity: random.range(0.1, 0.95) as f32,
        sh: flat(hue(position)),
    }
}

/// Generates a ball of radius 1 with all bands of the harmonics in use.
pub(super) fn uniform(count: u32, seed: u64) -> Made {
    let size = 0.9 * f64::from(count.max(1)).powf(-1.0 / 3.0);
    Scene::try_generate(count, 3, |i| {
        let random = &mut Random::new(seed, i as u64);
        let position = random.in_ball();
        let mut sh = flat(hue(position.map(|p| 1.5 * p)));
        sh[3..].iter_mut().for_each(|c| *c = random.range(-0.14, 0.14) as f32);
        Splat {
            position: single(position),
            scale: std::array::from_fn(|_| (size * random.range(0.25, 1.0)) as f32),
            rotation: random.rotation(),
            opacity: random.range(0.05, 0.95) as f32,
            sh,
        }
    })
}

/// Generates needles and plates with axes in ratios of up to 10,000 to 1.
pub(super) fn needles(count: u32, seed: u64) -> Made {
    Scene::try_generate(count, 0, |i| {
        let random = &mut Random::new(seed, i as u64);
        let mut splat = cloud(random, count);
        let long = random.range(0.2, 1.0);
        let ratio = 10f64.powf(random.range(2.0, 4.0));
        // Every third is a thin plate, the others are needles.
        let middle = if i % 3 == 0 { long } else { long / ratio };
        splat.scale = single([long, middle, long / ratio]);
        if i % 3 == 0 {
            splat.opacity *= 0.3;
        }
        splat
    })
}

/// Generates a cloud inside one splat that is a hundred times as large and holds the camera.
pub(super) fn huge(count: u32, seed: u64) -> Made {
    Scene::try_generate(count, 0, |i| {
        let random = &mut Random::new(seed, i as u64);
        let mut splat = cloud(random, count);
        if i == 0 {
            splat.position = [0.5, 0.3, 1.0];
            splat.scale = [200.0, 150.0, 100.0];
            splat.opacity = 0.4;
            splat.sh = flat([0.9, 0.4, 0.2]);
        }
        splat
    })
}

/// Generates a cloud with one splat in a hundred scattered up to a million units away.
pub(super) fn far(count: u32, seed: u64) -> Made {
    Scene::try_generate(count, 0, |i| {
        let random = &mut Random::new(seed, i as u64);
        let mut splat = cloud(random, count);
        if i % 100 == 7 {
            let distance = 10f64.powf(random.range(2.0, 6.0));
            splat.position = single(random.direction().map(|c| c * distance));
            splat.scale = [(0.01 * distance) as f32; 3];
        }
        splat
    })
}

/// Generates eight planes across the view, each with one depth for all of its splats.
pub(super) fn ties(count: u32, seed: u64) -> Made {
    Scene::try_generate(count, 0, |i| {
        let random = &mut Random::new(seed, i as u64);
        let mut splat = cloud(random, count);
        let plane = i % 8;
        splat.position[2] = 2.0 + 0.5 * plane as f32;
        // Larger, so that splats of one plane overlap and their order shows.
        splat.scale = splat.scale.map(|s| 2.0 * s);
        splat.opacity = 0.7;
        // The colour is the order: each is unlike its neighbours in it.
        splat.sh = flat(hue([i as f64 * 0.7, plane as f64, i as f64 * 0.3]));
        splat
    })
}

/// Generates opacities within a thousandth of 1/255, above and below, where alpha is skipped.
pub(super) fn faint(count: u32, seed: u64) -> Made {
    Scene::try_generate(count, 0, |i| {
        let random = &mut Random::new(seed, i as u64);
        let mut splat = cloud(random, count);
        splat.scale = splat.scale.map(|s| 4.0 * s);
        splat.opacity = ((1.0 + random.range(-1e-3, 1e-3)) / 255.0) as f32;
        splat.sh = flat([2.0, 1.5, 1.0]);
        splat
    })
}

/// Generates a cloud behind the camera.
pub(super) fn empty_view(count: u32, seed: u64) -> Made {
    Scene::try_generate(count, 0, |i| {
        let mut splat = cloud(&mut Random::new(seed, i as u64), count);
        splat.position[2] = -splat.position[2];
        splat
    })
}
