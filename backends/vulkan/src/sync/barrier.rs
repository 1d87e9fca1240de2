//! The barriers of a plan, as plain data.

use splatgraph_framework::ir::{Accesses, Hazard, Layout, PassId, ResourceId, Stages, Work};
use splatgraph_framework::plan::Plan;

/// Lists the barriers of a plan. Those before one pass are recorded as one call.
///
/// A call has at most one barrier on all memory, which comes first, and one for each image that changes its layout. Those of one call
/// do not form chains with each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Barriers {
    /// The barriers before each pass, indexed by [`PassId`].
    pub before: Vec<Vec<Barrier>>,
    /// Recorded once, between the prologue and the first frame: shows the frames what the prologue wrote, and brings images into the
    /// layouts that they are in between frames.
    pub handover: Vec<Barrier>,
}

impl Barriers {
    /// Returns the barriers before a pass; those of the handover for `None`.
    pub fn at(&self, at: Option<PassId>) -> &Vec<Barrier> {
        at.map_or(&self.handover, |pass| &self.before[pass.index()])
    }

    /// Returns the barriers of a call, to be changed.
    pub fn at_mut(&mut self, at: Option<PassId>) -> &mut Vec<Barrier> {
        match at {
            Some(pass) => &mut self.before[pass.index()],
            None => &mut self.handover,
        }
    }

    /// Lists the calls of the first frame with their barriers, the handover between prologue and frame. Passes without barriers have
    /// an empty one.
    pub fn calls<'a>(&'a self, plan: &'a Plan) -> impl Iterator<Item = (Option<PassId>, &'a Vec<Barrier>)> {
        let passes = |ids: &'a [PassId]| ids.iter().copied().map(Some);
        let all = passes(&plan.prologue).chain([None]).chain(passes(&plan.frame));
        all.map(|at| (at, self.at(at)))
    }

    /// Lists the stages whose work, in this frame or the next, waits for the copies of the plan's export.
    ///
    /// A blit that is recorded behind the frame takes its place among these copies: what waits for them must wait for it as well. Later
    /// barriers name `COPY`, or chain with those between the export and the frame's end, which came before the blit; so the
    /// targets of these are listed, too.
    pub fn waiting_for_copies(&self, plan: &Plan) -> Stages {
        let after = plan.frame.iter().skip_while(|pass| plan.pass(**pass).work != Work::Export).skip(1);
        let mut waiting = Stages::COPY;
        for pass in after {
            let call = self.at(Some(*pass)).iter();
            let chained = call.filter(|barrier| barrier.source_stages.intersects(waiting));
            waiting |= chained.map(|barrier| barrier.target_stages).collect::<Stages>();
        }
        waiting - Stages::HOST
    }
}

/// Orders earlier commands, at the source, before later ones, at the target, and their memory accesses with them.
///
/// All earlier work of the source stages and of stages before them happens before all later work
/// of the target stages and of stages after them, for all resources. Barriers with overlapping scopes form chains.
/// Writes by the source accesses in the source stages themselves are made available. Available writes (from here, or
/// from earlier in the chain) become visible to the target accesses in the target stages themselves. Without an image,
/// availability and visibility apply to all memory, otherwise only to accesses through that image.
/// (Vulkan 1.3, chapter 7, "Synchronization and Cache Control".)
#[derive(Clone, Debug, PartialEq)]
pub struct Barrier {
    /// The image whose layout changes. The change is a write that happens between source and target, and is visible to the
    /// target.
    pub image: Option<Transition>,
    /// Stages to wait for.
    pub source_stages: Stages,
    /// Writes to make available.
    pub source_accesses: Accesses,
    /// Stages that wait.
    pub target_stages: Stages,
    /// Accesses that the writes become visible to.
    pub target_accesses: Accesses,
    /// The conflicts that it resolves, one entry per resource: never empty in what [`barriers`](super::barriers) returns.
    pub causes: Vec<Cause>,
}

/// Changes an image's layout. `old` is [`Layout::Undefined`] where the contents are not needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Transition {
    /// The image.
    pub image: ResourceId,
    /// The layout before.
    pub old: Layout,
    /// The layout after.
    pub new: Layout,
}

/// Gives one reason for a barrier: the accesses of `after` conflict with those of `before`.
#[derive(Clone, Debug, PartialEq)]
pub struct Cause {
    /// The kind of conflict.
    pub hazard: Hazard,
    /// The pass that needs it: the one after the call, or a later one that would otherwise need a call of its own. (It may be one at
    /// the start of the next frame, whose needs the last call of this one meets.)
    pub before: PassId,
    /// The resource that it accesses.
    pub resource: ResourceId,
    /// The passes that are waited for, the latest of each kind. Empty where an image was never touched.
    pub after: Vec<PassId>,
    /// They ran in the frame before that of `before`.
    pub previous_frame: bool,
    /// The resource that they touched, where it is another one in the same memory.
    pub alias: Option<ResourceId>,
    /// The stages that this reason alone waits for.
    pub source_stages: Stages,
    /// Its writes to make available.
    pub source_accesses: Accesses,
    /// Its stages that wait.
    pub target_stages: Stages,
    /// Its accesses that the writes become visible to.
    pub target_accesses: Accesses,
}

/// A pass with the barriers before it, while they are being placed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Step {
    pub barriers: Vec<Barrier>,
    pub pass: PassId,
}
