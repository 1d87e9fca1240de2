//! Defines positions in graph files.

use std::ops::Range;

use serde::{Deserialize, Serialize};

/// An index into the files of a [`SourceMap`](crate::source::SourceMap).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FileId(pub u32);

/// A byte range of a file, `start..end`. The default is the start of the first file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span {
    /// The file that contains the range.
    pub file: FileId,
    /// Byte offset of the first byte.
    pub start: usize,
    /// Byte offset just past the last byte.
    pub end: usize,
}

impl Span {
    /// Creates the span of a byte range of a file.
    pub fn new(file: FileId, bytes: Range<usize>) -> Span {
        Span { file, start: bytes.start, end: bytes.end }
    }
}

/// The position of a declaration in a graph file, for error messages and dumps.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Origin {
    /// Path of the file, as in messages.
    pub file: String,
    /// Line, counted from 1.
    pub line: u32,
    /// Column in characters, counted from 1.
    pub column: u32,
}
