//! Applies the inputs of a frame: uniform blocks and host buffers.

use crate::check::invalid;
use crate::compiled::CompiledPlan;
use crate::gpu::Gpu;
use crate::shared::Shared;
use splatgraph_api::{BackendError, FrameInputs};
use splatgraph_framework::ir::{Param, ParamBinding, ResourceId, Source};

/// Copies the frame's uniform blocks to its slot's buffers, and zeroes the rest of each. All live parameters must be
/// present.
pub(crate) fn write_uniforms<G: Gpu>(
    compiled: &mut CompiledPlan<G>,
    slot: usize,
    inputs: &FrameInputs,
) -> Result<(), BackendError> {
    let live_end = |param: &Param| match param.binding {
        ParamBinding::Live { offset } => offset as usize + 4,
        ParamBinding::Const => 0,
    };
    for (index, resource) in compiled.plan.resources.iter().enumerate() {
        let bytes = match &resource.source {
            Source::Frame { uniform } => match inputs.uniforms.get(uniform) {
                Some(bytes) => bytes,
                None => return invalid(format!("the frame has no contents for uniform block `{uniform}`")),
            },
            Source::Live => {
                let needed = compiled.plan.params.iter().map(live_end).max().unwrap_or(0);
                if inputs.live.len() < needed {
                    return invalid(format!(
                        "the live parameters of plan `{}`: expected at least {needed} bytes, found {}",
                        compiled.plan.name,
                        inputs.live.len()
                    ));
                }
                &inputs.live
            }
            Source::Transient | Source::Scene { .. } | Source::HostBuffer { .. } | Source::Readback => {
                continue;
            }
        };
        let Some(target) = compiled.resources.mapped_mut(ResourceId(index as u32), slot) else { continue };
        if bytes.len() > target.len() {
            return invalid(format!(
                "uniform block `{}`: expected at most {} bytes, found {}",
                resource.name,
                target.len(),
                bytes.len()
            ));
        }
        let (contents, rest) = target.split_at_mut(bytes.len());
        contents.copy_from_slice(bytes);
        rest.fill(0);
    }
    Ok(())
}

/// Sets the contents of all host buffers for a frame in `slot`, and rewrites the slot's bindings that change.
pub(crate) fn take_host_buffers<G: Gpu>(
    shared: &Shared<G>,
    compiled: &mut CompiledPlan<G>,
    slot: usize,
    inputs: &FrameInputs,
) -> Result<(), BackendError> {
    let CompiledPlan { plan, resources, bindings, .. } = compiled;
    let mut changed = Vec::new();
    for (index, resource) in plan.resources.iter().enumerate() {
        let (id, Source::HostBuffer { buffer }) = (ResourceId(index as u32), &resource.source) else {
            continue;
        };
        let Some(contents) = inputs.buffers.get(buffer) else {
            return invalid(format!("the frame has no contents for host buffer `{buffer}`"));
        };
        let Some(held) = resources.host_buffer_mut(id, slot) else { continue };
        held.take(shared, resource, contents)?;
        if held.is_changed() {
            changed.push(id);
        }
    }
    bindings.rewrite(&shared.gpu, plan, resources, slot, &changed);
    for id in changed {
        if let Some(held) = resources.host_buffer_mut(id, slot) {
            held.set_written();
        }
    }
    Ok(())
}
