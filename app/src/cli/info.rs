//! Runs `splatgraph info`: reports the contents, the flaws and the memory of a scene.

use super::advise::{bands_text, keys_text};
use super::cameras;
use super::loading;
use super::options::{self, Drawing, MemoryArgs};
use super::outcome::{Outcome, Usage};
use crate::draw::camera::mean_up;
use crate::draw::facts::{self, SceneFacts};
use crate::draw::fit::{self, Target, Wanted};
use crate::draw::keys;
use crate::draw::planner::Planner;
use crate::draw::storage::{Choice, StorageError};
use crate::io::load::LoadOptions;
use crate::io::losses;
use crate::studies::advise::{Description, describe};
use anyhow::Result;
use glam::DVec3;
use serde_json::{Value as Json, json};
use splatgraph_assets::{Mesh, ScenePart, grouped};
use splatgraph_framework::dump::{self, Dump};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  splatgraph info scene.ply
  splatgraph info scene.ply --cameras cameras.json --pipeline key16
  splatgraph info scene.ply --memory 500MB       # the storage that fits
  splatgraph info scene.ply --json";

/// Show the size breakdown of a scene file, its flaws, and the GPU memory that a graph needs for it
///
/// The size breakdown accounts for every byte of the file: fields x bytes x splats. The report counts dropped and
/// unusual splats. It shows the depth range that a sort key must resolve, for the cameras: by default, the first beside
/// the scene, or one that frames it. It gives a width of depth keys that is sufficient to keep overlapping splats in
/// order, and the change of the colours by each band of spherical harmonics, with splats weighted by opacity times area
/// (see `advise --help`). It also reports whether the scene fits the device, and if not, the number of splats that fit.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[arg(help = options::scene_help())]
    scene: PathBuf,
    #[command(flatten)]
    drawing: Drawing,
    #[command(flatten)]
    memory: MemoryArgs,
    /// Build the plan for this device: a part of its name, its index in `splatgraph devices`, a name listed by
    /// `splatgraph check --help`, or a file from `splatgraph devices --json` [default: this machine's, or the least
    /// capable supported one]
    #[arg(long, value_name = "NAME|INDEX|FILE")]
    device: Option<String>,
    /// Print JSON, or write it to a file
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
    #[command(flatten)]
    pub(super) load: LoadOptions,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let mut guard = options::claim_inputs(Some(&args.scene), args.drawing.cameras.as_deref())?;
    guard.input("the graph", Path::new(&args.drawing.pipeline)).map_err(Usage::from)?;
    args.json.iter().try_for_each(|path| guard.output("--json", path)).map_err(Usage::from)?;
    let scene = loading::load_scene(&args.scene, &args.load)?;
    let given =
        cameras::load(args.drawing.cameras.as_deref(), Some(&args.scene), args.drawing.ignore_distortion)?;
    // The picture has the size of the first camera.
    let first = given.iter().flatten().next().filter(|_| args.drawing.size.is_none());
    first.map_or(Ok(()), cameras::check_size)?;
    let up = given.as_deref().filter(|_| args.drawing.cameras.is_some()).and_then(mean_up);
    let in_scene = given.map(|cameras| loading::in_scene(&cameras, &scene));
    let cameras = in_scene.unwrap_or_else(|| vec![loading::framing(&scene)]);
    let Description { report, keys: needs, bands } = describe(&scene, &cameras, 0);

    let own_size = cameras.first().map_or(facts::DEFAULT_SIZE, |c| (c.width, c.height));
    let size = args.drawing.size.unwrap_or(own_size);
    let key_bits = keys::of_scene(&scene.bounds());
    let worksheet = format!(
        "{}: {}\n{report}{}  default key width     {key_bits} bits (`scene.key_bits`): with float_bits, every view is in the exact order\n{}{}{}",
        args.scene.display(),
        scene.size_breakdown(),
        keys_text(&needs, 0),
        bands_text(&bands),
        up.map(|up| up_text(up, scene.up().into())).unwrap_or_default(),
        scene.mesh().map(mesh_text).unwrap_or_default()
    );
    if args.json.is_none() {
        // The report of the scene itself needs neither graph nor device.
        options::write_text(None, &worksheet)?;
    }
    let mut device = match args.device.as_deref() {
        Some(wanted) => options::target(Some(wanted))?,
        // Without a device, assume the least capable supported one.
        None => options::target(None).unwrap_or_else(|_| Target::nominal()),
    };
    let catalog = facts::catalog(&scene);
    let scene_facts = SceneFacts::of(&scene);
    let mut planner = Planner::default();
    let (mut set, limit) = (args.drawing.set.clone(), args.memory.memory);
    let facts = facts::facts(&scene_facts, &device.facts, size);
    let plan = |set: &[_]| planner.plan(&args.drawing.pipeline, set, &facts, &catalog);
    let (chosen, built) = match Choice::within(limit, &device.heap, &set, plan) {
        Ok(found) => found.unzip(),
        // The fit reports how many splats the smallest storage has room for, or the graph's errors.
        Err(StorageError::TooLarge { set: smallest, .. }) => {
            set.extend(smallest);
            (None, None)
        }
        Err(StorageError::Plan(_)) => (None, None),
    };
    let chosen = chosen.filter(|choice| limit.is_some() || choice.set.is_some());
    set.extend(chosen.iter().filter_map(|choice| choice.set.clone()));
    device = device.limited(limit);
    let wanted =
        Wanted { graph: &args.drawing.pipeline, set: &set, scene: scene_facts, catalog: &catalog, size };
    let (plan, fit) = fit::fit(&mut planner, &wanted, &device, built)?;
    let mut fits = vec![fit];
    // Also report the least capable supported device, if the scene does not fit it.
    if args.device.is_none()
        && limit.is_none()
        && device != Target::nominal()
        && let Ok((_, fit)) = fit::fit(&mut planner, &wanted, &Target::nominal(), None)
        && !fit.fits
    {
        fits.push(fit);
    }
    let dump = dump::dump(&plan);

    if let Some(path) = &args.json {
        let buffers: Vec<_> = dump
            .resources
            .iter()
            .map(|r| json!({ "name": r.name, "bytes": r.bytes, "shape": r.shape, "source": r.source, "freed": r.freed }))
            .collect();
        let size_breakdown = scene.size_breakdown();
        let all = json!({
            "scene": options::text_of(&args.scene),
            "size_breakdown": size_breakdown,
            "accounted_bytes": size_breakdown.sum(),
            "report": report,
            "keys": needs,
            "key_bits": key_bits,
            "bands": bands,
            "cameras_up": up.map(<[f64; 3]>::from),
            "pipeline": plan.name,
            "scenes": scene.parts().iter().map(part).collect::<Vec<_>>(),
            "storage": chosen.as_ref().map(Choice::json),
            "size": [size.0, size.1],
            "buffers": buffers,
            "fits": fits,
        });
        options::write_json(path, &all)?;
    } else {
        let fits: String =
            fits.iter().map(|fit| format!("\n{fit}{}", fit.advice(&args.scene, &args.load))).collect();
        let chosen = chosen.map_or_else(String::new, |choice| format!("{choice}\n"));
        options::write_text(None, &format!("\n{chosen}{}{fits}", memory(&dump, size)))?;
    }
    Ok(Outcome::Done)
}

/// Describes one entry of a list of scenes: its file, the first index of its splats (as in the output `index`), and
/// their number.
fn part(part: &ScenePart) -> Json {
    json!({ "file": options::text_of(&part.file), "first": part.splats.start, "count": part.splats.len() })
}

/// Describes the mean up direction of the cameras. If the scene's differs by more than a degree, adds the rotation, if
/// any, that turns the scene upright.
fn up_text(up: DVec3, of_scene: DVec3) -> String {
    let [x, y, z] = up.to_array().map(|v| (v * 1e4).round() / 1e4 + 0.0);
    let differs = up.angle_between(of_scene).to_degrees() > 1.0;
    let advice = losses::upright(up.into()).filter(|_| differs);
    let advice =
        advice.map(|(rotation, _)| format!("; {rotation} turns the scene upright")).unwrap_or_default();
    format!("  up of the cameras     {x},{y},{z}{advice}\n")
}

fn mesh_text(mesh: &Mesh) -> String {
    let count = |n: usize| grouped(n as u64);
    format!(
        "  mesh                  {} triangles of {} vertices, {} materials, {} texels\n",
        count(mesh.triangles.len()),
        count(mesh.positions.len()),
        mesh.materials.len(),
        count(mesh.texels.len())
    )
}

/// Formats the sizes of the plan's buffers and images, grouped by source, with sums.
fn memory(dump: &Dump, (width, height): (u32, u32)) -> String {
    let mut text = format!("on the GPU with {}, {width} x {height}\n", dump.graph);
    let (mut all, mut freed) = (0, 0);
    for (source, ends, title) in [
        ("scene", false, "of the scene"),
        ("transient", false, "of the graph"),
        ("frame", false, "of the host, per frame in flight"),
        ("live", false, "live parameters, per frame in flight"),
        ("readback", false, "statistics for the host, per frame in flight"),
        ("scene", true, "of the scene, freed once the first frame is drawn"),
        ("transient", true, "of the graph, freed once the first frame is drawn"),
    ] {
        let resources: Vec<_> =
            dump.resources.iter().filter(|r| r.source == source && r.freed == ends).collect();
        if resources.is_empty() {
            continue;
        }
        let sum: u64 = resources.iter().map(|r| r.bytes).sum();
        *(if ends { &mut freed } else { &mut all }) += sum;
        text += &format!("  {title}: {} bytes\n", splatgraph_assets::grouped(sum));
        for r in resources {
            text +=
                &format!("    {:<24}{:>28}{:>18}\n", r.name, r.shape, splatgraph_assets::grouped(r.bytes));
        }
    }
    let [stays, peak] = [all, all + freed].map(splatgraph_assets::grouped);
    text + &format!("  sum: {stays} bytes, {peak} until the first frame is drawn\n")
}
