//! Where every byte of a scene file goes.
//!
//! A splat of degree 3 has 62 floats, 45 of them colour that changes with the view; the breakdown makes that plain. Its
//! numbers add up to the file's size exactly.

use crate::ply::header::Element;
use crate::ply::write;
use serde::Serialize;
use std::fmt;

/// The bytes of a file, accounted for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SizeBreakdown {
    /// The file's format, for instance `ply, binary_little_endian`.
    pub format: String,
    /// The whole file.
    pub file_bytes: u64,
    /// From the start to the first row.
    pub header_bytes: u64,
    /// The tables, in the file's order.
    pub elements: Vec<ElementSize>,
    /// After the last row.
    pub trailing_bytes: u64,
}

/// One table of rows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ElementSize {
    /// Its name; `vertex` holds the splats.
    pub name: String,
    /// Rows.
    pub rows: u64,
    /// All of its rows.
    pub bytes: u64,
    /// Its columns, in the file's order.
    pub fields: Vec<FieldSize>,
    /// Blanks and line ends of an ASCII file.
    pub separator_bytes: u64,
}

/// One column.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FieldSize {
    /// The property's name.
    pub name: String,
    /// Its type, as PLY names it.
    pub kind: String,
    /// Bytes in each row; `None` where rows differ.
    pub bytes_per_row: Option<u64>,
    /// Bytes in all rows.
    pub bytes: u64,
    /// Whether it becomes part of a splat.
    pub used: bool,
}

impl SizeBreakdown {
    /// The breakdown of a file that [`crate::Scene::write_ply`] writes.
    pub(crate) fn reference(count: u64, degree: u32) -> Self {
        let fields: Vec<FieldSize> = write::property_names(degree)
            .into_iter()
            .map(|name| FieldSize {
                used: !name.starts_with('n'),
                name,
                kind: "float".into(),
                bytes_per_row: Some(4),
                bytes: 4 * count,
            })
            .collect();
        let header_bytes = write::header(count, degree).len() as u64;
        let bytes = 4 * count * fields.len() as u64;
        Self {
            format: "ply, binary_little_endian".into(),
            file_bytes: header_bytes + bytes,
            header_bytes,
            elements: vec![ElementSize {
                name: "vertex".into(),
                rows: count,
                bytes,
                fields,
                separator_bytes: 0,
            }],
            trailing_bytes: 0,
        }
    }

    /// Header, elements and trailing bytes added up: the file's size.
    pub fn sum(&self) -> u64 {
        self.header_bytes + self.elements.iter().map(ElementSize::sum).sum::<u64>() + self.trailing_bytes
    }
}

impl ElementSize {
    /// `sizes`: bytes of each property in all rows; `bytes`: all rows, with what separates the values.
    pub(crate) fn new(element: &Element, used: impl Fn(usize) -> bool, sizes: &[u64], bytes: u64) -> Self {
        let fields: Vec<FieldSize> = element
            .properties
            .iter()
            .zip(sizes)
            .enumerate()
            .map(|(column, (property, bytes))| {
                let per_row = bytes.checked_div(element.count);
                FieldSize {
                    name: property.name.clone(),
                    kind: property.kind.name(),
                    bytes_per_row: per_row.filter(|size| size * element.count == *bytes),
                    bytes: *bytes,
                    used: used(column),
                }
            })
            .collect();
        let separator_bytes = bytes - sizes.iter().sum::<u64>();
        Self { name: element.name.clone(), rows: element.count, bytes, fields, separator_bytes }
    }

    /// Fields and separators added up: [`ElementSize::bytes`].
    pub fn sum(&self) -> u64 {
        self.fields.iter().map(|f| f.bytes).sum::<u64>() + self.separator_bytes
    }
}

/// A number with thousands separated by commas.
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

/// Consecutive fields alike but for the number at their names' ends.
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
    /// A table: one line per field or run of numbered fields, with bytes per row and in all.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line =
            |f: &mut fmt::Formatter<'_>, what: &str, kind: &str, each: &str, bytes: u64, note: &str| {
                let text = format!("  {what:<26}{kind:<12}{each:>14}{:>18}  {note}", grouped(bytes));
                writeln!(f, "{}", text.trim_end())
            };
        writeln!(f, "{}, {} bytes", self.format, grouped(self.file_bytes))?;
        line(f, "header", "", "", self.header_bytes, "")?;
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
    fn a_reference_file_of_degree_3_has_248_bytes_per_splat() {
        let size = SizeBreakdown::reference(1000, 3);
        assert_eq!(size.elements[0].bytes, 248_000);
        assert_eq!(size.sum(), size.file_bytes);
        let text = size.to_string();
        assert!(text.contains("f_rest_0..44"), "{text}");
        assert!(text.contains("45 x 4"), "{text}");
        assert!(text.lines().any(|l| l.contains(" nx ") && l.ends_with("skipped")), "{text}");
    }

    #[test]
    fn thousands_are_grouped() {
        assert_eq!(
            (grouped(0), grouped(999), grouped(1_234_567)),
            ("0".into(), "999".into(), "1,234,567".into())
        );
    }
}
