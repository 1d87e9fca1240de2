//! Unpacks the array of a property, and converts its values.

use super::document::{Compression, Encoding, Property};
use crate::error::{SceneError, field};
use flate2::read::DeflateDecoder;
use std::f64::consts::FRAC_PI_2;
use std::io::Read;

/// Maximum compression ratio of deflate.
pub(super) const MAX_PER_BYTE: u64 = 1032;

/// An unpacked array of `rows` rows of `width` components.
pub(super) struct Column {
    encoding: Encoding,
    width: usize,
    pub rows: usize,
    min: f64,
    max: f64,
    bytes: Vec<u8>,
}

impl Column {
    /// Unpacks an array.
    ///
    /// `rows` is `None` for a palette of unknown size, which then follows from the bytes. `at` is the offset of the
    /// packed bytes, and `name` the name of the property, for errors.
    pub(super) fn unpack(
        property: &Property,
        rows: Option<usize>,
        packed: Vec<u8>,
        (at, name): (u64, &str),
    ) -> Result<Self, SceneError> {
        let row = property.name.width() * property.encoding.bytes();
        let most = match rows {
            Some(rows) => (rows * row) as u64,
            None => packed.len() as u64 * MAX_PER_BYTE,
        };
        let bytes = match property.compression {
            Some(Compression::Gz) => {
                let mut bytes = Vec::new();
                DeflateDecoder::new(&packed[..]).take(most + 1).read_to_end(&mut bytes).map_err(|error| {
                    field(at, name, format!("expected an intact deflate stream, found damage: {error}"))
                })?;
                bytes
            }
            None => packed,
        };
        let found = bytes.len() as u64;
        if rows.is_some() && found != most || !found.is_multiple_of(row as u64) {
            let more = if found > most { " or more" } else { "" };
            let expected = if rows.is_some() { format!("{most}") } else { format!("rows of {row}") };
            return Err(field(at, name, format!("expected {expected} unpacked bytes, found {found}{more}")));
        }
        let mut column = Self {
            encoding: property.encoding,
            width: property.name.width(),
            rows: bytes.len() / row,
            min: property.min.map_or(0.0, f64::from),
            max: property.max.map_or(0.0, f64::from),
            bytes,
        };
        column.sum_differences();
        Ok(column)
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Decodes the `_delta` encodings: replaces differences by their running sums.
    fn sum_differences(&mut self) {
        if !matches!(self.encoding, Encoding::R8Delta | Encoding::S8Delta) {
            return;
        }
        for component in self.bytes.chunks_exact_mut(self.rows.max(1)) {
            let mut last = 0u8;
            for byte in component {
                last = last.wrapping_add(*byte);
                *byte = last;
            }
        }
    }

    /// Returns the bytes of a component, in little-endian order.
    fn word<const N: usize>(&self, row: usize, component: usize) -> [u8; N] {
        let index = component * self.rows + row;
        std::array::from_fn(|byte| match self.encoding {
            Encoding::F32LeBytes | Encoding::F16LeBytes => self.bytes[byte * self.width * self.rows + index],
            _ => self.bytes[N * index + byte],
        })
    }

    /// Returns a component as a number. Values that are not stored as floats are computed in f64 and rounded once.
    pub(super) fn value(&self, row: usize, component: usize) -> f32 {
        let half = || half::f16::from_le_bytes(self.word(row, component));
        let byte = || self.word::<1>(row, component)[0];
        let range = self.max - self.min;
        match self.encoding {
            Encoding::F32 | Encoding::F32LeBytes => f32::from_le_bytes(self.word(row, component)),
            Encoding::F16 | Encoding::F16LeBytes => half().to_f32(),
            Encoding::LnF16 => half().to_f64().exp() as f32,
            Encoding::R8 | Encoding::R8Delta => (self.min + f64::from(byte()) / 255.0 * range) as f32,
            Encoding::S8 | Encoding::S8Delta => {
                (f64::from(i8::from_le_bytes([byte()])) / 127.0 * self.max) as f32
            }
            Encoding::Ln0R8 => match byte() {
                0 => 0.0,
                code => (self.min + f64::from(code - 1) / 254.0 * range).exp() as f32,
            },
            Encoding::Oct88r8 | Encoding::U16 | Encoding::U32 => self.index(row) as f32,
        }
    }

    /// Returns an index or a count, stored as `u16` or `u32`.
    pub(super) fn index(&self, row: usize) -> usize {
        match self.encoding {
            Encoding::U16 => u16::from_le_bytes(self.word(row, 0)).into(),
            _ => u32::from_le_bytes(self.word(row, 0)) as usize,
        }
    }

    /// Returns a quaternion w, x, y, z.
    pub(super) fn quaternion(&self, row: usize) -> [f64; 4] {
        if self.encoding != Encoding::Oct88r8 {
            let [x, y, z] = [0, 1, 2].map(|component| f64::from(self.value(row, component)));
            return [(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z];
        }
        // This encoding is not planar: the three bytes of a row are adjacent.
        let [u, v, angle] = [0, 1, 2].map(|byte| f64::from(self.bytes[3 * row + byte]) / 255.0);
        let (x, y) = (2.0 * u - 1.0, 2.0 * v - 1.0);
        let z = 1.0 - x.abs() - y.abs();
        // The lower half of the octahedron is folded over the upper half's corners.
        let fold = (-z).max(0.0);
        let [x, y] = [x, y].map(|value| if value >= 0.0 { value - fold } else { value + fold });
        let (sin, cos) = (angle * FRAC_PI_2).sin_cos();
        let scale = sin / (x * x + y * y + z * z).sqrt();
        [cos, x * scale, y * scale, z * scale]
    }
}
