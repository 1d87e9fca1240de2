//! Parses the rows of ASCII PLY files: one row per line, values separated by blanks.

use super::header::{Element, PropertyType};
use super::layout::Layout;
use crate::error::SceneError;

/// A cursor over the lines that hold rows.
#[derive(Clone, Copy)]
pub(crate) struct Lines<'a> {
    bytes: &'a [u8],
    /// Offset of the next line, in bytes.
    pub at: usize,
    /// Number of the previous line, counted from 1 over the file.
    pub number: u64,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(bytes: &'a [u8], at: usize, number: u64) -> Self {
        Self { bytes, at, number }
    }

    /// Returns the next line that is not blank. Line ends are `\n` or `\r\n`.
    pub(crate) fn next_row(&mut self) -> Option<&'a [u8]> {
        while self.at < self.bytes.len() {
            let rest = &self.bytes[self.at..];
            let end = rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
            self.at += (end + 1).min(rest.len());
            self.number += 1;
            if rest[..end].iter().any(|b| !b.is_ascii_whitespace()) {
                return Some(&rest[..end]);
            }
        }
        None
    }
}

/// Splits a line into its values.
pub(crate) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

fn error(line: u64, message: String) -> SceneError {
    SceneError::Row { line, message }
}

/// Escapes the first 40 bytes of a word for a message.
fn shown(word: &[u8]) -> String {
    word[..word.len().min(40)].escape_ascii().to_string()
}

/// Parses a splat's line into its slots, and adds the bytes of each word to its column's total.
///
/// Returns the number of values, at most one per column. The caller rejects lines with fewer.
///
/// # Errors
/// A value is not a number, or the line has more values than columns.
pub(crate) fn row(
    line: &[u8],
    number: u64,
    layout: &Layout,
    vertex: &Element,
    slots: &mut [f32],
    sizes: &mut [u64],
) -> Result<usize, SceneError> {
    let columns = layout.slot_of.len();
    let mut found = 0;
    for word in words(line) {
        if found == columns {
            let all = words(line).count();
            return Err(error(number, format!("expected {columns} values, found {all}")));
        }
        if let Some(slot) = layout.slot_of[found] {
            let value = std::str::from_utf8(word).ok().and_then(|text| text.parse().ok());
            slots[slot] = value.ok_or_else(|| {
                let name = &vertex.properties[found].name;
                error(number, format!("expected a number for `{name}`, found `{}`", shown(word)))
            })?;
        }
        sizes[found] += word.len() as u64;
        found += 1;
    }
    Ok(found)
}

/// Skips an element and returns the bytes of each property's words.
///
/// # Errors
/// A row does not match its properties, or the file ends before the last row.
pub(crate) fn skip(lines: &mut Lines, element: &Element) -> Result<Vec<u64>, SceneError> {
    let mut sizes = vec![0; element.properties.len()];
    for row in 0..element.count {
        let line = lines.next_row().ok_or_else(|| SceneError::TruncatedElement {
            element: element.name.clone(),
            there: row,
            promised: element.count,
            line: element.line,
        })?;
        let number = lines.number;
        let mut values = words(line);
        let missing =
            |name: &str| error(number, format!("expected a value for `{name}`, found the end of the line"));
        for (property, size) in element.properties.iter().zip(&mut sizes) {
            let word = values.next().ok_or_else(|| missing(&property.name))?;
            *size += word.len() as u64;
            if let PropertyType::List { .. } = property.kind {
                let length: u64 =
                    std::str::from_utf8(word).ok().and_then(|text| text.parse().ok()).ok_or_else(|| {
                        error(
                            number,
                            format!("expected the length of `{}`, found `{}`", property.name, shown(word)),
                        )
                    })?;
                for _ in 0..length {
                    *size += values.next().ok_or_else(|| missing(&property.name))?.len() as u64;
                }
            }
        }
        if let Some(extra) = values.next() {
            return Err(error(number, format!("expected the end of the line, found `{}`", shown(extra))));
        }
    }
    Ok(sizes)
}
