//! Converts text with terminal colours to egui's layout.

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
    fn broken_escapes_are_left_out_and_nothing_else_is() {
        assert_eq!(layout("a\u{1b}b\u{1b}[2Jc\u{1b}[31", 12.0).text, "abc");
    }
}
