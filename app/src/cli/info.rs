//! Runs `splatgraph info`: reports the contents, the flaws and the memory of a scene.

use super::advise::{bands_text, keys_text};
use super::cameras;
use super::loading;
use super::look_at::{named, numbers};
use super::options::{self, Drawing, MemoryArgs};
use super::outcome::{Outcome, Usage};
use crate::draw::camera::{common_view, mean_up};
use crate::draw::facts::{self, SceneFacts};
use crate::draw::fit::{self, Fit, Target, Wanted};
use crate::draw::keys;
use crate::draw::planner::Planner;
use crate::draw::storage::{Choice, StorageError};
use crate::io::load::LoadOptions;
use crate::io::losses;
use crate::studies::advise::{Description, describe};
use anyhow::Result;
use serde_json::{Value as Json, json};
use splatgraph_assets::{Camera, Mesh, Scene, ScenePart, SortKey, grouped};
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
/// unusual splats. It shows the range that a sort key must resolve, of depths or of distances from the camera, for the
/// cameras: by default, the first beside the scene, or one that frames it. It gives a width of depth keys that is
/// sufficient to keep overlapping splats in order, and the change of the colours by each band of spherical harmonics,
/// with splats weighted by opacity times area (see `advise --help`). It also reports whether the scene fits the device,
/// and if not, the number of splats that fit.
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
    let named_by_option = given.clone().filter(|_| args.drawing.cameras.is_some());
    let up = named_by_option.as_deref().and_then(mean_up);
    let in_scene = given.map(|cameras| loading::in_scene(&cameras, &scene));
    let cameras = in_scene.unwrap_or_else(|| vec![loading::framing(&scene)]);
    let Description { report, keys: needs, bands } = describe(&scene, &cameras, 0);

    let own_size = cameras.first().map_or(facts::DEFAULT_SIZE, |c| (c.width, c.height));
    let size = args.drawing.size.unwrap_or(own_size);
    let (key_bits, key_text) = default_keys(&scene);
    let worksheet = format!(
        "{}: {}\n{report}{}  default key width     {key_bits} bits{key_text}\n{}{}{}",
        args.scene.display(),
        scene.size_breakdown(),
        keys_text(&needs, 0),
        bands_text(&bands),
        named_by_option.map(|cameras| up_text(&cameras, &scene)).unwrap_or_default(),
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
        let memory = memory(&dump, &fits[0], size);
        let fits: String =
            fits.iter().map(|fit| format!("\n{fit}{}", fit.advice(&args.scene, &args.load))).collect();
        let chosen = chosen.map_or_else(String::new, |choice| format!("{choice}\n"));
        options::write_text(None, &format!("\n{chosen}{memory}{fits}"))?;
    }
    Ok(Outcome::Done)
}

/// Returns the default width of depth keys, and what is known about it.
fn default_keys(scene: &Scene) -> (u32, &'static str) {
    match scene.notes().key_of {
        SortKey::Depth => (
            keys::of_scene(&scene.bounds()),
            " (`scene.key_bits`): with float_bits, every view is in the exact order",
        ),
        SortKey::Distance => (*keys::WIDTHS.end(), ", because the splats are sorted by distance"),
    }
}

/// Describes one entry of a list of scenes: its file, the first index of its splats (as in the output `index`), and
/// their number.
fn part(part: &ScenePart) -> Json {
    json!({ "file": options::text_of(&part.file), "first": part.splats.start, "count": part.splats.len() })
}

/// Describes the mean up direction of the cameras. For a scene without the tag `up`, adds how to correct its direction,
/// if the mean differs by more than a degree.
fn up_text(cameras: &[Camera], scene: &Scene) -> String {
    let mean = mean_up(cameras);
    let text = mean.map_or_else(|| "none, because they cancel out".into(), numbers);
    let rotation = mean.and_then(|up| losses::upright(up.into())).map(|(rotation, _)| rotation);
    let advice = match (common_view(cameras), mean, rotation) {
        _ if scene.notes().up.is_some() => String::new(),
        (_, Some(_), None) => String::new(),
        (Some(forward), _, rotation) => {
            let (along, up) = (named(forward), named(-forward));
            let otherwise =
                rotation.map(|rotation| format!(", otherwise {rotation} turns the scene upright"));
            let otherwise = otherwise.unwrap_or_default();
            format!(
                "; all cameras look along {along}: if that is down, `convert --tag up={up}` records it{otherwise}"
            )
        }
        // A rotation would move a georeferenced scene elsewhere.
        (None, Some(up), Some(_)) if scene.offset() != [0.0; 3] => {
            format!("; `convert --tag up={}` records it", named(up))
        }
        (None, _, Some(rotation)) => format!("; {rotation} turns the scene upright"),
        (None, None, None) => String::new(),
    };
    format!("  up of the cameras     {text}{advice}\n")
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
///
/// `fit` has the sums in which memory that several resources share counts once.
fn memory(dump: &Dump, fit: &Fit, (width, height): (u32, u32)) -> String {
    let mut text = format!("on the GPU with {}, {width} x {height}\n", dump.graph);
    let mut all = 0;
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
        all += if ends { 0 } else { sum };
        text += &format!("  {title}: {} bytes\n", grouped(sum));
        for r in resources {
            text += &format!("    {:<24}{:>28}{:>18}\n", r.name, r.shape, grouped(r.bytes));
        }
    }
    let shared = [fit.needed_bytes, fit.needed_bytes + fit.loading_bytes];
    let [all, stays, peak] = [all, shared[0], shared[1]].map(grouped);
    text + &format!(
        "  sum: {all} bytes; with shared memory, {stays}, and {peak} until the first frame is drawn\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::{FileNotes, synth};

    #[test]
    fn a_scene_is_turned_by_cameras_only_if_they_look_around_and_it_has_neither_tag_nor_place() {
        let looking = |up: [f64; 3], eyes: &[[f64; 3]]| -> Vec<Camera> {
            eyes.iter().map(|eye| Camera::looking_at_upright(*eye, [0.0; 3], up, 60.0, (64, 48))).collect()
        };
        let oblique = looking([0.0, 0.0, 1.0], &[[5.0, 0.0, 4.0], [-5.0, 0.0, 4.0]]);
        let north = looking([0.0, 1.0, 0.0], &[[0.1, 0.0, 5.0], [-0.1, 0.0, 5.0]]);
        let scene = || synth::generate("uniform", 50, 0).unwrap();
        let (near, far) = (scene(), scene().with_offset([5e5, 5.4e6, 0.0]));
        let tagged = scene().with_notes(FileNotes { up: Some([0.0, 0.0, 1.0]), ..FileNotes::default() });
        let turns = "`convert --transform rotate:1,0,0,90` turns the scene upright";
        assert!(up_text(&oblique, &near).contains("turns the scene upright"));
        assert!(up_text(&oblique, &far).ends_with("; `convert --tag up=z` records it\n"));
        for (cameras, scene) in [(&oblique, &tagged), (&north, &tagged)] {
            assert!(!up_text(cameras, scene).contains("convert"));
        }
        let down =
            "0,1,0; all cameras look along -z: if that is down, `convert --tag up=z` records it, otherwise";
        let told = up_text(&north, &near);
        assert!(told.contains(down) && !told.contains(turns), "{told}");
    }
}
