//! Creates the pipelines of a plan and their layouts, which [`crate::lower`] lists.
//!
//! A plan reuses the pipelines of other plans that are still loaded, so a rebuilt plan compiles only the changed ones,
//! even on drivers whose pipeline cache stores nothing.

use crate::error::api;
use crate::gpu::{Owned, Pipeline, PipelineLayout, VulkanGpu};
use crate::lower::{self, Interface, PipelineKey, Subgroups};
use ash::vk;
use splatgraph_api::BackendError;
use splatgraph_framework::ir::{Blend, DepthAccess, Format, PassId, ShaderId, Topology};
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{BlendFactors, NextPipeline, PipelineState, PipelineStates};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::num::NonZero;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use std::thread;

/// The pipelines of one plan.
pub struct Pipelines {
    pipelines: Vec<Arc<Pipeline>>,
    lowered: PipelineStates<Interface>,
}

impl Pipelines {
    /// Creates a plan's pipelines on several threads, and reuses existing ones. Calls `next` before it waits for each
    /// new pipeline; an error from `next` stops the creation.
    pub(crate) fn new(
        gpu: &Arc<VulkanGpu>,
        plan: &Plan,
        next: &mut dyn FnMut(NextPipeline) -> Result<(), BackendError>,
    ) -> Result<Pipelines, BackendError> {
        let lowered = PipelineStates::new(plan, lower::interface);
        let states = &lowered.states;
        let key = |(state, interface): &(_, _)| PipelineKey::new(plan, state, interface, &gpu.common.limits);
        let keys: Vec<PipelineKey> = states.iter().map(key).collect();
        let mut pipelines: Vec<Option<Arc<Pipeline>>> =
            keys.iter().map(|key| gpu.find_pipeline(key)).collect();
        let missing: Vec<usize> = (0..states.len()).filter(|at| pipelines[*at].is_none()).collect();
        let (mut layouts, mut modules) = (HashMap::new(), HashMap::new());
        for (state, interface) in missing.iter().map(|at| &states[*at]) {
            if let Entry::Vacant(entry) = layouts.entry(interface) {
                entry.insert(Arc::new(layout(gpu, interface)?));
            }
            for shader in state.shaders() {
                if let Entry::Vacant(entry) = modules.entry(shader) {
                    entry.insert(module(gpu, plan, shader)?);
                }
            }
        }
        let create = |number: usize| {
            let at = missing[number];
            let (state, interface) = &states[at];
            let pipeline = Arc::new(create(gpu, &keys[at], (state, &modules), &layouts[interface])?);
            gpu.share_pipeline(keys[at].clone(), &pipeline);
            Ok(pipeline)
        };
        let next = |number: usize| next(lowered.next(missing[number]));
        for (at, pipeline) in missing.iter().zip(in_parallel(missing.len(), create, next)?) {
            pipelines[*at] = Some(pipeline);
        }
        let pipelines = pipelines.into_iter().flatten().collect();
        Ok(Pipelines { pipelines, lowered })
    }

    pub(crate) fn find(&self, pass: PassId) -> Option<(&Pipeline, &PipelineLayout)> {
        let pipeline = &self.pipelines[self.lowered.of_pass[pass.index()]?];
        Some((pipeline, &pipeline.layout))
    }

    pub(crate) fn interface(&self, pass: PassId) -> Option<&Interface> {
        Some(&self.lowered.states[self.lowered.of_pass[pass.index()]?].1)
    }
}

/// Calls `create` for the numbers below `count`, on several threads, and returns the results in order.
///
/// Calls `next` with each number before it waits for that result, so a call that hangs is the last one announced. The
/// first error of either stops the rest; calls that have begun are finished first.
fn in_parallel<T: Send>(
    count: usize,
    create: impl Fn(usize) -> Result<T, BackendError> + Sync,
    mut next: impl FnMut(usize) -> Result<(), BackendError>,
) -> Result<Vec<T>, BackendError> {
    let threads = thread::available_parallelism().map_or(1, NonZero::get).min(count);
    let (begun, stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
    let (sender, created) = mpsc::channel();
    thread::scope(|scope| {
        for thread in 0..threads {
            let (sender, create, begun, stopped) = (sender.clone(), &create, &begun, &stopped);
            let work = move || {
                while !stopped.load(Ordering::Relaxed) {
                    let at = begun.fetch_add(1, Ordering::Relaxed);
                    if at >= count || sender.send((at, create(at))).is_err() {
                        break;
                    }
                }
            };
            match thread::Builder::new().spawn_scoped(scope, work) {
                Ok(_) => {}
                // The limit of processes may be reached; one thread is enough.
                Err(_) if thread > 0 => break,
                Err(error) => {
                    let call = "the start of a thread for the driver's compiler";
                    return Err(BackendError::Api { call, answer: error.to_string() });
                }
            }
        }
        drop(sender);
        let mut early = HashMap::new();
        let mut in_order = |at| {
            next(at)?;
            loop {
                if let Some(result) = early.remove(&at) {
                    return result;
                }
                let (other, result) = created.recv().expect("a thread ends after it has sent its results");
                early.insert(other, result);
            }
        };
        let all = (0..count).map(&mut in_order).collect();
        stopped.store(true, Ordering::Relaxed);
        all
    })
}

fn create(
    gpu: &Arc<VulkanGpu>,
    key: &PipelineKey,
    (state, modules): (&PipelineState, &HashMap<ShaderId, Owned<vk::ShaderModule>>),
    layout: &Arc<PipelineLayout>,
) -> Result<Pipeline, BackendError> {
    let (raw, bind_point) = match state {
        PipelineState::Compute(shader) => {
            (compute(gpu, *modules[shader], key.subgroups, *layout.raw), vk::PipelineBindPoint::COMPUTE)
        }
        PipelineState::Draw { vertex, fragment, topology, targets, depth } => {
            let modules = [*modules[vertex], *modules[fragment]];
            let raw = draw(gpu, modules, *topology, (targets, *depth), *layout.raw);
            (raw, vk::PipelineBindPoint::GRAPHICS)
        }
    };
    let raw = raw.map_err(|answer| match api("vkCreatePipelines")(answer) {
        BackendError::Api { call, answer } => {
            BackendError::Api { call, answer: format!("{answer} for `{}`", key.name) }
        }
        other => other,
    })?;
    gpu.name(raw, &key.name);
    Ok(Pipeline { raw: Owned::new(gpu, raw), bind_point, layout: layout.clone() })
}

fn layout(gpu: &Arc<VulkanGpu>, interface: &Interface) -> Result<PipelineLayout, BackendError> {
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

fn module(
    gpu: &Arc<VulkanGpu>,
    plan: &Plan,
    shader: ShaderId,
) -> Result<Owned<vk::ShaderModule>, BackendError> {
    let shader = plan.shader(shader);
    let info = vk::ShaderModuleCreateInfo::default().code(&shader.spirv);
    // SAFETY: the words are a compiler's output.
    let module =
        unsafe { gpu.device.create_shader_module(&info, None) }.map_err(api("vkCreateShaderModule"))?;
    gpu.name(module, &shader.name);
    Ok(Owned::new(gpu, module))
}

fn compute(
    gpu: &VulkanGpu,
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
    gpu: &VulkanGpu,
    [vertex, fragment]: [vk::ShaderModule; 2],
    topology: Topology,
    (targets, depth): (&[(Format, Blend)], Option<DepthAccess>),
    layout: vk::PipelineLayout,
) -> Result<vk::Pipeline, vk::Result> {
    let stage = |stage, module| {
        vk::PipelineShaderStageCreateInfo::default().stage(stage).module(module).name(c"main")
    };
    let stages =
        [stage(vk::ShaderStageFlags::VERTEX, vertex), stage(vk::ShaderStageFlags::FRAGMENT, fragment)];
    let no_vertices = vk::PipelineVertexInputStateCreateInfo::default();
    let assembly = vk::PipelineInputAssemblyStateCreateInfo::default().topology(lower::topology(topology));
    let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
    let raster = vk::PipelineRasterizationStateCreateInfo::default()
        .polygon_mode(vk::PolygonMode::FILL)
        .cull_mode(vk::CullModeFlags::NONE)
        .line_width(1.0);
    let samples =
        vk::PipelineMultisampleStateCreateInfo::default().rasterization_samples(vk::SampleCountFlags::TYPE_1);
    let attachments: Vec<_> = targets.iter().map(|&(_, blend)| attachment(blend)).collect();
    let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(&attachments);
    // Reversed: the near plane has depth 1, and nearer fragments greater depths.
    let tests = vk::PipelineDepthStencilStateCreateInfo::default()
        .depth_test_enable(depth.is_some())
        .depth_write_enable(depth.is_some_and(|access| access != DepthAccess::Test))
        .depth_compare_op(vk::CompareOp::GREATER);
    let dynamic = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
    let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamic);
    let formats: Vec<_> = targets.iter().map(|&(format, _)| lower::format(format)).collect();
    let mut rendering = vk::PipelineRenderingCreateInfo::default().color_attachment_formats(&formats);
    if depth.is_some() {
        rendering = rendering.depth_attachment_format(lower::format(Format::Depth32Float));
    }
    let info = vk::GraphicsPipelineCreateInfo::default()
        .stages(&stages)
        .vertex_input_state(&no_vertices)
        .input_assembly_state(&assembly)
        .viewport_state(&viewport)
        .rasterization_state(&raster)
        .multisample_state(&samples)
        .depth_stencil_state(&tests)
        .color_blend_state(&blend)
        .dynamic_state(&dynamic)
        .layout(layout)
        .push_next(&mut rendering);
    // SAFETY: `info` and all it points to live until the call returns; modules and layout are alive.
    single(unsafe { gpu.device.create_graphics_pipelines(gpu.pipeline_cache, &[info], None) })
}

fn attachment(blend: Blend) -> vk::PipelineColorBlendAttachmentState {
    let state =
        vk::PipelineColorBlendAttachmentState::default().color_write_mask(vk::ColorComponentFlags::RGBA);
    match BlendFactors::of(blend) {
        None => state,
        Some(BlendFactors { color, alpha }) => state
            .blend_enable(true)
            .src_color_blend_factor(lower::factor(color.0))
            .dst_color_blend_factor(lower::factor(color.1))
            .color_blend_op(vk::BlendOp::ADD)
            .src_alpha_blend_factor(lower::factor(alpha.0))
            .dst_alpha_blend_factor(lower::factor(alpha.1))
            .alpha_blend_op(vk::BlendOp::ADD),
    }
}

/// Returns the only pipeline of a creation call. On an error, Vulkan returns null handles, which need no destruction.
fn single(
    made: Result<Vec<vk::Pipeline>, (Vec<vk::Pipeline>, vk::Result)>,
) -> Result<vk::Pipeline, vk::Result> {
    match made {
        Ok(pipelines) => pipelines.first().copied().ok_or(vk::Result::ERROR_UNKNOWN),
        Err((_, answer)) => Err(answer),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn failure(call: usize) -> BackendError {
        BackendError::Api { call: "test", answer: call.to_string() }
    }

    #[test]
    fn results_of_several_threads_are_in_order_and_each_is_announced_before_its_wait() {
        // Earlier calls take longer, so that later ones finish first.
        let slow = |at: usize| {
            thread::sleep(Duration::from_millis(8 - at as u64));
            Ok(10 * at)
        };
        let mut announced = Vec::new();
        let next = |at| {
            announced.push(at);
            Ok(())
        };
        assert_eq!(in_parallel(8, slow, next).expect("no failure"), [0, 10, 20, 30, 40, 50, 60, 70]);
        assert_eq!(announced, [0, 1, 2, 3, 4, 5, 6, 7]);
        assert!(in_parallel(0, slow, |_| Ok(())).expect("nothing to do").is_empty());
    }

    #[test]
    fn the_first_error_in_order_is_returned_and_an_error_of_the_caller_stops_the_rest() {
        let odd = |at: usize| if at % 2 == 1 { Err(failure(at)) } else { Ok(at) };
        let error = in_parallel(6, odd, |_| Ok(())).expect_err("the second call fails");
        assert_eq!(error.to_string(), failure(1).to_string());
        let begun = AtomicUsize::new(0);
        let count = |at| {
            begun.fetch_add(1, Ordering::Relaxed);
            thread::sleep(Duration::from_millis(1));
            Ok(at)
        };
        let stop = |at| if at == 2 { Err(failure(at)) } else { Ok(()) };
        let error = in_parallel(1000, count, stop).expect_err("the caller stops");
        assert_eq!(error.to_string(), failure(2).to_string());
        assert!(begun.into_inner() < 1000);
    }
}
