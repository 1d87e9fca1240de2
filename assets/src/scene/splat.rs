//! Defines a splat, and the sizes of its values.

/// Returns the number of spherical-harmonics floats of a degree: 3 channels of (degree + 1)^2 coefficients.
pub const fn sh_floats(degree: u32) -> usize {
    3 * ((degree + 1) * (degree + 1)) as usize
}

/// A splat with activated values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Centre, in world units, relative to [`Scene::offset`](super::Scene::offset).
    pub position: [f32; 3],
    /// Standard deviation along each axis, in world units. Scenes store its absolute value.
    pub scale: [f32; 3],
    /// Unit quaternion w, x, y, z that rotates the axes into the world.
    pub rotation: [f32; 4],
    /// Opacity at the centre, 0 to 1.
    pub opacity: f32,
    /// Spherical harmonics in the basis of [`crate::harmonics`], zero above the scene's degree.
    ///
    /// Coefficient `k` of channel `c` is at `3 * k + c`.
    pub sh: [f32; 48],
}
