//! Manages buffers that only the prologue uses, such as most planes of the scene. Prologue passes pack these planes,
//! and frames read the packed data.
//!
//! They are freed once the prologue's frame has completed. If device memory lacks room for them beside the rest of the
//! plan, the scene's planes among them are placed in host memory, which the device reads more slowly. If the plan
//! reuses results, buffers that only the skipped passes use are not created.

use crate::attributes::PlaneKey;
use crate::gpu::Location;
use splatgraph_api::{BackendError, display_bytes};
use splatgraph_framework::ir::{PassId, ResourceId};
use splatgraph_framework::plan::Plan;
use std::collections::{BTreeSet, HashSet};

/// The buffers of one plan that its frames do not use.
#[derive(Debug)]
pub(crate) struct UsedOnce {
    /// Buffers that the prologue uses, freed after it.
    pub freed: BTreeSet<ResourceId>,
    /// Buffers that no executed pass uses; they are not created.
    pub unused: BTreeSet<ResourceId>,
    /// Memory in which to create the scene's planes among [`UsedOnce::freed`].
    pub location: Location,
}

impl UsedOnce {
    /// Finds the buffers that no frame uses. The `skipped` passes do not run.
    pub fn new(plan: &Plan, skipped: &[PassId]) -> UsedOnce {
        let runs = plan.prologue.iter().copied().filter(|pass| !skipped.contains(pass));
        let used: BTreeSet<ResourceId> = runs.flat_map(|pass| plan.pass(pass).resources()).collect();
        let (freed, unused) = plan.used_once().into_iter().partition(|id| used.contains(id));
        UsedOnce { freed, unused, location: Location::Device }
    }

    /// Moves planes used only by the prologue to host memory if `available` bytes do not suffice for everything.
    ///
    /// `absent` are the planes to upload, `held` is the size of the results that the plan reuses, and `available` is
    /// the driver's estimate, or the size of the heap. The check comes first because allocation may succeed at the cost
    /// of other programs' memory.
    ///
    /// # Errors
    /// [`BackendError::OutOfMemory`] if the plan needs more than `available` bytes even without these planes.
    pub fn find_room(
        &mut self,
        plan: &Plan,
        available: u64,
        absent: &[&(ResourceId, PlaneKey)],
        held: u64,
    ) -> Result<(), BackendError> {
        let unused: u64 = self
            .unused
            .iter()
            .filter(|id| plan.resource(**id).block.is_some())
            .map(|id| plan.resource(*id).bytes())
            .sum();
        let own = plan.transient_bytes().saturating_sub(held).saturating_sub(unused);
        let sum = |freed: bool| -> u64 {
            let planes = absent.iter().filter(|(id, _)| self.freed.contains(id) == freed);
            // A plane that two includes import appears twice.
            let planes: HashSet<&PlaneKey> = planes.map(|(_, key)| key).collect();
            planes.iter().fold(0, |sum, key| sum.saturating_add(key.bytes))
        };
        let needed = own.saturating_add(sum(false));
        if needed > available {
            return Err(BackendError::OutOfMemory {
                name: format!("the plan `{}`", plan.name),
                bytes: needed,
                reason: format!(
                    "expected at most {} of the device's memory, which the driver says this process can still allocate",
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
