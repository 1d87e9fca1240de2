//! The logical order of pipeline stages, and sets of (stage, access) pairs.
//!
//! Vulkan 1.3, 7.1.2 "Pipeline Stages": a source stage mask also stands for the logically earlier stages and a target
//! stage mask for the logically later ones, but only for the order of execution. Memory accesses are in a barrier's
//! scope only at stages that it names.

use crate::ir::{Accesses, Stages};

/// Returns these stages and all earlier ones of a pipeline: the scope of a source mask.
pub fn with_earlier(stages: Stages) -> Stages {
    let mut scope = stages;
    if stages.contains(Stages::COLOR_OUTPUT) {
        scope |= Stages::FRAGMENT | Stages::VERTEX | Stages::INDIRECT;
    }
    if stages.contains(Stages::FRAGMENT) {
        scope |= Stages::VERTEX | Stages::INDIRECT;
    }
    if stages.intersects(Stages::VERTEX | Stages::COMPUTE) {
        scope |= Stages::INDIRECT;
    }
    scope
}

/// Returns these stages and all later ones of a pipeline: the scope of a target mask.
pub fn with_later(stages: Stages) -> Stages {
    let mut scope = stages;
    if stages.contains(Stages::INDIRECT) {
        scope |= Stages::VERTEX | Stages::FRAGMENT | Stages::COLOR_OUTPUT | Stages::COMPUTE;
    }
    if stages.contains(Stages::VERTEX) {
        scope |= Stages::FRAGMENT | Stages::COLOR_OUTPUT;
    }
    if stages.contains(Stages::FRAGMENT) {
        scope |= Stages::COLOR_OUTPUT;
    }
    scope
}

/// Returns the stages that stand for what a command did at `stage` if a source mask names one: that stage, and the later ones
/// of the command's own pipeline.
///
/// `INDIRECT` is the one stage that two pipelines have. That a later stage stands for it is said of the pipeline that a command
/// runs; whether `COMPUTE` stands for the reading of a draw's arguments is open, and a driver with queues of its own for
/// dispatches and draws (PanVK) does not wait for it. So it does not count.
pub fn stood_for_by(stage: Stages, dispatch: bool) -> Stages {
    match stage {
        Stages::INDIRECT if dispatch => Stages::INDIRECT | Stages::COMPUTE,
        Stages::INDIRECT => Stages::INDIRECT | Stages::VERTEX | Stages::FRAGMENT | Stages::COLOR_OUTPUT,
        _ => with_later(stage),
    }
}

/// Returns the accesses that one stage can perform (Vulkan 1.3, table "Supported access types").
pub fn performed_by(stage: Stages) -> Accesses {
    match stage {
        Stages::INDIRECT => Accesses::INDIRECT_READ,
        Stages::VERTEX | Stages::FRAGMENT | Stages::COMPUTE => {
            Accesses::UNIFORM_READ | Accesses::STORAGE_READ | Accesses::STORAGE_WRITE
        }
        Stages::COLOR_OUTPUT => Accesses::COLOR_READ | Accesses::COLOR_WRITE,
        Stages::COPY => Accesses::TRANSFER_READ | Accesses::TRANSFER_WRITE,
        Stages::CLEAR => Accesses::TRANSFER_WRITE,
        Stages::HOST => Accesses::HOST_READ,
        _ => Accesses::empty(),
    }
}

/// Holds a set of (stage, access) pairs: 16 bits of accesses for each of 8 stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pairs(u128);

const ACCESS_BITS: u32 = u128::BITS / 8;
const _: () = assert!(Stages::all().bits() < 1 << 8 && Accesses::all().bits() < 1 << ACCESS_BITS);

impl Pairs {
    pub const NONE: Pairs = Pairs(0);
    pub const ALL: Pairs = Pairs(u128::MAX);

    /// Combines each of the accesses with each of the stages.
    pub fn of(stages: Stages, accesses: Accesses) -> Pairs {
        let mut pairs = 0;
        let mut left = stages.bits();
        while left != 0 {
            pairs |= u128::from(accesses.bits()) << (left.trailing_zeros() * ACCESS_BITS);
            left &= left - 1;
        }
        Pairs(pairs)
    }

    pub fn union(self, other: Pairs) -> Pairs {
        Pairs(self.0 | other.0)
    }

    /// Returns true if it has this one access at this one stage.
    pub fn has(self, stage: Stages, access: Accesses) -> bool {
        self.0 & Pairs::of(stage, access).0 != 0
    }
}
