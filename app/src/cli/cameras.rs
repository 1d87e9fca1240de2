//! Finds the cameras of a command: from `--cameras`, or the first camera of the file beside the scene.

use super::outcome::Usage;
use crate::draw::camera;
use crate::draw::orbit;
use crate::io::output::{OutputGuard, is_standard_output, one_line, say, shell_word};
use anyhow::{Result, bail};
use serde_json::Value as Json;
use splatgraph_assets::{Camera, CameraError, CameraOptions, Crop, Dataset, FrameTiming, Projection, View};
use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

/// Maximum width and height of a picture, in pixels.
pub const MAX_SIDE: u32 = 32_768;

fn beside(spec: Option<&str>, scene: Option<&Path>) -> Option<PathBuf> {
    scene.filter(|_| spec.is_none()).and_then(camera::beside)
}

/// Loads all cameras of `--cameras`, or else the first camera of the file beside the scene.
///
/// Prints which file beside the scene is used, or why it is not. Returns `None` if there is no such file, or it is not
/// usable.
///
/// # Errors
/// `spec` is invalid, cannot be read, or has no cameras; see [`parse`].
pub fn load(
    spec: Option<&str>,
    scene: Option<&Path>,
    ignore_distortion: bool,
) -> Result<Option<Vec<Camera>>> {
    if let Some(spec) = spec {
        return Ok(Some(parse(spec, ignore_distortion)?));
    }
    let Some(file) = beside(spec, scene) else { return Ok(None) };
    let Some(mut all) = load_beside(&file) else { return Ok(None) };
    let file_name = file.display();
    let others = match all.len() {
        1 => String::new(),
        count => format!(" of {count}; --cameras {} takes all", shell_word(&file_name.to_string())),
    };
    say(format!("the camera is the first of {file_name}{others}"));
    all.truncate(1);
    Ok(Some(all))
}

/// Loads cameras as [`load`] does, for pictures of `size`, or of the cameras' own sizes if it is `None`. The cameras
/// are not resized.
///
/// # Errors
/// The errors of [`load`] and, without `size`, of [`check_size`].
pub fn load_sized(
    spec: Option<&str>,
    scene: Option<&Path>,
    size: Option<(u32, u32)>,
    ignore_distortion: bool,
) -> Result<Option<Vec<Camera>>> {
    let given = load(spec, scene, ignore_distortion)?;
    given.iter().flatten().filter(|_| size.is_none()).try_for_each(check_size)?;
    Ok(given)
}

/// Rejects a camera whose picture is wider or higher than [`MAX_SIDE`].
pub fn check_size(camera: &Camera) -> Result<()> {
    if camera.width.max(camera.height) > MAX_SIDE {
        bail!(
            "the camera {}: expected a picture of at most {MAX_SIDE} x {MAX_SIDE} pixels, found {} x {}",
            one_line(&camera.img_name),
            camera.width,
            camera.height
        );
    }
    Ok(())
}

/// Loads all cameras of a file beside the scene. If they are not usable, prints why and returns `None`.
pub fn load_beside(file: &Path) -> Option<Vec<Camera>> {
    let told = |error: &CameraError| say(format!("the cameras beside the scene are not used: {error}"));
    let cameras = Camera::load(file).and_then(|cameras| match cameras.is_empty() {
        true => Err(CameraError::Empty { path: file.into() }),
        false => Ok(cameras),
    });
    cameras.inspect_err(told).ok()
}

/// Registers the files of `--cameras` and their photographs, or else the file beside the scene, as inputs. No output
/// can then overwrite them.
pub fn claim(guard: &mut OutputGuard, spec: Option<&str>, scene: Option<&Path>) -> Result<(), Usage> {
    if let Some(spec) = spec {
        return claim_file(guard, spec);
    }
    match beside(spec, scene) {
        Some(file) => Ok(guard.input("the cameras", &file)?),
        None => Ok(()),
    }
}

fn is_json(spec: &str) -> bool {
    spec.trim_start().starts_with(['[', '{']) && !Path::new(spec).exists()
}

/// Loads cameras as [`read`] does, without their photographs.
///
/// # Errors
/// The errors of [`read`].
pub fn parse(spec: &str, ignore_distortion: bool) -> Result<Vec<Camera>, CameraError> {
    read(spec, ignore_distortion).map(Dataset::into_cameras)
}

/// Loads the cameras of `PATH`, `PATH#INDEX` or `PATH#NAME` in any format of [`Dataset`], or parses the JSON text of
/// such a file. Prints the notes of [`tell_alignment`], and that an animation is not read.
///
/// # Errors
/// The file or the text is invalid, or has no cameras.
pub fn read(spec: &str, ignore_distortion: bool) -> Result<Dataset, CameraError> {
    let options = CameraOptions { ignore_distortion, ..CameraOptions::default() };
    if is_json(spec) {
        let name = Path::new("--cameras");
        let dataset = Dataset::parse_with(spec, name, options)?;
        let is_empty = dataset.views.is_empty();
        return if is_empty { Err(CameraError::Empty { path: name.into() }) } else { Ok(dataset) };
    }
    if spec.is_empty() {
        let source = io::Error::new(io::ErrorKind::InvalidInput, "expected a file, found an empty name");
        return Err(CameraError::Io { path: "--cameras".into(), source });
    }
    let dataset = Dataset::select(spec, options)?;
    tell_alignment(&dataset);
    if dataset.has_animation {
        say("the animation of the cameras is not read: each is drawn where its node is without it");
    }
    dataset
        .crop
        .iter()
        .map(crop_options)
        .for_each(|options| say(format!("the crop is not read: `{options}` is the same")));
    Ok(dataset)
}

/// Formats the options that crop a scene.
fn crop_options(crop: &Crop) -> String {
    // Rounding hides the errors of the rotation.
    let rounded = |v: f64| (v * 1e9).round() / 1e9 + 0.0;
    let side = |(axis, length): (&[f64; 3], f64)| {
        let term = |(v, name): (&f64, &str)| match rounded(*v) {
            0.0 => None,
            1.0 => Some(name.to_owned()),
            v => Some(format!("{v}*{name}")),
        };
        let terms: Vec<String> = axis.iter().zip(["x", "y", "z"]).filter_map(term).collect();
        let middle: f64 = axis.iter().zip(crop.center).map(|(a, b)| a * b).sum();
        let [low, high] = [-0.5, 0.5].map(|half| rounded(middle + half * length));
        let along = terms.join(" + ");
        format!("{along} > {low} && {along} < {high}")
    };
    let sides: Vec<String> = crop.axes.iter().zip(crop.size).map(side).collect();
    let [red, green, blue] = crop.background.map(|v| rounded(v) as f32);
    format!("--where '{}' --background {red},{green},{blue}", sides.join(" && "))
}

/// Tells the user how a dataset was read: which file moved the cameras, and which of COLMAP's models are not read. Also
/// tells if several views have the name of the selected one.
pub fn tell_alignment(dataset: &Dataset) {
    if let Some(file) = &dataset.alignment {
        say(format!("the cameras are moved to the space of nerfstudio's scene, by {}", file.display()));
    }
    if let [other, more @ ..] = dataset.other_models.as_slice() {
        let more = if more.is_empty() { String::new() } else { format!(" and {} more", more.len()) };
        let count = dataset.views.len();
        say(format!("COLMAP's model 0 is read, with {count} cameras; not read: {}{more}", other.display()));
    }
    if let ([view], Some((count, next))) = (dataset.views.as_slice(), dataset.same_name) {
        let name = one_line(&view.camera.img_name);
        say(format!("{count} cameras have the name {name}: the first is taken; #{next} is the next"));
    }
}

/// Warns the user if principal points of pinholes are farther from the middle of the pictures than scores tolerate.
pub fn tell_off_center<'a>(cameras: impl IntoIterator<Item = &'a Camera>) {
    /// Maximum offset without a warning, in pixels. It hardly changes a score. But half a pixel does, as of
    /// `cx = (width - 1) / 2`.
    const TOLERANCE: f64 = 0.05;
    // The reference implementation has only pinholes.
    let pinholes = cameras.into_iter().filter(|camera| camera.projection.is_pinhole());
    let offsets = pinholes.flat_map(|camera| camera.principal_offset);
    let farthest = offsets.fold(0.0, |most: f64, v| v.abs().max(most));
    if farthest > TOLERANCE {
        say(format!(
            "principal points are up to {farthest:.1} pixels off the middle of the pictures; the 3DGS reference implementation trains with the middle: score its scenes with their cameras.json"
        ));
    }
}

/// Warns the user if a panorama does not have the shape 2:1.
pub fn tell_shape(cameras: &[Camera]) {
    let is_stretched = |camera: &&Camera| {
        camera.projection == Projection::Equirectangular && camera.width != 2 * camera.height
    };
    if let Some(Camera { width, height, .. }) = cameras.iter().find(is_stretched) {
        say(format!(
            "a panorama has 360 by 180 degrees: players and headsets expect 2:1, found {width} x {height} pixels"
        ));
    }
}

/// Warns the user if pinholes become tilted panoramas.
pub fn tell_tilt<'a>(pinholes: impl IntoIterator<Item = &'a Camera>, up: [f64; 3]) {
    let most = pinholes.into_iter().map(|camera| orbit::tilt(camera, up)).fold(0.0, f64::max);
    if most >= 0.05 {
        let [x, y, z] = up;
        say(format!(
            "panoramas are tilted by up to {most:.1} degrees from the up direction {x},{y},{z}, as their cameras are: docs/projections.md has a script that levels cameras"
        ));
    }
}

/// Finds the file that belongs to a photograph in another folder, such as its mask; `None` if there is none.
///
/// Its extension may differ or be appended. Leading folders of the name may be part of `folder`: `images/a.png` may be
/// `a.png` there.
pub fn beside_photograph(folder: &Path, photograph: &str) -> Option<PathBuf> {
    let ends = std::iter::once(0).chain(photograph.match_indices('/').map(|(at, _)| at + 1));
    ends.map(|at| &photograph[at..]).find_map(|name| Dataset::photograph_in(folder, name).ok())
}

/// Warns the user if the dataset has masks.
pub fn tell_masks(dataset: &Dataset) {
    if dataset.has_masks {
        say(
            "masks (`mask_path`) are not read: all pixels are scored; --masks DIR scores only the pixels that its masks keep",
        );
    }
}

/// Converts a dataset to the JSON of a `cameras.json`, in which `test` is [`View::test`].
pub fn as_json(dataset: &Dataset) -> serde_json::Result<Json> {
    let entry = |view: &View| {
        let mut entry = serde_json::to_value(&view.camera)?;
        view.test.into_iter().for_each(|test| entry["test"] = test.into());
        Ok(entry)
    };
    dataset.views.iter().map(entry).collect()
}

/// Tells the user what the `cameras.json` of a dataset lacks. `path` is its file.
pub fn tell_lost(dataset: &Dataset, path: &Path) {
    if let Some(FrameTiming { fps, is_cycle }) = dataset.timing {
        tell_frames(path, fps, is_cycle);
    }
    if dataset.has_masks {
        say(format!(
            "{}: masks (`mask_path`) are not written: `evaluate --masks DIR` names their folder",
            path.display()
        ));
    }
}

/// Tells the user how `video` draws the cameras of a `cameras.json` as the frames of a film.
pub fn tell_frames(path: &Path, fps: Option<impl Display>, is_cycle: bool) {
    let file = path.display();
    let word = if is_standard_output(path) { "FILE".into() } else { shell_word(&file.to_string()) };
    let fps = fps.map_or_else(String::new, |fps| format!(" --fps {fps}"));
    let closed = if is_cycle { " --closed" } else { "" };
    say(format!(
        "{file}: the times of the frames are not written: `video -c {word} --cameras-as frames{fps}{closed}` keeps them"
    ));
}

/// Registers the files of a dataset, given as in [`parse`], and its photographs as inputs. Does nothing for JSON text,
/// and for a dataset that cannot be read.
pub fn claim_file(guard: &mut OutputGuard, cameras: &str) -> Result<(), Usage> {
    if is_json(cameras) {
        return Ok(());
    }
    // A `#` may also be part of the file's own name.
    let file = match cameras.rsplit_once('#') {
        Some((file, _)) if !Path::new(cameras).exists() => file,
        _ => cameras,
    };
    let options = CameraOptions { ignore_distortion: true, ..CameraOptions::default() };
    match Dataset::load_with(Path::new(file), options) {
        Ok(dataset) => claim_dataset(guard, &dataset),
        // The command reports it when it reads the cameras.
        Err(_) => Ok(()),
    }
}

/// Registers the files of a dataset and its photographs as inputs.
pub fn claim_dataset(guard: &mut OutputGuard, dataset: &Dataset) -> Result<(), Usage> {
    dataset.files.iter().try_for_each(|file| guard.input("the cameras", file))?;
    let folder = dataset.photographs.as_deref();
    folder.map_or(Ok(()), |folder| claim_photographs(guard, folder, &dataset.views))
}

/// Registers the photograph of each view in `folder` as an input, if it exists.
pub fn claim_photographs(guard: &mut OutputGuard, folder: &Path, views: &[View]) -> Result<(), Usage> {
    for view in views {
        // A photograph outside of the dataset is refused as an input, but no output may overwrite it either.
        let named = || Some(folder.join(&view.photograph)).filter(|path| path.is_file());
        if let Some(file) = Dataset::photograph_in(folder, &view.photograph).ok().or_else(named) {
            guard.input("a photograph of the dataset", &file)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::render_command;
    use crate::io::load::LoadOptions;
    use proptest::prelude::*;
    use splatgraph_assets::synth;

    #[test]
    fn the_first_camera_beside_a_scene_is_taken_unless_others_are_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let (scene, own) = (folder.path().join("a.ply"), folder.path().join("a.cameras.json"));
        assert_eq!(load(None, Some(&scene), false).expect("no cameras"), None);
        let cameras = synth::demo_cameras();
        Camera::save(&cameras, &own).expect("written");
        let found = load(None, Some(&scene), false).expect("cameras").expect("beside the scene");
        assert_eq!(found, cameras[..1]);
        let spec = own.display().to_string();
        assert_eq!(
            load(Some(&spec), Some(&scene), false).expect("cameras").map(|all| all.len()),
            Some(cameras.len())
        );
        assert_eq!(load(None, None, false).expect("no scene"), None);
        std::fs::write(&own, "{}").expect("written");
        assert_eq!(load(None, Some(&scene), false).expect("a file without cameras is not used"), None);
        let mut guard = OutputGuard::default();
        claim(&mut guard, None, Some(&scene)).expect("an input");
        assert!(guard.output("--output", &own).is_err(), "no output replaces it");
    }

    #[test]
    fn mistakes_in_the_text_of_cameras_are_told_with_line_and_column() {
        let said = |text: &str| parse(text, false).unwrap_err().to_string();
        let one = r#"{"position": [0,0,0], "rotation": [[1,0,0],[0,1,0],[0,0,1]], "width": 4, "height": 2, "fx": 5.0}"#;
        assert_eq!(said(&format!("[{one}]")), "--cameras:1:98: camera 0: missing field `fy`");
        assert_eq!(
            said("[\n {\"width\": 1.5}]"),
            "--cameras:2:14: camera 0: invalid type: floating point `1.5`, expected u32"
        );
        assert!(
            said(one).starts_with("--cameras:1:") && said(one).contains("expected a list of cameras"),
            "{}",
            said(one)
        );
        assert_eq!(said(" []"), "--cameras has no cameras");
        assert_eq!(said(""), "--cameras: expected a file, found an empty name");
        let whole = one.replace("\"fx\"", "\"fy\": 6.0, \"fx\"");
        assert_eq!(parse(&format!("[{whole}]"), false).unwrap()[0].fy, 6.0);
        let distorted = format!("[{}]", whole.replace("\"fx\"", "\"k1\": 0.1, \"fx\""));
        assert!(said(&distorted).contains("`k1`: expected 0"));
        assert_eq!(parse(&distorted, true).unwrap()[0].fy, 6.0);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("[1].json");
        assert!(!is_json(&file.to_string_lossy()));
    }

    #[test]
    fn a_crop_is_a_condition_and_a_background() {
        let axes = [[0.8, 0.6, 0.0], [-0.6, 0.8, 1e-17], [0.0, 0.0, 1.0]];
        let crop = Crop { center: [1.0, 2.0, 0.5], axes, size: [2.0, 1.0, 4.0], background: [1.0, 0.2, 0.0] };
        let options = crop_options(&crop);
        let sides = "0.8*x + 0.6*y > 1 && 0.8*x + 0.6*y < 3 && -0.6*x + 0.8*y > 0.5 && -0.6*x + 0.8*y < 1.5 \
                     && z > -1.5 && z < 2.5";
        assert_eq!(options, format!("--where '{sides}' --background 1,0.2,0"));
        assert!(sides.parse::<crate::io::condition::Condition>().is_ok());
    }

    proptest! {
        #[test]
        fn a_camera_comes_back_from_its_command_bit_by_bit(
            position in prop::array::uniform3(any::<f64>().prop_filter("within f32", |v| v.abs() < 1e18)),
            turn in prop::array::uniform3(-4.0..4.0f64), focal in prop::array::uniform2(1e-3..1e5f64),
            size in (1..9000u32, 1..9000u32), principal_offset in prop::array::uniform2(-1e4..1e4f64),
        ) {
            let rotation = glam::DMat3::from_euler(glam::EulerRot::XYZ, turn[0], turn[1], turn[2]);
            let camera = Camera {
                id: 7,
                img_name: "it's #1".into(),
                width: size.0,
                height: size.1,
                position,
                rotation: rotation.to_cols_array_2d(),
                fx: focal[0],
                fy: focal[1],
                principal_offset,
                projection: Default::default(),
            };
            let camera = camera.rounded();
            let [scene, output] = ["scene.ply", "out.png"].map(Path::new);
            let line = render_command::line((scene, &LoadOptions::default()), &camera, "tiled", [], [0.0; 3], output);
            // Starting a shell for each of hundreds of lines would be slow.
            let json = line.split("--cameras '").nth(1).and_then(|rest| rest.split("' --size").next());
            let json = json.expect("a quoted word").replace("'\\''", "'");
            let read = parse(&json, false).expect("the camera is read");
            prop_assert_eq!(read.len(), 1);
            let resized = read[0].resized(size.0, size.1);
            let bits = |camera: &Camera| {
                let lens = [camera.fx, camera.fy, camera.principal_offset[0], camera.principal_offset[1]];
                let numbers = [&camera.position[..], camera.rotation.as_flattened(), &lens].concat();
                numbers.into_iter().map(f64::to_bits).collect::<Vec<_>>()
            };
            prop_assert_eq!(bits(&resized), bits(&camera));
            prop_assert_eq!(resized, camera);
        }
    }
}
