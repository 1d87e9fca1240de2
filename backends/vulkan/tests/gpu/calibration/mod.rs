//! Missing synchronization that the validation layer does and does not report, tried on plans with one mistake each:
//! without this, "no message" would mean nothing.
//!
//! Every test writes down what is, for Khronos validation 1.3.239 with synchronization validation: a test that fails after
//! an update of the layer says that the layer sees more (or less) than it did. Each case is first run without its mistake,
//! and must then be silent.
//!
//! Not reported, in short: writes of shaders after writes of shaders; the writing half of atomics (a binding
//! counts as a write if the shader stores to it, else as a read, and never as both); all that colour attachments do, and
//! the layout that they are in; what one submission does to the next, unless it is asked to look; the host. The files:
//!
//! - [`buffers`]: dispatches, fills and indirect arguments that share a buffer, or the memory under two;
//! - [`images`]: layouts, storage images and colour attachments;
//! - [`frames`]: from one frame to the next, and to the host.

mod buffers;
mod frames;
mod images;

use crate::build::*;
use splatgraph_api::{Device, FrameInputs};
use splatgraph_framework::{ir::*, plan::*};

/// Stages and accesses, one side of a barrier.
type Side = (Stages, Accesses);

const COMPUTE_READS: Side = (Stages::COMPUTE, Accesses::STORAGE_READ);
const COMPUTE_WRITES: Side = (Stages::COMPUTE, Accesses::STORAGE_WRITE);
const COMPUTE_DOES_BOTH: Side = (Stages::COMPUTE, BOTH);
const FILLS: Side = (Stages::CLEAR, Accesses::TRANSFER_WRITE);

/// The layer's message about a hazard.
const RAW: &str = "SYNC-HAZARD-READ-AFTER-WRITE";
const WAR: &str = "SYNC-HAZARD-WRITE-AFTER-READ";
const WAW: &str = "SYNC-HAZARD-WRITE-AFTER-WRITE";

/// A sound plan, and how it is run.
struct Case {
    plan: Plan,
    /// Frames that are submitted before the first is waited for.
    frames: usize,
    read_output: bool,
}

/// Ends a plan with an output that has nothing to do with the rest.
fn case(mut build: Build) -> Case {
    let output = build.image("output", Format::R32Uint, 1, 1, Usage::STORAGE);
    Case { plan: build.export(output), frames: 1, read_output: false }
}

impl Case {
    /// Replaces the barrier on all memory before a pass by this one.
    fn between(mut self, pass: &str, source: Side, target: Side) -> Case {
        let step = step(&mut self.plan, pass);
        step.barriers.retain(|b| b.image.is_some());
        step.barriers.insert(0, barrier(source, target));
        self
    }

    /// Leaves before a pass only the changes of layouts, with these sides.
    fn at_change(mut self, pass: &str, source: Side, target: Side) -> Case {
        let step = step(&mut self.plan, pass);
        step.barriers.retain(|b| b.image.is_some());
        for change in &mut step.barriers {
            *change = Barrier { image: change.image, ..barrier(source, target) };
        }
        self
    }

    /// The mistake is a message that contains this.
    fn caught(&self, mistake: impl FnOnce(&mut Plan), expected: &str) {
        let said = self.said(mistake);
        assert!(said.iter().any(|text| text.contains(expected)), "expected {expected} in {said:#?}");
    }

    /// The layer says nothing about the mistake.
    fn not_seen(&self, mistake: impl FnOnce(&mut Plan)) {
        assert_eq!(self.said(mistake), Vec::<String>::new(), "the layer sees what it did not see before");
    }

    /// Returns the layer's messages about the plan with a mistake. Without the mistake there must be none.
    fn said(&self, mistake: impl FnOnce(&mut Plan)) -> Vec<String> {
        let sound = self.messages(&self.plan);
        assert_eq!(sound, Vec::<String>::new(), "the plan without the mistake");
        let mut plan = self.plan.clone();
        mistake(&mut plan);
        assert_ne!(plan, self.plan, "there is no mistake");
        self.messages(&plan)
    }

    /// Returns the layer's messages while frames of a plan are submitted, one after another, and completed.
    fn messages(&self, plan: &Plan) -> Vec<String> {
        let inputs = FrameInputs { read_output: self.read_output, ..Default::default() };
        let mut vulkan = open();
        load(&mut vulkan, plan.clone());
        let frames: Vec<_> = (0..self.frames).map(|_| vulkan.submit(&inputs).unwrap()).collect();
        for frame in frames {
            vulkan.wait(frame).unwrap();
        }
        vulkan.close()
    }
}

/// The frame's step that runs the pass of this name.
fn step<'a>(plan: &'a mut Plan, pass: &str) -> &'a mut Step {
    let index = plan.passes.iter().position(|p| p.name == pass).expect("a pass");
    let step = plan.frame.iter_mut().find(|step| step.pass == PassId(index as u32));
    step.expect("a step of the frame")
}

/// Takes out all barriers before a pass.
fn removed(pass: &'static str) -> impl FnOnce(&mut Plan) {
    move |plan| step(plan, pass).barriers.clear()
}

/// Clears bits of the barriers before a pass: of the source's stages and accesses, and of the target's.
fn cleared(pass: &'static str, source: Side, target: Side) -> impl FnOnce(&mut Plan) {
    move |plan| {
        for barrier in &mut step(plan, pass).barriers {
            barrier.source_stages -= source.0;
            barrier.source_accesses -= source.1;
            barrier.target_stages -= target.0;
            barrier.target_accesses -= target.1;
        }
    }
}

const NOTHING: Side = (Stages::empty(), Accesses::empty());

/// These accesses and no stage.
fn access(accesses: Accesses) -> Side {
    (Stages::empty(), accesses)
}

/// This stage and no access.
fn stage(stages: Stages) -> Side {
    (stages, Accesses::empty())
}

impl Build {
    /// A dispatch that reads all of a buffer, and writes to one of its own.
    fn reads(&mut self, name: &str, buffer: ResourceId) {
        let sink = self.words(&format!("sink of {name}"), 4);
        let shader = self.shader(
            "reads.comp",
            "#version 460
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) readonly buffer Source { uint source[]; };
layout(set = 0, binding = 1) writeonly buffer Sink { uint sink[]; };
void main() { uint i = gl_WorkGroupID.x; sink[i] = source[i]; }",
        );
        self.dispatch(Run::Frame, name, shader, 4, &[(buffer, 0, READ), (sink, 1, WRITE)]);
    }

    /// A dispatch that writes all of a buffer.
    fn writes(&mut self, name: &str, buffer: ResourceId) {
        let shader = self.shader(
            "writes.comp",
            "#version 460
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) writeonly buffer Words { uint words[]; };
void main() { words[gl_WorkGroupID.x] = gl_WorkGroupID.x; }",
        );
        self.dispatch(Run::Frame, name, shader, 4, &[(buffer, 0, WRITE)]);
    }

    /// A dispatch that reads and writes all of a buffer.
    fn changes(&mut self, name: &str, buffer: ResourceId) {
        let shader = self.shader("add.comp", &add(1));
        self.dispatch(Run::Frame, name, shader, 4, &[(buffer, 0, BOTH)]);
    }

    /// A dispatch that adds to the first word of a buffer, atomically.
    fn counts(&mut self, name: &str, buffer: ResourceId) {
        let shader = self.shader(
            "counts.comp",
            "#version 460
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) buffer Count { uint count; };
void main() { atomicAdd(count, 1); }",
        );
        self.dispatch(Run::Frame, name, shader, 4, &[(buffer, 0, BOTH)]);
    }
}
