//! Tests of the solver's guarantees, one sentence each. A failing assertion prints the dump.

mod barriers;
mod effects;
mod histories;
mod memory;
mod order;

use crate::ir::{Accesses, Hazard, Layout, PassId, Run, Stages, Work};
use crate::plan::{Barrier, Plan, Step};
use crate::solve::reorder;
use crate::testing::{apart, dispatch, graph, plan};

/// Every resource in its own memory.
fn solved(params: &str, passes: &[String]) -> Plan {
    apart(&graph(params, &passes.join("\n"))).unwrap_or_else(|error| panic!("{error}"))
}

/// Resources in shared memory where they can be.
fn packed(passes: &[String]) -> Plan {
    plan(&graph("", &passes.join("\n")), &[]).unwrap_or_else(|error| panic!("{error}"))
}

fn shown(plan: &Plan) -> String {
    let step = |step: &Step| {
        let barriers: Vec<String> =
            step.barriers.iter().map(|b| format!("  | {}", line(plan, b, Some(step.pass)))).collect();
        format!("{}\n{}\n", barriers.join("\n"), plan.pass(step.pass).name)
    };
    let steps = |steps: &[Step]| steps.iter().map(step).collect::<String>();
    format!("\n{}handover {:#?}\n{}", steps(&plan.prologue), handover(plan), steps(&plan.frame))
}

/// The names of the frame's passes, as they run.
fn frame(plan: &Plan) -> Vec<&str> {
    plan.frame.iter().map(|s| plan.pass(s.pass).name.as_str()).collect()
}

/// The barriers before a pass, as text.
fn before(plan: &Plan, pass: &str) -> Vec<String> {
    let step = plan.prologue.iter().chain(&plan.frame).find(|s| plan.pass(s.pass).name == pass);
    let step = step.unwrap_or_else(|| panic!("{}", shown(plan)));
    step.barriers.iter().map(|b| line(plan, b, Some(step.pass))).collect()
}

fn handover(plan: &Plan) -> Vec<String> {
    plan.handover.iter().map(|b| line(plan, b, None)).collect()
}

/// `COMPUTE STORAGE_WRITE -> COMPUTE STORAGE_READ: ReadAfterWrite on a after make`.
/// A later pass that needs it is named at the end.
fn line(plan: &Plan, barrier: &Barrier, step: Option<PassId>) -> String {
    fn flags<T>(names: impl Iterator<Item = (&'static str, T)>) -> String {
        names.map(|(name, _)| name).collect::<Vec<_>>().join("|")
    }
    let side = |stages: Stages, accesses: Accesses| {
        [flags(stages.iter_names()), flags(accesses.iter_names())].join(" ").trim().to_string()
    };
    let layouts = barrier
        .image
        .map_or(String::new(), |t| format!(" [{} {:?} -> {:?}]", plan.resource(t.image).name, t.old, t.new));
    let reasons = barrier.causes.iter().map(|d| {
        let after: Vec<&str> = d.after.iter().map(|id| plan.pass(*id).name.as_str()).collect();
        let alias = d.alias.map_or(String::new(), |id| format!(" ({})", plan.resource(id).name));
        let frame = if d.previous_frame { " of the frame before" } else { "" };
        let before = match step.is_none_or(|step| step == d.before) {
            true => String::new(),
            false => format!(", for {}", plan.pass(d.before).name),
        };
        let resource = &plan.resource(d.resource).name;
        format!("{:?} on {resource}{alias} after {}{frame}{before}", d.hazard, after.join("+"))
    });
    format!(
        "{} -> {}{layouts}: {}",
        side(barrier.source_stages, barrier.source_accesses),
        side(barrier.target_stages, barrier.target_accesses),
        reasons.collect::<Vec<_>>().join(", ")
    )
}

fn draw(name: &str, load: &str) -> String {
    format!(
        r#"Draw(name: "{name}", vertex: "quad.vert", fragment: "quad.frag", topology: TriangleStrip, call: Direct(vertices: 4, instances: 2),
            bind: {{"In": "a"}}, targets: [Target(image: "color", load: {load}, blend: PremultipliedOver)]),"#
    )
}

/// [`graph`] with a buffer, a ping-pong buffer and an image with histories: `past`, `order`, `trail`.
fn with_history(passes: &[String]) -> String {
    graph("", &passes.join("\n")).replace(
        "resources: {",
        r#"resources: {
        "past": Buffer(stride: 4, count: 64, history: true),
        "order": Buffer(stride: 4, count: 64, ping_pong: true, history: true),
        "trail": Image(format: "rgba16f", size: ("viewport.width", "viewport.height"), history: true),"#,
    )
}
