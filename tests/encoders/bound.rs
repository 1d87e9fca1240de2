//! Derives the minimum number of encoders, waits and barriers of a frame on Metal from its passes and their
//! dependencies only, without the lowering.
//!
//! The order of the passes is given. Then a careful version by hand cannot have fewer
//!
//! - **encoders** than the frame has runs of one kind, where draws end a run if they clear, if their targets are others than those
//!   before them, or if they conflict with a draw of the run other than by blending;
//! - **barriers** in a run of dispatches than there are pairs of conflicting passes one after another, the next pair beginning no
//!   earlier than the last one ends: there must be one between the passes of each pair, and different pairs have different ones;
//! - **waits** than each run has *last conflicts*: earlier runs, of this frame or of the previous frame, which conflict with it and
//!   which none of its other conflicts comes after;
//! - **fences** than there are runs at any one time whose update is still waited for.
//!
//! The last two hold for versions that order two runs only if one depends on the other, directly or through others. In a chain of runs,
//! each has one last conflict, and one fence serves all. A run beside the chain makes a fork: the draw of a mesh is beside the sort of
//! `mesh_quads`, and beside the previous frame's copies in `mesh`. The run that joins the branches has two last conflicts. It must wait
//! for each, because a wait for one orders it after the other only if one branch waits for the other. A wait is for the last update
//! of its fence, so while two updates are waited for, they need two fences. A version with one wait for each run would let the sort
//! wait for the mesh, or the mesh for the sort.

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
            let attached = Stages::COLOR_OUTPUT | Stages::DEPTH_TESTS;
            let blends = dependency.alias.is_none() && both.iter().all(|stages| attached.contains(*stages));
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
        let waits = last_conflicts(&runs, &conflicts);
        Least {
            encoders: runs.len(),
            fences: most_awaited(&waits, runs.len()),
            waits: waits.len(),
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

/// Returns the last conflicts of each run: pairs of an earlier run and the run that waits. Runs of the next frame count on.
fn last_conflicts(runs: &[Vec<PassId>], conflicts: &Conflicts) -> Vec<(usize, usize)> {
    let count = runs.len();
    let meet = |one: usize, two: usize| {
        let passes = |run: usize| runs[run % count].iter();
        passes(one).any(|one| passes(two).any(|two| conflicts.any.contains(&(*one, *two))))
    };
    // Three frames, of which the last has two before it. By run, the earlier ones that it comes after.
    let mut after: Vec<HashSet<usize>> = Vec::new();
    let mut waits = Vec::new();
    for run in 0..3 * count {
        let previous_frame = (run / count).saturating_sub(1) * count;
        let direct: Vec<usize> = (previous_frame..run).filter(|earlier| meet(*earlier, run)).collect();
        let comes_between = |one: usize| direct.iter().any(|other| after[*other].contains(&one));
        if run >= 2 * count {
            let last = direct.iter().filter(|one| !comes_between(**one));
            waits.extend(last.map(|one| (one - count, run - count)));
        }
        let through = direct.iter().flat_map(|one| after[*one].iter().copied());
        after.push(through.chain(direct.iter().copied()).collect());
    }
    waits
}

/// Returns the maximum number of runs that are waited for at one time, of waits in the second of two frames with `count` runs each.
fn most_awaited(waits: &[(usize, usize)], count: usize) -> usize {
    let awaited = |time: usize| {
        // The waits of the next frame are these, one frame later.
        let waits = waits.iter().flat_map(|(one, two)| [(*one, *two), (one + count, two + count)]);
        let open = waits.filter(|(update, wait)| *update < time && time <= *wait);
        open.map(|(update, _)| update).collect::<HashSet<_>>().len()
    };
    (count..2 * count).map(awaited).max().unwrap_or(0)
}
