//! Models Vulkan's rules: replays a plan with its barriers, and reports each access whose result Vulkan does not
//! define.
//!
//! The lowering in [`crate::sync`] places barriers by reasoning about the whole plan. The model does not reason: it
//! walks through the prologue, the handover and a few frames in the order of submission, records every access to every
//! byte, applies each barrier to these records as chapter 7 of the Vulkan 1.3 specification defines it, and checks each
//! access against the records of the same bytes. The two share nothing but the plan, so a mistake goes unnoticed only
//! if it is made twice.
//!
//! Four guarantees are tracked separately, because a barrier can provide one and lack another:
//!
//! - **order**: the earlier access is finished before the later one starts;
//! - **availability**: the written data has left the caches of the writing stage;
//! - **visibility**: it has reached the accessing stage, for each stage and each kind of access separately;
//! - **layout**: an image is in the layout that the access requires.
//!
//! No barrier provides a fifth one, **contents**: bytes must not be read if they were never written, if a discard
//! destroyed them, if another resource in the same memory overwrote them, or if they are left over from an earlier
//! frame.
//!
//! [`mutate`] tests the reverse: a barrier, or one bit of it, is needless if the replay without it shows no violation.
//!
//! # Limits of the model
//!
//! A shader that writes a resource is assumed to write all of it. Within one stage of one pass, accesses to the same
//! resource never conflict: shaders synchronise themselves. (Accesses at two stages do conflict, unless both are
//! atomics, and so do the arguments of a command and its own writes.) A fence orders only resources with a copy per
//! frame in flight, so that barriers must suffice at any pace of the host.

use crate::sync::barrier::Barriers;
use splatgraph_framework::oracle::trace::Trace;
use splatgraph_framework::plan::Plan;

mod calls;
mod cell;
mod memory_state;
pub mod mutate;
mod rules;
mod stages;
#[cfg(test)]
mod tests;
mod violation;

use memory_state::MemoryState;
pub use rules::{Replay, Rules};
pub use violation::{Actor, Missing, Violation, ViolationKind, What, When};

/// Replays a plan and returns its violations. The ids in the plan must be valid, as in every solved plan.
///
/// A violation that recurs between the same two passes, for instance in every frame, is reported once.
pub fn replay(plan: &Plan, barriers: &Barriers, replay: &Replay) -> Vec<Violation> {
    let trace = Trace::new(plan, replay.copies);
    let mut memory = MemoryState::new(plan, &trace, *replay, Rules::HAZARDS, false);
    memory.run(barriers);
    memory.findings.violations
}

/// Replays successive plans, each for its number of frames, with two frames in flight.
///
/// Between two plans the backend records one barrier from everything to everything. Resources with a
/// [history](splatgraph_framework::plan::Resource::history) of the same name and shape continue, unless another pass of
/// the new prologue writes them. Their [`Work::ClearHistory`](splatgraph_framework::ir::Work::ClearHistory) is omitted
/// together with the barrier on its image, and the image is transitioned to the layout that the pass would have left.
/// All other resources of the new plan are fresh memory.
pub fn replay_swap(plans: &[(&Plan, &Barriers, u32)]) -> Vec<Violation> {
    let mut violations = Vec::new();
    let mut carried = Vec::new();
    for (index, (plan, barriers, frames)) in plans.iter().enumerate() {
        let replay = Replay { frames: *frames, ..Replay::default() };
        let trace = Trace::new(plan, replay.copies);
        let mut memory = MemoryState::new(plan, &trace, replay, Rules::HAZARDS, false);
        memory.adopt(&carried);
        memory.run(barriers);
        carried = memory.carry();
        let found = memory.findings.violations.into_iter();
        violations.extend(found.map(|violation| Violation { plan: index, ..violation }));
    }
    violations
}

/// Returns true if a replay of four frames shows a violation under `rules`.
pub fn has_violation(plan: &Plan, barriers: &Barriers, rules: Rules) -> bool {
    let replay = Replay::default();
    let trace = Trace::new(plan, replay.copies);
    let mut memory = MemoryState::new(plan, &trace, replay, rules, true);
    memory.run(barriers);
    !memory.findings.violations.is_empty()
}
