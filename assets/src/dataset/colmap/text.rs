//! Reads and writes `cameras.txt` and `images.txt`. A line that begins with `#` is a comment.

use super::lens::{Fault, Lenses, MODELS, open, push};
use crate::camera::Camera;
use crate::dataset::error::CameraError;
use crate::dataset::view::Dataset;
use crate::error::nearest;
use crate::projection::Projection;
use glam::{DMat3, DQuat, DVec3};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::str::FromStr;

/// Maximum length of a line in bytes, without the line feed. Lines of points are skipped, and can be longer.
const MAX_LINE: u64 = 64 << 10;

struct Lines<'a> {
    file: BufReader<File>,
    path: &'a Path,
    number: u64,
    line: Vec<u8>,
}

impl<'a> Lines<'a> {
    fn open(path: &'a Path) -> Result<Self, CameraError> {
        Ok(Self { file: open(path)?.0, path, number: 0, line: Vec::new() })
    }

    fn fault(&self, (field, message): Fault) -> CameraError {
        CameraError::invalid(self.path, format!(":{}: `{field}`", self.number), message)
    }

    /// Reads the next line that is neither empty nor a comment; false at the end of the file.
    fn next(&mut self) -> Result<bool, CameraError> {
        loop {
            if self.read()? {
                return Err(self.fault(("line", format!("expected at most {MAX_LINE} bytes, found more"))));
            }
            if self.line.is_empty() {
                return Ok(false);
            }
            if !self.line.starts_with(b"#") && !self.line.trim_ascii().is_empty() {
                return Ok(true);
            }
        }
    }

    /// Reads the next line with its line feed; nothing at the end of the file. Returns true if the line is too long and
    /// was cut.
    fn read(&mut self) -> Result<bool, CameraError> {
        self.line.clear();
        self.number += 1;
        let mut line = (&mut self.file).take(MAX_LINE + 1);
        let read = line.read_until(b'\n', &mut self.line).map_err(CameraError::io(self.path))?;
        Ok(read as u64 > MAX_LINE && !self.line.ends_with(b"\n"))
    }

    /// Skips the line of an image's points: triples of numbers, or nothing. Only its first bytes are checked.
    fn skip_points(&mut self) -> Result<(), CameraError> {
        let is_cut = self.read()?;
        let text = String::from_utf8_lossy(&self.line);
        let mut words: Vec<&str> = text.split_ascii_whitespace().collect();
        if is_cut {
            // The last word may be cut, too.
            words.pop();
        }
        let other = words.iter().find(|word| word.parse::<f64>().is_err());
        let found = match other {
            Some(word) => format!("found `{}`", word.chars().take(60).collect::<String>()),
            None if !is_cut && !words.len().is_multiple_of(3) => format!("found {} numbers", words.len()),
            None => {
                return match is_cut {
                    true => self.file.skip_until(b'\n').map(drop).map_err(CameraError::io(self.path)),
                    false => Ok(()),
                };
            }
        };
        let expected = "expected the points of the image above as triples X, Y, POINT3D_ID, or an empty line";
        Err(self.fault(("POINTS2D", format!("{expected}, {found}"))))
    }

    fn text(&self) -> Result<&str, CameraError> {
        let text = str::from_utf8(self.line.trim_ascii());
        text.map_err(|error| {
            self.fault((
                "line",
                format!("expected UTF-8 text, found another byte in column {}", error.valid_up_to() + 1),
            ))
        })
    }
}

/// Parses the first word of `rest`, and removes it.
fn value<T: FromStr>(rest: &mut &str, field: &'static str) -> Result<T, Fault> {
    let word = word(rest, field)?;
    word.parse().map_err(|_| (field, format!("expected a number, found `{word}`")))
}

fn word<'a>(rest: &mut &'a str, field: &'static str) -> Result<&'a str, Fault> {
    let text = rest.trim_ascii_start();
    if text.is_empty() {
        return Err((field, "expected a value, found the end of the line".into()));
    }
    let (word, after) = text.split_at(text.find(|c: char| c.is_ascii_whitespace()).unwrap_or(text.len()));
    *rest = after;
    Ok(word)
}

pub(super) fn lenses(path: &Path, ignore_distortion: bool) -> Result<Lenses, CameraError> {
    let mut lines = Lines::open(path)?;
    let mut lenses = Lenses::new();
    while lines.next()? {
        let mut rest = lines.text()?;
        let mut entry = || {
            let id = value(&mut rest, "CAMERA_ID")?;
            let name = word(&mut rest, "MODEL")?;
            let model = MODELS.iter().find(|model| model.name == name).ok_or_else(|| {
                let help = nearest(name, MODELS.iter().map(|model| model.name));
                let help = help.map(|help| format!("; did you mean {help}?")).unwrap_or_default();
                ("MODEL", format!("expected a model of a camera, for instance PINHOLE, found `{name}`{help}"))
            })?;
            let projection = model.projection()?;
            let [width, height] = [value(&mut rest, "WIDTH")?, value(&mut rest, "HEIGHT")?];
            let mut values = [0.0; 12];
            for (number, name) in values.iter_mut().zip(model.parameters) {
                *number = value(&mut rest, name)?;
            }
            Ok((id, model.lens(projection, (width, height), &values, ignore_distortion)?))
        };
        let (id, lens) = entry().map_err(|fault| lines.fault(fault))?;
        lenses.insert(id, lens);
    }
    Ok(lenses)
}

/// Reads `images.txt` into a dataset: one line per image, followed by a line of points, which may be empty.
pub(super) fn images(path: &Path, lenses: &Lenses, dataset: &mut Dataset) -> Result<(), CameraError> {
    let mut lines = Lines::open(path)?;
    while lines.next()? {
        let mut rest = lines.text()?;
        let mut entry = || {
            let id = value(&mut rest, "IMAGE_ID")?;
            let mut pose = [0.0; 7];
            for (number, name) in pose.iter_mut().zip(["QW", "QX", "QY", "QZ", "TX", "TY", "TZ"]) {
                *number = value(&mut rest, name)?;
            }
            let lens = value(&mut rest, "CAMERA_ID")?;
            // A name can contain blanks.
            let name = rest.trim_ascii();
            if name.is_empty() {
                return Err(("NAME", "expected a value, found the end of the line".into()));
            }
            let [w, x, y, z, translation @ ..] = pose;
            push(dataset, lenses, (id, lens), ([w, x, y, z], translation), name.to_owned())
        };
        entry().map_err(|fault| lines.fault(fault))?;
        lines.skip_points()?;
    }
    Ok(())
}

/// Formats the files of a model, with their names. Each camera gets its own lens. Fails for projections other than
/// pinhole and fisheye.
pub(in crate::dataset) fn write(
    cameras: &[Camera],
    extension: &str,
) -> Result<[(&'static str, String); 3], CameraError> {
    let mut lenses = String::from("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
    let mut images = String::from(
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n",
    );
    for (camera, id) in cameras.iter().zip(1..) {
        let Camera { width, height, fx, fy, .. } = camera;
        let [cx, cy] = camera.principal_point();
        let to_camera = DMat3::from_cols_array_2d(&camera.rotation);
        let DQuat { x, y, z, w } = DQuat::from_mat3(&to_camera);
        let [tx, ty, tz] = (to_camera * -DVec3::from(camera.position)).to_array();
        // The coefficients of a fisheye are zero: COLMAP's model without distortion is equidistant.
        let (model, coefficients) = match camera.projection {
            Projection::Pinhole => ("PINHOLE", ""),
            Projection::Fisheye => ("OPENCV_FISHEYE", " 0 0 0 0"),
            projection @ (Projection::Orthographic | Projection::Equirectangular) => {
                return Err(CameraError::NoModel { name: camera.img_name.clone(), projection });
            }
        };
        _ = writeln!(lenses, "{id} {model} {width} {height} {fx} {fy} {cx} {cy}{coefficients}");
        let name = &camera.img_name;
        _ = writeln!(images, "{id} {w} {x} {y} {z} {tx} {ty} {tz} {id} {name}.{extension}\n");
    }
    let points = "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n".into();
    Ok([("cameras.txt", lenses), ("images.txt", images), ("points3D.txt", points)])
}
