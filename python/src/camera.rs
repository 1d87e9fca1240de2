//! Defines the Python class `Camera`: loads, saves and makes cameras, and converts their matrices from and to NumPy
//! arrays.

use crate::arrays::{give, take};
use crate::errors::{Error, SceneError};
use crate::scene::Scene;
use crate::wait;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use splatgraph::draw::camera_path::{self, CameraPath};
use splatgraph_assets::{self as assets, CameraOptions, Dataset, Projection};
use std::path::PathBuf;

/// A camera with x to the right, y down and z forward.
///
/// Args:
///     viewmat: world to camera, a rotation and a translation in world units, [4, 4].
///     K: intrinsics in pixels, [3, 3]: fx, fy, and the principal point cx, cy from the picture's top left corner. The
///         focal lengths of an orthographic camera are pixels per world unit, and those of a fisheye camera are pixels
///         per radian. An equirectangular camera ignores them, but they must be positive, and the principal point must
///         be within a pixel of the middle of the picture, to which it is moved.
///     width: width of the picture, in pixels.
///     height: height of the picture, in pixels.
///     name: name for files and messages.
///     projection: "pinhole", "orthographic", "fisheye" (equidistant) or "equirectangular". All but pinhole cameras
///         need a graph with the same projection.
///
/// Raises:
///     ValueError: an argument has a wrong shape or range, or `viewmat` is not a rotation and a translation.
#[pyclass(frozen, module = "splatgraph")]
pub struct Camera(pub assets::Camera);

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(
        signature = (viewmat, K, width, height, name = String::new(), projection = "pinhole"),
        text_signature = "(viewmat, K, width, height, name='', projection='pinhole')"
    )]
    #[expect(non_snake_case, reason = "the field's name of the matrix")]
    fn new(
        viewmat: &Bound<'_, PyAny>,
        K: &Bound<'_, PyAny>,
        width: Side,
        height: Side,
        name: String,
        projection: &str,
    ) -> PyResult<Camera> {
        let (Side(width), Side(height)) = (width, height);
        let projection = projection.parse::<Projection>().map_err(|()| {
            let names = Projection::ALL.map(Projection::name).join(", ");
            PyValueError::new_err(format!("projection: expected one of {names}, found {projection:?}"))
        })?;
        let view = matrix::<4>(viewmat, "viewmat")?;
        let k = matrix::<3>(K, "K")?;
        let axes: [[f64; 3]; 3] = std::array::from_fn(|row| [view[row][0], view[row][1], view[row][2]]);
        let camera = assets::Camera {
            id: 0,
            img_name: name,
            width,
            height,
            position: [0.0; 3],
            rotation: std::array::from_fn(|row| std::array::from_fn(|axis| axes[axis][row])),
            fx: k[0][0],
            fy: k[1][1],
            principal_offset: [k[0][2] - 0.5 * f64::from(width), k[1][2] - 0.5 * f64::from(height)],
            projection,
        };
        if view[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(PyValueError::new_err(format!(
                "viewmat: expected the last row 0, 0, 0, 1, found {:?}",
                view[3]
            )));
        }
        if k[0][1] != 0.0 || k[1][0] != 0.0 || k[2] != [0.0, 0.0, 1.0] {
            return Err(PyValueError::new_err("K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"));
        }
        let Camera(mut camera) = checked(camera)?;
        camera.straighten();
        let axes = camera.axes();
        camera.position =
            std::array::from_fn(|i| -(0..3).map(|row| axes[row][i] * view[row][3]).sum::<f64>());
        checked(camera)
    }

    /// Makes a camera at `eye` that looks at `target`, both in world units. `fov` is the horizontal field of view, in
    /// degrees.
    ///
    /// The direction `up` of the world is up in the picture; most scenes have y downwards.
    ///
    /// Raises:
    ///     ValueError: `eye` equals `target`, `fov` is not above 0 and below 180, or the camera is invalid.
    #[staticmethod]
    #[pyo3(
        signature = (eye, target, fov = 60.0, size = (Side(960), Side(540)), up = [0.0, -1.0, 0.0], name = String::new()),
        text_signature = "(eye, target, fov=60.0, size=(960, 540), up=(0.0, -1.0, 0.0), name='')"
    )]
    fn look_at(
        eye: [f64; 3],
        target: [f64; 3],
        fov: f64,
        size: (Side, Side),
        up: [f64; 3],
        name: String,
    ) -> PyResult<Camera> {
        if eye == target {
            return Err(PyValueError::new_err(format!(
                "target: expected a point other than eye, found {target:?} for both"
            )));
        }
        if !(fov > 0.0 && fov < 180.0) {
            return Err(PyValueError::new_err(format!(
                "fov: expected an angle above 0 and below 180 degrees, found {fov}"
            )));
        }
        let (Side(width), Side(height)) = size;
        let camera = assets::Camera::looking_at_upright(eye, target, up, fov, (width, height));
        checked(assets::Camera { img_name: name, ..camera })
    }

    /// Makes a camera that frames most of a scene.
    #[staticmethod]
    #[pyo3(signature = (scene, size = (Side(960), Side(540))), text_signature = "(scene, size=(960, 540))")]
    fn framing(scene: &Bound<'_, Scene>, size: (Side, Side)) -> PyResult<Camera> {
        wait::pool()?;
        let scene = &scene.get().0;
        let (Side(width), Side(height)) = size;
        let camera = assets::Camera::framing(scene, width, height);
        Ok(Camera(camera.in_world(scene.offset())))
    }

    /// Loads cameras: a `cameras.json`, a `transforms.json`, a `camera_path.json`, a glTF file, a file of COLMAP's
    /// model, or a folder with a `cameras.json`, `transforms*.json` or COLMAP's model.
    ///
    /// Lenses with distortion are refused. With `ignore_distortion`, they become ideal lenses, whose pictures do not
    /// match the photographs.
    ///
    /// Raises:
    ///     SceneError: the file cannot be read, or a camera is invalid or refused.
    #[staticmethod]
    #[pyo3(signature = (path, ignore_distortion = false))]
    fn load(py: Python<'_>, path: PathBuf, ignore_distortion: bool) -> PyResult<Vec<Camera>> {
        let options = CameraOptions { ignore_distortion, ..CameraOptions::default() };
        let dataset = wait::run(py, move || Dataset::load_with(&path, options))?;
        let cameras = dataset.map_err(|error| SceneError::new_err(error.to_string()))?.into_cameras();
        Ok(cameras.into_iter().map(Camera).collect())
    }

    /// Writes cameras to a `cameras.json`.
    ///
    /// Raises:
    ///     SceneError: the file cannot be written.
    #[staticmethod]
    fn save(cameras: Vec<PyRef<'_, Camera>>, path: PathBuf) -> PyResult<()> {
        let cameras: Vec<_> = cameras.iter().map(|camera| camera.0.clone()).collect();
        assets::Camera::save(&cameras, path).map_err(|error| SceneError::new_err(error.to_string()))
    }

    /// Makes `count` cameras along the smooth path through the cameras `keys`, as `splatgraph video` does.
    ///
    /// The speed is constant: the distance that takes as long as a rotation by one radian is half the extent of the
    /// scene. An open path begins at the first key and ends at the last.
    ///
    /// Raises:
    ///     ValueError: the keys have several projections.
    #[staticmethod]
    #[pyo3(signature = (scene, keys, count, closed = false))]
    fn path(
        scene: &Bound<'_, Scene>,
        keys: Vec<PyRef<'_, Camera>>,
        count: u32,
        closed: bool,
    ) -> PyResult<Vec<Camera>> {
        wait::pool()?;
        let scene = &scene.get().0;
        let mut path = CameraPath::new(camera_path::length_of_radian(scene), scene.up());
        let keys = keys.iter().map(|key| key.0.relative_to(scene.offset())).collect();
        path.set_keys(keys).map_err(|error| PyValueError::new_err(error.to_string()))?;
        path.set_closed(closed);
        let frames = (0..count).filter_map(|frame| {
            let camera = path.at_frame(f64::from(frame), count)?.in_world(scene.offset());
            Some(Camera(assets::Camera { id: frame.into(), img_name: format!("{frame:05}"), ..camera }))
        });
        Ok(frames.collect())
    }

    /// Returns the camera with another picture size, in pixels, and the same vertical field of view.
    fn resized(&self, width: Side, height: Side) -> PyResult<Camera> {
        checked(self.0.resized(width.0, height.0))
    }

    // A camera never changes, so a copy is the camera itself.
    fn __copy__(this: Py<Self>) -> Py<Self> {
        this
    }

    fn __deepcopy__(this: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        this
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let json = serde_json::to_string(&self.0).map_err(|error| Error::new_err(error.to_string()))?;
        Ok((py.get_type::<Camera>().getattr("_of_json")?, (json,)))
    }

    /// Restores a pickled camera.
    #[staticmethod]
    fn _of_json(json: &str) -> PyResult<Camera> {
        let camera = serde_json::from_str(json).map_err(|error| PyValueError::new_err(error.to_string()))?;
        checked(camera)
    }

    /// World to camera, float64 [4, 4].
    #[getter]
    fn viewmat<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let axes = self.0.axes();
        let mut view = [[0.0; 4]; 4];
        for (row, axis) in axes.iter().enumerate() {
            view[row][..3].copy_from_slice(axis);
            view[row][3] = -(0..3).map(|i| axis[i] * self.0.position[i]).sum::<f64>();
        }
        view[3][3] = 1.0;
        give(py, view.as_flattened(), &[4, 4])
    }

    /// Intrinsics in pixels, float64 [3, 3]: fx, fy, and the principal point from the picture's top left corner, where
    /// the middle of the first pixel is (0.5, 0.5).
    #[getter]
    #[pyo3(name = "K")]
    fn intrinsics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let centre = self.0.principal_point();
        let k = [[self.0.fx, 0.0, centre[0]], [0.0, self.0.fy, centre[1]], [0.0, 0.0, 1.0]];
        give(py, k.as_flattened(), &[3, 3])
    }

    /// Centre of projection, in world units.
    #[getter]
    fn position(&self) -> [f64; 3] {
        self.0.position
    }

    /// Width of the picture, in pixels.
    #[getter]
    fn width(&self) -> u32 {
        self.0.width
    }

    /// Height of the picture, in pixels.
    #[getter]
    fn height(&self) -> u32 {
        self.0.height
    }

    /// Name of the projection: "pinhole", "orthographic", "fisheye" or "equirectangular".
    #[getter]
    fn projection(&self) -> &'static str {
        self.0.projection.name()
    }

    /// Name for files and messages.
    #[getter]
    fn name(&self) -> &str {
        &self.0.img_name
    }

    fn __repr__(&self) -> String {
        let assets::Camera { img_name, width, height, position, .. } = &self.0;
        format!("<splatgraph.Camera {img_name:?}: {width} x {height} pixels at {position:?}>")
    }
}

/// The width or the height of a picture, in pixels.
#[derive(Clone, Copy)]
struct Side(u32);

impl FromPyObject<'_, '_> for Side {
    type Error = PyErr;

    fn extract(value: Borrowed<'_, '_, PyAny>) -> PyResult<Side> {
        // Fails for anything but an integer, with an error that names the type.
        let number = value.py().import("operator")?.call_method1("index", (value,))?;
        match number.extract::<u32>() {
            Ok(side) if side > 0 => Ok(Side(side)),
            _ => Err(PyValueError::new_err(format!(
                "expected a width and a height in pixels, from 1 to {}, found {number}",
                u32::MAX
            ))),
        }
    }
}

fn checked(camera: assets::Camera) -> PyResult<Camera> {
    match camera.fault() {
        Some(fault) => Err(PyValueError::new_err(fault)),
        None => Ok(Camera(camera)),
    }
}

fn matrix<const N: usize>(value: &Bound<'_, PyAny>, name: &str) -> PyResult<[[f64; N]; N]> {
    let array = take::<f64>(value, name, &[Some(N), Some(N)])?;
    Ok(std::array::from_fn(|row| std::array::from_fn(|column| array.values[N * row + column])))
}
