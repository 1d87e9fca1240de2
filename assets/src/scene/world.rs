//! Generates scenes from positions of more precision than f32, such as those of surveyed scenes.

use super::{Scene, Splat, normalised};
use crate::memory::SceneMemoryError;
use crate::ply::origin::Sample;
use crate::words::CHUNK;
use glam::DVec3;
use rayon::prelude::*;

/// Chooses the origin as for a PLY file of doubles.
fn origin(count: u32, position: &impl Fn(usize) -> [f64; 3]) -> [f64; 3] {
    let mut sample = Sample::new([true; 3], count.into());
    for index in (0..count).step_by(sample.every as usize) {
        let position = position(index as usize);
        (0..3).for_each(|axis| sample.add(axis, position[axis]));
    }
    sample.origin()
}

impl Scene {
    /// Generates a scene like [`Scene::try_generate`], from positions in the world; [`Splat::position`] is ignored.
    ///
    /// As for a PLY file of doubles, [`Scene::offset`] is an origin near the splats, to which positions are relative.
    ///
    /// # Errors
    /// The scene does not fit in memory.
    pub fn try_generate_in_world(
        count: u32,
        degree: u32,
        position: impl Fn(usize) -> [f64; 3] + Sync,
        splat: impl Fn(usize) -> Splat + Sync,
    ) -> Result<Self, SceneMemoryError> {
        let origin = origin(count, &position);
        let scene = Self::generated(count, degree, true, |index| {
            let (splat, norm) = normalised(splat(index));
            let world = position(index);
            (splat, std::array::from_fn(|axis| world[axis] - origin[axis]), norm)
        })?;
        Ok(scene.with_offset(origin))
    }

    /// Finds an origin near the splats, if f32 would be too coarse for positions relative to `offset`.
    ///
    /// It is too coarse if it shifts more than a tenth of the splats by more than 1/256 of their size, which is the
    /// largest standard deviation. The positions are the world's.
    pub(crate) fn finer_origin(
        count: u32,
        offset: DVec3,
        position: impl Fn(usize) -> DVec3 + Sync,
        size: impl Fn(usize) -> f64 + Sync,
    ) -> Option<DVec3> {
        const VISIBLE: f64 = 1.0 / 256.0;
        let is_shifted = |index: &usize| {
            let exact = position(*index) - offset;
            (exact - exact.as_vec3().as_dvec3()).abs().max_element() > VISIBLE * size(*index)
        };
        let splats = (0..count as usize).into_par_iter().with_min_len(CHUNK);
        let shifted = splats.filter(is_shifted).count();
        (shifted > count as usize / 10).then(|| origin(count, &|index| position(index).into()).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn splat(index: usize) -> Splat {
        let rotation = if index == 3 { [0.0; 4] } else { [0.0, 3.0, 0.0, 0.0] };
        Splat { position: [0.0; 3], scale: [0.01; 3], rotation, opacity: 0.5, sh: [0.0; 48] }
    }

    #[test]
    fn positions_far_from_the_origin_are_relative_to_an_offset_near_them() {
        let place =
            |index: usize| [1e7 + 0.001 * index as f64, 3.0, if index == 5 { f64::NAN } else { -2e6 }];
        let scene = Scene::try_generate_in_world(2000, 0, place, splat).unwrap();
        assert_eq!(scene.offset(), [10_000_384.0, 0.0, -1_999_872.0]);
        assert_eq!((scene.count(), scene.dropped().total()), (1998, 2));
        let found = scene.world_position(1990)[0];
        assert!((found - place(1992)[0]).abs() < 1e-8, "{found}");
        assert_eq!(scene.splat(0).rotation, [0.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn positions_near_the_origin_have_no_offset_and_are_not_wide() {
        let place = |index: usize| [0.1 * index as f64, 0.1, -0.3];
        let scene = Scene::try_generate_in_world(100, 0, place, splat).unwrap();
        assert_eq!((scene.offset(), scene.is_wide()), ([0.0; 3], false));
        assert_eq!(scene.positions()[7], place(8).map(|v| v as f32));
    }
}
