//! Plans prepared while frames are drawn, and executors of one device on several threads.

use crate::build::*;
use crate::swapping::{grow, growing, grown, submit};
use splatgraph_api::{Device, FrameInputs, Loader as _};
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::{Loader, Options, Ready, Vulkan};
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

/// Stress-tests the lock on the loader's list of devices for deadlocks.
///
/// It hardly detects a missing lock: the loader's own race is rare, and none of 50 runs without the lock crashed.
///
/// Validation is off: the layer (1.3.239) looks up the device of every call in a map without a lock, and opening a
/// device changes the map. With validation, one run in thirty crashed, in this test or in one beside it.
#[test]
fn devices_are_opened_and_closed_while_objects_of_others_are_named() {
    let open = || Vulkan::open(&Options::default()).expect("these tests need a Vulkan 1.3 driver");
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
