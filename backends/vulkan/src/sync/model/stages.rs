//! Expands stage masks to the stages that they cover, and defines sets of (stage, access) pairs.
//!
//! Vulkan 1.3, 7.1.2 "Pipeline Stages": a source stage mask also covers the logically earlier stages, and a target
//! stage mask the logically later ones, but only for the execution dependency. Memory accesses are in a barrier's scope
//! only at stages that it names.

use splatgraph_framework::ir::{Accesses, Stages};
pub use splatgraph_framework::oracle::stages::with_later;

/// Returns the stages and all earlier ones of their pipelines: the scope of a source mask.
pub fn with_earlier(stages: Stages) -> Stages {
    let mut scope = stages;
    if stages.contains(Stages::COLOR_OUTPUT) {
        scope |= with_earlier(Stages::LATE_TESTS);
    }
    if stages.contains(Stages::LATE_TESTS) {
        scope |= with_earlier(Stages::FRAGMENT);
    }
    if stages.contains(Stages::FRAGMENT) {
        scope |= with_earlier(Stages::EARLY_TESTS);
    }
    if stages.contains(Stages::EARLY_TESTS) {
        scope |= Stages::VERTEX | Stages::INDIRECT;
    }
    if stages.intersects(Stages::VERTEX | Stages::COMPUTE) {
        scope |= Stages::INDIRECT;
    }
    scope
}

/// A set of (stage, access) pairs: at each of 10 stages, a bit for each of up to 12 accesses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pairs(u128);

const ACCESS_BITS: u32 = u128::BITS / 10;
const _: () = assert!(Stages::all().bits() < 1 << 10 && Accesses::all().bits() < 1 << ACCESS_BITS);

impl Pairs {
    pub const NONE: Pairs = Pairs(0);
    pub const ALL: Pairs = Pairs(u128::MAX);

    /// Returns all pairs of one of the stages and one of the accesses.
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

    pub fn has(self, stage: Stages, access: Accesses) -> bool {
        self.0 & Pairs::of(stage, access).0 != 0
    }
}
