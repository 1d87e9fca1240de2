//! Solves for a plan: gives the linked passes an order, memory and dependencies.
//!
//! Each step has a file. `order` builds the dependency graph, sorts the passes, and culls those whose results are
//! unused. Ties follow the order of the file, so equal requests give equal plans. `compact` drops unused resources and
//! shaders, renumbers the others, and records the uses of each resource. `effects` finds the passes that depend on each
//! parameter. `memory` lets resources share blocks. `dependencies` lists the accesses that must be ordered, per memory
//! cell (cut by `extents`). `warnings` reports constructs that are probably unintended.

mod compact;
mod dependencies;
mod effects;
mod extents;
mod memory;
mod order;
mod warnings;

use crate::ir::{
    Accesses, EXPORT, HOST, Layout, Pass, PassId, ResourceId, Run, Shape, Source, Stages, Usage, Use, Work,
};
use crate::link::{Linked, LinkedPass, PassParams};
use crate::lower::{Declaration, Lowered};
use crate::plan::{Plan, Resource};
use crate::source::{Diagnostic, SourceMap};
use std::ops::Range;

/// Orders and culls the passes, places memory (shared if `share_memory`), and lists the dependencies.
///
/// # Errors
/// Passes that depend on one another in a cycle, reads of resources that no pass has written before, and `Once` passes
/// that use a resource which only the frame writes.
pub(crate) fn solve(linked: Linked, share_memory: bool, files: &SourceMap) -> Result<Plan, Vec<Diagnostic>> {
    let Linked { mut lowered, mut passes } = linked;
    passes.extend(end(&mut lowered, files));

    forget_overwritten(&passes.iter().collect::<Vec<_>>(), &mut lowered);
    let order = order::order(&passes, &lowered)?;
    let warnings = warnings::warnings(&passes, &order, &lowered, files);
    let causes = effects::Causes::new(&lowered, &passes, &order, files);
    lowered.plan.culled.extend(order.culled);
    // The plan holds the passes in execution order: the prologue first.
    let sorted: Vec<&LinkedPass> = order.once.iter().chain(&order.frame).map(|i| &passes[*i]).collect();
    forget_overwritten(&sorted, &mut lowered);
    let mut plan = compact::compact(lowered, &sorted);
    plan.warnings = warnings;
    let starts = starts(&plan.resources);
    plan.effects = causes.effects(&plan, &starts);
    let split = starts.len() + order.once.len();
    plan.passes.splice(..0, starts);
    compact::note_usage(&mut plan);

    let mut prologue: Vec<PassId> = (0..plan.passes.len() as u32).map(PassId).collect();
    plan.frame = prologue.split_off(split);
    plan.prologue = prologue;
    place(&mut plan, share_memory);
    Ok(plan)
}

/// Returns the plan with its frame in another order, and with the memory and dependencies of this order.
///
/// Conflicting passes (two passes that use a resource, one of them writing it) must keep their order.
///
/// # Panics
/// Panics if `frame` is not a permutation of the plan's frame.
pub fn reorder(plan: &Plan, frame: &[PassId], share_memory: bool) -> Plan {
    let sorted = |mut ids: Vec<PassId>| {
        ids.sort();
        ids
    };
    assert_eq!(sorted(plan.frame.clone()), sorted(frame.to_vec()), "the passes of another frame");
    let mut plan = Plan { frame: frame.to_vec(), ..plan.clone() };
    place(&mut plan, share_memory);
    plan
}

/// Returns the positions in the frame at which each resource is alive. `None` for resources that are not transient,
/// outlive a frame, or are not written in it.
pub(crate) fn lifetimes(plan: &Plan) -> impl Iterator<Item = Option<Range<usize>>> {
    let lives = memory::lives(&plan.passes, &plan.frame, &plan.resources);
    lives.into_iter().map(|life| life.map(|life| life.first..life.last + 1))
}

fn place(plan: &mut Plan, share_memory: bool) {
    plan.blocks = memory::place(&plan.passes, &plan.frame, &mut plan.resources, share_memory);
    add_dependencies(plan);
}

/// Derives the dependencies and layout changes of a plan from its passes' accesses, replacing existing ones.
pub fn add_dependencies(plan: &mut Plan) {
    (plan.layout_changes, plan.dependencies) = dependencies::dependencies(plan);
}

/// Creates the last passes of a frame: the export, and the host pass if there are statistics. The export prepares
/// outputs for copies, and copies statistics to a buffer that this function adds to `lowered`. The host pass reads them
/// there.
fn end(lowered: &mut Lowered, files: &SourceMap) -> Vec<LinkedPass> {
    let span = lowered.output_span;
    let touch =
        |resource, stages, accesses, layout| Use { resource, stages, accesses, layout, discards: false };
    let pass = |name: &str, work, uses| LinkedPass {
        pass: Pass {
            name: name.into(),
            phase: EXPORT.into(),
            run: Run::Frame,
            work,
            bindings: Vec::new(),
            push: Vec::new(),
            uses,
            origin: files.origin(span),
        },
        span,
        include: None,
        params: PassParams { all: lowered.results.clone(), ..PassParams::default() },
    };
    let output = Some(Layout::TransferSource);
    let mut uses = vec![touch(lowered.plan.output, Stages::COPY, Accesses::TRANSFER_READ, output)];
    for other in &lowered.plan.outputs {
        if uses.iter().all(|t| t.resource != other.image) {
            uses.push(touch(other.image, Stages::COPY, Accesses::TRANSFER_READ, output));
        }
    }
    if lowered.plan.stats.is_empty() {
        return vec![pass(EXPORT, Work::Export, uses)];
    }
    for stat in &lowered.plan.stats {
        if uses.iter().all(|t| t.resource != stat.buffer) {
            uses.push(touch(stat.buffer, Stages::COPY, Accesses::TRANSFER_READ, None));
        }
    }
    let readback = ResourceId(lowered.plan.resources.len() as u32);
    lowered.plan.resources.push(Resource {
        name: "host(stats)".into(),
        shape: Shape::Buffer { stride: 4, count: lowered.plan.stats.len() as u64 },
        usage: Usage::empty(),
        source: Source::Readback,
        block: None,
        history: None,
        origin: files.origin(span),
    });
    let params = lowered.results.clone();
    lowered.declarations.push(Declaration { span, previous_frame_of: None, params });
    uses.push(touch(readback, Stages::COPY, Accesses::TRANSFER_WRITE, None));
    let read = touch(readback, Stages::HOST, Accesses::HOST_READ, None);
    vec![pass(EXPORT, Work::Export, uses), pass(HOST, Work::Host, vec![read])]
}

/// Drops histories whose contents cannot matter. They do not if no pass reads them by `last(name)`, no `Once` pass uses
/// them, and a frame that uses them first overwrites them completely.
fn forget_overwritten(passes: &[&LinkedPass], lowered: &mut Lowered) {
    let mut users: Vec<Vec<&LinkedPass>> = vec![Vec::new(); lowered.plan.resources.len()];
    let mut used_once = vec![false; lowered.plan.resources.len()];
    for pass in passes {
        for touch in &pass.pass.uses {
            if pass.pass.run == Run::Once {
                used_once[touch.resource.index()] = true;
                continue;
            }
            let users = &mut users[touch.resource.index()];
            // A pass may use a resource in several stages.
            if !users.last().is_some_and(|last| std::ptr::eq(*last, *pass)) {
                users.push(pass);
            }
        }
    }
    for previous in (0..lowered.plan.resources.len() as u32).map(ResourceId) {
        let Some(real) = lowered.declaration(previous).previous_frame_of else { continue };
        let writes = |p: &&&LinkedPass| p.pass.uses.iter().any(|t| t.resource == real && t.accesses.writes());
        let mut writers = users[real.index()].iter().filter(writes);
        // A single writer runs before all other users, wherever they are in the file.
        let first = match (writers.next(), writers.next()) {
            (Some(only), None) => Some(only),
            _ => users[real.index()].first(),
        };
        let once = used_once[real.index()] || used_once[previous.index()];
        if !once && users[previous.index()].is_empty() && first.is_none_or(|p| p.pass.overwrites(real)) {
            lowered.plan.resources[real.index()].history = None;
        }
    }
}

/// Returns the passes that zero histories. They precede every `Once` pass, because a `Once` pass may write only a part
/// of a history.
fn starts(resources: &[Resource]) -> Vec<Pass> {
    let mut starts = Vec::new();
    for (index, resource) in resources.iter().enumerate() {
        let id = ResourceId(index as u32);
        let Some(name) = &resource.history else { continue };
        let layout = match resource.shape {
            Shape::Buffer { .. } => None,
            Shape::Image { .. } => Some(Layout::TransferTarget),
        };
        starts.push(Pass {
            name: format!("start({name})"),
            phase: "start".into(),
            run: Run::Once,
            work: Work::ClearHistory { resource: id },
            bindings: Vec::new(),
            push: Vec::new(),
            uses: vec![Use {
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
