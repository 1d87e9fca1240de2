//! Parses text layers.
//!
//! A prim is `def Type "name" ( metadata ) { attributes and children }`; an attribute is
//! `type name = value ( metadata )`. Only the attributes that [`kind_of`] knows are converted; the values of all others
//! are skipped by matching brackets.

use super::layer::{ARCS, Array, Kind, Layer, Numbers, Prim, Value, kind_of};
use crate::error::{SceneError, row};
use crate::scalar::Scalar;
use half::f16;
use std::fmt::Display;

pub(crate) const MAGIC: &[u8; 6] = b"#usda ";

/// Keywords that can precede the type of an attribute.
const MODIFIERS: [&str; 8] = ["custom", "uniform", "varying", "config", "prepend", "append", "add", "delete"];

/// Maximum number of numbers in a value that is not an array: the elements of a 4 x 4 matrix.
const MAX_NUMBERS: usize = 16;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Token<'t> {
    /// A name or a keyword.
    Word(&'t str),
    /// The contents of a string, an asset's name or a path.
    Text(&'t str),
    Number(f64),
    /// A bracket, or another punctuation mark.
    Mark(u8),
    End,
}

struct Parser<'t> {
    text: &'t [u8],
    at: usize,
}

pub(super) fn parse(text: &[u8]) -> Result<Layer, SceneError> {
    let mut parser = Parser { text, at: 0 };
    if !text.starts_with(MAGIC) {
        return Err(parser.wrong("expected #usda, found other bytes"));
    }
    parser.layer()
}

fn is_word(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b':' | b'.') || byte >= 0x80
}

impl<'t> Parser<'t> {
    fn wrong(&self, message: impl Display) -> SceneError {
        let before = &self.text[..self.at.min(self.text.len())];
        let line = 1 + before.iter().filter(|byte| **byte == b'\n').count() as u64;
        row(line, message)
    }

    fn unexpected(&self, expected: &str, found: Token) -> SceneError {
        let found = match found {
            Token::Word(text) | Token::Text(text) => text.chars().take(40).collect(),
            Token::Number(number) => number.to_string(),
            Token::Mark(byte) => char::from(byte).to_string(),
            Token::End => "the end of the file".into(),
        };
        self.wrong(format!("expected {expected}, found {found}"))
    }

    fn skip_blanks(&mut self) {
        while let Some(byte) = self.text.get(self.at) {
            match byte {
                b'#' => {
                    let rest = &self.text[self.at..];
                    self.at += rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len());
                }
                b';' => self.at += 1,
                byte if byte.is_ascii_whitespace() => self.at += 1,
                _ => return,
            }
        }
    }

    fn utf8(&self, from: usize, to: usize) -> Result<&'t str, SceneError> {
        std::str::from_utf8(&self.text[from..to]).map_err(|_| self.wrong("expected UTF-8"))
    }

    /// Returns the text from `from` to a closing mark, and advances past the mark. Fails if there is none. If `escapes`
    /// is true, a backslash escapes the next byte; backslashes stay in the text.
    fn until(&mut self, from: usize, close: &[u8], escapes: bool) -> Result<Token<'t>, SceneError> {
        let mut at = from;
        loop {
            match self.text.get(at..) {
                None | Some([]) => {
                    return Err(self.wrong("expected the end of a string, found the end of the file"));
                }
                Some([b'\\', ..]) if escapes => at += 2,
                Some(rest) if rest.starts_with(close) => break,
                Some(_) => at += 1,
            }
        }
        let text = self.utf8(from, at)?;
        self.at = at + close.len();
        Ok(Token::Text(text))
    }

    fn next(&mut self) -> Result<Token<'t>, SceneError> {
        self.skip_blanks();
        let rest = &self.text[self.at.min(self.text.len())..];
        let Some(first) = rest.first() else { return Ok(Token::End) };
        let at = self.at;
        match first {
            b'"' | b'\'' => {
                let quote = [*first; 3];
                let width = if rest.starts_with(&quote) { 3 } else { 1 };
                self.until(at + width, &quote[..width], true)
            }
            b'@' => {
                let width = if rest.starts_with(b"@@@") { 3 } else { 1 };
                self.until(at + width, &b"@@@"[..width], false)
            }
            b'<' => self.until(at + 1, b">", false),
            b'0'..=b'9' | b'-' | b'+' => Ok(Token::Number(self.number()?)),
            byte if is_word(*byte) => {
                let length = rest.iter().position(|byte| !is_word(*byte)).unwrap_or(rest.len());
                self.at += length;
                Ok(Token::Word(self.utf8(at, at + length)?))
            }
            byte => {
                self.at += 1;
                Ok(Token::Mark(*byte))
            }
        }
    }

    fn peek(&mut self) -> Result<Token<'t>, SceneError> {
        let at = self.at;
        let token = self.next();
        self.at = at;
        token
    }

    /// Consumes a mark if it is next. Returns true if it was.
    fn skip(&mut self, mark: u8) -> bool {
        self.skip_blanks();
        let found = self.text.get(self.at) == Some(&mark);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, mark: u8) -> Result<(), SceneError> {
        if self.skip(mark) {
            return Ok(());
        }
        let found = self.next()?;
        Err(self.unexpected(&char::from(mark).to_string(), found))
    }

    /// Reads a number; `inf` and `nan` are numbers as well.
    fn number(&mut self) -> Result<f64, SceneError> {
        self.skip_blanks();
        let rest = &self.text[self.at.min(self.text.len())..];
        let end = |byte: &u8| byte.is_ascii_whitespace() || b",)]}(;:#".contains(byte);
        let length = rest.iter().take(64).position(end).unwrap_or(rest.len().min(64));
        let text = std::str::from_utf8(&rest[..length]).unwrap_or_default();
        let number = text.parse().map_err(|_| {
            let found: String = String::from_utf8_lossy(&rest[..length.min(20)]).into_owned();
            self.wrong(format!("expected a number, found {found}"))
        })?;
        self.at += length;
        Ok(number)
    }

    fn skip_value(&mut self) -> Result<(), SceneError> {
        let mut depth = 0u64;
        loop {
            match self.next()? {
                Token::End => return Err(self.wrong("expected a value, found the end of the file")),
                Token::Mark(b'[' | b'(' | b'{') => depth += 1,
                Token::Mark(b']' | b')' | b'}') if depth == 0 => {
                    return Err(self.wrong("expected a value, found a closing bracket"));
                }
                Token::Mark(b']' | b')' | b'}') => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                return Ok(());
            }
        }
    }

    /// Reads metadata after its opening bracket.
    ///
    /// Calls `entry` with the name of each entry, before its value. A value that `entry` does not consume is skipped.
    fn metadata(
        &mut self,
        mut entry: impl FnMut(&mut Self, &'t str) -> Result<(), SceneError>,
    ) -> Result<(), SceneError> {
        loop {
            match self.next()? {
                Token::Mark(b')') => return Ok(()),
                // A comment, or the rest of a reference: a path, and its offset in brackets.
                Token::Text(_) | Token::Mark(b',') => {}
                Token::Mark(b'(') => {
                    self.at -= 1;
                    self.skip_value()?;
                }
                Token::Word(word) if MODIFIERS.contains(&word) || word == "reorder" => {}
                Token::Word(name) => {
                    self.expect(b'=')?;
                    let before = self.at;
                    entry(self, name)?;
                    if self.at == before {
                        self.skip_value()?;
                    }
                }
                found => return Err(self.unexpected("an entry of metadata", found)),
            }
        }
    }

    fn layer(&mut self) -> Result<Layer, SceneError> {
        let mut layer = Layer { kind: "usda", ..Layer::default() };
        // The first line, `#usda 1.0`, is skipped as a comment.
        if self.skip(b'(') {
            self.metadata(|parser, name| {
                match (name, parser.peek()?) {
                    ("upAxis", Token::Text(axis)) => layer.up_axis = Some(axis.into()),
                    _ if ARCS.contains(&name) => layer.arc = Some(name.into()),
                    _ => {}
                }
                Ok(())
            })?;
        }
        // Prims that are not closed yet, the outermost first.
        let mut open: Vec<usize> = Vec::new();
        loop {
            match self.next()? {
                Token::End if open.is_empty() => return Ok(layer),
                Token::Mark(b'}') if !open.is_empty() => drop(open.pop()),
                Token::Word(specifier @ ("def" | "over" | "class")) => {
                    let prim = self.prim(&mut layer, specifier, open.last().copied())?;
                    open.push(prim);
                }
                Token::Word(word @ ("reorder" | "variantSet")) => {
                    if word == "variantSet" {
                        layer.arc = Some(word.into());
                    }
                    self.next()?;
                    self.expect(b'=')?;
                    self.skip_value()?;
                }
                Token::Word(word) if !open.is_empty() => {
                    let prim = open[open.len() - 1];
                    self.property(&mut layer.prims[prim], word)?;
                }
                found => return Err(self.unexpected("a prim or an attribute", found)),
            }
        }
    }

    fn prim(
        &mut self,
        layer: &mut Layer,
        specifier: &str,
        parent: Option<usize>,
    ) -> Result<usize, SceneError> {
        let mut prim = Prim { parent, defined: specifier == "def", ..Prim::default() };
        let mut token = self.next()?;
        if let Token::Word(kind) = token {
            prim.kind = kind.into();
            token = self.next()?;
        }
        let Token::Text(name) = token else { return Err(self.unexpected("the name of a prim", token)) };
        prim.name = name.into();
        if self.skip(b'(') {
            self.metadata(|parser, name| {
                match (name, parser.peek()?) {
                    ("active", Token::Word("false")) => prim.inactive = true,
                    ("active", Token::Number(value)) => prim.inactive = value == 0.0,
                    _ if ARCS.contains(&name) => layer.arc = Some(name.into()),
                    _ => {}
                }
                Ok(())
            })?;
        }
        self.expect(b'{')?;
        layer.prims.push(prim);
        Ok(layer.prims.len() - 1)
    }

    /// Reads an attribute, whose first word is `word`, into `prim`. Skips relationships, and attributes without a
    /// [`kind_of`].
    fn property(&mut self, prim: &mut Prim, mut word: &'t str) -> Result<(), SceneError> {
        while MODIFIERS.contains(&word) {
            word = match self.next()? {
                Token::Word(next) => next,
                found => return Err(self.unexpected("the type of an attribute", found)),
            };
        }
        let kind = word;
        if self.skip(b'[') {
            self.expect(b']')?;
        }
        let name = match self.next()? {
            Token::Word(name) => name,
            found => return Err(self.unexpected("the name of an attribute", found)),
        };
        let (name, suffix) = name.split_once('.').unwrap_or((name, ""));
        let wanted = kind_of(name).filter(|_| kind != "rel");
        if matches!(suffix, "timeSamples" | "spline") && wanted.is_some() {
            prim.attributes.entry(name.into()).or_default().animated = true;
        }
        if self.skip(b'=') {
            match wanted.filter(|_| suffix.is_empty()) {
                Some(_) if self.peek()? == Token::Word("None") => self.skip_value()?,
                Some(wanted) => {
                    let value = self.value(wanted, kind)?;
                    prim.attributes.entry(name.into()).or_default().value = Some(value);
                }
                None => self.skip_value()?,
            }
        }
        if self.skip(b'(') {
            self.metadata(|_, _| Ok(()))?;
        }
        Ok(())
    }

    /// Reads a value of the kind `wanted`. `kind` is the name of its type.
    fn value(&mut self, wanted: Kind, kind: &str) -> Result<Value, SceneError> {
        // For example `half3`, `quath` and `point3h`.
        let is_half = kind.starts_with("half") || kind.ends_with('h');
        match wanted {
            Kind::Words => {
                let mut words = Vec::new();
                if !self.skip(b'[') {
                    return match self.next()? {
                        Token::Text(word) => Ok(Value::Words(vec![word.into()])),
                        found => Err(self.unexpected("a token", found)),
                    };
                }
                loop {
                    match self.next()? {
                        Token::Text(word) => words.push(word.into()),
                        Token::Mark(b',') => {}
                        Token::Mark(b']') => return Ok(Value::Words(words)),
                        found => return Err(self.unexpected("a token", found)),
                    }
                }
            }
            Kind::Numbers => {
                let mut numbers = Vec::new();
                let mut depth = 0;
                loop {
                    if self.skip(b'(') {
                        depth += 1;
                    } else if depth > 0 && self.skip(b')') {
                        depth -= 1;
                    } else if depth == 0 || !self.skip(b',') {
                        numbers.push(self.number()?);
                    }
                    if numbers.len() > MAX_NUMBERS {
                        return Err(self.wrong(format!("expected at most {MAX_NUMBERS} numbers, found more")));
                    }
                    if depth == 0 {
                        return Ok(Value::Numbers(numbers));
                    }
                }
            }
            Kind::Array(width) => self.array(width, is_half).map(Value::Array),
        }
    }

    fn array(&mut self, width: usize, is_half: bool) -> Result<Array, SceneError> {
        self.expect(b'[')?;
        let start = self.at;
        let scalar = if is_half { Scalar::F16 } else { Scalar::F32 };
        let mut bytes = Vec::new();
        while !self.skip(b']') {
            if width > 1 {
                self.expect(b'(')?;
            }
            for component in 0..width {
                if component > 0 {
                    self.expect(b',')?;
                }
                let value = self.number()?;
                bytes.try_reserve(scalar.size()).map_err(std::io::Error::from)?;
                match is_half {
                    true => bytes.extend(f16::from_f64(value).to_le_bytes()),
                    false => bytes.extend((value as f32).to_le_bytes()),
                }
            }
            if width > 1 {
                self.expect(b')')?;
            }
            if !self.skip(b',') {
                self.expect(b']')?;
                break;
            }
        }
        Ok(Array {
            width,
            count: (bytes.len() / (width * scalar.size())) as u64,
            scalar,
            kind: scalar.name(),
            numbers: Numbers::Memory(bytes.into()),
            real_last: false,
            at: start as u64,
            bytes: (self.at - start) as u64,
        })
    }
}
