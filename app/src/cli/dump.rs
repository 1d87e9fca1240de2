//! `splatgraph dump`: the plan of a graph, for people and programs.

use super::Outcome;
use super::options;
use crate::facts::{self, SceneFacts};
use crate::planner::Planner;
use anyhow::{Context, Result};
use clap::ValueEnum;
use splatgraph_framework::build::Facts;
use splatgraph_framework::dump;
use splatgraph_vulkan::Vulkan;
use std::path::PathBuf;

pub const EXAMPLES: &str = "Examples:
  splatgraph dump splat                                    # passes, barriers and resources
  splatgraph dump digit4 --scene scene.ply --size 1920x1080
  splatgraph dump splat --set digit_bits=11 --format json
  splatgraph dump my/graph.ron --format dot | dot -Tsvg > graph.svg";

/// Show the plan that a graph becomes: passes in order, barriers, resources
///
/// Needs no GPU: without --device the plan is for a device with the least limits that the built-in graphs run on and
/// subgroups of 32 lanes, without --scene for a million splats with spherical harmonics of degree 3.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The graph: a built-in one's name (see --help), or a path
    #[arg(value_name = "NAME")]
    graph: String,
    /// Change a parameter of the graph; can be given several times
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
    /// The scene whose facts (number of splats, degree of the harmonics) the plan is for
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// The device whose limits the plan is for: a part of its name, or its index in `splatgraph devices`
    #[arg(long, value_name = "NAME|INDEX")]
    device: Option<String>,
    /// Size of the pictures
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "960x540", value_parser = options::size)]
    size: (u32, u32),
    #[arg(long, value_enum, default_value_t = Form::Text)]
    format: Form,
    /// Where it goes [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// The form of a dump.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Form {
    /// To read
    Text,
    /// For programs; everything that the others show
    Json,
    /// A picture of passes and resources, for Graphviz
    Dot,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let (scene, catalog) = match &args.scene {
        Some(path) => {
            let scene = options::load_scene(path)?;
            (SceneFacts::of(&scene), facts::catalog(&scene))
        }
        None => (SceneFacts::NOMINAL, facts::nominal_catalog()),
    };
    let device = device_facts(args.device.as_deref())?;
    let facts = facts::facts(&scene, &device, args.size);
    let plan = Planner::default().plan(&args.graph, &args.set, &facts, &catalog)?;
    let text = match args.format {
        Form::Text => dump::text(&dump::dump(&plan)),
        Form::Json => format!("{:#}\n", dump::json(&plan)),
        Form::Dot => dump::dot(&dump::dump(&plan)),
    };
    options::write_text(args.output.as_deref(), &text)?;
    Ok(Outcome::Done)
}

/// The facts of the device that is named, or of the portable one.
pub fn device_facts(wanted: Option<&str>) -> Result<Facts> {
    let Some(wanted) = wanted else {
        return Ok(facts::portable_device(facts::USUAL_SUBGROUP_SIZE));
    };
    let options = splatgraph_vulkan::Options { device: Some(wanted.to_owned()), ..Default::default() };
    let device = Vulkan::open(&options).context("the device's limits are not known")?;
    Ok(splatgraph_api::Device::info(&device).facts.clone())
}
