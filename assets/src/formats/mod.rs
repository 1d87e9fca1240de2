//! Loads and writes scene files: recognises the format from the bytes, and calls its reader.

use crate::composition::{self, Placed};
use crate::edit::Similarity;
use crate::error::{LoadError, SceneError};
use crate::input::{Input, OpenFile, Progress, SceneHeader, Source};
use crate::memory;
use crate::recognise::{self, HEAD, SceneFormat};
use crate::scene::Scene;
use crate::spz::SpzVersion;
use crate::{gltf, ksplat, ply, sog, splat, spz};
use std::io::Write;
use std::path::Path;

#[cfg(test)]
mod tests;

/// Recognises the format of the bytes. `path` is used to describe a file that is not a scene.
fn recognise(source: &Source, path: Option<&Path>) -> Result<SceneFormat, SceneError> {
    recognise::format(path, &source.head(HEAD)?, source.length())
}

fn parse(input: &Input, path: Option<&Path>) -> Result<Scene, SceneError> {
    match recognise(input.source, path)? {
        SceneFormat::Ply | SceneFormat::CompressedPly => ply::read::parse(input),
        SceneFormat::Spz => spz::parse(input),
        SceneFormat::Splat => splat::parse(input),
        SceneFormat::Sog => sog::parse(input),
        SceneFormat::Ksplat => ksplat::parse(input),
        SceneFormat::Gltf => gltf::parse(input, path),
    }
}

/// Content of a file that [`Scene::load`] accepts.
enum Content<T> {
    /// One scene.
    One(T),
    /// The parts of a composition. Its file was unchanged during the read.
    Several(Vec<Placed>),
}

/// Opens a file and reads it with `one`, unless it is a composition.
fn open<T>(path: &Path, one: impl FnOnce(&Source) -> Result<T, SceneError>) -> Result<Content<T>, LoadError> {
    let inner = || {
        let file = OpenFile::open(path)?;
        let source = Source::File(&file);
        let several = composition::begins_as_scenes(&source.head(HEAD)?);
        let content = if several {
            placed(&source, path).map(Content::Several)
        } else {
            one(&source).map(Content::One)
        };
        // If the file was modified during the read, its contents mean nothing.
        file.check_unchanged().and(content)
    };
    inner().map_err(|problem| LoadError { path: path.to_owned(), problem })
}

/// Reads the text of a composition.
fn placed(source: &Source, path: &Path) -> Result<Vec<Placed>, SceneError> {
    let length = source.length();
    if length > composition::MAX_BYTES {
        let message = format!("expected at most {} bytes of text, found {length}", composition::MAX_BYTES);
        return Err(SceneError::Scenes { message });
    }
    let bytes = source.head(length as usize)?;
    let text =
        String::from_utf8(bytes).map_err(|_| SceneError::Scenes { message: "expected UTF-8".into() })?;
    composition::parse(&text, path.parent().unwrap_or(Path::new("")))
}

/// Refuses a composition inside a composition.
fn nested(path: &Path) -> LoadError {
    let message = "expected one scene, found several".into();
    LoadError { path: path.to_owned(), problem: SceneError::Scenes { message } }
}

impl SceneHeader {
    /// Reads only the header of a scene file; for a composition, the sum of its scenes' headers.
    ///
    /// # Errors
    /// The errors of [`Scene::load`] that the header and the file's length reveal.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, LoadError> {
        let path = path.as_ref();
        let parts = match open(path, |source| Self::of(source, path))? {
            Content::One(header) => return Ok(header),
            Content::Several(parts) => parts,
        };
        let all = parts.iter().map(|part| match open(&part.file, |source| Self::of(source, &part.file))? {
            Content::One(header) => Ok(header),
            Content::Several(_) => Err(nested(&part.file)),
        });
        let all: Vec<Self> = all.collect::<Result<_, _>>().map_err(|error| within(path, error))?;
        let stored_degree = all.iter().map(|header| header.stored_degree).max().unwrap_or(0);
        Ok(Self { count: all.iter().map(|header| header.count).sum(), stored_degree })
    }

    fn of(source: &Source, path: &Path) -> Result<Self, SceneError> {
        match recognise(source, Some(path))? {
            SceneFormat::Ply | SceneFormat::CompressedPly => ply::read::scene_header(source),
            SceneFormat::Spz => spz::header(source),
            SceneFormat::Splat => splat::header(source),
            SceneFormat::Sog => sog::header(source),
            SceneFormat::Ksplat => ksplat::header(source),
            SceneFormat::Gltf => gltf::header(source),
        }
    }
}

/// Adds the composition's file to the error of one of its scenes.
fn within(path: &Path, error: LoadError) -> LoadError {
    LoadError { path: path.to_owned(), problem: SceneError::Placed(Box::new(error)) }
}

/// Returns true if a file is a composition; false if it cannot be read.
pub fn names_scenes(path: &Path) -> bool {
    let head = || OpenFile::open(path).and_then(|file| Source::File(&file).head(HEAD));
    head().is_ok_and(|head| composition::begins_as_scenes(&head))
}

impl Scene {
    /// Loads a scene file of any [`SceneFormat`], recognised by its bytes, or a `.ron` composition of several.
    ///
    /// # Errors
    /// The file cannot be read, is not a scene, is damaged, does not fit in memory, or was modified during the read.
    /// See [`SceneError`].
    pub fn load(path: impl AsRef<Path>, progress: Progress) -> Result<Self, LoadError> {
        let path = path.as_ref();
        let parts = match Self::load_one(path, progress)? {
            Content::One(scene) => return Ok(scene),
            Content::Several(parts) => parts,
        };
        Self::load_placed(&parts, progress).map_err(|error| within(path, error))
    }

    fn load_one(path: &Path, progress: Progress) -> Result<Content<Self>, LoadError> {
        open(path, |source| parse(&Input { source, memory: memory::available(), progress }, Some(path)))
    }

    /// Loads scenes, transforms each, and joins them.
    fn load_placed(parts: &[Placed], progress: Progress) -> Result<Self, LoadError> {
        let bytes = |part: &Placed| std::fs::metadata(&part.file).map_or(0, |found| found.len());
        let total: u64 = parts.iter().map(bytes).sum();
        let (mut scenes, mut before) = (Vec::with_capacity(parts.len()), 0);
        for part in parts {
            let length = bytes(part);
            // Counts bytes of the file, whatever its reader counts.
            let tell = |done: u64, of: u64| {
                let share = done as f64 / of.max(1) as f64;
                progress(before + (share * length as f64) as u64, total)
            };
            let no_room = |error| LoadError { path: part.file.clone(), problem: SceneError::Memory(error) };
            let scene = match Self::load_one(&part.file, &tell)? {
                Content::One(scene) => scene,
                Content::Several(_) => return Err(nested(&part.file)),
            };
            scenes.push(match part.by == Similarity::IDENTITY {
                true => scene,
                false => scene.transformed(&part.by).map_err(no_room)?,
            });
            before += length;
        }
        let path = parts.last().map_or_else(Default::default, |part| part.file.clone());
        Self::joined(&scenes).map_err(|error| LoadError { path, problem: SceneError::Memory(error) })
    }

    /// Parses a scene from the bytes of a file.
    ///
    /// # Errors
    /// The errors of [`Scene::load`].
    pub fn parse(bytes: &[u8], progress: Progress) -> Result<Self, SceneError> {
        parse(&Input { source: &Source::Bytes(bytes), memory: memory::available(), progress }, None)
    }

    /// Writes the scene as SPZ of a given version; [`Scene::write`] uses the newest.
    ///
    /// # Errors
    /// The writer fails, or a coordinate exceeds 8,388,607.
    pub fn write_spz(&self, version: SpzVersion, out: &mut impl Write) -> std::io::Result<()> {
        spz::write(self, version, out)
    }

    /// Writes the scene in a format, in the world's coordinates.
    ///
    /// All formats but [`SceneFormat::Ply`] and [`SceneFormat::Gltf`] round the values: [`SceneFormat::losses`]
    /// describes how.
    ///
    /// # Errors
    /// The writer fails, or the format is not in [`SceneFormat::WRITTEN`].
    pub fn write(&self, format: SceneFormat, out: &mut impl Write) -> std::io::Result<()> {
        match format {
            SceneFormat::Ply => self.write_ply_to(out),
            SceneFormat::CompressedPly => ply::pack::write(self, out),
            SceneFormat::Spz => spz::write(self, SpzVersion::default(), out),
            SceneFormat::Splat => splat::write(self, out),
            SceneFormat::Gltf => gltf::write(self, out),
            SceneFormat::Sog => sog::write(self, out),
            SceneFormat::Ksplat => {
                let found = format.extension();
                let text =
                    format!("expected a format that can be written, found {found}, which is read alone");
                Err(std::io::Error::new(std::io::ErrorKind::Unsupported, text))
            }
        }
    }
}
