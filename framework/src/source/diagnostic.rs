//! Defines diagnostics: errors and warnings with source spans and suggestions.

use std::collections::HashSet;
use std::fmt;

use crate::ir::Span;

/// A span with a text to show under it, which may be empty.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Label {
    /// The source range to underline.
    pub span: Span,
    /// The text drawn under the span.
    pub text: String,
}

/// An error or a warning about a range of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// The message: one sentence, in lower case and without a full stop.
    pub message: String,
    /// The place of the mistake, with a label.
    pub primary: Label,
    /// Related places, possibly in other files.
    pub secondary: Vec<Label>,
    /// Suggested corrections, one paragraph each.
    pub help: Vec<String>,
}

impl Diagnostic {
    /// Creates a diagnostic at `span`, with `label` shown under it (empty for none). Overlong names are shortened.
    pub fn new(message: impl Into<String>, span: Span, label: impl Into<String>) -> Self {
        let primary = Label { span, text: clipped(label.into()) };
        Diagnostic { message: clipped(message.into()), primary, secondary: Vec::new(), help: Vec::new() }
    }

    /// Adds a secondary label at a related place.
    pub fn with_label(mut self, span: Span, text: impl Into<String>) -> Self {
        self.secondary.push(Label { span, text: clipped(text.into()) });
        self
    }

    /// Adds a suggestion.
    pub fn with_help(mut self, text: impl Into<String>) -> Self {
        self.help.push(clipped(text.into()));
        self
    }

    /// Removes diagnostics that repeat the message and the place of an earlier one. A file that is included twice
    /// reports each error twice.
    pub fn distinct(mut all: Vec<Diagnostic>) -> Vec<Diagnostic> {
        let mut seen = HashSet::new();
        all.retain(|new| seen.insert((new.primary.span, new.message.clone())));
        all
    }

    /// Suggests the candidate nearest to `name`. If none is near, adds `otherwise` as help, unless it is empty.
    pub fn with_nearest<'a>(
        self,
        name: &str,
        candidates: impl IntoIterator<Item = &'a str>,
        otherwise: impl Into<String>,
    ) -> Self {
        let otherwise = otherwise.into();
        match nearest(name, candidates) {
            Some(near) => self.with_help(format!("did you mean `{near}`?")),
            None if otherwise.is_empty() => self,
            None => self.with_help(otherwise),
        }
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Diagnostic {}

/// Maximum length of a quoted name in a message, in bytes. Longer ones have dots in the middle: a missing quote in a
/// file turns many lines into a name.
const MAX_QUOTED: usize = 200;
/// Maximum length of a word in a message, in bytes; paths may be long.
const MAX_WORD: usize = 300;

/// Shortens the quoted names and the words of a message that are too long.
fn clipped(text: String) -> String {
    if text.len() <= MAX_QUOTED {
        return text;
    }
    let clip = |part: &str, most: usize| match part.len() > most {
        false => part.to_string(),
        true => format!(
            "{}...{}",
            &part[..part.floor_char_boundary(most / 2)],
            &part[part.ceil_char_boundary(part.len() - most / 2)..]
        ),
    };
    let words = |part: &str| part.split(' ').map(|word| clip(word, MAX_WORD)).collect::<Vec<_>>().join(" ");
    let parts = text.split('`').enumerate().map(|(index, part)| match index % 2 {
        0 => words(part),
        _ => clip(part, MAX_QUOTED),
    });
    parts.collect::<Vec<_>>().join("`")
}

/// Maximum length of a name to compare, in characters, because comparing takes quadratic time.
const MAX_NAME: usize = 256;

/// Returns the candidate most similar to `name`, for a "did you mean" suggestion.
///
/// A candidate that differs only in case wins. Otherwise the nearest by Damerau-Levenshtein distance wins; of equally
/// near ones, the first that begins with `name`, or else the first. `None` if every character would change, if the
/// distance is more than 1 and more than a third of the name's length, or if the name has more than 256 characters.
pub fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let length = name.chars().count();
    if length > MAX_NAME {
        return None;
    }
    let limit = (length / 3).max(1);
    let mut best: Option<((usize, bool), &str)> = None;
    for candidate in candidates {
        if candidate != name && candidate.to_lowercase() == name.to_lowercase() {
            return Some(candidate);
        }
        let candidate_length = candidate.chars().count();
        // The distance is at least the difference of the lengths.
        if candidate_length.abs_diff(length) > limit {
            continue;
        }
        let distance = strsim::damerau_levenshtein(name, candidate);
        let something_stays = distance < length.max(candidate_length);
        let rank = (distance, !candidate.starts_with(name));
        if distance <= limit && something_stays && best.is_none_or(|(least, _)| rank < least) {
            best = Some((rank, candidate));
        }
    }
    best.map(|(_, candidate)| candidate)
}
