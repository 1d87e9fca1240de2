//! Converts text with ANSI colours to egui layouts.

use egui::text::{LayoutJob, TextFormat};
use egui::{Color32, FontId};

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

/// Minimum number of characters that a cut line keeps before the first caret.
const BEFORE: usize = 8;

const PLAIN: Color32 = Color32::from_rgb(225, 225, 225);

/// A line of text: its characters with their colours.
type Line = Vec<(char, Color32)>;

/// Returns the text without its escape sequences.
pub fn plain(ansi: &str) -> String {
    let lines: Vec<String> = parsed(ansi).iter().map(|line| line.iter().map(|(c, _)| c).collect()).collect();
    lines.join("\n")
}

/// Lays out text with ANSI colours in a monospace font of `size` points. Lines have at most `columns` characters where
/// possible. Drops other escape sequences.
pub fn layout(ansi: &str, columns: usize, size: f32) -> LayoutJob {
    let mut job = LayoutJob::default();
    let mut append = |text: &str, color: Color32| {
        let format = TextFormat { font_id: FontId::monospace(size), color, ..TextFormat::default() };
        job.append(text, 0.0, format);
    };
    let mut lines = parsed(ansi);
    narrow(&mut lines, columns);
    for (index, line) in lines.into_iter().flat_map(|line| wrapped(line, columns)).enumerate() {
        if index > 0 {
            append("\n", PLAIN);
        }
        for run in line.chunk_by(|(_, a), (_, b)| a == b) {
            append(&run.iter().map(|(c, _)| c).collect::<String>(), run[0].1);
        }
    }
    job
}

/// Splits text into lines of coloured characters; drops all escape sequences.
fn parsed(ansi: &str) -> Vec<Line> {
    let (mut all, mut colour, mut rest) = (Line::new(), PLAIN, ansi);
    while let Some(start) = rest.find('\u{1b}') {
        all.extend(rest[..start].chars().map(|c| (c, colour)));
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
    all.extend(rest.chars().map(|c| (c, colour)));
    all.split(|(c, _)| *c == '\n').map(<[_]>::to_vec).collect()
}

/// Cuts the starts of source lines in an error, so that the notes below each end within `columns`. At least a few
/// characters stay before the first caret.
fn narrow(lines: &mut [Line], columns: usize) {
    let mut at = 0;
    while at < lines.len() {
        let first = at;
        at += 1;
        let Some(bar) = gutter(&lines[first]).filter(|bar| has_number(&lines[first][..*bar])) else {
            continue;
        };
        let is_below = |line: &&Line| gutter(line) == Some(bar) && !has_number(&line[..bar]);
        at += lines[at..].iter().take_while(is_below).count();
        let notes = &lines[first + 1..at];
        let carets = notes.iter().filter_map(|line| line.iter().position(|(c, _)| *c == '^'));
        let Some(caret) = carets.min() else { continue };
        let end = notes.iter().map(Vec::len).max().unwrap_or(0);
        // The cut is replaced by one mark.
        let cut = bar + 2..(bar + 3 + end.saturating_sub(columns)).min(caret.saturating_sub(BEFORE));
        if end > columns && cut.len() > 1 {
            for (index, line) in lines[first..at].iter_mut().enumerate() {
                let Some((_, colour)) = line.get(cut.start).copied() else { continue };
                let mark = if index == 0 { '…' } else { ' ' };
                line.splice(cut.start..cut.end.min(line.len()), [(mark, colour)]);
            }
        }
    }
}

/// Breaks a long line at spaces, unless it is a source line. Continuation lines are indented, after the bar of a note
/// below a source line.
fn wrapped(line: Line, columns: usize) -> Vec<Line> {
    let start = gutter(&line).map_or(0, |bar| bar + 1);
    if line.len() <= columns || has_number(&line[..start]) {
        return vec![line];
    }
    let indent = [&line[..start], &[(' ', PLAIN); 4]].concat();
    let (mut lines, mut last) = (Vec::new(), Line::new());
    // Index of the last space outside the indent.
    let mut space = None;
    for (c, colour) in line {
        if c == ' ' && last.iter().skip(start).any(|(c, _)| *c != ' ') {
            space = Some(last.len());
        }
        last.push((c, colour));
        if last.len() > columns
            && let Some(at) = space.take()
        {
            let rest = last.split_off(at + 1);
            last.truncate(at);
            lines.push(std::mem::replace(&mut last, indent.clone()));
            last.extend(rest);
        }
    }
    lines.push(last);
    lines
}

fn has_number(line: &[(char, Color32)]) -> bool {
    line.iter().any(|(c, _)| c.is_ascii_digit())
}

/// Returns the column of `|` after a line number or after spaces; `None` for lines of other text.
fn gutter(line: &[(char, Color32)]) -> Option<usize> {
    let bar = line.iter().position(|(c, _)| *c == '|')?;
    line[..bar].iter().all(|(c, _)| *c == ' ' || c.is_ascii_digit()).then_some(bar)
}

/// Applies the parameters of an SGR escape sequence to a text colour: resets and the 16 named colours. Ignores others.
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

    const WIDE: usize = 1000;

    fn laid_out(ansi: &str, columns: usize) -> String {
        layout(ansi, columns, 12.0).text
    }

    #[test]
    fn the_colours_of_a_terminal_become_sections() {
        let job = layout("\u{1b}[1m\u{1b}[91merror\u{1b}[0m: x\n\u{1b}[38;5;12m  | \u{1b}[0m", WIDE, 12.0);
        assert_eq!(job.text, "error: x\n  | ");
        let colour = |text: &str| {
            let at = job.text.find(text).unwrap();
            let of = |s: &&egui::text::LayoutSection| s.byte_range.start.0 <= at && at < s.byte_range.end.0;
            job.sections.iter().find(of).unwrap().format.color
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
        let narrow = layout(&text, 30, 12.0);
        let lines: Vec<&str> = narrow.text.split('\n').collect();
        assert_eq!(lines[2], "7 | …xxxxxxxxxxxy(z)");
        assert_eq!(narrow.sections.iter().filter(|section| section.format.color == PALETTE[1]).count(), 3);
        assert_eq!(lines[3], "  |             ^ not declared");
        assert_eq!((lines[0], lines[4]), ("error: no `y`", "8 | z"));
        let narrower = laid_out(&text, 10);
        assert!(narrower.contains("\n  |          ^\n  |    not\n"), "{narrower}");
        assert_eq!(laid_out(&text, 200), plain(&text), "it fits");
    }

    #[test]
    fn long_sentences_are_wrapped_and_source_lines_are_not() {
        let source = format!("7 | {}", "x ".repeat(30));
        let text =
            format!("\u{1b}[31merror\u{1b}[0m: the image is larger than this\n --> a.ron:1:1\n{source}");
        let expected = format!("error: the image\n    is larger than\n    this\n --> a.ron:1:1\n{source}");
        assert_eq!(laid_out(&text, 18), expected);
        assert_eq!(laid_out("unbreakable", 3), "unbreakable");
    }

    #[test]
    fn a_long_note_below_a_source_line_goes_on_behind_the_bar() {
        let text = "7 | grey(1)\n  | ^^^^ not declared in this shader or in its includes\n  |\n8 | z";
        let note = "  | ^^^^ not declared\n  |    in this shader\n  |    or in its\n  |    includes\n  |";
        assert_eq!(laid_out(text, 22), format!("7 | grey(1)\n{note}\n8 | z"));
    }

    #[test]
    fn broken_escapes_are_left_out_and_nothing_else_is() {
        assert_eq!(plain("a\u{1b}b\u{1b}[2Jc\nd\u{1b}[31"), "abc\nd");
    }
}
