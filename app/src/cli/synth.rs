//! Runs `splatgraph synth`: generates scenes.

use super::loading;
use super::look_at;
use super::options::{self, Listed};
use super::outcome::{self, Outcome, Usage, refuse_without};
use super::stdout::Stdout;
use crate::draw::orbit::Orbit;
use crate::draw::truth::Truth;
use crate::io::load::LoadOptions;
use crate::io::output::{self, OutputGuard, is_standard_output, note, shell_word};
use crate::io::{losses, own_file};
use anyhow::{Context, Result};
use splatgraph_assets::{Camera, Dataset, grouped, synth};
use splatgraph_reference::Rules;
use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  splatgraph synth                                         # the list
  splatgraph synth demo -o demo.ply --cameras demo.cameras.json
  splatgraph synth ring -o ring.glb                        # a mesh to draw beside it
  splatgraph synth uniform --count 1000000 --seed 7 -o uniform.ply
  splatgraph synth --enlarge scene.ply --count 5000000 -o large.ply
  splatgraph synth --photograph scene.ply --dataset views/ # a COLMAP dataset of its pictures";

/// Generate a scene
///
/// The same arguments give the same scene, on any machine. Without NAME, the scenes are listed.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Name of the scene
    #[arg(conflicts_with_all = ["enlarge", "photograph"], value_parser = Listed(names, |name| Ok(name.to_owned())))]
    #[arg(hide_possible_values = true)]
    name: Option<String>,
    /// The file to write: .ply in the layout of the reference implementation, .glb for a mesh; `-` is standard output
    #[arg(short, long, value_name = "OUT.ply")]
    output: Option<PathBuf>,
    /// Number of splats [default: as listed]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    count: Option<u32>,
    /// Seed of the random numbers
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Also write the scene's cameras; `-` is standard output
    #[arg(long, value_name = "CAMERAS.json", conflicts_with = "enlarge")]
    cameras: Option<PathBuf>,
    /// Enlarge this scene to --count splats by copies scattered inside its splats
    #[arg(long, value_name = "SCENE.ply", requires = "count")]
    enlarge: Option<PathBuf>,
    /// Make a COLMAP dataset (--dataset) of exact pictures of this scene, from cameras on a circle around it
    #[arg(long, value_name = "SCENE", requires = "dataset", conflicts_with_all = ["enlarge", "output", "cameras", "count"])]
    photograph: Option<PathBuf>,
    /// Folder of the COLMAP dataset: images/ and sparse/0/, as text; it must not contain another dataset
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    /// Number of photographs of --photograph [default: 24]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    views: Option<u32>,
    /// Size of the photographs [default: 480x270]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = options::size)]
    size: Option<(u32, u32)>,
    #[command(flatten)]
    load: LoadOptions,
}

fn names() -> Vec<&'static str> {
    synth::generators().iter().map(|generator| generator.name).chain([synth::MESH.0]).collect()
}

pub fn generator_list() -> String {
    let row = |g: &synth::Generator| {
        (g.name.to_owned(), format!("{} ({} splats)", g.summary, grouped(g.default_count.into())))
    };
    let (name, summary) = synth::MESH;
    let rows = synth::generators().iter().map(row).chain([(name.to_owned(), summary.to_owned())]);
    format!("Scenes:\n{}", super::help::two_columns(rows.collect()))
}

/// Checks the files of the command line before a scene is generated.
pub(super) fn check_files(args: &Args) -> Result<(), Usage> {
    if is_mesh(args) {
        let given = [
            ("--count", args.count.is_some()),
            ("--seed", args.seed != 0),
            ("--cameras", args.cameras.is_some()),
        ];
        outcome::refuse(&given, |option| {
            format!("expected {option} with a scene of splats, found the mesh `{}`", synth::MESH.0)
        })?;
    }
    let mut guard = OutputGuard::default();
    if let Some(path) = &args.enlarge {
        guard.scene("the scene", path)?;
    }
    if let (Some(path), Some(folder)) = (&args.photograph, &args.dataset) {
        guard.scene("the scene", path)?;
        return photographs(args, folder).iter().try_for_each(|path| Ok(guard.output("--dataset", path)?));
    }
    let options = [
        ("--dataset", args.dataset.is_some()),
        ("--views", args.views.is_some()),
        ("--size", args.size.is_some()),
    ];
    refuse_without("--photograph", &options)?;
    let drops = args.load.condition.is_some() && args.enlarge.is_none();
    refuse_without("--photograph or --enlarge", &[("--where", drops)])?;
    let Some(output) = &args.output else {
        return match (&args.name, &args.enlarge) {
            (None, None) => Ok(()),
            _ => Err(Usage("missing output file: add -o OUT.ply".into())),
        };
    };
    if is_standard_output(output) {
        options::refuse_terminal("the scene")?;
    } else if !output.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension(args))) {
        return Err(Usage(format!(
            "expected a file name with the extension .{}, found {}",
            extension(args),
            output.display()
        )));
    }
    guard.output("--output", output)?;
    if let Some(path) = &args.cameras {
        guard.output("--cameras", path)?;
    }
    Ok(())
}

/// Rejects a folder with files of another dataset. Its photographs would stay among the new ones, and its model could
/// be read instead of the new one. The same command may run again.
fn refuse_other(folder: &Path, photographs: &[PathBuf], model: &[(PathBuf, String)]) -> Result<(), Usage> {
    let entries = |below: &str| {
        let entries = fs::read_dir(folder.join(below)).into_iter().flatten().flatten();
        // Hidden files belong to the system, or were left by an interrupted run.
        let visible = entries.filter(|entry| !entry.file_name().as_encoded_bytes().starts_with(b"."));
        visible.map(|entry| entry.path())
    };
    let photographs: HashSet<&PathBuf> = photographs.iter().collect();
    let is_written = |path: &PathBuf| {
        let text = model.iter().find(|(own, _)| own == path).map(|(_, text)| text.as_bytes());
        text.is_some_and(|text| own_file::read(path).is_ok_and(|found| found == text))
    };
    let found = ["cameras.bin", "cameras.txt", "transforms.json", "transforms_train.json", "cameras.json"]
        .map(|name| folder.join(name))
        .into_iter()
        .filter(|path| path.exists())
        .chain(entries("images").filter(|path| !photographs.contains(path)))
        .chain(entries("sparse").filter(|path| !path.ends_with("0")))
        .chain(entries("sparse/0").filter(|path| !is_written(path)))
        .next();
    found.map_or(Ok(()), |path| {
        let path = path.display();
        Err(Usage(format!(
            "expected --dataset without files of another dataset, found {path}; name a new folder"
        )))
    })
}

fn extension(args: &Args) -> &'static str {
    if is_mesh(args) { "glb" } else { "ply" }
}

fn is_mesh(args: &Args) -> bool {
    args.name.as_deref() == Some(synth::MESH.0)
}

fn write_mesh(output: &Path) -> Result<Outcome> {
    let mesh = synth::mesh();
    let mut bytes = Vec::new();
    mesh.write_glb(&mut bytes)?;
    output::write_bytes(output, &bytes)?;
    let (triangles, length) = (grouped(mesh.triangles.len() as u64), grouped(bytes.len() as u64));
    let line = format!("{}: {triangles} triangles, {length} bytes", output.display());
    Stdout::of([output]).line(&line)?;
    Ok(Outcome::Done)
}

fn photographs(args: &Args, folder: &Path) -> Vec<PathBuf> {
    let name = |index| folder.join("images").join(format!("view-{index:04}.png"));
    (0..args.views.unwrap_or(24)).map(name).collect()
}

/// Draws a scene exactly from a circle of cameras, and writes a COLMAP dataset of the pictures and cameras.
fn photograph(args: &Args, scene: &Path, folder: &Path) -> Result<Outcome> {
    let scene = loading::load_scene(scene, &args.load)?;
    let (width, height) = args.size.unwrap_or((480, 270));
    let paths = photographs(args, folder);
    let framing = Camera::framing(&scene, width, height);
    let around = scene.robust_bounds().center();
    let axis = scene.up();
    let start = Camera::looking_at_upright(framing.position, around, axis, 60.0, (width, height));
    let zoom = look_at::enlargement(&framing);
    let start = Camera { fx: zoom * start.fx, fy: zoom * start.fy, ..start };
    let circle = Orbit { start, around, axis };
    let mut cameras = look_at::on_circle(&circle, paths.len());
    for (camera, path) in cameras.iter_mut().zip(&paths) {
        camera.img_name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    }
    let world: Vec<Camera> = cameras.iter().map(|camera| camera.in_world(scene.offset())).collect();
    let model =
        Dataset::colmap_text(&world, "png")?.map(|(name, text)| (folder.join("sparse/0").join(name), text));
    refuse_other(folder, &paths, &model)?;
    // Remove the old model first: an interrupted run must not leave one, because its photographs may be of two scenes.
    for (path, _) in model.iter().filter(|(path, _)| path.exists()) {
        fs::remove_file(path).with_context(|| path.display().to_string())?;
    }
    for (camera, path) in cameras.iter().zip(&paths) {
        Truth::draw(&scene, camera, [0.0; 3], &Rules::of(&scene))?.image().save(path)?;
    }
    for (path, text) in &model {
        output::write_bytes(path, text.as_bytes())?;
    }
    note(format!("{}: {} photographs of {width} x {height}", folder.display(), paths.len()));
    Ok(Outcome::Done)
}

pub fn run(args: &Args) -> Result<Outcome> {
    check_files(args)?;
    if let (Some(scene), Some(folder)) = (&args.photograph, &args.dataset) {
        return photograph(args, scene, folder);
    }
    if let Some(output) = args.output.as_ref().filter(|_| is_mesh(args)) {
        return write_mesh(output);
    }
    let (scene, views) = match (&args.name, &args.enlarge, args.count) {
        (None, Some(path), Some(count)) => {
            (synth::enlarge(&loading::load_scene(path, &args.load)?, count)?, None)
        }
        (Some(name), ..) => {
            let generator = synth::generators().iter().find(|g| g.name == *name);
            let count = args.count.or(generator.map(|g| g.default_count)).unwrap_or(1);
            (synth::generate(name, count, args.seed)?, generator.map(|g| (g.cameras)()))
        }
        _ => {
            options::print(&generator_list())?;
            return Ok(Outcome::Done);
        }
    };
    let Some(output) = &args.output else { return Ok(Outcome::Done) };
    let stdout = Stdout::of([args.output.as_deref(), args.cameras.as_deref()].into_iter().flatten());
    output::write(output, |mut out| Ok(scene.write_ply_to(&mut out)?))?;
    let (splats, bytes) = (losses::splats(scene.count().into()), scene.size_breakdown().file_bytes);
    stdout.line(&format!("{}: {splats}, {} bytes", output.display(), grouped(bytes)))?;
    if args.cameras.is_none() && views.is_some() && !is_standard_output(output) {
        let path = output.with_extension("cameras.json");
        let path = shell_word(&path.to_string_lossy());
        note(format!("to write its cameras, too, where other commands find them, add --cameras {path}"));
    }
    if let (Some(path), Some(views)) = (&args.cameras, views) {
        options::write_cameras(path, &views, &scene)?;
        stdout.line(&format!("{}: {} cameras", path.display(), views.len()))?;
    }
    Ok(Outcome::Done)
}
