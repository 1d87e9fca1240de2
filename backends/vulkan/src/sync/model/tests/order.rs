//! Tests execution order: logically earlier and later stages, chains, and calls.

use super::*;

fn order_of(write: Stages, barriers: &[&[Barrier]], read: (Stages, Accesses)) -> Vec<String> {
    let mut sketch = Sketch::new();
    let (a, other) = (sketch.buffer("a"), sketch.buffer("other"));
    sketch.frame("first", &[], &[touch(a, write, WRITE)]);
    for (index, call) in barriers.iter().enumerate() {
        match index + 1 == barriers.len() {
            true => sketch.frame("second", call, &[touch(a, read.0, read.1)]),
            // Calls belong to passes, so another pass separates two calls.
            false => sketch.frame("between", call, &[touch(other, Stages::HOST, Accesses::HOST_READ)]),
        }
    }
    sketch.found().into_iter().filter(|line| !line.contains("other")).collect()
}

const UNORDERED: [&str; 1] = ["ReadAfterWrite: first, second: a: Order"];
const UNAVAILABLE: [&str; 1] = ["ReadAfterWrite: first, second: a: Availability"];

/// Reads a buffer, then writes it at another stage. Only dispatches have the stage `COMPUTE`.
fn write_after_read(read: (Stages, Accesses), barrier: Barrier, write: (Stages, Accesses)) -> Vec<String> {
    let work = if read.0 == COMPUTE { dispatch() } else { draw() };
    write_after_read_of(work, read, &[barrier], write)
}

fn write_after_read_of(
    reader: Work,
    read: (Stages, Accesses),
    call: &[Barrier],
    write: (Stages, Accesses),
) -> Vec<String> {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    let ready = barrier((CLEAR, Accesses::TRANSFER_WRITE), read);
    sketch.frame("fill", &[], &[fills(a)]);
    sketch.frame_work("first", &[ready], reader, &[touch(a, read.0, read.1)]);
    sketch.frame("second", call, &[touch(a, write.0, write.1)]);
    // The replay also reports the fill, two passes earlier; this test is about the reader.
    sketch.found().into_iter().filter(|line| !line.contains("fill")).collect()
}

const OVERTAKEN: [&str; 1] = ["WriteAfterRead: first, second: a: Order"];

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
fn a_barrier_from_a_later_stage_of_the_same_command_orders_its_arguments() {
    let (read, write) = ((Stages::INDIRECT, Accesses::INDIRECT_READ), (CLEAR, Accesses::TRANSFER_WRITE));
    let found = |work: Work, stage| write_after_read_of(work, read, &[order(stage, CLEAR)], write);
    for stage in
        [Stages::INDIRECT, VERTEX, Stages::EARLY_TESTS, FRAGMENT, Stages::LATE_TESTS, Stages::COLOR_OUTPUT]
    {
        assert_eq!(found(draw(), stage), NOTHING);
    }
    for stage in [Stages::INDIRECT, COMPUTE] {
        assert_eq!(found(dispatch(), stage), NOTHING);
    }
    // A dispatch has none of these stages, and a draw has no `COMPUTE`.
    assert_eq!(found(draw(), COMPUTE), OVERTAKEN);
    for stage in [VERTEX, FRAGMENT, Stages::COLOR_OUTPUT, COPY] {
        assert_eq!(found(dispatch(), stage), OVERTAKEN);
    }
    assert_eq!(found(draw(), COPY), OVERTAKEN);
}

#[test]
fn a_chain_goes_on_from_what_an_earlier_barrier_let_wait_for_the_arguments_of_a_draw() {
    let mut sketch = Sketch::new();
    let (a, b) = (sketch.buffer("a"), sketch.buffer("b"));
    let ready = barrier((CLEAR, Accesses::TRANSFER_WRITE), (Stages::INDIRECT, Accesses::INDIRECT_READ));
    sketch.frame("fill", &[], &[fills(a)]);
    let arguments = touch(a, Stages::INDIRECT, Accesses::INDIRECT_READ);
    sketch.frame_work("first", &[ready], draw(), &[arguments]);
    sketch.frame("between", &[order(Stages::INDIRECT, COMPUTE)], &[writes(b)]);
    sketch.frame("second", &[order(COMPUTE, COMPUTE)], &[writes(a)]);
    assert_eq!(
        sketch.found().into_iter().filter(|line| line.contains(" a:") && !line.contains("fill")).count(),
        0
    );
}

#[test]
fn two_stages_of_one_pass_race_where_one_of_them_writes() {
    let found = |work: Work, uses: &dyn Fn(ResourceId) -> Vec<Use>| {
        let mut sketch = Sketch::new();
        let a = sketch.buffer("a");
        sketch.frame("fill", &[], &[fills(a)]);
        let all = barrier((CLEAR, Accesses::TRANSFER_WRITE), (Stages::all(), Accesses::all()));
        sketch.frame_work("pass", &[all], work, &uses(a));
        sketch.found()
    };
    let race = |kind: &str| vec![format!("{kind}: pass, pass: a: Order")];
    let reads_and_writes = |a| vec![touch(a, VERTEX, READ), touch(a, FRAGMENT, WRITE)];
    assert_eq!(found(draw(), &reads_and_writes), race("WriteAfterRead"));
    assert_eq!(
        found(draw(), &|a| vec![touch(a, VERTEX, WRITE), touch(a, FRAGMENT, READ)]),
        race("ReadAfterWrite")
    );
    assert_eq!(found(draw(), &|a| vec![touch(a, VERTEX, READ), touch(a, FRAGMENT, READ)]), NOTHING);
    // A shader orders its own reads and writes.
    assert_eq!(found(dispatch(), &|a| vec![touch(a, COMPUTE, BOTH)]), NOTHING);
    // A dispatch that writes the words of its own arguments, or other words of the same buffer.
    for offset in [0, 8] {
        let groups = Groups::Indirect { buffer: ResourceId(0), offset };
        let uses = |a| vec![touch(a, Stages::INDIRECT, Accesses::INDIRECT_READ), writes(a)];
        let work = Work::Dispatch { shader: ShaderId(0), groups };
        assert_eq!(found(work, &uses), race("WriteAfterRead"));
    }
}

#[test]
fn two_stages_that_access_by_atomics_alone_do_not_race() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("fill", &[], &[fills(a)]);
    let all = barrier((CLEAR, Accesses::TRANSFER_WRITE), (Stages::all(), Accesses::all()));
    sketch.frame_work("pass", &[all], draw(), &[touch(a, VERTEX, BOTH), touch(a, FRAGMENT, BOTH)]);
    let binding = Binding {
        name: "Count".into(),
        binding: 3,
        element: 0,
        kind: DescriptorKind::StorageBuffer,
        resource: a,
    };
    sketch.plan.passes[1].bindings = vec![binding];
    let shader = |stage, atomics_only| Shader {
        name: "count".into(),
        path: String::new(),
        defines: vec![],
        spirv: Default::default(),
        msl: None,
        reflection: Reflection {
            stage,
            local_size: [1; 3],
            shared_bytes: 0,
            bindings: vec![ReflectedBinding {
                name: "Count".into(),
                set: 0,
                binding: 3,
                count: 1,
                kind: ReflectedKind::StorageBuffer { stride: Some(4), fixed_bytes: 0 },
                reads: true,
                writes: true,
                atomics: true,
                atomics_only,
                writes_first: false,
                scalar: splatgraph_framework::ir::MemberKind::Other,
                words: vec![],
            }],
            push: None,
            inputs: vec![],
            outputs: vec![],
            uses_position: true,
            ignores_rows: false,
            features: Default::default(),
        },
    };
    for (vertex, fragment, races) in [(true, true, false), (true, false, true), (false, true, true)] {
        let shaders = vec![shader(ShaderStage::Vertex, vertex), shader(ShaderStage::Fragment, fragment)];
        sketch.plan.shaders = shaders;
        assert_eq!(!sketch.found().is_empty(), races, "{vertex} {fragment}");
    }
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
        (VERTEX, (Stages::EARLY_TESTS, Accesses::DEPTH_READ)),
        (Stages::EARLY_TESTS, (FRAGMENT, READ)),
        (FRAGMENT, (Stages::LATE_TESTS, Accesses::DEPTH_READ)),
        (Stages::LATE_TESTS, (Stages::COLOR_OUTPUT, Accesses::COLOR_READ)),
    ];
    for (target, (stage, access)) in later {
        let shows_all = barrier((COMPUTE, WRITE), (target, Accesses::all()));
        let expected = format!("ReadAfterWrite: first, second: a: {access} at {stage}");
        assert_eq!(order_of(COMPUTE, &[&[shows_all]], (stage, access)), [expected]);
    }
}

#[test]
fn early_tests_are_before_fragment_shaders_and_late_tests_after_them() {
    let test = |stage| (stage, Accesses::DEPTH_READ);
    let write = (CLEAR, Accesses::TRANSFER_WRITE);
    // A source stage covers earlier stages: `FRAGMENT` covers early tests, but not late tests.
    assert_eq!(write_after_read(test(Stages::EARLY_TESTS), order(FRAGMENT, CLEAR), write), NOTHING);
    assert_eq!(write_after_read(test(Stages::LATE_TESTS), order(FRAGMENT, CLEAR), write), OVERTAKEN);
    assert_eq!(write_after_read((FRAGMENT, READ), order(Stages::EARLY_TESTS, CLEAR), write), OVERTAKEN);
    // A target stage covers later stages, not earlier ones.
    let early = test(Stages::EARLY_TESTS);
    assert_eq!(order_of(COMPUTE, &[&[order(COMPUTE, FRAGMENT)]], early), UNORDERED);
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
    // Draws and dispatches share only their first stage, through which the barriers chain.
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
    assert_eq!(write_after_read_of(dispatch(), (COMPUTE, READ), &[one, two], (FRAGMENT, WRITE)), OVERTAKEN);
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
    *sketch.before(3) = vec![order(COMPUTE | FRAGMENT, CLEAR)];
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
fn what_one_stage_does_to_a_resource_is_its_own_affair() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame_work("draw", &[], draw(), &[touch(a, FRAGMENT, BOTH)]);
    assert_eq!(sketch.found(), NOTHING);
    // The next pass must wait for both the read and the write.
    sketch.frame("fill", &[barrier((VERTEX, WRITE), (CLEAR, Accesses::TRANSFER_WRITE))], &[fills(a)]);
    let expected = ["WriteAfterRead: draw, fill: a: Order", "WriteAfterWrite: draw, fill: a: Order"];
    assert_eq!(sketch.found(), expected);
    *sketch.before(1) = vec![order(FRAGMENT, CLEAR)];
    assert_eq!(sketch.found(), ["WriteAfterWrite: draw, fill: a: Availability"]);
}
