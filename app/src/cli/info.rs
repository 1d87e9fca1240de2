//! Runs `splatgraph info`: reports a scene's contents, flaws and memory.

use super::Outcome;
use super::advise::{bands_text, keys_text};
use super::options::{self, Drawing};
use crate::draw::facts::{self, SceneFacts};
use crate::draw::fit::{self, Target, Wanted};
use crate::draw::keys::{self, Seen};
use crate::draw::planner::Planner;
use crate::studies::advise::harmonics;
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
/// splats, and shows the depth range that a sort key must resolve, for the given cameras or one that frames the scene; the width
/// at which depth keys put every two splats that overlap there in the right order; and how much each band of spherical
/// harmonics changes the colours. The last lines say whether the scene fits the device, and if not, how many of its splats would.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A scene file: .ply, .compressed.ply, .spz, .splat, .ksplat or .sog
    scene: PathBuf,
    #[command(flatten)]
    drawing: Drawing,
    /// Build the plan for this device: a part of its name, or its index in `splatgraph devices` [default: the smallest supported]
    #[arg(long, value_name = "NAME|INDEX")]
    device: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let scene = options::load_scene(&args.scene)?;
    let given = args.drawing.cameras()?;
    let in_scene = given.map(|cameras| options::in_scene(&cameras, &scene));
    let cameras = in_scene.unwrap_or_else(|| vec![options::framing(&scene)]);
    let report = Report::new(&scene, &cameras);

    let own_size = cameras.first().map_or(facts::DEFAULT_SIZE, |c| (c.width, c.height));
    let size = args.drawing.size.unwrap_or(own_size);
    let needs = keys::needs(&Seen::shown(&scene, &cameras).views(), 0);
    let key_bits = keys::of_scene(&scene.bounds());
    let bands = harmonics::bands(&scene);
    let worksheet = format!(
        "{}: {}\n{report}{}  default key width     {key_bits} bits (`scene.key_bits`): with float_bits, every view is in the exact order\n{}",
        args.scene.display(),
        scene.size_breakdown(),
        keys_text(&needs, 0),
        bands_text(&bands)
    );
    if !args.json {
        // Whatever the graph or the device says, the scene's own part is known.
        options::write_text(None, &worksheet)?;
    }
    let device = match args.device.as_deref() {
        Some(wanted) => options::target(Some(wanted))?,
        None => Target::nominal(),
    };
    let catalog = facts::catalog(&scene);
    let wanted = Wanted {
        graph: &args.drawing.pipeline,
        set: &args.drawing.set,
        scene: SceneFacts::of(&scene),
        catalog: &catalog,
        size,
    };
    let mut planner = Planner::default();
    let (plan, fit) = fit::fit(&mut planner, &wanted, &device)?;
    let mut fits = vec![fit];
    // What the smallest device cannot hold, that of this machine may.
    if args.device.is_none()
        && !fits[0].fits
        && let Ok(found) = options::target(None)
        && let Ok((_, fit)) = fit::fit(&mut planner, &wanted, &found)
    {
        fits.push(fit);
    }
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
            "keys": needs,
            "key_bits": key_bits,
            "bands": bands,
            "pipeline": plan.name,
            "size": [size.0, size.1],
            "buffers": buffers,
            "fits": fits,
        });
        options::write_text(None, &format!("{all:#}\n"))?;
    } else {
        let fits: String = fits.iter().map(|fit| format!("\n{fit}")).collect();
        options::write_text(None, &format!("\n{}{fits}", memory(&dump, size)))?;
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
