//! Lists which accesses must not run at the same time, for models of other APIs than Vulkan.

use super::trace::Trace;
use crate::ir::{Accesses, PassId, ResourceId, Stages};
use crate::plan::Plan;

/// Describes one kind of access of a pass to a resource, at one stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Touch {
    /// The pass.
    pub pass: PassId,
    /// The resource, which may share its memory with others.
    pub resource: ResourceId,
    /// The stage, one bit.
    pub stage: Stages,
    /// The kind of access, one bit.
    pub access: Accesses,
}

/// Pairs two accesses to the same bytes, one of them a write: whichever comes second must wait for the other.
///
/// The two may be of one pass, which then conflicts with itself in another frame (or, if `touches` differ, within the frame, which
/// only the shader can put right).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Conflict {
    /// Both, in the order of the passes' ids; the same twice where an access conflicts with itself alone.
    pub touches: [Touch; 2],
    /// Each frame in flight has its own copy of the bytes, so that the conflict is within a frame alone.
    pub per_frame: bool,
}

/// Lists the conflicts between the passes of a plan, by their bytes, whatever barriers there are.
///
/// The time grows with the square of the number of accesses.
pub fn conflicts(plan: &Plan) -> Vec<Conflict> {
    let trace = Trace::new(plan, 1);
    let all: Vec<_> = (trace.passes.iter().zip(0..))
        .flat_map(|(actions, pass)| actions.accesses.iter().map(move |access| (PassId(pass), access)))
        .collect();
    let mut conflicts = Vec::new();
    for (index, (pass, one)) in all.iter().enumerate() {
        for (other_pass, other) in &all[index..] {
            let (cells, others) = (one.cells(0), other.cells(0));
            let meet = cells.start.max(others.start) < cells.end.min(others.end);
            if !meet || !(one.writes() || other.writes()) {
                continue;
            }
            let touch = |pass, access: &super::trace::Access| Touch {
                pass,
                resource: access.resource,
                stage: access.stage,
                access: access.access,
            };
            conflicts.push(Conflict {
                touches: [touch(*pass, one), touch(*other_pass, other)],
                per_frame: trace.place(one.resource).per_frame(),
            });
        }
    }
    conflicts
}
