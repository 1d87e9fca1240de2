//! `splatgraph render`: pictures of a scene, and what they cost.

use super::options::{self, Drawing};
use super::{Outcome, Usage};
use crate::demo;
use crate::image::{Format, Image};
use crate::inspect::{self, Finding};
use crate::progress::Progress;
use crate::session::{FrameRequest, Session, image_of};
use crate::stats::CameraStats;
use anyhow::{Context, Result, bail};
use splatgraph_api::{Device, FRAMES_IN_FLIGHT, FrameResult, Inspect};
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::{Options, Validation, Vulkan};
use std::collections::{BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

pub const EXAMPLES: &str = "Examples:
  splatgraph render -o demo.png                                          # the demo scene
  splatgraph render scene.ply --cameras cameras.json -o pictures/ --format npy
  splatgraph render scene.ply --cameras cameras.json#2 --size 1920x1080 -o out.exr
  splatgraph render scene.ply --pipeline digit4 --set cutoff=3.0 -o out.png
  splatgraph render scene.ply --repeat 100 --json -                      # times, as medians
  splatgraph render scene.ply --inspect keys@sort.scatter=keys.npy -o out.png
  splatgraph render scene.ply --pipeline my/graph.ron --validate -o out.png";

/// Draw a scene
///
/// Without SCENE, the demo scene is drawn; it is generated on first use. Without cameras, one that frames the scene.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A .ply file in the layout of the reference implementation
    scene: Option<PathBuf>,
    #[command(flatten)]
    drawing: Drawing,
    /// Colour of what nothing covers, display-encoded, 0 to 1
    #[arg(long, value_name = "R,G,B", default_value = "0,0,0", value_parser = options::colour)]
    background: [f32; 3],
    /// Where the picture goes: .png (8 bits), .exr or .npy (float32, as blended, not clamped), or a folder
    ///
    /// A name without such an ending is a folder: it gets one picture per camera, named after the camera's img_name.
    #[arg(short, long, value_name = "OUT", required_unless_present_any = ["json", "inspect"])]
    output: Option<PathBuf>,
    /// Format of the pictures in a folder [default: png]
    #[arg(long, value_name = "png|exr|npy")]
    format: Option<Format>,
    /// Write statistics as JSON, one entry per camera; `-` is standard output
    #[arg(long, value_name = "STATS.json")]
    json: Option<PathBuf>,
    /// Frames per camera; times are the medians over them
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Read a resource back after a pass (names as in `dump`), print its ends, and write it to FILE.npy
    ///
    /// `keys` stands for the half of the pair that the pass writes, and a pass without its index for the last one. Of a
    /// resource whose name begins with `keys` it is said whether its keys ascend.
    #[arg(long, value_name = "RESOURCE@PASS[=FILE.npy]", value_parser = wish)]
    inspect: Vec<Wish>,
    /// The device: a part of its name, or its index in `splatgraph devices`
    #[arg(long, value_name = "NAME|INDEX")]
    device: Option<String>,
    /// Draw under Vulkan's validation layer with synchronization validation; exit with code 1 if it says anything
    #[arg(long)]
    validate: bool,
}

/// `RESOURCE@PASS[=FILE.npy]`.
#[derive(Clone, Debug)]
struct Wish {
    resource: String,
    pass: String,
    file: Option<PathBuf>,
}

fn wish(text: &str) -> Result<Wish, String> {
    let (target, file) = match text.split_once('=') {
        Some((target, file)) if Format::of(Path::new(file)) == Some(Format::Npy) => {
            (target, Some(file.into()))
        }
        Some(_) => return Err("the file's name must end with .npy".into()),
        None => (text, None),
    };
    match target.split_once('@') {
        Some((resource, pass)) if !resource.is_empty() && !pass.is_empty() => {
            Ok(Wish { resource: resource.into(), pass: pass.into(), file })
        }
        _ => Err("expected RESOURCE@PASS, for instance keys@sort.scatter".into()),
    }
}

pub fn run(args: &Args) -> Result<Outcome> {
    // A device that is not there is known before a large scene is loaded.
    let validation = if args.validate { Validation::Synchronization } else { Validation::Off };
    let device = Vulkan::open(&Options { device: args.device.clone(), validation })?;
    let (scene, cameras) = scene_and_cameras(args)?;
    let outputs = outputs(args, &cameras)?;

    let mut session = Session::new(device, scene, &args.drawing.pipeline, &args.drawing.set);
    let mut all = Vec::with_capacity(cameras.len());
    let mut progress = Progress::new("drawing");
    for (index, camera) in cameras.iter().enumerate() {
        progress.set(index as u64, cameras.len() as u64, &camera.img_name);
        let (stats, image) = draw(args, &mut session, camera, outputs.is_some())?;
        for (finding, wish) in stats.inspected.iter().zip(&args.inspect) {
            progress.say(&finding.text());
            if let Some(file) = &wish.file {
                finding.save(&numbered(file, camera, cameras.len()))?;
            }
        }
        if let (Some(outputs), Some(image)) = (&outputs, image) {
            image.save(&outputs[index])?;
            // Where the JSON goes to standard output, it goes alone.
            let line =
                format!("{}: {} x {}, {}", outputs[index].display(), image.width, image.height, stats.line());
            if to_stdout(args) { progress.say(&line) } else { progress.print(&line) }
        } else if !to_stdout(args) {
            progress.print(&format!("{}: {}", camera.img_name, stats.line()));
        }
        all.push(stats);
    }
    drop(progress);
    if let Some(path) = &args.json {
        options::write_json(path, &serde_json::to_value(&all)?)?;
    }
    Ok(finish(args, session.into_device()))
}

fn to_stdout(args: &Args) -> bool {
    args.json.as_deref() == Some(Path::new("-"))
}

/// Closes the device and prints what validation had to say.
fn finish(args: &Args, device: Vulkan) -> Outcome {
    let messages = device.close();
    for message in &messages {
        eprintln!("validation: {message}");
    }
    match (args.validate, messages.len()) {
        (false, _) => Outcome::Done,
        (true, 0) => {
            eprintln!("validation: no messages");
            Outcome::Done
        }
        (true, count) => {
            eprintln!("error: the validation layer gave {count} messages");
            Outcome::Failed
        }
    }
}

/// The scene, and the cameras to draw it from, in the size that was asked for, each with a name of its own.
fn scene_and_cameras(args: &Args) -> Result<(Scene, Vec<Camera>)> {
    let given = args.drawing.cameras()?;
    let (scene, own) = match &args.scene {
        Some(path) => (options::load_scene(path)?, None),
        None => {
            let path = demo::path();
            let made = demo::ensure(&path)
                .with_context(|| format!("the demo scene cannot be written to {}", path.display()))?;
            if made {
                eprintln!("the demo scene was generated into {}", path.display());
            }
            (options::load_scene(&path)?, demo::camera())
        }
    };
    let mut cameras = given.or(own.map(|own| vec![own])).unwrap_or_else(|| vec![options::framing(&scene)]);
    let mut taken = BTreeSet::new();
    for (index, camera) in cameras.iter_mut().enumerate() {
        if let Some((width, height)) = args.drawing.size {
            *camera = camera.resized(width, height);
        }
        if camera.img_name.is_empty() {
            camera.img_name = format!("camera{index}");
        }
        if !taken.insert(camera.img_name.clone()) {
            camera.img_name = format!("{}-{index}", camera.img_name);
            taken.insert(camera.img_name.clone());
        }
    }
    Ok((scene, cameras))
}

/// The file of each camera's picture, if pictures are wanted.
fn outputs(args: &Args, cameras: &[Camera]) -> Result<Option<Vec<PathBuf>>> {
    let Some(output) = &args.output else { return Ok(None) };
    if let Some(format) = Format::of(output) {
        if cameras.len() > 1 {
            let message = format!(
                "{} is one picture, and there are {} cameras: name a folder, or one camera with --cameras FILE#INDEX",
                output.display(),
                cameras.len()
            );
            return Err(Usage(message).into());
        }
        if args.format.is_some_and(|wanted| wanted != format) {
            return Err(Usage(format!("--format and the ending of {} do not agree", output.display())).into());
        }
        return Ok(Some(vec![output.clone()]));
    }
    if let Some(extension) = output.extension().filter(|_| !output.is_dir() && args.format.is_none()) {
        let message = format!(
            "pictures are written as .png, .exr or .npy, not as .{} (a folder of that name needs --format)",
            extension.display()
        );
        return Err(Usage(message).into());
    }
    let extension = args.format.unwrap_or(Format::Png).extension();
    // The name of a photograph may hold a path.
    let file =
        |camera: &Camera| output.join(format!("{}.{extension}", camera.img_name.replace(['/', '\\'], "_")));
    Ok(Some(cameras.iter().map(file).collect()))
}

/// `keys.npy` as `keys-NAME.npy` where there are several cameras.
fn numbered(file: &Path, camera: &Camera, cameras: usize) -> PathBuf {
    if cameras == 1 {
        return file.to_owned();
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!("{stem}-{}.npy", camera.img_name.replace(['/', '\\'], "_")))
}

/// Draws the frames of one camera.
fn draw(
    args: &Args,
    session: &mut Session<Vulkan>,
    camera: &Camera,
    wanted: bool,
) -> Result<(CameraStats, Option<Image>)> {
    let loaded = prepare(session, camera)?;
    let plan = session.plan().context("the plan was just made")?.clone();
    let targets: Vec<Inspect> = args
        .inspect
        .iter()
        .map(|wish| inspect::resolve(&plan, &wish.resource, &wish.pass))
        .collect::<Result<_, _>>()?;

    let mut results = Vec::with_capacity(args.repeat as usize);
    let mut findings: Vec<Option<Finding>> = vec![None; targets.len()];
    let mut flying: VecDeque<(_, Vec<usize>)> = VecDeque::new();
    let mut land = |session: &mut Session<Vulkan>, (id, asked): (_, Vec<usize>)| -> Result<()> {
        let result = session.wait(id)?;
        for (bytes, &target) in result.inspected.iter().zip(&asked) {
            let visible = visible(&result);
            findings[target] = Some(Finding::new(&plan, &targets[target], bytes, visible));
        }
        results.push(result);
        Ok(())
    };
    for frame in 0..args.repeat {
        let (first, last) = (frame == 0, frame + 1 == args.repeat);
        // What the prologue leaves can only be read in the frame that runs it.
        let due = |target: &Inspect| if inspect::in_prologue(&plan, target) { first && loaded } else { last };
        let asked: Vec<usize> = (0..targets.len()).filter(|&i| due(&targets[i])).collect();
        let request = FrameRequest {
            background: args.background,
            read_output: wanted && last,
            inspect: asked.iter().map(|&i| targets[i]).collect(),
        };
        if flying.len() == FRAMES_IN_FLIGHT
            && let Some(oldest) = flying.pop_front()
        {
            land(session, oldest)?;
        }
        flying.push_back((session.submit(camera, &request)?, asked));
    }
    for frame in flying {
        land(session, frame)?;
    }

    let image = match results.last_mut().and_then(|result| result.output.take()) {
        Some(pixels) => Some(image_of(&pixels).with_context(|| not_colours(&plan))?),
        None if wanted => bail!("the device gave no picture back"),
        None => None,
    };
    let scene_count = session.scene().count().into();
    let memory = session.device().memory();
    let info = session.device().info();
    let size = (camera.width, camera.height);
    let mut stats = CameraStats::new((&camera.img_name, size), &plan, info, scene_count, &results, memory);
    stats.inspected = findings.into_iter().flatten().collect();
    Ok((stats, image))
}

/// Makes and loads the plan, with progress.
fn prepare(session: &mut Session<Vulkan>, camera: &Camera) -> Result<bool> {
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
    format!("the graph's output `{}` holds no colours", plan.resource(plan.output).name)
}
