//! Lowers a plan's dependencies to Vulkan's barriers.
//!
//! A walk over the passes tracks the effect of the barriers so far.
//!
//! A barrier is placed as late as possible, immediately before the pass that requires it, with as few bits as suffice.
//! If all causes of a requirement precede the last call, that call gets the bits instead, so that there are as few
//! calls as possible. For each pass the walk finds the requirements that the barriers so far do not meet: `needs`
//! represents a requirement, `state` tracks the passes and the layouts, and `scopes` tracks the effect of the barriers.
//! The module does not look at accesses: the plan lists the conflicts and the layout changes. If a layout change
//! follows an access, a dependency on the access counts as a dependency on the change, which waited for the access.
//!
//! Every frame records the same barriers, and follows a frame that recorded them, too. The walk over the frame is
//! therefore repeated until the list of barriers is a fixpoint. Additional requirements of the first frame, which
//! follows the prologue, are met once, by the handover between them.

mod barrier;
pub(crate) mod commands;
pub mod dump;
mod fixpoint;
pub mod model;
mod needs;
mod scopes;
mod state;
#[cfg(test)]
mod tests;

use barrier::Step;
pub use barrier::{Barrier, Barriers};
use needs::Requirement;
use splatgraph_api::BackendError;
use splatgraph_framework::ir::{Hazard, Masks, PassId};
use splatgraph_framework::plan::{Plan, Transition};
use state::SyncState;

/// Maximum number of rounds of the walk before it is treated as cyclic.
const MAX_ROUNDS: usize = 8;

/// Lowers the dependencies of a plan to barriers.
///
/// # Errors
/// [`BackendError::Invalid`] if no valid barriers were found, which would be a bug in this module.
pub fn barriers(plan: &Plan) -> Result<Barriers, BackendError> {
    let none = || {
        let text = "no list of barriers was found that is valid for every frame of the plan: please report this bug with the graph";
        BackendError::Invalid(text.to_string())
    };
    place(plan).ok_or_else(none)
}

fn place(plan: &Plan) -> Option<Barriers> {
    let walk = |state: &mut SyncState, ids: &[PassId]| -> Vec<Step> {
        state.start_frame();
        let mut steps = Vec::with_capacity(ids.len());
        ids.iter().for_each(|id| state.place(*id, &mut steps));
        steps
    };

    let mut start = SyncState::new(plan);
    let prologue = walk(&mut start, &plan.prologue);

    let mut state = SyncState::new(plan);
    let mut frame = walk(&mut state, &plan.frame);
    let mut rounds = 0;
    loop {
        let again = walk(&mut state, &plan.frame);
        if again == frame {
            break;
        }
        if rounds == MAX_ROUNDS {
            frame = fixpoint::fixpoint(frame, again, plan)?;
            break;
        }
        (frame, rounds) = (again, rounds + 1);
    }
    let handover = handover(&start, &frame)?;
    let mut before = vec![Vec::new(); plan.passes.len()];
    prologue.into_iter().chain(frame).for_each(|step| before[step.pass.index()] = step.barriers);
    Some(Barriers { before, handover })
}

/// Computes the call between the prologue and the first frame; `None` if no call suffices.
fn handover(start: &SyncState, frame: &[Step]) -> Option<Vec<Barrier>> {
    let mut call = Handover { memory: Masks::default(), needs: Vec::new(), images: Vec::new() };
    for change in start.plan.layout_changes_at(None) {
        let needs = start.change_needs(change, true);
        let masks = needs::least_source(&needs);
        call.images.push((change.transition(), masks, needs, change.before));
    }
    // Every round adds the mask bits that the previous one lacked.
    loop {
        let missing = call.missing(start, frame);
        if missing.is_empty() {
            break;
        }
        if missing.iter().filter(|need| call.add(need)).count() == 0 {
            return None;
        }
    }
    call.reduce(start, frame);
    Some(call.barriers())
}

#[derive(Clone)]
struct Handover {
    memory: Masks,
    /// The requirements that `memory`, the barrier on all memory, meets.
    needs: Vec<Requirement>,
    /// Layout changes, each with its masks, its requirements and the first pass that accesses the image.
    images: Vec<(Transition, Masks, Vec<Requirement>, PassId)>,
}

impl Handover {
    fn barriers(&self) -> Vec<Barrier> {
        let of_prologue = |needs: &[Requirement]| {
            let mut causes = needs::causes(needs);
            causes.iter_mut().for_each(|(cause, _)| cause.previous_frame = false);
            causes
        };
        let mut barriers = Vec::new();
        if self.memory != Masks::default() {
            barriers.push(Barrier { image: None, masks: self.memory, causes: of_prologue(&self.needs) });
        }
        for (transition, masks, needs, first) in &self.images {
            let mut causes = of_prologue(needs);
            if causes.is_empty() {
                let cause = needs::cause(Hazard::LayoutChange, *first, transition.image);
                causes.push((cause, Masks::default()));
            }
            for (cause, own) in &mut causes {
                *own = own.source().with(masks.target());
                if cause.hazard == Hazard::WriteAfterWrite && masks.target_accesses.reads() {
                    cause.hazard = Hazard::ReadAfterWrite;
                }
            }
            barriers.push(Barrier { image: Some(*transition), masks: *masks, causes });
        }
        barriers
    }

    /// Lists the requirements of the first frame that this handover does not meet yet.
    fn missing(&self, start: &SyncState, frame: &[Step]) -> Vec<Requirement> {
        let mut state = start.clone();
        // The handover is recorded right before the first pass.
        let first = frame.first().map_or(PassId(0), |step| step.pass);
        state.call(&self.barriers(), first);
        state.start_frame();
        frame.iter().flat_map(|step| state.replay(step.pass, &step.barriers)).collect()
    }

    /// Adds the mask bits that `need` requires to the call. Returns false if they were already there.
    fn add(&mut self, need: &Requirement) -> bool {
        let mut target = need.least_target();
        let changed =
            |(t, ..): &&mut (Transition, Masks, Vec<Requirement>, PassId)| t.image == need.reason.resource;
        let masks = match self.images.iter_mut().find(changed) {
            // The pass waits for the layout change itself.
            Some((_, masks, ..)) => masks,
            None => {
                // The first frame's own barriers come after this call, so it cannot rely on a chain with them.
                let flushes =
                    Masks { source_stages: need.from, source_accesses: need.flush, ..Masks::default() };
                target.add(if need.flush.is_empty() { need.least_source() } else { flushes });
                self.needs.push(*need);
                &mut self.memory
            }
        };
        let before = *masks;
        masks.add(target);
        *masks != before
    }

    /// Clears every mask bit that the first frame does not need, except in the sources of layout changes.
    fn reduce(&mut self, start: &SyncState, frame: &[Step]) {
        let reduced = needs::least(self.memory, |masks| {
            let less = Handover { memory: *masks, ..self.clone() };
            less.missing(start, frame).is_empty()
        });
        self.memory = reduced;
        for i in 0..self.images.len() {
            // The source of a layout change is already minimal.
            let masks = self.images[i].1;
            let reduced = needs::least(masks.target(), |target| {
                let mut less = self.clone();
                less.images[i].1 = masks.source().with(*target);
                less.missing(start, frame).is_empty()
            });
            self.images[i].1 = masks.source().with(reduced);
        }
    }
}
