//! Allocates and writes descriptor sets, which hold the bindings of a plan's passes.

use crate::error::api;
use crate::gpu::{Owned, VulkanGpu};
use crate::lower::descriptor;
use crate::pipelines::Pipelines;
use ash::vk;
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT};
use splatgraph_framework::ir::{Binding, PassId};
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{BindingTarget, binding_copies};
use std::sync::Arc;

/// The descriptor sets of all passes of a plan.
pub struct DescriptorSets {
    /// Descriptor sets by pass, then by slot; null for passes without bindings.
    sets: Vec<[vk::DescriptorSet; FRAMES_IN_FLIGHT]>,
    // Dropping the pool frees the sets.
    _pool: Option<Owned<vk::DescriptorPool>>,
}

impl DescriptorSets {
    pub(crate) fn set(&self, pass: PassId, slot: usize) -> vk::DescriptorSet {
        self.sets[pass.index()][slot]
    }
}

impl splatgraph_runtime::Bindings<VulkanGpu> for DescriptorSets {
    /// Allocates a descriptor set per copy for each dispatch and draw with bindings.
    fn new(gpu: &Arc<VulkanGpu>, plan: &Plan, pipelines: &Pipelines) -> Result<DescriptorSets, BackendError> {
        let mut sets = vec![[vk::DescriptorSet::null(); FRAMES_IN_FLIGHT]; plan.passes.len()];
        let bound = plan.order().filter(|&id| !plan.pass(id).bindings.is_empty());
        let bound: Vec<PassId> = bound.collect();
        let Some(pool) = pool(gpu, plan, pipelines, &bound)? else {
            return Ok(DescriptorSets { sets, _pool: None });
        };
        for id in bound {
            let Some((_, layout)) = pipelines.find(id) else { continue };
            let copies = binding_copies(plan, plan.pass(id));
            let layouts = vec![*layout.set; copies];
            let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(*pool).set_layouts(&layouts);
            // SAFETY: the pool was made for exactly these sets.
            let new = unsafe { gpu.device.allocate_descriptor_sets(&info) }
                .map_err(api("vkAllocateDescriptorSets"))?;
            for &set in &new {
                gpu.name(set, &plan.pass(id).name);
            }
            sets[id.index()] = std::array::from_fn(|slot| new[slot % copies]);
        }
        Ok(DescriptorSets { sets, _pool: Some(pool) })
    }

    fn write(
        &mut self,
        gpu: &VulkanGpu,
        pass: PassId,
        copy: usize,
        binding: &Binding,
        target: BindingTarget<VulkanGpu>,
    ) {
        let write = vk::WriteDescriptorSet::default()
            .dst_set(self.set(pass, copy))
            .dst_binding(binding.binding)
            .dst_array_element(binding.element)
            .descriptor_type(descriptor(binding.kind));
        let buffer;
        let image;
        let write = match target {
            BindingTarget::Image(bound) => {
                image = [vk::DescriptorImageInfo::default()
                    .image_view(*bound.raw.view)
                    .image_layout(vk::ImageLayout::GENERAL)];
                write.image_info(&image)
            }
            BindingTarget::Buffer(bound, bytes) => {
                buffer = [vk::DescriptorBufferInfo::default()
                    .buffer(*bound.raw)
                    .offset(bytes.start)
                    .range(bytes.end - bytes.start)];
                write.buffer_info(&buffer)
            }
        };
        // SAFETY: the set is not in use, the resources are alive, and the kinds fit (checked with the plan).
        unsafe { gpu.device.update_descriptor_sets(&[write], &[]) };
    }
}

/// Creates a descriptor pool with room for the sets of the passes `bound`; `None` if they need no sets.
fn pool(
    gpu: &Arc<VulkanGpu>,
    plan: &Plan,
    pipelines: &Pipelines,
    bound: &[PassId],
) -> Result<Option<Owned<vk::DescriptorPool>>, BackendError> {
    let mut sets = 0;
    let mut sizes: Vec<vk::DescriptorPoolSize> = Vec::new();
    for &id in bound {
        let Some(interface) = pipelines.interface(id) else { continue };
        let copies = binding_copies(plan, plan.pass(id)) as u32;
        sets += copies;
        for binding in &interface.bindings {
            let count = binding.count * copies;
            match sizes.iter_mut().find(|size| size.ty == binding.kind) {
                Some(size) => size.descriptor_count += count,
                None => {
                    sizes.push(vk::DescriptorPoolSize::default().ty(binding.kind).descriptor_count(count))
                }
            }
        }
    }
    if sets == 0 {
        return Ok(None);
    }
    let info = vk::DescriptorPoolCreateInfo::default().max_sets(sets).pool_sizes(&sizes);
    // SAFETY: `info` lives until the call returns.
    let pool =
        unsafe { gpu.device.create_descriptor_pool(&info, None) }.map_err(api("vkCreateDescriptorPool"))?;
    Ok(Some(Owned::new(gpu, pool)))
}
