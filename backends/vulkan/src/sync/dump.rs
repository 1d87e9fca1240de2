//! Adds the barriers of a plan to its dump, with names instead of numbers.

use super::barrier::{Barrier, Barriers};
use splatgraph_api::BackendError;
use splatgraph_framework::dump::{Declared, Dump, DumpBarrier, DumpCause, DumpWarning};
use splatgraph_framework::ir::{Masks, PassId};
use splatgraph_framework::plan::{Cause, Plan};

/// Adds the barriers of a plan to its dump, or a warning if no valid barriers were found.
pub fn add_barriers(mut dump: Dump, plan: &Plan, barriers: Result<&Barriers, &BackendError>) -> Dump {
    let barriers = match barriers {
        Ok(barriers) => barriers,
        Err(error) => {
            let declared = plan.resource(plan.output).origin.clone();
            let message = format!("this dump has no barriers: {error}");
            dump.warnings.push(DumpWarning { message, help: Vec::new(), declared });
            return dump;
        }
    };
    let call = |(at, call): (Option<PassId>, &Vec<Barrier>)| -> Vec<DumpBarrier> {
        call.iter().map(|barrier| barrier_of(plan, barrier, at)).collect()
    };
    dump.with_barriers(barriers.calls(plan).map(call))
}

fn barrier_of(plan: &Plan, barrier: &Barrier, at: Option<PassId>) -> DumpBarrier {
    let cause =
        |(cause, masks): &(Cause, Masks)| DumpCause { conflict: Declared::cause(plan, cause), masks: *masks };
    DumpBarrier {
        id: 0,
        before: at.map(|id| Declared::pass(plan, id)),
        image: barrier.image.map(|change| change.map(|id| plan.resource(*id).name.clone())),
        masks: barrier.masks,
        dependencies: barrier.causes.iter().map(cause).collect(),
    }
}
