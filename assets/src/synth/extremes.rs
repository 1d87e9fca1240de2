//! Generates scenes that each take one property to its limit, small enough for tests.
//!
//! [`super::generators`] describes each scene. Most are seen by [`camera`]: from the origin, looking along +z. The
//! others have their own cameras here.

use super::random::Random;
use crate::activation::flat;
use crate::camera::Camera;
use crate::memory::SceneMemoryError;
use crate::scene::{Scene, Splat};

pub(super) type Made = Result<Scene, SceneMemoryError>;

/// Creates a camera at the origin that looks along +z, so that view depth is exactly z.
pub(super) fn camera() -> Camera {
    Camera { img_name: "origin".into(), ..Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 79.0, (960, 540)) }
}

/// Creates a camera that looks at the unit ball from outside.
pub(super) fn outside() -> Camera {
    Camera { img_name: "outside".into(), ..Camera::looking_at([0.0, -0.6, -2.6], [0.0; 3], 60.0, (960, 540)) }
}

/// Evaluates a colour that changes smoothly with position.
fn hue(p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|c| 0.5 + 0.42 * (2.6 * p[c] + 1.3 * p[(c + 1) % 3] + c as f64).sin())
}

fn single(values: [f64; 3]) -> [f32; 3] {
    values.map(|v| v as f32)
}

/// Generates one of the `count` splats of a cloud in front of [`camera`], between depths 2 and 7.
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

/// Generates splats like [`cloud`]. `change` gets the index, the random numbers and the splat, and changes it.
fn changed_cloud(
    count: u32,
    seed: u64,
    degree: u32,
    change: impl Fn(usize, &mut Random, &mut Splat) + Sync,
) -> Made {
    Scene::try_generate(count, degree, |i| {
        let random = &mut Random::new(seed, i as u64);
        let mut splat = cloud(random, count);
        change(i, random, &mut splat);
        splat
    })
}

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

pub(super) fn needles(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |i, random, splat| {
        let long = random.range(0.2, 1.0);
        let ratio = 10f64.powf(random.range(2.0, 6.0));
        // Every third is a thin plate, the others are needles.
        let middle = if i % 3 == 0 { long } else { long / ratio };
        splat.scale = single([long, middle, long / ratio]);
        if i % 3 == 0 {
            splat.opacity *= 0.3;
        }
    })
}

pub(super) fn huge(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |i, _, splat| {
        if i == 0 {
            splat.position = [0.5, 0.3, 1.0];
            splat.scale = [200.0, 150.0, 100.0];
            splat.opacity = 0.4;
            splat.sh = flat([0.9, 0.4, 0.2]);
        }
    })
}

pub(super) fn far(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |i, random, splat| {
        if i % 100 == 7 {
            let distance = 10f64.powf(random.range(2.0, 6.0));
            splat.position = single(random.direction().map(|c| c * distance));
            splat.scale = [(0.01 * distance) as f32; 3];
        }
    })
}

pub(super) fn ties(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |i, _, splat| {
        let plane = i % 8;
        splat.position[2] = 2.0 + 0.5 * plane as f32;
        // Larger, so that splats of one plane overlap and their order shows.
        splat.scale = splat.scale.map(|s| 2.0 * s);
        splat.opacity = 0.7;
        // The colour encodes the order: each differs from its neighbours.
        splat.sh = flat(hue([i as f64 * 0.7, plane as f64, i as f64 * 0.3]));
    })
}

pub(super) fn faint(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |_, random, splat| {
        splat.scale = splat.scale.map(|s| 4.0 * s);
        splat.opacity = ((1.0 + random.range(-1e-3, 1e-3)) / 255.0) as f32;
        splat.sh = flat([2.0, 1.5, 1.0]);
    })
}

pub(super) fn empty_view(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |_, _, splat| {
        splat.position[2] = -splat.position[2];
    })
}

pub(super) fn giants(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |_, random, splat| {
        splat.scale = std::array::from_fn(|_| random.range(-30.0, 20.0).exp() as f32);
        // Splats that cover the view are faint, so that needles and points are visible.
        let giant = splat.scale.iter().filter(|s| **s > 1.0).count();
        splat.opacity = if giant > 1 { 0.0045 } else { random.range(0.3, 0.9) as f32 };
    })
}

pub(super) fn coincident(count: u32, seed: u64) -> Made {
    Scene::try_generate(count, 0, |i| {
        let random = &mut Random::new(seed, i as u64);
        Splat {
            position: [0.3, 0.2, 4.0],
            scale: std::array::from_fn(|_| random.range(0.05, 0.8) as f32),
            rotation: random.rotation(),
            opacity: random.range(0.05, 0.9) as f32,
            sh: flat(hue([i as f64 * 0.7, 0.0, i as f64 * 0.3])),
        }
    })
}

pub(super) fn near_plane(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |i, random, splat| {
        let near = crate::report::NEAR as f32;
        let [x, y, z] = random.in_ball().map(|v| (0.3 * v) as f32);
        let depth = match i % 6 {
            0 => near,
            1 => near.next_up(),
            2 => near.next_down(),
            3 => near * random.range(1.0, 2.0) as f32,
            4 => -near * random.range(0.5, 2.0) as f32,
            _ => z,
        };
        splat.position = [x, y, depth];
        splat.scale = std::array::from_fn(|_| random.range(0.002, 0.03) as f32);
    })
}

pub(super) fn logits(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |i, _, splat| {
        let sigmoid = |logit: f64| (1.0 / (1.0 + (-logit).exp())) as f32;
        splat.opacity = [0.0, 1.0, sigmoid(-40.0), sigmoid(40.0), 0.5][i % 5];
    })
}

pub(super) fn quaternions(count: u32, seed: u64) -> Made {
    changed_cloud(count, seed, 0, |_, random, splat| {
        let length = 10f64.powf(random.range(-43.0, 38.0));
        splat.rotation = splat.rotation.map(|c| (f64::from(c) * length) as f32);
        // The shortest ones lose most of their digits. The smallest float keeps them from being zero.
        splat.rotation[0] += f32::from_bits(1);
        splat.scale[0] *= 4.0;
    })
}

/// Generates a cloud of degree 3 with random coefficients from `-most` to `most`.
pub(super) fn harmonics(count: u32, seed: u64, most: f64) -> Made {
    changed_cloud(count, seed, 3, |_, random, splat| {
        splat.sh = std::array::from_fn(|_| random.range(-most, most) as f32);
    })
}

/// Creates layer `i` across the whole view, close behind the previous one.
fn layer(i: usize, color: [f64; 3]) -> Splat {
    Splat {
        position: [0.0, 0.0, 2.0 + i as f32 / 1024.0],
        scale: [200.0, 200.0, 0.01],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 0.5,
        sh: flat(color),
    }
}

/// Generates a layer of a colour that differs from the others'.
fn colored_layer(i: usize, count: u32, seed: u64) -> Splat {
    let random = &mut Random::new(seed, i as u64);
    // A gradient, so that a picture shows which layers it contains.
    layer(i, [random.range(0.6, 1.0), random.range(0.3, 0.7), i as f64 / f64::from(count.max(1))])
}

pub(super) fn layers(count: u32, seed: u64, opacity: f32) -> Made {
    Scene::try_generate(count, 0, |i| Splat { opacity, ..colored_layer(i, count, seed) })
}

pub(super) fn layers_dark(count: u32, seed: u64) -> Made {
    Scene::try_generate(count, 0, |i| {
        let opacity = 0.0045 * Random::new(seed, i as u64).range(0.99, 1.01);
        Splat { opacity: opacity as f32, ..layer(i, [0.0; 3]) }
    })
}

/// Generates layers without falloff, whose opacities are within a few units in the last place of the alpha floor. Three
/// of eight opacities are below it.
pub(super) fn floor(count: u32, seed: u64) -> Made {
    let floor = (1.0f32 / 255.0).to_bits();
    Scene::try_generate(count, 0, |i| Splat {
        opacity: f32::from_bits(floor - 3 + i as u32 % 8),
        scale: [1e6, 1e6, 0.01],
        ..colored_layer(i, count, seed)
    })
}

/// View direction of [`crossing_camera`]: the normal of the plates of [`crossing`].
const CROSSING: [f64; 3] = [0.0, 0.939_692_620_785_908_4, 0.342_020_143_325_668_7];

/// Generates groups of 18 splats: six parallel plates, 2e-4 units apart, and twelve points, a unit in front of the
/// plates or behind them.
///
/// The plates' normal is [`CROSSING`]. Only a camera that looks along it needs precise depths to sort the plates: in
/// most other views, their depths differ by much more, because their centres are about a unit apart in their planes.
pub(super) fn crossing(count: u32, seed: u64) -> Made {
    let along = [0.0, -CROSSING[2], CROSSING[1]];
    Scene::try_generate(count, 0, |i| {
        let random = &mut Random::new(seed, i as u64);
        let plate = i % 18;
        let angle = (10.0 + 60.0 * plate as f64 + random.range(-1.0, 1.0)).to_radians();
        let (x, y) = (angle.cos(), angle.sin());
        // In the file, the plates are ordered far to near, 2e-4 units apart. The points are a unit in front of them and
        // a unit behind.
        let z = if plate < 6 { -2e-4 * plate as f64 } else { 1.0 - 2.0 * (plate % 2) as f64 };
        let position = std::array::from_fn(|axis| [x, 0.0, 0.0][axis] + y * along[axis] + z * CROSSING[axis]);
        let half: f64 = 35f64.to_radians();
        Splat {
            position: single(position),
            scale: if plate < 6 { [0.8, 0.8, 1e-3] } else { [1e-3; 3] },
            rotation: [half.cos() as f32, -half.sin() as f32, 0.0, 0.0],
            opacity: 0.9,
            sh: flat(std::array::from_fn(
                |c| if plate % 3 == c { 0.9 } else { 0.1 + 0.1 * (plate % 2) as f64 },
            )),
        }
    })
}

pub(super) fn crossing_camera() -> Camera {
    let position = CROSSING.map(|v| -3.0 * v);
    Camera { img_name: "across".into(), ..Camera::looking_at(position, [0.0; 3], 60.0, (960, 540)) }
}

/// Origin of the cloud of [`remote`], in world units. [`remote_camera`] is near it.
const REMOTE: [f64; 3] = [1e4, -1e4, 1e4];

pub(super) fn remote(count: u32, seed: u64) -> Made {
    Scene::try_generate(count, 0, |i| {
        let mut splat = small_cloud(&mut Random::new(seed, i as u64), count);
        splat.position = std::array::from_fn(|axis| (f64::from(splat.position[axis]) + REMOTE[axis]) as f32);
        splat
    })
}

/// Creates a camera in front of the cloud of [`remote`], at a position that f32 cannot represent exactly.
pub(super) fn remote_camera() -> Camera {
    Camera { img_name: "remote".into(), ..camera().relative_to(REMOTE.map(|v| -v - 0.012_345_678_9)) }
}

pub(super) fn surveyed(count: u32, seed: u64) -> Made {
    let scene = Scene::try_generate(count, 0, |i| small_cloud(&mut Random::new(seed, i as u64), count))?;
    // A multiple of 1,024, so that a reader of the file chooses the same origin.
    Ok(scene.with_offset([9_999_360.0, -9_999_360.0, 9_999_360.0]))
}

/// Generates two distant clouds: one with two thirds of the splats, and one in front of [`two_clouds_camera`].
pub(super) fn two_clouds(count: u32, seed: u64) -> Made {
    let scene = Scene::try_generate_at(count, 0, true, |i| {
        let splat = small_cloud(&mut Random::new(seed, i as u64), count / 3);
        let near = splat.position.map(f64::from);
        let far = [TWO_CLOUDS[0] + 1e7 + near[0], near[1] + 1e7, near[2]];
        let position =
            if i % 3 == 1 { std::array::from_fn(|axis| near[axis] + TWO_CLOUDS[axis]) } else { far };
        (splat, position)
    })?;
    Ok(scene)
}

/// Position of [`two_clouds_camera`], in world units.
const TWO_CLOUDS: [f64; 3] = [-5_000_000.123_456_789, 0.123_456_789, 0.1];

pub(super) fn two_clouds_camera() -> Camera {
    Camera { img_name: "smaller".into(), ..camera().relative_to(TWO_CLOUDS.map(|v| -v)) }
}

/// Creates a camera at `distance` from the origin, where it sees a ball of this radius. The field of view is 1.5 times
/// as wide as the ball.
pub(super) fn telephoto_camera(distance: f64, radius: f64) -> Camera {
    let degrees = 3.0 * (radius / distance).atan().to_degrees();
    let eye = [0.28 * distance, -0.3 * distance, -0.911_921 * distance];
    Camera { img_name: "telephoto".into(), ..Camera::looking_at(eye, [0.0; 3], degrees, (960, 540)) }
}

pub(super) fn millionth(count: u32, seed: u64) -> Made {
    let ball = uniform(count, seed)?;
    Scene::try_generate(count, 3, |i| {
        let mut splat = ball.splat(i);
        splat.position = splat.position.map(|v| 1e-6 * v);
        splat.scale = splat.scale.map(|v| 1e-6 * v);
        splat
    })
}

/// Creates a camera at the origin, askew to all axes.
pub(super) fn askew_camera() -> Camera {
    Camera { img_name: "askew".into(), ..Camera::looking_at([0.0; 3], [-3.1, 4.3, 5.98], 60.0, (960, 540)) }
}

pub(super) fn askew(count: u32, seed: u64) -> Made {
    let [right, down, forward] = askew_camera().axes();
    changed_cloud(count, seed, 0, |i, _, splat| {
        let [x, y, _] = splat.position.map(f64::from);
        splat.position =
            std::array::from_fn(|axis| (8.0 * forward[axis] + x * right[axis] + 1.5 * y * down[axis]) as f32);
        splat.opacity = 0.7;
        splat.sh = flat(hue([i as f64 * 0.7, i as f64 * 0.11, i as f64 * 0.3]));
    })
}

/// Generates a splat of [`cloud`], scaled to 0.3 in size and distance.
fn small_cloud(random: &mut Random, count: u32) -> Splat {
    let mut splat = cloud(random, count);
    splat.position = splat.position.map(|v| 0.3 * v);
    splat.scale = splat.scale.map(|v| 0.3 * v);
    splat
}
