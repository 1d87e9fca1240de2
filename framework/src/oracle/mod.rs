//! Replays a plan on memory that records every access, and reports each access that Vulkan leaves undefined.
//!
//! The solver places barriers by reasoning about the whole plan. The oracle does not reason: it walks through the
//! prologue, the handover and a few frames in the order of submission, records every access to every byte, applies
//! each barrier to these records as chapter 7 of the Vulkan 1.3 specification defines it, and checks each access
//! against the records of the same bytes. The two share nothing but [`crate::plan`],
//! so that only the same mistake in both goes unnoticed.
//!
//! It tracks four properties separately, because a barrier can provide one and lack another:
//!
//! - **order**: the earlier access is finished before the later one starts;
//! - **availability**: the written data has left the caches of the writing stage;
//! - **visibility**: it has reached the accessing stage, for each stage and each kind of access separately;
//! - **layout**: an image is in the layout that the access requires.
//!
//! The fifth property is not provided by barriers: **contents**. Bytes that were never written, that a discard destroyed, that
//! another resource in the same memory overwrote or that are left over from an earlier frame must not be read.
//!
//! [`mutate`] tests the opposite: a barrier, or one bit of it, is needless if the replay without it shows no violation.
//! Together, over all mutations of every preset and of 100,000 random graphs, this is strong testing; it is no proof.
//!
//! The files: `stages` holds the logical order of pipeline stages; `trace` lists the accesses of each pass by their
//! bytes; `cell` holds the records of a few bytes, and how barriers and accesses change them; `calls` puts the barriers down until a
//! cell is next touched; `memory_state` walks the plan. [`dependencies()`] checks the plan's dependencies against the same accesses.
//!
//! # Where the model stops
//!
//! A shader that writes a resource is taken to write all of it. Within one stage of one pass, accesses to the same
//! resource never conflict: shaders synchronise themselves. (Those of two stages do, unless both are atomics, and so do the
//! arguments of a command and what it writes itself.) A fence orders only what exists once per frame in flight,
//! so that barriers must hold whatever the pace of the host.

use crate::plan::Plan;

mod calls;
mod cell;
mod dependencies;
mod memory_state;
pub mod mutate;
mod stages;
#[cfg(test)]
mod tests;
mod trace;
mod violation;

pub use dependencies::{Objection, dependencies};
use memory_state::MemoryState;
use trace::Trace;
pub use violation::{Actor, Missing, Violation, ViolationKind, When};

/// Sets the length of a replay and its frames in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Replay {
    /// Frames after the prologue and the handover.
    pub frames: u32,
    /// The host prepares frame `n` when frame `n - in_flight` is finished.
    pub in_flight: u32,
    /// Copies of what the host touches: frame `n` uses copy `n % copies`. With fewer than `in_flight` the host writes
    /// what the device is still reading.
    pub copies: u32,
}

impl Default for Replay {
    /// Four frames, two of them in flight: each copy of what the host touches is used twice.
    fn default() -> Self {
        Replay { frames: 4, in_flight: 2, copies: 2 }
    }
}

/// Chooses among readings of the specification, and among the reasons for a bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rules {
    /// A write after a write needs the first to be visible to the second, as validation has it. Otherwise it is enough that the
    /// first is available, as in the memory model (Vulkan 1.3, appendix B).
    pub writes_see_writes: bool,
    /// A layout change names the write before it in its own source, if nothing has read that since, also where an earlier barrier
    /// made it available. The specification does not ask for this; validation layers do.
    pub changes_name_writes: bool,
}

impl Rules {
    /// The rules by which a plan is judged.
    pub const HAZARDS: Rules = Rules { writes_see_writes: true, changes_name_writes: false };
    /// The rules by which a part of a barrier is needed: the solver places bits for layout changes that only layers ask for.
    pub const NECESSARY: Rules = Rules { writes_see_writes: true, changes_name_writes: true };
    /// The same, with availability alone for writes after writes.
    pub const AVAILABILITY: Rules = Rules { writes_see_writes: false, changes_name_writes: true };
}

/// Replays a plan and returns its violations. One that recurs between the same two passes, for instance in every frame, is
/// reported once.
///
/// The ids in the plan must be valid, as they are in every plan that was solved.
pub fn replay(plan: &Plan, replay: &Replay) -> Vec<Violation> {
    let trace = Trace::new(plan, replay.copies);
    let mut memory = MemoryState::new(&trace, Rules::HAZARDS, false);
    memory.run(plan, &trace, replay);
    memory.findings.violations
}

/// Replays plans that follow one another, each for its number of frames, two of them in flight.
///
/// Between two plans the backend records one barrier from everything to everything. Resources with a
/// [history](crate::plan::Resource::history) of the same name and shape are kept: their
/// [`Work::ClearHistory`](crate::ir::Work::ClearHistory) is left out together with the barrier on its image, and the image is brought
/// into the layout that it would have left behind. All else in the new plan is fresh memory.
pub fn replay_swap(plans: &[(&Plan, u32)]) -> Vec<Violation> {
    let mut violations = Vec::new();
    let mut carried = Vec::new();
    for (index, (plan, frames)) in plans.iter().enumerate() {
        let replay = Replay { frames: *frames, ..Replay::default() };
        let trace = Trace::new(plan, replay.copies);
        let mut memory = MemoryState::new(&trace, Rules::HAZARDS, false);
        memory.adopt(plan, &trace, &carried);
        memory.run(plan, &trace, &replay);
        carried = memory.carry(plan, &trace);
        let found = memory.findings.violations.into_iter();
        violations.extend(found.map(|violation| Violation { plan: index, ..violation }));
    }
    violations
}

/// Returns true if four frames show a violation. Stops at the first.
pub fn has_violation(plan: &Plan) -> bool {
    has_violation_by(plan, Rules::HAZARDS)
}

/// Returns true if four frames show a violation by these rules.
pub fn has_violation_by(plan: &Plan, rules: Rules) -> bool {
    let replay = Replay::default();
    let trace = Trace::new(plan, replay.copies);
    let mut memory = MemoryState::new(&trace, rules, true);
    memory.run(plan, &trace, &replay);
    !memory.findings.violations.is_empty()
}
