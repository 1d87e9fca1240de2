//! Tests whether barriers are necessary: removes each of them, and each bit of their masks, and replays the plan.

use super::memory_state::{At, MemoryState};
use super::rules::{Replay, Rules};
use crate::sync::barrier::{Barrier, Barriers};
use splatgraph_framework::ir::{Masks, PassId};
use splatgraph_framework::oracle::trace::Trace;
use splatgraph_framework::plan::Plan;

/// The removal of a whole barrier, or of one bit of its masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mutation {
    /// The pass that the barrier is recorded before; `None` in the handover.
    pub at: Option<PassId>,
    /// Index of the barrier in the call, from 0.
    pub barrier: usize,
    /// The mask bit to clear; a mask without bits becomes Vulkan's `NONE`. `None` removes the whole barrier, with the
    /// layout change of its image.
    pub clear: Option<Masks>,
}

impl Mutation {
    /// Returns true if the mutation clears a write access in a barrier's target.
    pub fn clears_a_written_target(&self) -> bool {
        self.clear.is_some_and(|bit| bit.target_accesses.writes())
    }

    /// Describes the mutation and its place, for instance "target stage COMPUTE of barrier 0 (all memory) before `sort`
    /// in the frame".
    pub fn describe(&self, plan: &Plan, barriers: &Barriers) -> String {
        let Mutation { at, barrier: number, clear } = *self;
        let place = match at {
            None => "in the handover".to_string(),
            Some(pass) => {
                let part = if plan.prologue.contains(&pass) { "prologue" } else { "frame" };
                format!("before `{}` in the {part}", plan.pass(pass).name)
            }
        };
        let barrier = &barriers.at(at)[number];
        let subject = match barrier.image {
            Some(image) => {
                let name = &plan.resource(image.image).name;
                format!("barrier {number} (`{name}`, {:?} to {:?}) {place}", image.old, image.new)
            }
            None => format!("barrier {number} (all memory) {place}"),
        };
        let Some(Masks { source_stages, source_accesses, target_stages, target_accesses }) = clear else {
            return subject;
        };
        let sides = [
            ("source stage", source_stages.to_string()),
            ("source access", source_accesses.to_string()),
            ("target stage", target_stages.to_string()),
            ("target access", target_accesses.to_string()),
        ];
        let bit = sides.iter().filter(|(_, bit)| !bit.is_empty());
        let bit: String = bit.map(|(side, bit)| format!("{side} {bit}")).collect();
        format!("{bit} of {subject}")
    }
}

/// Lists every single mutation of the barriers.
pub fn mutations(plan: &Plan, barriers: &Barriers) -> Vec<Mutation> {
    let mut all = Vec::new();
    for (at, call) in barriers.calls(plan) {
        for (barrier, Barrier { masks, .. }) in call.iter().enumerate() {
            let clears = [None].into_iter().chain(masks.bits().map(Some));
            all.extend(clears.map(|clear| Mutation { at, barrier, clear }));
        }
    }
    all
}

/// Returns the barriers with the mutation applied.
///
/// # Panics
/// Panics if these barriers lack the mutation's pass or barrier.
pub fn apply(barriers: &Barriers, mutation: &Mutation) -> Barriers {
    let mut mutant = barriers.clone();
    take_away(&mut mutant, mutation);
    mutant
}

/// Applies a mutation, and returns the original barrier.
fn take_away(barriers: &mut Barriers, mutation: &Mutation) -> Barrier {
    let call = barriers.at_mut(mutation.at);
    let Some(bit) = mutation.clear else { return call.remove(mutation.barrier) };
    let barrier = &mut call[mutation.barrier];
    let before = barrier.clone();
    barrier.masks = barrier.masks.without(bit);
    before
}

fn put_back(barriers: &mut Barriers, mutation: &Mutation, before: Barrier) {
    let call = barriers.at_mut(mutation.at);
    match mutation.clear {
        None => call.insert(mutation.barrier, before),
        Some(_) => call[mutation.barrier] = before,
    }
}

/// Calls [`needless_by`] with [`Rules::NECESSARY`].
pub fn needless(plan: &Plan, barriers: &Barriers) -> Vec<Mutation> {
    needless_by(plan, barriers, Rules::NECESSARY)
}

/// Returns the mutations that cause no violation within four frames, by `rules`.
///
/// The unmutated barriers must cause no violation.
pub fn needless_by(plan: &Plan, barriers: &Barriers, rules: Rules) -> Vec<Mutation> {
    let replay = Replay::default();
    let trace = Trace::new(plan, replay.copies);
    let mut memory = MemoryState::new(plan, &trace, replay, rules, true);
    // One copy serves all mutants. Each shares the walk of the plan up to the mutation.
    let mut mutant = barriers.clone();
    let mut needless = Vec::new();
    let all = mutations(plan, barriers);
    let mut left = all.iter().peekable();
    let mut next = Some(memory.start());
    while let Some(at) = next.filter(|_| left.peek().is_some()) {
        let place = match at {
            At::Prologue(step) => Some(Some(plan.prologue[step])),
            At::Handover => Some(None),
            At::Begin(_) => None,
            At::Frame(_, step) => Some(Some(plan.frame[step])),
        };
        while let Some(mutation) = left.next_if(|mutation| Some(mutation.at) == place) {
            let before = take_away(&mut mutant, mutation);
            if !memory.trial(&mutant, at) {
                needless.push(*mutation);
            }
            put_back(&mut mutant, mutation, before);
        }
        next = memory.advance(barriers, at);
    }
    needless
}
