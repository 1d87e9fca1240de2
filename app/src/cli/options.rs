//! Defines options and helpers that several commands share.

use super::cameras::MAX_SIDE;
use super::known_devices;
use super::outcome::Usage;
use crate::draw::backend::{Api, Backend, Options, Validation};
use crate::draw::builtin;
use crate::draw::facts::{self, SceneFacts};
use crate::draw::fit::Target;
use crate::draw::interleaved::Frames;
use crate::draw::storage;
use crate::io::demo;
use crate::io::load::LoadOptions;
use crate::io::output::{self, OutputGuard, is_standard_output, names, say, shell_word};
use crate::io::progress::Progress;
use crate::io::report::plot::Plot;
use crate::io::scene_file;
use crate::lsp;
use crate::studies::bench;
use anyhow::{Context, Result, anyhow, bail};
use splatgraph_api::BackendError;
use splatgraph_assets::{
    Camera, CameraError, Content, LoadError, QUIET, Scene, SceneError, SceneFormat, SceneHeader,
};
use splatgraph_framework::ir::Catalog;
use std::collections::HashMap;
use std::ffi::OsString;
use std::io::IsTerminal;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use tracing::info_span;

pub use crate::draw::builtin::DEFAULT_PIPELINE;

/// Formats the help of an argument that names a scene.
pub fn scene_help() -> String {
    format!("A scene file: {}, or .ron, a list of scenes", SceneFormat::endings())
}

/// Formats the help of an argument that names a scene, the demo scene by default.
pub fn optional_scene_help() -> String {
    format!("{} [default: the demo scene]", scene_help())
}

pub fn setting(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.trim().is_empty() && !value.trim().is_empty() => {
            Ok((name.trim().to_owned(), value.trim().to_owned()))
        }
        _ => Err("expected NAME=VALUE, for instance digit_bits=4".into()),
    }
}

pub fn positive<T: FromStr + Copy + Into<f64>>(text: &str) -> Result<T, String> {
    let is_positive = |number: &T| (*number).into().is_finite() && (*number).into() > 0.0;
    text.parse().ok().filter(is_positive).ok_or_else(|| "expected a number above 0".into())
}

pub fn size(text: &str) -> Result<(u32, u32), String> {
    let parse = || -> Option<(u32, u32)> {
        let (width, height) = text.split_once(['x', 'X'])?;
        let (width, height) = (width.trim().parse().ok()?, height.trim().parse().ok()?);
        (width > 0 && height > 0).then_some((width, height))
    };
    match parse() {
        Some((width, height)) if width.max(height) > MAX_SIDE => {
            Err(format!("expected at most {MAX_SIDE}x{MAX_SIDE} pixels, found {width}x{height}"))
        }
        Some(size) => Ok(size),
        None => Err("expected WIDTHxHEIGHT in pixels, for instance 1920x1080".into()),
    }
}

pub fn colour(text: &str) -> Result<[f32; 3], String> {
    let values: Vec<f32> = text.split(',').filter_map(|v| v.trim().parse().ok()).collect();
    match values.as_slice() {
        &[r, g, b] if text.split(',').count() == 3 && values.iter().all(|v| v.is_finite()) => {
            // Float pictures keep any value, for example -1 or 1000 to mark the background. But integers of which one
            // is from 2 to 255 are probably 8-bit values.
            let is_byte = |value: &f32| value.fract() == 0.0 && (0.0..=255.0).contains(value);
            match values.iter().find(|value| **value >= 2.0) {
                Some(value) if values.iter().all(is_byte) => {
                    Err(format!("expected values from 0 to 1 (255 is 1), found {value}"))
                }
                _ => Ok([r, g, b]),
            }
        }
        _ => Err("expected three numbers, for instance 1,0.5,0.25".into()),
    }
}

/// Cancel flag that is never set.
pub static NEVER: AtomicBool = AtomicBool::new(false);

/// Opens a device while another thread runs `load`, which loads the scene. Returns both results.
///
/// If `open` fails, the load is cancelled, and its error is not reported. Drivers free memory when a thread that called
/// them ends, so the device is not opened on a thread that ends here.
pub fn open_and_load<D, L: Send>(
    open: impl FnOnce() -> Result<D>,
    load: impl FnOnce(&AtomicBool) -> Result<L> + Send,
) -> Result<(D, L)> {
    let cancel = AtomicBool::new(false);
    thread::scope(|scope| {
        let loading = thread::Builder::new()
            .name("scene".into())
            .spawn_scoped(scope, || load(&cancel))
            .context("no thread can be started to load the scene")?;
        let opened = open().inspect_err(|_| cancel.store(true, Ordering::Relaxed));
        let loaded = info_span!("wait for the scene").in_scope(|| loading.join());
        Ok((opened?, loaded.unwrap_or_else(|panic| resume_unwind(panic))?))
    })
}

/// Loads a scene and shows the progress.
pub fn load_scene(path: &Path, load: &LoadOptions) -> Result<Scene> {
    load_scene_unless(&NEVER, path, load)
}

/// Loads a scene and shows the progress. Fails soon after `cancel` becomes true, and for a file with only a mesh.
pub fn load_scene_unless(cancel: &AtomicBool, path: &Path, load: &LoadOptions) -> Result<Scene> {
    match load_any_unless(cancel, path, load)? {
        Content::Splats(scene) => Ok(*scene),
        Content::Mesh(_) => bail!(LoadError { path: path.to_owned(), problem: SceneError::MeshAlone }),
    }
}

/// Loads a scene, or a mesh to draw with one, and shows the progress. Fails soon after `cancel` becomes true.
pub fn load_any_unless(cancel: &AtomicBool, path: &Path, load: &LoadOptions) -> Result<Content> {
    let progress = Mutex::new(Progress::new(format!("loading {}", path.display())));
    let _span = info_span!("load the scene", path = %path.display()).entered();
    let content = load.any(path, &|done, of| {
        // Called on many threads. While one reports, the others skip their report.
        if let Ok(mut progress) = progress.try_lock() {
            progress.set(done, of, "");
        }
        if cancel.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    if let Content::Splats(scene) = &content {
        if scene.dropped().total() > 0 {
            say(format!(
                "{}: {} dropped ({})",
                path.display(),
                scene_file::splats(scene.dropped().total()),
                scene.dropped()
            ));
        }
        if let Some(mesh) = scene.notes().mesh_left_out() {
            say(format!("{}: left out: {mesh}", path.display()));
        }
        if let Some(coarse) = scene.coarse_positions() {
            say(format!("{}: positions are {coarse}", path.display()));
        }
        if let Some(names) = scene_file::skipped(scene) {
            say(format!(
                "{}: properties that are not read, although they may matter: {names}",
                path.display()
            ));
        }
        tell_mixed_tags(&path.display().to_string(), scene);
    }
    Ok(content)
}

/// Reports the tags that a merged scene ignores, because the scenes differ in them.
pub fn tell_mixed_tags(name: &str, scene: &Scene) {
    if let Some(tags) = scene.notes().mixed_tags() {
        say(format!("{name}: tags that are ignored, because the scenes differ in them: {tags}"));
    }
}

/// Loads the scene at `path`, or the demo scene. Returns the scene, its path, and the demo scene's camera.
///
/// Setting `cancel` stops the load of a scene file, but not of the demo scene.
pub fn scene_or_demo(
    cancel: &AtomicBool,
    path: Option<&Path>,
    load: &LoadOptions,
) -> Result<(Scene, PathBuf, Option<Camera>)> {
    let Some(path) = path else {
        let path = demo::path().context(
            "the demo scene has no folder: set XDG_CACHE_HOME or HOME to an absolute path, or name a scene",
        )?;
        if path.is_file() {
            match load_scene(&path, load) {
                // A crash or a full disk may have damaged the file.
                Err(error) if load.level.is_none() => {
                    say(format!("{error}; the demo scene is generated again"))
                }
                loaded => return Ok((loaded?, path, demo::camera())),
            }
        }
        let bytes = info_span!("generate the demo scene").in_scope(demo::generate);
        let bytes = bytes.map_err(|error| anyhow!("the demo scene cannot be generated: {error}"))?;
        let scene = match output::write_bytes(&path, &bytes) {
            Ok(()) => {
                say(format!("the demo scene was generated into {}", path.display()));
                load_scene(&path, load)?
            }
            // With a level, loading the file would have been an error, too.
            Err(error) if load.level.is_some() => return Err(error.into()),
            Err(error) => {
                say(format!("the demo scene is generated at each use, because {error}"));
                Scene::parse(&bytes, QUIET)?
            }
        };
        return Ok((scene, path, demo::camera()));
    };
    Ok((load_scene_unless(cancel, path, load)?, path.to_owned(), None))
}

pub fn inspect_target(text: &str) -> Result<(String, String), String> {
    match text.split_once('@') {
        Some((resource, pass)) if !resource.is_empty() && !pass.is_empty() => {
            Ok((resource.to_owned(), pass.to_owned()))
        }
        _ => Err("expected RESOURCE@PASS, for instance keys@scatter".into()),
    }
}

/// Lists every built-in graph except parts: renderers, filters, and the graphs of `bench` and of the viewer's window.
pub fn built_in_graphs() -> Vec<&'static str> {
    let mut graphs = builtin::names();
    graphs.extend(builtin::filters());
    graphs.extend(bench::GRAPHS);
    #[cfg(feature = "window")]
    graphs.push(crate::view::paint::GRAPH);
    graphs
}

const FRAMING: &str = "framing";

/// Lists the names of the cameras of [`scene_and_cameras`], before empty and duplicate ones get unique names, and
/// before the scene is loaded.
pub fn camera_names(scene: Option<&Path>, given: Option<&[Camera]>) -> Vec<String> {
    let own = || {
        scene.is_none().then(demo::camera).flatten().map_or_else(|| FRAMING.into(), |camera| camera.img_name)
    };
    given.map_or_else(|| vec![own()], |all| all.iter().map(|camera| camera.img_name.clone()).collect())
}

/// Lists the cameras' names as unique file names of at most `room` bytes, before the scene is loaded.
pub fn stems(scene: Option<&Path>, given: Option<&[Camera]>, room: usize) -> Vec<String> {
    names::unique(&camera_names(scene, given), room)
}

/// Returns the name of the scene at `path`, or of the demo scene.
pub fn scene_name(path: Option<&Path>) -> String {
    path.map_or_else(|| demo::NAME.to_owned(), |path| path.display().to_string())
}

/// Loads the scene and its cameras, and resizes the cameras' pictures to `size`.
///
/// A camera with an empty or duplicate name gets a unique one, as a file name of at most `room` bytes.
pub fn scene_and_cameras(
    path: Option<&Path>,
    load: &LoadOptions,
    given: Option<Vec<Camera>>,
    room: usize,
    size: Option<(u32, u32)>,
) -> Result<(Scene, Vec<Camera>)> {
    let stems = stems(path, given.as_deref(), room);
    let (scene, _, own) = scene_or_demo(&NEVER, path, load)?;
    let cameras = cameras_of(&scene, given.or(own.map(|own| vec![own])), &stems, size);
    Ok((scene, cameras))
}

/// Converts cameras to the scene's coordinates and to the requested size; without cameras, frames the scene at that
/// size.
///
/// A camera with an empty or duplicate name gets its entry of `stems` as its name.
pub fn cameras_of(
    scene: &Scene,
    given: Option<Vec<Camera>>,
    stems: &[String],
    size: Option<(u32, u32)>,
) -> Vec<Camera> {
    let given = given.map(|cameras| in_scene(&cameras, scene));
    let mut cameras = given.unwrap_or_else(|| vec![framing_at(scene, size)]);
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
    cameras
}

/// Scales a camera's picture down to at most `width` pixels across. Smaller pictures stay unchanged.
pub fn at_most(camera: &Camera, width: u32) -> Camera {
    if camera.width <= width {
        return camera.clone();
    }
    let height = (f64::from(camera.height) * f64::from(width) / f64::from(camera.width)).round();
    camera.resized(width, (height as u32).max(1))
}

/// Converts cameras to the scene's coordinates. Reports cameras that are far from the scene and do not see it.
pub fn in_scene(cameras: &[Camera], scene: &Scene) -> Vec<Camera> {
    let cameras: Vec<Camera> = cameras.iter().map(|camera| camera.relative_to(scene.offset())).collect();
    stray_cameras(&cameras, scene).iter().for_each(say);
    cameras
}

/// Describes the cameras that are more than ten extents from the scene and look elsewhere, as cameras of other
/// coordinates do. `None` if there are none.
fn stray_cameras(cameras: &[Camera], scene: &Scene) -> Option<String> {
    let bounds = scene.robust_bounds();
    let distance = |camera: &Camera| camera.distance_elsewhere(&bounds, 10.0 * bounds.extent());
    let distances: Vec<f64> = cameras.iter().filter_map(distance).collect();
    let nearest = distances.iter().copied().reduce(f64::min)?;
    let (of, bounds) = (cameras.len(), bounds.in_world(scene.offset()));
    Some(format!(
        "{} of {of} cameras see nothing of the scene: the nearest is {nearest:.0} units away, and most splats are in \
         the box {bounds}; are the coordinates those of another scene?",
        distances.len()
    ))
}

pub fn framing(scene: &Scene) -> Camera {
    framing_at(scene, None)
}

/// Returns the camera that frames a scene in pictures of this size, or of the default size.
pub fn framing_at(scene: &Scene, size: Option<(u32, u32)>) -> Camera {
    let (width, height) = size.unwrap_or(facts::DEFAULT_SIZE);
    Camera { img_name: FRAMING.into(), ..Camera::framing(scene, width, height) }
}

/// Finds a device in the catalogue or in a file, or else opens the named or the default device of this machine.
pub fn target(wanted: Option<&str>) -> Result<Target> {
    if let Some(known) = wanted.map(known_devices::find).transpose()?.flatten() {
        return Ok(known);
    }
    let options = Options { device: wanted.map(str::to_owned), ..Default::default() };
    let device = Backend::open(Api::default(), &options).with_context(|| match wanted {
        Some(wanted) => format!(
            "expected a device that `splatgraph check --help` lists, a file, or a device of this machine, found `{wanted}`"
        ),
        None => "the device's limits are not available".to_owned(),
    })?;
    Ok(Target::of(splatgraph_api::Device::info(&device)))
}

/// Returns the facts and the imports of the scene at `path`, or of the nominal scene.
pub fn scene_facts(path: Option<&Path>, load: &LoadOptions) -> Result<(SceneFacts, Catalog)> {
    let Some(path) = path else { return Ok((SceneFacts::NOMINAL, lsp::nominal_catalog())) };
    let scene = load_scene(path, load)?;
    Ok((SceneFacts::of(&scene), facts::catalog(&scene)))
}

/// Options of the device.
#[derive(Debug, clap::Args)]
pub struct DeviceArgs {
    /// Device: a part of its name, or its index in `splatgraph devices`
    #[arg(long, value_name = "NAME|INDEX")]
    pub device: Option<String>,
    /// Enable the API's validation (for Vulkan, with synchronization validation), and exit with code 1 if it reports
    /// anything
    #[arg(long)]
    pub validate: bool,
    /// Do not check accesses beyond the ends of buffers and images, to measure the cost of the checks
    #[arg(long)]
    pub no_robustness: bool,
}

impl DeviceArgs {
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
    /// Graphics API: `vulkan`, `metal` (on Apple's systems), or `null`, which executes nothing (pictures are black, and
    /// times are meaningless)
    #[arg(long, value_name = "NAME", default_value_t = Api::default(), value_parser = Api::parse)]
    pub backend: Api,
    #[command(flatten)]
    pub device: DeviceArgs,
}

impl BackendArgs {
    pub fn open(&self) -> Result<Backend, BackendError> {
        Backend::open(self.backend, &self.device.options())
    }

    /// Returns the command-line words that select this device again.
    pub fn words(&self) -> Vec<String> {
        let backend = (self.backend != Api::default())
            .then(|| ["--backend".to_owned(), self.backend.name().to_owned()]);
        let device = self.device.device.clone().map(|device| ["--device".to_owned(), device]);
        backend.into_iter().chain(device).flatten().collect()
    }
}

impl std::ops::Deref for BackendArgs {
    type Target = DeviceArgs;

    fn deref(&self) -> &DeviceArgs {
        &self.device
    }
}

/// Restricts `--backend` to the APIs that draw, for commands that compare pictures.
pub fn that_draws(backend: clap::Arg) -> clap::Arg {
    let help = "Graphics API: `vulkan`, or `metal` on Apple's systems";
    backend.help(help).value_parser(Api::parse_drawing)
}

/// Describes `--pipeline` of the commands that measure the settings of one graph.
pub fn that_is_changed(pipeline: clap::Arg) -> clap::Arg {
    pipeline.help("The graph whose parameters are changed: the name of a built-in one, or a path; presets are measured unchanged")
}

/// Describes `--set` of the commands that measure the settings of one graph.
pub fn that_is_fixed(set: clap::Arg) -> clap::Arg {
    set.help("Fix a parameter of the graph in every setting; may be repeated")
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
    /// Cameras: a COLMAP folder, a transforms.json, the reference implementation's cameras.json, or a glTF file; `#2`
    /// or `#NAME` selects one [default: the first camera beside the scene, or one that frames the scene]
    ///
    /// The format is recognised by the contents; docs/formats.md lists the formats. The text of a cameras.json works
    /// in place of a path: `[{"position": [0, 0, -4], "rotation": ..., ...}]`.
    #[arg(short, long, value_name = "PATH[#INDEX]|JSON")]
    pub cameras: Option<String>,
    /// Draw lenses with distortion as ideal ones: the same poses and focal lengths, but pictures that do not match the
    /// photographs [default: such lenses are refused]
    #[arg(long, requires = "cameras")]
    pub ignore_distortion: bool,
    /// Size of the pictures [default: the cameras'; 2:1 for a panorama of pinhole cameras]
    ///
    /// The cameras keep their vertical field of view: a wider picture shows more at the sides. The camera that frames
    /// the scene frames it at this size.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    pub size: Option<(u32, u32)>,
}

impl Drawing {
    pub fn cameras(&self, scene: Option<&Path>) -> Result<Option<Vec<Camera>>> {
        super::cameras::load_sized(self.cameras.as_deref(), scene, self.size, self.ignore_distortion)
    }

    /// Reads the cameras of `--cameras`.
    pub fn given_cameras(&self) -> Result<Option<Vec<Camera>>, CameraError> {
        let parse = |spec: &str| super::cameras::parse(spec, self.ignore_distortion);
        self.cameras.as_deref().map(parse).transpose()
    }
}

/// Returns the maximum number of unfinished pictures: `wanted`, or by default two per worker thread.
pub fn jobs(wanted: Option<u16>) -> usize {
    wanted.map_or_else(|| 2 * rayon::current_num_threads(), usize::from)
}

/// The memory for a graph and its scene.
#[derive(Debug, clap::Args)]
pub struct MemoryArgs {
    /// Choose the most accurate storage of the splats that fits so much memory of the device, such as 8GiB
    ///
    /// The buffers and images that stay after the first frame count. Storage is a parameter of the graph, so `--set
    /// storage=...` leaves nothing to choose. The default is the device's free memory, for scenes that may exceed it.
    #[arg(long, value_name = "SIZE", value_parser = storage::parse_bytes)]
    pub memory: Option<u64>,
}

/// Options for the number of frames of a measurement.
#[derive(Debug, clap::Args)]
pub struct EffortArgs {
    /// Maximum number of rounds. Measuring ends earlier once the time is precise enough, or after 8 seconds. With fewer
    /// than 8 frames in all rounds, all differences in time count as noise
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Frames per round; the baseline draws as many, interleaved [default: 1 to 3, from the frame time]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    frames: Option<u32>,
}

impl EffortArgs {
    pub fn frames(&self) -> Frames {
        Frames { rounds: self.rounds, frames: self.frames }
    }
}

/// Registers the scene, or the demo scene, and the camera file as inputs, so that no output can overwrite them.
pub fn claim_inputs(scene: Option<&Path>, cameras: Option<&str>) -> Result<OutputGuard, Usage> {
    let mut guard = OutputGuard::default();
    match scene {
        Some(path) => guard.scene("the scene", path)?,
        None => demo::path().map_or(Ok(()), |path| guard.input("the demo scene", &path))?,
    }
    super::cameras::claim(&mut guard, cameras, scene)?;
    Ok(guard)
}

pub fn claim_json<'a>(
    json: Option<&Path>,
    inputs: impl Iterator<Item = (&'a str, &'a Path)>,
) -> Result<(), Usage> {
    let mut guard = OutputGuard::default();
    for (what, path) in inputs {
        guard.scene(what, path)?;
    }
    json.map_or(Ok(()), |path| Ok(guard.output("--json", path)?))
}

/// Rejects `--json FILE.json` and `--json -`, whose second word would be taken for a scene.
///
/// Some scenes are JSON files, too: such a word stays a scene.
pub fn refuse_json_apart(arguments: &[OsString]) -> Result<(), Usage> {
    let before_end = arguments.iter().take_while(|word| *word != "--");
    for (option, word) in before_end.zip(arguments.iter().skip(1)).filter(|(option, _)| *option == "--json") {
        let (option, path) = (option.display(), Path::new(word));
        if is_standard_output(path) {
            return Err(Usage(format!(
                "expected {option} alone for standard output, found {option} {}",
                path.display()
            )));
        }
        let is_json = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
        if is_json && SceneHeader::load(path).is_err() {
            let word = word.to_string_lossy();
            let name = output::one_line(&word);
            return Err(Usage(format!("expected {option}={name} to write a file, found {option} {name}")));
        }
    }
    Ok(())
}

/// Registers the files of [`write_plot`].
pub fn claim_plot(guard: &mut OutputGuard, folder: &Path, name: &str) -> Result<(), Usage> {
    let files = ["svg", "png"].map(|format| folder.join(format!("{name}.{format}")));
    Ok(files.iter().try_for_each(|file| guard.output("--output", file))?)
}

/// Writes a plot as `NAME.svg` and `NAME.png`.
pub fn write_plot(plot: &Plot, folder: &Path, name: &str) -> Result<()> {
    output::write_bytes(&folder.join(format!("{name}.svg")), plot.svg()?.as_bytes())?;
    Ok(plot.image()?.save(&folder.join(format!("{name}.png")))?)
}

/// Formats this process's command line for a shell.
pub fn command_line() -> String {
    std::env::args_os().map(|word| shell_word(&word.to_string_lossy())).collect::<Vec<_>>().join(" ")
}

/// Returns a path as text for JSON. Serde refuses a [`PathBuf`] that is not valid UTF-8, and `json!` panics on it.
pub fn text_of(path: &Path) -> String {
    path.display().to_string()
}

pub fn write_json(path: &Path, value: &serde_json::Value) -> Result<()> {
    write_text(Some(path), &format!("{value:#}\n"))
}

/// Writes cameras as a cameras.json in world coordinates. The cameras are in the scene's coordinates.
pub fn write_cameras(path: &Path, cameras: &[Camera], scene: &Scene) -> Result<()> {
    let world: Vec<Camera> = cameras.iter().map(|camera| camera.in_world(scene.offset())).collect();
    write_json(path, &serde_json::to_value(world)?)
}

/// Prints a line of the command's result. A closed pipe is not an error.
pub fn print(line: &str) -> Result<()> {
    write_text(None, &format!("{line}\n"))
}

/// Prints text, unless `json`, the file of `--json`, is standard output.
pub fn print_beside(json: Option<&Path>, text: &str) -> Result<()> {
    if json.is_some_and(is_standard_output) { Ok(()) } else { write_text(None, text) }
}

/// Writes text to a file, or to standard output for `None` or `-`. A closed pipe is not an error.
pub fn write_text(path: Option<&Path>, text: &str) -> Result<()> {
    match path.filter(|path| !is_standard_output(path)) {
        Some(path) => Ok(output::write_bytes(path, output::harmless(text).as_bytes())?),
        None => Ok(output::print(text)?),
    }
}

/// Returns an error if standard output is a terminal, which cannot take binary data.
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
    use splatgraph_assets::synth;

    #[test]
    fn a_background_is_refused_if_it_looks_like_values_from_0_to_255() {
        for text in ["0,128,255", "2,0,0", "0,1,255"] {
            let error = colour(text).unwrap_err();
            assert!(error.starts_with("expected values from 0 to 1 (255 is 1), found "), "{text}: {error}");
        }
        for text in ["1,1,1", "1e3,1e3,1e3", "-1,-1,-1", "0.5,2,0", "1.5,0,0", "0,0,256"] {
            assert!(colour(text).is_ok(), "{text}");
        }
    }

    #[test]
    fn the_default_camera_frames_the_scene_in_a_picture_of_any_shape() {
        let scene = synth::generate("uniform", 500, 0).unwrap();
        for size in [(300, 600), (300, 300), (960, 540), (900, 100)] {
            let camera = cameras_of(&scene, None, &[FRAMING.into()], Some(size)).remove(0);
            assert_eq!((camera.width, camera.height), size);
            let corners = scene.robust_bounds().corners().map(|corner| camera.to_view(corner));
            let reach = |axis: usize, focal: f64, side: u32| {
                let of = |view: &[f64; 3]| (view[axis] / view[2] * focal).abs() / (0.5 * f64::from(side));
                corners.iter().map(of).fold(0.0, f64::max)
            };
            let widest = reach(0, camera.fx, size.0).max(reach(1, camera.fy, size.1));
            assert!((0.9..0.93).contains(&widest), "{size:?}: {widest}");
        }
        let given = vec![Camera::framing(&scene, 200, 100)];
        let wide = cameras_of(&scene, Some(given.clone()), &["one".into()], Some((300, 100))).remove(0);
        assert_eq!(wide.fy, given[0].fy, "a camera of a file keeps its vertical field of view");
    }
}
