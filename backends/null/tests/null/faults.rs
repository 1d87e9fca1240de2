//! Every fault at every call of a script of loads, frames, swaps and resizes.

use crate::common::*;
use crate::testing::plan;
use splatgraph_api::{BackendError, Device, FrameId, FrameInputs, Inspect, Recovery, Windowed};
use splatgraph_framework::ir::PassId;
use splatgraph_null::{Call, Config, Fault, Journal, Null, Point, open};

/// A device in the middle of the script.
struct Script {
    null: Null,
    frames: Vec<FrameId>,
}

impl Script {
    fn load(&mut self, plan: splatgraph_framework::plan::Plan) -> Result<(), BackendError> {
        // Each with a scene of its own, so that each uploads.
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

fn presented() -> FrameInputs {
    FrameInputs { present: true, ..inputs() }
}

fn read_back() -> FrameInputs {
    let inspect = vec![Inspect { resource: crate::testing::WORDS, after: PassId(1) }];
    FrameInputs { read_output: true, inspect, ..inputs() }
}

type Action = fn(&mut Script) -> Result<(), BackendError>;

/// The steps of the script, the last of which shows that the device is as it should be.
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
    |s| s.load(plan()),
    |s| s.submit(presented()),
    Script::wait,
    |s| s.load(histories()),
    |s| {
        s.submit(inputs())?;
        s.wait()
    },
];

/// The outcome of the script.
struct Outcome {
    /// The steps that failed; none for the device's opening.
    errors: Vec<(Option<usize>, BackendError)>,
    /// The commands of the last frame.
    last: Vec<Call>,
    journal: Journal,
}

fn run(faults: &[Fault]) -> Outcome {
    let config = Config { window: Some((64, 32)), faults: faults.to_vec(), ..Config::default() };
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
                    errors.push((Some(index), error));
                } else if index == STEPS.len() - 1 {
                    last = last_frame(&journal.take()).to_vec();
                }
            }
            assert_eq!(script.null.close(), Vec::<String>::new(), "a promise is broken under {faults:?}");
        }
    }
    assert_eq!(journal.alive(), Default::default(), "objects are left under {faults:?}");
    Outcome { errors, last, journal }
}

/// The last frame without the number in its label.
fn unnumbered(last: &[Call]) -> Vec<Call> {
    let number = |call: &Call| matches!(call, Call::PushLabel(name) if name.starts_with("frame "));
    last.iter()
        .filter(|call| !number(call))
        .map(|call| match call {
            // A frame that failed leaves its slot to the next.
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
        Point::AcquireOutOfDate | Point::AcquireTimeout | Point::PresentOutOfDate => None,
        Point::Submit | Point::Execute => Some(Recovery::DeviceEnded),
        Point::Allocate | Point::Create | Point::AcquireGone | Point::PresentGone => Some(Recovery::User),
    };
    let first = outcome.errors.first();
    assert_eq!(first.map(|(_, error)| error.recovery()), expected, "{text}");
    let Some((step, error)) = first else {
        return assert_eq!(unnumbered(&outcome.last), unnumbered(&sound.last), "{text}");
    };
    if expected == Some(Recovery::DeviceEnded) {
        // All calls say the same from then on, but for the results that are there already.
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
    // Without a device, or without its first plan, nothing else can go on; otherwise the fault concerns one step alone.
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
    let (null, journal) = open(&Config {
        // The upload of the plan's plane is the first submission.
        faults: vec![Fault { point: Point::Execute, after: 2 }],
        ..Config::default()
    });
    let mut null = null.expect("it opens");
    load(&mut null, plan());
    let first = submit(&mut null);
    let second = submit(&mut null);
    let error = error_of(null.wait(second));
    let BackendError::DeviceLost(text) = &error else { panic!("{error}") };
    assert!(text.contains("frame 1") && text.contains("complete is `scan[1]`"), "{text}");
    assert!(text.contains("next one is `splat`"), "{text}");
    // Every executor of the device says the same.
    assert_eq!(error_of(null.wait(first)), error);
    assert_eq!(error_of(null.new_context()), error);
    assert_eq!(error_of(null.load(plan(), &Zeros::default(), &mut |_| {})), error);
    finish(null, &journal);
}
