//! Reads COLMAP's sparse models: `cameras` and `images`, as text or binary.
//!
//! `cameras` has the lenses, `images` the poses. A pose is a quaternion w, x, y, z and a translation; they transform
//! world coordinates to camera coordinates (x right, y down, z forward). Points are not read. Format:
//! <https://colmap.github.io/format.html>.

mod binary;
mod lens;
pub(super) mod text;

pub(super) use lens::{IDEAL, UNDISTORT, distorted_parameters};

use super::error::CameraError;
use super::view::Dataset;
use std::path::{Path, PathBuf};

pub(super) fn is_folder(folder: &Path) -> bool {
    ["bin", "txt"].into_iter().any(|form| has(folder, form))
}

fn has(folder: &Path, form: &str) -> bool {
    ["cameras", "images"].into_iter().all(|name| folder.join(format!("{name}.{form}")).exists())
}

/// Returns true for the name of a file of a model: `cameras` or `images`, as text or binary.
pub(super) fn has_name_of_model(path: &Path) -> bool {
    let has_extension = path.extension().is_some_and(|extension| extension == "txt" || extension == "bin");
    has_extension && path.file_stem().is_some_and(|stem| stem == "cameras" || stem == "images")
}

/// Lists the folders of other models beside the folder `model`, sorted by name.
pub(super) fn beside(model: &Path) -> Vec<PathBuf> {
    let entries = model.parent().and_then(|parent| parent.read_dir().ok()).into_iter().flatten().flatten();
    let is_other = |folder: &PathBuf| folder.file_name() != model.file_name() && is_folder(folder);
    let mut models: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_other).collect();
    models.sort();
    models
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
    // The file has the order of registration. A camera path follows the order of the photographs, which their names
    // give.
    dataset.views.sort_by(|a, b| a.photograph.cmp(&b.photograph));
    Ok(dataset)
}
