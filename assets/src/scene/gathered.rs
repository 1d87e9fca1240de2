//! Gathers statistics of splats as they are stored, such as how many were dropped and why.

use super::splat::Splat;
use crate::bounds::{Bounds, largest};
use serde::Serialize;
use std::fmt;

/// Counts of the splats dropped on load or by a transformation. A splat counts for its first reason only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Dropped {
    /// Splats with a coordinate that is NaN, infinite, or beyond the range of f32.
    pub position: u64,
    /// Splats with a scale that is NaN or infinite. A logarithm of negative infinity is a scale of 0, which is kept.
    pub scale: u64,
    /// Splats with a component of the quaternion that is NaN or infinite.
    pub rotation: u64,
    /// Splats with a zero quaternion, which cannot be normalised.
    pub zero_rotation: u64,
    /// Splats with an opacity that is NaN or infinite, or with a logit that is NaN.
    pub opacity: u64,
    /// Splats with a spherical-harmonics coefficient that is NaN or infinite.
    pub color: u64,
}

impl Dropped {
    /// Sums the counts over all reasons.
    pub fn total(&self) -> u64 {
        self.by_reason().iter().map(|(_, count)| count).sum()
    }

    /// Lists every reason in words that follow a count, with its count, which may be zero.
    pub(crate) fn by_reason(&self) -> [(&'static str, u64); 6] {
        [
            ("with a position not finite in f32", self.position),
            ("with a scale not finite in f32", self.scale),
            ("with a quaternion not finite in f32", self.rotation),
            ("with a zero quaternion", self.zero_rotation),
            ("with an opacity not finite in f32", self.opacity),
            ("with a colour not finite in f32", self.color),
        ]
    }

    pub(crate) fn plus(self, other: &Self) -> Self {
        self.with(other, |own, other| own + other)
    }

    /// Subtracts the counts of the scene that this one was derived from, which must not be higher.
    pub fn since(&self, earlier: &Self) -> Self {
        self.with(earlier, |own, earlier| own - earlier)
    }

    fn with(&self, other: &Self, of: impl Fn(u64, u64) -> u64) -> Self {
        Self {
            position: of(self.position, other.position),
            scale: of(self.scale, other.scale),
            rotation: of(self.rotation, other.rotation),
            zero_rotation: of(self.zero_rotation, other.zero_rotation),
            opacity: of(self.opacity, other.opacity),
            color: of(self.color, other.color),
        }
    }

    /// Counts a splat under the first reason to drop it, in the order of the fields. Returns false if there is none.
    /// `norm` is the length of the file's quaternion; the first `sh_floats` coefficients are checked.
    #[inline]
    pub(super) fn count(&mut self, splat: &Splat, norm: f64, sh_floats: usize) -> bool {
        let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
        *if !finite(&splat.position) {
            &mut self.position
        } else if !finite(&splat.scale) {
            &mut self.scale
        } else if !norm.is_finite() {
            &mut self.rotation
        } else if norm == 0.0 {
            &mut self.zero_rotation
        } else if !splat.opacity.is_finite() {
            &mut self.opacity
        } else if !finite(&splat.sh[..sh_floats]) {
            &mut self.color
        } else {
            return false;
        } += 1;
        true
    }
}

impl std::fmt::Display for Dropped {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let counts: Vec<String> = self
            .by_reason()
            .iter()
            .filter(|(_, n)| *n > 0)
            .map(|(reason, n)| format!("{n} {reason}"))
            .collect();
        f.write_str(if counts.is_empty() { "none".into() } else { counts.join(", ") }.as_str())
    }
}

/// Lengths of the file's quaternions before normalisation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct QuaternionNorms {
    /// Length of the shortest quaternion; infinite without splats.
    pub min: f64,
    /// Length of the longest quaternion; 0 without splats.
    pub max: f64,
    /// Number of lengths that differ from 1 by more than [`QuaternionNorms::FAR`].
    pub far_from_unit: u64,
}

impl QuaternionNorms {
    /// Difference from 1 above which a length counts as far.
    pub const FAR: f64 = 0.1;

    const NONE: Self = Self { min: f64::INFINITY, max: 0.0, far_from_unit: 0 };

    pub(super) fn add(&mut self, norm: f64) {
        self.join(&Self { min: norm, max: norm, far_from_unit: u64::from((norm - 1.0).abs() > Self::FAR) });
    }

    pub(super) fn join(&mut self, other: &Self) {
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
        self.far_from_unit += other.far_from_unit;
    }
}

#[derive(Debug)]
pub(crate) struct Gathered {
    pub(super) dropped: Dropped,
    /// Number of opacities that were clamped.
    pub(crate) clamped_opacities: u64,
    pub(super) norms: QuaternionNorms,
    pub(super) effective_degree: u32,
    pub(super) bounds: Bounds,
    /// Largest rounding error of a position, relative to the largest standard deviation of its splat.
    pub(super) rounding: f32,
}

impl Gathered {
    pub(super) fn new() -> Self {
        Self {
            dropped: Dropped::default(),
            clamped_opacities: 0,
            norms: QuaternionNorms::NONE,
            effective_degree: 0,
            bounds: Bounds::EMPTY,
            rounding: 0.0,
        }
    }

    pub(super) fn add_low(&mut self, low: [f32; 3], scale: [f32; 3]) {
        // The lower bound avoids 0 / 0 for a splat without extent. Any rounding of such a splat counts as large.
        self.rounding = self.rounding.max(largest(low) / largest(scale).max(f32::MIN_POSITIVE));
    }

    pub(super) fn join(&mut self, other: &Self) {
        self.dropped = self.dropped.plus(&other.dropped);
        self.clamped_opacities += other.clamped_opacities;
        self.norms.join(&other.norms);
        self.effective_degree = self.effective_degree.max(other.effective_degree);
        self.bounds.join(&other.bounds);
        self.rounding = self.rounding.max(other.rounding);
    }
}

/// Positions that f32 rounded to steps that are large relative to the splats.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CoarsePositions {
    /// Median step of a splat's largest coordinate, or the step of an SPZ file if that is larger, in world units.
    pub step: f64,
    /// Median of the splats' largest standard deviations, in world units.
    pub size: f64,
    /// Translation that moves the scene to the origin, which keeps later sums from being rounded as coarsely.
    #[serde(skip)]
    pub to_origin: [f64; 3],
    /// True if the format of the file can store doubles.
    #[serde(skip)]
    pub has_doubles: bool,
}

impl fmt::Display for CoarsePositions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { step, size, to_origin: [x, y, z], has_doubles } = self;
        let (stored, advice) = match has_doubles {
            true => ("`float`", "with `double`, or near the origin"),
            false => ("the format", "near the origin"),
        };
        write!(
            f,
            "in steps of {step:.1e}, but the median standard deviation is {size:.1e}: {stored} is too coarse so far from \
             the origin; export the scene {advice}; `convert --transform move:{x},{y},{z}` keeps drawing from rounding \
             the positions further"
        )
    }
}
