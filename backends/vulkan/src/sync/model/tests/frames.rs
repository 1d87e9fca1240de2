//! Tests the prologue, the handover, successive frames, and the host.

use super::*;

#[test]
fn the_handover_shows_the_frames_what_the_prologue_wrote() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.once("load", &[], &[writes(a)]);
    sketch.frame("draw", &[], &[touch(a, VERTEX, READ)]);
    assert_eq!(sketch.found_in(4), ["ReadAfterWrite: load, draw: a: Order"]);
    sketch.barriers.handover = vec![barrier((COMPUTE, WRITE), (VERTEX, READ))];
    assert_eq!(sketch.found_in(4), NOTHING);
}

#[test]
fn prologue_passes_need_barriers_among_themselves() {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.once("load", &[], &[writes(a)]);
    sketch.once("sum", &[], &[reads(a)]);
    assert_eq!(sketch.found_in(0), ["ReadAfterWrite: load, sum: a: Order"]);
    *sketch.before_once(1) = vec![compute_to_compute()];
    assert_eq!(sketch.found_in(0), NOTHING);
}

fn every_frame(first: &[Barrier]) -> Sketch {
    let mut sketch = Sketch::new();
    let a = sketch.buffer("a");
    sketch.frame("write", first, &[writes(a)]);
    sketch.frame("draw", &[barrier((COMPUTE, WRITE), (VERTEX, READ))], &[touch(a, VERTEX, READ)]);
    sketch
}

#[test]
fn a_frame_waits_for_the_readers_of_the_one_before() {
    let sketch = every_frame(&[]);
    assert_eq!(sketch.found_in(1), NOTHING);
    let expected = ["WriteAfterRead: draw, write: a: Order", "WriteAfterWrite: write, write: a: Order"];
    assert_eq!(sketch.found_in(2), expected);
    let found = sketch.replay(&Replay::default());
    let expected = "`write` (frame 1) writes `a`, bytes 0..64, without waiting \
                    for `draw` (frame 0), which read them";
    assert_eq!(found[0].describe(&sketch.plan), expected);
    assert_eq!(every_frame(&[order(VERTEX, COMPUTE)]).found_in(4), NOTHING);
}

#[test]
fn four_frames_are_replayed_unless_told_otherwise_and_the_first_objection_suffices() {
    assert_eq!(Replay::default(), Replay { frames: 4, in_flight: 2, copies: 2 });
    let violates = |sketch: Sketch| has_violation(&sketch.plan, &sketch.barriers, Rules::HAZARDS);
    assert!(violates(every_frame(&[])));
    assert!(!violates(every_frame(&[order(VERTEX, COMPUTE)])));
}

/// Replays a draw that reads a uniform block, with `in_flight` frames in flight and `copies` copies of the block.
fn with_uniform(in_flight: u32, copies: u32) -> Vec<String> {
    let mut sketch = Sketch::new();
    let camera = sketch.uniform("camera");
    sketch.frame("draw", &[], &[touch(camera, VERTEX | FRAGMENT, Accesses::UNIFORM_READ)]);
    tell(&sketch.plan, &sketch.replay(&Replay { frames: 6, in_flight, copies }))
}

#[test]
fn the_host_writes_uniforms_without_barriers() {
    assert_eq!(with_uniform(2, 2), NOTHING);
    assert_eq!(with_uniform(1, 1), NOTHING);
    assert_eq!(with_uniform(3, 3), NOTHING);
    assert_eq!(with_uniform(1, 2), NOTHING);
}

#[test]
fn the_host_must_not_write_what_a_frame_in_flight_reads() {
    let expected = ["WriteAfterRead: draw, host: camera: Order"];
    assert_eq!(with_uniform(2, 1), expected);
    assert_eq!(with_uniform(3, 2), expected);
}

#[test]
fn the_host_is_told_by_the_frame_that_it_prepares() {
    let mut sketch = Sketch::new();
    let camera = sketch.uniform("camera");
    sketch.frame("draw", &[], &[touch(camera, VERTEX, Accesses::UNIFORM_READ)]);
    let found = sketch.replay(&Replay { frames: 4, in_flight: 3, copies: 2 });
    let expected = "the host, preparing frame 2, writes `camera`, bytes 0..16, without waiting \
                    for `draw` (frame 0), which read them";
    assert_eq!(found[0].describe(&sketch.plan), expected);
}

#[test]
fn the_prologue_reads_the_uniforms_of_the_first_frame() {
    let mut sketch = Sketch::new();
    let live = sketch.resource("live", Shape::Buffer { stride: 4, count: 1 }, Source::Live);
    sketch.once("load", &[], &[touch(live, COMPUTE, Accesses::UNIFORM_READ)]);
    assert_eq!(sketch.found_in(4), NOTHING);
}

fn with_statistics(to_host: &[Barrier]) -> Sketch {
    let mut sketch = Sketch::new();
    let counts = sketch.buffer("counts");
    let words = sketch.resource("words", Shape::Buffer { stride: 4, count: 2 }, Source::Readback);
    let stat = |name: &str, offset| Stat { name: name.into(), buffer: counts, offset, grows: Vec::new() };
    sketch.plan.stats = vec![stat("visible", 8), stat("drawn", 40)];
    // The export reads only two words. The next write also needs the others made visible.
    sketch.frame("count", &[barrier((COPY, NO_ACCESS), (COMPUTE, WRITE))], &[writes(counts)]);
    let copied = [touch(counts, COPY, Accesses::TRANSFER_READ), touch(words, COPY, Accesses::TRANSFER_WRITE)];
    let exported = barrier((COMPUTE, WRITE), (COPY, Accesses::TRANSFER_READ));
    sketch.frame_work("export", &[exported], Work::Export, &copied);
    let read = touch(words, Stages::HOST, Accesses::HOST_READ);
    sketch.frame_work("host", to_host, Work::Host, &[read]);
    sketch
}

fn copy_to_host() -> Barrier {
    barrier((COPY, Accesses::TRANSFER_WRITE), (Stages::HOST, Accesses::HOST_READ))
}

#[test]
fn the_host_reads_statistics_after_a_barrier_to_it() {
    assert_eq!(with_statistics(&[copy_to_host()]).found_in(6), NOTHING);
}

#[test]
fn the_fence_orders_exports_to_the_same_copy() {
    // The exported data never change, so no other barrier orders successive exports.
    let mut sketch = Sketch::new();
    let source = Source::Scene { attribute: "scene.counts".into(), plane: 0 };
    let counts = sketch.resource("counts", Shape::Buffer { stride: 4, count: 1 }, source);
    let words = sketch.resource("words", Shape::Buffer { stride: 4, count: 1 }, Source::Readback);
    sketch.plan.stats = vec![Stat { name: "count".into(), buffer: counts, offset: 0, grows: Vec::new() }];
    let copied = [touch(counts, COPY, Accesses::TRANSFER_READ), touch(words, COPY, Accesses::TRANSFER_WRITE)];
    sketch.frame_work("export", &[], Work::Export, &copied);
    let read = touch(words, Stages::HOST, Accesses::HOST_READ);
    sketch.frame_work("host", &[copy_to_host()], Work::Host, &[read]);
    assert_eq!(sketch.found_in(6), NOTHING);
}

#[test]
fn a_fence_shows_the_host_nothing() {
    // The fence of this frame does not order the host's read after the copies: a barrier must.
    let found = with_statistics(&[]).found_in(1);
    assert_eq!(found, ["ReadAfterWrite: export, host: words: Order"]);
    let unseen = barrier((COPY, Accesses::TRANSFER_WRITE), (Stages::HOST, NO_ACCESS));
    assert_eq!(
        with_statistics(&[unseen]).found_in(1),
        ["ReadAfterWrite: export, host: words: HOST_READ at HOST"]
    );
    let unavailable = barrier((COPY, NO_ACCESS), (Stages::HOST, Accesses::HOST_READ));
    assert_eq!(
        with_statistics(&[unavailable]).found_in(1),
        ["ReadAfterWrite: export, host: words: Availability"]
    );
}

#[test]
fn the_export_must_not_write_what_the_host_still_reads() {
    let sketch = with_statistics(&[copy_to_host()]);
    let found = sketch.replay(&Replay { frames: 6, in_flight: 3, copies: 2 });
    let expected = [
        "WriteAfterRead: host, export: words: Order",
        "WriteAfterWrite: export, export: words: TRANSFER_WRITE at COPY",
    ];
    assert_eq!(tell(&sketch.plan, &found), expected);
}

#[test]
fn statistics_are_the_words_that_the_export_copies() {
    let mut sketch = with_statistics(&[copy_to_host()]);
    sketch.before(1).clear();
    let found = sketch.replay(&Replay { frames: 1, ..Replay::default() });
    assert_eq!(tell(&sketch.plan, &found), ["ReadAfterWrite: count, export: counts: Order"]);
    assert_eq!(found[0].range, 8..12);
    sketch.plan.stats.remove(0);
    let found = sketch.replay(&Replay { frames: 1, ..Replay::default() });
    assert_eq!(found[0].range, 40..44);
    sketch.before(2).clear();
    let found = sketch.replay(&Replay { frames: 1, ..Replay::default() });
    assert_eq!(found[1].range, 0..4);
}

#[test]
fn the_host_must_not_read_the_statistics_of_an_earlier_frame() {
    let mut sketch = with_statistics(&[copy_to_host()]);
    // The host reads before the export copies.
    sketch.plan.frame.swap(1, 2);
    let found = sketch.found_in(3);
    assert!(found.contains(&"Unwritten: export, host: words: Contents".to_string()), "{found:?}");
}

#[test]
fn a_fence_does_not_order_what_the_device_alone_touches() {
    // A frame starts once the previous one is complete, but the model lets a fence order only the host's resources.
    let sketch = every_frame(&[]);
    let replay = sketch.replay(&Replay { frames: 4, in_flight: 1, copies: 1 });
    assert!(!replay.is_empty());
}
