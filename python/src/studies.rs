//! Runs the library's studies, each on its own thread, with progress and cancellation.

use crate::arrays::take_picture;
use crate::camera::Camera;
use crate::errors;
use crate::scene::Scene;
use crate::wait;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde_json::json;
use splatgraph::draw::backend::{Api, Backend, Options};
use splatgraph::draw::interleaved::Frames;
use splatgraph::io::image::Image;
use splatgraph::io::output::names::{self, MAX_NAME_BYTES};
use splatgraph::studies::study::{Listener, StudyError, Subject};
use splatgraph::studies::{advise as advising, trade as trading};
use splatgraph_assets as assets;
use std::collections::HashMap;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::mpsc::Sender;
use std::sync::{Mutex, PoisonError};
use std::thread::JoinHandle;

/// Threads of studies that may not have ended. The process waits for them at its end, because they use a driver.
static THREADS: Mutex<Vec<JoinHandle<()>>> = Mutex::new(Vec::new());

enum News<T> {
    Progress(String, u64, u64, String),
    Message(String),
    Done(T),
}

/// A listener that sends a study's messages. Dropping the receiver cancels the study.
struct Reporter<T>(Sender<News<T>>);

impl<T> Listener for Reporter<T> {
    fn progress(&mut self, task: &str, done: u64, of: u64, step: &str) -> ControlFlow<()> {
        match self.0.send(News::Progress(task.to_owned(), done, of, step.to_owned())) {
            Ok(()) => ControlFlow::Continue(()),
            Err(_) => ControlFlow::Break(()),
        }
    }

    fn say(&mut self, message: &str) {
        // If the receiver is gone, the next progress report cancels the study.
        let _ = self.0.send(News::Message(message.to_owned()));
    }
}

/// Runs a study on its own thread; returns its result and its messages.
///
/// `progress` is called with four arguments: the task, the number of steps done, the total, and the next step.
///
/// # Errors
/// The study's own error; or the exception of `progress` or of a signal handler, such as `KeyboardInterrupt`. After an
/// exception, the study ends when it next reports progress.
fn run<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    study: impl FnOnce(&mut dyn Listener) -> Result<T, StudyError> + Send + 'static,
) -> PyResult<(T, Vec<String>)> {
    wait::pool()?;
    let (sender, mut receiver) = std::sync::mpsc::channel();
    let thread = std::thread::Builder::new().name("splatgraph".into()).spawn(move || {
        let found = study(&mut Reporter(sender.clone()));
        // After an interruption, the receiver is gone.
        let _ = sender.send(News::Done(found));
    })?;
    let mut messages = Vec::new();
    let found = loop {
        match wait::receive(py, &mut receiver) {
            Ok(News::Done(found)) => break found.map_err(|error| errors::study(py, &error)),
            Ok(News::Message(message)) => messages.push(message),
            Ok(News::Progress(task, done, of, step)) => {
                if let Some(Err(error)) = progress.map(|progress| progress.call1((task, done, of, step))) {
                    break Err(error);
                }
            }
            Err(error) => break Err(error),
        }
    };
    drop(receiver);
    let mut threads = THREADS.lock().unwrap_or_else(PoisonError::into_inner);
    threads.retain(|thread| !thread.is_finished());
    threads.push(thread);
    drop(threads);
    found.map(|found| (found, messages))
}

/// Waits for the threads of all studies, at the end of the process. Does nothing in a fork, which lacks them.
#[pyfunction]
pub fn _join_studies(py: Python<'_>) {
    if wait::pool().is_err() {
        return;
    }
    let threads = std::mem::take(&mut *THREADS.lock().unwrap_or_else(PoisonError::into_inner));
    // The panic hook has already printed the message of a panic.
    py.detach(|| threads.into_iter().for_each(|thread| drop(thread.join())));
}

/// The device of a study, and the numbers of frames and rounds.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Effort {
    backend: Option<String>,
    device: Option<String>,
    rounds: u32,
    frames: Option<u32>,
}

impl Effort {
    fn api(&self) -> PyResult<Api> {
        let api = self.backend.as_deref().map_or_else(|| Ok(Api::default()), Api::parse_drawing);
        api.map_err(|error| PyValueError::new_err(format!("backend: {error}")))
    }

    fn frames(&self) -> Frames {
        Frames { rounds: self.rounds, frames: self.frames }
    }

    fn options(&self) -> Options {
        Options { device: self.device.clone(), ..Options::default() }
    }
}

/// Measures settings: see `splatgraph.trade`. Returns a dict.
#[pyfunction]
#[pyo3(signature = (scene, cameras, pipeline, params, graphs, only, truths, file, effort, progress = None))]
#[expect(clippy::too_many_arguments, reason = "the package has one caller, with defaults")]
pub fn trade<'py>(
    py: Python<'py>,
    scene: &Bound<'py, Scene>,
    cameras: Vec<Bound<'py, Camera>>,
    pipeline: String,
    params: Vec<(String, String)>,
    graphs: Vec<String>,
    only: Vec<String>,
    truths: Option<Vec<Bound<'py, PyAny>>>,
    file: Option<PathBuf>,
    effort: Effort,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    crate::configure();
    let scene = scene.get().0.clone();
    let cameras = of_study(&scene, &cameras)?;
    let truths = truths.map(|truths| pictures(&truths, &cameras)).transpose()?;
    let (api, options, frames) = (effort.api()?, effort.options(), effort.frames());
    let wanted = trading::Wanted {
        pipeline,
        set: params,
        graphs,
        only,
        frames,
        truths: truths.map(|truths| ("arrays".into(), truths)),
        opened: "from Python".into(),
        command: String::new(),
        file,
    };
    let name = format!("{:016x}", scene.identity());
    let (ledger, messages) = run(py, progress, move |listener| {
        let device = Backend::open(api, &options)?;
        let subject = Subject { device, name, scene, cameras };
        let found = trading::study(&subject, &wanted, listener);
        subject.device.close();
        found
    })?;
    let (lines, failed) = ledger.lines();
    let table = trading::table::table(&lines);
    let page = trading::page::page(&ledger, &lines, &failed, &trading::pictures::Album::default())
        .map_err(|error| errors::study(py, &error.into()))?;
    let provenance = &ledger.origin.provenance;
    let csv = trading::table::csv(&ledger, &lines);
    let all = json!({
        "lines": lines, "failed": failed, "rows": ledger.rows, "device": provenance.device, "messages": messages,
        "notes": trading::table::notes(&lines), "table": table, "csv": csv, "html": page,
    });
    errors::to_python(py, &all)
}

/// Describes a scene and, if there is a budget, searches for settings: see `splatgraph.advise`. Returns a dict.
///
/// `budget` is the minimum PSNR in decibels and the maximum frame time in milliseconds; both `None` means no search.
#[pyfunction]
#[pyo3(signature = (scene, cameras, pipeline, params, budget, errors, effort, progress = None))]
#[expect(clippy::too_many_arguments, reason = "the package has one caller, with defaults")]
pub fn advise<'py>(
    py: Python<'py>,
    scene: &Bound<'py, Scene>,
    cameras: Vec<Bound<'py, Camera>>,
    pipeline: String,
    params: Vec<(String, String)>,
    budget: (Option<f64>, Option<f64>),
    errors: u64,
    effort: Effort,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    crate::configure();
    let scene = scene.get().0.clone();
    let cameras = of_study(&scene, &cameras)?;
    let (api, options, frames) = (effort.api()?, effort.options(), effort.frames());
    let budget = advising::search::Budget { psnr: budget.0, ms: budget.1 };
    let wanted = advising::Wanted { pipeline, set: params, budget, frames };
    let (mut all, messages) = run(py, progress, move |listener| {
        let advising::Description { report, keys, bands } = advising::describe(&scene, &cameras, errors);
        let mut all = json!({ "report": report, "text": report.to_string(), "keys": keys, "bands": bands });
        if budget == advising::search::Budget::default() {
            return Ok(all);
        }
        let device = Backend::open(api, &options)?;
        let subject = Subject { device, name: "scene".into(), scene, cameras };
        let found = advising::study(&subject, &keys, &wanted, listener);
        subject.device.close();
        let advice = found?;
        let best = advice.best();
        all["best"] = json!(best.found);
        all["hidden"] = json!(best.hidden);
        all["tried"] = json!(advice.tried);
        all["unsure"] = json!(advice.unsure);
        Ok(all)
    })?;
    all["notes"] = json!(messages);
    errors::to_python(py, &all)
}

/// Converts cameras to a scene's coordinates, and gives each a unique name.
fn of_study(scene: &assets::Scene, cameras: &[Bound<'_, Camera>]) -> PyResult<Vec<assets::Camera>> {
    if cameras.is_empty() {
        return Err(PyValueError::new_err("cameras: expected at least one, found none"));
    }
    let mut cameras: Vec<assets::Camera> =
        cameras.iter().map(|camera| camera.get().0.relative_to(scene.offset())).collect();
    let names: Vec<String> = cameras.iter().map(|camera| camera.img_name.clone()).collect();
    let mut uses: HashMap<&str, usize> = HashMap::new();
    names.iter().for_each(|name| *uses.entry(name).or_default() += 1);
    for (camera, own) in cameras.iter_mut().zip(names::unique(&names, MAX_NAME_BYTES)) {
        if camera.img_name.is_empty() || uses.get(camera.img_name.as_str()).is_some_and(|uses| *uses > 1) {
            camera.img_name = own;
        }
    }
    Ok(cameras)
}

fn pictures(truths: &[Bound<'_, PyAny>], cameras: &[assets::Camera]) -> PyResult<Vec<Image>> {
    if truths.len() != cameras.len() {
        return Err(PyValueError::new_err(format!(
            "truths: expected a picture for each of {} cameras, found {}",
            cameras.len(),
            truths.len()
        )));
    }
    let of = |(index, (truth, camera)): (usize, (&Bound<'_, PyAny>, &assets::Camera))| {
        let size = (camera.width as usize, camera.height as usize);
        let picture = take_picture(truth, "truths", Some(size))?;
        match picture.rgb.as_flattened().iter().find(|value| !value.is_finite()) {
            Some(value) => {
                Err(PyValueError::new_err(format!("truths[{index}]: expected finite values, found {value}")))
            }
            None => Ok(picture),
        }
    };
    truths.iter().zip(cameras).enumerate().map(of).collect()
}
