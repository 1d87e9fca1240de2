//! Chooses an origin near the splats of a file whose coordinates exceed the precision of f32.
//!
//! Surveyed scenes lie millions of units from their origin. At that distance f32 resolves half a unit, and the splats
//! would fall onto a lattice. Such files store positions as `double` (or as integers). The origin is subtracted in f64,
//! before the coordinates are rounded to f32.
//!
//! The origin is the median of rows sampled over the whole file, so that outliers do not move it. It is a multiple of
//! [`STEP`], so that it is readable and the subtraction is exact. On axes near the origin nothing is subtracted.

use crate::bounds::median;

/// Spacing of the origins, in world units. At half this distance, f32 resolves 1/16,384 of a unit.
pub(crate) const STEP: f64 = 1024.0;

const SAMPLES: u64 = 1000;

/// A sample of the positions, for choosing the origin.
pub(super) struct Sample {
    /// Sampling stride, in rows.
    pub every: u64,
    /// For each axis, true if the file's type has more precision than f32.
    wide: [bool; 3],
    values: [Vec<f64>; 3],
}

impl Sample {
    /// Starts a sample of `count` positions.
    pub(super) fn new(wide: [bool; 3], count: u64) -> Self {
        Self { every: count.div_ceil(SAMPLES).max(1), wide, values: Default::default() }
    }

    /// Adds a position. Ignores coordinates that are not finite, and axes that are not `wide`.
    pub(super) fn add(&mut self, position: [f64; 3]) {
        for (axis, value) in position.into_iter().enumerate() {
            if self.wide[axis] && value.is_finite() {
                self.values[axis].push(value);
            }
        }
    }

    /// Returns the origin: on each axis, the median rounded to a multiple of [`STEP`]; 0 without coordinates.
    pub(super) fn origin(self) -> [f64; 3] {
        // The sum turns -0 into 0.
        self.values.map(|mut values| (median(&mut values) / STEP).round() * STEP + 0.0)
    }
}

/// Chooses the origin of `count` positions that are wide on every axis.
pub(crate) fn origin(count: u64, position: impl Fn(usize) -> [f64; 3]) -> [f64; 3] {
    let mut sample = Sample::new([true; 3], count);
    (0..count).step_by(sample.every as usize).for_each(|index| sample.add(position(index as usize)));
    sample.origin()
}
