//! Finds barriers for frames whose walk does not reach a fixpoint.
//!
//! A barrier can be required in one round only because another was absent in the round before, in a cycle of odd
//! length; then no list of barriers reproduces itself. A sufficient list without needless bits still exists: the
//! barriers of two rounds together are sufficient, since more barriers never remove order, and every bit that can go is
//! then removed.

use super::barrier::{Barrier, Step};
use super::needs;
use super::state::{Inputs, SyncState};
use splatgraph_framework::ir::Masks;

/// Number of frames after which the state repeats.
const FRAMES: usize = 3;

/// Merges the barriers of two successive rounds, and removes the mask bits that are not needed. `None` if the merged
/// barriers do not suffice.
pub(super) fn fixpoint(mut steps: Vec<Step>, other: Vec<Step>, inputs: &Inputs) -> Option<Vec<Step>> {
    for (step, other) in steps.iter_mut().zip(other) {
        for barrier in other.barriers {
            join(&mut step.barriers, barrier);
        }
    }
    if !holds(&steps, inputs) {
        return None;
    }
    for step in 0..steps.len() {
        for at in 0..steps[step].barriers.len() {
            let Barrier { image, masks, .. } = steps[step].barriers[at];
            // The target of a layout change is the pass's own access: all of its bits are needed.
            let fixed = if image.is_some() { masks.target() } else { Masks::default() };
            let least = needs::least(masks.without(fixed), |masks| {
                steps[step].barriers[at].masks = masks.with(fixed);
                holds(&steps, inputs)
            });
            steps[step].barriers[at].masks = least.with(fixed);
        }
        let nothing = |b: &Barrier| b.image.is_none() && b.masks == Masks::default();
        steps[step].barriers.retain(|b| !nothing(b));
    }
    Some(steps)
}

/// Merges a barrier into a call.
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
        // The one on all memory comes first.
        None if barrier.image.is_none() => call.insert(0, barrier),
        None => call.push(barrier),
    }
}

/// Returns true if every requirement is met in all frames.
fn holds(steps: &[Step], inputs: &Inputs) -> bool {
    let mut state = SyncState::new(inputs);
    (0..FRAMES).all(|_| {
        state.start_frame();
        steps.iter().all(|step| state.replay(step.pass, &step.barriers, inputs).is_empty())
    })
}
