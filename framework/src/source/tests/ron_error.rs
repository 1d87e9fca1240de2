use std::collections::BTreeMap;

use proptest::prelude::*;
use serde::Deserialize;

use super::*;
use crate::ir::FileId;

/// A schema with everything that a graph's has: structs, newtype, tuple and struct variants, unit variants,
/// maps, tuples.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code)]
struct Graph {
    version: u32,
    #[serde(default)]
    summary: Option<String>,
    #[serde(default)]
    params: BTreeMap<String, Param>,
    passes: Vec<Pass>,
}

#[derive(Debug, Deserialize)]
#[allow(dead_code)]
enum Param {
    Const(Domain),
    Live(Domain),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code)]
enum Domain {
    Int { default: i64, range: (i64, i64) },
    Bool { default: bool },
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code)]
enum Pass {
    Dispatch {
        name: String,
        shader: String,
        #[serde(default)]
        run: Run,
        #[serde(default)]
        bind: BTreeMap<String, String>,
    },
    Swap(String),
}

#[derive(Debug, Default, Deserialize)]
enum Run {
    #[default]
    Frame,
    Once,
}

fn read(text: &str) -> Result<Graph, ron::error::SpannedError> {
    let options = ron::Options::default().with_default_extension(ron::extensions::Extensions::IMPLICIT_SOME);
    options.from_str(text)
}

fn error_of(text: &str) -> Diagnostic {
    let error = read(text).expect_err(text);
    ron_error(FileId(0), text, &error, &|text| read(text).map(drop))
}

/// Checks the message, the text that it points at, and the label under it. Returns the diagnostic.
#[track_caller]
fn fails(text: &str, message: &str, at: &str, label: &str) -> Diagnostic {
    let error = error_of(text);
    let span = error.primary.span;
    let found = (error.message.as_str(), &text[span.start..span.end], error.primary.text.as_str());
    assert_eq!(found, (message, at, label), "{text}");
    error
}

#[test]
fn a_good_file_is_read() {
    let params = r#"{"a": Const(Bool(default: true))}"#;
    read(&format!(r#"Graph(version: 1, summary: "s", params: {params}, passes: [Swap("keys")])"#)).unwrap();
}

#[test]
fn a_misspelt_field_is_met_with_the_nearest_one() {
    let text = "Graph(\n  version: 1,\n  passes: [\n    Dispatch(name: \"a\", shadr: \"b\"),\n  ],\n)\n";
    let error = fails(text, "unknown field `shadr` in `Dispatch`", "shadr", "did you mean `shader`?");
    let (files, _) = one_file("splat.ron", text);
    let expected = r#"error: unknown field `shadr` in `Dispatch`
 --> splat.ron:4:25
  |
4 |     Dispatch(name: "a", shadr: "b"),
  |                         ^^^^^ did you mean `shader`?
  |
  = help: the fields are name, shader, run, bind
"#;
    assert_eq!(render(&files, &[error], false), expected);
}

#[test]
fn an_unknown_field_that_resembles_nothing_is_met_with_the_list() {
    let text = "Graph(version: 1, fluffy: 2, passes: [])";
    let error = fails(text, "unknown field `fluffy` in `Graph`", "fluffy", "no such name");
    assert_eq!(error.help, ["the fields are version, summary, params, passes"]);
}

#[test]
fn a_misspelt_variant_is_met_with_the_nearest_one() {
    let text = r#"Graph(version: 1, passes: [Dispach(name: "a", shader: "b")])"#;
    let error = fails(text, "unknown variant `Dispach` of `Pass`", "Dispach", "did you mean `Dispatch`?");
    assert_eq!(error.help, ["the variants are Dispatch, Swap"]);
    let text = r#"Graph(version: 1, passes: [Dispatch(name: "a", shader: "b", run: Onec)])"#;
    fails(text, "unknown variant `Onec` of `Run`", "Onec", "did you mean `Once`?");
    // A name is wrong whether or not the file is balanced further on.
    let text = r#"Graph(version: 1, passes: [Dispach(name: "a""#;
    fails(text, "unknown variant `Dispach` of `Pass`", "Dispach", "did you mean `Dispatch`?");
}

#[test]
fn a_missing_field_is_pointed_at_where_the_struct_starts() {
    let text = "Graph(version: 1,\n  passes: [\n    Swap(\"a\"),\n    Dispatch(\n      name: \"b\",\n    ),\n  ],\n)\n";
    fails(text, "the field `shader` is missing in `Dispatch`", "Dispatch", "this has no `shader`");
    fails("Graph(version: 1)", "the field `passes` is missing in `Graph`", "Graph", "this has no `passes`");
    fails("(version: 1)", "the field `passes` is missing in `Graph`", "(", "this has no `passes`");
}

#[test]
fn a_field_given_twice_is_shown_twice() {
    let text = r#"Graph(version: 1, passes: [Dispatch(name: "a", shader: "b", name: "c")])"#;
    let error = fails(text, "the field `name` is given twice", "name", "again here");
    assert_eq!(error.secondary[0].span.start, text.find("name").unwrap());
}

#[test]
fn a_missing_comma_is_pointed_at_where_it_belongs() {
    let text = r#"Graph(version: 1, passes: [Dispatch(name: "a" shader: "b")])"#;
    let error = fails(text, "a comma is missing", "", "expected `,` or `)` here");
    assert_eq!(error.primary.span.start, text.find(" shader").unwrap());
}

#[test]
fn an_unclosed_bracket_is_pointed_at_where_it_was_opened() {
    let text = r#"Graph(version: 1, passes: [Swap("a")]"#;
    let error = fails(text, "this `(` is not closed", "(", "opened here");
    assert_eq!(error.primary.span.start, 5);
    let text = r#"Graph(version: 1, passes: [Dispatch(name: "a", shader: "b"])"#;
    let error = fails(text, "expected `,` or `)`, found `]`", "]", "this closes another bracket");
    assert_eq!(error.secondary[0].span.start, text.find("(name").unwrap());
    fails(
        "Graph(version: 1, summary: \"abc, passes: [])",
        "a string is not closed",
        "\"",
        "it starts here and has no closing quote",
    );
}

#[test]
fn a_value_of_another_type_is_pointed_at() {
    let in_graph = |version: &str, passes: &str| format!("Graph(version: {version}, passes: {passes})");
    let wrong = |text: String, message: &str, at: &str| {
        let error = error_of(&text);
        let span = error.primary.span;
        assert_eq!((error.message.as_str(), &text[span.start..span.end]), (message, at), "{text}");
    };
    wrong(in_graph("\"1\"", "[]"), "expected an integer, found a string", "1");
    wrong(in_graph("1.5", "[]"), "expected an integer, found `1.5`", "1.5");
    wrong(in_graph("-1", "[]"), "this integer is out of range for its type", "-1");
    wrong(in_graph("99999999999", "[]"), "this integer is out of range for its type", "99999999999");
    wrong(in_graph("1", "{\"a\": 1}"), "expected a list `[...]`, found a map", "{");
    wrong(in_graph("1", "[Swap(3)]"), "expected a string in double quotes, found `3`", "3");
    wrong(in_graph("1", "[Swap([\"a\"])]"), "expected a string in double quotes, found a list", "[");
    wrong(in_graph("1", "[Swap]"), "`Swap` needs parentheses after it", "Swap");
    wrong(in_graph("1", "[Swap(\"a\", \"b\")]"), "expected `)`", "b");
    wrong("Grph(version: 1, passes: [])".into(), "expected `Graph`, found `Grph`", "Grph");
    let param = |param: &str| format!("(version: 1, passes: [], params: {{{param}}})");
    wrong(param("\"a\": Const(Bool(default: 1))"), "expected `true` or `false`, found `1`", "1");
    wrong(param("\"a\": Const(Bool(default: maybe))"), "expected `true` or `false`, found `maybe`", "maybe");
    wrong(param("a: Const(Bool(default: true))"), "expected a string in double quotes, found `a`", "a");
    wrong(
        param("\"a\": Const(Int(default: 1, range: (1)))"),
        "expected a tuple of size 2, found 1 element",
        "(",
    );
    wrong(param("\"a\": Const(Int(default: 1, range: (1, 2, 3)))"), "expected `)`", "3");
}

#[test]
fn a_name_in_quotes_is_met_with_the_name() {
    let text = r#"Graph(version: 1, passes: [Dispatch(name: "a", shader: "b", run: "Once")])"#;
    let error = fails(text, "expected a name, found a string", "Once", "expected a name");
    assert_eq!(error.help, ["names are written without quotes: `Once`"]);
}

#[test]
fn a_value_without_the_name_of_its_field_is_met_with_the_fields() {
    let graph = |pass: &str| format!("Graph(version: 1, passes: [{pass}])");
    let positional = |pass: &str, found: &str, at: &str| {
        let message = format!("expected a field `name: value`, found {found}");
        let error = fails(&graph(pass), &message, at, "has no name before it");
        assert_eq!(error.help, ["the fields are name, shader, run, bind"]);
    };
    positional("Dispatch(4, \"b\")", "`4`", "4");
    positional("Dispatch(\"a\", \"b\")", "a string", "a");
    positional("Dispatch(false)", "`false`", "false");
    positional("Dispatch((1, 2))", "`(`", "(");
    let error = fails(&graph("4"), "expected a name, found `4`", "4", "expected a name");
    assert_eq!(error.help, ["the names here are Dispatch, Swap"]);
    let error = error_of("Graph(version: 1, passes: [], params: {\"a\": Const(2000)})");
    assert_eq!(error.help, ["the names here are Int, Bool"]);
}

#[test]
fn a_name_before_a_value_without_one_is_left_out() {
    let range = |range: &str| {
        format!("(version: 1, passes: [], params: {{\"a\": Const(Int(default: 1, range: {range}))}})")
    };
    let label = "the value here has no name";
    let error = fails(&range("(min: 1, max: 2)"), "expected an integer, found `min:`", "min", label);
    assert_eq!(error.help, ["leave out `min:`"]);
    let swap = "Graph(version: 1, passes: [Swap(name: \"a\")])";
    fails(swap, "expected a string in double quotes, found `name:`", "name", label);
}

#[test]
fn parentheses_after_a_name_that_takes_none_are_left_out() {
    for after in ["(x: 1)", "(1)", " (1)", "()"] {
        let run =
            format!("Graph(version: 1, passes: [Dispatch(name: \"a\", shader: \"b\", run: Once{after})])");
        let message = "`Once` takes nothing in parentheses";
        fails(&run, message, "Once", "leave out the parentheses after this");
    }
}

#[test]
fn what_is_not_in_parentheses_is_named() {
    let range = |range: &str| {
        format!("(version: 1, passes: [], params: {{\"a\": Const(Int(default: 1, range: {range}))}})")
    };
    let fails = |text: &str, found: &str, at: &str| {
        fails(&range(text), &format!("expected `(a, b)`, found {found}"), at, "expected `(a, b)`")
    };
    fails("\"w\"", "a string", "w");
    let error = fails("[1, 9]", "a list", "[");
    assert_eq!(error.help, ["write `(` and `)` in place of `[` and `]`"]);
}

#[test]
fn what_follows_the_graph_is_pointed_at() {
    let text = "Graph(version: 1, passes: []) Graph()";
    fails(text, "expected the end of the file, found `Graph`", "Graph", "not expected here");
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
        for text in ["", "x", "(a: é)\n", "("] {
            for code in [Error::Eof, Error::ExpectedString, Error::ExpectedComma, Error::Message("m".into())]
            {
                let error = ron_error(
                    FileId(0),
                    text,
                    &SpannedError { code, span: Span { start, end } },
                    &|_| Ok(()),
                );
                assert!(text.get(error.primary.span.start..error.primary.span.end).is_some());
            }
        }
    }
}

const GRAPH: &str = r#"Graph(version: 1, summary: "é", params: {"a": Const(Int(default: 1, range: (1, 2)))},
  passes: [Dispatch(name: "a", shader: "b", run: Once, bind: {"K": "k"}), Swap("keys")])"#;

proptest! {
    #[test]
    fn no_damage_to_a_graph_makes_the_translation_panic(
        at in 0..GRAPH.len(),
        length in 0usize..12,
        with in "[(){}\\[\\]:,\"a1 ]{0,2}",
    ) {
        let mut bytes = GRAPH.as_bytes().to_vec();
        let end = (at + length).min(bytes.len());
        bytes.splice(at..end, with.bytes());
        let text = String::from_utf8_lossy(&bytes).into_owned();
        if let Err(error) = read(&text) {
            let (files, file) = one_file("a.ron", &text);
            let diagnostic = ron_error(file, &text, &error, &|text| read(text).map(drop));
            let span = diagnostic.primary.span;
            prop_assert!(text.get(span.start..span.end).is_some(), "{diagnostic:?}");
            render(&files, &[diagnostic], false);
        }
    }
}
