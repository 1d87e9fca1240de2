//! Host buffers, whose contents come with every frame.

use crate::build::*;
use splatgraph_api::{BufferContents, Device, FrameId, FrameInputs, Inspect};
use splatgraph_framework::{ir::*, plan::*};
use std::sync::Arc;

const NAME: &str = "frame.words";

/// Returns a plan that outputs the first words of the buffer `frame.words`, and its length as the last pixel. The
/// buffer's minimum length is `count`.
fn words_and_length(count: u64) -> Plan {
    let mut build = Build::new();
    let given = build.given(NAME, 4, count);
    let image = build.image("row", Format::R32Uint, count as u32 + 1, 1, Usage::STORAGE);
    let shader = build.shader(
        "show.comp",
        &format!(
            "layout(set = 0, binding = 0) readonly buffer Words {{ uint words[]; }};
layout(set = 0, binding = 1, r32ui) writeonly uniform uimage2D row;
void main() {{
    uint i = gl_WorkGroupID.x;
    imageStore(row, ivec2(i, 0), uvec4(i == {count} ? words.length() : words[i]));
}}"
        ),
    );
    build.dispatch(Run::Frame, "show", shader, count as u32 + 1, &[(given, 0, READ), (image, 1, WRITE)]);
    build.export(image)
}

fn bytes(words: &[u32]) -> Arc<Vec<u8>> {
    Arc::new(words.iter().flat_map(|word| word.to_le_bytes()).collect())
}

fn giving(given: BufferContents) -> FrameInputs {
    FrameInputs { buffers: [(NAME.to_string(), given)].into(), ..with_output() }
}

fn given(words: &[u32]) -> FrameInputs {
    giving(BufferContents::Bytes(bytes(words)))
}

#[test]
fn each_frame_in_flight_reads_its_own_buffer_however_long_it_is() {
    let mut vulkan = open_with(words_and_length(2));
    // The length grows, stays and shrinks, always with two frames in flight.
    let lengths = [2, 3, 2, 5000, 4, 100_000, 2, 2, 1 << 20, 3];
    let frames: Vec<(FrameId, u32)> = (0..)
        .zip(lengths)
        .map(|(index, length)| {
            let mut words = vec![7; length];
            (words[0], words[1]) = (index, 10 * index);
            (vulkan.submit(&given(&words)).expect("the frame is submitted"), length as u32)
        })
        .collect();
    for (index, (frame, length)) in (0..).zip(frames) {
        assert_eq!(row(&mut vulkan, frame), [index, 10 * index, length]);
    }
    finish(vulkan);
    again_comparing_submissions("given::each_frame_in_flight_reads_its_own_buffer_however_long_it_is");
}

#[test]
fn the_same_words_may_come_again_and_others_in_between() {
    let mut vulkan = open_with(words_and_length(2));
    let (first, second, longer) = (bytes(&[1, 2]), bytes(&[3, 4]), bytes(&[5, 6, 7]));
    // Each slot gets some contents twice in a row, and some again after others.
    let order =
        [&first, &first, &first, &second, &first, &second, &longer, &second, &second, &first, &second];
    let frames: Vec<_> = order
        .iter()
        .map(|&words| {
            vulkan.submit(&giving(BufferContents::Bytes(words.clone()))).expect("the frame is submitted")
        })
        .collect();
    for (frame, &given) in frames.into_iter().zip(&order) {
        let given = words(given);
        assert_eq!(row(&mut vulkan, frame), [given[0], given[1], given.len() as u32]);
    }
    // A slot holds a reference to the words that it has copied, so they cannot be modified and need no second copy.
    let mut last = order[9].clone();
    drop((first, second, longer));
    assert!(Arc::get_mut(&mut last).is_none(), "the slot holds what it will not copy again");
    finish(vulkan);
    assert!(Arc::get_mut(&mut last).is_some());
}

#[test]
fn arguments_of_dispatches_and_draws_may_come_with_the_frame() {
    let mut build = Build::new();
    let args = build.given(NAME, 4, 7);
    let count = build.words("count", 1);
    let target = build.image("target", Format::Rgba8Unorm, 4, 1, Usage::COLOR_TARGET);
    build.fill(Run::Frame, "clear", count, 0);
    let shader = build.shader(
        "count.comp",
        "layout(set = 0, binding = 0) buffer Count { uint count; };
void main() { atomicAdd(count, 1); }",
    );
    build.dispatch_indirect("count", shader, (args, 0), &[(count, 0, BOTH)]);
    // Instance i covers pixel i. The draw also binds the buffer of its arguments.
    let vertex = build.shader(
        "pixel.vert",
        "layout(set = 0, binding = 0) readonly buffer Args { uint args[]; };
void main() {
    float left = float(gl_InstanceIndex) / 2.0 - 1.0, right = left + 0.5;
    if (args[3] == 0) right = left;
    vec2 corners[6] = vec2[](vec2(left, -1), vec2(right, -1), vec2(left, 1),
                             vec2(right, -1), vec2(right, 1), vec2(left, 1));
    gl_Position = vec4(corners[gl_VertexIndex], 0, 1);
}",
    );
    let fragment = build.shader(
        "white.frag",
        "layout(location = 0) out vec4 color;
void main() { color = vec4(1); }",
    );
    let targets = [Target { image: target, load: Load::Clear(0.0, 0.0, 0.0, 0.0), blend: Blend::Replace }];
    let call = DrawCall::Indirect { buffer: args, offset: 12 };
    build.draw("pixels", [vertex, fragment], call, &targets, &[(args, 0, READ)]);
    build.stat("count", count, 0);
    build.stat("groups", args, 0);
    let mut vulkan = open_with(build.export(target));
    let frames: Vec<_> = (1..=4u32)
        .map(|n| {
            let args = [n, 2, 1, 6, n, 0, 0];
            vulkan.submit(&given(&args)).expect("the frame is submitted")
        })
        .collect();
    for (n, frame) in (1..=4u32).zip(frames) {
        let result = vulkan.wait(frame).expect("the frame is done");
        assert_eq!(result.stats.iter().map(|(_, value)| *value).collect::<Vec<_>>(), [2 * n, n]);
        let pixels = output(&result);
        let expected: Vec<u32> = (0..4).map(|i| if i < n { u32::MAX } else { 0 }).collect();
        assert_eq!(pixels, expected);
    }
    finish(vulkan);
}

#[test]
fn what_is_inspected_of_a_buffer_that_came_with_the_frame_is_all_of_it() {
    let mut vulkan = open();
    let plan = words_and_length(1);
    load(&mut vulkan, plan.clone());
    let resource = plan.find_resource(NAME).expect("it is in the plan");
    let inspect = vec![Inspect { resource, after: PassId(0) }];
    for words_ in [&[1, 2, 3, 4, 5][..], &[6], &[7, 8, 9]] {
        let result = frame(&mut vulkan, &FrameInputs { inspect: inspect.clone(), ..given(words_) });
        assert_eq!(words(&result.inspected[0]), words_);
    }
    finish(vulkan);
}
