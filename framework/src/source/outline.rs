//! Byte spans of every element of a RON text.
//!
//! `serde` and the `ron` crate turn the text into typed values and know places only for their own errors. The
//! outline reads the text a second time, into a tree that has no values but spans, and is asked by [`Path`]:
//! the way from the root to an element, by fields, keys and indices.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;
use std::{fmt, iter};

use super::token::{Text, Token, TokenKind, tokens};
use super::{Diagnostic, Label};
use crate::ir::{FileId, Span};

/// The way from the root of a RON text to one of its elements.
///
/// A step is a field of a struct, a key of a map (the two are the same where they have the same name) or an
/// index: of a list, a tuple, or what stands in a variant's parentheses. In `params: {"x": Const(Int(default:
/// 8))}` the 8 is at `root().field("params").key("x").index(0).field("default")`. `Some(x)` is as good as
/// `x`: it is no step.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Path(Arc<[Step]>);

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Step {
    Name(Arc<str>),
    Index(usize),
}

impl Path {
    /// Returns the path of the whole file.
    pub fn root() -> Self {
        Path(Arc::new([]))
    }

    /// To the field of this name.
    pub fn field(&self, name: &str) -> Self {
        self.then(Step::Name(name.into()))
    }

    /// To the value of this key; keys that are no texts are named as they are written.
    pub fn key(&self, name: &str) -> Self {
        self.then(Step::Name(name.into()))
    }

    /// To the element with this index, counted from 0.
    pub fn index(&self, index: usize) -> Self {
        self.then(Step::Index(index))
    }

    fn then(&self, step: Step) -> Self {
        Path(self.0.iter().cloned().chain(iter::once(step)).collect())
    }
}

/// For instance `passes[2].bind.Keys`.
impl fmt::Display for Path {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for (i, step) in self.0.iter().enumerate() {
            match step {
                Step::Name(name) if i == 0 => write!(f, "{name}")?,
                Step::Name(name) => write!(f, ".{name}")?,
                Step::Index(index) => write!(f, "[{index}]")?,
            }
        }
        Ok(())
    }
}

/// The places of the elements of one RON text.
#[derive(Clone, Debug)]
pub struct Outline {
    file: FileId,
    nodes: Vec<Node>,
    root: usize,
}

/// An element.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub place: Range<usize>,
    /// A short span for diagnostics: the name before the parenthesis, else the opening bracket.
    pub head: Range<usize>,
    /// The field's name or the map's key before it.
    pub key: Option<Range<usize>>,
    pub content: Content,
}

#[derive(Clone, Debug)]
pub(super) enum Content {
    /// A number, a character, a byte string, or a name with nothing behind it.
    Scalar,
    Text(Text),
    /// `(a, b)`, `Name(a, b)`, `[a, b]`
    List {
        children: Vec<usize>,
        bracket: char,
    },
    /// `(a: 1)`, `Name(a: 1)`, `{"a": 1}`
    Record {
        children: Vec<(String, usize)>,
        bracket: char,
    },
}

/// Deepest nesting. What is deeper is hostile, and must not overflow the stack.
const MAX_DEPTH: usize = 128;

impl Outline {
    /// Reads a RON text, all of the language. Fails on what is not balanced, not separated or not named as
    /// RON has it; what the values mean is not looked at.
    pub fn parse(file: FileId, text: &str) -> Result<Outline, Diagnostic> {
        let (tokens, lexical_error) = tokens(file, text);
        let mut parser =
            Parser { file, text, tokens: &tokens, lexical_error, at: 0, open: Vec::new(), nodes: Vec::new() };
        let root = parser.document().map_err(|error| *error)?;
        Ok(Outline { file, nodes: parser.nodes, root })
    }

    /// The place of the element at `path`; of a text, without its quotes. Where the path leads to nothing,
    /// that of the nearest element around it.
    pub fn value(&self, path: &Path) -> Span {
        self.span(self.walk(path).0.inside())
    }

    /// The place of the field's name or the map's key that leads to the element at `path`; of a text, without
    /// its quotes. The element itself where it has neither, or where the path leads to nothing.
    pub fn key(&self, path: &Path) -> Span {
        let (node, found) = self.walk(path);
        self.span(node.key.clone().filter(|_| found).unwrap_or(node.inside()))
    }

    /// Like [`Outline::value`], but of a struct, a variant or a list only the name or the bracket that it
    /// starts with: what to point at where something is missing in it.
    pub fn head(&self, path: &Path) -> Span {
        self.span(self.walk(path).0.shallow())
    }

    /// The offset in the file of byte `offset_in_value` of the text at `path`, as it is without its escapes.
    /// Falls back to the nearest place where the text is missing or shorter.
    pub fn string_offset(&self, path: &Path, offset_in_value: usize) -> usize {
        let node = self.walk(path).0;
        match &node.content {
            Content::Text(text) => text.file_offset(offset_in_value.min(text.value.len())),
            _ => node.place.start,
        }
    }

    /// The place of a range of bytes of the text at `path`, as it is without its escapes: where an expression
    /// in it has its mistake. Where there is no text, the whole element.
    pub fn within_string(&self, path: &Path, range: Range<usize>) -> Span {
        if !matches!(self.walk(path).0.content, Content::Text(_)) {
            return self.value(path);
        }
        let [start, end] = [range.start, range.end].map(|offset| self.string_offset(path, offset));
        self.span(start..end.max(start))
    }

    /// An error for every name that a struct or a map gives twice. Maps keep the last one silently otherwise.
    pub fn duplicates(&self) -> Vec<Diagnostic> {
        let mut errors = Vec::new();
        for node in &self.nodes {
            let Content::Record { children, bracket } = &node.content else { continue };
            let mut first: HashMap<&str, usize> = HashMap::new();
            for (name, child) in children {
                let key = |child: usize| self.span(self.nodes[child].key.clone().unwrap_or_default());
                if let Some(first) = first.insert(name, *child) {
                    let what = if *bracket == '(' { "field" } else { "key" };
                    errors.push(
                        Diagnostic::new(
                            format!("the {what} `{name}` is given twice"),
                            key(*child),
                            "again here",
                        )
                        .with_label(key(first), "first here"),
                    );
                }
            }
        }
        errors.sort_by_key(|error| error.primary.span.start);
        errors
    }

    /// The element at a path, or the nearest around it, and whether it is the one asked for.
    fn walk(&self, path: &Path) -> (&Node, bool) {
        let mut node = &self.nodes[self.root];
        for step in path.0.iter() {
            let child = match (&node.content, step) {
                (Content::List { children, .. }, Step::Index(index)) => children.get(*index).copied(),
                (Content::Record { children, .. }, Step::Name(name)) => {
                    // Of a map's duplicate keys the last one counts.
                    children.iter().rev().find(|(n, _)| **n == **name).map(|(_, child)| *child)
                }
                // With `unwrap_variant_newtypes`, `Const(Int(default: 8))` may be written `Const(default:
                // 8)`.
                (Content::Record { .. }, Step::Index(0)) => continue,
                _ => None,
            };
            match child {
                Some(child) => node = &self.nodes[child],
                None => return (node, false),
            }
        }
        (node, true)
    }

    fn span(&self, place: Range<usize>) -> Span {
        Span { file: self.file, start: place.start, end: place.end }
    }

    /// The element that starts at `offset`, if there is one.
    pub(super) fn starting_at(&self, offset: usize) -> Option<&Node> {
        // Of a list and its first element only a list without a bracket could start at the same place; there
        // is none.
        self.nodes.iter().find(|node| node.place.start == offset)
    }

    /// The field's name or map's key that starts at `offset` (with its quote, if it has one).
    pub(super) fn key_starting_at(&self, offset: usize) -> Option<Range<usize>> {
        let keys = self.nodes.iter().filter_map(|node| node.key.clone());
        keys.min_by_key(|key| key.start.abs_diff(offset))
            .filter(|key| key.start == offset || key.start == offset + 1)
    }

    /// The innermost element that `offset` is in or just behind.
    pub(super) fn innermost(&self, offset: usize) -> &Node {
        let holds = |node: &&Node| node.place.start <= offset && offset <= node.place.end;
        let innermost = self.nodes.iter().filter(holds).min_by_key(|node| node.place.len());
        innermost.unwrap_or(&self.nodes[self.root])
    }

    /// The innermost struct, list or map that is open at `offset`.
    pub(super) fn enclosing(&self, offset: usize) -> &Node {
        let holds = |node: &&Node| {
            node.place.start <= offset
                && offset < node.place.end
                && matches!(node.content, Content::List { .. } | Content::Record { .. })
        };
        let innermost = self.nodes.iter().filter(holds).min_by_key(|node| node.place.len());
        innermost.unwrap_or(&self.nodes[self.root])
    }

    /// The first field called `name` in an element.
    pub(super) fn field_of(&self, node: &Node, name: &str) -> Option<Range<usize>> {
        let Content::Record { children, .. } = &node.content else { return None };
        children.iter().find(|(n, _)| n == name).and_then(|(_, child)| self.nodes[*child].key.clone())
    }
}

impl Node {
    /// The element, a text without its quotes.
    pub fn inside(&self) -> Range<usize> {
        match &self.content {
            Content::Text(text) => text.inside.clone(),
            _ => self.place.clone(),
        }
    }

    /// Returns a span for diagnostics that does not cover many lines.
    pub fn shallow(&self) -> Range<usize> {
        match &self.content {
            Content::List { .. } | Content::Record { .. } => self.head.clone(),
            _ => self.inside(),
        }
    }
}

struct Parser<'a> {
    file: FileId,
    text: &'a str,
    tokens: &'a [Token],
    /// The lexical error that ended the tokens, if any.
    lexical_error: Option<Diagnostic>,
    at: usize,
    /// The brackets that are open, outermost first.
    open: Vec<&'a Token>,
    nodes: Vec<Node>,
}

/// Boxed, because a diagnostic is much larger than an index.
type ParseResult<T> = Result<T, Box<Diagnostic>>;

impl<'a> Parser<'a> {
    fn peek(&self, ahead: usize) -> Option<&'a Token> {
        self.tokens.get(self.at + ahead)
    }

    fn peek_kind(&self, ahead: usize) -> Option<&'a TokenKind> {
        self.peek(ahead).map(|token| &token.kind)
    }

    fn document(&mut self) -> ParseResult<usize> {
        while let Some(TokenKind::Attribute) = self.peek_kind(0) {
            self.at += 1;
        }
        let root = self.value()?;
        match self.peek(0) {
            None if self.lexical_error.is_none() => Ok(root),
            Some(token) if matches!(token.kind, TokenKind::Close(_)) => {
                let message = format!("this `{}` closes nothing", &self.text[token.start..token.end]);
                Err(self.error(token.start..token.end, message, "no bracket is open here"))
            }
            _ => Err(self.expected("the end of the file")),
        }
    }

    fn value(&mut self) -> ParseResult<usize> {
        let Some(token) = self.peek(0) else { return Err(self.expected("a value")) };
        let place = token.start..token.end;
        match &token.kind {
            TokenKind::Open(_) => self.bracketed(None),
            TokenKind::Identifier => {
                self.at += 1;
                match self.peek(0) {
                    Some(next) if next.kind == TokenKind::Open('(') => self.bracketed(Some(token)),
                    _ => Ok(self.push(place.clone(), place, Content::Scalar)),
                }
            }
            TokenKind::Scalar => {
                self.at += 1;
                Ok(self.push(place.clone(), place, Content::Scalar))
            }
            TokenKind::Text(text) => {
                self.at += 1;
                Ok(self.push(place.clone(), place, Content::Text(text.clone())))
            }
            _ => Err(self.expected("a value")),
        }
    }

    /// From an opening bracket to the closing one. `name` is the identifier before it.
    fn bracketed(&mut self, name: Option<&'a Token>) -> ParseResult<usize> {
        let opener = &self.tokens[self.at];
        let TokenKind::Open(bracket) = opener.kind else { return Err(self.expected("an opening bracket")) };
        if self.open.len() == MAX_DEPTH {
            let message = format!("the file is nested more than {MAX_DEPTH} levels deep");
            return Err(self.error(opener.start..opener.end, message, "this level is one too many"));
        }
        self.open.push(opener);
        self.at += 1;
        let closer = closing(bracket);
        let is_record = match bracket {
            '{' => true,
            // A quoted name is a mistake that `key` explains.
            '(' => {
                matches!(self.peek_kind(0), Some(TokenKind::Identifier | TokenKind::Text(_)))
                    && self.peek_kind(1) == Some(&TokenKind::Colon)
            }
            _ => false,
        };
        let (mut children, mut names) = (Vec::new(), Vec::new());
        while self.peek_kind(0) != Some(&TokenKind::Close(closer)) {
            let key = if is_record { Some(self.key(bracket)?) } else { None };
            let child = self.value()?;
            if let Some((name, place)) = key {
                self.nodes[child].key = Some(place);
                names.push(name);
            }
            children.push(child);
            match self.peek_kind(0) {
                Some(TokenKind::Comma) => self.at += 1,
                Some(TokenKind::Close(c)) if *c == closer => {}
                _ => return Err(self.expected_separator(closer)),
            }
        }
        let end = self.tokens[self.at].end;
        self.at += 1;
        self.open.pop();
        let first = name.unwrap_or(opener);
        let is_some = name.is_some_and(|name| &self.text[name.start..name.end] == "Some");
        if let (true, false, [inner]) = (is_some, is_record, &children[..]) {
            return Ok(*inner);
        }
        let content = if is_record {
            Content::Record { children: names.into_iter().zip(children).collect(), bracket }
        } else {
            Content::List { children, bracket }
        };
        Ok(self.push(first.start..end, first.start..first.end, content))
    }

    /// A field's name or a map's key, with the colon behind it: the name, and its place.
    fn key(&mut self, bracket: char) -> ParseResult<(String, Range<usize>)> {
        let Some(token) = self.peek(0) else { return Err(self.expected("a name")) };
        let (name, place) = match &token.kind {
            TokenKind::Identifier if bracket == '(' && self.peek_kind(1) == Some(&TokenKind::Open('(')) => {
                // Most likely the next element of a list, and the parenthesis of the one before was
                // forgotten.
                let name = &self.text[token.start..token.end];
                let message = format!("expected a field `name: value`, found `{name}(`");
                let mut error = self.error(token.start..token.end, message, "not expected here");
                if let Some(opener) = self.open.last() {
                    let span = Span { file: self.file, start: opener.start, end: opener.end };
                    error.secondary.push(Label { span, text: "this `(` is still open".into() });
                }
                return Err(error);
            }
            TokenKind::Identifier => {
                self.at += 1;
                let name = &self.text[token.start..token.end];
                (name.strip_prefix("r#").unwrap_or(name).to_string(), token.start..token.end)
            }
            TokenKind::Text(text) if bracket == '{' => {
                self.at += 1;
                (text.value.clone(), text.inside.clone())
            }
            TokenKind::Scalar | TokenKind::Open(_) if bracket == '{' => {
                let key = self.value()?;
                let place = self.nodes[key].place.clone();
                (self.text[place.clone()].to_string(), place)
            }
            TokenKind::Text(text) if self.peek_kind(1) == Some(&TokenKind::Colon) => {
                let label = "write it without quotes";
                let error = self.error(
                    token.start..token.end,
                    format!("a field's name is in quotes: {:?}", text.value),
                    label,
                );
                return Err(Box::new(error.with_help("keys are in quotes in `{...}`, not in `(...)`")));
            }
            _ if bracket == '{' => return Err(self.expected("a key")),
            _ => return Err(self.expected("a field, as those before it: `name: value`")),
        };
        if self.peek_kind(0) != Some(&TokenKind::Colon) {
            return Err(self.expected(&format!("`:` behind `{name}`")));
        }
        self.at += 1;
        Ok((name, place))
    }

    fn push(&mut self, place: Range<usize>, head: Range<usize>, content: Content) -> usize {
        self.nodes.push(Node { place, head, key: None, content });
        self.nodes.len() - 1
    }

    fn error(&self, place: Range<usize>, message: impl Into<String>, label: &str) -> Box<Diagnostic> {
        let span = Span { file: self.file, start: place.start, end: place.end };
        Box::new(Diagnostic::new(message, span, label))
    }

    /// After an element, neither a comma nor the bracket's end.
    fn expected_separator(&mut self, closer: char) -> Box<Diagnostic> {
        let starts_element = matches!(
            self.peek_kind(0),
            Some(TokenKind::Identifier | TokenKind::Scalar | TokenKind::Text(_) | TokenKind::Open(_))
        );
        if !starts_element {
            return self.expected(&format!("`,` or `{closer}`"));
        }
        let (before, next) = (&self.tokens[self.at - 1], &self.tokens[self.at]);
        let end = before.end;
        // `Threads(scene.count)`: a name of two words.
        if before.end == next.start
            && before.kind == TokenKind::Identifier
            && self.text[next.start..next.end].starts_with('.')
        {
            let place = before.start..next.end;
            let span = Span { file: self.file, start: place.start, end: place.end };
            return Box::new(unquoted(&self.text[place], span));
        }
        let error = self.error(end..end, "a comma is missing", &format!("expected `,` or `{closer}` here"));
        let is_text = |token: &Token| matches!(token.kind, TokenKind::Text(_));
        // `name: "a, shader: "b"`: the second quote was meant to open a text, and closed one.
        if before.end == next.start && (is_text(before) || is_text(next)) {
            return Box::new(error.with_help("or a quote is missing or too many, here or before"));
        }
        error
    }

    /// The token ahead is not what should come.
    fn expected(&mut self, what: &str) -> Box<Diagnostic> {
        let Some(token) = self.peek(0) else { return self.expected_more(what) };
        let found = match &token.kind {
            TokenKind::Text(_) => "a text".to_string(),
            TokenKind::Attribute => "an attribute".to_string(),
            _ => format!("`{}`", &self.text[token.start..token.end]),
        };
        let error = self.error(
            token.start..token.end,
            format!("expected {what}, found {found}"),
            "not expected here",
        );
        match (&token.kind, self.open.last()) {
            (TokenKind::Close(found), Some(opener)) if opener.kind != TokenKind::Open(opening(*found)) => {
                let opened = &self.text[opener.start..opener.end];
                let message = format!("expected {what}, found `{found}`");
                let error = self.error(token.start..token.end, message, "this closes another bracket");
                let span = Span { file: self.file, start: opener.start, end: opener.end };
                Box::new(error.with_label(span, format!("this `{opened}` is still open")))
            }
            (TokenKind::Colon, Some(opener)) if opener.kind == TokenKind::Open('[') => {
                Box::new(error.with_help("names and values stand in `{...}` or `(...)`, a list in `[...]`"))
            }
            (TokenKind::Attribute, _) => {
                Box::new(error.with_help("attributes stand at the start of the file"))
            }
            _ => error,
        }
    }

    /// There are no more tokens, and there should be.
    fn expected_more(&mut self, what: &str) -> Box<Diagnostic> {
        if let Some(error) = self.lexical_error.take() {
            return Box::new(error);
        }
        // Behind the last thing that stands there: no editor, and no drawing, has a line behind the last line's end.
        let end = self.text.trim_end().len();
        if let Some(opener) = self.open.last() {
            let opened = &self.text[opener.start..opener.end];
            let error =
                self.error(opener.start..opener.end, format!("this `{opened}` is not closed"), "opened here");
            let end = Span { file: self.file, start: end, end };
            let TokenKind::Open(bracket) = opener.kind else { return error };
            return Box::new(
                error.with_label(end, format!("the file ends without its `{}`", closing(bracket))),
            );
        }
        if self.tokens.is_empty() {
            return self.error(end..end, "the file is empty", &format!("expected {what}"));
        }
        self.error(end..end, format!("expected {what}, found the end of the file"), "the file ends here")
    }
}

/// Describes an expression that is written without its quotes.
pub(super) fn unquoted(name: &str, span: Span) -> Diagnostic {
    Diagnostic::new(format!("`{name}` is not in quotes"), span, "an expression")
        .with_help(format!("write it as a text: `\"{name}\"`"))
}

fn closing(bracket: char) -> char {
    match bracket {
        '(' => ')',
        '[' => ']',
        _ => '}',
    }
}

fn opening(bracket: char) -> char {
    match bracket {
        ')' => '(',
        ']' => '[',
        _ => '{',
    }
}
