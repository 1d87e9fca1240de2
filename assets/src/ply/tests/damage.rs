//! Reads PLY files that are cut off, or whose headers and rows do not fit.

use super::{Made, PLAIN, edited, error};
use crate::testing::{parse, says};

#[test]
fn a_truncated_file_says_how_many_splats_are_there() {
    for format in ["binary_little_endian", "binary_big_endian", "ascii"] {
        let bytes = Made { format, ..PLAIN }.bytes();
        says(error(&bytes[..bytes.len() - 5]), "expected 20 splats (line 5), found 19");
    }
    let made = Made { faces: true, ..PLAIN };
    let bytes = made.bytes();
    let said = error(&bytes[..bytes.len() - 20]);
    assert!(said.contains("expected 2 rows of `element after`") && said.ends_with("found 0"), "{said}");
    says(error(b""), "empty");
    says(error(&bytes[..30]), "ends inside it, after line 1");
}

#[test]
fn counts_that_cannot_be_true_are_refused_before_anything_is_allocated() {
    let said = error(&edited(&PLAIN, "vertex 20", "vertex 18446744073709551615"));
    assert!(
        said.contains("header is damaged") && said.contains("declares 18446744073709551615 rows"),
        "{said}"
    );
    says(
        error(&edited(&PLAIN, "vertex 20", "vertex 0")),
        "expected at least one splat, found `element vertex 0` (line 5)",
    );
    let ascii = Made { format: "ascii", degree: 0, ..PLAIN };
    says(error(&edited(&ascii, "vertex 20", "vertex 1500")), "expected 1500 splats (line 5), found 20");
}

#[test]
fn missing_properties_are_named_with_the_nearest_that_is_there() {
    says(
        error(&edited(&PLAIN, "float opacity", "float opacty")),
        "(line 5) has no property `opacity`; the nearest name there is `opacty`",
    );
    says(error(&edited(&PLAIN, "f_rest_3\n", "f_rest_33\n")), "no property `f_rest_3`");
    let said = error(&edited(&PLAIN, "property float f_rest_8\n", ""));
    assert!(
        said.contains("expected 0, 9, 24, 45 or 72 properties `f_rest_*`") && said.ends_with("found 8"),
        "{said}"
    );
    let cloud = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n";
    says(error(cloud), "may be a point cloud or a mesh");
    let said = error(&edited(&PLAIN, "float scale_0", "float log_scale_0"));
    assert!(!said.contains("point cloud"), "{said}");
    says(
        error(b"ply\nformat ascii 1.0\nelement face 1\nproperty float x\nend_header\n0\n"),
        "no `element vertex`, which holds the splats; it has face",
    );
    let said = error(&edited(&PLAIN, "property float nx", "property list uchar float nx"));
    assert!(said.starts_with("line 9 of the header: `nx` is a list"), "{said}");
}

#[test]
fn rows_of_text_that_do_not_parse_are_named_by_line() {
    let made = Made { format: "ascii", degree: 0, ..PLAIN };
    let text = String::from_utf8(made.bytes()).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let first = lines.iter().position(|l| *l == "end_header").unwrap() + 1;
    let replaced = |row: String| {
        let mut lines = lines.clone();
        lines[first + 4] = &row;
        error(lines.join("\n").as_bytes())
    };
    let row = lines[first + 4].trim_end();
    let number = format!("line {}: ", first + 5);
    let said = replaced(row.replacen(' ', " 1.2.3 ", 1));
    assert!(said.starts_with(&number) && said.contains("expected a number for `y`, found `1.2.3`"), "{said}");
    let said = replaced(format!("{row} 5"));
    assert!(said.starts_with(&number) && said.contains("expected 17 values, found 18"), "{said}");
    let said = replaced(row.rsplit_once(' ').unwrap().0.into());
    assert!(said.starts_with(&number) && said.contains("expected 17 values, found 16"), "{said}");
    // Blank lines are skipped.
    let spaced = text.replacen("end_header\n", "end_header\n\n", 1);
    assert_eq!(parse(spaced.as_bytes()).unwrap().count(), 20);
}
