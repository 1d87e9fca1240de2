//! Names the parts of a scene that was joined from a list of scenes.

use std::ops::Range;
use std::path::PathBuf;

/// A scene of a list of scenes: its file, and its splats in the joined scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScenePart {
    /// Path of the scene's file.
    pub file: PathBuf,
    /// Indices of the scene's splats.
    pub splats: Range<u32>,
}

impl ScenePart {
    /// Lists the parts of `count` splats, given as files with their numbers of splats. Empty if the numbers do not sum
    /// to `count`.
    pub(super) fn of_files(files: Vec<(PathBuf, u32)>, count: u32) -> Vec<Self> {
        let mut end = 0;
        let part = |(file, count): (PathBuf, u32)| {
            let first = end;
            end += count;
            Self { file, splats: first..end }
        };
        let parts = files.into_iter().map(part).collect();
        if end == count { parts } else { Vec::new() }
    }
}
