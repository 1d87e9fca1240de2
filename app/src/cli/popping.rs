//! Runs `splatgraph popping`: the error that changes from frame to frame.

use super::cameras;
use super::options::{self, DEFAULT_PIPELINE, DrawingBackendArgs};
use super::{Outcome, Usage, claim_graph_files};
use crate::draw::fit;
use crate::draw::session::Session;
use crate::io::output::names::{self, MAX_NAME_BYTES};
use crate::io::output::{self, OutputGuard, is_standard_output, one_line};
use crate::io::progress::Progress;
use crate::studies::popping::measure::{self, Path as CameraPath, Variant};
use crate::studies::popping::report::{self, Summary};
use anyhow::{Context, Result};
use serde_json::json;
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene};
use std::path::{Path, PathBuf};

/// Measure popping along a path of cameras: how the error changes from frame to frame
///
/// The exact renderer draws every frame of the path (`render --backend reference`), and so does each graph. From a frame to the
/// next, a graph's picture changes, and so does the true one. The `pop` of a step is the mean over the pixels of the difference of
/// both changes, which is the change of the error: 0 for an error that stays as it is, however large. The `excess` is the mean of
/// what a pixel changes more than the true one does, and at most the pop. Both are of values clamped to 0..1.
///
/// The table: the step in degrees that the camera turns, means over the steps, the pop for each degree, the worst step, the worst
/// pixel of any step, and how many pairs of splats change places in a step, in the drawn order and in the true one. Pops of two
/// different steps cannot be compared, and a finer step may rank the graphs differently: an error that drifts with the surfaces
/// falls with the step, one that jumps falls less. The published order, in which the exact renderer draws, has a pop of 0 by
/// definition, although it pops, too: two splats change places where their depths cross. Frames are drawn once and in turn, so that `stale_order` has the
/// order of the path's last frame.
///
/// Without SCENE, the demo scene is drawn; the first use generates it. Without cameras, or with one, the path is a short orbit
/// around the middle of the scene.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph popping                                        # the demo scene, every built-in graph
  splatgraph popping scene.ply -c path.json -o popping/     # popping.csv, popping.svg and popping.png
  splatgraph popping scene.ply -p splat -p unsorted --with key_bits=8 --with key_bits=8,key_map=linear
  splatgraph popping scene.ply --frames 60 --step 0.1 --json popping.json")]
pub struct Args {
    /// A scene file: .ply, .compressed.ply, .spz, .splat, .ksplat or .sog
    scene: Option<PathBuf>,
    /// A graph: the name of a built-in one, or a path; may be repeated [default: all built-in ones]
    #[arg(short, long, value_name = "NAME")]
    pipeline: Vec<String>,
    /// Parameters of the graph `auto` that make a variant of it; may be repeated, for several variants
    #[arg(long, value_name = "NAME=VALUE,...", value_parser = variant)]
    with: Vec<Variant>,
    /// The path, as cameras: a COLMAP folder, a transforms.json or a cameras.json; `#2` or `#NAME` selects one [default: the first beside the scene]
    #[arg(short, long, value_name = "PATH[#INDEX]|JSON")]
    cameras: Option<String>,
    /// Frames of the orbit, or the first frames of the path [default: 12, or the whole path]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    frames: Option<u32>,
    /// Degrees of the orbit between two frames
    #[arg(long, value_name = "DEGREES", default_value_t = 0.25, value_parser = degrees)]
    step: f64,
    /// Size of the pictures [default: the cameras', at most 480 pixels wide]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = options::size)]
    size: Option<(u32, u32)>,
    /// File for all numbers as JSON, or `-` for standard output in place of the table
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    json: Option<PathBuf>,
    /// Folder for popping.csv, popping.svg and popping.png
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    device: DrawingBackendArgs,
}

/// Frames of an orbit without `--frames`.
const FRAMES: u32 = 12;
/// Width of the pictures without `--size`, in pixels.
const WIDTH: u32 = 480;
/// Files in the folder of `--output`.
const CSV: &str = "popping.csv";
const SVG: &str = "popping.svg";
const PNG: &str = "popping.png";

/// Parses `NAME=VALUE,...`.
fn variant(text: &str) -> Result<Variant, String> {
    let set = text.split(',').map(options::setting).collect::<Result<Vec<_>, _>>()?;
    let name = set.iter().map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join(",");
    Ok(Variant { name, pipeline: DEFAULT_PIPELINE.into(), set })
}

fn degrees(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(degrees) if degrees.is_finite() && degrees.abs() <= 180.0 => Ok(degrees),
        _ => Err("expected degrees from -180 to 180".into()),
    }
}

pub fn run(args: &Args) -> Result<Outcome> {
    let given = cameras::load(args.cameras.as_deref(), args.scene.as_deref())?;
    let names = options::camera_names(args.scene.as_deref(), given.as_deref());
    let stems = names::unique(&names, MAX_NAME_BYTES);
    let mut guard = guard(args)?;
    let variants = variants(args);
    let device = args.device.open()?;
    if let Some(path) = &args.scene {
        for variant in &variants {
            fit::check_header(path, device.info(), &variant.pipeline, &variant.set)?;
        }
    }
    let (scene, cameras) = options::scene_and_cameras(args.scene.as_deref(), given, &stems, args.size)?;
    let path = path(args, &scene, cameras)?;
    measure::check(&path)?;
    let origin = origin(args, &scene, &path, device.info());
    let size = (path[0].width, path[0].height);
    let mut session = Session::new(device, scene, DEFAULT_PIPELINE, &[]);
    // Mistakes in a graph are told before the true pictures are drawn, which takes the longest.
    for variant in &variants {
        session.set_graph(&variant.pipeline, &variant.set);
        session.controls(size)?;
    }
    claim_graph_files(&mut guard, &session.files())?;

    let mut progress = Progress::new("measuring popping");
    let of = (path.len() * (1 + variants.len())) as u64;
    let frames = path.len();
    let mut told = |row: usize, frame: usize, what: &str| {
        progress.set((row * frames + frame) as u64, of, &format!("{what}, frame {frame}"));
    };
    let path = CameraPath::new(session.scene(), path, &mut |frame| told(0, frame, "the exact pictures"))?;
    let mut tracks = Vec::new();
    for (row, variant) in variants.iter().enumerate() {
        let name = one_line(&variant.name);
        tracks.push(measure::measure(&mut session, variant, &path, &mut |at| told(1 + row, at, &name))?);
    }
    drop(progress);

    let summaries: Vec<Summary> = tracks.iter().map(report::summary).collect();
    if !args.json.as_deref().is_some_and(is_standard_output) {
        options::write_text(None, &format!("{}{}", report::table(&summaries), report::NOTES))?;
    }
    if let Some(file) = &args.json {
        let rows = summaries.iter().zip(&tracks);
        let rows: Vec<_> =
            rows.map(|(summary, track)| json!({ "summary": summary, "track": track })).collect();
        options::write_json(file, &json!({ "origin": origin, "variants": rows, "notes": report::NOTES }))?;
    }
    if let Some(folder) = &args.output {
        let plot = report::plot(&tracks);
        output::write_bytes(&folder.join(CSV), report::csv(&tracks).as_bytes())?;
        output::write_bytes(&folder.join(SVG), plot.svg()?.as_bytes())?;
        plot.image()?.save(&folder.join(PNG))?;
    }
    Ok(super::validated(args.device.validate, &session.into_device().close()))
}

/// Lists what is drawn: the given graphs and variants, or all built-in graphs. A name that is given twice is drawn once.
fn variants(args: &Args) -> Vec<Variant> {
    let graph = |name: &str| Variant { name: name.into(), pipeline: name.into(), set: Vec::new() };
    let mut all: Vec<Variant> = args.pipeline.iter().map(|name| graph(name)).collect();
    if all.is_empty() && args.with.is_empty() {
        all = options::measured_names().into_iter().map(graph).collect();
    } else if all.is_empty() {
        all.push(graph(DEFAULT_PIPELINE));
    }
    all.extend(args.with.iter().cloned());
    let mut kept: Vec<Variant> = Vec::new();
    for variant in all {
        if !kept.contains(&variant) {
            kept.push(variant);
        }
    }
    kept
}

/// Makes the path: the given cameras, or an orbit around one.
fn path(args: &Args, scene: &Scene, mut cameras: Vec<Camera>) -> Result<Vec<Camera>> {
    if args.size.is_none() {
        cameras = cameras.iter().map(|camera| options::at_most(camera, WIDTH)).collect();
    }
    if let [camera] = cameras.as_slice() {
        return Ok(measure::orbit(scene, camera, args.frames.unwrap_or(FRAMES), args.step));
    }
    cameras.truncate(args.frames.map_or(usize::MAX, |frames| frames as usize));
    cameras.first().context("no cameras")?;
    Ok(cameras)
}

fn origin(
    args: &Args,
    scene: &Scene,
    path: &[Camera],
    device: &splatgraph_api::DeviceInfo,
) -> serde_json::Value {
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "scene": args.scene.as_ref().map_or_else(|| "demo".into(), |path| path.display().to_string()),
        "splats": scene.count(),
        "cameras": path,
        "device": format!("{} ({})", device.name, device.driver),
    })
}

/// Lists the files; an error if an output would destroy an input.
pub(super) fn guard(args: &Args) -> Result<OutputGuard, Usage> {
    let mut guard = options::claim_inputs(args.scene.as_deref(), args.cameras.as_deref())?;
    for graph in &args.pipeline {
        guard.input("a graph", Path::new(graph))?;
    }
    if let Some(json) = &args.json {
        guard.output("--json", json)?;
    }
    for name in [CSV, SVG, PNG] {
        if let Some(folder) = &args.output {
            guard.output("--output", &folder.join(name))?;
        }
    }
    Ok(guard)
}
