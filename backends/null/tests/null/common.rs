//! Devices, plans and scenes that the tests share.

use crate::testing::{COLOR, WORDS, plan};
use splatgraph_api::{BackendError, Device, FrameId, FrameInputs, FrameResult, SceneData};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_null::{Call, Config, Journal, Null, Object, open};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

pub fn device() -> (Null, Journal) {
    opened(&Config::default())
}

pub fn opened(config: &Config) -> (Null, Journal) {
    let (null, journal) = open(config);
    (null.expect("it opens"), journal)
}

/// Waits until another thread has made a condition true; fails after 60 s.
#[track_caller]
pub fn until(mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < Duration::from_secs(60), "waited in vain");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Closes the device, and checks that there are no messages and no live objects.
pub fn finish(null: Null, journal: &Journal) {
    assert_eq!(null.close(), Vec::<String>::new());
    assert_eq!(journal.alive(), Default::default(), "objects are left");
}

/// A scene of zeros, which counts the requested planes, and records the size of the largest piece.
#[derive(Default)]
pub struct Zeros {
    pub identity: u64,
    pub asked: AtomicUsize,
    pub largest: AtomicUsize,
}

impl Zeros {
    pub fn asked(&self) -> usize {
        self.asked.load(Ordering::Relaxed)
    }
}

impl SceneData for Zeros {
    fn write(&self, _: &str, _: u32, offset: u64, target: &mut [u8]) -> Result<(), String> {
        self.asked.fetch_add(usize::from(offset == 0), Ordering::Relaxed);
        self.largest.fetch_max(target.len(), Ordering::Relaxed);
        target.fill(0);
        Ok(())
    }

    fn identity(&self) -> u64 {
        self.identity
    }
}

/// Returns the plan of the unit tests with histories for the buffer `words` and the image `color`. Its prologue clears
/// both.
pub fn histories() -> Plan {
    let mut plan = plan();
    for id in [WORDS, COLOR] {
        let resource = &mut plan.resources[id.index()];
        resource.history = Some(resource.name.clone());
        resource.usage |= Usage::COPY_TARGET;
    }
    plan.passes[0].name = "start words".to_string();
    plan.passes[0].work = Work::ClearHistory { resource: WORDS };
    let start = Pass {
        name: "start color".to_string(),
        work: Work::ClearHistory { resource: COLOR },
        ..plan.passes[0].clone()
    };
    plan.passes.push(start);
    let start = PassId(plan.passes.len() as u32 - 1);
    plan.prologue.push(start);
    // The draw keeps the image's contents, and the export leaves the image in the layout of a copy source.
    let (draw, export) = (plan.frame[2], plan.frame[3]);
    plan.layout_changes = [
        (start, Layout::Undefined, Layout::TransferTarget, false),
        (draw, Layout::TransferTarget, Layout::TransferSource, true),
        (draw, Layout::TransferSource, Layout::ColorTarget, false),
        (export, Layout::ColorTarget, Layout::TransferSource, false),
    ]
    .map(|(before, old, new, handover)| LayoutChange { image: COLOR, old, new, before, handover })
    .into();
    plan
}

pub fn with_host_buffer() -> Plan {
    let mut plan = plan();
    let splats = &mut plan.resources[crate::testing::SPLATS.index()];
    splats.source = Source::HostBuffer { buffer: "frame.words".to_string() };
    splats.shape = Shape::Buffer { stride: 4, count: 1 };
    plan
}

pub fn inputs() -> FrameInputs {
    FrameInputs { uniforms: [("frame.camera".to_string(), vec![1; 8])].into(), ..Default::default() }
}

/// Returns the inputs of a frame that is shown in the window.
pub fn presented() -> FrameInputs {
    FrameInputs { present: true, ..inputs() }
}

pub fn load(null: &mut Null, plan: Plan) {
    null.load(plan, &Zeros::default(), &mut |_| {}).expect("the plan loads");
}

pub fn submit(null: &mut Null) -> FrameId {
    null.submit(&inputs()).expect("the frame is submitted")
}

pub fn frame(null: &mut Null, inputs: &FrameInputs) -> FrameResult {
    let frame = null.submit(inputs).expect("the frame is submitted");
    null.wait(frame).expect("the frame is done")
}

/// Returns the calls of the last submitted frame, from its `Begin` on.
pub fn last_frame(calls: &[Call]) -> &[Call] {
    let begins = |call: &Call| matches!(call, Call::Begin { encoder } if encoder == "frame");
    let begin = calls.iter().rposition(begins).expect("a frame");
    let submit =
        calls[begin..].iter().position(|call| matches!(call, Call::Submit { .. })).expect("submitted");
    &calls[begin..=begin + submit]
}

pub fn waits(calls: &[Call]) -> usize {
    calls.iter().filter(|call| matches!(call, Call::Wait { blocks: true, .. } | Call::WaitIdle)).count()
}

pub fn destroyed(calls: &[Call], object: Object) -> Vec<&str> {
    let destroyed = |call: &&Call| matches!(call, Call::Destroy { object: kind, .. } if *kind == object);
    calls
        .iter()
        .filter(destroyed)
        .map(|call| match call {
            Call::Destroy { name, .. } => name.as_str(),
            _ => "",
        })
        .collect()
}

pub fn error_of<T>(result: Result<T, BackendError>) -> BackendError {
    match result {
        Ok(_) => panic!("this should have been refused"),
        Err(error) => error,
    }
}
