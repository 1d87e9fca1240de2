//! Opens and reads files that a user names. Only regular files are opened, and [`read`] has a size limit.
//!
//! Opening a FIFO blocks until it has a writer, and a device such as `/dev/zero` never ends. Paths are therefore
//! checked before they are opened, and a file is read only up to a limit, regardless of its reported length.

use std::fs::{File, FileType};
use std::hash::{DefaultHasher, Hasher};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::{Component, Path, PathBuf};

/// Opens a regular file for reading.
///
/// # Errors
/// System errors, and [`ErrorKind::InvalidInput`] for a folder, a FIFO, a socket or a device.
pub fn open(path: impl AsRef<Path>) -> Result<File> {
    let path = path.as_ref();
    // Checked before the path is opened, which blocks for a FIFO, and again after, because the path may have changed.
    require_regular(std::fs::metadata(path)?.file_type())?;
    let file = File::open(path)?;
    require_regular(file.metadata()?.file_type())?;
    Ok(file)
}

/// Reads a regular file of at most `limit` bytes.
///
/// # Errors
/// The errors of [`open`], [`ErrorKind::FileTooLarge`] for a longer file, and [`ErrorKind::OutOfMemory`].
pub fn read(path: impl AsRef<Path>, limit: u64) -> Result<Vec<u8>> {
    let file = open(path)?;
    let length = file.metadata()?.len();
    let too_large = |found: u64| {
        let text = format!("expected a file of at most {limit} bytes, found {found} or more");
        Error::new(ErrorKind::FileTooLarge, text)
    };
    if length > limit {
        return Err(too_large(length));
    }
    let mut bytes = Vec::new();
    // One byte more, so that `read_to_end` finds the end without another allocation.
    bytes.try_reserve_exact(length as usize + 1)?;
    // `take`, because the file may have grown since its length was read.
    file.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(too_large(bytes.len() as u64));
    }
    Ok(bytes)
}

/// Hashes the bytes of a file from its current position to its end.
///
/// It is in this crate because test builds optimise this crate. Otherwise a test program, which has 200 MB, would take
/// seconds to hash itself.
///
/// # Errors
/// The file cannot be read.
pub fn hash(mut file: File) -> Result<u64> {
    let (mut hash, mut bytes) = (DefaultHasher::new(), vec![0; 1 << 20]);
    loop {
        match file.read(&mut bytes)? {
            0 => return Ok(hash.finish()),
            count => hash.write(&bytes[..count]),
        }
    }
}

/// Reads a regular file of at most `limit` bytes as UTF-8 text.
///
/// # Errors
/// The errors of [`read`], and [`ErrorKind::InvalidData`] if the bytes are not UTF-8.
pub(crate) fn read_text(path: impl AsRef<Path>, limit: u64) -> Result<String> {
    String::from_utf8(read(path, limit)?).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Error::new(ErrorKind::InvalidData, format!("expected UTF-8 text, found another byte at offset {at}"))
    })
}

/// Resolves the name of a file that a document names. `None` without a `folder`, and if a component of the path is not
/// a plain name, such as `/`, `..` or a leading `.`.
pub(crate) fn beside(folder: Option<&Path>, name: &str) -> Option<PathBuf> {
    let inside = Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
    folder.filter(|_| inside).map(|folder| folder.join(name))
}

fn require_regular(kind: FileType) -> Result<()> {
    if kind.is_file() {
        return Ok(());
    }
    let text = format!("expected a regular file, found {}", name(kind));
    Err(Error::new(ErrorKind::InvalidInput, text))
}

fn name(kind: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return "a FIFO";
        }
        if kind.is_socket() {
            return "a socket";
        }
        if kind.is_char_device() || kind.is_block_device() {
            return "a device";
        }
    }
    if kind.is_dir() { "a folder" } else { "another kind of file" }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::says;

    #[test]
    fn a_file_is_read_up_to_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, "four").unwrap();
        assert_eq!(read_text(&path, 4).unwrap(), "four");
        let said = read(&path, 3).unwrap_err();
        assert_eq!(said.kind(), ErrorKind::FileTooLarge);
        says(said, "at most 3 bytes, found 4");
        std::fs::write(&path, b"ab\xFF").unwrap();
        says(read_text(&path, 9).unwrap_err(), "UTF-8 text, found another byte at offset 2");
    }

    #[test]
    fn a_folder_is_no_regular_file() {
        let said = open(".").unwrap_err().to_string();
        assert_eq!(said, "expected a regular file, found a folder");
    }

    #[cfg(unix)]
    #[test]
    fn a_fifo_and_a_device_are_refused_before_anything_waits_for_them() {
        let folder = tempfile::tempdir().unwrap();
        let fifo = folder.path().join("fifo");
        let made = std::process::Command::new("mkfifo").arg(&fifo).status().unwrap();
        assert!(made.success());
        assert_eq!(open(&fifo).unwrap_err().to_string(), "expected a regular file, found a FIFO");
        assert_eq!(read("/dev/zero", 9).unwrap_err().to_string(), "expected a regular file, found a device");
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        assert_eq!(open(&socket).unwrap_err().to_string(), "expected a regular file, found a socket");
    }
}
