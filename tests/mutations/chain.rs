//! Lower bounds on the barrier calls of a frame, derived from the passes' accesses, independent of the solver's
//! barriers.
//!
//! Where one pass depends on another, some call must be recorded between the two. Along a chain of such pairs these calls
//! are different ones, because the second pass of one pair is the first of the next. So that no list of barriers has fewer
//! calls than the longest chain has links. There are two such bounds:
//!
//! - with [`reads_what_was_written`] it holds whatever the order of the passes, and whichever resources share memory;
//! - with [`conflicts`] it holds for the order and the memory of the plan.
//!
//! One more call is needed if the first pass of the frame changes a layout ([`changes_a_layout_first`]): this call comes before every
//! link of a chain, because both passes of a link are in the frame.

use splatgraph_framework::ir::Use;
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::sync::Barriers;

/// Counts the barrier calls of a frame of this plan.
pub fn calls(plan: &Plan, barriers: &Barriers) -> usize {
    plan.frame.iter().filter(|pass| !barriers.at(Some(**pass)).is_empty()).count()
}

/// The passes of the longest chain of one frame, by name, each of which depends on the one before it. `depends` is given two
/// steps of the frame, the earlier first.
pub fn longest(plan: &Plan, depends: impl Fn(&Plan, usize, usize) -> bool) -> Vec<&str> {
    // For each step, the length of the longest chain that ends there, and the previous step in it.
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

/// Returns true if the first pass of each frame changes the layout of an image. The plan places a change immediately before the pass.
pub fn changes_a_layout_first(plan: &Plan) -> bool {
    plan.frame.first().is_some_and(|first| plan.layout_changes_at(Some(*first)).next().is_some())
}

fn uses(plan: &Plan, step: usize) -> &[Use] {
    &plan.pass(plan.frame[step]).uses
}

/// Returns true if the later step reads data whose last writer is the earlier step.
pub fn reads_what_was_written(plan: &Plan, earlier: usize, later: usize) -> bool {
    uses(plan, later).iter().filter(|touch| reads(touch)).any(|touch| {
        let writes = |other: &Use| other.resource == touch.resource && other.accesses.writes();
        (0..later).rfind(|step| uses(plan, *step).iter().any(writes)) == Some(earlier)
    })
}

/// Returns true if both steps access the same memory and one writes it, or if they need an image in different layouts.
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

/// Returns true if a use reads. A cleared attachment is not read, although blending names the access.
fn reads(touch: &Use) -> bool {
    touch.accesses.reads() && !touch.discards
}
