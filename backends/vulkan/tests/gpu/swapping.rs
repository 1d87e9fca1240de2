//! Swapping plans: frames in flight of the previous plan, and histories that carry over.

use crate::build::*;
use splatgraph_api::{Device, FrameId, FrameInputs, Inspect, Loader, Progress};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_vulkan::Vulkan;

/// Returns a plan that adds `step` every frame to a buffer's first word and to every pixel of an image.
///
/// Both have a history. The image is `width` pixels wide and is the output; the statistic `name` is the word. `alter`
/// changes the plan before it is finished.
fn growing_with(
    name: &str,
    step: u32,
    width: u32,
    alter: impl FnOnce(&mut Build, ResourceId, ResourceId),
) -> Plan {
    let mut build = Build::new();
    let count = build.words("count", 4);
    let trail = build.image("trail", Format::R32Uint, width, 1, Usage::STORAGE);
    build.history(count);
    build.history(trail);
    let shader = build.shader(
        "grow.comp",
        &format!(
            "layout(set = 0, binding = 0) buffer Count {{ uint count; }};
layout(set = 0, binding = 1, r32ui) uniform uimage2D trail;
void main() {{
    ivec2 at = ivec2(gl_WorkGroupID.x, 0);
    imageStore(trail, at, imageLoad(trail, at) + {step});
    if (at.x == 0) count += {step};
}}"
        ),
    );
    build.dispatch(Run::Frame, "grow", shader, width, &[(count, 0, BOTH), (trail, 1, BOTH)]);
    build.stat(name, count, 0);
    alter(&mut build, count, trail);
    build.export(trail)
}

pub fn growing(name: &str, step: u32) -> Plan {
    growing_with(name, step, 2, |_, _, _| {})
}

pub fn submit(vulkan: &mut Vulkan) -> FrameId {
    vulkan.submit(&with_output()).expect("the frame is submitted")
}

/// Returns the name and value of the statistic, after checking that every pixel has this value.
pub fn grown(vulkan: &mut Vulkan, frame: FrameId) -> (String, u32) {
    let result = vulkan.wait(frame).expect("the frame is done");
    let pixels = output(&result);
    let [(name, value)] = result.stats.try_into().expect("one statistic");
    assert!(pixels.iter().all(|&pixel| pixel == value), "{name} is {value}, and the image {pixels:?}");
    (name, value)
}

pub fn grow(vulkan: &mut Vulkan) -> u32 {
    let frame = submit(vulkan);
    grown(vulkan, frame).1
}

#[test]
fn a_plan_takes_over_equal_pipelines_of_the_plan_before_or_compiled_ahead_and_keeps_them_when_these_are_gone()
{
    let mut vulkan = open();
    let created = |vulkan: &mut Vulkan, plan| {
        let mut names = Vec::new();
        vulkan
            .load(plan, &Scene::default(), &mut |progress| {
                if let Progress::Pipeline { shader, .. } = progress {
                    names.push(shader.to_owned());
                }
            })
            .expect("the plan loads");
        (names, grow(vulkan))
    };
    assert_eq!(created(&mut vulkan, growing("first", 1)), (vec!["grow.comp".to_owned()], 1));
    // Nothing holds the first plan any more when the third is loaded.
    assert_eq!(created(&mut vulkan, growing("second", 1)), (vec![], 2));
    assert_eq!(created(&mut vulkan, growing("third", 1)), (vec![], 3));
    assert_eq!(created(&mut vulkan, growing("fast", 10)), (vec!["grow.comp".to_owned()], 13));
    assert_eq!(created(&mut vulkan, growing("again", 1)), (vec!["grow.comp".to_owned()], 14));
    let ahead = vulkan.loader().compile(growing("ahead", 100)).expect("the pipelines");
    assert_eq!(created(&mut vulkan, growing("later", 100)), (vec![], 114));
    drop(ahead);
    assert_eq!(created(&mut vulkan, growing("the same", 100)), (vec![], 214));
    finish(vulkan);
}

#[test]
fn a_plan_sees_its_history_however_the_one_before_wrote_it() {
    let plan = |finish: fn(&mut Build, ResourceId)| {
        let mut build = Build::new();
        let count = build.words("count", 4);
        build.history(count);
        finish(&mut build, count);
        let output = build.image("output", Format::R32Uint, 1, 1, Usage::STORAGE);
        build.export(output)
    };
    // The first plan ends with a dispatch that writes the words...
    let adds = plan(|build, count| {
        let shader = build.shader("add.comp", &add(7));
        build.dispatch(Run::Frame, "add", shader, 1, &[(count, 0, BOTH)]);
    });
    // ... and the second, which copies them, waits only for its own history's start.
    let shows = plan(|build, count| build.stat("count", count, 0));
    let mut barriers = barriers_everywhere(&shows);
    let fill = (Stages::CLEAR, Accesses::TRANSFER_WRITE);
    barriers.handover.insert(0, barrier(fill, (Stages::COPY, Accesses::TRANSFER_READ)));
    barriers.at_mut(Some(shows.frame[0])).retain(|barrier| barrier.image.is_some());
    let mut vulkan = open_with(adds);
    vulkan.submit(&FrameInputs::default()).unwrap();
    load_with(&mut vulkan, shows, barriers);
    assert_eq!(frame(&mut vulkan, &FrameInputs::default()).stats, [("count".to_string(), 7)]);
    finish(vulkan);
    again_comparing_submissions("swapping::a_plan_sees_its_history_however_the_one_before_wrote_it");
}

#[test]
fn barriers_before_a_start_that_is_left_out_still_stand_for_the_passes_behind_it() {
    let copy = "layout(set = 0, binding = 0) readonly buffer Source { uint source; };
layout(set = 0, binding = 1) writeonly buffer Target { uint target; };
void main() { target = source; }";
    let mut constants = [ResourceId(0); 2];
    let plan = growing_with("count", 1, 2, |build, _, _| {
        constants = [build.words("source", 1), build.words("target", 1)];
        build.fill(Run::Once, "fill", constants[0], 3);
        let last = build.words("last", 1);
        build.history(last);
        let shader = build.shader("copy.comp", copy);
        let binds = [(constants[0], 0, READ), (constants[1], 1, WRITE)];
        build.dispatch(Run::Once, "copy", shader, 1, &binds);
        build.stat("target", constants[1], 0);
    });
    // Moves the copy's barrier to the history's start, before it.
    let [.., start, copy] = plan.prologue[..] else { panic!("a start and a copy") };
    let mut barriers = barriers_everywhere(&plan);
    let fill = (Stages::CLEAR, Accesses::TRANSFER_WRITE);
    *barriers.at_mut(Some(start)) = vec![barrier(fill, (Stages::COMPUTE, Accesses::STORAGE_READ))];
    barriers.at_mut(Some(copy)).clear();
    let inspect = vec![Inspect { resource: constants[1], after: copy }];
    let mut vulkan = open();
    for _ in 0..2 {
        load_with(&mut vulkan, plan.clone(), barriers.clone());
        let result = frame(&mut vulkan, &FrameInputs { inspect: inspect.clone(), ..Default::default() });
        assert_eq!(words(&result.inspected[0]), [3]);
    }
    finish(vulkan);
}

#[test]
fn a_start_leaves_zeros_whatever_was_there() {
    // The prologue writes both before their histories start.
    let mut build = Build::new();
    let count = build.words("count", 1);
    let trail = build.image("trail", Format::R32Uint, 1, 1, Usage::STORAGE);
    build.fill(Run::Once, "fill", count, 7);
    let set = build.shader("set.comp", &image_shader("uvec4(7)"));
    build.dispatch(Run::Once, "set", set, 1, &[(trail, 0, WRITE)]);
    build.history(count);
    build.history(trail);
    let keep = build.shader("keep.comp", &image_shader("imageLoad(image, ivec2(0))"));
    build.dispatch(Run::Frame, "keep", keep, 1, &[(trail, 0, BOTH)]);
    build.stat("count", count, 0);
    let mut vulkan = open_with(build.export(trail));
    assert_eq!(grow(&mut vulkan), 0);
    finish(vulkan);
}

#[test]
fn a_plan_is_kept_until_its_frames_in_flight_are_done() {
    let rest = |vulkan: &Vulkan| {
        let memory = vulkan.memory();
        memory.iter().find(|(name, _)| name == "frames in flight").map(|(_, bytes)| *bytes)
    };
    let large = |name: &str| {
        growing_with(name, 1, 2, |build, _, _| {
            let large = build.words("large", 1 << 18);
            build.fill(Run::Frame, "fill", large, 1);
        })
    };
    let mut vulkan = open_with(large("first"));
    let first = submit(&mut vulkan);
    assert_eq!(rest(&vulkan), None);
    load(&mut vulkan, large("second"));
    let second = submit(&mut vulkan);
    load(&mut vulkan, large("third"));
    // The large buffers of both former plans; resources common to all three plans belong to the third.
    let held = rest(&vulkan).expect("two plans are in flight");
    assert!((2 << 20..(2 << 20) + 4096).contains(&held), "{held}");
    assert_eq!(grown(&mut vulkan, second), ("second".to_string(), 2));
    assert!(rest(&vulkan).is_some_and(|held| held < 2 << 20));
    assert_eq!(grown(&mut vulkan, first), ("first".to_string(), 1));
    assert_eq!(rest(&vulkan), None);
    assert_eq!(grow(&mut vulkan), 3);
    finish(vulkan);
}
