//! The possible orders of a frame's passes.

use splatgraph_framework::ir::{PassId, Use, Work};
use splatgraph_framework::plan::Plan;

/// Returns orders of the frame that keep the order of conflicting passes. The plan's export and host passes stay at the
/// end.
///
/// Two passes conflict if they access the same resource and one of them writes. Returns at most `most` orders,
/// beginning with the plan's own.
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

/// Extends `order` by each pass whose predecessors are in it, recursively; adds complete orders to `found` until it has
/// `most`.
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
