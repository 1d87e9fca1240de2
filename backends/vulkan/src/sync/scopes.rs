//! Tracks the execution order, availability and visibility that barriers establish.
//!
//! [`Scopes`] follows Vulkan's model (see [`Barrier`](super::Barrier)) for all resources at once: it tracks only stages
//! and times. This suffices because a barrier applies to everything before it: whether a write is visible depends only
//! on the stage and the time of the write. So the cost of a barrier does not depend on the size of the graph.

use splatgraph_framework::ir::{Accesses, Masks, Stages};

pub(super) const STAGES: usize = Stages::all().bits().count_ones() as usize;

const ACCESSES: usize = Accesses::all().bits().count_ones() as usize;

/// A position in the walk. Pass number `n`, from 1, is at time `2 n`, the barriers before it at `2 n - 1`. 0 precedes
/// everything.
pub(super) type Time = u32;

/// For each [`Origin`], the time up to which its accesses are covered.
type Since = [Time; ORIGINS];

/// Returns the bit number of a single stage or access.
pub(super) fn index(bit: u32) -> usize {
    bit.trailing_zeros() as usize
}

const DRAW: [Stages; 6] = [
    Stages::INDIRECT,
    Stages::VERTEX,
    Stages::EARLY_TESTS,
    Stages::FRAGMENT,
    Stages::LATE_TESTS,
    Stages::COLOR_OUTPUT,
];
const DISPATCH: [Stages; 2] = [Stages::INDIRECT, Stages::COMPUTE];

/// Returns the stages and the later stages of their pipelines: the scope of a target mask.
pub(super) fn with_later(stages: Stages) -> Stages {
    stages | later_in(&DRAW, stages) | later_in(&DISPATCH, stages)
}

/// Returns the stages of a pipeline from its first one in `stages` on.
fn later_in(pipeline: &[Stages], stages: Stages) -> Stages {
    pipeline.iter().skip_while(|stage| !stages.contains(**stage)).copied().collect()
}

pub(super) const ORIGINS: usize = STAGES + 1;

/// The stage at which a command accesses memory.
///
/// Draws and dispatches both read their arguments at [`Stages::INDIRECT`], but as different origins, because different
/// stages follow. A barrier waits for the stages that it names and for earlier stages *of the same pipeline*: a barrier
/// after `COMPUTE` does not wait for the arguments of a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Origin(usize);

impl Origin {
    pub fn new(stage: Stages, dispatch: bool) -> Origin {
        Origin(if dispatch && stage == Stages::INDIRECT { STAGES } else { index(stage.bits()) })
    }

    pub fn all() -> impl Iterator<Item = Origin> {
        (0..ORIGINS).map(Origin)
    }

    pub fn index(self) -> usize {
        self.0
    }

    pub fn stage(self) -> Stages {
        if self.0 == STAGES { Stages::INDIRECT } else { Stages::from_bits_truncate(1 << self.0) }
    }

    /// Returns the origin's stage and the later stages of its pipeline. A source that names any of them waits for the
    /// origin.
    pub fn named_by(self) -> Stages {
        let stage = self.stage();
        let pipeline: &[Stages] = if self.0 == STAGES { &DISPATCH } else { &DRAW };
        stage | later_in(pipeline, stage)
    }
}

pub(super) fn write_access(stage: Stages) -> Accesses {
    match stage {
        Stages::COLOR_OUTPUT => Accesses::COLOR_WRITE,
        Stages::EARLY_TESTS | Stages::LATE_TESTS => Accesses::DEPTH_WRITE,
        Stages::COPY | Stages::CLEAR => Accesses::TRANSFER_WRITE,
        _ => Accesses::STORAGE_WRITE,
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Scopes {
    /// `ordered[to][from]`: work of `from` up to this time happens before later work of `to`.
    ordered: [Since; STAGES],
    /// `available[to][from]`: writes of `from` up to this time are available before later work of `to`.
    available: [Since; STAGES],
    /// `visible[to][access][from]`: writes of `from` up to this time are visible to this access of `to`.
    visible: [[Since; ACCESSES]; STAGES],
    /// `shown[to][access][from]`: writes available to `from` up to this time are visible to this access of `to`.
    shown: [[Since; ACCESSES]; STAGES],
}

impl Scopes {
    /// Returns the source stages that wait for the work of `origin` up to `time`. A barrier needs any one of them.
    pub fn after(&self, origin: Origin, time: Time) -> Stages {
        origin.named_by() | reached(&self.ordered, origin, time)
    }

    /// Returns the source stages that chain with the barrier which made a write by `stage` at `time` available. A
    /// barrier needs any one of them.
    pub fn available(&self, stage: Stages, time: Time) -> Stages {
        reached(&self.available, Origin::new(stage, false), time)
    }

    pub fn is_ordered(&self, from: Origin, time: Time, to: Stages) -> bool {
        self.ordered[index(to.bits())][from.index()] >= time
    }

    /// Returns true if the writes of `from` at `time` are visible to an access of `to`.
    pub fn is_visible(&self, from: Stages, time: Time, to: Stages, access: Accesses) -> bool {
        self.visible[index(to.bits())][index(access.bits())][index(from.bits())] >= time
    }

    /// Returns true if writes available to a stage of `from` at `time` are visible to an access.
    pub fn is_shown(&self, from: Stages, time: Time, to: Stages, access: Accesses) -> bool {
        let shown = &self.shown[index(to.bits())][index(access.bits())];
        from.iter().any(|from| shown[index(from.bits())] >= time)
    }

    /// Applies the barriers of one call, which covers accesses up to `time`. Each barrier has its masks, and true if it
    /// is on all memory.
    pub fn apply(&mut self, call: impl Iterator<Item = (Masks, bool)>, time: Time) {
        // Barriers of one call do not form chains: each starts from the state before the call.
        let (ordered, available) = (self.ordered, self.available);
        for (masks, memory) in call {
            let target = with_later(masks.target_stages);
            for from in Origin::all() {
                let at = from.index();
                // Work that is before a stage is also before later stages.
                let chained = |table: &[Since; STAGES]| {
                    masks.source_stages.iter().map(|x| table[index(x.bits())][at]).max().unwrap_or(0)
                };
                let waits = masks.source_stages.intersects(from.named_by());
                let before = if waits { time } else { chained(&ordered) };
                let flushed = memory
                    && masks.source_stages.contains(from.stage())
                    && masks.source_accesses.contains(write_access(from.stage()));
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

/// Returns the stages whose entry for `from` in the table is at least `time`.
fn reached(table: &[Since; STAGES], from: Origin, time: Time) -> Stages {
    Stages::all().iter().filter(|to| table[index(to.bits())][from.index()] >= time).collect()
}
