//! Draws views of a scene on a device or with the exact renderer, and writes their pictures.

use super::args::{Args, Renderer, Work};
use super::batch::Batch;
use super::destination::{Destination, PICTURE, in_folder, per_camera};
use super::frames::{self, Drawn};
use crate::cli::cameras;
use crate::cli::loading;
use crate::cli::options;
use crate::cli::outcome::{Usage, claim_graph_files};
use crate::draw::backend::Backend;
use crate::draw::blind;
use crate::draw::facts::DEFAULT_SIZE;
use crate::draw::orbit;
use crate::draw::outputs::{self, RGBA};
use crate::draw::projection;
use crate::draw::session::{EarlyPlan, Session, draws_mesh};
use crate::draw::stats::CPU_TIMES;
use crate::draw::storage::Choice;
use crate::draw::truth::{self, Truth, TruthStats};
use crate::io::image::Format;
use crate::io::output::{OutputGuard, one_line, say};
use crate::io::progress::Progress;
use anyhow::{Context, Result};
use serde_json::Value as Json;
use splatgraph_api::{Device, DeviceInfo};
use splatgraph_assets::{Camera, Projection, Scene};
use splatgraph_reference::{KeyOf, Rules};
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;
use std::thread;
use tracing::info_span;

#[derive(Clone)]
pub struct Loaded {
    pub scene: Arc<Scene>,
    /// Cameras in the scene's coordinates, in the order of the file names in [`Work`].
    pub cameras: Vec<Camera>,
}

impl Loaded {
    /// Loads the scenes and their cameras. Cameras get the requested size and the projection `graph`. With the exact
    /// renderer and a pinhole `graph`, they keep their own projections.
    fn load(args: &Args, work: &Work, graph: Projection, cancel: &AtomicBool) -> Result<Loaded> {
        let (scene, own) = args.scenes.load(cancel)?;
        let given = work.given.clone().or(own.map(|own| vec![own]));
        let size = args.drawing.size;
        let mut found = loading::cameras_of(&scene, given, size);
        if graph == Projection::Equirectangular && args.look.names().is_none() {
            match work.given {
                Some(_) => cameras::tell_tilt(found.iter().filter(|c| c.projection.is_pinhole()), scene.up()),
                None => found = found.iter().map(|camera| orbit::levelled(camera, scene.up())).collect(),
            }
        }
        found = args.look.cameras(&scene, size, graph)?.unwrap_or(found);
        // The exact renderer draws each camera in its own projection, unless the graph's name selects one.
        if args.backend != Renderer::Reference || !graph.is_pinhole() {
            found = projection::convert_all(&found, graph, &scene, size)?;
        }
        let cameras: Vec<Camera> =
            found.into_iter().map(|camera| args.look.scaled(camera)).collect::<Result<_, _>>()?;
        cameras::tell_shape(&cameras);
        Ok(Loaded { scene: scene.into(), cameras })
    }
}

/// A renderer that keeps the scene and the device between calls.
pub struct Drawer {
    loaded: Loaded,
    stems: Vec<String>,
    with: With,
}

enum With {
    Device { session: Box<Session>, batch: Box<Batch>, guard: OutputGuard },
    Exact { done: Vec<TruthStats> },
}

impl Drawer {
    /// Loads the scene, unless it is given, while the device is opened. The exact renderer needs no device. Chooses the
    /// storage of the splats, and prints notes about it, the times and the outputs.
    ///
    /// # Errors
    /// There is no suitable device, a rule is invalid, the scene cannot be loaded or is too large, or its cameras do
    /// not suit the graph.
    pub fn open(args: &Args, work: &Work, loaded: Option<Loaded>) -> Result<Drawer> {
        let pipeline = &args.drawing.pipeline;
        let graph = || match args.backend {
            // A preset named after a projection selects that projection.
            Renderer::Reference => pipeline.parse().unwrap_or_default(),
            Renderer::Device(_) => projection::of_graph_for(
                pipeline,
                &args.drawing.set,
                work.given.as_deref().unwrap_or_default(),
            ),
        };
        let load = |cancel: &_| loaded.map_or_else(|| Loaded::load(args, work, graph(), cancel), Ok);
        let requested: Vec<String> =
            args.named().map(|(name, _)| outputs::source_of(name).to_owned()).collect();
        let stems = work.stems.clone();
        let Renderer::Device(api) = args.backend else {
            // Report invalid rules before a large scene is loaded.
            truth::rules(Rules::PUBLISHED, &args.rule).map_err(|error| Usage(error.to_string()))?;
            let loaded = load(&loading::NEVER)?;
            let lens = loaded.cameras.iter().find(|camera| !camera.projection.is_pinhole());
            if let Some(camera) = lens.filter(|_| loaded.scene.mesh().is_some()) {
                let projection = camera.projection;
                say(format!(
                    "the scene's mesh is not drawn: expected a pinhole camera, found a {projection} one"
                ));
            }
            if loaded.scene.mesh().is_some() && loaded.cameras.iter().any(|c| c.projection.is_pinhole()) {
                outputs_with_mesh(args)?.iter().for_each(say);
            }
            let sorts_by_distance = |camera: &Camera| {
                let rules = truth::rules(Rules::of_view(&loaded.scene, camera), &args.rule);
                !camera.projection.sees_behind() && rules.is_ok_and(|rules| rules.key_of == KeyOf::Distance)
            };
            if loaded.cameras.iter().any(sorts_by_distance) {
                let names = args.named().map(|(name, _)| name);
                outputs::distance_note(names, "--rule key_of=depth").iter().for_each(say);
            }
            return Ok(Drawer { loaded, stems, with: With::Exact { done: Vec::new() } });
        };
        let (pipeline, set) = (&args.drawing.pipeline, &args.drawing.set);
        let (sender, chosen) = channel();
        let open = || {
            let tell = &mut |info: &DeviceInfo| _ = sender.send(info.facts);
            let device = info_span!("open the device")
                .in_scope(|| Backend::open_telling(api, &args.device.options(), tell));
            // Without a device, the other thread must not wait for one.
            drop(sender);
            let device = device?;
            let checked = |set: &[_]| args.scenes.check_header(device.info(), pipeline, set);
            // A scene that is too large may fit in a packed storage. If not, report the error of the requested storage.
            info_span!("check the scene's header").in_scope(|| {
                checked(set).or_else(|error| match Choice::smallest(set) {
                    Some(smallest) => checked(&[set.as_slice(), &[smallest]].concat()).map_err(|_| error),
                    None => Err(error),
                })
            })?;
            Ok(device)
        };
        // The plan of the first view is built while the device is created. If it has errors, building it again reports
        // them.
        let names = requested.clone();
        let load_and_plan = move |cancel: &_| {
            let loaded = load(cancel)?;
            // With --inspect, resources do not share memory, so another plan is drawn.
            let first = loaded.cameras.first().filter(|_| args.inspect.is_empty());
            let early = first.zip(chosen.recv().ok()).and_then(|(camera, device)| {
                let size = (camera.width, camera.height);
                EarlyPlan::new((pipeline, set), names, &loaded.scene, &device, size).ok()
            });
            Ok((loaded, early))
        };
        let (device, (loaded, early)) = loading::open_and_load(open, load_and_plan)?;
        let mut session = Session::new(device, loaded.scene.clone(), pipeline, set);
        if let Some(early) = early {
            session = session.with_plan(early);
        }
        if !args.inspect.is_empty() {
            session.keep_contents();
            say(
                "resources do not share memory while --inspect reads them: a pass that reads stale contents may draw \
                 another picture than without --inspect",
            );
        }
        if args.repeat > 1 && session.device().info().is_cpu() {
            say(CPU_TIMES);
        }
        session.set_outputs(&requested);
        let sizes = loaded.cameras.iter().map(|camera| (camera.width, camera.height));
        let largest = sizes.max_by_key(|(width, height)| u64::from(*width) * u64::from(*height));
        let limit = args.memory.memory;
        let size = largest.unwrap_or(DEFAULT_SIZE);
        let choice = session.choose_storage(limit, size);
        let choice = choice.map_err(|error| args.scenes.too_large(error, limit, &mut session, size))?;
        choice.iter().filter(|choice| limit.is_some() || choice.set.is_some()).for_each(say);
        let file =
            |(name, file): (&str, &Path)| (name.to_owned(), file.to_owned(), in_folder(name, args.format));
        let files: Vec<(String, PathBuf, Format)> = args.named().map(file).collect();
        let (jobs, files) = ((options::jobs(args.jobs), args.json.is_some()), (files, loaded.cameras.len()));
        let mut batch = Batch::new(jobs, work.destination.clone(), files, args.background, args.stdout());
        batch.opened = args.device.opened();
        let with =
            With::Device { session: Box::new(session), batch: batch.into(), guard: work.guard.clone() };
        Ok(Drawer { loaded, stems, with })
    }

    pub fn loaded(&self) -> &Loaded {
        &self.loaded
    }

    /// Builds and checks the plan for the first view, and returns the session; `None` for the exact renderer.
    pub fn prepared(&mut self, args: &Args) -> Result<Option<&Session>> {
        let With::Device { session, guard, .. } = &mut self.with else { return Ok(None) };
        if let Some(camera) = self.loaded.cameras.first() {
            frames::prepare_plan(session, camera).map_err(|error| args.or_picture(error.into()))?;
            check_plan(args, session, guard, camera)?;
        }
        Ok(Some(session))
    }

    /// Draws the views with these camera indices. May return before all files are written; see [`Drawer::finish`].
    ///
    /// # Errors
    /// A view cannot be drawn. If the graph, or the device's limits or memory, do not allow its size or its frame, the
    /// other views are drawn first.
    pub fn draw(&mut self, args: &Args, views: &[usize]) -> Result<()> {
        let Drawer { loaded: Loaded { scene, cameras }, stems, with } = self;
        let mut blind = 0;
        let mut progress = Progress::new("drawing");
        for (index, &view) in views.iter().enumerate() {
            let (camera, stem) = (&cameras[view], &stems[view]);
            progress.set(index as u64, views.len() as u64, &camera.img_name);
            match with {
                With::Device { session, batch, guard } => {
                    let view = (camera, stem.as_str(), cameras.len());
                    draw(args, session, batch, guard, view, &progress)?;
                }
                With::Exact { done } => {
                    let stats =
                        progress.suspend(|| draw_exactly(args, scene, (camera, stem), cameras.len()))?;
                    blind += usize::from(stats.loaded > 0 && stats.most_contributors == 0);
                    if args.json.is_some() {
                        done.push(stats);
                    }
                }
            }
        }
        if let With::Device { session, batch, .. } = with {
            batch.land_all(session, &progress)?;
            batch.report_skipped(views.len())?;
            blind = std::mem::take(&mut batch.blind);
        }
        let rules = |camera: &Camera| match &*with {
            With::Device { session, .. } => Ok(blind::rules_of(session.plan(), scene, camera)),
            With::Exact { .. } => truth::rules(Rules::of_view(scene, camera), &args.rule),
        };
        // Cameras of files that are far from the scene were reported when they were read.
        if args.look.has_camera() || loading::stray_cameras(cameras, scene).is_none() {
            let drawn = views.iter().map(|view| &cameras[*view]);
            let drawn: Result<Vec<_>, _> =
                drawn.map(|camera| rules(camera).map(|rules| (camera, rules))).collect();
            // A panorama has no --fov.
            loading::tell_blind(scene, (blind, views.len()), &drawn?, "`--orbit 1`");
        }
        Ok(())
    }

    /// Waits until all files are written.
    pub fn finish(&mut self) -> Result<()> {
        if let With::Device { batch, .. } = &mut self.with {
            batch.finish(&Progress::new("drawing"))?;
        }
        Ok(())
    }

    /// Closes the device while other threads write the last files and free the scene. Returns the statistics of all
    /// views, in order, if `--json` wants them, and the device's validation messages.
    pub fn close(self) -> Result<(Json, Vec<String>)> {
        let Drawer { loaded, with, .. } = self;
        let (session, mut batch) = match with {
            With::Device { session, batch, .. } => (session, batch),
            With::Exact { done } => return Ok((serde_json::to_value(done)?, Vec::new())),
        };
        batch.wait_for_pixels();
        // Drop the session's reference to the scene, so that the drop below frees it.
        let device = session.into_device();
        let name = |name: &str| thread::Builder::new().name(name.into());
        thread::scope(|scope| {
            // If the thread cannot be started, the scene is freed here.
            _ = name("free").spawn_scoped(scope, || info_span!("free the scene").in_scope(|| drop(loaded)));
            let finishing = name("files")
                .spawn_scoped(scope, || {
                    let done = batch.finish(&Progress::new("drawing"))?;
                    Ok(serde_json::to_value(done)?)
                })
                .context("no thread can be started to finish the files")?;
            let messages = info_span!("close the device").in_scope(|| device.close());
            let stats: Result<Json> = finishing.join().unwrap_or_else(|panic| resume_unwind(panic));
            Ok((stats?, messages))
        })
    }
}

/// Draws a view on a device, or skips it if its size was refused. A single frame without `--inspect` is only submitted.
/// The tuple is the camera, its file name stem, and the number of cameras.
fn draw(
    args: &Args,
    session: &mut Session,
    batch: &mut Batch,
    guard: &mut OutputGuard,
    (camera, stem, cameras): (&Camera, &str, usize),
    progress: &Progress,
) -> Result<()> {
    if batch.skip_refused(camera) {
        return Ok(());
    }
    if !session.is_prepared((camera.width, camera.height)) {
        batch.land_all(session, progress)?;
    }
    let loaded = match frames::prepare_plan(session, camera) {
        Ok(loaded) => loaded,
        Err(error) => return batch.refuse(camera, error),
    };
    if loaded {
        progress.suspend(|| check_plan(args, session, guard, camera))?;
    }
    if args.repeat == 1 && args.inspect.is_empty() {
        return batch.submit(session, (camera, stem), progress);
    }
    let read_output = batch.reads_picture();
    let drawn = frames::draw(args, read_output, session, camera, loaded);
    let Drawn { stats, output, outputs, requests } = match drawn.map_err(anyhow::Error::downcast) {
        Ok(drawn) => drawn,
        Err(Ok(error)) => return batch.skip(camera.img_name.clone(), error).map(drop),
        Err(Err(error)) => return Err(error),
    };
    let inspected: Vec<_> = stats.inspected.iter().cloned().zip(requests).collect();
    batch.save(stats, output, outputs, stem.to_owned(), progress)?;
    batch.finish(progress)?;
    for (finding, inspect_request) in inspected {
        progress.suspend(|| args.stdout().line(&finding.text()))?;
        if let Some(file) = &args.inspect[inspect_request].file {
            finding.save(&per_camera(file, Format::Npy, stem, cameras))?;
        }
    }
    Ok(())
}

/// Prints notes about a new plan's settings and outputs, and registers the graph's files as inputs.
///
/// # Errors
/// An output cannot have its file's format, `rgba` is among the outputs of a picture with a mesh, or an output would
/// overwrite a file of the graph.
fn check_plan(args: &Args, session: &mut Session, guard: &mut OutputGuard, camera: &Camera) -> Result<()> {
    let _span = info_span!("check files and settings").entered();
    session.settings_without_effect().iter().for_each(say);
    session.background_note(args.background).iter().for_each(say);
    let plan = session.plan().context("no plan after `prepare`")?;
    outputs::check_formats(plan, args.formats()).map_err(Usage)?;
    outputs::behind_note(plan, &args.drawing.set, camera).iter().for_each(say);
    if outputs::sorts_by_distance(plan) && !camera.projection.sees_behind() {
        let names = plan.outputs.iter().map(|output| output.name.as_str());
        outputs::distance_note(names, "--set key_of=depth").iter().for_each(say);
    }
    if draws_mesh(plan) {
        outputs_with_mesh(args)?.iter().for_each(say);
    }
    claim_graph_files(guard, &session.files())?;
    Ok(())
}

/// Returns a note for the outputs of a picture with a mesh; `None` without outputs.
///
/// # Errors
/// `rgba` is among them.
fn outputs_with_mesh(args: &Args) -> Result<Option<String>, Usage> {
    let names = || args.named().map(|(name, _)| name);
    if names().any(|name| name == RGBA.0) {
        let why = "expected a scene without a mesh for the output `rgba`: `alpha` does not contain the mesh; --set mesh=false \
                   draws the splats alone";
        return Err(Usage(why.into()));
    }
    Ok(outputs::mesh_note(names()))
}

fn draw_exactly(
    args: &Args,
    scene: &Scene,
    (camera, stem): (&Camera, &str),
    cameras: usize,
) -> Result<TruthStats> {
    let _span = info_span!("draw exactly").entered();
    let rules = truth::rules(Rules::of_view(scene, camera), &args.rule)?;
    let mut truth = Truth::draw(scene, camera, args.background, &rules)?;
    let image = truth.image();
    for (name, file) in args.named() {
        let source = truth.output(outputs::source_of(name));
        let output = outputs::named(name, source.as_ref(), Some(&image), args.background);
        let output = output.with_context(|| format!("the exact renderer has no output `{name}`"))?;
        let path = per_camera(file, in_folder(name, args.format), stem, cameras);
        output.save(&path)?.and_then(|found| found.note(path.display())).iter().for_each(say);
        truth.stats.files.insert(name.into(), options::text_of(&path));
    }
    let name = match Destination::of(args.picture()?, args.format)? {
        Some(destination) => {
            let path = destination.path(stem);
            image.save_as(destination.format(), &path)?;
            let name = options::text_of(&path);
            truth.stats.files.insert(PICTURE.into(), name.clone());
            name
        }
        None => one_line(&camera.img_name).into_owned(),
    };
    args.stdout().line(&format!("{name}: {} x {}, {}", camera.width, camera.height, truth.stats))?;
    Ok(truth.stats)
}
