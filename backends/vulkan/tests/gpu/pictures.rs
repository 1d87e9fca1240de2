//! Several executors on one device that share their outputs.

use crate::build::*;
use splatgraph_api::{BackendError, BufferContents, Device, FrameId, FrameInputs, Picture};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_vulkan::Vulkan;
use std::sync::Arc;

/// Returns a plan that outputs a row of `width` pixels, all equal to `frame.value`.
fn plain(width: u32) -> Plan {
    let mut build = Build::new();
    let value = build.given("frame.value", 4, 1);
    let image = build.image("row", Format::R32Uint, width, 1, Usage::STORAGE);
    let shader = build.shader(
        "plain.comp",
        "layout(set = 0, binding = 0) readonly buffer Value { uint value; };
layout(set = 0, binding = 1, r32ui) writeonly uniform uimage2D row;
void main() { imageStore(row, ivec2(gl_WorkGroupID.x, 0), uvec4(value)); }",
    );
    build.dispatch(Run::Frame, "plain", shader, width, &[(value, 0, READ), (image, 1, WRITE)]);
    build.export(image)
}

/// Returns a plan that examines the pixels of two rows. For each row, it outputs the first pixel, the number of pixels,
/// and the number equal to the first.
fn compare() -> Plan {
    let mut build = Build::new();
    let rows = ["frame.left", "frame.right"].map(|name| build.given(name, 4, 1));
    let image = build.image("row", Format::R32Uint, 6, 1, Usage::STORAGE);
    let shader = build.shader(
        "compare.comp",
        "layout(set = 0, binding = 0) readonly buffer Left { uint left[]; };
layout(set = 0, binding = 1) readonly buffer Right { uint right[]; };
layout(set = 0, binding = 2, r32ui) writeonly uniform uimage2D row;
void main() {
    uint same[2] = uint[](0, 0);
    for (int i = 0; i < left.length(); i++) same[0] += uint(left[i] == left[0]);
    for (int i = 0; i < right.length(); i++) same[1] += uint(right[i] == right[0]);
    uint all[6] = uint[](left[0], left.length(), same[0], right[0], right.length(), same[1]);
    for (int i = 0; i < 6; i++) imageStore(row, ivec2(i, 0), uvec4(all[i]));
}",
    );
    let binds = [(rows[0], 0, READ), (rows[1], 1, READ), (image, 2, WRITE)];
    build.dispatch(Run::Frame, "compare", shader, 1, &binds);
    build.export(image)
}

fn value(value: u32) -> FrameInputs {
    let bytes = BufferContents::Bytes(Arc::new(value.to_le_bytes().to_vec()));
    FrameInputs { buffers: [("frame.value".to_string(), bytes)].into(), ..Default::default() }
}

fn draw(vulkan: &mut Vulkan, pixels: u32) -> Picture {
    vulkan.submit(&FrameInputs { show: true, ..value(pixels) }).expect("the frame is submitted");
    vulkan.picture().expect("it was shown")
}

fn pictures(left: Picture, right: Picture) -> FrameInputs {
    let given = [("frame.left", left), ("frame.right", right)];
    let buffers = given.map(|(name, picture)| (name.to_string(), BufferContents::Picture(picture)));
    FrameInputs { buffers: buffers.into(), ..with_output() }
}

fn total(vulkan: &Vulkan) -> u64 {
    vulkan.memory().iter().map(|(_, bytes)| bytes).sum()
}

fn listed(vulkan: &Vulkan, entry: &str) -> Option<u64> {
    vulkan.memory().iter().find(|(name, _)| name == entry).map(|(_, bytes)| *bytes)
}

#[test]
fn a_third_executor_reads_what_two_others_drew_frame_after_frame() {
    let mut window = open();
    let (mut left, mut right) = (new_context(&window), new_context(&window));
    load(&mut window, compare());
    load(&mut right, plain(5));
    let mut width = 0;
    let mut frames = Vec::new();
    let mut seen = draw(&mut right, 1000);
    for frame in 0..40 {
        if frame % 8 == 0 {
            // Larger, smaller, and larger again, with frames of the previous size in flight.
            width = [300, 7, 2000, 2, 90][frame as usize / 8];
            load(&mut left, plain(width));
        }
        let drawn = draw(&mut left, frame);
        if frame % 3 == 0 {
            seen = draw(&mut right, 1000 + frame);
        }
        let id = window.submit(&pictures(drawn, seen)).expect("the frame is submitted");
        let last = 1000 + frame / 3 * 3;
        frames.push((id, [frame, width, width, last, 5, 5]));
    }
    for (frame, expected) in frames {
        assert_eq!(row(&mut window, frame), expected);
    }
    // The order of closing does not matter.
    assert_eq!(left.close(), Vec::<String>::new());
    assert_eq!(window.close(), Vec::<String>::new());
    finish(right);
    again_comparing_submissions("pictures::a_third_executor_reads_what_two_others_drew_frame_after_frame");
}

#[test]
fn one_picture_may_be_drawn_often_and_read_seldom_and_read_often_and_drawn_seldom() {
    let mut window = open();
    let mut scene = new_context(&window);
    load(&mut window, compare());
    load(&mut scene, plain(64));
    let mut frames = Vec::new();
    for turn in 0..6 {
        let picture = (0..3).map(|i| draw(&mut scene, 10 * turn + i)).last().expect("three were drawn");
        for _ in 0..3 {
            let id = window.submit(&pictures(picture, picture)).expect("the frame is submitted");
            frames.push((id, 10 * turn + 2));
        }
    }
    for (frame, pixel) in frames {
        assert_eq!(row(&mut window, frame), [pixel, 64, 64, pixel, 64, 64]);
    }
    drop(scene);
    finish(window);
    again_comparing_submissions(
        "pictures::one_picture_may_be_drawn_often_and_read_seldom_and_read_often_and_drawn_seldom",
    );
}

#[test]
fn a_picture_stays_until_another_size_is_shown_and_only_frames_that_are_shown_change_it() {
    let mut window = open();
    let mut scene = new_context(&window);
    load(&mut window, compare());
    load(&mut scene, plain(3));
    frame(&mut scene, &value(1));
    assert_eq!(scene.picture(), None);
    let first = draw(&mut scene, 2);
    assert_eq!((first.format, first.width, first.height), (Format::R32Uint, 3, 1));
    frame(&mut scene, &value(4));
    let error = scene.submit(&FrameInputs { show: true, ..Default::default() });
    assert!(matches!(error, Err(BackendError::Invalid(_))), "{error:?}");
    assert_eq!(scene.picture(), Some(first));
    let seen = frame(&mut window, &pictures(first, first)).output.expect("it was asked for");
    assert_eq!(words(&seen.bytes)[..3], [2, 3, 3]);
    // A plan of equal size reuses the picture. After a plan of another size, the former picture stays until a frame is
    // shown.
    load(&mut scene, plain(3));
    assert_eq!(draw(&mut scene, 5), first);
    load(&mut scene, plain(4));
    assert_eq!(scene.picture(), Some(first));
    let second = draw(&mut scene, 6);
    assert!(second.id != first.id && second.width == 4);
    assert!(window.picture().is_none(), "each executor has its own");
    drop(scene);
    finish(window);
}

#[test]
fn a_picture_that_is_gone_cannot_be_given_and_frames_that_were_given_it_read_it_to_the_end() {
    let mut window = open();
    let mut scene = new_context(&window);
    load(&mut window, compare());
    load(&mut scene, plain(9));
    let refused = |window: &mut Vulkan, picture: Picture| {
        let error = error_of(window.submit(&pictures(picture, picture)));
        assert!(
            error.contains(&format!("host buffer `frame.left` was given the picture {}", picture.id)),
            "{error}"
        );
    };
    let first = draw(&mut scene, 1);
    let pending = window.submit(&pictures(first, first)).expect("the frame is submitted");
    load(&mut scene, plain(2));
    let second = draw(&mut scene, 2);
    refused(&mut window, first);
    let mixed = window.submit(&pictures(second, second)).expect("the frame is submitted");
    drop(scene);
    refused(&mut window, second);
    assert_eq!(row(&mut window, pending), [1, 9, 9, 1, 9, 9]);
    assert_eq!(row(&mut window, mixed), [2, 2, 2, 2, 2, 2]);
    let mut scene = new_context(&window);
    load(&mut scene, plain(2));
    let third = draw(&mut scene, 3);
    refused(&mut window, Picture { width: 3, ..third });
    drop(scene);
    finish(window);
}

#[test]
fn an_executor_may_be_given_its_own_last_picture() {
    let mut build = Build::new();
    let last = build.given("frame.last", 4, 1);
    let image = build.image("row", Format::R32Uint, 2, 1, Usage::STORAGE);
    let shader = build.shader(
        "next.comp",
        "layout(set = 0, binding = 0) readonly buffer Last { uint last[]; };
layout(set = 0, binding = 1, r32ui) writeonly uniform uimage2D row;
void main() {
    uint i = gl_WorkGroupID.x;
    imageStore(row, ivec2(i, 0), uvec4(last[min(i, last.length() - 1)] + 1 + i));
}",
    );
    build.dispatch(Run::Frame, "next", shader, 2, &[(last, 0, READ), (image, 1, WRITE)]);
    let mut vulkan = open_with(build.export(image));
    let given = |last| FrameInputs {
        buffers: [("frame.last".to_string(), last)].into(),
        show: true,
        ..with_output()
    };
    let mut last = BufferContents::Bytes(Arc::new(vec![0; 4]));
    let mut frames = Vec::new();
    for _ in 0..6 {
        frames.push(vulkan.submit(&given(last)).expect("the frame is submitted"));
        last = BufferContents::Picture(vulkan.picture().expect("it is shown"));
    }
    for (index, frame) in (1..).zip(frames) {
        assert_eq!(row(&mut vulkan, frame), [index, 2 * index]);
    }
    finish(vulkan);
    again_comparing_submissions("pictures::an_executor_may_be_given_its_own_last_picture");
}

#[test]
fn executors_have_frames_and_results_of_their_own() {
    let mut first = open();
    let mut second = new_context(&first);
    load(&mut first, plain(1));
    assert!(error_of(second.submit(&value(0))).contains("before a plan was loaded"));
    load(&mut second, plain(2));
    let shown = |pixel| FrameInputs { read_output: true, ..value(pixel) };
    let frames = [first.submit(&shown(1)), second.submit(&shown(2)), first.submit(&shown(3))];
    let [one, two, three] = frames.map(|frame| frame.expect("the frame is submitted"));
    assert_eq!((one, two, three), (FrameId(0), FrameId(0), FrameId(1)));
    assert_eq!(row(&mut second, two), [2, 2]);
    assert_eq!(row(&mut first, three), [3]);
    assert_eq!(row(&mut first, one), [1]);
    assert_eq!(second.info(), first.info());
    // The first executor may be dropped before the others on its device.
    drop(first);
    assert_eq!(output(&frame(&mut second, &shown(4))), [4, 4]);
    finish(second);
}

#[test]
fn a_picture_is_its_executors_memory_until_it_has_another_and_then_of_the_frames_in_flight() {
    const PIXELS: u32 = 4096;
    let mut window = open();
    load(&mut window, compare());
    let mut scene = new_context(&window);
    load(&mut scene, plain(PIXELS));
    let words_ = BufferContents::Bytes(Arc::new(vec![0; 4]));
    let buffers = ["frame.left", "frame.right"].map(|name| (name.to_string(), words_.clone()));
    for _ in 0..2 {
        // Makes both slots allocate their buffers for host bytes.
        frame(&mut window, &FrameInputs { buffers: buffers.clone().into(), ..with_output() });
    }
    let before = total(&window);
    assert_eq!(listed(&scene, "picture"), None);
    let picture = draw(&mut scene, 1);
    let bytes = listed(&scene, "picture").expect("it is shown");
    assert!(bytes >= 4 * PIXELS as u64);
    let pending = window.submit(&pictures(picture, picture)).expect("the frame is submitted");
    assert_eq!(total(&window), before);
    load(&mut scene, plain(1));
    draw(&mut scene, 2);
    assert!(listed(&scene, "picture").is_some_and(|small| small < bytes));
    assert_eq!(listed(&window, "frames in flight"), Some(bytes));
    drop(scene);
    assert_eq!(total(&window), before + bytes);
    assert_eq!(row(&mut window, pending)[0], 1);
    assert_eq!(total(&window), before);
    finish(window);
}

/// Reads a picture of more than 128 MiB, the binding limit of lavapipe and the minimum of every device. It has 2,900 x
/// 2,900 pixels of 16 bytes.
#[test]
fn a_picture_larger_than_a_storage_binding_is_read_by_its_rows() {
    const SIDE: u32 = 2900;
    let mut build = Build::new();
    let image = build.image("large", Format::Rgba32Float, SIDE, SIDE, Usage::STORAGE);
    let shader = build.shader(
        "corner.comp",
        "layout(set = 0, binding = 0, rgba32f) writeonly uniform image2D image;
void main() { imageStore(image, ivec2(7, 2899), vec4(0.25, 0.5, 0.75, 1.0)); }",
    );
    build.dispatch(Run::Frame, "corner", shader, 1, &[(image, 0, WRITE)]);
    let large = build.export(image);

    let mut build = Build::new();
    let rows = build.given("frame.rows", 4, 1);
    build.plan.resources[rows.index()].usage = Usage::STORAGE;
    let found = build.words("found", 5);
    let shader = build.shader(
        "read.comp",
        "layout(set = 0, binding = 0) readonly buffer Rows { uint rows[]; };
layout(set = 0, binding = 1) buffer Found { uint found[]; };
void main() {
    for (uint i = 0; i < 4; i++) found[i] = rows[4 * (3 * 2900 + 7) + i];
    found[4] = rows.length();
}",
    );
    build.dispatch(Run::Frame, "read", shader, 1, &[(rows, 0, READ), (found, 1, BOTH)]);
    let read = show(build, found);

    let mut window = open();
    let mut scene = new_context(&window);
    load(&mut scene, large);
    load(&mut window, read);
    let shown =
        scene.submit(&FrameInputs { show: true, ..Default::default() }).expect("the frame is submitted");
    scene.wait(shown).expect("the frame is done");
    let picture = scene.picture().expect("it was shown");
    let give =
        |contents| FrameInputs { buffers: [("frame.rows".to_string(), contents)].into(), ..with_output() };
    // If the whole picture exceeds the device's binding limit, it is refused, and later frames still work.
    if window.info().facts.max_storage_bytes < 16 * u64::from(SIDE) * u64::from(SIDE) {
        let error = window.submit(&give(BufferContents::Picture(picture)));
        assert!(matches!(error, Err(BackendError::Limit(_))), "{error:?}");
    }
    // A row is 181.25 times the alignment, so every fourth can be the first.
    let last = give(BufferContents::Rows { picture, first: 2896, count: 4 });
    let seen = frame(&mut window, &last).output.expect("it was asked for");
    let floats = [0.25f32, 0.5, 0.75, 1.0].map(f32::to_bits);
    assert_eq!(words(&seen.bytes), [floats.as_slice(), &[4 * 4 * SIDE]].concat());
    let odd = error_of(window.submit(&give(BufferContents::Rows { picture, first: 2899, count: 1 })));
    assert!(odd.contains("multiple of 256"), "{odd}");
    drop(scene);
    finish(window);
}
