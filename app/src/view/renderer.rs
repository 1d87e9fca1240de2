//! A device with a graph that is kept up to date.
//!
//! A [`Renderer`] has a device, the name of a graph, and settings. When a file of the graph changes, or a constant parameter,
//! or the [`PlanInputs`] that the plan is made for, it has a new plan built and made ready on a thread of its own, while frames of
//! the plan of now go on, and swaps to it at the edge of a frame. When that fails, the plan of now stays and the failure is
//! told. Live parameters need none of this: they go to the device with the next frame.
//!
//! One plan is built at a time: whatever changes meanwhile is built after that, all at once.

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
use splatgraph_framework::plan::{Param, Plan};
use splatgraph_framework::reload::{
    Attempt, Change, LastGood, Rebuilder, Wanted, WatchError, WatchKind, Watcher,
};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

pub use events::{Cause, Failure, RendererEvent, Swap};

/// Called, from any thread, when there is something new to draw.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// What a plan is made for, besides its files and parameters.
#[derive(Clone)]
pub struct PlanInputs {
    /// The scene to draw; `None` for a graph that draws no scene, such as the window's.
    pub scene: Option<Arc<Scene>>,
    /// What graphs can import.
    pub catalog: Arc<Catalog>,
    /// Of the picture, in pixels.
    pub size: (u32, u32),
    /// See [`splatgraph_framework::ir::Request::share_memory`].
    pub share_memory: bool,
}

impl PlanInputs {
    /// Why a plan for `former` will not do for this one.
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

/// A frame that is done.
pub struct FinishedFrame {
    /// What came of it.
    pub result: FrameResult,
    /// The plan that it is of.
    pub plan: Arc<Plan>,
    /// Whether it is the first of that plan.
    pub first: bool,
    /// What was asked to be read back.
    pub inspected: Vec<Inspect>,
}

struct FrameInFlight {
    frame: FrameId,
    plan: Arc<Plan>,
    inspected: Vec<Inspect>,
    first: Option<PendingSwap>,
}

/// A swap whose first frame is not done.
struct PendingSwap {
    swap: Swap,
    asked: Instant,
}

/// The next plan to build.
struct PendingBuild {
    cause: Cause,
    /// Since when it is waited for.
    asked: Instant,
    attempt: Attempt,
}

type Ready<D> = <<D as Device>::Loader as Loader>::Ready;

/// See the module's documentation.
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
    /// When it was polled last.
    now: Instant,
    params: Vec<Param>,
    size: (u32, u32),
    pending_swap: Option<PendingSwap>,
    in_flight: VecDeque<FrameInFlight>,
    done: Vec<FinishedFrame>,
    events: Vec<RendererEvent>,
    /// The failure that was told last.
    failed: Option<String>,
    /// The attempt that is being built.
    building: Option<Attempt>,
    progress: Arc<Mutex<String>>,
}

impl<D: Device> Renderer<D> {
    /// A renderer that draws with `graph`, a built-in one's name or a path, and the parameters of `set` changed.
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
            params: Vec::new(),
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

    /// The device, for what concerns no plan.
    pub fn device(&self) -> &D {
        &self.device
    }

    /// The device, for what concerns no plan.
    pub fn device_mut(&mut self) -> &mut D {
        &mut self.device
    }

    /// The name that the graph was asked for by.
    pub fn graph(&self) -> &str {
        &self.graph
    }

    /// The plan that frames are drawn with, once there is one.
    pub fn plan(&self) -> Option<&Arc<Plan>> {
        self.state.good()
    }

    /// The size of the pictures that the plan draws.
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// The parameters, with the values that were asked for: those of constants may still be on their way into a plan.
    pub fn params(&self) -> &[Param] {
        &self.params
    }

    /// The parameters that were changed, with their values as texts, in the order in which they were changed first.
    pub fn set(&self) -> &IndexMap<String, String> {
        &self.set
    }

    /// Why the newest files and parameters have no plan, if that is so.
    pub fn failure(&self) -> Option<&Failure> {
        self.state.error(self.now)
    }

    /// Whether a plan is being built, or waits to be.
    pub fn busy(&self) -> bool {
        self.pending_build.is_some() || self.building.is_some() || self.state.due(self.now).is_some()
    }

    /// What of the building takes time just now, in words; empty where nothing is known.
    pub fn progress(&self) -> String {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// How files are watched.
    pub fn watching(&self) -> WatchKind {
        self.watcher.kind()
    }

    /// Changes to another graph. Its settings go with it; those that are given come instead.
    pub fn choose(&mut self, graph: &str, set: IndexMap<String, String>) {
        self.graph = graph.to_owned();
        self.set = set;
        self.want(Cause::Graph, Instant::now());
    }

    /// Changes a parameter; `None` is its default. An unknown name, or a value of another kind, changes nothing.
    pub fn set_param(&mut self, name: &str, value: Option<Value>) {
        let Some(param) = self.params.iter_mut().find(|param| param.name == name) else { return };
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

    /// All parameters at once to their defaults.
    pub fn reset_params(&mut self) {
        let names: Vec<String> = self.set.keys().cloned().collect();
        for name in names {
            self.set_param(&name, None);
        }
    }

    /// Asks for a plan to be built, because of a change that came at `asked`.
    pub fn want(&mut self, cause: Cause, asked: Instant) {
        let now = Instant::now();
        // What a file is while it is being written is no mistake yet.
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

    /// Takes a plan that became ready, and has one built where something changed. To be called at the edge of every frame.
    pub fn poll(&mut self, inputs: &PlanInputs, now: Instant) -> Result<(), BackendError> {
        self.now = now;
        while let Some(output) = self.builder.poll() {
            match output {
                Ok(built) => self.take(built)?,
                Err(panicked) => self.fail(Failure::Panicked(panicked.message)),
            }
        }
        if let Some(Change { files, first_seen }) = self.watcher.take() {
            self.want(Cause::Files(files), first_seen);
        }
        if let Some(cause) = self.asked.as_ref().and_then(|former| inputs.differs(former)) {
            self.want(cause, now);
        }
        // A size of nothing has no pictures: the plan of before will do until there is one.
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
        let (plan, ready) = match built.outcome {
            Ok(made) => made,
            Err(failure) => {
                self.fail(failure);
                return Ok(());
            }
        };
        self.device.swap(ready)?;
        self.strict = false;
        self.size = built.inputs.size;
        self.params = plan.params.clone();
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

    /// What was changed since the plan was asked for stays changed.
    fn apply_set(&mut self) {
        for param in &mut self.params {
            if let Some(value) = self.set.get(&param.name).and_then(|text| value_of(param, text)) {
                param.value = value;
            }
        }
    }

    /// Draws a frame, if there is a plan. `inputs` lacks the live parameters, which are the renderer's own.
    pub fn submit(&mut self, inputs: FrameInputs) -> Result<bool, BackendError> {
        let Some(plan) = self.state.good().cloned() else { return Ok(false) };
        if self.in_flight.len() == FRAMES_IN_FLIGHT {
            self.wait_for_oldest()?;
        }
        zone!("submit");
        let inspected = inputs.inspect.clone();
        let inputs = FrameInputs { live: plan.live_bytes_of(&self.params), ..inputs };
        let frame = self.device.submit(&inputs)?;
        let first = self.pending_swap.take();
        let is_first = first.is_some();
        self.in_flight.push_back(FrameInFlight { frame, plan, inspected, first });
        if is_first {
            // Once per swap, so that what is told of it is what it took.
            self.finish()?;
        }
        Ok(true)
    }

    /// Waits for the frames that are being drawn.
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

    /// Whether the next frame is the first of its plan, the one that runs the prologue.
    pub fn is_first_next(&self) -> bool {
        self.pending_swap.is_some()
    }

    /// Gives the device back.
    pub fn into_device(self) -> D {
        self.device
    }

    /// The frames that were finished since this was asked last, in the order of their submission.
    pub fn take_done(&mut self) -> Vec<FinishedFrame> {
        std::mem::take(&mut self.done)
    }

    /// Takes the events since the last call.
    pub fn take_events(&mut self) -> Vec<RendererEvent> {
        std::mem::take(&mut self.events)
    }
}

/// A setting's text as a value of the parameter's kind.
fn value_of(param: &Param, text: &str) -> Option<Value> {
    match param.value {
        Value::Bool(_) => text.parse().ok().map(Value::Bool),
        Value::Int(_) => text.parse().ok().map(Value::Int),
        Value::Float(_) => text.parse().ok().map(Value::Float),
        Value::Text(_) => Some(Value::Text(text.to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_settings_text_is_read_as_the_parameters_kind() {
        let param = |value: Value| Param {
            name: "p".into(),
            label: String::new(),
            help: String::new(),
            default: value.clone(),
            value,
            exact: None,
            domain: splatgraph_framework::ir::Domain::Bool,
            binding: ParamBinding::Const,
            origin: splatgraph_framework::ir::Origin { file: "g.ron".into(), line: 1, column: 1 },
        };
        assert_eq!(value_of(&param(Value::Int(1)), "4"), Some(Value::Int(4)));
        assert_eq!(value_of(&param(Value::Float(1.0)), "4"), Some(Value::Float(4.0)));
        assert_eq!(value_of(&param(Value::Bool(true)), "4"), None);
        assert_eq!(value_of(&param(Value::Text("a".into())), "4"), Some(Value::Text("4".into())));
    }
}
