//! Increases a renderer's list capacities when frames overflow, up to the device's memory.

use super::Renderer;
use super::failure::Failure;
use super::state::{Crowded, ends_device};
use crate::draw::capacity::{Overflow, overflows};
use crate::view::events::{Cause, Causes};
use splatgraph_api::FrameResult;
use splatgraph_framework::plan::Plan;
use std::sync::Arc;
use std::time::Instant;

impl Renderer {
    /// Returns the reason why the device rejected more capacity. `None` if it did not, or after a change or the retry
    /// time.
    pub fn crowded(&self) -> Option<&str> {
        self.crowded.as_ref().map(|crowded| crowded.reason.as_str())
    }

    /// Returns true while the current plan has growing lists and none of its frames has finished. False if the last
    /// attempt to draw failed.
    pub fn may_grow(&self) -> bool {
        self.whole.is_none() && self.trouble().is_none() && self.grows()
    }

    /// Copies the capacities of another renderer that draws the same scene with the same graph.
    pub fn take_room_of(&mut self, other: &Renderer) {
        self.capacities = other.capacities.clone();
    }

    fn grows(&self) -> bool {
        self.plan().is_some_and(|plan| plan.params.iter().any(|param| param.grows.is_some()))
    }

    /// Returns true if waiting cannot make frames more complete. This holds if no list can grow, or once a frame of the
    /// plan has finished and either was complete or no build is running.
    pub fn is_at_best(&self) -> bool {
        !self.grows() || self.whole.is_some_and(|whole| whole || !self.busy())
    }

    /// Returns the lists that overflowed in a frame, and requests a plan with the capacities that the frame needed.
    /// Requests nothing for a frame of an earlier plan, during a build, or while [`Renderer::crowded`].
    pub(super) fn make_room(&mut self, plan: &Arc<Plan>, result: &FrameResult) -> Vec<Overflow> {
        let short = overflows(plan, &result.stats);
        // A previous plan may be of another scene, and frames of the current plan report their own overflows.
        let current = self.state.good().is_some_and(|good| Arc::ptr_eq(good, plan));
        if current {
            self.whole = Some(short.is_empty());
        }
        if current && self.crowded.is_none() && !self.busy() {
            let raised = short.iter().filter(|short| self.capacities.raise(short));
            let causes: Causes = raised.map(|short| Cause::Room(short.parameter.clone())).collect();
            if causes.is_room_alone() {
                self.want(causes, Instant::now());
            }
        }
        short
    }

    /// Returns the time from which frames may request more capacity again. `None` if they may now, or only after a
    /// change.
    pub(super) fn room_again(&self) -> Option<Instant> {
        self.crowded.as_ref()?.retry
    }

    pub(super) fn try_room_again(&mut self) {
        if self.room_again().is_some_and(|time| time <= self.now) {
            self.crowded = None;
            // An incomplete frame must be drawn again to request capacity.
            self.redraw = true;
        }
    }

    /// Records the failure of a build. If the build raised capacities, restores those of the last plan, unless the
    /// build panicked or the device is lost. A build for capacity alone is given up; frames then stay incomplete.
    pub(super) fn refuse(&mut self, causes: &Causes, failure: Failure) {
        let ended = match &failure {
            Failure::Backend(error) => ends_device(error),
            Failure::Panicked(_) => true,
            Failure::Graph(_) | Failure::Held(_) => false,
        };
        let grew = self.capacities != self.drawn_with;
        if ended || !grew {
            return self.fail(failure);
        }
        // Whatever causes the next build, it starts from the capacities of the last good plan.
        self.capacities = self.drawn_with.clone();
        if causes.is_room_alone() {
            let retry = failure.may_pass().then(|| self.next_attempt());
            self.crowded = Some(Crowded { reason: failure.text(false), retry });
            self.build.running = None;
        } else {
            self.fail(failure);
        }
    }
}
