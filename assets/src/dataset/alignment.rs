//! Moves the cameras of a capture to the space of a scene that nerfstudio trained.
//!
//! nerfstudio rotates, centres and scales a capture before the training, and writes this motion to
//! `dataparser_transforms.json`: the point x of the capture becomes `scale * (transform * x)`. The poses of a
//! `transforms.json` may already contain a part of the motion, its `applied_transform` and `applied_scale`.

use super::error::{CameraError, MAX_CAMERA_BYTES};
use super::view::Dataset;
use crate::file;
use crate::similarity;
use glam::{DAffine3, DMat3, DMat4, DVec3, DVec4};
use serde::{Deserialize, Deserializer};
use std::path::{Path, PathBuf};

/// A matrix of 3 or 4 rows of 4 numbers, or of these numbers in one list. A fourth row is 0, 0, 0, 1.
#[derive(Clone, Copy)]
pub(super) struct Matrix(pub(super) [[f64; 4]; 3]);

impl Matrix {
    fn affine(&self) -> DAffine3 {
        let [x, y, z] = self.0.map(DVec4::from);
        DAffine3::from_mat4(DMat4::from_cols(x, y, z, DVec4::W).transpose())
    }
}

/// The part of the motion that the poses of a `transforms.json` already contain.
#[derive(Clone, Copy, Default)]
pub(super) struct Applied {
    pub(super) transform: Option<Matrix>,
    pub(super) scale: Option<f64>,
}

#[derive(Deserialize)]
struct Alignment {
    transform: Matrix,
    scale: f64,
}

/// Returns the path of `dataparser_transforms.json` in a folder; `None` if there is no such file.
pub(super) fn beside(folder: &Path) -> Option<PathBuf> {
    Some(folder.join("dataparser_transforms.json")).filter(|file| file.is_file())
}

/// Moves cameras as the `dataparser_transforms.json` at `path` says, and lists the file in the dataset. `applied` is
/// the motion that the cameras already contain; it is undone first.
pub(super) fn apply(dataset: &mut Dataset, path: PathBuf, applied: &Applied) -> Result<(), CameraError> {
    let text = file::read_text(&path, MAX_CAMERA_BYTES).map_err(CameraError::io(&path))?;
    let invalid = |message: String| CameraError::invalid(&path, String::new(), message);
    let Alignment { transform, scale } =
        serde_json::from_str(&text).map_err(|error| invalid(error.to_string()))?;
    let motion = applied.transform.map_or(DAffine3::IDENTITY, |matrix| matrix.affine().inverse());
    let motion = transform.affine() * motion;
    let scale = scale / applied.scale.unwrap_or(1.0);
    if !scale.is_finite() || scale <= 0.0 {
        return Err(invalid(format!("`scale`: expected a positive number, found {scale}")));
    }
    for camera in dataset.views.iter_mut().map(|view| &mut view.camera) {
        camera.position = (scale * motion.transform_point3(DVec3::from(camera.position))).into();
        // The matrices of glam have columns, and the camera's rotation rows.
        let rotation = motion.matrix3 * DMat3::from_cols_array_2d(&camera.rotation).transpose();
        camera.rotation = rotation.transpose().to_cols_array_2d();
        camera.fault().map_or(Ok(()), |fault| Err(invalid(fault)))?;
        camera.straighten();
    }
    dataset.files.push(path.clone());
    dataset.alignment = Some(path);
    Ok(())
}

impl<'de> Deserialize<'de> for Matrix {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged, expecting = "expected a number or 4 numbers in a row of the matrix")]
        enum Entry {
            Row([f64; 4]),
            Number(f64),
        }
        let mut numbers = Vec::new();
        for entry in Vec::deserialize(deserializer)? {
            match entry {
                Entry::Row(row) => numbers.extend(row),
                Entry::Number(number) => numbers.push(number),
            }
        }
        let (rows, _) = numbers.as_chunks();
        match rows {
            [a, b, c, last @ ..] if numbers.len() % 4 == 0 && last.len() <= 1 => {
                let fault = last.iter().try_for_each(|row| similarity::affine(DVec4::from(*row)));
                fault.map_err(serde::de::Error::custom).map(|()| Self([*a, *b, *c]))
            }
            _ => Err(serde::de::Error::custom(format!(
                "expected a matrix of 3 or 4 rows of 4 numbers, found {} numbers",
                numbers.len()
            ))),
        }
    }
}
