//! Buffers that only the prologue uses. Most planes of the scene are: passes read them once, to pack them, and frames read what these
//! passes wrote.
//!
//! They are freed when the frame that ran the prologue is done. Where the device has no room for them beside everything else, they
//! lie in the host's memory until then, which the device reads more slowly. A plan that takes over the results of passes does
//! not need what only these passes use, and it is not made.

use crate::attributes::PlaneKey;
use crate::gpu::Location;
use splatgraph_api::{BackendError, display_bytes};
use splatgraph_framework::ir::{PassId, ResourceId};
use splatgraph_framework::plan::Plan;
use std::collections::BTreeSet;

/// The buffers of one plan that frames do not use.
#[derive(Debug)]
pub(crate) struct UsedOnce {
    /// Used by the prologue, and freed after it.
    pub freed: BTreeSet<ResourceId>,
    /// Used by no pass that runs.
    pub unused: BTreeSet<ResourceId>,
    /// The memory of the planes among [`UsedOnce::freed`].
    pub location: Location,
}

impl UsedOnce {
    /// Finds them in a plan that runs without the passes `left_out`.
    pub fn new(plan: &Plan, left_out: &[PassId]) -> UsedOnce {
        let runs = plan.prologue.iter().copied().filter(|pass| !left_out.contains(pass));
        let used: BTreeSet<ResourceId> = runs.flat_map(|pass| plan.pass(pass).resources()).collect();
        let (freed, unused) = plan.used_once().into_iter().partition(|id| used.contains(id));
        UsedOnce { freed, unused, location: Location::Device }
    }

    /// Finds room for a plan's own memory and the planes that are `absent` on the device, without the `held` bytes that it takes over.
    ///
    /// The driver's number of `available` bytes is an estimate. Without this, memory would be taken piece by piece until one fails, or
    /// until other programs lose theirs.
    ///
    /// # Errors
    /// The memory that stays after the prologue exceeds the available bytes.
    pub fn find_room(
        &mut self,
        plan: &Plan,
        available: Option<u64>,
        absent: &[&(ResourceId, PlaneKey)],
        held: u64,
    ) -> Result<(), BackendError> {
        let Some(available) = available else { return Ok(()) };
        let unused: u64 = self
            .unused
            .iter()
            .filter(|id| plan.resource(**id).block.is_some())
            .map(|id| plan.resource(*id).bytes())
            .sum();
        let own = plan.transient_bytes().saturating_sub(held).saturating_sub(unused);
        let sum = |freed: bool| -> u64 {
            let planes = absent.iter().filter(|(id, _)| self.freed.contains(id) == freed);
            planes.fold(0, |sum, (_, key)| sum.saturating_add(key.bytes))
        };
        let needed = own.saturating_add(sum(false));
        if needed > available {
            return Err(BackendError::OutOfMemory {
                name: format!("the plan `{}`", plan.name),
                bytes: needed,
                reason: format!(
                    "expected at most {} of the device's memory, which the driver says this process can still take",
                    display_bytes(available)
                ),
            });
        }
        if needed.saturating_add(sum(true)) > available {
            self.location = Location::Host;
        }
        Ok(())
    }
}
