use std::fmt;

use super::{SourceMap, Span};

/// A place, and what is to be said of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Label {
    pub span: Span,
    pub text: String,
}

/// An error in a file. There are no warnings: what a graph may not say, it may not say.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// One sentence without a full stop, lower case, as a compiler would put it.
    pub message: String,
    /// Where the mistake is.
    pub primary: Label,
    /// Other places that one must look at to understand it, in any file.
    pub secondary: Vec<Label>,
    /// What to do about it, one hint each.
    pub help: Vec<String>,
}

impl Diagnostic {
    pub fn new(message: impl Into<String>, span: Span, label: impl Into<String>) -> Self {
        let primary = Label { span, text: label.into() };
        Diagnostic { message: message.into(), primary, secondary: Vec::new(), help: Vec::new() }
    }

    pub fn with_label(mut self, span: Span, text: impl Into<String>) -> Self {
        self.secondary.push(Label { span, text: text.into() });
        self
    }

    pub fn with_help(mut self, text: impl Into<String>) -> Self {
        self.help.push(text.into());
        self
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Diagnostic {}

pub fn render(_files: &SourceMap, diagnostics: &[Diagnostic], _colour: bool) -> String {
    diagnostics.iter().map(|d| d.to_string()).collect()
}

pub fn nearest<'a>(_name: &str, _candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    None
}
