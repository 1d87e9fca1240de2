//! Defines expressions and references to resources in a graph's strings, parsed once when a file is read.
//!
//! A syntax error is stored rather than reported, because a string may be an option of a choice instead of an
//! expression. It is reported when the graph needs the value.

use std::ops::Range;

use serde::Deserialize;

use crate::expr::{Expr, ExprError};

/// An expression, as written and as parsed.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(from = "String")]
pub struct Expression {
    /// The text in the file.
    pub text: String,
    /// The parsed expression, or its syntax error.
    pub parsed: Result<Expr, ExprError>,
}

impl From<String> for Expression {
    fn from(text: String) -> Expression {
        Expression { parsed: Expr::parse(&text), text }
    }
}

impl Expression {
    /// Returns the text on one line.
    pub fn line(&self) -> String {
        folded(&self.text)
    }
}

/// Trims each line of a text, and joins the lines with spaces.
pub fn folded(text: &str) -> String {
    text.lines().map(str::trim).collect::<Vec<_>>().join(" ")
}

/// A reference to a resource. It is a name, `front` or `back` of a ping-pong resource, `last` (the previous frame's
/// contents), or an expression that chooses one.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(from = "String")]
pub struct Reference {
    /// The text in the file.
    pub text: String,
    /// The parsed name; `None` for a choice and for invalid text.
    pub name: Option<ResourceName>,
    /// An expression that chooses the resource: `condition ? 'a' : 'b'`; `None` for the other forms.
    pub choice: Option<Expression>,
}

impl From<String> for Reference {
    fn from(text: String) -> Reference {
        let chooses = is_choice(&text);
        Reference {
            name: if chooses { None } else { ResourceName::parse(&text) },
            choice: chooses.then(|| text.clone().into()),
            text,
        }
    }
}

/// Returns true if a text is an expression rather than a name: it contains `?` or `'`.
pub fn is_choice(text: &str) -> bool {
    text.contains(['?', '\''])
}

/// A parsed reference: the name of a resource, and a part of it.
#[derive(Clone, Debug, PartialEq)]
pub struct ResourceName {
    /// Name of the resource, without its part.
    pub name: String,
    /// Part of the resource.
    pub part: Part,
    /// The byte range of the name in the text.
    pub range: Range<usize>,
}

/// A part of a resource.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// `name`: the resource, or the front of a ping-pong resource.
    Whole,
    /// `front(name)`
    Front,
    /// `back(name)`
    Back,
    /// `last(name)`: the contents that the previous frame left.
    PreviousFrame,
}

impl ResourceName {
    /// Parses `name`, `front(name)`, `back(name)` or `last(name)`. `None` for other text that ends in `)`; any other
    /// text counts as a name.
    pub fn parse(text: &str) -> Option<ResourceName> {
        let (part, range) = match text.strip_suffix(')').map(|inner| inner.split_once('(')) {
            None => (Part::Whole, 0..text.len()),
            Some(Some((part, name))) => {
                let part = match part {
                    "front" => Part::Front,
                    "back" => Part::Back,
                    "last" => Part::PreviousFrame,
                    _ => return None,
                };
                let end = text.len() - 1;
                (part, end - name.len()..end)
            }
            Some(None) => return None,
        };
        Some(ResourceName { name: text[range.clone()].into(), part, range })
    }
}
