use std::collections::BTreeMap;

use crate::shader::compile::reached::{Reached, Text, reached};

/// Returns the names in capitals that a shader reaches with `A=1`, `B=2`, `N=-1` and `F=0.5`; `all` if it cannot be
/// followed.
fn names(text: &str) -> String {
    names_of(&[("main", text)])
}

fn names_of(files: &[(&str, &str)]) -> String {
    let Some(Reached { names, .. }) = walked(files) else { return "all".into() };
    let upper = names.iter().filter(|name| name.chars().all(|c| c.is_ascii_uppercase()));
    upper.cloned().collect::<Vec<_>>().join(" ")
}

fn walked(files: &[(&str, &str)]) -> Option<Reached> {
    let includes: BTreeMap<&str, usize> = files.iter().enumerate().map(|(i, file)| (file.0, i)).collect();
    let defines = [("A", "1"), ("B", "2"), ("N", "-1"), ("F", "0.5")];
    let defines = defines.map(|(name, value)| (name.to_string(), value.to_string()));
    let texts: Vec<Text> =
        files.iter().map(|file| Text { text: file.1, includes: includes.clone() }).collect();
    reached(&texts, &defines)
}

#[test]
fn a_name_in_a_condition_that_nothing_defines_is_found_where_the_compiler_reads_it() {
    let undefined = |text: &str| {
        let (_, place) = walked(&[("main", text)]).expect("it is followed").undefined?;
        Some(text[place].to_string())
    };
    for (text, name) in [
        ("#if C\n#endif", "C"),
        ("#if A == 1 && C > 2\n#endif", "C"),
        ("#if A == 2\n#elif (B + C)\n#endif", "C"),
        ("#define M C\n#if M\n#endif", "C"),
        ("#undef A\n#if A\n#endif", "A"),
        ("#if true\n#endif", "true"),
        ("#if defined(D) && D\n#elif C\n#endif", "C"),
    ] {
        assert_eq!(undefined(text).as_deref(), Some(name), "{text}");
    }
    for text in [
        "#ifdef C\n#endif",
        "#if defined(C) && C > 1\n#elif 0\n#endif",
        "#if !defined C || C\n#endif",
        "#if A == 1 || C\n#endif",
        "#if A == 2\n#if C\n#endif\n#endif",
        "#if A == 1\n#elif C\n#endif",
        "#if GL_EXT_thing || __VERSION__ > 450\n#endif",
        "#if defined(GL_EXT_thing) && C\n#endif",
        "#ifdef GL_EXT_thing\n#if C\n#endif\n#endif",
        "#ifdef GL_EXT_thing\n#define C 1\n#endif\n#if C\n#endif",
        "#ifndef C\n#define C 0\n#endif\n#if C\n#endif",
        "#define D(x) x\n#if D(1)\n#endif",
    ] {
        assert_eq!(undefined(text), None, "{text}");
    }
    let included = walked(&[("main", "#include \"a\""), ("a", "\n#if C\n#endif")]).expect("it is followed");
    assert_eq!(included.undefined, Some((1, 5..6)));
}

#[test]
fn a_define_that_the_shader_declares_is_found_whatever_it_declares() {
    let redeclared = |text: &str| {
        let (_, place) = walked(&[("main", text)]).expect("it is followed").redeclared?;
        Some(place.start)
    };
    for (text, start) in [
        ("const uint A = 4u;", 11),
        ("layout(binding = 0) readonly buffer A { uint a[]; };", 36),
        ("layout(rgba8) uniform image2D A;", 30),
        ("struct A { float x; };", 7),
        ("Splat A;", 6),
        ("#define A 3", 8),
        ("#define A(x) x", 8),
    ] {
        assert_eq!(redeclared(text), Some(start), "{text}");
    }
    for text in [
        "return A;",
        "case A: x = B; else A;",
        "#define NEGATE -\nint x = NEGATE A;",
        "#define A 1",
        "#undef A\n#define A 3\nuint A;",
        "#ifndef A\n#define A 3\n#endif",
        "#if C\n#define A 3\n#endif",
        "int x = A + B;",
    ] {
        assert_eq!(redeclared(text), None, "{text}");
    }
}

#[test]
fn a_branch_that_is_not_taken_is_not_reached_and_its_condition_is() {
    assert_eq!(names("A\n#if B == 2\nX\n#else\nY\n#endif\nZ"), "A B X Z");
    assert_eq!(names("#if B == 3\nX\n#elif A == 1\nY\n#elif N\nZ\n#else\nW\n#endif"), "A B Y");
    assert_eq!(names("#if B != 2\n#if A\nX\n#else\nY\n#endif\n#elif N > 0\nZ\n#else\nW\n#endif"), "B N W");
    assert_eq!(names("#ifdef A\nX\n#endif\n#ifndef C\nY\n#endif"), "A C X Y");
}

#[test]
fn operands_after_one_that_decides_are_not_reached() {
    assert_eq!(names("#if A == 2 && B == 2\nX\n#endif"), "A");
    assert_eq!(names("#if A == 1 || B == 2\nX\n#endif"), "A X");
    assert_eq!(names("#if A == 1 && B == 2 && !defined(C)\nX\n#endif"), "A B C X");
    assert_eq!(names("#if (A + 1 < B || N >= 0) && defined C\nX\n#endif"), "A B N");
}

#[test]
fn operators_have_the_values_and_the_precedence_of_c() {
    for condition in [
        "A + B * 3 == 7",
        "(A + B) * 3 == 9",
        "A << B == 4",
        "-N == A",
        "~A == -2",
        "7 % 4 - 1 == B",
        "A | 2 && 0 || 1",
        "0x10 / 3 == 5u",
        "(5 & 3 ^ 1) == 0",
        "!(A > B) == 1",
        "9 >> 1 <= 4",
        "N - N == 0",
    ] {
        assert_eq!(
            names(&format!("#if {condition}\nX\n#else\nY\n#endif")).replace(['A', 'B', 'N', ' '], ""),
            "X",
            "{condition}"
        );
    }
}

#[test]
fn every_branch_of_a_condition_without_a_value_is_reached() {
    for condition in [
        "C",
        "F > 0",
        "GL_EXT_thing",
        "defined(GL_EXT_thing)",
        "1 / (A - 1)",
        "A +",
        "A B",
        "017 == 15",
        "-(-2147483647 - 1) > 0",
    ] {
        let found = names(&format!("#if {condition}\nX\n#else\nY\n#endif"));
        assert!(found.ends_with("X Y"), "{condition}: {found}");
    }
    // Definitions in an unknown branch may be in force.
    let text = "#if C\n#define D 1\n#endif\n#ifdef D\nX\n#else\nY\n#endif\n#if D\nZ\n#endif";
    assert_eq!(names(text), "C D X Y Z");
    assert_eq!(names("#define D 1\n#if C\n#undef D\n#endif\n#ifdef D\nX\n#else\nY\n#endif"), "C D X Y");
}

#[test]
fn a_macro_is_followed_where_it_is_used() {
    assert_eq!(names("#define D (A == 1)\n#define E B\n#if D\nX\n#endif"), "A D E X");
    assert_eq!(names("#define D E\n#define E(x) x + B\nD(1)"), "B D E");
    assert_eq!(names("#define D D + A\nD"), "A D");
    assert_eq!(names("#define D(x) A\n#if D(1)\nX\n#else\nY\n#endif"), "A D X Y");
    assert_eq!(names("#define D 1\n#undef D\n#define D 0\n#if D\nX\n#else\nY\n#endif"), "D Y");
    assert_eq!(names("#undef A\n#ifdef A\nX\n#endif"), "A");
}

#[test]
fn texts_that_grow_or_nest_without_end_are_given_up() {
    let doubled: String = (1..40).map(|i| format!("#define M{i} M{0} + M{0}\n", i - 1)).collect();
    let grows = format!("#define M0 A\n{doubled}#if M39\nX\n#else\nY\n#endif\nM39");
    assert_eq!(names(&grows), "A X Y");
    let empty = grows.replace("#define M0 A", "#define M0").replace(" + ", " ");
    assert_eq!(names(&empty), "X Y");
    let chain: String = (1..20_000).map(|i| format!("#define M{i} M{}\n", i - 1)).collect();
    assert_eq!(names(&format!("#define M0 B\n{chain}M19999")), "B");
    let nested = format!("#if {}A{}\nX\n#else\nY\n#endif", "(".repeat(100_000), ")".repeat(100_000));
    assert_eq!(names(&nested), "A X Y");
    assert_eq!(names(&format!("#if {}A\nX\n#else\nY\n#endif", "!".repeat(100_000))), "A X Y");
}

#[test]
fn includes_are_followed_where_they_are_compiled() {
    let guarded =
        "#ifndef G\n#define G\nX\n#if A == 1\n#include \"b\"\n#else\n#include \"c\"\n#endif\n#endif";
    let files =
        [("main", "#include \"a\"\n#include <a>\nM"), ("a", guarded), ("b", "N\n#define H"), ("c", "B")];
    assert_eq!(names_of(&files), "A G H M N X");
    assert_eq!(names_of(&[("main", "#include \"main\"")]), "all", "includes without end");
    assert_eq!(names("X ## Y"), "all", "names that are pasted together");
}
