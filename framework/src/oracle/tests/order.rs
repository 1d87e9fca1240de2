//! The order of execution: logically earlier and later stages, chains, calls.

use super::*;

/// A write at one stage and a read at another, and what a plain barrier leaves missing between them.
fn order_of(write: Stages, barriers: &[&[Barrier]], read: (Stages, Accesses)) -> Vec<String> {
    let mut sketch = Sketch::new();
    let (a, other) = (sketch.buffer("a"), sketch.buffer("other"));
    sketch.frame("first", &[], &[touch(a, write, WRITE)]);
    for (index, call) in barriers.iter().enumerate() {
        match index + 1 == barriers.len() {
            true => sketch.frame("second", call, &[touch(a, read.0, read.1)]),
            // A pass has to stand between two calls.
            false => sketch.frame("between", call, &[touch(other, Stages::HOST, Accesses::HOST_READ)]),
        }
    }
    sketch.found().into_iter().filter(|line| !line.contains("other")).collect()
}

const UNORDERED: [&str; 1] = ["ReadAfterWrite: first, second: a: Order"];
const UNAVAILABLE: [&str; 1] = ["ReadAfterWrite: first, second: a: Availability"];

/// Reads of a buffer, then a write at another stage.
fn write_after_read(read: (Stages, Accesses), barrier: Barrier, write: (Stages, Accesses)) -> Vec<String> {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    let ready = super::barrier((CLEAR, Accesses::TRANSFER_WRITE), read);
    sketch.frame("fill", &[], &[fills(a)]);
    sketch.frame("first", &[ready], &[touch(a, read.0, read.1)]);
    sketch.frame("second", &[barrier], &[touch(a, write.0, write.1)]);
    // The fill, two passes ago, is objected to as well; here it is about the reader.
    sketch.found().into_iter().filter(|line| !line.contains("fill")).collect()
}

const OVERTAKEN: [&str; 1] = ["WriteAfterRead: first, second: a: Order"];

#[test]
fn without_a_barrier_nothing_is_ordered() {
    assert_eq!(order_of(COMPUTE, &[&[]], (COMPUTE, READ)), UNORDERED);
}

#[test]
fn a_barrier_orders_the_stages_that_it_names() {
    assert_eq!(order_of(COMPUTE, &[&[order(COMPUTE, FRAGMENT)]], (FRAGMENT, READ)), UNAVAILABLE);
    assert_eq!(order_of(COMPUTE, &[&[order(FRAGMENT, FRAGMENT)]], (FRAGMENT, READ)), UNORDERED);
    assert_eq!(order_of(COMPUTE, &[&[order(COMPUTE, COMPUTE)]], (FRAGMENT, READ)), UNORDERED);
}

#[test]
fn a_barrier_from_colour_output_orders_what_vertex_shaders_read() {
    let barrier = order(Stages::COLOR_OUTPUT, CLEAR);
    let write = (CLEAR, Accesses::TRANSFER_WRITE);
    assert_eq!(write_after_read((VERTEX, READ), barrier.clone(), write), NOTHING);
    assert_eq!(write_after_read((FRAGMENT, READ), barrier.clone(), write), NOTHING);
    assert_eq!(write_after_read((Stages::INDIRECT, Accesses::INDIRECT_READ), barrier, write), NOTHING);
}

#[test]
fn a_barrier_from_the_vertex_stage_does_not_order_the_fragment_stage() {
    let write = (CLEAR, Accesses::TRANSFER_WRITE);
    assert_eq!(write_after_read((FRAGMENT, READ), order(VERTEX, CLEAR), write), OVERTAKEN);
}

#[test]
fn a_barrier_from_any_shader_orders_indirect_arguments() {
    let (read, write) = ((Stages::INDIRECT, Accesses::INDIRECT_READ), (CLEAR, Accesses::TRANSFER_WRITE));
    for stage in [VERTEX, FRAGMENT, COMPUTE] {
        assert_eq!(write_after_read(read, order(stage, CLEAR), write), NOTHING);
    }
    assert_eq!(write_after_read(read, order(COPY, CLEAR), write), OVERTAKEN);
}

#[test]
fn a_barrier_from_the_fragment_stage_orders_the_vertex_stage() {
    let write = (CLEAR, Accesses::TRANSFER_WRITE);
    assert_eq!(write_after_read((VERTEX, READ), order(FRAGMENT, CLEAR), write), NOTHING);
}

#[test]
fn compute_is_no_part_of_drawing() {
    let write = (CLEAR, Accesses::TRANSFER_WRITE);
    assert_eq!(write_after_read((COMPUTE, READ), order(Stages::COLOR_OUTPUT, CLEAR), write), OVERTAKEN);
    assert_eq!(write_after_read((VERTEX, READ), order(COMPUTE, CLEAR), write), OVERTAKEN);
    assert_eq!(order_of(COMPUTE, &[&[order(COMPUTE, VERTEX)]], (COMPUTE, READ)), UNORDERED);
}

#[test]
fn copies_fills_and_the_host_stand_alone() {
    assert_eq!(
        write_after_read((COPY, Accesses::TRANSFER_READ), order(COMPUTE, COMPUTE), (COMPUTE, WRITE)),
        OVERTAKEN
    );
    let fill = (CLEAR, Accesses::TRANSFER_WRITE);
    assert_eq!(write_after_read((COPY, Accesses::TRANSFER_READ), order(CLEAR, CLEAR), fill), OVERTAKEN);
    let copied = (COPY, Accesses::TRANSFER_READ);
    assert_eq!(order_of(COMPUTE, &[&[order(COMPUTE, CLEAR | Stages::HOST)]], copied), UNORDERED);
    assert_eq!(order_of(COMPUTE, &[&[order(COMPUTE, Stages::INDIRECT)]], copied), UNORDERED);
}

#[test]
fn a_target_orders_the_stages_after_it_but_shows_them_nothing() {
    let later = [
        (Stages::INDIRECT, (COMPUTE, READ)),
        (Stages::INDIRECT, (VERTEX, READ)),
        (Stages::INDIRECT, (FRAGMENT, READ)),
        (Stages::INDIRECT, (Stages::COLOR_OUTPUT, Accesses::COLOR_READ)),
        (VERTEX, (FRAGMENT, READ)),
        (VERTEX, (Stages::COLOR_OUTPUT, Accesses::COLOR_READ)),
        (FRAGMENT, (Stages::COLOR_OUTPUT, Accesses::COLOR_READ)),
    ];
    for (target, (stage, access)) in later {
        let shows_all = barrier((COMPUTE, WRITE), (target, Accesses::all()));
        let (stage_name, access_name) =
            (violation::flag_names(stage.iter_names()), violation::flag_names(access.iter_names()));
        let expected = format!("ReadAfterWrite: first, second: a: {access_name} at {stage_name}");
        assert_eq!(order_of(COMPUTE, &[&[shows_all]], (stage, access)), [expected]);
    }
}

#[test]
fn a_target_does_not_order_the_stages_before_it() {
    assert_eq!(order_of(COMPUTE, &[&[order(COMPUTE, FRAGMENT)]], (VERTEX, READ)), UNORDERED);
    let arguments = (Stages::INDIRECT, Accesses::INDIRECT_READ);
    assert_eq!(order_of(COMPUTE, &[&[order(COMPUTE, COMPUTE)]], arguments), UNORDERED);
}

#[test]
fn barriers_chain_where_target_and_source_meet() {
    let (one, two) = (order(COMPUTE, COPY), order(COPY, FRAGMENT));
    assert_eq!(order_of(COMPUTE, &[&[one], &[two]], (FRAGMENT, READ)), UNAVAILABLE);
}

#[test]
fn barriers_do_not_chain_where_target_and_source_are_apart() {
    let (one, two) = (order(COMPUTE, COPY), order(CLEAR, FRAGMENT));
    assert_eq!(order_of(COMPUTE, &[&[one], &[two]], (FRAGMENT, READ)), UNORDERED);
}

#[test]
fn chains_go_through_later_stages_of_the_target_and_earlier_ones_of_the_source() {
    let through = |target, source| {
        order_of(COMPUTE, &[&[order(COMPUTE, target)], &[order(source, COMPUTE)]], (COMPUTE, READ))
    };
    assert_eq!(through(VERTEX, Stages::COLOR_OUTPUT), UNAVAILABLE);
    // Draws have no dispatch among them: the link is the stage that both start with.
    assert_eq!(through(Stages::INDIRECT, FRAGMENT), UNAVAILABLE);
    let disjoint = order_of(
        VERTEX,
        &[&[order(VERTEX, FRAGMENT)], &[order(COMPUTE, CLEAR)]],
        (CLEAR, Accesses::TRANSFER_WRITE),
    );
    assert_eq!(disjoint, ["WriteAfterWrite: first, second: a: Order"]);
}

#[test]
fn a_chain_runs_forward_only() {
    let (one, two) = (order(COPY, FRAGMENT), order(COMPUTE, COPY));
    assert_eq!(order_of(COMPUTE, &[&[one], &[two]], (FRAGMENT, READ)), UNORDERED);
}

#[test]
fn barriers_of_one_call_do_not_chain() {
    let (one, two) = (order(COMPUTE, COPY), order(COPY, FRAGMENT));
    assert_eq!(order_of(COMPUTE, &[&[one.clone(), two.clone()]], (FRAGMENT, READ)), UNORDERED);
    assert_eq!(write_after_read_in_one_call(one, two), OVERTAKEN);
}

/// A read in a compute shader, then a fill after both barriers in one call.
fn write_after_read_in_one_call(one: Barrier, two: Barrier) -> Vec<String> {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    let ready = barrier((CLEAR, Accesses::TRANSFER_WRITE), (COMPUTE, READ));
    sketch.frame("fill", &[], &[fills(a)]);
    sketch.frame("first", &[ready], &[reads(a)]);
    sketch.frame("second", &[one, two], &[touch(a, FRAGMENT, WRITE)]);
    let found = sketch.found();
    found.into_iter().filter(|line| line.starts_with("WriteAfterRead")).collect()
}

#[test]
fn a_write_waits_for_every_reader() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    let ready = barrier((CLEAR, Accesses::TRANSFER_WRITE), (COMPUTE | FRAGMENT, READ));
    sketch.frame("fill", &[], &[fills(a)]);
    sketch.frame("early", &[ready], &[touch(a, FRAGMENT, READ)]);
    sketch.frame("late", &[], &[reads(a)]);
    sketch.frame("write", &[order(COMPUTE, CLEAR)], &[fills(a)]);
    assert_eq!(sketch.found(), ["WriteAfterRead: early, write: a: Order"]);
    sketch.plan.frame[3].barriers = vec![order(COMPUTE | FRAGMENT, CLEAR)];
    assert_eq!(sketch.found(), NOTHING);
}

#[test]
fn a_reader_that_was_waited_for_does_not_stand_for_a_later_one() {
    let mut sketch = Sketch::new();
    let (a, b) = (sketch.buffer("a"), sketch.buffer("b"));
    let ready = barrier((CLEAR, Accesses::TRANSFER_WRITE), (COMPUTE, READ));
    sketch.frame("fill", &[], &[fills(a)]);
    sketch.frame("early", &[ready], &[reads(a)]);
    sketch.frame("else", &[order(COMPUTE, CLEAR)], &[fills(b)]);
    sketch.frame("late", &[], &[reads(a)]);
    sketch.frame("write", &[], &[fills(a)]);
    assert!(sketch.found().contains(&"WriteAfterRead: late, write: a: Order".to_string()));
}

#[test]
fn what_was_objected_to_is_not_held_against_the_next() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    let fill = (CLEAR, Accesses::TRANSFER_WRITE);
    sketch.frame("fill", &[], &[fills(a)]);
    sketch.frame("read", &[barrier(fill, (COMPUTE, READ))], &[reads(a)]);
    sketch.frame("early", &[barrier(fill, fill)], &[fills(a)]);
    sketch.frame("late", &[barrier(fill, fill)], &[fills(a)]);
    assert_eq!(sketch.found(), ["WriteAfterRead: read, early: a: Order"]);
}

#[test]
fn every_stage_of_a_touch_counts_for_itself() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("first", &[], &[writes(a)]);
    let barrier = barrier((COMPUTE, WRITE), (FRAGMENT, READ));
    sketch.frame("second", &[barrier], &[touch(a, VERTEX | FRAGMENT, READ)]);
    assert_eq!(sketch.found(), UNORDERED);
}

#[test]
fn what_one_pass_does_to_a_resource_is_its_own_affair() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("draw", &[], &[touch(a, VERTEX, WRITE), touch(a, FRAGMENT, BOTH)]);
    assert_eq!(sketch.found(), NOTHING);
    // But the next pass has to wait for all of it.
    sketch.frame("fill", &[barrier((VERTEX, WRITE), (CLEAR, Accesses::TRANSFER_WRITE))], &[fills(a)]);
    let expected = ["WriteAfterRead: draw, fill: a: Order", "WriteAfterWrite: draw, fill: a: Order"];
    assert_eq!(sketch.found(), expected);
    sketch.plan.frame[1].barriers = vec![barrier((FRAGMENT, WRITE), (CLEAR, Accesses::TRANSFER_WRITE))];
    assert_eq!(sketch.found(), ["WriteAfterWrite: draw, fill: a: Availability"]);
}
