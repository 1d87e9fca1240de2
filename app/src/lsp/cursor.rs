//! Tells what a text in a graph file means, from what stands before it: the file may be broken while it is typed.

use std::ops::Range;

/// The meaning of the text around a place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// A block or an image variable of the pass's shaders: a key of `bind`.
    Block {
        /// The shaders of the pass that stand before it.
        shaders: Vec<String>,
    },
    /// A resource, or an expression that chooses one.
    Resource,
    /// An expression over parameters, facts and `let`s.
    Expression,
    /// A shader's file.
    Shader,
    /// A graph's file.
    Graph,
    /// The format of an image.
    Format,
    /// An attribute of the scene, or a block of the frame.
    Import,
    /// A name that the graph gives, or words.
    Free,
}

/// A text between quotes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cursor {
    /// The meaning.
    pub meaning: Meaning,
    /// The bytes between the quotes; up to the end of the line if the closing one is missing.
    pub inside: Range<usize>,
}

/// An open bracket with what is known of its contents.
#[derive(Default)]
struct Frame {
    /// The name before a parenthesis: `Dispatch`.
    name: String,
    /// The field or key that the bracket is the value of.
    lead: String,
    /// The field or key whose value comes.
    key: Option<String>,
    /// The bracket is a brace.
    is_map: bool,
    /// The texts of its fields so far.
    texts: Vec<(String, String)>,
}

/// Finds the text that holds byte `offset`; `None` outside of all texts, and in comments.
pub fn at(text: &str, offset: usize) -> Option<Cursor> {
    let bytes = text.as_bytes();
    let mut frames = vec![Frame::default()];
    // The last name or text, which a colon makes a key and a parenthesis a name.
    let mut last = String::new();
    let mut at = 0;
    while at < bytes.len() && at < offset {
        let rest = &text[at..];
        let frame = frames.last_mut()?;
        match bytes[at] {
            b'/' if rest.starts_with("//") => at += rest.find('\n').unwrap_or(rest.len()),
            b'/' if rest.starts_with("/*") => at += rest.find("*/").map_or(rest.len(), |end| end + 2),
            b'"' => {
                let inside = at + 1..end_of_text(text, at + 1, offset);
                if (inside.start..=inside.end).contains(&offset) {
                    return Some(Cursor { meaning: meaning(&frames), inside });
                }
                last = text[inside.clone()].to_owned();
                if let Some(key) = &frame.key {
                    frame.texts.push((key.clone(), last.clone()));
                }
                at = inside.end + 1;
            }
            b':' => {
                frame.key = Some(std::mem::take(&mut last));
                at += 1;
            }
            b',' => {
                frame.key = None;
                last.clear();
                at += 1;
            }
            open @ (b'(' | b'[' | b'{') => {
                let lead = frame.key.clone().unwrap_or_default();
                let name = std::mem::take(&mut last);
                frames.push(Frame { name, lead, is_map: open == b'{', ..Frame::default() });
                at += 1;
            }
            b')' | b']' | b'}' => {
                if frames.len() > 1 {
                    frames.pop();
                }
                last.clear();
                at += 1;
            }
            byte if byte.is_ascii_alphabetic() || byte == b'_' => {
                let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len());
                last = rest[..end].to_owned();
                at += end;
            }
            _ => at += rest.chars().next().map_or(1, char::len_utf8),
        }
    }
    None
}

/// Returns the byte of the quote that ends a text.
///
/// A text may run over lines. But one that begins in the line of byte `offset` may be unfinished, and would swallow the file: it ends
/// with that line.
fn end_of_text(text: &str, start: usize, offset: usize) -> usize {
    let last = match text[start..offset].contains('\n') {
        true => text.len(),
        false => text[offset..].find('\n').map_or(text.len(), |end| offset + end),
    };
    let mut escaped = false;
    for (at, c) in text[start..last].char_indices() {
        if c == '"' && !escaped {
            return start + at;
        }
        escaped = c == '\\' && !escaped;
    }
    last
}

fn meaning(frames: &[Frame]) -> Meaning {
    let Some((frame, around)) = frames.split_last() else { return Meaning::Free };
    let shaders = |pass: &Frame| {
        let named = |key: &str| ["shader", "vertex", "fragment"].contains(&key);
        pass.texts.iter().filter(|(key, _)| named(key)).map(|(_, text)| text.clone()).collect()
    };
    match (frame.key.as_deref(), frame.lead.as_str()) {
        (None, "bind") if frame.is_map => {
            Meaning::Block { shaders: around.last().map(shaders).unwrap_or_default() }
        }
        (None, _) if frame.is_map => Meaning::Free,
        (Some(_), "bind" | "with") if frame.is_map => Meaning::Resource,
        (Some("image" | "buffer" | "output"), _) => Meaning::Resource,
        (Some("shader" | "vertex" | "fragment"), _) => Meaning::Shader,
        (Some("graph"), _) => Meaning::Graph,
        (Some("format"), _) => Meaning::Format,
        (Some("from"), _) if frame.name == "Import" => Meaning::Import,
        (Some("name" | "phase" | "summary" | "label" | "help" | "var" | "grows" | "of"), _) => Meaning::Free,
        (None, _) if matches!(frame.name.as_str(), "Swap" | "Indirect") => Meaning::Resource,
        // The buffer of a statistic.
        (None, _) if around.last().is_some_and(|map| map.is_map && map.lead == "stats") => Meaning::Resource,
        (None, "of" | "expose") => Meaning::Free,
        (None, _) if frame.name == "Only" => Meaning::Free,
        _ => Meaning::Expression,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_text_and_no_place_in_it_panics(text in "[\"\\\\(){}\\[\\],:a-dä/*\n ]{0,60}") {
            for offset in (0..=text.len()).filter(|at| text.is_char_boundary(*at)) {
                if let Some(cursor) = at(&text, offset) {
                    prop_assert!((cursor.inside.start..=cursor.inside.end).contains(&offset));
                    prop_assert!(text.get(cursor.inside).is_some());
                }
            }
        }
    }

    /// The meaning of the text in which the mark `|` stands.
    fn meaning_at(marked: &str) -> Option<Meaning> {
        let offset = marked.find('|').expect("a mark");
        at(&marked.replacen('|', "", 1), offset).map(|cursor| cursor.meaning)
    }

    #[test]
    fn texts_mean_what_stands_before_them_says_even_in_a_file_that_is_not_finished() {
        let shaders = vec!["a.vert".to_owned(), "a.frag".to_owned()];
        let draw = "Graph(passes: [Draw(name: \"d\", vertex: \"a.vert\", fragment: \"a.frag\", bind: {";
        for (text, expected) in [
            (format!("{draw} \"|"), Some(Meaning::Block { shaders: shaders.clone() })),
            (format!("{draw} \"Camera\": \"camera\", \"Ke|\n  passes"), Some(Meaning::Block { shaders })),
            (format!("{draw} \"Camera\": \"ca|\" }}"), Some(Meaning::Resource)),
            ("Graph(let: { \"n\": \"scene.|\" }".into(), Some(Meaning::Expression)),
            ("Graph(let: { \"|\"".into(), Some(Meaning::Free)),
            ("Dispatch(name: \"a\", size: Threads(\"ceil|".into(), Some(Meaning::Expression)),
            ("Dispatch(name: \"a|".into(), Some(Meaning::Free)),
            ("Dispatch(size: Indirect(\"ar|".into(), Some(Meaning::Resource)),
            ("stats: { \"seen\": (\"ar|".into(), Some(Meaning::Resource)),
            ("imports: { \"p\": Import(from: \"sc|".into(), Some(Meaning::Import)),
            ("resources: { \"p\": Image(format: \"|".into(), Some(Meaning::Format)),
            ("Include(graph: \"parts/|".into(), Some(Meaning::Graph)),
            ("Dispatch(shader: \"|".into(), Some(Meaning::Shader)),
            ("help: \"one\n two\n three\", \n let: { \"n\": \"|".into(), Some(Meaning::Expression)),
            ("Import(help: \"a \\\"quoted\\\" word\", from: \"|".into(), Some(Meaning::Import)),
            ("// a \"comment|\"".into(), None),
            ("Graph(version: 1|".into(), None),
        ] {
            assert_eq!(meaning_at(&text), expected, "{text}");
        }
    }
}
