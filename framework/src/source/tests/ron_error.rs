//! The golden files of `framework/tests/golden/in/syntax.ron` show the message and the place of more mistakes.

use super::*;
use crate::ir::FileId;
use crate::schema::Document;

/// Checks the message, the text that it points at, and the label under it. Returns the diagnostic.
#[track_caller]
fn fails(text: &str, message: &str, at: &str, label: &str) -> Diagnostic {
    let outline = Outline::parse(FileId(0), text).expect(text);
    let read = |text: &str| Document::parse(text).map(drop);
    let error = ron_error(&outline, text, &read(text).expect_err(text), &read);
    let span = error.primary.span;
    let found = (error.message.as_str(), &text[span.start..span.end], error.primary.text.as_str());
    assert_eq!(found, (message, at, label), "{text}");
    error
}

#[test]
fn a_missing_field_is_pointed_at_where_the_innermost_struct_starts() {
    let shown = |text: &str, field: &str, of: &str, at: &str| {
        let message = format!("the field `{field}` is missing in `{of}`");
        fails(text, &message, at, &format!("this has no `{field}`"));
    };
    shown("Choice(summary: \"\", of: [(require: [])])", "graph", "Candidate", "(");
    let pass = "Graph(version: 1, summary: \"\",\n  passes: [\n    Swap(\"a\"),\n    Fill(\n      name: \"b\",\n    ),\n  ],\n)\n";
    shown(pass, "buffer", "Fill", "Fill");
}

#[test]
fn values_of_every_kind_without_the_name_of_their_field_are_met_with_the_fields() {
    for (pass, found, at) in [
        ("Fill(4, \"b\")", "`4`", "4"),
        ("Fill(\"a\", \"b\")", "a string", "a"),
        ("Fill(false)", "`false`", "false"),
        ("Fill((1, 2))", "`(`", "("),
    ] {
        let text = format!("Graph(version: 1, summary: \"\", passes: [{pass}])");
        let message = format!("expected a field `name: value`, found {found}");
        let error = fails(&text, &message, at, "has no name before it");
        assert_eq!(error.help, ["the fields are name, phase, when, buffer, value"]);
    }
}

#[test]
fn lines_and_columns_of_the_crate_are_characters() {
    let text = "Graph(version: 1, /* größe 🦀 */ summary: \"né\nü\", fluffy: 1)";
    fails(text, "unknown field `fluffy` in `Graph`", "fluffy", "no such name");
}

#[test]
fn a_position_beyond_the_text_is_no_trouble() {
    use ron::error::{Error, Position, Span, SpannedError};
    let far = Position { line: 1000, col: 1000 };
    let nowhere = Position { line: 0, col: 0 };
    for (start, end) in [(far, far), (nowhere, nowhere), (far, nowhere), (nowhere, far)] {
        for text in ["x", "(a: é)\n", "[]"] {
            let outline = Outline::parse(FileId(0), text).expect(text);
            for code in [Error::Eof, Error::ExpectedString, Error::ExpectedComma, Error::Message("m".into())]
            {
                let error = SpannedError { code, span: Span { start, end } };
                let span = ron_error(&outline, text, &error, &|_| Ok(())).primary.span;
                assert!(text.get(span.start..span.end).is_some());
            }
        }
    }
}
