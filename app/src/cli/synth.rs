//! Runs `splatgraph synth`: generates scenes.

use super::Usage;
use super::{Outcome, options};
use crate::demo;
use crate::image::make_folder_of;
use anyhow::{Context, Result};
use splatgraph_assets::grouped;
use splatgraph_assets::{Camera, synth};
use std::path::PathBuf;

pub const EXAMPLES: &str = "Examples:
  splatgraph synth                                         # the list
  splatgraph synth demo -o demo.ply --cameras demo.cameras.json
  splatgraph synth uniform --count 1000000 --seed 7 -o uniform.ply
  splatgraph synth --enlarge scene.ply --count 5000000 -o large.ply";

/// Generate a scene
///
/// The same arguments give the same scene, on any machine. Without NAME, the scenes are listed.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Name of the scene
    #[arg(conflicts_with = "enlarge")]
    name: Option<String>,
    /// The .ply file to write, in the layout of the reference implementation
    #[arg(short, long, value_name = "OUT.ply")]
    output: Option<PathBuf>,
    /// Number of splats [default: as listed]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    count: Option<u32>,
    /// Seed of the random numbers
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Also write the scene's cameras
    #[arg(long, value_name = "CAMERAS.json", conflicts_with = "enlarge")]
    cameras: Option<PathBuf>,
    /// Enlarge this scene to --count splats, with copies scattered inside its splats
    #[arg(long, value_name = "SCENE.ply", requires = "count")]
    enlarge: Option<PathBuf>,
}

/// Lists the scenes, for help.
pub fn generator_list() -> String {
    let row = |g: &synth::Generator| {
        (g.name.to_owned(), format!("{} ({} splats)", g.summary, grouped(g.default_count.into())))
    };
    format!("Scenes:\n{}", options::two_columns(synth::generators().iter().map(row).collect()))
}

pub fn run(args: &Args) -> Result<Outcome> {
    let (scene, cameras) = match (&args.name, &args.enlarge, args.count) {
        (None, Some(path), Some(count)) => (synth::enlarge(&options::load_scene(path)?, count)?, None),
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
    let Some(output) = &args.output else {
        return Err(Usage("missing output file: add -o OUT.ply".into()).into());
    };
    if !output.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply")) {
        return Err(Usage(format!(
            "expected a file name with the extension .ply, found {}",
            output.display()
        ))
        .into());
    }
    demo::write(&scene, output).with_context(|| format!("{} cannot be written", output.display()))?;
    options::print(&format!(
        "{}: {} splats, {} bytes",
        output.display(),
        grouped(scene.count().into()),
        grouped(scene.size_breakdown().file_bytes)
    ))?;
    if let (Some(path), Some(cameras)) = (&args.cameras, cameras) {
        make_folder_of(path)?;
        Camera::save(&cameras, path)?;
        options::print(&format!("{}: {} cameras", path.display(), cameras.len()))?;
    }
    Ok(Outcome::Done)
}
