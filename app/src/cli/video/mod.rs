//! Runs `splatgraph video`: draws films.

mod sequence;

use super::cameras;
use super::job::{self, Shard};
use super::loading;
use super::look_at::LookAtArgs;
use super::options::{self, BackendArgs, Drawing};
use super::outcome::{self, Outcome, Usage, claim_graph_files};
use super::render::prepare_plan;
use super::scenes::ScenesArgs;
use super::stdout::Stdout;
use crate::draw::animation::is_animated;
use crate::draw::blind;
use crate::draw::camera_path::{self, CameraPath, DEFAULT_SECONDS, SECONDS};
use crate::draw::film::{self, DrawOptions, Drawn, Film, Motion};
use crate::draw::fingerprint::fingerprint;
use crate::draw::orbit::{self, Orbit};
use crate::draw::outputs::{NAMES, RGBA, behind_note};
use crate::draw::projection;
use crate::draw::session::Session;
use crate::io::film::{Format, Rate};
use crate::io::image;
use crate::io::output::{self, OutputGuard, is_standard_output, names, say, shell_word};
use crate::io::program;
use crate::io::progress::Progress;
use crate::io::report::text;
use anyhow::{Context, Result, anyhow, bail};
use clap::ValueEnum;
use clap::builder::{OsStringValueParser, TypedValueParser};
use sequence::{FPS, Sequence};
use serde_json::json;
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Dataset, FrameTiming, Projection, Scene, grouped};
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  splatgraph video -o turn.gif --size 480x270 --fps 15             # once around the demo scene
  splatgraph video scene.ply --orbit 240 -o frames/                # a PNG per frame; the same command again goes on
  splatgraph video scene.ply -c path-1.cameras.json --seconds 8 -o film.apng   # keys that K recorded in the viewer
  splatgraph video scene.ply -c keys.json --closed --samples 16 -o frames/     # a loop, with motion blur
  splatgraph video scene.ply -c keys.json -o - |
    ffmpeg -colorspace bt709 -color_primaries bt709 -color_trc iec61966-2-1 -i - -crf 18 film.mp4";

/// Command that encodes a Y4M. The format has no fields for these options; FFmpeg would assume BT.601.
const FFMPEG: &str = "ffmpeg -colorspace bt709 -color_primaries bt709 -color_trc iec61966-2-1 -i -";

/// Draw a film of a camera that moves through a scene
///
/// With --cameras, the camera moves smoothly through them at constant speed, where rotation counts as distance. The
/// cameras of nerfstudio's camera_path.json are the frames instead (--cameras-as). Without --cameras, the camera goes
/// once around the scene. Fisheyes need `--pipeline fisheye`, which draws pinholes as fisheyes, too. The viewer plays
/// the same path: K records a key, and the Cameras tool writes the keys to a file.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Output: .gif, .apng or .png (animated), .y4m, or a folder; .mp4 (AV1) if the program was built with the feature
    /// av1
    ///
    /// A name without extension is a folder with 00000.png, 00001.png, ..., and film.json, which describes the film.
    /// Repeating the command draws the missing frames. A .y4m is uncompressed video for encoders: 4:2:0, BT.709. `-`
    /// writes .y4m to standard output. Files and pictures are never partial.
    #[arg(short, long, value_name = "OUT", value_parser = OsStringValueParser::new().try_map(film_path))]
    output: PathBuf,
    /// Format of the pictures in a folder [default: png]
    #[arg(long, value_name = "png|exr|npy", value_parser = options::picture_format(), hide_possible_values = true)]
    format: Option<image::Format>,
    #[command(flatten)]
    scenes: ScenesArgs,
    #[command(flatten)]
    drawing: Drawing,
    /// Use of the cameras: keys of a path at constant speed, or frames, one camera each [default: keys; frames for a
    /// camera_path.json]
    ///
    /// Frames keep their times, also where the camera rests. With --seconds, and for motion blur, the camera moves
    /// smoothly between them.
    #[arg(long, value_name = "keys|frames", hide_possible_values = true)]
    cameras_as: Option<CamerasAs>,
    /// Return from the last camera to the first, so that the film repeats without a jump
    #[arg(long)]
    closed: bool,
    /// Duration [default: 10; for frames, one frame for each camera]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, conflicts_with = "orbit")]
    seconds: Option<f64>,
    /// Frames per second: a whole number, a fraction such as 30000/1001, or 23.976, 29.97 or 59.94 [default: 30; for
    /// frames, the rate of a camera_path.json]
    #[arg(long, value_name = "RATE")]
    fps: Option<Rate>,
    /// Motion blur: each frame is the mean of N pictures, taken while the shutter is open, in linear light
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    samples: u32,
    /// Time that the shutter is open, as a share of the time between two frames [default: 0.5]
    #[arg(long, value_name = "0..1", value_parser = shutter)]
    shutter: Option<f64>,
    /// Background colour, display-encoded: 0 is black, 1 is white
    #[arg(long, value_name = "R,G,B|#RRGGBB", default_value = "0,0,0", allow_hyphen_values = true, value_parser = options::colour)]
    background: [f32; 3],
    /// Write the cameras of the frames as a cameras.json, with which `render` draws depth and other outputs of them,
    /// without motion blur
    #[arg(long, value_name = "FILE")]
    write_cameras: Option<PathBuf>,
    /// Maximum number of pictures that are drawn but not yet encoded [default: two per processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// Draw only every N-th frame, from frame I (0 to N - 1), into a folder that several processes share
    ///
    /// The same command without --shard then draws the frames that are missing, and checks that all are there.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    #[command(flatten)]
    device: BackendArgs,
    // The heading would apply to all arguments below.
    #[command(flatten, next_help_heading = "A circle without a file of cameras")]
    look: LookAtArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CamerasAs {
    Keys,
    Frames,
}

const MAX_FRAMES: u32 = 100_000;

/// Default shutter time, as a fraction of the frame time: a 180-degree shutter.
const SHUTTER: f64 = 0.5;

/// Parses the path of a film. `NAME=FILE` with an output of `render` is refused: films have only their pictures.
fn film_path(text: OsString) -> Result<PathBuf, String> {
    let name = text.to_str().and_then(|text| text.split_once('=')).map(|(name, _)| name);
    match name.filter(|name| NAMES.iter().chain([&RGBA]).any(|(output, _)| output == name)) {
        Some(name) => Err(format!(
            "expected a film, found the output `{name}`, which `render` writes for each picture: `render --orbit 60 -o \
             {name}=turn.{}`; a film of that name is `./{}`",
            if name == RGBA.0 { "png" } else { "npy" },
            text.display()
        )),
        None => Ok(text.into()),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds| SECONDS.contains(seconds));
    seconds.ok_or_else(|| format!("expected {} to {} seconds", SECONDS.start(), SECONDS.end()))
}

fn shutter(text: &str) -> Result<f64, String> {
    let share = text.parse().ok().filter(|share: &f64| (0.0..=1.0).contains(share));
    share.ok_or_else(|| "expected 0 to 1, for instance 0.5 for a shutter of 180 degrees".into())
}

#[derive(Debug)]
enum Destination {
    File(PathBuf, Format),
    Folder(Sequence),
}

/// Properties of a film that are known before the device is opened.
#[derive(Debug)]
pub(super) struct Work {
    /// Cameras of `--cameras`; `None` for a circle.
    keys: Option<Vec<Camera>>,
    timing: Timing,
    destination: Destination,
    guard: OutputGuard,
}

/// Times of a film's frames.
#[derive(Clone, Copy, Debug)]
struct Timing {
    rate: Rate,
    frames: u32,
    cameras_as: CamerasAs,
    closed: bool,
}

/// Checks the command line, reads the keys, and determines the number of frames and the destination.
///
/// # Errors
/// The command line is invalid, an output cannot be written or is an input, or the cameras cannot be read or do not
/// form a path.
pub(super) fn prepare(args: &Args) -> Result<Work> {
    let destination = destination(args)?;
    args.look.check(args.drawing.cameras.as_deref())?;
    let given = args.drawing.cameras.as_deref().filter(|_| args.look.names().is_none());
    let dataset = given.map(|spec| cameras::read(spec, args.drawing.ignore_distortion)).transpose()?;
    let timing = timing(args, dataset.as_ref())?;
    if let Destination::File(_, format) = &destination {
        format.check_rate(timing.rate).map_err(Usage)?;
    }
    let keys = dataset.map(Dataset::into_cameras);
    if keys.is_none() {
        let path = [("--closed", args.closed), ("--cameras-as", args.cameras_as.is_some())];
        outcome::refuse(&path, |option| {
            format!("expected a path through --cameras with {option}, found a circle")
        })?;
    }
    if args.shutter.is_some() && args.samples == 1 {
        bail!(Usage("expected --samples of 2 or more with --shutter, found 1".into()));
    }
    if let Some(keys) = &keys {
        check_keys(args, keys, timing.cameras_as)?;
        keys.iter().filter(|_| args.drawing.size.is_none()).try_for_each(cameras::check_size)?;
    }
    let mut guard = OutputGuard::default();
    let mut claim = || -> Result<(), Usage> {
        args.scenes.claim(&mut guard)?;
        if args.drawing.cameras.is_some() {
            cameras::claim(&mut guard, args.drawing.cameras.as_deref(), None)?;
        }
        guard.input("the graph", Path::new(&args.drawing.pipeline))?;
        args.write_cameras.iter().try_for_each(|path| guard.output("--write-cameras", path))?;
        match &destination {
            Destination::File(path, _) => guard.output("--output", path)?,
            Destination::Folder(sequence) => {
                guard.output("--output", &sequence.record())?;
                for frame in 0..timing.frames {
                    guard.output("--output", &sequence.picture(frame))?;
                }
            }
        }
        Ok(())
    };
    claim()?;
    Ok(Work { keys, timing, destination, guard })
}

fn destination(args: &Args) -> Result<Destination, Usage> {
    let path = &args.output;
    let is_folder = names::ends_in_separator(path) || path.is_dir();
    if !is_folder && is_pattern(path) {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let format = args.format.or(image::Format::of(path)).unwrap_or(image::Format::Png);
        let advice = in_folder(folder.unwrap_or(Path::new("frames")), format);
        return Err(Usage(format!("expected the name of a film, found a pattern of names; {advice}")));
    }
    let file = if is_standard_output(path) {
        options::refuse_terminal("the film")?;
        Format::of(path).or(Some(Format::Y4m))
    } else {
        Format::of(path).filter(|_| !is_folder)
    };
    match (file, args.format, path.extension()) {
        (Some(format), _, _) => {
            let of_folders = [("--format", args.format.is_some()), ("--shard", args.shard.is_some())];
            outcome::refuse(&of_folders, |option| format!("{option} is for the pictures of a folder"))?;
            Ok(Destination::File(path.clone(), format))
        }
        (None, None, Some(extension)) if !is_folder => {
            let expected = format!(
                "expected a folder, or a name that ends in .gif, .apng, .png or .y4m, found .{}",
                extension.display()
            );
            if let Some(format) = image::Format::of(path) {
                let advice = in_folder(&path.with_extension(""), format);
                return Err(Usage(format!("{expected}; {advice}")));
            }
            let feature = match extension.eq_ignore_ascii_case("mp4") {
                true => ", or a program built with `--features av1`",
                false => "",
            };
            // Do not suggest a command that overwrites an existing file, which may be the scene.
            let film = if path.exists() { "FILM".into() } else { shell_word(&path.to_string_lossy()) };
            Err(Usage(format!(
                "{expected} (for a folder of that name, end it with a slash); other formats need an encoder: `-o - | {FFMPEG} {film}`{feature}"
            )))
        }
        (None, format, _) => {
            Ok(Destination::Folder(Sequence::new(path, format.unwrap_or(image::Format::Png))))
        }
    }
}

/// Returns true for the name of a picture with a place for its number, as in `shot_%04d.png` or `shot.####.exr`.
fn is_pattern(path: &Path) -> bool {
    let is_number = |name: &OsStr| {
        let name = name.to_string_lossy();
        let printed = name.strip_suffix('d').map(|name| name.trim_end_matches(|c: char| c.is_ascii_digit()));
        name.ends_with("##") || printed.is_some_and(|name| name.ends_with('%'))
    };
    [path.file_stem(), path.file_name()].into_iter().flatten().any(is_number)
}

/// Describes how to write a picture per frame.
fn in_folder(folder: &Path, format: image::Format) -> String {
    let option = match format {
        image::Format::Png => String::new(),
        other => format!(" --format {other}"),
    };
    let folder = shell_word(&folder.join("").to_string_lossy());
    format!(
        "for a picture per frame, name a folder: `-o {folder}{option}` writes 00000.{format}, 00001.{format}, ..."
    )
}

/// Determines the times of the frames. Prints that the cameras of a `camera_path.json` are the frames.
fn timing(args: &Args, cameras: Option<&Dataset>) -> Result<Timing, Usage> {
    let (count, own) = cameras.map_or((0, None), |all| (all.views.len(), all.timing));
    let by_default = if own.is_some() { CamerasAs::Frames } else { CamerasAs::Keys };
    let cameras_as = args.cameras_as.unwrap_or(by_default);
    let FrameTiming { fps, is_cycle } = own.filter(|_| cameras_as == CamerasAs::Frames).unwrap_or_default();
    if args.cameras_as.is_none() && own.is_some() {
        let rate = fps.map_or_else(String::new, |fps| format!(", {fps} per second"));
        say(format!(
            "the {count} cameras are the frames of a film{rate}; --cameras-as keys makes them keys of a path at constant speed"
        ));
    }
    let rate = match fps.filter(|_| args.fps.is_none()) {
        Some(fps) => Rate::near(fps).ok_or_else(|| {
            let found = format!("expected cameras with 0.1 to 1000 frames per second, found {fps}");
            Usage(format!("{found}; --fps chooses another rate"))
        })?,
        None => args.fps.unwrap_or_default(),
    };
    let seconds = args.seconds.or((cameras_as == CamerasAs::Keys).then_some(DEFAULT_SECONDS));
    let timed = seconds.map_or(count as f64, |seconds| (seconds * rate.per_second()).round().max(1.0));
    match args.look.count().map_or(timed, f64::from) {
        frames if frames <= f64::from(MAX_FRAMES) => {
            Ok(Timing { rate, frames: frames as u32, cameras_as, closed: args.closed || is_cycle })
        }
        frames => Err(Usage(format!("expected a film of at most {MAX_FRAMES} frames, found {frames}"))),
    }
}

impl Args {
    /// Returns the projection of the graph that draws a path through `keys`.
    fn projection(&self, keys: &[Camera]) -> Projection {
        projection::of_graph_for(&self.drawing.pipeline, &self.drawing.set, keys)
    }
}

fn check_keys(args: &Args, keys: &[Camera], cameras_as: CamerasAs) -> Result<()> {
    if keys.len() < 2 && cameras_as == CamerasAs::Keys {
        bail!(Usage(format!("expected two cameras or more for a path, found {}", keys.len())));
    }
    projection::check(projection::shared(keys)?, args.projection(keys))?;
    Ok(())
}

/// Makes the camera motion, in the scene's coordinates. `own` is the demo scene's camera. With `even`, an odd width
/// or height of a key gets one pixel more, unless a size was requested.
fn motion(
    args: &Args,
    timing: &Timing,
    even: bool,
    keys: Option<&[Camera]>,
    scene: &Scene,
    own: Option<Camera>,
    graph: Projection,
) -> Result<Motion> {
    let sized = |camera: &Camera| match args.drawing.size {
        Some((width, height)) => camera.resized(width, height),
        None => {
            let camera = projection::shaped(camera, graph);
            let (width, height) = (camera.width.next_multiple_of(2), camera.height.next_multiple_of(2));
            let is_odd = (width, height) != (camera.width, camera.height);
            if even && is_odd { camera.resized(width, height) } else { camera }
        }
    };
    let Some(keys) = keys else {
        return Ok(Motion::Orbit(match own.filter(|_| !args.look.has_camera()) {
            Some(own) => {
                let own = match graph {
                    Projection::Equirectangular => orbit::levelled(&own, scene.up()),
                    _ => own,
                };
                let own = args.look.scaled(sized(&own).projected(graph, scene))?;
                Orbit::before(own, scene.robust_bounds().center())
            }
            None => {
                let orbit = args.look.circle(scene, args.drawing.size, graph, true)?;
                Orbit { start: args.look.scaled(orbit.start)?, ..orbit }
            }
        }));
    };
    // Converted before the spline: pinholes at equal distances could otherwise have another scale between them.
    let key = |camera: &Camera| args.look.scaled(sized(camera).projected(graph, scene));
    let keys = loading::in_scene(keys, scene).iter().map(key).collect::<Result<_, _>>()?;
    let mut path = CameraPath::new(camera_path::length_of_radian(scene), scene.up());
    path.set_frames(timing.cameras_as == CamerasAs::Frames);
    path.set_closed(timing.closed);
    path.set_keys(keys)?;
    Ok(Motion::Path(path))
}

pub fn run(args: &Args) -> Result<Outcome> {
    let Work { keys, timing, destination, mut guard } = prepare(args)?;
    let frames = timing.frames;
    let open = || {
        let device = args.device.open()?;
        args.scenes.check_header(device.info(), &args.drawing.pipeline, &args.drawing.set)?;
        Ok(device)
    };
    let (device, (scene, own)) = loading::open_and_load(open, |cancel| args.scenes.load(cancel))?;
    let advice = "docs/video.md has the commands for a film of one scene per frame";
    args.scenes.note_superimposed(advice).iter().for_each(say);
    let graph = args.projection(keys.as_deref().unwrap_or_default());
    // Encoders subsample the colours of a Y4M by two.
    let even = matches!(destination, Destination::File(_, Format::Y4m));
    let motion = motion(args, &timing, even, keys.as_deref(), &scene, own, graph)?;
    let film = Film { motion, frames, samples: args.samples, shutter: args.shutter.unwrap_or(SHUTTER) };
    let mut session = Session::new(device, scene, &args.drawing.pipeline, &args.drawing.set);
    let cameras: Vec<Camera> =
        (0..frames).filter_map(|frame| film.cameras(frame).into_iter().next()).collect();
    let first = cameras.first().context("a film without a camera")?;
    let size = (first.width, first.height);
    let own = keys.as_deref().unwrap_or_default().first().filter(|_| even && args.drawing.size.is_none());
    if let Some(own) = own.filter(|own| own.width % 2 + own.height % 2 > 0) {
        say(format!(
            "frames of {} x {}: encoders expect even numbers, the keys have {} x {}; --size chooses another size",
            size.0, size.1, own.width, own.height
        ));
    }
    let shown = first.projected(graph, session.scene());
    cameras::tell_shape(std::slice::from_ref(&shown));
    let pinholes = keys.as_deref().is_some_and(|keys| keys.iter().all(|key| key.projection.is_pinhole()));
    if graph == Projection::Equirectangular && pinholes {
        cameras::tell_tilt(&cameras, session.scene().up());
    }
    prepare_plan(&mut session, first)?;
    let note = session.background_note(args.background);
    let plan = session.plan().context("no plan after `prepare`")?;
    behind_note(plan, &args.drawing.set, &shown).iter().for_each(say);
    let dependent = is_animated(plan).then(|| {
        format!(
            "{}: each frame depends on those before it (state, such as a history, or `camera.frame`)",
            plan.name
        )
    });
    let samples = dependent.as_ref().filter(|_| args.samples > 1);
    let samples = samples.map(|why| format!("{why}, and each of the {} samples counts as one", args.samples));
    session.settings_without_effect().iter().chain(&note).chain(&samples).for_each(say);
    claim_graph_files(&mut guard, &session.files())?;
    if args.shard.is_some() {
        job::refuse_animated(&session)?;
    }

    let job = Job { args, film: &film, rate: timing.rate, size };
    let began = Instant::now();
    let mut others = None;
    let told = match &destination {
        Destination::File(path, format) => {
            job.write_cameras(session.scene(), graph)?;
            job.write(&mut session, path, *format)?.map(|drawn| (0, drawn))
        }
        Destination::Folder(sequence) => {
            let record = job.record(&session, &cameras)?;
            sequence.claim(&record, frames)?;
            // A refused film must not replace the cameras of the film in the folder.
            job.write_cameras(session.scene(), graph)?;
            others = sequence.others(frames);
            let own = job.own_frames();
            let missing = sequence.missing(&own, size);
            let last = missing.last().filter(|_| dependent.is_some());
            let drawn = last.map_or_else(|| missing.clone(), |last| (0..=*last).collect());
            if let (Some(why), true) = (&dependent, drawn.len() > missing.len()) {
                say(format!("{why}: the first {} are drawn, and the missing ones saved", drawn.len()));
            }
            let there = own.len() - missing.len();
            Some((there, job.fill(&mut session, sequence, &drawn, missing)?))
        }
    };
    if let Some((there, drawn)) = told {
        let scene = session.scene();
        let shown: Vec<_> = cameras.iter().map(|camera| camera.projected(graph, scene)).collect();
        let rules = |camera| (camera, blind::rules_of(session.plan(), scene, camera));
        let views: Vec<_> = shown.iter().map(rules).collect();
        loading::tell_blind(scene, (drawn.blind, drawn.frames), &views, "the same command");
        let line = job.summary(there, &drawn, began.elapsed().as_secs_f64());
        Stdout::of([Some(args.output.as_path()), args.write_cameras.as_deref()].into_iter().flatten())
            .line(&line)?;
    }
    others.iter().for_each(say);
    Ok(outcome::validated(args.device.validate, &session.into_device().close()))
}

struct Job<'a> {
    args: &'a Args,
    film: &'a Film,
    rate: Rate,
    size: (u32, u32),
}

impl Job<'_> {
    fn options(&self) -> DrawOptions {
        DrawOptions { background: self.args.background, jobs: options::jobs(self.args.jobs) }
    }

    /// Lists the frames of this process.
    fn own_frames(&self) -> Vec<u32> {
        let all = self.film.frames;
        let shard = self.args.shard.map(|shard| shard.views(all as usize));
        shard.map_or_else(|| (0..all).collect(), |own| own.into_iter().map(|frame| frame as u32).collect())
    }

    /// Writes the cameras of the frames to the file of `--write-cameras`.
    fn write_cameras(&self, scene: &Scene, graph: Projection) -> Result<()> {
        let Some(path) = &self.args.write_cameras else { return Ok(()) };
        let named = |frame: u32| {
            let camera = self.film.camera(f64::from(frame))?;
            // The session converts pinholes in the same way.
            Some(Camera {
                id: frame.into(),
                img_name: format!("{frame:05}"),
                ..camera.projected(graph, scene)
            })
        };
        if self.args.samples > 1 {
            say(format!(
                "{}: the cameras are those of the middle of each exposure; what `render` draws with them has no motion blur",
                path.display()
            ));
        }
        cameras::tell_frames(path, Some(self.rate), self.args.closed);
        options::write_cameras(path, &(0..self.film.frames).filter_map(named).collect::<Vec<_>>(), scene)
    }

    /// Writes the film to one file. Returns counts and times; `None` if the reader of the output pipe closed it.
    fn write(&self, session: &mut Session, path: &Path, format: Format) -> Result<Option<Drawn>> {
        let frames: Vec<u32> = (0..self.film.frames).collect();
        let mut progress = Progress::new("drawing");
        let mut told = None;
        let mut failure = None;
        let written = output::write(path, |out| {
            let mut writer = format.begin(out, self.size, self.rate, self.film.frames)?;
            let mut unwritten = None;
            let mut done = 0;
            let encode = move |frame, image: image::Image| {
                let (encoded, not_finite) = format.encode(&image).map_err(|error| anyhow!(error))?;
                not_finite.note(format_args!("frame {frame}")).iter().for_each(say);
                Ok(encoded)
            };
            let drawn = film::draw(session, self.film, &frames, &self.options(), encode, |frame| {
                done += 1;
                progress.set(done, frames.len() as u64, "");
                writer.add(frame).map_err(|cause| {
                    unwritten = Some(cause);
                    anyhow!("the film cannot be written")
                })
            });
            match (drawn, unwritten) {
                (_, Some(cause)) => Err(cause),
                (Ok(drawn), None) => {
                    writer.finish()?;
                    // A reader that closed the pipe could otherwise be noticed too late to report it.
                    out.flush()?;
                    told = Some(drawn);
                    Ok(())
                }
                (Err(error), None) => {
                    let text = error.to_string();
                    failure = Some(error);
                    Err(text.into())
                }
            }
        });
        match failure {
            // `written` would report this as an error of the file.
            Some(error) => Err(error),
            None => {
                written?;
                if told.is_none() {
                    say("standard output: the reader closed the pipe before the end of the film");
                }
                Ok(told)
            }
        }
    }

    /// Draws `frames`, and saves those that are `missing`, a sorted list.
    fn fill(
        &self,
        session: &mut Session,
        sequence: &Sequence,
        frames: &[u32],
        missing: Vec<u32>,
    ) -> Result<Drawn> {
        let mut progress = Progress::new("drawing");
        let mut done = 0;
        let encode = {
            let (sequence, missing) = (sequence.clone(), Arc::new(missing));
            move |frame, image: image::Image| match missing.binary_search(&frame) {
                Ok(_) => Ok(sequence.save(frame, &image)?),
                Err(_) => Ok(()),
            }
        };
        film::draw(session, self.film, frames, &self.options(), encode, |()| {
            done += 1;
            progress.set(done, frames.len() as u64, "");
            Ok(())
        })
    }

    /// Describes the film for `film.json`: the rate, and the inputs that determine the frames' pixels.
    fn record(&self, session: &Session, cameras: &[Camera]) -> Result<serde_json::Value> {
        let plan = session.plan().context("no plan after `prepare`")?;
        let (width, height) = self.size;
        let mut record = json!({
            "frames": self.film.frames,
            FPS: self.rate.to_string(),
            "size": [width, height],
            "scene": text::hex(session.scene().identity()),
            "graph": self.args.drawing.pipeline,
            "plan": text::hex(fingerprint(plan)),
            "background": self.args.background,
            "samples": self.film.samples,
            "cameras": format!("{:08x}", crc32fast::hash(&serde_json::to_vec(cameras)?)),
        });
        if self.film.samples > 1 {
            record["shutter"] = json!(self.film.shutter);
        }
        // Last: if other inputs differ, too, the error names one of those.
        record["program"] = json!(program::hash().context("the program's file cannot be read")?);
        Ok(record)
    }

    fn summary(&self, there: usize, drawn: &Drawn, seconds: f64) -> String {
        let ((width, height), frames) = (self.size, self.film.frames);
        let path = &self.args.output;
        let name =
            if is_standard_output(path) { "standard output".into() } else { path.display().to_string() };
        let duration = f64::from(frames) / self.rate.per_second();
        let bytes = std::fs::metadata(path).ok().filter(|found| found.is_file());
        let bytes = bytes.map_or_else(String::new, |found| format!(", {} bytes", grouped(found.len())));
        let shard = self
            .args
            .shard
            .map_or_else(String::new, |shard| format!("{shard}, {} of ", self.own_frames().len()));
        let there = match there {
            0 => String::new(),
            there => format!(" ({there} already there)"),
        };
        let Drawn { frames: drawn, gpu_ms, .. } = *drawn;
        let gpu = gpu_ms.filter(|_| drawn > 0);
        let gpu = gpu.map(|ms| format!(", {:.2} ms of GPU time each", ms / drawn as f64));
        format!(
            "{name}: {shard}{frames} {} of {width} x {height}{there}, {duration:.1} s at {} fps{bytes}; {drawn} drawn in {seconds:.1} s{}",
            if frames == 1 { "frame" } else { "frames" },
            self.rate,
            gpu.unwrap_or_default()
        )
    }
}
