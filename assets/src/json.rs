//! Limits the memory that parsing a JSON document takes.

use crate::memory::{self, display};

/// Maximum number of bytes outside of strings, without blanks. A string, such as a buffer in base 64, takes no more memory
/// than its text, but an empty object of two bytes can become a struct of hundreds.
const MAX_STRUCTURE: u64 = 8 << 20;

/// Most bytes of memory that a byte outside of strings was measured to take: 191 in the nodes of a mesh, 379 in the nodes
/// of splats. A list that grows exists twice for a moment.
const MEMORY_PER_BYTE: u64 = 384;

/// Checks that a document can be parsed within the available memory. The error is the message.
pub(crate) fn check(text: &[u8]) -> Result<(), String> {
    check_against(text, memory::available())
}

fn check_against(text: &[u8], available: Option<u64>) -> Result<(), String> {
    let found = structure(text);
    if found > MAX_STRUCTURE {
        return Err(format!(
            "expected JSON with at most {MAX_STRUCTURE} bytes outside of strings, found {found}"
        ));
    }
    let needed = found * MEMORY_PER_BYTE;
    match available {
        Some(available) if needed > available => Err(format!(
            "expected JSON that fits in memory, found {found} bytes outside of strings, which can need {}, of {} available",
            display(needed),
            display(available)
        )),
        _ => Ok(()),
    }
}

/// Counts the bytes outside of strings, without blanks. Quotation marks count.
fn structure(mut text: &[u8]) -> u64 {
    let mut count = 0;
    while let Some(start) = text.iter().position(|byte| *byte == b'"') {
        count += 2 + visible(&text[..start]);
        text = &text[start + 1..];
        // The end of the string, or of an unfinished one.
        loop {
            let Some(end) = text.iter().position(|byte| matches!(byte, b'"' | b'\\')) else { return count };
            let escaped = text[end] == b'\\';
            text = text.get(end + 1 + usize::from(escaped)..).unwrap_or_default();
            if !escaped {
                break;
            }
        }
    }
    count + visible(text)
}

fn visible(text: &[u8]) -> u64 {
    text.iter().filter(|byte| !byte.is_ascii_whitespace()).count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_within_strings_and_blanks_do_not_count() {
        assert_eq!(structure(br#" { "a" : [ 1, "{[\"\\" ], "b":"" } "#), 17);
        assert_eq!(structure(br#"["a\"#), 3);
        assert_eq!(structure(b""), 0);
    }

    #[test]
    fn json_that_can_need_more_than_the_memory_is_refused() {
        assert_eq!(check_against(b"[{}, {}]", Some(8 * MEMORY_PER_BYTE)), Ok(()));
        let said = check_against(b"[{}, {}]", Some(7 * MEMORY_PER_BYTE - 1)).unwrap_err();
        assert!(
            said.ends_with("found 7 bytes outside of strings, which can need 2.6 KiB, of 2.6 KiB available"),
            "{said}"
        );
        let long = vec![b'0'; MAX_STRUCTURE as usize + 1];
        assert!(check_against(&long, None).unwrap_err().ends_with("found 8388609"));
    }
}
