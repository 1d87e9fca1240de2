//! Finds the meaning of a string in a graph file.
//!
//! [`at`] uses only the text before the string, because the file may be incomplete while it is edited.

use splatgraph_framework::source::nearest;
use std::ops::Range;

/// Meaning of a string at a position in a graph file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// A block or an image variable of the pass's shaders, as a key of `bind`.
    Block {
        /// Shaders that the pass names in the scanned text.
        shaders: Vec<String>,
    },
    /// A parameter of an included graph, as a key of `set` or in `Only`; or of a preset's graph.
    Parameter {
        /// The graph, if the include or the preset names it in the scanned text.
        graph: Option<String>,
    },
    /// A port of an included graph, as a key of `with`.
    Port {
        /// The graph, if the include names it in the scanned text.
        graph: Option<String>,
    },
    /// A resource, or an expression that selects one.
    Resource,
    /// An expression over parameters, facts and `let`s.
    Expression,
    /// The value of a parameter in `set`: an expression, or one of the options of a choice.
    Value {
        /// The graph of the include or of the preset, if the scanned text names it.
        graph: Option<String>,
        parameter: String,
    },
    Shader {
        /// Extension of the shaders of this stage.
        extension: &'static str,
    },
    Graph,
    Format,
    /// An attribute of the scene, or a block of the frame.
    Import,
    /// A name that the graph defines, or free text.
    Free,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cursor {
    pub meaning: Meaning,
    /// Byte range between the quotes; up to the end of the line if the closing quote is missing.
    pub inside: Range<usize>,
}

/// A bracket with its contents: `()`, `[]` or `{}`; or the whole file.
#[derive(Clone, Debug, Default)]
pub struct Group {
    /// The name before the opening bracket, such as `Dispatch`; empty if there is none.
    pub name: String,
    /// The field or key that has the bracket as its value; empty if there is none.
    pub lead: String,
    /// Index of the enclosing bracket in [`Scan::groups`]; `None` for the file.
    pub parent: Option<usize>,
    /// True for a brace, which encloses a map.
    pub is_map: bool,
    /// Pairs of a field or key and its value, for values that are strings or names.
    pub values: Vec<(String, String)>,
}

impl Group {
    /// Returns the value of the field or key `key`; `None` unless it is a string or a name.
    pub fn value(&self, key: &str) -> Option<&str> {
        self.values.iter().find(|(other, _)| other == key).map(|(_, value)| value.as_str())
    }
}

#[derive(Clone, Debug)]
pub struct Text {
    /// Byte range between the quotes.
    pub inside: Range<usize>,
    /// Index of the innermost bracket around the string in [`Scan::groups`].
    pub group: usize,
    /// The field or key that has the string as its value; `None` for a list's element and for a key.
    pub key: Option<String>,
}

#[derive(Debug)]
pub struct Scan {
    /// Brackets, in the order of the file; the first is the file itself.
    pub groups: Vec<Group>,
    pub texts: Vec<Text>,
}

impl Scan {
    /// Scans a whole file, which may have syntax errors.
    pub fn of(text: &str) -> Scan {
        scan(text, None)
    }

    /// Lists a bracket, given by its index, and the brackets around it, the innermost first.
    pub fn around(&self, group: usize) -> impl Iterator<Item = &Group> {
        std::iter::successors(self.groups.get(group), |group| self.groups.get(group.parent?))
    }

    pub fn meaning(&self, text: &Text) -> Meaning {
        meaning(&self.around(text.group).collect::<Vec<_>>(), text.key.as_deref())
    }
}

/// Finds the string that contains byte `offset`; `None` outside of all strings, and in comments.
pub fn at(text: &str, offset: usize) -> Option<Cursor> {
    let scan = scan(text, Some(offset));
    let last = scan.texts.last().filter(|last| (last.inside.start..=last.inside.end).contains(&offset))?;
    Some(Cursor { meaning: scan.meaning(last), inside: last.inside.clone() })
}

/// Scans a file up to byte `stop` or to the end of the string that contains it. Without `stop`, scans the whole file.
fn scan(text: &str, stop: Option<usize>) -> Scan {
    let bytes = text.as_bytes();
    let mut scan = Scan { groups: vec![Group::default()], texts: Vec::new() };
    // Open brackets, each with the field or key whose value comes next.
    let mut open: Vec<(usize, Option<String>)> = vec![(0, None)];
    // The last name or string. A colon after it makes it a key, an opening bracket the name of the group.
    let mut last = String::new();
    let mut at = 0;
    while at < stop.unwrap_or(bytes.len()).min(bytes.len()) {
        let rest = &text[at..];
        let Some((group, key)) = open.last_mut() else { break };
        match bytes[at] {
            b'/' if rest.starts_with("//") => at += rest.find('\n').unwrap_or(rest.len()),
            b'/' if rest.starts_with("/*") => at += rest.find("*/").map_or(rest.len(), |end| end + 2),
            b'"' => {
                let inside = at + 1..end_of_text(text, at + 1, stop);
                scan.texts.push(Text { inside: inside.clone(), group: *group, key: key.clone() });
                if stop.is_some_and(|stop| (inside.start..=inside.end).contains(&stop)) {
                    break;
                }
                last = text[inside.clone()].to_owned();
                if let Some(key) = key {
                    scan.groups[*group].values.push((key.clone(), last.clone()));
                }
                at = inside.end + 1;
            }
            b':' => {
                *key = Some(std::mem::take(&mut last));
                at += 1;
            }
            b',' => {
                *key = None;
                last.clear();
                at += 1;
            }
            bracket @ (b'(' | b'[' | b'{') => {
                let (parent, lead) = (Some(*group), key.clone().unwrap_or_default());
                let name = std::mem::take(&mut last);
                open.push((scan.groups.len(), None));
                scan.groups.push(Group { name, lead, parent, is_map: bracket == b'{', values: Vec::new() });
                at += 1;
            }
            b')' | b']' | b'}' => {
                if open.len() > 1 {
                    open.pop();
                }
                last.clear();
                at += 1;
            }
            byte if byte.is_ascii_alphabetic() || byte == b'_' => {
                let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len());
                last = rest[..end].to_owned();
                if let Some(key) = key {
                    scan.groups[*group].values.push((key.clone(), last.clone()));
                }
                at += end;
            }
            _ => at += rest.chars().next().map_or(1, char::len_utf8),
        }
    }
    scan
}

/// Returns the byte offset of the quote that ends a string, or that of its line's end if the quote is missing.
///
/// A string may span several lines. But if it begins in the line of byte `offset`, it may be unfinished, and ends with
/// that line at the latest, so that it does not swallow the rest of the file.
fn end_of_text(text: &str, start: usize, offset: Option<usize>) -> usize {
    let last = match offset {
        Some(offset) if !text[start..offset].contains('\n') => {
            text[offset..].find('\n').map_or(text.len(), |end| offset + end)
        }
        _ => text.len(),
    };
    let mut escaped = false;
    for (at, c) in text[start..last].char_indices() {
        if c == '"' && !escaped {
            return start + at;
        }
        escaped = c == '\\' && !escaped;
    }
    text[start..last].find('\n').map_or(last, |end| start + end)
}

/// Determines the meaning of the value of `key`. `around` lists the brackets around it, innermost first.
fn meaning(around: &[&Group], key: Option<&str>) -> Meaning {
    let Some((group, around)) = around.split_first() else { return Meaning::Free };
    let graph = |include: &&Group| include.value("graph").map(str::to_owned);
    let is_in = |map: &str| around.first().is_some_and(|group| group.is_map && group.lead == map);
    match (key, group.lead.as_str()) {
        (None, "bind") if group.is_map => {
            Meaning::Block { shaders: around.first().map(|pass| shaders(pass)).unwrap_or_default() }
        }
        (None, "set") if group.is_map => Meaning::Parameter { graph: around.first().and_then(graph) },
        (None, "with") if group.is_map => Meaning::Port { graph: around.first().and_then(graph) },
        (None, _) if group.is_map => Meaning::Free,
        (None, _) if around.first().is_some_and(|around| around.name == "Only") => {
            let include = around.iter().find(|around| around.name == "Include");
            Meaning::Parameter { graph: include.and_then(graph) }
        }
        (Some(parameter), "set") if group.is_map => {
            let graph = around.first().and_then(graph);
            Meaning::Value { graph, parameter: parameter.to_owned() }
        }
        (Some(_), "bind" | "with" | "outputs") if group.is_map => Meaning::Resource,
        (Some("image" | "buffer" | "output"), _) => Meaning::Resource,
        (Some("shader"), _) => Meaning::Shader { extension: "comp" },
        (Some("vertex"), _) => Meaning::Shader { extension: "vert" },
        (Some("fragment"), _) => Meaning::Shader { extension: "frag" },
        (Some("graph"), _) => Meaning::Graph,
        (Some("format"), _) => Meaning::Format,
        (Some("from"), _) if group.name == "Import" || is_in("imports") => Meaning::Import,
        (Some("name" | "phase" | "summary" | "label" | "help" | "var" | "grows" | "of"), _) => Meaning::Free,
        (None, _) if matches!(group.name.as_str(), "Swap" | "Indirect") => Meaning::Resource,
        // The buffer of a statistic.
        (None, _) if is_in("stats") => Meaning::Resource,
        (None, "of" | "expose") => Meaning::Free,
        _ => Meaning::Expression,
    }
}

/// Lists the shaders that a pass names. An expression may choose one of several.
pub fn shaders(pass: &Group) -> Vec<String> {
    let named = |key: &str| ["shader", "vertex", "fragment"].contains(&key);
    let texts = pass.values.iter().filter(|(key, _)| named(key)).map(|(_, text)| text.as_str());
    let names = texts.flat_map(|text| match text.contains('\'') {
        true => text.split('\'').filter(|part| is_shader(part)).collect(),
        false => vec![text],
    });
    names.map(str::to_owned).collect()
}

pub fn is_shader(name: &str) -> bool {
    [".comp", ".vert", ".frag"].iter().any(|extension| name.ends_with(extension))
}

/// Returns true for RON that is not meant as a graph, such as a list of scenes or other settings.
pub fn is_foreign(scan: &Scan) -> bool {
    let is_document = |name: &str| nearest(name, ["Graph", "Preset", "Choice"]).is_some();
    !scan.groups.iter().any(|group| group.parent == Some(0) && is_document(&group.name))
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

    #[test]
    fn a_string_without_an_end_does_not_swallow_the_lines_after_it() {
        let scan = Scan::of("Graph(output: \"picture,\n passes: [Fill(value: 0)])");
        let names: Vec<&str> = scan.groups.iter().map(|group| group.name.as_str()).collect();
        assert_eq!(names, ["", "Graph", "", "Fill"]);
    }

    /// `|` marks the cursor.
    fn meaning_at(marked: &str) -> Option<Meaning> {
        let offset = marked.find('|').expect("a mark");
        at(&marked.replacen('|', "", 1), offset).map(|cursor| cursor.meaning)
    }

    #[test]
    fn texts_mean_what_stands_before_them_says_even_in_a_file_that_is_not_finished() {
        let shaders = vec!["a.vert".to_owned(), "a.frag".to_owned()];
        let draw = "Graph(passes: [Draw(name: \"d\", vertex: \"a.vert\", fragment: \"a.frag\", bind: {";
        let parameter = |graph: &str| Some(Meaning::Parameter { graph: Some(graph.to_owned()) });
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
            ("imports: { \"p\": (from: \"sc|".into(), Some(Meaning::Import)),
            ("resources: { \"p\": Image(format: \"|".into(), Some(Meaning::Format)),
            ("Include(graph: \"parts/|".into(), Some(Meaning::Graph)),
            ("Include(graph: \"a\", set: { \"n\": 1, \"w|".into(), parameter("a")),
            ("Include(graph: \"a\", with: { \"k|".into(), Some(Meaning::Port { graph: Some("a".into()) })),
            ("Include(graph: \"a\", expose: Only([\"w|".into(), parameter("a")),
            ("Preset(graph: \"b\", set: { \"|".into(), parameter("b")),
            (
                "Preset(graph: \"b\", set: { \"n\": \"|".into(),
                Some(Meaning::Value { graph: Some("b".into()), parameter: "n".into() }),
            ),
            ("Dispatch(shader: \"|".into(), Some(Meaning::Shader { extension: "comp" })),
            ("Draw(vertex: \"|".into(), Some(Meaning::Shader { extension: "vert" })),
            ("Draw(vertex: \"a.vert\", fragment: \"|".into(), Some(Meaning::Shader { extension: "frag" })),
            ("help: \"one\n two\n three\", \n let: { \"n\": \"|".into(), Some(Meaning::Expression)),
            ("Import(help: \"a \\\"quoted\\\" word\", from: \"|".into(), Some(Meaning::Import)),
            ("// a \"comment|\"".into(), None),
            ("Graph(version: 1|".into(), None),
        ] {
            assert_eq!(meaning_at(&text), expected, "{text}");
        }
    }
}
