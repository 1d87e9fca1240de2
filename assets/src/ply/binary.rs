//! Parses the rows of binary PLY files.

use super::header::{Element, PropertyType, Scalar};

/// Reads the scalar at the start of `bytes` as f32; doubles are rounded, integers converted.
///
/// # Panics
/// Panics if `bytes` is shorter than the scalar.
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

/// Reads the length of a list; `None` if it is negative or cut off.
fn length(bytes: &[u8], scalar: Scalar, big: bool) -> Option<u64> {
    let raw = bytes.get(..scalar.size())?;
    let value = raw.iter().enumerate().fold(0u64, |sum, (i, b)| {
        let shift = 8 * if big { raw.len() - 1 - i } else { i };
        sum | u64::from(*b) << shift
    });
    // Sign-extend what is signed.
    let bits = 64 - 8 * raw.len() as u32;
    match scalar {
        Scalar::I8 | Scalar::I16 | Scalar::I32 => u64::try_from((value << bits) as i64 >> bits).ok(),
        _ => Some(value),
    }
}

/// Measures the bytes of an element's rows, per property.
///
/// # Errors
/// The number of whole rows, if `bytes` ends before the last.
pub(crate) fn measure(bytes: &[u8], element: &Element, big: bool) -> Result<Vec<u64>, u64> {
    if let Some(stride) = element.stride() {
        // An element without properties has rows without bytes: as many as it likes.
        let whole = bytes.len().checked_div(stride).map_or(u64::MAX, |rows| rows as u64);
        if whole < element.count {
            return Err(whole);
        }
        let size = |kind| if let PropertyType::Scalar(s) = kind { s.size() as u64 } else { 0 };
        return Ok(element.properties.iter().map(|p| size(p.kind) * element.count).collect());
    }
    let mut sizes = vec![0u64; element.properties.len()];
    let mut at = 0usize;
    for row in 0..element.count {
        for (property, total) in element.properties.iter().zip(&mut sizes) {
            let size = match property.kind {
                PropertyType::Scalar(scalar) => Some(scalar.size() as u64),
                PropertyType::List { count, item } => bytes
                    .get(at..)
                    .and_then(|rest| length(rest, count, big))
                    .and_then(|n| n.checked_mul(item.size() as u64)?.checked_add(count.size() as u64)),
            };
            let end =
                size.and_then(|size| (at as u64).checked_add(size)).filter(|end| *end <= bytes.len() as u64);
            let end = end.ok_or(row)? as usize;
            *total += (end - at) as u64;
            at = end;
        }
    }
    Ok(sizes)
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!(length(&[1], Scalar::U16, false), None);
    }
}
