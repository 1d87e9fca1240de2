//! Tests the solver's guarantees; a failing assertion prints the dependencies.

mod effects;
mod histories;
mod memory;
mod order;

use crate::ir::{Layout, PassId, Work};
use crate::oracle;
use crate::plan::{Dependency, Plan, Since};
use crate::solve::reorder;
use crate::testing::{apart, dispatch, draw, error_of, frame, graph, make, plan, show};

/// Solves with every resource in its own memory.
fn solved(passes: &[String]) -> Plan {
    apart(&graph("", &passes.join("\n")))
}

/// Solves with shared memory.
fn packed(passes: &[String]) -> Plan {
    plan(&graph("", &passes.join("\n")), &[])
}

fn shown(plan: &Plan) -> String {
    let pass = |id: PassId| {
        let dependencies: Vec<String> = plan.dependencies_of(id).iter().map(|d| line(plan, d)).collect();
        format!("{}\n  {}\n", plan.pass(id).name, dependencies.join("\n  "))
    };
    format!("\n{}{:#?}", plan.order().map(pass).collect::<String>(), plan.layout_changes)
}

fn dependencies(plan: &Plan, pass: &str) -> Vec<String> {
    let id = plan.order().find(|id| plan.pass(*id).name == pass);
    let id = id.unwrap_or_else(|| panic!("{}", shown(plan)));
    plan.dependencies_of(id).iter().map(|dependency| line(plan, dependency)).collect()
}

/// Formats a dependency: `WriteAfterRead on a (b) after make of the previous frame`.
fn line(plan: &Plan, dependency: &Dependency) -> String {
    let Dependency { hazard, first, since, resource, alias, .. } = *dependency;
    let alias = alias.map_or(String::new(), |id| format!(" ({})", plan.resource(id).name));
    let since = match since {
        Since::Same => "",
        Since::Prologue => " of the prologue",
        Since::PreviousFrame => " of the previous frame",
    };
    format!("{hazard:?} on {}{alias} after {}{since}", plan.resource(resource).name, plan.pass(first).name)
}

/// Solves [`with_history`].
fn kept(passes: &[String]) -> Plan {
    plan(&with_history(passes), &[])
}

/// Returns [`graph`] with a buffer, a ping-pong buffer and an image with histories: `past`, `order`, `trail`.
fn with_history(passes: &[String]) -> String {
    graph("", &passes.join("\n")).replace(
        "resources: {",
        r#"resources: {
        "past": Buffer(stride: 4, count: 64, history: true),
        "order": Buffer(stride: 4, count: 64, ping_pong: true, history: true),
        "trail": Image(format: "rgba16f", size: ("viewport.width", "viewport.height"), history: true),"#,
    )
}
