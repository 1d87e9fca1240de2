//! Defines the errors of scene files. Each message states what was expected, what was found, and where.

use crate::memory::SceneMemoryError;
use crate::scene_format::SceneFormat;
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// An error while loading a scene file.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", path.display())]
pub struct LoadError {
    /// Path of the file.
    pub path: PathBuf,
    /// The problem with the file or its contents.
    pub problem: SceneError,
}

/// The reason why a scene cannot be loaded. Line numbers are counted from 1, over the whole file.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The system refused to open or read the file, or it is not a regular file.
    #[error("cannot be read: {0}")]
    Io(#[from] std::io::Error),

    /// The progress callback cancelled the load.
    #[error("the load was cancelled")]
    Cancelled,

    /// The file is empty.
    #[error("expected a scene, found an empty file")]
    Empty,

    /// The bytes belong to no scene format, or a folder has no document of a scene.
    #[error("expected a scene ({}, or .ron, a list of scenes), found {found}", SceneFormat::endings())]
    NotScene {
        /// The likely kind of the file.
        found: String,
    },

    /// The file is a mesh, where splats are needed.
    #[error(
        "expected splats, found a mesh; a scene file (.ron) lists it beside splats, and a command that takes several scenes \
         draws it after the first"
    )]
    MeshAlone,

    /// The file has a splat format that is recognised but not supported.
    #[error("unsupported format: this is {format}; {advice}")]
    Unsupported {
        /// The format's name, with its article.
        format: &'static str,
        /// Clause that ends the message: advice, or the formats that are supported instead.
        advice: &'static str,
    },

    /// A level was requested of a scene without levels.
    #[error("expected a scene with levels, a streamed SOG (lod-meta.json), found one without")]
    NoLevels,

    /// A field of a binary file or a line of a text is damaged or not supported. The text begins with the offset of the
    /// field, in the file or in its decompressed data, or with the number of the line.
    #[error("{0}")]
    Malformed(String),

    /// A part of the scene is missing, damaged or malformed. The text states what was expected and found, and where: in
    /// the header of a PLY, a file of the scene, a value in its JSON, or an object such as `accessor 0` or a USD path.
    #[error("{0}")]
    Invalid(String),

    /// Every splat was dropped.
    #[error("none of the {count} splats can be drawn: {reasons}")]
    AllDropped {
        /// Number of splats in the file.
        count: u64,
        /// The counts per reason, in words.
        reasons: String,
    },

    /// The file has more splats than a 32-bit index can address.
    #[error("expected at most 4,294,967,295 splats, which 32 bits can index, found {count}")]
    TooMany {
        /// Number of splats in the file.
        count: u64,
    },

    /// The scene does not fit in the host's memory.
    #[error(transparent)]
    Memory(#[from] SceneMemoryError),

    /// The file was truncated during the read.
    #[error(
        "the file became shorter while it was read: expected {expected} bytes, found {found}; load it again when its writer has \
         finished"
    )]
    BecameShorter {
        /// Bytes of the file when it was opened.
        expected: u64,
        /// Bytes of the file now.
        found: u64,
    },

    /// The file was modified during the read.
    #[error(
        "the file was written to while it was read: expected it to stay as it is; load it again when its writer has finished"
    )]
    Changed,

    /// A scene of a composition cannot be loaded.
    #[error("line {line}, column {column}: {error}")]
    Placed {
        /// Line of the entry's key `file`, from 1.
        line: usize,
        /// Column of the entry's key `file`, from 1.
        column: usize,
        /// Error of the entry's file.
        error: Box<LoadError>,
    },
}

impl SceneError {
    /// The error for 2D Gaussians (2DGS): they are disks, which are projected by other rules.
    pub(crate) const SURFELS: Self = Self::Unsupported {
        format: "a scene of 2D Gaussians (2DGS), which are disks",
        advice: "only 3D Gaussians are drawn",
    };

    /// Creates the error for loading the file at `path`.
    pub(crate) fn of(self, path: &Path) -> LoadError {
        LoadError { path: path.to_owned(), problem: self }
    }

    /// Adds a file name to an error that has only a byte offset or a line number. Returns other errors unchanged. The
    /// file is in the archive or beside the scene.
    pub(crate) fn in_file(self, name: &str) -> Self {
        match self {
            Self::Malformed(message) => wrong(name, message),
            other => other,
        }
    }

    /// Fails for more splats than a 32-bit index can address.
    pub(crate) fn check_count(count: u64) -> Result<(), Self> {
        if count > u32::MAX.into() { Err(Self::TooMany { count }) } else { Ok(()) }
    }
}

/// Creates the error for a field of a binary file.
pub(crate) fn field(at: u64, name: impl Display, message: impl Display) -> SceneError {
    SceneError::Malformed(format!("byte {at}, `{name}`: {message}"))
}

/// Creates the error for a line of a text, counted from 1.
pub(crate) fn row(line: u64, message: impl Display) -> SceneError {
    SceneError::Malformed(format!("line {line}: {message}"))
}

/// Creates the error for a named part of the scene: see [`SceneError::Invalid`].
pub(crate) fn wrong(part: impl Display, message: impl Display) -> SceneError {
    SceneError::Invalid(format!("`{part}`: {message}"))
}

/// Finds the candidate nearest to `name`; `None` if all edit distances exceed a third of `name`'s length (at least 1).
pub(crate) fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::damerau_levenshtein(name, candidate), candidate))
        .filter(|(distance, _)| *distance <= (name.len() / 3).max(1))
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}
