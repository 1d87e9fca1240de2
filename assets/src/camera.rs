//! Reads and writes cameras in the format of the 3DGS reference implementation, `cameras.json`.
//!
//! A camera is a position, a rotation, a focal length and an image size; its principal point is the image's centre. Position
//! and rotation are camera-to-world, and the columns of the rotation are the camera's axes in the world: x right, y down,
//! z forward.

use crate::bounds::Bounds;
use crate::file;
use crate::scene::Scene;
use serde::de::{DeserializeSeed, Error as _, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use std::cell::Cell;
use std::path::{Path, PathBuf};

/// A pinhole camera. Unknown fields of the file are ignored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// The trainer's number of the camera.
    #[serde(default)]
    pub id: i64,
    /// The name of the camera's photograph.
    #[serde(default)]
    pub img_name: String,
    /// Image width, in pixels.
    pub width: u32,
    /// Image height, in pixels.
    pub height: u32,
    /// Centre of projection, in world units.
    pub position: [f64; 3],
    /// Camera-to-world rotation, row by row; the columns are right, down and forward.
    pub rotation: [[f64; 3]; 3],
    /// Horizontal focal length, in pixels.
    pub fx: f64,
    /// Vertical focal length, in pixels.
    pub fy: f64,
}

/// Bytes of a `cameras.json` at most: enough for half a million cameras.
pub const MAX_CAMERA_BYTES: u64 = 256 << 20;

/// An error of reading, writing or selecting cameras.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// The file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The text is not a list of cameras.
    #[error("{}:{line}:{column}: {}{message}", path.display(), in_camera(.camera))]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// Column, counted from 1.
        column: usize,
        /// Index of the camera with the error, from 0; `None` outside of the list's entries.
        camera: Option<usize>,
        /// The expectation and the finding.
        message: String,
    },
    /// `file#camera` matches none of the cameras.
    #[error("{} has no camera `{wanted}`: it has {count}, numbered from 0{}", path.display(), named(.names))]
    NotFound {
        /// The file.
        path: PathBuf,
        /// The requested index or name.
        wanted: String,
        /// Number of cameras in the file.
        count: usize,
        /// The first names in the file.
        names: Vec<String>,
    },
    /// The list is empty.
    #[error("{} has no cameras", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
}

fn in_camera(camera: &Option<usize>) -> String {
    camera.map(|index| format!("camera {index}: ")).unwrap_or_default()
}

fn named(names: &[String]) -> String {
    if names.is_empty() { String::new() } else { format!(" and named {}", names.join(", ")) }
}

impl Camera {
    /// Reads a `cameras.json` of at most [`MAX_CAMERA_BYTES`] bytes.
    ///
    /// # Errors
    /// Where the file cannot be read, is longer or not a regular file, or a camera in it is malformed: with line, column and the
    /// camera's index.
    pub fn load(path: impl AsRef<Path>) -> Result<Vec<Self>, CameraError> {
        let path = path.as_ref();
        let text = file::read_text(path, MAX_CAMERA_BYTES)
            .map_err(|source| CameraError::Io { path: path.to_owned(), source })?;
        Self::parse(&text, path)
    }

    /// Parses the text of a `cameras.json`; `path` appears only in errors.
    ///
    /// # Errors
    /// As [`Camera::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Vec<Self>, CameraError> {
        let reached = Cell::new(None);
        let mut json = serde_json::Deserializer::from_str(text);
        let cameras =
            List { reached: &reached }.deserialize(&mut json).and_then(|list| json.end().map(|()| list));
        cameras.map_err(|error| {
            // serde_json says the place again at the end of its message.
            let message = error.to_string();
            let place = format!(" at line {} column {}", error.line(), error.column());
            CameraError::Parse {
                path: path.to_owned(),
                line: error.line(),
                column: error.column(),
                camera: reached.get(),
                message: message.strip_suffix(&place).unwrap_or(&message).to_owned(),
            }
        })
    }

    /// Writes a `cameras.json`.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn save(cameras: &[Self], path: impl AsRef<Path>) -> Result<(), CameraError> {
        let path = path.as_ref();
        let io = |source| CameraError::Io { path: path.to_owned(), source };
        let mut text = serde_json::to_string_pretty(cameras).map_err(|e| io(e.into()))?;
        text.push('\n');
        std::fs::write(path, text).map_err(io)
    }

    /// Selects the camera of `file`, `file#2` (index from 0) or `file#name` (`img_name`); without `#`, the first.
    ///
    /// # Errors
    /// Those of [`Camera::load`], or there is no such camera.
    pub fn select(spec: &str) -> Result<Self, CameraError> {
        // A file whose own name has a `#` can be named too.
        let (path, wanted) = match spec.rsplit_once('#') {
            Some((path, wanted)) if !Path::new(spec).exists() => (Path::new(path), Some(wanted)),
            _ => (Path::new(spec), None),
        };
        let mut cameras = Self::load(path)?;
        if cameras.is_empty() {
            return Err(CameraError::Empty { path: path.to_owned() });
        }
        let Some(wanted) = wanted else { return Ok(cameras.swap_remove(0)) };
        let index = match wanted.parse::<usize>() {
            Ok(index) => Some(index).filter(|i| *i < cameras.len()),
            Err(_) => cameras.iter().position(|c| c.img_name == wanted),
        };
        match index {
            Some(index) => Ok(cameras.swap_remove(index)),
            None => Err(CameraError::NotFound {
                path: path.to_owned(),
                wanted: wanted.to_owned(),
                count: cameras.len(),
                names: cameras
                    .iter()
                    .map(|c| c.img_name.clone())
                    .filter(|name| !name.is_empty())
                    .take(8)
                    .collect(),
            }),
        }
    }

    /// Makes a camera at `eye` that looks at `target`, upright where the world's y points down.
    ///
    /// `horizontal_fov` is in degrees. For a view straight up or down, the camera's x axis is the world's.
    pub fn looking_at(
        eye: [f64; 3],
        target: [f64; 3],
        horizontal_fov: f64,
        (width, height): (u32, u32),
    ) -> Self {
        let eye = glam::DVec3::from(eye);
        let forward = (glam::DVec3::from(target) - eye).normalize_or(glam::DVec3::Z);
        let right = glam::DVec3::Y.cross(forward).normalize_or(glam::DVec3::X);
        let down = forward.cross(right);
        let focal = 0.5 * f64::from(width) / (0.5 * horizontal_fov.to_radians()).tan();
        Self {
            id: 0,
            img_name: String::new(),
            width,
            height,
            position: eye.into(),
            rotation: glam::DMat3::from_cols(right, down, forward).transpose().to_cols_array_2d(),
            fx: focal,
            fy: focal,
        }
    }

    /// Makes a camera that frames the bulk of a scene.
    ///
    /// It looks along +z and 12 degrees down (+y), from where the box [`Scene::robust_bounds`] fits with a margin of 8 %.
    /// The field of view is 60 degrees across the longer side.
    pub fn framing(scene: &Scene, width: u32, height: u32) -> Self {
        /// Downward slope of the view, in degrees.
        const PITCH: f64 = 12.0;
        /// Share of the image that the box may fill.
        const FILL: f64 = 0.92;
        let (width, height) = (width.max(1), height.max(1));
        let bounds = scene.robust_bounds();
        let center = glam::DVec3::from(bounds.center());
        let focal = 0.5 * f64::from(width.max(height)) / 30f64.to_radians().tan();
        let horizontal = 2.0 * (0.5 * f64::from(width) / focal).atan().to_degrees();
        let forward = glam::DVec3::new(0.0, PITCH.to_radians().sin(), PITCH.to_radians().cos());
        let mut camera = Self::looking_at([0.0; 3], forward.into(), horizontal, (width, height));
        let [tan_x, tan_y] = [width, height].map(|side| FILL * 0.5 * f64::from(side) / focal);
        // The distance at which each corner is inside the pyramid of the view.
        let distance = bounds.corners().into_iter().fold(0.0, |distance: f64, corner| {
            let v = camera.to_view((glam::DVec3::from(corner) - center).into());
            distance.max(v[0].abs() / tan_x - v[2]).max(v[1].abs() / tan_y - v[2])
        });
        // A scene that is a single point still needs to be in front of the near plane.
        camera.position = (center - forward * distance.max(1.0)).into();
        camera
    }

    /// Moves the camera into coordinates whose origin is at `origin`: from the world's into those of a scene with that
    /// [`Scene::offset`].
    pub fn relative_to(&self, origin: [f64; 3]) -> Self {
        Self { position: std::array::from_fn(|axis| self.position[axis] - origin[axis]), ..self.clone() }
    }

    /// Returns the camera's axes in the world: right, down and forward.
    pub fn axes(&self) -> [[f64; 3]; 3] {
        std::array::from_fn(|axis| std::array::from_fn(|row| self.rotation[row][axis]))
    }

    /// Transforms a point from world to camera space: right, down and forward of the camera.
    pub fn to_view(&self, point: [f64; 3]) -> [f64; 3] {
        self.axes().map(|axis| (0..3).map(|i| axis[i] * (point[i] - self.position[i])).sum())
    }

    /// Computes the least and greatest view depth of a box's corners; negative behind the camera.
    pub fn depth_range(&self, bounds: &Bounds) -> (f64, f64) {
        let depths = bounds.corners().map(|corner| self.to_view(corner)[2]);
        depths
            .into_iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(near, far), z| (near.min(z), far.max(z)))
    }

    /// Makes the camera of the same view in another image size; the vertical field of view stays.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let factor = f64::from(height) / f64::from(self.height);
        Self { width, height, fx: self.fx * factor, fy: self.fy * factor, ..self.clone() }
    }

    /// Describes the first reason that makes the camera unusable: its numbers contradict one another, or exceed f32, with which
    /// renderers compute.
    pub fn fault(&self) -> Option<String> {
        /// Largest deviation of the rotation from orthonormal: files have as few as three decimals.
        const TOLERANCE: f64 = 0.01;
        /// Smallest focal length, in pixels. Times 2^32 pixels, neither it nor its inverse leaves the range of f32.
        const LEAST: f64 = 1e-20;
        /// Largest coordinate, in world units. The square of a distance between two of them is within f32.
        const FARTHEST: f64 = 1e18;
        if self.width == 0 || self.height == 0 {
            return Some(format!("the image is {} x {} pixels", self.width, self.height));
        }
        for (name, focal) in [("fx", self.fx), ("fy", self.fy)] {
            if !(focal > 0.0 && focal.is_finite()) {
                return Some(format!("expected a positive {name}, found {focal}"));
            }
            // Its inverse, times a number of pixels, is computed with, too.
            if !(LEAST..=1.0 / LEAST).contains(&focal) {
                return Some(format!(
                    "expected {name} from {LEAST:e} to {:e} pixels, found {focal:e}",
                    1.0 / LEAST
                ));
            }
        }
        for (axis, value) in ["x", "y", "z"].into_iter().zip(self.position) {
            // Distances to it are squared and summed.
            if value.is_nan() || value.abs() > FARTHEST {
                return Some(format!(
                    "expected a position within {FARTHEST:e} of the origin, found {axis} = {value:e}"
                ));
            }
        }
        let axes = self.axes().map(glam::DVec3::from);
        for (i, a) in axes.iter().enumerate() {
            for (j, b) in axes.iter().enumerate().skip(i) {
                let (product, wanted) = (a.dot(*b), f64::from(i == j));
                // NaN is not within it.
                let within = (product - wanted).abs() <= TOLERANCE;
                if !within {
                    return Some(format!(
                        "the rotation is not orthonormal: column {i} times column {j} is {product:.4}, expected {wanted}"
                    ));
                }
            }
        }
        if axes[0].cross(axes[1]).dot(axes[2]) < 0.0 {
            return Some("the rotation mirrors: its determinant is -1".into());
        }
        None
    }
}

/// Deserialises the list camera by camera and records the current index for error messages.
struct List<'a> {
    reached: &'a Cell<Option<usize>>,
}

impl<'de> DeserializeSeed<'de> for List<'_> {
    type Value = Vec<Camera>;

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for List<'_> {
    type Value = Vec<Camera>;

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("a list of cameras")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut cameras = Vec::new();
        self.reached.set(Some(0));
        while let Some(camera) = list.next_element::<Camera>()? {
            if let Some(fault) = camera.fault() {
                return Err(A::Error::custom(fault));
            }
            cameras.push(camera);
            self.reached.set(Some(cameras.len()));
        }
        self.reached.set(None);
        Ok(cameras)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{captures, golden, splat};

    const ONE: &str = r#"{"id": 3, "img_name": "a", "width": 4, "height": 2, "position": [1, 2, 3.5], "lens": "x",
        "rotation": [[1,0,0],[0,1,0],[0,0,1]], "fx": 5.0, "fy": 6.0}"#;

    fn error(text: &str) -> String {
        Camera::parse(text, Path::new("c.json")).unwrap_err().to_string()
    }

    #[test]
    fn the_reference_form_is_read_and_fields_not_known_are_ignored() {
        let cameras = Camera::parse(&format!("[{ONE}, {ONE}]"), Path::new("c.json")).unwrap();
        assert_eq!(cameras.len(), 2);
        assert_eq!((cameras[1].id, cameras[1].position, cameras[1].fy), (3, [1.0, 2.0, 3.5], 6.0));
    }

    #[test]
    fn errors_say_line_column_and_which_camera() {
        let missing = error(&format!("[{ONE},\n{}]", ONE.replace("\"fx\"", "\"fz\"")));
        assert!(
            missing.starts_with("c.json:4:") && missing.contains("camera 1: missing field `fx`"),
            "{missing}"
        );
        let skew = error(&format!("[{}]", ONE.replace("[0,1,0]", "[0,1,0.5]")));
        assert!(
            skew.contains("c.json:2:") && skew.contains("camera 0: the rotation is not orthonormal"),
            "{skew}"
        );
        assert!(error(&format!("[{}]", ONE.replace("[1,0,0]", "[-1,0,0]"))).contains("mirrors"));
        assert!(error(&format!("[{}]", ONE.replace("5.0", "0"))).contains("positive fx"));
        assert!(error(&format!("[{}]", ONE.replace(": 4", ": 0"))).contains("0 x 2 pixels"));
        for (from, to, what) in [
            ("5.0", "1e40", "expected fx from 1e-20 to 1e20 pixels, found 1e40"),
            ("6.0", "1e-50", "expected fy from 1e-20 to 1e20 pixels, found "),
            ("3.5", "-1e40", "expected a position within 1e18 of the origin, found z = -1e40"),
            ("3.5", "1e999", "number out of range"),
        ] {
            let said = error(&format!("[{ONE}, {}]", ONE.replace(from, to)));
            assert!(said.contains("camera 1: ") && said.contains(what), "{said}");
        }
        assert!(error("{}").contains("expected a list of cameras"));
        assert!(error(&format!("[{ONE}] x")).contains("trailing"));
        assert!(error("").contains("EOF"));
    }

    #[test]
    fn a_camera_is_selected_by_number_or_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.json");
        let mut cameras = vec![Camera::looking_at([0.0; 3], [1.0, 0.5, 2.0], 60.0, (64, 32)); 3];
        for (i, camera) in cameras.iter_mut().enumerate() {
            (camera.id, camera.img_name) = (i as i64, format!("view-{i}"));
        }
        Camera::save(&cameras, &path).unwrap();
        assert_eq!(Camera::load(&path).unwrap(), cameras);
        let select = |suffix: &str| Camera::select(&format!("{}{suffix}", path.display()));
        assert_eq!(select("").unwrap(), cameras[0]);
        assert_eq!(select("#2").unwrap(), cameras[2]);
        assert_eq!(select("#view-1").unwrap(), cameras[1]);
        let missing = select("#3").unwrap_err().to_string();
        assert!(
            missing.contains("no camera `3`: it has 3, numbered from 0 and named view-0, view-1"),
            "{missing}"
        );
        Camera::save(&[], &path).unwrap();
        assert!(matches!(select(""), Err(CameraError::Empty { .. })));
    }

    #[cfg(unix)]
    #[test]
    fn cameras_that_never_end_or_never_come_are_refused_at_once() {
        let said = |path: &Path| Camera::load(path).unwrap_err().to_string();
        assert_eq!(said(Path::new("/dev/zero")), "/dev/zero: expected a regular file, found a device");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.json");
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        assert!(said(&path).ends_with("c.json: expected a regular file, found a FIFO"), "{}", said(&path));
        std::fs::remove_file(&path).unwrap();
        std::fs::File::create(&path).unwrap().set_len(MAX_CAMERA_BYTES + 1).unwrap();
        assert!(
            said(&path).contains("expected a file of at most 268435456 bytes, found 268435457"),
            "{}",
            said(&path)
        );
    }

    #[test]
    fn looking_at_a_point_puts_it_on_the_axis_with_the_world_upright() {
        let camera = Camera::looking_at([1.0, -2.0, 3.0], [4.0, 1.0, -2.0], 90.0, (200, 100));
        assert_eq!(camera.fault(), None);
        let v = camera.to_view([4.0, 1.0, -2.0]);
        assert!(v[0].abs() < 1e-12 && v[1].abs() < 1e-12 && (v[2] - 43f64.sqrt()).abs() < 1e-12);
        assert!(camera.axes()[1][1] > 0.0, "down in the image is down in the world");
        assert!((camera.fx - 100.0).abs() < 1e-9);
    }

    #[test]
    fn the_framing_camera_sees_every_corner_of_the_bulk_and_looks_down_a_little() {
        let scene = Scene::generate(5000, 0, splat);
        for (width, height) in [(960, 540), (300, 700)] {
            let camera = Camera::framing(&scene, width, height);
            assert_eq!(camera.fault(), None);
            let mut widest = 0.0f64;
            for corner in scene.robust_bounds().corners() {
                let [x, y, z] = camera.to_view(corner);
                assert!(z > 0.2);
                let (x, y) = (
                    x / z * camera.fx / (0.5 * f64::from(width)),
                    y / z * camera.fy / (0.5 * f64::from(height)),
                );
                widest = widest.max(x.abs()).max(y.abs());
            }
            assert!((0.9..0.93).contains(&widest), "{widest}");
            let forward = camera.axes()[2];
            assert!(forward[2] > 0.9 && forward[1] > 0.1, "{forward:?}");
        }
    }

    #[test]
    fn the_cameras_of_the_captures_are_read() {
        let check = |folder: &Path, name: &str| {
            let cameras = Camera::load(folder.join(format!("{name}.cameras.json"))).unwrap();
            assert!(cameras.len() >= 3);
            assert!(cameras.iter().enumerate().all(|(i, c)| c.img_name == format!("{name}-{i}")));
        };
        check(&golden(), "rules");
        let Some(captures) = captures("the_cameras_of_the_captures_are_read") else { return };
        ["biker", "playbot-31k"].iter().for_each(|name| check(&captures, name));
    }
}
