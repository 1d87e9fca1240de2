//! Tests image layouts, and layout changes as writes to memory.

use super::*;
use splatgraph_framework::ir::Layout::{ColorTarget, General, TransferSource, Undefined};

const NONE: (Stages, Accesses) = (Stages::empty(), NO_ACCESS);

fn written_then_copied(barriers: &[Barrier]) -> Vec<String> {
    let (mut sketch, image) = written();
    let copied = Use { layout: Some(TransferSource), ..touch(image, COPY, Accesses::TRANSFER_READ) };
    sketch.frame("copy", barriers, &[copied]);
    sketch.found()
}

fn written() -> (Sketch, ResourceId) {
    let mut sketch = Sketch::new();
    let image = sketch.image("image");
    let first = change(image, (Undefined, General), NONE, (COMPUTE, WRITE));
    sketch.frame("first", &[first], &[in_general(image, WRITE)]);
    (sketch, image)
}

const IMAGE: ResourceId = ResourceId(0);

fn to_copy(source: (Stages, Accesses)) -> Barrier {
    change(IMAGE, (General, TransferSource), source, (COPY, Accesses::TRANSFER_READ))
}

#[test]
fn a_change_of_layout_brings_order_and_memory_with_it() {
    assert_eq!(written_then_copied(&[to_copy((COMPUTE, WRITE))]), NOTHING);
}

#[test]
fn a_touch_in_another_layout_is_objected_to() {
    let right_but_for_the_layout = barrier((COMPUTE, WRITE), (COPY, Accesses::TRANSFER_READ));
    let found = written_then_copied(&[right_but_for_the_layout]);
    assert_eq!(found, ["Layout: none, copy: image: TransferSource, not General"]);
}

#[test]
fn a_change_from_a_layout_that_the_image_is_not_in_is_objected_to() {
    let target = (COPY, Accesses::TRANSFER_READ);
    let found =
        written_then_copied(&[change(IMAGE, (ColorTarget, TransferSource), (COMPUTE, WRITE), target)]);
    assert_eq!(found, ["Layout: none, change before copy: image: ColorTarget, not General"]);
}

#[test]
fn an_image_starts_in_no_layout_and_a_wrong_one_is_told_where_it_is_first_met() {
    let mut sketch = Sketch::new();
    let image = sketch.image("image");
    sketch.frame("first", &[], &[in_general(image, WRITE)]);
    sketch.frame("second", &[compute_to_compute()], &[in_general(image, READ)]);
    assert_eq!(sketch.found(), ["Layout: none, first: image: General, not Undefined"]);
}

#[test]
fn a_change_from_undefined_destroys_the_contents() {
    let target = (COPY, Accesses::TRANSFER_READ);
    let found = written_then_copied(&[change(IMAGE, (Undefined, TransferSource), (COMPUTE, WRITE), target)]);
    assert_eq!(found, ["Unwritten: change before copy, copy: image: Contents"]);
}

#[test]
fn a_change_waits_for_earlier_writes_and_needs_them_available() {
    let order = "WriteAfterWrite: first, change before copy: image: Order";
    let availability = "WriteAfterWrite: first, change before copy: image: Availability";
    assert_eq!(written_then_copied(&[to_copy(NONE)]), [order]);
    assert_eq!(written_then_copied(&[to_copy((FRAGMENT, WRITE))]), [order]);
    assert_eq!(written_then_copied(&[to_copy((COMPUTE, NO_ACCESS))]), [availability]);
}

#[test]
fn a_change_may_come_at_the_end_of_a_chain() {
    for (made_available, expected) in [
        (WRITE, vec![]),
        (NO_ACCESS, vec!["WriteAfterWrite: first, change before copy: image: Availability"]),
    ] {
        let (mut sketch, image) = written();
        sketch.frame("between", &[barrier((COMPUTE, made_available), (CLEAR, NO_ACCESS))], &[]);
        let copied = Use { layout: Some(TransferSource), ..touch(image, COPY, Accesses::TRANSFER_READ) };
        sketch.frame("copy", &[to_copy((CLEAR, NO_ACCESS))], &[copied]);
        assert_eq!(sketch.found(), expected);
    }
}

#[test]
fn a_change_does_not_chain_with_the_other_barriers_of_its_call() {
    let found =
        written_then_copied(&[barrier((COMPUTE, WRITE), (CLEAR, NO_ACCESS)), to_copy((CLEAR, NO_ACCESS))]);
    assert_eq!(found, ["WriteAfterWrite: first, change before copy: image: Order"]);
    // The call's other barriers do not make the change's write visible either.
    let all = (COPY, Accesses::TRANSFER_READ);
    let blind = change(IMAGE, (General, TransferSource), (COMPUTE, WRITE), NONE);
    let found = written_then_copied(&[barrier((COMPUTE, WRITE), all), blind]);
    assert_eq!(found, ["ReadAfterWrite: change before copy, copy: image: Order"]);
}

#[test]
fn a_change_waits_for_earlier_reads() {
    let copied = |source| {
        let (mut sketch, image) = written();
        let read = Use { stages: FRAGMENT, ..in_general(image, READ) };
        let copied = Use { layout: Some(TransferSource), ..touch(image, COPY, Accesses::TRANSFER_READ) };
        sketch.frame("read", &[barrier((COMPUTE, WRITE), (FRAGMENT, READ))], &[read]);
        sketch.frame("copy", &[to_copy(source)], &[copied]);
        sketch.found()
    };
    assert_eq!(copied((FRAGMENT, NO_ACCESS)), NOTHING);
    assert_eq!(copied((COMPUTE, WRITE)), ["WriteAfterRead: read, change before copy: image: Order"]);
}

#[test]
fn a_change_may_wait_for_earlier_reads_by_a_chain() {
    let (mut sketch, image) = written();
    let read = Use { stages: FRAGMENT, ..in_general(image, READ) };
    let copied = Use { layout: Some(TransferSource), ..touch(image, COPY, Accesses::TRANSFER_READ) };
    sketch.frame("read", &[barrier((COMPUTE, WRITE), (FRAGMENT, READ))], &[read]);
    sketch.frame("between", &[order(FRAGMENT, CLEAR)], &[]);
    sketch.frame("copy", &[to_copy((CLEAR, NO_ACCESS))], &[copied]);
    assert_eq!(sketch.found(), NOTHING);
}

#[test]
fn a_change_is_visible_to_the_named_target_only() {
    let only = |target: (Stages, Accesses)| {
        let mut sketch = Sketch::new();
        let image = sketch.image("image");
        sketch.frame(
            "first",
            &[change(image, (Undefined, General), NONE, target)],
            &[in_general(image, WRITE)],
        );
        sketch.found()
    };
    let missing = ["WriteAfterWrite: change before first, first: image: STORAGE_WRITE at COMPUTE"];
    assert_eq!(only((COMPUTE, WRITE)), NOTHING);
    assert_eq!(only((COMPUTE, READ)), missing);
    assert_eq!(only((Stages::INDIRECT, WRITE)), missing);
    assert_eq!(only((COPY, WRITE)), ["WriteAfterWrite: change before first, first: image: Order"]);
}

#[test]
fn later_barriers_pass_on_what_a_change_did() {
    let passed_on = |second: Barrier| {
        let mut sketch = Sketch::new();
        let image = sketch.image("image");
        let first = change(image, (Undefined, General), NONE, (CLEAR, NO_ACCESS));
        sketch.frame("between", &[first], &[]);
        sketch.frame("first", &[second], &[in_general(image, WRITE)]);
        sketch.found()
    };
    assert_eq!(passed_on(barrier((CLEAR, NO_ACCESS), (COMPUTE, WRITE))), NOTHING);
    // No source stage includes a layout change.
    let all_but_fills = Stages::all().difference(CLEAR);
    let missing = "WriteAfterWrite: change before between, first: image: Order";
    assert_eq!(passed_on(barrier((all_but_fills, Accesses::all()), (COMPUTE, WRITE))), [missing]);
}

#[test]
fn two_changes_of_one_call_must_not_meet_in_memory() {
    let mut sketch = Sketch::new();
    let (one, two) = (sketch.image("one"), sketch.image("two"));
    sketch.share(two, one);
    let both = [one, two].map(|image| change(image, (Undefined, General), NONE, (COMPUTE, WRITE)));
    sketch.frame("first", &both, &[]);
    assert_eq!(
        sketch.found(),
        ["WriteAfterWrite: change before first (as one), change before first: two: Order"]
    );
}

#[test]
fn the_memory_part_of_an_image_barrier_is_about_that_image() {
    let mut sketch = Sketch::new();
    let (image, a) = (sketch.image("image"), sketch.buffer("a"));
    let source = (COMPUTE, WRITE);
    let target = (COMPUTE, BOTH);
    sketch.frame("first", &[], &[writes(a)]);
    sketch.frame(
        "second",
        &[change(image, (Undefined, General), source, target)],
        &[reads(a), in_general(image, WRITE)],
    );
    // The execution dependency applies to all memory, availability only to the image.
    assert_eq!(sketch.found(), ["ReadAfterWrite: first, second: a: Availability"]);
    // An image barrier does not make other resources visible, even if they are already available.
    sketch.before(1).push(barrier(source, (COPY, NO_ACCESS)));
    assert_eq!(sketch.found(), ["ReadAfterWrite: first, second: a: STORAGE_READ at COMPUTE"]);
    sketch.frame(
        "third",
        &[change(image, (General, TransferSource), (COMPUTE | COPY, WRITE), (COMPUTE, READ))],
        &[reads(a)],
    );
    let expected = [
        "ReadAfterWrite: first, second: a: STORAGE_READ at COMPUTE",
        "ReadAfterWrite: first, third: a: STORAGE_READ at COMPUTE",
    ];
    assert_eq!(sketch.found(), expected);
}

#[test]
fn the_order_of_an_image_barrier_is_for_all_memory() {
    let mut sketch = Sketch::new();
    let (image, a) = (sketch.image("image"), sketch.buffer("a"));
    sketch.frame("first", &[], &[fills(a)]);
    sketch.frame("read", &[barrier((CLEAR, Accesses::TRANSFER_WRITE), (COMPUTE, READ))], &[reads(a)]);
    let other = change(image, (Undefined, General), (COMPUTE, NO_ACCESS), (FRAGMENT, NO_ACCESS));
    sketch.frame("write", &[other], &[touch(a, FRAGMENT, WRITE)]);
    assert_eq!(sketch.found(), NOTHING);
}

#[test]
fn an_image_barrier_extends_chains_of_other_memory() {
    let mut sketch = Sketch::new();
    let (image, a) = (sketch.image("image"), sketch.buffer("a"));
    sketch.frame("first", &[], &[writes(a)]);
    sketch.frame("one", &[barrier((COMPUTE, WRITE), (CLEAR, NO_ACCESS))], &[]);
    sketch.frame("two", &[change(image, (Undefined, General), (CLEAR, NO_ACCESS), (COPY, NO_ACCESS))], &[]);
    sketch.frame("second", &[barrier((COPY, NO_ACCESS), (COMPUTE, READ))], &[reads(a)]);
    assert_eq!(sketch.found(), NOTHING);
}

#[test]
fn a_barrier_that_leaves_the_layout_is_no_write() {
    let (mut sketch, image) = written();
    let stays = change(image, (General, General), (COMPUTE, WRITE), (FRAGMENT, READ));
    sketch.frame("read", &[stays], &[Use { stages: FRAGMENT, ..in_general(image, READ) }]);
    assert_eq!(sketch.found(), NOTHING);
    // It makes the image visible only to accesses through the image, not through an alias.
    let buffer = sketch.buffer("a");
    sketch.share(buffer, image);
    sketch.plan.passes[1].uses = vec![touch(buffer, FRAGMENT, WRITE)];
    sketch.before(1)[0].masks.target_accesses = WRITE;
    assert_eq!(sketch.found(), ["WriteAfterWrite: first (as image), read: a: STORAGE_WRITE at FRAGMENT"]);
}

#[test]
fn a_change_is_visible_through_the_image_that_changed() {
    let mut sketch = Sketch::new();
    let (image, a) = (sketch.image("image"), sketch.buffer("a"));
    sketch.share(a, image);
    sketch.frame("first", &[change(image, (Undefined, General), NONE, (COMPUTE, WRITE))], &[writes(a)]);
    assert_eq!(
        sketch.found(),
        ["WriteAfterWrite: change before first (as image), first: a: STORAGE_WRITE at COMPUTE"]
    );
}

#[test]
fn a_change_of_an_alias_makes_nothing_available_for_it() {
    let changed = |call: &[Barrier]| {
        let mut sketch = Sketch::new();
        let (image, a) = (sketch.image("image"), sketch.buffer("a"));
        sketch.share(a, image);
        sketch.frame("first", &[], &[writes(a)]);
        sketch.frame("between", &[barrier((COMPUTE, WRITE), (COPY, NO_ACCESS))], &[]);
        sketch.frame("second", call, &[in_general(image, WRITE)]);
        sketch.found()
    };
    let from = |source| [change(IMAGE, (Undefined, General), source, (COMPUTE, WRITE))];
    assert_eq!(changed(&from((COPY, NO_ACCESS))), NOTHING);
    // Source accesses of the change apply to the image, through which nothing was written.
    let missing = "WriteAfterWrite: first (as a), change before second: image: Availability";
    assert_eq!(changed(&from((COMPUTE, WRITE))), [missing]);
}

#[test]
fn writing_an_alias_leaves_an_image_in_no_layout() {
    let (mut sketch, image) = written();
    let (a, other) = (sketch.buffer("a"), sketch.image("other"));
    sketch.share(a, image);
    sketch.frame("alias", &[barrier((COMPUTE, WRITE), (COMPUTE, WRITE))], &[writes(a)]);
    let back = barrier((COMPUTE, WRITE), (COMPUTE, WRITE));
    sketch.frame("again", &[back], &[in_general(image, WRITE)]);
    assert_eq!(sketch.found(), ["Layout: none, again: image: General, not Undefined"]);
    // A layout change of an aliasing image has the same effect.
    sketch.share(other, image);
    *sketch.before(1) = vec![change(other, (Undefined, General), (COMPUTE, WRITE), (COMPUTE, WRITE))];
    sketch.plan.passes[1].uses = vec![];
    sketch.before(1).insert(0, barrier((COMPUTE, WRITE), (COPY, NO_ACCESS)));
    assert!(sketch.found().contains(&"Layout: none, again: image: General, not Undefined".to_string()));
}

#[test]
fn changes_in_the_handover_are_told_as_such() {
    let mut sketch = Sketch::new();
    let image = sketch.image("image");
    let first = change(image, (Undefined, General), NONE, (COMPUTE, WRITE));
    sketch.once("first", &[first], &[in_general(image, WRITE)]);
    sketch.barriers.handover =
        vec![change(image, (General, TransferSource), (FRAGMENT, WRITE), (COPY, Accesses::TRANSFER_READ))];
    assert_eq!(sketch.found(), ["WriteAfterWrite: first, change in handover: image: Order"]);
    let found = sketch.replay(&Replay::default());
    let expected = "the layout change of `image` (handover) writes `image`, bytes 0..64, without waiting for `first` (prologue), which \
                    wrote them";
    assert_eq!(found[0].describe(&sketch.plan), expected);
}
