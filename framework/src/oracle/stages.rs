//! Defines the logical order of pipeline stages, and the accesses that each performs.
//!
//! Vulkan 1.3, 7.1.2 "Pipeline Stages": a source stage mask includes the logically earlier stages, and a target stage
//! mask the logically later ones, but only for the execution dependency. Memory accesses are in a barrier's scope only
//! at stages that it names.

use crate::ir::{Accesses, Stages};

/// Returns these stages and all later ones of a pipeline: the scope of a target mask.
pub fn with_later(stages: Stages) -> Stages {
    let mut scope = stages;
    if stages.contains(Stages::INDIRECT) {
        scope |= Stages::VERTEX | Stages::EARLY_TESTS | Stages::FRAGMENT | Stages::LATE_TESTS;
        scope |= Stages::COLOR_OUTPUT | Stages::COMPUTE;
    }
    if stages.contains(Stages::VERTEX) {
        scope |= Stages::EARLY_TESTS | Stages::FRAGMENT | Stages::LATE_TESTS | Stages::COLOR_OUTPUT;
    }
    if stages.contains(Stages::EARLY_TESTS) {
        scope |= Stages::FRAGMENT | Stages::LATE_TESTS | Stages::COLOR_OUTPUT;
    }
    if stages.contains(Stages::FRAGMENT) {
        scope |= Stages::LATE_TESTS | Stages::COLOR_OUTPUT;
    }
    if stages.contains(Stages::LATE_TESTS) {
        scope |= Stages::COLOR_OUTPUT;
    }
    scope
}

/// Returns the stages that, in a source mask, cover a command's work at `stage`.
///
/// They are `stage` itself and the later stages of the command's pipeline: compute if `dispatch`, otherwise graphics.
/// Only `INDIRECT` is in both pipelines. The specification leaves open whether `COMPUTE` in a source mask covers the
/// reading of a draw's arguments, so it does not count here.
pub fn stood_for_by(stage: Stages, dispatch: bool) -> Stages {
    match stage {
        Stages::INDIRECT if dispatch => Stages::INDIRECT | Stages::COMPUTE,
        Stages::INDIRECT => Stages::INDIRECT | with_later(Stages::VERTEX),
        _ => with_later(stage),
    }
}

/// Returns the accesses that one stage can perform (Vulkan 1.3, table "Supported access types"). Empty for a set of
/// several stages.
pub fn performed_by(stage: Stages) -> Accesses {
    match stage {
        Stages::INDIRECT => Accesses::INDIRECT_READ,
        Stages::VERTEX | Stages::FRAGMENT | Stages::COMPUTE => {
            Accesses::UNIFORM_READ | Accesses::STORAGE_READ | Accesses::STORAGE_WRITE
        }
        Stages::COLOR_OUTPUT => Accesses::COLOR_READ | Accesses::COLOR_WRITE,
        Stages::EARLY_TESTS | Stages::LATE_TESTS => Accesses::DEPTH_READ | Accesses::DEPTH_WRITE,
        Stages::COPY => Accesses::TRANSFER_READ | Accesses::TRANSFER_WRITE,
        Stages::CLEAR => Accesses::TRANSFER_WRITE,
        Stages::HOST => Accesses::HOST_READ,
        _ => Accesses::empty(),
    }
}
