//! Covers parametric surfaces with splats.

use super::materials::Material;
use crate::scene::Splat;
use glam::{DMat3, DQuat, DVec2, DVec3};

/// Evaluates point `index` of Roberts' R2 sequence, which fills the unit square evenly at every length.
pub(super) fn even(index: usize) -> DVec2 {
    let fraction = |step: f64| (0.5 + step * (index as f64 + 1.0)).fract();
    DVec2::new(fraction(0.754_877_666_246_692_8), fraction(0.569_840_290_998_053_2))
}

pub(super) struct Patch {
    pub at: DVec3,
    /// Unit normal, in the direction of `du x dv`.
    normal: DVec3,
    /// Derivatives with respect to both parameters.
    du: DVec3,
    dv: DVec3,
}

impl Patch {
    /// Evaluates a surface at parameters `uv`, by central differences.
    pub(super) fn new(surface: impl Fn(DVec2) -> DVec3, uv: DVec2) -> Self {
        const H: f64 = 1e-4;
        let du = (surface(uv + DVec2::new(H, 0.0)) - surface(uv - DVec2::new(H, 0.0))) / (2.0 * H);
        let dv = (surface(uv + DVec2::new(0.0, H)) - surface(uv - DVec2::new(0.0, H))) / (2.0 * H);
        Self { at: surface(uv), normal: du.cross(dv).normalize_or(DVec3::Y), du, dv }
    }

    /// Returns the normal on the side of `out`.
    pub(super) fn normal_towards(&self, out: DVec3) -> DVec3 {
        if self.normal.dot(out) < 0.0 { -self.normal } else { self.normal }
    }

    /// Returns a splat that covers its share of the surface.
    ///
    /// `count` splats are spread evenly over the unit square of parameters. `stretch` is the elongation along u
    /// relative to an even share; `cover` is the splat's size relative to its share.
    pub(super) fn splat(
        &self,
        count: usize,
        stretch: f64,
        cover: f64,
        opacity: f64,
        material: &Material,
    ) -> Splat {
        let share = cover / (count as f64).sqrt();
        let scale = DVec3::new(
            self.du.length() * share * stretch,
            self.dv.length() * share / stretch,
            0.12 * (self.du.length() * self.dv.length()).sqrt() * share,
        );
        flat(self.at, self.du, self.normal, scale, opacity, material)
    }
}

/// Returns a splat with its first axis along `along` (made perpendicular to the normal) and its third along `normal`.
pub(super) fn flat(
    at: DVec3,
    along: DVec3,
    normal: DVec3,
    scale: DVec3,
    opacity: f64,
    material: &Material,
) -> Splat {
    let along = (along - normal * normal.dot(along)).normalize_or(normal.any_orthonormal_vector());
    let q = DQuat::from_mat3(&DMat3::from_cols(along, normal.cross(along), normal)).normalize();
    Splat {
        position: at.as_vec3().into(),
        // A surface can shrink to a point, but a splat has a minimum size.
        scale: scale.max(DVec3::splat(2e-4)).as_vec3().into(),
        rotation: [q.w, q.x, q.y, q.z].map(|c| c as f32),
        opacity: opacity.clamp(0.0, 0.995) as f32,
        sh: material.sh(),
    }
}

pub(super) fn ball(at: DVec3, size: f64, opacity: f64, material: &Material) -> Splat {
    flat(at, DVec3::X, DVec3::Y, DVec3::splat(size), opacity, material)
}

/// Distributes `count` splats over objects in proportion to their weights.
///
/// Yields, for each splat, its object, its index within the object, and the object's number of splats.
pub(super) fn deal(weights: &[f64], count: usize) -> impl Iterator<Item = (usize, usize, usize)> {
    let total: f64 = weights.iter().sum();
    let mut sum = 0.0;
    let mut edges = vec![0];
    for weight in weights {
        sum += weight;
        edges.push((count as f64 * sum / total).round() as usize);
    }
    // Rounding must not drop the last splat.
    *edges.last_mut().expect("it has the 0 at least") = if weights.is_empty() { 0 } else { count };
    (0..weights.len()).flat_map(move |thing| {
        let (first, end) = (edges[thing], edges[thing + 1]);
        (0..end - first).map(move |index| (thing, index, end - first))
    })
}
