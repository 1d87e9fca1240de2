//! Runs `splatgraph render`: draws pictures of a scene and measures their cost.

use super::options::{self, DeviceArgs, Drawing, MAX_SIDE};
use super::{Outcome, Usage, claim_graph_files};
use crate::backend::{Api, Backend};
use crate::fit;
use crate::image::{Format, Image};
use crate::inspect::{self, Finding};
use crate::output::names::{self, MAX_NAME_BYTES, MIN_ROOM_BYTES};
use crate::output::{Claims, is_standard_output, note, one_line, say};
use crate::progress::Progress;
use crate::session::{FrameOptions, Session, image_of};
use crate::stats::CameraStats;
use crate::truth::{self, Map, Truth};
use crate::turns;
use anyhow::{Context, Result, bail};
use splatgraph_api::{Device, FRAMES_IN_FLIGHT, FrameResult, Inspect};
use splatgraph_assets::Camera;
use splatgraph_framework::plan::Plan;
use std::collections::VecDeque;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;

mod destination;
mod exact;
mod kept;

use destination::{Destination, per_camera, stem};
use kept::Kept;

pub const EXAMPLES: &str = "Examples:
  splatgraph render -o demo.png                                          # the demo scene
  splatgraph render scene.ply --cameras cameras.json -o pictures/ --format npy
  splatgraph render scene.ply --cameras cameras.json#2 --size 1920x1080 -o out.exr
  splatgraph render scene.ply --pipeline digit4 --set cutoff=3.0 -o out.png
  splatgraph render scene.ply --repeat 100 --json -                      # times, as medians
  splatgraph render scene.ply --inspect keys@scatter=keys.npy -o out.png
  splatgraph render scene.ply --pipeline my/graph.ron --validate -o out.png
  splatgraph render scene.ply --backend reference -o exact.npy           # exactly, on the CPU
  splatgraph render scene.ply --backend reference --rule stop=none --map contributors=count.npy";

/// Draw a scene
///
/// A graph draws it on a device; with `--backend reference`, the exact renderer does, on the CPU, in f64. Without SCENE, the demo
/// scene is drawn; the first use generates it. Without cameras, one that frames the scene is used.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A scene file: .ply, .compressed.ply, .spz, .splat or .sog
    scene: Option<PathBuf>,
    #[command(flatten)]
    drawing: Drawing,
    /// Choose the renderer: `vulkan`, on Apple's systems `metal`, or `reference`, the exact one on the CPU
    ///
    /// The first two execute the graph on a device. `null` executes nothing, for a look at what everything else costs: its pictures are
    /// black, and its times mean nothing. The exact renderer follows the published CUDA rasteriser rule by rule in f64, shares no
    /// arithmetic with the shaders and executes no graph. Other pictures are measured against its own.
    #[arg(long, value_name = "NAME", default_value_t = Renderer::Device(Api::default()), value_parser = renderer)]
    backend: Renderer,
    /// Change a rule of the exact renderer; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = options::setting, long_help = exact::rule_help())]
    rule: Vec<(String, String)>,
    /// Write what the exact renderer knows of each pixel: `transmittance` (float32) or `contributors` (splats, uint32)
    #[arg(long, value_name = "NAME=FILE.npy", value_parser = exact::map)]
    map: Vec<(Map, PathBuf)>,
    /// Background colour, display-encoded, 0 to 1
    #[arg(long, value_name = "R,G,B", default_value = "0,0,0", allow_hyphen_values = true, value_parser = options::colour)]
    background: [f32; 3],
    /// Output: .png (8 bits), .exr or .npy (float32, as blended, not clamped), or a folder
    ///
    /// A name without one of these extensions is a folder: it gets one picture per camera, named after the camera's img_name.
    /// What a file name cannot have becomes `_`, and two cameras never share a file: the second gets its index after its name.
    /// `-` writes the picture of one camera to standard output, in the format of --format. A picture is whole, or not there.
    #[arg(short, long, value_name = "OUT", required_unless_present_any = ["json", "inspect", "map"])]
    output: Option<PathBuf>,
    /// Format of the pictures in a folder [default: png]
    #[arg(long, value_name = "png|exr|npy")]
    format: Option<Format>,
    /// Write statistics as JSON, one entry per camera; `-` is standard output
    #[arg(long, value_name = "STATS.json")]
    json: Option<PathBuf>,
    /// Number of frames per camera; times are medians over them, after a warm-up of a fifth of a second where there are several
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = repeat)]
    repeat: u32,
    /// Read a resource back after a pass (names as in `dump`), print its first and last words, and write it to FILE.npy
    ///
    /// `keys` stands for the half of the pair that the pass writes, `scatter` for the last of `sort.scatter[0]`,
    /// `sort.scatter[1]`, ... For a resource whose name begins with `keys`, the output says whether its keys ascend.
    #[arg(long, value_name = "RESOURCE@PASS[=FILE.npy]", value_parser = inspect_request)]
    inspect: Vec<InspectRequest>,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Names the renderer of `--backend`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Renderer {
    Device(Api),
    Reference,
}

/// The name of the exact renderer.
const REFERENCE: &str = "reference";

impl fmt::Display for Renderer {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Renderer::Device(api) => api.fmt(f),
            Renderer::Reference => f.write_str(REFERENCE),
        }
    }
}

/// Parses the value of `--backend`.
fn renderer(text: &str) -> Result<Renderer, String> {
    match text {
        REFERENCE => Ok(Renderer::Reference),
        _ => Api::find(text).map(Renderer::Device).ok_or_else(|| Api::refusal(text, &[REFERENCE])),
    }
}

/// A parsed `RESOURCE@PASS[=FILE.npy]`.
#[derive(Clone, Debug)]
struct InspectRequest {
    resource: String,
    pass: String,
    file: Option<PathBuf>,
}

fn inspect_request(text: &str) -> Result<InspectRequest, String> {
    let (target, file) = match text.split_once('=') {
        Some((target, file)) if Format::of(Path::new(file)) == Some(Format::Npy) => {
            (target, Some(file.into()))
        }
        Some(_) => return Err("expected a file name with the extension .npy".into()),
        None => (text, None),
    };
    let (resource, pass) = options::inspect_target(target)?;
    Ok(InspectRequest { resource, pass, file })
}

/// Parses the number of frames. The times of all of them are kept for the medians.
fn repeat(text: &str) -> Result<u32, String> {
    const MOST: u32 = 100_000;
    match text.parse() {
        Ok(frames @ 1..=MOST) => Ok(frames),
        _ => {
            Err(format!("expected 1 to {MOST} frames, as the times of all of them are kept for the medians"))
        }
    }
}

/// The cameras of a run and its files, known before the device is opened.
#[derive(Debug)]
pub(super) struct Work {
    /// The cameras of the command line; `None` for those of the scene.
    given: Option<Vec<Camera>>,
    destination: Option<Destination>,
    /// A file name for each camera, without extension, unlike all others.
    stems: Vec<String>,
    claims: Claims,
}

/// Reads the cameras and chooses the names of all files; an error if one of them would destroy another, or an input.
pub(super) fn prepare(args: &Args) -> Result<Work> {
    refuse_options_of_others(args)?;
    let destination = Destination::of(args.output.as_deref(), args.format)?;
    let given = args.drawing.cameras()?;
    for camera in given.iter().flatten().filter(|_| args.drawing.size.is_none()) {
        if camera.width.max(camera.height) > MAX_SIDE {
            bail!(
                "the camera {} has pictures of {} x {} pixels; no device has images larger than {MAX_SIDE} x {MAX_SIDE}",
                one_line(&camera.img_name),
                camera.width,
                camera.height
            );
        }
    }
    let names = options::camera_names(args.scene.as_deref(), given.as_deref());
    if let (Some(Destination::Picture(path, _)), [_, _, ..]) = (&destination, names.as_slice()) {
        let message = format!(
            "expected one camera for the picture {}, found {}: name a folder, or one camera with --cameras FILE#INDEX",
            path.display(),
            names.len()
        );
        return Err(Usage(message).into());
    }
    if args.output.as_deref().is_some_and(is_standard_output) {
        options::refuse_terminal("the picture")?;
    }
    let files: Vec<(&str, &Path)> = args.files().collect();
    // The longest text around a camera's name: that of a picture, or `keys-NAME.npy`.
    let around = files
        .iter()
        .map(|(_, file)| stem(file).len() + "-.npy".len())
        .chain([".png".len()])
        .max()
        .unwrap_or(0);
    if names.len() > 1 && around + MIN_ROOM_BYTES > MAX_NAME_BYTES {
        let message = format!(
            "a file of --inspect or --map has a name of {around} bytes, which leaves no room for the cameras' names"
        );
        return Err(Usage(message).into());
    }
    let stems = names::unique(&names, MAX_NAME_BYTES.saturating_sub(around));

    let mut claims = Claims::default();
    let mut claim = || -> Result<(), Usage> {
        if let Some(path) = &args.scene {
            claims.input("the scene", path)?;
        }
        if let Some(path) = &args.drawing.cameras {
            options::claim_cameras(&mut claims, path)?;
        }
        claims.input("the graph", Path::new(&args.drawing.pipeline))?;
        if let Some(path) = &args.json {
            claims.output("--json", path)?;
        }
        for stem in &stems {
            if let Some(destination) = &destination {
                claims.output("--output", &destination.path(stem))?;
            }
            for (option, file) in &files {
                claims.output(option, &per_camera(file, stem, stems.len()))?;
            }
        }
        Ok(())
    };
    claim()?;
    Ok(Work { given, destination, stems, claims })
}

pub fn run(args: &Args) -> Result<Outcome> {
    // Errors of the command line and of the device are reported before a large scene is loaded.
    let work = prepare(args)?;
    let Renderer::Device(api) = args.backend else { return run_exactly(args, work) };
    let Work { given, destination, stems, mut claims } = work;
    let device = Backend::open(api, &args.device.options())?;
    if let Some(path) = &args.scene {
        fit::check_header(path, device.info(), &args.drawing.pipeline, &args.drawing.set)?;
    }
    let (scene, cameras) =
        options::scene_and_cameras(args.scene.as_deref(), given, &stems, args.drawing.size)?;

    let mut session = Session::new(device, scene, &args.drawing.pipeline, &args.drawing.set);
    if !args.inspect.is_empty() {
        session.keep_contents();
    }
    let mut all = Vec::with_capacity(cameras.len());
    let stdout = Stdout::of(args);
    let mut progress = Progress::new("drawing");
    for (index, (camera, stem)) in cameras.iter().zip(&stems).enumerate() {
        progress.set(index as u64, cameras.len() as u64, &camera.img_name);
        let loaded = prepare_plan(&mut session, camera)?;
        if loaded {
            progress.suspend(|| session.tell_settings_without_effect());
            claim_graph_files(&mut claims, &session.files())?;
        }
        let Drawn { stats, image, requests } =
            draw(args, &mut session, camera, destination.is_some(), loaded)?;
        let tell = |line: String| progress.suspend(|| stdout.line(&line));
        match (&destination, image) {
            (Some(destination), Some(image)) => {
                let path = destination.path(stem);
                image.save_as(destination.format(), &path)?;
                tell(format!("{}: {} x {}, {}", path.display(), image.width, image.height, stats.line()))?;
            }
            _ => tell(format!("{}: {}", one_line(&camera.img_name), stats.line()))?,
        }
        for (finding, inspect_request) in stats.inspected.iter().zip(requests) {
            tell(finding.text())?;
            if let Some(file) = &args.inspect[inspect_request].file {
                finding.save(&per_camera(file, stem, cameras.len()))?;
            }
        }
        all.push(stats);
    }
    drop(progress);
    if let Some(path) = &args.json {
        options::write_json(path, &serde_json::to_value(&all)?)?;
    }
    Ok(super::validated(args.device.validate, &session.into_device().close()))
}

/// Draws with the exact renderer.
fn run_exactly(args: &Args, Work { given, destination, stems, .. }: Work) -> Result<Outcome> {
    let rules = truth::rules(&args.rule).map_err(|error| Usage(error.to_string()))?;
    let (scene, cameras) =
        options::scene_and_cameras(args.scene.as_deref(), given, &stems, args.drawing.size)?;
    let stdout = Stdout::of(args);
    let mut all = Vec::with_capacity(cameras.len());
    for (camera, stem) in cameras.iter().zip(&stems) {
        let truth = Truth::draw(&scene, camera, args.background, &rules);
        let name = match &destination {
            Some(destination) => {
                let path = destination.path(stem);
                truth.image().save_as(destination.format(), &path)?;
                path.display().to_string()
            }
            None => one_line(&camera.img_name).into_owned(),
        };
        stdout.line(&format!("{name}: {} x {}, {}", camera.width, camera.height, truth.stats))?;
        for (map, file) in &args.map {
            truth.save(*map, &per_camera(file, stem, cameras.len()))?;
        }
        all.push(truth.stats);
    }
    if let Some(path) = &args.json {
        options::write_json(path, &serde_json::to_value(&all)?)?;
    }
    Ok(Outcome::Done)
}

/// Refuses options that have no meaning for the chosen renderer.
fn refuse_options_of_others(args: &Args) -> Result<(), Usage> {
    let device = &args.device;
    let given = match args.backend {
        Renderer::Device(_) => vec![("--rule", !args.rule.is_empty()), ("--map", !args.map.is_empty())],
        Renderer::Reference => vec![
            ("--pipeline", args.drawing.pipeline != options::DEFAULT_PIPELINE),
            ("--set", !args.drawing.set.is_empty()),
            ("--repeat", args.repeat != 1),
            ("--inspect", !args.inspect.is_empty()),
            ("--device", device.device.is_some()),
            ("--validate", device.validate),
            ("--no-robustness", device.no_robustness),
        ],
    };
    let Some((option, _)) = given.iter().find(|(_, given)| *given) else { return Ok(()) };
    Err(Usage(match args.backend {
        Renderer::Device(_) => format!("{option} is for the exact renderer: add --backend reference"),
        Renderer::Reference => format!(
            "{option} is for graphs, and the exact renderer executes none; its rules are changed with --rule"
        ),
    }))
}

impl Args {
    /// The files beside the pictures, with their options; several cameras have one each.
    fn files(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        let inspected = self.inspect.iter().filter_map(|request| request.file.as_deref());
        let maps = self.map.iter().map(|(_, file)| ("--map", file.as_path()));
        inspected.map(|file| ("--inspect", file)).chain(maps)
    }
}

/// The use of standard output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stdout {
    /// A file is written there, which must be alone; lines go to standard error.
    File,
    /// Its lines are all that the command gives.
    Product,
    /// Its lines tell of the files that the command is for.
    Notes,
}

impl Stdout {
    fn of(args: &Args) -> Stdout {
        let others = args.files().map(|(_, file)| file);
        let files: Vec<&Path> =
            args.output.iter().chain(&args.json).map(PathBuf::as_path).chain(others).collect();
        match files.iter().any(|file| is_standard_output(file)) {
            true => Stdout::File,
            false if files.is_empty() => Stdout::Product,
            false => Stdout::Notes,
        }
    }

    fn line(self, line: &str) -> Result<()> {
        match self {
            Stdout::File => say(line),
            Stdout::Product => return options::print(line),
            Stdout::Notes => note(line),
        }
        Ok(())
    }
}

/// The results of one camera.
struct Drawn {
    stats: CameraStats,
    image: Option<Image>,
    /// Index of the `--inspect` option of each finding in `stats`. Contents after the prologue are read once per load.
    requests: Vec<usize>,
}

/// Draws the frames of one camera with the prepared plan, which is `loaded` anew or not.
fn draw(
    args: &Args,
    session: &mut Session<Backend>,
    camera: &Camera,
    wanted: bool,
    loaded: bool,
) -> Result<Drawn> {
    let plan = session.plan().context("no plan after `prepare`")?.clone();
    let resolve = |plan: &Plan, inspect_request: &InspectRequest| {
        inspect::resolve(plan, &inspect_request.resource, &inspect_request.pass)
    };
    let targets: Vec<Inspect> = args
        .inspect
        .iter()
        .map(|inspect_request| resolve(&plan, inspect_request))
        .collect::<Result<_, _>>()?;

    let mut kept = Kept::default();
    let mut findings: Vec<Option<Finding>> = vec![None; targets.len()];
    let mut flying: VecDeque<(_, Vec<usize>, bool)> = VecDeque::new();
    let mut growths = session.growths();
    let mut land = |session: &mut Session<Backend>, (id, asked, counts): (_, Vec<usize>, _)| -> Result<()> {
        let result = session.wait(id)?;
        let plan = session.plan().context("no plan after a frame")?;
        // The passes of a plan with less room may be others, and their times mean another plan.
        if std::mem::replace(&mut growths, session.growths()) != session.growths() {
            kept = Kept::default();
        }
        for (bytes, &index) in result.inspected.iter().zip(&asked) {
            let target = resolve(plan, &args.inspect[index])?;
            findings[index] = Some(Finding::new(plan, &target, bytes, visible(&result)));
        }
        kept.add(result, plan, counts);
        Ok(())
    };
    // A device that has rested draws at a lower clock: of several frames, those of a warm-up do not count.
    let begun = Instant::now();
    let mut warm = args.repeat == 1;
    let (mut counted, mut first) = (0, true);
    while counted < args.repeat {
        counted += u32::from(warm);
        let last = counted == args.repeat;
        // The results of the prologue can only be read in the frame that runs it.
        let due = |target: &Inspect| if inspect::in_prologue(&plan, target) { first && loaded } else { last };
        let asked: Vec<usize> = (0..targets.len()).filter(|&i| due(&targets[i])).collect();
        let request = FrameOptions {
            background: args.background,
            read_output: wanted && last,
            inspect: asked.iter().map(|&i| targets[i]).collect(),
            untimed_passes: false,
        };
        first = false;
        if flying.len() == FRAMES_IN_FLIGHT
            && let Some(oldest) = flying.pop_front()
        {
            land(session, oldest)?;
        }
        flying.push_back((session.submit(camera, &request)?, asked, warm));
        warm |= begun.elapsed() >= turns::WARM_UP;
    }
    for frame in flying {
        land(session, frame)?;
    }

    let plan = session.plan().context("no plan after the frames")?.clone();
    let image = match kept.output() {
        Some(pixels) => Some(image_of(&pixels).with_context(|| not_colours(&plan))?),
        None if wanted => bail!("the device returned no picture"),
        None => None,
    };
    let scene_count = session.scene().count().into();
    let memory = session.device().memory();
    let info = session.device().info();
    let size = (camera.width, camera.height);
    let mut stats = kept.stats((&camera.img_name, size), &plan, info, scene_count, memory);
    let found = findings
        .into_iter()
        .enumerate()
        .filter_map(|(inspect_request, finding)| Some((inspect_request, finding?)));
    let requests;
    (requests, stats.inspected) = found.unzip();
    Ok(Drawn { stats, image, requests })
}

/// Builds and loads the plan, with progress.
fn prepare_plan(session: &mut Session<Backend>, camera: &Camera) -> Result<bool> {
    let mut compiling = Progress::new("making pipelines");
    let mut uploading = None;
    let loaded = session.prepare((camera.width, camera.height), &mut |step| match step {
        splatgraph_api::Progress::Pipeline { done, of, shader } => {
            compiling.set(done as u64, of as u64, shader)
        }
        splatgraph_api::Progress::Upload { done_bytes, of_bytes } => {
            uploading
                .get_or_insert_with(|| Progress::new("uploading the scene"))
                .set(done_bytes, of_bytes, "");
        }
    })?;
    Ok(loaded)
}

fn visible(result: &FrameResult) -> Option<u64> {
    result.stats.iter().find(|(name, _)| name == "visible").map(|(_, count)| (*count).into())
}

fn not_colours(plan: &Plan) -> String {
    format!("the graph's output `{}` has no colours", plan.resource(plan.output).name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn more_frames_than_their_times_can_be_kept_of_are_refused() {
        let parse = |frames: &str| Line::try_parse_from(["render", "--json", "-", "--repeat", frames]);
        assert_eq!(parse("100000").unwrap().args.repeat, 100_000);
        for frames in ["0", "100001", "4294967295", "4294967296", "many"] {
            assert!(
                parse(frames).unwrap_err().to_string().contains("expected 1 to 100000 frames"),
                "{frames}"
            );
        }
    }

    #[test]
    fn what_to_inspect_is_a_resource_a_pass_and_perhaps_a_file() {
        let found = inspect_request("keys#1@sort.scatter[2]=a/b.npy").unwrap();
        assert_eq!((found.resource.as_str(), found.pass.as_str()), ("keys#1", "sort.scatter[2]"));
        assert_eq!(found.file, Some("a/b.npy".into()));
        assert!(inspect_request("keys@scatter=keys.txt").is_err());
    }
}
