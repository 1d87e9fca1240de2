//! Writes text to standard output and standard error.
//!
//! Names from files (cameras, properties, passes, paths, drivers) reach the terminal only through this module, which
//! escapes their control characters. Nothing here panics: a line that cannot be written is lost, and the work
//! continues. A failed write is an error only for a command that prints its result, unless the reader closed the pipe.

use clap::error::{ContextKind, ContextValue};
use std::borrow::Cow;
use std::fmt::Display;
use std::io::{self, ErrorKind, Write};

/// Returns true for characters that move the cursor, change the terminal's state, or reorder the text around them.
///
/// These are the control characters C0, C1 and DEL (except the line break and the tab), the bidirectional controls of
/// Unicode, and its line and paragraph separators.
pub fn is_harmful(c: char) -> bool {
    match c {
        '\n' | '\t' => false,
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => true,
        c => c.is_control(),
    }
}

/// Escapes the harmful characters of a text, for example as `\u001b`. The escapes are also valid in JSON.
pub fn harmless(text: &str) -> Cow<'_, str> {
    if !text.contains(is_harmful) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_harmful(c) {
            out += &format!("\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// Escapes harmful characters, line breaks and tabs, so that a name stays on its line.
pub fn one_line(text: &str) -> Cow<'_, str> {
    match harmless(text) {
        text if text.contains(['\n', '\t']) => {
            Cow::Owned(text.replace('\n', "\\u000a").replace('\t', "\\u0009"))
        }
        text => text,
    }
}

/// Quotes a word for a POSIX shell, if necessary.
pub fn shell_word(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-./=,#:@%+".contains(c);
    if !word.is_empty() && word.chars().all(plain) && !word.starts_with('#') {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

/// Escapes harmful characters, except the colour sequences (`ESC [ digits m`) of this program's own renderers.
fn harmless_styled(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find("\x1b[") {
        let (before, from) = rest.split_at(at);
        out += &harmless(before);
        let digits = from[2..].find(|c: char| !c.is_ascii_digit() && c != ';').unwrap_or(from.len() - 2);
        let end = 2 + digits;
        if from[end..].starts_with('m') {
            out += &from[..=end];
            rest = &from[end + 1..];
        } else {
            out += &harmless(&from[..2]);
            rest = &from[2..];
        }
    }
    out + &harmless(rest)
}

fn to_standard_error(text: &str) {
    let mut err = io::stderr().lock();
    // A failure of standard error cannot be reported anywhere.
    let _ = err.write_all(text.as_bytes()).and_then(|()| err.flush());
}

/// Writes a line to standard error.
pub fn say(line: impl Display) {
    to_standard_error(&format!("{}\n", harmless(&line.to_string())));
}

/// Writes rendered text, which may contain colour sequences, to standard error.
pub fn say_styled(text: &str) {
    to_standard_error(&harmless_styled(text));
}

/// Writes a line that is not the command's result to standard output; ignores failures.
pub fn note(line: impl Display) {
    let line = format!("{}\n", harmless(&line.to_string()));
    let mut out = io::stdout().lock();
    let _ = out.write_all(line.as_bytes()).and_then(|()| out.flush());
}

/// Writes a command's result to standard output.
///
/// # Errors
/// The text cannot be written, for example to a full disk. A closed pipe is not an error: its reader needs no more.
pub fn print(text: &str) -> io::Result<()> {
    print_raw(&harmless(text))
}

/// Writes text to standard output without escaping. Has the errors of [`print`].
fn print_raw(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        Err(error) => {
            Err(io::Error::new(error.kind(), format!("standard output cannot be written: {error}")))
        }
        Ok(()) => Ok(()),
    }
}

/// Writes clap's help to standard output, or its error to standard error. Returns the exit code.
pub fn say_usage(mut error: clap::Error, colour: bool) -> u8 {
    // No command takes a word that begins with `--` as a value.
    if let Some(ContextValue::StyledStrs(mut tips)) = error.remove(ContextKind::Suggested) {
        tips.retain(|tip| !tip.to_string().contains("' as a value, use '-- --"));
        // clap prints an empty line for an empty list.
        if !tips.is_empty() {
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
        }
    }
    let text = error.render();
    let text = if colour { text.ansi().to_string() } else { text.to_string() };
    if error.use_stderr() {
        say_styled(&text);
        return 2;
    }
    match print_raw(&harmless_styled(&text)) {
        Ok(()) => 0,
        Err(error) => {
            say(format!("error: {error}"));
            1
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_with_spaces_and_quotes_come_back_from_a_shell_as_they_were() {
        assert_eq!(shell_word("a/b-c.ply#2"), "a/b-c.ply#2");
        for word in ["two words", "it's", "$HOME", "", "#1"] {
            let line = format!("printf %s {}", shell_word(word));
            let output = std::process::Command::new("sh").args(["-c", &line]).output().unwrap();
            assert_eq!(String::from_utf8_lossy(&output.stdout), word);
        }
    }

    #[test]
    fn escape_sequences_and_bidirectional_overrides_are_spelled_out() {
        assert_eq!(harmless("plain\n\ttext, ä 日本"), "plain\n\ttext, ä 日本");
        assert_eq!(
            harmless("a\x1b[31mb\r\x08\x7f\u{9b}c\u{202e}"),
            "a\\u001b[31mb\\u000d\\u0008\\u007f\\u009bc\\u202e"
        );
        assert_eq!(one_line("a\nerror: b\t"), "a\\u000aerror: b\\u0009");
        for c in (0..=0x10ffff).filter_map(char::from_u32) {
            let text = harmless(c.encode_utf8(&mut [0; 4])).into_owned();
            assert!(!text.contains(is_harmful), "{c:?}");
        }
    }

    #[test]
    fn only_colours_pass_where_colours_are_allowed() {
        assert_eq!(harmless_styled("\x1b[1;31merror\x1b[0m: a"), "\x1b[1;31merror\x1b[0m: a");
        assert_eq!(
            harmless_styled("\x1b[2Ja\x1b]0;title\x07\x1b[\x1b[1"),
            "\\u001b[2Ja\\u001b]0;title\\u0007\\u001b[\\u001b[1"
        );
    }

    #[test]
    fn text_stays_json_when_it_is_made_harmless() {
        let name = "a\u{9b}31m\u{202e}\u{7f}\x1b";
        let text = serde_json::to_string(name).unwrap();
        let shown = harmless(&text);
        assert!(!shown.contains(is_harmful));
        assert_eq!(serde_json::from_str::<String>(&shown).unwrap(), name);
    }
}
