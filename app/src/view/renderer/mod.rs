//! Draws frames with a graph, and keeps the graph's plan up to date.
//!
//! When a file of the graph, a constant parameter or the [`PlanInputs`] change, a [`Renderer`] builds a new plan on
//! another thread, draws frames of the current plan meanwhile, and swaps between frames. If the build fails, the
//! current plan stays and the failure is reported. Live parameters need no build: they reach the device with the next
//! frame.
//!
//! One plan is built at a time. Changes during a build are combined into the next one, which cancels a slow build.
//!
//! A frame that overflows a list is incomplete; a plan with more capacity is then built like any other
//! ([`crate::draw::capacity`]). The capacity stays until another graph or scene is chosen, or the user sets the
//! parameter. If the device refuses such a plan, frames stay incomplete ([`Renderer::crowded`]) until the next change,
//! or, if memory was short, until the next attempt.
//!
//! No error ends a renderer. A frame that cannot be drawn is retried ([`RETRY`]). A build that lacked memory is retried
//! with exponential backoff. A frame that the device does not finish within [`Renderer::patience`] is awaited again
//! with the next frame. A lost device is dropped with [`Renderer::release`], and replaced with [`Renderer::give`].
//!
//! A renderer acts only when called: `Renderer::next` returns the time at which it must be polled even if nothing
//! called its [`Wake`].

mod device;
mod failure;
pub(super) mod frames;
mod job;
mod room;
mod settings;
mod state;

use super::events::{Cause, Causes, Event, RendererId, Swap};
use crate::draw::backend::Backend;
use crate::draw::capacity::{Capacities, Overflow};
use crate::draw::planner::replaced;
use indexmap::{IndexMap, IndexSet};
use job::{Built, Job, builder};
use splatgraph_api::{BackendError, Device, DeviceInfo, FrameId, FrameResult, Inspect, Running};
use splatgraph_assets::Scene;
use splatgraph_framework::lower::Control;
use splatgraph_framework::plan::Plan;
use splatgraph_framework::reload::{FileChange, LastGood, Rebuilder, Watcher};
use state::{BuildState, Crowded, DeviceState, Fault, Pause, PendingBuild, ends_device, pause_after};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

pub use failure::Failure;
pub use state::{Choice, PlanInputs, RETRY, Wake};

/// Default of [`Renderer::patience`]. A longer wait would let a slow frame block the user interface; with no wait, the
/// end of a short frame would only be noticed at the next poll.
const PATIENCE: Duration = Duration::from_millis(5);

/// A finished frame, with its results.
pub struct FinishedFrame {
    /// Results from the device.
    pub result: FrameResult,
    /// Plan that the frame was drawn with.
    pub plan: Arc<Plan>,
    /// Inspections that the frame read, in the order of the result's contents.
    pub inspected: Vec<Inspect>,
    /// Lists that overflowed in the frame, with their capacities.
    pub short: Vec<Overflow>,
    /// Number of the frame; see [`Renderer::submitted`].
    pub number: u64,
}

struct FrameInFlight {
    frame: FrameId,
    number: u64,
    submitted: Instant,
    plan: Arc<Plan>,
    inspected: Vec<Inspect>,
    first: Option<PendingSwap>,
    /// Result, if it was taken out of order, before older frames were finished.
    result: Option<FrameResult>,
}

/// A swap that is reported once the first frame of its plan has ended.
struct PendingSwap {
    swap: Swap,
    asked: Instant,
    /// Plan of the former frame; `None` before the first.
    former: Option<Arc<Plan>>,
}

/// A graph on a device, with its plans, builds and frames in flight; see the module's documentation.
pub struct Renderer {
    /// Name of the renderer in its events.
    pub(super) id: RendererId,
    /// Maximum wait for a frame in [`Renderer::submit`].
    pub patience: Duration,
    /// True while frames must not be submitted.
    pub(super) paused: bool,
    device: DeviceState,
    info: DeviceInfo,
    /// Number of devices released so far; identifies the current device.
    epoch: u64,
    choice: Choice,
    /// The name of the current plan's graph, and true if it is built in; `None` before the first plan.
    source: Option<(String, bool)>,
    /// Settings that the current graph rejects. Each build tries them again.
    rejected: IndexMap<String, String>,
    /// Minimum values of the parameters that grow with overflows.
    capacities: Capacities,
    /// Capacities of the current plan.
    drawn_with: Capacities,
    /// The device's rejection of more capacity. While it is set, nothing grows; a change or the next attempt clears it.
    crowded: Option<Crowded>,
    /// True if the newest finished frame of the current plan was complete; `None` before its first one.
    whole: Option<bool>,
    subject: u64,
    submitted: u64,
    redraw: bool,
    changes: u64,
    strict: bool,
    builder: Rebuilder<Job, Built>,
    watcher: Watcher,
    build: BuildState,
    /// Number of retried build failures since the last change or plan.
    attempts: u32,
    asked: Option<PlanInputs>,
    state: LastGood<Arc<Plan>, Failure>,
    now: Instant,
    controls: Vec<Control>,
    size: (u32, u32),
    scene: Option<u64>,
    pending_swap: Option<PendingSwap>,
    /// True if the next plan replaces the current one even if it has the same commands. This is so after a swap failed,
    /// after a build panicked, and after a build failed that had other causes than edits, such as another scene.
    must_swap: bool,
    in_flight: VecDeque<FrameInFlight>,
    stalled: Option<Running>,
    forgot: bool,
    done: Vec<FinishedFrame>,
    events: Vec<Event>,
    /// Problem that was reported as an event and is not solved yet, if any.
    failed: Option<String>,
    /// Device numbers (see `epoch`) of the builds in progress, oldest first.
    jobs: VecDeque<u64>,
    progress: Arc<Mutex<String>>,
}

impl Renderer {
    /// Creates a renderer that draws the chosen graph. Unlike after [`Renderer::choose`], a setting that the graph
    /// rejects is an error.
    ///
    /// # Errors
    /// The file watcher or the build thread cannot be started.
    pub fn new(id: RendererId, device: Backend, choice: Choice, wake: Wake) -> std::io::Result<Renderer> {
        let woken = wake.clone();
        let watcher = Watcher::new(move || woken())?;
        let woken = wake;
        let builder = Rebuilder::new(builder, move || woken())?;
        let mut state = LastGood::new();
        let now = Instant::now();
        let build = PendingBuild { causes: Cause::Start.into(), asked: now, attempt: state.asked(now) };
        Ok(Renderer {
            id,
            patience: PATIENCE,
            paused: false,
            info: device.info().clone(),
            device: DeviceState::new(Some(device)),
            epoch: 0,
            choice,
            source: None,
            rejected: IndexMap::new(),
            capacities: Capacities::default(),
            drawn_with: Capacities::default(),
            crowded: None,
            whole: None,
            subject: 0,
            submitted: 0,
            redraw: false,
            changes: 0,
            strict: true,
            builder,
            watcher,
            build: BuildState { requested: Some(build), ..BuildState::default() },
            attempts: 0,
            asked: None,
            state,
            now,
            controls: Vec::new(),
            size: (0, 0),
            scene: None,
            pending_swap: None,
            must_swap: false,
            in_flight: VecDeque::new(),
            stalled: None,
            forgot: false,
            done: Vec::new(),
            events: Vec::new(),
            failed: None,
            jobs: VecDeque::new(),
            progress: Arc::default(),
        })
    }

    /// Returns the pass that was running when the last wait for a frame timed out; on a CPU, the frame.
    ///
    /// `None` if no wait timed out since the last completed one, or if the device does not know.
    pub fn stalled(&self) -> Option<&Running> {
        self.stalled.as_ref()
    }

    /// Returns the error of the last attempt to draw a frame. `None` if it succeeded, after a swap of plans, or if the
    /// device is lost.
    pub fn trouble(&self) -> Option<&BackendError> {
        match &self.device.fault {
            Some(Fault::Failing { error, .. }) => Some(error),
            _ => None,
        }
    }

    /// Describes the failures of the newest build and of the last frame, with ANSI colours if `colour`. `None` if there
    /// are none.
    pub fn problem(&self, colour: bool) -> Option<String> {
        let mut texts: Vec<String> = self.failure().map(|failure| failure.text(colour)).into_iter().collect();
        texts.extend(self.trouble().map(|error| Failure::Backend(error.clone()).text(colour)));
        texts.dedup();
        if texts.is_empty() { None } else { Some(texts.join("\n")) }
    }

    /// Returns the requested graph and the changed parameters.
    pub fn choice(&self) -> &Choice {
        &self.choice
    }

    /// Returns the requested graph: a built-in name or a path.
    pub fn graph(&self) -> &str {
        &self.choice.graph
    }

    /// Returns the current plan; `None` until a build has succeeded on the current device.
    pub fn plan(&self) -> Option<&Arc<Plan>> {
        self.state.good()
    }

    /// Returns the size of the plan's pictures, in pixels; (0, 0) without a plan.
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// Returns true if the current plan draws this scene.
    pub fn draws(&self, scene: &Scene) -> bool {
        self.scene == Some(scene.identity())
    }

    /// Returns the parameters with their requested values; constants may still wait for a new plan. Empty before the
    /// first plan.
    pub fn controls(&self) -> &[Control] {
        &self.controls
    }

    /// Returns the changed parameters with their values as text, in the order of the first change.
    pub fn set(&self) -> &IndexMap<String, String> {
        &self.choice.set
    }

    /// Returns the failure of the newest build; `None` if it succeeded, or before the first one ends.
    ///
    /// After a change of a file, the previous result stays for a short time, because the file may be half written.
    pub fn failure(&self) -> Option<&Failure> {
        self.state.error(self.now)
    }

    /// Returns true while a build is running or requested, or while the report of its failure is delayed.
    pub fn busy(&self) -> bool {
        self.build.is_busy() || self.state.due(self.now).is_some()
    }

    pub(super) fn is_idle(&self) -> bool {
        !self.builder.busy()
    }

    /// Returns the number of frames submitted so far.
    pub fn submitted(&self) -> u64 {
        self.submitted
    }

    /// Returns the number of frames in flight: submitted, with results not taken yet.
    pub(super) fn in_flight(&self) -> usize {
        self.in_flight.len()
    }

    /// Returns a counter of scenes, graphs and devices: pictures with equal numbers show the same scene and graph.
    pub fn subject(&self) -> u64 {
        self.subject
    }

    /// Returns a counter of changes that panels show, other than finished frames: builds, failures, plans.
    pub(super) fn changes(&self) -> u64 {
        self.changes
    }

    /// Returns true if a frame is due although none of its inputs changed.
    pub(super) fn must_redraw(&self) -> bool {
        self.redraw
    }

    /// Returns the time by which [`Renderer::poll`] must be called even if nothing wakes the owner. `None` if it need
    /// not be.
    pub(super) fn next(&self) -> Option<Instant> {
        let rebuild = match self.build.pause {
            Some(Pause::Retry(time)) => Some(time),
            _ => None,
        };
        [rebuild, self.room_again(), self.state.due(self.now)].into_iter().flatten().min()
    }

    /// Returns the time of the next attempt to draw after a [`Renderer::trouble`]; `None` without one.
    pub(super) fn retry(&self) -> Option<Instant> {
        match self.device.fault {
            Some(Fault::Failing { retry, .. }) => Some(retry),
            _ => None,
        }
    }

    /// Describes the current step of the build, as text for the status line; empty if unknown.
    pub fn progress(&self) -> String {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Selects another graph, replaces all changed parameters with `set`, and forgets raised capacities. Settings that
    /// the graph rejects are set aside and reported.
    pub fn choose(&mut self, graph: &str, set: IndexMap<String, String>) {
        self.choice = Choice { graph: graph.to_owned(), set };
        self.rejected.clear();
        self.strict = false;
        self.capacities = Capacities::default();
        self.want(Cause::Graph, Instant::now());
    }

    /// Requests a build because of `causes`. `asked` is the time of the first change.
    pub fn want(&mut self, causes: impl Into<Causes>, asked: Instant) {
        let (causes, now) = (causes.into(), Instant::now());
        self.changes += 1;
        if !causes.is_room_alone() {
            self.crowded = None;
        }
        if !causes.are_own() {
            self.attempts = 0;
        }
        // The file may be half written, so errors are reported only after a delay.
        let attempt = if causes.has_file() { self.state.changed(now) } else { self.state.asked(now) };
        self.build.ask(PendingBuild { causes, asked, attempt });
    }

    /// Takes finished builds, starts a build if something changed, and reports failures as events. Must be called
    /// before every frame.
    pub fn poll(&mut self, inputs: &PlanInputs, now: Instant) {
        self.now = now;
        self.take_builds();
        if let Some(FileChange { files, first_seen }) = self.watcher.take() {
            self.want(files.into_iter().map(Cause::File).collect::<Causes>(), first_seen);
        }
        let causes = self.asked.as_ref().map(|former| inputs.differs(former)).unwrap_or_default();
        let other_scene = causes.contains(&Cause::Scene);
        if other_scene {
            self.capacities = Capacities::default();
        }
        // After repeated losses of the device, a new size alone must not build the graph again.
        if causes.iter().next().is_some() && (self.build.pause != Some(Pause::Held) || other_scene) {
            self.want(causes, now);
        }
        self.try_room_again();
        if matches!(self.build.pause, Some(Pause::Retry(time)) if time <= now) {
            self.want(Cause::Retry, now);
        }
        self.builder.set_outdated(self.build.running.is_some() && self.build.requested.is_some());
        // A picture without pixels cannot be drawn; the previous plan stays.
        let drawable = inputs.size.0 > 0 && inputs.size.1 > 0;
        if drawable
            && let Some(device) = &self.device.device
            && let Some(PendingBuild { causes, asked, .. }) = self.build.begin()
        {
            self.asked = Some(inputs.clone());
            let replaced = self.builder.submit(Job {
                graph: self.choice.graph.clone(),
                set: self.choice.set.clone().into_iter().chain(self.rejected.clone()).collect(),
                capacities: self.capacities.clone(),
                strict: self.strict,
                inputs: inputs.clone(),
                device: device.info().facts,
                loader: device.loader(),
                drawn: self.state.good().filter(|_| causes.are_edits() && !self.must_swap).cloned(),
                causes,
                asked,
                progress: self.progress.clone(),
            });
            if replaced.is_some() {
                self.jobs.pop_back();
            }
            self.jobs.push_back(self.epoch);
        }
        let failure = self.problem(false);
        if failure != self.failed {
            self.changes += 1;
            self.events.push(match &failure {
                Some(text) => Event::Failed { renderer: self.id, text: text.clone() },
                None => Event::Mended { renderer: self.id },
            });
            self.failed = failure;
        }
    }

    /// Takes finished builds, and drops builds that were made for a lost device.
    fn take_builds(&mut self) {
        while let Some(output) = self.builder.poll() {
            if self.jobs.pop_front() != Some(self.epoch) {
                continue;
            }
            self.changes += 1;
            match output {
                Ok(built) => self.take(built),
                Err(panicked) => {
                    self.must_swap = true;
                    self.fail(Failure::Panicked(panicked.message));
                }
            }
        }
    }

    fn fail(&mut self, failure: Failure) {
        if let Failure::Backend(error) = &failure
            && ends_device(error)
        {
            self.device.fail(error.clone(), self.now);
        }
        let may_pass = failure.may_pass();
        if let Some(attempt) = self.build.running.take() {
            self.state.failed(attempt, failure);
        }
        if may_pass && !self.build.is_busy() && self.build.pause.is_none() {
            self.build.pause = Some(Pause::Retry(self.next_attempt()));
        }
    }

    /// Counts a transient failure, and returns the time of the next attempt to build.
    fn next_attempt(&mut self) -> Instant {
        self.attempts += 1;
        self.now + pause_after(self.attempts - 1)
    }

    fn take(&mut self, built: Built) {
        self.watcher.watch(&built.wanted);
        let (plan, controls, ready) = match built.outcome {
            Ok(made) => made,
            Err(None) => {
                // Build again, for the causes of the cancelled build and the newer request.
                let newer = std::mem::take(&mut self.build).requested;
                let attempt = newer.as_ref().map(|newer| newer.attempt);
                let attempt = attempt.unwrap_or_else(|| self.state.asked(Instant::now()));
                self.build.ask(PendingBuild { causes: built.causes, asked: built.asked, attempt });
                if let Some(newer) = newer {
                    self.build.ask(newer);
                }
                return;
            }
            Err(Some(failure)) => {
                self.must_swap |= !built.causes.are_edits();
                return self.refuse(&built.causes, failure);
            }
        };
        let is_first = self.is_first_next();
        let Some(device) = &mut self.device.device else { return };
        // Until the first frame of a plan, another plan with the same commands counts as new.
        let same_plan = ready.is_none() && !is_first;
        if let Some(ready) = ready {
            if let Err(error) = device.swap(ready) {
                self.must_swap = true;
                return self.refuse(&built.causes, Failure::Backend(error));
            }
            self.whole = None;
        }
        // A new plan may draw although the previous one failed. With an equal plan, drawing is also tried again at
        // once.
        self.device.recover();
        self.drawn_with = built.capacities;
        self.attempts = 0;
        self.redraw |= same_plan;
        self.must_swap = false;
        let new = [Cause::Start, Cause::Scene, Cause::Graph, Cause::Device];
        self.subject += u64::from(new.iter().any(|cause| built.causes.contains(cause)));
        self.strict = false;
        self.size = built.inputs.size;
        self.scene = built.inputs.scene.map(|scene| scene.identity());
        self.controls = controls;
        let former = self.pending_swap.take().map_or_else(|| self.state.good().cloned(), |swap| swap.former);
        let swap = Swap {
            graph: plan.name.clone(),
            causes: built.causes,
            passes: plan.frame.len(),
            effect: former.as_ref().and_then(|former| difference(former, &plan)),
            same_plan,
            plan_ms: built.plan_ms,
            prepare_ms: built.prepare_ms,
            latency_ms: 0.0,
        };
        self.report_source(built.source);
        self.pending_swap = Some(PendingSwap { swap, asked: built.asked, former });
        if let Some(attempt) = self.build.running.take() {
            self.state.succeeded(attempt, Arc::new(plan));
        }
        // A newer request may be for another graph.
        if self.build.requested.is_none() {
            self.sort_settings();
        }
        self.apply_set();
    }

    /// Reports that a built-in graph replaces a file: one that the user named, or one that is gone since the last plan.
    fn report_source(&mut self, source: (String, bool)) {
        let (graph, is_built_in) = &source;
        let is_gone = self.source.as_ref().is_some_and(|(former, built_in)| former == graph && !built_in);
        let is_new = self.source.as_ref() != Some(&source);
        if *is_built_in && is_new && (is_gone || graph.ends_with(".ron")) {
            self.events.push(Event::Problem { text: replaced(graph) });
        }
        self.source = Some(source);
    }

    /// Returns true if the next frame is the first of its plan, which runs the prologue.
    pub fn is_first_next(&self) -> bool {
        self.pending_swap.as_ref().is_some_and(|pending| !pending.swap.same_plan)
    }

    /// Takes the frames finished since the last call, in the order of submission.
    pub fn take_done(&mut self) -> Vec<FinishedFrame> {
        std::mem::take(&mut self.done)
    }

    /// Takes the events since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }
}

/// Describes how a plan differs from the former one, as in [`Swap::effect`]. `None` if no phase has another number of
/// passes.
fn difference(former: &Plan, plan: &Plan) -> Option<String> {
    fn phases(plan: &Plan) -> Vec<&str> {
        plan.frame.iter().map(|pass| plan.pass(*pass).phase.as_str()).collect()
    }
    let [former, now] = [former, plan].map(phases);
    let all: IndexSet<&str> = former.iter().chain(&now).copied().collect();
    let changed = all.into_iter().filter_map(|phase| {
        let [from, to] = [&former, &now].map(|phases| phases.iter().filter(|of| **of == phase).count());
        (from != to).then(|| format!("{phase} {from} → {to}"))
    });
    let changed = changed.collect::<Vec<_>>().join(", ");
    (!changed.is_empty()).then(|| format!("{} → {} passes: {changed}", former.len(), now.len()))
}
