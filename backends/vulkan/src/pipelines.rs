//! Pipelines and descriptor sets, made once per plan.
//!
//! The lists come from [`crate::lower`]: an interface is a descriptor set layout with a pipeline layout, and each
//! pipeline names the interface that it is made for. A pass that binds something of the frame has one descriptor set per
//! frame in flight, any other pass has one. What is bound is written when the set is made, but for buffers that come with a
//! frame ([`crate::given`]), and written again where it changes.

use crate::error::api;
use crate::gpu::{Gpu, Owned};
use crate::lower::{Interface, Lowered, PipelineState, Subgroups, TargetState, descriptor};
use crate::resources::Resources;
use ash::vk;
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT, Progress};
use splatgraph_framework::ir::{Pass, ResourceId, ShaderId, Source};
use splatgraph_framework::plan::Plan;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;

pub(crate) struct PipelineLayout {
    pub raw: Owned<vk::PipelineLayout>,
    pub set: Owned<vk::DescriptorSetLayout>,
    pub stages: vk::ShaderStageFlags,
}

pub(crate) struct Pipeline {
    pub raw: Owned<vk::Pipeline>,
    pub bind_point: vk::PipelineBindPoint,
    /// Index into [`Pipelines::layouts`].
    pub layout: usize,
}

pub(crate) struct Pipelines {
    pub pipelines: Vec<Pipeline>,
    pub layouts: Vec<PipelineLayout>,
}

impl Pipelines {
    pub fn new(
        gpu: &Arc<Gpu>,
        plan: &Plan,
        lowered: &Lowered,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Pipelines, BackendError> {
        let layouts: Vec<PipelineLayout> =
            lowered.interfaces.iter().map(|interface| layout(gpu, interface)).collect::<Result<_, _>>()?;
        // Needed only until the pipelines are made.
        let mut modules = HashMap::new();
        let mut pipelines = Vec::new();
        for (done, (state, interface)) in lowered.pipelines.iter().enumerate() {
            let shaders = match *state {
                PipelineState::Compute { shader, .. } => vec![shader],
                PipelineState::Draw { vertex, fragment, .. } => vec![vertex, fragment],
            };
            let name = &plan.shader(shaders[0]).name;
            progress(Progress::Pipeline { done, of: lowered.pipelines.len(), shader: name });
            for shader in shaders {
                if let Entry::Vacant(entry) = modules.entry(shader) {
                    entry.insert(module(gpu, plan, shader)?);
                }
            }
            let raw = match state {
                PipelineState::Compute { shader, subgroups } => {
                    compute(gpu, *modules[shader], *subgroups, *layouts[*interface].raw)
                }
                PipelineState::Draw { vertex, fragment, topology, targets } => draw(
                    gpu,
                    [*modules[vertex], *modules[fragment]],
                    *topology,
                    targets,
                    *layouts[*interface].raw,
                ),
            };
            let raw = Owned::new(
                gpu,
                raw.map_err(|answer| match api("vkCreatePipelines")(answer) {
                    BackendError::Api { call, answer } => {
                        BackendError::Api { call, answer: format!("{answer} for `{name}`") }
                    }
                    other => other,
                })?,
            );
            gpu.name(*raw, name);
            let bind_point = match state {
                PipelineState::Compute { .. } => vk::PipelineBindPoint::COMPUTE,
                PipelineState::Draw { .. } => vk::PipelineBindPoint::GRAPHICS,
            };
            pipelines.push(Pipeline { raw, bind_point, layout: *interface });
        }
        Ok(Pipelines { pipelines, layouts })
    }
}

fn layout(gpu: &Arc<Gpu>, interface: &Interface) -> Result<PipelineLayout, BackendError> {
    let bindings: Vec<_> = interface
        .bindings
        .iter()
        .map(|b| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(b.binding)
                .descriptor_type(b.kind)
                .descriptor_count(b.count)
                .stage_flags(interface.stages)
        })
        .collect();
    let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
    // SAFETY: `info` is complete and lives until the call returns.
    let set = unsafe { gpu.device.create_descriptor_set_layout(&info, None) }
        .map_err(api("vkCreateDescriptorSetLayout"))?;
    let set = Owned::new(gpu, set);
    let sets = [*set];
    let ranges = [vk::PushConstantRange::default().stage_flags(interface.stages).size(interface.push_bytes)];
    let info = vk::PipelineLayoutCreateInfo::default()
        .set_layouts(&sets)
        .push_constant_ranges(if interface.push_bytes > 0 { &ranges } else { &[] });
    // SAFETY: as above; the set layout is alive.
    let raw =
        unsafe { gpu.device.create_pipeline_layout(&info, None) }.map_err(api("vkCreatePipelineLayout"))?;
    Ok(PipelineLayout { raw: Owned::new(gpu, raw), set, stages: interface.stages })
}

fn module(gpu: &Arc<Gpu>, plan: &Plan, shader: ShaderId) -> Result<Owned<vk::ShaderModule>, BackendError> {
    let shader = plan.shader(shader);
    let info = vk::ShaderModuleCreateInfo::default().code(&shader.spirv);
    // SAFETY: the words are a compiler's output.
    let module =
        unsafe { gpu.device.create_shader_module(&info, None) }.map_err(api("vkCreateShaderModule"))?;
    gpu.name(module, &shader.name);
    Ok(Owned::new(gpu, module))
}

fn compute(
    gpu: &Gpu,
    module: vk::ShaderModule,
    subgroups: Subgroups,
    layout: vk::PipelineLayout,
) -> Result<vk::Pipeline, vk::Result> {
    let mut size = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default();
    let mut stage = vk::PipelineShaderStageCreateInfo::default()
        .stage(vk::ShaderStageFlags::COMPUTE)
        .module(module)
        .name(c"main");
    if subgroups.full {
        stage = stage.flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS);
    }
    if let Some(lanes) = subgroups.size {
        size = size.required_subgroup_size(lanes);
        stage = stage.push_next(&mut size);
    }
    let info = vk::ComputePipelineCreateInfo::default().stage(stage).layout(layout);
    // SAFETY: `info` and its chain live until the call returns; module and layout are alive.
    single(unsafe { gpu.device.create_compute_pipelines(gpu.pipeline_cache, &[info], None) })
}

fn draw(
    gpu: &Gpu,
    [vertex, fragment]: [vk::ShaderModule; 2],
    topology: vk::PrimitiveTopology,
    targets: &[TargetState],
    layout: vk::PipelineLayout,
) -> Result<vk::Pipeline, vk::Result> {
    let stage = |stage, module| {
        vk::PipelineShaderStageCreateInfo::default().stage(stage).module(module).name(c"main")
    };
    let stages =
        [stage(vk::ShaderStageFlags::VERTEX, vertex), stage(vk::ShaderStageFlags::FRAGMENT, fragment)];
    let no_vertices = vk::PipelineVertexInputStateCreateInfo::default();
    let assembly = vk::PipelineInputAssemblyStateCreateInfo::default().topology(topology);
    let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
    let raster = vk::PipelineRasterizationStateCreateInfo::default()
        .polygon_mode(vk::PolygonMode::FILL)
        .cull_mode(vk::CullModeFlags::NONE)
        .line_width(1.0);
    let samples =
        vk::PipelineMultisampleStateCreateInfo::default().rasterization_samples(vk::SampleCountFlags::TYPE_1);
    let attachments: Vec<_> = targets.iter().map(attachment).collect();
    let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(&attachments);
    let dynamic = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
    let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamic);
    let formats: Vec<_> = targets.iter().map(|target| target.format).collect();
    let mut rendering = vk::PipelineRenderingCreateInfo::default().color_attachment_formats(&formats);
    let info = vk::GraphicsPipelineCreateInfo::default()
        .stages(&stages)
        .vertex_input_state(&no_vertices)
        .input_assembly_state(&assembly)
        .viewport_state(&viewport)
        .rasterization_state(&raster)
        .multisample_state(&samples)
        .color_blend_state(&blend)
        .dynamic_state(&dynamic)
        .layout(layout)
        .push_next(&mut rendering);
    // SAFETY: `info` and all it points to live until the call returns; modules and layout are alive.
    single(unsafe { gpu.device.create_graphics_pipelines(gpu.pipeline_cache, &[info], None) })
}

fn attachment(target: &TargetState) -> vk::PipelineColorBlendAttachmentState {
    let state =
        vk::PipelineColorBlendAttachmentState::default().color_write_mask(vk::ColorComponentFlags::RGBA);
    match target.blend {
        None => state,
        Some(blend) => state
            .blend_enable(true)
            .src_color_blend_factor(blend.color.0)
            .dst_color_blend_factor(blend.color.1)
            .color_blend_op(vk::BlendOp::ADD)
            .src_alpha_blend_factor(blend.alpha.0)
            .dst_alpha_blend_factor(blend.alpha.1)
            .alpha_blend_op(vk::BlendOp::ADD),
    }
}

/// The one pipeline that was asked for. On an error Vulkan gives null handles, which need no destroying.
fn single(
    made: Result<Vec<vk::Pipeline>, (Vec<vk::Pipeline>, vk::Result)>,
) -> Result<vk::Pipeline, vk::Result> {
    match made {
        Ok(pipelines) => pipelines.first().copied().ok_or(vk::Result::ERROR_UNKNOWN),
        Err((_, answer)) => Err(answer),
    }
}

/// Every pass's descriptor sets.
pub(crate) struct DescriptorSets {
    /// By pass; null for passes that bind nothing.
    sets: Vec<[vk::DescriptorSet; FRAMES_IN_FLIGHT]>,
    // Frees the sets.
    _pool: Option<Owned<vk::DescriptorPool>>,
}

impl DescriptorSets {
    pub fn new(
        gpu: &Arc<Gpu>,
        plan: &Plan,
        lowered: &Lowered,
        pipelines: &Pipelines,
        resources: &Resources,
    ) -> Result<DescriptorSets, BackendError> {
        let mut sets = vec![[vk::DescriptorSet::null(); FRAMES_IN_FLIGHT]; plan.passes.len()];
        let steps = lowered.prologue.iter().chain(&lowered.frame);
        let bound: Vec<(&Pass, usize, usize)> = steps
            .filter_map(|step| Some((step, step.pipeline?)))
            .map(|(step, pipeline)| {
                (plan.pass(step.pass), step.pass.index(), pipelines.pipelines[pipeline].layout)
            })
            .filter(|(pass, ..)| !pass.bindings.is_empty())
            .collect();
        let Some(pool) = pool(gpu, plan, &bound, lowered)? else {
            return Ok(DescriptorSets { sets, _pool: None });
        };
        for &(pass, index, layout) in &bound {
            let made = copies(plan, pass);
            let layouts = vec![*pipelines.layouts[layout].set; made];
            let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(*pool).set_layouts(&layouts);
            // SAFETY: the pool was made for exactly these sets.
            let new = unsafe { gpu.device.allocate_descriptor_sets(&info) }
                .map_err(api("vkAllocateDescriptorSets"))?;
            for (slot, &set) in new.iter().enumerate() {
                gpu.name(set, &pass.name);
                write(gpu, pass, set, slot, resources, |id| !is_given(plan, id));
            }
            sets[index] = std::array::from_fn(|slot| new[slot % made]);
        }
        Ok(DescriptorSets { sets, _pool: Some(pool) })
    }

    /// Points all that this slot's sets bind of `changed` to where it is now. No frame that uses these sets is in flight.
    pub fn rewrite(
        &self,
        gpu: &Gpu,
        plan: &Plan,
        resources: &Resources,
        slot: usize,
        changed: &[ResourceId],
    ) {
        if changed.is_empty() {
            return;
        }
        for (pass, sets) in plan.passes.iter().zip(&self.sets) {
            // Passes that no step runs have none.
            if sets[slot] != vk::DescriptorSet::null() {
                write(gpu, pass, sets[slot], slot, resources, |id| changed.contains(&id));
            }
        }
    }

    /// The set of a pass (by index) for the frame in this slot.
    pub fn of(&self, pass: usize, slot: usize) -> vk::DescriptorSet {
        self.sets[pass][slot]
    }
}

/// How many sets a pass needs.
fn copies(plan: &Plan, pass: &Pass) -> usize {
    let per_frame = pass.bindings.iter().any(|b| plan.resource(b.resource).source.is_per_frame());
    if per_frame { FRAMES_IN_FLIGHT } else { 1 }
}

fn pool(
    gpu: &Arc<Gpu>,
    plan: &Plan,
    bound: &[(&Pass, usize, usize)],
    lowered: &Lowered,
) -> Result<Option<Owned<vk::DescriptorPool>>, BackendError> {
    let mut sets = 0;
    let mut sizes: Vec<vk::DescriptorPoolSize> = Vec::new();
    for &(pass, _, layout) in bound {
        let copies = copies(plan, pass) as u32;
        sets += copies;
        for binding in &lowered.interfaces[layout].bindings {
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

fn is_given(plan: &Plan, id: ResourceId) -> bool {
    matches!(plan.resource(id).source, Source::Given { .. })
}

/// Writes those bindings of a pass whose resources are `wanted`.
fn write(
    gpu: &Gpu,
    pass: &Pass,
    set: vk::DescriptorSet,
    slot: usize,
    resources: &Resources,
    wanted: impl Fn(ResourceId) -> bool,
) {
    for binding in pass.bindings.iter().filter(|binding| wanted(binding.resource)) {
        let write = vk::WriteDescriptorSet::default()
            .dst_set(set)
            .dst_binding(binding.binding)
            .dst_array_element(binding.element)
            .descriptor_type(descriptor(binding.kind));
        let buffer;
        let image;
        let write = if let Some(view) = resources.image(binding.resource) {
            image = [vk::DescriptorImageInfo::default()
                .image_view(*view.view)
                .image_layout(vk::ImageLayout::GENERAL)];
            write.image_info(&image)
        } else {
            let (held, bytes) = resources.part(binding.resource, slot);
            buffer = [vk::DescriptorBufferInfo::default().buffer(*held.raw).range(bytes)];
            write.buffer_info(&buffer)
        };
        // SAFETY: the set is not in use, the resources are alive, and the kinds fit (checked with the plan).
        unsafe { gpu.device.update_descriptor_sets(&[write], &[]) };
    }
}
