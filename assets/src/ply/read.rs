//! Reads a PLY file: parses the header, then converts the rows in parallel.
//!
//! The file is read in pieces ([`crate::input`]), so that at most one piece per thread is in memory. Binary rows have a
//! fixed length, so every chunk of splats is read and converted into the scene's arrays independently. ASCII rows vary
//! in length, so a first pass finds the start of each chunk.

use super::header::{Element, Encoding, HEADER_LIMIT, Header};
use super::layout::{self, Layout};
use super::origin::Sample;
use super::packed::Packed;
use super::{ascii, binary};
use crate::error::{self, SceneError};
use crate::input::{self, Done, Filled, Input, SceneHeader, Source};
use crate::scene::{Rows, Scene};
use crate::size_breakdown::{ElementSize, SizeBreakdown};
use crate::words::CHUNK;
use std::sync::atomic::{AtomicU64, Ordering};

enum Stored {
    /// A property per value: the reference layout.
    Plain(Layout),
    /// PlayCanvas's compressed layout.
    Packed(Packed),
}

/// Reads the header, finds the splats' properties and further ones, and checks the number of rows. Also returns the
/// number of splats.
fn header(source: &Source, properties: &[String]) -> Result<(Header, Stored, u64), SceneError> {
    // One byte more than the limit, to distinguish a header that is too long from one that is cut off.
    let header = Header::parse(&source.head(HEADER_LIMIT + 1)?)?;
    let vertex = header.vertex()?;
    layout::check(&header)?;
    let packed = vertex.properties.iter().any(|property| property.name == "packed_position");
    let stored = match packed {
        true => Stored::Packed(Packed::find(&header)?),
        false => Stored::Plain(Layout::find(vertex, properties)?),
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
    SceneError::check_count(count)?;
    Ok((header, stored, count))
}

pub(crate) fn scene_header(source: &Source) -> Result<SceneHeader, SceneError> {
    let (_, stored, count) = header(source, &[])?;
    let stored_degree = match stored {
        Stored::Plain(layout) => layout.harmonics.degree,
        Stored::Packed(packed) => packed.harmonics.degree,
    };
    Ok(SceneHeader { count, stored_degree })
}

pub(crate) fn parse(input: &Input) -> Result<Scene, SceneError> {
    let (header, stored, count) = header(input.source, input.properties)?;
    let layout = match stored {
        Stored::Plain(layout) => layout,
        Stored::Packed(packed) => return packed.parse(input, &header),
    };
    let file = File { input, header: &header, layout: &layout };
    let Body { filled, origin, elements } = match header.encoding {
        Encoding::Ascii => file.ascii()?,
        Encoding::LittleEndian => file.binary::<false>()?,
        Encoding::BigEndian => file.binary::<true>()?,
    };
    let length = input.source.length();
    let format = format!("ply, {}", header.encoding.name());
    let size_breakdown = SizeBreakdown::new(format, length, header.bytes as u64, elements)
        .with_comments(header.comment_texts());
    let scene = input::finish(filled, count, size_breakdown, layout.notes(header.notes))?.with_offset(origin);
    Ok(scene.with_header_comments(header.kept_comments()))
}

struct File<'a> {
    input: &'a Input<'a>,
    header: &'a Header,
    layout: &'a Layout,
}

struct Body {
    filled: Filled,
    origin: [f64; 3],
    elements: Vec<ElementSize>,
}

impl File<'_> {
    fn uses(&self, element: &Element, column: usize) -> bool {
        element.name == "vertex" && self.layout.slot_of[column].is_some()
    }

    fn binary<const BIG: bool>(&self) -> Result<Body, SceneError> {
        let Self { input, header, layout } = *self;
        let used = |element: &Element, column| self.uses(element, column);
        let (elements, tables) = binary::elements(input.source, header, BIG, used)?;
        let (table, count) = (tables["vertex"], header.vertex()?.count);
        let wide = layout.wide();
        let is_wide = wide.contains(&true);
        let coordinate = |row: &[u8], axis: usize| {
            let place = layout.slots[axis];
            place.scalar.wide::<BIG>(&row[place.offset..])
        };
        let mut origin = [0.0; 3];
        if is_wide {
            let (mut sample, mut row) = (Sample::new(wide, count), vec![0; table.stride]);
            for index in (0..count).step_by(sample.every as usize) {
                table.read(index as usize, 1, &mut row)?;
                sample.add([0, 1, 2].map(|axis| coordinate(&row, axis)));
            }
            origin = sample.origin();
        }
        let done = Done::new(count * layout.stride as u64, input.progress)?;
        let (names, further) = &layout.properties;
        let filled = input.fill_with(
            names,
            (count, layout.harmonics.degree, is_wide),
            [table],
            0,
            &done,
            |[row], _, out| {
                let position = |axis: usize| coordinate(row, axis) - origin[axis];
                let value = |slot: usize| {
                    let place = layout.slots[slot];
                    place.scalar.value::<BIG>(&row[place.offset..])
                };
                let (splat, norm) = layout.splat(|slot| match wide.get(slot) {
                    Some(true) => position(slot) as f32,
                    _ => value(slot),
                });
                out.set_properties(|name| value(further[name]));
                if is_wide {
                    out.push_wide(&splat, std::array::from_fn(position), norm);
                } else {
                    out.push(&splat, norm);
                }
            },
        )?;
        Ok(Body { filled, origin, elements })
    }

    fn ascii(&self) -> Result<Body, SceneError> {
        let Self { input, header, .. } = *self;
        let (mut splats, mut elements) = (None, Vec::new());
        let start = ascii::Place { at: header.bytes as u64, number: u64::from(header.lines) };
        let mut lines = ascii::Lines::new(input.source, start);
        for element in &header.elements {
            let start = lines.place().at;
            let sizes = if element.name == "vertex" {
                let (filled, origin, sizes) = self.ascii_splats(&mut lines, element)?;
                splats = Some((filled, origin));
                sizes
            } else {
                ascii::skip(&mut lines, element)?
            };
            let bytes = lines.place().at - start;
            elements.push(element.size(header.encoding, &sizes, bytes, |column| self.uses(element, column)));
        }
        let (filled, origin) = splats.expect("the caller found `vertex` among the elements");
        Ok(Body { filled, origin, elements })
    }

    /// Reads the splats, and advances `lines` past the last. Also returns the origin of their positions, and the bytes
    /// of each column's words.
    fn ascii_splats(
        &self,
        lines: &mut ascii::Lines,
        vertex: &Element,
    ) -> Result<(Filled, [f64; 3], Vec<u64>), SceneError> {
        let Self { input, layout, .. } = *self;
        let start = lines.place().at;
        let is_wide = layout.wide().contains(&true);
        let mut sample = is_wide.then(|| Sample::new(layout.wide(), vertex.count));
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
                // A word that is not a number is reported below, with its line.
                let coordinate = |axis: usize| ascii::wide(&line, layout.slots[axis].column);
                sample.add([0, 1, 2].map(|axis| coordinate(axis).unwrap_or(f64::NAN)));
            }
        }
        let origin = sample.map_or([0.0; 3], Sample::origin);
        let (names, further) = &layout.properties;
        let columns = input.allocate(vertex.count, layout.harmonics.degree, is_wide, (0, 0))?;
        let mut columns = columns.with_properties(names)?;
        let done = Done::new(lines.place().at - start, input.progress)?;
        let sizes: Vec<AtomicU64> = vertex.properties.iter().map(|_| AtomicU64::new(0)).collect();
        let gathered = columns.fill(|out: &mut Rows| {
            done.check()?;
            let place = chunks[out.first() / CHUNK];
            let mut lines = ascii::Lines::new(input.source, place);
            let mut slots = vec![0.0; layout.slots.len()];
            let mut chunk_sizes = vec![0; vertex.properties.len()];
            for index in 0..out.len() {
                let row = (out.first() + index) as u64;
                let line = lines.next_row()?.ok_or_else(|| vertex.truncated(row))?;
                let mut position = [0.0; 3];
                let values = (&mut slots[..], &mut position);
                let found = ascii::row(&line, layout, vertex, origin, values, &mut chunk_sizes)?;
                if found < vertex.properties.len() {
                    return Err(short_row(&line, vertex, row));
                }
                let (splat, norm) = layout.splat(|slot| slots[slot]);
                out.set_properties(|name| match further[name] {
                    axis @ 0..3 => (position[axis] + origin[axis]) as f32,
                    slot => slots[slot],
                });
                out.push_wide(&splat, position, norm);
            }
            for (sum, size) in sizes.iter().zip(chunk_sizes) {
                sum.fetch_add(size, Ordering::Relaxed);
            }
            done.add(lines.place().at - place.at)
        })?;
        Ok(((columns, gathered), origin, sizes.into_iter().map(AtomicU64::into_inner).collect()))
    }
}

fn short_row(line: &ascii::Line, vertex: &Element, row: u64) -> SceneError {
    if line.cut {
        return vertex.truncated(row);
    }
    let (expected, found) = (vertex.properties.len(), ascii::words(line.text).count());
    error::row(line.number, format!("expected {expected} values, found {found}"))
}
