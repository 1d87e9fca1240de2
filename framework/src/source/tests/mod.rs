mod diagnostic;
mod files;
mod outline;
mod ron_error;

use super::*;
use crate::ir::FileId;

fn one_file(path: &str, text: &str) -> (SourceMap, FileId) {
    let mut files = SourceMap::default();
    let file = files.add(path, text);
    (files, file)
}
