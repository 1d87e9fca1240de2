use std::collections::BTreeMap;
use std::fmt;

use crate::plan;

/// A file of a [`SourceMap`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FileId(pub u32);

/// A range of bytes in a file, `start..end`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span {
    pub file: FileId,
    pub start: usize,
    pub end: usize,
}

/// What a file is looked for as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A graph or a preset, kept in `pipelines`.
    Graph,
    /// A shader or what a shader includes, kept in `shaders`.
    Shader,
}

/// Where files come from.
#[derive(Clone, Debug, Default)]
pub struct Library {
    /// Path and text of the files built into the binary: `pipelines/splat.ron`, `shaders/sort/scatter.comp`.
    pub builtin: &'static [(&'static str, &'static str)],
    /// Path and text of files that exist only in memory; they come before those on disk.
    pub memory: BTreeMap<String, String>,
}

/// See the module's documentation.
#[derive(Debug, Default)]
pub struct SourceMap {
    library: Library,
    files: Vec<(String, String)>,
}

/// No file of this name, or one that is no text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotFound {
    pub name: String,
    /// Everywhere it was looked for, in order.
    pub tried: Vec<String>,
    /// The name that was probably meant.
    pub nearest: Option<String>,
    /// Where a file of that name exists and cannot be used: why.
    pub why: Option<String>,
}

impl fmt::Display for NotFound {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}", self.name)
    }
}
impl std::error::Error for NotFound {}

impl SourceMap {
    pub fn new(library: Library) -> Self {
        SourceMap { library, files: Vec::new() }
    }
    pub fn add(&mut self, path: impl Into<String>, text: impl Into<String>) -> FileId {
        self.files.push((path.into(), text.into()));
        FileId(self.files.len() as u32 - 1)
    }
    pub fn find(&mut self, _from: Option<FileId>, name: &str, _kind: Kind) -> Result<FileId, NotFound> {
        let _ = &self.library;
        Err(NotFound { name: name.into(), tried: Vec::new(), nearest: None, why: None })
    }
    pub fn path(&self, file: FileId) -> &str {
        &self.files[file.0 as usize].0
    }
    pub fn text(&self, file: FileId) -> &str {
        &self.files[file.0 as usize].1
    }
    pub fn line_column(&self, _span: Span) -> (u32, u32) {
        (1, 1)
    }
    pub fn origin(&self, span: Span) -> plan::Origin {
        let (line, column) = self.line_column(span);
        plan::Origin { file: self.path(span.file).to_string(), line, column }
    }
    pub fn opened(&self) -> impl Iterator<Item = (FileId, &str, bool)> {
        self.files.iter().enumerate().map(|(i, f)| (FileId(i as u32), f.0.as_str(), false))
    }
}
