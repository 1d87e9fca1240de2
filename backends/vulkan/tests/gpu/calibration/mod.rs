//! Calibrates the validation layer: which missing synchronization it reports, on plans with one mistake each. Without
//! this, "no message" would mean nothing.
//!
//! The tests record the behaviour of Khronos validation 1.3.239 with synchronization validation. A test that fails
//! after an update of the layer shows that the layer now reports more (or less). Each case first runs without its
//! mistake, and must then give no message.
//!
//! In short, the layer does not report: write-after-write hazards between shaders; the writing half of atomics (a
//! binding counts as a write if the shader stores to it, else as a read, and never as both); colour attachment
//! accesses, and their layout; hazards between submissions, unless requested; the host.

mod buffers;
mod frames;
mod images;

use crate::build::*;
use splatgraph_api::{Device, FrameInputs};
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_vulkan::sync::{Barrier, Barriers};

type Side = (Stages, Accesses);

const COMPUTE_READS: Side = (Stages::COMPUTE, Accesses::STORAGE_READ);
const COMPUTE_WRITES: Side = (Stages::COMPUTE, Accesses::STORAGE_WRITE);
const COMPUTE_DOES_BOTH: Side = (Stages::COMPUTE, BOTH);
const FILLS: Side = (Stages::CLEAR, Accesses::TRANSFER_WRITE);

const RAW: &str = "SYNC-HAZARD-READ-AFTER-WRITE";
const WAR: &str = "SYNC-HAZARD-WRITE-AFTER-READ";
const WAW: &str = "SYNC-HAZARD-WRITE-AFTER-WRITE";

/// A correct plan, and how to run it.
#[derive(Clone)]
struct Case {
    plan: Plan,
    barriers: Barriers,
    /// Number of frames submitted before the first is waited for.
    frames: usize,
    read_output: bool,
}

/// Finishes a plan with an output that no other pass uses.
fn case(mut build: Build) -> Case {
    let output = build.image("output", Format::R32Uint, 1, 1, Usage::STORAGE);
    Case::of(build.export(output))
}

impl Case {
    fn of(plan: Plan) -> Case {
        Case { barriers: barriers_everywhere(&plan), plan, frames: 1, read_output: false }
    }

    fn at(&self, pass: &str) -> Option<PassId> {
        let index = self.plan.passes.iter().position(|p| p.name == pass).expect("a pass");
        Some(PassId(index as u32))
    }

    fn before(&mut self, pass: &str) -> &mut Vec<Barrier> {
        self.barriers.at_mut(self.at(pass))
    }

    /// Replaces the memory barriers before a pass by one with these sides; image barriers stay.
    fn between(mut self, pass: &str, source: Side, target: Side) -> Case {
        let call = self.before(pass);
        call.retain(|b| b.image.is_some());
        call.insert(0, barrier(source, target));
        self
    }

    /// Removes the memory barriers before a pass, and gives its image barriers this source and target scope.
    fn at_change(mut self, pass: &str, source: Side, target: Side) -> Case {
        let call = self.before(pass);
        call.retain(|b| b.image.is_some());
        for change in call {
            *change = Barrier { image: change.image, ..barrier(source, target) };
        }
        self
    }

    /// Checks that the layer reports the mistake with a message that contains `expected`.
    fn caught(&self, mistake: impl FnOnce(&mut Case), expected: &str) {
        let said = self.said(mistake);
        assert!(said.iter().any(|text| text.contains(expected)), "expected {expected} in {said:#?}");
    }

    fn not_seen(&self, mistake: impl FnOnce(&mut Case)) {
        assert_eq!(self.said(mistake), Vec::<String>::new(), "the layer sees what it did not see before");
    }

    /// Returns the layer's messages about the plan with a mistake. Without the mistake, there must be none.
    fn said(&self, mistake: impl FnOnce(&mut Case)) -> Vec<String> {
        assert_eq!(self.messages(), Vec::<String>::new(), "the plan without the mistake");
        let mut wrong = self.clone();
        mistake(&mut wrong);
        assert_ne!(wrong.barriers, self.barriers, "there is no mistake");
        wrong.messages()
    }

    fn messages(&self) -> Vec<String> {
        let inputs = FrameInputs { read_output: self.read_output, ..Default::default() };
        let mut vulkan = open();
        load_with(&mut vulkan, self.plan.clone(), self.barriers.clone());
        let frames: Vec<_> = (0..self.frames).map(|_| vulkan.submit(&inputs).unwrap()).collect();
        for frame in frames {
            vulkan.wait(frame).unwrap();
        }
        vulkan.close()
    }
}

/// A function that adds a pass with this name, which accesses a resource.
type Action = fn(&mut Build, &str, ResourceId);

/// Returns a case with two successive passes on one buffer.
fn two(first: Action, second: Action) -> Case {
    let mut build = Build::new();
    let words = build.words("words", 4);
    first(&mut build, "first", words);
    second(&mut build, "second", words);
    case(build)
}

fn fills(build: &mut Build, name: &str, buffer: ResourceId) {
    build.fill(Run::Frame, name, buffer, 1);
}

fn removed(pass: &'static str) -> impl FnOnce(&mut Case) {
    move |case| case.before(pass).clear()
}

/// Returns a mistake that clears bits in the barriers before a pass: stages and accesses of the source and the target.
fn cleared(pass: &'static str, source: Side, target: Side) -> impl FnOnce(&mut Case) {
    move |case| {
        for barrier in case.before(pass) {
            barrier.masks.source_stages -= source.0;
            barrier.masks.source_accesses -= source.1;
            barrier.masks.target_stages -= target.0;
            barrier.masks.target_accesses -= target.1;
        }
    }
}

const NOTHING: Side = (Stages::empty(), Accesses::empty());

fn access(accesses: Accesses) -> Side {
    (Stages::empty(), accesses)
}

fn stage(stages: Stages) -> Side {
    (stages, Accesses::empty())
}

impl Build {
    /// Adds a dispatch that reads all of a buffer and writes a buffer of its own.
    fn reads(&mut self, name: &str, buffer: ResourceId) {
        let sink = self.words(&format!("sink of {name}"), 4);
        let shader = self.shader(
            "reads.comp",
            "layout(set = 0, binding = 0) readonly buffer Source { uint source[]; };
layout(set = 0, binding = 1) writeonly buffer Sink { uint sink[]; };
void main() { uint i = gl_WorkGroupID.x; sink[i] = source[i]; }",
        );
        self.dispatch(Run::Frame, name, shader, 4, &[(buffer, 0, READ), (sink, 1, WRITE)]);
    }

    fn writes(&mut self, name: &str, buffer: ResourceId) {
        let shader = self.shader(
            "writes.comp",
            "layout(set = 0, binding = 0) writeonly buffer Words { uint words[]; };
void main() { words[gl_WorkGroupID.x] = gl_WorkGroupID.x; }",
        );
        self.dispatch(Run::Frame, name, shader, 4, &[(buffer, 0, WRITE)]);
    }

    fn changes(&mut self, name: &str, buffer: ResourceId) {
        let shader = self.shader("add.comp", &add(1));
        self.dispatch(Run::Frame, name, shader, 4, &[(buffer, 0, BOTH)]);
    }

    /// Adds a dispatch that increments the first word of a buffer atomically.
    fn counts(&mut self, name: &str, buffer: ResourceId) {
        let shader = self.shader(
            "counts.comp",
            "layout(set = 0, binding = 0) buffer Count { uint count; };
void main() { atomicAdd(count, 1); }",
        );
        self.dispatch(Run::Frame, name, shader, 4, &[(buffer, 0, BOTH)]);
    }
}
