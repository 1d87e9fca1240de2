//! Finds barriers for frames whose walk does not reach a fixpoint.
//!
//! Sometimes a barrier is required in one round only because another was absent in the round before. If such
//! dependences form a cycle of odd length, no list of barriers reproduces itself. A minimal sufficient list still
//! exists. More barriers never remove order, so the barriers of two rounds together are sufficient; then every mask bit
//! that is not needed is removed.

use super::barrier::{Barrier, Step};
use super::needs;
use super::state::SyncState;
use splatgraph_framework::ir::Masks;
use splatgraph_framework::plan::Plan;

/// Number of frames to replay. After these, the state repeats.
const FRAMES: usize = 3;

/// Merges the barriers of two successive rounds, and removes the mask bits that are not needed. `None` if the merged
/// barriers do not suffice.
pub(super) fn fixpoint(mut steps: Vec<Step>, other: Vec<Step>, plan: &Plan) -> Option<Vec<Step>> {
    for (step, other) in steps.iter_mut().zip(other) {
        for barrier in other.barriers {
            join(&mut step.barriers, barrier);
        }
    }
    if !holds(&steps, plan) {
        return None;
    }
    for step in 0..steps.len() {
        for at in 0..steps[step].barriers.len() {
            let Barrier { image, masks, .. } = steps[step].barriers[at];
            // The target of a layout change is the pass's own access: all of its bits are needed.
            let fixed = if image.is_some() { masks.target() } else { Masks::default() };
            let least = needs::least(masks.without(fixed), |masks| {
                steps[step].barriers[at].masks = masks.with(fixed);
                holds(&steps, plan)
            });
            steps[step].barriers[at].masks = least.with(fixed);
        }
        let nothing = |b: &Barrier| b.image.is_none() && b.masks == Masks::default();
        steps[step].barriers.retain(|b| !nothing(b));
    }
    Some(steps)
}

/// Adds a barrier to a call. Merges its masks and causes into the call's barrier with the same layout change, or on all
/// memory, if there is one.
fn join(call: &mut Vec<Barrier>, barrier: Barrier) {
    match call.iter_mut().find(|b| b.image == barrier.image) {
        Some(known) => {
            known.masks.add(barrier.masks);
            for cause in barrier.causes {
                if !known.causes.contains(&cause) {
                    known.causes.push(cause);
                }
            }
        }
        // A barrier on all memory must come first.
        None if barrier.image.is_none() => call.insert(0, barrier),
        None => call.push(barrier),
    }
}

fn holds(steps: &[Step], plan: &Plan) -> bool {
    let mut state = SyncState::new(plan);
    (0..FRAMES).all(|_| {
        state.start_frame();
        steps.iter().all(|step| state.replay(step.pass, &step.barriers).is_empty())
    })
}
