//! Splits GLSL into tokens with a small lexer, and lists the identifiers, includes and declarations of a text.
//!
//! The lexer handles comments, line continuations and strings. It evaluates nothing: all branches of an `#if` count.

use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::sync::Arc;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TokenKind {
    Identifier,
    Number,
    /// `"text"`, with its quotes.
    Text,
    Symbol,
    /// The end of a line that is not continued.
    Newline,
    /// A character that GLSL allows in comments only (NUL, or not ASCII), or a string with one.
    Foreign,
}

/// A token. Comments, and white space other than newlines, produce none. `start..end` is its byte range in the text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Token {
    pub kind: TokenKind,
    pub start: usize,
    pub end: usize,
}

impl Token {
    pub fn range(&self) -> Range<usize> {
        self.start..self.end
    }

    pub fn of<'t>(&self, text: &'t str) -> &'t str {
        &text[self.range()]
    }
}

/// Operators with several characters, longer ones first.
const OPERATORS: [&str; 22] = [
    "<<=", ">>=", "++", "--", "<<", ">>", "<=", ">=", "==", "!=", "&&", "||", "^^", "+=", "-=", "*=", "/=",
    "%=", "&=", "|=", "^=", "##",
];

pub(super) fn lex(text: &str) -> Vec<Token> {
    let bytes = text.as_bytes();
    let word = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
    let mut tokens = Vec::with_capacity(bytes.len() / 4);
    // Skip the byte order mark.
    let mut at = if text.starts_with('\u{feff}') { 3 } else { 0 };
    while at < bytes.len() {
        let start = at;
        let rest = &bytes[at..];
        let kind = match rest[0] {
            b'\n' => {
                at += 1;
                TokenKind::Newline
            }
            b if b.is_ascii_whitespace() => {
                at += 1;
                continue;
            }
            b'\\' if rest.starts_with(b"\\\n") || rest.starts_with(b"\\\r\n") => {
                at += if rest[1] == b'\n' { 2 } else { 3 };
                continue;
            }
            b'/' if rest.starts_with(b"//") => {
                at = end_of_line(bytes, at);
                continue;
            }
            b'/' if rest.starts_with(b"/*") => {
                at = text[at + 2..].find("*/").map_or(bytes.len(), |i| at + 2 + i + 2);
                continue;
            }
            b'"' => {
                at += 1;
                while at < bytes.len() && !matches!(bytes[at], b'"' | b'\n') {
                    at += 1;
                }
                if bytes.get(at) == Some(&b'"') {
                    at += 1;
                }
                TokenKind::Text
            }
            b if b.is_ascii_digit() || (b == b'.' && rest.get(1).is_some_and(u8::is_ascii_digit)) => {
                at += 1;
                while at < bytes.len() {
                    let exponent = matches!(bytes[at], b'+' | b'-')
                        && matches!(bytes[at - 1], b'e' | b'E')
                        && !rest.starts_with(b"0x")
                        && !rest.starts_with(b"0X");
                    if !(word(bytes[at]) || bytes[at] == b'.' || exponent) {
                        break;
                    }
                    at += 1;
                }
                TokenKind::Number
            }
            b if word(b) => {
                while at < bytes.len() && word(bytes[at]) {
                    at += 1;
                }
                TokenKind::Identifier
            }
            b if b == 0 || !b.is_ascii() => {
                at += text[at..].chars().next().map_or(1, char::len_utf8);
                TokenKind::Foreign
            }
            _ => {
                // Few symbols are followed by another, so the table is rarely searched.
                let longer = rest.get(1).is_some_and(u8::is_ascii_punctuation);
                let operator = OPERATORS.iter().find(|o| longer && rest.starts_with(o.as_bytes()));
                at += operator.map_or(1, |o| o.len());
                TokenKind::Symbol
            }
        };
        let foreign = kind == TokenKind::Text && bytes[start..at].iter().any(|&b| b == 0 || !b.is_ascii());
        tokens.push(Token { kind: if foreign { TokenKind::Foreign } else { kind }, start, end: at });
    }
    tokens
}

/// Returns the end of the line that contains `at`: its newline, unless a backslash continues the line.
fn end_of_line(bytes: &[u8], mut at: usize) -> usize {
    while at < bytes.len() {
        let rest = &bytes[at..];
        if rest.starts_with(b"\\\r\n") {
            at += 3;
        } else if rest.starts_with(b"\\\n") {
            at += 2;
        } else if rest[0] == b'\n' {
            break;
        } else {
            at += 1;
        }
    }
    at
}

/// Names and directives of a text, in any branch of its `#if`s.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Scan {
    pub identifiers: HashSet<String>,
    /// Names after `#include`, with their places (inside the quotes).
    pub includes: Vec<(String, Range<usize>)>,
    pub macros: HashSet<String>,
    /// All words, numbers and symbols after `#if` and `#elif`.
    pub conditions: HashSet<String>,
    /// Names of blocks and other `uniform` declarations, without push constants.
    pub bindings: Vec<String>,
    /// Place of the number in the first `#version`, and true if it is 460 in the core profile.
    pub version: Option<(Range<usize>, bool)>,
    /// The first token with a character that GLSL allows in comments only, if any.
    pub foreign: Option<Range<usize>>,
    /// The first `#line`, if any.
    pub line: Option<Range<usize>>,
}

/// Maximum number of entries in each map of [`Scans`]. A full map is emptied.
const MAX_KEPT: usize = 1024;

/// A text with its scan, shared by all shaders that include it.
#[derive(Clone, Debug)]
pub(super) struct Scanned {
    /// Number that identifies the text. Equal texts have the same number while fewer than [`MAX_KEPT`] texts are kept.
    pub id: u64,
    pub text: Arc<str>,
    pub scan: Arc<Scan>,
}

/// The scans of texts. Many shaders include the same texts, and most texts are unchanged from build to build.
#[derive(Debug, Default)]
pub(super) struct Scans {
    by_text: HashMap<Arc<str>, Scanned>,
    /// By [`SourceMap::serial`](crate::source::SourceMap), so that a file's text is hashed once.
    by_file: HashMap<u64, Scanned>,
    next: u64,
}

impl Scans {
    /// Returns the scan of a file's text. `serial` is the file's [`SourceMap::serial`](crate::source::SourceMap).
    pub fn of(&mut self, serial: u64, text: &str) -> Scanned {
        if let Some(scanned) = self.by_file.get(&serial) {
            return scanned.clone();
        }
        let scanned = match self.by_text.get(text) {
            Some(scanned) => scanned.clone(),
            None => {
                if self.by_text.len() >= MAX_KEPT {
                    self.by_text.clear();
                }
                self.next += 1;
                let scanned = Scanned { id: self.next, text: text.into(), scan: Arc::new(scan(text)) };
                self.by_text.insert(scanned.text.clone(), scanned.clone());
                scanned
            }
        };
        // Each build opens its files anew, so this map fills up much earlier than the other.
        if self.by_file.len() >= MAX_KEPT {
            self.by_file.clear();
        }
        self.by_file.insert(serial, scanned.clone());
        scanned
    }
}

fn scan(text: &str) -> Scan {
    let tokens = lex(text);
    let mut scan = Scan::default();
    let (mut line_starts, mut statement) = (true, 0);
    for (i, token) in tokens.iter().enumerate() {
        match token.kind {
            TokenKind::Identifier => {
                let name = token.of(text);
                if !scan.identifiers.contains(name) {
                    scan.identifiers.insert(name.to_owned());
                }
                let is_push = || tokens[statement..i].iter().any(|t| t.of(text) == "push_constant");
                if matches!(name, "buffer" | "uniform") && !is_push() {
                    scan.bindings.extend(binding_name(text, &tokens[i + 1..]).map(str::to_owned));
                }
            }
            TokenKind::Foreign if scan.foreign.is_none() => scan.foreign = Some(token.range()),
            TokenKind::Symbol if line_starts && token.of(text) == "#" => {
                let mut words = tokens[i + 1..].iter().take_while(|t| t.kind != TokenKind::Newline);
                let directive = words.next();
                let argument = words.next();
                match directive.map(|t| t.of(text)) {
                    Some("include") => {
                        let found = directive.and_then(|t| header_name(text, t.end));
                        scan.includes.extend(found.map(|(name, place)| (name.to_owned(), place)));
                    }
                    Some("if" | "elif") => {
                        let rest = argument.into_iter().chain(words);
                        scan.conditions.extend(rest.map(|token| token.of(text).to_owned()));
                    }
                    Some("line") if scan.line.is_none() => {
                        scan.line = directive.map(|directive| token.start..directive.end);
                    }
                    Some("define") => scan.macros.extend(argument.map(|t| t.of(text).to_owned())),
                    Some("version") if scan.version.is_none() => {
                        let number = argument.map_or(token.range(), Token::range);
                        let profile = words.next().map(|t| t.of(text));
                        let right = &text[number.clone()] == "460" && matches!(profile, None | Some("core"));
                        scan.version = Some((number, right));
                    }
                    _ => {}
                }
            }
            TokenKind::Symbol if matches!(token.of(text), ";" | "{" | "}") => statement = i + 1,
            _ => {}
        }
        line_starts = token.kind == TokenKind::Newline;
    }
    scan
}

/// Lists the identifiers of a text that do not follow a dot.
pub(super) fn names(text: &str) -> impl Iterator<Item = &str> {
    let (mut tokens, mut before) = (lex(text), "");
    tokens.retain(|token| {
        let follows_dot = std::mem::replace(&mut before, token.of(text)) == ".";
        token.kind == TokenKind::Identifier && !follows_dot
    });
    tokens.into_iter().map(|token| token.of(text))
}

/// Returns the name that a declaration after `buffer` or `uniform` declares. It is the last word before a brace, a
/// bracket or a semicolon. `None` if it only sets a default layout.
fn binding_name<'t>(text: &'t str, tokens: &[Token]) -> Option<&'t str> {
    let is_word = |token: &&Token| matches!(token.kind, TokenKind::Identifier | TokenKind::Newline);
    let words = tokens.iter().take_while(is_word).filter(|token| token.kind == TokenKind::Identifier);
    words.last().map(|token| token.of(text))
}

/// Returns the name in quotes or angle brackets at `at`, with its place; `None` if there is none.
fn header_name(text: &str, at: usize) -> Option<(&str, Range<usize>)> {
    let line = text[at..].split('\n').next()?;
    let quoted = line.trim_start_matches([' ', '\t']);
    let close = match quoted.as_bytes().first()? {
        b'"' => '"',
        b'<' => '>',
        _ => return None,
    };
    let name = &quoted[1..1 + quoted[1..].find(close)?];
    let start = at + (line.len() - quoted.len()) + 1;
    Some((name, start..start + name.len()))
}

/// Replaces a byte order mark, NUL and all non-ASCII bytes, which occur only in comments. The result is ASCII, and has
/// the same byte offsets.
pub(super) fn to_ascii(text: &str) -> String {
    if text.is_ascii() && !text.contains('\0') {
        return text.to_owned();
    }
    let mut bytes = text.as_bytes().to_vec();
    if text.starts_with('\u{feff}') {
        bytes[..3].fill(b' ');
    }
    bytes.iter().map(|&b| if b == 0 || !b.is_ascii() { '?' } else { b as char }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_hide_identifiers_and_includes() {
        let scan = scan("a /* b\n#include \"x\"\n */ c // d \\\n still\n#include \"y\"\ne");
        assert_eq!(scan.identifiers, HashSet::from(["a", "c", "include", "e"].map(String::from)));
        assert_eq!(scan.includes.iter().map(|i| i.0.as_str()).collect::<Vec<_>>(), ["y"]);
    }

    #[test]
    fn blocks_and_images_are_declarations_and_words_in_comments_are_none() {
        let scan = scan(
            "// buffer Past { uint p[]; };\n/* uniform Gone { float g; }; */\nlayout(std430) buffer;\n\
             #if 0\nlayout(binding = 0) readonly buffer\n  Keys { uint keys[]; } named[2];\n#endif\n\
             layout(rgba16f) uniform writeonly image2D image;\nuniform image2D images[3];\n\
             layout(push_constant) uniform Push { uint shift; };\nuint local = 1;\n",
        );
        assert_eq!(scan.bindings, ["Keys", "image", "images"]);
    }

    #[test]
    fn an_include_is_found_with_its_place_however_it_is_written() {
        let text = "  # /* so */ include   <a/b.glsl>\n#include \"c//d.glsl\" // why\nx #include \"no\"\n#include nothing\n";
        let scan = scan(text);
        assert_eq!(scan.includes.iter().map(|i| i.0.as_str()).collect::<Vec<_>>(), ["a/b.glsl", "c//d.glsl"]);
        assert!(scan.includes.iter().all(|(name, range)| text[range.clone()] == *name));
    }

    #[test]
    fn numbers_end_where_they_end() {
        let text = "1.0e-3+.5f-0x1Fu+0xe+1-a.x";
        let tokens: Vec<_> = lex(text).iter().map(|t| t.of(text)).collect();
        assert_eq!(tokens, ["1.0e-3", "+", ".5f", "-", "0x1Fu", "+", "0xe", "+", "1", "-", "a", ".", "x"]);
    }

    #[test]
    fn foreign_characters_are_allowed_in_comments_only() {
        assert_eq!(scan("/* é */ a // ü\0").foreign, None);
        assert_eq!(scan("float é;").foreign, Some(6..8));
        assert_eq!(to_ascii("\u{feff}a // é"), "   a // ??");
    }

    #[test]
    fn the_version_may_follow_comments() {
        assert_eq!(scan("// hi\n#version 460\n").version, Some((15..18, true)));
        assert_eq!(scan("#version 310 es\n").version, Some((9..12, false)));
        assert_eq!(scan("void main() {}").version, None);
    }

    #[test]
    fn a_text_keeps_its_number_over_many_builds() {
        let mut scans = Scans::default();
        let first = scans.of(0, "a").id;
        assert!((1..3 * MAX_KEPT as u64).all(|serial| scans.of(serial, "a").id == first));
        assert!(scans.by_file.len() <= MAX_KEPT);
        assert_ne!(scans.of(u64::MAX, "b").id, first);
    }
}
