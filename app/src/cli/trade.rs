//! Runs `splatgraph trade`: a ledger of what each setting saves and costs.

use super::cameras;
use super::options::{self, DEFAULT_PIPELINE, DrawingBackendArgs, EffortArgs};
use super::{Outcome, Usage};
use crate::draw::backend::Backend;
use crate::draw::fit;
use crate::draw::session::Session;
use crate::io::image::{Format, Image};
use crate::io::output::names::{self, MAX_NAME_BYTES};
use crate::io::output::{self, one_line, say, shell_word};
use crate::io::progress::Progress;
use crate::studies::trade::ledger::{Book, Origin};
use crate::studies::trade::measure::{Baseline, View, measure};
use crate::studies::trade::page::{page, plot};
use crate::studies::trade::settings::{self, Setting};
use crate::studies::trade::table::{csv, notes, table};
use anyhow::{Context, Result, bail};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene};
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Measure what each setting saves, and what it costs in accuracy
///
/// Draws the scene with every parameter at its exact value, then with one parameter changed at a time, with the graph's
/// defaults, and with every preset. Each picture is compared with the truth: the exact renderer's picture (`render --backend
/// reference`), or a picture of --truth. Frames are interleaved with frames of the exact settings, so that a change of
/// the device's clock affects both. A parameter without an effect on the plan of the exact settings is not measured, nor is a
/// setting whose plan equals an earlier one.
///
/// The columns: the share of the exact settings' time, ± half of its 99 % confidence interval; the share in milliseconds on the
/// GPU, from one time of the exact settings, with the spread over the rounds; PSNR over
/// all pixels and over those that a splat covers; the lowest SSIM; the mean of NVIDIA's FLIP (0 for equal pictures); the largest
/// difference of a channel; the share of pixels that are off by more than 1/255; pairs of visible splats in the wrong
/// order; memory on the device. A `*` marks the Pareto front: every setting that is at least as accurate takes at least 2 % longer,
/// beyond the noise, which is at least that of the exact settings against themselves. A `?` marks settings that may be on the front:
/// too noisy to tell. A graph that draws from the previous frame is not judged, because still views hide its error.
///
/// An interrupted run resumes. A row is measured again if anything that its numbers depend on has changed: the program, the
/// scene, the cameras, the pictures of --truth, the plans, the device.
///
/// The default scene is the demo scene, which the first use generates. The default camera frames the scene.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph trade                                        # the demo scene; ledger/ledger.html shows the result
  splatgraph trade scene.ply -c cameras.json -o biker/    # an interrupted run goes on
  splatgraph trade scene.ply --only key_bits --only key_map
  splatgraph trade scene.ply --set sh_degree=1            # what the others save with one band of harmonics
  splatgraph trade scene.ply -c cameras.json --truth photographs/ --size 980x545")]
pub struct Args {
    /// A scene file: .ply, .compressed.ply, .spz, .splat, .ksplat or .sog
    scene: Option<PathBuf>,
    /// The graph whose parameters are changed: the name of a built-in one, or a path
    #[arg(short, long, value_name = "NAME", default_value = DEFAULT_PIPELINE)]
    pipeline: String,
    /// Fix a parameter of the graph in every setting; may be repeated
    #[arg(short, long, value_name = "NAME=VALUE", value_parser = options::setting)]
    set: Vec<(String, String)>,
    /// Cameras: a COLMAP folder, a transforms.json or a cameras.json; `#2` or `#NAME` selects one [default: the first beside the scene]
    #[arg(short, long, value_name = "PATH[#INDEX]|JSON")]
    cameras: Option<String>,
    /// Size of the pictures [default: the cameras']
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = options::size)]
    size: Option<(u32, u32)>,
    /// Folder of true pictures, one for each camera, named after its img_name [default: the exact renderer's pictures]
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// Folder for ledger.json, .csv, .html, .svg and .png; an interrupted run resumes from ledger.json
    #[arg(short, long, value_name = "DIR", default_value = "ledger")]
    output: PathBuf,
    /// Measure only settings whose names begin with this, for instance `key_bits` or `preset`; may be repeated
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    #[command(flatten)]
    effort: EffortArgs,
    #[command(flatten)]
    device: DrawingBackendArgs,
}

/// Files in the folder of `--output`.
const LEDGER: &str = "ledger.json";
const CSV: &str = "ledger.csv";
const PAGE: &str = "ledger.html";
const SVG: &str = "ledger.svg";
const PNG: &str = "ledger.png";

pub fn run(args: &Args) -> Result<Outcome> {
    let given = cameras::load(args.cameras.as_deref(), args.scene.as_deref())?;
    let stems =
        names::unique(&options::camera_names(args.scene.as_deref(), given.as_deref()), MAX_NAME_BYTES - 5);
    claim_files(args)?;
    let device = args.device.open()?;
    if let Some(path) = &args.scene {
        fit::check_header(path, device.info(), &args.pipeline, &args.set)?;
    }
    let (scene, cameras) = options::scene_and_cameras(args.scene.as_deref(), given, &stems, args.size)?;
    let truths = args.truth.as_deref().map(|folder| true_pictures(folder, &cameras, &stems)).transpose()?;
    let mut session = Session::new(device, scene, &args.pipeline, &args.set);
    let settings = chosen(args, &mut session, &cameras)?;
    let (first, camera) = settings.first().zip(cameras.first()).context("no exact settings")?;
    let mut exact = session.beside(&first.pipeline, &first.set)?;
    // The files of the graph and its shaders are known once they are built.
    exact.prepare((camera.width, camera.height), &mut |_| {})?;
    let wanted = options::with_effect(settings, &exact)?.into_iter().filter(|setting| only(args, setting));
    let settings = options::with_plans(wanted.collect(), &mut exact, &cameras)?;
    let plans: Vec<_> = settings.iter().map(|(setting, plan)| (setting.name.as_str(), *plan)).collect();
    let origin = origin(args, &mut exact, (&cameras, truths.as_deref()), plans[0].1)?;
    let (mut book, lost) = Book::open(args.output.join(LEDGER), origin, &plans);
    lost.iter().for_each(say);
    if !book.ledger.rows.is_empty() {
        say(format!("{}: {} rows of an earlier run are kept", book.path().display(), book.ledger.rows.len()));
    }

    let mut progress = Progress::new("measuring");
    let of = (settings.len() * cameras.len()) as u64;
    for (index, camera) in cameras.iter().enumerate() {
        if settings.iter().all(|(setting, _)| book.has(&setting.name, &camera.img_name)) {
            continue;
        }
        exact.prepare((camera.width, camera.height), &mut |_| {})?;
        let effort = args.effort.choose(&mut exact, camera, 4)?;
        let view = view(session.scene(), camera, truths.as_ref().map(|truths| &truths[index]));
        for (at, (setting, plan)) in settings.iter().enumerate() {
            if book.has(&setting.name, &camera.img_name) {
                continue;
            }
            let done = (index * settings.len() + at) as u64;
            progress.set(done, of, &format!("{}, {}", one_line(&camera.img_name), setting.name));
            let baseline = Baseline { session: &mut exact, ms: book.exact_ms(&camera.img_name) };
            book.add(measure(&mut session, baseline, (setting, *plan), &view, effort)?)?;
        }
    }
    drop(progress);

    book.ledger.command = std::env::args().map(|word| shell_word(&word)).collect::<Vec<_>>().join(" ");
    book.ledger.rows.retain(|row| settings.iter().any(|(setting, _)| setting.name == row.setting));
    let (lines, failed) = book.ledger.lines();
    let notes: String = notes(&lines).iter().map(|note| format!("{note}\n")).collect();
    options::write_text(None, &format!("{}{notes}", table(&lines)))?;
    for (setting, why) in &failed {
        say(format!("{setting}: {why}"));
    }
    let file = |name: &str| args.output.join(name);
    output::write_bytes(&file(CSV), csv(&lines).as_bytes())?;
    output::write_bytes(&file(PAGE), page(&book.ledger, &lines, &failed)?.as_bytes())?;
    if let Some(plot) = plot(&book.ledger, &lines) {
        output::write_bytes(&file(SVG), plot.svg()?.as_bytes())?;
        plot.image()?.save(&file(PNG))?;
    }
    say(format!("{} shows the result", file(PAGE).display()));
    let mut messages = exact.into_device().close();
    messages.extend(session.into_device().close());
    Ok(super::validated(args.device.validate, &messages))
}

/// An error if a file of the ledger would destroy an input.
pub(super) fn claim_files(args: &Args) -> Result<(), Usage> {
    let mut guard = options::claim_inputs(args.scene.as_deref(), args.cameras.as_deref())?;
    guard.input("the graph", Path::new(&args.pipeline))?;
    for name in [LEDGER, CSV, PAGE, SVG, PNG] {
        guard.output("--output", &args.output.join(name))?;
    }
    Ok(())
}

/// Returns true if `--only` selects a setting; the exact settings are always selected.
fn only(args: &Args, setting: &Setting) -> bool {
    args.only.is_empty()
        || setting.name == settings::EXACT
        || args.only.iter().any(|name| setting.name.starts_with(name.as_str()))
}

/// Lists the settings; an error if `--only` selects none of them.
fn chosen(args: &Args, session: &mut Session<Backend>, cameras: &[Camera]) -> Result<Vec<Setting>> {
    let camera = cameras.first().context("no cameras")?;
    let controls = session.controls((camera.width, camera.height))?;
    let all = options::settings_of(&args.pipeline, &args.set, &controls);
    for name in &args.only {
        if !all.iter().any(|setting| setting.name.starts_with(name.as_str())) {
            let names: Vec<&str> = all.iter().map(|setting| setting.name.as_str()).collect();
            bail!(Usage(format!(
                "--only {name}: expected the begin of a setting's name, of: {}",
                names.join(", ")
            )));
        }
    }
    Ok(all)
}

/// Describes everything that the rows depend on; `exact` is the hash of the exact settings' plans.
fn origin(
    args: &Args,
    session: &mut Session<Backend>,
    (cameras, truths): (&[Camera], Option<&[Image]>),
    exact: Option<u64>,
) -> Result<Origin> {
    let info = session.device().info();
    let device = format!("{} ({})", info.name, info.driver);
    let opened = format!(
        "{:?}, bounds {:?}, validation {}, robustness {}",
        info.facts, info.robustness, args.device.validate, !args.device.no_robustness
    );
    let (rounds, frames) = args.effort.given();
    Ok(Origin {
        version: env!("CARGO_PKG_VERSION").into(),
        program: program().context("the program's own file cannot be read")?,
        scene: args.scene.as_ref().map_or_else(|| "demo".into(), |path| path.display().to_string()),
        splats: session.scene().count(),
        content: format!("{:016x}", session.scene().identity()),
        cameras: serde_json::to_value(cameras)?,
        pipeline: args.pipeline.clone(),
        set: args.set.clone(),
        exact: exact.map_or_else(String::new, |plan| format!("{plan:016x}")),
        truth: args.truth.as_ref().map_or_else(|| "reference".into(), |path| path.display().to_string()),
        truth_content: truths.map_or_else(String::new, content),
        device,
        opened,
        rounds,
        frames,
    })
}

/// Hashes the program's file.
fn program() -> std::io::Result<String> {
    // On Linux, the link leads to the running program, even if its file was replaced.
    let link = fs::File::open("/proc/self/exe");
    let mut file = link.or_else(|_| fs::File::open(std::env::current_exe()?))?;
    let (mut hash, mut bytes) = (DefaultHasher::new(), vec![0; 1 << 20]);
    loop {
        match file.read(&mut bytes)? {
            0 => return Ok(format!("{:016x}", hash.finish())),
            count => hash.write(&bytes[..count]),
        }
    }
}

/// Hashes the pixels of pictures, bit by bit.
fn content(pictures: &[Image]) -> String {
    let mut hash = DefaultHasher::new();
    for picture in pictures {
        (picture.width, picture.height).hash(&mut hash);
        picture.rgb.as_flattened().iter().for_each(|value| value.to_bits().hash(&mut hash));
    }
    format!("{:016x}", hash.finish())
}

/// Loads the true picture of every camera.
fn true_pictures(folder: &Path, cameras: &[Camera], stems: &[String]) -> Result<Vec<Image>> {
    let load = |(camera, stem): (&Camera, &String)| -> Result<Image> {
        let formats = [Format::Npy, Format::Exr, Format::Png];
        let path = formats
            .map(|format| folder.join(format!("{stem}.{format}")))
            .into_iter()
            .find(|path| path.exists());
        let Some(path) = path else {
            bail!("expected the picture {stem}.npy, .exr or .png in {}, found none", folder.display());
        };
        let image = Image::load(&path)?;
        if (image.width, image.height) != (camera.width as usize, camera.height as usize) {
            bail!(
                "{}: expected {} x {} pixels, as the camera has, found {} x {} (--size changes the cameras)",
                path.display(),
                camera.width,
                camera.height,
                image.width,
                image.height
            );
        }
        Ok(image)
    };
    cameras.iter().zip(stems).map(load).collect()
}

/// Returns the truth of a view: the exact renderer's, with its picture replaced by one of `--truth` if given.
fn view(scene: &Scene, camera: &Camera, picture: Option<&Image>) -> View {
    let mut view = View::exact(scene, camera).with_order(scene);
    if let Some(picture) = picture {
        view.picture = picture.clone();
    }
    view
}
