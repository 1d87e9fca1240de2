//! Diagnostics: errors and warnings with source spans and suggestions.

use std::fmt;

use crate::ir::Span;

/// A span with a text to show under it. The text may be empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Label {
    /// Range of the source text.
    pub span: Span,
    /// The text drawn under the span.
    pub text: String,
}

/// An error in a file, or a warning about one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// The message: a sentence in lower case without a full stop.
    pub message: String,
    /// The place of the mistake.
    pub primary: Label,
    /// Related places, in any file.
    pub secondary: Vec<Label>,
    /// Suggestions for a correction.
    pub help: Vec<String>,
}

impl Diagnostic {
    /// Creates an error at `span`, with a `label` under it, which may be empty.
    pub fn new(message: impl Into<String>, span: Span, label: impl Into<String>) -> Self {
        let primary = Label { span, text: label.into() };
        Diagnostic { message: message.into(), primary, secondary: Vec::new(), help: Vec::new() }
    }

    /// Adds a related place.
    pub fn with_label(mut self, span: Span, text: impl Into<String>) -> Self {
        self.secondary.push(Label { span, text: text.into() });
        self
    }

    /// Adds a hint.
    pub fn with_help(mut self, text: impl Into<String>) -> Self {
        self.help.push(text.into());
        self
    }

    /// Suggests the nearest of the valid names; if none is near, adds `otherwise`, unless it is empty.
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

/// Maximum length of names to compare, in bytes: a longer name is no typing mistake, and comparing it would take long.
const LONGEST_NAME: usize = 256;

/// Returns the candidate that `name` was probably meant to be: one that differs only in case, or else the nearest by
/// Damerau-Levenshtein distance (changes, insertions, deletions and transpositions count one); of equally near ones,
/// the first.
///
/// `None` if more than a third of the name, and more than one character, would have to change, or if no character would
/// stay.
pub fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let length = name.chars().count();
    if length > LONGEST_NAME {
        return None;
    }
    let limit = (length / 3).max(1);
    let mut best: Option<(usize, &str)> = None;
    for candidate in candidates {
        // Equal except for case.
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
        if distance <= limit && something_stays && best.is_none_or(|(least, _)| distance < least) {
            best = Some((distance, candidate));
        }
    }
    best.map(|(_, candidate)| candidate)
}
