//! Converts text with terminal colours to egui's layout.

use egui::text::{LayoutJob, TextFormat};
use egui::{Color32, FontId};
use std::ops::Range;

/// The eight ANSI colours of a terminal with a dark background, in the order of their codes.
const PALETTE: [Color32; 8] = [
    Color32::from_rgb(110, 110, 110),
    Color32::from_rgb(255, 110, 103),
    Color32::from_rgb(120, 220, 120),
    Color32::from_rgb(240, 210, 110),
    Color32::from_rgb(110, 170, 255),
    Color32::from_rgb(220, 140, 255),
    Color32::from_rgb(110, 220, 230),
    Color32::from_rgb(235, 235, 235),
];

/// Number of characters before the first caret that a cut line keeps.
const BEFORE: usize = 8;

const PLAIN: Color32 = Color32::from_rgb(225, 225, 225);

/// Lays out text with ANSI colours in a monospace font; drops other escape sequences.
pub fn layout(ansi: &str, size: f32) -> LayoutJob {
    let mut job = LayoutJob::default();
    let mut colour = PLAIN;
    let mut rest = ansi;
    let mut write = |text: &str, colour: Color32| {
        let format = TextFormat { font_id: FontId::monospace(size), color: colour, ..TextFormat::default() };
        job.append(text, 0.0, format);
    };
    while let Some(start) = rest.find('\u{1b}') {
        write(&rest[..start], colour);
        rest = &rest[start + 1..];
        let Some(sequence) = rest.strip_prefix('[') else { continue };
        let Some(end) = sequence.find(|c: char| c.is_ascii_alphabetic()) else {
            rest = "";
            break;
        };
        if sequence[end..].starts_with('m') {
            colour = sgr(&sequence[..end], colour);
        }
        rest = &sequence[end + 1..];
    }
    write(rest, colour);
    job
}

/// Cuts the starts of source lines in an error, so that the notes below each end within `columns`. At least a few
/// characters stay before the first caret.
pub fn narrowed(ansi: &str, columns: usize) -> String {
    let mut lines: Vec<String> = ansi.split('\n').map(str::to_owned).collect();
    let texts: Vec<Vec<char>> = lines.iter().map(|line| layout(line, 1.0).text.chars().collect()).collect();
    let has_number = |text: &[char]| text.iter().any(char::is_ascii_digit);
    let mut at = 0;
    while at < lines.len() {
        let first = at;
        at += 1;
        let Some(bar) = gutter(&texts[first]).filter(|bar| has_number(&texts[first][..*bar])) else {
            continue;
        };
        let is_below = |text: &&Vec<char>| gutter(text) == Some(bar) && !has_number(&text[..bar]);
        at += texts[at..].iter().take_while(is_below).count();
        let notes = &texts[first + 1..at];
        let Some(caret) = notes.iter().filter_map(|text| text.iter().position(|c| *c == '^')).min() else {
            continue;
        };
        let end = notes.iter().map(Vec::len).max().unwrap_or(0);
        // The cut is replaced by one mark.
        let cut = bar + 2..(bar + 3 + end.saturating_sub(columns)).min(caret.saturating_sub(BEFORE));
        if end > columns && cut.len() > 1 {
            for (index, line) in lines[first..at].iter_mut().enumerate() {
                *line = without(line, &cut, if index == 0 { '…' } else { ' ' });
            }
        }
    }
    lines.join("\n")
}

/// Breaks long lines at spaces, except source lines and the notes below them. A continued line is indented.
pub fn wrapped(ansi: &str, columns: usize) -> String {
    let lines = ansi.split('\n').map(|line| {
        let text: Vec<char> = layout(line, 1.0).text.chars().collect();
        if text.len() <= columns || gutter(&text).is_some() {
            return line.to_owned();
        }
        let (mut kept, mut column, mut in_escape) = (String::new(), 0, false);
        // Position in `kept` and column of the last space outside the indent.
        let mut space = None;
        for c in line.chars() {
            if in_escape || c == '\u{1b}' {
                in_escape = !c.is_ascii_alphabetic();
            } else {
                if c == ' ' && !kept.trim().is_empty() {
                    space = Some((kept.len(), column));
                }
                column += 1;
            }
            kept.push(c);
            if column > columns
                && let Some((at, before)) = space.take()
            {
                kept.replace_range(at..=at, "\n    ");
                column = 4 + column - before - 1;
            }
        }
        kept
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// Returns the column of `|` after a line number or after spaces; `None` for lines of other text.
fn gutter(text: &[char]) -> Option<usize> {
    let bar = text.iter().position(|c| *c == '|')?;
    text[..bar].iter().all(|c| *c == ' ' || c.is_ascii_digit()).then_some(bar)
}

/// Replaces these columns of a line by one mark; keeps all escape sequences.
fn without(line: &str, cut: &Range<usize>, mark: char) -> String {
    let mut kept = String::new();
    let (mut column, mut in_escape) = (0, false);
    for c in line.chars() {
        if in_escape || c == '\u{1b}' {
            in_escape = !c.is_ascii_alphabetic();
            kept.push(c);
            continue;
        }
        if !cut.contains(&column) {
            kept.push(c);
        } else if column == cut.start {
            kept.push(mark);
        }
        column += 1;
    }
    kept
}

/// Applies the parameters of an SGR escape sequence to a text colour.
fn sgr(parameters: &str, before: Color32) -> Color32 {
    let mut colour = before;
    let mut numbers = parameters.split(';').map(|n| n.parse::<usize>().unwrap_or(0));
    while let Some(number) = numbers.next() {
        colour = match number {
            0 | 39 => PLAIN,
            30..=37 => PALETTE[number - 30],
            90..=97 => PALETTE[number - 90],
            38 => {
                // `38;5;N` selects from 256 colours; the first 16 are the named ones.
                let (kind, index) = (numbers.next(), numbers.next());
                match (kind, index) {
                    (Some(5), Some(index)) if index < 16 => PALETTE[index % 8],
                    _ => colour,
                }
            }
            _ => colour,
        };
    }
    colour
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_colours_of_a_terminal_become_sections() {
        let job = layout("\u{1b}[1m\u{1b}[91merror\u{1b}[0m: x\n\u{1b}[38;5;12m  | \u{1b}[0m", 12.0);
        assert_eq!(job.text, "error: x\n  | ");
        let colour = |text: &str| {
            let at = job.text.find(text).unwrap();
            job.sections
                .iter()
                .find(|s| s.byte_range.start.0 <= at && at < s.byte_range.end.0)
                .unwrap()
                .format
                .color
        };
        assert_eq!(colour("error"), PALETTE[1]);
        assert_eq!(colour(": x"), PLAIN);
        assert_eq!(colour("  |"), PALETTE[4]);
    }

    #[test]
    fn a_long_line_begins_before_its_caret() {
        let before = "x".repeat(100);
        let text = format!(
            "error: no `y`\n  |\n7 | \u{1b}[31m{before}y(z)\n  | {}^ not declared\n8 | z",
            " ".repeat(100)
        );
        let narrow = narrowed(&text, 30);
        let lines: Vec<&str> = narrow.split('\n').collect();
        assert_eq!(lines[2], "7 | \u{1b}[31m…xxxxxxxxxxxy(z)");
        assert_eq!(lines[3], "  |             ^ not declared");
        assert_eq!(narrowed(&text, 10).split('\n').nth(3), Some("  |          ^ not declared"));
        assert_eq!((lines[0], lines[4]), ("error: no `y`", "8 | z"));
        assert_eq!(narrowed(&text, 200), text, "it fits");
        assert_eq!(narrowed("a\nb\u{1b}[31", 1), "a\nb\u{1b}[31");
    }

    #[test]
    fn long_sentences_are_wrapped_and_source_lines_are_not() {
        let source = format!("7 | {}", "x ".repeat(30));
        let text =
            format!("\u{1b}[31merror\u{1b}[0m: the image is larger than this\n --> a.ron:1:1\n{source}");
        let expected = format!(
            "\u{1b}[31merror\u{1b}[0m: the image\n    is larger than\n    this\n --> a.ron:1:1\n{source}"
        );
        assert_eq!(wrapped(&text, 18), expected);
        assert_eq!(wrapped("unbreakable", 3), "unbreakable");
    }

    #[test]
    fn broken_escapes_are_left_out_and_nothing_else_is() {
        assert_eq!(layout("a\u{1b}b\u{1b}[2Jc\u{1b}[31", 12.0).text, "abc");
    }
}
