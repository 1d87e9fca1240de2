//! Runs `splatgraph synth`: generates scenes.

use super::Usage;
use super::{Outcome, options};
use crate::io::output::{self, OutputGuard, is_standard_output, note, say};
use anyhow::Result;
use splatgraph_assets::grouped;
use splatgraph_assets::synth;
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
    /// The .ply file to write, in the layout of the reference implementation; `-` is standard output
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

/// Checks the files of the command line, before a scene is made.
pub(super) fn check_files(args: &Args) -> Result<(), Usage> {
    let mut guard = OutputGuard::default();
    if let Some(path) = &args.enlarge {
        guard.input("the scene", path)?;
    }
    let Some(output) = &args.output else {
        return match (&args.name, &args.enlarge) {
            (None, None) => Ok(()),
            _ => Err(Usage("missing output file: add -o OUT.ply".into())),
        };
    };
    if is_standard_output(output) {
        options::refuse_terminal("the scene")?;
    } else if !output.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply")) {
        return Err(Usage(format!(
            "expected a file name with the extension .ply, found {}",
            output.display()
        )));
    }
    guard.output("--output", output)?;
    if let Some(path) = &args.cameras {
        guard.output("--cameras", path)?;
    }
    Ok(())
}

pub fn run(args: &Args) -> Result<Outcome> {
    check_files(args)?;
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
    let Some(output) = &args.output else { return Ok(Outcome::Done) };
    let data_on_stdout =
        [args.output.as_deref(), args.cameras.as_deref()].into_iter().flatten().any(is_standard_output);
    let tell = |line: String| if data_on_stdout { say(line) } else { note(line) };
    output::write(output, |mut out| Ok(scene.write_ply_to(&mut out)?))?;
    tell(format!(
        "{}: {} splats, {} bytes",
        output.display(),
        grouped(scene.count().into()),
        grouped(scene.size_breakdown().file_bytes)
    ));
    if let (Some(path), Some(cameras)) = (&args.cameras, cameras) {
        // In the world's coordinates, as the scene's file is.
        let world = cameras.iter().map(|camera| camera.relative_to(scene.offset().map(|v| -v)));
        options::write_json(path, &serde_json::to_value(world.collect::<Vec<_>>())?)?;
        tell(format!("{}: {} cameras", path.display(), cameras.len()));
    }
    Ok(Outcome::Done)
}
