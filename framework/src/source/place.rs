//! Locates elements of a RON text, so that errors can point at them.

use std::ops::Range;
use std::rc::Rc;

use super::outline::{Content, Node};
use super::{Diagnostic, Outline};
use crate::ir::Span;

/// An element of a RON text, reached by steps from the root.
///
/// A step leads to a field of a struct, a key of a map, or an index of a list, a tuple or a variant's parentheses. In
/// `params: {"x": Const(Int(default: 8))}`, the 8 is at `root.field("params").field("x").index(0).field("default")`.
/// `Some(x)` counts as `x`, without a step. A step to a missing element stays where it is.
#[derive(Clone, Debug)]
pub struct Place {
    outline: Rc<Outline>,
    node: usize,
    exists: bool,
}

impl Place {
    /// Returns the place of the root element.
    pub fn root(outline: &Rc<Outline>) -> Place {
        Place { outline: outline.clone(), node: outline.root, exists: true }
    }

    /// Steps to a field of a struct or a key of a map. Keys that are not strings are spelled as in the file.
    pub fn field(&self, name: &str) -> Place {
        self.step(match &self.node().content {
            Content::Record { children, .. } => children.get(name).copied(),
            _ => None,
        })
    }

    /// Steps to an element by index, from 0.
    pub fn index(&self, index: usize) -> Place {
        self.step(match &self.node().content {
            Content::List { children, .. } => children.get(index).copied(),
            // With `unwrap_variant_newtypes`, `Const(Int(default: 8))` may be written `Const(default: 8)`.
            Content::Record { .. } if index == 0 => Some(self.node),
            _ => None,
        })
    }

    fn step(&self, child: Option<usize>) -> Place {
        let found = child.filter(|_| self.exists);
        Place { outline: self.outline.clone(), node: found.unwrap_or(self.node), exists: found.is_some() }
    }

    fn node(&self) -> &Node {
        &self.outline.nodes[self.node]
    }

    /// Returns a number that identifies the element within its text.
    pub fn id(&self) -> usize {
        self.node
    }

    /// Returns the span of the element; for a string, without its quotes.
    pub fn span(&self) -> Span {
        self.outline.span(self.node().inside())
    }

    /// Returns the span of the field name or map key before the element, without quotes. Without either, returns the
    /// element's own span.
    pub fn key(&self) -> Span {
        let node = self.node();
        self.outline.span(node.key.clone().filter(|_| self.exists).unwrap_or(node.inside()))
    }

    /// Returns a span for errors about a missing part. It is the name or bracket at the start of a struct, variant,
    /// list or map. For other elements, returns [`Place::span`].
    pub fn head(&self) -> Span {
        self.outline.span(self.node().shallow())
    }

    /// Converts a byte offset in a string's value, after escapes are resolved, to an offset in the file. `offset` is
    /// clamped. For other elements, returns their start.
    pub(super) fn string_offset(&self, offset: usize) -> usize {
        let node = self.node();
        match &node.content {
            Content::Text(text) => text.file_offset(offset.min(text.value.len())),
            _ => node.place.start,
        }
    }

    /// Returns the span of part of a string, for errors about an expression in it. `range` counts bytes after escapes
    /// are resolved. For other elements, returns [`Place::span`].
    pub fn within_string(&self, range: Range<usize>) -> Span {
        if !matches!(self.node().content, Content::Text(_)) {
            return self.span();
        }
        let [start, end] = [range.start, range.end].map(|offset| self.string_offset(offset));
        self.outline.span(start..end.max(start))
    }

    /// Creates an error at the element, with `label` shown under it.
    pub fn error(&self, message: impl Into<String>, label: impl Into<String>) -> Diagnostic {
        Diagnostic::new(message, self.span(), label)
    }
}
