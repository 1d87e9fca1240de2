//! Identifies the contents of a path by a hash, to detect whether a build would read something else.

use std::fs::{self, File, Metadata, OpenOptions};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{ErrorKind, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Maximum size of a file to read, in bytes.
pub(super) const MAX_FILE: u64 = 16 << 20;

/// The contents of a path, with a hash for the bytes of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Content {
    /// No entry. The search for the file continues.
    Missing,
    /// A folder, or a link to nothing. The search for the file continues.
    Obstacle {
        /// Hash of the description that an error shows.
        hash: u64,
    },
    /// An entry that cannot be read, a special file (a pipe, a device), or a file that is too large.
    Unusable,
    /// A file. Compare hashes only within one process: the algorithm can change with the version of Rust.
    Bytes {
        /// Length in bytes.
        length: u64,
        /// Hash of the bytes.
        hash: u64,
    },
    /// A file that [`Content::stamp`] did not read.
    Stamp {
        /// Length in bytes.
        length: u64,
        /// Hash of the file's times and inode.
        hash: u64,
    },
}

/// A path that a build looked up, with its contents at that time. While no path's contents change, a build gives the
/// same result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// The path as opened: absolute, or relative to the working directory.
    pub path: PathBuf,
    /// The contents when the build read them.
    pub content: Content,
}

impl Content {
    /// Returns the contents for a file with these bytes.
    pub fn of(bytes: &[u8]) -> Content {
        Content::Bytes { length: bytes.len() as u64, hash: hash(bytes) }
    }

    /// Returns the contents of a path without a file.
    pub(super) fn without_file(path: &Path) -> Content {
        match obstacle(path) {
            text if text.is_empty() => Content::Missing,
            text => Content::Obstacle { hash: hash(text.as_bytes()) },
        }
    }

    /// Returns the contents of `path`; follows links.
    pub fn at(path: &Path) -> Content {
        let read = open(path).and_then(|found| match found {
            Found::Nothing => Ok(Content::without_file(path)),
            Found::Other(_) => Ok(Content::Unusable),
            Found::File(file) => Ok(read(file)?.map_or(Content::Unusable, |bytes| Content::of(&bytes))),
        });
        read.unwrap_or(Content::Unusable)
    }

    /// Returns the contents of `path` by the metadata of its file, without reading it; follows links. A different
    /// length, time or inode counts as different contents. Compare the result only with other stamps.
    pub fn stamp(path: &Path) -> Content {
        match fs::metadata(path) {
            Ok(metadata) if metadata.is_file() => {
                let mut hasher = DefaultHasher::new();
                Stamp::of(&metadata).hash(&mut hasher);
                Content::Stamp { length: metadata.len(), hash: hasher.finish() }
            }
            Ok(metadata) if metadata.is_dir() => Content::without_file(path),
            Err(error) if is_missing(error.kind()) => Content::without_file(path),
            _ => Content::Unusable,
        }
    }

    /// Returns true if the path has no file, or an empty one. Some editors cause both briefly while they save.
    pub fn is_empty(self) -> bool {
        use Content::{Bytes, Missing, Obstacle, Stamp};
        matches!(self, Missing | Obstacle { .. } | Bytes { length: 0, .. } | Stamp { length: 0, .. })
    }
}

/// Metadata that changes with a file's contents, unless these change twice within the clock's resolution.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub(crate) struct Stamp {
    length: u64,
    pub modified: Option<SystemTime>,
    /// Device, inode, and the time of the last change to either content or inode, in nanoseconds. Zeros on systems
    /// without inodes.
    inode: (u64, u64, i128),
}

impl Stamp {
    pub fn of(metadata: &Metadata) -> Stamp {
        Stamp { length: metadata.len(), modified: metadata.modified().ok(), inode: inode(metadata) }
    }
}

#[cfg(unix)]
fn inode(metadata: &Metadata) -> (u64, u64, i128) {
    use std::os::unix::fs::MetadataExt;
    let changed = i128::from(metadata.ctime()) * 1_000_000_000 + i128::from(metadata.ctime_nsec());
    (metadata.dev(), metadata.ino(), changed)
}

#[cfg(not(unix))]
fn inode(_: &Metadata) -> (u64, u64, i128) {
    (0, 0, 0)
}

fn hash(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write(bytes);
    hasher.finish()
}

/// An entry of the file system, with links followed.
pub(super) enum Found {
    /// Nothing, or a folder. A search for a file continues.
    Nothing,
    /// A regular file, opened for reading.
    File(File),
    /// A pipe, for example. The text describes it for messages.
    Other(&'static str),
}

/// Opens a path if it is a regular file. Opening a pipe would block, and opening a device can have side effects.
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
    // If a pipe replaced the file after the check, opening it must not block.
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

/// Reads a whole file; `None` if it is larger than [`MAX_FILE`].
pub(super) fn read(file: File) -> std::io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    file.take(MAX_FILE + 1).read_to_end(&mut bytes)?;
    Ok((bytes.len() as u64 <= MAX_FILE).then_some(bytes))
}

/// Decodes the bytes of a file as UTF-8 and removes a byte order mark. The error has the text, with a replacement
/// character in place of each invalid sequence, and the range of the first one.
pub(super) fn as_text(mut bytes: Vec<u8>) -> Result<String, (String, Range<usize>)> {
    if bytes.starts_with("\u{feff}".as_bytes()) {
        bytes.drain(..'\u{feff}'.len_utf8());
    }
    String::from_utf8(bytes).map_err(|error| {
        let start = error.utf8_error().valid_up_to();
        let text = String::from_utf8_lossy(error.as_bytes()).into_owned();
        (text, start..start + char::REPLACEMENT_CHARACTER.len_utf8())
    })
}

/// Describes the folder or the link at a path without a file, such as ` (a folder)`. Empty if there is neither.
pub(super) fn obstacle(path: &Path) -> String {
    if path.is_dir() {
        return " (a folder)".to_string();
    }
    let target = fs::read_link(path);
    target.map_or_else(|_| String::new(), |to| format!(" (a link to {}, which does not exist)", to.display()))
}

/// Returns true for errors that mean the file does not exist, rather than that it is unreadable.
fn is_missing(kind: ErrorKind) -> bool {
    matches!(
        kind,
        ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::InvalidInput | ErrorKind::InvalidFilename
    )
}
