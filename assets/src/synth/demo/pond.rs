//! Generates the pond: water, lily pads, reeds and reflections.

use super::materials::{Material, SUN, UP, blend, diffuse, display};
use super::surface::{Patch, deal, even, flat};
use crate::scene::Splat;
use crate::synth::random::Random;
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Radius of the water, in world units; mist hides its edge.
const SHORE: f64 = 9.0;
const REFLECTED: f64 = 0.72;

/// Evaluates the slope of the ripples: rings around the lotus, and a light wind across.
fn ripple(at: DVec3) -> DVec3 {
    let out = DVec3::new(at.x, 0.0, at.z);
    let r = out.length();
    let ring = 0.11 * (r * 15.0).sin() * (-0.55 * r).exp() * (1.0 - (-3.0 * r).exp());
    let wind = DVec3::new((3.1 * at.x + 5.3 * at.z).sin(), 0.0, (4.7 * at.z - 1.9 * at.x).cos()) * 0.045;
    out.normalize_or_zero() * ring + wind
}

/// Generates the water's surface: thin, flat and dark, with the sun's glitter.
pub(super) fn water(random: &mut Random, count: usize) -> Vec<Splat> {
    (0..count)
        .map(|index| {
            // Denser near the middle: rings of equal counts have areas that grow outwards.
            let t = (index as f64 + 0.5) / count as f64;
            let radius = 0.12 + SHORE * t.powf(0.78);
            let azimuth = TAU * (index as f64 * 0.618_033_988_749_895).fract();
            let (sin, cos) = azimuth.sin_cos();
            let at = DVec3::new(radius * cos, 0.002 * random.normal(), radius * sin);
            let normal = (UP + ripple(at)).normalize();
            // The area that one splat must cover.
            let spread = SHORE * 0.78 * t.powf(-0.22);
            let size = 0.46 * (TAU * radius * spread / count as f64).sqrt();
            let sunward =
                0.5 + 0.5 * DVec3::new(cos, 0.0, sin).dot(DVec3::new(SUN.x, 0.0, SUN.z).normalize());
            let deep = blend(
                DVec3::new(0.020, 0.060, 0.095),
                DVec3::new(0.10, 0.060, 0.10),
                sunward * radius / SHORE,
            );
            let far = (radius / SHORE).powi(2);
            // Seen at a low angle against the sun, the water mirrors the glowing sky.
            let low = DVec3::new(-SUN.x, -0.16, -SUN.z).normalize();
            // The visible disc of the sun is lower than `SUN`, the direction of its light.
            let disc = DVec3::new(SUN.x, -0.14, SUN.z).normalize();
            let mirrored = 2.0 * normal.dot(disc) * normal - disc;
            let opposite = DVec3::new(SUN.x, -0.25, SUN.z).normalize();
            let material = Material::new(deep)
                .sheen(low, DVec3::new(0.36, 0.19, 0.15) * (0.45 + 0.55 * far))
                .sheen(opposite, DVec3::new(0.02, 0.05, 0.12))
                .flash(mirrored, DVec3::new(1.05, 0.56, 0.22) * random.range(0.0, 1.4));
            let fade = ((SHORE * 0.98 - radius) / 2.2).clamp(0.0, 1.0);
            let along = DVec3::new(-sin, 0.0, cos);
            flat(at, along, normal, DVec3::new(size * 1.5, size / 1.15, 0.002), 0.36 * fade + 0.01, &material)
        })
        .collect()
}

struct Pad {
    center: DVec2,
    radius: f64,
    notch: f64,
    curl: f64,
}

/// Places lily pads around the lotus, without overlaps.
fn pads(random: &mut Random) -> Vec<Pad> {
    let mut pads: Vec<Pad> = Vec::new();
    for _ in 0..4000 {
        let azimuth = random.range(0.0, TAU);
        let radius = random.range(0.17, 0.46);
        let distance = random.range(0.95, 4.6);
        let center = DVec2::new(azimuth.cos(), azimuth.sin()) * distance;
        // The water in front of the lotus stays open, for its reflection.
        let open = center.y < -0.4 && center.x.abs() < 0.75;
        let clear = pads.iter().all(|p: &Pad| p.center.distance(center) > p.radius + radius + 0.03);
        let group = (2.3 * azimuth + 0.8).sin() * (1.7 * distance).cos();
        if clear && !open && group > -0.15 && pads.len() < 44 {
            pads.push(Pad { center, radius, notch: random.range(0.0, TAU), curl: random.range(0.02, 0.16) });
        }
    }
    pads
}

pub(super) fn lily_pads(random: &mut Random, count: usize) -> Vec<Splat> {
    let pads = pads(random);
    let weights: Vec<f64> = pads.iter().map(|p| p.radius * p.radius).collect();
    deal(&weights, count)
        .map(|(pad, index, count)| {
            let pad = &pads[pad];
            let uv = even(index);
            let surface = |uv: DVec2| {
                // u runs outwards, by area; v around, except in the notch.
                let r = uv.x.max(0.0).sqrt();
                let angle = pad.notch + 0.16 + (TAU - 0.32) * uv.y;
                let edge = pad.radius * (1.0 + 0.025 * (5.0 * angle + pad.notch).sin());
                let rise = 0.006 + pad.curl * pad.radius * r.powi(8) * (0.6 + 0.4 * (3.0 * angle).sin());
                DVec3::new(
                    pad.center.x + edge * r * angle.cos(),
                    -rise,
                    pad.center.y + edge * r * angle.sin(),
                )
            };
            let patch = Patch::new(surface, uv);
            let normal = patch.normal_towards(UP);
            let r = uv.x.sqrt();
            let vein = (0.5 + 0.5 * (uv.y * TAU * 9.0).cos()).powi(6) * (1.0 - 0.5 * r);
            let leaf = blend(DVec3::new(0.018, 0.085, 0.045), DVec3::new(0.045, 0.12, 0.035), r);
            let leaf = blend(leaf, DVec3::new(0.13, 0.20, 0.07), 0.7 * vein);
            let leaf = blend(leaf, DVec3::new(0.26, 0.07, 0.07), (r - 0.90) * 7.0);
            let light = diffuse(patch.at, normal, leaf * (1.0 + 0.10 * random.normal()), 0.9, 0.15, 0.4);
            let material =
                Material::new(display(light)).gloss(patch.at, normal, 0.28, DVec3::new(0.9, 1.0, 0.85));
            patch.splat(count, 1.0, 0.58, 0.96, &material)
        })
        .collect()
}

/// Generates reeds at the pond's edge: curved needles, some with a seed head, against the light.
pub(super) fn reeds(random: &mut Random, count: usize) -> Vec<Splat> {
    const BLADES: usize = 950;
    const CLUMPS: f64 = 14.0;
    /// Half angle of the gap in front of the first camera, in radians.
    const OPEN: f64 = 0.62;
    let blades = BLADES.min(count);
    let mut splats = Vec::with_capacity(count);
    let mut edge = 0;
    for blade in 0..blades {
        // Clumps surround the water, with a gap in front of the first camera.
        let clump = (CLUMPS * random.unit()).floor();
        let azimuth =
            -0.25 * TAU + OPEN + (TAU - 2.0 * OPEN) * (clump + 0.5) / CLUMPS + 0.10 * random.normal();
        let distance = 4.5 + 1.1 * (clump * 2.4).sin() + 0.26 * random.normal();
        let root = DVec3::new(azimuth.cos() * distance, 0.0, azimuth.sin() * distance);
        let height = random.range(0.5, 1.0) * (0.62 + 0.11 * distance);
        let lean_azimuth = random.range(0.0, TAU);
        let lean = random.range(0.05, 0.42) * height;
        let lean = DVec3::new(lean_azimuth.cos() * lean, 0.0, lean_azimuth.sin() * lean);
        let droop = random.range(0.0, 0.30) * height;
        let point = |t: f64| root + lean * t * t - DVec3::Y * (height * t - droop * t.powi(4));
        let head = blade % 9 == 0;
        let next = count * (blade + 1) / blades;
        let segments = next - edge;
        edge = next;
        let tone = random.range(0.7, 1.25);
        for segment in 0..segments {
            let t = (segment as f64 + 0.5) / segments as f64;
            let along = (point(t + 0.01) - point(t - 0.01)).normalize();
            let side = along.cross(UP).normalize_or(DVec3::X);
            let normal = side.cross(along);
            let in_head = head && (0.80..0.97).contains(&t);
            let green = blend(DVec3::new(0.010, 0.028, 0.030), DVec3::new(0.10, 0.13, 0.035), t);
            let albedo = if in_head { DVec3::new(0.20, 0.095, 0.040) } else { green } * tone;
            let light = diffuse(point(t), normal, albedo, 0.15 + 0.85 * t, 0.3, 0.7);
            let material = Material::new(display(light))
                .sheen(-*SUN, DVec3::new(0.16, 0.095, 0.035) * t)
                .flash(DVec3::new(-SUN.x, -0.1, -SUN.z).normalize(), DVec3::new(0.16, 0.09, 0.04) * t * t);
            let length = height / segments as f64 * 0.75;
            let width = if in_head { 0.017 } else { 0.0075 * (1.0 - t).powf(0.6) + 0.0012 };
            splats.push(flat(
                point(t),
                along,
                normal,
                DVec3::new(length, width, width.min(0.004)),
                0.93,
                &material,
            ));
        }
    }
    splats
}

/// Mirrors `count` splats below the water, sampled evenly from `splats`. Returns none if `splats` is empty.
pub(super) fn reflection(random: &mut Random, splats: &[Splat], count: usize) -> Vec<Splat> {
    if splats.is_empty() {
        return Vec::new();
    }
    let share = splats.len() as f64 / count.max(1) as f64;
    (0..count)
        .map(|index| {
            let source = &splats[((index as f64 + 0.5) * share) as usize % splats.len()];
            mirror(source, share.max(1.0).sqrt(), random)
        })
        .collect()
}

/// Mirrors a splat at y = 0, dims it, and displaces it with the ripples.
///
/// `growth` scales the splat, to compensate for omitted splats.
fn mirror(splat: &Splat, growth: f64, random: &mut Random) -> Splat {
    /// Basis functions that are odd in y, and change sign when mirrored.
    const ODD: [usize; 6] = [1, 4, 5, 9, 10, 11];
    let [x, y, z] = splat.position.map(f64::from);
    // The higher an object, the farther its reflection sways.
    let height = (-y).max(0.0);
    let sway = ripple(DVec3::new(0.45 * x, 0.0, 0.45 * z + 0.3 * height)) * height.min(2.0) * 0.35;
    let jitter = 0.004 * height.min(2.5);
    let [w, qx, qy, qz] = splat.rotation;
    let mut sh = splat.sh;
    for k in 0..16 {
        let sign = if ODD.contains(&k) { -1.0 } else { 1.0 };
        for c in 0..3 {
            sh[3 * k + c] *= (sign * REFLECTED) as f32;
        }
    }
    // The 0.5 added to the sum is dimmed as well: max(0, r (sum + 0.5)) = max(0, r sum - 0.5 (1 - r) + 0.5).
    let y0 = crate::harmonics::basis([0.0, 0.0, 1.0])[0];
    for (c, tint) in [0.000, 0.008, 0.022].into_iter().enumerate() {
        sh[c] += ((tint - 0.5 * (1.0 - REFLECTED)) / y0) as f32;
    }
    Splat {
        position: [
            (x + sway.x + jitter * random.normal()) as f32,
            height as f32 + 0.004,
            (z + sway.z + jitter * random.normal()) as f32,
        ],
        scale: splat.scale.map(|s| s * growth as f32),
        // A mirror reflects the axis of a rotation and reverses its angle.
        rotation: [w, -qx, qy, -qz],
        opacity: splat.opacity,
        sh,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::basis;

    #[test]
    fn a_reflection_shows_from_below_what_the_thing_shows_from_above() {
        let splat = crate::testing::splat(3);
        let image = mirror(&splat, 1.0, &mut Random::new(0, 0));
        for d in [[0.6, 0.0, 0.8], [0.36, 0.48, 0.8], [-0.48, -0.6, 0.64]] {
            let color = |s: &Splat, d: [f64; 3]| {
                0.5 + basis(d).iter().enumerate().map(|(k, y)| f64::from(s.sh[3 * k]) * y).sum::<f64>()
            };
            let (seen, real) = (color(&image, d), color(&splat, [d[0], -d[1], d[2]]));
            assert!((seen - REFLECTED * real).abs() < 1e-5, "{seen} {real}");
        }
    }

    #[test]
    fn a_mirrored_covariance_is_the_mirror_of_the_covariance() {
        let mut splat = crate::testing::splat(3);
        splat.rotation = [0.2, 0.4, -0.4, 0.8];
        let image = mirror(&splat, 1.0, &mut Random::new(0, 0));
        let covariance = |s: &Splat| {
            let [w, x, y, z] = s.rotation.map(f64::from);
            let r = glam::DMat3::from_quat(glam::DQuat::from_xyzw(x, y, z, w));
            let s = glam::DMat3::from_diagonal(DVec3::from(s.scale.map(f64::from)));
            r * s * s * r.transpose()
        };
        let m = glam::DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
        assert!(covariance(&image).abs_diff_eq(m * covariance(&splat) * m, 1e-9));
    }
}
