//! Watches which pass the device executes, and for how long, so that every wait for the device is bounded.
//!
//! If the device runs one pass for longer than the patience, the wait fails with an error that names the pass. The
//! submission stays in flight until it completes or the device is lost.
//!
//! The executors of a device share its queue, so a frame may wait for another executor's pass. The device is running
//! the first submission, in queue order, with a pass whose end timestamp is not written, and in the first such pass.
//! A submission without readable timestamps, such as an upload, is reported only to a caller that asks about it.

use crate::gpu::{Encoder, Gpu};
use crate::lock::lock;
use crate::stopwatch::Stopwatch;
use crate::timing::Times;
use splatgraph_api::{BackendError, Running};
use splatgraph_framework::ir::PassId;
use splatgraph_framework::plan::Plan;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Maximum time between two looks during a wait.
const SLICE: Duration = Duration::from_millis(50);

/// The submissions of a device that are not known to be complete.
pub(crate) struct Watch<G: Gpu> {
    state: Mutex<State<G>>,
}

struct State<G: Gpu> {
    next: u64,
    submitted: BTreeMap<u64, Submission<G>>,
}

struct Submission<G: Gpu> {
    /// The submitted frame; `None` for an upload.
    frame: Option<Frame<G>>,
    /// Number of passes complete at the last look, and the time since the first look that found this number. Kept per
    /// submission: callers that look at different submissions must not reset each other's times.
    reached: Option<(usize, Stopwatch)>,
}

pub(crate) struct Frame<G: Gpu> {
    pub plan: Arc<Plan>,
    pub passes: Arc<[PassId]>,
    pub timestamps: Option<Arc<G::Timestamps>>,
}

/// A submission's registration in the watch, removed on drop.
pub(crate) struct Ticket<G: Gpu> {
    number: u64,
    watch: Arc<Watch<G>>,
}

impl<G: Gpu> Drop for Ticket<G> {
    fn drop(&mut self) {
        lock(&self.watch.state).submitted.remove(&self.number);
    }
}

impl<G: Gpu> Default for Watch<G> {
    fn default() -> Self {
        Watch { state: Mutex::new(State { next: 0, submitted: BTreeMap::new() }) }
    }
}

impl<G: Gpu> Watch<G> {
    /// Calls `submit`, and registers the submission; `frame` is `None` for an upload. Both happen under one lock, so
    /// that the numbers follow the queue's order.
    pub fn submit(
        self: &Arc<Self>,
        frame: Option<Frame<G>>,
        submit: impl FnOnce() -> Result<(), BackendError>,
    ) -> Result<Ticket<G>, BackendError> {
        let mut state = lock(&self.state);
        submit()?;
        let number = state.next;
        state.next += 1;
        state.submitted.insert(number, Submission { frame, reached: None });
        Ok(Ticket { number, watch: self.clone() })
    }

    /// Returns the work that the device is executing. The caller knows that `own` is unfinished.
    pub fn look(&self, gpu: &G, own: &Ticket<G>) -> Running {
        let mut state = lock(&self.state);
        let (number, done, place) = state.first_unfinished(gpu, own.number);
        let time =
            state.submitted.get_mut(&number).map_or(Duration::ZERO, |submission| {
                match &mut submission.reached {
                    Some((reached, watch)) if *reached == done => watch.look(),
                    reached => reached.insert((done, Stopwatch::start())).1.look(),
                }
            });
        Running { place, time }
    }

    /// Blocks until the encoder's submission, registered as `ticket`, has completed.
    ///
    /// # Errors
    /// [`BackendError::Stuck`] once the device has run one pass for longer than the patience; an error of the wait.
    pub fn wait(&self, gpu: &G, encoder: &mut G::Encoder, ticket: &Ticket<G>) -> Result<(), BackendError> {
        while !encoder.wait(SLICE.min(gpu.common().patience))? {
            let running = self.look(gpu, ticket);
            if running.time >= gpu.common().patience {
                return Err(stuck(running));
            }
        }
        Ok(())
    }
}

pub(crate) fn stuck(running: Running) -> BackendError {
    BackendError::Stuck { place: running.place, seconds: running.time.as_secs() }
}

impl<G: Gpu> State<G> {
    /// Finds the first submission up to `own` with an unfinished pass. Returns its number, the number of its completed
    /// passes, and a description of the work that the device is executing. If there is none, returns `own` and
    /// `usize::MAX`.
    fn first_unfinished(&self, gpu: &G, own: u64) -> (u64, usize, String) {
        let live = gpu.common().limits.live_timestamps;
        for (&number, submission) in self.submitted.range(..=own).filter(|_| live) {
            let Some(frame) = &submission.frame else { continue };
            let passes = frame.passes.len();
            let Ok(times) = Times::read(gpu, frame.timestamps.as_deref(), passes) else { continue };
            let Some(finished) = times.finished(passes) else { continue };
            let done = finished.iter().take_while(|&&done| done).count();
            if done < passes {
                let pass = &frame.plan.pass(frame.passes[done]).name;
                return (number, done, format!("pass `{pass}` of `{}`", frame.plan.name));
            }
        }
        let place = match self.submitted.get(&own).and_then(|submission| submission.frame.as_ref()) {
            Some(frame) if live && frame.timestamps.is_some() => {
                format!("the end of a frame of `{}`", frame.plan.name)
            }
            Some(frame) => format!("a frame of `{}`", frame.plan.name),
            None => "the upload of the scene".to_string(),
        };
        (own, usize::MAX, place)
    }
}
