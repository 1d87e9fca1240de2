//! Checks which resources can be read back after which pass, and creates the readback buffers.

use crate::check::invalid;
use crate::compiled::CompiledPlan;
use crate::gpu::{Buffer, Gpu};
use splatgraph_api::{BackendError, Inspect};
use splatgraph_framework::ir::Use;
use std::sync::Arc;

pub(crate) fn buffers<G: Gpu>(
    gpu: &Arc<G>,
    compiled: &CompiledPlan<G>,
    slot: usize,
    inspect: &[Inspect],
) -> Result<Vec<Buffer<G>>, BackendError> {
    let plan = &compiled.plan;
    let buffer = |inspect: &Inspect| {
        let (Some(resource), Some(pass)) =
            (plan.resources.get(inspect.resource.index()), plan.passes.get(inspect.after.index()))
        else {
            return invalid(format!("{inspect:?} names a resource or a pass that is not in the plan"));
        };
        let Some(last) = compiled.passes().position(|pass| pass == inspect.after) else {
            return invalid(format!(
                "`{}` cannot be inspected after pass `{}`, which does not run in this frame",
                resource.name, pass.name
            ));
        };
        check_contents(compiled, inspect, last)?;
        let bytes = match compiled.resources.image(inspect.resource) {
            Some(image) => image.bytes(),
            None => {
                let range = compiled.resources.part(inspect.resource, slot).1;
                range.end - range.start
            }
        };
        Buffer::to_host(gpu, "inspection", bytes)
    };
    inspect.iter().map(buffer).collect()
}

/// Refuses a resource that has no valid contents right after pass number `last` of the next frame.
///
/// It may be freed, an image that is not written yet, or inactive while another resource occupies their shared memory.
/// In the last case, a layout change for the copy would destroy the other resource.
fn check_contents<G: Gpu>(
    compiled: &CompiledPlan<G>,
    inspect: &Inspect,
    last: usize,
) -> Result<(), BackendError> {
    let (plan, id) = (&compiled.plan, inspect.resource);
    let (resource, pass) = (plan.resource(id), plan.pass(inspect.after));
    if compiled.resources.is_freed(id) {
        return invalid(format!(
            "`{}` cannot be inspected after pass `{}`: only passes that run once use it, and it is freed after them",
            resource.name, pass.name
        ));
    }
    let uses = || compiled.passes().take(last + 1).flat_map(|pass| &plan.pass(pass).uses);
    if plan.aliases(id).next().is_some() {
        let holds = |touch: &&Use| plan.resource(touch.resource).block == resource.block;
        let holder = uses().filter(holds).last().map(|touch| touch.resource);
        if holder != Some(id) {
            let holder = match holder {
                Some(holder) => format!("holds `{}` then", plan.resource(holder).name),
                None => "holds nothing yet".to_string(),
            };
            return invalid(format!(
                "`{}` cannot be inspected after pass `{}`: it shares its memory, which {holder}",
                resource.name, pass.name
            ));
        }
    }
    let written = !compiled.prologue_due
        || compiled.carried.contains(&id)
        || uses().any(|touch| touch.resource == id && touch.accesses.writes());
    if compiled.resources.image(id).is_some() && !written {
        return invalid(format!("image `{}` has no contents yet after pass `{}`", resource.name, pass.name));
    }
    Ok(())
}
