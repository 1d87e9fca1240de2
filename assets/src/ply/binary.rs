//! Measures the elements of binary PLY files.

use super::header::{Element, Header, PropertyType};
use crate::error::SceneError;
use crate::input::{Source, SourceReader, Table};
use crate::scalar::Scalar;
use crate::size_breakdown::ElementSize;
use std::collections::HashMap;
use std::io::{BufReader, Read};

const PIECE: usize = 64 << 10;

/// Reads the length of a list, in big-endian order if `big`; `None` if it is negative.
fn length(raw: &[u8], scalar: Scalar, big: bool) -> Option<u64> {
    let value = if big { scalar.wide::<true>(raw) } else { scalar.wide::<false>(raw) };
    (value >= 0.0).then_some(value as u64)
}

/// Computes the sizes of all elements of a file, which is big-endian if `big`. Also returns the tables of those without
/// lists, by name.
///
/// `used` gets an element and the index of a property, and returns true if the reader uses the property.
pub(super) fn elements<'a, 'h>(
    source: &'a Source<'a>,
    header: &'h Header,
    big: bool,
    used: impl Fn(&Element, usize) -> bool,
) -> Result<(Vec<ElementSize>, HashMap<&'h str, Table<'a>>), SceneError> {
    let (mut elements, mut tables) = (Vec::new(), HashMap::new());
    let mut at = header.bytes as u64;
    for element in &header.elements {
        let sizes = measure(source, at, element, big)?;
        let bytes = sizes.iter().sum::<u64>();
        elements.push(element.size(header.encoding, &sizes, bytes, |column| used(element, column)));
        tables.extend(element.stride().map(|stride| (&*element.name, Table::new(*source, at, stride))));
        at += bytes;
    }
    Ok((elements, tables))
}

/// Sums the bytes of each property over all rows of an element, from offset `start` on. Fails if the file ends before
/// the last row does.
fn measure(source: &Source, start: u64, element: &Element, big: bool) -> Result<Vec<u64>, SceneError> {
    let mut left = source.length() - start;
    if let Some(stride) = element.stride() {
        // An element without properties has empty rows: any number of them fits.
        let whole = left.checked_div(stride as u64).unwrap_or(u64::MAX);
        if whole < element.count {
            return Err(element.truncated(whole));
        }
        let size = |kind| if let PropertyType::Scalar(s) = kind { s.size() as u64 } else { 0 };
        return Ok(element.properties.iter().map(|p| size(p.kind) * element.count).collect());
    }
    let mut sizes = vec![0u64; element.properties.len()];
    let mut file = BufReader::with_capacity(PIECE, SourceReader::new(source, start));
    for row in 0..element.count {
        for (property, total) in element.properties.iter().zip(&mut sizes) {
            let (size, read) = match property.kind {
                PropertyType::Scalar(scalar) => (Some(scalar.size() as u64), 0),
                PropertyType::List { count, .. } if left < count.size() as u64 => (None, 0),
                PropertyType::List { count, item } => {
                    let (mut raw, read) = ([0; size_of::<u32>()], count.size() as u64);
                    file.read_exact(&mut raw[..count.size()])?;
                    let items = length(&raw, count, big).and_then(|n| n.checked_mul(item.size() as u64));
                    (items.and_then(|items| items.checked_add(read)), read)
                }
            };
            let size = size.filter(|size| *size <= left).ok_or_else(|| element.truncated(row))?;
            file.seek_relative((size - read) as i64)?;
            *total += size;
            left -= size;
        }
    }
    Ok(sizes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ply::header::Property;
    use crate::testing::says;

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
        assert!(bytes.len() > 4 * PIECE);
        let items = 800 * (0..30).sum::<u64>();
        let measured = |bytes: &[u8]| measure(&Source::Bytes(bytes), 5, &element, false);
        assert_eq!(measured(&bytes).unwrap(), [items + 60, 30]);
        says(
            measured(&bytes[..bytes.len() - 2]).unwrap_err(),
            "expected 30 rows of `element e` (line 1), found 29",
        );
    }
}
