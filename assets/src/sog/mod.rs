//! Reads and writes PlayCanvas's SOG: lossless WebP textures with one texel per splat, and a `meta.json`.
//!
//! The files are in a ZIP archive or in a folder. The table describes version 2, which is also written. Version 1
//! stores the ends of ranges in place of codebooks, and opacities as logits. [`levels`] reads a level of a streamed
//! scene.
//!
//! | texture | value of the splat's texel |
//! |---|---|
//! | `means` (two) | low and high bytes of 16 bits per axis, between `mins` and `maxs`, of `sign(v) ln(1 + abs(v))` |
//! | `scales` | per axis an index into the `codebook` of logarithms |
//! | `quats` | red, green, blue: the three smaller components; alpha - 252: the index of the largest of w, x, y, z |
//! | `sh0` | red, green, blue: indices into the `codebook` of band 0; alpha: opacity `u / 255` |
//! | `shN` (two) | red, green: 16-bit label of a palette entry; its coefficients are indices into the `codebook` |
//!
//! A component of a quaternion is `(u / 255 * 2 - 1) / sqrt(2)`. Texel `i` is at column `i % width` and row
//! `i / width`. The palette has 64 entries per row, and a texel per coefficient. Format:
//! <https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/>.

mod codebook;
mod container;
mod levels;
mod meta;
mod palette;
mod read;
#[cfg(test)]
mod tests;
mod write;

use crate::error::SceneError;
use crate::input::{HEAD, Input, SceneHeader, Source};
use crate::scene::Scene;
use std::path::Path;

pub(crate) use container::MAGIC;
pub(crate) use write::{position_steps, write};

/// Returns true if a text looks like a `meta.json` or a `lod-meta.json`.
pub(crate) fn begins_as_json(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    text.trim_start().starts_with('{') && text.contains("\"means\"") || levels::begins_as_levels(head)
}

/// Reads the header of a scene. `level` selects a level of a streamed scene; `None` is the finest. Fails if a level of
/// a scene that is not streamed is selected.
pub(crate) fn header(
    source: &Source,
    path: Option<&Path>,
    level: Option<u32>,
) -> Result<SceneHeader, SceneError> {
    let folder = path.and_then(Path::parent);
    match (levels::begins_as_levels(&source.head(HEAD)?), level) {
        (true, level) => levels::header(source, folder, level),
        (false, None) => read::header(source, folder),
        (false, Some(_)) => Err(SceneError::NoLevels),
    }
}

pub(crate) fn parse(input: &Input, path: Option<&Path>, level: Option<u32>) -> Result<Scene, SceneError> {
    let folder = path.and_then(Path::parent);
    match (levels::begins_as_levels(&input.source.head(HEAD)?), level) {
        (true, level) => levels::parse(input, folder, level),
        (false, None) => read::parse(input, folder, None),
        (false, Some(_)) => Err(SceneError::NoLevels),
    }
}
