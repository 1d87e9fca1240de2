//! Tests that the model objects to encoders with one mistake.

use super::mutate::{Mutation, Piece, apply, mutations};
use super::*;
use crate::testing::*;

fn told(sketch: &Sketch, change: impl FnOnce(&mut Encoders)) -> Vec<String> {
    let mut encoders = encoders(&sketch.plan, Division::Merged);
    change(&mut encoders);
    let found = Model::new(&sketch.plan).objections(&encoders);
    found.iter().map(|objection| objection.describe(&sketch.plan)).collect()
}

const NOTHING: [&str; 0] = [];

#[test]
fn a_whole_list_gets_no_objection() {
    assert_eq!(told(&chain(), |_| {}), NOTHING);
}

#[test]
fn a_missing_barrier_is_named_by_both_passes_and_the_resource() {
    let found = told(&chain(), |encoders| encoders.frame[0].passes[1].barrier = None);
    assert_eq!(
        found,
        ["`change` (frame 0) touches `x` without waiting for `make` (frame 0), which touched it"]
    );
}

#[test]
fn a_barrier_for_the_other_kind_of_resource_does_not_help() {
    let textures = MemoryBarrier { buffers: false, textures: true };
    let found = told(&chain(), |encoders| encoders.frame[0].passes[1].barrier = Some(textures));
    assert_eq!(found.len(), 1, "{found:#?}");
}

#[test]
fn a_missing_wait_lets_a_draw_run_before_what_it_reads() {
    let found = told(&chain(), |encoders| {
        encoders.frame[1].waits.retain(|wait| wait.stages == Some(RenderStages::Fragment))
    });
    let draw = "`draw` (frame 0) touches `x` without waiting for `change` (frame 0), which touched it";
    assert!(found.iter().any(|text| text == draw), "{found:#?}");
}

#[test]
fn a_missing_update_is_found_where_nothing_is_waited_for() {
    let found = told(&chain(), |encoders| encoders.frame[0].updates.clear());
    let draw = "`draw` (frame 0) touches `x` without waiting for `change` (frame 0), which touched it";
    assert!(found.iter().any(|text| text == draw), "{found:#?}");
}

#[test]
fn an_event_is_missed_between_the_prologue_and_the_first_frame() {
    let found = told(&chain(), |encoders| encoders.handover = false);
    assert_eq!(
        found,
        ["`make` (frame 0) touches `y` without waiting for `once` (prologue), which touched it"]
    );
}

#[test]
fn a_missing_wait_between_frames_is_found_in_the_second() {
    let mut s = Sketch::new();
    let (x, y) = (s.buffer("x"), s.buffer("y"));
    s.share(x, y);
    s.dispatch("make", &[writes(x)]);
    s.dispatch("over", &[writes(y)]);
    let found = told(&s, |encoders| encoders.frame[0].waits.clear());
    let over = "`make` (frame 1) touches `x` without waiting for `over` (frame 0), which touched it as `y` in the same memory";
    assert!(found.iter().any(|text| text == over), "{found:#?}");
}

#[test]
fn a_fence_stands_for_its_last_update_alone() {
    let mut s = Sketch::new();
    let (x, y, z) = (s.buffer("x"), s.buffer("y"), s.buffer("z"));
    s.dispatch("x", &[writes(x)]);
    s.dispatch("y", &[writes(y)]);
    s.dispatch("z", &[reads(x), reads(y), writes(z)]);
    let mut encoders = encoders(&s.plan, Division::Passes);
    // `x` and `y` both update fence 1, and `z` waits for it.
    encoders.frame[0].updates[0].fence = 1;
    encoders.frame[1].waits.clear();
    encoders.frame[2].waits.retain(|wait| wait.fence == 1);
    let found = Model::new(&s.plan).objections(&encoders);
    let text: Vec<String> = found.iter().map(|found| found.describe(&s.plan)).collect();
    assert!(text.iter().any(|text| text.starts_with("`z` (frame 0) touches `x`")), "{text:#?}");
}

#[test]
fn lists_that_are_none_of_the_plan_are_refused_with_a_reason() {
    type Change = fn(&mut Encoders);
    let cases: [(Change, &str); 10] = [
        (|e| e.frame[0].passes.truncate(1), "the frame has other passes than the plan, or in another order"),
        (|e| e.frame[0].passes.reverse(), "or in another order"),
        (|e| drop(e.frame.remove(2)), "other passes"),
        (|e| e.frame[0].kind = EncoderKind::Blit, "is of the kind Blit, which `make` is not"),
        (|e| e.frame[0].waits[0].fence = 9, "encoder 0 of the frame waits for fence 9 of"),
        (|e| e.frame[1].waits[0].stages = None, "at stages that it does not have"),
        (|e| e.frame[1].passes[0].barrier = Some(MemoryBarrier::default()), "where none can be"),
        (
            |e| e.frame[0].passes[1].barrier = Some(MemoryBarrier::default()),
            "a barrier for nothing before `change`",
        ),
        (
            |e| e.frame[0].updates = e.frame[0].updates.repeat(2),
            "encoder 0 of the frame updates fence 0 twice",
        ),
        (
            |e| e.frame.iter_mut().for_each(|e| e.updates.clear()),
            "is waited for in the frame and never updated",
        ),
    ];
    for (change, reason) in cases {
        let found = told(&chain(), change);
        assert!(found.iter().any(|text| text.contains(reason)), "{reason}: {found:#?}");
    }
}

#[test]
fn a_fence_that_is_updated_before_it_is_waited_for_is_refused() {
    let mut s = Sketch::new();
    let image = s.image("image");
    s.draw("draw", image, CLEAR, &[]);
    let found = told(&s, |encoders| encoders.frame[0].updates[0].stages = Some(RenderStages::Vertex));
    assert!(found.iter().any(|text| text.contains("updates fence 0 before it waits for it")), "{found:#?}");
}

#[test]
fn a_fence_that_is_updated_while_an_earlier_encoder_may_wait_for_it_is_refused() {
    let s = fork();
    // The export and the next `first` wait for the same update by `end`. Then `first` can update the fence without
    // waiting for the export.
    let found = told(&s, |encoders| {
        encoders.frame[2].updates.truncate(1);
        encoders.frame[3].waits[0].fence = 0;
    });
    assert_eq!(
        found,
        ["the encoder of `first` updates fence 0, for which the encoder of `export` may be waiting"]
    );
}

#[test]
fn a_draw_that_clears_in_the_encoder_of_another_is_refused() {
    let mut s = Sketch::new();
    let image = s.image("image");
    s.draw("one", image, CLEAR, &[]);
    s.draw("two", image, CLEAR, &[]);
    let found = told(&s, |encoders| {
        let second = encoders.frame.remove(1);
        encoders.frame[0].passes.extend(second.passes);
    });
    assert!(
        found.iter().any(|text| text.contains("holds `two`, which needs targets of its own")),
        "{found:#?}"
    );
}

#[test]
fn each_part_of_the_synchronization_can_be_taken_away() {
    let s = chain();
    let encoders = encoders(&s.plan, Division::Merged);
    let all = mutations(&encoders);
    assert!(
        all.contains(&Mutation::Handover) && all.contains(&Mutation::Encoder(1, Piece::Barrier(1))),
        "{all:?}"
    );
    for mutation in all {
        let mutant = apply(&encoders, mutation);
        assert_ne!(mutant, encoders, "{}", mutation.describe(&s.plan, &encoders));
        assert!(Model::new(&s.plan).finds_unordered(&mutant), "{}", mutation.describe(&s.plan, &encoders));
    }
}
