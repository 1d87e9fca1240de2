//! Claims a folder for one request, by a file in it that describes the request.

use super::file::{folder_of, write_new_bytes};
use crate::io::own_file;
use anyhow::{Context, Result};
use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// Outcome of claiming a folder for a request.
pub enum Claim {
    /// The folder had neither a description nor results; it has the request's description now.
    Written,
    /// The folder has this description.
    Found(Vec<u8>),
    /// The folder has this result, without a description.
    Stray(PathBuf),
}

/// Writes the `description` of a request to `file`, unless the file exists, or `stray` finds a result.
///
/// If two requests are concurrent, one writes its description, and the other finds it.
///
/// # Errors
/// The file cannot be read or written.
pub fn claim(file: &Path, description: &[u8], stray: impl FnOnce() -> Option<PathBuf>) -> Result<Claim> {
    let read = || own_file::read(file).with_context(|| file.display().to_string()).map(Claim::Found);
    match fs::metadata(file) {
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        _ => return read(),
    }
    match stray() {
        // Another process may have written the description in the meantime.
        Some(stray) if !file.exists() => return Ok(Claim::Stray(stray)),
        _ => {}
    }
    match write_new_bytes(file, description) {
        Err(error) if error.is_taken() => read(),
        written => Ok(written.map(|()| Claim::Written)?),
    }
}

/// Creates the folder of `file`, and locks it until the result is dropped. `None` if the folder cannot be opened, or
/// does not support locks, as on some network disks.
///
/// # Errors
/// Another process holds the lock ([`ErrorKind::WouldBlock`]), or the folder cannot be created.
pub fn lock(file: &Path) -> io::Result<Option<File>> {
    let folder = folder_of(file);
    fs::create_dir_all(folder)?;
    let Ok(folder) = File::open(folder) else { return Ok(None) };
    match folder.try_lock() {
        Ok(()) => Ok(Some(folder)),
        Err(TryLockError::WouldBlock) => Err(ErrorKind::WouldBlock.into()),
        Err(TryLockError::Error(_)) => Ok(None),
    }
}
