//! Loads and writes scene files: recognises the format by the bytes, and calls its reader.

use crate::error::{LoadError, SceneError};
use crate::input::{Input, OpenFile, Progress, SceneHeader, Source};
use crate::memory;
use crate::recognise::{self, HEAD, SceneFormat};
use crate::scene::Scene;
use crate::spz::SpzVersion;
use crate::{ksplat, ply, sog, splat, spz};
use std::io::Write;
use std::path::Path;

#[cfg(test)]
mod tests;

/// Recognises the format of the bytes; `path` helps to name what is not a scene.
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
    }
}

impl SceneHeader {
    /// Reads the header of a scene file, and nothing else.
    ///
    /// # Errors
    /// Those of [`Scene::load`] that the header and the file's length show.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, LoadError> {
        let path = path.as_ref();
        let inner = || {
            let file = OpenFile::open(path)?;
            let source = Source::File(&file);
            match recognise(&source, Some(path))? {
                SceneFormat::Ply | SceneFormat::CompressedPly => ply::read::scene_header(&source),
                SceneFormat::Spz => spz::header(&source),
                SceneFormat::Splat => splat::header(&source),
                SceneFormat::Sog => sog::header(&source),
                SceneFormat::Ksplat => ksplat::header(&source),
            }
        };
        inner().map_err(|problem| LoadError { path: path.to_owned(), problem })
    }
}

impl Scene {
    /// Loads a scene file of any [`SceneFormat`], which its bytes tell.
    ///
    /// # Errors
    /// The file cannot be read, is not a scene, is damaged, does not fit in memory, or was written to meanwhile. See
    /// [`SceneError`].
    pub fn load(path: impl AsRef<Path>, progress: Progress) -> Result<Self, LoadError> {
        let path = path.as_ref();
        let inner = || {
            let file = OpenFile::open(path)?;
            let input = Input { source: &Source::File(&file), memory: memory::available(), progress };
            let parsed = parse(&input, Some(path));
            // Whatever was found in a file that changed under the reader says nothing about the file.
            file.check_unchanged().and(parsed)
        };
        inner().map_err(|problem| LoadError { path: path.to_owned(), problem })
    }

    /// Parses a scene from the bytes of a file.
    ///
    /// # Errors
    /// Those of [`Scene::load`].
    pub fn parse(bytes: &[u8], progress: Progress) -> Result<Self, SceneError> {
        parse(&Input { source: &Source::Bytes(bytes), memory: memory::available(), progress }, None)
    }

    /// Writes the scene as SPZ of a version; [`Scene::write`] takes the newest.
    ///
    /// # Errors
    /// The writer fails, or a coordinate is beyond 8,388,607.
    pub fn write_spz(&self, version: SpzVersion, out: &mut impl Write) -> std::io::Result<()> {
        spz::write(self, version, out)
    }

    /// Writes the scene in a format, in the world's coordinates.
    ///
    /// All formats but [`SceneFormat::Ply`] round the values: [`SceneFormat::losses`] says how.
    ///
    /// # Errors
    /// The writer fails, or the format is none of [`SceneFormat::WRITTEN`].
    pub fn write(&self, format: SceneFormat, out: &mut impl Write) -> std::io::Result<()> {
        match format {
            SceneFormat::Ply => self.write_ply_to(out),
            SceneFormat::CompressedPly => ply::pack::write(self, out),
            SceneFormat::Spz => spz::write(self, SpzVersion::default(), out),
            SceneFormat::Splat => splat::write(self, out),
            SceneFormat::Sog | SceneFormat::Ksplat => {
                let found = format.extension();
                let text =
                    format!("expected a format that can be written, found {found}, which is read alone");
                Err(std::io::Error::new(std::io::ErrorKind::Unsupported, text))
            }
        }
    }
}
