//! Parses the header of SPZ, and limits the decompressed data to the sizes that it declares.

use super::layout::HEADER;
use crate::error::{SceneError, field};
use crate::input::{Done, Input};
use crate::memory::SceneMemoryError;
use crate::scene::Scene;
use crate::size_breakdown::FieldSize;
use crate::words::word;
use std::io::{self, ErrorKind, Read};
use std::ops::RangeInclusive;

/// Maximum ratio of unpacked to packed bytes in a gzip stream: 258 bytes in 2 bits (RFC 1951).
const MAX_OF_GZIP: u64 = 1032;

/// Maximum ratio of unpacked to packed bytes in Zstandard: a block of 128 KiB in 4 bytes (RFC 8878).
const MAX_OF_ZSTD: u64 = (128 << 10) / 4;

/// Minimum growth of an array, in bytes.
const PIECE: usize = 64 << 10;

pub(super) struct Header {
    pub version: u32,
    pub count: u32,
    pub degree: u32,
    pub fractional_bits: u8,
    pub flags: u8,
}

impl Header {
    /// Parses the header of a file of `length` bytes; its version must be in `versions`.
    pub(super) fn parse(
        bytes: &[u8; HEADER],
        length: u64,
        versions: RangeInclusive<u32>,
    ) -> Result<Self, SceneError> {
        let expected = |at: usize, name: &str, expected: &str, found: u32| {
            field(at as u64, name, format!("expected {expected}, found {found}"))
        };
        let header = Self {
            version: word(bytes, 4),
            count: word(bytes, 8),
            degree: bytes[12].into(),
            fractional_bits: bytes[13],
            flags: bytes[14],
        };
        if !versions.contains(&header.version) {
            let expected_versions = match (versions.start(), versions.end()) {
                (first, last) if first == last => first.to_string(),
                (first, last) => format!("{first} to {last}"),
            };
            return Err(expected(4, "version", &expected_versions, header.version));
        }
        if header.degree > 4 {
            return Err(expected(12, "shDegree", "0 to 4", header.degree));
        }
        if header.fractional_bits > 24 {
            return Err(expected(13, "fractionalBits", "at most 24", header.fractional_bits.into()));
        }
        if header.count == 0 {
            return Err(expected(8, "numPoints", "at least one splat", 0));
        }
        let ratio = if header.version < 4 { MAX_OF_GZIP } else { MAX_OF_ZSTD };
        let most = length.saturating_mul(ratio) / header.stride();
        if u64::from(header.count) > most {
            let text = format!("at most {most} splats, which {length} bytes can hold");
            return Err(expected(8, "numPoints", &text, header.count));
        }
        Ok(header)
    }

    /// Lists the arrays: name, type of the values, and bytes per splat.
    pub(super) fn arrays(&self) -> [(&'static str, &'static str, usize); 6] {
        let coefficients = ((self.degree + 1) * (self.degree + 1) - 1) as usize;
        [
            if self.version == 1 { ("positions", "half", 6) } else { ("positions", "int24", 9) },
            ("alphas", "uchar", 1),
            ("colors", "uchar", 3),
            ("scales", "uchar", 3),
            if self.version < 3 { ("rotations", "uchar", 3) } else { ("rotations", "uint", 4) },
            ("sh", "uchar", 3 * coefficients),
        ]
    }

    pub(super) fn stride(&self) -> u64 {
        self.arrays().iter().map(|(_, _, bytes)| *bytes as u64).sum()
    }
}

/// Converts an error that occurred while a field of `expected` bytes was unpacked.
pub(super) fn unpacked(error: io::Error, at: u64, name: &str, expected: u64) -> SceneError {
    match error.kind() {
        ErrorKind::UnexpectedEof => {
            field(at, name, format!("expected {expected} bytes, found the end of the compressed stream"))
        }
        // The decoder's kinds of errors. All others come from the system.
        ErrorKind::InvalidInput | ErrorKind::InvalidData | ErrorKind::Other => {
            field(at, name, format!("expected an intact compressed stream, found damage: {error}"))
        }
        _ => SceneError::Io(error),
    }
}

pub(super) struct Unpacked {
    pub header: Header,
    /// The arrays, one after the other.
    pub data: Vec<u8>,
    /// Packed size of each array.
    pub fields: Vec<FieldSize>,
    /// Number of packed bytes before the arrays.
    pub header_bytes: u64,
    pub packing: &'static str,
    /// Bytes of the extension records, and their offset: in the unpacked stream, or in the file since version 4.
    pub records: (Vec<u8>, u64),
}

/// Refuses a file if its arrays and the scene together exceed the available memory.
pub(super) fn check_memory(header: &Header, input: &Input) -> Result<(), SceneError> {
    let (count, degree) = (u64::from(header.count), header.degree.min(3));
    let needed = Scene::host_bytes(count, degree).saturating_add(count * header.stride());
    Ok(SceneMemoryError::check_against(count, degree, needed, input.memory)?)
}

/// Appends `bytes` unpacked bytes to `data`, which grows only as they arrive. `failed` converts the error if there are
/// fewer, or memory is short.
pub(super) fn append(
    unpacker: &mut impl Read,
    bytes: u64,
    data: &mut Vec<u8>,
    done: &Done,
    failed: impl FnOnce(io::Error) -> SceneError,
) -> Result<(), SceneError> {
    let mut left = bytes;
    while left > 0 {
        let piece = left.min(data.len().clamp(PIECE, 1 << 24) as u64);
        let start = data.len();
        let read = data.try_reserve(piece as usize).map_err(io::Error::from).and_then(|()| {
            data.resize(start + piece as usize, 0);
            unpacker.read_exact(&mut data[start..])
        });
        if let Err(error) = read {
            return Err(failed(error));
        }
        done.add(piece)?;
        left -= piece;
    }
    Ok(())
}
