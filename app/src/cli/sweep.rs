//! Runs `splatgraph sweep`: quality and time as splats are removed.

use super::console::Console;
use super::options::{self, Drawing, DrawingBackendArgs, EffortArgs};
use super::outcome::{Outcome, Usage};
use crate::draw::fit;
use crate::io::output::names::{self, MAX_NAME_BYTES};
use crate::io::output::{self, say};
use crate::studies::study::Subject;
use crate::studies::sweep::choice::Choice;
use crate::studies::sweep::page::{PLOTS, Shown};
use crate::studies::sweep::{Wanted, study};
use anyhow::Result;
use splatgraph_api::Device;
use std::path::{Path, PathBuf};

/// Measure quality and time as splats are removed
///
/// Draws the scene with all splats, a half, a quarter and so on, chosen in four ways: the first of the file (a naive truncation),
/// the largest by opacity times size in the world or on the screen (the usual heuristics for levels of detail, applied before keys
/// are made), and the nearest visible ones (cut after the sort; tiles use `sorted=splats` for it). Each picture is compared with
/// the exact renderer's picture of all splats.
///
/// Then a camera comes closer, and the time of the draw is compared with the number of fragments.
///
/// The output folder gets a page (sweep.html), all numbers (sweep.csv and .json), plots as .svg and .png, and the pictures.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph sweep                                       # the demo scene; sweep/sweep.html shows the result
  splatgraph sweep scene.ply -c cameras.json --steps 8 -o garden/
  splatgraph sweep scene.ply --pipeline key16 --size 1920x1080")]
pub struct Args {
    /// A scene file: .ply, .compressed.ply, .spz, .splat, .ksplat or .sog [default: the demo scene]
    scene: Option<PathBuf>,
    #[command(flatten)]
    drawing: Drawing,
    /// Folder of the results
    #[arg(short, long, value_name = "DIR", default_value = "sweep")]
    output: PathBuf,
    /// Number of steps, each with half of the splats of the previous step; the first has all
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u32).range(2..=32))]
    steps: u32,
    #[command(flatten)]
    effort: EffortArgs,
    #[command(flatten)]
    device: DrawingBackendArgs,
}

/// Files in the folder of `--output` besides plots and pictures.
const PAGE: &str = "sweep.html";
const CSV: &str = "sweep.csv";
const JSON: &str = "sweep.json";

pub fn run(args: &Args) -> Result<Outcome> {
    let given = args.drawing.cameras(args.scene.as_deref())?;
    let room = MAX_NAME_BYTES - 40;
    let stems = names::unique(&options::camera_names(args.scene.as_deref(), given.as_deref()), room);
    claim_files(args)?;
    let device = args.device.open()?;
    if let Some(path) = &args.scene {
        fit::check_header(path, device.info(), &args.drawing.pipeline, &args.drawing.set)?;
    }
    let (scene, cameras) =
        options::scene_and_cameras(args.scene.as_deref(), given, &stems, args.drawing.size)?;
    let name = args.scene.as_deref().and_then(Path::file_stem).map_or("demo".into(), |s| s.to_string_lossy());
    let subject = Subject { device: &device, name: name.into_owned(), scene: scene.into(), cameras };
    let wanted = Wanted {
        pipeline: args.drawing.pipeline.clone(),
        set: args.drawing.set.clone(),
        steps: args.steps,
        frames: args.effort.frames(),
    };
    let (swept, shown) = study(&subject, &wanted, &mut Console::default())?;
    options::write_text(None, &swept.table())?;
    let file = |name: &str| args.output.join(name);
    output::write_bytes(&file(CSV), swept.csv().as_bytes())?;
    options::write_json(&file(JSON), &serde_json::to_value(&swept)?)?;
    for (name, plot, _) in swept.plots() {
        output::write_bytes(&file(&format!("{name}.svg")), plot.svg()?.as_bytes())?;
        plot.image()?.save(&file(&format!("{name}.png")))?;
    }
    for Shown { choice, count, picture } in &shown {
        let stem = choice.map_or("all", Choice::stem);
        picture.save(&file(&format!("pictures/{stem}-{count}.png")))?;
    }
    output::write_bytes(&file(PAGE), swept.page(&shown)?.as_bytes())?;
    say(format!("{} shows the result", file(PAGE).display()));
    Ok(super::outcome::validated(args.device.validate, &device.close()))
}

/// Returns an error if a file of the sweep would destroy an input.
pub(super) fn claim_files(args: &Args) -> Result<(), Usage> {
    let mut guard = options::claim_inputs(args.scene.as_deref(), args.drawing.cameras.as_deref())?;
    guard.input("the graph", Path::new(&args.drawing.pipeline))?;
    let plots = PLOTS.iter().flat_map(|name| ["svg", "png"].map(|format| format!("{name}.{format}")));
    for name in [PAGE, CSV, JSON].map(String::from).into_iter().chain(plots) {
        guard.output("--output", &args.output.join(name))?;
    }
    Ok(())
}
