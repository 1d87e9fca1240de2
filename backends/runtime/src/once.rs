//! Manages buffers that only the prologue uses. Most planes of the scene are such buffers: prologue passes pack them,
//! and frames read the packed data.
//!
//! They are freed once the prologue's frame has completed. If the device has no room for them beside everything else,
//! they are placed in host memory, which the device reads more slowly. If a plan reuses the results of passes, the
//! buffers that only these passes use are not created.

use crate::attributes::PlaneKey;
use crate::gpu::Location;
use splatgraph_api::{BackendError, display_bytes};
use splatgraph_framework::ir::{PassId, ResourceId};
use splatgraph_framework::plan::Plan;
use std::collections::BTreeSet;

/// The buffers of one plan that its frames do not use.
#[derive(Debug)]
pub(crate) struct UsedOnce {
    /// Buffers that the prologue uses; freed after it.
    pub freed: BTreeSet<ResourceId>,
    /// Buffers that no executed pass uses.
    pub unused: BTreeSet<ResourceId>,
    /// The location of the planes in [`UsedOnce::freed`].
    pub location: Location,
}

impl UsedOnce {
    /// Finds the buffers that only the prologue uses, in a plan that skips the passes `skipped`.
    pub fn new(plan: &Plan, skipped: &[PassId]) -> UsedOnce {
        let runs = plan.prologue.iter().copied().filter(|pass| !skipped.contains(pass));
        let used: BTreeSet<ResourceId> = runs.flat_map(|pass| plan.pass(pass).resources()).collect();
        let (freed, unused) = plan.used_once().into_iter().partition(|id| used.contains(id));
        UsedOnce { freed, unused, location: Location::Device }
    }

    /// Chooses the memory for a plan's resources and the `absent` planes, given `available` bytes and the `held` bytes
    /// that it reuses.
    ///
    /// `available` is the driver's estimate. Without this check, allocation would go on until it fails, or until other
    /// programs lose their memory.
    ///
    /// # Errors
    /// The memory that remains after the prologue exceeds `available`.
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
