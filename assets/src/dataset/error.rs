//! Defines the errors that reading and writing cameras can have.

use crate::error::SceneError;
use crate::projection::Projection;
use std::path::PathBuf;

/// Maximum size of a `cameras.json` or `transforms.json`, in bytes.
pub const MAX_CAMERA_BYTES: u64 = 256 << 20;

/// Maximum number of cameras in a `cameras.json`, a `transforms.json` or a COLMAP model.
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
    /// The text is neither a list of cameras nor a `transforms.json`, or one of its cameras is invalid.
    #[error("{}:{line}:{column}: {}{message}", path.display(), in_camera(.camera))]
    Parse {
        /// Path of the file.
        path: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// Column, counted from 1.
        column: usize,
        /// Index of the camera with the error, from 0; `None` outside the list's entries.
        camera: Option<usize>,
        /// Expected and found values, as a sentence.
        message: String,
    },
    /// A line of a text file, or one of its fields, is malformed.
    #[error("{}:{line}: `{field}`: {message}", path.display())]
    Line {
        /// Path of the file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// The field's name in the format's description.
        field: &'static str,
        /// Expected and found values, as a sentence.
        message: String,
    },
    /// A field of a binary file is damaged or has an invalid value.
    #[error("{}: byte {at}, `{field}`: {message}", path.display())]
    Byte {
        /// Path of the file.
        path: PathBuf,
        /// Offset of the field in the file.
        at: u64,
        /// The field's name in the format's description.
        field: &'static str,
        /// Expected and found values, as a sentence.
        message: String,
    },
    /// The cameras of a glTF file cannot be read.
    #[error("{}: {problem}", path.display())]
    Gltf {
        /// Path of the file.
        path: PathBuf,
        /// Cause of the failure.
        problem: Box<SceneError>,
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
        /// Names of the first cameras in the file, at most eight.
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

fn in_camera(camera: &Option<usize>) -> String {
    camera.map(|index| format!("camera {index}: ")).unwrap_or_default()
}

fn named(names: &[String]) -> String {
    if names.is_empty() { String::new() } else { format!(" and named {}", names.join(", ")) }
}
