//! Runs `splatgraph trade`: writes a ledger of what each setting saves and costs.

use super::cameras::{self, tell_off_center};
use super::console::Console;
use super::job::{self, Manifest, Origin, Outputs, ShardArgs, Work};
use super::loading;
use super::options::{self, BackendArgs, DeviceArgs, Drawing, EffortArgs};
use super::outcome::{Outcome, Usage, claim_graph_files};
use super::subject;
use crate::draw::projection;
use crate::io::image::{Format, Image};
use crate::io::load::LoadOptions;
use crate::io::output::names::MAX_NAME_BYTES;
use crate::io::output::{self, OutputGuard, say};
use crate::studies::measurement::plans::SamePlan;
use crate::studies::study::{Setting, StudyError, Subject};
use crate::studies::trade::ledger::{Book, Ledger};
use crate::studies::trade::measure::Row;
use crate::studies::trade::page::{page, plot};
use crate::studies::trade::pictures::{self, Album};
use crate::studies::trade::table::{csv, notes, table};
use crate::studies::trade::{Study, Wanted, study};
use anyhow::{Context, Result, bail};
use serde::Deserialize;
use serde_json::json;
use splatgraph_assets::Camera;
use splatgraph_assets::photograph::EXTENSIONS;
use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

/// Measure what each setting saves and what it costs in accuracy
///
/// Draws the scene with every parameter at its exact value, then with one parameter changed at a time, with the graph's
/// defaults, and with every built-in graph. Each picture is compared with the truth: the exact renderer's picture
/// (`render --backend reference`), or a picture of --truth. Frames are interleaved with frames of the exact settings, so that a
/// change of the device's clock affects both. A parameter whose declaration has no `exact` value keeps its default,
/// unless --only names it: its default then counts as exact. A parameter without an effect on the plan of the exact
/// settings is not measured. A setting whose plan equals an earlier one is not measured either.
///
/// The columns are the share of the exact settings' time, ± the farther end of its 99 % confidence interval; that share
/// in milliseconds on the GPU, of the exact settings' time on a warm device, with the spread over the rounds; PSNR of
/// the mean squared error over all pixels of all views, where `evaluate` and `convert --price` print the mean of the
/// views' PSNR, and over the pixels that a splat covers; the lowest SSIM; the mean of NVIDIA's FLIP (0 for equal
/// pictures); the largest difference of a channel; the share of pixels that are off by more than 1/255; pairs of
/// visible splats in the wrong order; and memory on the device. A `*` marks the Pareto front, the fastest setting of each
/// accuracy: every more accurate one on the front takes at least 2 % longer, beyond the noise. The noise is at least the
/// difference of the exact settings from themselves. A `?` marks settings that may be on the front, but are too noisy
/// to tell. A graph that draws from the previous frame is not judged. Its picture is the second frame of the still
/// view: its state begins anew in each view and setting. The error of a moving camera is not in it, and an average has
/// not converged.
///
/// An interrupted run resumes. A folder whose rows depend on other inputs is refused: on another scene, graph or option
/// of the device, on other cameras or pictures of --truth, or on other --rounds or --frames. Rows of another program or
/// device are kept in a file of another name, and everything is measured again. So are rows of a setting whose plan has
/// changed.
///
/// The default scene is the demo scene, which the first use generates. The default camera is the first beside the
/// scene, or one that frames it.
#[derive(Debug, clap::Args)]
#[command(mut_arg("backend", options::that_draws))]
#[command(mut_arg("pipeline", options::that_is_changed))]
#[command(mut_arg("set", options::that_is_fixed))]
#[command(after_help = "Examples:
  splatgraph trade                                        # the demo scene; ledger/ledger.html shows the result
  splatgraph trade scene.ply -c cameras.json -o biker/    # an interrupted run goes on
  splatgraph trade scene.ply --only key_bits --only key_map
  splatgraph trade scene.ply --graph a.ron --graph b.ron  # two graphs of your own, among the built-in ones
  splatgraph trade scene.ply --set sh_degree=1            # what the others save with one band of harmonics
  splatgraph trade scene.ply -c cameras.json --truth photographs/ --size 980x545")]
pub struct Args {
    #[arg(help = options::optional_scene_help())]
    scene: Option<PathBuf>,
    #[command(flatten)]
    drawing: Drawing,
    /// Folder of pictures that count as exact, one for each camera [default: the exact renderer's pictures]
    ///
    /// A picture has the name of the camera's img_name or photograph, with or without its folders. Alpha is blended
    /// over black, on which the graphs draw.
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// Folder for ledger.json, .csv, .html, .svg, .png and pictures/; an interrupted run resumes from ledger.json
    #[arg(short, long, value_name = "DIR", default_value = "ledger")]
    output: PathBuf,
    /// Measure another graph, too, with its defaults: a file or the name of a built-in graph; may be repeated
    ///
    /// Its rows are named `graph` and what is given here. It is drawn like the built-in graphs, which are always
    /// measured, and needs the projection of --pipeline, and the parameters of --set. Later runs keep its rows.
    #[arg(long = "graph", value_name = "GRAPH")]
    graphs: Vec<String>,
    /// Measure only settings whose names begin with this, for instance `key_bits` or `preset`; may be repeated
    ///
    /// A parameter takes all values of a choice, five across an integer's range, or four across a float's, without its
    /// minimum. `--only "NAME = VALUE"` measures another value.
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    #[command(flatten)]
    effort: EffortArgs,
    #[command(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    pub device: BackendArgs,
    #[command(flatten)]
    load: LoadOptions,
}

const LEDGER: &str = "ledger.json";
const CSV: &str = "ledger.csv";
const PAGE: &str = "ledger.html";
const PLOT: &str = "ledger";

/// Opens the device, loads the scene and the pictures of `--truth`, and registers the graph's files in `guard`.
fn open(
    args: &Args,
    guard: &mut OutputGuard,
    given: Option<Vec<Camera>>,
    file: Option<PathBuf>,
) -> Result<(Subject, Wanted)> {
    let Drawing { pipeline, set, size, .. } = &args.drawing;
    let graphs = std::iter::once(pipeline).chain(&args.graphs);
    let settings: Vec<_> = graphs.map(|graph| Setting::of_graph(graph, set)).collect();
    let stems = loading::stems(args.scene.as_deref(), given.as_deref(), ROOM);
    let scene = (args.scene.as_deref(), &args.load);
    let mut subject = subject::load(args.device.open()?, scene, &settings, given, *size)?;
    let graph = projection::of_graph_for(pipeline, set, &subject.cameras);
    subject.cameras = projection::convert_all(&subject.cameras, graph, &subject.scene, *size)?;
    let truths = |folder: &PathBuf| -> Result<_> {
        tell_off_center(&subject.cameras);
        Ok((folder.display().to_string(), true_pictures(folder, &subject.cameras, &stems)?))
    };
    let DeviceArgs { validate, no_robustness, .. } = &*args.device;
    let wanted = Wanted {
        pipeline: pipeline.clone(),
        set: set.clone(),
        graphs: args.graphs.clone(),
        only: args.only.clone(),
        frames: args.effort.frames(),
        truths: args.truth.as_ref().map(truths).transpose()?,
        opened: format!("validation {validate}, robustness {}", !no_robustness),
        command: options::command_line(),
        file,
    };
    claim_graph_files(guard, &subject.check(&settings)?)?;
    Ok((subject, wanted))
}

/// Maximum length of a camera's file name, in bytes, without the extension.
const ROOM: usize = MAX_NAME_BYTES - 5;

pub fn run(args: &Args) -> Result<Outcome> {
    // Check the cameras before a device is opened.
    let given = args.drawing.cameras(args.scene.as_deref())?;
    let mut guard = guard(args)?;
    let (subject, wanted) = open(args, &mut guard, given, Some(args.output.join(LEDGER)))?;
    let mut ledger = study(&subject, &wanted, &mut Console::default()).map_err(usage)?;
    ledger.command = wanted.command;
    report(&ledger, &args.output)?;
    Ok(super::outcome::validated(args.device.validate, &subject.device.close()))
}

/// Prints a ledger and writes its files.
fn report(ledger: &Ledger, output: &Path) -> Result<()> {
    let file = |name: &str| output.join(name);
    ledger.save(&file(LEDGER))?;
    let (lines, failed) = ledger.lines();
    output::write_bytes(&file(CSV), csv(ledger, &lines).as_bytes())?;
    let album = Album::beside(&file(LEDGER));
    output::write_bytes(&file(PAGE), page(ledger, &lines, &failed, &album)?.as_bytes())?;
    match plot(ledger, &lines) {
        Some(plot) => options::write_plot(&plot, output, PLOT)?,
        None if options::remove_plot(output, PLOT)? => {
            say("no setting has a time: the plots of an earlier run are removed");
        }
        None => {}
    }
    // Last, because standard output may be full or closed.
    let notes: String = notes(&lines).iter().map(|note| format!("{note}\n")).collect();
    options::write_text(None, &format!("{}{notes}", table(&lines)))?;
    for (setting, why) in &failed {
        say(format!("{setting}: {why}"));
    }
    say(format!("{} shows the result", file(PAGE).display()));
    Ok(())
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
        let (subject, wanted) = open(&self.args, &mut self.guard, self.given.clone(), None)?;
        let study = Study::new(&subject, &wanted, &mut Console::default()).map_err(usage)?;
        let origin = serde_json::to_value(study.origin())?;
        let mut origin = origin.as_object().cloned().unwrap_or_default();
        // Other machines may have other paths to the same files.
        let names = ["scene", "truth"].into_iter().filter_map(|name| origin.remove_entry(name)).collect();
        let names = serde_json::Value::Object(names);
        let (command, same_plan) = (options::command_line(), study.same_plan());
        let request = json!({ "names": names, "command": command, "same_plan": same_plan });
        origin.insert(job::REQUEST.into(), request);
        self.open = Some((subject, wanted, study));
        Ok(origin)
    }

    fn draw(&mut self, views: &[usize]) -> Result<()> {
        let (subject, wanted, study) = self.open.as_mut().context("no device")?;
        for &view in views {
            let mut book = study.book(None, &mut ())?;
            let stem = &self.stems[view];
            let album = album_of(&self.args.output.join(job::part(stem)));
            let console = &mut Console::default();
            study.measure(subject, wanted, view..view + 1, (&mut book, &album), console)?;
            job::write_part(&self.args.output, stem, &book.ledger.rows)?;
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
pub const COMMAND: &str = "trade";

/// Returns the album of the view with the result file `part`.
fn album_of(part: &Path) -> Album {
    Album::beside(&part.with_extension("").join(LEDGER))
}

/// The [`job::REQUEST`] of shared views.
#[derive(Deserialize)]
struct Request {
    /// Names of the scene and the truth.
    names: job::Origin,
    command: String,
    same_plan: SamePlan,
}

/// Prints and writes the ledger of the views that several processes measured into the folders of `manifests`. `found`
/// lists the result files of `parts`.
pub fn merge(manifests: &[Manifest], parts: Vec<Vec<Row>>, found: &[PathBuf], output: &Path) -> Result<()> {
    let commands = manifests.iter().map(|manifest| Ok(job::request::<Request>(&manifest.origin)?.command));
    let mut commands: Vec<String> = commands.collect::<Result<_>>()?;
    let mut origin = manifests[0].origin.clone();
    let Request { names, command, same_plan } = job::request(&origin)?;
    origin.remove(job::REQUEST);
    origin.extend(names);
    let origin = serde_json::from_value(origin.into()).context("the origin of a ledger")?;
    let of_camera: HashMap<String, &PathBuf> = parts
        .iter()
        .zip(found)
        .filter_map(|(rows, path)| Some((rows.first()?.camera.clone(), path)))
        .collect();
    let path = output.join(LEDGER);
    let (mut book, lost) = Book::open(Some(path.clone()), origin, &[])?;
    lost.into_iter().for_each(say);
    parts.into_iter().flatten().for_each(|row| book.insert(row));
    book.ledger.add_same_plan(same_plan);
    book.save()?;
    let (mut ledger, album) = (book.ledger, Album::beside(&path));
    let own = options::command_line();
    ledger.command = format!("{command}\n{own}");
    commands.push(own);
    commands.iter().for_each(|command| ledger.add_command(command));
    let settings: BTreeSet<&str> = ledger.rows.iter().map(|row| row.setting.as_str()).collect();
    for setting in settings {
        if let Some((camera, _)) = ledger.farthest(setting)
            && let Some(part) = of_camera.get(camera)
        {
            album.copy(&album_of(part), camera, setting)?;
        }
    }
    report(&ledger, output)
}

fn usage(error: StudyError) -> anyhow::Error {
    match error {
        StudyError::UnknownSetting { name, known } => {
            let known = known.join(", ");
            Usage(format!("--only {name}: expected a prefix of one of these settings' names: {known}")).into()
        }
        error => error.into(),
    }
}

/// Registers the inputs and the ledger's files. An error means that a file would overwrite an input, or that pictures
/// would go into the `--truth` folder.
pub(super) fn guard(args: &Args) -> Result<OutputGuard, Usage> {
    let mut guard = options::claim_inputs(args.scene.as_deref(), args.drawing.cameras.as_deref())?;
    for graph in std::iter::once(&args.drawing.pipeline).chain(&args.graphs) {
        guard.input("the graph", Path::new(graph))?;
    }
    for name in [LEDGER, CSV, PAGE] {
        guard.output("--output", &args.output.join(name))?;
    }
    options::claim_plot(&mut guard, &args.output, PLOT)?;
    let pictures = args.output.join(pictures::FOLDER);
    // The settings are not known yet, so any name serves to check the folder.
    guard.output("--output", &pictures.join("defaults.png"))?;
    let canonical = |path: &Path| path.canonicalize().ok();
    if let Some(truth) = &args.truth
        && canonical(truth).is_some_and(|truth| Some(truth) == canonical(&pictures))
    {
        let (truth, output) = (truth.display(), args.output.display());
        return Err(Usage(format!(
            "--truth {truth}: the settings' pictures would be written into this folder: choose another --output than {output}"
        )));
    }
    Ok(guard)
}

fn true_pictures(folder: &Path, cameras: &[Camera], stems: &[String]) -> Result<Vec<Image>> {
    let (mut used, mut blended) = (BTreeSet::new(), 0);
    let load = |(camera, stem): (&Camera, &String)| -> Result<Image> {
        let Some(path) = true_picture(folder, camera, stem) else {
            bail!("expected the picture {stem}.npy, .exr, .png or .jpg in {}, found none", folder.display());
        };
        if !used.insert(path.clone()) {
            bail!("{}: expected a picture for each camera, found one for two cameras", path.display());
        }
        let image = match Format::of(&path) {
            // Floats are already multiplied by alpha.
            Some(Format::Npy | Format::Exr) => Image::load(&path)?,
            Some(Format::Png) | None => Image::load_photograph(&path, [0.0; 3])?,
        };
        blended += usize::from(Image::header(&path).is_ok_and(|header| header.has_alpha));
        if (image.width, image.height) != (camera.width as usize, camera.height as usize) {
            bail!(
                "{}: expected {} x {} pixels, as the camera has, found {} x {} (--size changes the cameras)",
                path.display(),
                camera.width,
                camera.height,
                image.width,
                image.height
            );
        }
        Ok(image)
    };
    let images: Vec<_> = cameras.iter().zip(stems).map(load).collect::<Result<_>>()?;
    if blended > 0 {
        let (folder, all) = (folder.display(), images.len());
        say(format!("{folder}: alpha is blended over black in {blended} of {all} pictures"));
    }
    Ok(images)
}

/// Finds the true picture of a camera. It has the file name that `render` gives to the picture, or the photograph's.
fn true_picture(folder: &Path, camera: &Camera, stem: &str) -> Option<PathBuf> {
    let formats = ["npy", "exr"].into_iter().chain(EXTENSIONS);
    let drawn = formats.map(|format| folder.join(format!("{stem}.{format}"))).find(|path| path.exists());
    drawn.or_else(|| cameras::beside_photograph(folder, &camera.img_name))
}
