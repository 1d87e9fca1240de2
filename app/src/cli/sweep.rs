//! Runs `splatgraph sweep`: measures quality and time as splats are removed.

use super::console::Console;
use super::job::{self, Origin, Outputs, ShardArgs, Work};
use super::loading;
use super::options::{self, BackendArgs, Drawing, EffortArgs};
use super::outcome::{Outcome, Usage, claim_graph_files};
use super::subject;
use crate::draw::projection;
use crate::io::image::Image;
use crate::io::load::LoadOptions;
use crate::io::output::names::MAX_NAME_BYTES;
use crate::io::output::{self, OutputGuard, say};
use crate::studies::study::{Setting, Subject};
use crate::studies::sweep::approach::Closer;
use crate::studies::sweep::choice::Choice;
use crate::studies::sweep::measure::Step;
use crate::studies::sweep::page::{PLOTS, Shown, SweepResult};
use crate::studies::sweep::{Study, Wanted, study};
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::json;
use splatgraph_assets::Camera;
use std::path::{Path, PathBuf};

/// Measure quality and time as splats are removed
///
/// Draws the scene with all splats, a half, a quarter and so on, chosen in four ways: the first of the file, the
/// largest by opacity times area in the world, the largest by opacity times area on the screen, and the nearest visible
/// ones. The largest are chosen before keys are made, as usual for levels of detail. The nearest are cut after the
/// sort, for which tiles use `sorted=splats`; they are a half, a quarter and so on of the visible splats, so fewer if
/// some are outside of the view (`drawn` in sweep.csv). Each picture, the second frame of its view (a graph's state
/// begins anew), is compared with the exact renderer's picture of all splats. The page and the plots show the PSNR of
/// the mean squared error of all views, as `trade` does. `compare`, `evaluate` and `convert --price` show the mean of
/// the views' PSNRs, which is higher.
///
/// Then a camera approaches, and the time of the draw is compared with the number of fragments.
///
/// The output folder gets a page (sweep.html), all numbers (sweep.csv and .json), plots as .svg and .png, and the
/// pictures.
#[derive(Debug, clap::Args)]
#[command(mut_arg("backend", options::that_draws))]
#[command(after_help = "Examples:
  splatgraph sweep                                       # the demo scene; sweep/sweep.html shows the result
  splatgraph sweep scene.ply -c cameras.json --steps 8 -o garden/
  splatgraph sweep scene.ply --pipeline key16 --size 1920x1080")]
pub struct Args {
    #[arg(help = options::optional_scene_help())]
    scene: Option<PathBuf>,
    #[command(flatten)]
    drawing: Drawing,
    /// Folder of the results
    #[arg(short, long, value_name = "DIR", default_value = "sweep")]
    output: PathBuf,
    /// Number of steps, each with half of the splats of the previous step; the first has all splats
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u32).range(2..=32))]
    steps: u32,
    #[command(flatten)]
    effort: EffortArgs,
    #[command(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    pub device: BackendArgs,
    #[command(flatten)]
    load: LoadOptions,
}

const PAGE: &str = "sweep.html";
const CSV: &str = "sweep.csv";
const JSON: &str = "sweep.json";

/// Opens the device, loads the scene, and registers the graph's files in `guard`.
fn open(args: &Args, guard: &mut OutputGuard, given: Option<Vec<Camera>>) -> Result<(Subject, Wanted)> {
    let Drawing { pipeline, set, size, .. } = &args.drawing;
    let settings = [Setting::of_graph(pipeline, set)];
    let scene = (args.scene.as_deref(), &args.load);
    let mut subject = subject::load(args.device.open()?, scene, &settings, given, *size)?;
    let graph = projection::of_graph_for(pipeline, set, &subject.cameras);
    subject.cameras = projection::convert_all(&subject.cameras, graph, &subject.scene, *size)?;
    claim_graph_files(guard, &subject.check(&settings)?)?;
    let (pipeline, set, frames) = (pipeline.clone(), set.clone(), args.effort.frames());
    Ok((subject, Wanted { pipeline, set, steps: args.steps, frames }))
}

/// Maximum length of a camera's file name, in bytes, without suffixes.
const ROOM: usize = MAX_NAME_BYTES - 40;

pub fn run(args: &Args) -> Result<Outcome> {
    // Check the cameras before a device is opened.
    let given = args.drawing.cameras(args.scene.as_deref())?;
    let mut guard = guard(args)?;
    let (subject, wanted) = open(args, &mut guard, given)?;
    let (mut swept, shown) = study(&subject, &wanted, &mut Console::default())?;
    swept.command = options::command_line();
    remove_documents(&args.output)?;
    save_pictures(&shown, &args.output)?;
    report(&swept, &shown, &args.output)?;
    Ok(super::outcome::validated(args.device.validate, &subject.device.close()))
}

/// Removes the numbers of an earlier run, beside which new pictures would be wrong.
fn remove_documents(output: &Path) -> Result<()> {
    for name in [PAGE, CSV, JSON] {
        output::remove(&output.join(name))?;
    }
    Ok(())
}

fn save_pictures(shown: &[Shown], output: &Path) -> Result<()> {
    for Shown { choice, count, picture } in shown {
        picture.save(&output.join(picture_of(*choice, *count)))?;
    }
    Ok(())
}

/// Returns the path of a picture, relative to the folder of results. `choice` is `None` for the picture of all splats;
/// `count` is the number of splats kept.
fn picture_of(choice: Option<Choice>, count: u32) -> PathBuf {
    format!("pictures/{}-{count}.png", choice.map_or("all", Choice::stem)).into()
}

/// Writes the files of a sweep, except for the pictures, and prints its table. The table comes last, because standard
/// output may be full or closed.
fn report(swept: &SweepResult, shown: &[Shown], output: &Path) -> Result<()> {
    let file = |name: &str| output.join(name);
    output::write_bytes(&file(CSV), swept.csv().as_bytes())?;
    options::write_json(&file(JSON), &serde_json::to_value(swept)?)?;
    for (name, plot, _) in swept.plots() {
        options::write_plot(&plot, output, name)?;
    }
    output::write_bytes(&file(PAGE), swept.page(shown)?.as_bytes())?;
    options::write_text(None, &swept.table())?;
    swept.note().iter().for_each(say);
    say(format!("{} shows the result", file(PAGE).display()));
    Ok(())
}

/// Result file of one view of a sweep that several processes share.
#[derive(Serialize, Deserialize)]
pub struct Part {
    steps: Vec<Step>,
    /// Steps of the approach, measured with the first view; empty for all other views.
    closer: Vec<Closer>,
}

pub struct Views {
    args: Args,
    guard: OutputGuard,
    given: Option<Vec<Camera>>,
    stems: Vec<String>,
    open: Option<(Subject, Wanted, Study)>,
}

impl Views {
    /// Checks the arguments and reads the cameras. [`Work::open`] loads the scene.
    pub fn new(args: Args) -> Result<Views> {
        let given = args.drawing.cameras(args.scene.as_deref())?;
        let stems = loading::stems(args.scene.as_deref(), given.as_deref(), ROOM);
        let guard = guard(&args)?;
        Ok(Views { args, guard, given, stems, open: None })
    }
}

impl Work for Views {
    fn outputs(&self) -> Outputs {
        Outputs::parts(COMMAND, &self.args.output, &self.stems)
    }

    fn open(&mut self) -> Result<Origin> {
        let (subject, wanted) = open(&self.args, &mut self.guard, self.given.clone())?;
        let study = Study::new(&subject, &wanted, &mut Console::default())?;
        let Wanted { pipeline, set, steps, frames } = &wanted;
        let cameras = serde_json::to_value(&subject.cameras)?;
        let mut origin = job::origin_of(study.session(), &cameras, (pipeline, set))?;
        let empty = SweepResult { command: options::command_line(), ..study.empty(&subject, &wanted) };
        origin.extend([
            job::plan_of(study.session()),
            ("device".into(), json!(empty.origin.provenance.device)),
            ("--steps".into(), json!(steps)),
            ("--rounds".into(), json!(frames.rounds)),
            ("--frames".into(), json!(frames.frames)),
            (job::REQUEST.into(), serde_json::to_value(empty)?),
        ]);
        self.open = Some((subject, wanted, study));
        Ok(origin)
    }

    fn draw(&mut self, views: &[usize]) -> Result<()> {
        let (subject, wanted, study) = self.open.as_mut().context("no device")?;
        let console = &mut Console::default();
        for &view in views {
            let (steps, shown) = study.view(subject, wanted, view, console)?;
            let mut closer = Vec::new();
            if view == 0 {
                closer = study.approach(subject, wanted, console)?;
                save_pictures(&shown, &self.args.output)?;
            }
            job::write_part(&self.args.output, &self.stems[view], &Part { steps, closer })?;
        }
        Ok(())
    }

    fn close(&mut self) -> Vec<String> {
        let Some((subject, _, study)) = self.open.take() else { return Vec::new() };
        // The study's objects must not outlive `close`, which returns the last messages.
        drop(study);
        subject.device.close()
    }
}

/// Command name in the `job.json` of shared folders.
pub const COMMAND: &str = "sweep";

/// Prints and writes the report of the views that several processes measured. The pictures of the first view are read
/// from `folders`; without that view, the report has no pictures.
pub fn merge(origin: &Origin, parts: Vec<Part>, folders: &[PathBuf], output: &Path) -> Result<()> {
    let empty: SweepResult = job::request(origin)?;
    let first = parts.first().and_then(|part| part.steps.first()).map(|step| step.camera.clone());
    let shown_steps = parts.first().map(|part| part.steps.clone()).unwrap_or_default();
    let closer = parts.iter().flat_map(|part| part.closer.clone()).collect();
    let steps = parts.into_iter().flat_map(|part| part.steps).collect();
    let command = format!("{}\n{}", empty.command, options::command_line());
    let swept = SweepResult { command, ..empty.with(steps, closer) };
    let mut shown = Vec::new();
    for step in
        shown_steps.iter().filter(|step| Some(&step.camera) == first.as_ref() && !swept.closer.is_empty())
    {
        let path = picture_of(step.choice, step.count);
        let found = folders.iter().map(|folder| folder.join(&path)).find(|path| path.exists());
        let found = found.with_context(|| format!("expected {}, found none", path.display()))?;
        shown.push(Shown { choice: step.choice, count: step.count, picture: Image::load(&found)? });
    }
    save_pictures(&shown, output)?;
    report(&swept, &shown, output)
}

pub(super) fn guard(args: &Args) -> Result<OutputGuard, Usage> {
    let mut guard = options::claim_inputs(args.scene.as_deref(), args.drawing.cameras.as_deref())?;
    guard.input("the graph", Path::new(&args.drawing.pipeline))?;
    for name in [PAGE, CSV, JSON] {
        guard.output("--output", &args.output.join(name))?;
    }
    PLOTS.iter().try_for_each(|name| options::claim_plot(&mut guard, &args.output, name))?;
    // The numbers of splats are not known yet, so any number serves to check the folder.
    guard.output("--output", &args.output.join(picture_of(None, 0)))?;
    Ok(guard)
}
