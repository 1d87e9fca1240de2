//! Converts diagnostics to an error with the rendered text, and to plain data.

use std::fmt;

use serde::Serialize;

use super::{Diagnostic, SourceMap, render};
use crate::ir::Span;

/// Errors of a graph and its shaders, rendered with the source text.
///
/// `Debug` prints the rendered text, too, so that a `main` can return them.
pub struct GraphErrors {
    /// The errors, at least one.
    pub found: Vec<PlainDiagnostic>,
    plain: String,
    coloured: String,
}

impl GraphErrors {
    /// Renders errors, such as those of [`build`](crate::build()). `files` is the source map in which they were found.
    pub fn new(files: &SourceMap, found: &[Diagnostic]) -> GraphErrors {
        GraphErrors {
            found: found.iter().map(|error| PlainDiagnostic::new(files, error, Severity::Error)).collect(),
            plain: render(files, found, false),
            coloured: render(files, found, true),
        }
    }

    /// Joins several lists of errors; `None` if there are no lists.
    pub fn joined(all: impl IntoIterator<Item = GraphErrors>) -> Option<GraphErrors> {
        all.into_iter().reduce(|mut all, more| {
            all.found.extend(more.found);
            for (text, more) in [(&mut all.plain, more.plain), (&mut all.coloured, more.coloured)] {
                *text = format!("{}\n\n{more}", text.trim_end());
            }
            all
        })
    }

    /// Adds a note to each error, and to the end of the rendered errors.
    pub fn with_note(mut self, note: &str) -> GraphErrors {
        self.found.iter_mut().for_each(|error| error.help.push(note.to_owned()));
        for text in [&mut self.plain, &mut self.coloured] {
            *text = format!("{}\n{note}\n", text.trim_end());
        }
        self
    }

    /// Appends a note to the rendered errors, if one of them is about the device or its limits.
    pub fn with_device(mut self, note: &str) -> GraphErrors {
        let is_about = |text: &String| {
            let is_limit = text.contains("expected at most") && !text.contains("any device");
            text.contains("the device") || text.contains("device.") || is_limit
        };
        if self.found.iter().any(|error| is_about(&error.message) || is_about(&error.label)) {
            for text in [&mut self.plain, &mut self.coloured] {
                *text = format!("{}\n{note}\n", text.trim_end());
            }
        }
        self
    }

    /// Returns the rendered errors, with ANSI escapes if `colour`.
    pub fn text(&self, colour: bool) -> &str {
        if colour { &self.coloured } else { &self.plain }
    }
}

impl fmt::Display for GraphErrors {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.plain.trim_end())
    }
}

impl fmt::Debug for GraphErrors {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::error::Error for GraphErrors {}

/// Severity of a diagnostic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// No plan can be built.
    Error,
    /// A plan can still be built.
    Warning,
}

/// A diagnostic as plain data, for programs, without its secondary labels. Lines and columns count from 1, columns in
/// characters.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PlainDiagnostic {
    /// Path of the file, as in messages.
    pub file: String,
    /// Line of the first marked character.
    pub line: u32,
    /// Column of the first marked character.
    pub column: u32,
    /// Line of the character after the last marked one.
    pub end_line: u32,
    /// Column of the character after the last marked one.
    pub end_column: u32,
    /// Error or warning.
    pub severity: Severity,
    /// Message, one sentence.
    pub message: String,
    /// Label of the marked source text; may be empty.
    pub label: String,
    /// Suggestions to correct the problem.
    pub help: Vec<String>,
}

impl PlainDiagnostic {
    /// Converts a diagnostic, whose spans are in `files`.
    pub fn new(files: &SourceMap, found: &Diagnostic, severity: Severity) -> PlainDiagnostic {
        let span = found.primary.span;
        let (line, column) = files.line_column(span);
        let (end_line, end_column) = files.line_column(Span { start: span.end.max(span.start), ..span });
        PlainDiagnostic {
            file: files.path(span.file).to_owned(),
            line,
            column,
            end_line,
            end_column,
            severity,
            message: found.message.clone(),
            label: found.primary.text.clone(),
            help: found.help.clone(),
        }
    }
}
