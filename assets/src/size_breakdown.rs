//! Accounts for every byte of a scene file: header, fields, separators and trailing bytes sum to the file's size.

use serde::Serialize;
use std::fmt;

/// The bytes of a file, by use.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SizeBreakdown {
    /// The file's format, for instance `ply, binary_little_endian`.
    pub format: String,
    /// Bytes of the whole file, or of all files of a scene with several.
    pub file_bytes: u64,
    /// Bytes of the header and of other descriptions; in PLY, the bytes before the first row.
    pub header_bytes: u64,
    /// The elements, in the file's order.
    pub elements: Vec<ElementSize>,
    /// All other bytes; in PLY, the bytes after the last row.
    pub trailing_bytes: u64,
    /// Comments of a PLY, and the copyright of a glTF. Tags are not among them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub comments: Vec<String>,
    /// True for a scene that was loaded from one SOG.
    #[serde(skip)]
    pub(crate) is_whole_sog: bool,
}

/// The bytes of one element, a table of rows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ElementSize {
    /// The element's name; in PLY, `vertex` has the splats.
    pub name: String,
    /// Number of rows.
    pub rows: u64,
    /// Bytes of all rows.
    pub bytes: u64,
    /// The fields, in the file's order.
    pub fields: Vec<FieldSize>,
    /// Bytes of blanks and line ends in an ASCII file.
    pub separator_bytes: u64,
}

/// The bytes of one field, a column of an element.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FieldSize {
    /// Name of the field; in PLY, of the property.
    pub name: String,
    /// Type of the field: scalar or list, or a word such as `row`, `array` or `file` for data without columns.
    pub kind: String,
    /// Bytes in each row; `None` if rows vary or are compressed together.
    pub bytes_per_row: Option<u64>,
    /// Bytes in all rows.
    pub bytes: u64,
    /// True if the reader uses the field.
    pub used: bool,
}

impl SizeBreakdown {
    /// Creates the breakdown of a file. Bytes that belong to neither header nor elements count as trailing.
    pub(crate) fn new(
        format: String,
        file_bytes: u64,
        header_bytes: u64,
        elements: Vec<ElementSize>,
    ) -> Self {
        let trailing_bytes =
            file_bytes - header_bytes - elements.iter().map(|element| element.bytes).sum::<u64>();
        Self { format, file_bytes, header_bytes, elements, trailing_bytes, ..Self::default() }
    }

    pub(crate) fn with_comments(self, comments: Vec<String>) -> Self {
        Self { comments, ..self }
    }

    /// Sums header, elements and trailing bytes, which gives the file's size.
    pub fn sum(&self) -> u64 {
        self.header_bytes + self.elements.iter().map(ElementSize::sum).sum::<u64>() + self.trailing_bytes
    }
}

impl ElementSize {
    /// Creates an element without separators.
    pub(crate) fn new(name: &str, rows: u64, fields: Vec<FieldSize>) -> Self {
        let bytes = fields.iter().map(|field| field.bytes).sum();
        Self { name: name.into(), rows, bytes, fields, separator_bytes: 0 }
    }

    /// Sums fields and separators, which gives [`ElementSize::bytes`].
    pub fn sum(&self) -> u64 {
        self.fields.iter().map(|f| f.bytes).sum::<u64>() + self.separator_bytes
    }
}

impl FieldSize {
    /// Creates a field that the reader uses, of `size` bytes in each of `rows` rows.
    pub(crate) fn column(name: impl Into<String>, kind: &str, size: u64, rows: u64) -> Self {
        Self { bytes_per_row: Some(size), ..Self::whole(name, kind, size * rows) }
    }

    /// Creates a field that the reader uses, without columns.
    pub(crate) fn whole(name: impl Into<String>, kind: &str, bytes: u64) -> Self {
        Self { name: name.into(), kind: kind.into(), bytes_per_row: None, bytes, used: true }
    }
}

/// Formats a number with thousands separators.
pub fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// Formats a number for text: with three decimals, or with an exponent. The exponent is used for absolute values below
/// 0.001, except 0, and from 10 million on.
pub fn rounded(value: f64) -> String {
    if value == 0.0 || (1e-3..1e7).contains(&value.abs()) {
        format!("{value:.3}")
    } else {
        format!("{value:.3e}")
    }
}

/// Groups consecutive fields that differ only in the number at the end of their names.
fn runs(fields: &[FieldSize]) -> Vec<&[FieldSize]> {
    let stem = |f: &FieldSize| f.name.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned();
    fields
        .chunk_by(|a, b| {
            let numbered = stem(a).len() < a.name.len() && stem(a) == stem(b);
            numbered && (&a.kind, a.bytes_per_row, a.used) == (&b.kind, b.bytes_per_row, b.used)
        })
        .collect()
}

impl fmt::Display for SizeBreakdown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line =
            |f: &mut fmt::Formatter<'_>, what: &str, kind: &str, each: &str, bytes: u64, note: &str| {
                let text = format!("  {what:<26}{kind:<12}{each:>14}{:>18}  {note}", grouped(bytes));
                writeln!(f, "{}", text.trim_end())
            };
        writeln!(f, "{}, {} bytes", self.format, grouped(self.file_bytes))?;
        line(f, "header", "", "", self.header_bytes, "")?;
        for comment in &self.comments {
            writeln!(f, "    {comment}")?;
        }
        for element in &self.elements {
            writeln!(f, "  {}: {} rows", element.name, grouped(element.rows))?;
            for run in runs(&element.fields) {
                let (first, last) = (&run[0], &run[run.len() - 1]);
                let what = if run.len() == 1 {
                    format!("  {}", first.name)
                } else {
                    let number = last.name.trim_start_matches(|c: char| !c.is_ascii_digit());
                    format!("  {}..{}", first.name, number.rsplit('_').next().unwrap_or(number))
                };
                let each = match first.bytes_per_row {
                    Some(size) if run.len() > 1 => format!("{} x {size}", run.len()),
                    Some(size) => size.to_string(),
                    None => "varies".into(),
                };
                let bytes = run.iter().map(|field| field.bytes).sum();
                line(f, &what, &first.kind, &each, bytes, if first.used { "" } else { "skipped" })?;
            }
            if element.separator_bytes > 0 {
                line(f, "  blanks and line ends", "", "", element.separator_bytes, "")?;
            }
        }
        if self.trailing_bytes > 0 {
            line(f, "after the last row", "", "", self.trailing_bytes, "skipped")?;
        }
        line(f, "sum", "", "", self.sum(), "")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_grouped() {
        assert_eq!(
            (grouped(0), grouped(999), grouped(1_234_567)),
            ("0".into(), "999".into(), "1,234,567".into())
        );
    }
}
