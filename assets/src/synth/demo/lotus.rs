//! Generates the lotus: four rings of petals around a glowing heart.

use super::materials::{Material, UP, blend, diffuse, display};
use super::surface::{Patch, ball, deal, even, flat};
use crate::scene::Splat;
use crate::synth::random::Random;
use glam::{DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// A ring of petals; rings are listed from the outside in.
struct Ring {
    petals: usize,
    length: f64,
    width: f64,
    /// Slope at the root and at the tip, in degrees above the water.
    rise: (f64, f64),
    /// Rotation of the ring, as a share of the angle between petals.
    turn: f64,
}

const RINGS: [Ring; 4] = [
    Ring { petals: 9, length: 0.98, width: 0.235, rise: (4.0, 34.0), turn: 0.0 },
    Ring { petals: 9, length: 0.86, width: 0.225, rise: (20.0, 58.0), turn: 0.5 },
    Ring { petals: 7, length: 0.70, width: 0.205, rise: (40.0, 82.0), turn: 0.2 },
    Ring { petals: 5, length: 0.50, width: 0.165, rise: (50.0, 84.0), turn: 0.6 },
];

struct Petal {
    ring: usize,
    azimuth: f64,
    length: f64,
    lift: f64,
    curl: f64,
}

fn petals_of(random: &mut Random) -> Vec<Petal> {
    let mut petals = Vec::new();
    for (number, ring) in RINGS.iter().enumerate() {
        for petal in 0..ring.petals {
            petals.push(Petal {
                ring: number,
                azimuth: TAU * (petal as f64 + ring.turn + random.range(-0.09, 0.09)) / ring.petals as f64,
                length: ring.length * random.range(0.93, 1.06),
                lift: random.range(-5.0, 5.0),
                curl: random.range(0.8, 1.3),
            });
        }
    }
    petals
}

/// Evaluates a petal's half width at length `u` (0 to 1), relative to the widest. It ends in a point.
fn outline(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    (0.16 + 0.84 * (PI * u.powf(1.15)).sin().max(0.0).powf(0.75)) * (1.0 - u.powi(6)).max(0.0).powf(0.7)
}

impl Petal {
    /// Evaluates a point of the petal: u runs along it, v across, both 0 to 1.
    fn point(&self, uv: DVec2) -> DVec3 {
        const STEPS: usize = 12;
        let ring = &RINGS[self.ring];
        let slope = |u: f64| (ring.rise.0 + self.lift + (ring.rise.1 - ring.rise.0) * u * u).to_radians();
        let (mut out, mut up) = (0.10, 0.045);
        for step in 0..STEPS {
            let angle = slope(uv.x * (step as f64 + 0.5) / STEPS as f64);
            let length = self.length * uv.x / STEPS as f64;
            out += angle.cos() * length;
            up += angle.sin() * length;
        }
        let across = 2.0 * uv.y - 1.0;
        let half = ring.width * outline(uv.x);
        // The edges curve up from the middle, less so towards the tip.
        let cup = self.curl * half * (0.55 - 0.55 * uv.x.powi(3)) * across * across;
        let angle = slope(uv.x);
        let (out, up) = (out - angle.sin() * cup, up + angle.cos() * cup);
        let (sin, cos) = self.azimuth.sin_cos();
        let side = across * half;
        DVec3::new(cos * out - sin * side, -up, sin * out + cos * side)
    }
}

pub(super) fn petals(random: &mut Random, count: usize) -> Vec<Splat> {
    let petals = petals_of(random);
    let weights: Vec<f64> = petals.iter().map(|p| p.length * RINGS[p.ring].width).collect();
    deal(&weights, count)
        .map(|(petal, index, count)| {
            let petal = &petals[petal];
            // The outline is steep at the very tip, where a splat would be a spike.
            let uv = even(index) * DVec2::new(0.965, 1.0);
            let patch = Patch::new(|uv| petal.point(uv), uv);
            // The normal of the upper, inner side.
            let normal = patch.normal_towards(UP);
            let across = (2.0 * uv.y - 1.0).abs();
            let root = blend(DVec3::new(1.0, 0.86, 0.50), DVec3::new(0.94, 0.66, 0.66), uv.x * 2.6);
            let tip = blend(root, DVec3::new(0.80, 0.12, 0.36), (uv.x - 0.22) * 1.35);
            let vein = 0.5 + 0.5 * (across * 31.0 + 0.6 * (9.0 * uv.x).sin()).cos();
            let albedo =
                tip * (0.80 + 0.20 * vein) * (1.0 + 0.04 * random.normal()) * (1.0 - 0.22 * across.powi(4));
            // The roots are in the shade, and inner rings more than outer ones.
            let occlusion = (0.28 + 0.90 * uv.x).min(1.0) * (1.0 - 0.08 * petal.ring as f64);
            let light = diffuse(patch.at, normal, albedo, occlusion * occlusion, 0.25, 0.40);
            let material = Material::new(display(light))
                .gloss(patch.at, normal, 0.16, DVec3::new(1.0, 0.9, 0.9))
                .rim(normal, DVec3::new(0.10, 0.04, 0.07));
            // Thin at the tip and the edge, where the light shines through.
            let opacity = 0.93 - 0.30 * uv.x.powi(3) - 0.18 * across.powi(6);
            patch.splat(count, 1.7, 0.60, opacity, &material)
        })
        .collect()
}

/// Generates the seed pod, the stamens around it, and the glow between them.
pub(super) fn heart(random: &mut Random, count: usize) -> Vec<Splat> {
    const STAMENS: usize = 130;
    const SEGMENTS: usize = 20;
    let stamens = STAMENS.min(count / 2 / SEGMENTS) * SEGMENTS;
    let glows = 6.min(count - stamens);
    let pod = count - stamens - glows;
    let mut splats = Vec::with_capacity(count);
    for index in 0..stamens {
        let (stamen, segment) = (index / SEGMENTS, index % SEGMENTS);
        let azimuth = TAU * even(stamen).x;
        let lean = 0.25 + 0.75 * even(stamen).y;
        let (sin, cos) = azimuth.sin_cos();
        let point = |t: f64| {
            let out = 0.085 + 0.15 * lean * t.powf(1.3);
            DVec3::new(cos * out, -0.06 - 0.24 * t * (1.25 - 0.5 * lean), sin * out)
        };
        let t = (segment as f64 + 0.5) / SEGMENTS as f64;
        let tip = segment >= SEGMENTS - 3;
        let along = point(t + 0.02) - point(t - 0.02);
        let color = if tip { DVec3::new(1.0, 0.80, 0.30) } else { DVec3::new(0.98, 0.66, 0.20) };
        let material =
            Material::new(display(color * (0.55 + 0.75 * t))).sheen(UP, DVec3::new(0.12, 0.09, 0.03));
        let thick = if tip { 0.0062 } else { 0.0026 };
        let scale = DVec3::new(0.34 / SEGMENTS as f64 * 0.6, thick, thick);
        splats.push(flat(
            point(t),
            along,
            along.any_orthonormal_vector().normalize(),
            scale,
            0.92,
            &material,
        ));
    }
    for index in 0..glows {
        let color = display(DVec3::new(1.5, 0.85, 0.38));
        let at = DVec3::new(0.0, -0.14 - 0.06 * index as f64, 0.0);
        splats.push(ball(at, 0.07 + 0.035 * index as f64, 0.16 - 0.02 * index as f64, &Material::new(color)));
    }
    for index in 0..pod {
        // A cone that widens upwards, closed by a flat top with a seed here and there.
        let uv = even(index);
        let surface = |uv: DVec2| {
            let (sin, cos) = (TAU * uv.y).sin_cos();
            let side = (uv.x / 0.55).min(1.0);
            let radius =
                if uv.x < 0.55 { 0.055 + 0.075 * side } else { 0.13 * ((1.0 - uv.x) / 0.45).max(0.0) };
            DVec3::new(
                cos * radius,
                -0.05 - 0.13 * side - 0.012 * ((uv.x - 0.55).max(0.0) * 3.0).sin(),
                sin * radius,
            )
        };
        let patch = Patch::new(surface, uv);
        let normal = patch.normal_towards(UP + patch.at * DVec3::new(4.0, 0.0, 4.0));
        let seeds = (TAU * uv.y * 4.0).cos() * (uv.x * 40.0).cos();
        let green = blend(DVec3::new(0.72, 0.66, 0.14), DVec3::new(0.28, 0.40, 0.10), 1.4 * seeds);
        let light = diffuse(patch.at, normal, green * (1.0 + 0.06 * random.normal()), 0.9, 0.3, 0.0);
        let material = Material::new(display(light)).gloss(patch.at, normal, 0.15, DVec3::ONE);
        splats.push(patch.splat(pod, 1.0, 0.65, 0.95, &material));
    }
    splats
}
