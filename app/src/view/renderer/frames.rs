//! Manages a renderer's frames in flight: submission, bounded waits, and results.

use super::state::{Fault, RETRY};
use super::{FinishedFrame, FrameInFlight, PendingSwap, Renderer};
use crate::view::events::{Event, Swap};
use crate::view::profile::zone;
use splatgraph_api::{BackendError, Device, FRAMES_IN_FLIGHT, FrameInputs, Recovery, Running};
use splatgraph_framework::plan::Plan;
use std::time::{Duration, Instant};

/// First pause between polls of an unfinished frame; it doubles up to [`MAX_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_micros(50);
const MAX_PAUSE: Duration = Duration::from_micros(400);

impl Renderer {
    /// Submits a frame; returns true if it was submitted. The controls' values overwrite the live parameters in
    /// `inputs`.
    ///
    /// Returns false without a plan, while the renderer is paused or its device is lost, before the retry that follows
    /// a [`Renderer::trouble`], or if [`FRAMES_IN_FLIGHT`] frames are in flight and the oldest does not finish within
    /// [`Renderer::patience`]. After a plan's first frame, waits for it, also up to [`Renderer::patience`].
    ///
    /// # Errors
    /// The device fails. The caller passes the error to [`Renderer::report`], unless it retries with other inputs.
    pub fn submit(&mut self, inputs: FrameInputs) -> Result<bool, BackendError> {
        let Some(plan) = self.state.good().cloned() else { return Ok(false) };
        let waits = match self.device.fault {
            None => false,
            Some(Fault::Failing { retry, .. }) => self.now < retry,
            Some(Fault::Lost(_)) => true,
        };
        if waits || self.paused || self.device.device.is_none() {
            return Ok(false);
        }
        if self.in_flight.len() == FRAMES_IN_FLIGHT && !self.wait_for_oldest(self.patience)? {
            return Ok(false);
        }
        zone!("submit");
        let inspected = inputs.inspect.clone();
        let inputs = FrameInputs { live: self.live(&plan), ..inputs };
        let Some(device) = &mut self.device.device else { return Ok(false) };
        let frame = device.submit(&inputs)?;
        self.changes += u64::from(self.device.recover());
        self.redraw = false;
        self.submitted += 1;
        let first = self.pending_swap.take();
        let is_first = first.is_some();
        let (number, submitted) = (self.submitted, Instant::now());
        self.in_flight.push_back(FrameInFlight {
            frame,
            number,
            submitted,
            plan,
            inspected,
            first,
            result: None,
        });
        if is_first {
            // Wait for the first frame of a plan, so that the measured latency of the swap is exact.
            let end = Instant::now() + self.patience;
            while !self.in_flight.is_empty()
                && self.wait_for_oldest(end.saturating_duration_since(Instant::now()))?
            {}
        }
        Ok(true)
    }

    pub(in crate::view) fn live(&self, plan: &Plan) -> Vec<u8> {
        plan.live_bytes_of(self.controls.iter().map(|control| &control.param))
    }

    /// Records an error of drawing: the device becomes lost, or the next attempt to draw is scheduled.
    pub fn report(&mut self, error: BackendError) {
        self.changes += 1;
        self.redraw = true;
        self.device.fail(error, self.now + RETRY);
    }

    /// Waits up to `within` for the frames in flight.
    ///
    /// # Errors
    /// [`BackendError::Stuck`] if a frame is still in flight after `within`, and errors of the device.
    pub fn finish(&mut self, within: Duration) -> Result<(), BackendError> {
        let end = Instant::now() + within;
        while !self.in_flight.is_empty() {
            if !self.wait_for_oldest(end.saturating_duration_since(Instant::now()))? {
                let place = self.stalled.as_ref().map_or_else(String::new, |running| running.place.clone());
                return Err(BackendError::Stuck { place, seconds: within.as_secs() });
            }
        }
        Ok(())
    }

    /// Returns the submission time of the newest frame in flight; `None` if there is none.
    pub(in crate::view) fn newest(&self) -> Option<Instant> {
        self.in_flight.back().map(|frame| frame.submitted)
    }

    fn wait_for_newest(&mut self, patience: Duration) -> Result<bool, BackendError> {
        self.wait_for(self.in_flight.len().saturating_sub(1), patience)
    }

    fn take_results(&mut self) -> Result<(), BackendError> {
        while !self.in_flight.is_empty() && self.wait_for_oldest(Duration::ZERO)? {}
        Ok(())
    }

    /// Waits up to `patience` for the oldest frame in flight, and takes its result. Returns true if it is finished, or
    /// if no frame is in flight.
    ///
    /// Also reports the swap, if the frame is the first of its plan, and requests capacity for lists that overflowed.
    fn wait_for_oldest(&mut self, patience: Duration) -> Result<bool, BackendError> {
        if !self.wait_for(0, patience)? {
            return Ok(false);
        }
        let Some(FrameInFlight { plan, inspected, first, number, result: Some(result), .. }) =
            self.in_flight.pop_front()
        else {
            return Ok(true);
        };
        if let Some(PendingSwap { swap, asked, .. }) = first {
            let latency_ms = asked.elapsed().as_secs_f64() * 1e3;
            self.events.push(Event::Swapped { renderer: self.id, swap: Swap { latency_ms, ..swap } });
        }
        let short = self.make_room(&plan, &result);
        self.done.push(FinishedFrame { result, plan, inspected, short, number });
        Ok(true)
    }

    /// Waits up to `patience` for the frame in flight at this index, and stores its result. Returns true if it is
    /// finished, or if there is no such frame. Fails with the device's error; then drops the frame, unless the error is
    /// transient.
    fn wait_for(&mut self, index: usize, patience: Duration) -> Result<bool, BackendError> {
        let reads_block = self.reads_block();
        let (Some(device), Some(frame)) = (&mut self.device.device, self.in_flight.get_mut(index)) else {
            return Ok(true);
        };
        let end = Instant::now() + patience;
        let mut pause = FIRST_PAUSE;
        while frame.result.is_none() {
            match device.try_wait(frame.frame) {
                Ok(Some(result)) => frame.result = Some(result),
                Ok(None) if Instant::now() >= end => {
                    let place = format!("a frame of `{}`", frame.plan.name);
                    let whole = Running { place, time: frame.submitted.elapsed() };
                    self.stalled = if reads_block { Some(whole) } else { device.running() };
                    return Ok(false);
                }
                Ok(None) => {
                    std::thread::sleep(pause);
                    pause = (2 * pause).min(MAX_PAUSE);
                }
                Err(error) => {
                    // After a transient error, the frame stays in flight and can be awaited again. After any other
                    // error, its results are lost.
                    let stays = matches!(error, BackendError::OutOfMemory { .. });
                    if !stays && error.recovery() != Recovery::Retry {
                        self.in_flight.remove(index);
                        self.forgot = true;
                        self.redraw = true;
                    }
                    return Err(error);
                }
            }
        }
        self.stalled = None;
        Ok(true)
    }

    /// Returns true if a frame in flight has lost its results since the last call.
    pub fn take_forgot(&mut self) -> bool {
        std::mem::take(&mut self.forgot)
    }
}

/// Takes the results of finished frames of all renderers of a device, and reports errors to their renderers. If polling
/// a frame blocks until newer ones are finished ([`Renderer::reads_block`]), first waits up to `patience` for the
/// newest frame. Returns false, without results, if that frame is still in flight; the caller must not submit another
/// one then.
pub(in crate::view) fn collect(renderers: &mut [&mut Renderer], patience: Duration) -> bool {
    let newest = renderers.iter_mut().max_by_key(|renderer| renderer.newest());
    if let Some(newest) = newest.filter(|newest| newest.reads_block()) {
        match newest.wait_for_newest(patience) {
            Ok(true) => {}
            Ok(false) => return false,
            Err(error) => newest.report(error),
        }
    }
    for renderer in renderers {
        if let Err(error) = renderer.take_results() {
            renderer.report(error);
        }
    }
    true
}
