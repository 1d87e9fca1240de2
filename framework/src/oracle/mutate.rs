//! Tests whether barriers are necessary: removes each of them, and each bit of their masks, and replays the plan.

use super::memory_state::{At, MemoryState};
use super::trace::Trace;
use super::violation::flag_names;
use super::{Replay, Rules};
use crate::ir::{Accesses, Stages};
use crate::plan::{Barrier, Plan};

/// Locates a call of barriers in a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CallSite {
    /// Before the pass of this step of [`Plan::prologue`].
    Prologue(usize),
    /// The call between the prologue and the first frame.
    Handover,
    /// Before the pass of this step of [`Plan::frame`].
    Frame(usize),
}

impl CallSite {
    /// Returns the barriers of the call.
    ///
    /// # Panics
    /// Panics if the plan has no such step.
    pub fn barriers(self, plan: &Plan) -> &Vec<Barrier> {
        match self {
            CallSite::Prologue(step) => &plan.prologue[step].barriers,
            CallSite::Handover => &plan.handover,
            CallSite::Frame(step) => &plan.frame[step].barriers,
        }
    }

    fn barriers_mut(self, plan: &mut Plan) -> &mut Vec<Barrier> {
        match self {
            CallSite::Prologue(step) => &mut plan.prologue[step].barriers,
            CallSite::Handover => &mut plan.handover,
            CallSite::Frame(step) => &mut plan.frame[step].barriers,
        }
    }
}

/// Selects one bit of one of a barrier's masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bit {
    /// A stage that the barrier waits for.
    SourceStage(Stages),
    /// An access whose writes the barrier makes available.
    SourceAccess(Accesses),
    /// A stage that waits for the barrier.
    TargetStage(Stages),
    /// An access that the barrier makes writes visible to.
    TargetAccess(Accesses),
}

/// Removes a little synchronization from a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mutation {
    /// The whole barrier, with the layout change of its image.
    Remove {
        /// Call of barriers that holds it.
        at: CallSite,
        /// Index in the call, from 0.
        barrier: usize,
    },
    /// One bit; a mask that loses its last is empty, which is Vulkan's `NONE`.
    Clear {
        /// Call of barriers that holds it.
        at: CallSite,
        /// Index in the call, from 0.
        barrier: usize,
        /// Bit to clear.
        what: Bit,
    },
}

impl Mutation {
    fn at(&self) -> (CallSite, usize) {
        match *self {
            Mutation::Remove { at, barrier } | Mutation::Clear { at, barrier, .. } => (at, barrier),
        }
    }

    /// Describes the place and the change, for instance "target stage COMPUTE of barrier 0 (all memory) before `sort`
    /// in the frame".
    pub fn describe(&self, plan: &Plan) -> String {
        let (at, number) = self.at();
        let place = match at {
            CallSite::Prologue(step) => {
                format!("before `{}` in the prologue", plan.pass(plan.prologue[step].pass).name)
            }
            CallSite::Handover => "in the handover".to_string(),
            CallSite::Frame(step) => {
                format!("before `{}` in the frame", plan.pass(plan.frame[step].pass).name)
            }
        };
        let barrier = &at.barriers(plan)[number];
        let subject = match barrier.image {
            Some(image) => {
                let name = &plan.resource(image.image).name;
                format!("barrier {number} (`{name}`, {:?} to {:?}) {place}", image.old, image.new)
            }
            None => format!("barrier {number} (all memory) {place}"),
        };
        match self {
            Mutation::Remove { .. } => subject,
            Mutation::Clear { what, .. } => {
                let bit = match what {
                    Bit::SourceStage(bit) => format!("source stage {}", flag_names(bit.iter_names())),
                    Bit::SourceAccess(bit) => format!("source access {}", flag_names(bit.iter_names())),
                    Bit::TargetStage(bit) => format!("target stage {}", flag_names(bit.iter_names())),
                    Bit::TargetAccess(bit) => format!("target access {}", flag_names(bit.iter_names())),
                };
                format!("{bit} of {subject}")
            }
        }
    }
}

/// Lists every removal from the plan's barriers, one at a time.
pub fn mutations(plan: &Plan) -> Vec<Mutation> {
    let prologue = (0..plan.prologue.len()).map(CallSite::Prologue);
    let frame = (0..plan.frame.len()).map(CallSite::Frame);
    let mut all = Vec::new();
    for at in prologue.chain([CallSite::Handover]).chain(frame) {
        for (barrier, masks) in at.barriers(plan).iter().enumerate() {
            all.push(Mutation::Remove { at, barrier });
            let bits = (masks.source_stages.iter().map(Bit::SourceStage))
                .chain(masks.source_accesses.iter().map(Bit::SourceAccess))
                .chain(masks.target_stages.iter().map(Bit::TargetStage))
                .chain(masks.target_accesses.iter().map(Bit::TargetAccess));
            all.extend(bits.map(|what| Mutation::Clear { at, barrier, what }));
        }
    }
    all
}

/// Returns the plan with the mutation applied.
///
/// # Panics
/// Panics if the mutation is not one of this plan's [`mutations`].
pub fn apply(plan: &Plan, mutation: &Mutation) -> Plan {
    let mut mutant = plan.clone();
    take_away(&mut mutant, mutation);
    mutant
}

/// Applies a mutation, and returns the barrier as it was.
fn take_away(plan: &mut Plan, mutation: &Mutation) -> Barrier {
    let (at, number) = mutation.at();
    let barriers = at.barriers_mut(plan);
    match *mutation {
        Mutation::Remove { .. } => barriers.remove(number),
        Mutation::Clear { what, .. } => {
            let barrier = &mut barriers[number];
            let before = barrier.clone();
            match what {
                Bit::SourceStage(bit) => barrier.source_stages.remove(bit),
                Bit::SourceAccess(bit) => barrier.source_accesses.remove(bit),
                Bit::TargetStage(bit) => barrier.target_stages.remove(bit),
                Bit::TargetAccess(bit) => barrier.target_accesses.remove(bit),
            }
            before
        }
    }
}

fn put_back(plan: &mut Plan, mutation: &Mutation, before: Barrier) {
    let (at, number) = mutation.at();
    let barriers = at.barriers_mut(plan);
    match mutation {
        Mutation::Remove { .. } => barriers.insert(number, before),
        Mutation::Clear { .. } => barriers[number] = before,
    }
}

/// Returns the mutations that cause no violation within four frames, by the rules of [`Rules::NECESSARY`]. The plan itself must have
/// none.
pub fn needless(plan: &Plan) -> Vec<Mutation> {
    needless_by(plan, Rules::NECESSARY)
}

/// Returns the mutations that cause no violation within four frames, by these rules. The plan itself must have none.
pub fn needless_by(plan: &Plan, rules: Rules) -> Vec<Mutation> {
    let replay = Replay::default();
    let trace = Trace::new(plan, replay.copies);
    let mut memory = MemoryState::new(&trace, rules, true);
    // One copy serves all mutants. Each shares the walk of the plan up to the mutation.
    let mut mutant = plan.clone();
    let mut needless = Vec::new();
    let all = mutations(plan);
    let mut left = all.iter().peekable();
    let mut next = Some(memory.start(plan, &trace, &replay));
    while let Some(at) = next.filter(|_| left.peek().is_some()) {
        let place = match at {
            At::Prologue(step) => Some(CallSite::Prologue(step)),
            At::Handover => Some(CallSite::Handover),
            At::Begin(_) => None,
            At::Frame(_, step) => Some(CallSite::Frame(step)),
        };
        while let Some(mutation) = left.next_if(|mutation| Some(mutation.at().0) == place) {
            let before = take_away(&mut mutant, mutation);
            if !memory.trial(&mutant, &trace, &replay, at) {
                needless.push(*mutation);
            }
            put_back(&mut mutant, mutation, before);
        }
        memory.advance(plan, &trace, &replay, at);
        next = At::after(at, plan, &replay);
    }
    needless
}

impl Mutation {
    /// Returns true if it clears a write among the accesses that a barrier makes writes visible to.
    pub fn clears_a_written_target(&self) -> bool {
        matches!(self, Mutation::Clear { what: Bit::TargetAccess(access), .. } if access.writes())
    }
}
