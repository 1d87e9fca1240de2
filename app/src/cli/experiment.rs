//! Runs `splatgraph experiment`: makes pages that illustrate an equation with measurements.

use super::cameras;
use super::console::Console;
use super::loading;
use super::options::{self, BackendArgs};
use super::outcome::{Outcome, Usage, claim_graph_files};
use super::subject;
use crate::io::load::LoadOptions;
use crate::io::output::{self, OutputGuard, one_line, say};
use crate::io::program;
use crate::studies::experiment;
use crate::studies::experiment::exact::GRAPH;
use crate::studies::study::{Setting, Subject};
use anyhow::Result;
use std::path::PathBuf;

/// Write a page that illustrates an equation of splatting with measurements of a scene
///
/// An experiment changes one thing, draws pictures, and compares them with the exact renderer's. The page contains
/// pictures, differences, tables and the equation, in one file.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph experiment order                     # the demo scene: experiment-order.html
  splatgraph experiment sh scene.ply -c cameras.json#3 -o sh.html
  splatgraph experiment order scene.ply --size 1280x720")]
pub struct Args {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Debug, clap::Subcommand)]
enum Kind {
    /// Blend the splats in four ways, and with depth keys of 8 to 32 bits
    ///
    /// The ways are unsorted, back to front, front to back with the operator for back to front, and front to back. The
    /// page shows pictures, differences, the number of pairs of splats in the wrong order, and the term of the sum that
    /// differs. Only the first camera is drawn.
    Order(Common),
    /// Omit bands of the spherical harmonics in the glossiest part of the scene
    ///
    /// Draws the part of the picture whose colours depend most on the direction, with bands up to each degree of the
    /// scene, from three directions, or from the given cameras if there are several. Compares the error with the sum of
    /// the squared coefficients.
    Sh(Common),
}

/// The options of every experiment.
#[derive(Debug, clap::Args)]
#[command(mut_arg("backend", options::that_draws))]
struct Common {
    #[arg(help = options::optional_scene_help())]
    scene: Option<PathBuf>,
    /// Cameras: a COLMAP folder, a transforms.json, a cameras.json or a glTF file; `#2` or `#NAME` selects one
    /// [default: the first camera beside the scene, or one that frames the scene]
    #[arg(short, long, value_name = "PATH[#INDEX]|JSON")]
    cameras: Option<String>,
    /// Size of the pictures [default: the cameras', at most 640 pixels wide]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = options::size)]
    size: Option<(u32, u32)>,
    /// The page, or `-` for standard output [default: experiment-order.html or experiment-sh.html]
    #[arg(short, long, value_name = "FILE.html")]
    output: Option<PathBuf>,
    #[command(flatten)]
    device: BackendArgs,
    #[command(flatten)]
    load: LoadOptions,
}

/// Maximum width of the pictures without `--size`, in pixels. It is small because a page embeds many pictures.
const WIDTH: u32 = 640;

impl Args {
    fn output(&self) -> PathBuf {
        let (common, _, page) = self.kind.parts();
        common.output.clone().unwrap_or_else(|| page.into())
    }
}

impl Kind {
    /// Returns the options, the study, and the default name of the page.
    fn parts(&self) -> (&Common, experiment::Kind, &'static str) {
        match self {
            Kind::Order(common) => (common, experiment::Kind::Order, "experiment-order.html"),
            Kind::Sh(common) => (common, experiment::Kind::Sh, "experiment-sh.html"),
        }
    }
}

pub fn run(args: &Args) -> Result<Outcome> {
    let (common, kind, _) = args.kind.parts();
    let output = args.output();
    let given = cameras::load(common.cameras.as_deref(), common.scene.as_deref(), false)?;
    let mut guard = guard(args)?;
    let settings = [Setting::of_graph(GRAPH, &[])];
    let scene = (common.scene.as_deref(), &common.load);
    let mut subject = subject::load(common.device.open()?, scene, &settings, given, common.size)?;
    if common.size.is_none() {
        subject.cameras.iter_mut().for_each(|camera| *camera = loading::at_most(camera, WIDTH));
    }
    subject.cameras.iter().try_for_each(cameras::check_size)?;
    claim_graph_files(&mut guard, &subject.check(&settings)?)?;
    let page = experiment::study(&subject, kind, view(&subject), &mut Console::default())?;
    options::write_text(Some(&output), &page.html())?;
    if !output::is_standard_output(&output) {
        say(format!("{}: open it in a browser", output.display()));
    }
    Ok(super::outcome::validated(common.device.validate, &subject.device.close()))
}

fn view(subject: &Subject) -> String {
    let names: Vec<_> = subject.cameras.iter().map(|camera| one_line(&camera.img_name)).collect();
    let size = subject.cameras.first().map_or((0, 0), |camera| (camera.width, camera.height));
    format!(
        "Scene: {}, {} splats. Camera: {}, {} x {} pixels. Device: {}. Version: {}.",
        one_line(&subject.name),
        subject.scene.count(),
        names.join(", "),
        size.0,
        size.1,
        subject.device_name(),
        program::VERSION
    )
}

/// Registers the inputs and the page. An error means that the page would overwrite an input, or cannot be written.
pub(super) fn guard(args: &Args) -> Result<OutputGuard, Usage> {
    let (common, ..) = args.kind.parts();
    let mut guard = options::claim_inputs(common.scene.as_deref(), common.cameras.as_deref())?;
    guard.output("--output", &args.output())?;
    Ok(guard)
}
