//! Stores the splats of a scene as a structure of arrays.
//!
//! A splat is an anisotropic 3D Gaussian: a centre, a standard deviation along each of three axes, the rotation of these
//! axes, an opacity at the centre, and a view-dependent colour, as real spherical harmonics. All values here are
//! *activated*: scales are standard deviations and not logarithms, opacities are 0 to 1 and not logits, quaternions are
//! unit. A scene is immutable, so derived values are computed once.

use crate::bounds::Bounds;
use crate::harmonics;
use crate::memory::{self, SceneMemoryError};
use crate::size_breakdown::SizeBreakdown;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::OnceLock;

/// Number of splats that one task of a parallel loop converts.
pub(crate) const CHUNK: usize = 8192;

/// Opacity below which the reference rasteriser never draws a splat.
pub const ALPHA_FLOOR: f32 = 1.0 / 255.0;

/// Counts the floats of spherical harmonics of a degree: 3 channels of (degree + 1)^2 coefficients.
pub const fn sh_floats(degree: u32) -> usize {
    3 * ((degree + 1) * (degree + 1)) as usize
}

/// One splat, activated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Centre, in world units, relative to [`Scene::offset`].
    pub position: [f32; 3],
    /// Standard deviation along each axis, in world units.
    pub scale: [f32; 3],
    /// Unit quaternion w, x, y, z that turns the axes into the world.
    pub rotation: [f32; 4],
    /// Opacity at the centre, 0 to 1.
    pub opacity: f32,
    /// Spherical harmonics in the basis of [`crate::harmonics`], zero beyond the scene's degree.
    ///
    /// Coefficient `k` of channel `c` is at `3 * k + c`.
    pub sh: [f32; 48],
}

/// A reason to drop a splat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reason {
    Position,
    Scale,
    Rotation,
    ZeroRotation,
    Opacity,
    Color,
}

/// Counts of the splats dropped on load, by the first reason that applied to each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Dropped {
    /// Splats with a coordinate that is NaN, infinite, or beyond f32.
    pub position: u64,
    /// Splats with a scale that is NaN or infinite, as a logarithm or after the exponential.
    pub scale: u64,
    /// Splats with a component of the quaternion that is NaN or infinite.
    pub rotation: u64,
    /// Splats with a zero quaternion, which has no direction.
    pub zero_rotation: u64,
    /// Splats with a logit that is NaN or infinite.
    pub opacity: u64,
    /// Splats with a spherical-harmonics coefficient that is NaN or infinite.
    pub color: u64,
}

impl Dropped {
    /// Sums the counts over all reasons.
    pub fn total(&self) -> u64 {
        self.by_reason().iter().map(|(_, count)| count).sum()
    }

    /// Lists every reason in words with its count, which may be zero.
    pub fn by_reason(&self) -> [(&'static str, u64); 6] {
        [
            ("position not finite in f32", self.position),
            ("scale not finite in f32", self.scale),
            ("quaternion not finite in f32", self.rotation),
            ("zero quaternion", self.zero_rotation),
            ("opacity not finite in f32", self.opacity),
            ("colour not finite in f32", self.color),
        ]
    }

    fn join(&mut self, other: &Self) {
        self.position += other.position;
        self.scale += other.scale;
        self.rotation += other.rotation;
        self.zero_rotation += other.zero_rotation;
        self.opacity += other.opacity;
        self.color += other.color;
    }

    fn count(&mut self, reason: Reason) {
        *match reason {
            Reason::Position => &mut self.position,
            Reason::Scale => &mut self.scale,
            Reason::Rotation => &mut self.rotation,
            Reason::ZeroRotation => &mut self.zero_rotation,
            Reason::Opacity => &mut self.opacity,
            Reason::Color => &mut self.color,
        } += 1;
    }
}

impl std::fmt::Display for Dropped {
    /// Lists the reasons that apply, as `3 zero quaternion, 1 scale not finite in f32`, or `none`.
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
    /// Length of the shortest.
    pub min: f64,
    /// Length of the longest.
    pub max: f64,
    /// Number of lengths that differ from 1 by more than [`QuaternionNorms::FAR`].
    pub far_from_unit: u64,
}

impl QuaternionNorms {
    /// The difference from 1 that counts as far.
    pub const FAR: f64 = 0.1;

    const NONE: Self = Self { min: f64::INFINITY, max: 0.0, far_from_unit: 0 };

    fn add(&mut self, norm: f64) {
        self.join(&Self { min: norm, max: norm, far_from_unit: u64::from((norm - 1.0).abs() > Self::FAR) });
    }

    fn join(&mut self, other: &Self) {
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
        self.far_from_unit += other.far_from_unit;
    }
}

/// Statistics gathered while the splats are stored.
#[derive(Debug)]
pub(crate) struct Gathered {
    dropped: Dropped,
    norms: QuaternionNorms,
    effective_degree: u32,
    bounds: Bounds,
    /// The largest rounding of a position, in standard deviations of its splat.
    rounding: f32,
}

impl Gathered {
    fn new() -> Self {
        Self {
            dropped: Dropped::default(),
            norms: QuaternionNorms::NONE,
            effective_degree: 0,
            bounds: Bounds::EMPTY,
            rounding: 0.0,
        }
    }

    fn add_low(&mut self, low: [f32; 3], scale: [f32; 3]) {
        let largest = |v: [f32; 3]| v.into_iter().fold(0.0, |most: f32, v| most.max(v.abs()));
        // A splat without any extent is as wide as a pixel at least, wherever it is seen from.
        self.rounding = self.rounding.max(largest(low) / largest(scale).max(f32::MIN_POSITIVE));
    }

    fn join(&mut self, other: &Self) {
        self.dropped.join(&other.dropped);
        self.norms.join(&other.norms);
        self.effective_degree = self.effective_degree.max(other.effective_degree);
        self.bounds.join(&other.bounds);
        self.rounding = self.rounding.max(other.rounding);
    }
}

/// The largest rounding of positions that is left out, in standard deviations: it is invisible beside that of the picture, 100 dB.
const INVISIBLE: f32 = 1.0 / 16_384.0;

/// The arrays, one entry per splat.
#[derive(Clone, Debug)]
pub(crate) struct Columns {
    pub degree: u32,
    pub position: Vec<[f32; 3]>,
    /// What is missing in `position`; empty where nothing is that shows.
    pub low: Vec<[f32; 3]>,
    pub scale: Vec<[f32; 3]>,
    pub rotation: Vec<[f32; 4]>,
    pub opacity: Vec<f32>,
    /// [`sh_floats`] per splat.
    pub sh: Vec<f32>,
}

/// A chunk of [`Columns`] that is being filled.
pub(crate) struct Rows<'a> {
    /// Index of the first splat.
    first: usize,
    /// Number of splats stored so far; those that were dropped leave no gap.
    kept: usize,
    degree: u32,
    position: &'a mut [[f32; 3]],
    /// Empty where positions are floats.
    low: &'a mut [[f32; 3]],
    scale: &'a mut [[f32; 3]],
    rotation: &'a mut [[f32; 4]],
    opacity: &'a mut [f32],
    sh: &'a mut [f32],
    gathered: Gathered,
}

impl Rows<'_> {
    pub(crate) fn first(&self) -> usize {
        self.first
    }

    /// Counts the splats of the chunk, of which each is pushed once.
    pub(crate) fn len(&self) -> usize {
        self.opacity.len()
    }

    /// Stores the next splat, or counts the reason to drop it. `norm` is the length of the file's quaternion.
    #[inline]
    pub(crate) fn push(&mut self, splat: &Splat, norm: f64) {
        self.push_wide(splat, splat.position.map(f64::from), norm);
    }

    /// Stores a splat whose position has more digits than f32, which [`Splat::position`] rounds.
    #[inline]
    pub(crate) fn push_wide(&mut self, splat: &Splat, position: [f64; 3], norm: f64) {
        let floats = sh_floats(self.degree);
        if let Some(reason) = fault(splat, norm, floats) {
            self.gathered.dropped.count(reason);
            return;
        }
        self.gathered.norms.add(norm);
        self.gathered.bounds.add(splat.position);
        while self.gathered.effective_degree < self.degree
            && splat.sh[sh_floats(self.gathered.effective_degree)..floats].iter().any(|c| *c != 0.0)
        {
            self.gathered.effective_degree += 1;
        }
        let index = self.kept;
        self.position[index] = splat.position;
        if !self.low.is_empty() {
            let low = std::array::from_fn(|axis| (position[axis] - f64::from(splat.position[axis])) as f32);
            self.low[index] = low;
            self.gathered.add_low(low, splat.scale);
        }
        self.scale[index] = splat.scale;
        self.rotation[index] = splat.rotation;
        self.opacity[index] = splat.opacity;
        self.sh[index * floats..][..floats].copy_from_slice(&splat.sh[..floats]);
        self.kept += 1;
    }
}

/// Finds the first reason, in the order of [`Reason`], to drop a splat.
fn fault(splat: &Splat, norm: f64, sh_floats: usize) -> Option<Reason> {
    let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
    if !finite(&splat.position) {
        Some(Reason::Position)
    } else if !finite(&splat.scale) {
        Some(Reason::Scale)
    } else if !norm.is_finite() {
        Some(Reason::Rotation)
    } else if norm == 0.0 {
        Some(Reason::ZeroRotation)
    } else if !splat.opacity.is_finite() {
        Some(Reason::Opacity)
    } else if !finite(&splat.sh[..sh_floats]) {
        Some(Reason::Color)
    } else {
        None
    }
}

impl Columns {
    /// Bytes that the further digits of a position take.
    pub(crate) const LOW_BYTES: u64 = size_of::<[f32; 3]>() as u64;

    /// Computes the bytes that a splat takes in all arrays together.
    pub(crate) const fn bytes_per_splat(degree: u32) -> u64 {
        (size_of::<[f32; 3]>() * 2 + size_of::<[f32; 4]>() + size_of::<f32>() * (1 + sh_floats(degree)))
            as u64
    }

    /// Allocates the arrays.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(crate) fn zeroed(count: usize, degree: u32) -> Result<Self, SceneMemoryError> {
        let columns = || {
            Some(Self {
                degree,
                position: memory::zeroed(count)?,
                low: Vec::new(),
                scale: memory::zeroed(count)?,
                rotation: memory::zeroed(count)?,
                opacity: memory::zeroed(count)?,
                sh: memory::zeroed(count.checked_mul(sh_floats(degree))?)?,
            })
        };
        columns().ok_or_else(|| {
            let needed = (count as u64).saturating_mul(Self::bytes_per_splat(degree));
            SceneMemoryError { count: count as u64, degree, needed, available: memory::available() }
        })
    }

    /// Makes room for positions with more digits than f32 has.
    ///
    /// # Errors
    /// It does not fit in memory.
    pub(crate) fn widen(&mut self) -> Result<(), SceneMemoryError> {
        let count = self.position.len();
        self.low = memory::zeroed(count).ok_or_else(|| SceneMemoryError {
            count: count as u64,
            degree: self.degree,
            needed: count as u64 * Self::LOW_BYTES,
            available: memory::available(),
        })?;
        Ok(())
    }

    /// Fills all rows in parallel, one chunk per task, and closes the gaps that dropped splats leave. Of several errors,
    /// returns that of the first chunk.
    pub(crate) fn fill<E: Send>(
        &mut self,
        convert: impl Fn(&mut Rows) -> Result<(), E> + Sync,
    ) -> Result<Gathered, E> {
        let degree = self.degree;
        let mut low = self.low.chunks_mut(CHUNK);
        let low: Vec<&mut [[f32; 3]]> =
            (0..self.position.len().div_ceil(CHUNK)).map(|_| low.next().unwrap_or_default()).collect();
        let chunks: Vec<Result<(usize, Gathered), E>> = self
            .position
            .par_chunks_mut(CHUNK)
            .zip(low)
            .zip(self.scale.par_chunks_mut(CHUNK))
            .zip(self.rotation.par_chunks_mut(CHUNK))
            .zip(self.opacity.par_chunks_mut(CHUNK))
            .zip(self.sh.par_chunks_mut(CHUNK * sh_floats(degree)))
            .enumerate()
            .map(|(chunk, (((((position, low), scale), rotation), opacity), sh))| {
                let (first, gathered) = (chunk * CHUNK, Gathered::new());
                let mut rows =
                    Rows { first, kept: 0, degree, position, low, scale, rotation, opacity, sh, gathered };
                convert(&mut rows)?;
                Ok((rows.kept, rows.gathered))
            })
            .collect();
        let mut all = Gathered::new();
        let mut kept = 0;
        for (chunk, result) in chunks.into_iter().enumerate() {
            let (count, gathered) = result?;
            all.join(&gathered);
            self.shift(chunk * CHUNK, count, kept);
            kept += count;
        }
        self.truncate(kept);
        Ok(all)
    }

    /// Moves `count` splats from index `from` to index `to`, which is not above it.
    fn shift(&mut self, from: usize, count: usize, to: usize) {
        if from == to {
            return;
        }
        let floats = sh_floats(self.degree);
        self.position.copy_within(from..from + count, to);
        if !self.low.is_empty() {
            self.low.copy_within(from..from + count, to);
        }
        self.scale.copy_within(from..from + count, to);
        self.rotation.copy_within(from..from + count, to);
        self.opacity.copy_within(from..from + count, to);
        self.sh.copy_within(from * floats..(from + count) * floats, to * floats);
    }

    fn truncate(&mut self, count: usize) {
        self.position.truncate(count);
        self.low.truncate(count);
        self.scale.truncate(count);
        self.rotation.truncate(count);
        self.opacity.truncate(count);
        self.sh.truncate(count * sh_floats(self.degree));
    }
}

/// The range of a scene's colours: what must fit in the format that they are stored in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ColorRange {
    /// Largest absolute value of a coefficient of the spherical harmonics.
    pub largest_sh: f32,
    /// Display-encoded brightness that no channel of a splat exceeds, from any direction ([`harmonics::brightest`]).
    pub brightest: f64,
}

/// A loaded or generated scene.
#[derive(Debug)]
pub struct Scene {
    pub(crate) columns: Columns,
    offset: [f64; 3],
    effective_degree: u32,
    dropped: Dropped,
    norms: QuaternionNorms,
    bounds: Bounds,
    /// Sizes of the file's parts; empty for a generated scene until they are asked for.
    pub(crate) size_breakdown: OnceLock<SizeBreakdown>,
    robust: OnceLock<Bounds>,
    colors: OnceLock<ColorRange>,
    pub(crate) identity: OnceLock<u64>,
}

impl Scene {
    pub(crate) fn new(
        mut columns: Columns,
        gathered: Gathered,
        size_breakdown: Option<SizeBreakdown>,
    ) -> Self {
        let empty = columns.opacity.is_empty();
        if gathered.rounding < INVISIBLE {
            columns.low = Vec::new();
        }
        Self {
            columns,
            offset: [0.0; 3],
            effective_degree: gathered.effective_degree,
            dropped: gathered.dropped,
            norms: gathered.norms,
            bounds: if empty { Bounds::ORIGIN } else { gathered.bounds },
            size_breakdown: size_breakdown.map_or_else(OnceLock::new, OnceLock::from),
            robust: OnceLock::new(),
            colors: OnceLock::new(),
            identity: OnceLock::new(),
        }
    }

    /// Computes the host memory in bytes that a scene of `count` splats takes, statistics included.
    ///
    /// Its arrays take 44 + 4 * [`sh_floats`] bytes a splat, and robust bounds copy the positions for a moment.
    pub fn host_bytes(count: u64, stored_degree: u32) -> u64 {
        let statistics = size_of::<[f32; 3]>() as u64;
        count.saturating_mul(Columns::bytes_per_splat(stored_degree) + statistics)
    }

    /// Generates a scene of `count` splats with spherical harmonics of `degree`, at most 3.
    ///
    /// `splat` is called with each index, in parallel and in any order. As on load, quaternions are normalised, and splats
    /// that cannot be drawn are dropped and counted.
    ///
    /// # Panics
    /// Panics if the scene does not fit in memory; see [`Scene::try_generate`].
    pub fn generate(count: u32, degree: u32, splat: impl Fn(usize) -> Splat + Sync) -> Self {
        Self::try_generate(count, degree, splat).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Generates a scene as [`Scene::generate`] does.
    ///
    /// # Errors
    /// The scene does not fit in memory.
    pub fn try_generate(
        count: u32,
        degree: u32,
        splat: impl Fn(usize) -> Splat + Sync,
    ) -> Result<Self, SceneMemoryError> {
        let degree = degree.min(3);
        SceneMemoryError::check(count.into(), degree, Self::host_bytes(count.into(), degree))?;
        let mut columns = Columns::zeroed(count as usize, degree)?;
        let filled = columns.fill(|rows| {
            for index in 0..rows.len() {
                let mut splat = splat(rows.first() + index);
                let norm = splat.rotation.iter().map(|c| f64::from(*c).powi(2)).sum::<f64>().sqrt();
                if norm > 0.0 {
                    splat.rotation = splat.rotation.map(|c| (f64::from(c) / norm) as f32);
                }
                rows.push(&splat, norm);
            }
            Ok::<_, std::convert::Infallible>(())
        });
        match filled {
            Ok(gathered) => Ok(Self::new(columns, gathered, None)),
            Err(never) => match never {},
        }
    }

    /// Generates a scene as [`Scene::try_generate`] does, whose positions have more digits than f32.
    ///
    /// `splat` returns the position beside the splat, whose own is not read.
    ///
    /// # Errors
    /// The scene does not fit in memory.
    pub fn try_generate_wide(
        count: u32,
        degree: u32,
        splat: impl Fn(usize) -> (Splat, [f64; 3]) + Sync,
    ) -> Result<Self, SceneMemoryError> {
        let mut columns = Columns::zeroed(count as usize, degree.min(3))?;
        columns.widen()?;
        let filled = columns.fill(|rows| {
            for index in 0..rows.len() {
                let (mut splat, position) = splat(rows.first() + index);
                splat.position = position.map(|v| v as f32);
                rows.push_wide(&splat, position, 1.0);
            }
            Ok::<_, std::convert::Infallible>(())
        });
        match filled {
            Ok(gathered) => Ok(Self::new(columns, gathered, None)),
            Err(never) => match never {},
        }
    }

    /// Places the scene's origin in the world, without a change of the splats' positions, which are relative to it.
    pub fn with_offset(self, offset: [f64; 3]) -> Self {
        Self { offset, ..self }
    }

    /// Returns the world's coordinates of the scene's origin.
    ///
    /// Positions, boxes and cameras are relative to it everywhere but in files. It is 0 unless the file's coordinates have more
    /// digits than f32 holds; [`Camera::relative_to`](crate::Camera::relative_to) brings cameras of the world into the scene.
    pub fn offset(&self) -> [f64; 3] {
        self.offset
    }

    /// Counts the splats, without those that were dropped.
    pub fn count(&self) -> u32 {
        self.columns.opacity.len() as u32
    }

    /// Returns the centres, in world units, relative to [`Scene::offset`].
    pub fn positions(&self) -> &[[f32; 3]] {
        &self.columns.position
    }

    /// Returns true if positions have digits that [`Scene::positions`] lacks, as those of two clouds far from each other do.
    pub fn is_wide(&self) -> bool {
        !self.columns.low.is_empty()
    }

    /// Returns the centre of splat `index` with all of its digits, in world units, relative to [`Scene::offset`].
    ///
    /// # Panics
    /// Panics if `index` is not below [`Scene::count`].
    pub fn position(&self, index: usize) -> [f64; 3] {
        let high = self.columns.position[index].map(f64::from);
        match self.columns.low.get(index) {
            Some(low) => std::array::from_fn(|axis| high[axis] + f64::from(low[axis])),
            None => high,
        }
    }

    /// Returns the standard deviations along each splat's axes, in world units.
    pub fn scales(&self) -> &[[f32; 3]] {
        &self.columns.scale
    }

    /// Returns the unit quaternions, as w, x, y, z.
    pub fn rotations(&self) -> &[[f32; 4]] {
        &self.columns.rotation
    }

    /// Returns the opacities, 0 to 1.
    pub fn opacities(&self) -> &[f32] {
        &self.columns.opacity
    }

    /// Returns the spherical harmonics, [`sh_floats`]`(stored_degree)` floats per splat.
    ///
    /// Within a splat, coefficient `k` of channel `c` is at `3 * k + c`.
    pub fn sh(&self) -> &[f32] {
        &self.columns.sh
    }

    /// Returns the degree of the stored spherical harmonics.
    pub fn stored_degree(&self) -> u32 {
        self.columns.degree
    }

    /// Returns the highest band that is not zero in every splat, the last that a renderer must evaluate.
    pub fn effective_degree(&self) -> u32 {
        self.effective_degree
    }

    /// Returns true if splat `index` can show by the published rules: its opacity is 1/255 or more.
    ///
    /// # Panics
    /// Panics if `index` is not below [`Scene::count`].
    pub fn can_show(&self, index: usize) -> bool {
        self.columns.opacity[index] >= ALPHA_FLOOR
    }

    /// Finds the highest band that is not zero in every splat that [can show](Scene::can_show).
    pub fn shown_degree(&self) -> u32 {
        let (c, floats) = (&self.columns, sh_floats(self.columns.degree));
        let degree = |index: usize| {
            let sh = &c.sh[index * floats..][..floats];
            (1..=c.degree)
                .rev()
                .find(|band| sh[sh_floats(band - 1)..sh_floats(*band)].iter().any(|v| *v != 0.0))
        };
        let shown = (0..c.opacity.len()).into_par_iter().with_min_len(CHUNK).filter(|at| self.can_show(*at));
        shown.filter_map(degree).max().unwrap_or(0)
    }

    /// Copies splat `index`.
    ///
    /// # Panics
    /// Panics if `index` is not below [`Scene::count`].
    pub fn splat(&self, index: usize) -> Splat {
        let c = &self.columns;
        let floats = sh_floats(c.degree);
        let mut sh = [0.0; 48];
        sh[..floats].copy_from_slice(&c.sh[index * floats..][..floats]);
        Splat {
            position: c.position[index],
            scale: c.scale[index],
            rotation: c.rotation[index],
            opacity: c.opacity[index],
            sh,
        }
    }

    /// Returns the counts of the splats dropped on load.
    pub fn dropped(&self) -> &Dropped {
        &self.dropped
    }

    /// Returns the range of the quaternions' lengths before normalisation.
    pub fn quaternion_norms(&self) -> QuaternionNorms {
        self.norms
    }

    /// Returns the box around every centre; [`Bounds::ORIGIN`] for a scene without splats.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Returns the box from the 1st to the 99th percentile of each coordinate, which ignores outliers.
    pub fn robust_bounds(&self) -> Bounds {
        *self.robust.get_or_init(|| Bounds::percentiles(&self.columns.position, 0.01, 0.99))
    }

    /// Returns the range of the spherical harmonics and of the colours that they give. Computed once.
    pub fn color_range(&self) -> ColorRange {
        *self.colors.get_or_init(|| {
            let range = |sh: &[f32]| ColorRange {
                largest_sh: sh.iter().fold(0.0, |most: f32, c| most.max(c.abs())),
                brightest: harmonics::brightest(sh),
            };
            let wider = |a: ColorRange, b: ColorRange| ColorRange {
                largest_sh: a.largest_sh.max(b.largest_sh),
                brightest: a.brightest.max(b.brightest),
            };
            let none = || ColorRange { largest_sh: 0.0, brightest: 0.0 };
            let splats = self.columns.sh.par_chunks_exact(sh_floats(self.columns.degree)).with_min_len(CHUNK);
            splats.map(range).reduce(none, wider)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::splat;

    #[test]
    fn the_effective_degree_is_the_highest_band_in_use() {
        for (float, degree) in [(0, 0), (2, 0), (3, 1), (11, 1), (12, 2), (26, 2), (27, 3), (47, 3)] {
            let scene = Scene::generate(3, 3, |i| {
                let mut s = splat(i);
                s.sh = [0.0; 48];
                if i == 1 {
                    s.sh[float] = -1e-30;
                }
                s
            });
            assert_eq!(scene.effective_degree(), degree, "float {float}");
        }
    }

    #[test]
    fn bad_splats_are_dropped_counted_once_and_the_others_keep_their_order() {
        let count = 3 * CHUNK as u32 / 2;
        let scene = Scene::generate(count, 1, |i| {
            let mut s = splat(i);
            s.position[0] = i as f32;
            match i {
                5 => s.position[2] = f32::NAN,
                6 => (s.scale[1], s.opacity) = (f32::INFINITY, f32::NAN),
                7 => s.rotation[3] = f32::NAN,
                8 => s.rotation = [0.0; 4],
                9 => s.opacity = f32::NEG_INFINITY,
                10 => s.sh[11] = f32::NAN,
                // Beyond the degree: not stored, so not a fault.
                11 => s.sh[12] = f32::NAN,
                _ => {}
            }
            s
        });
        let dropped = Dropped { position: 1, scale: 1, rotation: 1, zero_rotation: 1, opacity: 1, color: 1 };
        assert_eq!(*scene.dropped(), dropped);
        assert_eq!(scene.dropped().total(), 6);
        let xs: Vec<f32> = scene.positions().iter().map(|p| p[0]).collect();
        let expected: Vec<f32> = (0..count).filter(|i| !(5..=10).contains(i)).map(|i| i as f32).collect();
        assert_eq!(xs, expected);
        assert_eq!(scene.splat(5).sh[..12], splat(11).sh[..12]);
    }
}
