//! Lowers the plan to Vulkan's terms, as plain data.
//!
//! Nothing here calls the API, so the lowering can be tested on any machine.

use ash::vk;
use splatgraph_framework::ir::Reflection;
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_runtime::{BlendFactor, PipelineStates, SubgroupLimits, position_or_push};
use std::ops::BitOr;

/// The layout of descriptor set 0, and the push constants. Passes with equal interfaces share a pipeline layout.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Interface {
    pub bindings: Vec<InterfaceBinding>,
    pub push_bytes: u32,
    pub stages: vk::ShaderStageFlags,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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

/// The pipelines of a plan. Each has the index of its interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Lowered {
    pub interfaces: Vec<Interface>,
    pub pipelines: PipelineStates<usize>,
}

/// Lowers a checked plan to interfaces and pipelines, with equal ones merged.
pub(crate) fn lower(plan: &Plan) -> Lowered {
    let mut interfaces = Vec::new();
    let pipelines = PipelineStates::new(plan, |pass| position_or_push(&mut interfaces, interface(pass)));
    Lowered { interfaces, pipelines }
}

fn interface(pass: &Pass) -> Interface {
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

/// Requests the subgroup size that the graph assumes and full subgroups, each if the device and the workgroup size
/// allow it.
pub(crate) fn subgroups(shader: &Reflection, limits: &SubgroupLimits) -> Subgroups {
    if !shader.has_subgroups() || limits.size == 0 {
        return Subgroups::default();
    }
    // A requested size must divide x and give few enough subgroups. Without a request, a SPIR-V 1.6 shader may get any
    // size, so full subgroups need a multiple of the largest.
    let selected = limits.can_request_size(shader.local_size);
    let full = selected || (limits.max_size > 0 && shader.local_size[0].is_multiple_of(limits.max_size));
    Subgroups { size: selected.then_some(limits.size), full }
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

    const LIMITS: SubgroupLimits =
        SubgroupLimits { size: 32, min_size: 32, max_size: 64, selectable: true, max_per_group: 8 };

    #[test]
    fn a_pass_that_binds_otherwise_has_a_pipeline_of_its_own() {
        let mut plan = plan();
        plan.passes[2].bindings[0].binding = 3;
        assert_eq!(lower(&plan).pipelines.states.len(), 3);
    }

    #[test]
    fn bindings_are_sorted_and_arrays_are_as_long_as_their_last_element() {
        let lowered = lower(&plan());
        let draw = &lowered.interfaces[lowered.pipelines.states[1].1];
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
        let asked = |local: [u32; 3], limits: SubgroupLimits| {
            let state =
                subgroups(&reflection(ShaderStage::Compute, local, Features::SUBGROUP_BASIC), &limits);
            (state.size, state.full)
        };
        assert_eq!(asked([256, 1, 1], LIMITS), (Some(32), true));
        // x is not a multiple of the size.
        assert_eq!(asked([16, 16, 1], LIMITS), (None, false));
        // Too many subgroups to request a size. Subgroups are then full only if x is a multiple of the largest size.
        assert_eq!(asked([32 * 9, 1, 1], LIMITS), (None, false));
        assert_eq!(asked([512, 1, 1], LIMITS), (None, true));
        let fixed = SubgroupLimits { selectable: false, ..LIMITS };
        assert_eq!(asked([256, 1, 1], fixed), (None, true));
        assert_eq!(asked([32, 1, 1], fixed), (None, false));
        let plain = subgroups(&reflection(ShaderStage::Compute, [256, 1, 1], Features::empty()), &LIMITS);
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
