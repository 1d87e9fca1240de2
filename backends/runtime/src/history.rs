//! Histories: resources whose contents continue from one plan to the next.
//!
//! Where a plan and the one before it both have a history of the same name and shape, for the same scene, they share the buffer
//! or the image, and the new plan leaves out the [`Work::ClearHistory`] that would have zeroed it. A history goes on only if it has
//! contents, if it has its memory to itself in both plans, if it was made for every use that the new plan makes of it, and if no
//! pass of the new plan's prologue writes it; otherwise it starts from zeros.
//!
//! A plan is made ready some time before it becomes the current one, and frames of other plans are drawn meanwhile. So every plan
//! is made with its own memory. When it is swapped in ([`crate::compiled::CompiledPlan::follow`]), it is bound to the histories
//! of the plan before it, with their layouts of that moment, and drops its own.

use crate::aliasing::Transient;
use crate::gpu::Gpu;
use crate::usage::usage;
use splatgraph_framework::{ir::*, plan::*};

/// A resource that a later plan may continue from.
pub(crate) struct History<G: Gpu> {
    pub name: String,
    pub shape: Shape,
    /// The scene's; see [`splatgraph_api::SceneData::identity`].
    pub identity: u64,
    /// The layout that frames left it in, if it is an image.
    pub layout: Layout,
    pub transient: Transient<G>,
}

/// Returns the name of a resource's history, if it has one and its memory to itself.
pub(crate) fn name(plan: &Plan, id: ResourceId) -> Option<&str> {
    let resource = plan.resource(id);
    let alone = resource.source == Source::Transient && plan.aliases(id).next().is_none();
    resource.history.as_deref().filter(|_| alone)
}

/// Finds the previous history that a resource of `plan` continues from.
pub(crate) fn find<'a, G: Gpu>(
    plan: &Plan,
    id: ResourceId,
    identity: u64,
    former: &'a [History<G>],
) -> Option<&'a History<G>> {
    let name = name(plan, id)?;
    let resource = plan.resource(id);
    // Without a pass to leave out, the plan does not count on it; and what another pass writes once starts anew.
    let prologue = || plan.prologue.iter().map(|pass| plan.pass(*pass));
    let start = Work::ClearHistory { resource: id };
    let writes = |pass: &Pass| pass.uses.iter().any(|t| t.resource == id && t.accesses.writes());
    let starts = prologue().any(|pass| pass.work == start)
        && !prologue().any(|pass| pass.work != start && writes(pass));
    former.iter().find(|history| {
        let made_for = match &history.transient {
            Transient::Buffer(buffer) => buffer.usage,
            Transient::Image(image) => image.usage,
        };
        starts
            && made_for.contains(usage(resource))
            && history.name == name
            && history.shape == resource.shape
            && history.identity == identity
    })
}
