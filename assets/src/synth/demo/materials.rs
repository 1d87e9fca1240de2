//! Computes the spherical harmonics of materials under the demo scene's light.
//!
//! Colours are display-encoded, as in trained scenes. The view-independent part is one colour. The view-dependent part
//! is a sum of lobes, each symmetric about an axis ([`Zonal`]). Lobes are given by the direction *towards the viewer*;
//! harmonics take the direction from the camera, which is its opposite.

use crate::harmonics::{Zonal, basis};
use glam::DVec3;
use std::sync::LazyLock;

/// Direction to the setting sun.
pub(super) static SUN: LazyLock<DVec3> = LazyLock::new(|| DVec3::new(-0.50, -0.36, 0.79).normalize());
/// Direction to the brightest part of the evening sky, opposite the sun.
pub(super) static SKY: LazyLock<DVec3> = LazyLock::new(|| DVec3::new(0.45, -0.75, -0.48).normalize());
/// Position of the lotus's glow.
pub(super) const GLOW: DVec3 = DVec3::new(0.0, -0.22, 0.0);
/// The world's direction up, -y.
pub(super) const UP: DVec3 = DVec3::new(0.0, -1.0, 0.0);

const SUN_COLOR: DVec3 = DVec3::new(2.2, 1.12, 0.50);
const SKY_COLOR: DVec3 = DVec3::new(0.17, 0.25, 0.52);
const AMBIENT: DVec3 = DVec3::new(0.075, 0.065, 0.13);
const GLOW_COLOR: DVec3 = DVec3::new(1.0, 0.55, 0.28);

static TIGHT: LazyLock<Zonal> = LazyLock::new(|| Zonal::lobe(9.0));
static BROAD: LazyLock<Zonal> = LazyLock::new(|| Zonal::lobe(2.2));
/// Reflection at grazing angles: Schlick's approximation with a lower power, because degree 3 cannot represent a higher
/// one.
static RIM: LazyLock<Zonal> = LazyLock::new(|| Zonal::fit(-0.2, |t| (1.0 - t.clamp(0.0, 1.0)).powi(3)));
static FILM_COS: LazyLock<Zonal> = LazyLock::new(|| film(f64::cos));
static FILM_SIN: LazyLock<Zonal> = LazyLock::new(|| film(f64::sin));

/// Fits the interference colours of a thin film. Their phase changes from facing to grazing views.
fn film(wave: fn(f64) -> f64) -> Zonal {
    const TURNS: f64 = 0.75;
    Zonal::fit(-0.05, |t| wave(std::f64::consts::TAU * TURNS * (1.0 - t)))
}

/// Encodes linear light for the display: compresses bright light, clamps it to white, then applies gamma.
pub(super) fn display(linear: DVec3) -> DVec3 {
    let exposed = linear.max(DVec3::ZERO);
    (exposed / (exposed + 0.75) * 1.15).min(DVec3::ONE).map(|c| c.powf(1.0 / 2.2))
}

pub(super) fn blend(from: DVec3, to: DVec3, t: f64) -> DVec3 {
    from.lerp(to, t.clamp(0.0, 1.0))
}

/// Computes the diffusely reflected linear light.
///
/// `wrap` is how far light reaches around the surface, and `through` is the share that passes to the other side: leaves
/// and petals glow against the sun.
pub(super) fn diffuse(
    at: DVec3,
    normal: DVec3,
    albedo: DVec3,
    occlusion: f64,
    wrap: f64,
    through: f64,
) -> DVec3 {
    let facing = |towards: DVec3| {
        let cosine = normal.dot(towards);
        let front = ((cosine + wrap) / (1.0 + wrap)).max(0.0);
        front + through * (-cosine).max(0.0)
    };
    let to_glow = GLOW - at;
    let glow = facing(to_glow.normalize_or(UP)) * 0.16 / (0.10 + to_glow.length_squared());
    let sky = 0.35 * (1.0 + normal.dot(UP)) + 0.65 * facing(*SKY);
    let light = SUN_COLOR * facing(*SUN) * (0.35 + 0.65 * occlusion)
        + occlusion * (SKY_COLOR * sky + AMBIENT)
        + GLOW_COLOR * glow;
    albedo * light
}

/// A splat's material, as spherical harmonics of its colour.
pub(super) struct Material([DVec3; 16]);

impl Material {
    /// Creates a material of one display colour, the same from every direction.
    pub(super) fn new(color: DVec3) -> Self {
        let mut material = Self([DVec3::ZERO; 16]);
        // The reference adds 0.5 to the sum.
        material.0[0] = (color - 0.5) / basis([0.0, 0.0, 1.0])[0];
        material
    }

    fn add(&mut self, lobe: &Zonal, towards: DVec3, color: DVec3) {
        for (sum, c) in self.0.iter_mut().zip(lobe.about((-towards).into())) {
            *sum += c * color;
        }
    }

    /// Adds highlights of sun, sky and lotus on a smooth surface, each in its mirror direction.
    pub(super) fn gloss(mut self, at: DVec3, normal: DVec3, strength: f64, tint: DVec3) -> Self {
        let mirror = |towards: DVec3| 2.0 * normal.dot(towards) * normal - towards;
        let seen = |towards: DVec3| (normal.dot(towards) * 4.0 + 0.4).clamp(0.0, 1.0);
        let (sun, sky) = (*SUN, *SKY);
        let warm = DVec3::new(1.0, 0.80, 0.55) * tint;
        let cool = DVec3::new(0.55, 0.72, 1.0) * tint;
        self.add(&TIGHT, mirror(sun), warm * strength * seen(sun));
        self.add(&BROAD, mirror(sun), warm * 0.22 * strength * seen(sun));
        self.add(&TIGHT, mirror(sky), cool * 0.65 * strength * seen(sky));
        let glow = GLOW - at;
        let near = 0.25 / (0.25 + glow.length_squared());
        let glow = glow.normalize_or(UP);
        self.add(&BROAD, mirror(glow), DVec3::new(1.0, 0.62, 0.35) * 0.5 * near * strength * seen(glow));
        self
    }

    /// Adds a tight lobe of light towards a direction.
    pub(super) fn flash(mut self, towards: DVec3, color: DVec3) -> Self {
        self.add(&TIGHT, towards, color);
        self
    }

    /// Adds a wide lobe of light towards a direction.
    pub(super) fn sheen(mut self, towards: DVec3, color: DVec3) -> Self {
        self.add(&BROAD, towards, color);
        self
    }

    /// Adds light of `color` along the silhouette of a surface with this normal.
    pub(super) fn rim(mut self, normal: DVec3, color: DVec3) -> Self {
        self.add(&RIM, normal, color);
        self
    }

    /// Adds interference colours that vary as the surface turns away; `phase` is in turns.
    pub(super) fn film(mut self, normal: DVec3, phase: f64, strength: f64) -> Self {
        let turn = |offset: f64| std::f64::consts::TAU * (phase + offset);
        let phases = DVec3::new(turn(0.0), turn(0.36), turn(0.64));
        self.add(&FILM_COS, normal, strength * phases.map(f64::cos));
        self.add(&FILM_SIN, normal, -strength * phases.map(f64::sin));
        self
    }

    /// Returns the coefficients; coefficient `k` of channel `c` is at `3 * k + c`.
    pub(super) fn sh(&self) -> [f32; 48] {
        std::array::from_fn(|i| self.0[i / 3][i % 3] as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn color(material: &Material, towards_viewer: DVec3) -> DVec3 {
        let y = basis((-towards_viewer).into());
        DVec3::splat(0.5) + material.0.iter().zip(y).map(|(c, y)| *c * y).sum::<DVec3>()
    }

    #[test]
    fn a_highlight_is_brightest_where_the_viewer_sees_the_sun_mirrored() {
        let normal = DVec3::new(0.2, -0.9, 0.1).normalize();
        let material =
            Material::new(DVec3::splat(0.2)).gloss(DVec3::new(0.0, 50.0, 0.0), normal, 0.5, DVec3::ONE);
        let mirrored = 2.0 * normal.dot(*SUN) * normal - *SUN;
        let there = color(&material, mirrored).x;
        assert!(there > 0.45);
        for other in [*SUN, normal, UP] {
            assert!(color(&material, other).x < there);
        }
    }

    #[test]
    fn a_film_changes_colour_as_it_turns_away() {
        let material = Material::new(DVec3::splat(0.5)).film(UP, 0.0, 0.3);
        let facing = color(&material, UP);
        let turned = color(&material, DVec3::new(0.8, -0.6, 0.0));
        assert!((facing.x - 0.8).abs() < 0.1, "{facing}");
        assert!((facing - turned).length() > 0.2, "{facing} {turned}");
    }
}
