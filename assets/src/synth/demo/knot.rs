//! Generates the knot: a trefoil of a twisted, three-lobed rope with the colours of a thin film.

use super::materials::{Material, UP, blend, diffuse, display};
use super::surface::{Patch, even};
use crate::scene::Splat;
use crate::synth::random::Random;
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

const CENTER: DVec3 = DVec3::new(0.0, -1.52, 0.0);
const RADIUS: f64 = 0.120;
/// Number of turns of the lobes along the rope.
const TWISTS: f64 = 7.0;

/// Evaluates the centre line of the rope, for `s` from 0 to 1.
fn line(s: f64) -> DVec3 {
    let t = TAU * s;
    let p = DVec3::new(t.sin() + 2.0 * (2.0 * t).sin(), t.cos() - 2.0 * (2.0 * t).cos(), -(3.0 * t).sin());
    // Tilted for a better view of the three loops, and thickened along z, its shortest axis.
    let p = DVec3::new(p.x, -p.y, p.z) * DVec3::new(0.190, 0.190, 0.245);
    glam::DQuat::from_rotation_y(0.42) * glam::DQuat::from_rotation_x(0.22) * p + CENTER
}

/// Evaluates the surface of the rope: u runs along it, v around it.
fn rope(uv: DVec2) -> DVec3 {
    const H: f64 = 1e-3;
    let (before, here, after) = (line(uv.x - H), line(uv.x), line(uv.x + H));
    let tangent = (after - before).normalize();
    // The curvature of a trefoil never vanishes, so this frame turns smoothly and closes.
    let bend = before + after - 2.0 * here;
    let normal = (bend - tangent * tangent.dot(bend)).normalize();
    let binormal = tangent.cross(normal);
    let (sin, cos) = (TAU * uv.y).sin_cos();
    here + RADIUS * lobes(uv) * (cos * normal + sin * binormal)
}

/// Evaluates the radius of the cross-section, relative to its mean.
fn lobes(uv: DVec2) -> f64 {
    1.0 + 0.17 * (TAU * (3.0 * uv.y + TWISTS * uv.x)).cos()
}

pub(super) fn knot(random: &mut Random, count: usize) -> Vec<Splat> {
    (0..count)
        .map(|index| {
            let uv = even(index);
            let patch = Patch::new(rope, uv);
            // The normal must point out of the rope.
            let axis = line(uv.x);
            let normal = patch.normal_towards(patch.at - axis);
            let ridge = (lobes(uv) - 0.83) / 0.34;
            // Little light reaches the grooves between the lobes and the inner side of the knot.
            let inward = 0.5 + 0.5 * normal.dot((patch.at - CENTER).normalize_or(UP));
            let occlusion = (0.18 + 0.82 * ridge.powf(0.8)) * (0.45 + 0.55 * inward);
            // A thread of gold lies in each groove.
            let gold = ((0.16 - ridge) / 0.10).clamp(0.0, 1.0);
            let grain = 1.0 + 0.10 * random.normal();
            let drift = (TAU * (2.0 * uv.x)).sin() * 0.12 + 0.018 * random.normal();
            let pearl = blend(DVec3::new(0.06, 0.20, 0.34), DVec3::new(0.30, 0.09, 0.36), 0.5 + 3.0 * drift);
            let albedo = grain * blend(pearl, DVec3::new(0.85, 0.50, 0.16), gold);
            let base = display(diffuse(patch.at, normal, albedo, occlusion, 0.25, 0.0));
            let film = (1.0 - gold) * (0.30 + 0.70 * occlusion);
            let tint = blend(DVec3::ONE, DVec3::new(1.0, 0.78, 0.45), gold);
            let material = Material::new(base)
                .film(normal, 0.56 + drift, 0.16 * film)
                .rim(normal, DVec3::new(0.22, 0.17, 0.34) * film)
                .gloss(patch.at, normal, 0.30 + 0.75 * occlusion, tint);
            patch.splat(count, 1.3, 0.56, 0.96, &material)
        })
        .collect()
}
