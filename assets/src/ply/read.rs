//! Reads a scene file: parses the header, then converts the rows in parallel.
//!
//! The file is read in pieces ([`super::source`]), so that no more of it is in memory than a piece per thread. Binary rows have
//! a fixed length, so every chunk of splats is read and converted into the scene's arrays independently. ASCII rows differ in
//! length, so a first pass finds the start of each chunk.
//!
//! What the header promises is held against the file's length and against the memory that there is before anything is
//! allocated. A file that was written to meanwhile is an error, never a scene that is half of one and half of another.

use super::header::{Element, Encoding, HEADER_LIMIT, Header, Property, begins_as_ply};
use super::layout::{Layout, MAX_SLOTS};
use super::origin::Sample;
use super::source::{Buffers, OpenFile, Source};
use super::{ascii, binary};
use crate::error::{LoadError, SceneError};
use crate::memory::{self, SceneMemoryError};
use crate::recognise;
use crate::scene::{CHUNK, Columns, Gathered, Rows, Scene};
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes of binary rows that a thread reads at a time, or one row if that is longer.
const PIECE: usize = 1 << 20;

/// A callback for the progress of a load: bytes of splats converted, and bytes in all.
///
/// Several threads call it, so the first number does not always ascend.
pub type Progress<'a> = &'a (dyn Fn(u64, u64) + Sync);

/// The promises of a scene file's header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneHeader {
    /// Number of splats, of which some may not be drawable.
    pub count: u64,
    /// Degree of the stored spherical harmonics.
    pub stored_degree: u32,
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
            let (_, layout, count) = header(&Source::File(&file), Some(path))?;
            Ok(Self { count, stored_degree: layout.degree })
        };
        inner().map_err(|problem| LoadError { path: path.to_owned(), problem })
    }
}

impl Scene {
    /// Loads a scene file.
    ///
    /// # Errors
    /// The file cannot be read, is not a PLY file in the reference layout, is damaged, does not fit in memory, or was written
    /// to meanwhile. See [`SceneError`].
    pub fn load(path: impl AsRef<Path>, progress: Progress) -> Result<Self, LoadError> {
        let path = path.as_ref();
        let inner = || {
            let file = OpenFile::open(path)?;
            let parsed = parse(&Source::File(&file), Some(path), memory::available(), progress);
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
        parse(&Source::Bytes(bytes), None, memory::available(), progress)
    }
}

/// Reads the header, finds the splats' properties in it, and checks the number of rows; returns the number of splats as well.
fn header(source: &Source, path: Option<&Path>) -> Result<(Header, Layout, u64), SceneError> {
    if source.length() == 0 {
        return Err(SceneError::Empty);
    }
    // One byte more than a header has, to tell one that is too long from one that is cut off.
    let head = source.head(HEADER_LIMIT + 1)?;
    if !begins_as_ply(&head) {
        return Err(recognise::not_ply(path, &head, source.length()));
    }
    let header = Header::parse(&head)?;
    let vertex = header.vertex()?;
    let layout = Layout::find(vertex)?;
    let count = vertex.count;
    if count == 0 {
        return Err(SceneError::NoSplats { line: vertex.line });
    }
    let available = source.length() - header.bytes as u64;
    // A row has at least one byte, so a truncated file cannot explain a larger count.
    if let Some(absurd) = header.elements.iter().find(|e| e.count > available && !e.properties.is_empty()) {
        return Err(SceneError::AbsurdCount {
            element: absurd.name.clone(),
            promised: absurd.count,
            available,
            line: absurd.line,
        });
    }
    if u32::try_from(count).is_err() {
        return Err(SceneError::TooMany { count });
    }
    Ok((header, layout, count))
}

/// Parses a scene; `path` helps to identify a file of another format. No more than `memory` bytes can be taken, if that is known.
pub(super) fn parse(
    source: &Source,
    path: Option<&Path>,
    memory: Option<u64>,
    progress: Progress,
) -> Result<Scene, SceneError> {
    let (header, layout, count) = header(source, path)?;
    let file = File { source, header: &header, layout: &layout, memory, progress };
    let (Splats { columns, gathered, origin }, elements, end) = match header.encoding {
        Encoding::Ascii => file.ascii()?,
        Encoding::LittleEndian => file.binary::<false>()?,
        Encoding::BigEndian => file.binary::<true>()?,
    };
    let size_breakdown = SizeBreakdown {
        format: format!("ply, {}", header.encoding.name()),
        file_bytes: source.length(),
        header_bytes: header.bytes as u64,
        elements,
        trailing_bytes: source.length() - end,
    };
    let scene = Scene::new(columns, gathered, Some(size_breakdown)).with_offset(origin);
    if scene.count() == 0 {
        let reasons = scene.dropped().to_string();
        return Err(SceneError::AllDropped { count, reasons });
    }
    Ok(scene)
}

/// A file with a parsed header.
struct File<'a> {
    source: &'a Source<'a>,
    header: &'a Header,
    layout: &'a Layout,
    memory: Option<u64>,
    progress: Progress<'a>,
}

/// The splats, their statistics, and the place in the file's coordinates that theirs are relative to.
struct Splats {
    columns: Columns,
    gathered: Gathered,
    origin: [f64; 3],
}

/// The splats, the sizes of the elements, and the offset of the byte after the last row.
type Body = (Splats, Vec<ElementSize>, u64);

impl File<'_> {
    /// Allocates the arrays, unless they, with a buffer per thread, are more than the memory that there is.
    fn allocate(&self, count: u64) -> Result<Columns, SceneError> {
        let degree = self.layout.degree;
        let buffers = rayon::current_num_threads() * PIECE.max(self.layout.stride);
        let wide = self.layout.wide().contains(&true);
        let low = if wide { count.saturating_mul(Columns::LOW_BYTES) } else { 0 };
        let needed = Scene::host_bytes(count, degree).saturating_add(low).saturating_add(buffers as u64);
        SceneMemoryError::check_against(count, degree, needed, self.memory)?;
        let mut columns = Columns::zeroed(count as usize, degree)?;
        if wide {
            columns.widen()?;
        }
        Ok(columns)
    }

    fn binary<const BIG: bool>(&self) -> Result<Body, SceneError> {
        let mut body = None;
        let mut elements = Vec::new();
        let mut at = self.header.bytes as u64;
        for element in &self.header.elements {
            let sizes = binary::measure(self.source, at, element, BIG)?;
            let sizes = sizes.map_err(|there| truncated(element, there))?;
            let total = sizes.iter().sum::<u64>();
            if element.name == "vertex" {
                body = Some(self.binary_splats::<BIG>(at, element.count)?);
            }
            elements.push(self.element_size(element, &sizes, total));
            at += total;
        }
        let splats = body.expect("the caller found `vertex` among the elements");
        Ok((splats, elements, at))
    }

    fn binary_splats<const BIG: bool>(&self, start: u64, count: u64) -> Result<Splats, SceneError> {
        let layout = self.layout;
        let stride = layout.stride;
        let origin = self.binary_origin::<BIG>(start, count)?;
        let mut columns = self.allocate(count)?;
        let wide = self.layout.wide();
        let done = Done::new(count * stride as u64, self.progress);
        let buffers = Buffers::default();
        let rows_at_once = (PIECE / stride).max(1);
        let gathered = columns.fill(|out: &mut Rows| {
            buffers.with(rows_at_once.min(out.len()) * stride, |buffer| {
                for first in (0..out.len()).step_by(rows_at_once) {
                    let count = rows_at_once.min(out.len() - first);
                    let rows = &mut buffer[..count * stride];
                    self.source.read(start + ((out.first() + first) * stride) as u64, rows)?;
                    for row in rows.chunks_exact(stride) {
                        let position = |axis: usize| {
                            let place = layout.slots[axis];
                            binary::wide::<BIG>(&row[place.offset..], place.scalar) - origin[axis]
                        };
                        let (splat, norm) = layout.splat(|slot| match wide.get(slot) {
                            Some(true) => position(slot) as f32,
                            _ => {
                                let place = layout.slots[slot];
                                binary::value::<BIG>(&row[place.offset..], place.scalar)
                            }
                        });
                        if wide.contains(&true) {
                            out.push_wide(&splat, std::array::from_fn(position), norm);
                        } else {
                            out.push(&splat, norm);
                        }
                    }
                    done.add(rows.len() as u64);
                }
                Ok(())
            })
        })?;
        Ok(Splats { columns, gathered, origin })
    }

    /// Chooses the origin from rows that begin at offset `start`.
    fn binary_origin<const BIG: bool>(&self, start: u64, count: u64) -> Result<[f64; 3], SceneError> {
        let Some(mut sample) = Sample::of(self.layout, count) else { return Ok([0.0; 3]) };
        let mut bytes = [0; 8];
        for row in (0..count).step_by(sample.every as usize) {
            for (axis, slot) in self.layout.slots[..3].iter().enumerate() {
                let bytes = &mut bytes[..slot.scalar.size()];
                self.source.read(start + row * self.layout.stride as u64 + slot.offset as u64, bytes)?;
                sample.add(axis, binary::wide::<BIG>(bytes, slot.scalar));
            }
        }
        Ok(sample.origin())
    }

    fn ascii(&self) -> Result<Body, SceneError> {
        let mut body = None;
        let mut elements = Vec::new();
        let start = ascii::Place { at: self.header.bytes as u64, number: u64::from(self.header.lines) };
        let mut lines = ascii::Lines::new(self.source, start);
        for element in &self.header.elements {
            let start = lines.place().at;
            let sizes = if element.name == "vertex" {
                let (splats, sizes) = self.ascii_splats(&mut lines, element)?;
                body = Some(splats);
                sizes
            } else {
                ascii::skip(&mut lines, element)?
            };
            elements.push(self.element_size(element, &sizes, lines.place().at - start));
        }
        let splats = body.expect("the caller found `vertex` among the elements");
        Ok((splats, elements, lines.place().at))
    }

    /// Reads the splats and advances `lines` past the last.
    fn ascii_splats(
        &self,
        lines: &mut ascii::Lines,
        vertex: &Element,
    ) -> Result<(Splats, Vec<u64>), SceneError> {
        let start = lines.place().at;
        let mut sample = Sample::of(self.layout, vertex.count);
        let mut chunks = Vec::new();
        chunks.try_reserve_exact(vertex.count as usize / CHUNK + 1).map_err(std::io::Error::from)?;
        // A value and a blank for each column: a shorter line cannot be a row. Checked before the allocation.
        let least = 2 * vertex.properties.len() - 1;
        for row in 0..vertex.count {
            if row % CHUNK as u64 == 0 {
                chunks.push(lines.place());
            }
            let line = lines.next_row()?.ok_or_else(|| truncated(vertex, row))?;
            if line.text.len() < least {
                return Err(short_row(&line, vertex, row));
            }
            if let Some(sample) = sample.as_mut().filter(|sample| row % sample.every == 0) {
                for (axis, slot) in self.layout.slots[..3].iter().enumerate() {
                    // A word that is no number is an error below, with its line.
                    sample.add(axis, ascii::wide(&line, slot.column).unwrap_or(f64::NAN));
                }
            }
        }
        let origin = sample.map_or([0.0; 3], Sample::origin);
        let mut columns = self.allocate(vertex.count)?;
        let done = Done::new(lines.place().at - start, self.progress);
        let sizes = Mutex::new(vec![0; vertex.properties.len()]);
        let gathered = columns.fill(|out: &mut Rows| {
            let place = chunks[out.first() / CHUNK];
            let mut lines = ascii::Lines::new(self.source, place);
            let mut slots = [0.0; MAX_SLOTS];
            let wide = self.layout.wide().contains(&true);
            let mut chunk_sizes = vec![0; vertex.properties.len()];
            for index in 0..out.len() {
                let row = (out.first() + index) as u64;
                let line = lines.next_row()?.ok_or_else(|| truncated(vertex, row))?;
                let mut position = [0.0; 3];
                let values = (&mut slots[..], &mut position);
                let found = ascii::row(&line, self.layout, vertex, origin, values, &mut chunk_sizes)?;
                if found < vertex.properties.len() {
                    return Err(short_row(&line, vertex, row));
                }
                let (splat, norm) = self.layout.splat(|slot| slots[slot]);
                if wide {
                    out.push_wide(&splat, position, norm);
                } else {
                    out.push(&splat, norm);
                }
            }
            let mut sizes = sizes.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            sizes.iter_mut().zip(&chunk_sizes).for_each(|(sum, size)| *sum += size);
            drop(sizes);
            done.add(lines.place().at - place.at);
            Ok(())
        })?;
        let sizes = sizes.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
        Ok((Splats { columns, gathered, origin }, sizes))
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

/// Makes the error for a row that has too few values.
fn short_row(line: &ascii::Line, vertex: &Element, row: u64) -> SceneError {
    if line.cut {
        return truncated(vertex, row);
    }
    let (expected, found) = (vertex.properties.len(), ascii::words(line.text).count());
    SceneError::Row { line: line.number, message: format!("expected {expected} values, found {found}") }
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
