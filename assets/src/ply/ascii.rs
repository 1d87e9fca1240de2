//! Parses the rows of ASCII PLY files: one row per line, values separated by white space.

use super::header::{Element, PropertyType};
use super::layout::Layout;
use crate::error::{self, SceneError};
use crate::input::{Source, SourceReader};
use std::io::{BufRead, BufReader, Read};

/// Bytes read at a time.
const PIECE: usize = 256 << 10;

/// Maximum length of a line, in bytes.
pub(crate) const MAX_LINE: usize = 16 << 20;

/// A position between two lines of a file.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    /// Offset of the next line, in bytes.
    pub at: u64,
    /// Number of the previous line, counted from 1 over the file.
    pub number: u64,
}

#[derive(Clone, Copy)]
pub(crate) struct Line<'a> {
    /// The bytes before the line feed. A carriage return is white space between words.
    pub text: &'a [u8],
    /// Line number in the file, from 1; header lines count.
    pub number: u64,
    /// True if the line ended at the end of the file, without a line feed: the file may be truncated.
    pub cut: bool,
}

/// A cursor over the lines with rows.
pub(crate) struct Lines<'a> {
    file: BufReader<SourceReader<'a>>,
    place: Place,
    line: Vec<u8>,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(source: &'a Source<'a>, place: Place) -> Self {
        let file = BufReader::with_capacity(PIECE, SourceReader::new(source, place.at));
        Self { file, place, line: Vec::new() }
    }

    pub(crate) fn place(&self) -> Place {
        self.place
    }

    /// Returns the next line that is not blank; `None` at the end of the file. Fails if a line is longer than
    /// [`MAX_LINE`].
    pub(crate) fn next_row(&mut self) -> Result<Option<Line<'_>>, SceneError> {
        loop {
            self.line.clear();
            let mut file = (&mut self.file).take(MAX_LINE as u64 + 1);
            let read = file.read_until(b'\n', &mut self.line)?;
            if read == 0 {
                return Ok(None);
            }
            self.place.at += read as u64;
            self.place.number += 1;
            let (number, cut) = (self.place.number, !self.line.ends_with(b"\n"));
            if cut && read > MAX_LINE {
                return Err(error::row(
                    number,
                    format!("expected a line of at most {MAX_LINE} bytes, found more"),
                ));
            }
            if self.line.iter().any(|b| !b.is_ascii_whitespace()) {
                let text = self.line.strip_suffix(b"\n").unwrap_or(&self.line);
                return Ok(Some(Line { text, number, cut }));
            }
        }
    }
}

/// Splits a line into its values, at white space.
pub(crate) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

fn shown(word: &[u8]) -> String {
    word[..word.len().min(40)].escape_ascii().to_string()
}

/// Parses a number, rounding once; `None` if the word is not a number.
fn parsed<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// Parses the word at `column` of a line; `None` if there is none, or it is not a number.
pub(crate) fn wide(line: &Line, column: usize) -> Option<f64> {
    parsed(words(line.text).nth(column)?)
}

/// Parses a splat's line into its slots, plus its position relative to `origin` at full precision. Adds the bytes of
/// each word to its column's total.
///
/// Returns the number of values. More values than columns are an error; the caller rejects lines with fewer.
pub(crate) fn row(
    line: &Line,
    layout: &Layout,
    vertex: &Element,
    origin: [f64; 3],
    (slots, position): (&mut [f32], &mut [f64; 3]),
    sizes: &mut [u64],
) -> Result<usize, SceneError> {
    let columns = layout.slot_of.len();
    let number = line.number;
    let wide = layout.wide();
    let mut found = 0;
    for word in words(line.text) {
        if found == columns {
            let all = words(line.text).count();
            return Err(error::row(number, format!("expected {columns} values, found {all}")));
        }
        if let Some(slot) = layout.slot_of[found] {
            let value = match wide.get(slot) {
                Some(wide) => {
                    let value = parsed::<f64>(word).map(|value| value - origin[slot]);
                    position[slot] = value.unwrap_or_default();
                    // Each decimal is rounded to f32 once: after the subtraction, or directly.
                    if *wide { value.map(|value| value as f32) } else { parsed(word) }
                }
                None => parsed(word),
            };
            slots[slot] = value.ok_or_else(|| {
                let name = &vertex.properties[found].name;
                error::row(number, format!("expected a number for `{name}`, found `{}`", shown(word)))
            })?;
        }
        sizes[found] += word.len() as u64;
        found += 1;
    }
    Ok(found)
}

/// Skips an element and returns the bytes of each property's words. Fails if a row has too few or too many words.
pub(crate) fn skip(lines: &mut Lines, element: &Element) -> Result<Vec<u64>, SceneError> {
    let mut sizes = vec![0; element.properties.len()];
    for row in 0..element.count {
        let line = lines.next_row()?.ok_or_else(|| element.truncated(row))?;
        let number = line.number;
        let mut values = words(line.text);
        let missing = |name: &str| {
            error::row(number, format!("expected a value for `{name}`, found the end of the line"))
        };
        for (property, size) in element.properties.iter().zip(&mut sizes) {
            let word = values.next().ok_or_else(|| missing(&property.name))?;
            *size += word.len() as u64;
            if let PropertyType::List { .. } = property.kind {
                let length: u64 = parsed(word).ok_or_else(|| {
                    error::row(
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
            return Err(error::row(
                number,
                format!("expected the end of the line, found `{}`", shown(extra)),
            ));
        }
    }
    Ok(sizes)
}
