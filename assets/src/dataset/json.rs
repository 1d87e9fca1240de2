//! Reads the JSON formats of cameras: the 3DGS reference implementation's list, `transforms.json`, and nerfstudio's
//! `camera_path.json`.
//!
//! The poses of the last two transform camera coordinates (x right, y up, z backward) to world coordinates.
//! Values of a frame take precedence over the file's, and its focal lengths and angles replace all of the file's.
//! Sources: the Blender scenes of NeRF (`camera_angle_x`),
//! <https://docs.nerf.studio/quickstart/data_conventions.html>, and `get_path_from_json` of nerfstudio.

use super::alignment::{Applied, Matrix};
use super::colmap::{IDEAL, UNDISTORT, distorted_parameters};
use super::error::{CameraError, MAX_CAMERAS};
use super::photograph;
use super::view::{CameraOptions, Crop, Dataset, FrameTiming, TRAIN, View};
use crate::camera::{Camera, Entry, distortion};
use crate::composition::BYTE_ORDER_MARK;
use crate::projection::Projection;
use glam::{DMat3, EulerRot};
use serde::Deserialize;
use serde::de::{DeserializeSeed, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Value};
use std::cell::Cell;
use std::collections::HashSet;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

/// Parses a camera file: an object is a `transforms.json` or a `camera_path.json`, a list a `cameras.json`.
///
/// Sizes that the file lacks are those of the photographs, by default in the file's folder. `fallback` is the size if
/// no photograph can be read. Also returns the motion that the poses of a `transforms.json` contain; `None` for the
/// other formats, whose cameras are in the space of the scene.
pub(super) fn parse(
    text: &str,
    path: &Path,
    options: CameraOptions,
    fallback: Option<(u32, u32)>,
) -> Result<(Dataset, Option<Applied>), CameraError> {
    let text = text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text);
    let reached = Cell::new(None);
    let start = text.trim_start();
    let parsed = if start.starts_with('{') {
        transforms(text, path, options, fallback, &reached)
    } else if !start.is_empty() && !start.starts_with('[') {
        return Err(CameraError::UnknownFormat { path: path.to_owned() });
    } else {
        let view = |entry: Entry| {
            if !options.ignore_distortion
                && let Some((name, value)) = distortion(|name| entry.other(name))
            {
                return Err(distorted(name, value));
            }
            let model = entry.other("camera_model").and_then(Value::as_str).unwrap_or_default();
            if !options.ignore_distortion {
                refuse_parameters(model, entry.other("params"))?;
            }
            let found = entry.projection();
            if let Some(expected) = projection_of(model)
                && expected != found
            {
                return Err(format!(
                    "`projection`: expected {expected}, that of the `camera_model` {model}, found {found}"
                ));
            }
            let test = entry.other("test").and_then(Value::as_bool);
            let camera = Camera::try_from(entry)?;
            let (img_name, photograph) =
                (photograph::stem(&camera.img_name).to_owned(), camera.img_name.clone());
            Ok(View { camera: Camera { img_name, ..camera }, photograph, test })
        };
        let views = whole(text, List { reached: &reached, view, entry: PhantomData });
        views.map(|views| {
            let split = views.iter().any(|view| view.test.is_some()).then_some("test");
            (Dataset { views, split, ..Dataset::default() }, None)
        })
    };
    parsed.map_err(|error| {
        // serde_json appends the line and column to its message.
        let message = error.to_string();
        let place = format!(" at line {} column {}", error.line(), error.column());
        let message = message.strip_suffix(&place).unwrap_or(&message);
        let lost = lost_pose(text, &error);
        let message = lost.as_deref().unwrap_or(message);
        let camera = reached.get().map(|index| format!("camera {index}: ")).unwrap_or_default();
        let place = format!(":{}:{}", error.line(), error.column());
        // `ns-export cameras` of nerfstudio writes a list of names and poses.
        let is_exported = message.starts_with("missing field") && text.contains("\"file_path\"");
        let advice = match is_exported && start.starts_with('[') {
            true => "; for a list of poses without lenses, name the transforms.json of the training instead",
            false => "",
        };
        CameraError::invalid(path, place, format!("{camera}{message}{advice}"))
    })
}

/// Describes a number that is not finite, as trackers write it into the poses of lost frames; `None` for other errors.
fn lost_pose(text: &str, error: &serde_json::Error) -> Option<String> {
    let lines = text.split_inclusive('\n').take(error.line().checked_sub(1)?);
    let at = lines.map(str::len).sum::<usize>() + error.column().checked_sub(1)?;
    let (before, rest) = text.split_at_checked(at)?;
    let is_null = error.to_string().starts_with("invalid type: null, expected f64");
    let sign = if before.ends_with('-') { "-" } else { "" };
    let found =
        ["NaN", "Infinity"].into_iter().find(|word| rest.starts_with(word)).or(is_null.then_some("null"))?;
    // Numbers of a pose are in nested lists, without texts in between.
    let field = before.rsplit('"').nth(1)?;
    Some(format!("`{field}`: expected a number, found {sign}{found}; leave out frames without a pose"))
}

/// Deserialises a text, and returns an error if anything follows the value.
fn whole<'de, S: DeserializeSeed<'de>>(text: &'de str, seed: S) -> serde_json::Result<S::Value> {
    let mut json = serde_json::Deserializer::from_str(text);
    let value = seed.deserialize(&mut json)?;
    json.end().map(|()| value)
}

/// A deserialiser of a list, entry by entry, so that an error has the line and index of its entry.
struct List<'a, T, F> {
    reached: &'a Cell<Option<usize>>,
    view: F,
    entry: PhantomData<T>,
}

impl<'de, T: Deserialize<'de>, F: FnMut(T) -> Result<View, String>> DeserializeSeed<'de> for List<'_, T, F> {
    type Value = Vec<View>;

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, T: Deserialize<'de>, F: FnMut(T) -> Result<View, String>> Visitor<'de> for List<'_, T, F> {
    type Value = Vec<View>;

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("a list of cameras")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut views = Vec::new();
        self.reached.set(Some(0));
        while let Some(entry) = list.next_element::<T>()? {
            let mut view = (self.view)(entry).map_err(A::Error::custom)?;
            if let Some(fault) = view.camera.fault() {
                return Err(A::Error::custom(fault));
            }
            view.camera.straighten();
            if views.len() == MAX_CAMERAS {
                return Err(A::Error::custom(format!("expected at most {MAX_CAMERAS} cameras, found more")));
            }
            views.push(view);
            self.reached.set(Some(views.len()));
        }
        self.reached.set(None);
        Ok(views)
    }
}

/// The values of a `transforms.json`: the file's or a frame's.
#[derive(Clone, Default, Deserialize)]
#[serde(default)]
struct Fields {
    /// Horizontal field of view, in radians.
    camera_angle_x: Option<f64>,
    /// Vertical field of view, in radians.
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    // instant-ngp writes sizes as floating-point numbers.
    w: Option<f64>,
    h: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    /// Image that marks the pixels to ignore.
    mask_path: Option<IgnoredAny>,
    file_path: Option<String>,
    #[serde(alias = "camera_to_world")]
    transform_matrix: Option<Matrix>,
    applied_transform: Option<Matrix>,
    applied_scale: Option<f64>,
    // Lists of photographs, in nerfstudio's files.
    test_filenames: Option<HashSet<PathBuf>>,
    val_filenames: Option<HashSet<PathBuf>>,
    train_filenames: Option<HashSet<PathBuf>>,
    /// The list that determines the test views, with its name.
    #[serde(skip)]
    split: Option<(&'static str, HashSet<PathBuf>)>,
    // The fields of a `camera_path.json`; `fov` is vertical, in degrees.
    camera_type: Option<String>,
    render_width: Option<f64>,
    render_height: Option<f64>,
    fov: Option<f64>,
    // The list of cameras, which is read entry by entry.
    frames: Option<IgnoredAny>,
    camera_path: Option<IgnoredAny>,
    /// The other fields, among them the lens's distortion.
    #[serde(flatten)]
    others: Map<String, Value>,
}

impl Fields {
    /// Returns true for the values of a `camera_path.json`.
    fn is_path(&self) -> bool {
        self.render_width.is_some()
    }

    fn has_focal(&self) -> bool {
        self.fl_x.or(self.fl_y).or(self.camera_angle_x).or(self.camera_angle_y).is_some()
    }

    /// Takes the list that determines the test views: the first that is not empty.
    fn take_split(&mut self) -> Option<(&'static str, HashSet<PathBuf>)> {
        let lists = [
            ("test_filenames", self.test_filenames.take()),
            ("val_filenames", self.val_filenames.take()),
            (TRAIN, self.train_filenames.take()),
        ];
        let mut lists = lists.into_iter().filter_map(|(field, names)| Some((field, names?)));
        let first = lists.next()?;
        let (field, names) = if first.1.is_empty() {
            lists.find(|(_, names)| !names.is_empty()).unwrap_or(first)
        } else {
            first
        };
        Some((field, names.iter().map(|name| plain(name).to_owned()).collect()))
    }

    /// Converts a frame of a `camera_path.json`, which names no photograph, to one of a `transforms.json`. `file` has
    /// the file's values.
    fn of_path(self, file: &Self) -> Self {
        let focal = |fov: f64| 0.5 * file.render_height.unwrap_or_default() / (0.5 * fov.to_radians()).tan();
        let model = match file.camera_type.as_deref() {
            None | Some("perspective") => "PINHOLE",
            Some("fisheye") => "OPENCV_FISHEYE",
            Some("equirectangular") => "EQUIRECTANGULAR",
            Some(other) => other,
        };
        Self {
            w: file.render_width,
            h: file.render_height,
            fl_x: self.fov.map(focal),
            camera_model: Some(model.to_owned()),
            file_path: Some(String::new()),
            ..self
        }
    }
}

/// Returns a field's value from the frame if it has one, else from the file.
macro_rules! either {
    ($name:ident of $frame:expr, $file:expr) => {
        $frame.$name.or($file.$name)
    };
}

/// Returns a path without a leading `./`.
fn plain(path: &Path) -> &Path {
    path.strip_prefix(".").unwrap_or(path)
}

fn distorted(name: &str, value: f64) -> String {
    format!("`{name}`: expected 0, a lens without distortion, found {value}; {UNDISTORT}{IDEAL}")
}

/// Refuses distortion in the list of parameters beside a `camera_model`, which has COLMAP's order.
fn refuse_parameters(model: &str, parameters: Option<&Value>) -> Result<(), String> {
    let numbers = |list: &Value| Some(list.as_array()?.iter().filter_map(Value::as_f64).collect::<Vec<_>>());
    let fault = parameters.and_then(numbers).and_then(|numbers| distorted_parameters(model, &numbers));
    fault.map_or(Ok(()), |fault| Err(format!("`params`: {fault}")))
}

/// Returns the projection of a camera model without its distortion; `None` if it is not supported.
fn projection_of(model: &str) -> Option<Projection> {
    match model {
        "OPENCV_FISHEYE" => Some(Projection::Fisheye),
        "EQUIRECTANGULAR" => Some(Projection::Equirectangular),
        "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" | "FULL_OPENCV" => {
            Some(Projection::Pinhole)
        }
        _ => None,
    }
}

/// Converts a frame to a view. `size` returns the size of a photograph, for a view whose size the file lacks. Fails if
/// a field is missing or wrong, or the lens is not supported.
fn view(
    frame: &Fields,
    file: &Fields,
    ignore_distortion: bool,
    size: impl FnOnce(&str) -> Result<(u32, u32), String>,
) -> Result<View, String> {
    let photograph = frame.file_path.as_deref().ok_or("missing field `file_path`")?;
    let Some(Matrix(matrix)) = &frame.transform_matrix else {
        return Err("missing field `transform_matrix`".into());
    };
    let model = frame.camera_model.as_deref().or(file.camera_model.as_deref()).unwrap_or("PINHOLE");
    let is_fisheye = either!(is_fisheye of frame, file).unwrap_or_default();
    let projection = match projection_of(model) {
        Some(Projection::Pinhole) if is_fisheye => Projection::Fisheye,
        Some(projection) => projection,
        None if file.is_path() => {
            return Err(format!(
                "`camera_type`: expected perspective, fisheye or equirectangular, found {model}; draw the views of two eyes as two cameras"
            ));
        }
        None => {
            return Err(format!(
                "`camera_model`: expected PINHOLE, OPENCV_FISHEYE, EQUIRECTANGULAR or another model without distortion, found {model}; {UNDISTORT}"
            ));
        }
    };
    let other = |name: &str| frame.others.get(name).filter(|v| !v.is_null()).or(file.others.get(name));
    if !ignore_distortion {
        if let Some((name, value)) = distortion(other) {
            return Err(distorted(name, value));
        }
        refuse_parameters(model, other("params"))?;
    }
    let sides = [("w", either!(w of frame, file)), ("h", either!(h of frame, file))];
    let (width, height) = match sides.map(|(_, side)| side) {
        [None, None] => size(photograph)?,
        _ => {
            let side = |(name, side): (&str, Option<f64>)| match side {
                Some(side) if (1.0..=f64::from(u32::MAX)).contains(&side) && side.fract() == 0.0 => {
                    Ok(side as u32)
                }
                Some(side) => Err(format!("`{name}`: expected a number of pixels, found {side}")),
                None => Err(format!("missing field `{name}`")),
            };
            (side(sides[0])?, side(sides[1])?)
        }
    };
    let of_angle = |side: u32, angle: f64| match projection {
        Projection::Fisheye => f64::from(side) / angle,
        _ => 0.5 * f64::from(side) / (0.5 * angle).tan(),
    };
    // One focal length of the frame and one of the file would be of two lenses.
    let lens = if frame.has_focal() { frame } else { file };
    let has_own_size = [(frame.w, file.w), (frame.h, file.h)]
        .into_iter()
        .any(|(own, shared)| own.zip(shared).is_some_and(|(own, shared)| own != shared));
    if has_own_size {
        let shared = [
            ("fl_x", file.fl_x.or(file.fl_y).filter(|_| !frame.has_focal())),
            ("cx", file.cx.filter(|_| frame.cx.is_none())),
            ("cy", file.cy.filter(|_| frame.cy.is_none())),
        ];
        if let Some((name, value)) = shared.into_iter().find_map(|(name, value)| Some((name, value?))) {
            return Err(format!(
                "`{name}`: expected one in the frame, whose size is not the file's, found the file's {value}"
            ));
        }
    }
    let fx = lens.fl_x.or_else(|| lens.camera_angle_x.map(|angle| of_angle(width, angle)));
    let fy = lens.fl_y.or_else(|| lens.camera_angle_y.map(|angle| of_angle(height, angle)));
    let panorama =
        (projection == Projection::Equirectangular).then(|| f64::from(width) / std::f64::consts::TAU);
    let fx = fx.or(panorama).ok_or("missing field `fl_x`, or `camera_angle_x`")?;
    let center = [either!(cx of frame, file), either!(cy of frame, file)];
    let camera = Camera {
        id: 0,
        img_name: photograph::stem(photograph).to_owned(),
        width,
        height,
        position: [0, 1, 2].map(|row| matrix[row][3]),
        // Converts the axes up and backward to down and forward.
        rotation: [0, 1, 2].map(|row| [matrix[row][0], -matrix[row][1], -matrix[row][2]]),
        fx,
        fy: fy.unwrap_or(fx),
        principal_offset: Camera::offset_of(center, [width, height]),
        projection,
    };
    let is_listed = |names: &HashSet<PathBuf>| names.contains(plain(Path::new(photograph)));
    let test = file.split.as_ref().map(|(field, names)| is_listed(names) != (*field == TRAIN));
    Ok(View { camera, photograph: photograph.to_owned(), test })
}

/// Reads the size of a frame's photograph.
fn size_of(folder: &Path, photograph: &str) -> Result<(u32, u32), String> {
    let path = photograph::find(folder, photograph).map_err(|error| {
        format!(
            "missing fields `w` and `h`, the size in pixels, and its photograph: {error}; add for instance \"w\": 800, \"h\": 800"
        )
    })?;
    photograph::size(&path).map_err(|error| format!("`file_path`: {}: {error}", path.display()))
}

/// Reads a `transforms.json`, with the motion that its poses contain, or a `camera_path.json`. The file's own values,
/// which may follow its frames, are read first.
fn transforms(
    text: &str,
    path: &Path,
    options: CameraOptions,
    fallback: Option<(u32, u32)>,
    reached: &Cell<Option<usize>>,
) -> serde_json::Result<(Dataset, Option<Applied>)> {
    let mut file: Fields = serde_json::from_str(text).inspect_err(|error| {
        // Only a list of cameras counts them.
        let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 90.0, (1, 1));
        let view = |_: IgnoredAny| Ok(View { camera: camera.clone(), photograph: String::new(), test: None });
        if error.is_syntax() {
            whole(text, Frames(List { reached, view, entry: PhantomData })).unwrap_or_default();
        }
    })?;
    file.split = file.take_split();
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    // A lost photograph, missing or damaged, has the size of the first readable one. Before that one is found, its size
    // is unknown, so the frames are read again.
    let (first, is_lost) = (Cell::new(None), Cell::new(false));
    let size =
        |photograph: &str, is_last: bool| match size_of(options.photographs.unwrap_or(&folder), photograph) {
            Ok(size) => {
                first.set(first.get().or(Some(size)));
                Ok(size)
            }
            Err(error) => match first.get() {
                Some(size) => Ok(size),
                None if is_last => fallback.ok_or(error),
                None => {
                    is_lost.set(true);
                    Ok((1, 1))
                }
            },
        };
    let read = |is_last: bool| {
        let mut has_masks = file.mask_path.is_some();
        let view = |frame: Fields| {
            has_masks |= frame.mask_path.is_some();
            let frame = if file.is_path() { frame.of_path(&file) } else { frame };
            view(&frame, &file, options.ignore_distortion, |photograph| size(photograph, is_last))
        };
        let views = whole(text, Frames(List { reached, view, entry: PhantomData }))?;
        serde_json::Result::Ok(Dataset { views, has_masks, ..Dataset::default() })
    };
    let mut dataset = read(false)?;
    if is_lost.get() {
        dataset = read(true)?;
    }
    for (view, id) in dataset.views.iter_mut().zip(0..) {
        view.camera.id = id;
    }
    let is_path = file.is_path();
    if let Some((field, mut names)) = file.split {
        dataset.split = Some(field);
        for view in &dataset.views {
            names.remove(plain(Path::new(&view.photograph)));
        }
        dataset.unmatched = names.into_iter().map(|name| name.display().to_string()).collect();
        dataset.unmatched.sort();
    }
    let timing = is_path.then(|| FrameTiming {
        fps: path_rate(&file.others, dataset.views.len()),
        is_cycle: file.others.get("is_cycle").and_then(Value::as_bool).unwrap_or_default(),
    });
    let crop = file.others.get("crop").filter(|_| is_path).and_then(crop);
    // A path is in the space of the scene.
    let applied = (!is_path).then_some(Applied {
        // nerfstudio assumes this one for files of COLMAP's poses that were written before the field existed.
        transform: file.applied_transform.or_else(|| {
            let swapped = [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]];
            folder.join("colmap/sparse/0").is_dir().then_some(Matrix(swapped))
        }),
        scale: file.applied_scale,
    });
    Ok((Dataset { photographs: Some(folder), timing, crop, ..dataset }, applied))
}

/// Returns the frames per second of a `camera_path.json` with `count` frames. nerfstudio plays them in `seconds`, which
/// its viewer writes rounded to whole frames of `fps`.
fn path_rate(fields: &Map<String, Value>, count: usize) -> Option<f64> {
    let number = |name: &str| fields.get(name).and_then(Value::as_f64);
    let (fps, seconds) = (number("fps"), number("seconds").filter(|seconds| *seconds > 0.0));
    let is_other = |seconds: &f64| fps.is_none_or(|fps| (fps * seconds - count as f64).abs() > 1.0);
    seconds.filter(is_other).map(|seconds| count as f64 / seconds).or(fps)
}

/// Reads the crop of a `camera_path.json`: see `get_crop_from_json` and `OrientedBox` of nerfstudio. `None` if it is
/// malformed.
fn crop(value: &Value) -> Option<Crop> {
    let numbers = |name: &str| <[f64; 3]>::deserialize(value.get(name)?).ok();
    let [roll, pitch, yaw] = if value.get("crop_rot").is_some() { numbers("crop_rot")? } else { [0.0; 3] };
    let channel = |name: &str| Some(value.get("crop_bg_color")?.get(name)?.as_f64()? / 255.0);
    Some(Crop {
        center: numbers("crop_center")?,
        axes: DMat3::from_euler(EulerRot::ZYX, yaw, pitch, roll).to_cols_array_2d(),
        size: numbers("crop_scale")?,
        background: [channel("r")?, channel("g")?, channel("b")?],
    })
}

struct Frames<'a, T, F>(List<'a, T, F>);

impl<'de, T: Deserialize<'de>, F: FnMut(T) -> Result<View, String>> DeserializeSeed<'de>
    for Frames<'_, T, F>
{
    type Value = Vec<View>;

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de, T: Deserialize<'de>, F: FnMut(T) -> Result<View, String>> Visitor<'de> for Frames<'_, T, F> {
    type Value = Vec<View>;

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("a list of cameras, or an object with `frames` or `camera_path`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut list, mut views, mut is_selection) = (Some(self.0), None, false);
        while let Some(key) = map.next_key::<String>()? {
            is_selection |= key == "indices";
            match list.take_if(|_| key == "frames" || key == "camera_path") {
                Some(list) => views = Some(map.next_value_seed(list)?),
                None => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        views.ok_or_else(|| {
            let found = match is_selection {
                true => "a selection of splats, which `splatgraph convert --keep` and `--remove` take",
                false => "an object without them",
            };
            A::Error::custom(format_args!(
                "expected a list of cameras, or an object with `frames` or `camera_path`, found {found}"
            ))
        })
    }
}
