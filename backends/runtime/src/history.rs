//! Hands histories over from one plan to the next. A history is a resource whose contents persist between frames.
//!
//! If a plan and its predecessor both have a history of the same name and shape, for the same scene, they share the
//! buffer or image, and the new plan skips the [`Work::ClearHistory`]. A history continues only if it has contents,
//! does not alias other resources in either plan, was created for every use that the new plan makes of it, and no other
//! pass of the new plan's prologue writes it. Otherwise the new plan's prologue initializes its own copy.
//!
//! Every plan is created with its own memory, because it is prepared before it becomes current. When it is swapped in
//! ([`crate::compiled::CompiledPlan::follow`]), it adopts the previous plan's histories, and drops its own.

use crate::aliasing::Transient;
use crate::gpu::Gpu;
use crate::usage::usage;
use splatgraph_framework::{ir::*, plan::*};

/// The contents with which the histories of a plan start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Start {
    /// The contents in the current plan.
    Current,
    /// The contents before the current plan's last frame with [`splatgraph_api::FrameInputs::save_histories`].
    Saved,
    Zeros,
}

pub(crate) struct History<G: Gpu> {
    pub name: String,
    pub shape: Shape,
    pub identity: u64,
    /// For an image, its layout after the last frame.
    pub layout: Layout,
    pub transient: Transient<G>,
}

/// Returns the name of a resource's history; `None` if it has no history or aliases other resources.
pub(crate) fn name(plan: &Plan, id: ResourceId) -> Option<&str> {
    let resource = plan.resource(id);
    let alone = resource.source == Source::Transient && plan.aliases(id).next().is_none();
    resource.history.as_deref().filter(|_| alone)
}

/// Returns the name of a history that the plan can continue; `None` for other resources.
pub(crate) fn continued(plan: &Plan, id: ResourceId) -> Option<&str> {
    // Without a pass that clears it, the plan does not treat it as a history. If another prologue pass writes it, its
    // contents start anew.
    let prologue = || plan.prologue.iter().map(|pass| plan.pass(*pass));
    let start = Work::ClearHistory { resource: id };
    let writes = |pass: &Pass| pass.uses.iter().any(|t| t.resource == id && t.accesses.writes());
    let starts = prologue().any(|pass| pass.work == start)
        && !prologue().any(|pass| pass.work != start && writes(pass));
    name(plan, id).filter(|_| starts)
}

/// Finds the history in `former`, the previous plan's histories, that resource `id` of `plan` continues, if any.
pub(crate) fn find<'a, G: Gpu>(
    plan: &Plan,
    id: ResourceId,
    identity: u64,
    former: &'a [History<G>],
) -> Option<&'a History<G>> {
    let name = continued(plan, id)?;
    let resource = plan.resource(id);
    former.iter().find(|history| {
        let made_for = match &history.transient {
            Transient::Buffer(buffer) => buffer.usage,
            Transient::Image(image) => image.usage,
        };
        made_for.contains(usage(resource))
            && history.name == name
            && history.shape == resource.shape
            && history.identity == identity
    })
}
