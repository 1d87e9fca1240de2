//! Collects the uses of each resource; a backend creates the resource for these.

use crate::ir::{Accesses, DescriptorKind, Usage};
use crate::plan::Plan;

const OF_ACCESSES: [(Accesses, Usage); 4] = [
    (Accesses::INDIRECT_READ, Usage::INDIRECT),
    (Accesses::TRANSFER_READ, Usage::COPY_SOURCE),
    (Accesses::TRANSFER_WRITE, Usage::COPY_TARGET),
    (Accesses::COLOR_READ.union(Accesses::COLOR_WRITE), Usage::COLOR_TARGET),
];

/// Fills in [`Resource::usage`](crate::plan::Resource::usage).
pub(super) fn note(plan: &mut Plan) {
    for pass in &plan.passes {
        for binding in &pass.bindings {
            plan.resources[binding.resource.index()].usage |= match binding.kind {
                DescriptorKind::UniformBuffer => Usage::UNIFORM,
                DescriptorKind::StorageBuffer | DescriptorKind::StorageImage => Usage::STORAGE,
            };
        }
        for touch in &pass.uses {
            let usages = OF_ACCESSES.iter().filter(|(accesses, _)| touch.accesses.intersects(*accesses));
            usages.for_each(|(_, usage)| plan.resources[touch.resource.index()].usage |= *usage);
        }
    }
}
