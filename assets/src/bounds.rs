//! Computes axis-aligned boxes: around all points, and around the central quantiles.

use rayon::prelude::*;
use serde::Serialize;
use std::fmt;

/// An axis-aligned box; [`Bounds::EMPTY`] contains no point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bounds<T = f32> {
    /// Minimum of each coordinate.
    pub min: [T; 3],
    /// Maximum of each coordinate.
    pub max: [T; 3],
}

/// An axis-aligned box in the world's coordinates.
pub type WorldBounds = Bounds<f64>;

/// Formats the box as `(x, y, z) to (x, y, z)`.
impl fmt::Display for WorldBounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x, y, z], [far_x, far_y, far_z]) = (self.min, self.max);
        let d = self.decimals();
        write!(f, "({x:.d$}, {y:.d$}, {z:.d$}) to ({far_x:.d$}, {far_y:.d$}, {far_z:.d$})")
    }
}

impl WorldBounds {
    /// Returns the number of decimals that show three digits of the longest side.
    pub(crate) fn decimals(&self) -> usize {
        decimals((0..3).map(|axis| self.max[axis] - self.min[axis]).fold(0.0, f64::max), 3)
    }
}

/// Returns the number of decimals, from `digits` to 12, that show that many digits of a length.
pub fn decimals(length: f64, digits: u8) -> usize {
    let least = f64::from(digits);
    let found = least - 1.0 - length.abs().log10().floor();
    if found.is_finite() { found.clamp(least, 12.0) as usize } else { digits.into() }
}

impl Bounds {
    /// The box that contains no point.
    pub const EMPTY: Self = Self { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] };

    /// The box that contains only the origin: gives scenes without splats a centre.
    pub const ORIGIN: Self = Self { min: [0.0; 3], max: [0.0; 3] };

    /// Extends the box to a point.
    pub fn add(&mut self, point: [f32; 3]) {
        self.join(&Self { min: point, max: point });
    }

    /// Extends the box to another box.
    pub fn join(&mut self, other: &Self) {
        self.min = std::array::from_fn(|a| self.min[a].min(other.min[a]));
        self.max = std::array::from_fn(|a| self.max[a].max(other.max[a]));
    }

    /// Converts the box of a scene with this [`Scene::offset`](crate::Scene::offset) to the world's coordinates.
    pub fn in_world(&self, offset: [f64; 3]) -> WorldBounds {
        let world = |corner: [f32; 3]| std::array::from_fn(|a| f64::from(corner[a]) + offset[a]);
        WorldBounds { min: world(self.min), max: world(self.max) }
    }

    /// Returns the centre; NaN for [`Bounds::EMPTY`].
    pub fn center(&self) -> [f64; 3] {
        std::array::from_fn(|a| 0.5 * (f64::from(self.min[a]) + f64::from(self.max[a])))
    }

    /// Returns the length of each side; -inf for [`Bounds::EMPTY`].
    pub fn size(&self) -> [f64; 3] {
        std::array::from_fn(|a| f64::from(self.max[a]) - f64::from(self.min[a]))
    }

    /// Returns the length of the longest side; 0 for [`Bounds::EMPTY`].
    pub fn extent(&self) -> f64 {
        self.size().into_iter().fold(0.0, f64::max)
    }

    /// Returns the eight corners; bit `a` of the index selects the maximum of axis `a`.
    pub fn corners(&self) -> [[f64; 3]; 8] {
        std::array::from_fn(|corner| {
            std::array::from_fn(|a| f64::from(if corner >> a & 1 == 0 { self.min[a] } else { self.max[a] }))
        })
    }

    /// Returns true if a point is inside or on the border.
    pub fn contains(&self, point: [f32; 3]) -> bool {
        (0..3).all(|a| self.min[a] <= point[a] && point[a] <= self.max[a])
    }

    /// Scales the box about its centre.
    pub fn grown(&self, factor: f64) -> Self {
        let (center, size) = (self.center(), self.size());
        Self {
            min: std::array::from_fn(|a| (center[a] - 0.5 * factor * size[a]) as f32),
            max: std::array::from_fn(|a| (center[a] + 0.5 * factor * size[a]) as f32),
        }
    }

    /// Computes the box between two quantiles of each coordinate; [`Bounds::ORIGIN`] without points.
    ///
    /// `low` and `high` are from 0 to 1; the nearest rank is taken.
    pub fn percentiles(points: &[[f32; 3]], low: f64, high: f64) -> Self {
        if points.is_empty() {
            return Self::ORIGIN;
        }
        let axes: Vec<(f32, f32)> = (0..3usize)
            .into_par_iter()
            .map(|a| {
                let mut values: Vec<f32> = points.iter().map(|p| p[a]).collect();
                (quantile(&mut values, low), quantile(&mut values, high))
            })
            .collect();
        Self { min: std::array::from_fn(|a| axes[a].0), max: std::array::from_fn(|a| axes[a].1) }
    }
}

/// Returns the largest absolute value of a vector's components.
pub(crate) fn largest(vector: [f32; 3]) -> f32 {
    vector.into_iter().fold(0.0, |most, value| value.abs().max(most))
}

/// Selects the value at a quantile (0 to 1, nearest rank). Reorders the values; there must be at least one.
pub(crate) fn quantile<T: Copy + Into<f64>>(values: &mut [T], q: f64) -> T {
    let rank = ((values.len() - 1) as f64 * q).round() as usize;
    *values.select_nth_unstable_by(rank, |&a, &b| a.into().total_cmp(&b.into())).1
}

/// Selects the median; 0 without values. Reorders the values.
pub(crate) fn median<T: Copy + Default + Into<f64>>(values: &mut [T]) -> T {
    if values.is_empty() { T::default() } else { quantile(values, 0.5) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_a_box_have_three_digits_of_its_longest_side() {
        let at = |side: f64| WorldBounds { min: [0.0; 3], max: [side, 0.5 * side, 0.0] }.to_string();
        assert_eq!(at(2.5), "(0.000, 0.000, 0.000) to (2.500, 1.250, 0.000)");
        assert_eq!(at(0.0002), "(0.000000, 0.000000, 0.000000) to (0.000200, 0.000100, 0.000000)");
    }

    #[test]
    fn percentiles_ignore_the_outliers_that_the_full_box_holds() {
        let mut points: Vec<[f32; 3]> = (0..=100).map(|i| [i as f32, -(i as f32), 2.0 * i as f32]).collect();
        points[100][0] = 1e9;
        let robust = Bounds::percentiles(&points, 0.01, 0.99);
        assert_eq!((robust.min, robust.max), ([1.0, -99.0, 2.0], [99.0, -1.0, 198.0]));
        assert_eq!(robust.grown(3.0).max[0], 197.0);
        assert!(robust.contains([50.0, -50.0, 50.0]) && !robust.contains(points[100]));
        assert_eq!(robust.extent(), 196.0);
    }
}
