//! Names the parts of a scene that was joined from a list of scenes.

use super::Scene;
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

impl Scene {
    /// Lists the parts of a scene that was loaded from a list of scenes, in the order of the list.
    ///
    /// Empty for other scenes, and if splats were dropped in the join. Scenes derived from this one have no parts.
    pub fn parts(&self) -> &[ScenePart] {
        &self.parts
    }

    /// Sets the parts, given as files with their numbers of splats. If splats were dropped in the join, there are no
    /// parts.
    pub(crate) fn with_parts(mut self, files: Vec<(PathBuf, u32)>) -> Self {
        let mut end = 0;
        let part = |(file, count): (PathBuf, u32)| {
            let first = end;
            end += count;
            ScenePart { file, splats: first..end }
        };
        let parts = files.into_iter().map(part).collect();
        if end == self.count() {
            self.parts = parts;
        }
        self
    }
}
