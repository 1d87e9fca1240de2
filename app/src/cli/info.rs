//! Runs `splatgraph info`: reports a scene's contents, flaws and memory.

use super::Outcome;
use super::options::{self, Drawing};
use crate::facts::{self, SceneFacts};
use crate::planner::Planner;
use anyhow::Result;
use serde_json::json;
use splatgraph_assets::Report;
use splatgraph_framework::dump::{self, Dump};
use std::path::PathBuf;

pub const EXAMPLES: &str = "Examples:
  splatgraph info scene.ply
  splatgraph info scene.ply --cameras cameras.json --pipeline key16
  splatgraph info scene.ply --json";

/// Show the size breakdown of a scene file, its flaws, and the GPU memory that a graph needs for it
///
/// The size breakdown accounts for every byte of the file: fields x bytes x splats. The report counts dropped and unusual
/// splats, and shows the depth range that a sort key must resolve, for the given cameras or one that frames the scene.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A .ply file in the layout of the reference implementation
    scene: PathBuf,
    #[command(flatten)]
    drawing: Drawing,
    /// Build the plan for this device's limits: a part of its name, or its index in `splatgraph devices`
    #[arg(long, value_name = "NAME|INDEX")]
    device: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let scene = options::load_scene(&args.scene)?;
    let given = args.drawing.cameras()?;
    let cameras = given.clone().unwrap_or_else(|| vec![options::framing(&scene)]);
    let report = Report::new(&scene, &cameras);

    let own_size = cameras.first().map_or(facts::DEFAULT_SIZE, |c| (c.width, c.height));
    let size = args.drawing.size.unwrap_or(own_size);
    let facts = facts::facts(&SceneFacts::of(&scene), &options::device_facts(args.device.as_deref())?, size);
    let plan = Planner::default().plan(
        &args.drawing.pipeline,
        &args.drawing.set,
        &facts,
        &facts::catalog(&scene),
    )?;
    let dump = dump::dump(&plan);

    if args.json {
        let buffers: Vec<_> = dump
            .resources
            .iter()
            .map(|r| json!({ "name": r.name, "bytes": r.bytes, "shape": r.shape, "source": r.source }))
            .collect();
        let size_breakdown = scene.size_breakdown();
        let all = json!({
            "scene": args.scene,
            "size_breakdown": size_breakdown,
            "accounted_bytes": size_breakdown.sum(),
            "report": report,
            "pipeline": plan.name,
            "size": [size.0, size.1],
            "buffers": buffers,
        });
        options::write_text(None, &format!("{all:#}\n"))?;
    } else {
        let text = format!(
            "{}: {}\n{report}\n{}",
            args.scene.display(),
            scene.size_breakdown(),
            memory(&dump, size)
        );
        options::write_text(None, &text)?;
    }
    Ok(Outcome::Done)
}

/// Formats the sizes of the plan's buffers and images by source, each source with its sum.
fn memory(dump: &Dump, (width, height): (u32, u32)) -> String {
    let mut text = format!("on the GPU with {}, {width} x {height}\n", dump.graph);
    let mut all = 0;
    for (source, title) in [
        ("scene", "of the scene"),
        ("transient", "of the graph"),
        ("frame", "of the host, per frame in flight"),
        ("live", "live parameters, per frame in flight"),
        ("readback", "statistics for the host, per frame in flight"),
    ] {
        let resources: Vec<_> = dump.resources.iter().filter(|r| r.source == source).collect();
        if resources.is_empty() {
            continue;
        }
        let sum: u64 = resources.iter().map(|r| r.bytes).sum();
        all += sum;
        text += &format!("  {title}: {} bytes\n", splatgraph_assets::grouped(sum));
        for r in resources {
            text +=
                &format!("    {:<24}{:>28}{:>18}\n", r.name, r.shape, splatgraph_assets::grouped(r.bytes));
        }
    }
    text + &format!("  sum: {} bytes\n", splatgraph_assets::grouped(all))
}
