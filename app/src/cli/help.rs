//! Formats lists and ranges for the help text.

use splatgraph_framework::ir::Domain;

pub fn domain(domain: &Domain) -> String {
    match domain {
        Domain::Bool => "true|false".into(),
        Domain::Int { min, max } => format!("{min}..{max}"),
        Domain::Float { min, max, .. } => format!("{min:?}..{max:?}"),
        Domain::Choice(choices) => choices.join("|"),
    }
}

/// Formats a list of names and descriptions in two columns, for the help text.
pub fn two_columns(rows: Vec<(String, String)>) -> String {
    /// Maximum width of a line, in characters. Only a longer word exceeds it.
    const COLUMNS: usize = 98;
    let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let mut lines: Vec<String> = Vec::new();
    for (name, about) in &rows {
        let mut line = format!("  {name:width$} ");
        for word in about.split(' ') {
            if line.chars().count() + 1 + word.chars().count() > COLUMNS && !line.trim().is_empty() {
                lines.push(line);
                line = " ".repeat(width + 3);
            }
            line = line + " " + word;
        }
        lines.push(line);
    }
    lines.iter().map(|line| line.trim_end()).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_broken_into_lines_that_stay_in_their_column() {
        let long = ["word"; 30].join(" ");
        let text = two_columns(vec![("a".into(), "short".into()), ("name".into(), long)]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "  a     short");
        assert!(lines[1].starts_with("  name  word word") && lines[1].len() <= 98);
        assert!(lines[2].starts_with("        word"));
        assert_eq!(lines.len(), 3);
    }
}
