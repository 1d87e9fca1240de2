//! Reads SPZ: unpacks the arrays in order, then converts them in parallel.

use super::frame::Frame;
use super::header::{Header, Unpacked};
use super::layout::{ANTIALIASED, COLOR_SCALE, COORDINATE_SYSTEM, EXTENSIONS, MAGIC};
use super::{gzip, streams};
use crate::activation;
use crate::error::{SceneError, field};
use crate::input::{self, Done, Input, SceneHeader, Source, Table};
use crate::scene::{FileNotes, Filter, Scene, Splat};
use crate::size_breakdown::{ElementSize, SizeBreakdown};
use crate::words::word;
use half::f16;
use std::f64::consts::FRAC_1_SQRT_2;

impl Header {
    /// Converts a splat; also returns the length of the file's quaternion.
    fn splat(&self, rows: [&[u8]; 6], frame: &Frame) -> (Splat, f64) {
        let [position, alpha, color, scale, rotation, sh] = rows;
        let (rotation, norm) = activation::unit(match rotation {
            [x, y, z] => bytes_quaternion([*x, *y, *z]),
            _ => packed_quaternion(word(rotation, 0)),
        });
        let mut splat = Splat {
            position: std::array::from_fn(|axis| match self.version {
                1 => f16::from_le_bytes([position[2 * axis], position[2 * axis + 1]]).to_f32(),
                _ => {
                    let [low, middle, high] = [0, 1, 2].map(|byte| position[3 * axis + byte]);
                    // The bytes are the upper three of a word, so that the shift sign-extends.
                    let fixed = i32::from_le_bytes([0, low, middle, high]) >> 8;
                    (f64::from(fixed) / f64::from(1u32 << self.fractional_bits)) as f32
                }
            }),
            scale: std::array::from_fn(|axis| (f64::from(scale[axis]) / 16.0 - 10.0).exp() as f32),
            rotation,
            opacity: (f64::from(alpha[0]) / 255.0) as f32,
            sh: [0.0; 48],
        };
        for (value, byte) in splat.sh.iter_mut().zip(color) {
            *value = ((f64::from(*byte) / 255.0 - 0.5) / COLOR_SCALE) as f32;
        }
        // A scene has no band 4: the zip ends before it.
        for (value, byte) in splat.sh[3..].iter_mut().zip(sh) {
            *value = (f32::from(*byte) - 128.0) / 128.0;
        }
        frame.apply(&mut splat, self.degree.min(3));
        (splat, norm)
    }
}

/// Converts the bytes of x, y and z of versions 1 and 2 to w, x, y, z.
fn bytes_quaternion(bytes: [u8; 3]) -> [f64; 4] {
    let [x, y, z] = bytes.map(|byte| f64::from(byte) / 127.5 - 1.0);
    activation::with_omitted(0, [x, y, z])
}

/// Unpacks the word of version 3 to w, x, y, z. The word orders its components x, y, z, w.
fn packed_quaternion(word: u32) -> [f64; 4] {
    let others = [20, 10, 0].map(|shift| {
        let bits = word >> shift & 1023;
        let size = f64::from(bits & 511) / 511.0 * FRAC_1_SQRT_2;
        if bits & 512 == 0 { size } else { -size }
    });
    let [x, y, z, w] = activation::with_omitted((word >> 30) as usize, others);
    [w, x, y, z]
}

/// Unpacks a file of any version. From version 4 on, it begins with an uncompressed [`MAGIC`].
fn unpack(input: &Input) -> Result<Unpacked, SceneError> {
    match is_plain(input.source)? {
        true => streams::unpack(input),
        false => gzip::unpack(input),
    }
}

fn is_plain(source: &Source) -> Result<bool, SceneError> {
    Ok(source.head(MAGIC.len())? == MAGIC)
}

pub(crate) fn header(source: &Source) -> Result<SceneHeader, SceneError> {
    let header = match is_plain(source)? {
        true => streams::header(source)?.0,
        false => gzip::header(source)?,
    };
    Ok(SceneHeader { count: header.count.into(), stored_degree: header.degree.min(3) })
}

pub(crate) fn parse(input: &Input) -> Result<Scene, SceneError> {
    let Unpacked { header, data, fields, header_bytes, packing, records: (records, at) } = unpack(input)?;
    let (count, degree) = (u64::from(header.count), header.degree.min(3));
    let frame = if header.flags & EXTENSIONS == 0 { Frame::RUB } else { coordinate_system(&records, at)? };
    let frame = Frame::new(frame).ok_or_else(|| {
        let text = format!("expected a coordinate system of 0 to 16, found {frame}");
        field(at, "extensions", text)
    })?;
    let bytes = count * header.stride();
    let done = Done::after(bytes, 2 * bytes, input.progress);
    let (source, mut start) = (Source::Bytes(&data), 0);
    let tables = header.arrays().map(|(_, _, width)| {
        let table = Table::new(source, start, width);
        start += count * width as u64;
        table
    });
    let filled = input.fill((count, degree, false), tables, 0, &done, |rows, _, out| {
        let (splat, norm) = header.splat(rows, &frame);
        out.push(&splat, norm);
    })?;
    let arrays = ElementSize::new("splats", count, fields);
    let format = format!("spz, version {}, {packing}", header.version);
    let size_breakdown = SizeBreakdown::new(format, input.source.length(), header_bytes, vec![arrays]);
    let notes = FileNotes {
        low_pass: if header.flags & ANTIALIASED == 0 { Filter::Dilated } else { Filter::Compensated },
        cut_degree: (header.degree > 3).then_some(header.degree),
        ..FileNotes::default()
    };
    input::finish(filled, count, size_breakdown, notes)
}

/// Finds the coordinate system among extension records, which begin at offset `start`; see [`Unpacked::records`].
///
/// A record is its type, the length of its payload, and the payload. Unknown types are skipped.
fn coordinate_system(mut records: &[u8], start: u64) -> Result<u32, SceneError> {
    let length = records.len() as u64;
    let mut system = Frame::RUB;
    while !records.is_empty() {
        let at = start + length - records.len() as u64;
        let cut =
            || field(at, "extensions", format!("expected a complete record, found {} bytes", records.len()));
        let (head, rest) = records.split_at_checked(8).ok_or_else(cut)?;
        let (payload, rest) = rest.split_at_checked(word(head, 4) as usize).ok_or_else(cut)?;
        if word(head, 0) == COORDINATE_SYSTEM {
            let value = payload.try_into().map_err(|_| {
                let text = format!("expected 4 bytes of coordinate system, found {}", payload.len());
                field(at, "extensions", text)
            })?;
            // 0 means unspecified.
            system = match u32::from_le_bytes(value) {
                0 => Frame::RUB,
                found => found,
            };
        }
        records = rest;
    }
    Ok(system)
}
