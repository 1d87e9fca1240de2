//! Injects every fault at every call of a script of loads, frames, swaps and resizes.

use crate::common::*;
use crate::testing::plan;
use splatgraph_api::{BackendError, Device, FrameId, FrameInputs, Inspect, Recovery};
use splatgraph_framework::ir::PassId;
use splatgraph_framework::plan::Plan;
use splatgraph_null::{Call, Config, Fault, Journal, Null, Point, open};
use std::time::Duration;

struct Script {
    null: Null,
    frames: Vec<FrameId>,
}

impl Script {
    fn load(&mut self, plan: Plan) -> Result<(), BackendError> {
        // The identity differs from that of the current plan's scene, so each load uploads.
        let scene = Zeros { identity: self.frames.len() as u64, ..Zeros::default() };
        self.null.load(plan, &scene, &mut |_| {})
    }

    fn submit(&mut self, inputs: FrameInputs) -> Result<(), BackendError> {
        self.frames.push(self.null.submit(&inputs)?);
        Ok(())
    }

    fn wait(&mut self) -> Result<(), BackendError> {
        std::mem::take(&mut self.frames).into_iter().try_for_each(|frame| self.null.wait(frame).map(drop))
    }
}

fn read_back() -> FrameInputs {
    let inspect = vec![Inspect { resource: crate::testing::WORDS, after: PassId(1) }];
    FrameInputs { read_output: true, inspect, ..inputs() }
}

type Action = fn(&mut Script) -> Result<(), BackendError>;

/// The steps of the script. The last one shows that the device still works.
const STEPS: [Action; 14] = [
    |s| s.load(histories()),
    |s| s.submit(presented()),
    |s| s.submit(read_back()),
    |s| s.load(histories()),
    |s| s.submit(presented()),
    |s| {
        s.null.resize_window(80, 40);
        s.submit(presented())
    },
    Script::wait,
    |s| s.submit(FrameInputs { show: true, present: true, ..inputs() }),
    |s| {
        let mut other = s.null.new_context()?;
        other.load(plan(), &Zeros::default(), &mut |_| {})?;
        let frame = other.submit(&inputs())?;
        other.wait(frame).map(drop)
    },
    |s| s.load(crate::once::packing()),
    |s| s.submit(presented()),
    Script::wait,
    |s| s.load(histories()),
    |s| {
        s.submit(inputs())?;
        s.wait()
    },
];

struct Outcome {
    /// Errors, each with the index of the failed step; `None` for opening the device.
    errors: Vec<(Option<usize>, BackendError)>,
    last: Vec<Call>,
    journal: Journal,
}

fn run(faults: &[Fault]) -> Outcome {
    // A sound compiler may be slow on a busy machine, and then must not count as hanging.
    let hangs = faults.iter().any(|fault| fault.point == Point::Compile);
    let config = Config {
        window: Some((64, 32)),
        faults: faults.to_vec(),
        compile_patience: if hangs { Duration::from_millis(200) } else { Duration::from_secs(60) },
        ..Config::default()
    };
    let (null, journal) = open(&config);
    let mut errors = Vec::new();
    let mut last = Vec::new();
    match null {
        Err(error) => errors.push((None, error)),
        Ok(null) => {
            let mut script = Script { null, frames: Vec::new() };
            for (index, step) in STEPS.iter().enumerate() {
                journal.take();
                if let Err(error) = step(&mut script) {
                    // The device or a compiler may hang: resumes it, and continues the script.
                    journal.resume();
                    until_compilers_end();
                    errors.push((Some(index), error));
                } else if index == STEPS.len() - 1 {
                    last = last_frame(&journal.take()).to_vec();
                }
            }
            journal.resume();
            until_compilers_end();
            assert_eq!(script.null.close(), Vec::<String>::new(), "a promise is broken under {faults:?}");
        }
    }
    assert_eq!(journal.alive(), Default::default(), "objects are left under {faults:?}");
    Outcome { errors, last, journal }
}

fn until_compilers_end() {
    until(|| splatgraph_runtime::abandoned_compilers() == 0);
}

/// Returns a frame's calls without its number and slot.
fn unnumbered(last: &[Call]) -> Vec<Call> {
    let number = |call: &Call| matches!(call, Call::PushLabel(name) if name.starts_with("frame "));
    last.iter()
        .filter(|call| !number(call))
        .map(|call| match call {
            // After a failed frame, the next frame uses the same slot.
            Call::BindPass { pass, .. } => Call::BindPass { pass: pass.clone(), slot: 0 },
            other => other.clone(),
        })
        .collect()
}

#[test]
fn every_fault_at_every_call_is_told_leaves_the_device_in_order_and_leaks_nothing() {
    let sound = run(&[]);
    assert_eq!(sound.errors, []);
    let mut runs = 0;
    for point in Point::ALL {
        let reached = sound.journal.reached(point);
        assert!(reached > 0, "the script never reaches {point:?}");
        for after in 0..reached {
            let fault = Fault { point, after };
            check(fault, &run(&[fault]), &sound);
            runs += 1;
        }
    }
    assert!(runs > 150, "{runs} runs");
}

fn check(fault: Fault, outcome: &Outcome, sound: &Outcome) {
    let text = format!("{fault:?}: {:?}", outcome.errors);
    let expected = match fault.point {
        Point::AcquireOutOfDate
        | Point::AcquireTimeout
        | Point::AcquireSuboptimal
        | Point::AcquireLost
        | Point::PresentOutOfDate
        | Point::PresentSuboptimal
        | Point::PresentLost
        | Point::LateSubmit => None,
        // A lost surface is recreated, except while the device is being opened, which queries it twice.
        Point::Surface if fault.after > 1 => None,
        Point::Submit | Point::Execute | Point::Present => Some(Recovery::DeviceEnded),
        Point::Hang | Point::Compile => Some(Recovery::Retry),
        Point::Allocate | Point::Create | Point::Wait | Point::Surface => Some(Recovery::User),
    };
    let first = outcome.errors.first();
    // A hang in a frame that nobody waits for is not noticed.
    let expected = expected.filter(|expected| first.is_some() || *expected != Recovery::Retry);
    assert_eq!(first.map(|(_, error)| error.recovery()), expected, "{text}");
    let Some((step, error)) = first else {
        return assert_eq!(unnumbered(&outcome.last), unnumbered(&sound.last), "{text}");
    };
    if expected == Some(Recovery::DeviceEnded) {
        // After a loss, all calls return the same error, except for results that are already available.
        let lost = outcome.errors.iter().all(|(_, other)| other == error);
        assert!(
            lost && outcome.errors.last().map(|(step, _)| *step) == Some(Some(STEPS.len() - 1)),
            "{text}"
        );
        return;
    }
    if let BackendError::OutOfMemory { name, bytes, .. } = error {
        assert!(!name.is_empty() && (fault.point != Point::Allocate || *bytes > 0), "{text}");
    }
    // Without a device or its first plan, nothing else works; any other fault affects only one step.
    match step {
        None => assert_eq!(outcome.errors.len(), 1, "{text}"),
        Some(0) => {
            let consequences = outcome.errors[1..].iter().all(|(_, e)| matches!(e, BackendError::Invalid(_)));
            assert!(consequences, "{text}");
        }
        Some(_) => assert_eq!(outcome.errors.len(), 1, "{text}"),
    }
    if matches!(step, Some(step) if *step < STEPS.len() - 2) {
        assert_eq!(unnumbered(&outcome.last), unnumbered(&sound.last), "{text}");
    }
}

#[test]
fn a_device_that_is_lost_in_a_frame_names_the_pass_that_was_done_last() {
    let (mut null, journal) = opened(&Config {
        // Uploads come first, in the order of submission.
        faults: vec![Fault { point: Point::Execute, after: 2 }],
        ..Config::default()
    });
    load(&mut null, plan());
    let first = submit(&mut null);
    let second = submit(&mut null);
    let error = error_of(null.wait(second));
    let BackendError::DeviceLost(text) = &error else { panic!("{error}") };
    assert!(text.contains("frame 1") && text.contains("complete is `scan[1]`"), "{text}");
    assert!(text.contains("next one is `splat`"), "{text}");
    assert_eq!(error_of(null.wait(first)), error);
    assert_eq!(error_of(null.new_context()), error);
    assert_eq!(error_of(null.load(plan(), &Zeros::default(), &mut |_| {})), error);
    finish(null, &journal);
}

/// Opens a device that hangs in submission number `after`; uploads count.
fn hanging(after: u64) -> (Null, Journal) {
    let faults = vec![Fault { point: Point::Hang, after }];
    let (mut null, journal) = opened(&Config { faults, ..Config::default() });
    load(&mut null, plan());
    (null, journal)
}

#[test]
fn a_wait_for_a_pass_that_does_not_end_is_given_up_and_names_the_pass() {
    let (mut null, journal) = hanging(2);
    let first = submit(&mut null);
    let second = submit(&mut null);
    null.wait(first).expect("the first frame is done");
    assert_eq!(null.running().expect("the second runs").place, "pass `splat` of `test`");
    let BackendError::Stuck { place, .. } = error_of(null.wait(second)) else { panic!("not stuck") };
    assert_eq!(place, "pass `splat` of `test`");
    // The frame is still in flight, and keeps its objects alive.
    assert_eq!(null.try_wait(second).expect("no error").map(drop), None);
    journal.take();
    load(&mut null, plan());
    assert_eq!(destroyed(&journal.take(), splatgraph_null::Object::Pipelines), Vec::<&str>::new());
    journal.resume();
    let result = null.try_wait(second).expect("no error").expect("it is done now");
    assert_eq!(result.pass_ms.len(), 4);
    assert_eq!(null.running(), None);
    finish(null, &journal);
}

#[test]
fn nothing_is_submitted_while_the_device_does_not_come_on_and_frames_go_on_after_it() {
    let (mut null, journal) = hanging(1);
    let frames = [submit(&mut null), submit(&mut null)];
    assert_eq!(null.is_ready(), Ok(false));
    journal.take();
    let error = error_of(null.submit(&inputs()));
    assert!(matches!(error, BackendError::Stuck { .. }), "{error}");
    assert!(!journal.take().iter().any(|call| matches!(call, Call::Submit { .. })));
    journal.resume();
    assert_eq!(null.is_ready(), Ok(true));
    let third = submit(&mut null);
    for frame in frames.into_iter().chain([third]) {
        null.wait(frame).expect("it is done");
    }
    finish(null, &journal);
}

#[test]
fn an_executor_that_waits_for_another_names_the_pass_of_the_other() {
    let (mut first, journal) = hanging(2);
    let mut second = first.new_context().expect("there can be another");
    let mut other = plan();
    other.name = "other".to_string();
    load(&mut second, other);
    let done = submit(&mut second);
    let stuck = submit(&mut first);
    let behind = submit(&mut second);
    second.wait(done).expect("it is done");
    let error = error_of(second.wait(behind));
    assert!(error.to_string().starts_with("pass `scan[1]` of `test` has been running"), "{error}");
    journal.resume();
    first.wait(stuck).expect("it is done");
    second.wait(behind).expect("it is done");
    drop(second);
    finish(first, &journal);
}

#[test]
fn two_executors_that_look_at_different_frames_each_count_the_time_of_their_own() {
    let (mut first, journal) = hanging(2);
    let mut second = first.new_context().expect("there can be another");
    load(&mut second, Plan { name: "other".to_string(), ..plan() });
    let done = submit(&mut second);
    // Without timestamps, only a wait for the frame itself can tell that it runs.
    let hidden = first.submit(&FrameInputs { untimed_passes: true, ..inputs() }).expect("it is submitted");
    let behind = submit(&mut second);
    second.wait(done).expect("it is done");
    std::thread::scope(|scope| {
        let wait = scope.spawn(|| error_of(first.wait(hidden)));
        until(|| {
            assert_eq!(second.running().expect("it waits").place, "pass `scan[0]` of `other`");
            wait.is_finished()
        });
        let error = wait.join().expect("no panic").to_string();
        assert!(error.starts_with("a frame of `test` has been running"), "{error}");
    });
    let running = second.running().expect("it waits");
    assert!(running.time >= Config::default().patience, "{:?}", running.time);
    journal.resume();
    first.wait(hidden).expect("it is done");
    second.wait(behind).expect("it is done");
    drop(second);
    finish(first, &journal);
}

#[test]
fn a_frame_behind_one_whose_submission_returns_late_names_the_pass_of_that_one() {
    let (mut first, journal) = opened(&Config {
        // Uploads come first, in the order of submission.
        faults: [Point::LateSubmit, Point::Hang].map(|point| Fault { point, after: 1 }).to_vec(),
        ..Config::default()
    });
    load(&mut first, plan());
    let mut second = first.new_context().expect("there can be another");
    load(&mut second, Plan { name: "other".to_string(), ..plan() });
    journal.take();
    let (first, stuck) = std::thread::scope(|scope| {
        let late = scope.spawn(|| {
            let frame = submit(&mut first);
            (first, frame)
        });
        while !journal.take().iter().any(|call| matches!(call, Call::Submit { .. })) {
            std::thread::yield_now();
        }
        let behind = submit(&mut second);
        let error = error_of(second.wait(behind));
        assert!(error.to_string().starts_with("pass `scan[1]` of `test` has been running"), "{error}");
        late.join().expect("no panic")
    });
    journal.resume();
    let mut first = first;
    first.wait(stuck).expect("it is done");
    drop(second);
    finish(first, &journal);
}

#[test]
fn an_upload_that_cannot_be_waited_for_keeps_the_memory_that_the_device_may_use() {
    let faults = (0..2).map(|after| Fault { point: Point::Wait, after }).collect();
    let (mut null, journal) = opened(&Config { faults, ..Config::default() });
    let error = error_of(null.load(plan(), &Zeros::default(), &mut |_| {}));
    assert!(matches!(error, BackendError::OutOfMemory { .. }), "{error}");
    load(&mut null, plan());
    frame(&mut null, &inputs());
    finish(null, &journal);
}

#[test]
fn an_upload_that_does_not_end_is_given_up_and_frees_its_memory_when_it_has_ended() {
    let (mut null, journal) =
        opened(&Config { faults: vec![Fault { point: Point::Hang, after: 0 }], ..Config::default() });
    let error = error_of(null.load(plan(), &Zeros::default(), &mut |_| {}));
    assert!(error.to_string().starts_with("the upload of the scene has been running"), "{error}");
    journal.resume();
    load(&mut null, plan());
    frame(&mut null, &inputs());
    finish(null, &journal);
}

#[test]
fn closing_a_device_that_hangs_ends_and_frees_nothing_that_it_uses() {
    let (mut null, journal) = hanging(1);
    submit(&mut null);
    assert_eq!(null.close(), Vec::<String>::new());
    assert!(journal.alive().contains_key(&splatgraph_null::Object::Device));
}
