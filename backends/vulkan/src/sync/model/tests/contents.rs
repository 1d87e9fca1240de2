//! Tests reads of bytes that were never written, belong to another resource, or date from the previous frame.

use super::*;

#[test]
fn bytes_that_were_never_written_must_not_be_read() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("read", &[], &[reads(a)]);
    assert_eq!(sketch.found(), ["Unwritten: none, read: a: Contents"]);
}

#[test]
fn the_scene_is_there_from_the_start() {
    let mut sketch = Sketch::new();
    let source = Source::Scene { attribute: "scene.position".into(), plane: 0 };
    let a = sketch.resource("position", Shape::Buffer { stride: 4, count: 4 }, source);
    sketch.frame("read", &[], &[reads(a)]);
    sketch.frame("again", &[], &[touch(a, VERTEX, READ)]);
    assert_eq!(sketch.found_in(4), NOTHING);
}

#[test]
fn a_shader_may_read_what_it_writes() {
    let mut sketch = Sketch::new();
    let (a, b) = (sketch.buffer("a"), sketch.buffer("b"));
    sketch.frame("both", &[], &[touch(a, COMPUTE, BOTH)]);
    sketch.frame_work("draw", &[], draw(), &[touch(b, FRAGMENT, BOTH)]);
    assert_eq!(sketch.found(), NOTHING);
}

#[test]
fn a_cleared_attachment_is_blended_with_the_clear_colour() {
    use Layout::{ColorTarget, Undefined};
    let drawn = |discards| {
        let mut sketch = Sketch::new();
        let image = sketch.image("color");
        let output = (Stages::COLOR_OUTPUT, Accesses::COLOR_READ | Accesses::COLOR_WRITE);
        let ready = change(image, (Undefined, ColorTarget), (Stages::empty(), NO_ACCESS), output);
        let target = Use { layout: Some(ColorTarget), discards, ..touch(image, output.0, output.1) };
        sketch.frame("draw", &[ready], &[target]);
        sketch.found()
    };
    assert_eq!(drawn(true), NOTHING);
    assert_eq!(drawn(false), ["Unwritten: change before draw, draw: color: Contents"]);
}

#[test]
fn what_another_resource_left_in_the_memory_must_not_be_read() {
    let mut sketch = Sketch::new();
    let (a, b) = (sketch.buffer("a"), sketch.sized("b", 16));
    sketch.share(b, a);
    sketch.frame("one", &[], &[writes(a)]);
    sketch.frame("two", &[barrier((COMPUTE, WRITE), (COMPUTE, BOTH))], &[writes(b)]);
    sketch.frame("read", &[compute_to_compute()], &[reads(a)]);
    assert_eq!(sketch.found(), ["Unwritten: two (as b), read: a: Contents"]);
    let found = sketch.replay(&Replay { frames: 1, ..Replay::default() });
    assert_eq!(found[0].range, 0..16);
    let expected = "`read` (frame 0) reads `a`, bytes 0..16, which hold only what `two` (frame 0) left there \
                    through `b` in the same memory";
    assert_eq!(found[0].describe(&sketch.plan), expected);
}

#[test]
fn resources_in_one_memory_wait_for_each_other() {
    let mut sketch = Sketch::new();
    let (a, b) = (sketch.buffer("a"), sketch.sized("b", 16));
    sketch.share(b, a);
    sketch.frame("one", &[], &[writes(a)]);
    sketch.frame("read", &[compute_to_compute()], &[reads(a)]);
    sketch.frame("two", &[], &[touch(b, FRAGMENT, WRITE)]);
    let expected =
        ["WriteAfterRead: read (as a), two: b: Order", "WriteAfterWrite: one (as a), two: b: Order"];
    assert_eq!(sketch.found(), expected);
    *sketch.before(2) = vec![order(COMPUTE, FRAGMENT)];
    assert_eq!(sketch.found(), NOTHING);
}

#[test]
fn resources_in_one_memory_conflict_where_they_overlap() {
    // The indirect arguments lie in `a` beyond the end of `b`.
    let mut sketch = Sketch::new();
    let (a, b) = (sketch.buffer("a"), sketch.sized("b", 16));
    sketch.share(b, a);
    let arguments = (Stages::INDIRECT, Accesses::INDIRECT_READ);
    sketch.frame("one", &[], &[writes(a)]);
    let groups = Groups::Indirect { buffer: a, offset: 16 };
    let work = Work::Dispatch { shader: ShaderId(0), groups };
    let two = barrier((COMPUTE, WRITE), (COMPUTE, WRITE));
    sketch.frame("two", &[two], &[writes(b)]);
    let seen = barrier((COMPUTE, WRITE), arguments);
    sketch.frame_work("read", &[seen], work, &[touch(a, arguments.0, arguments.1)]);
    assert_eq!(sketch.found(), NOTHING);
}

#[test]
fn one_pass_must_not_use_two_resources_of_one_memory() {
    let used = |one: Accesses, two: Accesses| {
        let mut sketch = Sketch::new();
        let (a, b) = (sketch.buffer("a"), sketch.buffer("b"));
        sketch.share(b, a);
        sketch.frame("both", &[], &[touch(a, COMPUTE, one), touch(b, COMPUTE, two)]);
        let found = sketch.found();
        found.into_iter().filter(|line| !line.starts_with("Unwritten")).collect::<Vec<_>>()
    };
    assert_eq!(used(WRITE, WRITE), ["WriteAfterWrite: both (as a), both: b: Order"]);
    assert_eq!(used(WRITE, READ), ["ReadAfterWrite: both (as a), both: b: Order"]);
    assert_eq!(used(READ, WRITE), ["WriteAfterRead: both (as a), both: b: Order"]);
    assert_eq!(used(READ, READ), NOTHING);
}

/// Replays a plan that reads a buffer in every frame before writing it. Only `history` and `once` give the buffer
/// contents in the first frame.
fn read_then_written(history: bool, once: bool) -> Vec<String> {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    let ready = barrier((COMPUTE, WRITE), (COMPUTE, READ));
    if history {
        sketch.history(a, "a");
        sketch.once_work("start", &[], Work::ClearHistory { resource: a }, &[writes(a)]);
    }
    if once {
        sketch.once("once", &[], &[writes(a)]);
    }
    sketch.frame("read", &[ready], &[reads(a)]);
    sketch.frame("write", &[order(COMPUTE, COMPUTE)], &[writes(a)]);
    sketch.found_in(3)
}

#[test]
fn the_frame_before_leaves_nothing_to_read() {
    assert_eq!(
        read_then_written(false, false),
        ["Unwritten: none, read: a: Contents", "Unwritten: write, read: a: Contents"]
    );
}

#[test]
fn a_history_lives_from_frame_to_frame() {
    assert_eq!(read_then_written(true, false), NOTHING);
}

#[test]
fn a_history_that_is_not_started_is_missed_in_the_first_frame() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.history(a, "a");
    sketch.frame("read", &[compute_to_compute()], &[reads(a)]);
    sketch.frame("write", &[order(COMPUTE, COMPUTE)], &[writes(a)]);
    assert_eq!(sketch.found_in(3), ["Unwritten: none, read: a: Contents"]);
}

#[test]
fn what_the_prologue_writes_lives_on() {
    assert_eq!(read_then_written(false, true), NOTHING);
}
