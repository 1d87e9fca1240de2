//! Tests successive plans.

use super::*;
use splatgraph_framework::ir::Layout::{General, TransferTarget, Undefined};

/// Returns a plan that reads the previous frame's contents of `kept`, then overwrites them.
fn with_history(name: &str, bytes: u64) -> Sketch {
    let mut sketch = Sketch::new();
    let kept = sketch.sized("kept", bytes);
    sketch.history(kept, name);
    sketch.once_work("start", &[], Work::ClearHistory { resource: kept }, &[fills(kept)]);
    sketch.barriers.handover = vec![barrier((CLEAR, Accesses::TRANSFER_WRITE), (COMPUTE, READ))];
    sketch.frame("draw", &[compute_to_compute()], &[reads(kept)]);
    sketch.frame("make", &[order(COMPUTE, COMPUTE)], &[writes(kept)]);
    sketch
}

fn swapped(plans: &[(&Sketch, u32)]) -> Vec<String> {
    let plans: Vec<_> =
        plans.iter().map(|(sketch, frames)| (&sketch.plan, &sketch.barriers, *frames)).collect();
    replay_swap(&plans)
        .iter()
        .flat_map(|found| {
            tell(plans[found.plan].0, std::slice::from_ref(found))
                .into_iter()
                .map(|line| format!("{}: {line}", found.plan))
        })
        .collect()
}

#[test]
fn a_plan_that_needs_nothing_of_another_follows_it() {
    let sketch = with_history("kept", BYTES);
    assert_eq!(swapped(&[(&sketch, 3), (&sketch, 3), (&sketch, 0), (&sketch, 1)]), NOTHING);
}

/// Returns the plan without the start of its history: it has violations unless the history carries over.
fn without_start(name: &str, bytes: u64) -> Sketch {
    let mut sketch = with_history(name, bytes);
    sketch.plan.prologue.clear();
    sketch
}

#[test]
fn a_history_of_the_same_name_and_shape_lives_on() {
    let old = with_history("kept", BYTES);
    assert_eq!(swapped(&[(&old, 2), (&without_start("kept", BYTES), 2)]), NOTHING);
    // This holds even if the old plan submitted no frame.
    assert_eq!(swapped(&[(&old, 0), (&without_start("kept", BYTES), 2)]), NOTHING);
}

#[test]
fn another_name_or_another_shape_starts_afresh() {
    let old = with_history("kept", BYTES);
    let unwritten = ["1: Unwritten: none, draw: kept: Contents"];
    assert_eq!(swapped(&[(&old, 2), (&without_start("other", BYTES), 2)]), unwritten);
    assert_eq!(swapped(&[(&old, 2), (&without_start("kept", 2 * BYTES), 2)]), unwritten);
    assert_eq!(swapped(&[(&old, 2), (&with_history("other", BYTES), 2)]), NOTHING);
}

#[test]
fn what_has_no_history_is_fresh_memory() {
    let mut old = with_history("kept", BYTES);
    old.plan.resources[0].history = None;
    assert_eq!(
        swapped(&[(&old, 1), (&without_start("kept", BYTES), 1)])[..],
        ["1: Unwritten: none, draw: kept: Contents"]
    );
}

#[test]
fn a_history_that_was_never_written_is_none() {
    let mut old = without_start("kept", BYTES);
    old.plan.frame.clear();
    assert_eq!(
        swapped(&[(&old, 1), (&with_history("kept", BYTES), 1)]),
        ["1: Unwritten: none, draw: kept: Contents"]
    );
}

#[test]
fn the_start_of_a_history_that_lives_on_is_left_out_and_the_barriers_of_others_stay() {
    let mut new = with_history("kept", BYTES);
    let other = new.buffer("other");
    // The call before the history's start may contain a barrier that another prologue pass relies on.
    let first = new.pass("first", Run::Once, dispatch(), &[writes(other)]);
    new.plan.prologue.insert(0, first);
    new.barriers.before.push(vec![]);
    *new.before_once(1) = vec![compute_to_compute()];
    new.once("last", &[], &[reads(other)]);
    let old = with_history("kept", BYTES);
    assert_eq!(swapped(&[(&new, 1)]), NOTHING);
    assert_eq!(swapped(&[(&old, 1), (&new, 1)]), NOTHING);
}

/// Returns a plan with an image history: its start leaves the image in `TransferTarget`, and frames use it in
/// `General`.
fn image_history() -> Sketch {
    let mut sketch = Sketch::new();
    let kept = sketch.image("kept");
    sketch.history(kept, "kept");
    let fill = (CLEAR, Accesses::TRANSFER_WRITE);
    let started = change(kept, (Undefined, TransferTarget), (Stages::empty(), NO_ACCESS), fill);
    let start = Use { layout: Some(TransferTarget), ..fills(kept) };
    sketch.once_work("start", &[started], Work::ClearHistory { resource: kept }, &[start]);
    sketch.barriers.handover = vec![change(kept, (TransferTarget, General), fill, (COMPUTE, READ))];
    sketch.frame("draw", &[compute_to_compute()], &[in_general(kept, READ)]);
    sketch.frame("make", &[order(COMPUTE, COMPUTE)], &[in_general(kept, WRITE)]);
    sketch
}

#[test]
fn an_image_that_lives_on_is_in_the_layout_that_its_start_leaves() {
    let sketch = image_history();
    assert_eq!(swapped(&[(&sketch, 3), (&sketch, 3)]), NOTHING);
    let mut other = image_history();
    other.plan.passes[0].uses[0].layout = Some(Layout::TransferSource);
    assert_eq!(
        swapped(&[(&sketch, 3), (&other, 3)]),
        ["1: Layout: none, change in handover: kept: TransferTarget, not TransferSource"]
    );
}

#[test]
fn an_image_without_a_start_keeps_its_layout() {
    let mut other = image_history();
    other.plan.prologue.clear();
    other.barriers.handover.clear();
    assert_eq!(swapped(&[(&image_history(), 3), (&other, 3)]), NOTHING);
}
