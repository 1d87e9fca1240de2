//! Gives format readers the file's bytes, memory limits, parallel conversion and the final checks of a load.
//!
//! The file is not mapped into memory: on Unix, a process that reads a mapped file after its truncation is killed by a
//! signal. Here truncation is a read error. [`OpenFile`] records the file's length and modification time before the
//! first read. After the last read, readers of scenes check that both are unchanged.

use crate::error::{SceneError, wrong};
use crate::file;
use crate::memory::SceneMemoryError;
use crate::scene::{Columns, FileNotes, Gathered, Rows, Scene};
use crate::size_breakdown::SizeBreakdown;
use std::fs::File;
use std::io::{self, BufReader, ErrorKind};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime};
use tracing::info_span;
use zip::ZipArchive;

/// Number of leading bytes that determine the format.
pub(crate) const HEAD: usize = 4096;

/// Bytes of rows that a thread reads at a time; at least one row.
const PIECE: usize = 1 << 20;

/// A callback for the progress of a load, or of a write: the amount of work done, and the total. The unit depends on
/// the format.
///
/// Several threads call it, so the first number may decrease between calls. `Break` cancels: a load returns
/// [`SceneError::Cancelled`] once every thread has stopped, and [`Scene::write`] an error of the kind
/// [`ErrorKind::Interrupted`].
pub type Progress<'a> = &'a (dyn Fn(u64, u64) -> ControlFlow<()> + Sync);

/// A callback that ignores the progress.
pub const QUIET: Progress<'static> = &|_, _| ControlFlow::Continue(());

/// Options of reading a scene file.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReadOptions<'a> {
    /// Level of a streamed SOG: 0 is the finest, and the default.
    pub level: Option<u32>,
    /// Names of further properties to read from a PLY file, for graphs that import `scene.property.NAME`.
    ///
    /// Their values become 32-bit floats. A name of the splat's own values, such as `opacity`, gives the file's numbers,
    /// without activation.
    pub properties: &'a [String],
}

/// Contents of a scene file's header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneHeader {
    /// Number of splats in the file. The scene can have fewer: some may not be drawable, or be inner nodes of a tree.
    pub count: u64,
    /// Degree of the spherical harmonics that a scene from this file stores, at most 3.
    pub stored_degree: u32,
}

impl SceneHeader {
    /// Returns the header of a scene that is joined from others.
    pub(crate) fn joined(all: &[Self]) -> Self {
        Self {
            count: all.iter().fold(0, |sum, header| sum.saturating_add(header.count)),
            stored_degree: all.iter().map(|header| header.stored_degree).max().unwrap_or(0),
        }
    }

    /// Fails unless the `available` memory holds all scenes, the joined scene (with wide positions) and `held` more
    /// bytes. Passes if the memory is unknown, and for a single scene, which is not copied.
    pub(crate) fn check_joined(
        all: &[Self],
        held: u64,
        available: Option<u64>,
    ) -> Result<(), SceneMemoryError> {
        if all.len() < 2 {
            return Ok(());
        }
        let joined = Self::joined(all);
        let bytes = |header: &Self| Scene::host_bytes(header.count, header.stored_degree);
        let low = joined.count.saturating_mul(Columns::LOW_BYTES);
        let needed = all.iter().chain([&joined]).map(bytes).chain([low, held]).fold(0, u64::saturating_add);
        SceneMemoryError::check_against(joined.count, joined.stored_degree, needed, available)
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Input<'a> {
    pub source: &'a Source<'a>,
    /// Available memory in bytes, if known.
    pub memory: Option<u64>,
    pub progress: Progress<'a>,
    /// Further properties to read; see [`ReadOptions::properties`].
    pub properties: &'a [String],
}

impl<'a> Input<'a> {
    /// Creates the input of a load without further properties.
    pub(crate) fn new(source: &'a Source<'a>, memory: Option<u64>, progress: Progress<'a>) -> Self {
        Self { source, memory, progress, properties: &[] }
    }

    /// Allocates the arrays of a scene. Positions that are `wide` have more precision than f32.
    ///
    /// Fails if the available memory is less than the arrays, `beside` more bytes, and a buffer per thread for rows of
    /// `stride` bytes.
    pub(crate) fn allocate(
        &self,
        count: u64,
        degree: u32,
        wide: bool,
        (stride, beside): (usize, u64),
    ) -> Result<Columns, SceneError> {
        let buffers = (rayon::current_num_threads() * PIECE.max(stride)) as u64;
        Ok(Columns::allocate(count, degree, wide, beside.saturating_add(buffers), self.memory)?)
    }

    /// Allocates the arrays of a scene, as [`Input::allocate`] does, and fills them in parallel from tables.
    ///
    /// `convert` gets the row of every table, empty for [`Table::NONE`], and the splat's index, and pushes one splat.
    /// Fails if the arrays do not fit in memory, the load is cancelled, or a table cannot be read.
    pub(crate) fn fill<const N: usize>(
        &self,
        (count, degree, wide): (u64, u32, bool),
        tables: [Table; N],
        beside: u64,
        done: &Done,
        convert: impl Fn([&[u8]; N], usize, &mut Rows) + Sync,
    ) -> Result<Filled, SceneError> {
        self.fill_with(&[], (count, degree, wide), tables, beside, done, convert)
    }

    /// Fills arrays like [`Input::fill`], with further properties of these names, which `convert` sets.
    pub(crate) fn fill_with<const N: usize>(
        &self,
        names: &[String],
        (count, degree, wide): (u64, u32, bool),
        tables: [Table; N],
        beside: u64,
        done: &Done,
        convert: impl Fn([&[u8]; N], usize, &mut Rows) + Sync,
    ) -> Result<Filled, SceneError> {
        let stride: usize = tables.iter().map(|table| table.stride).sum();
        let width: usize = tables.iter().map(|table| table.width).sum();
        let rows_at_once = (PIECE / stride).max(1);
        let columns = self.allocate(count, degree, wide, (stride, beside))?;
        let mut columns = columns.with_properties(names)?;
        let buffers = Buffers::default();
        let gathered = columns.fill(|out: &mut Rows| {
            buffers.with(rows_at_once.min(out.len()) * stride, |buffer| {
                for first in (0..out.len()).step_by(rows_at_once) {
                    done.check()?;
                    let count = rows_at_once.min(out.len() - first);
                    let first = out.first() + first;
                    let mut left = &mut buffer[..count * stride];
                    let mut pieces: [&[u8]; N] = [&[]; N];
                    for (table, piece) in tables.iter().zip(&mut pieces).filter(|(table, _)| table.width > 0)
                    {
                        let (rows, others) = left.split_at_mut(count * table.stride);
                        info_span!("read rows", bytes = rows.len())
                            .in_scope(|| table.read(first, count, rows))?;
                        (*piece, left) = (rows, others);
                    }
                    let _span = info_span!("convert rows", count).entered();
                    for row in 0..count {
                        let at = |at: usize| {
                            let Table { stride, width, .. } = tables[at];
                            &pieces[at][row * stride..][..width]
                        };
                        convert(std::array::from_fn(at), first + row, out);
                    }
                    done.add((count * width) as u64)?;
                }
                Ok(())
            })
        })?;
        Ok((columns, gathered))
    }
}

/// The arrays of a scene, filled from a file.
pub(crate) type Filled = (Columns, Gathered);

/// Creates the scene from the stored splats; fails if all of the file's `count` were dropped.
pub(crate) fn finish(
    (columns, gathered): Filled,
    count: u64,
    size_breakdown: SizeBreakdown,
    notes: FileNotes,
) -> Result<Scene, SceneError> {
    let notes = FileNotes { clamped_opacities: gathered.clamped_opacities, ..notes };
    let scene = Scene::new(columns, gathered).with_breakdown(size_breakdown).with_notes(notes);
    if scene.count() == 0 {
        return Err(SceneError::AllDropped { count, reasons: scene.dropped().to_string() });
    }
    Ok(scene)
}

/// A table in a file: rows of equal size, usually one for each splat.
#[derive(Clone, Copy)]
pub(crate) struct Table<'a> {
    pub source: Source<'a>,
    /// Offset of the first row.
    pub start: u64,
    /// Distance in bytes from one row to the next.
    pub stride: usize,
    /// Bytes of a row; 0 if the file lacks the table.
    pub width: usize,
}

impl<'a> Table<'a> {
    /// The table that a file lacks.
    pub(crate) const NONE: Self = Self { source: Source::Bytes(&[]), start: 0, stride: 0, width: 0 };

    /// Creates a table without gaps between its rows.
    pub(crate) fn new(source: Source<'a>, start: u64, width: usize) -> Self {
        Self { source, start, stride: width, width }
    }

    /// Reads `count` rows, at least one, from index `first` on, each at a multiple of the stride in `buffer`. The file
    /// can end with the last row, so its stride is not read.
    pub(crate) fn read(&self, first: usize, count: usize, buffer: &mut [u8]) -> io::Result<()> {
        let bytes = (count - 1) * self.stride + self.width;
        self.source.read(self.start + (first * self.stride) as u64, &mut buffer[..bytes])
    }
}

/// The summed progress of parallel chunks. If the load is cancelled, all of them stop.
pub(crate) struct Done<'a> {
    done: AtomicU64,
    of: u64,
    tell: Progress<'a>,
    cancelled: AtomicBool,
}

impl<'a> Done<'a> {
    pub(crate) fn new(of: u64, tell: Progress<'a>) -> Result<Self, SceneError> {
        let begun = Self::after(0, of, tell);
        begun.add(0)?;
        Ok(begun)
    }

    /// Creates the progress of a load of which `done` bytes are done, and `of` are the total.
    pub(crate) fn after(done: u64, of: u64, tell: Progress<'a>) -> Self {
        Self { done: AtomicU64::new(done), of, tell, cancelled: AtomicBool::new(false) }
    }

    pub(crate) fn add(&self, bytes: u64) -> Result<(), SceneError> {
        let done = self.done.fetch_add(bytes, Ordering::Relaxed) + bytes;
        if (self.tell)(done, self.of).is_break() {
            self.cancelled.store(true, Ordering::Relaxed);
        }
        self.check()
    }

    pub(crate) fn check(&self) -> Result<(), SceneError> {
        if self.cancelled.load(Ordering::Relaxed) { Err(SceneError::Cancelled) } else { Ok(()) }
    }
}

#[derive(Clone, Copy)]
pub(crate) enum Source<'a> {
    Bytes(&'a [u8]),
    File(&'a OpenFile),
    /// The bytes of a file from an offset on, and their number.
    Part(&'a OpenFile, u64, u64),
}

impl Source<'_> {
    /// Returns `length` bytes from offset `start` on, which must lie within the source.
    pub(crate) fn part(self, start: u64, length: u64) -> Self {
        match self {
            Self::Bytes(bytes) => Self::Bytes(&bytes[start as usize..][..length as usize]),
            Self::File(file) => Self::Part(file, start, length),
            Self::Part(file, first, _) => Self::Part(file, first + start, length),
        }
    }

    /// Returns the length in bytes; for a file, when it was opened.
    pub(crate) fn length(&self) -> u64 {
        match self {
            Self::Bytes(bytes) => bytes.len() as u64,
            Self::File(file) => file.length,
            Self::Part(_, _, length) => *length,
        }
    }

    /// Fills `buffer` with the bytes from offset `at` on. Fails if the source has too few.
    pub(crate) fn read(&self, at: u64, buffer: &mut [u8]) -> io::Result<()> {
        match self {
            Self::Bytes(bytes) => {
                let start = usize::try_from(at).ok();
                let from = start.and_then(|start| bytes.get(start..)?.get(..buffer.len()));
                buffer.copy_from_slice(from.ok_or_else(ended)?);
                Ok(())
            }
            Self::File(file) => file.read(at, buffer),
            Self::Part(file, start, length) => {
                let end = at.checked_add(buffer.len() as u64);
                end.filter(|end| end <= length).ok_or_else(ended)?;
                file.read(start + at, buffer)
            }
        }
    }

    /// Reads the first bytes, `limit` at most. A lack of memory is an error.
    pub(crate) fn head(&self, limit: usize) -> io::Result<Vec<u8>> {
        self.bytes(0, usize::try_from(self.length()).unwrap_or(limit).min(limit))
    }

    /// Reads `count` bytes from offset `at` on. A lack of memory is an error.
    pub(crate) fn bytes(&self, at: u64, count: usize) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        grow(&mut bytes, count)?;
        self.read(at, &mut bytes)?;
        Ok(bytes)
    }
}

/// Resolves the name of a file that a document names, as [`file::beside`] does. Fails where that returns `None`, and
/// for an empty name.
pub(crate) fn beside(folder: Option<&Path>, name: &str) -> Result<PathBuf, SceneError> {
    let path = file::beside(folder, name).filter(|_| !name.is_empty());
    path.ok_or_else(|| {
        let part: String = name.chars().take(60).collect();
        wrong(part, "expected a file in the folder of the JSON, found another place")
    })
}

/// Calls `read` with the bytes of a file. Fails as `read` does, or if the file changes meanwhile: any other error may be
/// a consequence of the change.
pub(crate) fn read_file<T>(
    path: &Path,
    read: impl FnOnce(&Source) -> Result<T, SceneError>,
) -> Result<T, SceneError> {
    let file = OpenFile::open(path)?;
    let done = read(&Source::File(&file));
    file.check_unchanged().and(done)
}

/// Reads a file that a document names, as [`read_file`] does. `read` also gets the path. Errors name the file.
pub(crate) fn read_beside<T>(
    folder: Option<&Path>,
    name: &str,
    read: impl FnOnce(&Source, &Path) -> Result<T, SceneError>,
) -> Result<T, SceneError> {
    let path = beside(folder, name)?;
    read_file(&path, |source| read(source, &path)).map_err(|problem| match problem {
        SceneError::Cancelled => problem,
        SceneError::Io(error) => {
            wrong(name, format!("expected a readable file beside this one, found: {error}"))
        }
        _ => wrong(name, problem),
    })
}

pub(crate) struct SourceReader<'a> {
    source: &'a Source<'a>,
    at: u64,
}

impl<'a> SourceReader<'a> {
    pub(crate) fn new(source: &'a Source<'a>, at: u64) -> Self {
        Self { source, at }
    }
}

impl io::Read for SourceReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = self.source.length().saturating_sub(self.at);
        let count = usize::try_from(left).unwrap_or(usize::MAX).min(buffer.len());
        self.source.read(self.at, &mut buffer[..count])?;
        self.at += count as u64;
        Ok(count)
    }
}

impl io::Seek for SourceReader<'_> {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        let at = match to {
            io::SeekFrom::Start(at) => Some(at),
            io::SeekFrom::End(by) => self.source.length().checked_add_signed(by),
            io::SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = at.ok_or_else(|| io::Error::from(ErrorKind::InvalidInput))?;
        Ok(self.at)
    }
}

pub(crate) fn archive<'a>(
    source: &'a Source<'a>,
) -> Result<ZipArchive<BufReader<SourceReader<'a>>>, SceneError> {
    ZipArchive::new(BufReader::new(SourceReader::new(source, 0))).map_err(|error| {
        match has_directory(source) {
            Ok(false) => {
                wrong("zip", "the file is truncated: expected the archive's directory at its end, found none")
            }
            _ => wrong("zip", format!("expected an intact archive, found damage: {error}")),
        }
    })
}

/// Returns true if a ZIP archive ends with the record that locates its directory.
fn has_directory(source: &Source) -> io::Result<bool> {
    // A comment of at most 65,535 bytes follows the record.
    const RECORD: usize = 22;
    const LONGEST: u64 = RECORD as u64 + 65_535;
    let length = source.length().min(LONGEST);
    let mut end = vec![0; length as usize];
    source.read(source.length() - length, &mut end)?;
    Ok(end.windows(RECORD).any(|bytes| bytes.starts_with(b"PK\x05\x06")))
}

fn ended() -> io::Error {
    io::Error::new(ErrorKind::UnexpectedEof, "it ends before its last byte")
}

pub(crate) struct OpenFile {
    file: File,
    length: u64,
    modified: Option<SystemTime>,
}

/// Minimum age of a file's modification time when it is opened. A later change then gets a different time, if the file
/// system's clock ticks at least this often.
const SETTLED: Duration = Duration::from_millis(20);

impl OpenFile {
    /// Opens a regular file. Waits until its modification time is at least [`SETTLED`] ago.
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let file = file::open(path)?;
        let metadata = file.metadata()?;
        let modified = metadata.modified().ok();
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

    /// Fails if the file was modified since it was opened.
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
    // `seek_read` moves the file's cursor, which nothing here uses.
    std::os::windows::fs::FileExt::seek_read(file, buffer, at)
}

/// Buffers reused by the threads of a load: at most one per thread.
#[derive(Default)]
pub(crate) struct Buffers {
    free: Mutex<Vec<Vec<u8>>>,
}

impl Buffers {
    /// Calls `work` with a buffer of at least `bytes` bytes, whose contents are unspecified. Fails if the buffer does
    /// not fit in memory, or as `work` does.
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

pub(crate) fn grow(buffer: &mut Vec<u8>, bytes: usize) -> io::Result<()> {
    if buffer.len() < bytes {
        buffer.try_reserve_exact(bytes - buffer.len())?;
        buffer.resize(bytes, 0);
    }
    Ok(())
}
