//! Runs `splatgraph view`: opens a window on a scene.

use super::cameras;
use super::loading;
use super::look_at::{self, Up};
use super::options::{self, BackendArgs, Drawing, MemoryArgs};
use super::outcome::{Outcome, Usage};
use crate::draw::camera;
use crate::draw::facts::{self, SceneFacts};
use crate::draw::fit::{self, Target, Wanted};
use crate::draw::planner::Planner;
use crate::draw::storage::{Choice, StorageError};
use crate::io::image::Format;
use crate::io::load::LoadOptions;
use crate::io::output::{Log, is_standard_output, say};
use crate::view::events::RendererId;
use crate::view::kept;
use crate::view::opening;
use crate::view::paint::Mode;
use crate::view::panels::Tool;
use crate::view::panels::selection::Selection;
use crate::view::shell::Shell;
use crate::view::viewer::CameraList;
use crate::view::window::{self, WindowOptions};
use anyhow::Result;
use clap::ValueEnum;
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene, SceneFormat};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  splatgraph view                                        # the demo scene
  splatgraph view scene.ply --cameras cameras.json
  splatgraph view scene.ply --pipeline my/graph.ron      # edit the file and its shaders, and see
  splatgraph view scene.ply --compare key16 --as split   # two graphs, one camera
  splatgraph view scene.ply --show parameters,timeline --frames 60 --screenshot window.png

Mouse: drag orbits, Shift + drag pans, the wheel zooms; the right button and W A S D fly. F frames the scene, F1 lists the rest.";

const CAMERAS: &str = "Cameras to look through: a COLMAP folder, a transforms.json, a cameras.json or a glTF file; `#2` or `#NAME` selects one, `#front/*` those whose names begin with `front/` [default: all cameras of the file beside the scene]";

/// Open a window on a scene, and edit its renderer live
///
/// The graph, its includes and its shaders are reloaded when a file changes. A graph in the working directory or its
/// pipelines/ folder takes precedence over a built-in one of the same name. The graph's parameters become controls. An
/// error is shown over the last good picture until you correct it.
#[derive(Debug, clap::Args)]
#[command(mut_arg("cameras", |arg| arg.help(CAMERAS).long_help(None)))]
#[command(mut_arg("size", |arg| arg.help("Size of the window [default: 1600x900]").long_help(None)))]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[arg(help = options::optional_scene_help())]
    scene: Option<PathBuf>,
    /// Further scenes, which `render` takes: refused with the ways to view them
    #[arg(hide = true)]
    more: Vec<PathBuf>,
    #[command(flatten)]
    drawing: Drawing,
    #[command(flatten)]
    memory: MemoryArgs,
    /// Background colour, display-encoded, 0 to 1
    #[arg(long, value_name = "R,G,B|#RRGGBB", default_value = "0,0,0", allow_hyphen_values = true, value_parser = options::colour)]
    background: [f32; 3],
    /// World direction that points up: an axis such as z or -y, a vector, or `cameras`, the mean of the cameras'; files
    /// that the window writes get it as a tag [default: the cameras', else the scene's, or -y, and no tag]
    #[arg(long, value_name = "AXIS|X,Y,Z|cameras", allow_hyphen_values = true, value_parser = look_at::up)]
    up: Option<Up>,
    /// Compare with another graph
    #[arg(long, value_name = "NAME")]
    compare: Option<String>,
    /// Compare with another scene, from the same camera
    #[arg(long, value_name = "FILE.ply")]
    compare_scene: Option<PathBuf>,
    /// Set a parameter of the graph of --compare or, without --compare, of a copy of the same graph; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = options::setting)]
    compare_set: Vec<(String, String)>,
    /// Display of the comparison [default: split]
    #[arg(long = "as", value_name = "HOW")]
    compare_as: Option<CompareMode>,
    /// Position of the split line, as a share of the width
    #[arg(long, value_name = "0..1", default_value_t = 0.5)]
    split: f32,
    /// Amplification of the difference
    #[arg(long, value_name = "FACTOR", default_value_t = 8.0)]
    gain: f32,
    /// Resolution of the picture: pixels per pixel of the window, in each direction
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    scale: f32,
    /// Tools to open, comma-separated [default: as in the last window (not with --screenshot or --frames), or
    /// parameters,times,timeline,hud; in a window below 900 pixels wide, parameters,hud]
    #[arg(long, value_name = "PANELS", value_enum, value_delimiter = ',')]
    show: Vec<ShowPanel>,
    /// Inspect a resource after a pass (names as in `dump`), in the inspector
    #[arg(long, value_name = "RESOURCE@PASS", value_parser = options::inspect_target)]
    inspect: Option<(String, String)>,
    /// Measure the difference of A and B once both are drawn
    #[arg(long)]
    measure: bool,
    /// Select an item (names as in `dump`): the inspector describes it
    #[arg(long, value_name = "pass:NAME|barrier:N|resource:NAME")]
    select: Option<Selection>,
    /// Pick the splat at a position in the first picture, given as shares of its width and height
    #[arg(long, value_name = "X,Y", value_parser = place, conflicts_with = "select")]
    pick: Option<[f32; 2]>,
    /// Select the splats in a box of the first picture, given as shares of its width and height
    #[arg(long, value_name = "LEFT,TOP,RIGHT,BOTTOM", value_parser = area)]
    select_box: Option<[f32; 4]>,
    /// Theme of the window [default: as in the last window (not with --screenshot or --frames), or dark]
    #[arg(long, value_enum)]
    theme: Option<Theme>,
    /// Draw as fast as the device can, without waiting for the display
    #[arg(long)]
    no_vsync: bool,
    /// Draw continuously, even if nothing changes, to measure times
    #[arg(long)]
    continuous: bool,
    #[command(flatten)]
    device: BackendArgs,
    /// Write events as JSON, one object per line; `-` is standard output
    #[arg(long, value_name = "FILE")]
    events: Option<PathBuf>,
    /// Save a picture of the window (.png, .exr or .npy) once everything is built, and close the window
    #[arg(long, value_name = "FILE")]
    screenshot: Option<PathBuf>,
    /// Draw continuously, and close the window after this many frames (with --screenshot: draw at least this many)
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
    #[command(flatten)]
    load: LoadOptions,
}

/// Maximum width and height of a window, in pixels.
const MAX_WINDOW_SIDE: u32 = 16_384;

/// Window width, in pixels, below which two side panels leave no room for the picture.
const SMALL: u32 = 900;

impl Args {
    fn size(&self) -> (u32, u32) {
        self.drawing.size.unwrap_or((1600, 900))
    }

    fn check(&self) -> Result<(), Usage> {
        let within = |name: &str, value: f32, range: RangeInclusive<f32>| match range.contains(&value) {
            true => Ok(()),
            false => Err(Usage(format!(
                "expected {name} from {} to {}, found {value}",
                range.start(),
                range.end()
            ))),
        };
        within("--scale", self.scale, 0.05..=4.0)?;
        within("--split", self.split, 0.0..=1.0)?;
        within("--gain", self.gain, 0.0..=65_536.0)?;
        for value in self.background {
            within("the channels of --background", value, 0.0..=1.0)?;
        }
        let (width, height) = self.size();
        if width.max(height) > MAX_WINDOW_SIDE {
            return Err(Usage(format!(
                "expected --size up to {MAX_WINDOW_SIDE}x{MAX_WINDOW_SIDE}, found {width}x{height}"
            )));
        }
        if self.frames == Some(0) {
            return Err(Usage("expected --frames of at least 1, found 0".to_owned()));
        }
        if self.show.contains(&ShowPanel::None) && self.show.len() > 1 {
            return Err(Usage("expected --show none alone, found other panels with it".to_owned()));
        }
        Ok(())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CompareMode {
    /// A to the left of a line, B to the right
    Split,
    /// The amplified absolute difference
    Difference,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Theme {
    /// Light text on a dark background
    Dark,
    /// Dark text on a light background
    Light,
}

fn place(text: &str) -> Result<[f32; 2], String> {
    shares(text).ok_or_else(|| format!("expected two numbers from 0 to 1, found `{text}`"))
}

fn area(text: &str) -> Result<[f32; 4], String> {
    shares(text).ok_or_else(|| format!("expected four numbers from 0 to 1, found `{text}`"))
}

fn shares<const N: usize>(text: &str) -> Option<[f32; N]> {
    let share = |text: &str| text.trim().parse::<f32>().ok().filter(|v| (0.0..=1.0).contains(v));
    let all: Option<Vec<f32>> = text.split(',').map(share).collect();
    all?.try_into().ok()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ShowPanel {
    /// Parameters of the graph
    #[value(alias = "settings")]
    Parameters,
    /// Saved views, the path and the field of view
    Cameras,
    /// Times and memory
    #[value(alias = "performance")]
    Times,
    /// The selected pass, barrier, resource or splat, with the contents of resources
    Inspector,
    /// Passes in order, with barriers and memory
    #[value(alias = "graph")]
    Timeline,
    /// Frame time and messages, on the picture
    Hud,
    /// No tool: the picture alone
    None,
}

pub(super) fn check_files(args: &Args) -> Result<(), Usage> {
    if let [second, ..] = args.more.as_slice() {
        return Err(Usage(format!(
            "expected one scene, found {}: to compare two, add `--compare-scene {}`; to view several in one picture, \
             list them in a file (.ron)",
            args.more.len() + 1,
            second.display()
        )));
    }
    let graphs = [("--pipeline", "name it without an option", &args.drawing.pipeline)];
    let compared = args.compare.iter().map(|graph| ("--compare", "use --compare-scene", graph));
    for (option, remedy, graph) in graphs.into_iter().chain(compared) {
        if SceneFormat::of_name(Path::new(graph)).is_some() {
            return Err(Usage(format!("{option}: expected a graph, found the scene {graph}: {remedy}")));
        }
    }
    let mut guard = options::claim_inputs(args.scene.as_deref(), args.drawing.cameras.as_deref())?;
    for graph in [Some(&args.drawing.pipeline), args.compare.as_ref()].into_iter().flatten() {
        guard.input("the graph", Path::new(graph))?;
    }
    if let Some(path) = &args.compare_scene {
        guard.scene("the other scene", path)?;
    }
    if let Some(path) = &args.screenshot {
        if is_standard_output(path) || Format::of(path).is_none() {
            return Err(Usage(format!(
                "expected a file for --screenshot with the extension .png, .exr or .npy, found {}",
                path.display()
            )));
        }
        guard.output("--screenshot", path)?;
    }
    if let Some(path) = &args.events {
        guard.output("--events", path)?;
    }
    Ok(())
}

pub fn run(args: &Args) -> Result<Outcome> {
    check_files(args)?;
    args.check()?;
    let parse = |spec: &str| cameras::parse(spec, args.drawing.ignore_distortion);
    let cameras = args.drawing.cameras.as_deref().map(parse).transpose()?;
    let is_beside = cameras.is_none();
    let files = args.scene.as_deref().map_or_else(Vec::new, opening::files);
    let (scene, cameras) = scene_and_cameras(args, cameras)?;
    args.up.as_ref().map_or(Ok(()), |up| up.read(&cameras))?;
    let events = args.events.as_deref().map(Log::create).transpose()?;
    let (pipeline, mut set) = (args.drawing.pipeline.clone(), args.drawing.set.clone());
    set.extend(storage(args, &scene.0, &scene.1)?);
    let messages = window::run(WindowOptions {
        scene,
        pipeline,
        set,
        size: args.size(),
        // A screenshot must have exactly the requested size.
        exact_size: args.drawing.size.is_some() && args.screenshot.is_some(),
        backend: args.device.backend,
        device: args.device.options(),
        // Scripted runs neither restore nor save the window layout, so that each opens the same window.
        kept: if args.screenshot.is_some() || args.frames.is_some() { None } else { kept::path() },
        setup: Box::new(|shell, size| {
            // The demo's file is stamped when the window opens.
            if !files.is_empty() {
                shell.viewer.set_files_read(files);
            }
            let cameras = if is_beside { CameraList::beside(cameras) } else { cameras.into() };
            shell.viewer.set_cameras(cameras);
            set_up(args, shell, size)
        }),
        events,
        screenshot: args.screenshot.clone(),
        frames: args.frames,
    })?;
    Ok(super::outcome::validated(args.device.validate, &messages))
}

/// Chooses a splat storage that fits `--memory` and the device, and prints it; `None` keeps the graph's own. Opens the
/// device only with `--memory`, or for a scene that may be too large for some supported device.
///
/// # Errors
/// The device cannot be opened, or the scene at `path` does not fit it with any storage.
fn storage(args: &Args, scene: &Scene, path: &Path) -> Result<Option<(String, String)>> {
    let limit = args.memory.memory;
    let scaled = |side: u32| ((side as f32 * args.scale) as u32).max(1);
    let size = (scaled(args.size().0), scaled(args.size().1));
    if limit.is_none() && !fit::may_exceed_any(scene.count().into(), size) {
        return Ok(None);
    }
    let device = args.device.open()?;
    let (graph, set) = (&args.drawing.pipeline, &args.drawing.set);
    let (catalog, scene) = (&facts::catalog(scene), SceneFacts::of(scene));
    let facts = facts::facts(&scene, &device.info().facts, size);
    let mut planner = Planner::default();
    let found = Choice::within(limit, &device.heap(), set, |set| planner.plan(graph, set, &facts, catalog));
    let target = Target::now(&device, limit);
    let wanted = Wanted { graph, set, scene, catalog, size };
    if matches!(found, Ok(None) | Err(StorageError::Plan(_))) {
        fit::check(&wanted, &target, path, &args.load)?;
    }
    let found = found.map_err(|error| error.with_fit(&wanted, &target, path, &args.load))?;
    let choice = found.map(|(choice, _)| choice);
    choice.iter().filter(|choice| limit.is_some() || choice.set.is_some()).for_each(say);
    Ok(choice.and_then(|choice| choice.set))
}

fn scene_and_cameras(args: &Args, given: Option<Vec<Camera>>) -> Result<((Scene, PathBuf), Vec<Camera>)> {
    let (scene, path, own) = loading::scene_or_demo(&loading::NEVER, args.scene.as_deref(), &args.load)?;
    let beside = || camera::beside(&path).and_then(|file| cameras::load_beside(&file));
    let cameras = given.or(own.map(|own| vec![own])).or_else(beside).unwrap_or_default();
    // The viewer takes cameras in world coordinates; cameras far from the scene are reported.
    loading::in_scene(&cameras, &scene);
    Ok(((scene, path), cameras))
}

/// Sets the initial state of the shell. The pair is the window's size, in pixels.
fn set_up(args: &Args, shell: &mut Shell, (width, _): (u32, u32)) -> Result<()> {
    let restored = shell.panels.is_restored() && args.show.is_empty();
    let show = match args.show.as_slice() {
        [] if width < SMALL => vec![ShowPanel::Parameters, ShowPanel::Hud],
        [] => vec![ShowPanel::Parameters, ShowPanel::Times, ShowPanel::Timeline, ShowPanel::Hud],
        show => show.to_vec(),
    };
    let has = |panel| show.contains(&panel);
    let mut tools = Vec::new();
    for (panel, tool) in [
        (ShowPanel::Parameters, Tool::Parameters),
        (ShowPanel::Cameras, Tool::Cameras),
        (ShowPanel::Inspector, Tool::Inspector),
        (ShowPanel::Times, Tool::Times),
        (ShowPanel::Timeline, Tool::Timeline),
    ] {
        if has(panel) || (panel == ShowPanel::Inspector && args.inspect.is_some()) {
            tools.push(tool);
        }
    }
    if !restored {
        shell.panels.open_tools(&tools);
        shell.panels.hud = has(ShowPanel::Hud);
    }
    shell.panels.hidden = has(ShowPanel::None);
    if let Some(selection) = &args.select {
        shell.panels.select_requested(selection.clone());
    }
    if let Some(place) = args.pick {
        shell.panels.pick_first(place);
    }
    if let Some(corners) = args.select_box {
        shell.panels.select_first(corners);
    }
    if let Some(theme) = args.theme {
        shell.context().set_theme(match theme {
            Theme::Dark => egui::Theme::Dark,
            Theme::Light => egui::Theme::Light,
        });
    }
    shell.panels.vsync = !args.no_vsync;
    let viewer = &mut shell.viewer;
    viewer.continuous = args.continuous || args.frames.is_some() || args.screenshot.is_some();
    if let Some(up) = args.up.as_ref().and_then(Up::direction) {
        viewer.set_up(up);
    }
    viewer.set_load_options(args.load.clone());
    viewer.background = args.background;
    (viewer.split, viewer.gain, viewer.scale) = (args.split, args.gain, args.scale);
    let compared = args.measure
        || args.compare.is_some()
        || args.compare_scene.is_some()
        || !args.compare_set.is_empty()
        || args.compare_as.is_some();
    if compared {
        viewer.set_compare(match args.compare_as {
            Some(CompareMode::Difference) => Mode::Difference,
            _ => Mode::Split,
        })?;
        if let Some(b) = viewer.viewport(RendererId::B) {
            let graph = args.compare.clone().unwrap_or_else(|| b.renderer.graph().to_owned());
            b.renderer.choose(&graph, args.compare_set.iter().cloned().collect());
        }
        if let Some(path) = &args.compare_scene {
            viewer.open_scene_in(RendererId::B, path);
        }
        if args.measure {
            viewer.measure();
        }
    }
    if let Some((resource, pass)) = &args.inspect {
        viewer.a.look_at(resource, pass);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;
    use splatgraph_assets::synth;

    #[test]
    fn options_of_other_commands_are_described_as_the_window_takes_them() {
        let view = <Args as clap::Args>::augment_args(clap::Command::new("view"));
        let help = |option: &str| {
            let found = view.get_arguments().find(|argument| argument.get_id() == option).expect(option);
            let texts = [found.get_help(), found.get_long_help()];
            texts.into_iter().flatten().map(ToString::to_string).collect::<String>()
        };
        assert_eq!(help("size"), "Size of the window [default: 1600x900]");
        assert!(help("cameras").ends_with("[default: all cameras of the file beside the scene]"));
    }

    #[test]
    fn all_cameras_beside_the_scene_are_opened_and_a_file_without_cameras_is_no_error() {
        let folder = tempfile::tempdir().unwrap();
        let (scene, beside) = (folder.path().join("a.ply"), folder.path().join("cameras.json"));
        synth::generate("uniform", 10, 0).unwrap().write_ply(&scene).unwrap();
        let args: Args = parsed(["view".as_ref(), scene.as_os_str()]).unwrap();
        let cameras = || scene_and_cameras(&args, None).expect("the scene opens").1;
        assert_eq!(cameras(), []);
        let saved = synth::demo_cameras();
        Camera::save(&saved, &beside).unwrap();
        assert_eq!(cameras(), saved);
        std::fs::write(&beside, "{}").unwrap();
        assert_eq!(cameras(), []);
    }
}
