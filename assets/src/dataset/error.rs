//! Defines the errors that reading and writing cameras can have.

use crate::projection::Projection;
use std::path::{Path, PathBuf};

/// Maximum size of a JSON file of cameras, or of a `dataparser_transforms.json`, in bytes.
pub const MAX_CAMERA_BYTES: u64 = 256 << 20;

/// Maximum number of cameras in a JSON file or a COLMAP model.
pub(crate) const MAX_CAMERAS: usize = 1 << 20;

/// An error while reading, writing or selecting cameras.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// The file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The contents of a camera file, or of its `dataparser_transforms.json`, are malformed or not supported, such as a
    /// lens with distortion.
    #[error("{}{place}: {message}", path.display())]
    Invalid {
        /// Path of the file.
        path: PathBuf,
        /// Position in the file after a colon, such as line and column or byte and field; empty if unknown.
        place: String,
        /// Expected and found values, as a sentence.
        message: String,
    },
    /// The file has none of the known formats.
    #[error(
        "{}: expected cameras in JSON (cameras.json, transforms.json, camera_path.json), COLMAP's cameras and images (.bin or \
         .txt), or glTF, found another format",
        path.display()
    )]
    UnknownFormat {
        /// Path of the file.
        path: PathBuf,
    },
    /// The folder contains no camera file.
    #[error(
        "{}: expected cameras.json, transforms.json, transforms_test.json, or COLMAP's cameras and images (.bin or .txt) here or \
         in sparse/0, found none of them",
        path.display()
    )]
    NoCameras {
        /// Path of the folder.
        path: PathBuf,
    },
    /// `file#camera` matches none of the cameras.
    #[error("{} has no camera `{wanted}`: it has {count}, numbered from 0{}", path.display(), named(.names))]
    NotFound {
        /// Path of the file.
        path: PathBuf,
        /// The requested index or name.
        wanted: String,
        /// Number of cameras in the file.
        count: usize,
        /// The first names of cameras in the file, at most eight; cameras without a name are left out.
        names: Vec<String>,
    },
    /// COLMAP has no model for the camera's projection.
    #[error("camera `{name}`: expected pinhole or fisheye, which COLMAP has a model for, found {projection}")]
    NoModel {
        /// The camera's `img_name`.
        name: String,
        /// The camera's projection.
        projection: Projection,
    },
    /// The file has no cameras.
    #[error("{} has no cameras", path.display())]
    Empty {
        /// Path of the file.
        path: PathBuf,
    },
}

impl CameraError {
    /// Returns a function that adds the file's path to a system error.
    pub(super) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), source }
    }

    pub(super) fn invalid(path: &Path, place: String, message: String) -> Self {
        Self::Invalid { path: path.to_owned(), place, message }
    }
}

fn named(names: &[String]) -> String {
    if names.is_empty() { String::new() } else { format!(" and named {}", names.join(", ")) }
}
