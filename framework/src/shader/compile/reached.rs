//! Follows the preprocessor through a shader, to find the names whose values its output can depend on.
//!
//! [`scan`] lists every identifier of a text, including inactive branches of `#if`s, where a define cannot change the
//! compiled shader. This module evaluates the `#if`s with the defines of the compilation. It collects the identifiers
//! of compiled lines, of the macros that they expand, and of conditions as far as they are evaluated (`&&` and `||`
//! short-circuit). It errs on the side of too many names: if it cannot evaluate a condition (because of an extension, a
//! function-like macro or a division by zero), all branches count.
//!
//! It also finds undefined names in conditions, which the preprocessor silently treats as 0, and declarations of a
//! define's name.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::generate::{INCLUDE_BYTES, MAX_DEPTH, MAX_INCLUDED_BYTES};
use super::scan::{Token, TokenKind, lex};

/// Maximum number of words visited while expanding a condition. A longer one is not evaluated.
const MAX_WORDS: usize = 10_000;
/// Maximum nesting of parentheses and signs in a condition. A deeper one is not evaluated.
const MAX_NESTED: usize = 100;

/// A text of a shader, and its includes: indices of their texts, by name.
pub(super) struct Text<'t> {
    pub text: &'t str,
    pub includes: BTreeMap<&'t str, usize>,
}

#[derive(Debug, PartialEq)]
pub(super) struct Reached {
    /// The identifiers that the result of preprocessing can depend on.
    pub names: BTreeSet<String>,
    /// The first undefined name in a condition: the index of its text, and its bytes. Operands of `defined` do not
    /// count, nor do names that the compiler or an extension may define.
    pub undefined: Option<(usize, Range<usize>)>,
    /// The first define that a compiled line declares, as in `uint COUNT`, `buffer COUNT` or `#define COUNT 3`. Given
    /// by the index of its text, and its bytes.
    pub redeclared: Option<(usize, Range<usize>)>,
}

/// Finds the names that the preprocessor reaches from `texts[0]` with `defines`. `None` if the texts cannot be
/// followed: their includes are too large or too deep, or they paste names together.
pub(super) fn reached<'t>(texts: &'t [Text<'t>], defines: &'t [(String, String)]) -> Option<Reached> {
    let words: Vec<Vec<Word>> =
        texts.iter().enumerate().map(|(index, text)| words(text.text, index)).collect();
    if words.iter().flatten().any(|word| word.text == "##") {
        return None;
    }
    let mut walk = Walk {
        texts,
        words: &words,
        defines: defines.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect(),
        macros: BTreeMap::new(),
        names: BTreeSet::new(),
        undefined: None,
        redeclared: None,
        bytes: 0,
    };
    walk.text(0, Truth::Yes, 0)?;
    let Walk { names, undefined, redeclared, .. } = walk;
    Some(Reached { names: names.into_iter().map(str::to_owned).collect(), undefined, redeclared })
}

/// Three-valued truth: whether lines are compiled, or whether a condition holds.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Truth {
    No,
    Unknown,
    Yes,
}

impl Truth {
    fn not(self) -> Truth {
        match self {
            Truth::No => Truth::Yes,
            Truth::Unknown => Truth::Unknown,
            Truth::Yes => Truth::No,
        }
    }
}

impl From<Option<i64>> for Truth {
    fn from(value: Option<i64>) -> Truth {
        match value {
            None => Truth::Unknown,
            Some(0) => Truth::No,
            Some(_) => Truth::Yes,
        }
    }
}

struct Group {
    /// Certainty that the current branch is compiled.
    active: Truth,
    /// Certainty that this branch or an earlier one is compiled.
    taken: Truth,
}

#[derive(Clone, Copy)]
struct Word<'t> {
    kind: TokenKind,
    text: &'t str,
    /// True if no space separates the word from the previous one.
    joined: bool,
    /// Index of the text that contains the word, and the word's first byte in it.
    at: (usize, usize),
}

/// A macro defined by the shader itself.
#[derive(Clone)]
struct Macro<'t> {
    /// The words of every definition that may be in force.
    body: Vec<Word<'t>>,
    /// True if the macro has no parameters.
    plain: bool,
    /// True if exactly one definition is in force.
    certain: bool,
}

struct Walk<'t> {
    texts: &'t [Text<'t>],
    /// The words of each text.
    words: &'t [Vec<Word<'t>>],
    defines: BTreeMap<&'t str, &'t str>,
    macros: BTreeMap<&'t str, Macro<'t>>,
    names: BTreeSet<&'t str>,
    undefined: Option<(usize, Range<usize>)>,
    redeclared: Option<(usize, Range<usize>)>,
    bytes: usize,
}

impl<'t> Walk<'t> {
    /// Walks over a text; `None` if it cannot be followed. `active` is the certainty that its `#include` is compiled.
    fn text(&mut self, index: usize, active: Truth, depth: usize) -> Option<()> {
        if depth > MAX_DEPTH || self.bytes > MAX_INCLUDED_BYTES {
            return None;
        }
        let mut groups: Vec<Group> = Vec::new();
        for line in self.words[index].split(|word| word.kind == TokenKind::Newline) {
            let around = |groups: &[Group]| groups.iter().map(|group| group.active).fold(active, Truth::min);
            let now = around(&groups);
            let (directive, rest) = match line {
                [sign, directive, rest @ ..] if sign.text == "#" => (directive.text, rest),
                _ => ("", line),
            };
            match directive {
                "if" | "ifdef" | "ifndef" => {
                    let holds =
                        if now == Truth::No { Truth::No } else { self.condition(directive, rest, now) };
                    groups.push(Group { active: holds, taken: holds });
                }
                "elif" | "else" => {
                    let Some(mut group) = groups.pop() else { continue };
                    let open = group.taken.not();
                    let holds = match open.min(around(&groups)) {
                        Truth::No => Truth::No,
                        _ if directive == "else" => Truth::Yes,
                        now => self.condition("if", rest, now),
                    };
                    group.active = holds.min(open);
                    group.taken = group.taken.max(holds);
                    groups.push(group);
                }
                "endif" => drop(groups.pop()),
                _ if now == Truth::No => {}
                "include" => {
                    let name: String =
                        rest.iter().map(|word| word.text.trim_matches(['"', '<', '>'])).collect();
                    if let Some(target) = self.texts[index].includes.get(name.as_str()) {
                        self.bytes += self.texts[*target].text.len() + INCLUDE_BYTES;
                        self.text(*target, now, depth + 1)?;
                    }
                }
                "define" => self.define(rest, now),
                "undef" => self.undefine(rest, now),
                _ => {
                    if now == Truth::Yes && directive.is_empty() {
                        self.find_declared(rest);
                    }
                    self.reach_all(rest);
                }
            }
        }
        Some(())
    }

    /// Finds the first define that a compiled line declares. Two words in a row are a declaration, unless the first is
    /// a statement's keyword or a macro.
    fn find_declared(&mut self, words: &[Word<'t>]) {
        let is_define = |word: &Word<'t>| self.defines.contains_key(word.text);
        let declares = |two: &&[Word<'t>]| {
            let [first, second] = two else { return false };
            first.kind == TokenKind::Identifier
                && !matches!(first.text, "return" | "case" | "else" | "do")
                && !self.macros.contains_key(first.text)
                && !is_define(first)
                && is_define(second)
        };
        let name = words.windows(2).find(declares).map(|two| two[1]);
        self.note_redeclared(name);
    }

    fn note_redeclared(&mut self, name: Option<Word<'t>>) {
        let place = name.map(|name| (name.at.0, name.at.1..name.at.1 + name.text.len()));
        self.redeclared = self.redeclared.take().or(place);
    }

    fn define(&mut self, words: &[Word<'t>], now: Truth) {
        let [name, body @ ..] = words else { return };
        self.names.insert(name.text);
        let value: String = body.iter().map(|word| word.text).collect();
        // The preprocessor accepts a second definition that equals the first.
        if now == Truth::Yes && self.defines.get(name.text).is_some_and(|define| *define != value) {
            self.note_redeclared(Some(*name));
        }
        let plain = !body.first().is_some_and(|first| first.text == "(" && first.joined);
        let new = Macro { body: body.to_vec(), plain, certain: now == Truth::Yes };
        match self.macros.get_mut(name.text) {
            Some(old) if now != Truth::Yes => {
                old.body.extend(new.body);
                old.certain = false;
            }
            _ => drop(self.macros.insert(name.text, new)),
        }
    }

    fn undefine(&mut self, words: &[Word<'t>], now: Truth) {
        let Some(name) = words.first() else { return };
        self.names.insert(name.text);
        if now == Truth::Yes {
            self.macros.remove(name.text);
            self.defines.remove(name.text);
        } else {
            let none = Macro { body: Vec::new(), plain: true, certain: false };
            self.macros.entry(name.text).or_insert(none).certain = false;
        }
    }

    /// Adds the identifiers of compiled words and of their macros.
    fn reach_all(&mut self, words: &[Word<'t>]) {
        let identifiers = |words: &[Word<'t>]| -> Vec<&'t str> {
            words.iter().filter(|word| word.kind == TokenKind::Identifier).map(|word| word.text).collect()
        };
        let mut open = identifiers(words);
        let mut expanded = BTreeSet::new();
        while let Some(name) = open.pop() {
            self.names.insert(name);
            if let Some(found) = self.macros.get(name).filter(|_| expanded.insert(name)) {
                open.extend(identifiers(&found.body));
            }
        }
    }

    /// Evaluates a condition; `now` says whether the compiler evaluates it. If an `#if` has no known value, adds all of
    /// its identifiers to the names.
    fn condition(&mut self, directive: &str, words: &[Word<'t>], now: Truth) -> Truth {
        match (directive, words) {
            ("if", words) => {
                let mut expanded = Vec::new();
                let value = self.expand(words, &mut expanded, 0, &mut { MAX_WORDS });
                let certain = now == Truth::Yes;
                let value = value.and_then(|()| {
                    Condition { words: &expanded, at: 0, nested: 0, certain, walk: self }.value()
                });
                if value.is_none() {
                    self.reach_all(words);
                }
                value.into()
            }
            (_, [name, ..]) => {
                let defined = self.defined(name.text);
                if directive == "ifdef" { defined } else { defined.not() }
            }
            _ => Truth::Unknown,
        }
    }

    fn defined(&mut self, name: &'t str) -> Truth {
        self.names.insert(name);
        match self.macros.get(name) {
            Some(found) if found.certain => Truth::Yes,
            Some(_) => Truth::Unknown,
            None if self.defines.contains_key(name) => Truth::Yes,
            None if is_the_compilers(name) => Truth::Unknown,
            None => Truth::No,
        }
    }

    /// Replaces the shader's own macros by their bodies. Defines of the compilation keep their names, so that the
    /// evaluation records which of them it reads. `None` for macros with parameters or without a certain definition,
    /// beyond [`MAX_DEPTH`] nested macros, and after `left` words.
    fn expand(
        &self,
        words: &[Word<'t>],
        into: &mut Vec<Word<'t>>,
        depth: usize,
        left: &mut usize,
    ) -> Option<()> {
        for (i, word) in words.iter().enumerate() {
            *left = left.checked_sub(1)?;
            let asked = match &words[..i] {
                [.., before] if before.text == "defined" => true,
                [.., before, open] => before.text == "defined" && open.text == "(",
                _ => false,
            };
            match self.macros.get(word.text).filter(|_| !asked) {
                None => into.push(*word),
                Some(found) if found.certain && found.plain && depth < MAX_DEPTH => {
                    self.expand(&found.body, into, depth + 1, left)?;
                }
                Some(_) => return None,
            }
        }
        Some(())
    }
}

/// Returns true for names that the compiler or an extension may define.
fn is_the_compilers(name: &str) -> bool {
    name.starts_with("GL_") || name.starts_with("__") || name == "VULKAN"
}

fn words(text: &str, index: usize) -> Vec<Word<'_>> {
    let mut end = 0;
    let word = |token: &Token| {
        let joined = token.start == std::mem::replace(&mut end, token.end);
        Word { kind: token.kind, text: token.of(text), joined, at: (index, token.start) }
    };
    lex(text).iter().map(word).collect()
}

/// An evaluator for the expression of an `#if`. Unknown values are `None`.
struct Condition<'w, 't, 'a> {
    words: &'w [Word<'t>],
    at: usize,
    nested: usize,
    /// True if the compiler certainly evaluates the current operand.
    certain: bool,
    walk: &'a mut Walk<'t>,
}

/// Binary operators with their precedence (higher binds tighter).
const OPERATORS: [(&str, u8); 18] = [
    ("||", 1),
    ("&&", 2),
    ("|", 3),
    ("^", 4),
    ("&", 5),
    ("==", 6),
    ("!=", 6),
    ("<", 7),
    (">", 7),
    ("<=", 7),
    (">=", 7),
    ("<<", 8),
    (">>", 8),
    ("+", 9),
    ("-", 9),
    ("*", 10),
    ("/", 10),
    ("%", 10),
];

impl Condition<'_, '_, '_> {
    fn value(mut self) -> Option<i64> {
        let value = self.binary(1, true)?;
        if self.at == self.words.len() { value } else { None }
    }

    /// Evaluates operands joined by operators that bind at least as tightly as `least`. The outer `None` is a syntax
    /// error or too deep a nesting. Names count as read only if `live`.
    fn binary(&mut self, least: u8, live: bool) -> Option<Option<i64>> {
        let mut left = self.operand(live)?;
        while let Some(word) = self.words.get(self.at)
            && let Some((operator, precedence)) = OPERATORS.iter().find(|entry| entry.0 == word.text)
            && *precedence >= least
        {
            self.at += 1;
            let decides = match *operator {
                "&&" => left == Some(0),
                "||" => left.is_some_and(|v| v != 0),
                _ => false,
            };
            let certain = self.certain;
            // An unknown left side may short-circuit.
            self.certain &= left.is_some() || !matches!(*operator, "&&" | "||");
            let right = self.binary(precedence + 1, live && !decides)?;
            self.certain = certain;
            left = if decides { left.map(|v| i64::from(v != 0)) } else { combine(operator, left, right) };
        }
        Some(left)
    }

    fn operand(&mut self, live: bool) -> Option<Option<i64>> {
        let word = *self.words.get(self.at)?;
        self.at += 1;
        self.nested += 1;
        if self.nested > MAX_NESTED {
            return None;
        }
        let value = match (word.kind, word.text) {
            (_, "(") => {
                let value = self.binary(1, live)?;
                self.close()?;
                value
            }
            (_, "!") => self.operand(live)?.map(|v| i64::from(v == 0)),
            (_, "-") => combine("-", Some(0), self.operand(live)?),
            (_, "+") => self.operand(live)?,
            (_, "~") => self.operand(live)?.map(|v| !v),
            (TokenKind::Number, text) => number(text),
            (TokenKind::Identifier, "defined") => {
                let mut name = *self.words.get(self.at)?;
                self.at += 1;
                let open = name.text == "(";
                if open {
                    name = *self.words.get(self.at)?;
                    self.at += 1;
                    self.close()?;
                }
                match if live { self.walk.defined(name.text) } else { Truth::Unknown } {
                    Truth::No => Some(0),
                    Truth::Unknown => None,
                    Truth::Yes => Some(1),
                }
            }
            (TokenKind::Identifier, name) => {
                if live {
                    self.walk.names.insert(name);
                }
                let value = self.walk.defines.get(name);
                if value.is_none() && live && self.certain && !is_the_compilers(name) {
                    let (text, start) = word.at;
                    self.walk.undefined.get_or_insert((text, start..start + name.len()));
                }
                value.and_then(|value| match value.strip_prefix('-') {
                    Some(positive) => number(positive).map(|v| -v),
                    None => number(value),
                })
            }
            _ => return None,
        };
        self.nested -= 1;
        Some(value)
    }

    fn close(&mut self) -> Option<()> {
        let closes = self.words.get(self.at).is_some_and(|word| word.text == ")");
        self.at += 1;
        closes.then_some(())
    }
}

fn combine(operator: &str, left: Option<i64>, right: Option<i64>) -> Option<i64> {
    let (a, b) = (left?, right?);
    let shift = u32::try_from(b).ok().filter(|by| *by < 32);
    let value = match operator {
        "||" => i64::from(a != 0 || b != 0),
        "&&" => i64::from(a != 0 && b != 0),
        "|" => a | b,
        "^" => a ^ b,
        "&" => a & b,
        "==" => i64::from(a == b),
        "!=" => i64::from(a != b),
        "<" => i64::from(a < b),
        ">" => i64::from(a > b),
        "<=" => i64::from(a <= b),
        ">=" => i64::from(a >= b),
        "<<" => a << shift?,
        ">>" => a >> shift?,
        "+" => a.checked_add(b)?,
        "-" => a.checked_sub(b)?,
        "*" => a.checked_mul(b)?,
        "/" => a.checked_div(b)?,
        _ => a.checked_rem(b)?,
    };
    // The compiler computes in 32 bits: a larger result counts as unknown.
    i32::try_from(value).is_ok().then_some(value)
}

/// Parses a decimal or hexadecimal integer that fits `i32`; `None` for other texts, octal integers included.
fn number(text: &str) -> Option<i64> {
    let digits = text.trim_end_matches(['u', 'U']);
    let value = match digits.strip_prefix("0x").or(digits.strip_prefix("0X")) {
        Some(digits) => i64::from_str_radix(digits, 16).ok(),
        None if digits.len() > 1 && digits.starts_with('0') => None,
        None => digits.parse().ok(),
    };
    value.filter(|v| i32::try_from(*v).is_ok())
}
