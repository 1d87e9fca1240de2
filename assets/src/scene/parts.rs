//! Defines the parts of a scene that was joined from a list: the file and the splats of each.

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
