//! Generates particles and backdrop: sky, hills, mist, fireflies, dust and drifting petals.

use super::materials::{GLOW, Material, SUN, UP, blend, diffuse, display};
use super::surface::{ball, even, flat};
use crate::scene::Splat;
use crate::synth::random::Random;
use glam::DVec3;
use std::f64::consts::TAU;

const SKY_RADIUS: f64 = 26.0;

/// Computes a direction from azimuth (from +x towards +z) and height above the horizon, in radians.
fn towards(azimuth: f64, elevation: f64) -> DVec3 {
    let (sin, cos) = azimuth.sin_cos();
    DVec3::new(cos * elevation.cos(), -elevation.sin(), sin * elevation.cos())
}

/// Computes the horizontal alignment with the sun: 1 towards it, 0 away from it.
fn sunward(direction: DVec3) -> f64 {
    let flat = |v: DVec3| DVec3::new(v.x, 0.0, v.z).normalize_or(DVec3::Z);
    0.5 + 0.5 * flat(direction).dot(flat(*SUN))
}

fn sky_color(direction: DVec3) -> DVec3 {
    let elevation = (-direction.y).asin().to_degrees();
    let bands = [
        (0.0, DVec3::new(1.00, 0.58, 0.28), DVec3::new(0.20, 0.20, 0.36)),
        (5.0, DVec3::new(0.93, 0.42, 0.30), DVec3::new(0.15, 0.16, 0.32)),
        (12.0, DVec3::new(0.55, 0.27, 0.40), DVec3::new(0.09, 0.10, 0.24)),
        (22.0, DVec3::new(0.22, 0.15, 0.34), DVec3::new(0.045, 0.055, 0.155)),
        (38.0, DVec3::new(0.05, 0.055, 0.14), DVec3::new(0.02, 0.025, 0.08)),
        (60.0, DVec3::ZERO, DVec3::ZERO),
    ];
    let warm = sunward(direction).powf(2.2);
    let color = |i: usize| blend(bands[i].2, bands[i].1, warm);
    let upper = bands.iter().position(|b| b.0 > elevation).unwrap_or(bands.len() - 1).max(1);
    let t = (elevation - bands[upper - 1].0) / (bands[upper].0 - bands[upper - 1].0);
    let t = t.clamp(0.0, 1.0);
    color(upper - 1).lerp(color(upper), t * t * (3.0 - 2.0 * t))
}

/// Generates a band of glow above the horizon that thins into the dark, the low sun, and the stars.
pub(super) fn sky(random: &mut Random, count: usize) -> Vec<Splat> {
    let glow = count * 2 / 5;
    // Equal steps of height have equal areas on a sphere.
    let (low, high) = ((-4f64).to_radians().sin(), 46f64.to_radians().sin());
    let size = 0.56 * SKY_RADIUS * (TAU * (high - low) / glow.max(1) as f64).sqrt();
    let mut splats = Vec::with_capacity(count);
    for index in 0..glow {
        let elevation = (low + (high - low) * (index as f64 + 0.5) / glow as f64).asin();
        let direction = towards(TAU * (index as f64 * 0.618_033_988_749_895).fract(), elevation);
        let fade = ((44.0 - elevation.to_degrees()) / 16.0).clamp(0.0, 1.0);
        let material = Material::new(sky_color(direction));
        let scale = DVec3::new(size, size, 0.02 * size);
        splats.push(flat(direction * SKY_RADIUS, UP, direction, scale, 0.92 * fade + 0.01, &material));
    }
    // The sun itself, low behind the hills.
    let disc = 5.min(count - glow);
    let low_sun = towards(SUN.z.atan2(SUN.x), 0.085);
    for layer in 0..disc {
        let wide = 0.42 * 2.1f64.powi(layer as i32);
        let color = blend(DVec3::new(1.0, 0.93, 0.72), DVec3::new(1.0, 0.55, 0.24), 0.3 * layer as f64);
        let scale = DVec3::new(wide, 1.15 * wide, 0.05);
        let opacity = 0.96 * 0.42f64.powi(layer as i32);
        let at = low_sun * (SKY_RADIUS - 2.0);
        splats.push(flat(at, UP, low_sun, scale, opacity, &Material::new(color)));
    }
    for _ in glow + disc..count {
        let elevation = random.range(0.16, 0.999f64).asin();
        let direction = towards(random.range(0.0, TAU), elevation);
        let bright = random.unit().powi(7);
        let tint = blend(DVec3::new(0.75, 0.84, 1.0), DVec3::new(1.0, 0.82, 0.62), random.unit().powi(2));
        let veil = ((elevation.to_degrees() - 9.0) / 26.0).clamp(0.0, 1.0) * (1.0 - 0.5 * sunward(direction));
        let material = Material::new(tint * (0.35 + 0.65 * bright));
        let size = 0.016 + 0.024 * bright;
        splats.push(ball(direction * (SKY_RADIUS - 1.0), size, veil * (0.45 + 0.54 * bright), &material));
    }
    splats
}

pub(super) fn hills(random: &mut Random, count: usize) -> Vec<Splat> {
    const RIDGES: usize = 3;
    (0..count)
        .map(|index| {
            let ridge = index % RIDGES;
            let uv = even(index / RIDGES);
            let azimuth = TAU * uv.x;
            let distance = 11.5 + 3.6 * ridge as f64;
            let wave = |f: f64, p: f64| (f * azimuth + p + 1.7 * ridge as f64).sin();
            let crest = 0.62
                + 0.48 * ridge as f64
                + 0.42 * wave(3.0, 0.4)
                + 0.26 * wave(7.0, 1.1)
                + 0.12 * wave(17.0, 2.0)
                + 0.05 * wave(41.0, 0.3);
            let crest = crest.max(0.12);
            let height = crest * uv.y.sqrt();
            let out = towards(azimuth, 0.0);
            let at = out * (distance + 0.3 * random.normal()) - DVec3::Y * height;
            let haze = 0.16 + 0.24 * ridge as f64 + 0.22 * (1.0 - height / 1.6).max(0.0);
            let dark = DVec3::new(0.045, 0.050, 0.105);
            let color = blend(dark, sky_color(towards(azimuth, 0.16)), haze);
            // Light from behind catches the tops.
            let rim = sunward(out).powi(4) * (height / crest).powi(14);
            let material = Material::new(color + DVec3::new(0.30, 0.13, 0.05) * rim);
            let width = 0.62 * TAU * distance / (count as f64 / RIDGES as f64).sqrt() * 0.55;
            let tall = (0.05 + 0.18 * (1.0 - uv.y)) * crest.min(1.0);
            flat(at, out.cross(UP), out, DVec3::new(width, tall, 0.05), 0.94, &material)
        })
        .collect()
}

pub(super) fn mist(random: &mut Random, count: usize) -> Vec<Splat> {
    (0..count)
        .map(|_| {
            let azimuth = random.range(0.0, TAU);
            let distance = random.range(2.6, 10.5);
            let direction = towards(azimuth, 0.0);
            let at = direction * distance - DVec3::Y * random.range(0.02, 0.08 + 0.03 * distance);
            let warm =
                blend(DVec3::new(0.26, 0.27, 0.42), DVec3::new(0.86, 0.52, 0.42), sunward(direction).powi(2));
            let size = random.range(0.35, 0.75) * (0.45 + 0.09 * distance);
            let scale = DVec3::new(1.9 * size, 0.8 * size, 0.20 * size);
            // Mist is brightest in front of the sun.
            let material = Material::new(warm * 0.82).sheen(-*SUN, DVec3::new(0.24, 0.13, 0.08));
            let opacity = random.range(0.04, 0.12) + 0.008 * distance;
            flat(at, direction.cross(UP), UP, scale, opacity, &material)
        })
        .collect()
}

pub(super) fn fireflies(random: &mut Random, count: usize) -> Vec<Splat> {
    let mut splats = Vec::with_capacity(count);
    while splats.len() < count {
        let azimuth = random.range(0.0, TAU);
        let distance = random.range(1.3, 5.2);
        let at = towards(azimuth, 0.0) * distance - DVec3::Y * (0.10 + 1.3 * random.unit().powi(2));
        let bright = random.range(0.5, 1.0);
        let color = DVec3::new(1.0, 0.84, 0.42);
        let layers = [
            (0.0050, 0.95, DVec3::new(1.0, 0.97, 0.80)),
            (0.0120, 0.30, color),
            (0.0340, 0.070, color * 0.92),
            (0.0900, 0.020, color * 0.80),
        ];
        for (size, opacity, color) in layers.into_iter().take(count - splats.len()) {
            splats.push(ball(at, size * (0.7 + 0.5 * bright), opacity * bright, &Material::new(color)));
        }
    }
    splats
}

/// Evaluates the spiral from the lotus (`t` = 0) to the knot (1).
fn spiral(t: f64, start: f64) -> DVec3 {
    let azimuth = start + 1.35 * TAU * t;
    let radius = 0.14 + 0.90 * t.powf(0.8);
    DVec3::new(azimuth.cos() * radius, GLOW.y - 0.10 - 2.05 * t, azimuth.sin() * radius)
}

pub(super) fn dust(random: &mut Random, count: usize) -> Vec<Splat> {
    (0..count)
        .map(|index| {
            let t = random.unit().powf(0.85);
            let start = if index % 2 == 0 { 0.4 } else { 0.4 + 0.5 * TAU };
            let spread = 0.018 + 0.085 * t;
            let scatter = DVec3::from(random.direction()) * spread * random.normal();
            let bright = random.unit().powi(3);
            let color = blend(DVec3::new(0.95, 0.55, 0.22), DVec3::new(1.0, 0.90, 0.62), bright);
            // Each flake flashes in its own direction.
            let flash = DVec3::from(random.direction());
            let material = Material::new(color * 0.72).flash(flash, DVec3::new(0.5, 0.42, 0.28));
            let size = 0.0022 + 0.0040 * bright;
            ball(spiral(t, start) + scatter, size, (0.35 + 0.6 * bright) * (1.0 - 0.75 * t), &material)
        })
        .collect()
}

pub(super) fn drifting_petals(random: &mut Random, count: usize) -> Vec<Splat> {
    const PETALS: usize = 46;
    let petals = PETALS.min(count);
    let mut splats = Vec::with_capacity(count);
    for petal in 0..petals {
        let t = random.range(0.12, 1.0);
        let away = DVec3::from(random.direction()) * DVec3::new(0.55, 0.20, 0.55);
        let at = spiral(t, random.range(0.0, TAU)) * DVec3::new(1.25, 1.0, 1.25) + away;
        let turn = {
            let [w, x, y, z] = random.rotation().map(f64::from);
            glam::DQuat::from_xyzw(x, y, z, w)
        };
        let length = random.range(0.055, 0.095);
        let share = count * (petal + 1) / petals - count * petal / petals;
        for index in 0..share {
            let uv = even(index);
            let (u, v) = (uv.x, 2.0 * uv.y - 1.0);
            let half = 0.42 * (std::f64::consts::PI * u.powf(0.8)).sin().max(0.0).powf(0.7);
            let local = DVec3::new(u - 0.5, 0.35 * (u - 0.5).powi(2) + 0.5 * half * v * v, half * v);
            let normal = turn * DVec3::new(-0.7 * (u - 0.5), 1.0, -v * half).normalize();
            let place = at + turn * local * length;
            let color = blend(DVec3::new(0.98, 0.80, 0.76), DVec3::new(0.90, 0.33, 0.50), u);
            let light = diffuse(place, normal, color, 0.9, 0.4, 0.7);
            let material = Material::new(display(light * 0.9)).gloss(place, normal, 0.18, DVec3::ONE);
            let size = length * 0.72 / (share as f64).sqrt();
            splats.push(flat(
                place,
                turn * DVec3::X,
                normal,
                DVec3::new(size * 1.3, size * 0.6, 0.002),
                0.88,
                &material,
            ));
        }
    }
    splats
}
