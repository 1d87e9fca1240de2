//! Defines options and helpers of several commands.

use super::{Usage, known_devices};
use crate::draw::backend::{Api, Backend, Options, Validation};
use crate::draw::builtin;
use crate::draw::facts;
use crate::draw::fit::Target;
use crate::draw::interleaved::{Effort, suitable_frames};
use crate::draw::session::Session;
use crate::io::demo;
use crate::io::output::{self, OutputGuard, say};
use crate::io::progress::Progress;
use crate::studies::bench;
use crate::studies::trade::plans;
use crate::studies::trade::settings::{self, Setting};
use anyhow::{Context, Result};
use splatgraph_api::{BackendError, Heap};
use splatgraph_assets::{Camera, CameraError, Dataset, Scene};
use splatgraph_framework::ir::{Catalog, DeviceFacts, Domain};
use splatgraph_framework::lower::Control;
use std::collections::HashMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Default of `--pipeline`: the fastest graph for the device, chosen by its facts.
pub const DEFAULT_PIPELINE: &str = "auto";

/// Lists the built-in graphs to measure: all but `auto`, which is one of the others on each device.
pub fn measured_names() -> Vec<&'static str> {
    builtin::names().into_iter().filter(|name| *name != DEFAULT_PIPELINE).collect()
}

/// Parses `NAME=VALUE`.
pub fn setting(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.trim().is_empty() && !value.trim().is_empty() => {
            Ok((name.trim().to_owned(), value.trim().to_owned()))
        }
        _ => Err("expected NAME=VALUE, for instance digit_bits=4".into()),
    }
}

/// Largest width and height of a picture, in pixels: no Vulkan device has larger images.
pub const MAX_SIDE: u32 = 32_768;

/// Parses `WIDTHxHEIGHT`.
pub fn size(text: &str) -> Result<(u32, u32), String> {
    let parse = || -> Option<(u32, u32)> {
        let (width, height) = text.split_once(['x', 'X'])?;
        let (width, height) = (width.trim().parse().ok()?, height.trim().parse().ok()?);
        (width > 0 && height > 0).then_some((width, height))
    };
    match parse() {
        Some((width, height)) if width.max(height) > MAX_SIDE => {
            Err(format!("expected at most {MAX_SIDE}x{MAX_SIDE}, the largest images of any device"))
        }
        Some(size) => Ok(size),
        None => Err("expected WIDTHxHEIGHT in pixels, for instance 1920x1080".into()),
    }
}

/// Parses `R,G,B`.
pub fn colour(text: &str) -> Result<[f32; 3], String> {
    let values: Vec<f32> = text.split(',').filter_map(|v| v.trim().parse().ok()).collect();
    match values.as_slice() {
        &[r, g, b] if text.split(',').count() == 3 && values.iter().all(|v| v.is_finite()) => Ok([r, g, b]),
        _ => Err("expected three numbers, for instance 1,0.5,0.25".into()),
    }
}

/// Formats a parameter's range of values, for help.
pub fn domain(domain: &Domain) -> String {
    match domain {
        Domain::Bool => "true|false".into(),
        Domain::Int { min, max } => format!("{min}..{max}"),
        Domain::Float { min, max, .. } => format!("{min:?}..{max:?}"),
        Domain::Choice(choices) => choices.join("|"),
    }
}

/// Formats a list of names and descriptions in two columns, for help.
pub fn two_columns(rows: Vec<(String, String)>) -> String {
    /// Width below which clap does not wrap the text on common terminals.
    const COLUMNS: usize = 98;
    let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let mut lines: Vec<String> = Vec::new();
    for (name, about) in &rows {
        let mut line = format!("  {name:width$} ");
        for word in about.split(' ') {
            if line.chars().count() + 1 + word.chars().count() > COLUMNS && !line.trim().is_empty() {
                lines.push(line);
                line = " ".repeat(width + 3);
            }
            line = line + " " + word;
        }
        lines.push(line);
    }
    lines.iter().map(|line| line.trim_end()).collect::<Vec<_>>().join("\n")
}

/// Loads a scene, with progress.
pub fn load_scene(path: &Path) -> Result<Scene> {
    let progress = Mutex::new(Progress::new(format!("loading {}", path.display())));
    let scene = Scene::load(path, &|done, of| {
        // Called from many threads: while one reports, the others need not.
        if let Ok(mut progress) = progress.try_lock() {
            progress.set(done, of, "");
        }
    })?;
    if scene.dropped().total() > 0 {
        say(format!("{}: {} splats dropped ({})", path.display(), scene.dropped().total(), scene.dropped()));
    }
    Ok(scene)
}

/// Loads the scene at `path`, or the demo scene with its camera; returns the scene's path with it.
pub fn scene_or_demo(path: Option<&Path>) -> Result<(Scene, PathBuf, Option<Camera>)> {
    let Some(path) = path else {
        let path = demo::path().context(
            "the demo scene has no folder: set XDG_CACHE_HOME or HOME to an absolute path, or name a scene",
        )?;
        if demo::ensure(&path).context("the demo scene cannot be generated")? {
            say(format!("the demo scene was generated into {}", path.display()));
        }
        return Ok((load_scene(&path)?, path, demo::camera()));
    };
    Ok((load_scene(path)?, path.to_owned(), None))
}

/// Parses `RESOURCE@PASS`.
pub fn inspect_target(text: &str) -> Result<(String, String), String> {
    match text.split_once('@') {
        Some((resource, pass)) if !resource.is_empty() && !pass.is_empty() => {
            Ok((resource.to_owned(), pass.to_owned()))
        }
        _ => Err("expected RESOURCE@PASS, for instance keys@scatter".into()),
    }
}

/// Returns true for the text of a `cameras.json`, false for the name of a file.
fn is_json(spec: &str) -> bool {
    spec.trim_start().starts_with(['[', '{']) && !Path::new(spec).exists()
}

/// Loads the cameras of `PATH` or `PATH#INDEX`, in any format of [`Dataset`], or parses the text of a `cameras.json`.
pub fn cameras(spec: &str) -> Result<Vec<Camera>, CameraError> {
    if is_json(spec) {
        let name = Path::new("--cameras");
        let cameras = Camera::parse(spec, name)?;
        return if cameras.is_empty() { Err(CameraError::Empty { path: name.into() }) } else { Ok(cameras) };
    }
    // A `#` may also be part of the file's own name.
    if spec.contains('#') && !Path::new(spec).exists() {
        return Camera::select(spec).map(|camera| vec![camera]);
    }
    let dataset = Dataset::load(spec)?;
    tell_off_center(&dataset);
    let cameras: Vec<Camera> = dataset.views.into_iter().map(|view| view.camera).collect();
    if cameras.is_empty() { Err(CameraError::Empty { path: spec.into() }) } else { Ok(cameras) }
}

/// Warns if principal points are not in the middle of the pictures.
pub fn tell_off_center(dataset: &Dataset) {
    if dataset.off_center > 0.5 {
        say(format!(
            "principal points are up to {:.1} pixels from the middle of the pictures; they are drawn in the middle, as by the 3DGS reference",
            dataset.off_center
        ));
    }
}

/// Lists the imports for any built-in graph: those of the nominal scene and of the viewer's window.
pub fn nominal_catalog() -> Catalog {
    #[cfg_attr(not(feature = "window"), expect(unused_mut))]
    let mut catalog = facts::nominal_catalog();
    #[cfg(feature = "window")]
    crate::view::paint::offer(&mut catalog);
    catalog
}

/// Lists every built-in graph: renderers, filters, and the graphs of `bench` and of the viewer's window.
pub fn built_in_graphs() -> Vec<&'static str> {
    let mut graphs = builtin::names();
    graphs.extend(builtin::filters());
    graphs.extend(bench::GRAPHS);
    #[cfg(feature = "window")]
    graphs.push(crate::view::paint::GRAPH);
    graphs
}

/// Name of the camera that frames the scene.
const FRAMING: &str = "framing";

/// Lists the names of the cameras that [`scene_and_cameras`] will return, before the scene is loaded.
pub fn camera_names(scene: Option<&Path>, given: Option<&[Camera]>) -> Vec<String> {
    let own = || {
        scene.is_none().then(demo::camera).flatten().map_or_else(|| FRAMING.into(), |camera| camera.img_name)
    };
    given.map_or_else(|| vec![own()], |all| all.iter().map(|camera| camera.img_name.clone()).collect())
}

/// Loads the scene and its cameras, in the requested size. Empty and duplicate names become the camera's stem.
pub fn scene_and_cameras(
    path: Option<&Path>,
    given: Option<Vec<Camera>>,
    stems: &[String],
    size: Option<(u32, u32)>,
) -> Result<(Scene, Vec<Camera>)> {
    let (scene, _, own) = scene_or_demo(path)?;
    let given = given.map(|cameras| in_scene(&cameras, &scene));
    let mut cameras = given.or(own.map(|own| vec![own])).unwrap_or_else(|| vec![framing(&scene)]);
    let mut uses: HashMap<String, usize> = HashMap::new();
    for camera in &cameras {
        *uses.entry(camera.img_name.clone()).or_default() += 1;
    }
    for (camera, stem) in cameras.iter_mut().zip(stems) {
        if let Some((width, height)) = size {
            *camera = camera.resized(width, height);
        }
        if camera.img_name.is_empty() || uses.get(&camera.img_name).is_some_and(|uses| *uses > 1) {
            camera.img_name = stem.clone();
        }
    }
    Ok((scene, cameras))
}

/// Scales the camera down to at most `width` pixels.
pub fn at_most(camera: &Camera, width: u32) -> Camera {
    if camera.width <= width {
        return camera.clone();
    }
    let height = (f64::from(camera.height) * f64::from(width) / f64::from(camera.width)).round();
    camera.resized(width, (height as u32).max(1))
}

/// Converts cameras of a file from world coordinates to the scene's.
pub fn in_scene(cameras: &[Camera], scene: &Scene) -> Vec<Camera> {
    cameras.iter().map(|camera| camera.relative_to(scene.offset())).collect()
}

/// Returns the camera that frames a scene, named `framing`.
pub fn framing(scene: &Scene) -> Camera {
    let (width, height) = facts::DEFAULT_SIZE;
    Camera { img_name: FRAMING.into(), ..Camera::framing(scene, width, height) }
}

/// Returns the facts of the named device, or of the smallest supported one; see [`target`].
pub fn device_facts(wanted: Option<&str>) -> Result<DeviceFacts> {
    match wanted {
        Some(wanted) => Ok(target(Some(wanted))?.facts),
        None => Ok(facts::portable_device(facts::USUAL_SUBGROUP_SIZE)),
    }
}

/// Describes a device of the catalogue or of a file, or else opens a device of this machine.
///
/// Without a name, it opens the default device.
pub fn target(wanted: Option<&str>) -> Result<Target> {
    if let Some(known) = wanted.map(known_devices::find).transpose()?.flatten() {
        return Ok(Target { name: known.name, facts: known.facts, heap: Heap::default() });
    }
    let options = Options { device: wanted.map(str::to_owned), ..Default::default() };
    let device = Backend::open(Api::default(), &options).context("the device's limits are not available")?;
    let info = splatgraph_api::Device::info(&device);
    Ok(Target { name: info.name.clone(), facts: info.facts, heap: info.heap })
}

/// Options of the device.
#[derive(Debug, clap::Args)]
pub struct DeviceArgs {
    /// Device: a part of its name, or its index in `splatgraph devices`
    #[arg(long, value_name = "NAME|INDEX")]
    pub device: Option<String>,
    /// Enable the API's validation (for Vulkan with synchronization validation); exit with code 1 if it reports anything
    #[arg(long)]
    pub validate: bool,
    /// Do not check accesses beyond the ends of buffers and images, to measure the cost of the checks
    #[arg(long)]
    pub no_robustness: bool,
}

impl DeviceArgs {
    /// Converts the arguments to the backend's options.
    pub fn options(&self) -> Options {
        let validation = if self.validate { Validation::Synchronization } else { Validation::Off };
        Options {
            device: self.device.clone(),
            validation,
            unchecked: self.no_robustness,
            ..Options::default()
        }
    }
}

/// Options of the device, and its API.
#[derive(Debug, clap::Args)]
pub struct BackendArgs {
    /// Graphics API: `vulkan`, `metal` (on Apple's systems), or `null`, which executes nothing (pictures are black, and times mean nothing)
    #[arg(long, value_name = "NAME", default_value_t = Api::default(), value_parser = Api::parse)]
    pub backend: Api,
    #[command(flatten)]
    pub device: DeviceArgs,
}

impl BackendArgs {
    /// Opens the device.
    pub fn open(&self) -> Result<Backend, BackendError> {
        Backend::open(self.backend, &self.device.options())
    }
}

impl std::ops::Deref for BackendArgs {
    type Target = DeviceArgs;

    fn deref(&self) -> &DeviceArgs {
        &self.device
    }
}

/// Options of the device, and its API, for commands that compare pictures.
#[derive(Debug, clap::Args)]
pub struct DrawingBackendArgs {
    /// Graphics API: `vulkan`, or `metal` on Apple's systems
    #[arg(long, value_name = "NAME", default_value_t = Api::default(), value_parser = Api::parse_drawing)]
    backend: Api,
    #[command(flatten)]
    device: DeviceArgs,
}

impl DrawingBackendArgs {
    /// Opens the device.
    pub fn open(&self) -> Result<Backend, BackendError> {
        Backend::open(self.backend, &self.device.options())
    }

    /// Returns the words of a command line that choose the same device.
    pub fn words(&self) -> Vec<String> {
        let backend = (self.backend != Api::default())
            .then(|| ["--backend".to_owned(), self.backend.name().to_owned()]);
        let device = self.device.device.clone().map(|device| ["--device".to_owned(), device]);
        backend.into_iter().chain(device).flatten().collect()
    }
}

impl std::ops::Deref for DrawingBackendArgs {
    type Target = DeviceArgs;

    fn deref(&self) -> &DeviceArgs {
        &self.device
    }
}

/// Options of a plan: graph, parameters, cameras and picture size.
#[derive(Debug, clap::Args)]
pub struct Drawing {
    /// The graph: the name of a built-in one (see --help), or a path
    #[arg(short, long, value_name = "NAME", default_value = DEFAULT_PIPELINE)]
    pub pipeline: String,
    /// Set a parameter of the graph; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = setting)]
    pub set: Vec<(String, String)>,
    /// Cameras: a COLMAP folder, a transforms.json, or the reference implementation's cameras.json; `#2` or `#NAME` selects one [default: the first beside the scene]
    ///
    /// The contents tell the format. Lenses with distortion are refused. The text of a cameras.json works in place of a path: `[{"position": [0, 0, -4], "rotation": ..., ...}]`.
    #[arg(short, long, value_name = "PATH[#INDEX]|JSON")]
    pub cameras: Option<String>,
    /// Size of the pictures [default: the cameras']
    ///
    /// The vertical field of view of the cameras stays the same: a wider picture shows more at the sides.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    pub size: Option<(u32, u32)>,
}

impl Drawing {
    /// Loads the cameras of `--cameras`, or the first beside the scene.
    pub fn cameras(&self, scene: Option<&Path>) -> Result<Option<Vec<Camera>>> {
        super::cameras::load(self.cameras.as_deref(), scene)
    }
}

/// Options for the number of frames of a measurement.
#[derive(Debug, clap::Args)]
pub struct EffortArgs {
    /// Maximum number of rounds; fewer if the time is known precisely enough, or after 8 seconds. With fewer than 8, all differences in time count as noise
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Frames per round; the baseline draws as many, interleaved [default: 1 to 30, from the frame time]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    frames: Option<u32>,
}

impl EffortArgs {
    /// Chooses the number of frames. Without `--frames`, a round has `1 / part` of the usual number.
    ///
    /// The session is prepared in the camera's size.
    pub fn choose(&self, session: &mut Session<Backend>, camera: &Camera, part: u32) -> Result<Effort> {
        let usual = || suitable_frames(session, camera).map(|frames| (frames / part).max(1));
        Ok(Effort { rounds: self.rounds, frames: self.frames.map_or_else(usual, Ok)? })
    }

    /// Returns `--rounds` and `--frames`.
    pub fn given(&self) -> (u32, Option<u32>) {
        (self.rounds, self.frames)
    }
}

/// Protects the inputs of a command that draws: the scene, or the demo scene, and the cameras.
pub fn claim_inputs(scene: Option<&Path>, cameras: Option<&str>) -> Result<OutputGuard, Usage> {
    let mut guard = OutputGuard::default();
    match scene {
        Some(path) => guard.input("the scene", path)?,
        None => demo::path().map_or(Ok(()), |path| guard.input("the demo scene", &path))?,
    }
    super::cameras::claim(&mut guard, cameras, scene)?;
    Ok(guard)
}

/// Adds the file of `FILE` or `FILE#INDEX` to the inputs; a `#` may also be part of the file's own name, and JSON has no file.
pub fn claim_cameras(guard: &mut OutputGuard, cameras: &str) -> Result<(), Usage> {
    if is_json(cameras) {
        return Ok(());
    }
    guard.input("the cameras", Path::new(cameras))?;
    if let Some((file, _)) = cameras.rsplit_once('#') {
        guard.input("the cameras", Path::new(file))?;
    }
    Ok(())
}

/// Lists the settings of a graph to measure, with the parameters of `set` fixed.
pub fn settings_of(pipeline: &str, set: &[(String, String)], controls: &[Control]) -> Vec<Setting> {
    let all = settings::list(pipeline, controls, &measured_names());
    if set.is_empty() {
        return all;
    }
    let presets = builtin::presets();
    let has = |graph: &str, name: &str| {
        let preset = presets.iter().find(|preset| preset.name == graph);
        preset.is_some_and(|preset| preset.params.iter().any(|control| control.param.name == name))
    };
    settings::fixed(all, set, has)
}

/// Removes and reports settings without an effect on the plan of the exact settings, which must be prepared.
pub fn with_effect(all: Vec<Setting>, exact: &Session<Backend>) -> Result<Vec<Setting>> {
    let plan = exact.plan().context("no plan of the exact settings")?;
    let (settings, lines) = settings::with_effect(all, plan);
    lines.iter().for_each(say);
    Ok(settings)
}

/// Builds the plans of settings for all picture sizes, and removes settings whose plans equal those of an earlier one.
///
/// Returns each with the hash of its plans; `None` if one cannot be built.
pub fn with_plans(
    all: Vec<Setting>,
    session: &mut Session<Backend>,
    cameras: &[Camera],
) -> Result<Vec<(Setting, Option<u64>)>> {
    let mut sizes: Vec<(u32, u32)> = cameras.iter().map(|camera| (camera.width, camera.height)).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let mut progress = Progress::new("building plans");
    let (mut planned, of) = (Vec::new(), all.len() as u64);
    for (at, setting) in all.into_iter().enumerate() {
        progress.set(at as u64, of, &setting.name);
        let plan = plans::of_setting(session, &setting, &sizes)?;
        planned.push((setting, plan));
    }
    drop(progress);
    let (settings, lines) = plans::distinct(planned);
    lines.iter().for_each(say);
    Ok(settings)
}

/// Returns an error if the file of `--json` would destroy an input.
pub fn claim_json<'a>(
    json: Option<&Path>,
    inputs: impl Iterator<Item = (&'a str, &'a Path)>,
) -> Result<(), Usage> {
    let mut guard = OutputGuard::default();
    for (what, path) in inputs {
        guard.input(what, path)?;
    }
    json.map_or(Ok(()), |path| Ok(guard.output("--json", path)?))
}

/// Writes JSON to a file, or to standard output if the name is `-`.
pub fn write_json(path: &Path, value: &serde_json::Value) -> Result<()> {
    write_text(Some(path), &format!("{value:#}\n"))
}

/// Prints a line of the command's result to standard output; a closed pipe is no error.
pub fn print(line: &str) -> Result<()> {
    write_text(None, &format!("{line}\n"))
}

/// Writes text to a file, or to standard output for `None` or `-`; a closed pipe is no error.
pub fn write_text(path: Option<&Path>, text: &str) -> Result<()> {
    match path.filter(|path| !output::is_standard_output(path)) {
        Some(path) => Ok(output::write_bytes(path, output::harmless(text).as_bytes())?),
        None => Ok(output::print(text)?),
    }
}

/// Returns an error if binary data for standard output would go to a terminal.
pub fn refuse_terminal(what: &str) -> Result<(), Usage> {
    if std::io::stdout().is_terminal() {
        return Err(Usage(format!(
            "expected a file or a pipe as standard output for {what}, found a terminal"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::render_command::RenderCommand;
    use proptest::prelude::*;

    #[test]
    fn mistakes_in_the_text_of_cameras_are_told_with_line_and_column() {
        let said = |text: &str| cameras(text).unwrap_err().to_string();
        let one = r#"{"position": [0,0,0], "rotation": [[1,0,0],[0,1,0],[0,0,1]], "width": 4, "height": 2, "fx": 5.0}"#;
        assert_eq!(said(&format!("[{one}]")), "--cameras:1:97: camera 0: missing field `fy`");
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
        let whole = one.replace("\"fx\"", "\"fy\": 6.0, \"fx\"");
        assert_eq!(cameras(&format!("[{whole}]")).unwrap()[0].fy, 6.0);
        // A file's name that looks like JSON.
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("[1].json");
        assert!(!is_json(&file.to_string_lossy()));
    }

    proptest! {
        #[test]
        fn a_camera_comes_back_from_its_command_bit_by_bit(
            position in prop::array::uniform3(any::<f64>().prop_filter("within f32", |v| v.abs() < 1e18)),
            turn in prop::array::uniform3(-4.0..4.0f64), focal in prop::array::uniform2(1e-3..1e5f64),
            size in (1..9000u32, 1..9000u32),
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
            };
            let line = RenderCommand {
                scene: Path::new("scene.ply"),
                camera: &camera,
                graph: "tiled",
                set: [],
                background: [0.0; 3],
                output: Path::new("out.png"),
            }.line();
            // The shell's words, without a shell for each of hundreds of lines.
            let json = line.split("--cameras '").nth(1).and_then(|rest| rest.split("' --size").next());
            let json = json.expect("a quoted word").replace("'\\''", "'");
            let read = cameras(&json).expect("the camera is read");
            prop_assert_eq!(read.len(), 1);
            let resized = read[0].resized(size.0, size.1);
            let bits = |camera: &Camera| {
                let numbers = [&camera.position[..], camera.rotation.as_flattened(), &[camera.fx, camera.fy]].concat();
                numbers.into_iter().map(f64::to_bits).collect::<Vec<_>>()
            };
            prop_assert_eq!(bits(&resized), bits(&camera));
            prop_assert_eq!(resized, camera);
        }
    }

    #[test]
    fn lists_are_broken_into_lines_that_stay_in_their_column() {
        let long = ["word"; 30].join(" ");
        let text = two_columns(vec![("a".into(), "short".into()), ("name".into(), long)]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "  a     short");
        assert!(lines[1].starts_with("  name  word word") && lines[1].len() <= 98);
        assert!(lines[2].starts_with("        word"));
        assert_eq!(lines.len(), 3);
    }
}
