//! Encoders, fences and memory barriers of a plan, as plain data.
//!
//! A Metal command buffer consists of encoders, each for commands of one kind. Resources are untracked: Metal orders nothing by itself.
//! Within an encoder of dispatches, which may run at the same time, a memory barrier orders those before it before those after it;
//! between encoders, a fence that one updates and another waits for does.

use splatgraph_framework::{ir::*, plan::*};

/// The encoders of a plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoders {
    /// Run once after the plan or the scene changed. All commands submitted later wait for all of them.
    pub prologue: Vec<Encoding>,
    /// Run every frame. Frames may overlap, but for the fences.
    pub frame: Vec<Encoding>,
    /// The number of fences.
    pub fences: u32,
}

/// One encoder, with passes of one kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoding {
    /// The kind of its commands.
    pub kind: EncoderKind,
    /// Fences that it waits for before its first command. One that was never updated is not waited for.
    pub waits: Vec<FenceUse>,
    /// The passes, in order.
    pub passes: Vec<EncodedPass>,
    /// Fences that it updates after its last command.
    pub updates: Vec<FenceUse>,
}

/// The kinds of encoders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderKind {
    /// Dispatches, and fills and clears, which are dispatches of kernels of our own. They may run at the same time
    /// (`MTLDispatchTypeConcurrent`).
    Compute,
    /// Draws into the same targets, in order.
    Render,
    /// Copies.
    Blit,
}

/// A fence that an encoder waits for or updates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FenceUse {
    /// Its number, below [`Encoders::fences`].
    pub fence: u32,
    /// Of an encoder of draws: waits before these stages, or updates after them (vertices alone, or vertices and fragments).
    pub stages: Option<RenderStages>,
}

/// Stages of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RenderStages {
    /// Reading of indirect arguments, and vertex shaders.
    Vertex,
    /// Fragment shaders and targets.
    Fragment,
}

/// A pass, and the barrier before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodedPass {
    /// Orders everything before it in the encoder before it and everything after.
    pub barrier: Option<MemoryBarrier>,
    /// The pass.
    pub pass: PassId,
}

/// A memory barrier within an encoder of dispatches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryBarrier {
    /// For buffers.
    pub buffers: bool,
    /// For textures.
    pub textures: bool,
}

/// The choice between few encoders and times of passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Division {
    /// As few encoders as the kinds of passes allow.
    Merged,
    /// An encoder for each pass: Apple's GPUs take times at the boundaries of encoders alone.
    Passes,
}

/// Divides the passes of a plan into encoders, and orders these.
pub fn encoders(plan: &Plan, _division: Division) -> Encoders {
    let mut fences = 0;
    let mut last = None;
    let mut one = |step: &Step| {
        let kind = match plan.pass(step.pass).work {
            Work::Draw { .. } => EncoderKind::Render,
            Work::Export => EncoderKind::Blit,
            Work::Host => return None,
            Work::Dispatch { .. } | Work::Fill { .. } | Work::Start { .. } => EncoderKind::Compute,
        };
        let stages = |stages| (kind == EncoderKind::Render).then_some(stages);
        let wait = last.map(|fence| FenceUse { fence, stages: stages(RenderStages::Vertex) });
        let update = FenceUse { fence: fences, stages: stages(RenderStages::Fragment) };
        last = Some(fences);
        fences += 1;
        let passes = vec![EncodedPass { barrier: None, pass: step.pass }];
        Some(Encoding { kind, waits: wait.into_iter().collect(), passes, updates: vec![update] })
    };
    let prologue = plan.prologue.iter().filter_map(&mut one).collect();
    let mut frame: Vec<Encoding> = plan.frame.iter().filter_map(&mut one).collect();
    if let (Some(first), Some(fence)) = (frame.first_mut(), last) {
        first.waits.push(FenceUse { fence, stages: None });
    }
    Encoders { prologue, frame, fences }
}
