//! Successive frames: the prologue, uniforms, frames in flight, and contents that persist.

use crate::build::*;
use splatgraph_api::{BackendError, Device, FrameId, FrameInputs, Inspect};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_vulkan::sync::{Barrier, barriers};
use splatgraph_vulkan::{Options, Validation, Vulkan};
use std::time::Duration;

/// Returns a plan whose prologue zeroes a word and adds 100, and whose frames add 1 each.
fn counter() -> (Plan, ResourceId) {
    let mut build = Build::new();
    let count = build.words("count", 1);
    build.fill(Run::Once, "clear", count, 0);
    let hundred = build.shader("hundred.comp", &add(100));
    build.dispatch(Run::Once, "hundred", hundred, 1, &[(count, 0, BOTH)]);
    let one = build.shader("one.comp", &add(1));
    build.dispatch(Run::Frame, "one", one, 1, &[(count, 0, BOTH)]);
    build.stat("count", count, 0);
    (show(build, count), count)
}

fn counts(vulkan: &mut Vulkan) -> u32 {
    frame(vulkan, &FrameInputs::default()).stats[0].1
}

#[test]
fn the_prologue_runs_in_the_first_frame_after_a_load_and_in_no_other() {
    let (plan, count) = counter();
    let mut vulkan = open_with(plan.clone());
    let inspect = vec![Inspect { resource: count, after: PassId(1) }];
    let first = frame(&mut vulkan, &FrameInputs { inspect, ..Default::default() });
    assert_eq!(words(&first.inspected[0]), [100]);
    let passes: Vec<u32> = first.pass_ms.iter().map(|(pass, _)| pass.0).collect();
    assert_eq!(passes, [0, 1, 2, 3, 4]);
    let second = frame(&mut vulkan, &FrameInputs::default());
    assert_eq!((first.stats[0].1, second.stats[0].1), (101, 102));
    assert_eq!(second.pass_ms.len(), 3);
    load(&mut vulkan, plan);
    assert_eq!((counts(&mut vulkan), counts(&mut vulkan)), (101, 102));
    finish(vulkan);
}

#[test]
fn frames_in_flight_see_the_frame_before_and_results_may_be_taken_in_any_order() {
    let mut vulkan = open_with(counter().0);
    let frames: Vec<FrameId> =
        (0..7).map(|_| vulkan.submit(&with_output()).expect("the frame is submitted")).collect();
    for index in [6, 0, 5, 1, 2, 4, 3] {
        let result = vulkan.wait(frames[index]).expect("the frame is done");
        assert_eq!(result.stats[0].1, 101 + index as u32);
        assert_eq!(output(&result), [101 + index as u32]);
    }
    let again = error_of(vulkan.wait(frames[3]));
    assert!(again.contains("frame 3 has no result"), "{again}");
    assert!(error_of(vulkan.wait(FrameId(99))).contains("never submitted"));
    finish(vulkan);
}

#[test]
fn results_that_are_not_taken_do_not_pile_up() {
    let mut vulkan = open_with(counter().0);
    let first = vulkan.submit(&FrameInputs::default()).unwrap();
    let last = (0..80).map(|_| vulkan.submit(&FrameInputs::default()).unwrap()).last().unwrap();
    assert!(error_of(vulkan.wait(first)).contains("newer results"));
    assert_eq!(vulkan.wait(last).unwrap().stats[0].1, 181);
    finish(vulkan);
}

/// Returns a plan that outputs the first word of a camera block and the second of the live block.
fn uniforms() -> Plan {
    let mut build = Build::new();
    let words_ = build.words("words", 2);
    let camera = build.uniform(Source::Frame { uniform: "frame.camera".to_string() }, 16);
    let live = build.uniform(Source::Live, 16);
    let shader = build.shader(
        "uniforms.comp",
        "layout(set = 0, binding = 0) writeonly buffer Words { uint words[]; };
layout(set = 0, binding = 1, std140) uniform Camera { uint camera; };
layout(set = 0, binding = 31, std140) uniform Live { uint first; uint second; };
void main() { words[0] = camera; words[1] = second; }",
    );
    let binds = [(words_, 0, WRITE), (camera, 1, UNIFORM), (live, 31, UNIFORM)];
    build.dispatch(Run::Frame, "uniforms", shader, 1, &binds);
    show(build, words_)
}

fn uniform_inputs(camera: u32, second: u32) -> FrameInputs {
    FrameInputs {
        uniforms: [("frame.camera".to_string(), camera.to_le_bytes().to_vec())].into(),
        live: [0u32, second].iter().flat_map(|word| word.to_le_bytes()).collect(),
        ..with_output()
    }
}

#[test]
fn each_frame_in_flight_reads_its_own_uniforms() {
    let mut vulkan = open_with(uniforms());
    let frames: Vec<FrameId> =
        (0..5).map(|i| vulkan.submit(&uniform_inputs(10 + i, 20 + i)).expect("submitted")).collect();
    for (index, &frame) in frames.iter().enumerate() {
        let output = vulkan.wait(frame).unwrap().output.unwrap();
        assert_eq!(words(&output.bytes), [10 + index as u32, 20 + index as u32]);
    }
    // Missing bytes of a block are 0, not an earlier frame's.
    let mut short = uniform_inputs(1, 2);
    short.live.clear();
    assert_eq!(output(&frame(&mut vulkan, &short)), [1, 0]);
    finish(vulkan);
}

#[test]
fn the_handover_brings_an_image_that_frames_keep_to_where_the_frame_before_would_have_left_it() {
    // The prologue sets the image to 100, and each frame adds 1. Frames find it in the layout that the export left.
    let mut build = Build::new();
    let image = build.image("kept", Format::R32Uint, 1, 1, Usage::STORAGE);
    let set = build.shader("set.comp", &image_shader("uvec4(100)"));
    build.dispatch(Run::Once, "set", set, 1, &[(image, 0, WRITE)]);
    let grow = build.shader("grow.comp", &image_shader("imageLoad(image, ivec2(0)) + 1"));
    build.dispatch(Run::Frame, "grow", grow, 1, &[(image, 0, BOTH)]);
    let plan = build.export(image);
    let barriers = barriers(&plan).expect("there are some");
    let changed = |at| barriers.at(at).iter().find_map(|b: &Barrier| b.image).map(|t| (t.old, t.new));
    assert_eq!(changed(None), Some((Layout::General, Layout::TransferSource)));
    assert_eq!(changed(Some(plan.frame[0])), Some((Layout::TransferSource, Layout::General)));
    let mut vulkan = open_with(plan);
    let mut pixel = || shown(&mut vulkan)[0];
    assert_eq!([pixel(), pixel(), pixel()], [101, 102, 103]);
    finish(vulkan);
}

#[test]
fn what_the_host_is_shown_by_the_plan_is_all_that_was_copied_before() {
    // Inspects the buffer before the host pass in one frame, and after it in the next.
    let (plan, count) = counter();
    let host = PassId(plan.passes.len() as u32 - 1);
    assert_eq!(plan.pass(host).work, Work::Host);
    let mut vulkan = open_with(plan);
    for (after, expected) in [(PassId(2), 101), (host, 102)] {
        let inspect = vec![Inspect { resource: count, after }];
        let result = frame(&mut vulkan, &FrameInputs { inspect, ..with_output() });
        assert_eq!(result.stats, [("count".to_string(), expected)]);
        assert_eq!(output(&result), [expected]);
        assert_eq!(words(&result.inspected[0]), [expected]);
        // The host pass does nothing on the device, so it has no time.
        assert!(result.pass_ms.iter().all(|(pass, _)| *pass != host));
    }
    finish(vulkan);
}

/// A slow pass with many short invocations, because lavapipe limits the iterations of a loop.
const SLOW: &str = "layout(set = 0, binding = 0) buffer Words { uint words[]; };
void main() {
    uint x = words[0] + gl_WorkGroupID.x;
    for (uint i = 0; i < 60000; i++) {
        x = (x ^ (x >> 7)) * 1664525u + 1013904223u;
    }
    if (x == 0u) {
        words[0] = 8u;
    }
}";

#[test]
fn a_pass_that_runs_for_long_is_named_while_it_runs_and_its_frame_can_be_waited_for_again() {
    let mut build = Build::new();
    let words_ = build.words("words", 1);
    build.fill(Run::Frame, "fill", words_, 7);
    let slow = build.shader("slow.comp", SLOW);
    build.dispatch(Run::Frame, "slow", slow, 3_000, &[(words_, 0, BOTH)]);
    let plan = show(build, words_);
    let options = Options {
        validation: Validation::Synchronization,
        patience: Some(Duration::from_millis(100)),
        ..Options::default()
    };
    let mut vulkan = Vulkan::open(&options).expect("a device");
    load(&mut vulkan, plan);
    let id = vulkan.submit(&with_output()).expect("the frame is submitted");
    assert_eq!(vulkan.try_wait(id).expect("no error").map(|_| ()), None);
    let error = vulkan.wait(id).map(|_| ()).expect_err("it takes longer than that");
    let BackendError::Stuck { place, .. } = &error else { panic!("{error}") };
    // Lavapipe does not report the pass while it runs.
    assert!(["pass `slow` of `hand-made`", "a frame of `hand-made`"].contains(&place.as_str()), "{place}");
    assert!(vulkan.running().is_some_and(|running| running.time >= Duration::from_millis(100)));
    let result = loop {
        match vulkan.wait(id) {
            Err(BackendError::Stuck { .. }) => {}
            other => break other.expect("it ends"),
        }
    };
    assert_eq!(result.output.expect("it was asked for").bytes.len(), 4);
    assert_eq!(vulkan.running(), None);
    finish(vulkan);
}
