//! Tests of the model on handwritten plans and barriers, each correct or with one mistake.

use super::*;
use crate::sync::Barrier;
use sketch::*;
use splatgraph_framework::ir::*;
use splatgraph_framework::plan::Transition;
use std::ops::{Deref, DerefMut};

mod contents;
mod frames;
mod images;
mod memory;
mod mutations;
mod order;
#[allow(dead_code)]
#[path = "../../../../../../framework/src/oracle/tests/sketch.rs"]
mod sketch;
mod swap;

struct Sketch {
    sketch: sketch::Sketch,
    barriers: Barriers,
}

impl Deref for Sketch {
    type Target = sketch::Sketch;

    fn deref(&self) -> &sketch::Sketch {
        &self.sketch
    }
}

impl DerefMut for Sketch {
    fn deref_mut(&mut self) -> &mut sketch::Sketch {
        &mut self.sketch
    }
}

impl Sketch {
    fn new() -> Sketch {
        Sketch { sketch: sketch::Sketch::new(), barriers: Barriers { before: vec![], handover: vec![] } }
    }

    fn frame(&mut self, name: &str, barriers: &[Barrier], uses: &[Use]) {
        self.frame_work(name, barriers, dispatch(), uses);
    }

    fn frame_work(&mut self, name: &str, barriers: &[Barrier], work: Work, uses: &[Use]) {
        self.sketch.frame_work(name, work, uses);
        self.barriers.before.push(barriers.to_vec());
    }

    fn once(&mut self, name: &str, barriers: &[Barrier], uses: &[Use]) {
        self.once_work(name, barriers, dispatch(), uses);
    }

    fn once_work(&mut self, name: &str, barriers: &[Barrier], work: Work, uses: &[Use]) {
        self.sketch.once_work(name, work, uses);
        self.barriers.before.push(barriers.to_vec());
    }

    fn before(&mut self, place: usize) -> &mut Vec<Barrier> {
        let pass = self.sketch.plan.frame[place];
        self.barriers.at_mut(Some(pass))
    }

    fn before_once(&mut self, place: usize) -> &mut Vec<Barrier> {
        let pass = self.sketch.plan.prologue[place];
        self.barriers.at_mut(Some(pass))
    }

    fn replay(&self, replay: &Replay) -> Vec<Violation> {
        super::replay(&self.sketch.plan, &self.barriers, replay)
    }

    fn found_in(&self, frames: u32) -> Vec<String> {
        tell(&self.sketch.plan, &self.replay(&Replay { frames, ..Replay::default() }))
    }

    fn found(&self) -> Vec<String> {
        self.found_in(1)
    }
}

const NOTHING: [&str; 0] = [];

/// Formats violations as `kind: first pass, second pass: resource: missing guarantee`.
fn tell(plan: &Plan, violations: &[Violation]) -> Vec<String> {
    let name = |actor: Actor| match actor.what {
        What::Pass(pass) => plan.pass(pass).name.clone(),
        What::Transition { before: Some(pass), .. } => format!("change before {}", plan.pass(pass).name),
        What::Transition { before: None, .. } => "change in handover".into(),
        What::Host => "host".into(),
    };
    let short = |o: &Violation| {
        let first = o.first.map_or("none".into(), name);
        let through = o.through.map_or(String::new(), |id| format!(" (as {})", plan.resource(id).name));
        let missing = match o.missing {
            Missing::Visibility(stage, access) => format!("{access} at {stage}"),
            Missing::Layout { found, needed } => format!("{needed:?}, not {found:?}"),
            other => format!("{other:?}"),
        };
        let (second, resource, kind) = (name(o.second), &plan.resource(o.resource).name, o.kind);
        format!("{kind:?}: {first}{through}, {second}: {resource}: {missing}")
    };
    violations.iter().map(short).collect()
}

fn barrier(source: (Stages, Accesses), target: (Stages, Accesses)) -> Barrier {
    Barrier { image: None, masks: Masks::new(source, target), causes: vec![] }
}

fn order(source: Stages, target: Stages) -> Barrier {
    barrier((source, NO_ACCESS), (target, NO_ACCESS))
}

fn compute_to_compute() -> Barrier {
    barrier((COMPUTE, WRITE), (COMPUTE, READ))
}

fn change(
    image: ResourceId,
    (old, new): (Layout, Layout),
    source: (Stages, Accesses),
    target: (Stages, Accesses),
) -> Barrier {
    Barrier { image: Some(Transition { image, old, new }), ..barrier(source, target) }
}
