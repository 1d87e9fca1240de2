//! Computes the steps of positions in formats that store them as integers between bounds.

use crate::bounds::largest;
use crate::scene::Scene;
use crate::scene_format::SceneFormat;
use crate::size_breakdown::grouped;
use crate::words::CHUNK;
use crate::{ply, sog};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt;

/// Steps of positions that are larger than the splats.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LargeSteps {
    /// Largest step among the splats that are smaller than their step, in world units.
    pub largest: f64,
    /// Number of splats whose largest standard deviation is less than the step of their position.
    pub splats: u64,
}

impl fmt::Display for LargeSteps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = grouped(self.splats);
        write!(f, "steps of up to {:.1e}, larger than the deviations of {count} splats", self.largest)
    }
}

impl Scene {
    /// Counts the splats that are smaller than the steps of their positions in a format. `None` if they are at most
    /// 1/100 of all, or if the format's steps do not depend on the extent of the scene or of a chunk.
    pub fn large_steps(&self, format: SceneFormat) -> Option<LargeSteps> {
        let count = self.count() as usize;
        let of = |step: &(dyn Fn(usize) -> f64 + Sync)| {
            let steps = (0..count).into_par_iter().with_min_len(CHUNK);
            let steps = steps.map(|index| (step(index), largest(self.scales()[index])));
            let large = steps.filter(|(step, size)| *step > f64::from(*size)).map(|(step, _)| (step, 1));
            large.reduce(|| (0.0, 0), |a, b| (a.0.max(b.0), a.1 + b.1))
        };
        let (largest, splats) = match format {
            SceneFormat::Sog => of(&sog::position_steps(self)),
            SceneFormat::CompressedPly => {
                let steps = ply::pack::position_steps(self);
                of(&|index| steps[index].into())
            }
            _ => return None,
        };
        (100 * splats > count as u64).then_some(LargeSteps { largest, splats })
    }
}
