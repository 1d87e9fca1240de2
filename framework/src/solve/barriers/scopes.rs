//! Execution order, availability and visibility established by barriers.
//!
//! [`Scopes`] follows Vulkan's model (see [`crate::plan::Barrier`]) for all resources at once: it tracks only stages and
//! times. This suffices because a barrier applies to everything before it: whether a write is visible depends only on the stage
//! and the time of the write. So the cost of a barrier does not depend on the size of the graph.

use crate::ir::{Accesses, Stages};
use crate::plan::Barrier;

/// Number of stages that [`Stages`] names.
pub(super) const STAGES: usize = Stages::all().bits().count_ones() as usize;

/// Number of accesses that [`Accesses`] names.
const ACCESSES: usize = Accesses::all().bits().count_ones() as usize;

/// The pass that is walked as number `n` happens at time `2 n`, the barriers before it at `2 n - 1`. 0 is before everything.
pub(super) type Time = u32;

/// A time for each stage: of what that stage did, all up to then.
type Since = [Time; STAGES];

/// The position of a single stage's or access's bit.
pub(super) fn index(bit: u32) -> usize {
    bit.trailing_zeros() as usize
}

const DRAW: [Stages; 4] = [Stages::INDIRECT, Stages::VERTEX, Stages::FRAGMENT, Stages::COLOR_OUTPUT];
const DISPATCH: [Stages; 2] = [Stages::INDIRECT, Stages::COMPUTE];

/// The stages, and those that come before them in a draw or a dispatch: what a barrier with this source waits for.
pub(super) fn with_earlier(stages: Stages) -> Stages {
    closure(stages, |pipeline, at| &pipeline[..at])
}

/// The stages, and those that come after them: what waits for a barrier with this target.
pub(super) fn with_later(stages: Stages) -> Stages {
    closure(stages, |pipeline, at| &pipeline[at + 1..])
}

fn closure(stages: Stages, implied: impl Fn(&'static [Stages], usize) -> &'static [Stages]) -> Stages {
    let pipelines: [&'static [Stages]; 2] = [&DRAW, &DISPATCH];
    let mut all = stages;
    for pipeline in pipelines {
        for (at, _) in pipeline.iter().enumerate().filter(|(_, stage)| stages.contains(**stage)) {
            all |= implied(pipeline, at).iter().fold(Stages::empty(), |all, stage| all | *stage);
        }
    }
    all
}

/// The access by which a stage writes.
pub(super) fn write_access(stage: Stages) -> Accesses {
    match stage {
        Stages::COLOR_OUTPUT => Accesses::COLOR_WRITE,
        Stages::COPY | Stages::CLEAR => Accesses::TRANSFER_WRITE,
        _ => Accesses::STORAGE_WRITE,
    }
}

/// The four masks of a barrier.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Masks {
    pub source_stages: Stages,
    pub source_accesses: Accesses,
    pub target_stages: Stages,
    pub target_accesses: Accesses,
}

impl Masks {
    pub fn of(barrier: &Barrier) -> Masks {
        Masks {
            source_stages: barrier.source_stages,
            source_accesses: barrier.source_accesses,
            target_stages: barrier.target_stages,
            target_accesses: barrier.target_accesses,
        }
    }

    /// The same barrier with these masks.
    pub fn on(self, barrier: &Barrier) -> Barrier {
        Barrier {
            source_stages: self.source_stages,
            source_accesses: self.source_accesses,
            target_stages: self.target_stages,
            target_accesses: self.target_accesses,
            ..barrier.clone()
        }
    }

    /// Each bit by itself; accesses first, so that stages that only accesses needed can go after them.
    pub fn bits(self) -> impl Iterator<Item = Masks> {
        let accesses =
            self.source_accesses.iter().map(move |a| Masks { source_accesses: a, ..Masks::default() });
        let stages = self.source_stages.iter().map(move |s| Masks { source_stages: s, ..Masks::default() });
        let seen = self.target_accesses.iter().map(move |a| Masks { target_accesses: a, ..Masks::default() });
        let seers = self.target_stages.iter().map(move |s| Masks { target_stages: s, ..Masks::default() });
        accesses.chain(stages).chain(seen).chain(seers)
    }

    /// Without the bits of another.
    pub fn without(self, bits: Masks) -> Masks {
        Masks {
            source_stages: self.source_stages - bits.source_stages,
            source_accesses: self.source_accesses - bits.source_accesses,
            target_stages: self.target_stages - bits.target_stages,
            target_accesses: self.target_accesses - bits.target_accesses,
        }
    }

    /// The target's half.
    pub fn target(self) -> Masks {
        Masks { source_stages: Stages::empty(), source_accesses: Accesses::empty(), ..self }
    }

    /// With the bits of another as well.
    pub fn with(mut self, bits: Masks) -> Masks {
        self.add(bits);
        self
    }

    pub fn add(&mut self, bits: Masks) {
        self.source_stages |= bits.source_stages;
        self.source_accesses |= bits.source_accesses;
        self.target_stages |= bits.target_stages;
        self.target_accesses |= bits.target_accesses;
    }
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(super) struct Scopes {
    /// `ordered[to][from]`: what `from` did happens before what `to` does from now on.
    ordered: [Since; STAGES],
    /// `available[to][from]`: what `from` wrote was made available, before what `to` does from now on.
    available: [Since; STAGES],
    /// `visible[to][access][from]`: what `from` wrote is visible to this access of `to`.
    visible: [[Since; ACCESSES]; STAGES],
    /// `shown[to][access][from]`: what was available to `from` is visible to this access of `to`.
    shown: [[Since; ACCESSES]; STAGES],
}

impl Scopes {
    pub fn new() -> Scopes {
        Scopes {
            ordered: Default::default(),
            available: Default::default(),
            visible: Default::default(),
            shown: Default::default(),
        }
    }

    /// The stages that a barrier may wait for in place of `stage`, so as to be after what that did up to `time`.
    pub fn after(&self, stage: Stages, time: Time) -> Stages {
        stage | reached(&self.ordered, stage, time)
    }

    /// The stages that a barrier may wait for so as to be after what `stage` wrote at `time` was made available.
    pub fn available(&self, stage: Stages, time: Time) -> Stages {
        reached(&self.available, stage, time)
    }

    pub fn is_ordered(&self, from: Stages, time: Time, to: Stages) -> bool {
        self.ordered[index(to.bits())][index(from.bits())] >= time
    }

    /// Returns whether the writes of `from` at `time` are visible to an access of `to`.
    pub fn is_visible(&self, from: Stages, time: Time, to: Stages, access: Accesses) -> bool {
        self.visible[index(to.bits())][index(access.bits())][index(from.bits())] >= time
    }

    /// Returns whether writes available to a stage of `from` at `time` are visible to an access.
    pub fn is_shown(&self, from: Stages, time: Time, to: Stages, access: Accesses) -> bool {
        let shown = &self.shown[index(to.bits())][index(access.bits())];
        from.iter().any(|from| shown[index(from.bits())] >= time)
    }

    /// Lets the barriers of one call act on what happened up to `time`: each's masks, and whether it is one on all memory.
    pub fn apply(&mut self, call: impl Iterator<Item = (Masks, bool)>, time: Time) {
        // Barriers of one call do not chain with each other: each starts from what was before the call.
        let (ordered, available) = (self.ordered, self.available);
        for (masks, memory) in call {
            let (source, target) = (with_earlier(masks.source_stages), with_later(masks.target_stages));
            for from in Stages::all().iter() {
                let at = index(from.bits());
                let chained = |table: &[Since; STAGES]| {
                    source.iter().map(|x| table[index(x.bits())][at]).max().unwrap_or(0)
                };
                let before = if source.contains(from) { time } else { chained(&ordered) };
                let flushed = memory
                    && masks.source_stages.contains(from)
                    && masks.source_accesses.contains(write_access(from));
                let flushed = if flushed { time } else { chained(&available) };
                for to in target.iter() {
                    raise(&mut self.ordered[index(to.bits())][at], before);
                    raise(&mut self.available[index(to.bits())][at], flushed);
                }
                if memory {
                    for (to, access) in masks
                        .target_stages
                        .iter()
                        .flat_map(|to| masks.target_accesses.iter().map(move |access| (to, access)))
                    {
                        let (to, access) = (index(to.bits()), index(access.bits()));
                        raise(&mut self.visible[to][access][at], flushed);
                        raise(&mut self.shown[to][access][at], before);
                    }
                }
            }
        }
    }
}

fn raise(known: &mut Time, time: Time) {
    *known = (*known).max(time);
}

/// The stages for which the table says of `from` at least `time`.
fn reached(table: &[Since; STAGES], from: Stages, time: Time) -> Stages {
    let at = index(from.bits());
    Stages::all().iter().filter(|to| table[index(to.bits())][at] >= time).collect()
}
