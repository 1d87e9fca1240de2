//! Defines similarity transforms of the world: a rotation, a uniform scale and a translation.

use glam::{DQuat, DVec3};

/// A rotation, a uniform scale and a translation of the world: maps `p` to `scale * rotation * p + translation`.
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

    /// Composes two similarities: this one first, then `next`.
    pub fn then(self, next: Self) -> Self {
        Self {
            rotation: (next.rotation * self.rotation).normalize(),
            scale: next.scale * self.scale,
            translation: next.point(self.translation),
        }
    }

    pub(crate) fn point(&self, point: DVec3) -> DVec3 {
        self.rotation * point * self.scale + self.translation
    }
}
