//! Reads a PLY file: parses the header, then converts the rows in parallel.
//!
//! The file is read in pieces ([`crate::input`]), so that at most one piece per thread is in memory. Binary rows have a
//! fixed length, so every chunk of splats is read and converted into the scene's arrays independently. ASCII rows vary
//! in length, so a first pass finds the start of each chunk.

use super::header::{Element, Encoding, HEADER_LIMIT, Header};
use super::layout::{Layout, MAX_SLOTS};
use super::origin::Sample;
use super::packed::Packed;
use super::{ascii, binary};
use crate::error::SceneError;
use crate::input::{self, Done, Input, SceneHeader, Source, Table};
use crate::scene::{Columns, Gathered, Rows, Scene};
use crate::size_breakdown::{ElementSize, SizeBreakdown};
use crate::words::CHUNK;
use std::sync::Mutex;

enum Stored {
    /// A property per value: the reference layout.
    Plain(Layout),
    /// PlayCanvas's compressed layout.
    Packed(Packed),
}

/// Reads the header, finds the splats' properties, and checks the number of rows. Also returns the number of splats.
fn header(source: &Source) -> Result<(Header, Stored, u64), SceneError> {
    // One byte more than the limit, to distinguish a header that is too long from one that is cut off.
    let header = Header::parse(&source.head(HEADER_LIMIT + 1)?)?;
    let vertex = header.vertex()?;
    let packed = vertex.properties.iter().any(|property| property.name == "packed_position");
    let stored = match packed {
        true => Stored::Packed(Packed::find(&header)?),
        false => Stored::Plain(Layout::find(vertex)?),
    };
    let count = vertex.count;
    if count == 0 {
        let line = vertex.line;
        let text = format!("expected at least one splat, found `element vertex 0` (line {line})");
        return Err(SceneError::Invalid(text));
    }
    let available = source.length() - header.bytes as u64;
    // A row has at least one byte. A count above `available` is reported as damage, although the file may be truncated.
    if let Some(absurd) = header.elements.iter().find(|e| e.count > available && !e.properties.is_empty()) {
        let Element { name, count, line, .. } = absurd;
        return Err(SceneError::Invalid(format!(
            "the header is damaged: `element {name}` (line {line}) declares {count} rows, but only {available} bytes follow the header"
        )));
    }
    if u32::try_from(count).is_err() {
        return Err(SceneError::TooMany { count });
    }
    Ok((header, stored, count))
}

pub(crate) fn scene_header(source: &Source) -> Result<SceneHeader, SceneError> {
    let (_, stored, count) = header(source)?;
    let stored_degree = match stored {
        Stored::Plain(layout) => layout.degree,
        Stored::Packed(packed) => packed.degree,
    };
    Ok(SceneHeader { count, stored_degree })
}

pub(crate) fn parse(input: &Input) -> Result<Scene, SceneError> {
    let (header, stored, count) = header(input.source)?;
    let layout = match stored {
        Stored::Plain(layout) => layout,
        Stored::Packed(packed) => return packed.parse(input, &header),
    };
    let file = File { input, source: input.source, header: &header, layout: &layout };
    let (Splats { columns, gathered, origin }, elements) = match header.encoding {
        Encoding::Ascii => file.ascii()?,
        Encoding::LittleEndian => file.binary::<false>()?,
        Encoding::BigEndian => file.binary::<true>()?,
    };
    let length = input.source.length();
    let format = format!("ply, {}", header.encoding.name());
    let size_breakdown = SizeBreakdown::new(format, length, header.bytes as u64, elements);
    let scene = input::finish((columns, gathered), count, size_breakdown, header.notes)?;
    Ok(scene.with_offset(origin))
}

struct File<'a> {
    input: &'a Input<'a>,
    source: &'a Source<'a>,
    header: &'a Header,
    layout: &'a Layout,
}

struct Splats {
    columns: Columns,
    gathered: Gathered,
    origin: [f64; 3],
}

/// The splats, and the sizes of the elements.
type Body = (Splats, Vec<ElementSize>);

impl File<'_> {
    fn allocate(&self, count: u64) -> Result<Columns, SceneError> {
        let layout = self.layout;
        self.input.allocate(count, layout.degree, layout.wide().contains(&true), (layout.stride, 0))
    }

    fn uses(&self, element: &Element, column: usize) -> bool {
        element.name == "vertex" && self.layout.slot_of[column].is_some()
    }

    fn binary<const BIG: bool>(&self) -> Result<Body, SceneError> {
        let mut body = None;
        let mut elements = Vec::new();
        let mut at = self.header.bytes as u64;
        for element in &self.header.elements {
            let sizes = binary::measure(self.source, at, element, BIG)?;
            let sizes = sizes.map_err(|there| element.truncated(there))?;
            let total = sizes.iter().sum::<u64>();
            if element.name == "vertex" {
                body = Some(self.binary_splats::<BIG>(at, element.count)?);
            }
            let used = |column| self.uses(element, column);
            elements.push(element.size(self.header.encoding, &sizes, total, used));
            at += total;
        }
        let splats = body.expect("the caller found `vertex` among the elements");
        Ok((splats, elements))
    }

    fn binary_splats<const BIG: bool>(&self, start: u64, count: u64) -> Result<Splats, SceneError> {
        let layout = self.layout;
        let stride = layout.stride;
        let origin = self.binary_origin::<BIG>(start, count)?;
        let wide = layout.wide();
        let mut columns = self.allocate(count)?;
        let done = Done::new(count * stride as u64, self.input.progress)?;
        let table = [Table { start, stride }];
        let gathered = input::fill(self.source, table, &mut columns, &done, |[row], _, out| {
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
        })?;
        Ok(Splats { columns, gathered, origin })
    }

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
            let bytes = lines.place().at - start;
            let used = |column| self.uses(element, column);
            elements.push(element.size(self.header.encoding, &sizes, bytes, used));
        }
        let splats = body.expect("the caller found `vertex` among the elements");
        Ok((splats, elements))
    }

    /// Reads the splats, and advances `lines` past the last. Also returns the bytes of each column's words.
    fn ascii_splats(
        &self,
        lines: &mut ascii::Lines,
        vertex: &Element,
    ) -> Result<(Splats, Vec<u64>), SceneError> {
        let start = lines.place().at;
        let mut sample = Sample::of(self.layout, vertex.count);
        let mut chunks = Vec::new();
        chunks.try_reserve_exact(vertex.count as usize / CHUNK + 1).map_err(std::io::Error::from)?;
        // A row has at least one digit per column, and blanks between them. A shorter line fails before the allocation.
        let least = 2 * vertex.properties.len() - 1;
        for row in 0..vertex.count {
            if row % CHUNK as u64 == 0 {
                chunks.push(lines.place());
            }
            let line = lines.next_row()?.ok_or_else(|| vertex.truncated(row))?;
            if line.text.len() < least {
                return Err(short_row(&line, vertex, row));
            }
            if let Some(sample) = sample.as_mut().filter(|sample| row % sample.every == 0) {
                for (axis, slot) in self.layout.slots[..3].iter().enumerate() {
                    // A word that is not a number is reported below, with its line.
                    sample.add(axis, ascii::wide(&line, slot.column).unwrap_or(f64::NAN));
                }
            }
        }
        let origin = sample.map_or([0.0; 3], Sample::origin);
        let mut columns = self.allocate(vertex.count)?;
        let done = Done::new(lines.place().at - start, self.input.progress)?;
        let sizes = Mutex::new(vec![0; vertex.properties.len()]);
        let gathered = columns.fill(|out: &mut Rows| {
            let place = chunks[out.first() / CHUNK];
            let mut lines = ascii::Lines::new(self.source, place);
            let mut slots = [0.0; MAX_SLOTS];
            let wide = self.layout.wide().contains(&true);
            let mut chunk_sizes = vec![0; vertex.properties.len()];
            for index in 0..out.len() {
                let row = (out.first() + index) as u64;
                let line = lines.next_row()?.ok_or_else(|| vertex.truncated(row))?;
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
            done.add(lines.place().at - place.at)?;
            Ok(())
        })?;
        let sizes = sizes.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
        Ok((Splats { columns, gathered, origin }, sizes))
    }
}

fn short_row(line: &ascii::Line, vertex: &Element, row: u64) -> SceneError {
    if line.cut {
        return vertex.truncated(row);
    }
    let (expected, found) = (vertex.properties.len(), ascii::words(line.text).count());
    SceneError::Row { line: line.number, message: format!("expected {expected} values, found {found}") }
}
