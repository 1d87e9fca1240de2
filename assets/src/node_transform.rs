//! Moves the splats of a glTF or USD node into the world, and converts them to the axes of scenes.

use crate::harmonics::Turn;
use crate::scene::Splat;
use crate::similarity::Similarity;
use crate::spz;
use glam::{DQuat, DVec3};

/// A transform from the space of a node to a scene's. In the node's world, x points left, y up and z to the front.
pub(crate) struct NodeTransform {
    place: Similarity,
    turn: Turn,
    /// Origin that positions are relative to, in the file's world.
    origin: DVec3,
    degree: u32,
}

impl NodeTransform {
    pub(crate) fn new(place: Similarity, degree: u32) -> Self {
        let far = place.translation.abs().max_element() > Similarity::FAR;
        let origin = if far { place.translation } else { DVec3::ZERO };
        Self { place, turn: Turn::new(place.rotation), origin, degree }
    }

    /// Returns the origin, converted to the axes of scenes.
    pub(crate) fn offset(&self) -> [f64; 3] {
        let [x, y, z] = self.origin.to_array();
        // Subtraction from 0 avoids a negative zero.
        [0.0 - x, 0.0 - y, z]
    }

    pub(crate) fn apply(&self, splat: &mut Splat) {
        let Similarity { rotation, scale, translation } = self.place;
        if self.place != Similarity::IDENTITY {
            let position =
                rotation * DVec3::from(splat.position.map(f64::from)) * scale + (translation - self.origin);
            splat.position = position.to_array().map(|value| value as f32);
            splat.scale = splat.scale.map(|value| (f64::from(value) * scale) as f32);
            let [w, x, y, z] = splat.rotation.map(f64::from);
            let turned = rotation * DQuat::from_xyzw(x, y, z, w);
            splat.rotation = [turned.w, turned.x, turned.y, turned.z].map(|value| value as f32);
            self.turn.apply(&mut splat.sh, self.degree);
        }
        spz::flip(splat, self.degree);
    }
}
