//! Stores splats as arrays that readers fill in parallel.

use super::gathered::Gathered;
use super::splat::{Splat, sh_floats};
use crate::memory::{self, SceneMemoryError};
use crate::words::CHUNK;
use rayon::prelude::*;

/// The arrays of a scene, one entry per splat.
#[derive(Clone, Debug)]
pub(crate) struct Columns {
    pub degree: u32,
    pub position: Vec<[f32; 3]>,
    /// Remainders of `position` below f32 precision; empty if positions are floats, or if all remainders are
    /// negligible.
    pub low: Vec<[f32; 3]>,
    pub scale: Vec<[f32; 3]>,
    pub rotation: Vec<[f32; 4]>,
    pub opacity: Vec<f32>,
    /// Coefficients of the harmonics, [`sh_floats`] per splat.
    pub sh: Vec<f32>,
    /// Names of the properties in `property`.
    pub property_names: Vec<String>,
    /// Values of further properties of the file, as many per splat as there are names.
    pub property: Vec<f32>,
}

/// A chunk of [`Columns`] that is being filled.
pub(crate) struct Rows<'a> {
    first: usize,
    /// Number of splats stored so far; dropped splats leave no gap.
    kept: usize,
    degree: u32,
    position: &'a mut [[f32; 3]],
    /// Remainders below f32 precision; empty if positions are floats.
    low: &'a mut [[f32; 3]],
    scale: &'a mut [[f32; 3]],
    rotation: &'a mut [[f32; 4]],
    opacity: &'a mut [f32],
    sh: &'a mut [f32],
    /// Number of further properties.
    properties: usize,
    property: &'a mut [f32],
    gathered: Gathered,
}

impl Rows<'_> {
    pub(crate) fn first(&self) -> usize {
        self.first
    }

    /// Returns the number of splats in the chunk. The reader must push each of them once.
    pub(crate) fn len(&self) -> usize {
        self.opacity.len()
    }

    /// Stores the further properties of the next splat. `value` returns that of a name, by its index.
    #[inline]
    pub(crate) fn set_properties(&mut self, value: impl Fn(usize) -> f32) {
        let row = &mut self.property[self.kept * self.properties..][..self.properties];
        row.iter_mut().enumerate().for_each(|(name, out)| *out = value(name));
    }

    /// Stores the next splat, or counts the reason to drop it. `norm` is the length of the file's quaternion.
    #[inline]
    pub(crate) fn push(&mut self, splat: &Splat, norm: f64) {
        self.push_wide(splat, splat.position.map(f64::from), norm);
    }

    /// Stores a splat like [`Rows::push`], and clamps an opacity from a file that may store any number.
    #[inline]
    pub(crate) fn push_clamped(&mut self, splat: &Splat, norm: f64) {
        let opacity = splat.opacity.clamp(0.0, 1.0);
        if opacity == splat.opacity || !splat.opacity.is_finite() {
            return self.push(splat, norm);
        }
        self.gathered.clamped_opacities += 1;
        self.push(&Splat { opacity, ..*splat }, norm);
    }

    /// Stores a splat like [`Rows::push`], with a position beyond f32 precision. [`Splat::position`] must be `position`
    /// rounded to f32.
    #[inline]
    pub(crate) fn push_wide(&mut self, splat: &Splat, position: [f64; 3], norm: f64) {
        let floats = sh_floats(self.degree);
        if self.gathered.dropped.count(splat, norm, floats) {
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
        // A negative scale is the same splat. Renderers and the logarithms of files need its absolute value.
        self.scale[index] = splat.scale.map(f32::abs);
        self.rotation[index] = splat.rotation;
        self.opacity[index] = splat.opacity;
        self.sh[index * floats..][..floats].copy_from_slice(&splat.sh[..floats]);
        self.kept += 1;
    }
}

impl Columns {
    /// Bytes of the remainder of a position.
    pub(crate) const LOW_BYTES: u64 = size_of::<[f32; 3]>() as u64;

    /// Computes the bytes per splat in all arrays but the remainders of positions.
    const fn bytes_per_splat(degree: u32) -> u64 {
        (size_of::<[f32; 3]>() * 2 + size_of::<[f32; 4]>() + size_of::<f32>() * (1 + sh_floats(degree)))
            as u64
    }

    /// Computes the host memory of a scene of `count` splats, in bytes, as
    /// [`Scene::host_bytes`](super::Scene::host_bytes) documents.
    pub(crate) fn host_bytes(count: u64, degree: u32) -> u64 {
        let statistics = size_of::<[f32; 3]>() as u64;
        count.saturating_mul(Self::bytes_per_splat(degree) + statistics)
    }

    /// Allocates the arrays of `count` splats. Positions that are `wide` have more precision than f32.
    ///
    /// Fails if the `available` memory is less than the scene and `beside` more bytes, or an allocation fails.
    pub(crate) fn allocate(
        count: u64,
        degree: u32,
        wide: bool,
        beside: u64,
        available: Option<u64>,
    ) -> Result<Self, SceneMemoryError> {
        let low = if wide { count.saturating_mul(Self::LOW_BYTES) } else { 0 };
        let needed = Self::host_bytes(count, degree).saturating_add(low).saturating_add(beside);
        SceneMemoryError::check_against(count, degree, needed, available)?;
        let length = count as usize;
        let columns = || {
            Some(Self {
                degree,
                position: memory::zeroed(length)?,
                low: memory::zeroed(if wide { length } else { 0 })?,
                scale: memory::zeroed(length)?,
                rotation: memory::zeroed(length)?,
                opacity: memory::zeroed(length)?,
                sh: memory::zeroed(length.checked_mul(sh_floats(degree))?)?,
                property_names: Vec::new(),
                property: Vec::new(),
            })
        };
        columns().ok_or(SceneMemoryError { count, degree, needed, available })
    }

    /// Allocates arrays for further properties.
    ///
    /// Fails if an allocation fails.
    pub(crate) fn with_properties(self, names: &[String]) -> Result<Self, SceneMemoryError> {
        let (count, degree) = (self.opacity.len(), self.degree);
        let property = memory::zeroed(count * names.len()).ok_or_else(|| SceneMemoryError {
            count: count as u64,
            degree,
            needed: (count * names.len() * size_of::<f32>()) as u64,
            available: None,
        })?;
        Ok(Self { property_names: names.to_vec(), property, ..self })
    }

    /// Fills all rows in parallel, one chunk per task, and closes the gaps of dropped splats.
    ///
    /// If several chunks fail, returns the error of the first.
    pub(crate) fn fill<E: Send>(
        &mut self,
        convert: impl Fn(&mut Rows) -> Result<(), E> + Sync,
    ) -> Result<Gathered, E> {
        let (degree, properties) = (self.degree, self.property_names.len());
        let chunks = self.position.len().div_ceil(CHUNK);
        let low = pieces(&mut self.low, 1, chunks);
        let property = pieces(&mut self.property, properties, chunks);
        let chunks: Vec<Result<(usize, Gathered), E>> = self
            .position
            .par_chunks_mut(CHUNK)
            .zip(low)
            .zip(self.scale.par_chunks_mut(CHUNK))
            .zip(self.rotation.par_chunks_mut(CHUNK))
            .zip(self.opacity.par_chunks_mut(CHUNK))
            .zip(self.sh.par_chunks_mut(CHUNK * sh_floats(degree)))
            .zip(property)
            .enumerate()
            .map(|(chunk, ((((((position, low), scale), rotation), opacity), sh), property))| {
                let mut rows = Rows {
                    first: chunk * CHUNK,
                    kept: 0,
                    degree,
                    position,
                    low,
                    scale,
                    rotation,
                    opacity,
                    sh,
                    properties,
                    property,
                    gathered: Gathered::new(),
                };
                convert(&mut rows)?;
                Ok((rows.kept, rows.gathered))
            })
            .collect();
        let (mut all, mut kept) = (Gathered::new(), Vec::with_capacity(chunks.len()));
        for result in chunks {
            let (count, gathered) = result?;
            all.join(&gathered);
            kept.push(count);
        }
        close_gaps(&mut self.position, 1, &kept);
        close_gaps(&mut self.low, 1, &kept);
        close_gaps(&mut self.scale, 1, &kept);
        close_gaps(&mut self.rotation, 1, &kept);
        close_gaps(&mut self.opacity, 1, &kept);
        close_gaps(&mut self.sh, sh_floats(degree), &kept);
        close_gaps(&mut self.property, properties, &kept);
        Ok(all)
    }
}

/// Splits the values of an array that may be empty into one piece per chunk. A splat has `width` values.
fn pieces<T>(values: &mut [T], width: usize, chunks: usize) -> Vec<&mut [T]> {
    let mut pieces = values.chunks_mut(CHUNK * width.max(1));
    (0..chunks).map(|_| pieces.next().unwrap_or_default()).collect()
}

/// Moves each chunk's stored values directly behind those of the previous chunk. `kept` has the number of splats that
/// each chunk stored; a splat has `width` values.
fn close_gaps<T: Copy>(values: &mut Vec<T>, width: usize, kept: &[usize]) {
    if values.is_empty() {
        return;
    }
    let mut end = 0;
    for (chunk, count) in kept.iter().enumerate() {
        let (start, length) = (chunk * CHUNK * width, count * width);
        if start != end {
            values.copy_within(start..start + length, end);
        }
        end += length;
    }
    values.truncate(end);
}
