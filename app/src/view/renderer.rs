//! Draws with a graph and keeps its plan up to date.
//!
//! A [`Renderer`] has a device, the name of a graph, and its settings. When a file of the graph, a constant parameter or the
//! [`PlanInputs`] change, it builds a new plan on another thread while frames of the current plan go on, and swaps to it
//! between frames. If the build fails, the current plan stays and the failure is reported. Live parameters need no build: they
//! go to the device with the next frame.
//!
//! One plan is built at a time; changes during a build are combined into the next one.

mod events;
mod job;

use super::profile::zone;
use indexmap::IndexMap;
use job::{Built, Job, builder};
use splatgraph_api::{
    BackendError, Device, FRAMES_IN_FLIGHT, FrameId, FrameInputs, FrameResult, Inspect, Loader,
};
use splatgraph_assets::Scene;
use splatgraph_framework::ir::{Catalog, ParamBinding, Value};
use splatgraph_framework::lower::{Control, parse_value};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::reload::{
    Attempt, FileChange, LastGood, Rebuilder, Wanted, WatchError, WatchKind, Watcher,
};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

pub use events::{Cause, Failure, RendererEvent, Swap};

/// A callback for new content to draw; any thread calls it.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// The inputs of a plan besides its files and parameters.
#[derive(Clone)]
pub struct PlanInputs {
    /// The scene to draw; `None` for a graph that draws no scene, such as the window's.
    pub scene: Option<Arc<Scene>>,
    /// The imports of graphs.
    pub catalog: Arc<Catalog>,
    /// Size of the picture, in pixels.
    pub size: (u32, u32),
    /// See [`splatgraph_framework::ir::Request::share_memory`].
    pub share_memory: bool,
}

impl PlanInputs {
    /// Returns the cause of a new build if a plan for `former` does not fit.
    fn differs(&self, former: &PlanInputs) -> Option<Cause> {
        let identity = |inputs: &PlanInputs| inputs.scene.as_ref().map(|scene| scene.identity());
        if identity(self) != identity(former) {
            Some(Cause::Scene)
        } else if self.size != former.size {
            Some(Cause::Size)
        } else if self.share_memory != former.share_memory {
            Some(Cause::Memory)
        } else {
            None
        }
    }
}

/// A finished frame.
pub struct FinishedFrame {
    /// The device's results.
    pub result: FrameResult,
    /// The frame's plan.
    pub plan: Arc<Plan>,
    /// True for the first frame of the plan.
    pub first: bool,
    /// The requested inspections.
    pub inspected: Vec<Inspect>,
}

struct FrameInFlight {
    frame: FrameId,
    plan: Arc<Plan>,
    inspected: Vec<Inspect>,
    first: Option<PendingSwap>,
}

/// A swap before the end of its first frame.
struct PendingSwap {
    swap: Swap,
    asked: Instant,
}

/// The next plan to build.
struct PendingBuild {
    cause: Cause,
    /// Time of the change.
    asked: Instant,
    attempt: Attempt,
}

type Ready<D> = <<D as Device>::Loader as Loader>::Ready;

/// A device with a graph; see the module's documentation.
pub struct Renderer<D: Device> {
    device: D,
    graph: String,
    set: IndexMap<String, String>,
    strict: bool,
    builder: Rebuilder<Job<D::Loader>, Built<Ready<D>>>,
    watcher: Watcher,
    pending_build: Option<PendingBuild>,
    asked: Option<PlanInputs>,
    state: LastGood<Arc<Plan>, Failure>,
    /// Time of the last poll.
    now: Instant,
    controls: Vec<Control>,
    size: (u32, u32),
    pending_swap: Option<PendingSwap>,
    in_flight: VecDeque<FrameInFlight>,
    done: Vec<FinishedFrame>,
    events: Vec<RendererEvent>,
    /// The last reported failure.
    failed: Option<String>,
    /// The attempt of the current build.
    building: Option<Attempt>,
    progress: Arc<Mutex<String>>,
}

impl<D: Device> Renderer<D> {
    /// Creates a renderer of `graph`, a built-in one's name or a path, with the parameters in `set`.
    pub fn new(
        device: D,
        graph: &str,
        set: &[(String, String)],
        wake: Wake,
    ) -> Result<Renderer<D>, WatchError> {
        let woken = wake.clone();
        let watcher = Watcher::new(move || woken())?;
        let woken = wake;
        let builder = Rebuilder::new(builder, move || woken())?;
        let mut state = LastGood::new();
        let now = Instant::now();
        let build = PendingBuild { cause: Cause::Start, asked: now, attempt: state.asked(now) };
        Ok(Renderer {
            device,
            graph: graph.to_owned(),
            set: set.iter().cloned().collect(),
            strict: true,
            builder,
            watcher,
            pending_build: Some(build),
            asked: None,
            state,
            now,
            controls: Vec::new(),
            size: (0, 0),
            pending_swap: None,
            in_flight: VecDeque::new(),
            done: Vec::new(),
            events: Vec::new(),
            failed: None,
            building: None,
            progress: Arc::default(),
        })
    }

    /// Returns the device.
    pub fn device(&self) -> &D {
        &self.device
    }

    /// Returns the device for changes that concern no plan.
    pub fn device_mut(&mut self) -> &mut D {
        &mut self.device
    }

    /// Returns the requested name of the graph.
    pub fn graph(&self) -> &str {
        &self.graph
    }

    /// Returns the current plan.
    pub fn plan(&self) -> Option<&Arc<Plan>> {
        self.state.good()
    }

    /// Returns the size of the plan's pictures, in pixels.
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// Returns the parameters with the requested values; constants may still wait for a new plan.
    pub fn controls(&self) -> &[Control] {
        &self.controls
    }

    /// Returns the changed parameters with their values as text, in the order of the first change.
    pub fn set(&self) -> &IndexMap<String, String> {
        &self.set
    }

    /// Returns the failure of the newest files and parameters, if they have no plan.
    pub fn failure(&self) -> Option<&Failure> {
        self.state.error(self.now)
    }

    /// Returns true while a plan is being built or waits for it.
    pub fn busy(&self) -> bool {
        self.pending_build.is_some() || self.building.is_some() || self.state.due(self.now).is_some()
    }

    /// Describes the current step of the build; empty if unknown.
    pub fn progress(&self) -> String {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the kind of file watching.
    pub fn watching(&self) -> WatchKind {
        self.watcher.kind()
    }

    /// Changes to another graph and replaces the settings.
    pub fn choose(&mut self, graph: &str, set: IndexMap<String, String>) {
        self.graph = graph.to_owned();
        self.set = set;
        self.want(Cause::Graph, Instant::now());
    }

    /// Sets a parameter; `None` restores its default. An unknown name, or a value of another type, changes nothing.
    pub fn set_param(&mut self, name: &str, value: Option<Value>) {
        let Some(param) = self.controls.iter_mut().map(|c| &mut c.param).find(|p| p.name == name) else {
            return;
        };
        let value = value.filter(|value| *value != param.default);
        match &value {
            Some(value) => {
                self.set.insert(name.to_owned(), value.to_string());
            }
            None => {
                self.set.shift_remove(name);
            }
        }
        param.value = value.unwrap_or_else(|| param.default.clone());
        if param.binding == ParamBinding::Const {
            self.want(Cause::Parameters(vec![name.to_owned()]), Instant::now());
        }
    }

    /// Restores the defaults of all parameters.
    pub fn reset_params(&mut self) {
        let names: Vec<String> = self.set.keys().cloned().collect();
        for name in names {
            self.set_param(&name, None);
        }
    }

    /// Requests a build because of a change at the time `asked`.
    pub fn want(&mut self, cause: Cause, asked: Instant) {
        let now = Instant::now();
        // A file may be half written, so its errors wait for a moment.
        let attempt = match cause {
            Cause::Files(_) => self.state.changed(now),
            _ => self.state.asked(now),
        };
        self.pending_build = Some(match self.pending_build.take() {
            None => PendingBuild { cause, asked, attempt },
            Some(former) => {
                PendingBuild { cause: former.cause.and(cause), asked: former.asked.min(asked), attempt }
            }
        });
    }

    /// Takes a finished plan, and starts a build if something changed. Must be called before every frame.
    pub fn poll(&mut self, inputs: &PlanInputs, now: Instant) -> Result<(), BackendError> {
        self.now = now;
        while let Some(output) = self.builder.poll() {
            match output {
                Ok(built) => self.take(built)?,
                Err(panicked) => self.fail(Failure::Panicked(panicked.message)),
            }
        }
        if let Some(FileChange { files, first_seen }) = self.watcher.take() {
            self.want(Cause::Files(files), first_seen);
        }
        if let Some(cause) = self.asked.as_ref().and_then(|former| inputs.differs(former)) {
            self.want(cause, now);
        }
        // An empty size has no pictures, so the former plan stays until there is one.
        let drawable = inputs.size.0 > 0 && inputs.size.1 > 0;
        if drawable
            && self.building.is_none()
            && let Some(PendingBuild { cause, asked, attempt }) = self.pending_build.take()
        {
            self.asked = Some(inputs.clone());
            self.building = Some(attempt);
            self.builder.submit(Job {
                graph: self.graph.clone(),
                set: self.set.iter().map(|(name, value)| (name.clone(), value.clone())).collect(),
                strict: self.strict,
                inputs: inputs.clone(),
                device: self.device.info().facts,
                loader: self.device.loader(),
                cause,
                asked,
                progress: self.progress.clone(),
            });
        }
        let failure = self.state.error(now).map(|failure| failure.text(false));
        match (&failure, &self.failed) {
            (Some(new), Some(old)) if new == old => {}
            (Some(new), _) => self.events.push(RendererEvent::Failed(new.clone())),
            (None, Some(_)) => self.events.push(RendererEvent::Mended),
            (None, None) => {}
        }
        self.failed = failure;
        Ok(())
    }

    fn fail(&mut self, failure: Failure) {
        if let Some(attempt) = self.building.take() {
            self.state.failed(attempt, failure);
        }
    }

    fn take(&mut self, built: Built<Ready<D>>) -> Result<(), BackendError> {
        self.watcher.watch(&built.wanted);
        if !built.dropped.is_empty() {
            for name in &built.dropped {
                self.set.shift_remove(name);
            }
            self.events.push(RendererEvent::Dropped(built.dropped));
        }
        let (plan, controls, ready) = match built.outcome {
            Ok(made) => made,
            Err(failure) => {
                self.fail(failure);
                return Ok(());
            }
        };
        self.device.swap(ready)?;
        self.strict = false;
        self.size = built.inputs.size;
        self.controls = controls;
        let swap = Swap {
            graph: plan.name.clone(),
            cause: built.cause,
            passes: plan.frame.len(),
            plan_ms: built.plan_ms,
            prepare_ms: built.prepare_ms,
            latency_ms: 0.0,
        };
        self.pending_swap = Some(PendingSwap { swap, asked: built.asked });
        if let Some(attempt) = self.building.take() {
            self.state.succeeded(attempt, Arc::new(plan));
        }
        self.apply_set();
        Ok(())
    }

    /// Applies settings that changed since the plan was requested.
    fn apply_set(&mut self) {
        for Control { param, .. } in &mut self.controls {
            let text = self.set.get(&param.name);
            if let Some(value) = text.and_then(|text| parse_value(text, &param.domain).ok()) {
                param.value = value;
            }
        }
    }

    /// Draws a frame, if there is a plan; returns true if it did. The live parameters in `inputs` are replaced.
    pub fn submit(&mut self, inputs: FrameInputs) -> Result<bool, BackendError> {
        let Some(plan) = self.state.good().cloned() else { return Ok(false) };
        if self.in_flight.len() == FRAMES_IN_FLIGHT {
            self.wait_for_oldest()?;
        }
        zone!("submit");
        let inspected = inputs.inspect.clone();
        let inputs = FrameInputs {
            live: plan.live_bytes_of(self.controls.iter().map(|control| &control.param)),
            ..inputs
        };
        let frame = self.device.submit(&inputs)?;
        let first = self.pending_swap.take();
        let is_first = first.is_some();
        self.in_flight.push_back(FrameInFlight { frame, plan, inspected, first });
        if is_first {
            // Waits once per swap, so that its latency is exact.
            self.finish()?;
        }
        Ok(true)
    }

    /// Waits for the frames in flight.
    pub fn finish(&mut self) -> Result<(), BackendError> {
        while !self.in_flight.is_empty() {
            self.wait_for_oldest()?;
        }
        Ok(())
    }

    fn wait_for_oldest(&mut self) -> Result<(), BackendError> {
        let Some(frame) = self.in_flight.pop_front() else { return Ok(()) };
        let result = self.device.wait(frame.frame)?;
        let first = frame.first.is_some();
        if let Some(PendingSwap { swap, asked }) = frame.first {
            let latency_ms = asked.elapsed().as_secs_f64() * 1e3;
            self.events.push(RendererEvent::Swapped(Swap { latency_ms, ..swap }));
        }
        self.done.push(FinishedFrame { result, plan: frame.plan, first, inspected: frame.inspected });
        Ok(())
    }

    /// Returns true if the next frame is the first of its plan, which runs the prologue.
    pub fn is_first_next(&self) -> bool {
        self.pending_swap.is_some()
    }

    /// Returns the device.
    pub fn into_device(self) -> D {
        self.device
    }

    /// Takes the frames finished since the last call, in the order of submission.
    pub fn take_done(&mut self) -> Vec<FinishedFrame> {
        std::mem::take(&mut self.done)
    }

    /// Takes the events since the last call.
    pub fn take_events(&mut self) -> Vec<RendererEvent> {
        std::mem::take(&mut self.events)
    }
}
