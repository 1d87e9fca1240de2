//! Lists the names in a graph file or a shader, with their positions and roles: declarations and references.

use super::cursor::{Group, Meaning, Scan, is_shader, shaders};
use super::scopes::Scopes;
use splatgraph_framework::schema::{ResourceName, is_choice};
use std::ops::Range;

/// Name of an included graph's output in its includer, after the include's name and a dot.
pub const PICTURE: &str = "picture";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Parameter,
    Let,
    /// An import, a port, a buffer or an image.
    Resource,
    /// A pass: a dispatch, a draw or a fill.
    Pass,
    Include,
    Statistic,
    /// The variable of a repeat.
    Variable,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Role {
    Declares(Kind),
    /// The use of a parameter, a `let` or a variable in an expression.
    Value,
    /// The use of a resource, in the graph to which these includes lead.
    Resource(Vec<String>),
    /// The use of an include, in the graph to which these includes lead.
    Include(Vec<String>),
    /// The use of another graph's parameter, in `set` or `Only` of an include, or in `set` of a preset. The text is the
    /// graph's name.
    ParameterOf(String),
    /// The use of a port of the graph with this name, in `with` of an include.
    PortOf(String),
    Statistic,
    Graph,
    Shader,
    /// A block, an image or a push constant of these shaders.
    OfShaders(Vec<String>),
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mention {
    pub range: Range<usize>,
    pub name: String,
    pub role: Role,
    /// Index in [`Scan::groups`] of the bracket that contains the name.
    pub group: usize,
}

pub fn mentions(text: &str, scan: &Scan) -> Vec<Mention> {
    let mut found = Vec::new();
    for place in &scan.texts {
        let around: Vec<&Group> = scan.around(place.group).collect();
        let group = around[0];
        let inside = &text[place.inside.clone()];
        let mut add = |range: Range<usize>, role| {
            let range = place.inside.start + range.start..place.inside.start + range.end;
            found.push(Mention { name: text[range.clone()].to_owned(), range, role, group: place.group });
        };
        let whole = 0..inside.len();
        let outer = around.get(1).copied();
        let graph = |include: Option<&Group>| include?.value("graph").map(str::to_owned);
        match (place.key.as_deref(), group.lead.as_str()) {
            // A requirement holds a condition over facts and an explanation, neither of which has names of the graph.
            _ if around.iter().any(|group| group.lead == "require") => {}
            (None, lead) if group.is_map => match (lead, outer.map_or("", |outer| outer.name.as_str())) {
                ("params", "Graph") => add(whole, Role::Declares(Kind::Parameter)),
                ("let", "Graph") => add(whole, Role::Declares(Kind::Let)),
                ("stats", "Graph") => add(whole, Role::Declares(Kind::Statistic)),
                ("imports" | "ports" | "resources", "Graph") => add(whole, Role::Declares(Kind::Resource)),
                ("bind" | "push", _) => add(whole, Role::OfShaders(outer.map(shaders).unwrap_or_default())),
                ("with", _) => graph(outer).into_iter().for_each(|g| add(whole.clone(), Role::PortOf(g))),
                ("set", _) => graph(outer).into_iter().for_each(|g| add(whole.clone(), Role::ParameterOf(g))),
                _ => {}
            },
            (Some("name"), _) if group.name == "Include" => add(whole, Role::Declares(Kind::Include)),
            (Some("name"), _) => add(whole, Role::Declares(Kind::Pass)),
            (Some("var"), _) => add(whole, Role::Declares(Kind::Variable)),
            (Some("grows"), _) => add(whole, Role::Statistic),
            (None, _) if around.iter().any(|group| group.name == "Only") => {
                let include = around.iter().find(|group| group.name == "Include").copied();
                graph(include).into_iter().for_each(|g| add(whole.clone(), Role::ParameterOf(g)));
            }
            (key, lead) => match scan.meaning(place) {
                Meaning::Graph => add(whole, Role::Graph),
                Meaning::Shader { .. } if !inside.contains('\'') => add(whole, Role::Shader),
                Meaning::Resource if !is_choice(inside) => match resource(inside) {
                    Some(range) => of_path(inside, range, &mut add),
                    None => expression(inside, false, &mut add),
                },
                Meaning::Resource => expression(inside, true, &mut add),
                Meaning::Expression | Meaning::Value { .. } | Meaning::Shader { .. } | Meaning::Format => {
                    expression(inside, key.is_some() && lead == "let", &mut add);
                }
                Meaning::Free
                | Meaning::Import
                | Meaning::Block { .. }
                | Meaning::Parameter { .. }
                | Meaning::Port { .. } => {}
            },
        }
    }
    found
}

/// Returns the byte range of the name in `name`, `front(name)`, `back(name)` or `last(name)`; `None` for other text.
fn resource(text: &str) -> Option<Range<usize>> {
    let range = ResourceName::parse(text)?.range;
    let is_name = |name: &str| !name.is_empty() && name.chars().all(|c| continues_name(c) || c == '.');
    is_name(&text[range.clone()]).then_some(range)
}

fn of_path(text: &str, range: Range<usize>, add: &mut impl FnMut(Range<usize>, Role)) {
    let mut start = range.start;
    let mut within = Vec::new();
    for part in text[range.clone()].split('.') {
        let place = start..start + part.len();
        let role = if place.end == range.end { Role::Resource } else { Role::Include };
        add(place.clone(), role(within.clone()));
        within.push(part.to_owned());
        start = place.end + 1;
    }
}

/// Returns the name with which an expression compares the single-quoted string that lies at `inside`. The name is empty
/// if another token is beside the operator; `None` if the string is no operand of `==` or `!=`.
///
/// Such a string is an option of a choice.
pub fn compared<'a>(text: &'a str, inside: &Range<usize>) -> Option<&'a str> {
    let is_in_name = |c: char| continues_name(c) || c == '.';
    let before = text[..inside.start - 1].trim_end();
    if let Some(left) = before.strip_suffix("==").or(before.strip_suffix("!=")) {
        let left = left.trim_end();
        return Some(&left[left.trim_end_matches(is_in_name).len()..]);
    }
    let after = text.get(inside.end + 1..)?.trim_start();
    let right = after.strip_prefix("==").or(after.strip_prefix("!="))?.trim_start();
    Some(&right[..right.len() - right.trim_start_matches(is_in_name).len()])
}

/// Adds the names in an expression and in its single-quoted strings: shaders, and resources if `resources` is true.
fn expression(text: &str, resources: bool, add: &mut impl FnMut(Range<usize>, Role)) {
    let mut at = 0;
    while let Some(c) = text[at..].chars().next() {
        let rest = &text[at..];
        if c == '\'' {
            let inside = at + 1..rest[1..].find('\'').map_or(text.len(), |end| at + 1 + end);
            let literal = &text[inside.clone()];
            let is_named = resources && compared(text, &inside).is_none();
            if is_shader(literal) {
                add(inside.clone(), Role::Shader);
            } else if let Some(name) = resource(literal).filter(|_| is_named) {
                let mut shifted = |place: Range<usize>, role| {
                    add(inside.start + place.start..inside.start + place.end, role);
                };
                of_path(literal, name, &mut shifted);
            }
            at = inside.end + 1;
            if at > text.len() {
                break;
            }
        } else if c.is_ascii_alphanumeric() || c == '_' {
            let length = rest.find(|c: char| !continues_name(c) && c != '.').unwrap_or(rest.len());
            // Numbers and facts are skipped. The name of a fact has a dot.
            if !c.is_ascii_digit() && !rest[..length].contains('.') {
                add(at..at + length, Role::Value);
            }
            at += length;
        } else {
            at += c.len_utf8();
        }
    }
}

pub fn continues_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Word {
    /// The byte range of an identifier that does not follow a dot.
    Name(Range<usize>),
    /// The byte range of an identifier that the shader declares itself; see [`Scopes`].
    Local(Range<usize>),
    /// The byte range of the name of an included file.
    Include(Range<usize>),
}

/// Lists the names in a shader's text outside of comments, except after a dot, and the files that it includes.
pub fn words(text: &str) -> Vec<Word> {
    let mut found = Vec::new();
    let mut at = 0;
    let (mut is_field, mut is_directive) = (false, false);
    let mut scopes = Scopes::new();
    while let Some(c) = text[at..].chars().next() {
        let rest = &text[at..];
        let after_a_dot = std::mem::take(&mut is_field);
        if rest.starts_with("//") {
            at += rest.find('\n').unwrap_or(rest.len());
        } else if rest.starts_with("/*") {
            at += rest.find("*/").map_or(rest.len(), |end| end + 2);
        } else if let Some(file) = after_include(rest) {
            let start = at + rest.len() - file.len();
            let length = file.find(['"', '>', '\n']).unwrap_or(file.len());
            found.push(Word::Include(start..start + length));
            at += rest.find('\n').unwrap_or(rest.len());
        } else if c.is_ascii_alphanumeric() || c == '_' {
            let length = rest.find(|c| !continues_name(c)).unwrap_or(rest.len());
            let (word, range) = (&rest[..length], at..at + length);
            if c.is_ascii_digit() || after_a_dot {
                if !is_directive {
                    scopes.sign(c);
                }
            } else {
                let is_local = if is_directive { scopes.contains(word) } else { scopes.word(word) };
                found.push(if is_local { Word::Local(range) } else { Word::Name(range) });
            }
            at += length;
        } else {
            // A directive ends with its line, unless a backslash continues it.
            let is_end = c == '\n' && !text[..at].trim_end_matches('\r').ends_with('\\');
            is_directive = c == '#' || is_directive && !is_end;
            if c == '#' {
                scopes.directive(rest);
            } else if !is_directive && !c.is_whitespace() {
                scopes.sign(c);
            }
            is_field = c == '.';
            at += c.len_utf8();
        }
    }
    if !scopes.is_known() {
        for word in &mut found {
            if let Word::Local(range) = word {
                *word = Word::Name(range.clone());
            }
        }
    }
    found
}

/// Returns the text after `#include "` or `#include <`, spelled with any blanks; `None` for another text.
fn after_include(text: &str) -> Option<&str> {
    let blanks = [' ', '\t'];
    let directive = text.strip_prefix('#')?.trim_start_matches(blanks).strip_prefix("include")?;
    directive.trim_start_matches(blanks).strip_prefix(['"', '<'])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn names_of_any_text_lie_in_it(text in "[\"'\\\\(){}\\[\\],:.=?a-dä/*\n ]{0,60}") {
            for mention in mentions(&text, &Scan::of(&text)) {
                prop_assert_eq!(text.get(mention.range), Some(mention.name.as_str()));
            }
            for word in words(&text) {
                let (Word::Name(range) | Word::Local(range) | Word::Include(range)) = word;
                prop_assert!(text.get(range).is_some());
            }
        }
    }

    fn roles(text: &str) -> Vec<(String, Role)> {
        mentions(text, &Scan::of(text)).into_iter().map(|m| (m.name, m.role)).collect()
    }

    #[test]
    fn an_expression_that_chooses_has_values_and_resources_but_no_names_of_choices() {
        let text =
            r#"Graph(passes: [Dispatch(bind: { "Order": "of == 'last' ? 'last(sort.order)' : 'order'" })])"#;
        let within = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        assert_eq!(
            roles(text),
            [
                ("Order".into(), Role::OfShaders(vec![])),
                ("of".into(), Role::Value),
                ("sort".into(), Role::Include(within(&[]))),
                ("order".into(), Role::Resource(within(&["sort"]))),
                ("order".into(), Role::Resource(within(&[]))),
            ]
        );
    }

    #[test]
    fn words_of_requirements_and_helps_are_no_names() {
        let text = r#"Graph(require: [("device.int64", "n of 64 bits")],
            params: { "n": Const(Int(default: "2 * scene.count", label: "n", help: "n")) }, summary: "n")"#;
        assert_eq!(roles(text), [("n".into(), Role::Declares(Kind::Parameter))]);
    }

    #[test]
    fn words_of_a_shader_leave_comments_and_fields_out() {
        let text = "#include \"a.glsl\"\n// N\nint x = N /* N */ + p.N;";
        let names: Vec<&str> = words(text)
            .iter()
            .filter_map(|word| match word {
                Word::Name(range) | Word::Local(range) => Some(&text[range.clone()]),
                Word::Include(_) => None,
            })
            .collect();
        assert_eq!(names, ["int", "x", "N", "p"]);
        assert_eq!(words(text)[0], Word::Include(10..16));
        for include in ["#  include  \"a.glsl\"", "#\tinclude<a.glsl>", "#include <a.glsl> // <b>"] {
            let [Word::Include(range)] = &words(include)[..] else { panic!("{include}") };
            assert_eq!(&include[range.clone()], "a.glsl");
        }
    }

    #[test]
    fn names_that_a_shader_declares_are_local_from_their_initialiser_to_the_end_of_their_block() {
        // Whether each `r` is local: 1 or 0.
        for (text, expected) in [
            ("float f(vec2 p, const in float r) { return r; } float g() { return r; }", "110"),
            ("float f(float r); float g() { return r; }", "10"),
            ("struct S { float a, r; } s; float g(S s) { return r * s.r; }", "10"),
            (
                "void f() { float r = 2.0 * r, s = r; if (s > r) { s = r; } } float g() { return r; }",
                "101110",
            ),
            ("void f() { float s = g(s, r), r = 1.0; } void g(float[2] r) { r; }", "0111"),
            (
                "void f() { for (int i = 0, r = 2; r < 3; r++) for (int j = r; j < r; j++) g(r); g(r); }",
                "1111110",
            ),
            (
                "void f(float s) { float t[2] = {s, r}; g(t, r); s = t[0], s = r; switch (1) { case 1: s = r; } }",
                "0000",
            ),
            ("void f() { if (a) return r; else r; }", "00"),
            ("void f() {\n#define TWICE \\\n  float r\n  r; }", "00"),
            ("void f() {\n#if A\nfloat r = 1.0;\n#endif\ng(r); }", "00"),
            ("struct S {\n#if A\nfloat r;\n#endif\n}; void f() { g(r); }", "10"),
            ("#ifndef G\n# define G\nvoid f(float r) { g(r); }\n#endif\nfloat s = r;", "110"),
            ("void f() { if (a) { float r; r; } else { r; } } void g(float r) { r; }", "11011"),
            // The names ahead of a body or a statement may belong to a second one, so the scopes are unknown.
            ("void f(float r)\n#if A == 1\n{ r; }\n#elif B == 2\n{ 2.0 * r; }\n#endif", "000"),
            ("void f() { for (int r = 0; r < 3; r++) if (a) { int s; g(r); } else { h(r); } }", "00000"),
            ("void f() { for (int r = 0; r < 3; r++) if (a) g(r); else h(r); }", "00000"),
            // Each branch of the directives closes the bracket, so the scopes are unknown.
            ("void f(float r) {\n#if A\nr; }\n#else\nr; }\n#endif", "000"),
        ] {
            let is_local = |word: &Word| match word {
                Word::Local(range) if &text[range.clone()] == "r" => Some('1'),
                Word::Name(range) if &text[range.clone()] == "r" => Some('0'),
                _ => None,
            };
            assert_eq!(words(text).iter().filter_map(is_local).collect::<String>(), expected, "{text}");
        }
    }
}
