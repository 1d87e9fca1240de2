//! Lowers the plan to Vulkan's terms, as plain data.
//!
//! Nothing here calls the API, so the lowering can be tested on any machine.

use ash::vk;
use splatgraph_framework::ir::Reflection;
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_runtime::{BlendFactor, Limits, PipelineState};
use std::ops::BitOr;
use std::sync::Arc;

/// The layout of descriptor set 0, and the push constants. Passes with equal interfaces share a pipeline layout.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Interface {
    pub bindings: Vec<InterfaceBinding>,
    pub push_bytes: u32,
    pub stages: vk::ShaderStageFlags,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct InterfaceBinding {
    pub binding: u32,
    pub kind: vk::DescriptorType,
    pub count: u32,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Subgroups {
    /// The subgroup size to request; `None` to let the driver choose.
    pub size: Option<u32>,
    /// True to require full subgroups, in which all lanes are active at the start.
    pub full: bool,
}

/// Everything that a device's pipeline depends on, and the name of its first shader.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PipelineKey {
    /// Shaders are indices into `spirv`, so that equal pipelines of different plans have equal keys.
    state: PipelineState,
    interface: Interface,
    pub subgroups: Subgroups,
    pub name: String,
    spirv: Vec<Arc<Vec<u32>>>,
}

impl PipelineKey {
    pub fn new(plan: &Plan, state: &PipelineState, interface: &Interface, limits: &Limits) -> PipelineKey {
        let shaders: Vec<_> = state.shaders().into_iter().map(|shader| plan.shader(shader)).collect();
        let mut state = state.clone();
        match &mut state {
            PipelineState::Compute(shader) => *shader = ShaderId(0),
            PipelineState::Draw { vertex, fragment, .. } => {
                [*vertex, *fragment] = [ShaderId(0), ShaderId(1)];
            }
        }
        PipelineKey {
            state,
            interface: interface.clone(),
            subgroups: subgroups(&shaders[0].reflection, limits),
            name: shaders[0].name.clone(),
            spirv: shaders.iter().map(|shader| shader.spirv.clone()).collect(),
        }
    }
}

pub(crate) fn interface(pass: &Pass) -> Interface {
    let mut bindings: Vec<InterfaceBinding> = Vec::new();
    for binding in &pass.bindings {
        match bindings.iter_mut().find(|b| b.binding == binding.binding) {
            Some(known) => known.count = known.count.max(binding.element + 1),
            None => bindings.push(InterfaceBinding {
                binding: binding.binding,
                kind: descriptor(binding.kind),
                count: binding.element + 1,
            }),
        }
    }
    bindings.sort_by_key(|b| b.binding);
    let stages = match pass.work {
        Work::Draw { .. } => vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT,
        _ => vk::ShaderStageFlags::COMPUTE,
    };
    Interface { bindings, push_bytes: pass.push.len() as u32, stages }
}

/// Returns the requests of a pipeline: the subgroup size that the graph assumes, and full subgroups. Each is requested
/// only if the device and the workgroup size allow it, and neither for a shader without subgroup operations.
pub(crate) fn subgroups(shader: &Reflection, limits: &Limits) -> Subgroups {
    if !shader.has_subgroups() || limits.facts.subgroup_size == 0 {
        return Subgroups::default();
    }
    // A requested size must divide x and give few enough subgroups. Without a request, a SPIR-V 1.6 shader may get any
    // size, so full subgroups need a multiple of the largest.
    let selected = limits.can_request_size(shader.local_size);
    let full = selected
        || (limits.subgroup.max_size > 0 && shader.local_size[0].is_multiple_of(limits.subgroup.max_size));
    Subgroups { size: selected.then_some(limits.facts.subgroup_size), full }
}

pub(crate) fn format(format: Format) -> vk::Format {
    match format {
        Format::Rgba8Unorm => vk::Format::R8G8B8A8_UNORM,
        Format::Rgba16Float => vk::Format::R16G16B16A16_SFLOAT,
        Format::Rgba32Float => vk::Format::R32G32B32A32_SFLOAT,
        Format::R32Uint => vk::Format::R32_UINT,
        Format::R32Float => vk::Format::R32_SFLOAT,
        Format::Depth32Float => vk::Format::D32_SFLOAT,
    }
}

pub(crate) fn aspect(format: Format) -> vk::ImageAspectFlags {
    match format {
        Format::Depth32Float => vk::ImageAspectFlags::DEPTH,
        _ => vk::ImageAspectFlags::COLOR,
    }
}

pub(crate) fn topology(topology: Topology) -> vk::PrimitiveTopology {
    match topology {
        Topology::TriangleList => vk::PrimitiveTopology::TRIANGLE_LIST,
        Topology::TriangleStrip => vk::PrimitiveTopology::TRIANGLE_STRIP,
    }
}

pub(crate) fn descriptor(kind: DescriptorKind) -> vk::DescriptorType {
    match kind {
        DescriptorKind::StorageBuffer => vk::DescriptorType::STORAGE_BUFFER,
        DescriptorKind::UniformBuffer => vk::DescriptorType::UNIFORM_BUFFER,
        DescriptorKind::StorageImage => vk::DescriptorType::STORAGE_IMAGE,
    }
}

pub(crate) fn factor(factor: BlendFactor) -> vk::BlendFactor {
    match factor {
        BlendFactor::Zero => vk::BlendFactor::ZERO,
        BlendFactor::One => vk::BlendFactor::ONE,
        BlendFactor::OneMinusSourceAlpha => vk::BlendFactor::ONE_MINUS_SRC_ALPHA,
        BlendFactor::TargetAlpha => vk::BlendFactor::DST_ALPHA,
    }
}

/// Subresource range of a colour image: its single mip level and layer.
pub(crate) const WHOLE: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};

/// Subresource layers of a colour image: its single mip level and layer.
pub(crate) const LAYER: vk::ImageSubresourceLayers = vk::ImageSubresourceLayers {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    mip_level: 0,
    base_array_layer: 0,
    layer_count: 1,
};

/// Joins the flags of a table's entries that satisfy `has`.
pub(crate) fn flags<A: Copy, B: Copy + Default + BitOr<Output = B>>(
    table: &[(A, B)],
    has: impl Fn(A) -> bool,
) -> B {
    table.iter().filter(|(bit, _)| has(*bit)).fold(B::default(), |all, (_, flag)| all | *flag)
}

pub(crate) fn buffer_usage(usage: Usage) -> vk::BufferUsageFlags {
    const TABLE: [(Usage, vk::BufferUsageFlags); 5] = [
        (Usage::STORAGE, vk::BufferUsageFlags::STORAGE_BUFFER),
        (Usage::UNIFORM, vk::BufferUsageFlags::UNIFORM_BUFFER),
        (Usage::INDIRECT, vk::BufferUsageFlags::INDIRECT_BUFFER),
        (Usage::COPY_SOURCE, vk::BufferUsageFlags::TRANSFER_SRC),
        (Usage::COPY_TARGET, vk::BufferUsageFlags::TRANSFER_DST),
    ];
    flags(&TABLE, |bit| usage.contains(bit))
}

pub(crate) fn image_usage(usage: Usage) -> vk::ImageUsageFlags {
    const TABLE: [(Usage, vk::ImageUsageFlags); 5] = [
        (Usage::STORAGE, vk::ImageUsageFlags::STORAGE),
        (Usage::COLOR_TARGET, vk::ImageUsageFlags::COLOR_ATTACHMENT),
        (Usage::DEPTH_TARGET, vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT),
        (Usage::COPY_SOURCE, vk::ImageUsageFlags::TRANSFER_SRC),
        (Usage::COPY_TARGET, vk::ImageUsageFlags::TRANSFER_DST),
    ];
    flags(&TABLE, |bit| usage.contains(bit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;
    use splatgraph_framework::ir::ShaderStage;
    use splatgraph_runtime::{PipelineStates, SubgroupLimits};

    fn limits(selectable: bool) -> Limits {
        Limits {
            facts: DeviceFacts::typical(32),
            subgroup: SubgroupLimits { min_size: 32, max_size: 64, selectable, max_per_group: 8 },
            ..Limits::default()
        }
    }

    #[test]
    fn a_pass_that_binds_otherwise_has_a_pipeline_of_its_own() {
        let mut plan = plan();
        plan.passes[2].bindings[0].binding = 3;
        assert_eq!(PipelineStates::new(&plan, interface).states.len(), 3);
    }

    #[test]
    fn a_pipeline_is_that_of_another_plan_only_if_all_that_it_depends_on_is_equal() {
        let key = |at: usize, alter: fn(&mut Plan)| {
            let mut plan = plan();
            alter(&mut plan);
            let (state, interface) = &PipelineStates::new(&plan, interface).states[at];
            PipelineKey::new(&plan, state, interface, &limits(true))
        };
        for at in 0..2 {
            let same = key(at, |_| {});
            let renumbered = |plan: &mut Plan| {
                plan.shaders.insert(0, plan.shaders[2].clone());
                for pass in &mut plan.passes {
                    match &mut pass.work {
                        Work::Dispatch { shader, .. } => shader.0 += 1,
                        Work::Draw { vertex, fragment, .. } => (vertex.0, fragment.0) = (2, 3),
                        _ => {}
                    }
                }
            };
            assert!(same == key(at, renumbered), "the number of a shader is its plan's");
            let changes: [fn(&mut Plan); 4] = [
                |plan| plan.shaders.iter_mut().for_each(|shader| shader.spirv = Arc::new(vec![1])),
                |plan| plan.shaders.iter_mut().for_each(|shader| shader.name.push('x')),
                |plan| plan.passes.iter_mut().for_each(|pass| pass.push.extend([0; 4])),
                |plan| {
                    let bindings = plan.passes.iter_mut().flat_map(|pass| &mut pass.bindings);
                    bindings.for_each(|binding| binding.binding += 1);
                },
            ];
            for (number, change) in changes.into_iter().enumerate() {
                assert!(same != key(at, change), "pipeline {at}, change {number}");
            }
        }
        let blended = |plan: &mut Plan| {
            let targets = plan.passes.iter_mut().flat_map(|pass| match &mut pass.work {
                Work::Draw { targets, .. } => targets.as_mut_slice(),
                _ => &mut [],
            });
            targets.for_each(|target| target.blend = Blend::Replace);
        };
        assert!(key(1, |_| {}) != key(1, blended));
    }

    #[test]
    fn bindings_are_sorted_and_arrays_are_as_long_as_their_last_element() {
        let draw = interface(&plan().passes[3]);
        let binding = |binding, kind, count| InterfaceBinding { binding, kind, count };
        assert_eq!(
            draw.bindings,
            [
                binding(0, vk::DescriptorType::STORAGE_BUFFER, 2),
                binding(1, vk::DescriptorType::UNIFORM_BUFFER, 1)
            ]
        );
        assert_eq!(draw.push_bytes, 8);
        assert_eq!(draw.stages, vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT);
    }

    #[test]
    fn subgroup_shaders_run_full_and_with_the_size_that_was_told_where_that_is_allowed() {
        let asked = |local: [u32; 3], selectable| {
            let shader = reflection(ShaderStage::Compute, local, Features::SUBGROUP_BASIC);
            let state = subgroups(&shader, &limits(selectable));
            (state.size, state.full)
        };
        assert_eq!(asked([256, 1, 1], true), (Some(32), true));
        // x is not a multiple of the size.
        assert_eq!(asked([16, 16, 1], true), (None, false));
        // Too many subgroups to request a size. Subgroups are then full only if x is a multiple of the largest size.
        assert_eq!(asked([32 * 9, 1, 1], true), (None, false));
        assert_eq!(asked([512, 1, 1], true), (None, true));
        assert_eq!(asked([256, 1, 1], false), (None, true));
        assert_eq!(asked([32, 1, 1], false), (None, false));
        let plain =
            subgroups(&reflection(ShaderStage::Compute, [256, 1, 1], Features::empty()), &limits(true));
        assert_eq!(plain, Subgroups::default());
    }

    #[test]
    fn every_usage_has_its_vulkan_counterpart() {
        let buffers = buffer_usage(Usage::all());
        assert_eq!(buffers.as_raw().count_ones(), 5);
        let images = image_usage(Usage::all());
        assert_eq!(images.as_raw().count_ones(), 5);
        assert!(image_usage(Usage::COPY_TARGET).contains(vk::ImageUsageFlags::TRANSFER_DST));
        assert!(!image_usage(Usage::STORAGE).contains(vk::ImageUsageFlags::TRANSFER_DST));
        assert!(buffer_usage(Usage::empty()).is_empty() && image_usage(Usage::empty()).is_empty());
    }
}
