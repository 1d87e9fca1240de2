//! Defines options and helpers that several commands share.

use super::cameras::MAX_SIDE;
use super::outcome::Usage;
use super::{help, known_devices};
use crate::draw::backend::{Api, Backend, Options, Validation};
use crate::draw::builtin;
use crate::draw::fit::Target;
use crate::draw::interleaved::Frames;
use crate::draw::stats::Opened;
use crate::draw::storage;
use crate::draw::truth::rule_list;
use crate::io::demo;
use crate::io::image::Format;
use crate::io::output::{self, OutputGuard, is_standard_output, shell_word};
use crate::io::report::plot::Plot;
use crate::studies::bench;
use anyhow::{Context, Result};
use clap::builder::{PossibleValue, TypedValueParser};
use splatgraph_api::BackendError;
use splatgraph_assets::{Camera, Scene, SceneFormat, SceneHeader};
use std::ffi::{OsStr, OsString};
use std::io::IsTerminal;
use std::path::Path;
use std::str::FromStr;

pub use crate::draw::builtin::DEFAULT_PIPELINE;

/// Formats the help of an argument that names a scene.
pub fn scene_help() -> String {
    format!("A scene file: {}, or .ron, a list of scenes", SceneFormat::endings())
}

/// Formats the help of an argument that names a scene, the demo scene by default.
pub fn optional_scene_help() -> String {
    format!("{} [default: the demo scene]", scene_help())
}

/// Formats the long help of `--rule`, with the rules.
pub fn rule_help(about: &str) -> String {
    format!(
        "{about}\n\nThe rules, with their values and their place in the published rasteriser:\n{}",
        help::two_columns(rule_list())
    )
}

pub fn setting(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.trim().is_empty() && !value.trim().is_empty() => {
            Ok((name.trim().to_owned(), value.trim().to_owned()))
        }
        _ => Err("expected NAME=VALUE, for instance digit_bits=4".into()),
    }
}

pub fn positive<T: FromStr + Copy + Into<f64>>(text: &str) -> Result<T, String> {
    let is_positive = |number: &T| (*number).into().is_finite() && (*number).into() > 0.0;
    text.parse().ok().filter(is_positive).ok_or_else(|| "expected a number above 0".into())
}

pub fn size(text: &str) -> Result<(u32, u32), String> {
    let parse = || -> Option<(u32, u32)> {
        let (width, height) = text.split_once(['x', 'X'])?;
        let (width, height) = (width.trim().parse().ok()?, height.trim().parse().ok()?);
        (width > 0 && height > 0).then_some((width, height))
    };
    match parse() {
        Some((width, height)) if width.max(height) > MAX_SIDE => {
            Err(format!("expected at most {MAX_SIDE}x{MAX_SIDE} pixels, found {width}x{height}"))
        }
        Some(size) => Ok(size),
        None => Err("expected WIDTHxHEIGHT in pixels, for instance 1920x1080".into()),
    }
}

/// Parses `R,G,B`, `#RRGGBB`, `black` or `white`. Numbers beyond 0 to 1 are accepted, unless they look like 8-bit
/// values.
pub fn colour(text: &str) -> Result<[f32; 3], String> {
    // `from_str_radix` accepts a sign.
    let is_hex = |hex: &&str| hex.len() == 6 && !hex.starts_with('+');
    let digits = text.strip_prefix('#').filter(is_hex).and_then(|hex| u32::from_str_radix(hex, 16).ok());
    match (text, digits) {
        ("black", _) => return Ok([0.0; 3]),
        ("white", _) => return Ok([1.0; 3]),
        (_, Some(rgb)) => return Ok([rgb >> 16, rgb >> 8, rgb].map(|byte| (byte & 255) as f32 / 255.0)),
        _ => {}
    }
    let values: Vec<f32> = text.split(',').filter_map(|v| v.trim().parse().ok()).collect();
    match values.as_slice() {
        &[r, g, b] if text.split(',').count() == 3 && values.iter().all(|v| v.is_finite()) => {
            // Float pictures keep any value, for example -1 or 1000 to mark the background. But three integers from 0
            // to 255, at least one of them above 1, are probably 8-bit values.
            let is_byte = |value: &f32| value.fract() == 0.0 && (0.0..=255.0).contains(value);
            match values.iter().find(|value| **value >= 2.0) {
                Some(value) if values.iter().all(is_byte) => {
                    Err(format!("expected values from 0 to 1 (255 is 1), found {value}"))
                }
                _ => Ok([r, g, b]),
            }
        }
        _ => {
            let expected = "expected three numbers, for instance 1,0.5,0.25, or #ff8040, black or white";
            let has_alpha = values.len() == 4 || text.starts_with('#') && text.len() == 9;
            Err(match has_alpha || ["transparent", "none"].contains(&text) {
                true => {
                    format!("{expected}; `render -o rgba=FILE.png` writes a picture without its background")
                }
                false => expected.into(),
            })
        }
    }
}

pub fn inspect_target(text: &str) -> Result<(String, String), String> {
    match text.split_once('@') {
        Some((resource, pass)) if !resource.is_empty() && !pass.is_empty() => {
            Ok((resource.to_owned(), pass.to_owned()))
        }
        _ => Err("expected RESOURCE@PASS, for instance keys@scatter".into()),
    }
}

/// Lists every built-in graph except parts: renderers, filters, and the graphs of `bench` and of the viewer's window.
pub fn built_in_graphs() -> Vec<&'static str> {
    let mut graphs = builtin::names();
    graphs.extend(builtin::filters());
    graphs.extend(bench::GRAPHS);
    #[cfg(feature = "window")]
    graphs.push(crate::view::paint::GRAPH);
    graphs
}

/// Finds a device in the catalogue or in a file, or else opens the named or the default device of this machine.
pub fn target(wanted: Option<&str>) -> Result<Target> {
    if let Some(known) = wanted.map(known_devices::find).transpose()?.flatten() {
        return Ok(known);
    }
    let options = Options { device: wanted.map(str::to_owned), ..Default::default() };
    let device = Backend::open(Api::default(), &options).with_context(|| match wanted {
        Some(wanted) => format!(
            "expected a device that `splatgraph check --help` lists, a file, or a device of this machine, found `{wanted}`"
        ),
        None => "the device's limits are not available".to_owned(),
    })?;
    Ok(Target::of(splatgraph_api::Device::info(&device)))
}

/// Parses a value with a function, and offers names to a shell's completions.
#[derive(Clone)]
pub struct Listed<T>(pub fn() -> Vec<&'static str>, pub fn(&str) -> Result<T, String>);

impl<T: Clone + Send + Sync + 'static> TypedValueParser for Listed<T> {
    type Value = T;

    fn parse_ref(
        &self,
        command: &clap::Command,
        option: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<T, clap::Error> {
        self.1.parse_ref(command, option, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new((self.0)().into_iter().map(PossibleValue::new)))
    }
}

/// Parses `--format` of commands that write pictures into a folder.
pub fn picture_format() -> Listed<Format> {
    Listed(|| vec!["png", "exr", "npy"], str::parse)
}

/// Options of the device.
#[derive(Debug, clap::Args)]
pub struct DeviceArgs {
    /// Device: a part of its name, or its index in `splatgraph devices`
    #[arg(long, value_name = "NAME|INDEX")]
    pub device: Option<String>,
    /// Enable the API's validation (for Vulkan, with synchronization validation), and exit with code 1 if it reports
    /// anything
    #[arg(long)]
    pub validate: bool,
    /// Do not check accesses beyond the ends of buffers and images, to measure the cost of the checks
    #[arg(long)]
    pub no_robustness: bool,
}

impl DeviceArgs {
    /// Returns the options that affect times, to record them.
    pub fn opened(&self) -> Opened {
        Opened { validate: self.validate, no_robustness: self.no_robustness }
    }

    pub fn options(&self) -> Options {
        let validation = if self.validate { Validation::Synchronization } else { Validation::Off };
        Options {
            device: self.device.clone(),
            validation,
            unchecked: self.no_robustness,
            ..Options::default()
        }
    }
}

/// Options of the device, and its API.
#[derive(Debug, clap::Args)]
pub struct BackendArgs {
    /// Graphics API: `vulkan`, `metal` (on Apple's systems), or `null`, which executes nothing (pictures are black, and
    /// times are meaningless)
    #[arg(long, value_name = "NAME", default_value_t = Api::default(), hide_possible_values = true)]
    #[arg(value_parser = Listed(|| Api::ALL.map(Api::name).to_vec(), Api::parse))]
    pub backend: Api,
    #[command(flatten)]
    pub device: DeviceArgs,
}

impl BackendArgs {
    pub fn open(&self) -> Result<Backend, BackendError> {
        Backend::open(self.backend, &self.device.options())
    }

    /// Returns the command-line words that select this device again.
    pub fn words(&self) -> Vec<String> {
        let backend = (self.backend != Api::default())
            .then(|| ["--backend".to_owned(), self.backend.name().to_owned()]);
        let device = self.device.device.clone().map(|device| ["--device".to_owned(), device]);
        backend.into_iter().chain(device).flatten().collect()
    }
}

impl std::ops::Deref for BackendArgs {
    type Target = DeviceArgs;

    fn deref(&self) -> &DeviceArgs {
        &self.device
    }
}

/// Restricts `--backend` to the APIs that draw, for commands that compare pictures.
pub fn that_draws(backend: clap::Arg) -> clap::Arg {
    let help = "Graphics API: `vulkan`, or `metal` on Apple's systems";
    backend.help(help).value_parser(Listed(Api::drawing, Api::parse_drawing))
}

/// Describes `--pipeline` of the commands that measure the settings of one graph.
pub fn that_is_changed(pipeline: clap::Arg) -> clap::Arg {
    pipeline.help("The graph whose parameters are changed: the name of a built-in one, or a path; presets are measured unchanged")
}

/// Describes `--set` of the commands that measure the settings of one graph.
pub fn that_is_fixed(set: clap::Arg) -> clap::Arg {
    set.help("Fix a parameter of the graph in every setting; may be repeated")
}

/// Options of a plan: graph, parameters, cameras and picture size.
#[derive(Debug, clap::Args)]
pub struct Drawing {
    /// The graph: the name of a built-in one (see --help), or a path
    #[arg(short, long, value_name = "NAME", default_value = DEFAULT_PIPELINE)]
    pub pipeline: String,
    /// Set a parameter of the graph; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = setting)]
    pub set: Vec<(String, String)>,
    /// Cameras: a COLMAP folder, a transforms.json, the reference implementation's cameras.json, or a glTF file; `#2`
    /// or `#NAME` selects one, `#front/*` those whose names begin with `front/` [default: the first camera beside the
    /// scene, or one that frames the scene]
    ///
    /// The format is recognised by the contents; docs/formats.md lists the formats. The text of a cameras.json works
    /// in place of a path: `[{"position": [0, 0, -4], "rotation": ..., ...}]`.
    #[arg(short, long, value_name = "PATH[#INDEX]|JSON")]
    pub cameras: Option<String>,
    /// Draw lenses with distortion as ideal ones: the same poses and focal lengths, but pictures that do not match the
    /// photographs [default: such lenses are refused]
    #[arg(long, requires = "cameras")]
    pub ignore_distortion: bool,
    /// Size of the pictures [default: the cameras'; 2:1 for a panorama of pinhole cameras]
    ///
    /// The cameras keep their vertical field of view: a wider picture shows more at the sides. The camera that frames
    /// the scene frames it at this size.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    pub size: Option<(u32, u32)>,
}

impl Drawing {
    pub fn cameras(&self, scene: Option<&Path>) -> Result<Option<Vec<Camera>>> {
        super::cameras::load_sized(self.cameras.as_deref(), scene, self.size, self.ignore_distortion)
    }
}

/// Returns the maximum number of unfinished pictures: `wanted`, or by default two per worker thread.
pub fn jobs(wanted: Option<u16>) -> usize {
    wanted.map_or_else(|| 2 * rayon::current_num_threads(), usize::from)
}

/// The memory for a graph and its scene.
#[derive(Debug, clap::Args)]
pub struct MemoryArgs {
    /// Choose the most accurate storage of the splats that fits so much memory of the device, such as 8GiB
    ///
    /// The buffers and images that stay after the first frame count. Storage is a parameter of the graph, so `--set
    /// storage=...` leaves nothing to choose. The default is the device's free memory, for scenes that may exceed it.
    #[arg(long, value_name = "SIZE", value_parser = storage::parse_bytes)]
    pub memory: Option<u64>,
}

/// Options for the number of frames of a measurement.
#[derive(Debug, clap::Args)]
pub struct EffortArgs {
    /// Maximum number of rounds. Measuring a setting in a view ends earlier once its time is precise enough, or after 8
    /// seconds. With fewer than 8 frames in all rounds, all differences in time count as noise
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Frames per round; the baseline draws as many, interleaved [default: 1 to 3, from the frame time]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    frames: Option<u32>,
}

impl EffortArgs {
    pub fn frames(&self) -> Frames {
        Frames { rounds: self.rounds, frames: self.frames }
    }
}

/// Registers the scene, or the demo scene, and the files of its cameras as inputs. No output can then overwrite them.
pub fn claim_inputs(scene: Option<&Path>, cameras: Option<&str>) -> Result<OutputGuard, Usage> {
    let mut guard = OutputGuard::default();
    match scene {
        Some(path) => guard.scene("the scene", path)?,
        None => demo::path().map_or(Ok(()), |path| guard.input("the demo scene", &path))?,
    }
    super::cameras::claim(&mut guard, cameras, scene)?;
    Ok(guard)
}

pub fn claim_json<'a>(
    json: Option<&Path>,
    inputs: impl Iterator<Item = (&'a str, &'a Path)>,
) -> Result<(), Usage> {
    let mut guard = OutputGuard::default();
    for (what, path) in inputs {
        guard.scene(what, path)?;
    }
    json.map_or(Ok(()), |path| Ok(guard.output("--json", path)?))
}

/// Rejects `--json FILE.json` and `--json -`, whose second word would be taken for a scene.
///
/// Some scenes are JSON files, too: such a word stays a scene.
pub fn refuse_json_apart(arguments: &[OsString]) -> Result<(), Usage> {
    let before_end = arguments.iter().take_while(|word| *word != "--");
    let is_option = |word: &OsString| word.as_encoded_bytes().starts_with(b"--");
    let pairs = before_end.zip(arguments.iter().skip(1));
    for (option, word) in pairs.filter(|(option, word)| *option == "--json" && !is_option(word)) {
        let (option, path) = (option.display(), Path::new(word));
        if is_standard_output(path) {
            return Err(Usage(format!(
                "expected {option} alone for standard output, found {option} {}",
                path.display()
            )));
        }
        let is_json = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
        if is_json && SceneHeader::load(path).is_err() {
            let word = word.to_string_lossy();
            let name = output::one_line(&word);
            return Err(Usage(format!("expected {option}={name} to write a file, found {option} {name}")));
        }
    }
    Ok(())
}

/// Registers the files of [`write_plot`].
pub fn claim_plot(guard: &mut OutputGuard, folder: &Path, name: &str) -> Result<(), Usage> {
    let files = ["svg", "png"].map(|format| folder.join(format!("{name}.{format}")));
    Ok(files.iter().try_for_each(|file| guard.output("--output", file))?)
}

/// Writes a plot as `NAME.svg` and `NAME.png`.
pub fn write_plot(plot: &Plot, folder: &Path, name: &str) -> Result<()> {
    output::write_bytes(&folder.join(format!("{name}.svg")), plot.svg()?.as_bytes())?;
    Ok(plot.image()?.save(&folder.join(format!("{name}.png")))?)
}

/// Removes the files of [`write_plot`], and returns true if there were any.
pub fn remove_plot(folder: &Path, name: &str) -> Result<bool> {
    let mut found = false;
    for format in ["svg", "png"] {
        found |= output::remove(&folder.join(format!("{name}.{format}")))?;
    }
    Ok(found)
}

/// Formats this process's command line for a shell.
pub fn command_line() -> String {
    std::env::args_os().map(|word| shell_word(&word.to_string_lossy())).collect::<Vec<_>>().join(" ")
}

/// Converts a path to text for JSON, lossily. Serde refuses a [`Path`] that is not valid UTF-8, and `json!` panics on
/// it.
pub fn text_of(path: &Path) -> String {
    path.display().to_string()
}

/// Adds the fields of one JSON object to another. Values that are no objects have no fields.
pub fn with_fields(mut all: serde_json::Value, more: serde_json::Value) -> serde_json::Value {
    if let (Some(all), serde_json::Value::Object(more)) = (all.as_object_mut(), more) {
        all.extend(more);
    }
    all
}

pub fn write_json(path: &Path, value: &serde_json::Value) -> Result<()> {
    write_text(Some(path), &format!("{value:#}\n"))
}

/// Writes cameras, given in the scene's coordinates, as a cameras.json in world coordinates.
pub fn write_cameras(path: &Path, cameras: &[Camera], scene: &Scene) -> Result<()> {
    let world: Vec<Camera> = cameras.iter().map(|camera| camera.in_world(scene.offset())).collect();
    write_json(path, &serde_json::to_value(world)?)
}

/// Prints a line of the command's result. A closed pipe is not an error.
pub fn print(line: &str) -> Result<()> {
    write_text(None, &format!("{line}\n"))
}

/// Prints text, unless `json`, the file of `--json`, is standard output.
pub fn print_beside(json: Option<&Path>, text: &str) -> Result<()> {
    if json.is_some_and(is_standard_output) { Ok(()) } else { write_text(None, text) }
}

/// Writes text to a file, or to standard output for `None` or `-`, with its harmful characters escaped. A closed pipe
/// is not an error.
pub fn write_text(path: Option<&Path>, text: &str) -> Result<()> {
    match path.filter(|path| !is_standard_output(path)) {
        Some(path) => Ok(output::write_bytes(path, output::harmless(text).as_bytes())?),
        None => Ok(output::print(text)?),
    }
}

/// Returns an error if standard output is a terminal, which cannot take binary data.
pub fn refuse_terminal(what: &str) -> Result<(), Usage> {
    if std::io::stdout().is_terminal() {
        return Err(Usage(format!(
            "expected a file or a pipe as standard output for {what}, found a terminal"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_background_is_refused_if_it_looks_like_values_from_0_to_255() {
        for text in ["0,128,255", "2,0,0", "0,1,255"] {
            let error = colour(text).unwrap_err();
            assert!(error.starts_with("expected values from 0 to 1 (255 is 1), found "), "{text}: {error}");
        }
        for (text, expected) in
            [("#ff0033", [1.0, 0.0, 0.2]), ("white", [1.0; 3]), ("0.5,0,1", [0.5, 0.0, 1.0])]
        {
            assert_eq!(colour(text), Ok(expected));
        }
        for text in ["#ff003", "#ff00333", "#ff003x", "#+f0033", "red"] {
            assert!(colour(text).unwrap_err().contains("black or white"), "{text}");
        }
        for text in ["transparent", "none", "#ff003300", "0,0,0,0"] {
            assert!(colour(text).unwrap_err().contains("; `render -o rgba=FILE.png`"), "{text}");
        }
        for text in ["1,1,1", "1e3,1e3,1e3", "-1,-1,-1", "0.5,2,0", "1.5,0,0", "0,0,256"] {
            assert!(colour(text).is_ok(), "{text}");
        }
    }
}
