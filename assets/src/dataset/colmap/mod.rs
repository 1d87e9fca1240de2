//! Reads COLMAP's sparse models: `cameras` and `images`, as text or binary.
//!
//! `cameras` has the lenses, `images` the poses. A pose is a quaternion w, x, y, z and a translation; they transform
//! world coordinates to camera coordinates (x right, y down, z forward). Points are not read. Format:
//! <https://colmap.github.io/format.html>.

mod binary;
mod lens;
pub(super) mod text;

pub(super) use lens::{IDEAL, UNDISTORT};

use super::error::CameraError;
use super::view::Dataset;
use std::path::Path;

pub(super) fn is_folder(folder: &Path) -> bool {
    ["bin", "txt"].into_iter().any(|form| has(folder, form))
}

fn has(folder: &Path, form: &str) -> bool {
    ["cameras", "images"].into_iter().all(|name| folder.join(format!("{name}.{form}")).exists())
}

pub(super) fn load(folder: &Path, ignore_distortion: bool) -> Result<Dataset, CameraError> {
    let form = if has(folder, "bin") { "bin" } else { "txt" };
    let [cameras, images] = ["cameras", "images"].map(|name| folder.join(format!("{name}.{form}")));
    let mut dataset = Dataset { files: vec![cameras.clone(), images.clone()], ..Dataset::default() };
    if form == "bin" {
        let lenses = binary::lenses(&cameras, ignore_distortion)?;
        binary::images(&images, &lenses, &mut dataset)?;
    } else {
        let lenses = text::lenses(&cameras, ignore_distortion)?;
        text::images(&images, &lenses, &mut dataset)?;
    }
    if dataset.views.is_empty() {
        return Err(CameraError::Empty { path: images });
    }
    Ok(dataset)
}
