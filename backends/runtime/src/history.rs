//! Hands state over from one plan to the next: the resources whose contents persist between frames. They are histories,
//! and results of the prologue that frames change.
//!
//! If a plan and its predecessor both have a history of the same name and shape, for the same scene, they share the
//! buffer or image, and the new plan skips the [`Work::ClearHistory`]. A history continues only if it has contents,
//! does not alias other resources in either plan, was created for every use that the new plan makes of it, and no other
//! pass of the new plan's prologue uses it. Otherwise the new plan's prologue initializes its own copy.
//!
//! A plan with more capacity ([`Start::Grown`], [`Start::Saved`]) continues all state of equal name and shape. Its
//! prologue runs as in any plan. Then the contents are copied from the previous plan.
//!
//! Every plan is created with its own memory, because it is prepared before it becomes current. When it is swapped in
//! ([`crate::compiled::CompiledPlan::follow`]), it adopts the previous plan's histories, and drops its own.

use crate::aliasing::Transient;
use crate::gpu::Gpu;
use crate::usage::usage;
use splatgraph_framework::{ir::*, plan::*};

/// The contents with which the state of a plan starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Start {
    /// Histories continue from the current plan, unless the prologue uses them other than to clear them.
    Current,
    /// All state continues from the current plan.
    Grown,
    /// All state continues with the contents before the current plan's last frame with
    /// [`splatgraph_api::FrameInputs::save_histories`].
    Saved,
    /// Nothing continues.
    Zeros,
}

/// The contents of a resource of another plan.
pub(crate) struct History<G: Gpu> {
    pub resource: Resource,
    pub identity: u64,
    /// For an image, its layout after the last frame.
    pub layout: Layout,
    pub transient: Transient<G>,
}

/// Returns true if a resource's contents persist between frames, and it does not alias other resources.
pub(crate) fn is_state(plan: &Plan, id: ResourceId) -> bool {
    let alone = plan.resource(id).source == Source::Transient && plan.aliases(id).next().is_none();
    alone && plan.is_state(id)
}

/// Returns true if the plan can share a history with the plan before it.
fn is_shared(plan: &Plan, id: ResourceId) -> bool {
    // Without a pass that clears it, the plan does not treat it as a history. If another prologue pass writes it, or
    // reads the zeros, its contents start anew.
    let prologue = || plan.prologue.iter().map(|pass| plan.pass(*pass));
    let start = Work::ClearHistory { resource: id };
    let uses = |pass: &Pass| pass.uses.iter().any(|touch| touch.resource == id);
    prologue().any(|pass| pass.work == start) && !prologue().any(|pass| pass.work != start && uses(pass))
}

/// Finds the state of the previous plan with which resource `id` of `plan` continues, if any. `former` is all of it.
///
/// With [`Start::Current`], the plan shares the previous plan's resource.
pub(crate) fn find<'a, G: Gpu>(
    plan: &Plan,
    id: ResourceId,
    identity: u64,
    (start, former): (Start, &'a [History<G>]),
) -> Option<&'a History<G>> {
    let resource = plan.resource(id);
    let shares = start == Start::Current;
    let may_continue = is_state(plan, id) && (!shares || is_shared(plan, id));
    former.iter().filter(|_| may_continue).find(|history| {
        let made_for = match &history.transient {
            Transient::Buffer(buffer) => buffer.usage,
            Transient::Image(image) => image.usage,
        };
        let same_name = match (&history.resource.history, &resource.history) {
            (None, None) => history.resource.name == resource.name,
            (former, own) => former == own,
        };
        (!shares || made_for.contains(usage(resource)))
            && same_name
            && history.resource.shape == resource.shape
            && history.identity == identity
    })
}
