//! Finds the byte span of every element of a RON text.
//!
//! `serde` and the `ron` crate produce typed values, and give positions only for their own errors. The outline parses
//! the text a second time, into a tree of spans without values. A [`Place`](super::Place) is an element of this tree.

use indexmap::IndexMap;
use std::ops::Range;

use super::token::{Text, Token, TokenKind, tokens};
use super::{Diagnostic, Label};
use crate::ir::{FileId, Span};

/// A tree of the elements of a RON text, with their spans.
#[derive(Clone, Debug)]
pub struct Outline {
    file: FileId,
    pub(super) nodes: Vec<Node>,
    pub(super) root: usize,
    duplicates: Vec<Diagnostic>,
}

#[derive(Clone, Debug)]
pub(super) struct Node {
    pub place: Range<usize>,
    /// Short span for diagnostics: the name before the parenthesis, or the opening bracket. Other elements: all of it.
    pub head: Range<usize>,
    /// Span of the field name or map key before the element; `None` for elements of lists.
    pub key: Option<Range<usize>>,
    pub content: Content,
}

#[derive(Clone, Debug)]
pub(super) enum Content {
    /// A number, a character, a byte string, or a bare name.
    Scalar,
    Text(Text),
    /// Elements without names: `(a, b)`, `Name(a, b)`, `[a, b]`.
    List {
        children: Vec<usize>,
        bracket: char,
    },
    /// Elements with names or keys: `(a: 1)`, `Name(a: 1)`, `{"a": 1}`.
    Record {
        children: IndexMap<String, usize>,
        bracket: char,
    },
}

/// Maximum nesting depth, so that hostile texts cannot overflow the stack.
const MAX_DEPTH: usize = 128;

impl Outline {
    /// Parses any RON text. Fails on invalid tokens, unbalanced brackets, missing separators, invalid names, and
    /// nesting deeper than 128 levels. Values are not checked.
    pub fn parse(file: FileId, text: &str) -> Result<Outline, Diagnostic> {
        let (tokens, lexical_error) = tokens(file, text);
        let mut parser = Parser {
            file,
            text,
            tokens: &tokens,
            lexical_error,
            at: 0,
            open: Vec::new(),
            nodes: Vec::new(),
            duplicates: Vec::new(),
        };
        let root = parser.document().map_err(|error| *error)?;
        let Parser { nodes, mut duplicates, .. } = parser;
        duplicates.sort_by_key(|error| error.primary.span.start);
        Ok(Outline { file, nodes, root, duplicates })
    }

    /// Returns an error for every duplicate name in a struct or a map. (`serde` would silently keep the last value of a
    /// map.)
    pub fn duplicates(&self) -> &[Diagnostic] {
        &self.duplicates
    }

    pub(super) fn span(&self, place: Range<usize>) -> Span {
        Span::new(self.file, place)
    }

    /// Returns the element that starts at byte `offset`, if any.
    pub(super) fn starting_at(&self, offset: usize) -> Option<&Node> {
        // At most one element starts at any offset, because lists start with a bracket.
        self.nodes.iter().find(|node| node.place.start == offset)
    }

    /// Returns the span of the field name or map key that contains `offset` or ends there, if any. The opening quote
    /// counts as part of a key, but the span excludes it.
    pub(super) fn key_at(&self, offset: usize) -> Option<Range<usize>> {
        let mut keys = self.nodes.iter().filter_map(|node| node.key.clone());
        keys.find(|key| key.start <= offset + 1 && offset <= key.end)
    }

    /// Returns the innermost element that contains `offset` or ends there, or else the root.
    pub(super) fn innermost(&self, offset: usize) -> &Node {
        let holds = |node: &&Node| node.place.start <= offset && offset <= node.place.end;
        let innermost = self.nodes.iter().filter(holds).min_by_key(|node| node.place.len());
        innermost.unwrap_or(&self.nodes[self.root])
    }

    /// Returns the innermost struct, list or map that is open at `offset`, or else the root.
    pub(super) fn enclosing(&self, offset: usize) -> &Node {
        let holds = |node: &&Node| {
            node.place.start <= offset
                && offset < node.place.end
                && matches!(node.content, Content::List { .. } | Content::Record { .. })
        };
        let innermost = self.nodes.iter().filter(holds).min_by_key(|node| node.place.len());
        innermost.unwrap_or(&self.nodes[self.root])
    }
}

impl Node {
    /// Returns the element's span; for a string, without its quotes.
    pub fn inside(&self) -> Range<usize> {
        match &self.content {
            Content::Text(text) => text.inside.clone(),
            _ => self.place.clone(),
        }
    }

    /// Returns a short span for diagnostics: the head of a struct or a list, otherwise the whole element.
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
    lexical_error: Option<Diagnostic>,
    at: usize,
    /// Opening brackets not yet closed, outermost first.
    open: Vec<&'a Token>,
    nodes: Vec<Node>,
    duplicates: Vec<Diagnostic>,
}

/// The error is boxed, because a diagnostic is much larger than an index.
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
                let message = format!("this `{}` closes nothing", &self.text[token.place()]);
                Err(self.error(token.place(), message, "no bracket is open here"))
            }
            _ => Err(self.expected("the end of the file")),
        }
    }

    fn value(&mut self) -> ParseResult<usize> {
        let Some(token) = self.peek(0) else { return Err(self.expected("a value")) };
        let place = token.place();
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

    /// Parses a bracketed element. `name` is the identifier before it, if any.
    fn bracketed(&mut self, name: Option<&'a Token>) -> ParseResult<usize> {
        let opener = &self.tokens[self.at];
        let TokenKind::Open(bracket) = opener.kind else { return Err(self.expected("an opening bracket")) };
        if self.open.len() == MAX_DEPTH {
            let message = format!("the file is nested more than {MAX_DEPTH} levels deep");
            return Err(self.error(opener.place(), message, "this level is one too many"));
        }
        self.open.push(opener);
        self.at += 1;
        let closer = closing(bracket);
        let is_record = match bracket {
            '{' => true,
            // A quoted name is a mistake; `key` reports it.
            '(' => {
                matches!(self.peek_kind(0), Some(TokenKind::Identifier | TokenKind::Text(_)))
                    && self.peek_kind(1) == Some(&TokenKind::Colon)
            }
            _ => false,
        };
        let (mut children, mut named) = (Vec::new(), IndexMap::new());
        while self.peek_kind(0) != Some(&TokenKind::Close(closer)) {
            let key = if is_record { Some(self.key(bracket)?) } else { None };
            let child = self.value()?;
            children.push(child);
            if let Some((name, place)) = key {
                self.nodes[child].key = Some(place);
                if let Some(first) = named.insert(name.clone(), child) {
                    self.duplicate(bracket, &name, (first, child));
                }
            }
            match self.peek_kind(0) {
                Some(TokenKind::Comma) => self.at += 1,
                Some(TokenKind::Close(c)) if *c == closer => {}
                _ => return Err(self.expected_separator(closer, &children)),
            }
        }
        let end = self.tokens[self.at].end;
        self.at += 1;
        self.open.pop();
        let first = name.unwrap_or(opener);
        let is_some = name.is_some_and(|name| &self.text[name.place()] == "Some");
        if let (true, false, [inner]) = (is_some, is_record, &children[..]) {
            return Ok(*inner);
        }
        let content = if is_record {
            Content::Record { children: named, bracket }
        } else {
            Content::List { children, bracket }
        };
        Ok(self.push(first.start..end, first.place(), content))
    }

    fn key(&mut self, bracket: char) -> ParseResult<(String, Range<usize>)> {
        let Some(token) = self.peek(0) else { return Err(self.expected("a name")) };
        let (name, place) = match &token.kind {
            TokenKind::Identifier if bracket == '(' && self.peek_kind(1) == Some(&TokenKind::Open('(')) => {
                // A struct or call follows where a name should be: a closing parenthesis is probably missing before it.
                let name = &self.text[token.place()];
                let message = format!("expected a field `name: value`, found `{name}(`");
                let mut error = self.error(token.place(), message, "not expected here");
                if let Some(opener) = self.open.last() {
                    let span = Span::new(self.file, opener.place());
                    error.secondary.push(Label { span, text: "this `(` is still open".into() });
                }
                return Err(error);
            }
            TokenKind::Identifier => {
                self.at += 1;
                let name = &self.text[token.place()];
                (name.strip_prefix("r#").unwrap_or(name).to_string(), token.place())
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
                    token.place(),
                    format!("a field's name is in quotes: {:?}", text.value),
                    label,
                );
                return Err(Box::new(error.with_help("keys are in quotes in `{...}`, not in `(...)`")));
            }
            _ if bracket == '{' => return Err(self.expected("a key")),
            _ => return Err(self.expected("a field, as those before it: `name: value`")),
        };
        if self.peek_kind(0) != Some(&TokenKind::Colon) {
            return Err(self.expected(&format!("`:` after `{name}`")));
        }
        self.at += 1;
        Ok((name, place))
    }

    fn duplicate(&mut self, bracket: char, name: &str, (first, again): (usize, usize)) {
        let what = if bracket == '(' { "field" } else { "key" };
        let message = format!("the {what} `{name}` is given twice");
        let key = |child: usize| self.nodes[child].key.clone().unwrap_or_default();
        let error = self.error(key(again), message, "again here");
        self.duplicates.push(error.with_label(Span::new(self.file, key(first)), "first here"));
    }

    fn push(&mut self, place: Range<usize>, head: Range<usize>, content: Content) -> usize {
        self.nodes.push(Node { place, head, key: None, content });
        self.nodes.len() - 1
    }

    fn error(&self, place: Range<usize>, message: impl Into<String>, label: &str) -> Box<Diagnostic> {
        Box::new(Diagnostic::new(message, Span::new(self.file, place), label))
    }

    /// Returns the error for an element that is not followed by a comma or the closing bracket. It is the last of
    /// `children`.
    fn expected_separator(&mut self, closer: char, children: &[usize]) -> Box<Diagnostic> {
        if let Some(error) = children.last().and_then(|child| self.unquoted_at(*child)) {
            return Box::new(error);
        }
        let starts_element = matches!(
            self.peek_kind(0),
            Some(TokenKind::Identifier | TokenKind::Scalar | TokenKind::Text(_) | TokenKind::Open(_))
        );
        if !starts_element {
            return self.expected(&format!("`,` or `{closer}`"));
        }
        let (before, next) = (&self.tokens[self.at - 1], &self.tokens[self.at]);
        let end = before.end;
        // `Dispatch(name "first")`
        if closer == ')' && children.len() == 1 && before.kind == TokenKind::Identifier {
            return self.expected(&format!("`:` after `{}`", &self.text[before.place()]));
        }
        let message = format!("expected `,` or `{closer}`, found {}", self.found(next));
        let error = self.error(end..end, message, "a comma may be missing here");
        let is_text = |token: &Token| matches!(token.kind, TokenKind::Text(_));
        // `name: "a, shader: "b"`: a quote meant to open a string closed one.
        if before.end == next.start && (is_text(before) || is_text(next)) {
            return Box::new(error.with_help("or there is a missing or extra quote, here or earlier"));
        }
        error
    }

    /// Returns the error for an expression without quotes, such as `2 * n`: an operator follows the element `child`.
    fn unquoted_at(&self, child: usize) -> Option<Diagnostic> {
        let Node { place, head, content, .. } = &self.nodes[child];
        let rest = &self.text[place.end..];
        let after = rest.trim_start_matches(' ');
        let is_operator = rest.starts_with('.')
            || ["==", "!="].iter().any(|operator| after.starts_with(operator))
            || after.starts_with(['+', '-', '*', '/', '%', '<', '>', '?', '&', '|']);
        // `(1 -2)` lacks a comma.
        let is_number = |text: &str| text.trim_start_matches('-').starts_with(|c: char| c.is_ascii_digit());
        let is_list = is_number(&self.text[place.clone()]) && is_number(after);
        let is_comment = ["//", "/*"].iter().any(|comment| after.starts_with(comment));
        let is_operand = matches!(content, Content::Scalar) || is_call(self.text, head);
        if !is_operator || is_list || is_comment || !is_operand {
            return None;
        }
        // The expression may be an argument of a function.
        let names = self.open.iter().rev().map(|opener| {
            let name = self.text[..opener.start].trim_end_matches(|c: char| c.is_alphanumeric() || c == '_');
            name.len()..opener.start
        });
        let start =
            names.take_while(|name| is_call(self.text, name)).last().map_or(place.start, |name| name.start);
        let mut depth = 0_i32;
        let end = start
            + self.text[start..].find(|c: char| {
                let ends = depth == 0 && matches!(c, ',' | ')' | ']' | '}' | '\n');
                match c {
                    '(' | '[' | '{' => depth += 1,
                    ')' | ']' | '}' => depth -= 1,
                    _ => {}
                }
                ends || c == '"'
            })?;
        let expression = self.text[start..end].trim_end();
        let span = Span::new(self.file, start..start + expression.len());
        (!self.text[end..].starts_with('"')).then(|| unquoted(expression, span))
    }

    /// Returns the error for an unexpected token or end of the text; `what` describes what was expected.
    fn expected(&mut self, what: &str) -> Box<Diagnostic> {
        let Some(token) = self.peek(0) else { return self.expected_more(what) };
        let found = self.found(token);
        let error = self.error(token.place(), format!("expected {what}, found {found}"), "not expected here");
        match (&token.kind, self.open.last()) {
            (TokenKind::Close(found), Some(opener)) if opener.kind != TokenKind::Open(opening(*found)) => {
                let opened = &self.text[opener.place()];
                let message = format!("expected {what}, found `{found}`");
                let error = self.error(token.place(), message, "this closes another bracket");
                let span = Span::new(self.file, opener.place());
                Box::new(error.with_label(span, format!("this `{opened}` is still open")))
            }
            (TokenKind::Colon, Some(opener)) if opener.kind == TokenKind::Open('[') => Box::new(
                error.with_help("names and values are written in `{...}` or `(...)`, a list in `[...]`"),
            ),
            (TokenKind::Attribute, _) => Box::new(error.with_help("attributes go at the start of the file")),
            _ => error,
        }
    }

    fn found(&self, token: &Token) -> String {
        match &token.kind {
            TokenKind::Text(_) => "a string".to_string(),
            TokenKind::Attribute => "an attribute".to_string(),
            _ => format!("`{}`", &self.text[token.place()]),
        }
    }

    fn expected_more(&mut self, what: &str) -> Box<Diagnostic> {
        if let Some(error) = self.lexical_error.take() {
            return Box::new(error);
        }
        // Point just after the last token, because blank lines may follow.
        let end = self.text.trim_end().len();
        if let Some(opener) = self.open.last() {
            let opened = &self.text[opener.place()];
            let error = self.error(opener.place(), format!("this `{opened}` is not closed"), "opened here");
            let end = Span::new(self.file, end..end);
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

/// Returns true if the word at `place` is no name of a struct or a variant, which begin with a capital letter.
pub(super) fn is_call(text: &str, place: &Range<usize>) -> bool {
    text[place.clone()].starts_with(char::is_lowercase)
}

pub(super) fn unquoted(name: &str, span: Span) -> Diagnostic {
    let lower = name.to_lowercase();
    if matches!(lower.as_str(), "true" | "false") {
        let message = format!("expected `true` or `false`, found `{name}`");
        return Diagnostic::new(message, span, format!("did you mean `{lower}`?"));
    }
    if matches!(lower.as_str(), "nan" | "infinity") {
        return Diagnostic::new(format!("expected a finite number, found `{name}`"), span, "not finite");
    }
    Diagnostic::new(format!("`{name}` is not in quotes"), span, "an expression")
        .with_help(format!("write it as a string: `\"{name}\"`"))
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
