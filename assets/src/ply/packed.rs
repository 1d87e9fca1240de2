//! Reads PlayCanvas's compressed PLY layout: 16 bytes per splat, relative to the bounds of its chunk of 256.
//!
//! | element | rows | properties |
//! |---|---|---|
//! | `chunk` | one per 256 splats | bounds, `float`: of positions, log scales and (not in older files) colours |
//! | `vertex` | splats | `packed_position`, `packed_rotation`, `packed_scale`, `packed_color`, `uint` |
//! | `sh` | splats, or absent | `f_rest_*`, `uchar`, channel-major |
//!
//! Positions and scales have 11, 10 and 11 bits of the range of their chunk, from the highest bit down. A rotation has
//! the index of the largest of w, x, y, z in its two highest bits, and the other three in 10 bits each. A colour has 8
//! bits per channel and 8 bits of opacity. Format and names are those of
//! <https://github.com/playcanvas/splat-transform>.

use super::binary;
use super::header::{Element, Encoding, Header, Property, PropertyType, wrong_line};
use super::layout::Rest;
use crate::activation;
use crate::error::SceneError;
use crate::input::{self, Done, Input, Table};
use crate::memory;
use crate::scalar::Scalar;
use crate::scene::{FileNotes, Scene, Splat};
use crate::size_breakdown::SizeBreakdown;
use crate::words::{float, word};
use std::f64::consts::SQRT_2;

pub(super) const CHUNK_SPLATS: usize = 256;

/// Properties of `vertex`.
pub(super) const VERTEX: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Properties of `chunk`: minima and maxima of positions, scales and colours.
pub(super) const CHUNK: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];

pub(super) struct Packed {
    pub harmonics: Rest,
    /// Offset of each of [`VERTEX`] in a row.
    vertex: [usize; 4],
    /// Offset of each of [`CHUNK`] in a row; only the first 12 if the file has no bounds for colours.
    chunk: Vec<usize>,
    rest: Vec<usize>,
}

/// The bounds of a chunk, in the order of [`CHUNK`].
type Bounds = [f32; 18];

impl Packed {
    /// Finds the properties in the header of a file, and checks the encoding and the numbers of rows.
    pub(super) fn find(header: &Header) -> Result<Self, SceneError> {
        let vertex = header.vertex()?;
        let fail = |element: &Element, message: String| wrong_line(element.line, &message);
        if header.encoding != Encoding::LittleEndian {
            let found = header.encoding.name();
            return Err(fail(
                vertex,
                format!("expected binary_little_endian for packed properties, found {found}"),
            ));
        }
        let chunk = header.elements.iter().find(|element| element.name == "chunk");
        let chunk = chunk.ok_or_else(|| {
            fail(vertex, "expected an `element chunk`, the bounds of packed properties, found none".into())
        })?;
        let expected = vertex.count.div_ceil(CHUNK_SPLATS as u64);
        if chunk.count < expected {
            let (count, found) = (vertex.count, chunk.count);
            let text =
                format!("expected {expected} rows of `element chunk` for {count} splats, found {found}");
            return Err(fail(chunk, text));
        }
        let colors = chunk.properties.iter().any(|p| CHUNK[12..].contains(&p.name.as_str()));
        let bounds = &CHUNK[..if colors { 18 } else { 12 }];
        let sh = header.elements.iter().find(|element| element.name == "sh");
        let (mut rest, mut harmonics) = (Vec::new(), Rest::default());
        if let Some(sh) = sh {
            if sh.count != vertex.count {
                let text = format!(
                    "expected {} rows of `element sh`, one per splat, found {}",
                    vertex.count, sh.count
                );
                return Err(fail(sh, text));
            }
            harmonics = Rest::of(sh, "")?;
            for name in harmonics.names() {
                rest.push(offset(sh, &name, Scalar::U8)?);
            }
        }
        let mut offsets = [0; 4];
        for (offset_of, name) in offsets.iter_mut().zip(VERTEX) {
            *offset_of = offset(vertex, name, Scalar::U32)?;
        }
        Ok(Self {
            harmonics,
            vertex: offsets,
            chunk: bounds.iter().map(|name| offset(chunk, name, Scalar::F32)).collect::<Result<_, _>>()?,
            rest,
        })
    }

    pub(super) fn parse(&self, input: &Input, header: &Header) -> Result<Scene, SceneError> {
        let used = |element: &Element, column: usize| used(&element.name, &element.properties[column]);
        let (elements, tables) = binary::elements(input.source, header, false, used)?;
        let table = |name: &str| {
            let line = header.vertex()?.line;
            let lists = || wrong_line(line, "expected no lists beside packed properties");
            tables.get(name).copied().ok_or_else(lists)
        };
        let (chunks, vertex) = (table("chunk")?, table("vertex")?);
        let sh = if self.harmonics.degree > 0 { table("sh")? } else { Table::NONE };
        let count = header.vertex()?.count;
        let bounds = self.bounds(chunks, count)?;
        let done = Done::new(count * (vertex.stride + sh.stride) as u64, input.progress)?;
        let bounds_bytes = size_of_val(bounds.as_slice()) as u64;
        let counts = (count, self.harmonics.degree, false);
        let filled = input.fill(counts, [vertex, sh], bounds_bytes, &done, |[row, rest], index, out| {
            let (splat, norm) = self.splat(row, rest, &bounds[index / CHUNK_SPLATS]);
            out.push(&splat, norm);
        })?;
        let length = input.source.length();
        let format = "PlayCanvas compressed ply".into();
        let size_breakdown = SizeBreakdown::new(format, length, header.bytes as u64, elements)
            .with_comments(header.comment_texts());
        let notes = FileNotes { cut_degree: self.harmonics.cut_degree, ..header.notes };
        let scene = input::finish(filled, count, size_breakdown, notes)?;
        Ok(scene.with_header_comments(header.kept_comments()))
    }

    fn bounds(&self, table: Table, count: u64) -> Result<Vec<Bounds>, SceneError> {
        let needed = count.div_ceil(CHUNK_SPLATS as u64) as usize;
        let mut bounds: Vec<Bounds> =
            memory::zeroed(needed).ok_or_else(|| std::io::Error::from(std::io::ErrorKind::OutOfMemory))?;
        let mut row = vec![0; table.stride];
        for (index, bounds) in bounds.iter_mut().enumerate() {
            table.read(index, 1, &mut row)?;
            // Without bounds, a colour ranges from 0 to 1.
            bounds[15..].fill(1.0);
            for (bound, offset) in bounds.iter_mut().zip(&self.chunk) {
                *bound = float(&row, *offset);
            }
        }
        Ok(bounds)
    }

    /// Unpacks a splat; also returns the length of the file's quaternion.
    fn splat(&self, row: &[u8], rest: &[u8], bounds: &Bounds) -> (Splat, f64) {
        let [position, rotation, scale, color] = self.vertex.map(|offset| word(row, offset));
        let lerp = |from: usize, axis: usize, t: f64| {
            let (min, max) = (f64::from(bounds[from + axis]), f64::from(bounds[from + 3 + axis]));
            min * (1.0 - t) + max * t
        };
        let ranged = |from: usize, word: u32| {
            let t = unpack(word);
            std::array::from_fn::<f32, 3, _>(|axis| lerp(from, axis, t[axis]) as f32)
        };
        let (rotation, norm) = activation::unit(quaternion(rotation));
        let channel = |shift: u32| f64::from(color >> shift & 255) / 255.0;
        let mut splat = Splat {
            position: ranged(0, position),
            scale: ranged(6, scale).map(activation::exponential),
            rotation,
            opacity: channel(0) as f32,
            sh: activation::flat([0, 1, 2].map(|axis| lerp(12, axis, channel([24, 16, 8][axis])))),
        };
        let bands = self.rest.len() / 3;
        for (index, offset) in self.rest.iter().enumerate() {
            splat.sh[3 * (index % bands + 1) + index / bands] = harmonic(rest[*offset]);
        }
        (splat, norm)
    }
}

fn used(element: &str, property: &Property) -> bool {
    let name = property.name.as_str();
    match element {
        "vertex" => VERTEX.contains(&name),
        "chunk" => CHUNK.contains(&name),
        _ => element == "sh" && name.starts_with("f_rest_"),
    }
}

/// Returns the offset of a property in a binary row. Fails if it is missing, has another type or follows a list.
fn offset(element: &Element, name: &str, scalar: Scalar) -> Result<usize, SceneError> {
    let mut offset = 0;
    for property in &element.properties {
        match property.kind {
            PropertyType::Scalar(found) if property.name != name => offset += found.size(),
            PropertyType::Scalar(found) if found == scalar => return Ok(offset),
            kind => {
                let (expected, found) = (scalar.name(), kind.name());
                let message = format!("expected the type {expected} of `{}`, found {found}", property.name);
                return Err(wrong_line(element.line, &message));
            }
        }
    }
    let (element, line) = (&element.name, element.line);
    let message =
        format!("expected a property `{name}` in `element {element}` of a compressed PLY, found none");
    Err(wrong_line(line, &message))
}

/// Unpacks three values from 0 to 1, stored in 11, 10 and 11 bits.
fn unpack(word: u32) -> [f64; 3] {
    [f64::from(word >> 21) / 2047.0, f64::from(word >> 11 & 1023) / 1023.0, f64::from(word & 2047) / 2047.0]
}

fn quaternion(word: u32) -> [f64; 4] {
    let component = |shift: u32| (f64::from(word >> shift & 1023) / 1023.0 - 0.5) * SQRT_2;
    let others = [20, 10, 0].map(component);
    activation::with_omitted((word >> 30) as usize, others)
}

/// Converts the byte of a coefficient above band 0. The extreme bytes are the ends of the range, -4 and 4.
fn harmonic(byte: u8) -> f32 {
    let part = match byte {
        0 => 0.0,
        255 => 1.0,
        _ => (f32::from(byte) + 0.5) / 256.0,
    };
    (part - 0.5) * 8.0
}
