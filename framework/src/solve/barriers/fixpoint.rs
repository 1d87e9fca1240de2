//! Barriers for a walk that never reaches a fixpoint.
//!
//! It can be that a barrier is needed in one round just because another was not in the round before, and so on in a circle of
//! odd length: then there is no list that asks for exactly itself. There still is one that holds and has nothing to spare. Two
//! rounds together hold, since more barriers never take order away; from these, whatever can go is taken, bit by bit.

use super::needs;
use super::scopes::Masks;
use super::world::{Facts, World};
use crate::plan::{Barrier, Step};

/// Frames after which every frame has been followed by one like it.
const FRAMES: usize = 3;

/// A list of barriers that holds and has no bit to spare, from what two rounds one after the other asked for.
pub(super) fn fixpoint(mut steps: Vec<Step>, other: Vec<Step>, facts: &Facts) -> Option<Vec<Step>> {
    for (step, other) in steps.iter_mut().zip(other) {
        for barrier in other.barriers {
            join(&mut step.barriers, barrier);
        }
    }
    if !holds(&steps, facts) {
        return None;
    }
    for step in 0..steps.len() {
        for at in 0..steps[step].barriers.len() {
            let barrier = steps[step].barriers[at].clone();
            let masks = Masks::of(&barrier);
            // The target of a change of layout is what the pass does to the image: there is nothing to spare.
            let fixed = if barrier.image.is_some() { masks.target() } else { Masks::default() };
            let least = needs::least(masks.without(fixed), |masks| {
                steps[step].barriers[at] = masks.with(fixed).on(&barrier);
                holds(&steps, facts)
            });
            steps[step].barriers[at] = least.with(fixed).on(&barrier);
        }
        let nothing = |b: &Barrier| b.image.is_none() && Masks::of(b) == Masks::default();
        steps[step].barriers.retain(|b| !nothing(b));
    }
    Some(steps)
}

/// Adds a barrier to a call that may have one of the same kind already.
fn join(call: &mut Vec<Barrier>, barrier: Barrier) {
    match call.iter_mut().find(|b| b.image == barrier.image) {
        Some(known) => {
            *known = Masks::of(known).with(Masks::of(&barrier)).on(known);
            for dependency in barrier.dependencies {
                if !known.dependencies.contains(&dependency) {
                    known.dependencies.push(dependency);
                }
            }
        }
        // The one on all memory comes first.
        None if barrier.image.is_none() => call.insert(0, barrier),
        None => call.push(barrier),
    }
}

/// Returns whether every requirement is met in frame after frame.
fn holds(steps: &[Step], facts: &Facts) -> bool {
    let mut world = World::new(facts);
    (0..FRAMES).all(|_| {
        world.start_frame(facts);
        steps.iter().all(|step| world.replay(step.pass, &step.barriers, facts).is_empty())
    })
}
