//! Submits frames, waits for their results, and repeats incomplete frames with more capacity.

use super::{Flight, Former, FrameOptions, Session, SessionError, can_grow, saves_state};
use crate::draw::camera;
use crate::draw::capacity::{self, Overflow};
use crate::draw::inspect;
use crate::draw::projection;
use crate::io::timeline;
use splatgraph_api::{BackendError, Device, FrameId, FrameInputs, FrameResult, Recovery};
use splatgraph_assets::Camera;
use splatgraph_framework::ir::{ParamBinding, Run};
use splatgraph_framework::lower::parse_value;
use splatgraph_framework::plan::Plan;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tracing::info_span;

/// Maximum number of frames whose inputs are kept. A device keeps the results of as many frames.
const MAX_FLYING: usize = 64;

impl SessionError {
    /// Returns true for an error of the graph, the scene, or the device's limits or memory. After such an error, other
    /// plans and frames can still be drawn.
    ///
    /// False for a failed or busy device, and for unsuitable inputs, such as a camera of another size.
    pub fn spares_device(&self) -> bool {
        match self {
            SessionError::Graph(_) | SessionError::NoSplats { .. } | SessionError::Full { .. } => true,
            SessionError::NoRoom { error, .. } => error.spares_device(),
            SessionError::Backend(error) => error.recovery() == Recovery::User,
            _ => false,
        }
    }
}

impl Session {
    /// Submits a frame. The camera must have the prepared size; a pinhole is converted to the graph's projection.
    ///
    /// The camera is in the scene's coordinates. [`Camera::relative_to`] with the scene's
    /// [`offset`](splatgraph_assets::Scene::offset) converts the cameras of files, which are in the world's.
    ///
    /// If the graph has growing lists and state, first waits for the frames in flight and repeats incomplete ones.
    /// [`Session::wait`] returns their results and errors.
    ///
    /// # Errors
    /// The camera is unusable, has another size than the prepared one or, unless it is a pinhole, another projection
    /// than the graph; a value of [`FrameOptions::live`] does not fit; no plan is prepared; or the device fails.
    pub fn submit(&mut self, camera: &Camera, request: &FrameOptions) -> Result<FrameId, SessionError> {
        // The state is saved before one frame only: the last.
        if self.loaded.is_some() && self.saves_state {
            for id in self.flying.iter().map(|flight| flight.id).collect::<Vec<_>>() {
                let result = self.finish(id);
                self.finished.insert(id, result);
                if self.finished.len() > MAX_FLYING {
                    self.finished.pop_first();
                }
            }
        }
        let flight = self.fly(camera.clone(), request.clone(), self.frame)?;
        self.frame += 1;
        let id = flight.id;
        if can_grow(&flight.plan) {
            let old = (self.flying.len() + 1).saturating_sub(MAX_FLYING);
            self.flying.drain(..old);
            self.flying.push(flight);
        }
        Ok(id)
    }

    fn fly(&mut self, camera: Camera, request: FrameOptions, number: u32) -> Result<Flight, SessionError> {
        let Some((plan, size)) = &self.loaded else { return Err(SessionError::NotPrepared) };
        let found = (camera.width, camera.height);
        if *size != found {
            return Err(SessionError::OtherSize { prepared: *size, found });
        }
        if let Some(fault) = camera.fault() {
            return Err(SessionError::Camera(fault));
        }
        let camera = projection::convert(&camera, projection::of_params(&plan.params), &self.scene)?;
        let inputs = FrameInputs {
            uniforms: camera::frame_uniforms(&camera, &self.scene.bounds(), request.background, number),
            live: live_bytes(plan, &request.live)?,
            read_output: request.read_output,
            inspect: request.inspect.clone(),
            untimed_passes: request.untimed_passes,
            save_histories: self.saves_state,
            ..FrameInputs::default()
        };
        let begun = Instant::now();
        let id = info_span!("submit a frame").in_scope(|| self.device.submit(&inputs))?;
        timeline::submitted(id.0, begun, (&camera.img_name, request.warm_up));
        Ok(Flight { id, camera, request, number, plan: plan.clone(), growths: self.growths })
    }

    /// Waits for a frame and returns its results.
    ///
    /// The results are of the current plan if at most [`FRAMES_IN_FLIGHT`](splatgraph_api::FRAMES_IN_FLIGHT) frames are
    /// in flight.
    ///
    /// Repeats an incomplete frame with more capacity; see the module documentation. Wait for all frames before
    /// you prepare another size.
    ///
    /// # Errors
    /// - The device fails.
    /// - The frame needs more capacity than a parameter's range or the device allows. The plan stays unchanged.
    /// - The frame must be repeated, but the larger plan lacks an inspected resource or pass.
    /// - The frame has no result: it was taken, or 64 later frames were completed.
    pub fn wait(&mut self, frame: FrameId) -> Result<FrameResult, SessionError> {
        match self.finished.remove(&frame) {
            Some(result) => result,
            None => self.finish(frame),
        }
    }

    /// Takes the results of a frame if it has completed, else returns `None`.
    ///
    /// Blocks only if the frame must be repeated with more capacity.
    ///
    /// # Errors
    /// See [`Session::wait`].
    pub fn try_wait(&mut self, frame: FrameId) -> Result<Option<FrameResult>, SessionError> {
        if let Some(result) = self.finished.remove(&frame) {
            return result.map(Some);
        }
        let Some(result) = self.device.try_wait(frame)? else { return Ok(None) };
        let plan = self.plan_of_frame(frame);
        self.landed(frame, &result, plan.as_deref());
        self.complete(frame, result).map(Some)
    }

    fn finish(&mut self, frame: FrameId) -> Result<FrameResult, SessionError> {
        let plan = self.plan_of_frame(frame);
        let result = self.land(frame, plan.as_deref())?;
        self.complete(frame, result)
    }

    fn plan_of_frame(&self, frame: FrameId) -> Option<Arc<Plan>> {
        let flight = self.flying.iter().find(|flight| flight.id == frame);
        flight.map(|flight| &flight.plan).or(self.loaded.as_ref().map(|(plan, _)| plan)).cloned()
    }

    /// Repeats a frame with more capacity until its result is complete.
    fn complete(&mut self, frame: FrameId, mut result: FrameResult) -> Result<FrameResult, SessionError> {
        let Some(index) = self.flying.iter().position(|flight| flight.id == frame) else { return Ok(result) };
        let mut drawn = self.flying.remove(index);
        loop {
            let short = capacity::overflows(&drawn.plan, &result.stats);
            if short.is_empty() && drawn.growths == self.growths {
                return Ok(result);
            }
            let inspects_once = |flight: &Flight| {
                flight.request.inspect.iter().any(|target| inspect::in_prologue(&flight.plan, target))
            };
            // Passes with reused results do not run, so nothing can be read after them.
            let share = !self.flying.iter().chain([&drawn]).any(inspects_once);
            if let Err(error) = self.grow(&short, (drawn.camera.width, drawn.camera.height), share) {
                self.undo(&drawn.plan, share);
                return Err(error);
            }
            let former = (drawn.plan.clone(), result);
            drawn = self.repeat(drawn)?;
            result = self.land(drawn.id, Some(&drawn.plan))?;
            keep_once_times(&former, (&drawn.plan, &mut result));
        }
    }

    /// Returns the time since the last frame was complete; `None` before the first.
    pub fn idle(&self) -> Option<Duration> {
        self.completed.map(|completed| completed.elapsed())
    }

    /// Waits for a frame. If its plan is given, adds the frame to the timeline.
    fn land(&mut self, id: FrameId, plan: Option<&Plan>) -> Result<FrameResult, BackendError> {
        let result = info_span!("wait for a frame").in_scope(|| self.device.wait(id))?;
        self.landed(id, &result, plan);
        Ok(result)
    }

    fn landed(&mut self, id: FrameId, result: &FrameResult, plan: Option<&Plan>) {
        self.completed = Some(Instant::now());
        if let Some(plan) = plan {
            timeline::completed(id.0, |submission, seen| timeline::Frame {
                number: id.0,
                submission,
                seen,
                start_ms: result.start_ms,
                total_ms: result.total_ms,
                passes: timed(plan, result),
            });
        }
    }

    /// Loads a plan with capacity for an overflowed frame, unless the current plan already has it.
    fn grow(&mut self, short: &[Overflow], size: (u32, u32), share: bool) -> Result<(), SessionError> {
        if let Some(Overflow { parameter, needed, most, .. }) = short.iter().find(|s| s.needed > s.most) {
            return Err(SessionError::Full { parameter: parameter.clone(), most: *most, needed: *needed });
        }
        let mut capacities = self.planner.capacities.clone();
        let raised: Vec<&Overflow> = short.iter().filter(|short| capacities.raise(short)).collect();
        let Some(first) = raised.first() else { return Ok(()) };
        let mut tight = capacities.clone();
        tight.tighten(&raised);
        let has_spare = tight != capacities;
        let former = (std::mem::replace(&mut self.planner.capacities, capacities), self.loaded.take());
        let from = Former::Frame { shares_results: share };
        let mut outcome = self.load(size, from, &mut |_| {});
        if has_spare && outcome.as_ref().is_err_and(SessionError::spares_device) {
            self.planner.capacities = tight;
            outcome = self.load(size, from, &mut |_| {});
        }
        match outcome {
            Ok(()) => {
                self.growths += 1;
                Ok(())
            }
            Err(error) => {
                (self.planner.capacities, self.loaded) = former;
                let (parameter, needed) = (first.parameter.clone(), first.needed);
                Err(SessionError::NoRoom { parameter, needed, error: Box::new(error) })
            }
        }
    }

    /// Restores the state from before an incomplete frame that cannot be repeated.
    ///
    /// Later frames then do not read its partial results. If this fails, for example without memory, these stay.
    fn undo(&mut self, plan: &Plan, share: bool) {
        if let (true, Some((_, size))) = (saves_state(plan), &self.loaded) {
            _ = self.load(*size, Former::Frame { shares_results: share }, &mut |_| {});
        }
    }

    fn repeat(&mut self, frame: Flight) -> Result<Flight, SessionError> {
        let Flight { camera, mut request, number, plan: former, .. } = frame;
        let plan = self.plan().ok_or(SessionError::NotPrepared)?;
        for target in &mut request.inspect {
            let (resource, pass) = (former.resource(target.resource), former.pass(target.after));
            *target = inspect::resolve(plan, &resource.name, &pass.name)?;
        }
        self.fly(camera, request, number)
    }
}

/// Encodes the live parameters of a frame: the plan's values, and `values` in place of some.
fn live_bytes(plan: &Plan, values: &[(String, String)]) -> Result<Vec<u8>, SessionError> {
    if values.is_empty() {
        return Ok(plan.live_bytes());
    }
    let mut params = plan.params.clone();
    for (name, text) in values {
        let found = params.iter_mut().find(|param| param.name == *name);
        let live = found.filter(|param| matches!(param.binding, ParamBinding::Live { .. }));
        let param = live.ok_or_else(|| {
            SessionError::Live(format!("expected a live parameter of `{}`, found `{name}`", plan.name))
        })?;
        let parsed = parse_value(text, &param.domain);
        param.value = parsed.map_err(|why| SessionError::Live(format!("`{name}` = `{text}`: {why}")))?;
    }
    Ok(plan.live_bytes_of(&params))
}

/// Copies the times of `Once` passes from an incomplete frame to the frame that reused their results.
fn keep_once_times(
    (former_plan, former): &(Arc<Plan>, FrameResult),
    (plan, result): (&Plan, &mut FrameResult),
) {
    let id_of = |name: &str| plan.prologue.iter().copied().find(|id| plan.pass(*id).name == name);
    let once = former.pass_ms.iter().filter(|(pass, _)| former_plan.pass(*pass).run == Run::Once);
    let reused: Vec<_> = once
        .filter_map(|(pass, ms)| Some((id_of(&former_plan.pass(*pass).name)?, *ms)))
        .filter(|(pass, _)| result.pass_ms.iter().all(|(other, _)| other != pass))
        .collect();
    result.pass_start_ms.splice(0..0, reused.iter().map(|_| None));
    result.pass_ms.splice(0..0, reused);
}

fn timed(plan: &Plan, result: &FrameResult) -> Vec<timeline::Pass> {
    let passes = result.pass_ms.iter().zip(&result.pass_start_ms);
    let timed = passes.filter_map(|((pass, ms), start)| {
        Some(timeline::Pass { name: plan.pass(*pass).name.clone(), start_ms: (*start)?, ms: (*ms)? })
    });
    timed.collect()
}
