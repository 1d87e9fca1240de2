//! Reads JSON documents, and limits the memory that parsing them takes.

use crate::error::{SceneError, field};
use crate::input::Source;
use crate::memory::{self, display};
use std::collections::BTreeSet;

/// Upper bound of the memory for a parsed object of glTF, in bytes. A node of splats was measured at 1137, an accessor
/// of a mesh at 696. A growing list briefly exists twice.
pub(crate) const GLTF_OBJECT: u64 = 1200;

/// Upper bound of the memory for a parsed object of a streamed SOG, in bytes. The largest are a map with one run and a
/// list with one node. An object of a `.rad` takes less.
pub(crate) const STREAMED_OBJECT: u64 = 320;

/// Upper bound of the memory for any other byte outside of strings, in bytes. An error about an index in a list takes
/// 76. A string, such as a buffer in base 64, takes no more memory than its text.
const OTHER_BYTE: u64 = 80;

/// Reads a document of `length` bytes at offset `at` of a source.
///
/// Fails if it has more than `most` bytes, or may need more than the available memory to parse. `object` is the memory
/// for a parsed object, in bytes.
pub(crate) fn read(
    source: &Source,
    (at, length): (u64, u64),
    most: u64,
    object: u64,
) -> Result<Vec<u8>, SceneError> {
    if length > most {
        return Err(field(at, "JSON", format!("expected at most {most} bytes, found {length}")));
    }
    let text = source.bytes(at, length as usize)?;
    check(&text, object).map_err(|message| field(at, "JSON", message))?;
    Ok(text)
}

/// Checks that a document can be parsed within the available memory. `object` is the memory for a parsed object, in
/// bytes. The error is the message.
pub(crate) fn check(text: &[u8], object: u64) -> Result<(), String> {
    check_against(text, object, memory::available())
}

fn check_against(text: &[u8], object: u64, available: Option<u64>) -> Result<(), String> {
    let (objects, others) = structure(text);
    let needed = objects * object + others * OTHER_BYTE;
    match available {
        Some(available) if needed > available => Err(format!(
            "expected JSON that fits in memory, found {objects} objects and {others} other bytes outside of strings, which can need {}, of {} available",
            display(needed),
            display(available)
        )),
        _ => Ok(()),
    }
}

/// Counts the objects, and the other bytes outside of strings: blanks do not count, quotation marks do.
fn structure(text: &[u8]) -> (u64, u64) {
    let (mut objects, mut others) = (0, 0);
    for (outside, string) in parts(text) {
        for byte in outside.iter().filter(|byte| !byte.is_ascii_whitespace()) {
            *(if *byte == b'{' { &mut objects } else { &mut others }) += 1;
        }
        others += 2 * u64::from(string.is_some());
    }
    (objects, others)
}

/// Lists the strings of a text that have 1 to `most` bytes, names of fields included, each once.
pub(crate) fn strings(text: &[u8], most: usize) -> BTreeSet<String> {
    let fits = |string: &&[u8]| (1..=most).contains(&string.len());
    let raw: BTreeSet<&[u8]> = parts(text).filter_map(|(_, string)| string).filter(fits).collect();
    raw.iter().filter_map(|raw| serde_json::from_slice(&[b"\"", *raw, b"\""].concat()).ok()).collect()
}

/// Splits a text into pairs: the bytes before a string, and the string without its quotation marks. The last pair has
/// no string, unless the text ends inside one.
fn parts(text: &[u8]) -> impl Iterator<Item = (&[u8], Option<&[u8]>)> {
    let mut rest = Some(text);
    std::iter::from_fn(move || {
        let text = rest.take()?;
        let Some(start) = text.iter().position(|byte| *byte == b'"') else { return Some((text, None)) };
        let mut end = start + 1;
        while let Some(byte) = text.get(end).filter(|byte| **byte != b'"') {
            end += 1 + usize::from(*byte == b'\\');
        }
        // The end of the string, or of an unfinished one.
        rest = text.get(end + 1..);
        Some((&text[..start], Some(&text[start + 1..end.min(text.len())])))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_within_strings_and_blanks_do_not_count() {
        assert_eq!(structure(br#" { "a" : [ 1, "{[\"\\" ], "b":"" } "#), (1, 16));
        assert_eq!(structure(br#"["a\"#), (0, 3));
        assert_eq!(structure(br#"["a"#), (0, 3));
        assert_eq!(structure(b""), (0, 0));
    }

    #[test]
    fn strings_are_listed_once_without_their_escapes() {
        let text = br#"{"a": ["b\"", "", "a"], "a long one": "\u0063", "unfinished"#;
        assert_eq!(strings(text, 9).into_iter().collect::<Vec<_>>(), ["a", "b\"", "c"]);
    }

    #[test]
    fn json_that_can_need_more_than_the_memory_is_refused() {
        let needed = 2 * GLTF_OBJECT + 5 * OTHER_BYTE;
        assert_eq!(check_against(b"[{}, {}]", GLTF_OBJECT, Some(needed)), Ok(()));
        assert_eq!(check_against(b"[{}, {}]", GLTF_OBJECT, None), Ok(()));
        let said = check_against(b"[{}, {}]", GLTF_OBJECT, Some(needed - 1)).unwrap_err();
        assert!(
            said.ends_with("found 2 objects and 5 other bytes outside of strings, which can need 2.7 KiB, of 2.7 KiB available"),
            "{said}"
        );
    }

    #[test]
    fn documents_of_large_scenes_are_accepted_and_empty_objects_by_the_million_are_not() {
        let fits = |entry: &str, count: usize, object| {
            check_against(entry.repeat(count).as_bytes(), object, Some(4 << 30)).is_ok()
        };
        // A part of a model: a node, a mesh, a material, four accessors and four views, in 900 bytes.
        let part = "{},".repeat(12) + &"0,".repeat(432);
        assert!(fits(&part, 15_000, GLTF_OBJECT));
        let run = r#""0":{"file":10,"offset":100000,"count":5000},"#;
        let leaf = format!(
            r#"{{"bound":{{"min":[-10.25,-10.25,-10.25],"max":[10.25,10.25,10.25]}},"lods":{{{}}}}},"#,
            run.repeat(6)
        );
        assert!(fits(&leaf, 31_000, STREAMED_OBJECT));
        assert!(!fits("{},", 4 << 20, GLTF_OBJECT));
        assert!(!fits("{},", 16 << 20, STREAMED_OBJECT));
    }
}
