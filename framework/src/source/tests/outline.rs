use std::collections::BTreeMap;
use std::rc::Rc;

use proptest::prelude::*;
use serde::Serialize;

use super::*;
use crate::ir::FileId;

fn outline(text: &str) -> Outline {
    Outline::parse(FileId(0), text).unwrap_or_else(|e| panic!("{text}: {e}"))
}

fn root(text: &str) -> Place {
    Place::root(&Rc::new(outline(text)))
}

#[track_caller]
fn value_is(text: &str, way: impl Fn(Place) -> Place, expected: &str) {
    let span = way(root(text)).span();
    assert_eq!(&text[span.start..span.end], expected, "{text}");
}

#[track_caller]
fn key_is(text: &str, way: impl Fn(Place) -> Place, expected: &str) {
    let span = way(root(text)).key();
    assert_eq!(&text[span.start..span.end], expected, "{text}");
}

/// Checks the error's message and the text that it points at.
#[track_caller]
fn fails(text: &str, message: &str, at: &str) {
    let error = Outline::parse(FileId(0), text).expect_err(text);
    let span = error.primary.span;
    assert_eq!((error.message.as_str(), &text[span.start..span.end]), (message, at), "{text}");
}

const GRAPH: &str = r##"#![enable(implicit_some)]
// A comment with "quotes" and (brackets
Graph(
  version: 1, /* nested /* comments: [ */ */
  params: { "digit bits": Const(Int(default: 8, range: (1, 11))), "x": Live(Float(default: -1.5e-3)) },
  passes: [
    Dispatch(name: "a\tb", bind: {"Keys": "front(keys)"}, size: Threads("n")),
    Swap("keys"),
    r#"raw "text""#,
  ],
  unit: (),
  format: Rgba16Float,
)"##;

#[test]
fn fields_keys_and_indices_lead_to_their_values() {
    let passes = |root: Place| root.field("passes");
    let bits = |root: Place| root.field("params").field("digit bits").index(0);
    value_is(GRAPH, |root| root.field("version"), "1");
    value_is(GRAPH, bits, "Int(default: 8, range: (1, 11))");
    value_is(GRAPH, |root| bits(root).field("default"), "8");
    value_is(GRAPH, |root| bits(root).field("range").index(1), "11");
    value_is(GRAPH, |root| root.field("params").field("x").index(0).field("default"), "-1.5e-3");
    value_is(GRAPH, |root| passes(root).index(0).field("size").index(0), "n");
    value_is(GRAPH, |root| passes(root).index(1), "Swap(\"keys\")");
    value_is(GRAPH, |root| passes(root).index(2), "raw \"text\"");
    value_is(GRAPH, |root| root.field("unit"), "()");
    value_is(GRAPH, |root| root.field("format"), "Rgba16Float");
}

#[test]
fn texts_are_pointed_at_inside_their_quotes() {
    value_is(GRAPH, |root| root.field("passes").index(0).field("name"), "a\\tb");
    value_is(GRAPH, |root| root.field("passes").index(0).field("bind").field("Keys"), "front(keys)");
}

#[test]
fn the_name_of_a_field_and_the_key_of_a_map_have_their_own_places() {
    key_is(GRAPH, |root| root.field("version"), "version");
    key_is(GRAPH, |root| root.field("params").field("digit bits"), "digit bits");
    key_is(GRAPH, |root| root.field("passes").index(0).field("bind").field("Keys"), "Keys");
    key_is("{1: 2, 'c': 3, (4, 5): 6}", |root| root.field("'c'"), "'c'");
    value_is("{1: 2, 'c': 3, (4, 5): 6}", |root| root.field("(4, 5)"), "6");
    key_is("(r#type: 1)", |root| root.field("type"), "r#type");
    // An element of a list has no key: its own span is returned.
    key_is("[7, 8]", |root| root.index(1), "8");
}

#[test]
fn a_step_to_nothing_stays_at_the_nearest_element_around_it() {
    value_is(
        GRAPH,
        |root| root.field("params").field("x").index(3).field("y"),
        "Live(Float(default: -1.5e-3))",
    );
    value_is(GRAPH, |root| root.field("format").index(0), "Rgba16Float");
    key_is(GRAPH, |root| root.field("format").index(0), "Rgba16Float");
    value_is("1", |root| root.field("a"), "1");
}

#[test]
fn some_and_an_unwrapped_variant_are_no_steps() {
    value_is("(a: Some(3))", |root| root.field("a"), "3");
    key_is("(a: Some(3))", |root| root.field("a"), "a");
    value_is("[Some(Some((x: 1)))]", |root| root.index(0).field("x"), "1");
    value_is("Const(default: 8)", |root| root.index(0).field("default"), "8");
}

#[test]
fn the_head_of_a_struct_is_its_name_and_that_of_a_list_its_bracket() {
    let head = |text: &str, way: fn(Place) -> Place| {
        let span = way(root(text)).head();
        text[span.start..span.end].to_string()
    };
    assert_eq!(head(GRAPH, |root| root), "Graph");
    assert_eq!(head(GRAPH, |root| root.field("passes")), "[");
    assert_eq!(head(GRAPH, |root| root.field("passes").index(0)), "Dispatch");
    assert_eq!(head(GRAPH, |root| root.field("passes").index(0).field("name")), "a\\tb");
    assert_eq!(head("(a: 1)", |root| root), "(");
}

#[test]
fn every_form_of_value_is_delimited() {
    let values = [
        "1",
        "-1",
        "+1",
        "1_000",
        "0x1F",
        "0b01",
        "0o17",
        "1u8",
        "1.0",
        ".5",
        "1.",
        "1e5",
        "1e-5",
        "1.5E+3",
        "1.0f32",
        "inf",
        "-inf",
        "NaN",
        "0..9",
        "inf..1",
        "b'a'..=b'z'",
        "1..inf",
        "0..=9",
        "-1..-5",
        "'c'",
        "'\\n'",
        "'\\''",
        "'\"'",
        "b'x'",
        "b'\\x0f'",
        "b\"bytes\\xff\"",
        "br#\"raw\"#",
        "true",
        "()",
        "[]",
        "{}",
        "Unit",
        "r#type",
        "größe",
        "Some(1)",
        "Empty()",
        "[[],[[]],]",
        "(1,2,)",
        "\"\"",
        "r\"\"",
        "r##\"a\"#b\"##",
    ];
    for value in values {
        let text = format!("[{value}, /* */ {value} // \n, last]");
        assert_eq!(root(&text).index(2).span().start, text.len() - 5, "{text}");
    }
}

#[test]
fn an_offset_in_a_text_is_found_behind_its_escapes() {
    let text = r#"(a: "x\ty\u{1f642}z\\")"#;
    let offset = |offset| root(text).field("a").string_offset(offset);
    let at = |part: &str| text.find(part).unwrap();
    assert_eq!(offset(0), at("x"));
    assert_eq!(offset(1), at("\\t"));
    assert_eq!(offset(2), at("y"));
    assert_eq!(offset(3), at("\\u"));
    assert_eq!(offset(7), at("z"));
    assert_eq!(offset(8), at("\\\\"));
    assert_eq!(offset(9), text.len() - 2);
    assert_eq!(offset(1000), text.len() - 2);
}

#[test]
fn a_line_that_goes_on_after_a_backslash_is_one_text() {
    let text = "\"ab\\\n     cd\"";
    assert_eq!(root(text).string_offset(1), 2);
    assert_eq!(root(text).string_offset(2), text.find("cd").unwrap());
    assert_eq!(root(text).string_offset(3), text.find('d').unwrap());
}

#[test]
fn a_part_of_a_text_has_a_place_and_other_values_have_theirs() {
    let text = r#"(a: "n \u{2b} m", b: r"n + m", c: 12)"#;
    let part = |name: &str, range| {
        let span = root(text).field(name).within_string(range);
        text[span.start..span.end].to_string()
    };
    assert_eq!(part("a", 2..3), "\\u{2b}");
    assert_eq!(part("a", 4..5), "m");
    assert_eq!(part("b", 2..3), "+");
    assert_eq!(part("c", 1..2), "12");
    assert_eq!(part("missing", 0..1), text);
}

#[test]
fn names_given_twice_are_errors() {
    let text = r#"(a: 1, b: {"k": 1, "k": 2, "l": 3}, a: 2, c: (a: 1))"#;
    let outline = outline(text);
    let errors = outline.duplicates();
    let messages: Vec<_> = errors.iter().map(|e| e.message.as_str()).collect();
    assert_eq!(messages, ["the key `k` is given twice", "the field `a` is given twice"]);
    let places = errors.iter().map(|e| (e.secondary[0].span.start, e.primary.span.start));
    assert_eq!(places.collect::<Vec<_>>(), [(12, 20), (1, 36)]);
    // The last of the duplicates counts.
    value_is(text, |root| root.field("a"), "2");
}

/// `framework/tests/golden/in/syntax.ron` has more cases.
#[test]
fn missing_and_wrong_punctuation_is_pointed_at() {
    fails("[1 2]", "expected `,` or `]`, found `2`", "");
    fails("[a .5]", "expected `,` or `]`, found `.5`", "");
    fails("(a: 1,, b: 2)", "expected a field, as those before it: `name: value`, found `,`", ",");
    fails("(a: 1, 2)", "expected a field, as those before it: `name: value`, found `2`", "2");
    fails("{\"a\" 1}", "expected `:` after `a`, found `1`", "1");
    fails("[a: 1]", "expected `,` or `]`, found `:`", ":");
    fails("1 2", "expected the end of the file, found `2`", "2");
    fails(" // only a comment", "the file is empty", "");
    fails("[1, #![enable(x)] 2]", "expected a value, found an attribute", "#![enable(x)]");
    fails("(a: ')", "this is not one character", "')");
    fails(r#""\u{}""#, "unknown escape", r"\u");
    fails(r#""\é""#, "unknown escape", r"\é");
}

#[test]
fn the_end_of_a_file_is_on_its_last_line_that_is_not_empty() {
    for (text, at) in
        [("\n", 0), (" \n\n", 0), ("// only a comment\n\n", 17), ("[1,\n 2\n", 6), ("Graph(a:\n\n", 8)]
    {
        let error = Outline::parse(FileId(0), text).expect_err(text);
        let end = error.secondary.first().unwrap_or(&error.primary).span.start;
        assert_eq!(end, at, "{text:?}: {error:?}");
    }
}

#[test]
fn hostile_depth_is_an_error_and_not_a_stack_overflow() {
    for opener in ["(", "[", "{", "(a: ", "{1: ", "a(", "Some("] {
        let error = Outline::parse(FileId(0), &opener.repeat(100_000)).unwrap_err();
        assert_eq!(error.message, "the file is nested more than 128 levels deep", "{opener}");
    }
    outline(&("[".repeat(128) + &"]".repeat(128)));
    let comment = "/*".repeat(100_000);
    assert_eq!(Outline::parse(FileId(0), &comment).unwrap_err().message, "a comment is not closed");
}

/// A value that `ron` can write in several ways.
#[derive(Clone, Debug, Serialize)]
enum Tree {
    Unit,
    Int(i64),
    Float(f64),
    Char(char),
    Text(String),
    List(Vec<Tree>),
    Map(BTreeMap<String, Tree>),
    Record { first: Box<Tree>, second: Option<Box<Tree>> },
}

fn tree() -> impl Strategy<Value = Tree> {
    let leaf = prop_oneof![
        Just(Tree::Unit),
        any::<i64>().prop_map(Tree::Int),
        (-1e10..1e10).prop_map(Tree::Float),
        any::<char>().prop_map(Tree::Char),
        ".{0,12}|[\"\\\\\n\r\té🦀#]{0,8}".prop_map(Tree::Text),
    ];
    leaf.prop_recursive(4, 32, 4, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..4).prop_map(Tree::List),
            prop::collection::btree_map("[a-z\" :\\\\]{0,4}", inner.clone(), 0..4).prop_map(Tree::Map),
            (inner.clone(), prop::option::of(inner)).prop_map(|(first, second)| Tree::Record {
                first: Box::new(first),
                second: second.map(Box::new)
            }),
        ]
    })
}

/// Checks that every leaf is at the place that the outline gives.
fn check(text: &str, tree: &Tree, place: Place) {
    let found = |place: &Place| {
        let span = place.span();
        &text[span.start..span.end]
    };
    match tree {
        Tree::Unit => assert_eq!(found(&place), "Unit"),
        Tree::Int(value) => assert_eq!(found(&place.index(0)), value.to_string()),
        Tree::Float(value) => assert_eq!(found(&place.index(0)).parse(), Ok(*value)),
        Tree::Char(value) => assert_eq!(ron::from_str(found(&place.index(0))), Ok(*value)),
        Tree::Text(value) => {
            let place = place.index(0);
            let written = place.span();
            // For each character: unescaping the text before it gives the value before it.
            let raw = text[..written.start].ends_with("#\"");
            for (offset, _) in value.char_indices().chain([(value.len(), ' ')]) {
                let prefix = &text[written.start..place.string_offset(offset)];
                let prefix =
                    if raw { Ok(prefix.to_string()) } else { ron::from_str(&format!("\"{prefix}\"")) };
                assert_eq!(prefix.as_deref(), Ok(&value[..offset]));
            }
        }
        Tree::List(trees) => {
            trees.iter().enumerate().for_each(|(i, tree)| check(text, tree, place.index(0).index(i)));
        }
        Tree::Map(trees) => {
            trees.iter().for_each(|(key, tree)| check(text, tree, place.index(0).field(key)));
        }
        Tree::Record { first, second } => {
            check(text, first, place.field("first"));
            if let Some(second) = second {
                check(text, second, place.field("second"));
            }
        }
    }
}

proptest! {
    #[test]
    fn what_ron_writes_is_outlined_with_every_leaf_in_its_place(tree in tree(), pretty: bool, escape: bool) {
        let config = ron::ser::PrettyConfig::new().escape_strings(escape);
        let text = if pretty { ron::ser::to_string_pretty(&tree, config) } else { ron::to_string(&tree) };
        let text = text.unwrap();
        check(&text, &tree, root(&text));
    }

    #[test]
    fn no_text_makes_the_outline_panic(text in ".*") {
        let _ = Outline::parse(FileId(0), &text);
    }

    #[test]
    fn no_heap_of_tokens_makes_the_outline_panic_and_what_ron_accepts_it_accepts(
        tokens in prop::collection::vec(prop::sample::select(vec![
            "(", ")", "[", "]", "{", "}", ",", ":", "a", "b(", "Some(", "\"", "\"x\"", "1", "-1.5e3", "'c'", "'",
            "r#\"q\"#", "r#", "r\"", "//c\n", "/*", "*/", "b'x'", "b\"z\"", "0x1f", "..", "=", "true", "inf", "\\",
            "\\x", "\\u{", "#", "#![enable(implicit_some)]", "é", "🦀", "\n", " ", "/", "+", "b", "br",
        ]), 0..16),
    ) {
        let text = tokens.concat();
        let outline = Outline::parse(FileId(0), &text);
        if let Err(error) = &outline {
            let span = error.primary.span;
            prop_assert!(text.get(span.start..span.end).is_some(), "{error:?}");
        }
        if ron::from_str::<ron::Value>(&text).is_ok() {
            prop_assert!(outline.is_ok(), "{text}: {outline:?}");
        }
    }
}
