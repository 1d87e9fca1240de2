//! Defines the views of a dataset.

use crate::camera::Camera;
use std::path::{Path, PathBuf};

/// A camera with the name of its photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// The camera. Its `img_name` is the photograph's path in the file, without a known extension and a leading `./`.
    pub camera: Camera,
    /// Path of the photograph, relative to [`Dataset::photographs`]; its extension may be missing.
    pub photograph: String,
    /// True for a test view; `None` if the dataset does not specify it.
    pub test: Option<bool>,
}

/// Options of [`Dataset::load_with`].
#[derive(Clone, Copy, Debug, Default)]
pub struct CameraOptions<'a> {
    /// Folder of the photographs, from which cameras without a size take theirs; `None` for the dataset's own.
    pub photographs: Option<&'a Path>,
    /// True to ignore the distortion of lenses, which is otherwise an error. The photographs then do not match the
    /// cameras.
    pub ignore_distortion: bool,
    /// True to take the test views that nerfstudio chooses by default, if the dataset names none.
    pub nerfstudio_split: bool,
}

/// A format of captures. Its cameras may be in another space than a scene that nerfstudio trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Capture {
    /// A model of COLMAP.
    Colmap,
    /// A `transforms.json` that is not Blender's.
    Frames,
}

/// The views of a capture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Dataset {
    /// The views, in the order of the dataset's file; COLMAP's in the order of the photographs' names. Blender's test
    /// views, which have their own file, come first.
    pub views: Vec<View>,
    /// Folder that the photographs' paths are relative to. `None` for a `cameras.json`, glTF, and a COLMAP model
    /// without a folder `images` nearby.
    pub photographs: Option<PathBuf>,
    /// Files that the cameras were read from; empty for a parsed text.
    pub files: Vec<PathBuf>,
    /// The `dataparser_transforms.json` that moved the cameras to the space of nerfstudio's scene, if there is one.
    pub alignment: Option<PathBuf>,
    /// Folders of the other models of COLMAP's reconstruction, if the first one was found in `sparse/0` or `0`. COLMAP
    /// writes one model for each group of photographs that it cannot join.
    pub other_models: Vec<PathBuf>,
    /// Format of the capture; `None` for cameras in the space of the scene.
    pub capture: Option<Capture>,
    /// Source of the test views: a field (`test_filenames`; `val_filenames`, `train_filenames` without it; `test` of a
    /// `cameras.json`), a file (`transforms_test`), or [`NERFSTUDIO`]. `None` if there is none.
    pub split: Option<&'static str>,
    /// Names of photographs in the list that [`Dataset::split`] names that no view has.
    pub unmatched: Vec<String>,
    /// Number of views that have the selected name, if there are several, and the index of the next one. The first is
    /// selected.
    pub same_name: Option<(usize, usize)>,
    /// True if the dataset has masks (`mask_path`), which are not read.
    pub has_masks: bool,
    /// True if the file moves cameras over time, which is not read. glTF files can.
    pub has_animation: bool,
    /// The timing of the cameras, if they are the frames of a film, as in a `camera_path.json`.
    pub timing: Option<FrameTiming>,
    /// The part of the scene that a `camera_path.json` shows.
    pub crop: Option<Crop>,
}

/// A box to which nerfstudio's viewer crops a scene, and the colour behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crop {
    /// Middle of the box, in world coordinates.
    pub center: [f64; 3],
    /// Directions of the box's edges, of length 1.
    pub axes: [[f64; 3]; 3],
    /// Lengths of the box's edges.
    pub size: [f64; 3],
    /// Colour of the background, display-encoded: 0 is black, 1 is white.
    pub background: [f64; 3],
}

/// [`Dataset::split`] of nerfstudio's default test views.
pub const NERFSTUDIO: &str = "nerfstudio";

/// Name of the list of photographs that are not test views.
pub(super) const TRAIN: &str = "train_filenames";

/// The timing of cameras that are the frames of a film, as far as the file contains it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameTiming {
    /// Frames per second.
    pub fps: Option<f64>,
    /// True if the first camera follows the last.
    pub is_cycle: bool,
}

/// Names the camera with this index, among `count`, if the file does not. The names sort in the order of the cameras.
pub fn unnamed(index: usize, count: usize) -> String {
    let digits = count.saturating_sub(1).to_string().len();
    format!("camera{index:0digits$}")
}
