//! Reads a scene file: parses the header, then converts the rows in parallel.
//!
//! The file is memory-mapped. Binary rows have a fixed length, so every chunk of splats is converted from the mapping into
//! the scene's arrays independently. ASCII rows differ in length, so a first pass finds the start of each chunk.

use super::header::{Element, Encoding, Header, Property, begins_as_ply};
use super::layout::{Layout, MAX_SLOTS};
use super::{ascii, binary};
use crate::error::{LoadError, SceneError};
use crate::recognise;
use crate::scene::{CHUNK, Columns, Gathered, Rows, Scene};
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// A callback for the progress of a load: bytes of splats converted, and bytes in all.
///
/// Several threads call it, so the first number does not always ascend.
pub type Progress<'a> = &'a (dyn Fn(u64, u64) + Sync);

impl Scene {
    /// Loads a scene file.
    ///
    /// # Errors
    /// The file cannot be read, is not a PLY file in the reference layout, or is damaged. See [`SceneError`].
    pub fn load(path: impl AsRef<Path>, progress: Progress) -> Result<Self, LoadError> {
        let path = path.as_ref();
        let inner = || {
            let file = std::fs::File::open(path)?;
            if file.metadata()?.is_dir() {
                return Err(std::io::Error::other("it is a folder").into());
            }
            if file.metadata()?.len() == 0 {
                return Err(SceneError::Empty);
            }
            parse(&map(&file)?, Some(path), progress)
        };
        inner().map_err(|problem| LoadError { path: path.to_owned(), problem })
    }

    /// Parses a scene from the bytes of a file.
    ///
    /// # Errors
    /// Those of [`Scene::load`].
    pub fn parse(bytes: &[u8], progress: Progress) -> Result<Self, SceneError> {
        parse(bytes, None, progress)
    }
}

/// Maps a file into memory.
fn map(file: &std::fs::File) -> std::io::Result<memmap2::Mmap> {
    // SAFETY: the mapping is only read, through shared slices, and is dropped before `load` returns. A process that
    // writes to the file meanwhile can change the bytes, and every use of them is bounds-checked; one that truncates the
    // file ends this process with SIGBUS, as in every program that maps its input.
    unsafe { memmap2::Mmap::map(file) }
}

/// Parses a scene; `path` helps to identify a file of another format.
fn parse(bytes: &[u8], path: Option<&Path>, progress: Progress) -> Result<Scene, SceneError> {
    if bytes.is_empty() {
        return Err(SceneError::Empty);
    }
    if !begins_as_ply(bytes) {
        return Err(recognise::not_ply(path, bytes));
    }
    let header = Header::parse(bytes)?;
    let vertex = header.elements.iter().find(|e| e.name == "vertex").ok_or_else(|| {
        SceneError::NoVertexElement { found: header.elements.iter().map(|e| e.name.clone()).collect() }
    })?;
    let layout = Layout::find(vertex)?;
    if vertex.count == 0 {
        return Err(SceneError::NoSplats { line: vertex.line });
    }
    let available = (bytes.len() - header.bytes) as u64;
    // A row has at least one byte, so a truncated file cannot explain a larger count.
    if let Some(absurd) = header.elements.iter().find(|e| e.count > available && !e.properties.is_empty()) {
        return Err(SceneError::AbsurdCount {
            element: absurd.name.clone(),
            promised: absurd.count,
            available,
            line: absurd.line,
        });
    }
    if u32::try_from(vertex.count).is_err() {
        return Err(SceneError::TooMany { count: vertex.count });
    }
    let file = File { bytes, header: &header, layout: &layout, progress };
    let (columns, gathered, elements, end) = match header.encoding {
        Encoding::Ascii => file.ascii()?,
        Encoding::LittleEndian => file.binary::<false>()?,
        Encoding::BigEndian => file.binary::<true>()?,
    };
    let size_breakdown = SizeBreakdown {
        format: format!("ply, {}", header.encoding.name()),
        file_bytes: bytes.len() as u64,
        header_bytes: header.bytes as u64,
        elements,
        trailing_bytes: (bytes.len() - end) as u64,
    };
    let scene = Scene::new(columns, gathered, Some(size_breakdown));
    if scene.count() == 0 {
        let reasons = scene.dropped().to_string();
        return Err(SceneError::AllDropped { count: vertex.count, reasons });
    }
    Ok(scene)
}

/// A file with a parsed header.
struct File<'a> {
    bytes: &'a [u8],
    header: &'a Header,
    layout: &'a Layout,
    progress: Progress<'a>,
}

/// The splats, their statistics, the sizes of the elements, and the byte after the last row.
type Body = (Columns, Gathered, Vec<ElementSize>, usize);

impl File<'_> {
    fn binary<const BIG: bool>(&self) -> Result<Body, SceneError> {
        let mut body = None;
        let mut elements = Vec::new();
        let mut at = self.header.bytes;
        for element in &self.header.elements {
            let rest = &self.bytes[at..];
            let is_vertex = element.name == "vertex";
            let sizes = binary::measure(rest, element, BIG).map_err(|there| truncated(element, there))?;
            let total = sizes.iter().sum::<u64>();
            if is_vertex {
                body = Some(self.binary_splats::<BIG>(&rest[..total as usize], element.count as usize)?);
            }
            elements.push(self.element_size(element, &sizes, total));
            at += total as usize;
        }
        let (columns, gathered) = body.expect("the caller found `vertex` among the elements");
        Ok((columns, gathered, elements, at))
    }

    fn binary_splats<const BIG: bool>(
        &self,
        rows: &[u8],
        count: usize,
    ) -> Result<(Columns, Gathered), SceneError> {
        let layout = self.layout;
        let stride = layout.stride;
        let done = Done::new(rows.len() as u64, self.progress);
        let mut columns = Columns::zeroed(count, layout.degree);
        let gathered = columns.fill(|out: &mut Rows| {
            let rows = &rows[out.first() * stride..][..out.len() * stride];
            for (index, row) in rows.chunks_exact(stride).enumerate() {
                let (splat, norm) = layout.splat(|slot| {
                    let slot = layout.slots[slot];
                    binary::value::<BIG>(&row[slot.offset..], slot.scalar)
                });
                out.set(index, &splat, norm);
            }
            done.add(rows.len() as u64);
            Ok::<_, SceneError>(())
        })?;
        Ok((columns, gathered))
    }

    fn ascii(&self) -> Result<Body, SceneError> {
        let mut body = None;
        let mut elements = Vec::new();
        let mut lines = ascii::Lines::new(self.bytes, self.header.bytes, u64::from(self.header.lines));
        for element in &self.header.elements {
            let start = lines.at;
            let is_vertex = element.name == "vertex";
            let sizes = if is_vertex {
                let (columns, gathered, sizes) = self.ascii_splats(&mut lines, element)?;
                body = Some((columns, gathered));
                sizes
            } else {
                ascii::skip(&mut lines, element)?
            };
            elements.push(self.element_size(element, &sizes, (lines.at - start) as u64));
        }
        let (columns, gathered) = body.expect("the caller found `vertex` among the elements");
        Ok((columns, gathered, elements, lines.at))
    }

    /// Reads the splats and advances `lines` past the last.
    fn ascii_splats(
        &self,
        lines: &mut ascii::Lines,
        vertex: &Element,
    ) -> Result<(Columns, Gathered, Vec<u64>), SceneError> {
        let start = lines.at;
        let mut chunks = Vec::with_capacity(vertex.count as usize / CHUNK + 1);
        // A value and a blank for each column: a shorter line cannot be a row. Checked before the allocation.
        let least = 2 * vertex.properties.len() - 1;
        for row in 0..vertex.count {
            if row % CHUNK as u64 == 0 {
                chunks.push(*lines);
            }
            let text = lines.next_row().ok_or_else(|| truncated(vertex, row))?;
            if text.len() < least {
                return Err(self.short_row(text, lines, vertex, row));
            }
        }
        let done = Done::new((lines.at - start) as u64, self.progress);
        let sizes = Mutex::new(vec![0; vertex.properties.len()]);
        let mut columns = Columns::zeroed(vertex.count as usize, self.layout.degree);
        let gathered = columns.fill(|out: &mut Rows| {
            let mut lines = chunks[out.first() / CHUNK];
            let start = lines.at;
            let mut slots = [0.0; MAX_SLOTS];
            let mut chunk_sizes = vec![0; vertex.properties.len()];
            for index in 0..out.len() {
                let row = (out.first() + index) as u64;
                let text = lines.next_row().ok_or_else(|| truncated(vertex, row))?;
                let found =
                    ascii::row(text, lines.number, self.layout, vertex, &mut slots, &mut chunk_sizes)?;
                if found < vertex.properties.len() {
                    return Err(self.short_row(text, &lines, vertex, row));
                }
                let (splat, norm) = self.layout.splat(|slot| slots[slot]);
                out.set(index, &splat, norm);
            }
            let mut sizes = sizes.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            sizes.iter_mut().zip(&chunk_sizes).for_each(|(sum, size)| *sum += size);
            drop(sizes);
            done.add((lines.at - start) as u64);
            Ok(())
        })?;
        let sizes = sizes.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
        Ok((columns, gathered, sizes))
    }

    /// Makes the error for the latest row of `lines`, which has too few values.
    fn short_row(&self, text: &[u8], lines: &ascii::Lines, vertex: &Element, row: u64) -> SceneError {
        if lines.at == self.bytes.len() && !self.bytes.ends_with(b"\n") {
            return truncated(vertex, row);
        }
        let (expected, found) = (vertex.properties.len(), ascii::words(text).count());
        SceneError::Row { line: lines.number, message: format!("expected {expected} values, found {found}") }
    }

    /// Accounts for an element. `sizes` has the bytes of each property in all rows; `bytes` includes separators.
    fn element_size(&self, element: &Element, sizes: &[u64], bytes: u64) -> ElementSize {
        let is_vertex = element.name == "vertex";
        let columns = element.properties.iter().zip(sizes).enumerate();
        let field = |(column, (property, bytes)): (usize, (&Property, &u64))| {
            let per_row = bytes.checked_div(element.count);
            FieldSize {
                name: property.name.clone(),
                kind: property.kind.name(),
                bytes_per_row: per_row.filter(|size| size * element.count == *bytes),
                bytes: *bytes,
                used: is_vertex && self.layout.slot_of[column].is_some(),
            }
        };
        ElementSize {
            name: element.name.clone(),
            rows: element.count,
            bytes,
            fields: columns.map(field).collect(),
            separator_bytes: bytes - sizes.iter().sum::<u64>(),
        }
    }
}

/// Makes the error for an element of which only `there` rows are in the file.
fn truncated(element: &Element, there: u64) -> SceneError {
    let (promised, line) = (element.count, element.line);
    if element.name == "vertex" {
        SceneError::Truncated { there, promised, line }
    } else {
        SceneError::TruncatedElement { element: element.name.clone(), there, promised, line }
    }
}

/// Sums the progress of parallel chunks.
struct Done<'a> {
    done: AtomicU64,
    of: u64,
    tell: Progress<'a>,
}

impl<'a> Done<'a> {
    fn new(of: u64, tell: Progress<'a>) -> Self {
        tell(0, of);
        Self { done: AtomicU64::new(0), of, tell }
    }

    fn add(&self, bytes: u64) {
        (self.tell)(self.done.fetch_add(bytes, Ordering::Relaxed) + bytes, self.of);
    }
}
