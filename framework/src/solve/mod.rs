//! From checked passes to a plan: who runs, in what order, and with what barriers between.
//!
//! Three steps, a file each. `order` finds which pass needs which other (a petgraph over read-after-write,
//! write-after-read and write-after-write), drops what nobody needs, and sorts the rest; ties go by the order of the
//! file, so that the same file always gives the same plan. `barriers` then walks the sorted passes with a model of what
//! each resource has been through, and places a barrier exactly where a hazard would be without. `usage` finally drops
//! the resources that no pass kept, and notes what the others are used for.

mod barriers;
mod order;
mod usage;

use crate::check::Checked;
use crate::plan::{Accesses, Layout, PLAN_VERSION, Pass, PassId, Plan, Run, Stages, Touch, Work};
use crate::source::{Diagnostic, SourceMap};

/// The name of the frame's last pass, which no pass of a graph may have.
pub const EXPORT: &str = "export";

/// Orders the passes, culls, places the barriers.
pub fn solve(checked: Checked, files: &SourceMap) -> Result<Plan, Vec<Diagnostic>> {
    let Checked { flat, shaders, mut passes, mut spans, mut left_out } = checked;
    passes.push(export(&flat, files));
    spans.push(flat.output_span);

    let order = order::order(&passes, &spans, &flat, files)?;
    left_out.extend(order.left_out);
    // The plan holds the passes as they run: the prologue's first.
    let sorted: Vec<Pass> = order.once.iter().chain(&order.frame).map(|i| passes[*i].clone()).collect();
    let split = order.once.len();
    let ids: Vec<PassId> = (0..sorted.len() as u32).map(PassId).collect();
    let solved =
        barriers::place(&sorted, &ids[..split], &ids[split..], flat.resources.len()).ok_or_else(|| {
            let message = "no list of barriers was found that suits every frame";
            vec![Diagnostic::new(message, flat.output_span, "for this output").with_help(
                "this is a mistake of the solver, not of the graph: please report it with the graph",
            )]
        })?;

    let mut plan = Plan {
        version: PLAN_VERSION,
        name: flat.name,
        summary: flat.summary,
        facts: flat.facts,
        params: flat.params,
        resources: flat.resources,
        shaders,
        passes: sorted,
        prologue: solved.prologue,
        frame: solved.frame,
        left_out,
        output: flat.output,
        stats: flat.stats,
    };
    usage::prune(&mut plan);
    Ok(plan)
}

/// The last pass of a frame: whoever waits for the frame can copy the output and the statistics.
fn export(flat: &crate::lower::Flat, files: &SourceMap) -> Pass {
    let read = |resource, layout| Touch {
        resource,
        stages: Stages::COPY,
        accesses: Accesses::TRANSFER_READ,
        layout,
        discards: false,
    };
    let mut touches = vec![read(flat.output, Some(Layout::TransferSource))];
    for stat in &flat.stats {
        if touches.iter().all(|t| t.resource != stat.buffer) {
            touches.push(read(stat.buffer, None));
        }
    }
    Pass {
        name: EXPORT.into(),
        phase: EXPORT.into(),
        run: Run::Frame,
        work: Work::Export,
        bindings: Vec::new(),
        push: Vec::new(),
        touches,
        origin: files.origin(flat.output_span),
    }
}

#[cfg(test)]
mod tests;
