//! Defines the requirements that a pass has on the barriers before it, and finds minimal barriers that meet them.

use super::scopes::{Time, with_later};
use splatgraph_framework::ir::{Accesses, Hazard, Masks, PassId, ResourceId, Stages};
use splatgraph_framework::plan::Cause;

/// The cause of a requirement: an earlier access, and its resource.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Reason {
    pub hazard: Hazard,
    /// The resource that the pass uses.
    pub resource: ResourceId,
    /// The resource of the earlier access, if it is an alias of `resource`.
    pub alias: Option<ResourceId>,
    pub after: PassId,
    pub previous_frame: bool,
    /// The pass that has the requirement.
    pub before: PassId,
    /// Time of the earlier access in the walk.
    pub time: Time,
}

/// A happens-before requirement between two accesses, one stage on each side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Requirement {
    pub reason: Reason,
    /// Source stage, and the write access to make available; no access after a read or a layout change.
    pub from: Stages,
    pub flush: Accesses,
    /// Source stages, any one of which suffices without `flush`. After a write, they chain with the barrier that made
    /// it available; there are none if `flush` is required. After a read or a layout change, they are `from`, later
    /// stages of its pipeline, and stages that chain with earlier barriers.
    pub via: Stages,
    /// Target stage, and the access to which the write must be visible; no access for an execution dependency.
    pub to: Stages,
    pub access: Accesses,
}

impl Requirement {
    /// Returns true if the same barriers meet both requirements.
    pub fn asks_the_same_as(&self, other: &Requirement) -> bool {
        let asked = |n: &Requirement| (n.from, n.flush, n.via, n.to, n.access);
        asked(self) == asked(other)
    }

    pub fn is_met_by(&self, masks: &Masks) -> bool {
        let target = match self.access.is_empty() {
            true => with_later(masks.target_stages).contains(self.to),
            false => masks.target_stages.contains(self.to) && masks.target_accesses.contains(self.access),
        };
        target && self.source_is_met_by(masks)
    }

    pub fn source_is_met_by(&self, masks: &Masks) -> bool {
        let flushes = !self.flush.is_empty()
            && masks.source_stages.contains(self.from)
            && masks.source_accesses.contains(self.flush);
        flushes || masks.source_stages.intersects(self.via)
    }

    /// Returns true if the execution order of an image barrier meets the requirement.
    pub fn is_met_by_order(&self, masks: &Masks) -> bool {
        self.access.is_empty() && self.is_met_by(masks)
    }

    pub fn least_source(&self) -> Masks {
        let chained = self.via.iter().find(|stage| *stage == self.from).or(self.via.iter().next());
        match chained {
            Some(stage) => Masks { source_stages: stage, ..Masks::default() },
            None => Masks { source_stages: self.from, source_accesses: self.flush, ..Masks::default() },
        }
    }

    pub fn least_target(&self) -> Masks {
        Masks { target_stages: self.to, target_accesses: self.access, ..Masks::default() }
    }
}

/// Returns a minimal barrier on all memory that meets the requirements: without any of its bits it would not.
pub(super) fn memory_barrier(needs: &[Requirement]) -> Masks {
    let mut masks = least_source(needs);
    // First the needs without alternatives, whose bits may satisfy the others.
    for need in needs.iter().filter(|n| !n.access.is_empty()) {
        masks.add(need.least_target());
    }
    for need in needs {
        if !with_later(masks.target_stages).contains(need.to) {
            masks.add(need.least_target());
        }
    }
    least(masks, |masks| needs.iter().all(|need| need.is_met_by(masks)))
}

/// Returns minimal source masks that meet the requirements, whatever the target: without any bit they would not.
pub(super) fn least_source(needs: &[Requirement]) -> Masks {
    let mut masks = Masks::default();
    let (forced, free): (Vec<&Requirement>, Vec<&Requirement>) = needs.iter().partition(|n| n.via.is_empty());
    for need in forced.into_iter().chain(free) {
        if !need.source_is_met_by(&masks) {
            masks.add(need.least_source());
        }
    }
    least(masks, |masks| needs.iter().all(|need| need.source_is_met_by(masks)))
}

/// Tries to clear each mask bit in turn; a bit stays cleared if `is_enough` holds without it.
pub(super) fn least(mut masks: Masks, mut is_enough: impl FnMut(&Masks) -> bool) -> Masks {
    for bit in masks.bits() {
        let less = masks.without(bit);
        if is_enough(&less) {
            masks = less;
        }
    }
    masks
}

/// Returns the causes of a barrier that meets the requirements, each with its masks. Requirements of one pass are
/// merged if resource, alias and frame are equal, but writes after reads only with each other.
pub(super) fn causes(needs: &[Requirement]) -> Vec<(Cause, Masks)> {
    let mut causes: Vec<(Cause, Masks)> = Vec::new();
    for need in needs {
        let Reason { hazard, resource, alias, after, previous_frame, before, .. } = need.reason;
        // A pass that reads and writes a resource gets a single reason: its read.
        let apart = hazard == Hazard::WriteAfterRead;
        let same = |(d, _): &(Cause, Masks)| {
            (d.before, d.resource, d.alias, d.previous_frame) == (before, resource, alias, previous_frame)
                && (d.hazard == Hazard::WriteAfterRead) == apart
        };
        let at = causes.iter().position(same).unwrap_or_else(|| {
            let conflict = Cause { alias, previous_frame, ..cause(hazard, before, resource) };
            causes.push((conflict, Masks::default()));
            causes.len() - 1
        });
        let (cause, masks) = &mut causes[at];
        if hazard == Hazard::ReadAfterWrite {
            cause.hazard = hazard;
        }
        if !cause.after.contains(&after) {
            cause.after.push(after);
        }
        masks.add(need.least_source().with(need.least_target()));
    }
    causes.iter_mut().for_each(|(cause, _)| cause.after.sort());
    causes
}

pub(super) fn cause(hazard: Hazard, before: PassId, resource: ResourceId) -> Cause {
    Cause { hazard, before, resource, after: Vec::new(), previous_frame: false, alias: None }
}
