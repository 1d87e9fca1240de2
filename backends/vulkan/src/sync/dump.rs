//! The barriers of a plan in its dump, with names in place of numbers.

use super::barrier::{Barrier, Barriers, Cause};
use splatgraph_framework::dump::{Declared, Dump, DumpBarrier, DumpCause, DumpTransition, Masks};
use splatgraph_framework::ir::PassId;
use splatgraph_framework::plan::{Plan, Scope};

/// Adds the barriers of a plan to its dump.
pub fn add_barriers(dump: Dump, plan: &Plan, barriers: &Barriers) -> Dump {
    let call = |(at, call): (Option<PassId>, &Vec<Barrier>)| -> Vec<DumpBarrier> {
        call.iter().map(|barrier| barrier_of(plan, barrier, at)).collect()
    };
    dump.with_barriers(barriers.calls(plan).map(call))
}

fn barrier_of(plan: &Plan, barrier: &Barrier, at: Option<PassId>) -> DumpBarrier {
    DumpBarrier {
        id: 0,
        before: at.map(|id| Declared::pass(plan, id)),
        image: barrier.image.map(|change| DumpTransition {
            image: plan.resource(change.image).name.clone(),
            old: change.old,
            new: change.new,
        }),
        masks: Masks::new(
            Scope { stages: barrier.source_stages, accesses: barrier.source_accesses },
            Scope { stages: barrier.target_stages, accesses: barrier.target_accesses },
        ),
        dependencies: barrier.causes.iter().map(|cause| cause_of(plan, cause)).collect(),
    }
}

fn cause_of(plan: &Plan, cause: &Cause) -> DumpCause {
    DumpCause {
        hazard: cause.hazard,
        before: Declared::pass(plan, cause.before),
        resource: Declared::resource(plan, cause.resource),
        after: cause.after.iter().map(|id| Declared::pass(plan, *id)).collect(),
        previous_frame: cause.previous_frame,
        alias: cause.alias.map(|id| Declared::resource(plan, id)),
        masks: Masks::new(
            Scope { stages: cause.source_stages, accesses: cause.source_accesses },
            Scope { stages: cause.target_stages, accesses: cause.target_accesses },
        ),
    }
}
