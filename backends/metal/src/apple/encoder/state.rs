//! Defines the state of a recording: a command buffer, the open encoder, and the next command's pipeline and arguments.

use crate::apple::descriptors::{Argument, Table};
use crate::apple::gpu::{MetalGpu, Submission};
use crate::apple::pipelines::{Order, Pipeline};
use crate::apple::queue::Timestamps;
use crate::sync::{EncoderKind, FenceUse};
use crate::walk::{Move, Walk};
use metal::*;
use splatgraph_framework::ir::ShaderStage;
use std::ffi::c_void;
use std::ops::Range;
use std::sync::Arc;

pub(super) enum Open {
    None,
    Compute(ComputeCommandEncoder),
    Render(RenderCommandEncoder),
    Blit(BlitCommandEncoder),
}

impl Open {
    pub(super) fn raw(&self) -> Option<&CommandEncoderRef> {
        let raw: &CommandEncoderRef = match self {
            Open::None => return None,
            Open::Compute(encoder) => encoder,
            Open::Render(encoder) => encoder,
            Open::Blit(encoder) => encoder,
        };
        Some(raw)
    }
}

/// A command buffer being recorded or executed, and the events that order it.
pub struct Encoder {
    pub(super) name: String,
    pub(super) commands: Option<CommandBuffer>,
    /// The last submission, until it has been waited for.
    pub(super) submitted: Option<Submission>,
    /// Event and value that signal completion of the submission.
    pub(super) done: (SharedEvent, u64),
    /// Event that orders earlier commands of the buffer before later ones (signal, then wait), and its last value.
    pub(super) order_event: (Event, u64),
    /// Event and value that the commands wait for before they start; see [`submit`](crate::apple::queue::submit).
    pub(super) others: (SharedEvent, u64),
    /// True if all commands wait for all earlier submissions, not only for published ones.
    pub(super) after_all: bool,
    /// True if all later submissions wait for these commands.
    pub(super) publishes: bool,
    pub(super) walk: Walk,
    pub(super) order: Option<Arc<Order>>,
    pub(super) moves: Vec<Move>,
    pub(super) open: Open,
    /// Kind of encoder to open for the next command, then to wait for `waits`; `None` if it is open already, or if the
    /// next command is outside the plan.
    pub(super) next: Option<EncoderKind>,
    pub(super) waits: Vec<FenceUse>,
    pub(super) bound: Bound,
    pub(super) times: Option<Timestamps>,
    /// Index of the first of the next encoder's two samples; `None` if the encoder is not timed.
    pub(super) sample: Option<u32>,
    pub(super) label: String,
    /// Number of debug groups open in the command encoder.
    pub(super) groups: usize,
    pub(super) gpu: Arc<MetalGpu>,
}

#[derive(Default)]
pub(super) struct Bound {
    pub(super) pipeline: Option<Pipeline>,
    pub(super) table: Table,
    /// Bytes to pass with the command: push constants, and buffer sizes.
    pub(super) bytes: Vec<u8>,
    pub(super) copied: Vec<(ShaderStage, u32, Range<usize>)>,
}

impl Bound {
    /// Sets the pipeline and arguments of a dispatch. Returns its threadgroup size; `None` without a compute pipeline.
    pub fn dispatch(&self, encoder: &ComputeCommandEncoderRef) -> Option<MTLSize> {
        let Some(Pipeline::Compute { raw, threads }) = &self.pipeline else { return None };
        encoder.set_compute_pipeline_state(raw);
        for (place, argument) in &self.table.arguments {
            let index = place.index.into();
            match argument {
                Argument::Buffer(buffer, offset) => encoder.set_buffer(index, Some(buffer), *offset),
                Argument::Texture(texture) => encoder.set_texture(index, Some(texture)),
            }
        }
        for (_, index, range) in &self.copied {
            let bytes = &self.bytes[range.clone()];
            encoder.set_bytes((*index).into(), bytes.len() as u64, pointer(bytes));
        }
        Some(*threads)
    }

    /// Sets the pipeline and arguments of a draw. Returns its primitive type; `None` without a render pipeline.
    pub fn draw(&self, encoder: &RenderCommandEncoderRef) -> Option<MTLPrimitiveType> {
        let Some(Pipeline::Draw { raw, primitives, depth }) = &self.pipeline else { return None };
        encoder.set_render_pipeline_state(raw);
        if let Some(depth) = depth {
            encoder.set_depth_stencil_state(depth);
        }
        for (place, argument) in &self.table.arguments {
            let index = place.index.into();
            match (place.stage == ShaderStage::Vertex, argument) {
                (true, Argument::Buffer(buffer, offset)) => {
                    encoder.set_vertex_buffer(index, Some(buffer), *offset)
                }
                (false, Argument::Buffer(buffer, offset)) => {
                    encoder.set_fragment_buffer(index, Some(buffer), *offset);
                }
                (true, Argument::Texture(texture)) => encoder.set_vertex_texture(index, Some(texture)),
                (false, Argument::Texture(texture)) => encoder.set_fragment_texture(index, Some(texture)),
            }
        }
        for (stage, index, range) in &self.copied {
            let bytes = &self.bytes[range.clone()];
            let (index, length) = ((*index).into(), bytes.len() as u64);
            match stage {
                ShaderStage::Vertex => encoder.set_vertex_bytes(index, length, pointer(bytes)),
                _ => encoder.set_fragment_bytes(index, length, pointer(bytes)),
            }
        }
        Some(*primitives)
    }
}

/// Returns a pointer to bytes that Metal copies during the call.
fn pointer(bytes: &[u8]) -> *const c_void {
    bytes.as_ptr().cast()
}
