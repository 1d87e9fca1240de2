//! Runs `splatgraph bench`: time, bytes and memory of graphs, drawn in turns.

use super::options::{self, DEFAULT_PIPELINE, DeviceArgs, EffortArgs};
use super::{Outcome, Usage};
use crate::backend::Backend;
use crate::bench::limit::{self, CopyLimit};
use crate::bench::measure::{Bench, Candidate, Frames};
use crate::bench::report::{Origin, Report, Row, SceneOrigin, size_text};
use crate::bench::table;
use crate::output::names::{self, MAX_NAME_BYTES};
use crate::output::{self, Claims, is_standard_output, say};
use crate::progress::Progress;
use anyhow::{Result, bail};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene, grouped, synth};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Measure graphs against each other, pass by pass
///
/// Draws the scene with several graphs in turns, frame by frame, so that a change of the device's clock concerns all of them. Each
/// time is the median of the rounds' medians, and its spread the largest of these without the smallest; the mean over the cameras is
/// the mean of their medians. Frames of a warm-up do not count.
///
/// First, a copy from buffer to buffer shows how many bytes per second the device moves at best. Each pass is held against it: its
/// bytes are the buffers and images that it reads and those that it writes, each once, at their declared size. A pass that reads
/// something again moves more, and one that works on the visible splats alone moves less than that.
///
/// Without SCENE, the demo scene is drawn; the first use generates it. Without cameras, one that frames the scene is used.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph bench                                                         # the demo scene, with the default graph
  splatgraph bench scene.ply --pipelines splat,key16,my/graph.ron --json bench.json
  splatgraph bench scene.ply -c cameras.json --sizes 1920x1080,3840x2160 --splats 1000000,3000000 -o bench/")]
pub struct Args {
    /// .ply files in the layout of the reference implementation
    scenes: Vec<PathBuf>,
    /// The graphs to compare: names of built-in ones, or paths
    #[arg(short, long, value_name = "NAME,...", default_value = DEFAULT_PIPELINE, value_delimiter = ',')]
    pipelines: Vec<String>,
    /// Set a parameter of all graphs; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
    /// Sizes of the pictures [default: the cameras']
    #[arg(long, value_name = "WIDTHxHEIGHT,...", value_delimiter = ',', value_parser = options::size)]
    sizes: Vec<(u32, u32)>,
    /// Numbers of splats: the scene is enlarged with copies inside its splats, as `synth --enlarge` does, or cut [default: as it is]
    #[arg(long, value_name = "N,...", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..))]
    splats: Vec<u32>,
    /// Cameras in the format of the reference implementation's cameras.json; `#2` or `#NAME` selects one. For several scenes, one
    /// for all, or one for each in the same order
    #[arg(short, long, value_name = "FILE[#INDEX]")]
    cameras: Vec<String>,
    /// Write every number as JSON; `-` is standard output
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    /// Folder for bench.csv
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    effort: EffortArgs,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Files in the folder of `--output`.
const CSV: &str = "bench.csv";

pub fn run(args: &Args) -> Result<Outcome> {
    let work = prepare(args)?;
    let device = Backend::open(&args.device.options())?;
    let (rounds, frames) = args.effort.given();
    let frames = Frames { rounds, frames };
    let copy = copy_limit(&device, frames)?;
    let origin = Origin::new(device.info(), copy, frames, &args.set);
    let mut report = Report { origin, scenes: Vec::new(), rows: Vec::new() };
    for (index, given) in work.cameras.iter().enumerate() {
        let path = args.scenes.get(index).map(PathBuf::as_path);
        measure_scene(args, &device, (path, given.clone()), &mut report)?;
    }
    show(args, &table::tables(&report))?;
    if let Some(path) = &args.json {
        options::write_json(path, &serde_json::to_value(&report)?)?;
    }
    if let Some(folder) = &args.output {
        output::write_bytes(&folder.join(CSV), report.csv().as_bytes())?;
        say(format!("{} has every number", folder.join(CSV).display()));
    }
    let outcome = super::validated(args.device.validate, &device.close());
    Ok(if report.drawn().next().is_none() { Outcome::Failed } else { outcome })
}

/// Prints the tables; to standard error where standard output is the JSON.
fn show(args: &Args, text: &str) -> Result<()> {
    if args.json.as_deref().is_some_and(is_standard_output) {
        say(text.trim_end());
        return Ok(());
    }
    options::write_text(None, text)
}

/// Measures the copy limit, and says why if it cannot.
fn copy_limit(device: &Backend, frames: Frames) -> Result<Option<CopyLimit>> {
    let copy = limit::measure(device, frames, limit::no_scene()?)?;
    Ok(copy.unwrap_or_else(|why| {
        say(format!("the copy limit cannot be measured: {why}"));
        None
    }))
}

/// Measures a scene, or the demo scene, in all of its numbers of splats and sizes.
fn measure_scene(
    args: &Args,
    device: &Backend,
    (path, given): (Option<&Path>, Option<Vec<Camera>>),
    report: &mut Report,
) -> Result<()> {
    let stems = names::unique(&options::camera_names(path, given.as_deref()), MAX_NAME_BYTES);
    let (base, cameras) = options::scene_and_cameras(path, given, &stems, None)?;
    let scene = path.map_or_else(|| "demo".into(), |path| path.display().to_string());
    report.scenes.push(SceneOrigin {
        scene: scene.clone(),
        splats: base.count(),
        cameras: serde_json::to_value(&cameras)?,
    });
    let base = Arc::new(base);
    let counts = if args.splats.is_empty() { vec![base.count()] } else { args.splats.clone() };
    let sizes: Vec<_> =
        if args.sizes.is_empty() { vec![None] } else { args.sizes.iter().copied().map(Some).collect() };
    let candidates: Vec<Candidate> = args
        .pipelines
        .iter()
        .map(|pipeline| Candidate { pipeline: pipeline.clone(), set: args.set.clone() })
        .collect();
    let mut progress = Progress::new(format!("measuring {}", table::scene_name(&scene)));
    let of = (counts.len() * sizes.len() * cameras.len()) as u64;
    let mut done = 0;
    for splats in counts {
        let row = |size, pipeline: &str, found| Row {
            scene: scene.clone(),
            splats,
            size,
            pipeline: pipeline.to_owned(),
            found,
        };
        progress.set(done, of, &format!("{} splats", grouped(splats.into())));
        let enlarged = match enlarged(&base, splats) {
            Ok(scene) => scene,
            Err(error) => {
                let places =
                    sizes.iter().flat_map(|size| args.pipelines.iter().map(move |name| (size, name)));
                report.rows.extend(places.map(|(size, name)| row(*size, name, Err(error.to_string()))));
                done += (sizes.len() * cameras.len()) as u64;
                continue;
            }
        };
        for size in &sizes {
            let resized =
                |camera: &Camera| size.map_or_else(|| camera.clone(), |(w, h)| camera.resized(w, h));
            let cameras: Vec<Camera> = cameras.iter().map(resized).collect();
            let bench = Bench {
                device,
                scene: enlarged.clone(),
                frames: report.origin.effort,
                copy: report.origin.copy.as_ref().map(|copy| copy.gb_per_s),
            };
            let place = format!("{} splats, {}", grouped(splats.into()), size_text(*size));
            let outcomes = bench.measure(&candidates, &cameras, &mut |at| {
                progress.set(done + at as u64, of, &place);
            })?;
            done += cameras.len() as u64;
            let rows = args.pipelines.iter().zip(outcomes).map(|(name, found)| row(*size, name, found));
            report.rows.extend(rows);
        }
    }
    Ok(())
}

/// Makes a scene of so many splats; the scene itself if it has as many.
fn enlarged(base: &Arc<Scene>, splats: u32) -> Result<Arc<Scene>> {
    Ok(if base.count() == splats { base.clone() } else { Arc::new(synth::enlarge(base, splats)?) })
}

/// The inputs of a run, known before the device is opened.
#[derive(Debug)]
pub(super) struct Work {
    /// The cameras of each scene of the command line; `None` for those of the scene. One for the demo scene.
    cameras: Vec<Option<Vec<Camera>>>,
}

/// Reads the cameras, and checks the files of the command line.
pub(super) fn prepare(args: &Args) -> Result<Work> {
    let scenes = args.scenes.len().max(1);
    if args.cameras.len() > 1 && args.cameras.len() != scenes {
        bail!(Usage(format!(
            "expected one --cameras for all scenes, or {scenes}, one for each; found {}",
            args.cameras.len()
        )));
    }
    for name in &args.pipelines {
        if name.trim().is_empty() {
            bail!(Usage("--pipelines: expected names with a comma between them, found an empty one".into()));
        }
        if args.pipelines.iter().filter(|other| *other == name).count() > 1 {
            bail!(Usage(format!("--pipelines: expected each graph once, found `{name}` twice")));
        }
    }
    claim_files(args)?;
    let cameras = |index: usize| {
        let spec = args.cameras.get(index).or(args.cameras.first());
        spec.map(|spec| options::cameras(spec)).transpose()
    };
    Ok(Work { cameras: (0..scenes).map(cameras).collect::<Result<_, _>>()? })
}

/// Returns an error if a file of the results would destroy an input.
fn claim_files(args: &Args) -> Result<(), Usage> {
    let mut claims = match args.scenes.as_slice() {
        [] => options::claim_inputs(None, None)?,
        _ => Claims::default(),
    };
    for scene in &args.scenes {
        claims.input("the scene", scene)?;
    }
    for cameras in &args.cameras {
        options::claim_cameras(&mut claims, cameras)?;
    }
    for pipeline in &args.pipelines {
        claims.input("the graph", Path::new(pipeline))?;
    }
    if let Some(path) = &args.json {
        claims.output("--json", path)?;
    }
    if let Some(folder) = &args.output {
        claims.output("--output", &folder.join(CSV))?;
    }
    Ok(())
}
