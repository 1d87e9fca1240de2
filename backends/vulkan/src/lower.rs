//! The plan in Vulkan's terms, as plain data.
//!
//! Everything here is a pure function of the plan: stages, accesses, layouts, formats and blends become Vulkan's,
//! each step's barriers become the contents of one `VkDependencyInfo`, bindings become descriptor set layouts, and
//! passes that can share a pipeline do. Nothing calls the API, so that the lowering is tested on any machine; the
//! rest of the crate creates and records exactly what is listed here.

use crate::limits::SubgroupLimits;
use ash::vk;
use splatgraph_framework::plan::*;
use splatgraph_framework::shader::Reflection;

/// One side of a barrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Scope {
    pub stages: vk::PipelineStageFlags2,
    pub accesses: vk::AccessFlags2,
}

/// A barrier on all memory.
///
/// The plan's barriers on buffers become these: what they order, they order for all resources (so says the
/// specification of buffer barriers, too), the solver counts on that, and drivers do the same for both. Validation
/// layers of old see the order that a buffer barrier gives for that buffer alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MemoryBarrier {
    pub source: Scope,
    pub target: Scope,
}

/// A barrier on a whole image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ImageBarrier {
    pub resource: ResourceId,
    pub source: Scope,
    pub target: Scope,
    pub old: vk::ImageLayout,
    pub new: vk::ImageLayout,
}

/// What one `vkCmdPipelineBarrier2` waits for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Dependency {
    pub memory: Vec<MemoryBarrier>,
    pub images: Vec<ImageBarrier>,
}

impl Dependency {
    pub fn is_empty(&self) -> bool {
        self.memory.is_empty() && self.images.is_empty()
    }

    /// Adds a barrier on all memory; barriers between the same stages are one.
    fn add(&mut self, source: Scope, target: Scope) {
        let same =
            |b: &&mut MemoryBarrier| b.source.stages == source.stages && b.target.stages == target.stages;
        match self.memory.iter_mut().find(same) {
            Some(barrier) => {
                barrier.source.accesses |= source.accesses;
                barrier.target.accesses |= target.accesses;
            }
            None => self.memory.push(MemoryBarrier { source, target }),
        }
    }
}

/// A descriptor set layout (set 0) and the push constants beside it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Interface {
    pub bindings: Vec<InterfaceBinding>,
    pub push_bytes: u32,
    /// The stages that see the descriptors and the push constants.
    pub stages: vk::ShaderStageFlags,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct InterfaceBinding {
    pub binding: u32,
    pub kind: vk::DescriptorType,
    pub count: u32,
}

/// What a pipeline is made from. Equal ones are one pipeline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum PipelineState {
    Compute { shader: ShaderId, subgroups: Subgroups },
    Draw { vertex: ShaderId, fragment: ShaderId, topology: vk::PrimitiveTopology, targets: Vec<TargetState> },
}

/// What a compute pipeline asks of its subgroups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Subgroups {
    /// The size asked for, where the device lets a pipeline ask.
    pub size: Option<u32>,
    /// Every subgroup starts with all its lanes active.
    pub full: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TargetState {
    pub format: vk::Format,
    pub blend: Option<BlendState>,
}

/// `colour = source * source factor + target * target factor`, likewise for alpha.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BlendState {
    pub color: (vk::BlendFactor, vk::BlendFactor),
    pub alpha: (vk::BlendFactor, vk::BlendFactor),
}

/// A step, ready to be recorded: the barriers, and the pipeline to bind for its pass.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LoweredStep {
    pub pass: PassId,
    pub dependency: Dependency,
    /// Index into [`Lowered::pipelines`]; none for fills and exports.
    pub pipeline: Option<usize>,
}

/// A whole plan, lowered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Lowered {
    pub interfaces: Vec<Interface>,
    /// Pipelines, each with the index of its interface.
    pub pipelines: Vec<(PipelineState, usize)>,
    pub prologue: Vec<LoweredStep>,
    pub frame: Vec<LoweredStep>,
}

/// Lowers a plan that [`crate::limits::check`] accepted.
pub(crate) fn lower(plan: &Plan, subgroups: &SubgroupLimits) -> Lowered {
    let mut lowered =
        Lowered { interfaces: Vec::new(), pipelines: Vec::new(), prologue: Vec::new(), frame: Vec::new() };
    let mut steps = |steps: &[Step]| -> Vec<LoweredStep> {
        steps
            .iter()
            .map(|step| {
                let pass = plan.pass(step.pass);
                let pipeline = pipeline(plan, pass, subgroups).map(|state| {
                    let interface = position_or_push(&mut lowered.interfaces, interface(pass));
                    position_or_push(&mut lowered.pipelines, (state, interface))
                });
                LoweredStep { pass: step.pass, dependency: dependency(&step.barriers), pipeline }
            })
            .collect()
    };
    (lowered.prologue, lowered.frame) = (steps(&plan.prologue), steps(&plan.frame));
    lowered
}

fn position_or_push<T: PartialEq>(list: &mut Vec<T>, item: T) -> usize {
    list.iter().position(|other| *other == item).unwrap_or_else(|| {
        list.push(item);
        list.len() - 1
    })
}

pub(crate) fn dependency(barriers: &[Barrier]) -> Dependency {
    let mut dependency = Dependency::default();
    for barrier in barriers {
        let resource = barrier.resource;
        let source =
            Scope { stages: stages(barrier.source_stages), accesses: accesses(barrier.source_accesses) };
        let target =
            Scope { stages: stages(barrier.target_stages), accesses: accesses(barrier.target_accesses) };
        match barrier.layouts {
            None => dependency.add(source, target),
            Some((old, new)) => {
                let (old, new) = (layout(old), layout(new));
                dependency.images.push(ImageBarrier { resource, source, target, old, new });
                // Its order holds for everything as well.
                if !source.stages.is_empty() {
                    let order = |scope: Scope| Scope { accesses: vk::AccessFlags2::NONE, ..scope };
                    dependency.add(order(source), order(target));
                }
            }
        }
    }
    dependency
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

fn pipeline(plan: &Plan, pass: &Pass, limits: &SubgroupLimits) -> Option<PipelineState> {
    match &pass.work {
        Work::Dispatch { shader, .. } => Some(PipelineState::Compute {
            shader: *shader,
            subgroups: subgroups(&plan.shader(*shader).reflection, limits),
        }),
        Work::Draw { vertex, fragment, topology, targets, .. } => {
            let targets = targets.iter().filter_map(|target| match plan.resource(target.image).shape {
                Shape::Image { format: image, .. } => {
                    Some(TargetState { format: format(image), blend: blend(target.blend) })
                }
                Shape::Buffer { .. } => None,
            });
            Some(PipelineState::Draw {
                vertex: *vertex,
                fragment: *fragment,
                topology: self::topology(*topology),
                targets: targets.collect(),
            })
        }
        Work::Fill { .. } | Work::Export => None,
    }
}

/// A shader with subgroup operations runs with the size that the graph was told, and with full subgroups, where the
/// device and the workgroup's size allow it.
pub(crate) fn subgroups(shader: &Reflection, limits: &SubgroupLimits) -> Subgroups {
    if !shader.subgroups || limits.size == 0 {
        return Subgroups::default();
    }
    let invocations: u64 = shader.local_size.iter().map(|&n| n as u64).product();
    let whole = shader.local_size[0].is_multiple_of(limits.size);
    let fits = invocations <= limits.size as u64 * limits.max_per_group as u64;
    // With a size asked for, x must be a multiple of it and the subgroups must not be too many. With none asked for,
    // a SPIR-V 1.6 shader may get any size, so that full subgroups need a multiple of the largest.
    let selected = limits.selectable && fits && whole;
    let full = selected || (limits.max_size > 0 && shader.local_size[0].is_multiple_of(limits.max_size));
    Subgroups { size: selected.then_some(limits.size), full }
}

/// The layouts that the images of a plan are in before the first frame: none has been touched.
pub(crate) fn untouched(plan: &Plan) -> Vec<vk::ImageLayout> {
    vec![vk::ImageLayout::UNDEFINED; plan.resources.len()]
}

/// The barrier's old layout, given what the image is really in. A plan describes the steady state; in the first frame
/// an image that the frame before would have left in some layout is in that of the prologue, or has not been touched yet.
pub(crate) fn old_layout(planned: vk::ImageLayout, current: vk::ImageLayout) -> vk::ImageLayout {
    if planned == vk::ImageLayout::UNDEFINED { planned } else { current }
}

/// `CLEAR` stands for fills. The specification counts `vkCmdFillBuffer` among the clear commands; validation layers
/// before 1.3.280 counted it among the copies. Naming both stages costs nothing, as both run in the same place.
pub(crate) fn stages(stages: Stages) -> vk::PipelineStageFlags2 {
    const TABLE: [(Stages, vk::PipelineStageFlags2); 7] = [
        (Stages::INDIRECT, vk::PipelineStageFlags2::DRAW_INDIRECT),
        (Stages::VERTEX, vk::PipelineStageFlags2::VERTEX_SHADER),
        (Stages::FRAGMENT, vk::PipelineStageFlags2::FRAGMENT_SHADER),
        (Stages::COLOR_OUTPUT, vk::PipelineStageFlags2::COLOR_ATTACHMENT_OUTPUT),
        (Stages::COMPUTE, vk::PipelineStageFlags2::COMPUTE_SHADER),
        (Stages::COPY, vk::PipelineStageFlags2::COPY),
        (Stages::CLEAR, FILL),
    ];
    const FILL: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::from_raw(
        vk::PipelineStageFlags2::CLEAR.as_raw() | vk::PipelineStageFlags2::COPY.as_raw(),
    );
    TABLE
        .iter()
        .filter(|(stage, _)| stages.contains(*stage))
        .fold(vk::PipelineStageFlags2::NONE, |all, (_, flag)| all | *flag)
}

pub(crate) fn accesses(accesses: Accesses) -> vk::AccessFlags2 {
    const TABLE: [(Accesses, vk::AccessFlags2); 8] = [
        (Accesses::INDIRECT_READ, vk::AccessFlags2::INDIRECT_COMMAND_READ),
        (Accesses::UNIFORM_READ, vk::AccessFlags2::UNIFORM_READ),
        (Accesses::STORAGE_READ, vk::AccessFlags2::SHADER_STORAGE_READ),
        (Accesses::STORAGE_WRITE, vk::AccessFlags2::SHADER_STORAGE_WRITE),
        (Accesses::COLOR_READ, vk::AccessFlags2::COLOR_ATTACHMENT_READ),
        (Accesses::COLOR_WRITE, vk::AccessFlags2::COLOR_ATTACHMENT_WRITE),
        (Accesses::TRANSFER_READ, vk::AccessFlags2::TRANSFER_READ),
        (Accesses::TRANSFER_WRITE, vk::AccessFlags2::TRANSFER_WRITE),
    ];
    TABLE
        .iter()
        .filter(|(access, _)| accesses.contains(*access))
        .fold(vk::AccessFlags2::NONE, |all, (_, flag)| all | *flag)
}

pub(crate) fn layout(layout: Layout) -> vk::ImageLayout {
    match layout {
        Layout::Undefined => vk::ImageLayout::UNDEFINED,
        Layout::General => vk::ImageLayout::GENERAL,
        Layout::ColorTarget => vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
        Layout::TransferSource => vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
    }
}

pub(crate) fn format(format: Format) -> vk::Format {
    match format {
        Format::Rgba8Unorm => vk::Format::R8G8B8A8_UNORM,
        Format::Rgba16Float => vk::Format::R16G16B16A16_SFLOAT,
        Format::Rgba32Float => vk::Format::R32G32B32A32_SFLOAT,
        Format::R32Uint => vk::Format::R32_UINT,
        Format::R32Float => vk::Format::R32_SFLOAT,
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

/// None where the fragment replaces what is there.
pub(crate) fn blend(blend: Blend) -> Option<BlendState> {
    use vk::BlendFactor as F;
    match blend {
        Blend::Replace => None,
        Blend::PremultipliedOver => Some(BlendState {
            color: (F::ONE, F::ONE_MINUS_SRC_ALPHA),
            alpha: (F::ONE, F::ONE_MINUS_SRC_ALPHA),
        }),
        Blend::TransmittanceUnder => {
            Some(BlendState { color: (F::DST_ALPHA, F::ONE), alpha: (F::ZERO, F::ONE_MINUS_SRC_ALPHA) })
        }
    }
}

/// The usage of a buffer or an image; copies out are always allowed, so that any resource can be inspected.
pub(crate) fn buffer_usage(resource: &Resource) -> vk::BufferUsageFlags {
    const TABLE: [(Usage, vk::BufferUsageFlags); 5] = [
        (Usage::STORAGE, vk::BufferUsageFlags::STORAGE_BUFFER),
        (Usage::UNIFORM, vk::BufferUsageFlags::UNIFORM_BUFFER),
        (Usage::INDIRECT, vk::BufferUsageFlags::INDIRECT_BUFFER),
        (Usage::COPY_SOURCE, vk::BufferUsageFlags::TRANSFER_SRC),
        (Usage::COPY_TARGET, vk::BufferUsageFlags::TRANSFER_DST),
    ];
    let base = match resource.source {
        // The same for every plan, since plans share it; uploaded by a copy.
        Source::Scene { .. } => {
            return vk::BufferUsageFlags::STORAGE_BUFFER
                | vk::BufferUsageFlags::UNIFORM_BUFFER
                | vk::BufferUsageFlags::TRANSFER_SRC
                | vk::BufferUsageFlags::TRANSFER_DST;
        }
        Source::Frame { .. } | Source::Live => {
            vk::BufferUsageFlags::UNIFORM_BUFFER | vk::BufferUsageFlags::TRANSFER_SRC
        }
        Source::Transient => vk::BufferUsageFlags::TRANSFER_SRC,
    };
    TABLE.iter().filter(|(usage, _)| resource.usage.contains(*usage)).fold(base, |all, (_, flag)| all | *flag)
}

/// See [`buffer_usage`].
pub(crate) fn image_usage(usage: Usage) -> vk::ImageUsageFlags {
    let mut flags = vk::ImageUsageFlags::TRANSFER_SRC;
    if usage.contains(Usage::STORAGE) {
        flags |= vk::ImageUsageFlags::STORAGE;
    }
    if usage.contains(Usage::COLOR_TARGET) {
        flags |= vk::ImageUsageFlags::COLOR_ATTACHMENT;
    }
    flags
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;
    use splatgraph_framework::shader::ShaderStage;
    use vk::{AccessFlags2 as A, PipelineStageFlags2 as S};

    const LIMITS: SubgroupLimits =
        SubgroupLimits { size: 32, max_size: 64, selectable: true, max_per_group: 8 };

    #[test]
    fn every_stage_and_access_has_its_vulkan_counterpart() {
        let of_stages: Vec<S> = Stages::all().iter().map(stages).collect();
        assert_eq!(of_stages.len(), 7);
        assert!(of_stages.iter().all(|flags| !flags.is_empty()));
        assert_eq!(
            stages(Stages::all()),
            S::DRAW_INDIRECT
                | S::VERTEX_SHADER
                | S::FRAGMENT_SHADER
                | S::COLOR_ATTACHMENT_OUTPUT
                | S::COMPUTE_SHADER
                | S::COPY
                | S::CLEAR
        );
        let of_accesses: Vec<A> = Accesses::all().iter().map(accesses).collect();
        assert!(of_accesses.iter().all(|flags| flags.as_raw().count_ones() == 1));
        assert_eq!(accesses(Accesses::all()).as_raw().count_ones() as usize, of_accesses.len());
    }

    #[test]
    fn nothing_lowers_to_nothing() {
        assert_eq!(stages(Stages::empty()), S::NONE);
        assert_eq!(accesses(Accesses::empty()), A::NONE);
        assert!(dependency(&[]).is_empty());
    }

    #[test]
    fn a_steps_barriers_become_one_dependency_with_the_same_masks_and_layouts() {
        let lowered = dependency(&[
            barrier(
                WORDS,
                (Stages::COMPUTE, Accesses::STORAGE_WRITE),
                (Stages::COMPUTE | Stages::INDIRECT, Accesses::STORAGE_READ | Accesses::INDIRECT_READ),
                None,
            ),
            barrier(
                COLOR,
                (Stages::COPY, Accesses::TRANSFER_READ),
                (Stages::COLOR_OUTPUT, Accesses::COLOR_READ | Accesses::COLOR_WRITE),
                Some((Layout::Undefined, Layout::ColorTarget)),
            ),
        ]);
        let memory = [
            MemoryBarrier {
                source: Scope { stages: S::COMPUTE_SHADER, accesses: A::SHADER_STORAGE_WRITE },
                target: Scope {
                    stages: S::COMPUTE_SHADER | S::DRAW_INDIRECT,
                    accesses: A::SHADER_STORAGE_READ | A::INDIRECT_COMMAND_READ,
                },
            },
            // What the image's barrier orders, it orders for all memory.
            MemoryBarrier {
                source: Scope { stages: S::COPY, accesses: A::NONE },
                target: Scope { stages: S::COLOR_ATTACHMENT_OUTPUT, accesses: A::NONE },
            },
        ];
        let images = [ImageBarrier {
            resource: COLOR,
            source: Scope { stages: S::COPY, accesses: A::TRANSFER_READ },
            target: Scope {
                stages: S::COLOR_ATTACHMENT_OUTPUT,
                accesses: A::COLOR_ATTACHMENT_READ | A::COLOR_ATTACHMENT_WRITE,
            },
            old: vk::ImageLayout::UNDEFINED,
            new: vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
        }];
        assert_eq!(lowered, Dependency { memory: memory.into(), images: images.into() });
    }

    #[test]
    fn passes_of_one_shader_and_state_share_a_pipeline() {
        let lowered = lower(&plan(), &LIMITS);
        assert_eq!(lowered.pipelines.len(), 2);
        let pipelines: Vec<_> = lowered.frame.iter().map(|step| step.pipeline).collect();
        assert_eq!(pipelines, [Some(0), Some(0), Some(1), None]);
        assert_eq!(lowered.prologue[0].pipeline, None);
    }

    #[test]
    fn a_pass_that_binds_otherwise_has_a_pipeline_of_its_own() {
        let mut plan = plan();
        plan.passes[2].bindings[0].binding = 3;
        assert_eq!(lower(&plan, &LIMITS).pipelines.len(), 3);
    }

    #[test]
    fn bindings_are_sorted_and_arrays_are_as_long_as_their_last_element() {
        let lowered = lower(&plan(), &LIMITS);
        let draw = &lowered.interfaces[lowered.pipelines[1].1];
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
    fn a_draws_state_holds_the_formats_and_blends_of_its_targets() {
        let lowered = lower(&plan(), &LIMITS);
        let over = BlendState {
            color: (vk::BlendFactor::ONE, vk::BlendFactor::ONE_MINUS_SRC_ALPHA),
            alpha: (vk::BlendFactor::ONE, vk::BlendFactor::ONE_MINUS_SRC_ALPHA),
        };
        let state = PipelineState::Draw {
            vertex: ShaderId(1),
            fragment: ShaderId(2),
            topology: vk::PrimitiveTopology::TRIANGLE_STRIP,
            targets: vec![TargetState { format: vk::Format::R16G16B16A16_SFLOAT, blend: Some(over) }],
        };
        assert_eq!(lowered.pipelines[1].0, state);
        assert_eq!(blend(Blend::Replace), None);
    }

    #[test]
    fn subgroup_shaders_run_full_and_with_the_size_that_was_told_where_that_is_allowed() {
        let asked = |local: [u32; 3], limits: SubgroupLimits| {
            let state = subgroups(&reflection(ShaderStage::Compute, local, true), &limits);
            (state.size, state.full)
        };
        assert_eq!(asked([256, 1, 1], LIMITS), (Some(32), true));
        // x is not a multiple of the size.
        assert_eq!(asked([16, 16, 1], LIMITS), (None, false));
        // Too many subgroups for a size to be asked for, and full only if full with any size.
        assert_eq!(asked([32 * 9, 1, 1], LIMITS), (None, false));
        assert_eq!(asked([512, 1, 1], LIMITS), (None, true));
        let fixed = SubgroupLimits { selectable: false, ..LIMITS };
        assert_eq!(asked([256, 1, 1], fixed), (None, true));
        assert_eq!(asked([32, 1, 1], fixed), (None, false));
        let plain = subgroups(&reflection(ShaderStage::Compute, [256, 1, 1], false), &LIMITS);
        assert_eq!(plain, Subgroups::default());
    }

    #[test]
    fn an_image_that_was_not_touched_yet_has_no_layout_to_come_from() {
        let (left, undefined) = (vk::ImageLayout::TRANSFER_SRC_OPTIMAL, vk::ImageLayout::UNDEFINED);
        assert_eq!(old_layout(left, undefined), undefined);
        assert_eq!(old_layout(left, left), left);
        // A plan that discards keeps doing so.
        assert_eq!(old_layout(undefined, left), undefined);
        assert_eq!(untouched(&plan()), [undefined; 5]);
    }

    #[test]
    fn every_resource_can_be_copied_from_and_scene_planes_have_one_usage() {
        for resource in &plan().resources {
            assert!(buffer_usage(resource).contains(vk::BufferUsageFlags::TRANSFER_SRC));
        }
        assert!(image_usage(Usage::empty()).contains(vk::ImageUsageFlags::TRANSFER_SRC));
        let mut plane = plan().resources[SPLATS.index()].clone();
        let usage = buffer_usage(&plane);
        plane.usage = Usage::UNIFORM;
        assert_eq!(buffer_usage(&plane), usage);
    }
}
