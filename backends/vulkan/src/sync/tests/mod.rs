//! Tests the barriers of small graphs. A failing assertion prints all barriers.

mod placement;
#[allow(dead_code)]
#[path = "../../../../../framework/src/testing.rs"]
mod testing;

use super::*;
use splatgraph_framework::ir::Run;
use testing::{apart, dispatch, frame, graph};

/// Solves a graph without aliasing.
fn solved(passes: &[String]) -> Plan {
    apart(&graph("", &passes.join("\n")))
}

fn placed(plan: &Plan) -> Barriers {
    barriers(plan).unwrap_or_else(|error| panic!("{error}"))
}

fn shown(plan: &Plan) -> String {
    let call = |(at, call): (Option<PassId>, &Vec<Barrier>)| {
        let lines: String = call.iter().map(|b| format!("  | {}\n", line(plan, b, at))).collect();
        format!("{lines}{}\n", at.map_or("handover", |id| &plan.pass(id).name))
    };
    format!("\n{}", placed(plan).calls(plan).map(call).collect::<String>())
}

/// Returns the barriers before a pass; see [`line`] for the format.
fn before(plan: &Plan, pass: &str) -> Vec<String> {
    let at = plan.order().find(|id| plan.pass(*id).name == pass);
    assert!(at.is_some(), "{}", shown(plan));
    placed(plan).at(at).iter().map(|barrier| line(plan, barrier, at)).collect()
}

fn handover(plan: &Plan) -> Vec<String> {
    placed(plan).handover.iter().map(|barrier| line(plan, barrier, None)).collect()
}

/// Formats a barrier: `COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on a after make`.
///
/// If a later pass than the next one needs the barrier, its name follows.
fn line(plan: &Plan, barrier: &Barrier, step: Option<PassId>) -> String {
    let layouts = barrier
        .image
        .map_or(String::new(), |t| format!(" [{} {:?} -> {:?}]", plan.resource(t.image).name, t.old, t.new));
    let reasons = barrier.causes.iter().map(|(d, _)| {
        let after: Vec<&str> = d.after.iter().map(|id| plan.pass(*id).name.as_str()).collect();
        let alias = d.alias.map_or(String::new(), |id| format!(" ({})", plan.resource(id).name));
        let frame = if d.previous_frame { " of the previous frame" } else { "" };
        let before = match step.is_none_or(|step| step == d.before) {
            true => String::new(),
            false => format!(", for {}", plan.pass(d.before).name),
        };
        let resource = &plan.resource(d.resource).name;
        format!("{:?} on {resource}{alias} after {}{frame}{before}", d.hazard, after.join("+"))
    });
    // Removes the spaces around the bars.
    let masks = barrier.masks.to_string().replace(" | ", "|");
    format!("{masks}{layouts}: {}", reasons.collect::<Vec<_>>().join(", "))
}
