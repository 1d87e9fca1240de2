//! Defines similarity transforms of the world: a rotation, a uniform scale and a translation.

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};
use std::ops::RangeInclusive;

/// Maximum deviation from the identity of `R * transpose(R)`, where `R` is the matrix divided by its scale.
const TOLERANCE: f64 = 1e-4;

/// Checks the last row of a matrix whose last column is the translation. Fails with a message.
pub(crate) fn affine(row: DVec4) -> Result<(), String> {
    let [x, y, z, w] = row.to_array();
    match row.abs_diff_eq(DVec4::W, 1e-6) {
        true => Ok(()),
        false => Err(format!(
            "expected 0, 0, 0, 1 as the matrix's last row, found {x}, {y}, {z}, {w}; is it transposed?"
        )),
    }
}

/// A rotation, a uniform scale and a translation of the world. Maps `p` to `scale * rotation * p + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Rotation, as a unit quaternion.
    pub rotation: DQuat,
    /// The scale factor, above 0.
    pub scale: f64,
    /// The translation, in world units.
    pub translation: DVec3,
}

impl Similarity {
    /// The similarity that changes nothing.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, scale: 1.0, translation: DVec3::ZERO };

    /// Maximum absolute coordinate of a translation or a camera's position in a file, in world units. The squared
    /// distance between two such positions is within the range of f32.
    pub(crate) const FARTHEST: f64 = 1e18;

    /// Coordinate of a node's origin, in world units, beyond which its positions are relative to that origin: they are
    /// rounded to f32, which is coarse far from 0.
    pub(crate) const FAR: f64 = 4096.0;

    /// Range of the scales that a file may have.
    pub(crate) const SCALES: RangeInclusive<f64> = 1e-9..=1e9;

    /// Decomposes a matrix.
    ///
    /// # Errors
    /// The matrix skews, mirrors or projects, or its numbers are out of range, such as a scale of 0. The error is a
    /// message.
    pub fn of_matrix(matrix: DMat4) -> Result<Self, String> {
        const SKEWED: &str = "expected a rotation, a uniform scale and a translation, found a matrix that skews, mirrors or projects";
        if matrix == DMat4::IDENTITY {
            return Ok(Self::IDENTITY);
        }
        let linear = DMat3::from_mat4(matrix);
        let (scale, translation) = (linear.determinant().cbrt(), matrix.w_axis.truncate());
        let is_near = translation.to_array().iter().all(|v| v.abs() <= Self::FARTHEST);
        if !Self::SCALES.contains(&scale.abs()) || !is_near {
            return Err(format!(
                "expected a scale of 1e-9 to 1e9 and a translation of at most 1e18, found {scale} and {translation}"
            ));
        }
        let turn = linear * (1.0 / scale);
        let is_rotation = (turn * turn.transpose()).abs_diff_eq(DMat3::IDENTITY, TOLERANCE);
        if !(scale > 0.0 && is_rotation && affine(matrix.row(3)).is_ok()) {
            return Err(SKEWED.into());
        }
        Ok(Self { rotation: DQuat::from_mat3(&turn).normalize(), scale, translation })
    }

    /// Composes two similarities: this one first, then `next`.
    pub fn then(self, next: Self) -> Self {
        Self {
            rotation: (next.rotation * self.rotation).normalize(),
            scale: next.scale * self.scale,
            translation: next.point(self.translation),
        }
    }

    /// Transforms a point.
    pub fn point(&self, point: DVec3) -> DVec3 {
        self.rotation * point * self.scale + self.translation
    }
}
