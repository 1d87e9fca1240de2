//! `splatgraph check`: whether graphs and their shaders are sound.

use super::Outcome;
use super::{colour, options};
use crate::builtin;
use crate::facts::{self, SceneFacts};
use crate::planner::Planner;
use anyhow::Result;

pub const EXAMPLES: &str = "Examples:
  splatgraph check                        # every built-in graph
  splatgraph check splat my/graph.ron";

/// Check graphs and their shaders, without a GPU
///
/// Every graph is built as far as a plan, and its shaders are compiled and held against it, for the least device that the
/// built-in graphs run on and a nominal scene. Mistakes are shown at their line and column.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The graphs: built-in ones' names (see --help), or paths; without any, every built-in one
    #[arg(value_name = "NAME")]
    graphs: Vec<String>,
    /// Change a parameter of the graphs; can be given several times
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let presets;
    let graphs: Vec<&str> = if args.graphs.is_empty() {
        presets = builtin::presets();
        options::names(&presets)
    } else {
        args.graphs.iter().map(String::as_str).collect()
    };
    let facts = facts::facts(&SceneFacts::NOMINAL, &facts::portable_device(), facts::DEFAULT_SIZE);
    let catalog = facts::nominal_catalog();
    // One for all: graphs share most of their shaders.
    let mut planner = Planner::default();
    let mut outcome = Outcome::Done;
    for graph in graphs {
        match planner.plan(graph, &args.set, &facts, &catalog) {
            Ok(plan) => println!(
                "{graph}: OK, {} passes once and {} every frame, {} shaders",
                plan.prologue.len(),
                plan.frame.len(),
                plan.shaders.len()
            ),
            Err(errors) => {
                outcome = Outcome::Failed;
                eprintln!("{}", errors.text(colour()).trim_end());
                println!("{graph}: {} errors", errors.count);
            }
        }
    }
    Ok(outcome)
}
