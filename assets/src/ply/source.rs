//! Reads pieces of a scene file at given offsets, from several threads at once.
//!
//! The file is not mapped into memory: a process that truncates a mapped file ends its readers with a signal. Every byte is
//! read into a buffer instead, so that a file that becomes shorter is an error of the read. Buffers are a few mebibytes and
//! used again. [`OpenFile`] remembers the file's length and time of change from before the first read, and tells at the end
//! whether it is still the same.

use crate::error::SceneError;
use crate::file;
use std::fs::File;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime};

/// The bytes of a scene.
pub(crate) enum Source<'a> {
    /// In memory.
    Bytes(&'a [u8]),
    /// In a file.
    File(&'a OpenFile),
}

impl Source<'_> {
    /// Returns the length in bytes; of a file, when it was opened.
    pub(crate) fn length(&self) -> u64 {
        match self {
            Self::Bytes(bytes) => bytes.len() as u64,
            Self::File(file) => file.length,
        }
    }

    /// Fills `buffer` with the bytes from offset `at` on.
    ///
    /// # Errors
    /// The bytes end before the buffer is full, or the system fails.
    pub(crate) fn read(&self, at: u64, buffer: &mut [u8]) -> io::Result<()> {
        match self {
            Self::Bytes(bytes) => {
                let start = usize::try_from(at).ok();
                let from = start.and_then(|start| bytes.get(start..)?.get(..buffer.len()));
                buffer.copy_from_slice(from.ok_or_else(ended)?);
                Ok(())
            }
            Self::File(file) => file.read(at, buffer),
        }
    }

    /// Reads the first bytes, `limit` at most.
    pub(crate) fn head(&self, limit: usize) -> io::Result<Vec<u8>> {
        let mut head = vec![0; usize::try_from(self.length()).unwrap_or(limit).min(limit)];
        self.read(0, &mut head)?;
        Ok(head)
    }
}

fn ended() -> io::Error {
    io::Error::new(ErrorKind::UnexpectedEof, "it ends before its last byte")
}

/// An opened scene file.
pub(crate) struct OpenFile {
    file: File,
    length: u64,
    modified: Option<SystemTime>,
}

/// The age at which a time of change is certain to differ from that of a change made now: clocks of file systems tick every
/// 10 ms at most.
const SETTLED: Duration = Duration::from_millis(20);

impl OpenFile {
    /// Opens a regular file.
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let file = file::open(path)?;
        let metadata = file.metadata()?;
        let modified = metadata.modified().ok();
        // A change that falls into the same tick as the one before it would not be seen.
        if let Some(age) = modified.and_then(|modified| modified.elapsed().ok()).filter(|age| *age < SETTLED)
        {
            std::thread::sleep(SETTLED - age);
        }
        Ok(Self { file, length: metadata.len(), modified })
    }

    fn read(&self, mut at: u64, mut buffer: &mut [u8]) -> io::Result<()> {
        while !buffer.is_empty() {
            match read_at(&self.file, buffer, at) {
                Ok(0) => return Err(ended()),
                Ok(count) => {
                    buffer = &mut buffer[count..];
                    at += count as u64;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Refuses a file that was changed since it was opened.
    pub(crate) fn check_unchanged(&self) -> Result<(), SceneError> {
        let metadata = self.file.metadata()?;
        let (expected, found) = (self.length, metadata.len());
        if found < expected {
            return Err(SceneError::BecameShorter { expected, found });
        }
        if found > expected || metadata.modified().ok() != self.modified {
            return Err(SceneError::Changed);
        }
        Ok(())
    }
}

#[cfg(unix)]
fn read_at(file: &File, buffer: &mut [u8], at: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, at)
}

#[cfg(windows)]
fn read_at(file: &File, buffer: &mut [u8], at: u64) -> io::Result<usize> {
    // It moves the file's cursor, which nothing here uses.
    std::os::windows::fs::FileExt::seek_read(file, buffer, at)
}

/// Buffers that the threads of a load use again: no more than one per thread is ever made.
#[derive(Default)]
pub(crate) struct Buffers {
    free: Mutex<Vec<Vec<u8>>>,
}

impl Buffers {
    /// Calls `work` with a buffer of at least `bytes` bytes, of any contents.
    ///
    /// # Errors
    /// There is no memory for it, or `work` fails.
    pub(crate) fn with<T>(
        &self,
        bytes: usize,
        work: impl FnOnce(&mut [u8]) -> Result<T, SceneError>,
    ) -> Result<T, SceneError> {
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = free().pop();
        let mut buffer = taken.unwrap_or_default();
        grow(&mut buffer, bytes)?;
        let done = work(&mut buffer);
        free().push(buffer);
        done
    }
}

/// Makes a buffer at least `bytes` long.
pub(crate) fn grow(buffer: &mut Vec<u8>, bytes: usize) -> io::Result<()> {
    if buffer.len() < bytes {
        buffer.try_reserve_exact(bytes - buffer.len())?;
        buffer.resize(bytes, 0);
    }
    Ok(())
}
