//! Runs `splatgraph bench`: measures time, bytes and memory of graphs, drawn interleaved.

use super::cameras;
use super::console::Console;
use super::loading;
use super::options::{self, BackendArgs, DEFAULT_PIPELINE, EffortArgs};
use super::outcome::{self, Outcome, Usage, claim_graph_files, once};
use crate::draw::backend::Backend;
use crate::draw::facts::{self, SceneFacts};
use crate::draw::planner::{Planner, without_effect};
use crate::io::load::LoadOptions;
use crate::io::output::names::{self, MAX_NAME_BYTES};
use crate::io::output::{self, OutputGuard, is_standard_output, say};
use crate::io::report::plot::Plot;
use crate::studies::bench::report::{Origin, Report, scene_names, size_text};
use crate::studies::bench::{Wanted, copy_limit, plot, sort, study, table};
use crate::studies::study::{Setting, Subject};
use anyhow::{Context as _, Result, bail};
use serde::Serialize;
use splatgraph_api::{Device, DeviceInfo};
use splatgraph_assets::{Camera, SceneHeader};
use splatgraph_framework::lower;
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

/// Measure the time and memory of graphs, pass by pass
///
/// Draws the scene with all graphs interleaved, frame by frame, so that a change of the device's clock affects all of
/// them. Each time is the median of the rounds' medians, and its spread is their maximum minus their minimum. The mean
/// over the cameras is the mean of their medians. Warm-up frames do not count.
///
/// First, a copy from buffer to buffer measures how many bytes per second the device can move. Each pass is compared
/// with this copy. The bytes of a pass are the declared sizes of all buffers and images that it reads, plus those of
/// all that it writes. A pass that reads data several times moves more. A pass over only the visible splats moves less.
///
/// The default scene is the demo scene, which the first use generates. The default camera is the first beside the
/// scene, or one that frames it.
///
/// A graph that cannot be drawn is a row with the reason. If nothing could be measured, the exit code is 1.
///
/// `--suite sort` measures the sort alone instead: random pairs of a key and a 32-bit value, with keys of 16, 24 and 32
/// bits.
#[derive(Debug, clap::Args)]
#[command(mut_arg("rounds", |arg| arg.help("Number of rounds")))]
#[command(mut_arg("frames", |arg| arg.help("Frames of each graph per round [default: 1 to 30, from the frame time]")))]
#[command(after_help = "Examples:
  splatgraph bench                                     # the demo scene
  splatgraph bench scene.ply --pipelines splat,key16,my/graph.ron --json=bench.json
  splatgraph bench scene.ply -c cameras.json --sizes 1920x1080,3840x2160 -o bench/
  splatgraph bench scene.ply --splats 1000000,3000000  # enlarged
  splatgraph bench --suite sort --pairs 1048576,6000000 --set digit_bits=6")]
pub struct Args {
    #[arg(value_name = "SCENE", help = options::optional_scene_help())]
    scenes: Vec<PathBuf>,
    /// Measure whole frames, or the sort alone
    #[arg(long, value_enum, default_value_t)]
    suite: Suite,
    /// Numbers of pairs of `--suite sort` [default: 64 Ki to 64 Mi in powers of 4]
    #[arg(long, value_name = "N,...", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=268_435_456))]
    pairs: Vec<u32>,
    /// The graphs to compare: names of built-in ones, or paths
    #[arg(short, long, visible_alias = "pipeline", value_name = "NAME,...", default_value = DEFAULT_PIPELINE, value_delimiter = ',')]
    pipelines: Vec<String>,
    /// Set a parameter of all graphs; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
    /// Sizes of the pictures [default: the cameras']
    #[arg(long, visible_alias = "size", value_name = "WIDTHxHEIGHT,...", value_delimiter = ',', value_parser = options::size)]
    sizes: Vec<(u32, u32)>,
    /// Numbers of splats: the scene is enlarged by copies inside its splats (see `synth --enlarge`), or cut [default:
    /// unchanged]
    #[arg(long, value_name = "N,...", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..))]
    splats: Vec<u32>,
    /// Cameras: a COLMAP folder, a transforms.json, a cameras.json or a glTF file; `#2` or `#NAME` selects one. With
    /// several scenes, give one for all, or one for each in the same order
    #[arg(short, long, value_name = "PATH[#INDEX]|JSON")]
    cameras: Vec<String>,
    /// Print all numbers as JSON, or write them to FILE after each size and number of splats or pairs
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
    /// Folder for bench.csv, and for curves over sizes or numbers of splats or pairs as .svg and .png
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    effort: EffortArgs,
    #[command(flatten)]
    device: BackendArgs,
    #[command(flatten)]
    load: LoadOptions,
}

/// Measurements of `bench`: whole frames, or the sort alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum Suite {
    #[default]
    Frames,
    Sort,
}

const CSV: &str = "bench.csv";
const SORT_PLOT: &str = "sort";

pub fn run(args: &Args) -> Result<Outcome> {
    let mut work = prepare(args)?;
    let device = args.device.open()?;
    check_graphs(args, device.info())?;
    let frames = args.effort.frames();
    let copy = copy_limit(&device, frames, &mut Console::default())?;
    let opened = args.device.opened();
    let origin = Origin { opened, ..Origin::new(device.info(), copy, frames, &args.set) };
    let measured = match args.suite {
        Suite::Frames => measure_frames(args, &device, origin, &mut work)?,
        Suite::Sort => measure_sorts(args, &device, origin)?,
    };
    let outcome = outcome::validated(args.device.validate, &device.close());
    Ok(if measured { outcome } else { Outcome::Failed })
}

/// Measures frames and writes the results. Returns false if no graph could be drawn.
fn measure_frames(args: &Args, device: &Backend, origin: Origin, work: &mut Work) -> Result<bool> {
    let mut report = Report { origin, complete: false, scenes: Vec::new(), rows: Vec::new() };
    for (index, given) in work.cameras.iter().enumerate() {
        let path = args.scenes.get(index).map(PathBuf::as_path);
        measure_scene(args, device, &mut work.guard, (path, given.clone()), &mut report)?;
    }
    report.complete = true;
    let plots = report.scenes.iter().zip(&work.stems).flat_map(|(scene, stem)| {
        let plots = plot::plots(&report, &scene.scene, &args.splats, &args.sizes());
        plot::names(stem, &args.splats, &args.sizes()).into_iter().zip(plots)
    });
    finish(args, (&table::tables(&report), &report.csv()), &report, plots)?;
    let (drawn, all) = (report.drawn().count(), report.rows.len());
    if drawn < all {
        say(format!("{} of {all} rows could not be drawn", all - drawn));
    }
    Ok(drawn > 0)
}

/// Measures sorts and writes the results. Returns false if no sort could be run.
fn measure_sorts(args: &Args, device: &Backend, origin: Origin) -> Result<bool> {
    let usual = sort::usual_pairs();
    let pairs = if args.pairs.is_empty() { &usual } else { &args.pairs };
    let mut kept = |report: &sort::Report| keep(args, report, &report.csv(), report.rows.is_empty());
    let report = sort::measure(device, pairs, origin, &mut kept, &mut Console::default())?;
    let plot = report.plot().map(|plot| (SORT_PLOT.to_owned(), plot));
    finish(args, (&report.table(), &report.csv()), &report, plot)?;
    Ok(!report.is_empty())
}

/// Rejects graphs and parameters that are invalid both on this device and on the least capable supported one. Only the
/// first scene and size are checked. Prints the settings without an effect.
///
/// An unmet requirement is not an error: the graph becomes a row with the reason, and may suit another scene.
fn check_graphs(args: &Args, device: &DeviceInfo) -> Result<()> {
    let scene = match args.scenes.first().map(|scene| args.load.header(scene)).transpose()? {
        Some(SceneHeader { count, stored_degree }) => SceneFacts {
            count,
            sh_degree: stored_degree,
            stored_sh_degree: stored_degree,
            ..SceneFacts::NOMINAL
        },
        None => SceneFacts::NOMINAL,
    };
    let (catalog, mut planner) = (facts::nominal_catalog(), Planner::default());
    let size = args.sizes.first().copied().unwrap_or(facts::DEFAULT_SIZE);
    if args.pipelines.len() > 1 {
        let names: Vec<&str> = args.pipelines.iter().map(String::as_str).collect();
        planner.compared(&names).iter().for_each(say);
    }
    for pipeline in args.graphs() {
        let mut controls = |device| {
            planner.controls(pipeline, &args.set, &facts::facts(&scene, device, size), &catalog).map(drop)
        };
        let portable = facts::portable_device(facts::USUAL_SUBGROUP_SIZE);
        if let (Err(errors), Err(_)) = (controls(&device.facts), controls(&portable)) {
            let facts = facts::facts(&scene, &device.facts, size);
            let standing = planner.ask((pipeline, &[]), &facts, &catalog, lower::standing);
            if standing.is_ok_and(|standing| !standing.unmet.is_empty()) {
                continue;
            }
            return Err(errors.into());
        }
        if !args.set.is_empty() {
            let facts = facts::facts(&scene, &device.facts, size);
            // A graph that cannot be built on this device becomes a row of the report.
            let plan = planner.plan(pipeline, &args.set, &facts, &catalog);
            let found = plan.map(|plan| without_effect(&plan, &args.set)).unwrap_or_default();
            found.iter().for_each(|(_, text)| say(format!("{pipeline}: {text}")));
        }
    }
    Ok(())
}

/// Writes the JSON, unless it goes to standard output, and the CSV. The `first` time, removes an earlier run's plots.
fn keep(args: &Args, report: &impl Serialize, csv: &str, first: bool) -> Result<()> {
    if let Some(path) = args.json.as_deref().filter(|path| !is_standard_output(path)) {
        options::write_json(path, &serde_json::to_value(report)?)?;
    }
    let Some(folder) = &args.output else { return Ok(()) };
    let file = folder.join(CSV);
    // Without a CSV, files with the names of plots are not of an earlier run.
    if first && file.exists() {
        remove_plots(folder)?;
    }
    Ok(output::write_bytes(&file, csv.as_bytes())?)
}

/// Removes the plots of any run of `bench` from a folder.
fn remove_plots(folder: &Path) -> Result<()> {
    let (mut removed, entries) = (BTreeSet::new(), fs::read_dir(folder));
    for entry in entries.with_context(|| folder.display().to_string())? {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        if let Some(name) = path.file_stem().and_then(OsStr::to_str)
            && (name == SORT_PLOT || plot::is_name(name))
            && options::remove_plot(folder, name)?
        {
            removed.insert(name.to_owned());
        }
    }
    if !removed.is_empty() {
        let names: Vec<String> = removed.into_iter().collect();
        say(format!("{}: plots of an earlier run are removed: {}", folder.display(), names.join(", ")));
    }
    Ok(())
}

/// Prints the tables, to standard error if the JSON goes to standard output, and writes all files. `plots` are pairs of
/// file name, without extension, and plot.
fn finish(
    args: &Args,
    (text, csv): (&str, &str),
    report: &impl Serialize,
    plots: impl IntoIterator<Item = (String, Plot)>,
) -> Result<()> {
    keep(args, report, csv, false)?;
    if let Some(folder) = &args.output {
        plots.into_iter().try_for_each(|(name, plot)| options::write_plot(&plot, folder, &name))?;
    }
    // Last, because standard output may be full or closed.
    match args.json.as_deref().filter(|path| is_standard_output(path)) {
        Some(path) => {
            say(text.trim_end());
            options::write_json(path, &serde_json::to_value(report)?)?;
        }
        None => options::write_text(None, text)?,
    }
    args.output.iter().for_each(|folder| say(format!("all numbers are in {}", folder.join(CSV).display())));
    Ok(())
}

/// Measures a scene, or the demo scene, for all numbers of splats and sizes, and adds the rows to `report`.
fn measure_scene(
    args: &Args,
    device: &Backend,
    guard: &mut OutputGuard,
    (path, given): (Option<&Path>, Option<Vec<Camera>>),
    report: &mut Report,
) -> Result<()> {
    let (scene, cameras) = loading::scene_and_cameras(path, &args.load, given, None)?;
    let name = loading::scene_name(path);
    let candidates: Vec<_> =
        args.pipelines.iter().map(|pipeline| Setting::of_graph(pipeline, &args.set)).collect();
    let subject = Subject { device: device.new_context()?, name, scene: scene.into(), cameras };
    claim_graph_files(guard, &subject.files(&candidates)?)?;
    let wanted = Wanted { candidates, splats: args.splats.clone(), sizes: args.sizes() };
    // An interrupted run keeps its results.
    let mut kept = |report: &Report| keep(args, report, &report.csv(), report.rows.is_empty());
    study(&subject, &wanted, report, &mut kept, &mut Console::default())?;
    Ok(())
}

impl Args {
    /// Lists the graphs to measure.
    fn graphs(&self) -> Vec<&str> {
        match self.suite {
            Suite::Frames => self.pipelines.iter().map(String::as_str).collect(),
            Suite::Sort => vec![sort::GRAPH],
        }
    }

    /// Lists the picture sizes; without `--sizes`, a single `None`: each camera keeps its own size.
    fn sizes(&self) -> Vec<Option<(u32, u32)>> {
        if self.sizes.is_empty() { vec![None] } else { self.sizes.iter().copied().map(Some).collect() }
    }
}

#[derive(Debug)]
pub(super) struct Work {
    guard: OutputGuard,
    /// Cameras of each scene; `None` for the default camera. The demo scene has one entry.
    cameras: Vec<Option<Vec<Camera>>>,
    /// Unique file name stems, one per scene.
    stems: Vec<String>,
}

/// Checks the options and files of the command line, and reads the cameras.
pub(super) fn prepare(args: &Args) -> Result<Work> {
    let scenes = args.scenes.len().max(1);
    if args.cameras.len() > 1 && args.cameras.len() != scenes {
        bail!(Usage(format!(
            "expected one --cameras for all scenes, or {scenes}, one for each; found {}",
            args.cameras.len()
        )));
    }
    refuse_options_of_others(args)?;
    if args.pipelines.iter().any(|name| name.trim().is_empty()) {
        bail!(Usage("--pipelines: expected names separated by commas, found an empty one".into()));
    }
    once("--pipelines", &args.pipelines, |name| format!("`{name}`"))?;
    once("--sizes", &args.sizes, |size| size_text(Some(*size)))?;
    once("--splats", &args.splats, u32::to_string)?;
    once("--pairs", &args.pairs, u32::to_string)?;
    once("SCENE", &args.scenes, |path| path.display().to_string())?;
    let scene_names: Vec<String> = match args.scenes.as_slice() {
        [] => vec!["demo".into()],
        scenes => scene_names(scenes.iter().map(|path| path.to_string_lossy().into_owned())),
    };
    // `splats-NAME-32768x32768.svg` is the longest file name: 23 bytes besides the stem. One byte is spare.
    let stems = names::unique(&scene_names, MAX_NAME_BYTES - 24);
    let guard = guard(args, &stems)?;
    let cameras = |index: usize| {
        let spec = args.cameras.get(index).or(args.cameras.first());
        let scene = args.scenes.get(index).map(PathBuf::as_path);
        cameras::load_sized(spec.map(String::as_str), scene, args.sizes.first().copied(), false)
    };
    Ok(Work { guard, cameras: (0..scenes).map(cameras).collect::<Result<_, _>>()?, stems })
}

fn refuse_options_of_others(args: &Args) -> Result<(), Usage> {
    let of_frames = [
        ("SCENE", !args.scenes.is_empty()),
        ("--pipelines", args.pipelines != [DEFAULT_PIPELINE]),
        ("--sizes", !args.sizes.is_empty()),
        ("--splats", !args.splats.is_empty()),
        ("--cameras", !args.cameras.is_empty()),
    ];
    match args.suite {
        Suite::Frames if !args.pairs.is_empty() => {
            Err(Usage("--pairs is for the sort alone: add --suite sort".into()))
        }
        Suite::Frames => Ok(()),
        Suite::Sort => {
            outcome::refuse(&of_frames, |option| {
                format!("{option} is for --suite frames: the sort alone draws nothing")
            })?;
            match args.set.iter().find(|(name, _)| sort::OWN_PARAMETERS.contains(&name.as_str())) {
                Some((name, _)) => Err(Usage(format!(
                    "--set {name}: --suite sort sets it itself (--pairs lists the numbers of pairs)"
                ))),
                None => Ok(()),
            }
        }
    }
}

fn guard(args: &Args, stems: &[String]) -> Result<OutputGuard, Usage> {
    let mut guard = match args.scenes.as_slice() {
        [] => options::claim_inputs(None, None)?,
        _ => OutputGuard::default(),
    };
    for scene in &args.scenes {
        guard.scene("the scene", scene)?;
        if args.cameras.is_empty() {
            cameras::claim(&mut guard, None, Some(scene))?;
        }
    }
    for cameras in &args.cameras {
        cameras::claim_file(&mut guard, cameras)?;
    }
    for pipeline in &args.pipelines {
        guard.input("the graph", Path::new(pipeline))?;
    }
    args.json.iter().try_for_each(|path| guard.output("--json", path))?;
    if let Some(folder) = &args.output {
        guard.output("--output", &folder.join(CSV))?;
        let curves = stems.iter().flat_map(|stem| plot::names(stem, &args.splats, &args.sizes()));
        let all: Vec<String> = match args.suite {
            Suite::Frames => curves.collect(),
            Suite::Sort => vec![SORT_PLOT.into()],
        };
        all.iter().try_for_each(|name| options::claim_plot(&mut guard, folder, name))?;
    }
    Ok(guard)
}
