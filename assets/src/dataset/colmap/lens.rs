//! Defines COLMAP's lenses, and converts its images to views.

use crate::camera::Camera;
use crate::dataset::error::{CameraError, MAX_CAMERAS};
use crate::dataset::photograph;
use crate::dataset::view::{Dataset, View};
use crate::file;
use crate::projection::Projection;
use glam::{DMat3, DQuat, DVec3};
use std::collections::HashMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

#[derive(Clone, Copy)]
pub(super) struct Lens {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    projection: Projection,
    principal_offset: [f64; 2],
}

/// Lenses of a sparse model, by `CAMERA_ID`.
pub(super) type Lenses = HashMap<u32, Lens>;

/// A lens model, with the names of its parameters in order.
pub(super) struct Model {
    pub(super) name: &'static str,
    pub(super) parameters: &'static [&'static str],
    /// Projection of the model with zero coefficients; `None` for FOV, which has its own.
    projection: Option<Projection>,
}

/// Lens models; the index is COLMAP's model ID, from its `src/colmap/sensor/models.h`.
pub(super) const MODELS: [Model; 11] = [
    Model { name: "SIMPLE_PINHOLE", parameters: &["f", "cx", "cy"], projection: Some(Projection::Pinhole) },
    Model { name: "PINHOLE", parameters: &["fx", "fy", "cx", "cy"], projection: Some(Projection::Pinhole) },
    Model {
        name: "SIMPLE_RADIAL",
        parameters: &["f", "cx", "cy", "k"],
        projection: Some(Projection::Pinhole),
    },
    Model {
        name: "RADIAL",
        parameters: &["f", "cx", "cy", "k1", "k2"],
        projection: Some(Projection::Pinhole),
    },
    Model {
        name: "OPENCV",
        parameters: &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"],
        projection: Some(Projection::Pinhole),
    },
    Model {
        name: "OPENCV_FISHEYE",
        parameters: &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"],
        projection: Some(Projection::Fisheye),
    },
    Model {
        name: "FULL_OPENCV",
        parameters: &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
        projection: Some(Projection::Pinhole),
    },
    Model { name: "FOV", parameters: &["fx", "fy", "cx", "cy", "omega"], projection: None },
    Model {
        name: "SIMPLE_RADIAL_FISHEYE",
        parameters: &["f", "cx", "cy", "k"],
        projection: Some(Projection::Fisheye),
    },
    Model {
        name: "RADIAL_FISHEYE",
        parameters: &["f", "cx", "cy", "k1", "k2"],
        projection: Some(Projection::Fisheye),
    },
    Model {
        name: "THIN_PRISM_FISHEYE",
        parameters: &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"],
        projection: Some(Projection::Fisheye),
    },
];

pub(in crate::dataset) const UNDISTORT: &str =
    "undistort the photographs first, for instance with `colmap image_undistorter`";

/// Advice that follows [`UNDISTORT`] for a lens that would be ideal without its coefficients.
pub(in crate::dataset) const IDEAL: &str = ", or draw an ideal lens with `render --ignore-distortion`, in Python with \
                                            `Camera.load(path, ignore_distortion=True)`";

/// A field's name, and what was expected and found.
pub(super) type Fault = (&'static str, String);

impl Model {
    /// Returns the projection of the model. Fails for a model that is neither a pinhole nor a fisheye, even with zero
    /// coefficients.
    pub(super) fn projection(&self) -> Result<Projection, Fault> {
        let fault = || format!("expected a pinhole or fisheye camera, found {}; {UNDISTORT}", self.name);
        self.projection.ok_or_else(|| ("MODEL", fault()))
    }

    /// Creates a lens of this model, with its [projection](Model::projection). `values` has an entry for each
    /// parameter. Fails if the lens has distortion that is not ignored, or its principal point is not finite.
    pub(super) fn lens(
        &self,
        projection: Projection,
        (width, height): (u32, u32),
        values: &[f64],
        ignore_distortion: bool,
    ) -> Result<Lens, Fault> {
        let mut lens = Lens { width, height, fx: 0.0, fy: 0.0, projection, principal_offset: [0.0; 2] };
        for (name, value) in self.parameters.iter().zip(values) {
            match *name {
                "f" => (lens.fx, lens.fy) = (*value, *value),
                "fx" => lens.fx = *value,
                "fy" => lens.fy = *value,
                "cx" | "cy" => {
                    let (axis, side) = if *name == "cx" { (0, width) } else { (1, height) };
                    if !value.is_finite() {
                        return Err((name, format!("expected a finite number, found {value}")));
                    }
                    lens.principal_offset[axis] = value - 0.5 * f64::from(side);
                }
                _ if ignore_distortion || *value == 0.0 => {}
                _ => {
                    return Err((
                        name,
                        format!("expected 0, a lens without distortion, found {value}; {UNDISTORT}{IDEAL}"),
                    ));
                }
            }
        }
        Ok(lens)
    }
}

/// Describes the distortion in the parameters of the model `name`; `None` without distortion, or for no known model.
pub(in crate::dataset) fn distorted_parameters(name: &str, parameters: &[f64]) -> Option<String> {
    let model = MODELS.iter().find(|model| model.name == name)?;
    let (name, fault) = model.lens(Projection::Pinhole, (1, 1), parameters, false).err()?;
    Some(format!("{name}: {fault}"))
}

/// Describes the values that an image's `CAMERA_ID` may have: the first IDs of the lenses, in order.
fn ids(lenses: &Lenses) -> String {
    const SHOWN: usize = 8;
    let mut ids: Vec<u32> = lenses.keys().copied().collect();
    ids.sort_unstable();
    let shown: Vec<String> = ids.iter().take(SHOWN).map(u32::to_string).collect();
    match (ids.len(), shown.join(", ")) {
        (0, _) => "an ID of cameras, which lists none".into(),
        (1, only) => format!("{only}, the only ID of cameras"),
        (count, shown) if count > SHOWN => format!("one of the {count} IDs of cameras ({shown}, ...)"),
        (_, shown) => format!("an ID of cameras ({shown})"),
    }
}

/// Adds the view of an image to a dataset. `lens` is the lens's ID. The pose is a quaternion w, x, y, z and a
/// translation, from the world to the camera.
pub(super) fn push(
    dataset: &mut Dataset,
    lenses: &Lenses,
    (id, lens): (u32, u32),
    ([w, x, y, z], translation): ([f64; 4], [f64; 3]),
    name: String,
) -> Result<(), Fault> {
    let Some(lens) = lenses.get(&lens) else {
        return Err(("CAMERA_ID", format!("expected {}, found {lens}", ids(lenses))));
    };
    if dataset.views.len() == MAX_CAMERAS {
        return Err(("IMAGE_ID", format!("expected at most {MAX_CAMERAS} images, found more")));
    }
    let turn = DQuat::from_xyzw(x, y, z, w);
    if !(turn.length() > 1e-6 && turn.is_finite()) {
        return Err(("QW", format!("expected a quaternion other than zero, found {w} {x} {y} {z}")));
    }
    let to_world = DMat3::from_quat(turn.normalize()).transpose();
    let camera = Camera {
        id: id.into(),
        img_name: photograph::stem(&name).to_owned(),
        width: lens.width,
        height: lens.height,
        position: (to_world * -DVec3::from(translation)).into(),
        rotation: to_world.transpose().to_cols_array_2d(),
        fx: lens.fx,
        fy: lens.fy,
        principal_offset: lens.principal_offset,
        projection: lens.projection,
    };
    if let Some(fault) = camera.fault() {
        return Err(("IMAGE_ID", fault));
    }
    dataset.views.push(View { camera, photograph: name, test: None });
    Ok(())
}

pub(super) fn open(path: &Path) -> Result<(BufReader<File>, u64), CameraError> {
    let inner = || {
        let file = file::open(path)?;
        let length = file.metadata()?.len();
        Ok((BufReader::new(file), length))
    };
    inner().map_err(CameraError::io(path))
}
