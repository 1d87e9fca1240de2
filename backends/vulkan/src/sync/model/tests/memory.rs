//! Tests availability and visibility.

use super::*;

/// Replays a compute write, barrier calls with empty passes between them, and a final access.
fn after_write(calls: &[&[Barrier]], second: (Stages, Accesses)) -> Vec<String> {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("first", &[], &[writes(a)]);
    for (index, call) in calls.iter().enumerate() {
        let uses = [touch(a, second.0, second.1)];
        let last = index + 1 == calls.len();
        sketch.frame(if last { "second" } else { "between" }, call, if last { &uses } else { &[] });
    }
    sketch.found()
}

#[test]
fn a_read_needs_the_write_ordered_available_and_visible() {
    let right = compute_to_compute();
    assert_eq!(after_write(&[&[right]], (COMPUTE, READ)), NOTHING);
    let order_only = order(COMPUTE, COMPUTE);
    assert_eq!(
        after_write(&[&[order_only]], (COMPUTE, READ)),
        ["ReadAfterWrite: first, second: a: Availability"]
    );
    let unseen = barrier((COMPUTE, WRITE), (COMPUTE, NO_ACCESS));
    assert_eq!(
        after_write(&[&[unseen]], (COMPUTE, READ)),
        ["ReadAfterWrite: first, second: a: STORAGE_READ at COMPUTE"]
    );
}

#[test]
fn availability_is_of_the_accesses_that_are_named() {
    let barrier = barrier((COMPUTE, Accesses::TRANSFER_WRITE | READ), (COMPUTE, READ));
    assert_eq!(
        after_write(&[&[barrier]], (COMPUTE, READ)),
        ["ReadAfterWrite: first, second: a: Availability"]
    );
}

#[test]
fn availability_is_of_the_stages_that_are_named_and_not_of_those_before_them() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("first", &[], &[touch(a, VERTEX, WRITE)]);
    sketch.frame("second", &[barrier((FRAGMENT, WRITE), (COMPUTE, READ))], &[reads(a)]);
    assert_eq!(sketch.found(), ["ReadAfterWrite: first, second: a: Availability"]);
}

#[test]
fn visibility_is_to_the_accesses_that_are_named() {
    let barrier = barrier((COMPUTE, WRITE), (COMPUTE, Accesses::UNIFORM_READ));
    assert_eq!(
        after_write(&[&[barrier]], (COMPUTE, READ)),
        ["ReadAfterWrite: first, second: a: STORAGE_READ at COMPUTE"]
    );
}

#[test]
fn visibility_is_to_each_access_at_each_stage() {
    let two = [
        barrier((COMPUTE, WRITE), (VERTEX, READ)),
        barrier((COMPUTE, WRITE), (FRAGMENT, Accesses::UNIFORM_READ)),
    ];
    let found = after_write(&[&two], (VERTEX | FRAGMENT, READ));
    assert_eq!(found, ["ReadAfterWrite: first, second: a: STORAGE_READ at FRAGMENT"]);
    let found = after_write(&[&[compute_to_compute()]], (COMPUTE, BOTH));
    assert_eq!(found, ["WriteAfterWrite: first, second: a: STORAGE_WRITE at COMPUTE"]);
}

#[test]
fn what_is_available_is_passed_on_by_a_chain() {
    let one = barrier((COMPUTE, WRITE), (COPY, NO_ACCESS));
    let two = barrier((COPY, NO_ACCESS), (FRAGMENT, READ));
    assert_eq!(after_write(&[&[one], &[two]], (FRAGMENT, READ)), NOTHING);
}

#[test]
fn what_is_available_is_passed_on_through_stages_that_are_not_named() {
    let one = barrier((COMPUTE, WRITE), (VERTEX, NO_ACCESS));
    let two = barrier((Stages::COLOR_OUTPUT, NO_ACCESS), (COPY, Accesses::TRANSFER_READ));
    assert_eq!(after_write(&[&[one], &[two]], (COPY, Accesses::TRANSFER_READ)), NOTHING);
}

#[test]
fn what_is_available_is_not_passed_on_past_the_chain() {
    // The second barrier waits for the write itself, but does not chain with the barrier that made it available.
    let one = barrier((COMPUTE, WRITE), (COPY, NO_ACCESS));
    let two = barrier((COMPUTE, NO_ACCESS), (FRAGMENT, READ));
    let found = after_write(&[&[one], &[two]], (FRAGMENT, READ));
    assert_eq!(found, ["ReadAfterWrite: first, second: a: STORAGE_READ at FRAGMENT"]);
}

#[test]
fn memory_does_not_chain_within_one_call() {
    let one = barrier((COMPUTE, WRITE), (COPY, NO_ACCESS));
    let two = barrier((COPY | COMPUTE, NO_ACCESS), (FRAGMENT, READ));
    let found = after_write(&[&[one, two]], (FRAGMENT, READ));
    assert_eq!(found, ["ReadAfterWrite: first, second: a: STORAGE_READ at FRAGMENT"]);
}

#[test]
fn a_chain_makes_nothing_available_by_itself() {
    let one = order(COMPUTE, COPY);
    let two = barrier((COPY, WRITE), (FRAGMENT, READ));
    assert_eq!(
        after_write(&[&[one], &[two]], (FRAGMENT, READ)),
        ["ReadAfterWrite: first, second: a: Availability"]
    );
}

#[test]
fn a_barrier_shows_nothing_that_is_written_after_it() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("first", &[compute_to_compute()], &[writes(a)]);
    sketch.frame("second", &[], &[reads(a)]);
    assert_eq!(sketch.found(), ["ReadAfterWrite: first, second: a: Order"]);
}

#[test]
fn a_write_after_a_write_needs_memory_too() {
    let second = (COMPUTE, WRITE);
    let right = barrier((COMPUTE, WRITE), (COMPUTE, WRITE));
    assert_eq!(after_write(&[&[]], second), ["WriteAfterWrite: first, second: a: Order"]);
    assert_eq!(
        after_write(&[&[order(COMPUTE, COMPUTE)]], second),
        ["WriteAfterWrite: first, second: a: Availability"]
    );
    assert_eq!(
        after_write(&[&[compute_to_compute()]], second),
        ["WriteAfterWrite: first, second: a: STORAGE_WRITE at COMPUTE"]
    );
    assert_eq!(after_write(&[&[right]], second), NOTHING);
}

fn write_read_write(barriers: &[Barrier]) -> Vec<String> {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("first", &[], &[writes(a)]);
    sketch.frame("reader", &[barrier((COMPUTE, WRITE), (FRAGMENT, READ))], &[touch(a, FRAGMENT, READ)]);
    sketch.frame("second", barriers, &[writes(a)]);
    sketch.found()
}

#[test]
fn after_a_reader_a_write_needs_only_order() {
    assert_eq!(write_read_write(&[order(FRAGMENT, COMPUTE)]), NOTHING);
}

#[test]
fn a_reader_that_is_not_waited_for_settles_nothing() {
    let expected = [
        "WriteAfterRead: reader, second: a: Order",
        "WriteAfterWrite: first, second: a: STORAGE_WRITE at COMPUTE",
    ];
    assert_eq!(write_read_write(&[order(COMPUTE, COMPUTE)]), expected);
}

#[test]
fn the_reads_of_the_writing_pass_settle_nothing() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("first", &[], &[touch(a, COMPUTE, BOTH)]);
    sketch.frame("second", &[compute_to_compute()], &[writes(a)]);
    assert_eq!(sketch.found(), ["WriteAfterWrite: first, second: a: STORAGE_WRITE at COMPUTE"]);
}

#[test]
fn a_reader_of_some_bytes_settles_those() {
    let written_again = |barriers: &[Barrier]| {
        let mut sketch = Sketch::new();
        let args = sketch.buffer("args");
        let arguments = (Stages::INDIRECT, Accesses::INDIRECT_READ);
        let work =
            Work::Dispatch { shader: ShaderId(0), groups: Groups::Indirect { buffer: args, offset: 8 } };
        sketch.frame("first", &[], &[writes(args)]);
        let seen = barrier((COMPUTE, WRITE), arguments);
        sketch.frame_work("reader", &[seen], work, &[touch(args, arguments.0, arguments.1)]);
        sketch.frame("second", barriers, &[writes(args)]);
        sketch.replay(&Replay { frames: 1, ..Replay::default() })
    };
    let found = written_again(&[order(Stages::INDIRECT, COMPUTE)]);
    assert_eq!(found.len(), 1);
    assert_eq!((found[0].range.clone(), found[0].missing), (0..8, Missing::Visibility(COMPUTE, WRITE)));
    let shown = barrier((Stages::INDIRECT, NO_ACCESS), (COMPUTE, WRITE));
    assert_eq!(written_again(&[shown]), []);
}

#[test]
fn a_write_that_follows_properly_stands_for_the_one_before() {
    // A scatter overwrites parts of a fill. One barrier makes both visible to the reader.
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("fill", &[], &[fills(a)]);
    sketch.frame("scatter", &[barrier((CLEAR, Accesses::TRANSFER_WRITE), (COMPUTE, WRITE))], &[writes(a)]);
    sketch.frame("read", &[compute_to_compute()], &[reads(a)]);
    assert_eq!(sketch.found(), NOTHING);
}

#[test]
fn indirect_arguments_are_the_words_that_the_work_reads() {
    let arguments = (Stages::INDIRECT, Accesses::INDIRECT_READ);
    let violations = |work: Work| {
        let mut sketch = Sketch::new();
        let args = sketch.buffer("args");
        sketch.frame("first", &[], &[writes(args)]);
        sketch.frame_work("second", &[], work, &[touch(args, arguments.0, arguments.1)]);
        sketch.replay(&Replay { frames: 1, ..Replay::default() })
    };
    let buffer = ResourceId(0);
    let groups = Groups::Indirect { buffer, offset: 8 };
    let found = violations(Work::Dispatch { shader: ShaderId(0), groups });
    assert_eq!((found.len(), found[0].range.clone()), (1, 8..20));
    let call = DrawCall::Indirect { buffer, offset: 16 };
    let (vertex, fragment, topology) = (ShaderId(0), ShaderId(0), Topology::TriangleStrip);
    let found = violations(Work::Draw { vertex, fragment, topology, call, targets: vec![], depth: None });
    assert_eq!((found.len(), found[0].range.clone()), (1, 16..32));
    let found = violations(dispatch());
    assert_eq!((found.len(), found[0].range.clone()), (1, 0..BYTES));
}

#[test]
fn a_write_over_several_cells_is_told_with_all_its_bytes() {
    let mut sketch = Sketch::new();
    let args = sketch.buffer("args");
    let groups = Groups::Indirect { buffer: args, offset: 8 };
    let ready = barrier((COMPUTE, WRITE), (Stages::INDIRECT, Accesses::INDIRECT_READ));
    sketch.frame("first", &[], &[writes(args)]);
    let read = touch(args, Stages::INDIRECT, Accesses::INDIRECT_READ);
    sketch.frame_work("second", &[ready], Work::Dispatch { shader: ShaderId(0), groups }, &[read]);
    sketch.frame("third", &[], &[writes(args)]);
    let found = sketch.replay(&Replay { frames: 1, ..Replay::default() });
    assert_eq!(tell(&sketch.plan, &found)[1..], ["WriteAfterRead: second, third: args: Order"]);
    assert_eq!(found.iter().map(|o| o.range.clone()).collect::<Vec<_>>(), [0..BYTES, 8..20]);
}

#[test]
fn a_touch_is_only_of_accesses_that_its_stages_perform() {
    // A dispatch reads its arguments and its data from one buffer, declared as one use: no stage reads both.
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    let accesses = Accesses::INDIRECT_READ | READ;
    sketch.frame("first", &[], &[writes(a)]);
    let barriers = [
        barrier((COMPUTE, WRITE), (Stages::INDIRECT, Accesses::INDIRECT_READ)),
        barrier((COMPUTE, WRITE), (COMPUTE, READ)),
    ];
    sketch.frame("second", &barriers, &[touch(a, Stages::INDIRECT | COMPUTE, accesses)]);
    assert_eq!(sketch.found(), NOTHING);
}

#[test]
fn an_objection_is_a_sentence() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("keys");
    sketch.frame("scatter", &[], &[writes(a)]);
    sketch.frame("draw", &[barrier((COMPUTE, WRITE), (FRAGMENT, NO_ACCESS))], &[touch(a, FRAGMENT, READ)]);
    let found = sketch.replay(&Replay { frames: 1, ..Replay::default() });
    let expected = "`draw` (frame 0) reads `keys`, bytes 0..64, but what `scatter` (frame 0) wrote there is not visible to \
                    STORAGE_READ at FRAGMENT";
    assert_eq!(found[0].describe(&sketch.plan), expected);
}

#[test]
fn each_resource_between_two_passes_is_told() {
    let mut sketch = Sketch::new();
    let (a, b) = (sketch.buffer("a"), sketch.buffer("b"));
    sketch.frame("first", &[], &[writes(a), writes(b)]);
    sketch.frame("second", &[], &[reads(a), reads(b)]);
    let expected = ["ReadAfterWrite: first, second: a: Order", "ReadAfterWrite: first, second: b: Order"];
    assert_eq!(sketch.found(), expected);
}

#[test]
fn the_same_pair_of_passes_is_told_once() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("first", &[], &[writes(a)]);
    sketch.frame("second", &[], &[reads(a)]);
    let expected = [
        "ReadAfterWrite: first, second: a: Order",
        "WriteAfterRead: second, first: a: Order",
        "WriteAfterWrite: first, first: a: Order",
    ];
    assert_eq!(sketch.found_in(4), expected);
}
