//! Decodes the two compressions of binary layers: LZ4 blocks, and delta-coded integers inside LZ4 blocks.

use super::layer::Bytes;
use crate::error::{SceneError, field};
use crate::input::grow;
use crate::words::bytes_at;
use std::fmt::Display;

/// Maximum compression ratio of LZ4.
const MAX_PER_BYTE: u64 = 255;

/// A position in a binary layer, from which fields are read in order.
pub(super) struct Cursor<'a, 'b> {
    pub layer: &'a Bytes<'b>,
    pub at: u64,
    /// Name of the section or the value, for errors.
    pub name: &'static str,
}

impl Cursor<'_, '_> {
    pub(super) fn take<const N: usize>(&mut self) -> Result<[u8; N], SceneError> {
        let mut bytes = [0; N];
        self.layer.read(self.at, &mut bytes)?;
        self.at += N as u64;
        Ok(bytes)
    }

    pub(super) fn word(&mut self) -> Result<u32, SceneError> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    pub(super) fn long(&mut self) -> Result<u64, SceneError> {
        Ok(u64::from_le_bytes(self.take()?))
    }

    pub(super) fn wrong(&self, message: impl Display) -> SceneError {
        field(self.at, self.name, message)
    }

    /// Reads the number of items of a list, and checks it against the layer's length.
    pub(super) fn count(&mut self) -> Result<usize, SceneError> {
        let count = self.long()?;
        // Assumes at least one byte of the layer per item. A compressed list could have more items.
        let most = self.layer.length;
        if count > most {
            return Err(field(
                self.at - 8,
                self.name,
                format!("expected at most {most} items, found {count}"),
            ));
        }
        Ok(count as usize)
    }

    /// Unpacks an LZ4 block, which its length precedes. Fails if it unpacks to more than `most` bytes.
    pub(super) fn unpack(&mut self, most: u64) -> Result<Vec<u8>, SceneError> {
        let length = self.long()?;
        let packed = self.layer.vec(self.at, length)?;
        let Some((chunks, block)) = packed.split_first() else {
            return Err(self.wrong("expected an LZ4 block, found no bytes"));
        };
        if *chunks != 0 {
            // Only data of about 2 GiB or more has several chunks.
            return Err(self.wrong(format!("expected one LZ4 block, found {chunks}")));
        }
        let limit = (block.len() as u64 + 1).saturating_mul(MAX_PER_BYTE);
        let mut unpacked = Vec::new();
        grow(&mut unpacked, most.min(limit) as usize)?;
        let count = lz4_flex::block::decompress_into(block, &mut unpacked)
            .map_err(|error| self.wrong(format!("expected an intact LZ4 block, found damage: {error}")))?;
        unpacked.truncate(count);
        self.at += length;
        Ok(unpacked)
    }

    /// Unpacks `count` delta-coded integers. Fails if there are fewer.
    ///
    /// They consist of the most common difference, a code of two bits per integer, and the other differences, of 1,
    /// 2 or 4 bytes.
    pub(super) fn integers(&mut self, count: usize) -> Result<Vec<u32>, SceneError> {
        let codes = count.div_ceil(4);
        let bytes = self.unpack((4 + codes + 4 * count) as u64)?;
        let short = |found: usize| {
            self.wrong(format!(
                "expected {count} integers, found the end of their {} bytes at {found}",
                bytes.len()
            ))
        };
        if bytes.len() < 4 + codes {
            return Err(short(bytes.len()));
        }
        let common = i32::from_le_bytes(bytes_at(&bytes, 0));
        let mut at = 4 + codes;
        let mut last = 0i32;
        let mut integers = Vec::new();
        integers.try_reserve_exact(count).map_err(std::io::Error::from)?;
        for index in 0..count {
            let width = match bytes[4 + index / 4] >> (2 * (index % 4)) & 3 {
                0 => 0,
                1 => 1,
                2 => 2,
                _ => 4,
            };
            let difference = bytes.get(at..at + width).ok_or_else(|| short(at))?;
            at += width;
            last = last.wrapping_add(match *difference {
                [] => common,
                [a] => i32::from(a as i8),
                [a, b] => i32::from(i16::from_le_bytes([a, b])),
                [a, b, c, d] => i32::from_le_bytes([a, b, c, d]),
                _ => unreachable!("a difference has at most 4 bytes"),
            });
            integers.push(last as u32);
        }
        Ok(integers)
    }
}
