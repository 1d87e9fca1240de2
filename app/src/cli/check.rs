//! Runs `splatgraph check`: builds graphs and replays their barriers.

use super::Outcome;
use super::{colour, options};
use crate::facts::{self, SceneFacts};
use crate::planner::{GraphErrors, Planner};
use anyhow::Result;
use splatgraph_framework::dump;
use splatgraph_framework::oracle::{self, Replay, mutate};
use splatgraph_framework::plan::Plan;

pub const EXAMPLES: &str = "Examples:
  splatgraph check                        # every built-in graph
  splatgraph check splat my/graph.ron";

/// Check graphs and their shaders, without a GPU
///
/// Every graph is built, and its shaders are compiled and checked against it, for a nominal scene and the smallest supported
/// device, with subgroups of 4 to 64 lanes. Errors are shown at their line and column. An oracle then replays the plan's
/// barriers, and tests that they suffice and that none of them, and no bit of one, is needless.
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
            Ok(Ok(line)) => options::print(&format!("{graph}: OK, {line}"))?,
            // Not the graph's fault: the solver's.
            Ok(Err(objections)) => {
                outcome = Outcome::Failed;
                eprintln!("{objections}");
                options::print(&format!(
                    "{graph}: its barriers do not hold; please report this with the graph"
                ))?;
            }
            Err(errors) => {
                outcome = Outcome::Failed;
                eprintln!("{}", errors.text(colour()).trim_end());
                options::print(&format!(
                    "{graph}: {}",
                    if errors.count == 1 { "an error" } else { "errors" }
                ))?;
            }
        }
    }
    Ok(outcome)
}

/// Builds a graph for every subgroup size, because graphs may depend on it, and describes the plan for the usual size.
///
/// Returns the errors of the first size that has any.
fn check(
    planner: &mut Planner,
    graph: &str,
    set: &[(String, String)],
) -> Result<Result<String, String>, GraphErrors> {
    let catalog = options::nominal_catalog();
    let mut line = Ok(String::new());
    for lanes in facts::SUBGROUP_SIZES {
        let facts = facts::facts(&SceneFacts::NOMINAL, &facts::portable_device(lanes), facts::DEFAULT_SIZE);
        let plan = planner.plan(graph, set, &facts, &catalog)?;
        if lanes == facts::USUAL_SUBGROUP_SIZE {
            line = proof(&plan);
        }
    }
    Ok(line)
}

/// Replays the plan with the oracle and tries every mutation; returns a summary, or the violations.
fn proof(plan: &Plan) -> Result<String, String> {
    let objections = oracle::replay(plan, &Replay::default());
    if !objections.is_empty() {
        let lines: Vec<String> = objections.iter().map(|objection| objection.describe(plan)).collect();
        return Err(lines.join("\n"));
    }
    let totals = dump::dump(plan).totals;
    let needless = mutate::needless(plan).len();
    Ok(format!(
        "{} passes once and {} every frame, {} shaders; {} barriers in {} calls: 0 hazards, {needless} of {} removals and \
         cleared bits go unnoticed",
        plan.prologue.len(),
        plan.frame.len(),
        plan.shaders.len(),
        totals.frame.barriers,
        totals.frame.calls,
        mutate::mutations(plan).len(),
    ))
}
