//! The possible orders of a frame's passes.

use splatgraph_framework::ir::{PassId, Use, Work};
use splatgraph_framework::plan::Plan;

/// Orders of the frame in which of two passes that touch the same resource, one of them writing, the first stays the first, and
/// whose end is the plan's: all of them, or the first `most` by the order of the plan.
pub fn orders(plan: &Plan, most: usize) -> Vec<Vec<PassId>> {
    let frame = &plan.frame;
    let conflict = |a: PassId, b: PassId| {
        if matches!(plan.pass(b).work, Work::Export | Work::Host) {
            return true;
        }
        let (a, b) = (&plan.pass(a).uses, &plan.pass(b).uses);
        a.iter().any(|x| {
            let meets = |y: &&Use| x.resource == y.resource;
            b.iter().filter(meets).any(|y| x.accesses.writes() || y.accesses.writes())
        })
    };
    // For each pass, its required predecessors.
    let before: Vec<Vec<usize>> = (0..frame.len())
        .map(|at| (0..at).filter(|other| conflict(frame[*other], frame[at])).collect())
        .collect();
    let mut found = Vec::new();
    extend(frame, &before, &mut Vec::new(), most, &mut found);
    found
}

/// Goes on with every pass that may be next.
fn extend(
    frame: &[PassId],
    before: &[Vec<usize>],
    order: &mut Vec<usize>,
    most: usize,
    found: &mut Vec<Vec<PassId>>,
) {
    if order.len() == frame.len() {
        found.push(order.iter().map(|at| frame[*at]).collect());
    }
    for next in 0..frame.len() {
        let ready = !order.contains(&next) && before[next].iter().all(|other| order.contains(other));
        if ready && found.len() < most {
            order.push(next);
            extend(frame, before, order, most, found);
            order.pop();
        }
    }
}
