//! Defines the encoders of a plan with their fences and barriers.

use splatgraph_framework::{ir::*, plan::*};

/// The encoders of a plan, in order.
///
/// The fences are sufficient if the executor follows these rules:
///
/// - It opens every encoder, in this order. An encoder without work still waits for its fences and updates them,
///   because other encoders rely on the order through it.
/// - Copies of the plan's output to the host belong to the encoder of [`Work::Export`], before its updates. The draw
///   into a window waits for the fences that this encoder updates, and updates them again. Events order all other
///   commands outside the plan, such as the copy of the output for another plan.
/// - Fences belong to one plan in one [`Division`]. A frame that follows a frame of another plan or division waits for
///   all earlier work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoders {
    /// Encoders that run once, after the plan or the scene has changed. With a [`handover`](Encoders::handover), all
    /// later submissions wait for all of them.
    pub prologue: Vec<Encoding>,
    /// True if the first frame must wait for the whole prologue, by an event. It must if a pass of the frame depends on
    /// a pass of the prologue.
    pub handover: bool,
    /// Encoders that run every frame. Only fences order one frame after another.
    pub frame: Vec<Encoding>,
    /// Number of fences. The prologue and the frame use the same ones if there is a handover between them.
    pub fences: u32,
}

impl Encoders {
    /// Lists the encoders of the prologue, then those of the frame.
    pub fn all(&self) -> impl Iterator<Item = &Encoding> {
        self.prologue.iter().chain(&self.frame)
    }

    /// Returns an encoder by its index, counted through the prologue and the frame.
    pub fn encoder(&self, index: usize) -> &Encoding {
        let frame = |index| &self.frame[index];
        index.checked_sub(self.prologue.len()).map_or_else(|| &self.prologue[index], frame)
    }
}

/// An encoder, with passes of one kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoding {
    /// The kind of the encoder's commands.
    pub kind: EncoderKind,
    /// Fences that the encoder waits for before its first command. A wait for a fence never updated blocks nothing.
    pub waits: Vec<FenceUse>,
    /// The passes, in order.
    pub passes: Vec<EncodedPass>,
    /// Fences that the encoder updates after its last command.
    pub updates: Vec<FenceUse>,
}

/// Kind of an encoder, by its commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EncoderKind {
    /// Dispatches, which may run concurrently (`MTLDispatchTypeConcurrent`). Fills and clears are dispatches of
    /// built-in kernels.
    Compute,
    /// Draws into the same targets, in order.
    Render,
    /// Copies.
    Blit,
}

/// A wait for a fence, or an update of it, by an encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FenceUse {
    /// Index of the fence, below [`Encoders::fences`].
    pub fence: u32,
    /// For draws, the stage that waits, or after which the fence is updated; `None` in other encoders.
    pub stages: Option<RenderStages>,
}

/// The stages of a draw, in order. Passes of other kinds start at the first and end at the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RenderStages {
    /// Reading of indirect arguments, and vertex shaders.
    Vertex,
    /// Fragment shaders and targets.
    Fragment,
}

impl RenderStages {
    /// Returns the earliest stage of a pass among `stages`.
    pub(super) fn first(pass: &Pass, stages: Stages) -> RenderStages {
        let draws = matches!(pass.work, Work::Draw { .. });
        let early = !draws || stages.intersects(Stages::INDIRECT | Stages::VERTEX);
        if early { RenderStages::Vertex } else { RenderStages::Fragment }
    }

    /// Returns the latest stage of a pass among `stages`.
    pub(super) fn last(pass: &Pass, stages: Stages) -> RenderStages {
        let draws = matches!(pass.work, Work::Draw { .. });
        let early = draws && (Stages::INDIRECT | Stages::VERTEX).contains(stages);
        if early { RenderStages::Vertex } else { RenderStages::Fragment }
    }
}

/// A pass of an encoder, with the barrier before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodedPass {
    /// The barrier that orders earlier passes of the encoder before this pass and later ones; `None` if none is needed.
    pub barrier: Option<MemoryBarrier>,
    /// Pass of the plan.
    pub pass: PassId,
}

/// A memory barrier within an encoder of dispatches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct MemoryBarrier {
    /// True if the scope includes buffers.
    pub buffers: bool,
    /// True if the scope includes textures.
    pub textures: bool,
}

impl MemoryBarrier {
    /// Returns the barrier whose scope is the resource's kind.
    pub(super) fn on(plan: &Plan, resource: ResourceId) -> MemoryBarrier {
        let textures = matches!(plan.resource(resource).shape, Shape::Image { .. });
        MemoryBarrier { buffers: !textures, textures }
    }

    /// Returns the barrier with both scopes.
    pub fn union(self, other: MemoryBarrier) -> MemoryBarrier {
        MemoryBarrier { buffers: self.buffers || other.buffers, textures: self.textures || other.textures }
    }

    /// Returns true if this scope includes the scope of `other`.
    pub fn contains(self, other: MemoryBarrier) -> bool {
        self.union(other) == self
    }
}

/// The division of passes into encoders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Division {
    /// As few encoders as the order of the passes, their kinds, and the targets and dependencies of draws allow.
    Merged,
    /// One encoder per pass, because timestamps are sampled where encoders start and end.
    Passes,
}

impl Division {
    /// All divisions.
    pub const ALL: [Division; 2] = [Division::Merged, Division::Passes];
}

/// Position of a wait, a barrier or the handover among the encoders of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum At {
    /// At a point of the encoder with this index in [`Encoders::prologue`].
    Prologue(usize, Point),
    /// Between the prologue and the first frame.
    Handover,
    /// At a point of the encoder with this index in [`Encoders::frame`].
    Frame(usize, Point),
}

/// Position of a wait or a barrier in an encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Point {
    /// The wait with this index.
    Wait(usize),
    /// The barrier before the pass with this index.
    Barrier(usize),
}
