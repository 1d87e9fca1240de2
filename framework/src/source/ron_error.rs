use super::{Diagnostic, FileId, Span};

pub fn ron_error(file: FileId, _text: &str, error: &ron::error::SpannedError) -> Diagnostic {
    Diagnostic::new(error.code.to_string(), Span { file, start: 0, end: 0 }, "")
}
