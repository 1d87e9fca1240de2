//! Owns a device on its own thread, which draws for all of Python's threads.
//!
//! A request is a camera ([`Engine::submit`], which returns a [`Pending`] picture) or a call on the session. The thread
//! draws cameras in the order of their requests and keeps up to [`FRAMES_IN_FLIGHT`] frames in flight, so that the
//! device stays busy. A call waits for the frames before it.

use crate::arrays::give;
use crate::camera::Camera;
use crate::errors::{self, DeviceError, Error};
use crate::plan::Plan;
use crate::scene::Scene;
use crate::wait::{self, Owner};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Value as Json, json};
use splatgraph::draw::backend::{Api, Backend, Options, Validation};
use splatgraph::draw::facts::DEFAULT_SIZE;
use splatgraph::draw::inspect::Words;
use splatgraph::draw::outputs::{self, Output};
use splatgraph::draw::session::{FrameOptions, Session, SessionError, image_of};
use splatgraph::draw::stats::CameraStats;
use splatgraph::io::output;
use splatgraph_api::{BackendError, Device, FRAMES_IN_FLIGHT, FrameId, Pixels};
use splatgraph_assets as assets;
use splatgraph_framework::ir::{Domain, ParamBinding};
use splatgraph_framework::lower::Control;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};

/// A call on the session, made on the drawing thread.
type Work = Box<dyn FnOnce(&mut Session) + Send>;

enum Request {
    Draw(Box<Draw>),
    Call(Work),
}

struct Draw {
    camera: assets::Camera,
    background: [f32; 3],
    /// Outputs of the graph besides the picture.
    outputs: Vec<String>,
    /// True once the caller no longer waits.
    abandoned: Arc<AtomicBool>,
    reply: Sender<Result<Drawn, SessionError>>,
}

struct Drawn {
    pixels: Option<Pixels>,
    outputs: Vec<Output>,
    stats: CameraStats,
}

struct Thread {
    requests: Sender<Request>,
    handle: JoinHandle<()>,
    owner: Owner,
}

/// A device that draws a scene with a graph. Any thread may use it.
#[pyclass(frozen, module = "splatgraph._native")]
pub struct Engine {
    /// The thread; `None` once closed.
    thread: Mutex<Option<Thread>>,
    /// Statistics of the last picture returned by [`Pending::result`].
    last: Arc<Mutex<Option<CameraStats>>>,
}

#[pymethods]
impl Engine {
    /// Opens a device. `params` are names and values of the graph's parameters, as text.
    #[new]
    #[pyo3(signature = (scene, pipeline, params, *, backend = None, device = None, validation = false))]
    fn new(
        py: Python<'_>,
        scene: &Bound<'_, Scene>,
        pipeline: String,
        params: Vec<(String, String)>,
        backend: Option<&str>,
        device: Option<String>,
        validation: bool,
    ) -> PyResult<Engine> {
        crate::configure();
        wait::pool()?;
        let api = backend.map_or_else(|| Ok(Api::default()), Api::parse);
        let api = api.map_err(|error| PyValueError::new_err(format!("backend: {error}")))?;
        let validation = if validation { Validation::On } else { Validation::Off };
        let options = Options { device, validation, ..Options::default() };
        let scene = scene.get().0.clone();
        let (requests, receiver) = channel();
        let (opened, mut is_open) = channel();
        // The drawing thread also opens the device, so that one thread makes all calls of the graphics API.
        let handle =
            Builder::new().name("splatgraph".into()).spawn(move || match Backend::open(api, &options) {
                Ok(backend) => {
                    let mut session = Session::new(backend, scene, &pipeline, &params);
                    if opened.send(Ok(())).is_ok() {
                        serve(&mut session, &receiver);
                    }
                    let messages = session.into_device().close();
                    messages.iter().for_each(|message| output::say(format!("validation: {message}")));
                }
                Err(error) => drop(opened.send(Err(error))),
            })?;
        let open: Result<(), BackendError> = wait::receive(py, &mut is_open)?;
        open.map_err(|error| errors::device(&error))?;
        let engine = Engine {
            thread: Mutex::new(Some(Thread { requests, handle, owner: Owner::current() })),
            last: Arc::default(),
        };
        // Reports an unreadable graph or an invalid setting here, rather than with the first picture.
        engine.controls(py, DEFAULT_SIZE)?;
        Ok(engine)
    }

    /// Requests a picture and outputs of the graph besides it, such as `depth`; `background` is display-encoded.
    #[pyo3(signature = (camera, background = [0.0; 3], outputs = Vec::new()))]
    fn submit(
        &self,
        camera: &Bound<'_, Camera>,
        background: [f32; 3],
        mut outputs: Vec<String>,
    ) -> PyResult<Pending> {
        // The plan depends on the order of the outputs.
        outputs.sort_unstable();
        outputs.dedup();
        let (reply, receiver) = channel();
        let abandoned = Arc::new(AtomicBool::new(false));
        let camera = camera.get().0.clone();
        let draw = Draw { camera, background, outputs, abandoned: abandoned.clone(), reply };
        self.send(Request::Draw(Box::new(draw)))?;
        Ok(Pending { receiver: Mutex::new(Some(receiver)), abandoned, last: self.last.clone() })
    }

    /// Changes the graph and its parameters. After an error, the previous ones stay.
    fn set_graph(
        &self,
        py: Python<'_>,
        pipeline: String,
        params: Vec<(String, String)>,
        size: (u32, u32),
    ) -> PyResult<()> {
        self.ask(py, move |session| {
            let former = session.graph().0.to_owned();
            session.change_graph(&pipeline, &params, size)?;
            if pipeline != former {
                // The new graph may lack the outputs of the last picture.
                session.set_outputs(&[]);
            }
            Ok(())
        })
    }

    /// Draws another scene from the next request on.
    fn set_scene(&self, py: Python<'_>, scene: &Bound<'_, Scene>) -> PyResult<()> {
        let scene = scene.get().0.clone();
        self.ask(py, move |session| {
            session.set_scene(scene);
            Ok(())
        })
    }

    /// Lists the graph's parameters for a picture size, as a list of dicts.
    #[pyo3(signature = (size = DEFAULT_SIZE))]
    fn params<'py>(&self, py: Python<'py>, size: (u32, u32)) -> PyResult<Bound<'py, PyAny>> {
        let controls: Json = self.controls(py, size)?.iter().map(control).collect();
        errors::to_python(py, &controls)
    }

    /// Builds the plan for a picture size.
    #[pyo3(signature = (size = DEFAULT_SIZE))]
    fn plan(&self, py: Python<'_>, size: (u32, u32)) -> PyResult<Plan> {
        self.ask(py, move |session| session.plan_for(size)).map(Plan)
    }

    /// Statistics of the last picture returned by `Pending.result`, as a dict; `None` before the first one.
    #[getter]
    fn stats<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let last = self.last.lock().unwrap_or_else(PoisonError::into_inner).clone();
        last.map(|stats| errors::to_python(py, &json!(stats))).transpose()
    }

    /// Description of the device: a dict with its name, driver, kind and index.
    #[getter]
    fn device<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let info = self.ask(py, |session| Ok(session.device().info().clone()))?;
        let info = json!({"name": info.name, "driver": info.driver, "kind": info.kind, "index": info.index});
        errors::to_python(py, &info)
    }

    /// Ends the thread and closes the device, after the requested pictures are done. In a fork, which lacks the thread,
    /// only refuses later calls.
    fn close(&self, py: Python<'_>) {
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(Thread { requests, handle, owner }) = thread {
            drop(requests);
            if owner.is_current() {
                // The panic hook has already printed the message of a panic.
                let _ = py.detach(|| handle.join());
            }
        }
    }
}

impl Engine {
    fn send(&self, request: Request) -> PyResult<()> {
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(thread) = thread.as_ref() else {
            return Err(Error::new_err("the renderer is closed"));
        };
        thread.owner.check()?;
        let ended =
            |_| DeviceError::new_err("the renderer's thread ended early; standard error has its message");
        thread.requests.send(request).map_err(ended)
    }

    /// Calls a function with the session, on the drawing thread, and returns its result.
    fn ask<T: Send + 'static>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut Session) -> Result<T, SessionError> + Send + 'static,
    ) -> PyResult<T> {
        let (reply, mut receiver) = channel();
        self.send(Request::Call(Box::new(move |session: &mut Session| {
            // After an interruption, the receiver is gone.
            let _ = reply.send(call(session));
        })))?;
        wait::receive(py, &mut receiver)?.map_err(|error| errors::session(py, &error))
    }

    fn controls(&self, py: Python<'_>, size: (u32, u32)) -> PyResult<Vec<Control>> {
        self.ask(py, move |session| session.controls(size))
    }
}

/// A requested picture.
#[pyclass(frozen, module = "splatgraph._native")]
pub struct Pending {
    /// Receives the result; `None` once [`Pending::result`] was called.
    receiver: Mutex<Option<Receiver<Result<Drawn, SessionError>>>>,
    abandoned: Arc<AtomicBool>,
    last: Arc<Mutex<Option<CameraStats>>>,
}

#[pymethods]
impl Pending {
    /// Waits for the picture. Can be called only once.
    ///
    /// Returns: The picture, float32 [height, width, 3], display-encoded, row 0 at the top, not clamped; and a dict of
    /// the other outputs by name.
    fn result<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyDict>)> {
        let receiver = self.receiver.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(mut receiver) = receiver else {
            return Err(Error::new_err("the result was already returned"));
        };
        let answer = wait::receive(py, &mut receiver).inspect_err(|_| self.abandon())?;
        let Drawn { pixels, outputs, stats } = answer.map_err(|error| errors::session(py, &error))?;
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(stats);
        let pixels = pixels.ok_or_else(|| DeviceError::new_err("the device returned no picture"))?;
        let image = py.detach(|| image_of(&pixels)).map_err(|error| Error::new_err(error.to_string()))?;
        let by_name = PyDict::new(py);
        for Output { name, shape, words, .. } in outputs {
            let shape: Vec<usize> = shape.into_iter().map(|length| length as usize).collect();
            let values = match &words {
                Words::Float(values) => give(py, values, &shape)?,
                Words::Uint(values) => give(py, values, &shape)?,
            };
            by_name.set_item(name, values)?;
        }
        Ok((give(py, image.rgb.as_flattened(), &[image.height, image.width, 3])?, by_name))
    }
}

impl Pending {
    fn abandon(&self) {
        self.abandoned.store(true, Ordering::Relaxed);
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        self.abandon();
    }
}

/// Draws and answers requests until the channel is closed.
fn serve(session: &mut Session, requests: &Receiver<Request>) {
    let mut flying = VecDeque::new();
    loop {
        // Waits for a request only if no frame is in flight.
        let request = match flying.is_empty() {
            true => requests.recv().map_err(|_| TryRecvError::Disconnected),
            false => requests.try_recv(),
        };
        match request {
            Ok(Request::Draw(draw)) if draw.abandoned.load(Ordering::Relaxed) => {}
            Ok(Request::Draw(draw)) => {
                let former = session.outputs().to_vec();
                if draw.outputs != former {
                    land(session, &mut flying, 0);
                    session.set_outputs(&draw.outputs);
                }
                if !start(session, &mut flying, *draw) {
                    // The plan must not depend on a request that failed.
                    session.set_outputs(&former);
                }
            }
            Ok(Request::Call(call)) => {
                land(session, &mut flying, 0);
                call(session);
            }
            Err(TryRecvError::Empty) => {
                let most = flying.len() - 1;
                land(session, &mut flying, most);
            }
            Err(TryRecvError::Disconnected) => {
                land(session, &mut flying, 0);
                return;
            }
        }
    }
}

/// Submits the frame of a request, and builds the plan first if necessary. If that fails, replies with the error and
/// returns false.
fn start(session: &mut Session, flying: &mut VecDeque<(FrameId, Draw)>, draw: Draw) -> bool {
    let size = (draw.camera.width, draw.camera.height);
    if !session.is_prepared(size) {
        land(session, flying, 0);
    }
    land(session, flying, FRAMES_IN_FLIGHT - 1);
    let camera = draw.camera.relative_to(session.scene().offset());
    let submitted = session.prepare(size, &mut |_| {}).and_then(|_| {
        let inspect = session.plan().map(outputs::inspections).unwrap_or_default();
        let background = draw.background;
        let options = FrameOptions { background, read_output: true, inspect, ..FrameOptions::default() };
        session.submit(&camera, &options)
    });
    match submitted {
        Ok(frame) => {
            flying.push_back((frame, draw));
            true
        }
        Err(error) => {
            drop(draw.reply.send(Err(error)));
            false
        }
    }
}

/// Waits for the oldest frames, and replies to their requests, until at most `most` frames are in flight.
fn land(session: &mut Session, flying: &mut VecDeque<(FrameId, Draw)>, most: usize) {
    while flying.len() > most {
        let Some((frame, draw)) = flying.pop_front() else { return };
        let answer = session.wait(frame).and_then(|mut result| {
            let pixels = result.output.take();
            let memory = session.device().memory();
            let info = session.device().info().clone();
            let count = session.scene().count().into();
            let plan = session.plan().ok_or(SessionError::NotPrepared)?;
            let outputs = outputs::read(plan, &result.inspected);
            let camera = (draw.camera.img_name.as_str(), (draw.camera.width, draw.camera.height));
            let stats = CameraStats::new(camera, plan, &info, count, &[result], memory);
            Ok(Drawn { pixels, outputs, stats })
        });
        // If the request was abandoned meanwhile, the receiver is gone.
        let _ = draw.reply.send(answer);
    }
}

fn control(control: &Control) -> Json {
    let param = &control.param;
    let (kind, range, step, choices) = match &param.domain {
        Domain::Bool => ("bool", Json::Null, Json::Null, Json::Null),
        Domain::Int { min, max } => ("int", json!([min, max]), Json::Null, Json::Null),
        Domain::Float { min, max, step } => ("float", json!([min, max]), json!(step), Json::Null),
        Domain::Choice(names) => ("str", Json::Null, Json::Null, json!(names)),
    };
    json!({
        "name": param.name, "value": param.value, "default": param.default,
        "exact": param.exact, "kind": kind, "range": range, "step": step, "choices": choices,
        "live": matches!(param.binding, ParamBinding::Live { .. }), "grows": param.grows.is_some(),
        "label": control.label, "help": control.help,
    })
}
