//! Creates the pipelines and fences of a plan, and divides its passes into encoders, once per plan.

use crate::apple::gpu::{self, MetalGpu};
use crate::apple::memory::format;
use crate::apple::objc;
use crate::features::LANES;
use crate::lower::{self, Lowered};
use crate::sync::Division;
use crate::walk::Walked;
use metal::*;
use splatgraph_api::BackendError;
use splatgraph_framework::ir::{Blend, DepthAccess, Format, Msl, PassId, ShaderId, Topology, Work};
use splatgraph_framework::msl::add_msl;
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{BlendFactor, BlendFactors, NextPipeline, PipelineState};
use std::borrow::Cow;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Arc, Mutex};

/// A pipeline, with the parameters that Metal takes with each of its commands.
#[derive(Clone)]
pub(crate) enum Pipeline {
    Compute { raw: ComputePipelineState, threads: MTLSize },
    Draw { raw: RenderPipelineState, primitives: MTLPrimitiveType, depth: Option<DepthStencilState> },
}

/// The pipelines of one plan.
pub struct Pipelines {
    pipelines: Vec<Pipeline>,
    pub(crate) lowered: Lowered,
    pub(crate) order: Arc<Order>,
}

/// A plan's encoders and their fences. They are shared with each recording until it has been submitted.
pub(crate) struct Order {
    pub walked: Mutex<Walked>,
    /// The fences of each division: first merged, then one encoder per pass.
    fences: [Vec<Fence>; 2],
    /// The export pass. The draw into a window waits for the fences of its encoder.
    pub export: Option<PassId>,
}

impl Order {
    pub fn fence(&self, division: Division, fence: u32) -> &Fence {
        &self.fences[usize::from(division == Division::Passes)][fence as usize]
    }
}

impl Pipelines {
    /// Creates a plan's pipelines and fences; calls `next` before each pipeline, and stops at its error.
    pub(crate) fn new(
        gpu: &MetalGpu,
        plan: &Plan,
        next: &mut dyn FnMut(NextPipeline) -> Result<(), BackendError>,
    ) -> Result<Pipelines, BackendError> {
        let plan = &*translated(plan)?;
        let lowered = lower::lower(plan)?;
        let mut functions = HashMap::new();
        let mut pipelines = Vec::new();
        for (done, (state, ())) in lowered.pipelines.states.iter().enumerate() {
            next(lowered.pipelines.next(done))?;
            pipelines.push(objc::pool(|| {
                for shader in state.shaders() {
                    if let Entry::Vacant(entry) = functions.entry(shader) {
                        entry.insert(function(gpu, plan, shader)?);
                    }
                }
                match state {
                    PipelineState::Compute(shader) => compute(gpu, plan, *shader, &functions[shader]),
                    PipelineState::Draw { vertex, fragment, topology, targets, depth } => {
                        let name = &plan.shader(*vertex).name;
                        let functions = [&*functions[vertex], &*functions[fragment]];
                        draw(gpu, name, functions, *topology, (targets, *depth))
                    }
                }
            })?);
        }
        let walked = Walked::new(plan);
        let fences = [Division::Merged, Division::Passes]
            .map(|division| (0..walked.encoders(division).fences).map(|_| gpu.device.new_fence()).collect());
        let export = plan.frame.iter().copied().find(|pass| plan.pass(*pass).work == Work::Export);
        Ok(Pipelines {
            pipelines,
            lowered,
            order: Arc::new(Order { walked: Mutex::new(walked), fences, export }),
        })
    }

    pub(crate) fn of(&self, pass: PassId) -> Option<&Pipeline> {
        self.lowered.pipelines.of_pass[pass.index()].map(|pipeline| &self.pipelines[pipeline])
    }
}

/// Returns the plan with all shaders translated to Metal source; borrows it if they already are.
fn translated(plan: &Plan) -> Result<Cow<'_, Plan>, BackendError> {
    if plan.shaders.iter().all(|shader| shader.msl.is_some()) {
        return Ok(Cow::Borrowed(plan));
    }
    let mut plan = plan.clone();
    add_msl(&mut plan).map_err(|errors| {
        let errors: Vec<String> = errors.iter().map(ToString::to_string).collect();
        BackendError::Unsupported(errors.join("\n"))
    })?;
    Ok(Cow::Owned(plan))
}

fn function(gpu: &MetalGpu, plan: &Plan, shader: ShaderId) -> Result<Function, BackendError> {
    let shader = plan.shader(shader);
    let Some(Msl { source, entry, .. }) = shader.msl.as_deref() else {
        unreachable!("a lowered plan is translated")
    };
    gpu::function(&*gpu::library(&gpu.device, source, &shader.name)?, entry)
}

fn compute(
    gpu: &MetalGpu,
    plan: &Plan,
    shader: ShaderId,
    function: &FunctionRef,
) -> Result<Pipeline, BackendError> {
    let shader = plan.shader(shader);
    let threads = shader.reflection.local_size;
    let all: u64 = threads.iter().map(|&n| u64::from(n)).product();
    let (raw, lanes) = gpu::kernel(&gpu.device, function, &shader.name, all)?;
    if shader.reflection.has_subgroups() && lanes != u64::from(LANES) {
        return Err(BackendError::Unsupported(format!(
            "shader `{}` was compiled for SIMD groups of {LANES} lanes, and Metal runs it with {lanes}",
            shader.name
        )));
    }
    let [x, y, z] = threads.map(u64::from);
    Ok(Pipeline::Compute { raw, threads: MTLSize::new(x, y, z) })
}

fn draw(
    gpu: &MetalGpu,
    name: &str,
    [vertex, fragment]: [&FunctionRef; 2],
    topology: Topology,
    (targets, depth): (&[(Format, Blend)], Option<DepthAccess>),
) -> Result<Pipeline, BackendError> {
    let descriptor = RenderPipelineDescriptor::new();
    descriptor.set_label(name);
    descriptor.set_vertex_function(Some(vertex));
    descriptor.set_fragment_function(Some(fragment));
    for (index, &(color, blend)) in targets.iter().enumerate() {
        let Some(attachment) = descriptor.color_attachments().object_at(index as u64) else { continue };
        attachment.set_pixel_format(format(color));
        let Some(BlendFactors { color, alpha }) = BlendFactors::of(blend) else { continue };
        attachment.set_blending_enabled(true);
        attachment.set_rgb_blend_operation(MTLBlendOperation::Add);
        attachment.set_alpha_blend_operation(MTLBlendOperation::Add);
        attachment.set_source_rgb_blend_factor(factor(color.0));
        attachment.set_destination_rgb_blend_factor(factor(color.1));
        attachment.set_source_alpha_blend_factor(factor(alpha.0));
        attachment.set_destination_alpha_blend_factor(factor(alpha.1));
    }
    if depth.is_some() {
        descriptor.set_depth_attachment_pixel_format(format(Format::Depth32Float));
    }
    let raw = gpu.device.new_render_pipeline_state(&descriptor).map_err(|answer| BackendError::Api {
        call: "newRenderPipelineStateWithDescriptor",
        answer: format!("{answer} for `{name}`"),
    })?;
    let primitives = match topology {
        Topology::TriangleList => MTLPrimitiveType::Triangle,
        Topology::TriangleStrip => MTLPrimitiveType::TriangleStrip,
    };
    Ok(Pipeline::Draw { raw, primitives, depth: depth.map(|access| depth_state(gpu, access)) })
}

/// Creates the state of depth tests. Depths are reversed: nearer fragments have larger values.
fn depth_state(gpu: &MetalGpu, access: DepthAccess) -> DepthStencilState {
    let descriptor = DepthStencilDescriptor::new();
    descriptor.set_depth_compare_function(MTLCompareFunction::Greater);
    descriptor.set_depth_write_enabled(access != DepthAccess::Test);
    gpu.device.new_depth_stencil_state(&descriptor)
}

fn factor(factor: BlendFactor) -> MTLBlendFactor {
    match factor {
        BlendFactor::Zero => MTLBlendFactor::Zero,
        BlendFactor::One => MTLBlendFactor::One,
        BlendFactor::OneMinusSourceAlpha => MTLBlendFactor::OneMinusSourceAlpha,
        BlendFactor::TargetAlpha => MTLBlendFactor::DestinationAlpha,
    }
}
