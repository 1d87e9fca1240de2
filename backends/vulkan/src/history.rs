//! What outlives a plan: resources with a history.
//!
//! A plan that follows another goes on from its histories: where both have one of the same name and shape, for the same
//! scene, they share the buffer or the image, and the new plan leaves out the [`Work::Start`] that would have zeroed it. A
//! history is taken over only if it has contents, if it stands in its block alone in both plans, and if it was made for all
//! that the new plan uses it for; otherwise it starts from zeros.
//!
//! A plan is made ready some time before it becomes the current one, and frames of other plans go on in between. So every plan
//! is made with memory of its own, and what it goes on from is settled when it is swapped in
//! ([`crate::loaded::Loaded::follow`]): with the layouts and the contents of that moment, it is bound to what the plan before it
//! has, and lets go of its own.

use crate::blocks::Bound;
use crate::lower;
use ash::vk;
use splatgraph_framework::{ir::*, plan::*};

/// A resource that a later plan may take over.
pub(crate) struct History {
    pub name: String,
    pub shape: Shape,
    /// The scene's; see [`splatgraph_api::SceneData::identity`].
    pub identity: u64,
    /// The layout that it was left in, if it is an image.
    pub layout: vk::ImageLayout,
    pub bound: Bound,
}

/// The name of a resource's history, if it has one and its memory to itself.
pub(crate) fn name(plan: &Plan, id: ResourceId) -> Option<&str> {
    let resource = plan.resource(id);
    let alone = resource.source == Source::Transient && plan.aliases(id).next().is_none();
    resource.history.as_deref().filter(|_| alone)
}

/// The former history that a resource of `plan` goes on from.
pub(crate) fn find<'a>(
    plan: &Plan,
    id: ResourceId,
    identity: u64,
    former: &'a [History],
) -> Option<&'a History> {
    let name = name(plan, id)?;
    let resource = plan.resource(id);
    // Without a pass to leave out, the plan does not count on it.
    let starts = plan.prologue.iter().any(|step| plan.pass(step.pass).work == Work::Start { resource: id });
    former.iter().find(|history| {
        let fits = match &history.bound {
            Bound::Buffer(buffer) => buffer.usage.contains(lower::buffer_usage(resource)),
            Bound::Image(image) => image.usage.contains(lower::image_usage(resource.usage)),
        };
        starts
            && fits
            && history.name == name
            && history.shape == resource.shape
            && history.identity == identity
    })
}
