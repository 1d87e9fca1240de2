//! Renders diagnostics with the source text, in the style of rustc.

use std::borrow::Cow;
use std::ops::Range;

use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet, normalize_untrusted_str};

use super::{Diagnostic, Label, SourceMap};
use crate::ir::{FileId, Span};

/// Maximum number of diagnostics to render.
pub(crate) const MAX_RENDERED: usize = 100;

/// Soft limit on the total length of the diagnostics' lines, in bytes: rendering a diagnostic reads its whole line.
const MAX_LINE_BYTES: usize = 4 << 20;

/// Renders diagnostics as errors, separated by blank lines. The result ends in a line break, unless it is empty.
///
/// After the first 100, or after a few on very long lines, it only says how many more there are.
///
/// ```text
/// error: unknown field `shadr` in `Dispatch`
///   --> pipelines/splat.ron:12:31
///    |
/// 12 |     Dispatch(name: "scatter", shadr: "scatter.comp"),
///    |                               ^^^^^ did you mean `shader`?
/// ```
///
/// Spans are clamped to the text, and rounded down to the start of a character; a reversed span becomes empty. `colour`
/// adds ANSI escapes.
pub fn render(files: &SourceMap, diagnostics: &[Diagnostic], colour: bool) -> String {
    render_as(Level::ERROR, files, diagnostics, colour)
}

/// Renders diagnostics as warnings; see [`render`].
pub fn render_warnings(files: &SourceMap, diagnostics: &[Diagnostic], colour: bool) -> String {
    render_as(Level::WARNING, files, diagnostics, colour)
}

fn render_as(level: Level<'static>, files: &SourceMap, diagnostics: &[Diagnostic], colour: bool) -> String {
    let renderer = if colour { Renderer::styled() } else { Renderer::plain() };
    let mut out = String::new();
    let mut room = MAX_LINE_BYTES;
    let fits = |diagnostic: &&Diagnostic| {
        let is_left = room > 0;
        room = room.saturating_sub(line_bytes(files, diagnostic.primary.span));
        is_left
    };
    let count = diagnostics.iter().take(MAX_RENDERED).take_while(fits).count();
    let (shown, others) = diagnostics.split_at(count);
    for diagnostic in shown {
        if !out.is_empty() {
            out.push('\n');
        }
        out.push_str(&render_one(&level, files, diagnostic, &renderer));
        out.push('\n');
    }
    if !others.is_empty() {
        let title = Group::with_title(level.primary_title(format!("{} more, not shown", others.len())));
        out.push_str(&format!("\n{}\n", renderer.render(&[title])));
    }
    out
}

/// Returns the length of the line in which a span starts.
fn line_bytes(files: &SourceMap, span: Span) -> usize {
    let text = files.text(span.file).as_bytes();
    let (before, after) = text.split_at(span.start.min(text.len()));
    let is_end = |byte: &u8| *byte == b'\n';
    before.iter().rev().take_while(|byte| !is_end(byte)).count()
        + after.iter().take_while(|byte| !is_end(byte)).count()
}

fn render_one(
    level: &Level<'static>,
    files: &SourceMap,
    diagnostic: &Diagnostic,
    renderer: &Renderer,
) -> String {
    let mut snippets: Vec<(FileId, Vec<(AnnotationKind, &Label)>)> = Vec::new();
    let primary = (AnnotationKind::Primary, &diagnostic.primary);
    let secondary = diagnostic.secondary.iter().map(|label| (AnnotationKind::Context, label));
    for (kind, label) in std::iter::once(primary).chain(secondary) {
        match snippets.iter_mut().find(|s| s.0 == label.span.file) {
            Some(snippet) => snippet.1.push((kind, label)),
            None => snippets.push((label.span.file, vec![(kind, label)])),
        }
    }
    let texts: Vec<Cow<str>> = snippets.iter().map(|(file, _)| harmless(files.text(*file))).collect();
    // Files must not be able to send escape sequences to the terminal, or to imitate lines of the message.
    let mut group = Group::with_title(level.clone().primary_title(one_line(&diagnostic.message)));
    for ((file, labels), text) in snippets.iter().zip(&texts) {
        let mut snippet = Snippet::source(&**text).path(one_line(&files.shown_path(*file)));
        for (kind, label) in labels {
            let annotation = kind.span(drawable(text, label.span));
            snippet = snippet.annotation(match label.text.as_str() {
                "" => annotation,
                text => annotation.label(one_line(text)),
            });
        }
        group = group.element(snippet);
    }
    for help in &diagnostic.help {
        group = group.element(Level::HELP.message(one_line(help)));
    }
    renderer.render(&[group])
}

/// Replaces characters that terminals interpret and `annotate_snippets` keeps. These are C1 control characters, and
/// characters that change the text direction or break lines. Each replacement has the same length in bytes, so spans
/// stay valid.
fn harmless(text: &str) -> Cow<'_, str> {
    let replaced = |c: char| match c {
        '\u{80}'..='\u{9f}' | '\u{61c}' => Some('\u{bf}'),
        '\u{200e}' | '\u{200f}' | '\u{2028}' | '\u{2029}' => Some(char::REPLACEMENT_CHARACTER),
        _ => None,
    };
    if !text.contains(|c| replaced(c).is_some()) {
        return text.into();
    }
    text.chars().map(|c| replaced(c).unwrap_or(c)).collect()
}

/// Joins the lines of a message by `␊`, and replaces characters that terminals interpret.
fn one_line(text: &str) -> String {
    normalize_untrusted_str(&harmless(text)).replace('\n', "\u{240a}")
}

fn drawable(text: &str, span: Span) -> Range<usize> {
    let start = text.floor_char_boundary(span.start);
    start..text.floor_char_boundary(span.end).max(start)
}
