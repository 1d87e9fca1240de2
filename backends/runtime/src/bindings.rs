//! Creates the bindings of a plan's passes, and decides when each is written.
//!
//! A pass that binds a per-frame resource has one copy of its bindings per frame in flight; any other pass has one.
//! Bindings are written at creation, except bindings of host buffers, which are written when the buffer changes.
//! Bindings of a continued history are rewritten when the plan is swapped in.

use crate::gpu::{Bindings as _, Gpu, binding_copies};
use crate::resources::Resources;
use splatgraph_api::BackendError;
use splatgraph_framework::ir::{Pass, PassId, ResourceId, Run, Source, Work};
use splatgraph_framework::plan::Plan;
use std::sync::Arc;

pub(crate) struct Bindings<G: Gpu> {
    pub raw: G::Bindings,
    /// The passes with bindings, each with its number of copies.
    passes: Vec<(PassId, usize)>,
}

impl<G: Gpu> Bindings<G> {
    /// Creates the bindings of all dispatches and draws. Writes those of passes that are not `skipped`, except the
    /// bindings of host buffers.
    pub fn new(
        gpu: &Arc<G>,
        plan: &Plan,
        pipelines: &G::Pipelines,
        resources: &Resources<G>,
        skipped: &[PassId],
    ) -> Result<Self, BackendError> {
        let mut raw = G::Bindings::new(gpu, plan, pipelines)?;
        let runs = |pass: &Pass| matches!(pass.work, Work::Dispatch { .. } | Work::Draw { .. });
        let bound = plan.order().filter(|&id| {
            runs(plan.pass(id)) && !plan.pass(id).bindings.is_empty() && !skipped.contains(&id)
        });
        let passes: Vec<_> = bound.map(|id| (id, binding_copies(plan, plan.pass(id)))).collect();
        let fixed = |id: ResourceId| !matches!(plan.resource(id).source, Source::HostBuffer { .. });
        for &(id, copies) in &passes {
            for copy in 0..copies {
                for binding in plan.pass(id).bindings.iter().filter(|binding| fixed(binding.resource)) {
                    let target = resources.binding_target(binding.resource, copy);
                    raw.write(gpu, id, copy, binding, target);
                }
            }
        }
        Ok(Bindings { raw, passes })
    }

    pub fn end_prologue(&mut self, plan: &Plan) {
        let once = |id: PassId| plan.pass(id).run == Run::Once;
        for (id, _) in self.passes.extract_if(.., |(id, _)| once(*id)) {
            self.raw.clear(id);
        }
    }

    /// Rewrites the bindings of the `changed` resources in one slot. No frame in flight may use these bindings.
    pub fn rewrite(
        &mut self,
        gpu: &G,
        plan: &Plan,
        resources: &Resources<G>,
        slot: usize,
        changed: &[ResourceId],
    ) {
        if changed.is_empty() {
            return;
        }
        for &(id, copies) in &self.passes {
            for binding in plan.pass(id).bindings.iter().filter(|binding| changed.contains(&binding.resource))
            {
                let target = resources.binding_target(binding.resource, slot);
                self.raw.write(gpu, id, slot % copies, binding, target);
            }
        }
    }
}
