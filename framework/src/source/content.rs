//! The contents of paths, as hashes: they tell later whether a build would read the same again.

use std::fs::{self, Metadata};
use std::hash::{DefaultHasher, Hasher};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Larger files are not graphs or shaders; reading one by mistake must not fill the memory.
pub(super) const LARGEST_FILE: u64 = 16 << 20;

/// Identifies the contents of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Content {
    /// No file. A folder counts as none: it does not end a search either.
    Missing,
    /// Something that cannot be read, or not twice (a pipe), or that is too large to be meant.
    Unusable,
    /// A file of `length` bytes. The hash is SipHash with fixed keys, 64 bits; it means nothing outside of this process.
    Bytes {
        /// Length in bytes.
        length: u64,
        /// SipHash of the bytes.
        hash: u64,
    },
}

/// Names a path on disk that a build read, and its contents. A build has the same result while none of them changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// As it was opened: relative to the working directory, unless it is absolute.
    pub path: PathBuf,
    /// The contents at that time.
    pub content: Content,
}

impl Content {
    /// Identifies a file of these bytes.
    pub fn of(bytes: &[u8]) -> Content {
        let mut hasher = DefaultHasher::new();
        hasher.write(bytes);
        Content::Bytes { length: bytes.len() as u64, hash: hasher.finish() }
    }

    /// Identifies the contents of `path`. Links are followed.
    pub fn at(path: &Path) -> Content {
        match file_at(path) {
            Ok(Some(metadata)) if metadata.is_file() => {}
            Ok(None) => return Content::Missing,
            Ok(Some(_)) | Err(_) => return Content::Unusable,
        }
        match read(path) {
            Ok(Some(bytes)) => Content::of(&bytes),
            Ok(None) => Content::Unusable,
            // It went away since.
            Err(error) if is_missing(error.kind()) => Content::Missing,
            Err(_) => Content::Unusable,
        }
    }

    /// No file, or one without a byte in it: what editors leave for a moment while they save.
    pub fn is_empty(self) -> bool {
        matches!(self, Content::Missing | Content::Bytes { length: 0, .. })
    }
}

/// Returns the metadata of a file at `path`, links followed; `None` where there is none or a folder.
pub(super) fn file_at(path: &Path) -> std::io::Result<Option<Metadata>> {
    match fs::metadata(path) {
        Ok(metadata) if metadata.is_dir() => Ok(None),
        Ok(metadata) => Ok(Some(metadata)),
        Err(error) if is_missing(error.kind()) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The bytes of a file; `None` if they are more than [`LARGEST_FILE`].
pub(super) fn read(path: &Path) -> std::io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    fs::File::open(path)?.take(LARGEST_FILE + 1).read_to_end(&mut bytes)?;
    Ok((bytes.len() as u64 <= LARGEST_FILE).then_some(bytes))
}

/// The errors that mean that there is no such file, rather than one that cannot be had.
fn is_missing(kind: ErrorKind) -> bool {
    matches!(
        kind,
        ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::InvalidInput | ErrorKind::InvalidFilename
    )
}
