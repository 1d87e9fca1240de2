//! Last tidying: only what a scene requires. Resources and shaders that no pass of the plan uses are dropped, and what the
//! others are used for is noted, so that a backend creates them for that and nothing more.

use crate::ir::{Accesses, DescriptorKind, DrawCall, Groups, ResourceId, ShaderId, Usage, Work};
use crate::plan::Plan;

/// Drops unused resources and shaders, renumbers the rest, and fills in [`crate::plan::Resource::usage`].
pub(super) fn prune(plan: &mut Plan) {
    let mut usage = vec![Usage::empty(); plan.resources.len()];
    let mut shader_used = vec![false; plan.shaders.len()];
    for pass in &plan.passes {
        for binding in &pass.bindings {
            usage[binding.resource.index()] |= match binding.kind {
                DescriptorKind::UniformBuffer => Usage::UNIFORM,
                DescriptorKind::StorageBuffer | DescriptorKind::StorageImage => Usage::STORAGE,
            };
        }
        for touch in &pass.touches {
            let used = &mut usage[touch.resource.index()];
            let accesses = touch.accesses;
            used.set(
                Usage::INDIRECT,
                used.contains(Usage::INDIRECT) || accesses.contains(Accesses::INDIRECT_READ),
            );
            used.set(
                Usage::COPY_SOURCE,
                used.contains(Usage::COPY_SOURCE) || accesses.contains(Accesses::TRANSFER_READ),
            );
            used.set(
                Usage::COPY_TARGET,
                used.contains(Usage::COPY_TARGET) || accesses.contains(Accesses::TRANSFER_WRITE),
            );
            let color = accesses.intersects(Accesses::COLOR_READ | Accesses::COLOR_WRITE);
            used.set(Usage::COLOR_TARGET, used.contains(Usage::COLOR_TARGET) || color);
        }
        match &pass.work {
            Work::Dispatch { shader, .. } => shader_used[shader.index()] = true,
            Work::Draw { vertex, fragment, .. } => {
                shader_used[vertex.index()] = true;
                shader_used[fragment.index()] = true;
            }
            Work::Fill { .. } | Work::Start { .. } | Work::Export | Work::Host => {}
        }
    }
    let resources = renumber(&mut plan.resources, |i| !usage[i].is_empty());
    let shaders = renumber(&mut plan.shaders, |i| shader_used[i]);
    let mut used = usage.into_iter().filter(|u| !u.is_empty());
    for resource in &mut plan.resources {
        resource.usage = used.next().unwrap_or(Usage::empty());
    }

    let resource = |id: &mut ResourceId| *id = ResourceId(resources[id.index()]);
    let shader = |id: &mut ShaderId| *id = ShaderId(shaders[id.index()]);
    for pass in &mut plan.passes {
        pass.bindings.iter_mut().for_each(|b| resource(&mut b.resource));
        pass.touches.iter_mut().for_each(|t| resource(&mut t.resource));
        match &mut pass.work {
            Work::Dispatch { shader: id, groups } => {
                shader(id);
                if let Groups::Indirect { buffer, .. } = groups {
                    resource(buffer);
                }
            }
            Work::Draw { vertex, fragment, call, targets, .. } => {
                shader(vertex);
                shader(fragment);
                targets.iter_mut().for_each(|t| resource(&mut t.image));
                if let DrawCall::Indirect { buffer, .. } = call {
                    resource(buffer);
                }
            }
            Work::Fill { buffer, .. } => resource(buffer),
            Work::Start { resource: id } => resource(id),
            Work::Export | Work::Host => {}
        }
    }
    let steps = plan.prologue.iter_mut().chain(&mut plan.frame).flat_map(|step| &mut step.barriers);
    for barrier in steps.chain(&mut plan.handover) {
        barrier.image.iter_mut().for_each(|t| resource(&mut t.image));
        for dependency in &mut barrier.dependencies {
            resource(&mut dependency.resource);
            dependency.alias.iter_mut().for_each(resource);
        }
    }
    plan.blocks.iter_mut().flat_map(|block| &mut block.tenants).for_each(resource);
    resource(&mut plan.output);
    plan.stats.iter_mut().for_each(|s| resource(&mut s.buffer));
}

/// Keeps the elements that `keep` wants, and returns the new number of each old one.
fn renumber<T>(items: &mut Vec<T>, keep: impl Fn(usize) -> bool) -> Vec<u32> {
    let (mut numbers, mut next, mut at) = (Vec::with_capacity(items.len()), 0, 0);
    items.retain(|_| {
        let kept = keep(at);
        // A dropped one is never asked for.
        numbers.push(if kept { next } else { u32::MAX });
        next += u32::from(kept);
        at += 1;
        kept
    });
    numbers
}
