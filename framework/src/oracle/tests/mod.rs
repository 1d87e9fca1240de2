//! hand-made plans, each with one thing right or wrong.

use std::collections::BTreeMap;

use super::*;
use crate::{ir::*, plan::*};

mod contents;
mod dependencies;
mod frames;
mod images;
mod memory;
mod mutations;
mod order;
mod swap;

/// A plan in the making. Buffers have 64 bytes and memory of their own unless a test says otherwise.
struct Sketch {
    plan: Plan,
}

const BYTES: u64 = 64;

fn origin() -> Origin {
    Origin { file: "graph.ron".into(), line: 1, column: 1 }
}

impl Sketch {
    fn new() -> Sketch {
        let plan = Plan {
            effects: vec![],
            name: "sketch".into(),
            summary: String::new(),
            based_on: vec![],
            fallbacks: vec![],
            facts: BTreeMap::new(),
            params: vec![],
            resources: vec![],
            shaders: vec![],
            passes: vec![],
            blocks: vec![],
            prologue: vec![],
            dependencies: vec![],
            layout_changes: vec![],
            handover: vec![],
            frame: vec![],
            culled: vec![],
            warnings: vec![],
            output: ResourceId(0),
            outputs: vec![],
            stats: vec![],
        };
        Sketch { plan }
    }

    fn resource(&mut self, name: &str, shape: Shape, source: Source) -> ResourceId {
        let id = ResourceId(self.plan.resources.len() as u32);
        let block = (source == Source::Transient).then(|| {
            self.plan.blocks.push(Block { aliases: vec![id] });
            BlockId(self.plan.blocks.len() as u32 - 1)
        });
        let (name, usage) = (name.into(), Usage::all());
        self.plan.resources.push(Resource {
            name,
            shape,
            usage,
            source,
            block,
            history: None,
            origin: origin(),
        });
        id
    }

    fn sized(&mut self, name: &str, bytes: u64) -> ResourceId {
        self.resource(name, Shape::Buffer { stride: 4, count: bytes / 4 }, Source::Transient)
    }

    fn buffer(&mut self, name: &str) -> ResourceId {
        self.sized(name, BYTES)
    }

    /// As large as a buffer.
    fn image(&mut self, name: &str) -> ResourceId {
        let shape = Shape::Image { format: Format::Rgba8Unorm, width: 4, height: 4 };
        self.resource(name, shape, Source::Transient)
    }

    fn uniform(&mut self, name: &str) -> ResourceId {
        let shape = Shape::Buffer { stride: 4, count: 4 };
        self.resource(name, shape, Source::Frame { uniform: name.into() })
    }

    /// Puts a resource into the memory of another.
    fn share(&mut self, id: ResourceId, with: ResourceId) {
        let block = self.plan.resource(with).block;
        let old = std::mem::replace(&mut self.plan.resources[id.index()].block, block);
        self.plan.blocks[old.unwrap().index()].aliases.clear();
        self.plan.blocks[block.unwrap().index()].aliases.push(id);
    }

    fn history(&mut self, id: ResourceId, name: &str) {
        self.plan.resources[id.index()].history = Some(name.into());
    }

    fn pass(&mut self, name: &str, run: Run, work: Work, uses: &[Use]) -> PassId {
        let id = PassId(self.plan.passes.len() as u32);
        self.plan.passes.push(Pass {
            name: name.into(),
            phase: "test".into(),
            run,
            work,
            bindings: vec![],
            push: vec![],
            uses: uses.to_vec(),
            origin: origin(),
        });
        id
    }

    /// A pass of the frame, after its barriers.
    fn frame(&mut self, name: &str, barriers: &[Barrier], uses: &[Use]) {
        self.frame_work(name, barriers, dispatch(), uses);
    }

    fn frame_work(&mut self, name: &str, barriers: &[Barrier], work: Work, uses: &[Use]) {
        let pass = self.pass(name, Run::Frame, work, uses);
        self.plan.frame.push(Step { barriers: barriers.to_vec(), pass });
    }

    /// A pass of the prologue, after its barriers.
    fn once(&mut self, name: &str, barriers: &[Barrier], uses: &[Use]) {
        self.once_work(name, barriers, dispatch(), uses);
    }

    fn once_work(&mut self, name: &str, barriers: &[Barrier], work: Work, uses: &[Use]) {
        let pass = self.pass(name, Run::Once, work, uses);
        self.plan.prologue.push(Step { barriers: barriers.to_vec(), pass });
    }

    /// Replays so many frames: kind, first pass, second pass, resource, missing guarantee of each violation.
    fn found_in(&self, frames: u32) -> Vec<String> {
        tell(&self.plan, &replay(&self.plan, &Replay { frames, ..Replay::default() }))
    }

    /// Replays one frame.
    fn found(&self) -> Vec<String> {
        self.found_in(1)
    }
}

/// Objections in short, for comparison.
fn tell(plan: &Plan, violations: &[Violation]) -> Vec<String> {
    let name = |actor: Actor| match actor {
        Actor::Pass { pass, .. } => plan.pass(pass).name.clone(),
        Actor::Transition { before: Some(pass), .. } => format!("change before {}", plan.pass(pass).name),
        Actor::Transition { before: None, .. } => "change in handover".into(),
        Actor::Host { .. } => "host".into(),
    };
    let short = |o: &Violation| {
        let first = o.first.map_or("none".into(), name);
        let through = o.through.map_or(String::new(), |id| format!(" (as {})", plan.resource(id).name));
        let missing = match o.missing {
            Missing::Visibility(stage, access) => {
                format!(
                    "{} at {}",
                    violation::flag_names(access.iter_names()),
                    violation::flag_names(stage.iter_names())
                )
            }
            Missing::Layout { found, needed } => format!("{needed:?}, not {found:?}"),
            other => format!("{other:?}"),
        };
        let (second, resource, kind) = (name(o.second), &plan.resource(o.resource).name, o.kind);
        format!("{kind:?}: {first}{through}, {second}: {resource}: {missing}")
    };
    violations.iter().map(short).collect()
}

const NOTHING: [&str; 0] = [];

fn dispatch() -> Work {
    Work::Dispatch { shader: ShaderId(0), groups: Groups::Direct([1; 3]) }
}

/// A draw by the shaders 0 and 1.
fn draw() -> Work {
    Work::Draw {
        vertex: ShaderId(0),
        fragment: ShaderId(1),
        topology: Topology::TriangleList,
        call: DrawCall::Direct { vertices: 3, instances: 1 },
        targets: vec![],
    }
}

fn touch(resource: ResourceId, stages: Stages, accesses: Accesses) -> Use {
    Use { resource, stages, accesses, layout: None, discards: false }
}

const READ: Accesses = Accesses::STORAGE_READ;
const WRITE: Accesses = Accesses::STORAGE_WRITE;
const BOTH: Accesses = READ.union(WRITE);
const COMPUTE: Stages = Stages::COMPUTE;
const VERTEX: Stages = Stages::VERTEX;
const FRAGMENT: Stages = Stages::FRAGMENT;
const COPY: Stages = Stages::COPY;
const CLEAR: Stages = Stages::CLEAR;
const NO_ACCESS: Accesses = Accesses::empty();

/// Storage reads and writes of a compute shader.
fn reads(resource: ResourceId) -> Use {
    touch(resource, COMPUTE, READ)
}

fn writes(resource: ResourceId) -> Use {
    touch(resource, COMPUTE, WRITE)
}

/// A fill.
fn fills(resource: ResourceId) -> Use {
    touch(resource, CLEAR, Accesses::TRANSFER_WRITE)
}

fn barrier(source: (Stages, Accesses), target: (Stages, Accesses)) -> Barrier {
    Barrier {
        image: None,
        source_stages: source.0,
        source_accesses: source.1,
        target_stages: target.0,
        target_accesses: target.1,
        causes: vec![],
    }
}

fn order(source: Stages, target: Stages) -> Barrier {
    barrier((source, NO_ACCESS), (target, NO_ACCESS))
}

/// Makes the barrier that a read in a compute shader needs after a write in one.
fn compute_to_compute() -> Barrier {
    barrier((COMPUTE, WRITE), (COMPUTE, READ))
}

/// A change of layout from one scope to another.
fn change(
    image: ResourceId,
    (old, new): (Layout, Layout),
    source: (Stages, Accesses),
    target: (Stages, Accesses),
) -> Barrier {
    Barrier { image: Some(Transition { image, old, new }), ..barrier(source, target) }
}

/// A storage image in a compute shader.
fn in_general(resource: ResourceId, accesses: Accesses) -> Use {
    Use { layout: Some(Layout::General), ..touch(resource, COMPUTE, accesses) }
}
