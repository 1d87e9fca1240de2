//! Defines the arguments of `splatgraph render`, and checks them before anything is loaded.

use super::destination::{self, Destination, Output, in_folder, per_camera, stem};
use crate::cli::cameras;
use crate::cli::job::ShardArgs;
use crate::cli::loading;
use crate::cli::look_at::LookAtArgs;
use crate::cli::options::{self, DeviceArgs, Drawing, Listed, MemoryArgs};
use crate::cli::outcome::{self, Usage};
use crate::cli::scenes::ScenesArgs;
use crate::cli::stdout::Stdout;
use crate::draw::backend::Api;
use crate::draw::builtin;
use crate::draw::outputs::{NAMES, RGBA, check_format};
use crate::io::image::Format;
use crate::io::output::names::{self, MAX_NAME_BYTES, MIN_ROOM_BYTES};
use crate::io::output::{OutputGuard, is_standard_output, shell_word};
use anyhow::Result;
use clap::builder::{OsStringValueParser, TypedValueParser};
use splatgraph_assets::{Camera, Projection};
use splatgraph_framework::lower::no_output;
use std::fmt;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  splatgraph render -o demo.png                                          # the demo scene
  splatgraph render scene.ply --cameras cameras.json -o pictures/ --format npy
  splatgraph render scene.ply --cameras cameras.json#2 --size 1920x1080 -o out.exr
  splatgraph render scene.ply --cameras garden/ -o pictures/             # the views of a COLMAP dataset
  splatgraph render scene.ply --eye 0,-1,-4 --orbit 60 -o turn/
  splatgraph render garden.ply statue.spz --at 1,0,-2 -o both.png        # two scenes, one sort
  splatgraph render scene.ply --pipeline digit4 --set cutoff=3.0 -o out.png
  splatgraph render scene.ply --repeat 100 --json                        # times, as medians
  splatgraph render scene.ply -o out.png --timeline trace.json           # where the time goes
  splatgraph render scene.ply --inspect keys@scatter=keys.npy -o out.png
  splatgraph render scene.ply --pipeline my/graph.ron --validate -o out.png
  splatgraph render scene.ply --backend reference -o exact.npy           # exactly, on the CPU
  splatgraph render scene.ply -o out.png --output expected_depth=depth.npy --output alpha=alpha.png
  splatgraph render scene.ply --backend reference --rule stop=none --output contributors=count.npy";

/// Draw a scene
///
/// A graph draws the scene on a device. With `--backend reference`, the exact renderer draws it on the CPU, in f64. The
/// default scene is the demo scene, which the first use generates. The default camera is the first beside the scene, or
/// one that frames it.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Output: .png (8 bits), .exr or .npy (float32, as blended, not clamped), or a folder; NAME=FILE for depth, alpha
    /// and others
    #[arg(
        short, long, value_name = "OUT|NAME=FILE", required_unless_present_any = ["json", "inspect"],
        value_parser = OsStringValueParser::new().try_map(destination::output), long_help = destination::output_help()
    )]
    pub(super) output: Vec<Output>,
    /// Format of the files in a folder [default: png for pictures, npy for other outputs]
    #[arg(long, value_name = "png|exr|npy", value_parser = options::picture_format(), hide_possible_values = true)]
    pub(super) format: Option<Format>,
    /// Background colour, display-encoded: 0 is black, 1 is white
    #[arg(long, value_name = "R,G,B|#RRGGBB", default_value = "0,0,0", allow_hyphen_values = true, value_parser = options::colour)]
    pub(super) background: [f32; 3],
    #[command(flatten)]
    pub(super) scenes: ScenesArgs,
    #[command(flatten)]
    pub(super) drawing: Drawing,
    /// Renderer: `vulkan`, `metal` (on Apple's systems), or `reference`, the exact renderer on the CPU
    ///
    /// `vulkan` and `metal` execute the graph on a device. `null` executes nothing, to measure the rest of the program:
    /// its pictures are black, and its GPU times are meaningless. The exact renderer follows the rules of the published
    /// CUDA rasteriser in f64. It shares no arithmetic with the shaders and executes no graph; `--pipeline
    /// orthographic`, `fisheye` and `equirectangular` name its projection. Errors are measured against its pictures.
    #[arg(long, value_name = "NAME", default_value_t = Renderer::Device(Api::default()))]
    #[arg(value_parser = Listed(renderers, renderer), hide_possible_values = true)]
    pub(super) backend: Renderer,
    #[arg(long, value_name = "NAME=VALUE", value_parser = options::setting)]
    #[arg(help = RULE_HELP, long_help = options::rule_help(RULE_HELP))]
    pub(super) rule: Vec<(String, String)>,
    /// Print statistics as JSON, one entry per camera, or write them to FILE
    ///
    /// docs/output-files.md lists the fields. If a camera fails, the others have entries, and the exit code is 1.
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    pub(super) json: Option<PathBuf>,
    /// Write the cameras of the pictures, at their sizes, as a cameras.json: also those of --orbit, and the default one
    #[arg(long, value_name = "FILE")]
    pub(super) write_cameras: Option<PathBuf>,
    /// Record where the time goes: a trace for https://ui.perfetto.dev, and a summary on standard error
    ///
    /// The trace has a track for each thread, one for the passes on the GPU by their timestamps, and one for each frame
    /// in flight. A line of the summary is the time of a step, excluding nested steps.
    #[arg(long, value_name = "FILE.json")]
    pub timeline: Option<PathBuf>,
    /// Number of frames per camera; times are their medians, and the files are of the last one
    ///
    /// If N is above 1, the device is first warmed up for a fifth of a second, unless the picture depends on the number
    /// of frames: the graph has state, such as a history, or a shader reads `camera.frame`. Its times need a large N.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = repeat)]
    pub(super) repeat: u32,
    /// Maximum number of pictures that are drawn but not yet written [default: two per processor]
    ///
    /// The device draws while other threads encode. If memory is short, fewer pictures wait. The number affects neither
    /// the files nor the order of messages.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) jobs: Option<u16>,
    /// Read back a resource after a pass (names as in `dump`), print its range and some words, and write it to FILE.npy
    ///
    /// Meanwhile, resources do not share memory: a pass that reads stale contents may draw another picture than without
    /// --inspect.
    ///
    /// For a ping-pong buffer `keys`, the half that the pass writes is read. `scatter` is the last of
    /// `sort.scatter[0]`, `sort.scatter[1]`, ... For sort keys, the output reports whether they ascend.
    #[arg(long, value_name = "RESOURCE@PASS[=FILE.npy]", value_parser = inspect_request)]
    pub(super) inspect: Vec<InspectRequest>,
    #[command(flatten)]
    pub(super) memory: MemoryArgs,
    #[command(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    pub device: DeviceArgs,
    // The heading would apply to all arguments below.
    #[command(flatten, next_help_heading = "A camera without a file")]
    pub(super) look: LookAtArgs,
}

/// The renderer that `--backend` selects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Renderer {
    Device(Api),
    Reference,
}

const RULE_HELP: &str = "Change a rule of the exact renderer; may be repeated";
const REFERENCE: &str = "reference";

impl fmt::Display for Renderer {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Renderer::Device(api) => api.fmt(f),
            Renderer::Reference => f.write_str(REFERENCE),
        }
    }
}

pub fn renderers() -> Vec<&'static str> {
    Api::ALL.map(Api::name).into_iter().chain([REFERENCE]).collect()
}

pub fn renderer(text: &str) -> Result<Renderer, String> {
    match text {
        REFERENCE => Ok(Renderer::Reference),
        _ => Api::find(text).map(Renderer::Device).ok_or_else(|| Api::refusal(text, &[REFERENCE])),
    }
}

/// Parses the number of frames. It is limited because the times of all frames stay in memory for the medians.
fn repeat(text: &str) -> Result<u32, String> {
    const MAX_FRAMES: u32 = 100_000;
    match text.parse() {
        Ok(frames @ 1..=MAX_FRAMES) => Ok(frames),
        _ => Err(format!(
            "expected 1 to {MAX_FRAMES} frames, because all their times are kept for the medians"
        )),
    }
}

/// Cameras and files of a run that are known before the device is opened.
#[derive(Debug)]
pub struct Work {
    /// Cameras of `--cameras` or of the file beside the scene. `None` for the default camera, and for those of
    /// [`LookAtArgs`].
    pub(super) given: Option<Vec<Camera>>,
    pub(super) destination: Option<Destination>,
    pub(super) stems: Vec<String>,
    pub(super) guard: OutputGuard,
}

/// Reads the cameras, and chooses the names of all files.
///
/// # Errors
/// The cameras cannot be read, or the command line is invalid.
pub fn prepare(args: &Args) -> Result<Work> {
    refuse_options_of_others(args)?;
    let destination = Destination::of(args.picture()?, args.format)?;
    // A camera of `LookAtArgs` replaces the camera beside the scene.
    let looking = args.look.names();
    let scene = args.scenes.scene.as_deref().filter(|_| looking.is_none());
    args.look.check(args.drawing.cameras.as_deref())?;
    let given = if looking.is_none() { args.drawing.cameras(scene)? } else { None };
    let own = || match args.scenes.scene.as_deref() {
        // The camera that frames a scene: pictures of several scenes in a folder need different names.
        Some(scene) if given.is_none() => vec![names::of_scene(scene)],
        scene => loading::camera_names(scene, given.as_deref()),
    };
    let names = looking.unwrap_or_else(own);
    if let (Some(Destination::Picture(path, _)), [_, _, ..]) = (&destination, names.as_slice()) {
        let message = format!(
            "expected one camera for the picture {}, found {}: name a folder, or one camera with --cameras FILE#INDEX",
            path.display(),
            names.len()
        );
        return Err(Usage(message).into());
    }
    if args.picture()?.is_some_and(is_standard_output) {
        options::refuse_terminal("the picture")?;
    }
    if destination.is_none() {
        args.check_folder_formats()?;
    }
    let files: Vec<(&str, &Path)> = args.files().collect();
    // Longest text around a camera's name in a file name: `.png`, or the rest of `keys-NAME.npy`.
    let around = files
        .iter()
        .map(|(_, file)| stem(file).len() + "-.npy".len())
        .chain([".png".len()])
        .max()
        .unwrap_or(0);
    if names.len() > 1 && around + MIN_ROOM_BYTES > MAX_NAME_BYTES {
        let message = format!(
            "a file of --inspect or --output has a name of {around} bytes, which leaves no room for the cameras' names"
        );
        return Err(Usage(message).into());
    }
    let stems = names::unique(&names, MAX_NAME_BYTES.saturating_sub(around));

    let mut guard = OutputGuard::default();
    let mut claim = || -> Result<(), Usage> {
        args.scenes.claim(&mut guard)?;
        cameras::claim(&mut guard, args.drawing.cameras.as_deref(), args.scenes.scene.as_deref())?;
        guard.input("the graph", Path::new(&args.drawing.pipeline))?;
        let written = [
            ("--json", &args.json),
            ("--timeline", &args.timeline),
            ("--write-cameras", &args.write_cameras),
        ];
        for (option, path) in written {
            path.iter().try_for_each(|path| guard.output(option, path))?;
        }
        for stem in &stems {
            if let Some(destination) = &destination {
                guard.output("--output", &destination.path(stem))?;
            }
            for (option, file) in args.files_of(stem, stems.len()) {
                guard.output(option, &file)?;
            }
        }
        Ok(())
    };
    claim()?;
    Ok(Work { given, destination, stems, guard })
}

/// Parsed value `RESOURCE@PASS[=FILE.npy]` of `--inspect`.
#[derive(Clone, Debug)]
pub struct InspectRequest {
    pub resource: String,
    pub pass: String,
    /// File for the contents; `None` to print only a summary.
    pub file: Option<PathBuf>,
}

pub fn inspect_request(text: &str) -> Result<InspectRequest, String> {
    let (target, file) = match text.split_once('=') {
        Some((target, file)) if Format::of(Path::new(file)) == Some(Format::Npy) => {
            (target, Some(file.into()))
        }
        Some(_) => return Err("expected a file name with the extension .npy".into()),
        None => (text, None),
    };
    let (resource, pass) = options::inspect_target(target)?;
    Ok(InspectRequest { resource, pass, file })
}

fn refuse_options_of_others(args: &Args) -> Result<(), Usage> {
    if let Renderer::Reference = args.backend {
        let more = [
            ("--repeat", args.repeat != 1),
            ("--jobs", args.jobs.is_some()),
            ("--memory", args.memory.memory.is_some()),
            ("--inspect", !args.inspect.is_empty()),
        ];
        refuse_for_reference(&more)?;
        let names: Vec<&str> = NAMES.iter().chain([&RGBA]).map(|(name, _)| *name).collect();
        if let Some((name, _)) = args.named().find(|(name, _)| !names.contains(name)) {
            let names = names.join(", ");
            return Err(Usage(format!("expected an output of the exact renderer, {names}, found `{name}`")));
        }
        // A preset named after a projection selects that projection.
        let is_projection = args.drawing.pipeline.parse::<Projection>().is_ok();
        let pipeline = if is_projection { options::DEFAULT_PIPELINE } else { &args.drawing.pipeline };
        return refuse_graph_options(pipeline, &args.drawing.set, &args.device);
    }
    match args.rule.is_empty() {
        true => Ok(()),
        false => Err(Usage("--rule is for the exact renderer: add --backend reference".into())),
    }
}

/// Rejects options of graphs and devices, which do not apply to the exact renderer.
pub fn refuse_graph_options(
    pipeline: &str,
    set: &[(String, String)],
    device: &DeviceArgs,
) -> Result<(), Usage> {
    refuse_for_reference(&[
        ("--pipeline", pipeline != options::DEFAULT_PIPELINE),
        ("--set", !set.is_empty()),
        ("--device", device.device.is_some()),
        ("--validate", device.validate),
        ("--no-robustness", device.no_robustness),
    ])
}

fn refuse_for_reference(given: &[(&str, bool)]) -> Result<(), Usage> {
    outcome::refuse(given, |option| {
        format!(
            "{option} is for graphs, and the exact renderer executes none; its rules are changed with --rule of `render`"
        )
    })
}

impl Args {
    pub(super) fn stdout(&self) -> Stdout {
        let timeline = self.timeline.as_deref().filter(|path| is_standard_output(path));
        let others = self.files().map(|(_, file)| file).chain(timeline).chain(self.write_cameras.as_deref());
        let picture = self.picture().ok().flatten();
        Stdout::of(picture.into_iter().chain(self.json.as_deref()).chain(others))
    }

    pub(super) fn files(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        let inspected = self.inspect.iter().filter_map(|request| request.file.as_deref());
        let outputs = self.named().map(|(_, file)| ("--output", file));
        inspected.map(|file| ("--inspect", file)).chain(outputs)
    }

    /// Lists the files of a camera besides its picture, each with its option. `stem` is the camera's name in file
    /// names; `cameras` is the number of all cameras.
    pub(super) fn files_of(
        &self,
        stem: &str,
        cameras: usize,
    ) -> impl Iterator<Item = (&'static str, PathBuf)> {
        let inspected = self.inspect.iter().filter_map(|request| request.file.as_deref());
        let inspected =
            inspected.map(move |file| ("--inspect", per_camera(file, Format::Npy, stem, cameras)));
        let outputs = self.named().map(move |(name, file)| {
            ("--output", per_camera(file, in_folder(name, self.format), stem, cameras))
        });
        inspected.chain(outputs)
    }

    /// Lists the outputs besides the picture, each with its file's format.
    pub(super) fn formats(&self) -> impl Iterator<Item = (&str, Format)> {
        self.named()
            .map(|(name, file)| (name, Format::of(file).unwrap_or_else(|| in_folder(name, self.format))))
    }

    /// Lists the outputs besides the picture, each with its file.
    pub(super) fn named(&self) -> impl Iterator<Item = (&str, &Path)> {
        self.output.iter().filter_map(|output| match output {
            Output::Named(name, file) => Some((name.as_str(), file.as_path())),
            Output::Picture(_) => None,
        })
    }

    /// Checks that outputs in folders can have the format of `--format`, for a command that writes no picture.
    fn check_folder_formats(&self) -> Result<(), Usage> {
        let Some(format) = self.format else { return Ok(()) };
        let mut in_folders = self.named().filter(|(_, file)| names::ends_in_separator(file));
        in_folders.try_for_each(|(name, _)| check_format(name, format)).map_err(Usage)
    }

    /// Replaces the error that a graph lacks an output, if the name may be part of a picture's path. An example is
    /// `take=2/out.png`.
    pub(super) fn or_picture(&self, error: anyhow::Error) -> anyhow::Error {
        let text = error.to_string();
        let is_path =
            |(name, _): &(&str, &Path)| text.contains(&no_output(name)) && builtin::giving(name).is_empty();
        let Some((name, file)) = self.named().find(is_path) else { return error };
        let picture = shell_word(&format!("./{name}={}", file.display()));
        let text = text.strip_prefix("error: ").unwrap_or(&text);
        Usage(format!("{text}\n  = help: for a picture with that name, write {picture}")).into()
    }

    /// Returns the path of the picture; `None` without an `--output` for it. Fails if several are given.
    pub(super) fn picture(&self) -> Result<Option<&Path>, Usage> {
        let pictures: Vec<&Path> = self
            .output
            .iter()
            .filter_map(|output| match output {
                Output::Picture(path) => Some(path.as_path()),
                Output::Named(..) => None,
            })
            .collect();
        match pictures[..] {
            [] => Ok(None),
            [path] => Ok(Some(path)),
            _ => Err(Usage(format!("expected one --output without a name, found {}", pictures.len()))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;

    #[test]
    fn what_to_inspect_is_a_resource_a_pass_and_perhaps_a_file() {
        let found = inspect_request("keys#1@sort.scatter[2]=a/b.npy").unwrap();
        assert_eq!((found.resource.as_str(), found.pass.as_str()), ("keys#1", "sort.scatter[2]"));
        assert_eq!(found.file, Some("a/b.npy".into()));
        assert!(inspect_request("keys@scatter=keys.txt").is_err());
    }

    #[test]
    fn more_frames_than_their_times_can_be_kept_of_are_refused() {
        let parse = |frames: &str| parsed::<Args>(["render", "--json", "--repeat", frames]);
        assert_eq!(parse("100000").unwrap().repeat, 100_000);
        for frames in ["0", "100001", "4294967295", "4294967296", "many"] {
            assert!(
                parse(frames).map(drop).unwrap_err().to_string().contains("expected 1 to 100000 frames"),
                "{frames}"
            );
        }
    }
}
