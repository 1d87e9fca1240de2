//! Converts errors of the `ron` crate to diagnostics with precise spans.
//!
//! The crate reports the position of its cursor. Depending on the error, the cursor is before an unexpected value,
//! after an unknown name, or at the end of a struct that lacks a field. This module uses the [`Outline`] to find the
//! element at fault. The outline's parser runs first, so texts that it rejects do not get here.

use std::ops::Range;

use ron::error::{Error, Position, SpannedError};

use super::outline::{Content, Node, is_call, unquoted};
use super::{Diagnostic, Outline, nearest};

/// Converts an error of the `ron` crate to a diagnostic that points at the mistake in `text`.
///
/// `outline` is the outline of `text`. For an unknown field or variant, the diagnostic suggests the nearest existing
/// name. `read` parses a text as the same type as `text`: to list the names that are valid at a place, this function
/// inserts an unknown name there and parses again.
pub fn ron_error(
    outline: &Outline,
    text: &str,
    error: &SpannedError,
    read: &dyn Fn(&str) -> Result<(), SpannedError>,
) -> Diagnostic {
    let start = offset(text, error.span.start);
    let end = offset(text, error.span.end).max(start);
    Translator { outline, text, read, start, end }.diagnostic(&error.code)
}

/// Converts a line and a column (both from 1, in characters) to a byte offset, clamped to the text.
fn offset(text: &str, position: Position) -> usize {
    let line_start = match position.line {
        0 | 1 => 0,
        line => text.match_indices('\n').nth(line - 2).map_or(text.len(), |(at, _)| at + 1),
    };
    let line = text[line_start..].split('\n').next().unwrap_or_default();
    let column = position.col.saturating_sub(1);
    line_start + line.char_indices().nth(column).map_or(line.len(), |(at, _)| at)
}

struct Translator<'a> {
    outline: &'a Outline,
    text: &'a str,
    read: &'a dyn Fn(&str) -> Result<(), SpannedError>,
    /// Byte offset of the crate's cursor before its last token; `end` is after it.
    start: usize,
    end: usize,
}

impl Translator<'_> {
    fn diagnostic(&self, error: &Error) -> Diagnostic {
        if let Some(call) = self.call_at_cursor() {
            return unquoted(&self.text[call.clone()], self.outline.span(call));
        }
        match error {
            Error::NoSuchStructField { expected, found, outer } => {
                let of = outer.as_deref().map(|outer| format!(" in `{outer}`")).unwrap_or_default();
                match self.name_before_cursor(found).filter(|name| self.is_positional(name.start)) {
                    Some(place) => self.positional(place, &format!("`{found}`"), expected),
                    None => {
                        self.unknown_name(format!("unknown field `{found}`{of}"), found, expected, "fields")
                    }
                }
            }
            Error::NoSuchEnumVariant { expected, found, outer } => {
                let of = outer.as_deref().map(|outer| format!(" of `{outer}`")).unwrap_or_default();
                let message = format!("unknown variant `{found}`{of}");
                self.unknown_name(message, found, expected, "variants")
            }
            Error::MissingStructField { field, outer } => {
                let of = outer.as_deref().map(|outer| format!(" in `{outer}`")).unwrap_or_default();
                let place = self.outline.enclosing(self.end).shallow();
                let label = format!("this has no `{field}`");
                self.error(format!("the field `{field}` is missing{of}"), place, &label)
            }
            Error::DuplicateStructField { field, .. } => {
                let again = self.name_before_cursor(field).unwrap_or(self.start..self.end);
                let mut twice = self.outline.duplicates().iter();
                let known = twice.find(|error| error.primary.span.start == again.start);
                known.cloned().unwrap_or_else(|| {
                    self.error(format!("the field `{field}` is given twice"), again, "again here")
                })
            }
            Error::ExpectedDifferentStructName { expected, found } => {
                let place = self.name_before_cursor(found).unwrap_or(self.start..self.end);
                let label = format!("write `{expected}`, or nothing, before the `(`");
                self.error(format!("expected `{expected}`, found `{found}`"), place, &label)
            }
            // The crate parses a bare name as a unit value.
            Error::InvalidValueForType { expected, .. }
                if expected.contains("in quotes") && is_name(&self.text[self.value_at_cursor()]) =>
            {
                let place = self.value_at_cursor();
                match self.key_for_position() {
                    Some(key) => self.named(expected, key),
                    None => unquoted(&self.text[place.clone()], self.outline.span(place)),
                }
            }
            Error::InvalidValueForType { expected, found } => {
                let (message, place) =
                    (format!("expected {expected}, found {found}"), self.value_at_cursor());
                self.error(message, place, &format!("expected {expected}"))
            }
            Error::ExpectedDifferentLength { expected, found } => {
                let expected = without_type(expected);
                let elements = if *found == 1 { "element" } else { "elements" };
                let place = self.outline.enclosing(self.end).shallow();
                let label = format!("this has {found} {elements}");
                self.error(format!("expected {expected}, found {found} {elements}"), place, &label)
            }
            Error::IntegerOutOfBounds => {
                let place = self.value_at_cursor();
                let message = format!("expected an integer that fits, found {}", &self.text[place.clone()]);
                self.error(message, place, "too large or too small")
            }
            Error::Message(message) => self.error(message.as_str(), self.value_at_cursor(), ""),
            Error::ExceededRecursionLimit => self.error(
                "the file is nested too deeply",
                self.value_at_cursor(),
                "this level is one too many",
            ),
            Error::NoSuchExtension(name) => {
                let place = self.name_before_cursor(name).unwrap_or(self.start..self.end);
                self.error(format!("there is no RON extension `{name}`"), place, "")
            }
            Error::ExpectedComma if self.name_before_parentheses().is_some() => {
                let place = self.name_before_parentheses().unwrap_or_default();
                let message = format!("`{}` takes nothing in parentheses", &self.text[place.clone()]);
                self.error(message, place, "leave out the parentheses after this")
            }
            Error::ExpectedComma if self.cursor_is_inside_a_number() => self.wrong_kind_before("an integer"),
            Error::ExpectedStructLike if self.node_at_cursor().is_none() => {
                let place = self.value_at_cursor();
                let message = format!("`{}` needs parentheses after it", &self.text[place.clone()]);
                self.error(message, place, "expected `(` after this")
            }
            Error::ExpectedStructLikeEnd if self.node_at_cursor().is_some() => {
                let label = "one element too many";
                self.error("expected `)`", self.value_at_cursor(), label)
            }
            Error::ExpectedIdentifier | Error::SuggestRawIdentifier(_) if self.node_at_cursor().is_some() => {
                self.expected_name()
            }
            _ => match wanted(error) {
                Some(wanted) => self.wrong_kind(&wanted),
                None => {
                    let message = error.to_string();
                    let mut letters = message.chars();
                    let first = letters.next().map(|c| c.to_lowercase().to_string()).unwrap_or_default();
                    self.error(first + letters.as_str(), self.cursor(), "")
                }
            },
        }
    }

    fn unknown_name(&self, message: String, found: &str, expected: &[&str], what: &str) -> Diagnostic {
        let place = self.name_before_cursor(found).unwrap_or_else(|| self.value_at_cursor());
        let near = nearest(found, expected.iter().copied());
        let label = match near {
            Some(near) => format!("did you mean `{near}`?"),
            None => "no such name".to_string(),
        };
        let help = match expected {
            _ if SYNCHRONIZATION.contains(&found.to_lowercase().as_str()) => {
                "order and barriers follow from what the shaders read and write: `splatgraph dump` shows them"
                    .into()
            }
            [] => format!("there are no {what} here"),
            [only] => format!("the only one is `{only}`"),
            _ => format!("the {what} are {}", expected.join(", ")),
        };
        self.error(message, place, &label).with_help(help)
    }

    /// Returns the error for a value of the wrong type; `wanted` describes the expected type.
    fn wrong_kind(&self, wanted: &str) -> Diagnostic {
        let place = self.value_at_cursor();
        let Some(node) = self.node_at_cursor() else {
            if let Some(key) = self.key_for_position() {
                return self.named(wanted, key);
            }
            let (found, place) = match self.outline.key_at(self.end) {
                Some(key) => (format!(", found `{}`", &self.text[key.clone()]), key),
                None => (String::new(), place),
            };
            return self.error(format!("expected {wanted}{found}"), place, &format!("expected {wanted}"));
        };
        let found = self.describe(node);
        let error =
            self.error(format!("expected {wanted}, found {found}"), place, &format!("expected {wanted}"));
        match &node.content {
            Content::List { bracket: '[', .. } if wanted == TUPLE => {
                error.with_help("write `(` and `)` in place of `[` and `]`")
            }
            _ => error,
        }
    }

    fn describe(&self, node: &Node) -> String {
        let head = &self.text[node.head.clone()];
        match &node.content {
            Content::Text(_) => "a string".to_string(),
            Content::Scalar | Content::Record { bracket: '(', .. } | Content::List { bracket: '(', .. }
                if !head.starts_with('(') =>
            {
                format!("`{head}`")
            }
            Content::Record { bracket: '{', .. } => "a map".to_string(),
            Content::List { bracket: '[', .. } => "a list".to_string(),
            _ => "`(`".to_string(),
        }
    }

    /// Returns the error for a value where a variant's name or a field `name: value` is expected.
    fn expected_name(&self) -> Diagnostic {
        let Some(node) = self.node_at_cursor() else { return self.wrong_kind(NAME) };
        let mut probe = self.text.to_string();
        probe.insert_str(node.place.start, "_: ");
        let expected = (self.read)(&probe).err().map(|error| error.code);
        let variants = match &expected {
            Some(Error::NoSuchStructField { expected, .. }) if self.is_positional(node.place.start) => {
                return self.positional(node.shallow(), &self.describe(node), expected);
            }
            Some(Error::NoSuchEnumVariant { expected, .. }) => expected,
            _ => &[][..],
        };
        let error = self.wrong_kind(NAME);
        match (&node.content, node.key.clone().map(|key| &self.text[key])) {
            (Content::Text(text), _) if variants.contains(&text.value.as_str()) => {
                error.with_help(format!("names are written without quotes: `{}`", text.value))
            }
            (Content::Text(text), Some("size")) => error.with_help(format!(
                "write `Threads(\"{0}\")` for invocations, or `Groups(\"{0}\")` for workgroups",
                text.value
            )),
            _ if variants.is_empty() => error,
            (Content::Record { bracket: '{', .. }, _) if variants.contains(&"Graph") => error.with_help(
                "a graph begins with `Graph(`, `Preset(` or `Choice(`; JSON, such as a plan that `dump` wrote, is no graph",
            ),
            _ => error.with_help(format!("the names here are {}", variants.join(", "))),
        }
    }

    /// Returns true if the element at `start` is in parentheses and has no name.
    fn is_positional(&self, start: usize) -> bool {
        let around = &self.outline.enclosing(start.saturating_sub(1)).content;
        matches!(around, Content::List { bracket: '(', .. })
    }

    /// Returns the error for a value without a field's name.
    fn positional(&self, place: Range<usize>, found: &str, fields: &[&str]) -> Diagnostic {
        let message = format!("expected a field `name: value`, found {found}");
        self.error(message, place, "has no name before it")
            .with_help(format!("the fields are {}", fields.join(", ")))
    }

    /// Returns the field name at the cursor if the parentheses around it expect values without names.
    fn key_for_position(&self) -> Option<Range<usize>> {
        let before = self.text[..self.end].trim_end();
        // After a value and its comma, the cursor is at the key of the next value.
        if before.ends_with(',') {
            return None;
        }
        let key = self.outline.key_at(self.end).or_else(|| self.outline.key_at(before.len()))?;
        let around = &self.outline.enclosing(key.start).content;
        matches!(around, Content::Record { bracket: '(', .. }).then_some(key)
    }

    /// Returns the error for a field name before a value that must have none.
    fn named(&self, wanted: &str, key: Range<usize>) -> Diagnostic {
        let name = &self.text[key.clone()];
        self.error(format!("expected {wanted}, found `{name}:`"), key, "the value here has no name")
            .with_help(format!("leave out `{name}:`"))
    }

    /// Returns the error for a value of the wrong type that was read only in part.
    fn wrong_kind_before(&self, wanted: &str) -> Diagnostic {
        let place = self.value_at_cursor();
        let message = format!("expected {wanted}, found `{}`", &self.text[place.clone()]);
        self.error(message, place, &format!("expected {wanted}"))
    }

    fn error(&self, message: impl Into<String>, place: Range<usize>, label: &str) -> Diagnostic {
        Diagnostic::new(message, self.outline.span(place), label)
    }

    /// Returns the span of the character at the cursor; empty at the end of a line.
    fn cursor(&self) -> Range<usize> {
        let width = self.text[self.end..].chars().next().filter(|c| *c != '\n').map_or(0, char::len_utf8);
        self.end..self.end + width
    }

    /// Finds the last `name` before the cursor, with only white space and quotes in between.
    fn name_before_cursor(&self, name: &str) -> Option<Range<usize>> {
        let start = self.text[..self.end].rfind(name)?;
        let between = &self.text[start + name.len()..self.end];
        let is_near = between.chars().all(|c| c.is_whitespace() || c == '"');
        (!name.is_empty() && is_near).then_some(start..start + name.len())
    }

    /// Returns the name before the cursor if parentheses open at the cursor.
    fn name_before_parentheses(&self) -> Option<Range<usize>> {
        let before = self.text[..self.end].trim_end();
        let start = before.trim_end_matches(|c: char| c.is_alphanumeric() || c == '_').len();
        let opens = self.text[self.end..].starts_with('(');
        (opens && is_name(&before[start..])).then_some(start..before.len())
    }

    /// Returns true if the cursor is inside a number. For a float in place of an integer, the crate stops at the point.
    fn cursor_is_inside_a_number(&self) -> bool {
        let node = self.outline.innermost(self.end);
        let place = &node.place;
        matches!(node.content, Content::Scalar)
            && (place.start + 1..place.end).contains(&self.end)
            && self.text[place.clone()]
                .starts_with(|c: char| c.is_ascii_digit() || matches!(c, '+' | '-' | '.'))
    }

    fn node_at_cursor(&self) -> Option<&Node> {
        self.outline.starting_at(self.end)
    }

    /// Returns the outermost call at the cursor, such as `max(a, b)`, or a negated name: expressions without quotes.
    fn call_at_cursor(&self) -> Option<Range<usize>> {
        let cursor = self.value_at_cursor().start;
        let is_expression = |node: &&Node| match node.content {
            Content::List { bracket: '(', .. } => is_call(self.text, &node.head),
            Content::Scalar => {
                self.text[node.place.clone()].starts_with('-')
                    && is_call(self.text, &(node.place.start + 1..node.place.end))
            }
            _ => false,
        };
        let nodes = self.outline.nodes.iter().filter(|node| node.place.contains(&cursor));
        nodes.filter(is_expression).map(|node| node.place.clone()).max_by_key(Range::len)
    }

    /// Returns the span of the element at the cursor, or of the element that ends before it.
    fn value_at_cursor(&self) -> Range<usize> {
        if let Some(node) = self.node_at_cursor() {
            return node.shallow();
        }
        // The cursor is after the comma and white space that follow the value.
        let before = self.text[..self.end].trim_end_matches(|c: char| c.is_whitespace() || c == ',');
        self.outline.innermost(before.len()).shallow()
    }
}

/// Names, in lower case, with which other programs order passes by hand.
const SYNCHRONIZATION: [&str; 7] =
    ["barrier", "after", "before", "depends_on", "dependencies", "reads", "writes"];

fn is_name(text: &str) -> bool {
    text.starts_with(char::is_alphabetic) && text.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// Removes Rust's name of a type from serde's description: `tuple variant Size::Indirect with 2 elements` becomes
/// `` `Indirect` with 2 elements``.
fn without_type(expected: &str) -> String {
    let parts = expected.split_once("::").and_then(|(_, rest)| rest.split_once(' '));
    parts.map_or_else(|| expected.to_string(), |(variant, rest)| format!("`{variant}` {rest}"))
}

const NAME: &str = "a name";
const TUPLE: &str = "`(a, b)`";

/// Describes the syntax that an error expected; `None` if the error does not say.
fn wanted(error: &Error) -> Option<String> {
    let wanted = match error {
        Error::ExpectedArray => "a list `[...]`",
        Error::ExpectedBoolean => "`true` or `false`",
        Error::ExpectedFloat => "a number",
        Error::ExpectedInteger => "an integer",
        Error::ExpectedMap => "a map `{...}`",
        Error::ExpectedNamedStructLike("") => "`(...)`",
        Error::ExpectedNamedStructLike(name) => return Some(format!("`{name}(...)`")),
        Error::ExpectedUnit => "`()`",
        Error::ExpectedString => "a string in double quotes",
        Error::ExpectedIdentifier | Error::SuggestRawIdentifier(_) => NAME,
        Error::ExpectedStructLike => TUPLE,
        Error::ExpectedComma => "a comma",
        Error::ExpectedArrayEnd => "`]`",
        Error::ExpectedMapEnd => "`}`",
        Error::ExpectedMapColon => "`:`",
        Error::ExpectedStructLikeEnd => "`)`",
        _ => return None,
    };
    Some(wanted.to_string())
}
