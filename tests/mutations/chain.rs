//! Lower bounds on the barrier calls of a frame, derived from the passes' accesses, independent of the solver's
//! barriers.
//!
//! If one pass depends on another, a barrier call must be recorded between the two. In a chain of dependent passes,
//! each link needs its own call, because a link begins at the pass where the previous link ends. So the number of links
//! in the longest chain is a lower bound on the calls. Two relations give two bounds:
//!
//! - [`reads_what_was_written`] is independent of the order of the passes and of the sharing of memory;
//! - [`conflicts`] applies to the order and the memory of the plan.
//!
//! If the first pass of the frame changes a layout ([`changes_a_layout_first`]), the frame needs one more call. It is
//! recorded before the first pass, so it is not part of any link.

use splatgraph_framework::ir::Use;
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::sync::Barriers;

pub fn calls(plan: &Plan, barriers: &Barriers) -> usize {
    plan.frame.iter().filter(|pass| !barriers.at(Some(**pass)).is_empty()).count()
}

/// Returns the longest chain of passes of a frame, by name, in which each depends on the one before it. `depends` takes
/// two steps of the frame, the earlier first.
pub fn longest(plan: &Plan, depends: impl Fn(&Plan, usize, usize) -> bool) -> Vec<&str> {
    // For each step, the number of links of the longest chain that ends there, and the step before it in that chain.
    let mut best: Vec<(usize, Option<usize>)> = Vec::new();
    for step in 0..plan.frame.len() {
        let before =
            (0..step).filter(|before| depends(plan, *before, step)).max_by_key(|before| best[*before].0);
        best.push((before.map_or(0, |before| best[before].0 + 1), before));
    }
    let mut chain = Vec::new();
    let mut next = (0..best.len()).max_by_key(|step| best[*step].0);
    while let Some(step) = next {
        chain.push(plan.pass(plan.frame[step]).name.as_str());
        next = best[step].1;
    }
    chain.reverse();
    chain
}

/// Returns the minimum number of calls of a frame, for the order and the memory of the plan.
pub fn least_calls(plan: &Plan) -> usize {
    longest(plan, conflicts).len() - 1 + usize::from(changes_a_layout_first(plan))
}

/// Returns true if the frame begins with a layout change, which the plan places directly before the first pass.
fn changes_a_layout_first(plan: &Plan) -> bool {
    plan.frame.first().is_some_and(|first| plan.layout_changes_at(Some(*first)).next().is_some())
}

fn uses(plan: &Plan, step: usize) -> &[Use] {
    &plan.pass(plan.frame[step]).uses
}

/// Returns true if `later` reads data whose last writer is `earlier`.
pub fn reads_what_was_written(plan: &Plan, earlier: usize, later: usize) -> bool {
    uses(plan, later).iter().filter(|touch| reads(touch)).any(|touch| {
        let writes = |other: &Use| other.resource == touch.resource && other.accesses.writes();
        (0..later).rfind(|step| uses(plan, *step).iter().any(writes)) == Some(earlier)
    })
}

/// Returns true if both steps access the same memory and one writes it. Also if they need an image in different
/// layouts.
pub fn conflicts(plan: &Plan, earlier: usize, later: usize) -> bool {
    uses(plan, earlier).iter().any(|one| {
        uses(plan, later).iter().any(|other| {
            let same = one.resource == other.resource;
            let meet = same || plan.aliases(one.resource).any(|alias| alias == other.resource);
            let writes = one.accesses.writes() || other.accesses.writes();
            meet && (writes || same && one.layout != other.layout)
        })
    })
}

/// Returns true if a use reads. A cleared attachment is not read, although blending declares a read access.
fn reads(touch: &Use) -> bool {
    touch.accesses.reads() && !touch.discards
}
