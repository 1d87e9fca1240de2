//! Formats tables for terminals, cells of CSV, numbers, and text in HTML.

use std::iter;

/// Formats a table. The first column is left-aligned; the others hold numbers and are right-aligned.
pub fn table<C: Into<String>>(
    header: impl IntoIterator<Item = C>,
    rows: impl IntoIterator<Item = Vec<String>>,
) -> String {
    let header = header.into_iter().map(Into::into).collect();
    let rows: Vec<Vec<String>> = iter::once(header).chain(rows).collect();
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, column: usize| row.get(column).map_or(0, |cell| cell.chars().count());
    let widths: Vec<usize> =
        (0..columns).map(|column| rows.iter().map(|row| cell(row, column)).max().unwrap_or(0)).collect();
    let mut text = String::new();
    for row in &rows {
        let mut line = String::new();
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            line += &if column == 0 { format!("{cell:width$}") } else { format!("  {cell:>width$}") };
        }
        text += line.trim_end();
        text += "\n";
    }
    text
}

/// Formats a hash as 16 hexadecimal digits, because many JSON readers round 64-bit integers.
pub fn hex(hash: u64) -> String {
    format!("{hash:016x}")
}

/// Formats a number with at most `digits` decimals, without trailing zeros.
pub fn decimals(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    if digits == 0 { text } else { text.trim_end_matches('0').trim_end_matches('.').to_owned() }
}

/// Formats a measurement for a table, with `digits` decimals; `-` for `None`.
pub fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".into(), |value| format!("{value:.digits$}"))
}

/// Formats a cell of CSV with all digits; empty for `None`.
pub fn optional(value: Option<impl ToString>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// Quotes a cell of CSV (RFC 4180), with a `'` before a text that begins like a formula.
///
/// Spreadsheets ignore the quotes: a name from a stranger's file would be a formula (OWASP, "CSV Injection").
pub fn quoted(cell: &str) -> String {
    let mark = if cell.starts_with(['=', '+', '-', '@', '\t', '\r']) { "'" } else { "" };
    format!("\"{mark}{}\"", cell.replace('"', "\"\""))
}

/// Escapes text for HTML and SVG.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Formats parameters as `NAME=VALUE,...`.
pub fn parameters(set: &[(String, String)]) -> String {
    set.iter().map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join(",")
}

/// Formats a CSV (RFC 4180). The header and the lines lack their line breaks. `more` are columns to append: a name, and
/// the same cell in each line.
pub fn csv(header: &str, lines: impl IntoIterator<Item = String>, more: &[(&str, String)]) -> String {
    let names: String = more.iter().map(|(name, _)| format!(",{name}")).collect();
    let values: String = more.iter().map(|(_, cell)| format!(",{cell}")).collect();
    let lines = lines.into_iter().map(|line| format!("{line}{values}\n"));
    iter::once(format!("{header}{names}\n")).chain(lines).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stand_to_the_left_and_numbers_to_the_right() {
        let rows = [["é", "10.5"], ["longer", ""]].map(|row| row.map(String::from).to_vec());
        assert_eq!(table(["name", "ms"], rows), "name      ms\né       10.5\nlonger\n");
    }

    #[test]
    fn a_text_that_begins_like_a_formula_stays_a_text() {
        for begin in ["=", "+", "-", "@", "\t", "\r"] {
            assert_eq!(quoted(&format!("{begin}1")), format!("\"'{begin}1\""));
        }
        assert_eq!(quoted("a=1"), "\"a=1\"");
    }

    #[test]
    fn columns_are_added_to_each_line_of_a_csv() {
        let lines = ["\"a \"\"b\nc\",1".to_owned(), "\"d\",2".to_owned()];
        let found = csv("name,ms", lines, &[("device", quoted("x \"y\"")), ("width", "1".into())]);
        let end = ",\"x \"\"y\"\"\",1\n";
        assert_eq!(found, format!("name,ms,device,width\n\"a \"\"b\nc\",1{end}\"d\",2{end}"));
    }

    #[test]
    fn only_zeros_after_the_point_are_dropped() {
        let texts =
            [(1.25, 4), (10.0, 2), (100.0, 0), (0.0, 3), (-0.5, 1)].map(|(v, digits)| decimals(v, digits));
        assert_eq!(texts, ["1.25", "10", "100", "0", "-0.5"]);
    }
}
