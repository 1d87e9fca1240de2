//! Derives the minimum number of encoders, waits and barriers of a frame on Metal from its passes and their
//! dependencies only, without the lowering.
//!
//! The order of the passes is given. Then a careful version by hand cannot have fewer
//!
//! - **encoders** than the frame has runs of one kind, where draws end a run if they clear, if their targets are others than those
//!   before them, or if they conflict with a draw of the run other than by blending;
//! - **barriers** in a run of dispatches than there are pairs of conflicting passes one after another, the next pair beginning no
//!   earlier than the last one ends: there must be one between the passes of each pair, and different pairs have different ones;
//! - **waits** than there are runs which conflict with another run, of this frame or of the previous frame: nothing else orders them;
//! - **fences** than one, if anything waits.

use splatgraph_framework::ir::{Hazard, Load, PassId, Stages, Target, Work};
use splatgraph_framework::plan::{Dependency, Plan};
use std::collections::HashSet;

/// The minimum counts of a frame.
#[derive(Debug, PartialEq, Eq)]
pub struct Least {
    pub encoders: usize,
    pub fences: usize,
    pub waits: usize,
    pub barriers: usize,
}

/// Passes of which one depends on the other: other than by blending into one target, and in any way. Further conflicts are chains of
/// these.
struct Conflicts {
    hard: HashSet<(PassId, PassId)>,
    any: HashSet<(PassId, PassId)>,
}

impl Conflicts {
    fn of(plan: &Plan) -> Conflicts {
        let mut found = Conflicts { hard: HashSet::new(), any: HashSet::new() };
        let of_device =
            |d: &&Dependency| d.hazard != Hazard::LayoutChange && plan.pass(d.second).work != Work::Host;
        for dependency in plan.dependencies.iter().filter(of_device) {
            let both = [dependency.masks.source_stages, dependency.masks.target_stages];
            let blends = dependency.alias.is_none() && both == [Stages::COLOR_OUTPUT; 2];
            for pair in [(dependency.first, dependency.second), (dependency.second, dependency.first)] {
                found.any.insert(pair);
                if !blends {
                    found.hard.insert(pair);
                }
            }
        }
        found
    }
}

impl Least {
    pub fn of(plan: &Plan) -> Least {
        let conflicts = Conflicts::of(plan);
        let mut runs: Vec<Vec<PassId>> = Vec::new();
        for pass in plan.frame.iter().copied().filter(|id| plan.pass(*id).work != Work::Host) {
            match runs.last_mut().filter(|run| continues(plan, run, pass, &conflicts)) {
                Some(run) => run.push(pass),
                None => runs.push(vec![pass]),
            }
        }
        let dispatches = |run: &&Vec<PassId>| kind(plan, run[0]) == 0;
        let waits = (0..runs.len()).filter(|run| waits(&runs, *run, &conflicts)).count();
        Least {
            encoders: runs.len(),
            fences: waits.min(1),
            waits,
            barriers: runs.iter().filter(dispatches).map(|run| pairs(run, &conflicts)).sum(),
        }
    }
}

fn kind(plan: &Plan, pass: PassId) -> u32 {
    match plan.pass(pass).work {
        Work::Draw { .. } => 1,
        Work::Export => 2,
        _ => 0,
    }
}

fn targets(plan: &Plan, pass: PassId) -> &[Target] {
    match &plan.pass(pass).work {
        Work::Draw { targets, .. } => targets,
        _ => &[],
    }
}

fn continues(plan: &Plan, run: &[PassId], pass: PassId, conflicts: &Conflicts) -> bool {
    let (first, own) = (targets(plan, run[0]), targets(plan, pass));
    kind(plan, run[0]) == kind(plan, pass)
        && own.iter().all(|target| target.load == Load::Keep)
        && own.iter().map(|target| target.image).eq(first.iter().map(|target| target.image))
        && (own.is_empty() || !run.iter().any(|earlier| conflicts.hard.contains(&(*earlier, pass))))
}

/// Returns the maximum number of disjoint pairs of conflicting passes: none begins before the previous one has ended.
fn pairs(run: &[PassId], conflicts: &Conflicts) -> usize {
    let (mut pairs, mut begin) = (0, 0);
    for (at, pass) in run.iter().enumerate() {
        // The pair that ends first is as good as any.
        if (begin..at).any(|earlier| conflicts.any.contains(&(run[earlier], *pass))) {
            (pairs, begin) = (pairs + 1, at);
        }
    }
    pairs
}

/// Returns true if a run conflicts with an earlier one of the frame, or with any of the previous frame.
fn waits(runs: &[Vec<PassId>], run: usize, conflicts: &Conflicts) -> bool {
    let meets = |other: &Vec<PassId>| {
        other.iter().any(|one| runs[run].iter().any(|two| conflicts.any.contains(&(*one, *two))))
    };
    runs.iter().any(meets)
}
