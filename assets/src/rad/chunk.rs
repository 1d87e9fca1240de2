//! Finds the chunks of a file, and unpacks their arrays.

use super::column::{Column, MAX_PER_BYTE};
use super::document::{BANDS, CHUNK_MAGIC, ChunkDocument, Document, Name, Place, Property};
use crate::error::{SceneError, field};
use crate::input::{Done, Source, read_beside};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;

const REQUIRED: [Name; 5] = [Name::Center, Name::Alpha, Name::Rgb, Name::Scales, Name::Orientation];

pub(super) struct Chunk {
    index: usize,
    place: Place,
    /// Offset of the payload in the chunk's file.
    payload: u64,
    /// Index of the chunk's first splat among all splats of the file.
    pub first: u64,
    pub count: usize,
    properties: Vec<Property>,
    /// Bytes of all unpacked arrays that are read. A palette of unknown size counts with its maximum.
    pub unpacked_bytes: u64,
}

pub(super) struct Chunks {
    pub count: u64,
    pub chunks: Vec<Chunk>,
    pub degree: u32,
    /// Bytes of the file and its `.radc` files.
    pub file_bytes: u64,
    /// Bytes after the last chunk of each file, summed over the files.
    pub trailing_bytes: u64,
}

pub(super) struct Arrays {
    /// The arrays by [`Name`]. Of palettes, only those of the first chunk are used.
    columns: [Option<Column>; Name::COUNT],
    count: usize,
    /// Rows without children; `None` if the chunk has no `child_count`.
    leaves: Option<Vec<u32>>,
}

impl Place {
    /// Calls `read` with the chunk's own file ([`read_beside`]), or with `source` if the chunk is inside.
    fn open<T>(
        &self,
        source: &Source,
        folder: Option<&Path>,
        read: impl FnOnce(&Source) -> Result<T, SceneError>,
    ) -> Result<T, SceneError> {
        match &self.filename {
            Some(name) => read_beside(folder, name, |file, _| read(file)),
            None => read(source),
        }
    }
}

impl Chunks {
    pub(super) fn read(source: &Source, folder: Option<&Path>) -> Result<Self, SceneError> {
        let (document, chunks_start) = Document::read(source)?;
        if document.count == 0 || document.chunks.is_empty() {
            return Err(field(8, "count", "expected at least one splat, found none"));
        }
        let (mut first, mut degree, mut chunks) = (0, 0, Vec::<Chunk>::new());
        let alone = source.head(4)? == CHUNK_MAGIC;
        // For each file, the end of its last chunk so far, and its length.
        let mut ends = BTreeMap::from([(None, (chunks_start, source.length()))]);
        for (index, mut place) in document.chunks.into_iter().enumerate() {
            if place.filename.is_none() {
                place.offset = place.offset.saturating_add(chunks_start);
            }
            let end = ends.get(&place.filename).map_or(0, |(end, _)| *end);
            let chunk = place.open(source, folder, |file| {
                let length = file.length();
                let after = place.offset.checked_add(place.bytes).filter(|after| *after <= length);
                let Some(after) = after.filter(|_| place.offset >= end) else {
                    let text = format!(
                        "expected bytes from {end} to {length}, the end of the file, found {} at {}",
                        place.bytes, place.offset
                    );
                    return Err(field(8, format!("chunks[{index}]"), text));
                };
                ends.insert(place.filename.clone(), (after, length));
                let chunk = Chunk::read(file, index, place.clone(), document.sh_code_count)?;
                if chunk.first != first && !alone {
                    let text =
                        format!("expected {first}, the splats of the chunks before, found {}", chunk.first);
                    return Err(chunk.wrong("base", text));
                }
                if chunk.has(Name::ShLabel) && !chunks.first().unwrap_or(&chunk).has(Name::Sh1Code) {
                    let text = "expected the palette in the first chunk of a .rad, found labels alone";
                    return Err(chunk.wrong("sh_label", text));
                }
                Ok(chunk)
            })?;
            let chunk = Chunk { first, ..chunk };
            first += chunk.count as u64;
            degree = degree.max(chunk.degree());
            chunks.push(chunk);
        }
        if first != document.count {
            let text = format!("expected {first}, the sum over the chunks, found {}", document.count);
            return Err(field(8, "count", text));
        }
        SceneError::check_count(first)?;
        let file_bytes = ends.values().map(|(_, length)| length).sum();
        let trailing_bytes = ends.values().map(|(end, length)| length - end).sum();
        Ok(Self { count: first, chunks, degree, file_bytes, trailing_bytes })
    }

    /// Returns the packed bytes of each property, summed over the chunks, in the order of [`Name`].
    pub(super) fn sizes(&self) -> BTreeMap<Name, u64> {
        let mut sizes = BTreeMap::new();
        for property in self.chunks.iter().flat_map(|chunk| &chunk.properties) {
            *sizes.entry(property.name).or_default() += property.bytes;
        }
        sizes
    }
}

impl Chunk {
    fn wrong(&self, name: impl Display, message: impl Display) -> SceneError {
        field(self.place.offset + 8, format!("chunks[{}].{name}", self.index), message)
    }

    /// Reads the description of a chunk, and checks it against the chunk's bytes. `entries` is the number of entries of
    /// the palette, if known.
    fn read(file: &Source, index: usize, place: Place, entries: Option<u64>) -> Result<Self, SceneError> {
        let (document, end) = ChunkDocument::read(file, place.offset, place.bytes)?;
        let ChunkDocument { base: first, count, properties, .. } = document;
        let payload = end + 8;
        let mut chunk =
            Self { index, place, payload, first, count: count as usize, properties, unpacked_bytes: 0 };
        let left = (chunk.place.offset + chunk.place.bytes).checked_sub(payload);
        let left = left.ok_or_else(|| chunk.wrong("payload", "expected its length, found the end"))?;
        let mut bytes = [0; 8];
        file.read(end, &mut bytes)?;
        let payload_bytes = u64::from_le_bytes(bytes);
        if payload_bytes > left {
            let text = format!("expected at most {left}, the bytes that are left, found {payload_bytes}");
            return Err(field(end, format!("chunks[{index}].payload"), text));
        }
        if count == 0 || u32::try_from(count).is_err() {
            return Err(chunk.wrong("count", format!("expected 1 to 4,294,967,295, found {count}")));
        }
        let mut position = 0;
        for (number, property) in chunk.properties.iter().enumerate() {
            let wrong =
                |name: &str, text: String| chunk.wrong(format_args!("properties[{number}].{name}"), text);
            let after = property.offset.checked_add(property.bytes).filter(|after| *after <= payload_bytes);
            let Some(after) = after.filter(|_| property.offset >= position) else {
                let text = format!(
                    "expected bytes from {position} to {payload_bytes}, the payload's end, found {} at {}",
                    property.bytes, property.offset
                );
                return Err(wrong("offset", text));
            };
            position = after;
            if let Some(expected) = property.name.refusal(property.encoding) {
                let text = format!(
                    "expected {expected} for {}, found {:?}",
                    property.name.text(),
                    property.encoding
                );
                return Err(wrong("encoding", text));
            }
            let (min, max) = property.encoding.bounds();
            for (name, bound, needed) in [("min", property.min, min), ("max", property.max, max)] {
                if needed && !bound.is_some_and(f32::is_finite) {
                    return Err(wrong(name, "expected a number, found none".into()));
                }
            }
            if chunk.properties[..number].iter().any(|other| other.name == property.name) {
                return Err(wrong("property", format!("expected {} once", property.name.text())));
            }
            let rows = if property.name.is_code() { entries } else { Some(count) };
            let row = (property.name.width() * property.encoding.bytes()) as u64;
            let most = match property.compression {
                Some(_) => property.bytes.saturating_mul(MAX_PER_BYTE),
                None => property.bytes,
            };
            let needed = rows.map_or(most, |rows| rows.saturating_mul(row));
            if needed > most {
                let text = format!("expected at least {needed} unpacked bytes, found at most {most}");
                return Err(wrong("bytes", text));
            }
            if property.name != Name::ChildStart {
                chunk.unpacked_bytes = chunk.unpacked_bytes.saturating_add(needed);
            }
        }
        match REQUIRED.iter().find(|name| !chunk.has(**name)) {
            Some(name) => {
                Err(chunk.wrong("properties", format!("expected the property {}, found none", name.text())))
            }
            None => Ok(chunk),
        }
    }

    fn has(&self, name: Name) -> bool {
        self.properties.iter().any(|property| property.name == name)
    }

    /// Returns the number of bands that the chunk has without a gap, from band 1 on.
    fn degree(&self) -> u32 {
        BANDS.iter().take_while(|(own, code)| self.has(*own) || self.has(*code)).count() as u32
    }

    pub(super) fn unpack(
        &self,
        source: &Source,
        folder: Option<&Path>,
        done: &Done,
    ) -> Result<Arrays, SceneError> {
        self.place.open(source, folder, |file| {
            if file.length() < self.place.offset + self.place.bytes {
                return Err(SceneError::Changed);
            }
            self.arrays(file, done)
        })
    }

    fn arrays(&self, file: &Source, done: &Done) -> Result<Arrays, SceneError> {
        let (mut columns, mut left) = ([const { None }; Name::COUNT], self.unpacked_bytes);
        for (number, property) in self.properties.iter().enumerate() {
            if property.name == Name::ChildStart {
                continue;
            }
            done.check()?;
            let at = self.payload + property.offset;
            let packed = file.bytes(at, property.bytes as usize)?;
            let name = format!("chunks[{}].properties[{number}], {}", self.index, property.name.text());
            let rows = (!property.name.is_code()).then_some(self.count);
            let column = Column::unpack(property, rows, packed, (at, &name))?;
            done.add(column.bytes())?;
            left = left.saturating_sub(column.bytes());
            columns[property.name as usize] = Some(column);
        }
        // Completes the progress: a palette of unknown size is usually smaller than its limit.
        done.add(left)?;
        let leaf = |children: &Column| {
            (0..self.count).filter(|row| children.index(*row) == 0).map(|row| row as u32).collect()
        };
        let leaves = columns[Name::ChildCount as usize].as_ref().map(leaf);
        Ok(Arrays { columns, count: self.count, leaves })
    }
}

impl Arrays {
    pub(super) fn get(&self, name: Name) -> Option<&Column> {
        self.columns[name as usize].as_ref()
    }

    /// Returns the number of splats that are read: the leaves, or all rows without a tree.
    pub(super) fn kept(&self) -> usize {
        self.leaves.as_ref().map_or(self.count, Vec::len)
    }

    /// Returns the row of the splat with the given index among those that are read.
    pub(super) fn row(&self, index: usize) -> usize {
        self.leaves.as_ref().map_or(index, |leaves| leaves[index] as usize)
    }
}
