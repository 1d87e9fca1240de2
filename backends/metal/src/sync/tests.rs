//! Tests the encoders of small plans.

use super::*;
use crate::sync::model::{Model, mutate};
use crate::testing::*;
use splatgraph_framework::ir::{Hazard, Load, PassId, Shape};
use splatgraph_framework::plan::Cause;

/// Checks the frame's encoders, one per line; that the model has no objections; and that nothing is needless.
#[track_caller]
fn expect(sketch: &Sketch, frame: &[&str]) {
    assert_eq!(sketch.lines(), frame);
    let model = Model::new(&sketch.plan);
    for division in Division::ALL {
        let encoders = encoders(&sketch.plan, division);
        let objections = model.objections(&encoders);
        let told: Vec<String> = objections.iter().map(|found| found.describe(&sketch.plan)).collect();
        assert!(told.is_empty(), "{division:?}: {told:#?}");
        assert_eq!(mutate::needless(&model, &encoders), [], "{division:?}");
    }
}

#[test]
fn a_read_waits_for_a_write_of_the_same_encoder_at_a_barrier_for_buffers() {
    let mut s = Sketch::new();
    let x = s.buffer("x");
    s.dispatch("make", &[writes(x)]);
    s.dispatch("use", &[reads(x)]);
    expect(&s, &["compute after 0: make, (buffers) use; then 0"]);
}

#[test]
fn dispatches_that_touch_nothing_in_common_wait_for_nothing() {
    let mut s = Sketch::new();
    let (x, y, z) = (s.buffer("x"), s.buffer("y"), s.buffer("z"));
    s.dispatch("one", &[reads(x), reads(y)]);
    s.dispatch("two", &[reads(y), reads(z)]);
    expect(&s, &["compute: one, two"]);
}

#[test]
fn one_barrier_as_late_as_possible_serves_all_that_lie_across_it() {
    let mut s = Sketch::new();
    let (x, y, z) = (s.buffer("x"), s.buffer("y"), s.buffer("z"));
    s.dispatch("x", &[writes(x)]);
    s.dispatch("y", &[writes(y)]);
    s.dispatch("z", &[reads(x), writes(z)]);
    s.dispatch("end", &[reads(y)]);
    expect(&s, &["compute after 0: x, y, (buffers) z, end; then 0"]);
}

#[test]
fn a_write_waits_for_reads() {
    let mut s = Sketch::new();
    let x = s.buffer("x");
    s.dispatch("read", &[reads(x)]);
    s.dispatch("write", &[writes(x)]);
    expect(&s, &["compute after 0: read, (buffers) write; then 0"]);
}

#[test]
fn fills_are_dispatches_among_others() {
    let mut s = Sketch::new();
    let (x, y) = (s.buffer("x"), s.buffer("y"));
    s.dispatch("make", &[writes(y)]);
    s.fill("clear", x);
    s.dispatch("add", &[reads(x), writes(x), reads(y)]);
    expect(&s, &["compute after 0: make, clear, (buffers) add; then 0"]);
}

#[test]
fn textures_need_a_barrier_for_textures() {
    let mut s = Sketch::new();
    let x = s.image("x");
    s.dispatch("make", &[writes(x)]);
    s.dispatch("use", &[reads(x)]);
    expect(&s, &["compute after 0: make, (textures) use; then 0"]);
}

#[test]
fn a_conflict_across_the_last_barrier_adds_to_its_scope() {
    let mut s = Sketch::new();
    let (x, y) = (s.buffer("x"), s.image("y"));
    s.dispatch("make", &[writes(x), writes(y)]);
    s.dispatch("use x", &[reads(x)]);
    s.dispatch("use y", &[reads(y)]);
    expect(&s, &["compute after 0: make, (both) use x, use y; then 0"]);
}

#[test]
fn a_texture_in_the_memory_of_a_buffer_waits_at_a_barrier_for_both() {
    let mut s = Sketch::new();
    let (x, y) = (s.buffer("x"), s.image("y"));
    s.share(x, y);
    s.dispatch("make x", &[writes(x)]);
    s.dispatch("use x", &[reads(x)]);
    s.dispatch("make y", &[writes(y)]);
    s.dispatch("use y", &[reads(y)]);
    expect(&s, &["compute after 0: make x, (buffers) use x, (both) make y, (textures) use y; then 0"]);
}

#[test]
fn arguments_of_dispatches_count_as_reads_of_their_words_alone() {
    let mut s = Sketch::new();
    let (args, x) = (s.buffer("args"), s.buffer("x"));
    s.dispatch("make", &[writes(args)]);
    s.dispatch_from("use", args, 16, &[writes(x)]);
    expect(&s, &["compute after 0: make, (buffers) use; then 0"]);

    // `over` writes `short`, an alias of `args`. The arguments lie beyond its end.
    let mut s = Sketch::new();
    let (args, short, image) = (s.buffer("args"), s.buffer("short"), s.image("image"));
    s.plan.resources[short.index()].shape = Shape::Buffer { stride: 4, count: 4 };
    s.share(args, short);
    s.dispatch_from("use", args, 16, &[writes(image)]);
    s.dispatch("over", &[writes(short)]);
    expect(&s, &["compute after 0: use, over; then 0"]);
}

#[test]
fn arguments_of_draws_hold_back_vertices() {
    let mut s = Sketch::new();
    let (args, image) = (s.buffer("args"), s.image("image"));
    s.dispatch("make", &[writes(args)]);
    s.draw_from("draw", args, image, &[]);
    // The next frame's `make` waits for this frame's vertices; its fragments wait for this frame's fragments.
    expect(&s, &["compute after 0: make; then 0", "render after 1f 0v: draw; then 0v 1f"]);
}

#[test]
fn what_fragments_alone_read_holds_back_fragments_alone() {
    let mut s = Sketch::new();
    let (x, image) = (s.buffer("x"), s.image("image"));
    s.dispatch("make", &[writes(x)]);
    s.draw("draw", image, CLEAR, &[fragments_read(x)]);
    expect(&s, &["compute after 0: make; then 0", "render after 0f: draw; then 0f"]);
}

#[test]
fn vertices_that_wait_hold_back_fragments_too() {
    let mut s = Sketch::new();
    let (x, y, image) = (s.buffer("x"), s.buffer("y"), s.image("image"));
    s.dispatch("make", &[writes(x), writes(y)]);
    s.draw("draw", image, CLEAR, &[vertices_read(x), fragments_read(y)]);
    expect(&s, &["compute after 0: make; then 0", "render after 0v: draw; then 0f"]);
}

#[test]
fn a_wait_of_fragments_says_nothing_of_what_follows_the_vertices() {
    let mut s = Sketch::new();
    let (x, y, z, image) = (s.buffer("x"), s.buffer("y"), s.buffer("z"), s.image("image"));
    s.dispatch("make", &[writes(x), writes(z)]);
    s.draw("draw", image, CLEAR, &[vertices_read(y), fragments_read(x)]);
    // `end` waits for the draw's vertices, which may run before `make` completes.
    s.dispatch("end", &[writes(y), reads(z)]);
    expect(
        &s,
        &[
            "compute after 2 3: make; then 0",
            "render after 1v 0f: draw; then 1v 2f",
            "compute after 0 1: end; then 1 3",
        ],
    );
}

#[test]
fn an_encoder_waits_for_the_last_of_those_that_wait_for_one_another() {
    let s = fork();
    // `end` needs `first`, but waits only for the draw. The next `first` needs `end`, but not the export. It may update
    // its fence while the export still waits, so the export waits for another fence.
    expect(
        &s,
        &[
            "compute after 0: first; then 0",
            "render after 0v: draw; then 0f",
            "compute after 1 0: end; then 0 1",
            "blit after 1: export; then 1",
        ],
    );
}

#[test]
fn draws_that_keep_the_targets_share_an_encoder() {
    let mut s = Sketch::new();
    let (x, image, other) = (s.buffer("x"), s.image("image"), s.image("other"));
    s.draw("one", image, CLEAR, &[vertices_read(x)]);
    s.draw("two", image, Load::Keep, &[vertices_read(x)]);
    s.draw("clear", image, CLEAR, &[]);
    s.draw("other", other, Load::Keep, &[]);
    expect(
        &s,
        &[
            "render after 0f: one, two; then 0f",
            "render after 0f: clear; then 0f",
            "render after 1f: other; then 1f",
        ],
    );
}

#[test]
fn draws_of_which_one_reads_what_the_other_writes_have_encoders_of_their_own() {
    let mut s = Sketch::new();
    let (x, image) = (s.buffer("x"), s.image("image"));
    s.draw("write", image, CLEAR, &[fragments_write(x)]);
    s.draw("read", image, Load::Keep, &[vertices_read(x)]);
    expect(&s, &["render after 0f: write; then 0f", "render after 0v: read; then 0f"]);
}

#[test]
fn a_frame_waits_for_the_one_before_where_it_touches_the_same_memory() {
    let mut s = Sketch::new();
    let x = s.buffer("x");
    s.dispatch("alone", &[writes(x)]);
    expect(&s, &["compute after 0: alone; then 0"]);
}

#[test]
fn a_frame_does_not_wait_for_copies_that_it_does_not_overwrite() {
    let mut s = Sketch::new();
    let (x, y, image) = (s.buffer("x"), s.buffer("y"), s.image("image"));
    s.dispatch("make", &[writes(x)]);
    s.draw("draw", image, CLEAR, &[vertices_read(x)]);
    s.dispatch("count", &[writes(y)]);
    s.export(image, Some(y));
    let frame = s.lines();
    // `make` waits only for the vertices that read `x`.
    assert_eq!(frame[0], "compute after 0: make; then 0");
    assert_eq!(frame[1], "render after 1f 0v: draw; then 0v 1f");
    expect(&s, &frame.iter().map(String::as_str).collect::<Vec<_>>());
}

#[test]
fn what_each_frame_in_flight_has_for_itself_orders_nothing() {
    let mut s = Sketch::new();
    let (x, image) = (s.buffer("x"), s.image("image"));
    s.once("make", &[writes(x), writes(image)]);
    s.export(image, Some(x));
    let readback = s.plan.find_resource("readback").expect("the export's");
    s.host(readback);
    // No encoder waits for the host pass, which waits for the whole command buffer instead.
    expect(&s, &["blit: export"]);
    assert!(encoders(&s.plan, Division::Merged).handover);
}

#[test]
fn the_handover_is_there_if_the_frame_touches_what_the_prologue_touched() {
    let mut s = Sketch::new();
    let (x, y) = (s.buffer("x"), s.buffer("y"));
    s.once("once", &[writes(x)]);
    s.once("twice", &[reads(x)]);
    s.dispatch("make", &[writes(y)]);
    expect(&s, &["compute after 0: make; then 0"]);
    assert_eq!(s.told(Division::Merged).0, ["compute: once, (buffers) twice"]);
    assert_eq!(s.told(Division::Passes).0, ["compute: once; then 0", "compute after 0: twice"]);
    assert!(!encoders(&s.plan, Division::Merged).handover);
    s.dispatch("use", &[reads(x)]);
    expect(&s, &["compute after 0: make, use; then 0"]);
    assert!(encoders(&s.plan, Division::Merged).handover);
}

#[test]
fn with_times_every_pass_has_an_encoder_and_waits_for_those_alone_that_it_needs() {
    let mut s = Sketch::new();
    let (x, y, z) = (s.buffer("x"), s.buffer("y"), s.buffer("z"));
    s.dispatch("x", &[writes(x)]);
    s.dispatch("y", &[writes(y)]);
    s.dispatch("z", &[reads(x), reads(y), writes(z)]);
    expect(&s, &["compute after 0: x, y, (buffers) z; then 0"]);
    let apart =
        ["compute after 0: x; then 0", "compute after 1: y; then 1", "compute after 0 1: z; then 0 1"];
    assert_eq!(s.told(Division::Passes).1, apart);
}

#[test]
fn one_fence_goes_round_where_each_encoder_waits_for_the_one_before() {
    let mut s = Sketch::new();
    let (x, image, last) = (s.buffer("x"), s.image("image"), s.image("last"));
    s.share(x, last);
    s.dispatch("make", &[writes(x)]);
    s.draw("draw", image, CLEAR, &[vertices_read(x)]);
    s.dispatch("compose", &[reads(image), writes(last)]);
    s.export(last, None);
    // `compose` overwrites what the vertices read, and reads what the fragments write: one wait covers both.
    expect(
        &s,
        &[
            "compute after 0: make; then 0",
            "render after 0v: draw; then 0f",
            "compute after 0: compose; then 0",
            "blit after 0: export; then 0",
        ],
    );
}

#[test]
fn reasons_name_the_hazard_the_passes_and_both_resources() {
    let mut s = Sketch::new();
    let (x, y) = (s.buffer("x"), s.buffer("y"));
    s.share(x, y);
    s.dispatch("make", &[writes(x)]);
    s.dispatch("over", &[writes(y)]);
    let (_, reasons) = explained(&s.plan, Division::Merged);
    let reason = |point, hazard, before, resource, after, previous_frame, alias| {
        let (before, after) = (PassId(before), vec![PassId(after)]);
        (At::Frame(0, point), Cause { hazard, before, resource, after, previous_frame, alias })
    };
    let write = Hazard::WriteAfterWrite;
    assert_eq!(
        reasons,
        [
            reason(Point::Wait(0), write, 0, x, 1, true, Some(y)),
            reason(Point::Barrier(1), write, 1, y, 0, false, Some(x)),
        ]
    );
}
