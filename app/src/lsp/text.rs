//! Converts positions and file names between the editor's form and the framework's.

use crate::io::uri;
use lsp_types::{Position, Range, Uri};
use percent_encoding::{AsciiSet, CONTROLS, percent_decode_str, utf8_percent_encode};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// ASCII characters that RFC 3986 allows nowhere in the URI of a file. Editors leave some of them unencoded.
const FORBIDDEN: &AsciiSet = &CONTROLS
    .add(b' ')
    .add(b'"')
    .add(b'<')
    .add(b'>')
    .add(b'[')
    .add(b']')
    .add(b'\\')
    .add(b'^')
    .add(b'`')
    .add(b'{')
    .add(b'|')
    .add(b'}');

/// Percent-encodes what RFC 3986 forbids in the fields `uri` and `rootUri` of a message, because [`Uri`] rejects it.
pub fn with_strict_uris(mut params: Value) -> Value {
    fn visit(value: &mut Value) {
        match value {
            Value::Array(all) => all.iter_mut().for_each(visit),
            Value::Object(all) => {
                for (key, value) in all {
                    match value {
                        Value::String(uri) if key == "uri" || key == "rootUri" => {
                            *uri = utf8_percent_encode(uri, FORBIDDEN).to_string();
                        }
                        _ => visit(value),
                    }
                }
            }
            _ => {}
        }
    }
    visit(&mut params);
    params
}

/// Returns the path of a `file:` URI; `None` for a URI with another scheme, and for a path that is not UTF-8.
pub fn path_of(uri: &Uri) -> Option<PathBuf> {
    let rest = uri.as_str().strip_prefix("file://")?;
    // An authority, which is usually empty, ends at the first slash.
    let path = &rest[rest.find('/')?..];
    let path = percent_decode_str(path).decode_utf8().ok()?;
    Some(PathBuf::from(path.into_owned()))
}

/// Returns the URI of an absolute path; `None` if the path is not UTF-8.
pub fn uri_of(path: &Path) -> Option<Uri> {
    path.to_str()?;
    Uri::from_str(&format!("file://{}", uri::encoded(path))).ok()
}

/// Converts a position, in UTF-16 units, to a byte offset. A position after the end of its line gives the line's end,
/// and a line after the last one gives the end of the text.
pub fn offset_of(text: &str, position: Position) -> usize {
    let start = match position.line {
        0 => 0,
        line => text.match_indices('\n').nth(line as usize - 1).map_or(text.len(), |(at, _)| at + 1),
    };
    let line = text[start..].lines().next().unwrap_or_default();
    let mut units = 0;
    for (at, c) in line.char_indices() {
        if units >= position.character {
            return start + at;
        }
        units += c.len_utf16() as u32;
    }
    start + line.len()
}

/// Converts a byte offset to a position in UTF-16 units.
pub fn position_of(text: &str, offset: usize) -> Position {
    let before = &text[..offset.min(text.len())];
    let line = before.matches('\n').count() as u32;
    let start = before.rfind('\n').map_or(0, |at| at + 1);
    Position { line, character: before[start..].encode_utf16().count() as u32 }
}

/// Converts a range of bytes to the editor's form.
pub fn range_of(text: &str, bytes: std::ops::Range<usize>) -> Range {
    Range { start: position_of(text, bytes.start), end: position_of(text, bytes.end) }
}

/// Converts a line and a column, counted from 1 and in characters, to a position in UTF-16 units.
pub fn position_of_column(text: &str, line: u32, column: u32) -> Position {
    let line = line.saturating_sub(1);
    let characters = text.lines().nth(line as usize).unwrap_or_default().chars();
    let before = characters.take(column.saturating_sub(1) as usize);
    Position { line, character: before.map(|c| c.len_utf16() as u32).sum() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_with_spaces_and_umlauts_come_back_from_their_uri() {
        for path in ["/a/b.ron", "/with space/ä#?%.ron"] {
            let uri = uri_of(Path::new(path)).expect("a URI");
            assert!(!uri.as_str().contains([' ', '#', '?']), "{}", uri.as_str());
            assert_eq!(path_of(&uri), Some(path.into()));
        }
        assert_eq!(path_of(&Uri::from_str("untitled:1").expect("a URI")), None);
    }

    #[test]
    fn positions_count_units_of_utf_16() {
        let text = "a\n😀b\nc";
        let b = text.find('b').expect("there");
        assert_eq!(position_of(text, b), Position { line: 1, character: 2 });
        assert_eq!(offset_of(text, Position { line: 1, character: 2 }), b);
        assert_eq!(position_of_column(text, 2, 2), Position { line: 1, character: 2 });
        // After the end of a line, and after the end of the text.
        assert_eq!(offset_of(text, Position { line: 0, character: 9 }), 1);
        assert_eq!(offset_of(text, Position { line: 9, character: 0 }), text.len());
        let of_windows = "a\r\nb\r\n";
        assert_eq!(offset_of(of_windows, Position { line: 0, character: 9 }), 1);
        assert_eq!(offset_of(of_windows, Position { line: 1, character: 9 }), 4);
    }
}
