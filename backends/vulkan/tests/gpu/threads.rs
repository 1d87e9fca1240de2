//! Plans prepared while frames are drawn, and executors of one device on several threads.

use crate::build::*;
use crate::swapping::{grow, growing, growing_with, grown, submit};
use splatgraph_api::{BackendError, Device, FrameInputs, Loader as _, SceneData};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_vulkan::{Loader, Ready, Vulkan};
use std::sync::Barrier as Meeting;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

fn prepare(loader: Loader, plan: Plan) -> Ready {
    loader.prepare(plan, &Scene::default(), &mut |_| {}).expect("the plan is made ready")
}

fn numbers(count: u64) -> Plan {
    let mut build = Build::new();
    let numbers = build.scene("numbers", 0, 4, count);
    show(build, numbers)
}

fn scene(values: &[u32]) -> Scene {
    Scene::new(1, "numbers", 0, values.iter().flat_map(|v| v.to_le_bytes()).collect())
}

/// Runs `work` in `count` threads, each with its index and its own executor, then [finishes](finish) the executors.
fn in_threads(vulkan: &Vulkan, count: u32, work: impl Fn(u32, &mut Vulkan) + Sync) {
    let executors: Vec<Vulkan> = thread::scope(|scope| {
        let start = |index| {
            let (mut own, work) = (new_context(vulkan), &work);
            scope.spawn(move || {
                work(index, &mut own);
                own
            })
        };
        let threads: Vec<_> = (0..count).map(start).collect();
        threads.into_iter().map(|thread| thread.join().expect("it ends well")).collect()
    });
    executors.into_iter().for_each(finish);
}

#[test]
fn a_plan_is_made_ready_on_another_thread_and_goes_on_from_frames_that_were_drawn_meanwhile() {
    let mut vulkan = open_with(growing("slow", 1));
    let loader = vulkan.loader();
    let done = AtomicBool::new(false);
    let mut frames = Vec::new();
    let ready = thread::scope(|scope| {
        let thread = scope.spawn(|| {
            let ready = prepare(loader, growing("fast", 10));
            done.store(true, Ordering::Release);
            ready
        });
        while frames.len() < 3 || !done.load(Ordering::Acquire) {
            frames.push(submit(&mut vulkan));
        }
        thread.join().expect("it ends well")
    });
    let slow = frames.len() as u32;
    // Two frames of the previous plan are in flight.
    vulkan.swap(ready).expect("it becomes the current plan");
    frames.extend([submit(&mut vulkan), submit(&mut vulkan)]);
    let last = frames.split_off(frames.len() - 4);
    let values: Vec<_> = last.into_iter().map(|frame| grown(&mut vulkan, frame)).collect();
    let expected = [("slow", slow - 1), ("slow", slow), ("fast", slow + 10), ("fast", slow + 20)];
    assert_eq!(values, expected.map(|(name, value)| (name.to_string(), value)));
    finish(vulkan);
    again_comparing_submissions(
        "threads::a_plan_is_made_ready_on_another_thread_and_goes_on_from_frames_that_were_drawn_meanwhile",
    );
}

#[test]
fn a_plan_goes_on_from_the_one_that_is_current_when_it_is_swapped_in() {
    let wide = |step| growing_with("wide", step, 3, |_, _, _| {});
    let mut vulkan = open_with(growing("narrow", 1));
    assert_eq!((grow(&mut vulkan), grow(&mut vulkan)), (1, 2));
    // Both are prepared for swapping in after the narrow plan.
    let (first, second) = (prepare(vulkan.loader(), wide(10)), prepare(vulkan.loader(), wide(100)));
    let back = vulkan.loader();
    vulkan.swap(first).expect("it becomes the current plan");
    // The image has another shape and starts anew; the buffer continues.
    let result = frame(&mut vulkan, &with_output());
    assert_eq!((result.stats[0].1, output(&result)), (12, vec![10; 3]));
    submit(&mut vulkan);
    vulkan.swap(second).expect("it becomes the current plan");
    // The buffer and the image continue from the plan in between.
    let result = frame(&mut vulkan, &with_output());
    let pixels = output(&result);
    assert_eq!((result.stats[0].1, pixels), (122, vec![120; 3]));
    // Swaps back with an old loader: that plan's image is gone.
    submit(&mut vulkan);
    vulkan.swap(prepare(back, growing("narrow", 1))).expect("it becomes the current plan");
    let result = frame(&mut vulkan, &with_output());
    let pixels = output(&result);
    assert_eq!((result.stats[0].1, pixels), (223, vec![1; 2]));
    finish(vulkan);
    again_comparing_submissions("threads::a_plan_goes_on_from_the_one_that_is_current_when_it_is_swapped_in");
}

#[test]
fn a_plan_that_was_made_ready_in_vain_leaves_nothing_behind() {
    let bytes = |vulkan: &Vulkan| (vulkan.memory(), vulkan.device_memory().used);
    let mut vulkan = open();
    let data = scene(&[1, 2, 3]);
    load(&mut vulkan, growing("count", 1));
    let pending = [submit(&mut vulkan), submit(&mut vulkan)];
    let before = bytes(&vulkan);
    let loader = vulkan.loader();
    thread::scope(|scope| {
        scope.spawn(|| drop(loader.prepare(numbers(3), &data, &mut |_| {}).expect("it is made ready")));
    });
    let ready = prepare(vulkan.loader(), growing("count", 10));
    // The plan is on the device, but no executor has it yet.
    assert!(vulkan.memory() == before.0 && vulkan.device_memory().used > before.1);
    assert!(vulkan.device_memory().reserved >= vulkan.device_memory().used);
    drop(ready);
    assert_eq!(bytes(&vulkan), before);
    assert_eq!(pending.map(|frame| grown(&mut vulkan, frame).1), [1, 2]);
    assert_eq!(grow(&mut vulkan), 3);
    // The plan's uploads were dropped with it.
    assert_eq!(data.asked(), 1);
    vulkan.load(numbers(3), &data, &mut |_| {}).expect("the plan loads");
    assert_eq!(data.asked(), 2);
    assert_eq!(shown(&mut vulkan), [1, 2, 3]);
    // A prepared plan that outlives all executors keeps the device open.
    let rest = vulkan.loader().prepare(numbers(3), &data, &mut |_| {}).expect("it is made ready");
    assert_eq!(vulkan.close(), Vec::<String>::new());
    drop(rest);
}

#[test]
fn plans_that_are_made_ready_at_the_same_time_upload_what_they_share_once() {
    const THREADS: u32 = 4;
    let values: Vec<u32> = (0..1 << 20).collect();
    let data = scene(&values);
    // The last word of a large plane.
    let plan = {
        let mut build = Build::new();
        let numbers = build.scene("numbers", 0, 4, values.len() as u64);
        let last = build.words("last", 1);
        let shader = build.shader(
            "last.comp",
            "layout(set = 0, binding = 0) readonly buffer Numbers { uint numbers[]; };
layout(set = 0, binding = 1) writeonly buffer Last { uint last; };
void main() { last = numbers[numbers.length() - 1]; }",
        );
        build.dispatch(Run::Frame, "last", shader, 1, &[(numbers, 0, READ), (last, 1, WRITE)]);
        show(build, last)
    };
    let vulkan = open();
    let meeting = Meeting::new(THREADS as usize);
    in_threads(&vulkan, THREADS, |_, own| {
        meeting.wait();
        own.load(plan.clone(), &data, &mut |_| {}).expect("the plan loads");
        for _ in 0..3 {
            assert_eq!(shown(own), [(1 << 20) - 1]);
        }
    });
    assert_eq!(data.asked(), 1);
    finish(vulkan);
}

struct Broken {
    panics: bool,
}

impl SceneData for Broken {
    fn write(&self, _: &str, _: u32, _: u64, _: &mut [u8]) -> Result<(), String> {
        assert!(!self.panics, "the scene breaks on purpose");
        Err("any of it".to_string())
    }

    fn identity(&self) -> u64 {
        1
    }
}

#[test]
fn an_upload_that_fails_does_not_block_others() {
    let mut vulkan = open();
    let loader = vulkan.loader();
    let error = loader.prepare(numbers(2), &Broken { panics: false }, &mut |_| {}).err();
    assert!(matches!(error, Some(BackendError::Scene { .. })), "{error:?}");
    let loader = vulkan.loader();
    let thread =
        thread::spawn(move || loader.prepare(numbers(2), &Broken { panics: true }, &mut |_| {}).map(drop));
    assert!(thread.join().is_err(), "the thread panics");
    // The scene's identity is the same, but nothing of the failed attempts is reused.
    let data = scene(&[8, 9]);
    vulkan.load(numbers(2), &data, &mut |_| {}).expect("the plan loads");
    assert_eq!((data.asked(), shown(&mut vulkan)), (1, vec![8, 9]));
    finish(vulkan);
}

#[test]
fn executors_draw_in_threads_of_their_own_while_plans_are_made_ready_in_others() {
    let vulkan = open();
    in_threads(&vulkan, 2, |index, own| {
        let mut value = 0;
        load(own, growing("count", 1));
        for round in 0..4 {
            let step = 10 * index + round;
            let loader = own.loader();
            let maker = thread::spawn(move || prepare(loader, growing("count", step)));
            let before = if round == 0 { 1 } else { 10 * index + round - 1 };
            let frames: Vec<_> = (0..5).map(|_| submit(own)).collect();
            for frame in frames {
                value += before;
                assert_eq!(grown(own, frame).1, value);
            }
            own.swap(maker.join().expect("it ends well")).expect("it becomes the current plan");
        }
    });
    finish(vulkan);
}

#[test]
fn executors_in_several_threads_take_turns_on_the_queue() {
    // Tiny frames, so that the threads meet at the queue: the validation layer reports concurrent use.
    let vulkan = open();
    let meeting = Meeting::new(4);
    in_threads(&vulkan, 4, |_, own| {
        load(own, growing("count", 1));
        meeting.wait();
        for _ in 0..300 {
            own.submit(&FrameInputs::default()).expect("the frame is submitted");
        }
        assert_eq!(grow(own), 301);
    });
    finish(vulkan);
}

#[test]
fn messages_are_the_devices_and_closing_one_executor_leaves_the_others_open() {
    let first = open();
    let mut second = new_context(&first);
    assert_eq!(first.close(), Vec::<String>::new());
    load(&mut second, growing("count", 1));
    assert_eq!((grow(&mut second), grow(&mut second)), (1, 2));
    second.submit(&FrameInputs::default()).expect("the frame is submitted");
    finish(second);
}

/// A stress test: without the lock, about one run in ten crashes in the loader or in the validation layer.
#[test]
fn devices_are_opened_and_closed_while_objects_of_others_are_named() {
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        let naming = scope.spawn(|| {
            let mut vulkan = open();
            while !done.load(Ordering::Acquire) {
                load(&mut vulkan, growing("named", 1));
            }
        });
        for _ in 0..100 {
            drop(open());
        }
        done.store(true, Ordering::Release);
        naming.join().expect("it ends well");
    });
}
