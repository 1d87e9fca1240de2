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
