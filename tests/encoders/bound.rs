//! Derives lower bounds on the encoders, barriers, waits and fences of a frame on Metal. They follow from the frame's
//! passes and their dependencies only, without the lowering.
//!
//! For the given order of the passes, careful hand-written code cannot have fewer
//!
//! - **encoders** than runs of passes of one kind. A draw begins a new run if it clears, if its targets differ from the
//!   run's, or if it conflicts with a draw of the run other than by blending.
//! - **barriers** in a run of dispatches than disjoint pairs of conflicting passes, where each pair begins no earlier
//!   than the previous one ends. Each pair needs a barrier between its passes, and no barrier serves two pairs.
//! - **waits** than *last conflicts*, over all runs. A last conflict of a run is an earlier run, of this or the
//!   previous frame, that conflicts with it and comes before none of its other conflicts.
//! - **fences** than runs whose updates are awaited at one time.
//!
//! The bounds on waits and fences assume that two runs are ordered only if one depends on the other, directly or
//! through others.
//!
//! In a chain of runs, each run has one last conflict, and one fence serves all. A run beside the chain makes a fork,
//! such as the draw of a mesh beside the sort in `mesh_quads`. The run that joins the branches has two last conflicts,
//! and must wait for both. A wait is for the latest update of its fence, so two updates that are awaited at one time
//! need two fences.

use splatgraph_framework::ir::{Hazard, Load, PassId, Stages, Target, Work};
use splatgraph_framework::plan::{Dependency, Plan};
use std::collections::HashSet;

#[derive(Debug, PartialEq, Eq)]
pub struct Least {
    pub encoders: usize,
    pub fences: usize,
    pub waits: usize,
    pub barriers: usize,
}

/// Pairs of passes, in both orders, of which one depends directly on the other. `any` contains all of them; `hard`
/// contains the pairs that depend other than by blending into one target.
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

/// Returns the maximum number of disjoint pairs of conflicting passes: each begins no earlier than the previous one
/// ends.
fn pairs(run: &[PassId], conflicts: &Conflicts) -> usize {
    let (mut pairs, mut begin) = (0, 0);
    for (at, pass) in run.iter().enumerate() {
        // Greedy: taking the pair that ends first is optimal.
        if (begin..at).any(|earlier| conflicts.any.contains(&(run[earlier], *pass))) {
            (pairs, begin) = (pairs + 1, at);
        }
    }
    pairs
}

/// Returns pairs of runs: a last conflict, and the run that waits for it.
///
/// Runs are numbered through two frames, from 0 and from `runs.len()`. The waiting runs are those of the second frame.
fn last_conflicts(runs: &[Vec<PassId>], conflicts: &Conflicts) -> Vec<(usize, usize)> {
    let count = runs.len();
    let meet = |one: usize, two: usize| {
        let passes = |run: usize| runs[run % count].iter();
        passes(one).any(|one| passes(two).any(|two| conflicts.any.contains(&(*one, *two))))
    };
    // Walks three frames and keeps the waits of the third, for whose previous frame `after` is complete. `after[run]`
    // holds the runs that come before `run`, directly or through others.
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

/// Returns the maximum number of runs awaited at one time. `waits` are those of the second of two frames, each with
/// `count` runs.
fn most_awaited(waits: &[(usize, usize)], count: usize) -> usize {
    let awaited = |time: usize| {
        // The next frame has the same waits, shifted by one frame.
        let waits = waits.iter().flat_map(|(one, two)| [(*one, *two), (one + count, two + count)]);
        let open = waits.filter(|(update, wait)| *update < time && time <= *wait);
        open.map(|(update, _)| update).collect::<HashSet<_>>().len()
    };
    (count..2 * count).map(awaited).max().unwrap_or(0)
}
