//! Runs `splatgraph check`: builds graphs and replays their barriers.

use super::Outcome;
use super::{colour, options};
use crate::facts::{self, SceneFacts};
use crate::output::{say, say_styled};
use crate::planner::{GraphErrors, Planner};
use anyhow::Result;
use splatgraph_framework::dump;
use splatgraph_framework::oracle::{self, Replay, mutate};
use splatgraph_framework::plan::Plan;
use std::io::Write;

pub const EXAMPLES: &str = "Examples:
  splatgraph check                        # every built-in graph
  splatgraph check splat my/graph.ron";

/// Check graphs and their shaders, without a GPU
///
/// Every graph is built, and its shaders are compiled and checked against it, for a nominal scene and the smallest supported
/// device, with subgroups of 4 to 64 lanes. Errors are shown at their line and column. An oracle then replays the barriers of
/// each plan, and tests that they suffice and that none of them, and no bit of one, is needless.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The graphs: names of built-in ones (see --help), or paths; without any, every built-in one
    #[arg(value_name = "NAME")]
    graphs: Vec<String>,
    /// Change a parameter of the graphs; can be given several times
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let graphs: Vec<&str> = if args.graphs.is_empty() {
        options::built_in_graphs()
    } else {
        args.graphs.iter().map(String::as_str).collect()
    };
    // One for all: graphs share most of their shaders.
    let mut planner = Planner::default();
    let mut outcome = Outcome::Done;
    for graph in graphs {
        match check(&mut planner, graph, &args.set) {
            Ok(Ok(lines)) => options::print(&format!("{graph}: OK{lines}"))?,
            // Not the graph's fault: the solver's.
            Ok(Err(violations)) => {
                outcome = Outcome::Failed;
                say(violations);
                options::print(&format!(
                    "{graph}: its barriers do not hold; please report this with the graph"
                ))?;
            }
            Err(errors) => {
                outcome = Outcome::Failed;
                say_styled(&format!("{}\n", errors.text(colour()).trim_end()));
                options::print(&format!(
                    "{graph}: {}",
                    if errors.count == 1 { "an error" } else { "errors" }
                ))?;
            }
        }
    }
    Ok(outcome)
}

/// A plan that was verified, with the widths of subgroups that it is for.
struct Verified {
    lanes: Vec<String>,
    plan: Plan,
    line: String,
}

/// Builds a graph for every subgroup size, because graphs may depend on it, and verifies each plan.
///
/// Returns a line for the sizes with equal counts, or the violations of the first size that has any; and the errors of the first
/// size that has any. Warnings are printed once each.
fn check(
    planner: &mut Planner,
    graph: &str,
    set: &[(String, String)],
) -> Result<Result<String, String>, GraphErrors> {
    let catalog = options::nominal_catalog();
    let mut found: Vec<Verified> = Vec::new();
    let mut warned = Vec::new();
    for lanes in facts::SUBGROUP_SIZES {
        let facts = facts::facts(&SceneFacts::NOMINAL, &facts::portable_device(lanes), facts::DEFAULT_SIZE);
        let plan = planner.plan(graph, set, &facts, &catalog)?;
        let warnings = planner.warnings(&plan, colour());
        if !warnings.is_empty() && !warned.contains(&warnings) {
            let _ = writeln!(std::io::stderr(), "{}", warnings.trim_end());
            warned.push(warnings);
        }
        // Barriers depend on passes and resources, not on shaders or facts.
        let same = |other: &Verified| is_same(&other.plan, &plan);
        let line = match found.iter().find(|other| same(other)) {
            Some(other) => other.line.clone(),
            None => match verify(&plan) {
                Ok(line) => line,
                Err(violations) => {
                    return Ok(Err(format!("with subgroups of {lanes} lanes:\n{violations}")));
                }
            },
        };
        match found.iter_mut().find(|other| other.line == line) {
            Some(other) => other.lanes.push(lanes.to_string()),
            None => found.push(Verified { lanes: vec![lanes.to_string()], plan, line }),
        }
    }
    let line = |verified: &Verified| format!("\n  {} lanes: {}", verified.lanes.join(", "), verified.line);
    Ok(Ok(found.iter().map(line).collect()))
}

/// Returns true if two plans have the same passes, memory and barriers.
fn is_same(a: &Plan, b: &Plan) -> bool {
    let uses = |plan: &Plan| -> Vec<_> { plan.passes.iter().map(|p| (p.run, p.uses.clone())).collect() };
    (&a.prologue, &a.handover, &a.frame, &a.resources, &a.blocks, &a.stats, &a.culled)
        == (&b.prologue, &b.handover, &b.frame, &b.resources, &b.blocks, &b.stats, &b.culled)
        && a.shaders.len() == b.shaders.len()
        && a.shaders.iter().zip(&b.shaders).all(|(a, b)| a.reflection.bindings == b.reflection.bindings)
        && uses(a) == uses(b)
        && a.passes.iter().zip(&b.passes).all(|(a, b)| a.work == b.work)
}

/// Replays the plan with the oracle and tries every mutation; returns the counts, or the violations and the needless parts.
fn verify(plan: &Plan) -> Result<String, String> {
    let violations = oracle::replay(plan, &Replay::default());
    let mut problems: Vec<String> = violations.iter().map(|violation| violation.describe(plan)).collect();
    if problems.is_empty() {
        let needless = mutate::needless(plan);
        problems = needless.iter().map(|mutation| format!("needless: {}", mutation.describe(plan))).collect();
    }
    if !problems.is_empty() {
        return Err(problems.join("\n"));
    }
    let dump = dump::dump(plan);
    let frame = &dump.totals.frame;
    let mut line = format!(
        "{} passes once and {} every frame, {} shaders; {} barriers in {} calls: they leave no hazard, and taking away any \
         barrier or any bit of one ({} ways) leaves one",
        plan.prologue.len(),
        plan.frame.len(),
        plan.shaders.len(),
        frame.barriers,
        frame.calls,
        mutate::mutations(plan).len(),
    );
    if !dump.left_out.is_empty() {
        line += &format!("; {}", dump::left_out_counts(&dump));
    }
    Ok(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(lanes: u32) -> Plan {
        let facts = facts::facts(&SceneFacts::NOMINAL, &facts::portable_device(lanes), facts::DEFAULT_SIZE);
        Planner::default().plan("splat", &[], &facts, &options::nominal_catalog()).expect("a plan")
    }

    #[test]
    fn the_plans_that_are_verified_have_both_sorts() {
        for (lanes, sort) in
            [(4, "sort_serial."), (8, "sort_serial."), (16, "sort."), (32, "sort."), (64, "sort.")]
        {
            let plan = plan(lanes);
            assert!(plan.passes.iter().any(|pass| pass.name.starts_with(sort)), "{lanes} lanes");
            assert!(verify(&plan).is_ok(), "{lanes} lanes");
        }
    }

    #[test]
    fn a_barrier_too_few_and_a_barrier_too_many_fail() {
        let plan = plan(8);
        let step = plan.frame.iter().position(|step| !step.barriers.is_empty()).expect("a barrier");
        let mut fewer = plan.clone();
        fewer.frame[step].barriers.clear();
        let text = verify(&fewer).expect_err("a hazard");
        assert!(!text.contains("needless"), "{text}");
        let mut more = plan.clone();
        let twice = more.frame[step].barriers[0].clone();
        more.frame[step].barriers.push(twice);
        let text = verify(&more).expect_err("a needless barrier");
        assert!(text.lines().all(|line| line.starts_with("needless: ")), "{text}");
    }
}
