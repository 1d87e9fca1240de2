//! Chooses an origin near the splats of a file whose coordinates exceed the precision of f32.
//!
//! Surveyed scenes lie millions of units from their origin. At that distance f32 resolves half a unit, and the splats
//! would fall onto a lattice. Such files store positions as `double` (or as integers). The origin is subtracted in f64,
//! before the coordinates are rounded to f32.
//!
//! The origin is the median of rows sampled over the whole file, so that outliers do not move it. It is a multiple of
//! [`STEP`], so that it is readable and the subtraction is exact. On axes near the origin nothing is subtracted.

use super::layout::Layout;

/// Spacing of the origins, in world units. At half this distance, f32 resolves 1/16,384 of a unit.
pub(crate) const STEP: f64 = 1024.0;

const SAMPLES: u64 = 1000;

/// A sample of the positions, for choosing the origin.
pub(crate) struct Sample {
    /// Sampling stride, in rows.
    pub every: u64,
    /// For each axis, true if the file's type has more precision than f32.
    pub wide: [bool; 3],
    values: [Vec<f64>; 3],
}

impl Sample {
    /// Starts a sample of `count` rows; `None` if no coordinate of the file has more precision than f32.
    pub(super) fn of(layout: &Layout, count: u64) -> Option<Self> {
        let wide = layout.wide();
        wide.contains(&true).then(|| Self::new(wide, count))
    }

    /// Starts a sample of `count` positions.
    pub(crate) fn new(wide: [bool; 3], count: u64) -> Self {
        Self { every: count.div_ceil(SAMPLES).max(1), wide, values: Default::default() }
    }

    /// Adds a coordinate. Ignores values that are not finite, and axes that are not `wide`.
    pub(crate) fn add(&mut self, axis: usize, value: f64) {
        if self.wide[axis] && value.is_finite() {
            self.values[axis].push(value);
        }
    }

    /// Returns the origin: on each axis, the median rounded to a multiple of [`STEP`]; 0 without coordinates.
    pub(crate) fn origin(self) -> [f64; 3] {
        self.values.map(|mut values| {
            if values.is_empty() {
                return 0.0;
            }
            let middle = values.len() / 2;
            let (_, median, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
            // Turns -0 into 0.
            (*median / STEP).round() * STEP + 0.0
        })
    }
}
