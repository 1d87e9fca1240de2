//! From checked passes to a plan: who runs, in what order, in what memory, and with what barriers between.
//!
//! Four steps, a file each. `order` finds which pass needs which other (a petgraph over read-after-write,
//! write-after-read and write-after-write), drops what nobody needs, and sorts the rest; ties go by the order of the
//! file, so that the same file always gives the same plan. `memory` lets resources whose lives do not meet share theirs.
//! `barriers` then walks the sorted passes with a model of what each piece of memory has been through, and places a barrier
//! exactly where a hazard would be without. `usage` finally drops the resources that no pass kept, and notes what the others
//! are used for.

mod barriers;
mod memory;
mod order;
mod usage;

use crate::ir::{
    Accesses, DrawCall, EXPORT, Groups, HOST, Layout, Pass, PassId, ResourceId, Run, Shape, Source, Stages,
    Touch, Usage, Work,
};
use crate::link::Linked;
use crate::lower::{Flat, Last};
use crate::plan::{PLAN_VERSION, Plan, Resource, Step};
use crate::source::{Diagnostic, SourceMap};

/// Orders the passes, culls, places memory (shared where `share_memory`) and barriers.
pub fn solve(linked: Linked, share_memory: bool, files: &SourceMap) -> Result<Plan, Vec<Diagnostic>> {
    let Linked { mut flat, shaders, mut passes, mut spans, mut left_out } = linked;
    for pass in end(&mut flat, files) {
        passes.push(pass);
        spans.push(flat.output_span);
    }

    forget_unread(&passes, &mut flat);
    let order = order::order(&passes, &spans, &flat, files)?;
    left_out.extend(order.left_out);
    // The plan holds the passes as they run: the prologue's first.
    let mut sorted: Vec<Pass> = order.once.iter().chain(&order.frame).map(|i| passes[*i].clone()).collect();
    forget_unread(&sorted, &mut flat);
    sorted.iter_mut().for_each(|pass| read_the_last_frame(pass, &flat));
    let starts = starts(&sorted, &flat.resources);
    let split = starts.len() + order.once.len();
    sorted.splice(..0, starts);
    let ids: Vec<PassId> = (0..sorted.len() as u32).map(PassId).collect();
    let (prologue, frame) = ids.split_at(split);

    let mut plan = Plan {
        version: PLAN_VERSION,
        name: flat.name,
        summary: flat.summary,
        facts: flat.facts,
        params: flat.params,
        resources: flat.resources,
        shaders,
        passes: sorted,
        blocks: Vec::new(),
        prologue: Vec::new(),
        handover: Vec::new(),
        frame: Vec::new(),
        left_out,
        output: flat.output,
        stats: flat.stats,
    };
    if !place(&mut plan, prologue, frame, share_memory) {
        let message = "no list of barriers was found that suits every frame";
        return Err(vec![Diagnostic::new(message, flat.output_span, "for this output").with_help(
            "this is a mistake of the solver, not of the graph: please report it with the graph",
        )]);
    }
    usage::prune(&mut plan);
    Ok(plan)
}

/// The same passes with those of the frame in another order, and with the memory and the barriers that this order needs. The
/// order must keep apart what the plan's keeps apart: of two passes that touch the same resource, one of them writing, the first
/// stays the first. `None` if the walk does not settle.
///
/// # Panics
/// If `frame` does not hold exactly the passes of the plan's frame.
pub fn reorder(plan: &Plan, frame: &[PassId], share_memory: bool) -> Option<Plan> {
    let ids = |steps: &[Step]| steps.iter().map(|step| step.pass).collect::<Vec<_>>();
    let sorted = |mut ids: Vec<PassId>| {
        ids.sort();
        ids
    };
    assert_eq!(sorted(ids(&plan.frame)), sorted(frame.to_vec()), "the passes of another frame");
    let mut plan = plan.clone();
    let prologue = ids(&plan.prologue);
    place(&mut plan, &prologue, frame, share_memory).then_some(plan)
}

/// Gives the plan's resources their memory, and its passes, in this order, their barriers.
fn place(plan: &mut Plan, prologue: &[PassId], frame: &[PassId], share_memory: bool) -> bool {
    plan.blocks = memory::place(&plan.passes, frame, &mut plan.resources, share_memory);
    let solved = barriers::place(plan, prologue, frame);
    let Some(solved) = solved else { return false };
    (plan.prologue, plan.handover, plan.frame) = (solved.prologue, solved.handover, solved.frame);
    true
}

/// The last passes of a frame: whoever waits for the frame can copy the output, and finds the statistics in host memory.
fn end(flat: &mut Flat, files: &SourceMap) -> Vec<Pass> {
    let origin = files.origin(flat.output_span);
    let copy = |resource, accesses, layout| {
        let (stages, discards) = (Stages::COPY, false);
        Touch { resource, stages, accesses, layout, discards }
    };
    let pass = |name: &str, work, touches| Pass {
        name: name.into(),
        phase: EXPORT.into(),
        run: Run::Frame,
        work,
        bindings: Vec::new(),
        push: Vec::new(),
        touches,
        origin: origin.clone(),
    };
    let mut touches = vec![copy(flat.output, Accesses::TRANSFER_READ, Some(Layout::TransferSource))];
    if flat.stats.is_empty() {
        return vec![pass(EXPORT, Work::Export, touches)];
    }
    for stat in &flat.stats {
        if touches.iter().all(|t| t.resource != stat.buffer) {
            touches.push(copy(stat.buffer, Accesses::TRANSFER_READ, None));
        }
    }
    let readback = ResourceId(flat.resources.len() as u32);
    touches.push(copy(readback, Accesses::TRANSFER_WRITE, None));
    flat.resources.push(Resource {
        name: "host(stats)".into(),
        shape: Shape::Buffer { stride: 4, count: flat.stats.len() as u64 },
        usage: Usage::empty(),
        source: Source::Readback,
        block: None,
        history: None,
        origin: origin.clone(),
    });
    flat.resource_spans.push(flat.output_span);
    let read = Touch {
        resource: readback,
        stages: Stages::HOST,
        accesses: Accesses::HOST_READ,
        layout: None,
        discards: false,
    };
    vec![pass(EXPORT, Work::Export, touches), pass(HOST, Work::Host, vec![read])]
}

/// Only what somebody reads in a later frame lives on: with `last(name)`, or by reading it before it is written.
fn forget_unread(passes: &[Pass], flat: &mut Flat) {
    for Last { stand_in, real } in flat.lasts.clone() {
        let touch = |p: &&Pass, id| p.touches.iter().any(|t: &Touch| t.resource == id);
        let first = passes.iter().filter(|p| p.run == Run::Frame).find(|p| touch(p, real));
        let reads = |p: &Pass| p.touches.iter().any(|t| t.resource == real && t.accesses.reads());
        if !passes.iter().any(|p| touch(&p, stand_in)) && !first.is_some_and(reads) {
            flat.resources[real.index()].history = None;
        }
    }
}

/// Puts the resources themselves where a pass names what the frame before left in them. Order has been made of it by now.
fn read_the_last_frame(pass: &mut Pass, flat: &Flat) {
    let real = |id: &mut ResourceId| *id = flat.last(*id).unwrap_or(*id);
    pass.bindings.iter_mut().for_each(|b| real(&mut b.resource));
    pass.touches.iter_mut().for_each(|t| real(&mut t.resource));
    match &mut pass.work {
        Work::Dispatch { groups: Groups::Indirect { buffer, .. }, .. }
        | Work::Draw { call: DrawCall::Indirect { buffer, .. }, .. } => real(buffer),
        _ => {}
    }
}

/// The passes that zero what has a history, where no `Once` pass writes it anyway.
fn starts(passes: &[Pass], resources: &[Resource]) -> Vec<Pass> {
    let mut starts = Vec::new();
    for (index, resource) in resources.iter().enumerate() {
        let id = ResourceId(index as u32);
        let written_once = |p: &Pass| {
            p.run == Run::Once && p.touches.iter().any(|t| t.resource == id && t.accesses.writes())
        };
        let touching = || passes.iter().filter(|p| p.touches.iter().any(|t| t.resource == id));
        let Some(name) = &resource.history else { continue };
        if touching().next().is_none() || touching().any(written_once) {
            continue;
        }
        let layout = match resource.shape {
            Shape::Buffer { .. } => None,
            Shape::Image { .. } => Some(Layout::TransferTarget),
        };
        starts.push(Pass {
            name: format!("start({name})"),
            phase: "start".into(),
            run: Run::Once,
            work: Work::Start { resource: id },
            bindings: Vec::new(),
            push: Vec::new(),
            touches: vec![Touch {
                resource: id,
                stages: Stages::CLEAR,
                accesses: Accesses::TRANSFER_WRITE,
                layout,
                discards: true,
            }],
            origin: resource.origin.clone(),
        });
    }
    starts
}

#[cfg(test)]
mod tests;
