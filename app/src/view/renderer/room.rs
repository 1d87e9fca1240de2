//! Room for what frames of a renderer need: growth of its parameters, and its end.

use super::device::ends_device;
use super::events::{Cause, Failure};
use super::{RETRY, Renderer};
use crate::growth::{Shortage, shortages};
use splatgraph_api::{Device, FrameResult};
use splatgraph_framework::plan::Plan;
use std::sync::Arc;
use std::time::Instant;

/// A device that refused a plan with more room.
pub(super) struct Crowded {
    reason: String,
    /// Time of the next attempt, where it may be otherwise by then.
    retry: Option<Instant>,
}

impl<D: Device> Renderer<D> {
    /// Returns the reason why the device has no plan with more room, if it refused one since the last change.
    pub fn crowded(&self) -> Option<&str> {
        self.crowded.as_ref().map(|crowded| crowded.reason.as_str())
    }

    /// Returns true before the end of the first frame of a plan that may have to grow, if frames can be drawn.
    pub fn may_grow(&self) -> bool {
        let grows = |plan: &Arc<Plan>| plan.params.iter().any(|param| param.grows.is_some());
        !self.told && self.trouble().is_none() && self.plan().is_some_and(grows)
    }

    /// Lists what a finished frame had no room for, and asks for a plan with more.
    pub(super) fn make_room(&mut self, plan: &Arc<Plan>, result: &FrameResult) -> Vec<Shortage> {
        let short = shortages(plan, &result.stats);
        // What a frame of a former plan lacked, perhaps of another scene, says nothing about this one; and while another plan is on its
        // way, the frames of that will tell.
        let current = self.state.good().is_some_and(|good| Arc::ptr_eq(good, plan));
        self.told |= current;
        if current && self.crowded.is_none() && !self.busy() {
            let raised = short.iter().filter(|short| self.grown.raise(short));
            let raised: Vec<String> = raised.map(|short| short.parameter.clone()).collect();
            if !raised.is_empty() {
                self.want(Cause::Room(raised), Instant::now());
            }
        }
        short
    }

    /// Lets frames ask for more room again, if the device may have it by now.
    pub(super) fn try_room_again(&mut self) {
        let due = |crowded: &mut Crowded| crowded.retry.is_some_and(|time| time <= self.now);
        self.crowded.take_if(due);
    }

    /// Takes note of a plan that failed. One whose only change was more room is given up: the frames go on in part.
    pub(super) fn refuse(&mut self, cause: &Cause, failure: Failure) {
        let ended = match &failure {
            Failure::Backend(error) => ends_device(error),
            Failure::Panicked(_) => true,
            Failure::Graph(_) | Failure::Cancelled | Failure::Held(_) => false,
        };
        let grew = self.grown != self.drawn_with;
        if ended || !grew {
            return self.fail(failure);
        }
        // The next plan, for whatever reason, has the room of the last good one.
        self.grown = self.drawn_with.clone();
        if matches!(cause, Cause::Room(_)) {
            let retry = failure.may_pass().then(|| self.now + RETRY);
            self.crowded = Some(Crowded { reason: failure.text(false), retry });
            self.building = None;
        } else {
            self.fail(failure);
        }
    }
}
