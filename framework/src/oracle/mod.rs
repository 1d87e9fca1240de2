//! An oracle for barriers: it replays a plan on memory that remembers who touched it, and objects to whatever Vulkan leaves
//! undefined.
//!
//! The solver places barriers by reasoning about the whole plan. The oracle does not reason: it walks through the
//! prologue, the handover and a few frames in the order in which they are submitted, writes down every access to
//! every byte, lets each barrier do to these records what chapter 7 of the Vulkan 1.3 specification says it does, and
//! looks, at each access, whether the records of the same bytes permit it. The two share nothing but [`crate::plan`],
//! so that a mistake has to be made twice to go unnoticed.
//!
//! Four things are kept apart, because a barrier can provide one and lack another:
//!
//! - **order**: the earlier access is finished before the later one starts;
//! - **availability**: what was written has left the caches of those who wrote it;
//! - **visibility**: it has reached those who are about to touch it, each stage and each kind of access for itself;
//! - **layout**: an image is in the layout in which it is touched.
//!
//! And one thing that no barrier provides: **contents**. Bytes that nobody wrote, that a discard destroyed, that
//! another resource in the same memory overwrote or that are left over from an earlier frame must not be read.
//!
//! [`mutate`] turns the question round: a barrier, or one bit of it, without which the oracle has no objection is
//! needless.
//!
//! The files: `stages` holds the logical order of pipeline stages; `script` reads from a plan what each pass does to
//! which bytes; `memory` has the records, and what barriers and accesses do to them; `world` walks.
//!
//! # Where the model stops
//!
//! A shader that is said to write a resource is taken to write all of it. Within one pass, accesses to the same
//! resource never conflict: shaders synchronise themselves. A fence orders only what exists once per frame in flight,
//! so that barriers have to hold whatever the pace of the host.

use crate::plan::Plan;

mod memory;
pub mod mutate;
mod objection;
mod script;
mod stages;
#[cfg(test)]
mod tests;
mod world;

pub use objection::{Actor, Kind, Missing, Objection, When};
use script::Script;
use world::World;

/// How a plan is replayed.
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

/// All that is wrong with the plan's barriers. What recurs between the same two passes, for instance in every frame, is
/// told once.
///
/// The ids in the plan must be valid, as they are in every plan that was solved.
pub fn replay(plan: &Plan, replay: &Replay) -> Vec<Objection> {
    let script = Script::new(plan, replay.copies);
    let mut world = World::new(&script, false);
    world.run(plan, &script, replay);
    world.findings.objections
}

/// Replays plans that follow one another, each for so many frames, two of them in flight.
///
/// Between two plans the backend records one barrier from everything to everything. Resources with a
/// [history](crate::plan::Resource::history) of the same name and shape live on: their
/// [`Work::Start`](crate::ir::Work::Start) is left out together with the barrier on its image, and the image is brought
/// into the layout that it would have left behind. All else in the new plan is fresh memory.
pub fn replay_swap(plans: &[(&Plan, u32)]) -> Vec<Objection> {
    let mut objections = Vec::new();
    let mut carried = Vec::new();
    for (index, (plan, frames)) in plans.iter().enumerate() {
        let replay = Replay { frames: *frames, ..Replay::default() };
        let script = Script::new(plan, replay.copies);
        let mut world = World::new(&script, false);
        world.adopt(plan, &script, &carried);
        world.run(plan, &script, &replay);
        carried = world.carry(plan, &script);
        let found = world.findings.objections.into_iter();
        objections.extend(found.map(|objection| Objection { plan: index, ..objection }));
    }
    objections
}

/// Whether there is any objection within four frames. Stops at the first.
pub fn objects(plan: &Plan) -> bool {
    let replay = Replay::default();
    let script = Script::new(plan, replay.copies);
    let mut world = World::new(&script, true);
    world.run(plan, &script, &replay);
    !world.findings.objections.is_empty()
}
