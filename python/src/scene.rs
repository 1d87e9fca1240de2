//! Defines the Python class `Scene`: loads and saves files, and converts from and to NumPy arrays.

use crate::arrays::{Array, give, take};
use crate::errors::{Error, SceneError};
use crate::wait;
use pyo3::exceptions::{PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use splatgraph::io::output::OutputError;
use splatgraph::io::{losses, scene_file};
use splatgraph_assets::{self as assets, FileNotes, Properties, ReadOptions, Similarity, Splat};
use std::collections::HashMap;
use std::ffi::CString;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(text)?, 1)
}

/// Warns of positions that were rounded to f32 far from 0.
fn warn_coarse(py: Python<'_>, name: &str, scene: &assets::Scene) -> PyResult<()> {
    scene.coarse_notes().iter().try_for_each(|note| warn(py, &format!("{name}: {note}")))
}

/// A 3D Gaussian Splatting scene. Its opacities and scales are activated (no logits, no logarithms). Scenes are
/// immutable; renderers share them.
#[pyclass(frozen, module = "splatgraph")]
pub struct Scene(pub Arc<assets::Scene>);

#[pymethods]
impl Scene {
    /// Loads a scene file of any format, recognised by its bytes; a folder of SOG; or a list of scenes (.ron).
    /// docs/formats.md lists the formats.
    ///
    /// `properties` names further properties of a PLY file to load, for graphs that import `scene.property.NAME`, and
    /// for `Scene.properties`. Warns (`UserWarning`) of positions so far from 0 that float32 rounds them coarsely.
    ///
    /// Raises:
    ///     SceneError: the file is not a scene, cannot be read, or lacks one of the properties.
    #[staticmethod]
    #[pyo3(signature = (path, *, properties = Vec::new()), text_signature = "(path, *, properties=())")]
    fn load(py: Python<'_>, path: PathBuf, properties: Vec<String>) -> PyResult<Scene> {
        let name = path.display().to_string();
        let load = move || {
            let options = ReadOptions { properties: &properties, ..ReadOptions::default() };
            assets::Scene::load_with(path, options, &|_, _| ControlFlow::Continue(()))
        };
        let loaded = wait::run(py, load)?;
        let scene = loaded.map_err(|error| SceneError::new_err(error.to_string()))?;
        warn_coarse(py, &name, &scene)?;
        Ok(Scene(Arc::new(scene)))
    }

    /// Makes a scene from arrays: objects with `__dlpack__`, or any that numpy converts.
    ///
    /// Args:
    ///     means: centres in world units, [N, 3]. If they are float64 and far from 0 (by more than 512 units), the
    ///         scene gets an `offset`.
    ///     quats: rotations w, x, y, z, of any length but 0, [N, 4].
    ///     scales: standard deviations along the axes in world units (not their logarithms), [N, 3].
    ///     opacities: opacities at the centre, 0 to 1 (not their logits), [N].
    ///     sh: spherical harmonics, [N, K, 3] with K = 1, 4, 9 or 16; a colour c is 0.5 + 0.28209 * sh[:, 0].
    ///     properties: further values of each splat, [N], by name, for graphs that import `scene.property.NAME`.
    ///     like: a scene that the arrays were made from, whose `tags` and mesh the new scene gets. The means are
    ///         relative to its `offset`, as its own are.
    ///
    /// Splats with values that are not finite or a quaternion of 0 are dropped: see `dropped`. Warns (`UserWarning`) of
    /// float32 means so far from 0 that they are coarse.
    ///
    /// Raises:
    ///     ValueError: an array has a wrong shape, an opacity is not in 0 to 1, or a scale is negative.
    ///     TypeError: an argument is not an array of numbers.
    #[staticmethod]
    #[pyo3(
        signature = (means, quats, scales, opacities, sh, *, properties = None, like = None, _checked = true),
        text_signature = "(means, quats, scales, opacities, sh, *, properties=None, like=None)"
    )]
    #[expect(clippy::too_many_arguments, reason = "Python's function has them")]
    fn from_arrays(
        py: Python<'_>,
        means: &Bound<'_, PyAny>,
        quats: &Bound<'_, PyAny>,
        scales: &Bound<'_, PyAny>,
        opacities: &Bound<'_, PyAny>,
        sh: &Bound<'_, PyAny>,
        properties: Option<&Bound<'_, PyDict>>,
        like: Option<&Scene>,
        _checked: bool,
    ) -> PyResult<Scene> {
        let means = Means::take(means)?;
        let count = means.count();
        let quats = take::<f32>(quats, "quats", &[Some(count), Some(4)])?;
        let scales = take::<f32>(scales, "scales", &[Some(count), Some(3)])?;
        let opacities = take::<f32>(opacities, "opacities", &[Some(count)])?;
        let sh = take::<f32>(sh, "sh", &[Some(count), None, Some(3)])?;
        // Only gsplat's function omits the check. Opacities above 1 are then capped like alphas, opacities below 0 are
        // invisible, and negative scales count as positive.
        if _checked {
            let hint = "logarithms: numpy.exp gives the scales";
            check(&scales, |scale| scale < 0.0, "scales: expected no negative values", hint)?;
            let hint = "logits: their sigmoid, 1 / (1 + numpy.exp(-logits)), gives the opacities";
            check(&opacities, |p| !(0.0..=1.0).contains(&p), "opacities: expected values of 0 to 1", hint)?;
        }
        let bases = sh.shape[1];
        let Some(degree) = [1, 4, 9, 16].iter().position(|k| *k == bases) else {
            return Err(PyValueError::new_err(format!(
                "sh: expected 1, 4, 9 or 16 bases (degrees 0 to 3), found {bases}"
            )));
        };
        let splats = u32::try_from(count).map_err(|_| {
            PyValueError::new_err(format!("means: expected at most {} splats, found {count}", u32::MAX))
        })?;
        let (mut names, mut columns) = (Vec::new(), Vec::new());
        for (name, values) in properties.into_iter().flatten() {
            let name: String = name.extract()?;
            columns.push(take::<f32>(&values, &name, &[Some(count)])?.values);
            names.push(name);
        }
        let properties = Properties { names, value: &|index, name| columns[name][index] };
        let [quats, scales, opacities, sh] = [quats, scales, opacities, sh].map(|array| array.values);
        let splat = |index: usize| {
            let mut all = [0.0; 48];
            all[..3 * bases].copy_from_slice(&sh[3 * bases * index..][..3 * bases]);
            Splat {
                position: [0.0; 3],
                scale: three(&scales, index),
                rotation: std::array::from_fn(|axis| quats[4 * index + axis]),
                opacity: opacities[index],
                sh: all,
            }
        };
        let degree = degree as u32;
        wait::pool()?;
        let made = py.detach(|| match &means {
            Means::Single(means) => {
                assets::Scene::try_generate_with_properties(splats, degree, properties, |index| Splat {
                    position: three(&means.values, index),
                    ..splat(index)
                })
            }
            Means::Double(means) => {
                let position = |index| three(&means.values, index);
                assets::Scene::try_generate_in_world(splats, degree, properties, position, splat)
            }
        });
        let mut scene = made.map_err(|error| Error::new_err(error.to_string()))?;
        warn_coarse(py, "means", &scene)?;
        if let Some(Scene(like)) = like {
            scene = alike(scene, like);
        }
        Ok(Scene(Arc::new(scene)))
    }

    /// Writes the scene in the format of the file's extension: .ply, .glb, .compressed.ply, .spz, .splat or .sog. All
    /// formats but the first two round the values, .compressed.ply and .sog also change the order of the splats, and
    /// .splat has no harmonics above degree 0.
    ///
    /// Warns (`UserWarning`) of what else a file lacks, such as a mesh. A .glb cannot name the order by depth: the
    /// scene that is loaded from it is drawn in the order of the distance from the camera.
    ///
    /// Raises:
    ///     ValueError: the extension is not one of these.
    ///     SceneError: the scene has no splats, or the file cannot be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let format = scene_file::format_of(&path)
            .map_err(|message| PyValueError::new_err(format!("path: {message}")))?;
        let scene = self.0.clone();
        if scene.count() == 0 {
            let dropped = scene.dropped().total();
            return Err(SceneError::new_err(format!(
                "expected at least one splat to write, found none ({dropped} dropped)"
            )));
        }
        let name = path.display().to_string();
        let write = move || {
            scene_file::write(&scene, format, None, assets::QUIET, &path)?;
            Ok::<_, OutputError>(losses::missing(&scene, format))
        };
        let written: Result<Vec<String>, OutputError> = wait::run(py, write)?;
        let losses = written.map_err(|error| SceneError::new_err(error.to_string()))?;
        losses.iter().try_for_each(|loss| warn(py, &format!("{name}: lost: {loss}")))
    }

    /// Centres in world units, float32 [N, 3], relative to `offset`. A copy.
    #[getter]
    fn means<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        give(py, self.0.positions().as_flattened(), &[self.0.count() as usize, 3])
    }

    /// Unit quaternions w, x, y, z, float32 [N, 4]. A copy.
    #[getter]
    fn quats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        give(py, self.0.rotations().as_flattened(), &[self.0.count() as usize, 4])
    }

    /// Standard deviations along the axes in world units, float32 [N, 3]. A copy.
    #[getter]
    fn scales<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        give(py, self.0.scales().as_flattened(), &[self.0.count() as usize, 3])
    }

    /// Opacities at the centres, 0 to 1, float32 [N]. A copy.
    #[getter]
    fn opacities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        give(py, self.0.opacities(), &[self.0.count() as usize])
    }

    /// Spherical harmonics, float32 [N, K, 3], with K = 1, 4, 9 or 16 as stored: at least (sh_degree + 1)^2. A copy.
    #[getter]
    fn sh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let bases = assets::sh_floats(self.0.stored_degree()) / 3;
        give(py, self.0.sh(), &[self.0.count() as usize, bases, 3])
    }

    /// Further properties of the splats, float32 [N], by name. Copies.
    #[getter]
    fn properties<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let found = PyDict::new(py);
        for (at, name) in self.0.property_names().iter().enumerate() {
            let values: Vec<f32> =
                (0..self.0.count() as usize).map(|index| self.0.property(index, at)).collect();
            found.set_item(name, give(py, &values, &[values.len()])?)?;
        }
        Ok(found)
    }

    /// Highest band of spherical harmonics with a coefficient other than 0 in a splat that can be visible, with an
    /// opacity of 1/255 or more.
    #[getter]
    fn sh_degree(&self) -> u32 {
        self.0.effective_degree()
    }

    /// World coordinates, float64 [3], of the point that `means` are relative to. Not 0 only for positions of more
    /// precision than float32 that are far from 0, such as those of surveys.
    #[getter]
    fn offset(&self) -> [f64; 3] {
        self.0.offset()
    }

    /// Tags of the scene's file, which say how to draw the splats: `low_pass` and `key_of` if they differ from the
    /// published rules, and `up`.
    #[getter]
    fn tags(&self) -> HashMap<&'static str, String> {
        self.0.notes().tags().into_iter().collect()
    }

    /// Box of all centres: its minimum and its maximum corner, in world units relative to `offset`.
    #[getter]
    fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        let bounds = self.0.bounds();
        (bounds.min, bounds.max)
    }

    /// Number of splats of the file or the arrays that were dropped because they cannot be drawn.
    #[getter]
    fn dropped(&self) -> u64 {
        self.0.dropped().total()
    }

    fn __len__(&self) -> usize {
        self.0.count() as usize
    }

    // A scene never changes, so a copy is the scene itself.
    fn __copy__(this: Py<Self>) -> Py<Self> {
        this
    }

    fn __deepcopy__(this: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        this
    }

    fn __repr__(&self) -> String {
        format!(
            "<splatgraph.Scene: {} splats, harmonics of degree {}>",
            self.0.count(),
            self.0.effective_degree()
        )
    }
}

/// Moves a scene by the offset of `like`, and gives it the tags and the mesh of that scene.
fn alike(scene: assets::Scene, like: &assets::Scene) -> assets::Scene {
    let (offset, origin) = (scene.offset(), like.offset());
    let FileNotes { low_pass, key_of, up, .. } = like.notes();
    let notes = FileNotes { low_pass, key_of, up, ..scene.notes() };
    let moved = scene.with_offset(std::array::from_fn(|axis| offset[axis] + origin[axis])).with_notes(notes);
    let in_world = Similarity { translation: origin.into(), ..Similarity::IDENTITY };
    match like.mesh() {
        Some(mesh) => moved.beside(mesh, &in_world),
        None => moved,
    }
}

/// Rejects an array with a finite value that `is_wrong`. Splats with values that are not finite are dropped later.
///
/// `hint` names the usual cause: the logits or logarithms that files store.
fn check(array: &Array<f32>, is_wrong: impl Fn(f32) -> bool, expected: &str, hint: &str) -> PyResult<()> {
    let wrong = |value: &&f32| value.is_finite() && is_wrong(**value);
    let Some(first) = array.values.iter().find(wrong) else { return Ok(()) };
    let count = array.values.iter().filter(wrong).count();
    Err(PyValueError::new_err(format!("{expected}, found {count}, the first {first} (if they are {hint})")))
}

/// Centres of splats, [N, 3].
enum Means {
    Single(Array<f32>),
    /// Centres of an array that may have more precision than float32.
    Double(Array<f64>),
}

impl Means {
    fn take(means: &Bound<'_, PyAny>) -> PyResult<Means> {
        // The types of numpy's arrays and of torch's: `float32`, `torch.float32`.
        let kind = means.getattr("dtype").map(|kind| kind.to_string()).unwrap_or_default();
        let shape = [None, Some(3)];
        Ok(match kind.ends_with("float32") || kind.ends_with("float16") {
            true => Means::Single(take(means, "means", &shape)?),
            false => Means::Double(take(means, "means", &shape)?),
        })
    }

    fn count(&self) -> usize {
        match self {
            Means::Single(means) => means.shape[0],
            Means::Double(means) => means.shape[0],
        }
    }
}

fn three<T: Copy>(from: &[T], index: usize) -> [T; 3] {
    [from[3 * index], from[3 * index + 1], from[3 * index + 2]]
}
