//! Stores the splats of a scene as a structure of arrays.
//!
//! A splat is an anisotropic 3D Gaussian: a centre, a standard deviation along each of three axes, the rotation of
//! these axes, an opacity at the centre, and a view-dependent colour, as real spherical harmonics. All values here are
//! *activated*: scales are standard deviations, not logarithms; opacities are 0 to 1, not logits; quaternions have unit
//! length. A scene is immutable, so derived values are computed once.

mod columns;
mod gathered;
mod notes;
mod parts;
mod splat;
mod world;

pub(crate) use columns::{Columns, Rows};
pub(crate) use gathered::Gathered;
pub use gathered::{CoarsePositions, Dropped, QuaternionNorms};
pub use notes::{FileNotes, Filter, MixedTags, SortKey};
pub use parts::ScenePart;
pub use splat::{Splat, sh_floats};

use crate::activation;
use crate::bounds::{Bounds, largest, median};
use crate::harmonics;
use crate::memory::{self, SceneMemoryError};
use crate::mesh::Mesh;
use crate::size_breakdown::SizeBreakdown;
use crate::words::CHUNK;
use rayon::prelude::*;
use serde::Serialize;
use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use tracing::info_span;

/// Opacity below which the reference rasteriser never draws a splat.
pub const ALPHA_FLOOR: f32 = 1.0 / 255.0;

/// Limit below which the rounding of positions is ignored, relative to the splat's largest standard deviation.
const INVISIBLE: f32 = 1.0 / 16_384.0;

/// The range of a scene's coefficients and colours, which storage formats must cover.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ColorRange {
    /// Largest absolute value of a coefficient of the spherical harmonics.
    pub largest_sh: f32,
    /// Upper bound of all splats' display-encoded channels, from any direction ([`harmonics::brightest`]).
    pub brightest: f64,
}

/// A loaded or generated scene.
#[derive(Debug)]
pub struct Scene {
    pub(crate) columns: Columns,
    offset: [f64; 3],
    gathered: Gathered,
    notes: FileNotes,
    mesh: Option<Arc<Mesh>>,
    parts: Vec<ScenePart>,
    coarse_parts: Vec<(String, CoarsePositions)>,
    /// Lines `comment` and `obj_info` of the PLY header that are no tags.
    header_comments: Vec<String>,
    /// Sizes of the file's parts; empty for a generated scene until requested.
    pub(crate) size_breakdown: OnceLock<SizeBreakdown>,
    robust: OnceLock<Bounds>,
    colors: OnceLock<ColorRange>,
    pub(crate) identity: OnceLock<u64>,
}

/// Further properties of generated splats; see [`Scene::property_names`].
pub struct Properties<'a> {
    /// The properties' names.
    pub names: Vec<String>,
    /// Returns the value of a splat's property; arguments are the splat's index and the name's.
    pub value: &'a (dyn Fn(usize, usize) -> f32 + Sync),
}

impl Properties<'_> {
    /// No properties.
    pub const NONE: Self = Self { names: Vec::new(), value: &|_, _| 0.0 };
}

/// Normalises the quaternion of a splat; also returns its original length.
fn normalised(splat: Splat) -> (Splat, f64) {
    let (rotation, norm) = activation::unit(splat.rotation.map(f64::from));
    (Splat { rotation, ..splat }, norm)
}

impl Scene {
    pub(crate) fn new(mut columns: Columns, mut gathered: Gathered) -> Self {
        if columns.opacity.is_empty() {
            gathered.bounds = Bounds::ORIGIN;
        }
        if gathered.rounding < INVISIBLE {
            columns.low = Vec::new();
        }
        Self {
            columns,
            offset: [0.0; 3],
            gathered,
            notes: FileNotes::default(),
            mesh: None,
            parts: Vec::new(),
            coarse_parts: Vec::new(),
            header_comments: Vec::new(),
            size_breakdown: OnceLock::new(),
            robust: OnceLock::new(),
            colors: OnceLock::new(),
            identity: OnceLock::new(),
        }
    }

    /// Computes the host memory in bytes of a scene of `count` splats, statistics included.
    ///
    /// Its arrays take 44 + 4 * [`sh_floats`] bytes per splat, and computing robust bounds temporarily copies the
    /// positions. Wide positions ([`Scene::is_wide`]) take 12 bytes more.
    pub fn host_bytes(count: u64, stored_degree: u32) -> u64 {
        Columns::host_bytes(count, stored_degree)
    }

    /// Generates a scene of `count` splats with spherical harmonics of `degree`, at most 3.
    ///
    /// Calls `splat` with each index, in parallel and in any order. As on load, quaternions are normalised, and splats
    /// that cannot be drawn are dropped and counted.
    ///
    /// # Panics
    /// Panics if the scene does not fit in memory; see [`Scene::try_generate`].
    pub fn generate(count: u32, degree: u32, splat: impl Fn(usize) -> Splat + Sync) -> Self {
        Self::try_generate(count, degree, splat).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Generates a scene like [`Scene::generate`].
    ///
    /// # Errors
    /// The scene does not fit in memory.
    pub fn try_generate(
        count: u32,
        degree: u32,
        splat: impl Fn(usize) -> Splat + Sync,
    ) -> Result<Self, SceneMemoryError> {
        Self::try_generate_with_properties(count, degree, Properties::NONE, splat)
    }

    /// Generates a scene like [`Scene::try_generate`], with further properties.
    ///
    /// # Errors
    /// The scene does not fit in memory.
    pub fn try_generate_with_properties(
        count: u32,
        degree: u32,
        properties: Properties,
        splat: impl Fn(usize) -> Splat + Sync,
    ) -> Result<Self, SceneMemoryError> {
        Self::generated(count, degree, false, properties, |index| {
            let (splat, norm) = normalised(splat(index));
            (splat, splat.position.map(f64::from), norm)
        })
    }

    /// Generates a scene. `splat` returns a splat, its position, and the original length of its quaternion.
    fn generated(
        count: u32,
        degree: u32,
        wide: bool,
        properties: Properties,
        splat: impl Fn(usize) -> (Splat, [f64; 3], f64) + Sync,
    ) -> Result<Self, SceneMemoryError> {
        let columns = Columns::allocate(count.into(), degree.min(3), wide, 0, memory::available())?;
        let mut columns = columns.with_properties(&properties.names)?;
        let Ok(gathered) = columns.fill(|rows| {
            for index in rows.first()..rows.first() + rows.len() {
                let (splat, position, norm) = splat(index);
                rows.set_properties(|name| (properties.value)(index, name));
                rows.push_wide(&Splat { position: position.map(|v| v as f32), ..splat }, position, norm);
            }
            Ok::<_, Infallible>(())
        });
        Ok(Self::new(columns, gathered))
    }

    /// Generates a scene like [`Scene::try_generate`]. Positions have more precision than f32 if the scene is `wide`;
    /// otherwise they are rounded.
    ///
    /// `splat` returns the position separately; [`Splat::position`] is ignored. Its quaternion must have unit length.
    pub(crate) fn try_generate_at(
        count: u32,
        degree: u32,
        wide: bool,
        splat: impl Fn(usize) -> (Splat, [f64; 3]) + Sync,
    ) -> Result<Self, SceneMemoryError> {
        Self::try_generate_with(count, degree, wide, Properties::NONE, splat)
    }

    /// Generates a scene like [`Scene::try_generate_at`], with further properties.
    pub(crate) fn try_generate_with(
        count: u32,
        degree: u32,
        wide: bool,
        properties: Properties,
        splat: impl Fn(usize) -> (Splat, [f64; 3]) + Sync,
    ) -> Result<Self, SceneMemoryError> {
        Self::generated(count, degree, wide, properties, |index| {
            let (splat, position) = splat(index);
            (splat, position, 1.0)
        })
    }

    /// Copies the scene without the harmonics above `degree`.
    ///
    /// # Errors
    /// The copy does not fit in memory.
    pub fn cut_to_degree(&self, degree: u32) -> Result<Self, SceneMemoryError> {
        let degree = degree.min(self.stored_degree());
        let splat = |index| (self.splat(index), self.position(index));
        self.derived(self.count(), degree, |index| index, splat)
    }

    /// Generates a scene with the offset, tags, comments and mesh of this one. Its positions are wide if this scene's
    /// are. `source` returns the index of the splat in this scene whose further properties a splat gets.
    ///
    /// As with [`Scene::try_generate_at`], quaternions must have unit length: they are copied bit by bit.
    pub(crate) fn derived(
        &self,
        count: u32,
        degree: u32,
        source: impl Fn(usize) -> usize + Sync,
        splat: impl Fn(usize) -> (Splat, [f64; 3]) + Sync,
    ) -> Result<Self, SceneMemoryError> {
        let value = |index: usize, name: usize| self.property(source(index), name);
        let properties = Properties { names: self.property_names().to_vec(), value: &value };
        let derived = Self::try_generate_with(count, degree, self.is_wide(), properties, splat)?;
        let derived = derived.with_offset(self.offset).with_notes(self.notes).with_mesh(self.mesh.clone());
        Ok(derived.with_header_comments(self.header_comments.clone()))
    }

    /// Sets the scene's origin in the world without changing the positions, which are relative to it.
    pub fn with_offset(self, offset: [f64; 3]) -> Self {
        Self { offset, ..self }
    }

    /// Sets the tags of the scene's file, and the counts of what loading left out or clamped.
    pub fn with_notes(self, notes: FileNotes) -> Self {
        Self { notes, ..self }
    }

    pub(crate) fn with_dropped(mut self, dropped: Dropped) -> Self {
        self.gathered.dropped = dropped;
        self
    }

    /// Sets the comments that PLY files of the scene get, as lines of a header.
    pub(crate) fn with_header_comments(self, header_comments: Vec<String>) -> Self {
        Self { header_comments, ..self }
    }

    /// Returns the comments of the PLY file that the scene was loaded or derived from, as lines of a header.
    ///
    /// PLY files of the scene get them. Tags are not among them. Empty for joined scenes, and for more than 32 KiB.
    pub fn header_comments(&self) -> &[String] {
        &self.header_comments
    }

    pub(crate) fn with_breakdown(self, breakdown: SizeBreakdown) -> Self {
        Self { size_breakdown: OnceLock::from(breakdown), ..self }
    }

    /// Takes over what loading found out about the file of `whole`, of which this scene is a part.
    pub(crate) fn with_file_of(mut self, whole: &Scene) -> Self {
        (self.gathered.dropped, self.gathered.norms) = (whole.gathered.dropped, whole.gathered.norms);
        self.coarse_parts.clone_from(&whole.coarse_parts);
        // The steps of a SOG's positions follow from the box of all its splats.
        self.with_breakdown(SizeBreakdown { is_whole_sog: false, ..whole.size_breakdown().clone() })
    }

    /// Lists the parts of a scene that was loaded from a list of scenes, in the order of the list.
    ///
    /// Empty for other scenes, and if splats were dropped in the join. Scenes derived from this one have no parts.
    pub fn parts(&self) -> &[ScenePart] {
        &self.parts
    }

    /// Sets the parts, given as files with their numbers of splats. If splats were dropped in the join, there are no
    /// parts.
    pub(crate) fn with_parts(mut self, files: Vec<(PathBuf, u32)>) -> Self {
        let mut end = 0;
        let part = |(file, count): (PathBuf, u32)| {
            let first = end;
            end += count;
            ScenePart { file, splats: first..end }
        };
        let parts = files.into_iter().map(part).collect();
        if end == self.count() {
            self.parts = parts;
        }
        self
    }

    /// Lists the files of a list of scenes that have coarse positions.
    ///
    /// The positions of the joined scene do not show it, because an offset gives them finer steps than the file's.
    pub fn coarse_parts(&self) -> &[(String, CoarsePositions)] {
        &self.coarse_parts
    }

    pub(crate) fn with_coarse_parts(self, coarse_parts: Vec<(String, CoarsePositions)>) -> Self {
        Self { coarse_parts, ..self }
    }

    /// Sets the mesh that is drawn beside the splats, in coordinates relative to [`Scene::offset`].
    pub fn with_mesh(self, mesh: Option<Arc<Mesh>>) -> Self {
        Self { mesh, ..self }
    }

    /// Returns the mesh beside the splats; `None` if there is none.
    pub fn mesh(&self) -> Option<&Mesh> {
        self.mesh.as_deref()
    }

    /// Returns the tags of the scene's file, and the counts of what loading left out or clamped.
    pub fn notes(&self) -> FileNotes {
        self.notes
    }

    /// Returns the world's up direction: the tag of the file, or -y.
    pub fn up(&self) -> [f64; 3] {
        self.notes.up.unwrap_or(FileNotes::UP)
    }

    /// Removes the tags, so that the scene is drawn by the published rules, with -y up.
    pub fn without_tags(self) -> Self {
        let notes = self.notes.without_tags();
        self.with_notes(notes)
    }

    /// Returns the world's coordinates of the scene's origin.
    ///
    /// The scene's positions and boxes, and the cameras that draw it, are relative to it; files and reports have the
    /// world's coordinates. It is 0 unless a file or a transform places the splats too far from 0 for f32;
    /// [`Camera::relative_to`](crate::Camera::relative_to) translates cameras from the world into the scene.
    pub fn offset(&self) -> [f64; 3] {
        self.offset
    }

    /// Returns the number of splats, without dropped ones.
    pub fn count(&self) -> u32 {
        self.columns.opacity.len() as u32
    }

    /// Returns the centres, in world units, relative to [`Scene::offset`].
    pub fn positions(&self) -> &[[f32; 3]] {
        &self.columns.position
    }

    /// Returns true if positions need more precision than [`Scene::positions`] has, as for two distant clouds.
    pub fn is_wide(&self) -> bool {
        !self.columns.low.is_empty()
    }

    /// Returns the centre of splat `index` at full precision, in world units, relative to [`Scene::offset`].
    pub fn position(&self, index: usize) -> [f64; 3] {
        let high = self.columns.position[index].map(f64::from);
        match self.columns.low.get(index) {
            Some(low) => std::array::from_fn(|axis| high[axis] + f64::from(low[axis])),
            None => high,
        }
    }

    /// Returns the centre of splat `index` in the world's coordinates.
    pub fn world_position(&self, index: usize) -> [f64; 3] {
        let position = self.position(index);
        std::array::from_fn(|axis| position[axis] + self.offset[axis])
    }

    /// Returns the largest absolute value of a centre's coordinate in the world; 0 for a scene without splats.
    pub fn largest_coordinate(&self) -> f64 {
        let coordinates = (0..self.count() as usize).flat_map(|index| self.world_position(index));
        coordinates.fold(0.0, |most, value| value.abs().max(most))
    }

    /// Returns the standard deviations along each splat's axes, in world units, never negative.
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

    /// Returns the names of the further properties of its PLY file that the scene was loaded with; see
    /// [`ReadOptions::properties`](crate::ReadOptions::properties).
    pub fn property_names(&self) -> &[String] {
        &self.columns.property_names
    }

    /// Returns the value in the file of a further property of splat `index`. `name` is an index into
    /// [`Scene::property_names`].
    pub fn property(&self, index: usize, name: usize) -> f32 {
        self.columns.property[index * self.columns.property_names.len() + name]
    }

    /// Returns the degree of the stored spherical harmonics.
    pub fn stored_degree(&self) -> u32 {
        self.columns.degree
    }

    /// Returns the highest band with a coefficient other than 0 in any splat: the last that a renderer must evaluate.
    pub fn effective_degree(&self) -> u32 {
        self.gathered.effective_degree
    }

    /// Returns true if splat `index` can be visible under the published rules: its opacity is 1/255 or more.
    pub fn can_show(&self, index: usize) -> bool {
        self.columns.opacity[index] >= ALPHA_FLOOR
    }

    /// Finds the highest band with a coefficient other than 0 in any splat that [can be visible](Scene::can_show).
    pub(crate) fn shown_degree(&self) -> u32 {
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

    /// Copies splat `index`. Its position is in f32, relative to [`Scene::offset`]; harmonics above the degree are 0.
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

    /// Returns the counts of the splats dropped on load or by a transformation. In the copies of [`Scene::picked`] and
    /// [`Scene::cut_to_degree`], they begin at 0 again.
    pub fn dropped(&self) -> &Dropped {
        &self.gathered.dropped
    }

    /// Returns the range of the quaternions' lengths before normalisation. In a scene derived from another, they are 1,
    /// except that [`Scene::selected`] keeps the file's.
    pub fn quaternion_norms(&self) -> QuaternionNorms {
        self.gathered.norms
    }

    /// Returns the box around every centre, relative to [`Scene::offset`]; [`Bounds::ORIGIN`] for a scene without
    /// splats.
    pub fn bounds(&self) -> Bounds {
        self.gathered.bounds
    }

    /// Returns the box from the 1st to the 99th percentile of each coordinate, which ignores outliers, relative to
    /// [`Scene::offset`]. It is [`Bounds::ORIGIN`] for a scene without splats. Computed once.
    pub fn robust_bounds(&self) -> Bounds {
        *self.robust.get_or_init(|| {
            let _span = info_span!("find the robust bounds").entered();
            Bounds::percentiles(&self.columns.position, 0.01, 0.99)
        })
    }

    /// Computes the median of each splat's largest standard deviation; 0 without splats.
    pub fn median_size(&self) -> f32 {
        let mut largest: Vec<f32> = self.scales().iter().copied().map(largest).collect();
        median(&mut largest)
    }

    /// Returns the range of the spherical harmonics and of the resulting colours. Computed once.
    pub fn color_range(&self) -> ColorRange {
        *self.colors.get_or_init(|| {
            let _span = info_span!("find the range of colours").entered();
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
    fn a_copy_of_a_lower_degree_lacks_the_harmonics_above() {
        let scene = Scene::generate(50, 3, splat).with_offset([1024.0, 0.0, 0.0]);
        let cut = scene.cut_to_degree(1).unwrap();
        assert_eq!((cut.stored_degree(), cut.offset()), (1, scene.offset()));
        let (a, b) = (cut.splat(7), scene.splat(7));
        assert_eq!((a.position, a.opacity, &a.sh[..12]), (b.position, b.opacity, &b.sh[..12]));
        assert_eq!(a.sh[12..], [0.0; 36]);
        assert_eq!(scene.cut_to_degree(9).unwrap().stored_degree(), 3);
    }

    #[test]
    fn negative_scales_are_stored_as_the_standard_deviations_that_they_are() {
        let negative = |i: usize| Splat { scale: splat(i).scale.map(|s| -s), ..splat(i) };
        let scene = Scene::generate(3, 0, negative);
        assert!((0..3).all(|i| scene.scales()[i] == splat(i).scale));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_wide_scene_beyond_the_memory_is_refused_before_any_allocation() {
        let error =
            Scene::try_generate_at(u32::MAX, 3, true, |i| (splat(i), [0.0; 3])).map(|scene| scene.count());
        let needed = Scene::host_bytes(u32::MAX.into(), 3) + u64::from(u32::MAX) * Columns::LOW_BYTES;
        assert_eq!(error.unwrap_err().needed, needed);
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
                // Above the degree: not stored, so not a fault.
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
