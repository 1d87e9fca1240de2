//! Generates scenes from positions of more precision than f32, and finds out when f32 is too coarse.

use super::gathered::CoarsePositions;
use super::{Properties, Scene, Splat, normalised};
use crate::bounds::{largest, median};
use crate::memory::SceneMemoryError;
use crate::ply::origin::origin;
use crate::spz::SpzVersion;
use crate::words::CHUNK;
use glam::DVec3;
use rayon::prelude::*;

/// Maximum number of splats in a sample of a scene.
const SAMPLES: usize = 1000;

/// Returns the indices of up to [`SAMPLES`] splats, evenly spaced.
fn sampled(count: u32) -> impl ExactSizeIterator<Item = usize> + Clone {
    let count = count as usize;
    (0..count).step_by(count.div_ceil(SAMPLES).max(1))
}

impl Scene {
    /// Detects positions that were rounded to f32 far from the origin, which cannot be undone. `None` if they are fine,
    /// or wide.
    ///
    /// Up to 1,000 splats are sampled. Positions are coarse if most of these splats have steps above 1/8 of their
    /// largest standard deviation. Steps within 8 times the scene's size from the origin are never coarse, however
    /// small the splats are.
    pub fn coarse_positions(&self) -> Option<CoarsePositions> {
        const VISIBLE: f32 = 1.0 / 8.0;
        let step = |v: f32| v.next_up() - v;
        let (mut steps, mut sizes): (Vec<f32>, Vec<f32>) = sampled(self.count())
            .map(|index| (step(largest(self.positions()[index])), largest(self.scales()[index])))
            .unzip();
        let coarse = steps.iter().zip(&sizes).filter(|(step, size)| **step > VISIBLE * **size).count();
        if self.is_wide() || 2 * coarse <= steps.len() {
            return None;
        }
        let format = &self.size_breakdown().format;
        let found = CoarsePositions {
            step: median(&mut steps).into(),
            size: median(&mut sizes).into(),
            to_origin: self.to_origin(),
            has_doubles: format.starts_with("ply"),
        };
        let bounds = self.robust_bounds();
        let extent = (0..3).map(|axis| bounds.max[axis] - bounds.min[axis]).fold(0.0, f32::max);
        let is_far = found.step > f64::from(8.0 * f32::EPSILON * extent);
        let of_file =
            SpzVersion::position_step(self.largest_coordinate()).filter(|_| format.starts_with("spz"));
        is_far.then(|| CoarsePositions { step: of_file.unwrap_or(0.0).max(found.step), ..found })
    }

    /// Describes coarse positions, as sentences: those of each file of a list of scenes, or else of the whole scene.
    pub fn coarse_notes(&self) -> Vec<String> {
        let parts = self.coarse_parts().iter();
        let notes: Vec<_> = parts.map(|(file, coarse)| format!("{file}: positions are {coarse}")).collect();
        let own = self.coarse_positions().filter(|_| notes.is_empty());
        notes.into_iter().chain(own.map(|coarse| format!("positions are {coarse}"))).collect()
    }

    /// Returns the translation, in whole units, that moves the middle of the scene to the world's origin.
    pub fn to_origin(&self) -> [f64; 3] {
        let (center, offset) = (self.robust_bounds().center(), self.offset());
        std::array::from_fn(|axis| 0.0 - (center[axis] + offset[axis]).round())
    }

    /// Generates a scene like [`Scene::try_generate_with_properties`], from positions in the world; [`Splat::position`] is ignored.
    ///
    /// As for a PLY file of doubles, [`Scene::offset`] is an origin near the splats, to which positions are relative.
    ///
    /// # Errors
    /// The scene does not fit in memory.
    pub fn try_generate_in_world(
        count: u32,
        degree: u32,
        properties: Properties,
        position: impl Fn(usize) -> [f64; 3] + Sync,
        splat: impl Fn(usize) -> Splat + Sync,
    ) -> Result<Self, SceneMemoryError> {
        let origin = origin(count.into(), &position);
        let scene = Self::generated(count, degree, true, properties, |index| {
            let (splat, norm) = normalised(splat(index));
            let world = position(index);
            (splat, std::array::from_fn(|axis| world[axis] - origin[axis]), norm)
        })?;
        Ok(scene.with_offset(origin))
    }

    /// Returns true if f32 suffices for positions in the world. Rounding must shift no splat by more than 1/256 of its
    /// size.
    ///
    /// Shifts of up to one step of floats at 8 times the median distance from the middle are allowed for every size.
    /// `size` returns a splat's largest standard deviation.
    pub(crate) fn fits_floats(
        count: u32,
        position: impl Fn(usize) -> DVec3 + Sync,
        size: impl Fn(usize) -> f64 + Sync,
    ) -> bool {
        let sample = sampled(count);
        let median = |of: &dyn Fn(usize) -> f64| median(&mut sample.clone().map(of).collect::<Vec<_>>());
        let middle = DVec3::from([0, 1, 2].map(|axis: usize| median(&|index| position(index)[axis])));
        let distance = median(&|index| (position(index) - middle).abs().max_element());
        let step = 8.0 * f64::from(f32::EPSILON) * distance;
        let splats = (0..count as usize).into_par_iter().with_min_len(CHUNK);
        splats
            .map(|index| (shift(position(index)), size(index)))
            .all(|(by, size)| by <= step.max(VISIBLE * size))
    }

    /// Finds an origin near the splats if f32 is too coarse for positions relative to `offset`; otherwise `None`.
    ///
    /// f32 is too coarse if rounding shifts more than a tenth of the splats by more than 1/256 of their size, and the
    /// splats are farther from `offset` than about 8 times the scene's size. `position` returns world coordinates.
    pub(crate) fn finer_origin(
        count: u32,
        offset: DVec3,
        position: impl Fn(usize) -> DVec3 + Sync,
        size: impl Fn(usize) -> f64 + Sync,
    ) -> Option<DVec3> {
        /// Mean shift per mean distance from the centre, for splats at 8 times that distance from `offset`.
        const FAR: f64 = 1.0 / 4_194_304.0;
        let is_shifted = |index: &usize| shift(position(*index) - offset) > VISIBLE * size(*index);
        let splats = (0..count as usize).into_par_iter().with_min_len(CHUNK);
        if splats.filter(is_shifted).count() <= count as usize / 10 {
            return None;
        }
        // Tiny splats are shifted near the origin, too, where no other origin helps.
        let sample = sampled(count);
        let mean = |of: &dyn Fn(usize) -> DVec3| sample.clone().map(of).sum::<DVec3>() / sample.len() as f64;
        let centre = mean(&|index| position(index));
        let spread = mean(&|index| (position(index) - centre).abs()).max_element();
        let shift = mean(&|index| DVec3::splat(shift(position(index) - offset))).x;
        (shift > FAR * spread).then(|| origin(count.into(), |index| position(index).into()).into())
    }
}

/// Smallest visible shift of a splat, as a share of its size.
const VISIBLE: f64 = 1.0 / 256.0;

/// Returns the largest error of rounding a coordinate to f32.
fn shift(position: DVec3) -> f64 {
    (position - position.as_vec3().as_dvec3()).abs().max_element()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene_format::SceneFormat;
    use crate::testing::{parse, says, written};

    fn splat(index: usize) -> Splat {
        let rotation = if index == 3 { [0.0; 4] } else { [0.0, 3.0, 0.0, 0.0] };
        Splat { position: [0.0; 3], scale: [0.01; 3], rotation, opacity: 0.5, sh: [0.0; 48] }
    }

    #[test]
    fn positions_far_from_the_origin_are_relative_to_an_offset_near_them() {
        let place =
            |index: usize| [1e7 + 0.001 * index as f64, 3.0, if index == 5 { f64::NAN } else { -2e6 }];
        let scene = Scene::try_generate_in_world(2000, 0, Properties::NONE, place, splat).unwrap();
        assert_eq!(scene.offset(), [10_000_384.0, 0.0, -1_999_872.0]);
        assert_eq!((scene.count(), scene.dropped().total()), (1998, 2));
        let found = scene.world_position(1990)[0];
        assert!((found - place(1992)[0]).abs() < 1e-8, "{found}");
        assert_eq!(scene.splat(0).rotation, [0.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn positions_near_the_origin_have_no_offset_and_are_not_wide() {
        let place = |index: usize| [0.1 * index as f64, 0.1, -0.3];
        let scene = Scene::try_generate_in_world(100, 0, Properties::NONE, place, splat).unwrap();
        assert_eq!((scene.offset(), scene.is_wide()), ([0.0; 3], false));
        assert_eq!(scene.positions()[7], place(8).map(|v| v as f32));
    }

    #[test]
    fn floats_far_from_the_origin_are_coarse_and_doubles_are_not() {
        let place = |index: usize| [5e5, 5e6 + 0.1 * index as f64, 300.0];
        let doubles = Scene::try_generate_in_world(2000, 0, Properties::NONE, place, splat).unwrap();
        assert_eq!(doubles.coarse_positions(), None);
        let floats = |shift: f64| {
            Scene::generate(2000, 0, |index| Splat {
                position: place(index).map(|v| (v - shift) as f32),
                ..splat(index)
            })
        };
        let to_origin = [-500_000.0, -5_000_100.0, -300.0];
        let found = CoarsePositions { step: 0.5, size: 0.01f32.into(), to_origin, has_doubles: true };
        assert_eq!(floats(0.0).coarse_positions(), Some(found));
        let text = crate::report::Report::new(&floats(0.0), &[]).to_string();
        assert!(text.contains("in steps of 5.0e-1, but the median standard deviation is 1.0e-2"), "{text}");
        assert!(floats(5e5).coarse_positions().is_some());
        let spz = parse(&written(&floats(0.0), SceneFormat::Spz)).unwrap().coarse_positions().unwrap();
        assert_eq!(spz.step, 1.0);
        says(
            spz,
            "the format is too coarse so far from the origin; export the scene near the origin; `convert --tr",
        );
        let near = Scene::generate(2000, 0, |index| Splat {
            position: [1000.0, 0.1 * index as f32, 0.0],
            ..splat(index)
        });
        assert_eq!(near.coarse_positions(), None);
    }
}
