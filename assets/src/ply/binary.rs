//! Parses the rows of binary PLY files.

use super::header::{Element, PropertyType, Scalar};
use crate::error::SceneError;
use crate::input::Source;

/// Reads the scalar at the start of `bytes` as f32; doubles are rounded, integers converted.
#[inline]
pub(crate) fn value<const BIG: bool>(bytes: &[u8], scalar: Scalar) -> f32 {
    match scalar {
        Scalar::F32 => f32::from_bits(u32::from_ne_bytes(word::<BIG, 4>(bytes))),
        Scalar::F64 => f64::from_bits(u64::from_ne_bytes(word::<BIG, 8>(bytes))) as f32,
        Scalar::I8 => f32::from(bytes[0] as i8),
        Scalar::U8 => f32::from(bytes[0]),
        Scalar::I16 => f32::from(i16::from_ne_bytes(word::<BIG, 2>(bytes))),
        Scalar::U16 => f32::from(u16::from_ne_bytes(word::<BIG, 2>(bytes))),
        Scalar::I32 => i32::from_ne_bytes(word::<BIG, 4>(bytes)) as f32,
        Scalar::U32 => u32::from_ne_bytes(word::<BIG, 4>(bytes)) as f32,
    }
}

/// Reads the scalar at the start of `bytes` as f64, which represents every value of every type.
#[inline]
pub(crate) fn wide<const BIG: bool>(bytes: &[u8], scalar: Scalar) -> f64 {
    match scalar {
        Scalar::F64 => f64::from_bits(u64::from_ne_bytes(word::<BIG, 8>(bytes))),
        Scalar::I32 => f64::from(i32::from_ne_bytes(word::<BIG, 4>(bytes))),
        Scalar::U32 => f64::from(u32::from_ne_bytes(word::<BIG, 4>(bytes))),
        _ => f64::from(value::<BIG>(bytes, scalar)),
    }
}

/// Copies the first `N` bytes into the host's byte order.
#[inline]
fn word<const BIG: bool, const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut word = [0; N];
    word.copy_from_slice(&bytes[..N]);
    if BIG != cfg!(target_endian = "big") {
        word.reverse();
    }
    word
}

/// Reads the length of a list, stored in all of `raw`; `None` if it is negative.
fn length(raw: &[u8], scalar: Scalar, big: bool) -> Option<u64> {
    let value = raw.iter().enumerate().fold(0u64, |sum, (i, b)| {
        let shift = 8 * if big { raw.len() - 1 - i } else { i };
        sum | u64::from(*b) << shift
    });
    // Sign-extends signed types.
    let bits = 64 - 8 * raw.len() as u32;
    match scalar {
        Scalar::I8 | Scalar::I16 | Scalar::I32 => u64::try_from((value << bits) as i64 >> bits).ok(),
        _ => Some(value),
    }
}

/// Sums the bytes of each property over all rows of an element, from offset `start` on.
///
/// The inner `Err` has the number of whole rows, if the file ends inside a row or a list's length is negative.
pub(crate) fn measure(
    source: &Source,
    start: u64,
    element: &Element,
    big: bool,
) -> Result<Result<Vec<u64>, u64>, SceneError> {
    let available = source.length() - start;
    if let Some(stride) = element.stride() {
        // An element without properties has empty rows: any number of them fits.
        let whole = available.checked_div(stride as u64).unwrap_or(u64::MAX);
        if whole < element.count {
            return Ok(Err(whole));
        }
        let size = |kind| if let PropertyType::Scalar(s) = kind { s.size() as u64 } else { 0 };
        return Ok(Ok(element.properties.iter().map(|p| size(p.kind) * element.count).collect()));
    }
    let mut sizes = vec![0u64; element.properties.len()];
    let mut window = Window { source, at: start, bytes: Vec::new() };
    let mut at = start;
    for row in 0..element.count {
        for (property, total) in element.properties.iter().zip(&mut sizes) {
            let size = match property.kind {
                PropertyType::Scalar(scalar) => Some(scalar.size() as u64),
                PropertyType::List { count, item } => {
                    let raw = window.get(at, count.size())?;
                    let length = raw.and_then(|raw| length(raw, count, big));
                    length.and_then(|n| n.checked_mul(item.size() as u64)?.checked_add(count.size() as u64))
                }
            };
            let end = size.and_then(|size| at.checked_add(size)).filter(|end| *end <= source.length());
            let Some(end) = end else { return Ok(Err(row)) };
            *total += end - at;
            at = end;
        }
    }
    Ok(Ok(sizes))
}

/// A buffered piece of a file, which only moves forward.
struct Window<'a> {
    source: &'a Source<'a>,
    at: u64,
    bytes: Vec<u8>,
}

impl Window<'_> {
    const PIECE: u64 = 64 << 10;

    /// Returns `count` bytes at offset `at`, which must not decrease between calls; `None` beyond the end of the file.
    fn get(&mut self, at: u64, count: usize) -> Result<Option<&[u8]>, SceneError> {
        let left = self.source.length().saturating_sub(at);
        if left < count as u64 {
            return Ok(None);
        }
        if at + count as u64 > self.at + self.bytes.len() as u64 {
            self.bytes.resize(left.min(Self::PIECE) as usize, 0);
            self.source.read(at, &mut self.bytes)?;
            self.at = at;
        }
        let from = (at - self.at) as usize;
        Ok(Some(&self.bytes[from..from + count]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ply::header::Property;

    #[test]
    fn scalars_of_every_type_and_both_orders_are_read() {
        assert_eq!(value::<false>(&1.5f32.to_le_bytes(), Scalar::F32), 1.5);
        assert_eq!(value::<true>(&1.5f32.to_be_bytes(), Scalar::F32), 1.5);
        assert_eq!(value::<true>(&0.1f64.to_be_bytes(), Scalar::F64), 0.1);
        assert_eq!(value::<false>(&(-7i16).to_le_bytes(), Scalar::I16), -7.0);
        assert_eq!(value::<true>(&40000u16.to_be_bytes(), Scalar::U16), 40000.0);
        assert_eq!(value::<true>(&(-70000i32).to_be_bytes(), Scalar::I32), -70000.0);
        assert_eq!(value::<false>(&4_000_000_000u32.to_le_bytes(), Scalar::U32), 4e9);
        assert_eq!(value::<false>(&[0xFF], Scalar::I8), -1.0);
        assert_eq!(value::<false>(&[0xFF], Scalar::U8), 255.0);
    }

    #[test]
    fn list_lengths_are_read_in_both_orders_and_negative_ones_refused() {
        assert_eq!(length(&[1, 2], Scalar::U16, false), Some(0x0201));
        assert_eq!(length(&[1, 2], Scalar::U16, true), Some(0x0102));
        assert_eq!(length(&[0xFF], Scalar::U8, true), Some(255));
        assert_eq!(length(&[0xFF], Scalar::I8, true), None);
        assert_eq!(length(&[0xFF; 4], Scalar::U32, false), Some(u64::from(u32::MAX)));
    }

    #[test]
    fn rows_with_lists_are_measured_across_the_pieces_that_are_read() {
        let list = PropertyType::List { count: Scalar::U16, item: Scalar::F64 };
        let properties = vec![
            Property { name: "l".into(), line: 2, kind: list },
            Property { name: "s".into(), line: 3, kind: PropertyType::Scalar(Scalar::U8) },
        ];
        let element = Element { name: "e".into(), count: 30, line: 1, properties };
        let mut bytes = vec![0xAA; 5];
        for row in 0..30u16 {
            bytes.extend((100 * row).to_le_bytes());
            bytes.extend(std::iter::repeat_n(7, 800 * usize::from(row) + 1));
        }
        assert!(bytes.len() as u64 > 4 * Window::PIECE);
        let items = 800 * (0..30).sum::<u64>();
        assert_eq!(measure(&Source::Bytes(&bytes), 5, &element, false).unwrap(), Ok(vec![items + 60, 30]));
        let cut = &bytes[..bytes.len() - 2];
        assert_eq!(measure(&Source::Bytes(cut), 5, &element, false).unwrap(), Err(29));
    }
}
