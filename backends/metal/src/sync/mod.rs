//! Encoders, fences and memory barriers of a plan, as plain data.
//!
//! A Metal command buffer consists of encoders, each for commands of one kind. Resources are untracked: Metal orders nothing by itself.
//! Within an encoder of dispatches, which may run at the same time, a memory barrier orders those before it before those after it;
//! between encoders, a fence that one updates and another waits for does.
//!
//! All of this follows from the plan's dependencies: `divide` makes encoders of the passes, `order` walks over prologue and frames and
//! turns each dependency into a wait or a barrier, and `fences` numbers the fences. [`model`], which shares no code with the rest of
//! this folder, checks the result against the dependencies.
//!
//! # The rules, and where Apple states them
//!
//! Pages are those below `developer.apple.com/documentation/metal/`.
//!
//! 1. Metal does not order accesses to an untracked resource; "you're responsible for ensuring that commands access those resources
//!    safely with barriers, fences, or events" (`mtlhazardtrackingmode/untracked`). The GPU can run "multiple passes" and "two or more
//!    dispatch commands within a compute pass" at the same time (`synchronizing-passes-with-a-fence`). An encoder makes one such pass.
//! 2. In an encoder of type `MTLDispatchTypeConcurrent` whoever encodes commands that access one resource must synchronise them
//!    (`mtldispatchtype/concurrent`). `memoryBarrierWithScope:` "enforces the order of write and read operations for specific resource
//!    types" (`mtlcomputecommandencoder/memorybarrier(scope:)`): buffers, textures, or both (`mtlbarrierscope`). Where a buffer and a
//!    texture share memory, the barrier between them names both.
//! 3. A fence "resolves access conflicts between commands in different passes that you submit to the same command queue, including the
//!    passes you commit in other command buffers" (`synchronizing-passes-with-a-fence`): so fences order frames, too.
//! 4. Waits hold back the beginning of an encoder and updates follow its end, wherever they are encoded ("Fences are evaluated at
//!    command encoder boundaries", `mtlrendercommandencoder/1648377-updatefence`). An encoder may wait for a fence and then update it,
//!    not the other way round (same page; "can cause GPU deadlock" in later versions).
//! 5. A fence "can wait for workloads that have already begun, but it can't wait for future workloads" (sample "Image Filter Graph with
//!    Heaps and Events"); who updates is submitted before who waits (`mtlfence`). So a wait is for the update that was encoded last
//!    before it, and one without any holds nothing back.
//! 6. In an encoder of draws, a wait is before a stage and an update after one; an update captures the work "up to the given render
//!    stage" (`1648377-updatefence`), "a GPU can run the vertex stage of a pass while the fragment stage waits" (`mtlfence`). As a
//!    fragment needs its vertices, a wait before vertices holds back fragments as well.
//! 7. Draws of one encoder blend into its targets in the order in which they were encoded, as everywhere.
//! 8. An event that is signalled and waited for orders everything before it before everything after it
//!    (`mtlcommandbuffer/encodesignalevent(_:value:)`, `mtlcommandbuffer/encodewaitforevent(_:value:)`).
//!
//! Not found in Apple's pages, and to be confirmed on a Mac (`docs/metal.md` has the list): that arguments of indirect draws are read
//! in the stage of the vertices, and those of indirect dispatches within a barrier's scope for buffers; that targets are loaded,
//! cleared and stored in the stage of the fragments (MoltenVK maps Vulkan's stages in this way, `MVKCmdPipeline.mm`); that a barrier
//! orders writes after reads, as it orders reads after writes; that an encoder without commands still waits and updates; and that a
//! fence can be updated for the next frame while encoders of this one, submitted earlier, have yet to see the previous update.

mod divide;
mod fences;
pub mod model;
mod order;
#[cfg(test)]
mod tests;

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
    fn first(pass: &Pass, stages: Stages) -> RenderStages {
        let draws = matches!(pass.work, Work::Draw { .. });
        let early = !draws || stages.intersects(Stages::INDIRECT | Stages::VERTEX);
        if early { RenderStages::Vertex } else { RenderStages::Fragment }
    }

    /// Returns the stage of a pass that ends last of these.
    fn last(pass: &Pass, stages: Stages) -> RenderStages {
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
    fn on(plan: &Plan, resource: ResourceId) -> MemoryBarrier {
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

/// Divides the passes of a plan into encoders, and orders these.
///
/// The order of the passes is the plan's. No stage waits for more than it depends on, and nothing can be left out. [`Work::Host`] is
/// in no encoder: the completion of the command buffer shows the host what was copied.
pub fn encoders(plan: &Plan, division: Division) -> Encoders {
    explained(plan, division).0
}

/// Divides a plan as [`encoders`] does, and gives the reasons for every wait and barrier, in their order.
pub fn explained(plan: &Plan, division: Division) -> (Encoders, Vec<Cause>) {
    let prologue = divide::divide(plan, &plan.prologue, division);
    let frame = divide::divide(plan, &plan.frame, division);
    order::order(plan, prologue, frame)
}

/// Lists what a pass must come after. Images have no layouts here, and the host waits for the whole command buffer.
fn ordering(plan: &Plan, pass: PassId) -> impl Iterator<Item = &Dependency> {
    let of_device = |dependency: &&Dependency| plan.pass(dependency.second).work != Work::Host;
    let dependencies = plan.dependencies_of(pass).iter();
    dependencies.filter(|dependency| dependency.hazard != Hazard::LayoutChange).filter(of_device)
}
