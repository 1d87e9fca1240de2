//! Loads and writes scene files: recognises the format from the bytes, and calls its reader.

use crate::composition::{self, Placed};
use crate::error::{LoadError, SceneError, nearest, wrong};
use crate::input::{HEAD, Input, Progress, ReadOptions, SceneHeader, Source, read_file};
use crate::memory;
use crate::mesh::Mesh;
use crate::recognise;
use crate::scene::{FileNotes, Filter, Scene, SortKey};
use crate::scene_files::{document, scene_files};
use crate::scene_format::SceneFormat;
use crate::similarity::Similarity;
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use crate::spz::SpzVersion;
use crate::words::word;
use crate::{gltf, ksplat, ply, rad, sog, splat, spz, usd};
use rayon::prelude::*;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::io::Write;
use std::path::{Path, PathBuf};

mod steps;
#[cfg(test)]
mod tests;

pub use steps::LargeSteps;

/// Maximum size of a mesh's file, in bytes: the length of a GLB has 32 bits.
const MAX_MESH: u64 = u32::MAX as u64;

/// Recognises the format of the bytes. The extension of `path` identifies formats without a magic number.
fn recognise(source: &Source, path: Option<&Path>) -> Result<SceneFormat, SceneError> {
    recognise::format(path, &source.head(HEAD)?, source.length())
}

fn parse(input: &Input, path: Option<&Path>, level: Option<u32>) -> Result<Scene, SceneError> {
    match recognise(input.source, path)? {
        SceneFormat::Sog => sog::parse(input, path, level),
        _ if level.is_some() => Err(SceneError::NoLevels),
        SceneFormat::Ply | SceneFormat::CompressedPly => ply::read::parse(input),
        SceneFormat::Spz => spz::parse(input),
        SceneFormat::Splat => splat::parse(input),
        SceneFormat::Ksplat => ksplat::parse(input),
        SceneFormat::Rad => rad::parse(input, path),
        SceneFormat::Usd => usd::parse(input),
        SceneFormat::Gltf => gltf::parse(input, path),
    }
}

/// Content of a file; `T` represents a single scene, `M` a mesh.
enum Found<T, M = Mesh> {
    One(T),
    Mesh(M),
    /// The parts of a composition.
    Several(Vec<Placed>),
}

/// Content that [`Scene::load_any`] loaded.
#[derive(Debug)]
pub enum Content {
    /// Splats.
    Splats(Box<Scene>),
    /// A mesh, which is drawn beside splats.
    Mesh(Box<Mesh>),
}

/// Opens a file, or the document of a folder, and reads its content.
///
/// `one` reads a single scene, and `mesh` a mesh; this function reads a composition itself.
fn open<T, M>(
    path: &Path,
    one: impl FnOnce(&Source, &Path) -> Result<T, SceneError>,
    mesh: impl FnOnce(&Source, &Path) -> Result<M, SceneError>,
) -> Result<Found<T, M>, LoadError> {
    let document = document(path);
    let path = document.as_deref().unwrap_or(path);
    if path.is_dir() {
        let found = "a folder without meta.json, lod-meta.json or point_cloud/iteration_*/point_cloud.ply";
        return Err(SceneError::NotScene { found: found.into() }.of(path));
    }
    let content = read_file(path, |source| {
        let head = source.head(HEAD)?;
        if composition::begins_as_scenes(&head) {
            placed(source, path).map(Found::Several)
        } else if !sog::begins_as_json(&head) && gltf::begins_as_gltf(&head) && is_mesh(source, &head)? {
            mesh(source, path).map(Found::Mesh)
        } else {
            one(source, path).map(Found::One)
        }
    });
    content.map_err(|problem| problem.of(path))
}

fn placed(source: &Source, path: &Path) -> Result<Vec<Placed>, SceneError> {
    let length = source.length();
    if length > composition::MAX_BYTES {
        let text = format!("expected at most {} bytes of text, found {length}", composition::MAX_BYTES);
        return Err(SceneError::Invalid(text));
    }
    let bytes = source.head(length as usize)?;
    let text = String::from_utf8(bytes).map_err(|_| SceneError::Invalid("expected UTF-8".into()))?;
    composition::parse(&text, path.parent().unwrap_or(Path::new("")))
}

fn is_mesh(source: &Source, head: &[u8]) -> Result<bool, SceneError> {
    const MAX_SEARCHED: u64 = 1 << 26;
    let binary = head.starts_with(gltf::MAGIC);
    // GLB has a header of 12 bytes, followed by the length and the type of the JSON chunk.
    let length = head.get(12..16).map_or(0, |b| u64::from(word(b, 0)));
    let end = if binary { length.saturating_add(20) } else { source.length() };
    let text = source.head(end.min(source.length()).min(MAX_SEARCHED) as usize)?;
    // In the names of the extension and of its drafts.
    let name = b"gaussian_splat";
    Ok(!text.windows(name.len()).any(|window| window == name))
}

/// Refuses a mesh's file of more than [`MAX_MESH`] bytes, or one that does not fit twice in the `available` memory.
/// The parser copies its binary chunk.
fn check_mesh(length: u64, available: Option<u64>) -> Result<(), SceneError> {
    let most = available.map_or(MAX_MESH, |bytes| MAX_MESH.min(bytes / 2));
    if length > most {
        return Err(wrong("mesh", format!("expected a file of at most {most} bytes, found {length}")));
    }
    Ok(())
}

fn mesh(source: &Source, path: &Path) -> Result<Mesh, SceneError> {
    let length = source.length();
    check_mesh(length, memory::available())?;
    let bytes = source.head(usize::try_from(length).unwrap_or(usize::MAX))?;
    Mesh::parse(&bytes, Some(path.parent().unwrap_or(Path::new(""))))
}

fn nested(path: &Path) -> LoadError {
    SceneError::Invalid("expected one scene, found several".into()).of(path)
}

impl SceneHeader {
    /// Reads only the header of a scene file.
    ///
    /// For a composition, sums the splats of its scenes, and returns their highest degree; meshes count as 0 splats.
    ///
    /// # Errors
    /// The errors of [`Scene::load`] that the header and the file's length reveal.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, LoadError> {
        Self::load_level(path, None)
    }

    /// Reads the header of a level; see [`ReadOptions::level`].
    ///
    /// # Errors
    /// The errors of [`Scene::load_with`] that the headers and the files' lengths reveal.
    pub fn load_level(path: impl AsRef<Path>, level: Option<u32>) -> Result<Self, LoadError> {
        let path = path.as_ref();
        match Self::open(path, level)? {
            Found::One(header) => Ok(header),
            Found::Mesh(()) => Err(SceneError::MeshAlone.of(path)),
            Found::Several(parts) => Ok(Self::joined(&Self::of_parts(path, &parts, level)?)),
        }
    }

    fn open(path: &Path, level: Option<u32>) -> Result<Found<Self, ()>, LoadError> {
        open(path, |source, path| Self::of(source, path, level), |_, _| Ok(()))
    }

    /// Reads the headers of the parts of the composition at `path`, each file once. A mesh has 0 splats. Fails if a
    /// `level` is requested and no part has levels.
    fn of_parts(path: &Path, parts: &[Placed], level: Option<u32>) -> Result<Vec<Self>, LoadError> {
        let (mut known, mut has_levels) = (HashMap::new(), false);
        let mut header = |part: &Placed| {
            let (found, at_level) = at_level(level, |level| Self::open(&part.file, level))?;
            match found {
                Found::One(header) => {
                    has_levels |= at_level;
                    Ok(header)
                }
                Found::Mesh(()) => Ok(Self { count: 0, stored_degree: 0 }),
                Found::Several(_) => Err(nested(&part.file)),
            }
        };
        let all = parts.iter().map(|part| match known.entry(&part.file) {
            Entry::Occupied(known) => Ok(*known.get()),
            Entry::Vacant(unknown) => {
                Ok(*unknown.insert(header(part).map_err(|error| within(path, part, error))?))
            }
        });
        let all = all.collect::<Result<_, _>>()?;
        match parts.last() {
            Some(last) if level.is_some() && !has_levels => {
                Err(within(path, last, SceneError::NoLevels.of(&last.file)))
            }
            _ => Ok(all),
        }
    }

    /// Returns true unless the file is a mesh, a scene without levels, or a composition of these. Also returns true if
    /// the file cannot be read: a load reports the error.
    pub fn has_levels(path: impl AsRef<Path>) -> bool {
        match Self::load_level(path, Some(0)).map_err(|error| error.problem) {
            Err(SceneError::Placed { error, .. }) => !matches!(error.problem, SceneError::NoLevels),
            Err(SceneError::NoLevels | SceneError::MeshAlone) => false,
            _ => true,
        }
    }

    fn of(source: &Source, path: &Path, level: Option<u32>) -> Result<Self, SceneError> {
        match recognise(source, Some(path))? {
            SceneFormat::Sog => sog::header(source, Some(path), level),
            _ if level.is_some() => Err(SceneError::NoLevels),
            SceneFormat::Ply | SceneFormat::CompressedPly => ply::read::scene_header(source),
            SceneFormat::Spz => spz::header(source),
            SceneFormat::Splat => splat::header(source),
            SceneFormat::Ksplat => ksplat::header(source),
            SceneFormat::Rad => rad::header(source, Some(path)),
            SceneFormat::Usd => usd::header(source),
            SceneFormat::Gltf => gltf::header(source),
        }
    }
}

/// Reads a part of a composition at a level. If the part has no levels, reads it without one and returns false.
fn at_level<T>(
    level: Option<u32>,
    read: impl Fn(Option<u32>) -> Result<T, LoadError>,
) -> Result<(T, bool), LoadError> {
    match read(level) {
        Err(LoadError { problem: SceneError::NoLevels, .. }) => Ok((read(None)?, false)),
        found => Ok((found?, level.is_some())),
    }
}

/// Creates the error for the composition at `path` from that of a part.
fn within(path: &Path, part: &Placed, error: LoadError) -> LoadError {
    let (line, column) = part.at;
    SceneError::Placed { line, column, error: Box::new(error) }.of(path)
}

impl SceneFormat {
    /// Returns what a scene's tags `notes` become if it is written in this format and read back.
    pub fn kept_tags(self, notes: FileNotes) -> FileNotes {
        let none = FileNotes::default();
        match self {
            Self::Ply | Self::CompressedPly => FileNotes { low_pass: notes.low_pass, up: notes.up, ..none },
            // These formats have one flag for all filters.
            Self::Spz | Self::Sog if notes.is_antialiased() => {
                FileNotes { low_pass: Filter::Compensated, ..none }
            }
            Self::Gltf => FileNotes { key_of: SortKey::Distance, ..none },
            _ => none,
        }
    }
}

impl Scene {
    /// Loads a scene file of any [`SceneFormat`], a folder, or a composition of several scenes (`.ron`).
    ///
    /// The format is recognised by the file's bytes. A folder is a SOG scene, or the output of a training, whose last
    /// scene is loaded. A streamed SOG is loaded at its finest level.
    ///
    /// # Errors
    /// The file cannot be read, is a mesh or not a scene, is damaged, does not fit in memory, or was modified during
    /// the read; or `progress` cancelled. See [`SceneError`].
    pub fn load(path: impl AsRef<Path>, progress: Progress) -> Result<Self, LoadError> {
        Self::load_with(path, ReadOptions::default(), progress)
    }

    /// Loads a scene with options. In a composition, a level applies to the scenes that have levels, and further
    /// properties are 0 for the splats of scenes that lack them.
    ///
    /// # Errors
    /// The errors of [`Scene::load`], a level for scenes without levels, a level that a scene lacks, and a property that
    /// all scenes lack.
    pub fn load_with(
        path: impl AsRef<Path>,
        options: ReadOptions,
        progress: Progress,
    ) -> Result<Self, LoadError> {
        let path = path.as_ref();
        match Self::load_any(path, options, progress)? {
            Content::Splats(scene) => Ok(*scene),
            Content::Mesh(_) => Err(SceneError::MeshAlone.of(path)),
        }
    }

    /// Loads a scene like [`Scene::load_with`], or a mesh (glTF).
    ///
    /// # Errors
    /// The errors of [`Scene::load_with`] and of [`Mesh::parse`].
    pub fn load_any(
        path: impl AsRef<Path>,
        options: ReadOptions,
        progress: Progress,
    ) -> Result<Content, LoadError> {
        let path = path.as_ref();
        let scene = match Self::load_one(path, options, progress)? {
            Found::One(scene) => scene,
            Found::Mesh(mesh) => return Ok(Content::Mesh(mesh.into())),
            Found::Several(parts) => {
                let headers = SceneHeader::of_parts(path, &parts, options.level)?;
                SceneHeader::check_joined(&headers, 0, memory::available())
                    .map_err(|error| SceneError::Memory(error).of(path))?;
                let (scene, elements) = Self::load_placed(path, &parts, options, progress)?;
                let header_bytes = std::fs::metadata(path).map_or(0, |found| found.len());
                let file_bytes = header_bytes + elements.iter().map(|element| element.bytes).sum::<u64>();
                let format = format!("list of scenes, {} files", elements.len());
                let breakdown = SizeBreakdown::new(format, file_bytes, header_bytes, elements);
                scene.with_breakdown(breakdown)
            }
        };
        let lacks = |name: &&String| !scene.property_names().contains(name);
        match options.properties.iter().find(lacks) {
            Some(name) => Err(scene.no_property(name).of(path)),
            None => Ok(Content::Splats(scene.into())),
        }
    }

    /// Creates the error for a further property that no file of the scene has.
    fn no_property(&self, name: &str) -> SceneError {
        let fields = self.size_breakdown().elements.iter().flat_map(|element| &element.fields);
        let names: Vec<&str> = fields.map(|field| field.name.as_str()).collect();
        let near = nearest(name, names.iter().copied()).map(|near| format!("; did you mean `{near}`?"));
        let format = &self.size_breakdown().format;
        let others = || match format.split(',').next() {
            Some("ply") => "; `splatgraph info` lists its properties".to_owned(),
            Some("list of scenes") => " in any of its files".to_owned(),
            _ => format!("; only PLY files have further properties, and this is {format}"),
        };
        SceneError::Invalid(format!(
            "expected a property `{name}`, found none{}",
            near.unwrap_or_else(others)
        ))
    }

    fn load_one(path: &Path, options: ReadOptions, progress: Progress) -> Result<Found<Self>, LoadError> {
        let ReadOptions { level, properties } = options;
        let one = |source: &Source, path: &Path| {
            parse(&Input { source, memory: memory::available(), progress, properties }, Some(path), level)
        };
        open(path, one, mesh)
    }

    /// Loads the parts of the composition at `path`: transforms and joins the scenes, and adds the meshes. Needs at
    /// least one scene. Also returns the size of each file, which is named relative to the composition.
    fn load_placed(
        path: &Path,
        parts: &[Placed],
        options: ReadOptions,
        progress: Progress,
    ) -> Result<(Self, Vec<ElementSize>), LoadError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let size = |file: &PathBuf| std::fs::metadata(file).map_or(0, |found| found.len());
        let bytes = |part: &Placed| size(&part.file);
        let total: u64 = parts.iter().map(bytes).sum();
        let (mut scenes, mut meshes, mut before) = (Vec::with_capacity(parts.len()), Vec::new(), 0);
        let mut files = Vec::with_capacity(parts.len());
        let (mut sizes, mut coarse) = (Vec::with_capacity(parts.len()), Vec::new());
        for (index, part) in parts.iter().enumerate() {
            let length = bytes(part);
            // Readers count decompressed or used bytes, so their share is scaled to the file's length.
            let tell = |done: u64, of: u64| {
                let share = done as f64 / of.max(1) as f64;
                progress(before + (share * length as f64) as u64, total)
            };
            let fail = |error| within(path, part, error);
            let wrong = |problem: SceneError| fail(problem.of(&part.file));
            let name = part.file.strip_prefix(folder).unwrap_or(&part.file).display();
            let mut add_size = |format: &str, rows, bytes| {
                // A file that is placed several times is counted once.
                if !parts[..index].iter().any(|before| before.file == part.file) {
                    let contents = FieldSize::whole("contents", "file", bytes);
                    sizes.push(ElementSize::new(&format!("{name} ({format})"), rows, vec![contents]));
                }
            };
            let (found, _) = at_level(options.level, |level| {
                Self::load_one(&part.file, ReadOptions { level, ..options }, &tell)
            })
            .map_err(fail)?;
            let scene = match found {
                Found::One(scene) => {
                    let rows = u64::from(scene.count()) + scene.dropped().total();
                    let breakdown = scene.size_breakdown();
                    add_size(&breakdown.format, rows, breakdown.file_bytes);
                    scene
                }
                Found::Mesh(mut mesh) => {
                    // With the files of its buffers and images.
                    let all = scene_files(&part.file).iter().map(size).sum();
                    add_size("mesh", mesh.triangles.len() as u64, all);
                    mesh.left_out.iter_mut().for_each(|text| *text += &format!(" ({name})"));
                    meshes.push((mesh, part.by));
                    before += length;
                    continue;
                }
                Found::Several(_) => return Err(fail(nested(&part.file))),
            };
            let name = part.file.display().to_string();
            let is_new = !coarse.iter().any(|(file, _)| *file == name);
            coarse.extend(scene.coarse_positions().filter(|_| is_new).map(|found| (name, found)));
            let scene = match part.by == Similarity::IDENTITY {
                true => scene,
                false => scene.transformed(&part.by).map_err(|error| wrong(error.into()))?,
            };
            if scene.count() == 0 {
                let (count, reasons) = (scene.dropped().total(), scene.dropped().to_string());
                return Err(wrong(SceneError::AllDropped { count, reasons }));
            }
            files.push((part.file.clone(), scene.count()));
            scenes.push(scene);
            before += length;
        }
        if let Some(last) = parts.last().filter(|_| scenes.is_empty()) {
            return Err(within(path, last, SceneError::MeshAlone.of(&last.file)));
        }
        let joined = Self::of_one_file(scenes).map_err(|error| SceneError::Memory(error).of(path))?;
        let joined = joined.with_parts(files).with_coarse_parts(coarse);
        Ok((meshes.iter().fold(joined, |scene, (mesh, by)| scene.beside(mesh, by)), sizes))
    }

    /// Parses a scene from the bytes of a single file. Compositions, meshes and scenes of several files are refused.
    ///
    /// # Errors
    /// The errors of [`Scene::load`].
    pub fn parse(bytes: &[u8], progress: Progress) -> Result<Self, SceneError> {
        parse(&Input::new(&Source::Bytes(bytes), memory::available(), progress), None, None)
    }

    /// Writes the scene as SPZ of a given version; [`Scene::write`] uses the newest.
    ///
    /// # Errors
    /// The writer fails, or the absolute value of a coordinate exceeds 8,388,607.
    pub fn write_spz(&self, version: SpzVersion, out: &mut impl Write) -> std::io::Result<()> {
        spz::write(self, version, out)
    }

    /// Computes the largest error from rounding coordinates to f32 in a format, in world units.
    ///
    /// Returns 0 for formats that round no position to f32. Formats that also quantise positions have a further error,
    /// whose steps [`SceneFormat::losses`] describes. In SOG, the error is that of readers that decode to f32; this
    /// crate's reader keeps the file's precision.
    pub fn position_rounding(&self, format: SceneFormat) -> f64 {
        let stored: fn(&Self, usize) -> [f64; 3] = match format {
            // The node's translation is the offset.
            SceneFormat::Gltf if self.is_wide() => Self::position,
            SceneFormat::Splat | SceneFormat::CompressedPly | SceneFormat::Sog => Self::world_position,
            _ => return 0.0,
        };
        let indices = (0..self.count() as usize).into_par_iter();
        let rounding = |v: f64| (v - f64::from(v as f32)).abs();
        let errors = indices.map(|index| stored(self, index).map(rounding).into_iter().fold(0.0, f64::max));
        errors.reduce(|| 0.0, f64::max)
    }

    /// Writes the scene in a format, in the world's coordinates.
    ///
    /// All formats but [`SceneFormat::Ply`] and [`SceneFormat::Gltf`] round the values: [`SceneFormat::losses`]
    /// describes how. [`SceneFormat::Gltf`] rounds only wide positions: see [`Scene::position_rounding`]. Only
    /// [`SceneFormat::Sog`] calls `progress`, with the share done in percent, and 100.
    ///
    /// # Errors
    /// The writer fails, `progress` cancels ([`Interrupted`](std::io::ErrorKind::Interrupted)), the format cannot store
    /// the scene (SOG and glTF without splats, or SPZ with a coordinate beyond 8,388,607, for instance), or the format
    /// is not in [`SceneFormat::WRITTEN`].
    pub fn write(
        &self,
        format: SceneFormat,
        progress: Progress,
        out: &mut impl Write,
    ) -> std::io::Result<()> {
        match format {
            SceneFormat::Sog | SceneFormat::Gltf if self.count() == 0 => {
                let text = "expected at least one splat, found none";
                Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, text))
            }
            SceneFormat::Ply => self.write_ply_to(out),
            SceneFormat::CompressedPly => ply::pack::write(self, out),
            SceneFormat::Spz => spz::write(self, SpzVersion::default(), out),
            SceneFormat::Splat => splat::write(self, out),
            SceneFormat::Gltf => gltf::write(self, out),
            SceneFormat::Sog => sog::write(self, progress, out),
            SceneFormat::Ksplat | SceneFormat::Rad | SceneFormat::Usd => {
                let found = format.extension();
                let text =
                    format!("expected a format that can be written, found {found}, which is read-only");
                Err(std::io::Error::new(std::io::ErrorKind::Unsupported, text))
            }
        }
    }
}
