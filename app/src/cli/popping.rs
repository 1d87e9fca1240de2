//! Runs `splatgraph popping`: measures how errors change from frame to frame.

use super::cameras;
use super::console::Console;
use super::loading;
use super::options::{self, BackendArgs, DEFAULT_PIPELINE, rule_help};
use super::outcome::{Outcome, Usage, claim_graph_files, once};
use super::subject;
use crate::draw::projection;
use crate::draw::truth;
use crate::io::load::LoadOptions;
use crate::io::output::{self, OutputGuard};
use crate::io::report::text;
use crate::studies::measurement::settings;
use crate::studies::popping::report::{self, Summary};
use crate::studies::popping::{measure, study};
use crate::studies::provenance::Provenance;
use crate::studies::study::Setting;
use anyhow::{Context, Result};
use serde_json::json;
use splatgraph_assets::{Camera, Projection, Scene};
use splatgraph_reference::Rules;
use std::path::{Path, PathBuf};

/// Measure popping along a path of cameras: how the error changes from frame to frame
///
/// The exact renderer (`render --backend reference`) and each graph draw every frame of the path. From one frame to the
/// next, both pictures change. The `pop` of a step is the mean absolute difference of the two changes over all pixels,
/// which is the change of the error. It is 0 for a constant error, however large. The `excess` is the mean of the
/// change beyond the true change, at most the pop. Both are computed from values clamped to 0..1. The change of a pixel
/// is the mean of its channels' absolute changes, also for the worst pixel.
///
/// The table lists the mean step in degrees of camera rotation, means over the steps, the pop per degree, the worst
/// step, the worst pixel of any step, and the number of pairs of splats that change places per step, in the drawn order
/// and in the true order. Compare pops of equal steps only. With a smaller step, an error that drifts with the surfaces
/// falls in proportion. An error that jumps falls less, so the ranking of graphs may change. The exact renderer draws
/// in the published order, whose pop is therefore 0 by definition, although it pops where the depths of two splats
/// cross. With `--rule order=pixel`, it sorts the splats of each pixel by their depth there, which does not pop, and
/// the pops of the published order are measured as well. Frames are drawn once and in sequence, so `stale_order` uses
/// the order of the previous frame of the path. The state begins anew in each path, and the first camera is drawn
/// --warm-up times before.
///
/// The default scene is the demo scene, which the first use generates. With one camera, or none, the path is a short
/// orbit around the middle of the scene.
#[derive(Debug, clap::Args)]
#[command(mut_arg("backend", options::that_draws))]
#[command(after_help = "Examples:
  splatgraph popping                                        # the demo scene, every built-in graph
  splatgraph popping scene.ply -c path.json -o popping/     # popping.csv, popping.svg and popping.png
  splatgraph popping scene.ply -p splat,unsorted --with key_bits=8 --with key_bits=8,key_map=linear
  splatgraph popping scene.ply -p auto,pixel_order --rule order=pixel   # pops of the published order itself
  splatgraph popping scene.ply --frames 60 --step 0.1 --json=popping.json")]
pub struct Args {
    #[arg(help = options::optional_scene_help())]
    scene: Option<PathBuf>,
    /// The graphs: names of built-in ones, or paths [default: all built-in ones for the cameras' projection; with
    /// --with, only `auto`]
    #[arg(short, long, visible_alias = "pipelines", value_name = "NAME,...", value_delimiter = ',')]
    pipeline: Vec<String>,
    /// Also measure `auto` with these parameters; may be repeated for several variants
    #[arg(long, value_name = "NAME=VALUE,...", value_parser = variant)]
    with: Vec<Setting>,
    /// The path, as cameras: a COLMAP folder, a transforms.json, a cameras.json or a glTF file; `#2` or `#NAME` selects
    /// one [default: the first camera beside the scene, or one that frames the scene]
    #[arg(short, long, value_name = "PATH[#INDEX]|JSON")]
    cameras: Option<String>,
    /// Number of frames of the orbit, or of the start of the path [default: 12, or the whole path]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    frames: Option<u32>,
    /// Degrees of the orbit between successive frames
    #[arg(long, value_name = "DEGREES", default_value_t = 0.25, value_parser = degrees)]
    step: f64,
    /// Frames of the first camera before the path, for graphs that average frames
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..=10_000))]
    warm_up: u32,
    #[arg(long, value_name = "NAME=VALUE", value_parser = options::setting)]
    #[arg(help = RULE_HELP, long_help = rule_help(RULE_HELP))]
    rule: Vec<(String, String)>,
    /// Size of the pictures [default: the cameras', at most 480 pixels wide]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = options::size)]
    size: Option<(u32, u32)>,
    /// Print all numbers as JSON instead of the table, or write them to FILE
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
    /// Folder for popping.csv, popping.svg and popping.png
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    device: BackendArgs,
    #[command(flatten)]
    load: LoadOptions,
}

const FRAMES: u32 = 12;
const WIDTH: u32 = 480;
const RULE_HELP: &str = "Change a rule of the true pictures; may be repeated";
const CSV: &str = "popping.csv";
const PLOT: &str = "popping";

/// Parses parameter values of the default graph, `NAME=VALUE,...`.
fn variant(text: &str) -> Result<Setting, String> {
    let set = text.split(',').map(options::setting).collect::<Result<Vec<_>, _>>()?;
    Ok(Setting { name: text::parameters(&set), pipeline: DEFAULT_PIPELINE.into(), set })
}

fn degrees(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(degrees) if degrees.is_finite() && degrees.abs() <= 180.0 => Ok(degrees),
        _ => Err("expected degrees from -180 to 180".into()),
    }
}

pub fn run(args: &Args) -> Result<Outcome> {
    // Report invalid rules before a large scene is loaded.
    truth::rules(Rules::PUBLISHED, &args.rule).map_err(|error| Usage(error.to_string()))?;
    once("--pipeline", &args.pipeline, |name| format!("`{name}`"))?;
    once("--with", &args.with, |variant| format!("`{}`", variant.name))?;
    let given = cameras::load(args.cameras.as_deref(), args.scene.as_deref(), false)?;
    let mut guard = guard(args)?;
    let own = projection::of_cameras(given.as_deref().unwrap_or_default());
    let variants = variants(args, own);
    let graph = shared_projection(&variants)?.unwrap_or(own);
    let scene = (args.scene.as_deref(), &args.load);
    let mut subject = subject::load(args.device.open()?, scene, &variants, given, args.size)?;
    let path = path(args, &subject.scene, subject.cameras)?;
    // The exact renderer draws each camera in its own projection.
    subject.cameras = projection::convert_all(&path, graph, &subject.scene, args.size)?;
    measure::check(&subject.cameras)?;
    // Report errors in the graphs before the exact pictures are drawn, which takes long.
    claim_graph_files(&mut guard, &subject.check(&variants)?)?;
    let tracks = study(&subject, &variants, args.warm_up, &args.rule, &mut Console::default())?;
    let origin = Provenance::of(&subject);

    let summaries: Vec<Summary> = tracks.iter().map(report::summary).collect();
    let text = report::table(&summaries) + report::NOTES;
    if let Some(file) = &args.json {
        let rows = summaries.iter().zip(&tracks);
        let rows: Vec<_> =
            rows.map(|(summary, track)| json!({ "summary": summary, "track": track })).collect();
        let command = options::command_line();
        let all = json!({
            "command": command, "origin": origin, "rules": args.rule, "variants": rows, "notes": report::NOTES,
        });
        options::write_json(file, &all)?;
    }
    if let Some(folder) = &args.output {
        output::write_bytes(&folder.join(CSV), report::csv(&tracks, &args.rule, &origin).as_bytes())?;
        options::write_plot(&report::plot(&tracks), folder, PLOT)?;
    }
    // Last, because standard output may be full or closed.
    options::print_beside(args.json.as_deref(), &text)?;
    Ok(super::outcome::validated(args.device.validate, &subject.device.close()))
}

/// Lists the variants: the given graphs and parameters, or else the built-in graphs for the cameras' projection except
/// `auto`.
///
/// If only `--with` is given, `auto` without parameters comes first.
fn variants(args: &Args, cameras: Projection) -> Vec<Setting> {
    let graph = |name: &str| Setting::of_graph(name, &[]);
    let mut all: Vec<Setting> = args.pipeline.iter().map(|name| graph(name)).collect();
    if all.is_empty() && args.with.is_empty() {
        all = settings::measured_names(cameras).into_iter().map(graph).collect();
    } else if all.is_empty() {
        all.push(graph(DEFAULT_PIPELINE));
    }
    all.extend(args.with.iter().cloned());
    all
}

/// Returns the projection that all variants draw. `None` if all graphs have errors, which are reported later.
///
/// # Errors
/// Two variants have different projections: their pictures cannot be compared.
fn shared_projection(variants: &[Setting]) -> Result<Option<Projection>, Usage> {
    let mut first: Option<(&str, Projection)> = None;
    for variant in variants {
        let Some(found) = projection::of_graph(&variant.pipeline, &variant.set) else { continue };
        let (name, wanted) = *first.get_or_insert((&variant.name, found));
        if found != wanted {
            return Err(Usage(format!(
                "expected graphs with one projection, found {name} ({wanted}) and {} ({found})",
                variant.name
            )));
        }
    }
    Ok(first.map(|(_, projection)| projection))
}

/// Returns the cameras of the path, at most [`WIDTH`] pixels wide without `--size`. A single camera becomes an orbit
/// around the scene; of several, the first `--frames` are kept.
fn path(args: &Args, scene: &Scene, mut cameras: Vec<Camera>) -> Result<Vec<Camera>> {
    if args.size.is_none() {
        cameras = cameras.iter().map(|camera| loading::at_most(camera, WIDTH)).collect();
    }
    cameras.iter().try_for_each(cameras::check_size)?;
    if let [camera] = cameras.as_slice() {
        return Ok(measure::orbit(scene, camera, args.frames.unwrap_or(FRAMES), args.step));
    }
    cameras.truncate(args.frames.map_or(usize::MAX, |frames| frames as usize));
    cameras.first().context("no cameras")?;
    Ok(cameras)
}

pub(super) fn guard(args: &Args) -> Result<OutputGuard, Usage> {
    let mut guard = options::claim_inputs(args.scene.as_deref(), args.cameras.as_deref())?;
    for graph in &args.pipeline {
        guard.input("a graph", Path::new(graph))?;
    }
    args.json.iter().try_for_each(|path| guard.output("--json", path))?;
    if let Some(folder) = &args.output {
        guard.output("--output", &folder.join(CSV))?;
        options::claim_plot(&mut guard, folder, PLOT)?;
    }
    Ok(guard)
}
