//! Hashes the contents of paths, to detect later whether a build would read the same contents.

use std::fs::{self, File, Metadata, OpenOptions};
use std::hash::{DefaultHasher, Hasher};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Maximum size of a file to read: graphs and shaders are smaller, and other files must not fill the memory.
pub(super) const LARGEST_FILE: u64 = 16 << 20;

/// The contents of a path, identified by a hash.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Content {
    /// No file: nothing at all, or a folder. A search for the file continues.
    Missing,
    /// An unreadable entry, a special file (a pipe, a device), or a file that is too large.
    Unusable,
    /// A file of `length` bytes. The hash is SipHash with fixed keys, 64 bits, for use in this process only.
    Bytes {
        /// Length in bytes.
        length: u64,
        /// SipHash of the bytes.
        hash: u64,
    },
}

/// A path on disk that a build read, and its contents. A build gives the same result while all of them stay unchanged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// The path as opened, relative to the working directory or absolute.
    pub path: PathBuf,
    /// The contents when the build read them.
    pub content: Content,
}

impl Content {
    /// Identifies a file of these bytes.
    pub fn of(bytes: &[u8]) -> Content {
        let mut hasher = DefaultHasher::new();
        hasher.write(bytes);
        Content::Bytes { length: bytes.len() as u64, hash: hasher.finish() }
    }

    /// Identifies the contents of `path`, following links.
    pub fn at(path: &Path) -> Content {
        let read = open(path).and_then(|found| match found {
            Found::Nothing => Ok(Content::Missing),
            Found::Other(_) => Ok(Content::Unusable),
            Found::File(file) => Ok(read(file)?.map_or(Content::Unusable, |bytes| Content::of(&bytes))),
        });
        read.unwrap_or(Content::Unusable)
    }

    /// Returns true for a missing or empty file, which editors leave briefly while they save.
    pub fn is_empty(self) -> bool {
        matches!(self, Content::Missing | Content::Bytes { length: 0, .. })
    }
}

/// Entry at a path, with links followed.
pub(super) enum Found {
    /// Nothing, or a folder. A search for a file continues.
    Nothing,
    /// A regular file.
    File(File),
    /// An entry that cannot be read as a file, such as a pipe, with its description.
    Other(&'static str),
}

/// Opens a regular file only: opening a pipe would wait for its other end, and opening a device can have effects.
pub(super) fn open(path: &Path) -> std::io::Result<Found> {
    let looked = |result: std::io::Result<Metadata>| match result {
        Ok(metadata) if metadata.is_file() => Ok(None),
        Ok(metadata) if metadata.is_dir() => Ok(Some(Found::Nothing)),
        Ok(metadata) => Ok(Some(Found::Other(kind(&metadata)))),
        Err(error) if is_missing(error.kind()) => Ok(Some(Found::Nothing)),
        Err(error) => Err(error),
    };
    if let Some(found) = looked(fs::metadata(path))? {
        return Ok(found);
    }
    let mut options = OpenOptions::new();
    options.read(true);
    // The entry may have been replaced meanwhile.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK | libc::O_NOCTTY);
    let file = match options.open(path) {
        Ok(file) => file,
        Err(error) if is_missing(error.kind()) => return Ok(Found::Nothing),
        Err(error) => return Err(error),
    };
    Ok(looked(file.metadata())?.unwrap_or(Found::File(file)))
}

fn kind(metadata: &Metadata) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        let kind = metadata.file_type();
        if kind.is_fifo() {
            return "a pipe";
        } else if kind.is_socket() {
            return "a socket";
        } else if kind.is_char_device() || kind.is_block_device() {
            return "a device";
        }
    }
    let _ = metadata;
    "something else"
}

/// Reads a file; `None` if it is larger than [`LARGEST_FILE`].
pub(super) fn read(file: File) -> std::io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    file.take(LARGEST_FILE + 1).read_to_end(&mut bytes)?;
    Ok((bytes.len() as u64 <= LARGEST_FILE).then_some(bytes))
}

/// Returns true for errors that mean that the file does not exist, rather than that it is unreadable.
fn is_missing(kind: ErrorKind) -> bool {
    matches!(
        kind,
        ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::InvalidInput | ErrorKind::InvalidFilename
    )
}
