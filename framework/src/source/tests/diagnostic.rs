use proptest::prelude::*;

use super::*;
use crate::ir::{FileId, Span};

fn span(file: FileId, text: &str, part: &str) -> Span {
    let start = text.find(part).unwrap();
    Span { file, start, end: start + part.len() }
}

#[test]
fn an_error_is_drawn_under_the_text_that_it_is_about() {
    let text = "Graph(\n  passes: [\n    Dispatch(name: \"scatter\", shadr: \"scatter.comp\"),\n  ],\n)\n";
    let (files, file) = one_file("pipelines/splat.ron", text);
    let diagnostic =
        Diagnostic::new("unknown field `shadr`", span(file, text, "shadr"), "did you mean `shader`?")
            .with_label(span(file, text, "Dispatch"), "in this pass")
            .with_help("a dispatch has one shader");
    let expected = r#"error: unknown field `shadr`
 --> pipelines/splat.ron:3:31
  |
3 |     Dispatch(name: "scatter", shadr: "scatter.comp"),
  |     -------- in this pass     ^^^^^ did you mean `shader`?
  |
  = help: a dispatch has one shader
"#;
    assert_eq!(render(&files, &[diagnostic], false), expected);
}

#[test]
fn labels_in_other_files_are_drawn_in_their_files() {
    let mut files = SourceMap::default();
    let graph = files.add("a.ron", "bind: {\"Keys\": \"keys\"}");
    let shader = files.add("a.comp", "buffer Kees { uint k[]; };");
    let diagnostic = Diagnostic::new("no block `Keys`", span(graph, files.text(graph), "Keys"), "bound here")
        .with_label(span(shader, files.text(shader), "Kees"), "the only block");
    let expected = r#"error: no block `Keys`
 --> a.ron:1:9
  |
1 | bind: {"Keys": "keys"}
  |         ^^^^ bound here
  |
 ::: a.comp:1:8
  |
1 | buffer Kees { uint k[]; };
  |        ---- the only block
"#;
    assert_eq!(render(&files, &[diagnostic], false), expected);
}

#[test]
fn repeated_errors_are_told_once_in_linear_time() {
    let (_, file) = one_file("a.ron", "x");
    let error = |at: usize| Diagnostic::new("wrong", Span { file, start: at, end: at + 1 }, "");
    let thousands: Vec<Diagnostic> = (0..200_000).map(error).collect();
    let twice = [thousands.clone(), thousands.clone()].concat();
    assert!(Diagnostic::distinct(twice) == thousands);
}

#[test]
fn errors_have_blank_lines_between_and_those_after_the_first_hundred_are_only_counted() {
    let (files, file) = one_file("a.ron", "x");
    let error = Diagnostic::new("wrong", Span { file, start: 0, end: 1 }, "");
    let one = render(&files, std::slice::from_ref(&error), false);
    assert_eq!(one, "error: wrong\n --> a.ron:1:1\n  |\n1 | x\n  | ^\n");
    assert_eq!(render(&files, &[error.clone(), error.clone()], false), format!("{one}\n{one}"));
    assert_eq!(render(&files, &[], false), "");
    let hundred = vec![error.clone(); 100];
    let text = render(&files, &hundred, false);
    assert_eq!(text.matches(&one).count(), 100);
    assert_eq!(render(&files, &vec![error; 102], false), format!("{text}\nerror: 2 more, not shown\n"));
}

#[test]
fn names_that_are_too_long_are_cut_in_the_middle() {
    let (_, file) = one_file("a.ron", "x");
    let text = |name: &str| format!("there is no `{name}`, and {name} is no file, but `this` is");
    let short = "é".repeat(100);
    let long = format!("{}{}", "é".repeat(3000), "\nx".repeat(3000));
    for (name, most) in [(&short, usize::MAX), (&long, 3000)] {
        let error = Diagnostic::new(text(name), Span { file, start: 0, end: 1 }, text(name))
            .with_label(Span { file, start: 0, end: 1 }, text(name))
            .with_help(text(name));
        let parts = [&error.message, &error.primary.text, &error.secondary[0].text, &error.help[0]];
        for part in parts {
            assert_eq!(*part == text(name), *name == short, "{part}");
            assert!(part.len() < most || *name == short, "{part}");
            assert!(part.starts_with("there is no `é") && part.ends_with(", but `this` is"), "{part}");
        }
    }
}

#[test]
fn colour_is_added_only_when_asked_for() {
    let (files, file) = one_file("a.ron", "x");
    let error = [Diagnostic::new("wrong", Span { file, start: 0, end: 1 }, "this").with_help("do")];
    assert!(render(&files, &error, true).contains("\u{1b}["));
    assert!(!render(&files, &error, false).contains('\u{1b}'));
}

#[test]
fn no_control_character_of_a_file_reaches_the_terminal() {
    let hostile = "\u{1b}[31m\u{7}\u{8}\u{9b}2J\u{90}\u{85}\u{202e}\u{2066}\u{61c}\u{200f}\u{2028}\r";
    let (files, file) = one_file(&format!("{hostile}.ron"), &format!("a: \"{hostile}\"; b"));
    let at = |start, end| Span { file, start, end };
    let error = Diagnostic::new(format!("a {hostile}\nerror: b"), at(0, 1), format!("c {hostile}"))
        .with_label(at(1, 2), hostile)
        .with_help(format!("{hostile}\nerror: d"));
    for colour in [false, true] {
        let mut text = render(&files, std::slice::from_ref(&error), colour);
        // The renderer's own colours.
        while let Some(start) = text.find("\u{1b}[").filter(|_| colour) {
            let end = text[start..].find('m').expect("an end");
            text.replace_range(start..=start + end, "");
        }
        let acts = |c: char| {
            c.is_control() && c != '\n'
                || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{61c}')
                || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}' | '\u{2029}')
        };
        assert!(!text.contains(acts), "{text:?}");
        assert!(!text.contains("\nerror: b") && !text.contains("\nerror: d"), "{text}");
    }
}

#[test]
fn the_end_of_a_file_and_an_empty_file_can_be_pointed_at() {
    for text in ["", "x", "x\n", "\n\n"] {
        let (files, file) = one_file("a.ron", text);
        let end = text.len();
        let drawn = render(&files, &[Diagnostic::new("ends", Span { file, start: end, end }, "here")], false);
        assert!(drawn.contains("^ here"), "{drawn}");
    }
}

#[test]
fn a_long_line_is_drawn_in_part() {
    let text = format!("{}wrong{}", "a, ".repeat(100_000), ", b".repeat(100_000));
    let (files, file) = one_file("a.ron", &text);
    let drawn = render(&files, &[Diagnostic::new("long", span(file, &text, "wrong"), "here")], false);
    assert!(drawn.contains("wrong") && drawn.len() < 2000, "{}", drawn.len());
}

#[test]
fn of_many_errors_in_a_very_long_line_only_a_few_are_drawn() {
    let (files, file) = one_file("a.ron", &"x".repeat(3 << 20));
    let error = |at: usize| Diagnostic::new("wrong", Span { file, start: at, end: at + 1 }, "");
    let drawn = render(&files, &(0..10).map(error).collect::<Vec<_>>(), false);
    assert_eq!(drawn.matches("error: wrong").count(), 2);
    assert!(drawn.ends_with("\nerror: 8 more, not shown\n"), "{drawn}");
}

#[test]
fn the_nearest_name_is_the_one_with_the_fewest_changes() {
    let names = ["shader", "name", "phase", "size"];
    assert_eq!(nearest("shadr", names), Some("shader"));
    assert_eq!(nearest("pahse", names), Some("phase"));
    assert_eq!(nearest("nmae", names), Some("name"));
    assert_eq!(nearest("sizes", names), Some("size"));
    assert_eq!(nearest("covariance", names), None);
    assert_eq!(nearest("", names), None);
    assert_eq!(nearest("shader", []), None);
}

#[test]
fn a_third_of_the_name_may_be_wrong_and_something_must_be_right() {
    assert_eq!(nearest("abcdef", ["abcdxy"]), Some("abcdxy"));
    assert_eq!(nearest("abcdef", ["abcxyz"]), None);
    assert_eq!(nearest("n", ["d"]), None);
    assert_eq!(nearest("n", ["nn"]), Some("nn"));
    assert_eq!(nearest(&"long".repeat(1000), ["long"]), None);
}

#[test]
fn of_equally_near_names_the_first_is_offered() {
    assert_eq!(nearest("key", ["keys", "keg"]), Some("keys"));
}

proptest! {
    #[test]
    fn no_span_makes_the_drawing_panic(
        text in "(\\PC|[\n\r\t\u{0}-\u{1f}é漢🦀\u{301}\u{200d}\u{202e}]){0,60}",
        spans in prop::collection::vec((0usize..80, 0usize..80, 0u32..3, "\\PC{0,8}|[\n\r\té]{0,3}"), 1..5),
        message in ".{0,20}",
        colour: bool,
    ) {
        let mut files = SourceMap::default();
        files.add("a.ron", text.as_str());
        files.add("", format!("{text}\n{text}"));
        let mut diagnostic: Option<Diagnostic> = None;
        for (start, end, file, label) in spans {
            let span = Span { file: FileId(file), start, end };
            diagnostic = Some(match diagnostic {
                None => Diagnostic::new(message.as_str(), span, label),
                Some(diagnostic) => diagnostic.with_label(span, label).with_help(message.as_str()),
            });
        }
        let drawn = render(&files, &[diagnostic.unwrap()], colour);
        prop_assert!(drawn.contains("error"));
    }
}
