//! Defines the barriers of a plan, as plain data.

use splatgraph_framework::ir::{Masks, PassId, Stages, Work};
use splatgraph_framework::plan::{Cause, Plan, Transition};

/// The barriers of a plan. The barriers before one pass are recorded as one call.
///
/// A call has at most one barrier on all memory, which comes first, and one for each image that changes its layout.
/// Barriers of one call do not form chains with each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Barriers {
    /// The barriers before each pass, indexed by [`PassId`].
    pub before: Vec<Vec<Barrier>>,
    /// Barriers recorded once, between the prologue and the first frame.
    ///
    /// They make the prologue's writes visible to frames, and transition images to the layouts they have between
    /// frames.
    pub handover: Vec<Barrier>,
}

impl Barriers {
    /// Returns the barriers before a pass, or the handover's for `None`.
    pub fn at(&self, at: Option<PassId>) -> &Vec<Barrier> {
        at.map_or(&self.handover, |pass| &self.before[pass.index()])
    }

    /// Returns a mutable reference to the barriers before a pass, or the handover's for `None`.
    pub fn at_mut(&mut self, at: Option<PassId>) -> &mut Vec<Barrier> {
        match at {
            Some(pass) => &mut self.before[pass.index()],
            None => &mut self.handover,
        }
    }

    /// Lists the calls of the prologue, the handover (`None`) and the frame, in order. A pass without barriers has an
    /// empty call.
    pub fn calls<'a>(&'a self, plan: &'a Plan) -> impl Iterator<Item = (Option<PassId>, &'a Vec<Barrier>)> {
        let passes = |ids: &'a [PassId]| ids.iter().copied().map(Some);
        let all = passes(&plan.prologue).chain([None]).chain(passes(&plan.frame));
        all.map(|at| (at, self.at(at)))
    }

    /// Lists the stages, except `HOST`, whose work in this frame or the next waits for the export's copies.
    ///
    /// A blit recorded after the frame counts as one of these copies, so work that waits for them must wait for the
    /// blit. Later barriers name `COPY`, or chain with barriers between the export and the frame's end. Those barriers
    /// come before the blit, so their targets are listed as well.
    pub fn waiting_for_copies(&self, plan: &Plan) -> Stages {
        let after = plan.frame.iter().skip_while(|pass| plan.pass(**pass).work != Work::Export).skip(1);
        let mut waiting = Stages::COPY;
        for pass in after {
            let call = self.at(Some(*pass)).iter();
            let chained = call.filter(|barrier| barrier.masks.source_stages.intersects(waiting));
            waiting |= chained.map(|barrier| barrier.masks.target_stages).collect::<Stages>();
        }
        waiting - Stages::HOST
    }
}

/// A barrier: orders earlier commands (the source) and their memory accesses before later ones (the target).
///
/// All earlier work of the source stages and of stages before them happens before all later work of the target stages
/// and of stages after them, for all resources. Barriers of successive calls form chains if their scopes overlap.
/// Writes by the source accesses in the source stages themselves are made available. Available writes (from here, or
/// from earlier in the chain) become visible to the target accesses in the target stages themselves. Without an image,
/// availability and visibility apply to all memory, otherwise only to accesses through that image. (Vulkan 1.3,
/// chapter 7, "Synchronization and Cache Control".)
#[derive(Clone, Debug, PartialEq)]
pub struct Barrier {
    /// The image whose layout changes; `None` for a barrier on all memory. The change is a write that happens between
    /// source and target, and is visible to the target.
    pub image: Option<Transition>,
    /// Stages to wait for, writes to make available, stages that wait, and accesses that the writes become visible to.
    pub masks: Masks,
    /// The conflicts that the barrier resolves, each with the masks that it alone requires. Never empty in the result
    /// of [`barriers`](super::barriers).
    pub causes: Vec<(Cause, Masks)>,
}

/// A pass with the barriers before it, while they are being placed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Step {
    pub barriers: Vec<Barrier>,
    pub pass: PassId,
}
