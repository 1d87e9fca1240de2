//! Lowers a plan's dependencies to encoders, fences and memory barriers, as plain data.
//!
//! A Metal command buffer consists of encoders, each for commands of one kind. Resources are untracked: Metal orders
//! nothing by itself. Dispatches of one encoder may run at the same time; a memory barrier orders the earlier ones
//! before the later ones. A fence orders the encoder that updates it before the encoder that waits for it.
//!
//! The dependencies of the plan determine all of this. `divide` groups the passes into encoders, `order` walks over
//! prologue and frames and lowers each dependency to a wait or a barrier, and `fences` numbers the fences. [`model`]
//! checks the result against the dependencies, and shares no code with the rest of this folder.
//!
//! # The rules, and where Apple states them
//!
//! Pages are below `developer.apple.com/documentation/metal/`.
//!
//! 1. Metal does not order accesses to an untracked resource; "you're responsible for ensuring that commands access
//!    those resources safely with barriers, fences, or events" (`mtlhazardtrackingmode/untracked`). The GPU can run
//!    "multiple passes" and "two or more dispatch commands within a compute pass" at the same time
//!    (`synchronizing-passes-with-a-fence`). Each encoder is one such pass.
//! 2. In an encoder of type `MTLDispatchTypeConcurrent`, the application must synchronise commands that access one
//!    resource (`mtldispatchtype/concurrent`). `memoryBarrierWithScope:` "enforces the order of write and read
//!    operations for specific resource types" (`mtlcomputecommandencoder/memorybarrier(scope:)`): buffers, textures, or
//!    both (`mtlbarrierscope`). If a buffer and a texture share memory, the barrier between them names both.
//! 3. A fence "resolves access conflicts between commands in different passes that you submit to the same command
//!    queue, including the passes you commit in other command buffers" (`synchronizing-passes-with-a-fence`). Fences
//!    therefore order frames as well.
//! 4. Waits delay the beginning of an encoder and updates follow its end, wherever they are encoded ("Fences are
//!    evaluated at command encoder boundaries", `mtlrendercommandencoder/1648377-updatefence`). An encoder may wait for
//!    a fence and then update it, but not the other way round (same page; "can cause GPU deadlock" in later versions).
//! 5. A fence "can wait for workloads that have already begun, but it can't wait for future workloads" (sample "Image
//!    Filter Graph with Heaps and Events"); the update is submitted before the wait (`mtlfence`). So a wait is for the
//!    last update encoded before it; without one, it blocks nothing. A fence can be reused by an encoder that waits for
//!    it first and updates it second (`mtlblitcommandencoder/waitforfence(_:)`). Here, every encoder that updates a
//!    fence comes after all encoders that wait for the previous update, so that no update overtakes a wait.
//! 6. In an encoder of draws, a wait is before a stage and an update after one; an update captures the work "up to the
//!    given render stage" (`1648377-updatefence`), "a GPU can run the vertex stage of a pass while the fragment stage
//!    waits" (`mtlfence`). As a fragment needs its vertices, a wait before vertices delays fragments as well.
//! 7. Draws of one encoder blend into its targets in the order of encoding.
//! 8. An event that is signalled and waited for orders everything before it before everything after it
//!    (`mtlcommandbuffer/encodesignalevent(_:value:)`, `mtlcommandbuffer/encodewaitforevent(_:value:)`).
//!
//! Apple's pages do not state the following, which must be confirmed on a Mac (`docs/metal.md` lists it with the
//! expected observations). A wait is for the last update encoded before it. Arguments of indirect draws are read in the
//! vertex stage, and arguments of indirect dispatches within a barrier's scope for buffers. Targets are loaded, cleared
//! and stored in the fragment stage. A barrier orders writes after reads, as it orders reads after writes. A barrier
//! for both scopes, or a fence, orders accesses to a texture and a buffer in the same memory.

mod divide;
mod encoding;
mod fences;
pub mod model;
mod order;
#[cfg(test)]
mod tests;

pub use encoding::*;
use splatgraph_framework::plan::{Cause, Plan};

/// Divides the passes of a plan into encoders, and orders the encoders.
///
/// The order of the passes is the plan's. An encoder waits only for encoders that it depends on, and every wait and
/// barrier is necessary. `Work::Host` is in no encoder: completion of the command buffer makes the copies visible to
/// the host.
pub fn encoders(plan: &Plan, division: Division) -> Encoders {
    explained(plan, division).0
}

/// Divides a plan as [`encoders`] does. Also returns the reasons for every wait and barrier and for the handover.
pub fn explained(plan: &Plan, division: Division) -> (Encoders, Vec<(At, Cause)>) {
    let prologue = divide::divide(plan, &plan.prologue, division);
    let frame = divide::divide(plan, &plan.frame, division);
    order::order(plan, prologue, frame)
}
