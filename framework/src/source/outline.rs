use std::ops::Range;
use std::sync::Arc;

use super::{Diagnostic, FileId, Span};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Path(Arc<[Step]>);

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Step {
    Name(Arc<str>),
    Index(usize),
}

impl Path {
    pub fn root() -> Self {
        Path(Arc::new([]))
    }
    pub fn field(&self, name: &str) -> Self {
        self.then(Step::Name(name.into()))
    }
    pub fn key(&self, name: &str) -> Self {
        self.field(name)
    }
    pub fn index(&self, index: usize) -> Self {
        self.then(Step::Index(index))
    }
    fn then(&self, step: Step) -> Self {
        Path(self.0.iter().cloned().chain([step]).collect())
    }
}

#[derive(Clone, Debug)]
pub struct Outline {
    file: FileId,
}

impl Outline {
    pub fn parse(file: FileId, _text: &str) -> Result<Outline, Diagnostic> {
        Ok(Outline { file })
    }
    pub fn value(&self, _path: &Path) -> Span {
        Span { file: self.file, start: 0, end: 0 }
    }
    pub fn key(&self, path: &Path) -> Span {
        self.value(path)
    }
    /// The name in front of a struct's or a variant's `(`.
    pub fn head(&self, path: &Path) -> Span {
        self.value(path)
    }
    pub fn string_offset(&self, _path: &Path, offset_in_value: usize) -> usize {
        offset_in_value
    }
    /// The place of a range of bytes of the (unescaped) string at `path`.
    pub fn within_string(&self, path: &Path, range: Range<usize>) -> Span {
        let at = |offset| self.string_offset(path, offset);
        Span { file: self.file, start: at(range.start), end: at(range.end) }
    }
    /// Every name that a struct or a map gives twice.
    pub fn duplicates(&self) -> Vec<Diagnostic> {
        Vec::new()
    }
}
