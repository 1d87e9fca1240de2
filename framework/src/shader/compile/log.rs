//! Converts glslang's log to diagnostics.
//!
//! A line of the log is `ERROR: 2:14:9: 'keys' : undeclared identifier`: file number, line, column, token and message.
//! The line is the file's. So is the column of an error of the preprocessor. A parser error has a column in the
//! preprocessed text, where macros are expanded and spaces differ: this module looks for the token in the line and
//! takes the nearest to that column, for which [`printed_columns`] computes where the preprocessor puts each token.

use std::ops::Range;

use super::generate::{IncludeFailure, IncludeProblem, MAX_DEPTH, MAX_INCLUDED_BYTES};
use super::scan::{Token, TokenKind, lex};
use super::sources::{Sources, live_params};
use crate::ir::{FileId, Span};
use crate::shader::compiler::ShaderRequest;
use crate::source::{Diagnostic, SourceMap, nearest};

pub(super) const MAX_DIAGNOSTICS: usize = 10;

/// Message of glslang for an overflow of its parser's stack.
const PARSER_FULL: &str = "memory exhausted";

/// The end of glslang's message for a workgroup that is larger than the compiler's limits.
const WORKGROUP: &str = "gl_MaxComputeWorkGroupSize";

/// Messages of glslang for a second declaration of a name.
const SECOND: [&str; 3] = ["redefinition", "function already has a body", "Cannot reuse block name"];
/// The end of glslang's message for a member of a block without a name, such as the live block.
const MEMBER_TAKEN: &str = "already has a name at global scope";
/// The start of glslang's message for a call of a variable.
const NO_FUNCTION: &str = "function call, method";

/// Converts a log to 1 to [`MAX_DIAGNOSTICS`] diagnostics. Keeps only the first error of each source line.
pub(super) fn diagnose(
    files: &SourceMap,
    request: &ShaderRequest,
    sources: &Sources,
    log: &str,
) -> Vec<Diagnostic> {
    let mut diagnostics: Vec<Diagnostic> = Vec::new();
    let mut lines = Vec::new();
    for entry in entries(log) {
        // Further errors in a line are mostly consequences of the first.
        if entry.place.is_some() && lines.contains(&entry.place.map(|p| (p.unit, p.line))) {
            continue;
        }
        lines.push(entry.place.map(|p| (p.unit, p.line)));
        diagnostics.push(entry.diagnose(files, request, sources));
        if diagnostics.len() == MAX_DIAGNOSTICS {
            break;
        }
    }
    if diagnostics.is_empty() {
        let message = "the shader does not compile, and the compiler does not say why";
        diagnostics.push(Diagnostic::new(message, sources.first_line(), ""));
    }
    diagnostics
}

#[derive(Debug, PartialEq)]
struct Entry<'l> {
    place: Option<Place>,
    /// The token that glslang quotes, if any.
    token: Option<&'l str>,
    message: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    unit: usize,
    /// Line, from 1, like the column; 0 if unknown.
    line: usize,
    column: usize,
}

/// Parses the errors of a log, without its closing summary.
fn entries(log: &str) -> Vec<Entry<'_>> {
    const PREFIXES: [&str; 4] = ["ERROR: ", "INTERNAL ERROR: ", "UNIMPLEMENTED: ", "UNKNOWN ERROR: "];
    let mut entries: Vec<Entry> = Vec::new();
    for line in log.lines() {
        let Some(rest) = PREFIXES.iter().find_map(|prefix| line.strip_prefix(prefix)) else {
            // An entry can continue in indented lines, and in a list of extensions.
            if let (true, Some(last)) =
                (line.starts_with([' ', '\t']) || line.starts_with("GL_"), entries.last_mut())
            {
                last.message = format!("{} {}", last.message, line.trim());
            }
            continue;
        };
        let (place, rest) = split_place(rest);
        let (token, message) = match rest.strip_prefix('\'').and_then(|r| r.split_once("' : ")) {
            Some((token, message)) => (Some(token).filter(|t| !t.is_empty()), message),
            None => (None, rest),
        };
        let message = plain_types(&message.split_whitespace().collect::<Vec<_>>().join(" "));
        if message == "compilation terminated" || message.ends_with("No code generated.") {
            continue;
        }
        entries.push(Entry { place, token, message });
    }
    entries
}

/// Splits a place such as `0:12:5: ` from the start of the text; `None` if there is none.
fn split_place(text: &str) -> (Option<Place>, &str) {
    let parse = || {
        let (head, rest) = text.split_once(": ")?;
        let mut parts = head.rsplitn(3, ':');
        let column = parts.next()?.parse::<i64>().ok()?;
        let line = parts.next()?.parse::<i64>().ok()?;
        let unit = parts.next()?.parse().ok()?;
        Some((Place { unit, line: line.max(0) as usize, column: column.max(0) as usize }, rest))
    };
    match parse() {
        Some((place, rest)) => (Some(place), rest),
        None => (None, text),
    }
}

impl IncludeFailure {
    pub(super) fn diagnose(&self, files: &SourceMap, sources: &Sources) -> Diagnostic {
        let unit = &sources.units[self.unit];
        let include = unit.includes.get(&self.name);
        let place = include.map_or(0..0, |include| include.place.clone());
        let span = sources.span(self.unit, place);
        match &self.why {
            IncludeProblem::Missing => match include.map(|i| &i.target) {
                Some(Err(not_found)) => not_found.at(span),
                _ => Diagnostic::new(format!("the include of `{}` cannot be parsed", self.name), span, ""),
            },
            IncludeProblem::TooDeep(chain) => {
                let target = include.and_then(|i| i.target.as_ref().ok());
                let since = chain.iter().rposition(|unit| Some(unit) == target);
                let Some(since) = since else {
                    let message = format!("includes are nested deeper than {MAX_DEPTH}");
                    return Diagnostic::new(message, span, "the limit is exceeded here");
                };
                let name = |unit: &usize| format!("`{}`", files.path(sources.units[*unit].file));
                let names: Vec<String> = chain[since..].iter().chain(target).map(name).collect();
                let message = format!("{} includes itself", names[0]);
                let error = Diagnostic::new(message, span, "included again here")
                    .with_help(format!("the cycle: {}", names.join(" includes ")));
                match target {
                    Some(0) => error.with_help("move the code that both need into another file"),
                    _ => error.with_help("an include guard (`#ifndef`, `#define`, `#endif`) ends it"),
                }
            }
            IncludeProblem::TooMuch => {
                let message =
                    format!("the included files together are more than {} MiB", MAX_INCLUDED_BYTES >> 20);
                Diagnostic::new(message, span, "the limit is exceeded here")
            }
        }
    }
}

impl Entry<'_> {
    fn diagnose(&self, files: &SourceMap, request: &ShaderRequest, sources: &Sources) -> Diagnostic {
        let Some(place) = self.place else {
            let stages = ["vertex", "fragment", "compute"].map(|stage| format!("Linking {stage} stage: "));
            let message =
                stages.iter().find_map(|s| self.message.strip_prefix(s.as_str())).unwrap_or(&self.message);
            // Functions are written as `f(` with the types of their parameters.
            let functions: Vec<String> = message
                .split_whitespace()
                .filter_map(|word| word.split_once('('))
                .map(|(name, _)| format!("`{name}`"))
                .collect();
            let span = sources.find_quoted(&functions.concat());
            return match &functions[..] {
                [caller, called] if message.starts_with("Recursion detected") => Diagnostic::new(
                    format!("expected no recursion, found {caller} calling {called}"),
                    span,
                    "",
                ),
                _ => Diagnostic::new(message, span, ""),
            };
        };
        let unit = if place.unit < sources.units.len() { place.unit } else { 0 };
        let text = &sources.units[unit].text;
        let syntax = SyntaxError::parse(&self.message);
        let is_macro = |name: &str| {
            sources.macros().contains(name) || request.defines.iter().any(|(define, _)| define == name)
        };
        let wanted = |token: &Token| match (&syntax, self.token) {
            (Some(syntax), _) => syntax.is_about(token, text),
            (None, Some(quoted)) => token.of(text) == spelling(quoted),
            (None, None) => false,
        };
        // glslang says "assign" for every change of a value, also by `+=` and in an argument: its column tells which.
        let is_change = self.token == Some("assign");
        let (range, token) = locate(text, place, (wanted, is_change), is_macro);
        let found = token.map(|token| token.of(text));
        let span = sources.span(unit, range);
        if let Some(syntax) = syntax {
            let diagnostic = Diagnostic::new(syntax.message(found), span, syntax.label());
            // A `;` can be missing before the `#include`, in another file.
            let mut includes = sources.includes_of(unit).into_iter();
            return match includes.next().filter(|_| first_code(text) == Some(span.start)) {
                Some((includer, place)) => {
                    let span = sources.span(includer, place);
                    diagnostic.with_label(span, "included here: is the code before it complete?")
                }
                None => diagnostic,
            };
        }
        let line = line_range(text, place.line);
        if let Some(diagnostic) = self.float_in_condition(request, (span.file, text), line.clone()) {
            return diagnostic;
        }
        let message = match self.token {
            _ if self.message == PARSER_FULL => {
                "expected less nesting, found more than the compiler can parse".to_string()
            }
            _ if self.message.ends_with(WORKGROUP) => {
                "expected a `local_size` of at most 1024 x 1024 x 64, found a larger one".to_string()
            }
            // In an argument, glslang's column is that of a name or a comma.
            Some("assign") => match found.filter(|found| found.ends_with('=')) {
                Some(operator) => format!("`{operator}`: {}", self.message),
                None => self.message.clone(),
            },
            Some(token) => format!("`{token}`: {}", self.message),
            None => self.message.clone(),
        };
        let live = self.token.filter(|_| self.message == "undeclared identifier");
        if let Some(help) = live.and_then(|name| sources.live_help(files, request, name)) {
            return Diagnostic::new(message, span, "").with_help(help);
        }
        let unknown = ["undeclared identifier", "no matching overloaded function found"];
        let label = match self.token.filter(|_| unknown.contains(&self.message.as_str())) {
            Some(name) => {
                let defines = request.defines.iter().map(|(define, _)| define.as_str());
                let known = sources.names().into_iter().chain(defines);
                let known: Vec<&str> = known.filter(|known| *known != name).collect();
                let same = known.iter().copied().find(|known| known.eq_ignore_ascii_case(name));
                same.or(nearest(name, known)).map(|near| format!("did you mean `{near}`?"))
            }
            None => None,
        };
        let diagnostic = Diagnostic::new(message, span, label.unwrap_or_default());
        if let Some((name, place)) = self.live_clash(files, request, sources, (span, &text[line])) {
            let error = diagnostic
                .with_help(format!("`{name}` is also a live parameter of the graph: rename one of them"));
            return if place == span { error } else { error.with_label(place, "declared here, too") };
        }
        if self.is_second() {
            return sources.with_second_include(diagnostic, unit, files);
        }
        let lacks = self.message.strip_prefix("required extension not requested: ");
        let lacked = lacks.and_then(|lacks| lacks.split_whitespace().find(|word| word.starts_with("GL_")));
        let extension = lacked.map(|name| format!("add `#extension {name} : require` below `#version`"));
        let help = extension.or_else(|| self.hint().map(String::from));
        help.into_iter().fold(diagnostic, Diagnostic::with_help)
    }

    fn is_second(&self) -> bool {
        SECOND.iter().any(|second| self.message.starts_with(second))
    }

    /// Finds the live parameter whose name clashes with another, if this caused the error. Also returns the place of
    /// the other declaration, or, for a call, that of the error.
    fn live_clash<'f>(
        &self,
        files: &'f SourceMap,
        request: &ShaderRequest,
        sources: &Sources,
        (span, line): (Span, &str),
    ) -> Option<(&'f str, Span)> {
        let (live, members) = live_params(files, request)?;
        if self.message.starts_with(NO_FUNCTION) {
            let called = |word: Token| members.iter().find(|name| **name == word.of(line));
            return lex(line).into_iter().find_map(called).map(|name| (*name, span));
        }
        let is_member = self.message.ends_with(MEMBER_TAKEN);
        // The members are in the braces after the block's name.
        let text = files.text(span.file);
        let block = span.start..text[span.start..].find('}').map_or(text.len(), |end| span.start + end);
        let is_cause = |(name, place): &(&str, Span)| match () {
            () if is_member && span.file == live => true,
            () if is_member => place.file == span.file && block.contains(&place.start),
            () => self.is_second() && self.token == Some(*name),
        };
        sources.declarations(&members, live).into_iter().find(is_cause)
    }

    /// Returns the error for a constant of the graph with a fraction in an `#if`; `None` for all other errors. `line`
    /// is the place of the directive in `text`.
    fn float_in_condition(
        &self,
        request: &ShaderRequest,
        (file, text): (FileId, &str),
        line: Range<usize>,
    ) -> Option<Diagnostic> {
        self.token.filter(|token| *token == "preprocessor evaluation")?;
        let is_float = |value: &str| value.contains(['.', 'e']);
        let (token, (name, value)) =
            lex(text).into_iter().filter(|t| line.contains(&t.start)).find_map(|t| {
                let define =
                    request.defines.iter().find(|(name, value)| name == t.of(text) && is_float(value))?;
                Some((t, define))
            })?;
        let message = format!("expected integers in an `#if`, found `{name}` with the value {value}");
        let error = Diagnostic::new(message, Span::new(file, token.range()), "");
        Some(error.with_help("compare it in an `if`, or in a `let` of the graph"))
    }

    /// Returns the help for a common mistake; `None` for any other.
    fn hint(&self) -> Option<&'static str> {
        match (self.token, self.message.as_str()) {
            (_, PARSER_FULL) => Some("each `else if` is nested in the one before it: use a `switch`"),
            (_, "boolean expression expected") => Some("compare numbers with 0: `x != 0`"),
            (Some("non-opaque uniforms outside a block"), _) => Some(
                "a constant of the graph is defined in capitals, a live parameter is in `live.glsl`, and other numbers are members of a `push_constant` block",
            ),
            _ => None,
        }
    }
}

/// Returns the place of an error in a text, and the token there, if any. The place is that of the nearest matching
/// token, of the token at the error's column (the other way round if `by_column`), or the whole line.
fn locate(
    text: &str,
    place: Place,
    (wanted, by_column): (impl Fn(&Token) -> bool, bool),
    is_macro: impl Fn(&str) -> bool,
) -> (Range<usize>, Option<Token>) {
    let mut line = line_range(text, place.line);
    // An error at the end is shown at the last non-empty line.
    while line.start > 0 && text[line.clone()].trim().is_empty() {
        line = line_before(text, line.start);
    }
    let tokens: Vec<Token> = lex(text).into_iter().filter(|t| line.contains(&t.start)).collect();
    let tokens: Vec<Token> = tokens.into_iter().filter(|t| t.kind != TokenKind::Newline).collect();
    let printed = printed_columns(text, line.start, &tokens);
    // Errors of the preprocessor have the file's columns; errors of the parser have printed columns.
    let distance = |i: usize| {
        let in_file = tokens[i].start - line.start + 1;
        in_file.abs_diff(place.column).min(printed[i].abs_diff(place.column))
    };
    let nearest = (0..tokens.len()).filter(|&i| wanted(&tokens[i])).min_by_key(|&i| distance(i));
    let at_column = || {
        let expanded = tokens.iter().position(|t| is_macro(t.of(text))).unwrap_or(tokens.len());
        (0..tokens.len()).find(|&i| i <= expanded && printed[i] == place.column)
    };
    let (first, second) = if by_column { (at_column(), nearest) } else { (nearest, at_column()) };
    if let Some(i) = first.or(second) {
        return (tokens[i].range(), Some(tokens[i]));
    }
    match (tokens.first(), tokens.last()) {
        (Some(first), Some(last)) => (first.start..last.end, None),
        _ => (line, None),
    }
}

/// Returns the start of the first token that is not part of a directive; `None` if there is none.
fn first_code(text: &str) -> Option<usize> {
    let tokens = lex(text);
    let lines = tokens.split(|token| token.kind == TokenKind::Newline);
    lines.filter_map(|line| line.first()).find(|token| token.of(text) != "#").map(|token| token.start)
}

/// Returns the byte range of a line without its end, with the number clamped to existing lines.
fn line_range(text: &str, number: usize) -> Range<usize> {
    let mut start = 0;
    for _ in 1..number {
        match text[start..].find('\n') {
            Some(end) if start + end + 1 < text.len() => start += end + 1,
            _ => break,
        }
    }
    start..start + text[start..].find('\n').unwrap_or(text.len() - start)
}

/// Returns the byte range of the line before the one that starts at `start`, which is not 0.
fn line_before(text: &str, start: usize) -> Range<usize> {
    let end = start - 1;
    text[..end].rfind('\n').map_or(0, |newline| newline + 1)..end
}

/// Returns the columns, from 1, at which glslang's preprocessor prints the tokens of a line without macros. The first
/// stays in place, the others follow with one space or none.
fn printed_columns(text: &str, line_start: usize, tokens: &[Token]) -> Vec<usize> {
    let mut columns = Vec::with_capacity(tokens.len());
    let mut column = 0;
    for (i, token) in tokens.iter().enumerate() {
        let this = token.of(text);
        if i == 0 {
            column = token.start - line_start;
        } else {
            let last = tokens[i - 1];
            let space = match this {
                "(" => {
                    last.kind != TokenKind::Identifier
                        || matches!(last.of(text), "if" | "for" | "while" | "switch")
                }
                ";" | ")" | "[" | "]" | "." | "," => false,
                _ => !matches!(last.of(text), "." | "(" | "["),
            };
            column += space as usize;
        }
        columns.push(column + 1);
        column += this.len();
    }
    columns
}

/// The tokens in a message such as `syntax error, unexpected SEMICOLON, expecting COMMA or RIGHT_PAREN`.
struct SyntaxError<'m> {
    unexpected: &'m str,
    expecting: Vec<&'m str>,
}

impl<'m> SyntaxError<'m> {
    fn parse(message: &'m str) -> Option<Self> {
        let rest = message.strip_prefix("syntax error")?;
        let rest = rest.strip_prefix(", unexpected ").unwrap_or_default();
        let (unexpected, expecting) = rest.split_once(", expecting ").unwrap_or((rest, ""));
        Some(SyntaxError {
            unexpected,
            expecting: expecting.split(" or ").filter(|e| !e.is_empty()).collect(),
        })
    }

    fn is_about(&self, token: &Token, text: &str) -> bool {
        match described(self.unexpected) {
            "a name" | "a type's name" | "a member's name" => token.kind == TokenKind::Identifier,
            "a number" => token.kind == TokenKind::Number,
            _ => token.of(text).eq_ignore_ascii_case(grammar_spelling(self.unexpected)),
        }
    }

    fn message(&self, found: Option<&str>) -> String {
        match (found, self.unexpected) {
            (Some(found), _) => format!("syntax error: unexpected `{found}`"),
            (None, "") => "syntax error".to_string(),
            (None, unexpected) => format!("syntax error: unexpected {}", quoted(unexpected)),
        }
    }

    fn label(&self) -> String {
        match self.expecting.as_slice() {
            [] => String::new(),
            expecting => {
                let names: Vec<String> = expecting.iter().map(|e| quoted(e)).collect();
                format!("expected {}", names.join(" or "))
            }
        }
    }
}

/// Describes a class of tokens by its name in the grammar; empty for tokens with one spelling.
fn described(name: &str) -> &'static str {
    match name {
        "IDENTIFIER" => "a name",
        "TYPE_NAME" | "USER_TYPE" => "a type's name",
        "FIELD_SELECTION" => "a member's name",
        "STRING_LITERAL" => "a string",
        "$end" | "end of file" => "the end of the file",
        _ if name.ends_with("CONSTANT") && name != "CONSTANT" => "a number",
        _ => "",
    }
}

fn quoted(name: &str) -> String {
    match described(name) {
        "" => {
            let spelled = grammar_spelling(name);
            if spelled == name { format!("`{}`", name.to_lowercase()) } else { format!("`{spelled}`") }
        }
        description => description.to_string(),
    }
}

/// Returns the spelling of a token from its name in glslang's grammar, where keywords are in capitals.
fn grammar_spelling(name: &str) -> &str {
    match name {
        "LEFT_OP" => "<<",
        "RIGHT_OP" => ">>",
        "INC_OP" => "++",
        "DEC_OP" => "--",
        "LE_OP" => "<=",
        "GE_OP" => ">=",
        "EQ_OP" => "==",
        "NE_OP" => "!=",
        "AND_OP" => "&&",
        "OR_OP" => "||",
        "XOR_OP" => "^^",
        "MUL_ASSIGN" => "*=",
        "DIV_ASSIGN" => "/=",
        "MOD_ASSIGN" => "%=",
        "ADD_ASSIGN" => "+=",
        "SUB_ASSIGN" => "-=",
        "LEFT_ASSIGN" => "<<=",
        "RIGHT_ASSIGN" => ">>=",
        "AND_ASSIGN" => "&=",
        "XOR_ASSIGN" => "^=",
        "OR_ASSIGN" => "|=",
        "LEFT_PAREN" => "(",
        "RIGHT_PAREN" => ")",
        "LEFT_BRACKET" => "[",
        "RIGHT_BRACKET" => "]",
        "LEFT_BRACE" => "{",
        "RIGHT_BRACE" => "}",
        "DOT" => ".",
        "COMMA" => ",",
        "COLON" => ":",
        "EQUAL" => "=",
        "SEMICOLON" => ";",
        "BANG" => "!",
        "DASH" => "-",
        "TILDE" => "~",
        "PLUS" => "+",
        "STAR" => "*",
        "SLASH" => "/",
        "PERCENT" => "%",
        "LEFT_ANGLE" => "<",
        "RIGHT_ANGLE" => ">",
        "VERTICAL_BAR" => "|",
        "CARET" => "^",
        "AMPERSAND" => "&",
        "QUESTION" => "?",
        keyword => keyword,
    }
}

/// Returns a token's spelling in the text. `quoted` is glslang's quotation of the token.
fn spelling(quoted: &str) -> &str {
    match quoted {
        "assign" => "=",
        directive => directive.trim_start_matches('#'),
    }
}

/// Rewrites types in a message to GLSL's notation: `' temp highp 3-component vector of float'` becomes `` `vec3` ``.
fn plain_types(message: &str) -> String {
    let parts: Vec<&str> = message.split('\'').collect();
    // An even number of parts means an odd number of quotes, one of which is an apostrophe.
    if parts.len().is_multiple_of(2) {
        return message.to_string();
    }
    let plain = parts.iter().enumerate().map(|(i, part)| match i % 2 {
        0 => part.to_string(),
        _ => format!("`{}`", plain_type(part)),
    });
    plain.collect()
}

fn plain_type(description: &str) -> String {
    let mut text = description;
    if let Some((_, rest)) = text.strip_prefix("layout(").and_then(|rest| rest.split_once(')')) {
        text = rest;
    }
    let implied = ["temp", "global", "highp", "mediump", "lowp"];
    let words: Vec<&str> = text.split_whitespace().filter(|word| !implied.contains(word)).collect();
    let prefix = |element: &str| match element {
        "float" => Some(""),
        "uint" => Some("u"),
        "int" => Some("i"),
        "bool" => Some("b"),
        "double" => Some("d"),
        _ => None,
    };
    if let [before @ .., size, shape @ ("vector" | "matrix"), "of", element] = words.as_slice() {
        let short = match (*shape, size.split_once('-'), size.split_once('X'), prefix(element)) {
            ("vector", Some((size, "component")), _, Some(prefix)) => Some(format!("{prefix}vec{size}")),
            ("matrix", _, Some((columns, rows)), Some(prefix)) if columns == rows => {
                Some(format!("{prefix}mat{columns}"))
            }
            ("matrix", _, Some((columns, rows)), Some(prefix)) => {
                Some(format!("{prefix}mat{columns}x{rows}"))
            }
            _ => None,
        };
        if let Some(short) = short {
            return before.iter().copied().chain([short.as_str()]).collect::<Vec<_>>().join(" ");
        }
    }
    words.join(" ")
}
