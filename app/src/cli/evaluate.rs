//! Runs `splatgraph evaluate`: scores a scene against the photographs of its dataset.

use super::cameras;
use super::job::{self, Manifest, ShardArgs};
use super::loading;
use super::options::{self, DeviceArgs};
use super::outcome::{Outcome, Usage, claim_graph_files, validated};
use super::render::{Renderer, refuse_graph_options, renderer};
use crate::draw::backend::{Api, Backend};
use crate::draw::blind;
use crate::draw::fit;
use crate::draw::outputs;
use crate::draw::projection::{self, ProjectionError};
use crate::draw::session::Session;
use crate::draw::stats;
use crate::draw::truth::Truth;
use crate::io::image::Image;
use crate::io::load::LoadOptions;
use crate::io::output::names::{self, MAX_NAME_BYTES};
use crate::io::output::{self, OutputGuard, is_standard_output, one_line, say};
use crate::io::own_file;
use crate::io::program;
use crate::io::progress::Progress;
use crate::io::report::text;
use crate::studies::evaluation::{Evaluation, Score, score};
use anyhow::{Context, Result, anyhow, bail};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value as Json, json};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, CameraOptions, Dataset, Scene, TEST_EVERY};
use splatgraph_reference::Rules;
use std::ffi::OsStr;
use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub const EXAMPLES: &str = "Examples:
  splatgraph evaluate point_cloud.ply -c garden/
  splatgraph evaluate point_cloud.ply -c garden/ --downscale 4 --json
  splatgraph evaluate point_cloud.ply -c lego/ --background 1,1,1 -o scores/
  splatgraph evaluate point_cloud.ply -c garden/ --backend reference";

/// Score a scene against photographs: PSNR, SSIM and FLIP per test view, and their means
///
/// Draws the test views of a dataset at the photographs' size, and compares both. Test views are the dataset's own
/// (Blender, nerfstudio), or else every eighth photograph by name, as in the 3DGS reference implementation. A line on
/// standard error says so. PSNR and SSIM are computed as in `compare`, and FLIP as its `flip_8_bits`. The means over
/// the views are comparable with published tables, except for the differences that docs/formats.md lists.
///
/// A view does not stop the others if its photograph is missing, damaged or of another shape, or if its picture has
/// values that are not finite. The JSON lists it in `missing`, there are no means, and the exit code is 1.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[arg(help = options::scene_help())]
    scene: PathBuf,
    /// The dataset: a COLMAP folder, a folder with transforms_test.json, or a file of cameras
    #[arg(short, long, value_name = "DATASET")]
    cameras: PathBuf,
    /// Folder of the photographs [default: the dataset's]
    #[arg(long, value_name = "DIR")]
    photographs: Option<PathBuf>,
    /// Compare at 1/N of the photographs' width and height
    ///
    /// Uses the photographs in a folder images_N beside images/ if that folder exists (for a transforms.json, beside
    /// the images/ in the photographs' names), and averages pixels otherwise.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    downscale: u32,
    /// Score all views, not only the test views
    #[arg(long)]
    all: bool,
    /// The graph: the name of a built-in one, or a path
    #[arg(short, long, value_name = "NAME", default_value = options::DEFAULT_PIPELINE)]
    pipeline: String,
    /// Set a parameter of the graph; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
    /// Renderer: `vulkan`, `metal` (on Apple's systems), or `reference`, the exact renderer on the CPU
    #[arg(long, value_name = "NAME", default_value_t = Renderer::Device(Api::default()), value_parser = renderer)]
    backend: Renderer,
    /// Background colour, display-encoded: 0 is black, 1 is white, also behind photographs with alpha
    #[arg(long, value_name = "R,G,B|#RRGGBB", default_value = "0,0,0", allow_hyphen_values = true, value_parser = options::colour)]
    background: [f32; 3],
    /// Print JSON instead of a table, or write it to FILE beside the table
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
    /// Also write the pictures into DIR: renders/, photographs/ and differences/ (times ten)
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    pub device: DeviceArgs,
    #[command(flatten)]
    load: LoadOptions,
}

#[derive(Debug)]
struct View {
    name: String,
    photograph: std::io::Result<PathBuf>,
    /// Camera as in the dataset, at its own picture size.
    camera: Camera,
}

impl View {
    fn photograph(&self) -> Result<&Path> {
        self.photograph.as_deref().map_err(|error| anyhow!("{error}"))
    }

    /// Returns the camera of the picture to draw: at `1/downscale` of the photograph's size.
    ///
    /// # Errors
    /// The photograph cannot be read, its aspect ratio differs from the camera's by more than one pixel and one
    /// percent, or the picture is too large; see [`cameras::check_size`].
    fn drawn(&self, downscale: u32) -> Result<Camera> {
        let path = self.photograph()?;
        let (width, height) = Image::photograph_size(path)?;
        let (own_width, own_height) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let expected = own_height * width as f64 / own_width;
        let off = (expected - height as f64).abs();
        // Tolerate a pixel of height; in a portrait, also a pixel of width.
        if off > f64::max(1.0, own_height / own_width) && off > 0.01 * expected {
            let is_turned = (height as f64, width as f64) == (own_width, own_height);
            let turned = if is_turned { "; an EXIF orientation is not read: rotate the pixels" } else { "" };
            bail!(
                "{}: expected a photograph of {own_width} x {own_height} pixels, or of that shape, found {width} x {height}{turned}",
                path.display()
            );
        }
        let [width, height] =
            [width, height].map(|side| (side as f64 / f64::from(downscale)).round().max(1.0) as u32);
        let camera = self.camera.stretched(width, height);
        cameras::check_size(&camera)?;
        Ok(camera)
    }

    /// Returns the camera of the picture to draw, and the photograph at the picture's size.
    ///
    /// # Errors
    /// See [`View::drawn`]; also, the photograph may be damaged.
    fn load(&self, downscale: u32, background: [f32; 3]) -> Result<(Camera, Image)> {
        let camera = self.drawn(downscale)?;
        let (width, height) = (camera.width as usize, camera.height as usize);
        let photograph = Image::load_photograph(self.photograph()?, background)?;
        let same = (photograph.width, photograph.height) == (width, height);
        let photograph = if same { photograph } else { photograph.averaged(width, height) };
        Ok((camera, photograph))
    }

    fn score(&self, drawn: &Image, photograph: &Image) -> Result<Score> {
        let found = score(&self.name, drawn, photograph);
        found.with_context(|| format!("{} cannot be scored", one_line(&self.name)))
    }
}

#[derive(Debug)]
pub(super) struct Work {
    guard: OutputGuard,
    downscale: u32,
    /// Source of smaller photographs: a folder such as `images_2`, or `averaged`; `None` without `--downscale`.
    downscaled: Option<String>,
    views: Vec<View>,
    stems: Vec<String>,
    /// True for a dataset in the space of a capture, which nerfstudio leaves before the training.
    is_unaligned: bool,
}

impl Work {
    /// Warns the user if nerfstudio trained the scene, and no file says how it moved the cameras.
    fn tell_alignment(&self, args: &Args, scene: &Scene) {
        // `ns-export` writes "Generated by Nerstudio".
        let has_name = |comment: &String| {
            let comment = comment.to_ascii_lowercase();
            ["nerstudio", "nerfstudio"].iter().any(|name| comment.contains(name))
        };
        if self.is_unaligned && scene.size_breakdown().comments.iter().any(has_name) {
            say(format!(
                "{}: nerfstudio trained the scene, and moves a capture before that: copy the dataparser_transforms.json of the training beside the cameras",
                args.cameras.display()
            ));
        }
    }
}

/// Field of the JSON with the value of [`origin`].
const ORIGIN: &str = "origin";

/// Subfolders of `--output`.
const FOLDERS: [&str; 3] = ["renders", "photographs", "differences"];

/// Reads the cameras, finds the photographs, and checks the files of the command line.
pub(super) fn prepare(args: &Args) -> Result<Work> {
    if let Renderer::Reference = args.backend {
        refuse_graph_options(&args.pipeline, &args.set, &args.device)?;
    }
    let photographs = args.photographs.as_deref();
    let options = CameraOptions { photographs, ..CameraOptions::default() };
    let dataset = match args.cameras.to_str() {
        Some(spec) => Dataset::select(spec, options)?,
        None => Dataset::load_with(&args.cameras, options)?,
    };
    cameras::tell_alignment(&dataset);
    cameras::tell_off_center(dataset.views.iter().map(|view| &view.camera));
    cameras::tell_masks(&dataset);
    if let Some(name) = dataset.unmatched.first().filter(|_| !args.all) {
        let more = match dataset.unmatched.len() - 1 {
            0 => String::new(),
            more => format!(" and {more} more without a frame"),
        };
        bail!(
            "{}: `test_filenames`: expected photographs of frames, found {}{more}; --all scores all frames",
            args.cameras.display(),
            one_line(name)
        );
    }
    let is_reduced = args.photographs.is_none() && args.downscale > 1;
    let reduced = is_reduced.then(|| dataset.reduced(args.downscale)).flatten();
    let downscale = if reduced.is_some() { 1 } else { args.downscale };
    let found = reduced.as_ref().unwrap_or(&dataset);
    let count = found.views.len();
    let chosen: Vec<_> = if args.all { found.views.iter().collect() } else { found.test_views() };
    if chosen.is_empty() {
        bail!(
            "{}: expected at least one test view, found none among {count} views; --all scores all of them",
            args.cameras.display()
        );
    }
    let every = chosen.len() < count && found.views.iter().all(|view| view.test.is_none());
    let Some(folder) = args.photographs.as_ref().or(found.photographs.as_ref()) else {
        let factors = dataset.reduced_factors();
        let found = match factors.first() {
            Some(factor) => {
                let names: Vec<String> = factors.iter().map(|factor| format!("images_{factor}")).collect();
                format!("found {}: --downscale {factor} takes images_{factor}", names.join(", "))
            }
            None => "found none: name it with --photographs".into(),
        };
        let cameras = args.cameras.display();
        let text = format!("{cameras}: expected a folder `images` near the cameras, {found}");
        return Err(Usage(text).into());
    };
    if let Renderer::Device(_) = args.backend {
        projection::shared(&chosen.iter().map(|view| view.camera.clone()).collect::<Vec<_>>())?;
        // A photograph is no picture of another projection, so pinholes are not converted. A graph's errors are
        // reported when it is built.
        let graph = projection::of_graph(&args.pipeline, &args.set);
        let other = |graph| chosen.iter().find(|view| view.camera.projection != graph).zip(Some(graph));
        if let Some((view, graph)) = graph.and_then(other) {
            let error = ProjectionError { graph, camera: view.camera.projection };
            bail!("{}: {error}", one_line(&view.photograph));
        }
    }
    let view = |view: &splatgraph_assets::View| View {
        name: view.photograph.clone(),
        photograph: Dataset::photograph_in(folder, view),
        camera: view.camera.clone(),
    };
    let views: Vec<View> = chosen.into_iter().map(view).collect();
    if views.iter().all(|view| view.photograph.is_err()) {
        views[0].photograph()?;
    }
    let names: Vec<String> = views.iter().map(|view| view.camera.img_name.clone()).collect();
    let stems = names::unique(&names, MAX_NAME_BYTES - ".png".len());
    let mut guard = OutputGuard::default();
    let mut claim = || -> Result<(), Usage> {
        guard.scene("the scene", &args.scene)?;
        cameras::claim_dataset(&mut guard, &dataset)?;
        if dataset.photographs.as_ref() != Some(folder) {
            cameras::claim_photographs(&mut guard, folder, &found.views)?;
        }
        guard.input("the graph", Path::new(&args.pipeline))?;
        args.json.iter().try_for_each(|path| guard.output("--json", path))?;
        if let Some(output) = &args.output {
            if is_standard_output(output) {
                return Err(Usage("expected a folder for --output, found `-`".into()));
            }
            for (folder, stem) in
                FOLDERS.iter().flat_map(|folder| stems.iter().map(move |stem| (folder, stem)))
            {
                guard.output("--output", &picture(output, folder, stem))?;
            }
        }
        Ok(())
    };
    claim()?;
    if every {
        say(format!(
            "scored: every {TEST_EVERY}th view by name, {} of {count}; --all scores all",
            views.len()
        ));
    }
    let downscaled = (args.downscale > 1).then(|| match reduced {
        Some(_) => format!("images_{}", args.downscale),
        None => "averaged".into(),
    });
    match downscaled.as_deref() {
        Some("averaged") => say(format!("the photographs are averaged to 1/{downscale} of their size{}", {
            // `--photographs images_2 --downscale 2`.
            let sizes =
                views.iter().find_map(|view| Some((view.drawn(downscale).ok()?.width, view.camera.width)));
            let smaller = sizes.filter(|(drawn, own)| drawn * downscale + downscale < *own);
            smaller.map_or(String::new(), |(drawn, own)| {
                format!(", to {drawn} pixels across: they were reduced before, as the cameras have {own}")
            })
        })),
        Some(folder) => say(format!("the photographs are those of {folder}")),
        None => {}
    }
    // Cameras of a `cameras.json`, of a path and of Blender's scenes are in the scene's space.
    let is_capture = |file: &PathBuf| {
        ["transforms", "cameras"].map(OsStr::new).contains(&file.file_stem().unwrap_or_default())
    };
    let is_unaligned = dataset.alignment.is_none()
        && found.photographs.is_some()
        && dataset.files.first().is_some_and(is_capture);
    Ok(Work { guard, downscale, downscaled, views, stems, is_unaligned })
}

fn picture(output: &Path, folder: &str, stem: &str) -> PathBuf {
    output.join(folder).join(format!("{stem}.png"))
}

enum Drawer {
    Device(Box<Session>),
    Reference(Arc<Scene>),
}

impl Drawer {
    /// Loads the scene, unless it is given, while the device is opened. The exact renderer needs no device.
    ///
    /// Prepares the plan for the first view that can be drawn, and registers the graph's files as inputs.
    fn open(args: &Args, work: &mut Work, scene: Option<Arc<Scene>>) -> Result<Drawer> {
        let load = |cancel: &_| {
            let load = || loading::load_scene_unless(cancel, &args.scene, &args.load).map(Arc::new);
            scene.map_or_else(load, Ok)
        };
        let Renderer::Device(api) = args.backend else {
            return Ok(Drawer::Reference(load(&loading::NEVER)?));
        };
        let open = || {
            let device = Backend::open(api, &args.device.options())?;
            fit::check_header(&args.scene, &args.load, device.info(), &args.pipeline, &args.set)?;
            Ok(device)
        };
        let (device, scene) = loading::open_and_load(open, load)?;
        let mut session = Session::new(device, scene, &args.pipeline, &args.set);
        if let Some(camera) = work.views.iter().find_map(|view| view.drawn(work.downscale).ok()) {
            session.prepare((camera.width, camera.height), &mut |_| {})?;
        }
        claim_graph_files(&mut work.guard, &session.files())?;
        Ok(Drawer::Device(Box::new(session)))
    }

    fn scene(&self) -> &Scene {
        match self {
            Drawer::Reference(scene) => scene,
            Drawer::Device(session) => session.scene(),
        }
    }

    /// Draws a view from a camera in world coordinates.
    fn draw(&mut self, camera: &Camera, background: [f32; 3]) -> Result<Image> {
        match self {
            Drawer::Reference(scene) => {
                let camera = camera.relative_to(scene.offset());
                Ok(Truth::draw(scene, &camera, background, &Rules::of_view(scene, &camera))?.image())
            }
            Drawer::Device(session) => {
                let camera = camera.relative_to(session.scene().offset());
                Ok(outputs::draw(session, &camera, background)?.colour)
            }
        }
    }
}

/// Writes the pictures of a view to the folder of `--output`, if any.
fn save(args: &Args, stem: &str, drawn: &Image, photograph: &Image) -> Result<()> {
    let Some(output) = &args.output else { return Ok(()) };
    let difference = Image::difference(drawn, photograph, 10.0);
    for (folder, image) in FOLDERS.into_iter().zip([drawn, photograph, &difference]) {
        image.save(&picture(output, folder, stem))?;
    }
    Ok(())
}

fn request(args: &Args) -> Json {
    let graph = match args.backend {
        Renderer::Device(_) => json!(args.pipeline),
        Renderer::Reference => json!(null),
    };
    json!({
        "scene": options::text_of(&args.scene), "dataset": options::text_of(&args.cameras),
        "backend": args.backend.to_string(), "pipeline": graph,
        "set": args.set, "downscale": args.downscale, "photographs": args.photographs.as_deref().map(options::text_of), "all": args.all,
        "background": args.background, "ignore_tags": args.load.ignore_tags, "level": args.load.level,
    })
}

/// Describes what the scores depend on besides the request.
///
/// These are the program, the device, the graph that is drawn, and how photographs are made smaller. For the exact
/// renderer, the device and the graph are null. The graph is also null if no view can be drawn.
fn origin(drawer: &mut Drawer, downscaled: Option<&str>) -> Result<Json> {
    let (device, plan) = match drawer {
        Drawer::Reference(_) => (None, None),
        Drawer::Device(session) => {
            let info = session.device().info();
            (Some(format!("{} ({})", info.name, info.driver)), session.plan())
        }
    };
    let parameters = plan.map(|plan| -> Map<String, Json> {
        plan.params.iter().map(|param| (param.name.clone(), stats::json(&param.value))).collect()
    });
    Ok(json!({
        "version": program::VERSION,
        "program": program::hash().context("the program's file cannot be read")?,
        "device": device,
        "based_on": plan.map(|plan| &plan.based_on),
        "parameters": parameters,
        "downscaled": downscaled,
    }))
}

fn as_json(mut request: Json, found: &Evaluation) -> String {
    request["views"] = json!(found.views);
    request["missing"] = json!(found.missing);
    request["mean"] = json!(found.mean);
    format!("{request:#}")
}

pub fn run(args: &Args) -> Result<Outcome> {
    // Errors of the command line and of the dataset are reported before a large scene is loaded.
    let mut work = prepare(args)?;
    let mut others = Vec::new();
    if let Some(output) = &args.output {
        Manifest::refuse(output)?;
        let of = |folder: &str| {
            let own = work.stems.iter().map(|stem| picture(output, folder, stem)).collect();
            names::others(&output.join(folder), "png", &own)
        };
        others.extend(FOLDERS.into_iter().filter_map(of));
    }
    let mut drawer = Drawer::open(args, &mut work, None)?;
    work.tell_alignment(args, drawer.scene());
    let Work { views, stems, downscale, downscaled, .. } = work;
    let mut progress = Progress::new("scoring");
    let (mut scores, mut missing, mut blind) = (Vec::with_capacity(views.len()), Vec::new(), Vec::new());
    for (index, (view, stem)) in views.iter().zip(&stems).enumerate() {
        progress.set(index as u64, views.len() as u64, &view.name);
        // Errors of the device and the disk end the run: they would repeat for each view.
        let score = match view.load(downscale, args.background) {
            Ok((camera, photograph)) => {
                let drawn = drawer.draw(&camera, args.background)?;
                let scene = drawer.scene();
                // A view whose exact picture does not fit in memory counts as one that sees splats.
                let in_scene = camera.relative_to(scene.offset());
                if blind::sees(scene, &in_scene) == Ok(false) {
                    blind.push(in_scene);
                }
                save(args, stem, &drawn, &photograph)?;
                view.score(&drawn, &photograph)
            }
            Err(error) => Err(error),
        };
        match score {
            Ok(score) => scores.push(score),
            Err(error) => {
                let text = format!("{}: {}", one_line(&view.name), job::reason(&error).trim());
                progress.suspend(|| say(text));
                missing.push(view.name.clone());
            }
        }
    }
    if let Drawer::Device(session) = &mut drawer {
        let note = session.background_note(args.background);
        progress.suspend(|| session.settings_without_effect().iter().chain(&note).for_each(say));
    }
    drop(progress);
    if let Some(first) = blind.first() {
        let example = (first, Rules::of_view(drawer.scene(), first));
        say(blind::note(drawer.scene(), (blind.len(), views.len()), Some(&example), ""));
    }
    others.iter().for_each(say);
    let found = Evaluation::new(scores, missing);
    options::print_beside(args.json.as_deref(), &found.table())?;
    if let Some(path) = &args.json {
        let mut request = request(args);
        request[ORIGIN] = origin(&mut drawer, downscaled.as_deref())?;
        options::write_text(Some(path), &(as_json(request, &found) + "\n"))?;
    }
    let outcome = match drawer {
        Drawer::Device(session) => validated(args.device.validate, &session.into_device().close()),
        Drawer::Reference(_) => Outcome::Done,
    };
    Ok(if found.missing.is_empty() { outcome } else { Outcome::Failed })
}

/// Result file of one view of a shared evaluation.
#[derive(Serialize, Deserialize)]
pub struct Part {
    #[serde(flatten)]
    score: Score,
    /// Hash of the photograph's file. A view whose photograph has another hash is scored again.
    photograph: String,
}

fn hash_of(photograph: &Path) -> std::io::Result<String> {
    let mut hash = DefaultHasher::new();
    hash.write(&own_file::read(photograph)?);
    Ok(text::hex(hash.finish()))
}

pub struct Views {
    args: Args,
    folder: PathBuf,
    work: Work,
    scene: Option<Arc<Scene>>,
    drawer: Option<Drawer>,
}

impl Views {
    pub fn new(args: Args) -> Result<Views> {
        job::refuse(&[("--json", args.json.is_some())])?;
        let Some(folder) = args.output.clone() else {
            return Err(Usage("expected a folder for --output with --shard, found none".into()).into());
        };
        let work = prepare(&args)?;
        Ok(Views { args, folder, work, scene: None, drawer: None })
    }
}

impl job::Work for Views {
    fn outputs(&self) -> job::Outputs {
        let views = self.work.views.iter().map(|view| view.name.clone()).collect();
        job::Outputs { views, ..job::Outputs::parts(COMMAND, &self.folder, &self.work.stems) }
    }

    fn open(&mut self) -> Result<job::Origin> {
        let mut drawer = Drawer::open(&self.args, &mut self.work, self.scene.clone())?;
        let scene = match &drawer {
            Drawer::Reference(scene) => scene.clone(),
            Drawer::Device(session) => session.shared_scene(),
        };
        let views = self.work.views.iter();
        let cameras: Vec<_> = views.map(|view| view.camera.relative_to(scene.offset())).collect();
        let cameras = serde_json::to_value(cameras)?;
        let mut origin = match &drawer {
            Drawer::Reference(scene) => job::origin(scene, &cameras)?,
            Drawer::Device(session) => {
                job::refuse_animated(session)?;
                job::origin_of(session, &cameras, (&self.args.pipeline, &self.args.set))?
            }
        };
        self.scene = Some(scene);
        let mut request = request(&self.args);
        request[ORIGIN] = self::origin(&mut drawer, self.work.downscaled.as_deref())?;
        let Args { backend, downscale, background, .. } = &self.args;
        origin.extend([
            ("--backend".into(), json!(backend.to_string())),
            ("--downscale".into(), json!(downscale)),
            ("--background".into(), json!(background)),
            (job::REQUEST.into(), request),
        ]);
        self.drawer = Some(drawer);
        Ok(origin)
    }

    fn draw(&mut self, views: &[usize]) -> Result<()> {
        let drawer = self.drawer.as_mut().context("no device")?;
        let mut progress = Progress::new("scoring");
        for (index, &view) in views.iter().enumerate() {
            let (stem, view) = (&self.work.stems[view], &self.work.views[view]);
            progress.set(index as u64, views.len() as u64, &view.name);
            let hash = hash_of(view.photograph()?)?;
            let background = self.args.background;
            let (camera, photograph) = view.load(self.work.downscale, background)?;
            let drawn = drawer.draw(&camera, background)?;
            let score = view.score(&drawn, &photograph)?;
            save(&self.args, stem, &drawn, &photograph)?;
            job::write_part(&self.folder, stem, &Part { score, photograph: hash })?;
        }
        Ok(())
    }

    fn is_current(&self, view: usize) -> bool {
        let scored = || -> Result<bool> {
            let part = own_file::read(&self.folder.join(job::part(&self.work.stems[view])))?;
            let part: Part = serde_json::from_slice(&part)?;
            Ok(part.photograph == hash_of(self.work.views[view].photograph()?)?)
        };
        scored().unwrap_or(false)
    }

    fn close(&mut self) -> Vec<String> {
        match self.drawer.take() {
            Some(Drawer::Device(session)) => session.into_device().close(),
            _ => Vec::new(),
        }
    }
}

/// Command name in the `job.json` of shared folders.
pub const COMMAND: &str = "evaluate";

/// File name of the scores in the folder of a shared run.
const SCORES: &str = "scores.json";

/// Checks that all pictures have the same scale relative to their cameras. The photographs' sizes are not part of the
/// origin, because a missing photograph has none.
fn check_scales(origin: &job::Origin, parts: &[Part], missing: &[usize]) -> Result<()> {
    let cameras = origin.get("cameras").and_then(Json::as_array).context("the cameras of an evaluation")?;
    let present = cameras.iter().enumerate().filter(|(view, _)| !missing.contains(view));
    let (mut low, mut high) = ((0.0, None), (f64::INFINITY, None));
    for (part, (_, camera)) in parts.iter().zip(present) {
        let own = camera["width"].as_f64().context("the width of a camera")?;
        let width = part.score.width as f64;
        // Widths are rounded, and photographs may be cropped; see `View::drawn`.
        let slack = f64::max(1.0, 0.01 * width);
        let (least, most) = ((width - slack) / own, (width + slack) / own);
        low = if least > low.0 { (least, Some(part)) } else { low };
        high = if most < high.0 { (most, Some(part)) } else { high };
    }
    if let ((least, Some(large)), (most, Some(small))) = (low, high)
        && least > most
    {
        let text = |Part { score, .. }: &Part| {
            format!("{} with {} x {}", one_line(&score.view), score.width, score.height)
        };
        bail!(
            "expected scores of photographs of one size, found {} and {} pixels: run all shards again with the same photographs",
            text(large),
            text(small)
        );
    }
    Ok(())
}

/// Prints the scores that several processes computed, and writes them to `scores.json` in `output`. `missing` has the
/// indices of the views without scores.
///
/// # Errors
/// The origin has no request, the pictures differ in scale, or the file cannot be written.
pub fn merge(manifest: &Manifest, parts: Vec<Part>, missing: &[usize], output: &Path) -> Result<()> {
    let origin = &manifest.origin;
    check_scales(origin, &parts, missing)?;
    let missing = missing.iter().filter_map(|view| manifest.views.get(*view).cloned()).collect();
    let found = Evaluation::new(parts.into_iter().map(|part| part.score).collect(), missing);
    let request = origin.get(job::REQUEST).cloned().context("the origin of an evaluation")?;
    output::write_bytes(&output.join(SCORES), (as_json(request, &found) + "\n").as_bytes())?;
    options::print(found.table().trim_end())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::cli::parsed;
    use std::ffi::OsString;
    use std::os::unix::ffi::OsStringExt;

    #[test]
    fn names_that_are_not_utf_8_are_text_in_the_json() {
        let name = || OsString::from_vec(b"p\xff".to_vec());
        let option = |name: &str| OsString::from(name);
        let words = [option("evaluate"), name(), option("-c"), name(), option("--photographs"), name()];
        let request = request(&parsed(words).expect("a command line"));
        for field in ["scene", "dataset", "photographs"] {
            assert_eq!(request[field], "p\u{fffd}", "{field}");
        }
    }
}
