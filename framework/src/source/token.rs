//! Splits RON into tokens with spans.
//!
//! Numbers, characters and identifiers are only delimited, because the `ron` crate parses their values. Strings are
//! decoded, because errors point into them.

use std::ops::Range;

use super::Diagnostic;
use crate::ir::{FileId, Span};

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Token {
    pub kind: TokenKind,
    pub start: usize,
    pub end: usize,
}

impl Token {
    pub fn place(&self) -> Range<usize> {
        self.start..self.end
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum TokenKind {
    Open(char),
    Close(char),
    Comma,
    Colon,
    Identifier,
    /// A number, a range of numbers, a character, a byte or a byte string.
    Scalar,
    Text(Text),
    Attribute,
}

/// A string, with a map from its decoded value to the file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Text {
    pub value: String,
    /// Byte range of the file between the quotes.
    pub inside: Range<usize>,
    /// Pairs of an offset in the value and its offset in the file, ascending. The first is the start of the string.
    /// From one pair up to the next, both offsets advance together.
    pub steps: Vec<(usize, usize)>,
}

impl Text {
    pub fn file_offset(&self, offset: usize) -> usize {
        let next = self.steps.partition_point(|(value, _)| *value <= offset);
        let (value, file) = self.steps[next - 1];
        file + (offset - value)
    }
}

/// Reads tokens up to the first error. Returns the tokens, and the error if there is one.
pub(super) fn tokens(file: FileId, text: &str) -> (Vec<Token>, Option<Diagnostic>) {
    let mut lexer = Lexer { file, text, at: 0 };
    let mut tokens = Vec::new();
    loop {
        match lexer.next() {
            Ok(Some(token)) => tokens.push(token),
            Ok(None) => return (tokens, None),
            Err(error) => return (tokens, Some(*error)),
        }
    }
}

struct Lexer<'a> {
    file: FileId,
    text: &'a str,
    at: usize,
}

/// The error is boxed, because a diagnostic is much larger than a token.
type Result<T> = std::result::Result<T, Box<Diagnostic>>;

impl<'a> Lexer<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn error(&self, place: Range<usize>, message: impl Into<String>, label: &str) -> Box<Diagnostic> {
        Box::new(Diagnostic::new(message, Span::new(self.file, place), label))
    }

    fn next(&mut self) -> Result<Option<Token>> {
        self.skip_space()?;
        let start = self.at;
        let rest = self.rest();
        let Some(c) = rest.chars().next() else { return Ok(None) };
        let kind = match c {
            '(' | '[' | '{' => self.single(TokenKind::Open(c)),
            ')' | ']' | '}' => self.single(TokenKind::Close(c)),
            ',' => self.single(TokenKind::Comma),
            ':' => self.single(TokenKind::Colon),
            '"' => {
                self.at += 1;
                TokenKind::Text(self.escaped(start, false)?)
            }
            '\'' => self.character(start, 1)?,
            '#' => self.attribute()?,
            '0'..='9' | '+' | '-' | '.' => self.number()?,
            'b' if rest.starts_with("b'") => self.number()?,
            'b' if rest.starts_with("b\"") => {
                self.at += 2;
                self.escaped(start, true)?;
                TokenKind::Scalar
            }
            'b' if rest.starts_with("br\"") || rest.starts_with("br#") => {
                self.at += 2;
                self.raw(start)?;
                TokenKind::Scalar
            }
            'r' if raw_text_ahead(&rest[1..]) => {
                self.at += 1;
                TokenKind::Text(self.raw(start)?)
            }
            'r' if rest.starts_with("r#") => {
                // `r#type` is a raw identifier, which may also contain `.`, `+` and `-`.
                self.at += 2;
                self.take_while(|c| continues_identifier(c) || matches!(c, '.' | '+' | '-'));
                TokenKind::Identifier
            }
            c if starts_identifier(c) => {
                self.take_while(continues_identifier);
                let name = &self.text[start..self.at];
                let is_number = ["inf", "inff32", "inff64", "NaN", "NaNf32", "NaNf64"].contains(&name);
                if is_number && self.rest().starts_with("..") {
                    self.at = start;
                    self.number()?
                } else {
                    TokenKind::Identifier
                }
            }
            c => {
                let mut error = self.error(
                    start..start + c.len_utf8(),
                    format!("unexpected `{}`", c.escape_debug()),
                    "not valid here",
                );
                match c {
                    '=' => error.help.push("a field is written `name: value`".into()),
                    '*' | '/' | '%' | '<' | '>' | '?' | '&' | '|' | '!' => {
                        error.help.push("expressions are in quotes: `\"2 * n\"`".into());
                    }
                    ';' => error.help.push("items are separated by `,`".into()),
                    _ => {}
                }
                return Err(error);
            }
        };
        Ok(Some(Token { kind, start, end: self.at }))
    }

    fn single(&mut self, kind: TokenKind) -> TokenKind {
        self.at += 1;
        kind
    }

    fn take_while(&mut self, holds: impl Fn(char) -> bool) {
        self.at += self.rest().find(|c| !holds(c)).unwrap_or(self.rest().len());
    }

    fn skip_space(&mut self) -> Result<()> {
        loop {
            self.take_while(is_space);
            let rest = self.rest();
            if rest.starts_with("//") {
                self.take_while(|c| c != '\n');
            } else if rest.starts_with("/*") {
                self.block_comment()?;
            } else {
                return Ok(());
            }
        }
    }

    /// Skips a block comment and the block comments nested in it.
    fn block_comment(&mut self) -> Result<()> {
        let start = self.at;
        let mut depth = 0;
        loop {
            let rest = self.rest();
            if rest.starts_with("/*") {
                (depth, self.at) = (depth + 1, self.at + 2);
            } else if rest.starts_with("*/") {
                (depth, self.at) = (depth - 1, self.at + 2);
                if depth == 0 {
                    return Ok(());
                }
            } else {
                match rest.chars().next() {
                    Some(c) => self.at += c.len_utf8(),
                    None => {
                        return Err(self.error(
                            start..start + 2,
                            "a comment is not closed",
                            "it starts here and has no `*/`",
                        ));
                    }
                }
                self.take_while(|c| c != '/' && c != '*');
            }
        }
    }

    fn attribute(&mut self) -> Result<TokenKind> {
        let start = self.at;
        let wrong = |lexer: &Lexer| {
            lexer
                .error(start..start + 1, "unexpected `#`", "this does not start an attribute")
                .with_help("an attribute is written `#![enable(implicit_some)]`, a comment `// ...`")
        };
        for expected in ['#', '!', '['] {
            self.skip_space()?;
            if !self.rest().starts_with(expected) {
                return Err(Box::new(wrong(self)));
            }
            self.at += 1;
        }
        loop {
            self.skip_space()?;
            match self.rest().chars().next() {
                Some(']') => return Ok(self.single(TokenKind::Attribute)),
                Some('(' | ')' | ',' | '=') => self.at += 1,
                Some(c) if c == '"' || starts_identifier(c) => {
                    self.next()?;
                }
                _ => return Err(Box::new(wrong(self))),
            }
        }
    }

    /// Reads a run of characters that starts like a number. It is a number, a byte (`b'x'`), or a range of these
    /// (`0..=9`).
    fn number(&mut self) -> Result<TokenKind> {
        let start = self.at;
        while let Some(&byte) = self.text.as_bytes().get(self.at) {
            let before = &self.text[start..self.at];
            let starts_operand = before.is_empty() || before.ends_with("..") || before.ends_with("..=");
            let is_hexadecimal = before.trim_start_matches(['+', '-']).starts_with("0x");
            let in_exponent = before.ends_with(['e', 'E']) && !is_hexadecimal;
            if starts_operand && self.rest().starts_with("b'") {
                self.character(self.at, 2)?;
                continue;
            }
            let fits = match byte {
                b'+' | b'-' => starts_operand || in_exponent,
                b'=' => before.ends_with(".."),
                _ => byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'.'),
            };
            if !fits {
                break;
            }
            self.at += 1;
        }
        Ok(TokenKind::Scalar)
    }

    /// Reads `'c'` or `b'c'`. `prefix` is the length in bytes of the opening `'` or `b'`.
    fn character(&mut self, start: usize, prefix: usize) -> Result<TokenKind> {
        self.at += prefix;
        match self.rest().chars().next() {
            Some('\\') => {
                self.at += 1;
                self.escape(prefix == 2)?;
            }
            Some(c) => self.at += c.len_utf8(),
            None => {}
        }
        if !self.rest().starts_with('\'') {
            let line = self.text[start..].lines().next().unwrap_or_default();
            let end = line[1..].find('\'').map_or(line.len(), |at| at + 2);
            return Err(Box::new(
                self.error(
                    start..start + end,
                    "this is not one character",
                    "single quotes hold one character",
                )
                .with_help("a string is written in double quotes"),
            ));
        }
        self.at += 1;
        Ok(TokenKind::Scalar)
    }

    /// Reads the rest of a string after its opening quote. In a byte string (`binary`), each `\x` escape is a byte.
    fn escaped(&mut self, start: usize, binary: bool) -> Result<Text> {
        let inside = self.at;
        let mut text = Text { value: String::new(), inside: inside..inside, steps: vec![(0, inside)] };
        loop {
            let Some(length) = self.rest().find(['"', '\\']) else {
                return Err(self.unclosed(start, inside));
            };
            text.value.push_str(&self.rest()[..length]);
            self.at += length + 1;
            if self.text.as_bytes()[self.at - 1] == b'"' {
                text.inside.end = self.at - 1;
                return Ok(text);
            }
            let before = (text.value.len(), self.at - 1);
            if let Some(line) = self.rest().strip_prefix("\r\n").or(self.rest().strip_prefix('\n')) {
                // A backslash at the end of a line skips the line break and the indentation that follows.
                self.at = self.text.len() - line.trim_start_matches([' ', '\t', '\n', '\r']).len();
            } else if self.rest().is_empty() {
                return Err(self.unclosed(start, inside));
            } else {
                text.value.push(self.escape(binary)?);
            }
            push_step(&mut text.steps, before);
            push_step(&mut text.steps, (text.value.len(), self.at));
        }
    }

    fn unclosed(&self, start: usize, inside: usize) -> Box<Diagnostic> {
        let quote = start..inside;
        self.error(quote, "a string is not closed", "it starts here and has no closing quote")
    }

    fn escape(&mut self, binary: bool) -> Result<char> {
        let start = self.at - 1;
        let wrong = |lexer: &Lexer, end: usize, label: &str| {
            lexer.error(start..lexer.text.ceil_char_boundary(end), "unknown escape", label)
        };
        let Some(c) = self.rest().chars().next() else {
            return Err(wrong(self, start + 1, "the string ends here"));
        };
        self.at += c.len_utf8();
        Ok(match c {
            '\'' | '"' | '\\' => c,
            'n' => '\n',
            'r' => '\r',
            't' => '\t',
            '0' => '\0',
            'x' => {
                let first =
                    self.hex_byte().ok_or_else(|| wrong(self, start + 4, "`\\x` takes two hex digits"))?;
                if binary || first < 0x80 {
                    return Ok(char::from(first));
                }
                // Several `\x` escapes may encode one UTF-8 character.
                let mut bytes = vec![first];
                loop {
                    if let Ok(decoded) = std::str::from_utf8(&bytes) {
                        return Ok(decoded.chars().next().unwrap_or_default());
                    }
                    let more = bytes.len() < 4 && self.rest().starts_with("\\x");
                    if more {
                        self.at += 2;
                    }
                    match self.hex_byte().filter(|_| more) {
                        Some(byte) => bytes.push(byte),
                        None => return Err(wrong(self, self.at, "these bytes are not a UTF-8 character")),
                    }
                }
            }
            'u' => {
                let label = "a character is written `\\u{1f642}`";
                let digits = self.rest().strip_prefix('{').and_then(|rest| rest.split_once('}')).map(|r| r.0);
                let digits =
                    digits.filter(|d| (1..=6).contains(&d.len()) && d.bytes().all(|b| b.is_ascii_hexdigit()));
                let code =
                    digits.and_then(|digits| u32::from_str_radix(digits, 16).ok()).and_then(char::from_u32);
                match (digits, code) {
                    (Some(digits), Some(c)) => {
                        self.at += digits.len() + 2;
                        c
                    }
                    _ => return Err(wrong(self, start + 2, label)),
                }
            }
            _ => {
                return Err(Box::new(
                    wrong(self, self.at, "no such escape").with_help("a backslash itself is written `\\\\`"),
                ));
            }
        })
    }

    fn hex_byte(&mut self) -> Option<u8> {
        let digits = self.rest().get(..2).filter(|d| d.bytes().all(|b| b.is_ascii_hexdigit()))?;
        self.at += 2;
        u8::from_str_radix(digits, 16).ok()
    }

    fn raw(&mut self, start: usize) -> Result<Text> {
        let hashes = self.rest().len() - self.rest().trim_start_matches('#').len();
        self.at += hashes;
        let closing = format!("\"{}", "#".repeat(hashes));
        if !self.rest().starts_with('"') {
            return Err(self.unclosed(start, self.at));
        }
        self.at += 1;
        let inside = self.at;
        let Some(length) = self.rest().find(&closing) else {
            return Err(Box::new(
                self.unclosed(start, inside).with_help(format!("this string ends with `{closing}`")),
            ));
        };
        let value = self.rest()[..length].to_string();
        self.at += length + closing.len();
        Ok(Text { value, inside: inside..inside + length, steps: vec![(0, inside)] })
    }
}

/// Appends a pair. Replaces the last pair if it has the same offset in the value, so that an offset after a line
/// continuation is also after it in the file.
fn push_step(steps: &mut Vec<(usize, usize)>, step: (usize, usize)) {
    match steps.last_mut() {
        Some(last) if last.0 == step.0 => *last = step,
        _ => steps.push(step),
    }
}

/// Returns true if a raw string follows the `r`: a quote, with or without `#` before it.
fn raw_text_ahead(rest: &str) -> bool {
    rest.trim_start_matches('#').starts_with('"')
}

// Accepts every non-ASCII character except white space: the `ron` crate checks them.
fn starts_identifier(c: char) -> bool {
    c == '_' || c.is_ascii_alphabetic() || !c.is_ascii() && !is_space(c)
}

fn continues_identifier(c: char) -> bool {
    starts_identifier(c) || c.is_ascii_digit()
}

fn is_space(c: char) -> bool {
    matches!(c, '\t'..='\r' | ' ' | '\u{85}' | '\u{200E}'..='\u{200F}' | '\u{2028}'..='\u{2029}')
}
