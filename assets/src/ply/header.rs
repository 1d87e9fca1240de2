//! Parses the text header of a PLY file.

use super::tags;
use crate::error::SceneError;
use crate::scalar::Scalar;
use crate::scene::FileNotes;
use crate::size_breakdown::{ElementSize, FieldSize};

/// Maximum number of bytes in a header.
pub(crate) const HEADER_LIMIT: usize = 64 * 1024;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

impl Encoding {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::LittleEndian => "binary_little_endian",
            Self::BigEndian => "binary_big_endian",
        }
    }
}

/// Parses a type by either of its two names; `None` if the name is unknown.
fn parse_scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PropertyType {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

impl PropertyType {
    pub(crate) fn name(self) -> String {
        match self {
            Self::Scalar(s) => s.name().to_owned(),
            Self::List { count, item } => format!("list {} {}", count.name(), item.name()),
        }
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Property {
    pub name: String,
    /// Line of the property's declaration.
    pub line: u32,
    pub kind: PropertyType,
}

/// An element of the file: a table of rows.
#[derive(Clone, Debug)]
pub(crate) struct Element {
    pub name: String,
    pub count: u64,
    /// Line of the element's declaration.
    pub line: u32,
    pub properties: Vec<Property>,
}

impl Element {
    /// Computes the bytes of a binary row; `None` if a list makes row lengths vary.
    pub(crate) fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, p| match p.kind {
            PropertyType::Scalar(s) => Some(sum + s.size()),
            PropertyType::List { .. } => None,
        })
    }

    pub(crate) fn truncated(&self, there: u64) -> SceneError {
        let Self { name, count, line, .. } = self;
        let rows = if name == "vertex" { "splats".into() } else { format!("rows of `element {name}`") };
        SceneError::Invalid(format!(
            "the file is truncated: expected {count} {rows} (line {line}), found {there}"
        ))
    }

    /// Computes the size breakdown of the element. Lists, and words of text files, have no fixed bytes per row.
    ///
    /// `sizes` has the bytes of each property, summed over all rows; `bytes` is the total with separators. `used` gets
    /// the index of a property, and returns true if the reader uses the property.
    pub(crate) fn size(
        &self,
        encoding: Encoding,
        sizes: &[u64],
        bytes: u64,
        used: impl Fn(usize) -> bool,
    ) -> ElementSize {
        let columns = self.properties.iter().zip(sizes).enumerate();
        let field = |(column, (property, bytes)): (usize, (&Property, &u64))| FieldSize {
            name: property.name.clone(),
            kind: property.kind.name(),
            bytes_per_row: match property.kind {
                PropertyType::Scalar(scalar) if encoding != Encoding::Ascii => Some(scalar.size() as u64),
                _ => None,
            },
            bytes: *bytes,
            used: used(column),
        };
        ElementSize {
            name: self.name.clone(),
            rows: self.count,
            bytes,
            fields: columns.map(field).collect(),
            separator_bytes: bytes - sizes.iter().sum::<u64>(),
        }
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Bytes before the first row.
    pub bytes: usize,
    /// Number of lines before the first row.
    pub lines: u32,
    /// Drawing rules, read from the tags in the header's `comment` lines.
    pub notes: FileNotes,
    /// The lines `comment` and `obj_info` that are no tags.
    pub comments: Vec<String>,
}

impl Header {
    /// Returns the comments that files of the scene get; empty if they take more than half of a header.
    pub(super) fn kept_comments(&self) -> Vec<String> {
        let bytes: usize = self.comments.iter().map(|line| line.len() + 1).sum();
        if bytes > HEADER_LIMIT / 2 { Vec::new() } else { self.comments.clone() }
    }

    /// Returns the texts of [`Header::comments`].
    pub(super) fn comment_texts(&self) -> Vec<String> {
        self.comments.iter().filter_map(|line| Some(line.split_once(' ')?.1.to_owned())).collect()
    }

    pub(crate) fn vertex(&self) -> Result<&Element, SceneError> {
        self.elements.iter().find(|e| e.name == "vertex").ok_or_else(|| {
            let found = self.elements.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
            let found = if found.is_empty() { found } else { format!("; it has {found}") };
            SceneError::Invalid(format!("the header has no `element vertex`, which holds the splats{found}"))
        })
    }

    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, SceneError> {
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let (mut notes, mut comments) = (FileNotes::default(), Vec::new());
        let mut at = 0;
        let mut number = 0;
        loop {
            let rest = &bytes[at..bytes.len().min(HEADER_LIMIT)];
            let Some(end) = rest.iter().position(|&b| b == b'\n') else {
                return Err(SceneError::Invalid(match bytes.len() > HEADER_LIMIT {
                    true => {
                        format!(
                            "the header is too long: no `end_header` line in the first {HEADER_LIMIT} bytes"
                        )
                    }
                    false => {
                        format!(
                            "the header has no `end_header` line: the file ends inside it, after line {number}"
                        )
                    }
                }));
            };
            number += 1;
            at += end + 1;
            let text = String::from_utf8_lossy(&rest[..end]);
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            let fail = |message: String| wrong_line(number, &message);
            match words.as_slice() {
                [] | ["comment" | "obj_info"] => {}
                ["comment", comment @ ..] if tags::read(comment, &mut notes)? => {}
                ["comment" | "obj_info", ..] => comments.push(words.join(" ")),
                ["ply"] if number == 1 => {}
                ["format", name, version] => {
                    if encoding.is_some() {
                        return Err(fail("a second `format` line".into()));
                    }
                    let mut all = [Encoding::Ascii, Encoding::LittleEndian, Encoding::BigEndian].into_iter();
                    let unknown = || {
                        fail(format!(
                            "expected the format ascii, binary_little_endian or binary_big_endian, found `{name}`"
                        ))
                    };
                    encoding = Some(all.find(|known| known.name() == *name).ok_or_else(unknown)?);
                    if *version != "1.0" {
                        return Err(fail(format!("expected PLY version 1.0, found `{version}`")));
                    }
                }
                ["element", name, count] => {
                    if elements.iter().any(|e| e.name == *name) {
                        return Err(fail(format!("a second `element {name}`")));
                    }
                    let count = count
                        .parse()
                        .map_err(|_| fail(format!("expected the number of rows, found `{count}`")))?;
                    elements.push(Element {
                        name: (*name).into(),
                        count,
                        line: number,
                        properties: Vec::new(),
                    });
                }
                ["property", rest @ ..] => {
                    let property = property(rest, number).map_err(fail)?;
                    let element = elements
                        .last_mut()
                        .ok_or_else(|| fail("a `property` before the first `element`".into()))?;
                    if element.properties.iter().any(|p| p.name == property.name) {
                        return Err(fail(format!("a second property `{}`", property.name)));
                    }
                    element.properties.push(property);
                }
                ["end_header"] => {
                    let encoding = encoding.ok_or_else(|| fail("no `format` line before the end".into()))?;
                    return Ok(Self { encoding, elements, bytes: at, lines: number, notes, comments });
                }
                _ => {
                    let shown: String = text.trim_end().chars().take(60).collect();
                    return Err(fail(format!(
                        "expected format, element, property, comment, obj_info or end_header, found `{}`",
                        shown.escape_default()
                    )));
                }
            }
        }
    }
}

/// Creates the error for a line of the header, counted from 1.
pub(super) fn wrong_line(line: u32, message: &str) -> SceneError {
    SceneError::Invalid(format!("line {line} of the header: {message}"))
}

fn property(words: &[&str], line: u32) -> Result<Property, String> {
    let scalar = |name: &str| {
        parse_scalar(name).ok_or_else(|| {
            format!(
                "expected a type (char, uchar, short, ushort, int, uint, float or double), found `{name}`"
            )
        })
    };
    match words {
        ["list", count, item, name] => {
            let count = scalar(count)?;
            if matches!(count, Scalar::F32 | Scalar::F64) {
                return Err(format!(
                    "expected an integer type for a list's length, found `{}`",
                    count.name()
                ));
            }
            let kind = PropertyType::List { count, item: scalar(item)? };
            Ok(Property { name: (*name).into(), line, kind })
        }
        [kind, name] => {
            let kind = PropertyType::Scalar(scalar(kind)?);
            Ok(Property { name: (*name).into(), line, kind })
        }
        _ => Err("expected `property TYPE NAME` or `property list TYPE TYPE NAME`".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::says;

    fn error(text: &str) -> String {
        Header::parse(text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn a_header_with_windows_line_ends_and_comments_is_read() {
        let text = "ply\r\nformat binary_big_endian 1.0\r\ncomment made by hand\r\nobj_info x\r\nelement vertex 7\r\n\
                    property float32 x\r\nelement face 2\r\nproperty list uchar int vertex_indices\r\nend_header\r\n\x01";
        let header = Header::parse(text.as_bytes()).unwrap();
        assert_eq!(header.encoding, Encoding::BigEndian);
        assert_eq!(header.bytes, text.len() - 1);
        assert_eq!(
            (header.lines, header.comments),
            (9, vec!["comment made by hand".to_owned(), "obj_info x".to_owned()])
        );
        assert_eq!((header.elements[0].count, header.elements[0].stride()), (7, Some(4)));
        assert_eq!((header.elements[1].line, header.elements[1].stride()), (7, None));
    }

    #[test]
    fn errors_name_the_line_and_what_was_expected() {
        for (text, expected) in [
            ("format binary 1.0\nend_header\n", "line 2"),
            ("format ascii 2.0\n", "version 1.0, found `2.0`"),
            ("format ascii 1.0\nelement vertex many\n", "line 3 of the header"),
            ("format ascii 1.0\nproperty float x\n", "before the first `element`"),
            ("format ascii 1.0\nelement v 1\nproperty half x\n", "found `half`"),
            ("format ascii 1.0\nelement v 1\nproperty list float int x\n", "integer type"),
            ("format ascii 1.0\nelement v 1\nelement v 1\n", "a second `element v`"),
            ("end_header\n", "no `format`"),
            ("format ascii 1.0\nelemnt vertex 1\n", "found `elemnt vertex 1`"),
            ("format ascii 1.0\nelement vertex -1\n", "found `-1`"),
        ] {
            let found = error(&format!("ply\n{text}"));
            assert!(found.contains(expected), "{found}; expected {expected}");
        }
    }

    #[test]
    fn a_header_that_never_ends_is_told_from_one_that_was_cut() {
        says(error("ply\nformat ascii 1.0\n"), "ends inside it, after line 2");
        let long = format!("ply\nformat ascii 1.0\n{}", "comment a\n".repeat(HEADER_LIMIT / 10 + 1));
        says(error(&long), "too long");
    }
}
