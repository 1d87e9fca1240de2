//! Drops unused resources and shaders, renumbers the others in the same order, and collects the uses of each resource.
//!
//! `last(name)` becomes `name` itself: the order of the passes already puts its readers before this frame's writers.

use crate::ir::{Accesses, DescriptorKind, Pass, ResourceId, ShaderId, Usage};
use crate::link::LinkedPass;
use crate::lower::Lowered;
use crate::plan::Plan;

/// Creates a plan of these passes, in this order, and of the resources and shaders that they use, renumbered. It has
/// no memory, no dependencies and no usage yet.
pub(super) fn compact(lowered: Lowered, passes: &[&LinkedPass]) -> Plan {
    let real = |id: ResourceId| lowered.real(id);
    let mut plan = lowered.plan.clone();
    plan.passes = passes.iter().map(|linked| linked.pass.clone()).collect();
    let mut used = (vec![false; plan.resources.len()], vec![false; plan.shaders.len()]);
    for pass in &mut plan.passes {
        pass.uses.iter().for_each(|touch| used.0[real(touch.resource).index()] = true);
        pass.visit(|_| {}, |shader| used.1[shader.index()] = true);
    }
    let (resources, shaders) = (number(&used.0), number(&used.1));
    let resource = |id: &mut ResourceId| *id = ResourceId(resources[real(*id).index()]);
    for pass in &mut plan.passes {
        pass.visit(resource, |id| *id = ShaderId(shaders[id.index()]));
        read_sizes(pass);
    }
    resource(&mut plan.output);
    plan.pictures.retain(|picture| used.0[real(picture.image).index()]);
    plan.pictures.iter_mut().for_each(|picture| resource(&mut picture.image));
    plan.outputs.iter_mut().for_each(|output| resource(&mut output.image));
    plan.stats.iter_mut().for_each(|stat| resource(&mut stat.buffer));
    retain(&mut plan.resources, &used.0);
    retain(&mut plan.shaders, &used.1);
    plan
}

/// Counts size queries of images as reads.
///
/// They need the image's layout, and validation layers treat them so. Culling ran before: a size needs no contents.
fn read_sizes(pass: &mut Pass) {
    let accessed: Vec<ResourceId> =
        pass.uses.iter().filter(|touch| !touch.accesses.is_empty()).map(|touch| touch.resource).collect();
    for touch in pass.uses.iter_mut().filter(|touch| touch.layout.is_some()) {
        if !accessed.contains(&touch.resource) {
            touch.accesses = Accesses::STORAGE_READ;
        }
    }
}

/// Assigns consecutive numbers to the used items; the numbers of unused ones are meaningless.
fn number(used: &[bool]) -> Vec<u32> {
    let mut next = 0;
    let number = |used: &bool| {
        next += u32::from(*used);
        next.saturating_sub(1)
    };
    used.iter().map(number).collect()
}

fn retain<T>(list: &mut Vec<T>, used: &[bool]) {
    let mut used = used.iter();
    list.retain(|_| used.next() == Some(&true));
}

const OF_ACCESSES: [(Accesses, Usage); 5] = [
    (Accesses::INDIRECT_READ, Usage::INDIRECT),
    (Accesses::TRANSFER_READ, Usage::COPY_SOURCE),
    (Accesses::TRANSFER_WRITE, Usage::COPY_TARGET),
    (Accesses::COLOR_READ.union(Accesses::COLOR_WRITE), Usage::COLOR_TARGET),
    (Accesses::DEPTH_READ.union(Accesses::DEPTH_WRITE), Usage::DEPTH_TARGET),
];

/// Fills in [`Resource::usage`](crate::plan::Resource::usage).
pub(super) fn note_usage(plan: &mut Plan) {
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
