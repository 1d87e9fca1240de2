//! The encoders of a plan with their fences and barriers, and the reasons for these.

use splatgraph_framework::{ir::*, plan::*};

/// Lists the encoders of a plan.
///
/// For the fences to hold, an executor keeps these rules:
///
/// - Encoders are opened in this order, all of them: one whose passes have nothing to do, or are left out, still waits for its fences
///   and updates them, since others may count on the order through it.
/// - What reads the plan's output after the frame (copies to the host, to a window, to another plan) belongs to the encoder of
///   [`Work::Export`]: its fences are updated after that.
/// - Fences are those of one plan in one [`Division`]. A frame that follows one of another plan or of the other division waits for
///   everything before it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoders {
    /// Run once after the plan or the scene changed. All commands submitted later wait for all of them (see
    /// [`handover`](Encoders::handover)).
    pub prologue: Vec<Encoding>,
    /// Between the prologue and the first frame everything waits for everything (an event that is signalled and waited for, once):
    /// some pass of the frame touches what the prologue touched.
    pub handover: bool,
    /// Run every frame. Frames may overlap, but for the fences.
    pub frame: Vec<Encoding>,
    /// The number of fences. The prologue and the frame use the same ones.
    pub fences: u32,
}

/// Describes one encoder, with passes of one kind.
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

/// Classifies encoders by their commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EncoderKind {
    /// Dispatches, and fills and clears, which are dispatches of kernels of our own. They may run at the same time
    /// (`MTLDispatchTypeConcurrent`).
    Compute,
    /// Draws into the same targets, in order.
    Render,
    /// Copies.
    Blit,
}

/// Names a fence that an encoder waits for or updates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FenceUse {
    /// Its number, below [`Encoders::fences`].
    pub fence: u32,
    /// The stages of draws that it waits before, or updates after; `None` in other encoders.
    ///
    /// They are vertices alone, or vertices and fragments.
    pub stages: Option<RenderStages>,
}

/// Names stages of a draw, in their order. Every other pass has the first beginning and the last end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RenderStages {
    /// Reading of indirect arguments, and vertex shaders.
    Vertex,
    /// Fragment shaders and targets.
    Fragment,
}

impl RenderStages {
    /// Returns the stage of a pass that starts first of these.
    pub(super) fn first(pass: &Pass, stages: Stages) -> RenderStages {
        let draws = matches!(pass.work, Work::Draw { .. });
        let early = !draws || stages.intersects(Stages::INDIRECT | Stages::VERTEX);
        if early { RenderStages::Vertex } else { RenderStages::Fragment }
    }

    /// Returns the stage of a pass that ends last of these.
    pub(super) fn last(pass: &Pass, stages: Stages) -> RenderStages {
        let draws = matches!(pass.work, Work::Draw { .. });
        let early = draws && (Stages::INDIRECT | Stages::VERTEX).contains(stages);
        if early { RenderStages::Vertex } else { RenderStages::Fragment }
    }
}

/// Holds a pass, and the barrier before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodedPass {
    /// Orders everything before it in the encoder before it and everything after.
    pub barrier: Option<MemoryBarrier>,
    /// The pass.
    pub pass: PassId,
}

/// Describes a memory barrier within an encoder of dispatches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct MemoryBarrier {
    /// For buffers.
    pub buffers: bool,
    /// For textures.
    pub textures: bool,
}

impl MemoryBarrier {
    /// Returns the barrier for accesses to a resource.
    pub(super) fn on(plan: &Plan, resource: ResourceId) -> MemoryBarrier {
        let textures = matches!(plan.resource(resource).shape, Shape::Image { .. });
        MemoryBarrier { buffers: !textures, textures }
    }

    /// Returns the barrier for what either is for.
    pub fn union(self, other: MemoryBarrier) -> MemoryBarrier {
        MemoryBarrier { buffers: self.buffers || other.buffers, textures: self.textures || other.textures }
    }

    /// Returns true if it is for everything that `other` is for.
    pub fn contains(self, other: MemoryBarrier) -> bool {
        self.union(other) == self
    }
}

/// Chooses between few encoders and times of passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Division {
    /// As few encoders as the kinds of passes allow.
    Merged,
    /// An encoder for each pass: Apple's GPUs take times at the boundaries of encoders alone.
    Passes,
}

impl Division {
    /// Both.
    pub const ALL: [Division; 2] = [Division::Merged, Division::Passes];
}

/// Gives one reason for a barrier, a wait or the handover: the accesses of `before` conflict with those of `after`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cause {
    /// The wait, the barrier or the handover that it explains.
    pub at: At,
    /// The kind of conflict.
    pub hazard: Hazard,
    /// The pass that waits.
    pub before: PassId,
    /// The resource that it accesses.
    pub resource: ResourceId,
    /// The passes that are waited for.
    pub after: Vec<PassId>,
    /// They ran in the frame before that of `before`.
    pub previous_frame: bool,
    /// The resource that they accessed, if it is another one in the same memory.
    pub alias: Option<ResourceId>,
}

/// Locates synchronization among the encoders of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum At {
    /// At this point of this encoder of [`Encoders::prologue`].
    Prologue(usize, Point),
    /// Between the prologue and the first frame.
    Handover,
    /// At this point of this encoder of [`Encoders::frame`].
    Frame(usize, Point),
}

/// Locates synchronization in an encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Point {
    /// The wait of this index.
    Wait(usize),
    /// The barrier before the pass of this index.
    Barrier(usize),
}
