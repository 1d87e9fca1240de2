//! The state of a recording: a command buffer, the open encoder, and the next command's pipeline and arguments.

use crate::descriptors::{Argument, Table};
use crate::gpu::MetalGpu;
use crate::lower::Stage;
use crate::pipelines::{Order, Pipeline};
use crate::queue::Timestamps;
use crate::sync::{EncoderKind, FenceUse};
use crate::walk::{Move, Walk};
use metal::*;
use std::ffi::c_void;
use std::ops::Range;
use std::sync::Arc;

/// The encoder of Metal's that commands are recorded to.
pub(super) enum Open {
    None,
    Compute(ComputeCommandEncoder),
    Render(RenderCommandEncoder),
    Blit(BlitCommandEncoder),
}

/// A command buffer, and the events around it.
pub struct Encoder {
    pub(super) name: String,
    pub(super) commands: Option<CommandBuffer>,
    /// The last submission, until it was waited for.
    pub(super) submitted: Vec<CommandBuffer>,
    /// Signalled when a submission has completed.
    pub(super) done: (SharedEvent, u64),
    /// Signalled and waited for in the midst of the commands.
    pub(super) midst: (Event, u64),
    /// Signalled when what the commands wait for from their beginning has completed; see [`submit`](crate::queue::submit).
    pub(super) others: (SharedEvent, u64),
    /// They wait for everything submitted before them, and not only for what was published.
    pub(super) after_all: bool,
    /// All that is submitted later waits for them.
    pub(super) publishes: bool,
    pub(super) walk: Walk,
    pub(super) order: Option<Arc<Order>>,
    pub(super) moves: Vec<Move>,
    /// The encoder that commands are recorded to.
    pub(super) open: Open,
    /// The encoder that the next command opens, and the fences that it then waits for.
    pub(super) next: Option<EncoderKind>,
    pub(super) waits: Vec<FenceUse>,
    pub(super) bound: Bound,
    /// Takes the times of the frame.
    pub(super) times: Option<Timestamps>,
    /// The first of two samples of the next encoder.
    pub(super) sample: Option<u32>,
    pub(super) label: String,
    /// Debug groups that are open in the encoder.
    pub(super) groups: usize,
    pub(super) gpu: Arc<MetalGpu>,
}

/// The pipeline and the arguments of the next command.
#[derive(Default)]
pub(super) struct Bound {
    pub(super) pipeline: Option<Pipeline>,
    pub(super) table: Table,
    /// Words to copy with the command: push constants, and sizes of buffers.
    pub(super) bytes: Vec<u8>,
    pub(super) copied: Vec<(Stage, u32, Range<usize>)>,
}

impl Encoder {
    pub(crate) fn new(gpu: &Arc<MetalGpu>, name: &str) -> Encoder {
        Encoder {
            name: name.to_string(),
            commands: None,
            submitted: Vec::new(),
            done: (gpu.device.new_shared_event(), 0),
            midst: (gpu.device.new_event(), 0),
            others: (gpu.device.new_shared_event(), 0),
            after_all: false,
            publishes: false,
            walk: Walk::default(),
            order: None,
            moves: Vec::new(),
            open: Open::None,
            next: None,
            waits: Vec::new(),
            bound: Bound::default(),
            times: None,
            sample: None,
            label: String::new(),
            groups: 0,
            gpu: gpu.clone(),
        }
    }
}

impl Bound {
    /// Sets pipeline and arguments of a dispatch. Returns the threads of its threadgroups.
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

    /// Sets pipeline and arguments of a draw. Returns its primitives.
    pub fn draw(&self, encoder: &RenderCommandEncoderRef) -> Option<MTLPrimitiveType> {
        let Some(Pipeline::Draw { raw, primitives }) = &self.pipeline else { return None };
        encoder.set_render_pipeline_state(raw);
        for (place, argument) in &self.table.arguments {
            let index = place.index.into();
            match (place.stage == Stage::Vertex, argument) {
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
                Stage::Vertex => encoder.set_vertex_bytes(index, length, pointer(bytes)),
                _ => encoder.set_fragment_bytes(index, length, pointer(bytes)),
            }
        }
        Some(*primitives)
    }
}

/// Metal copies the bytes during the call.
fn pointer(bytes: &[u8]) -> *const c_void {
    bytes.as_ptr().cast()
}
