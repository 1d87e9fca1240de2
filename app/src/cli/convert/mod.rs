//! Runs `splatgraph convert`: writes a scene in another format, and lists what is lost.

mod edit;
mod price;

use super::cameras;
use super::loading;
use super::options;
use super::outcome::{Outcome, Usage};
use super::stdout::Stdout;
use crate::draw::{blind, camera};
use crate::io::load::FileOptions;
use crate::io::losses::{self, Losses, Original};
use crate::io::output::{OutputGuard, is_standard_output, say, shell_word};
use crate::io::progress::Progress;
use crate::io::scene_file;
use anyhow::{Result, bail};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use edit::EditArgs;
use price::PriceArgs;
use serde_json::json;
use splatgraph_assets::{SceneFormat, SpzVersion, grouped};
use splatgraph_reference::Rules;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

const EXAMPLES: &str = "Examples:
  splatgraph convert scene.ply scene.spz
  splatgraph convert scene.spz scene.ply
  splatgraph convert scene.ply scene.compressed.ply --degree 1
  splatgraph convert scene.ply - --format splat > scene.splat
  splatgraph convert scene.ply part.spz --crop sphere:0,0,0,2 --where 'opacity > 0.05'
  splatgraph convert scene.ply clean.ply --remove floaters.json
  splatgraph convert scene.ply --price -c cameras.json
  splatgraph convert scene.ply up.ply --transform rotate:1,0,0,90 -c garden/ --write-cameras up.cameras.json
  splatgraph convert a.ply both.ply --merge b.ply --transform rotate:1,0,0,180";

/// Write a scene in another format, and list what is lost
///
/// The contents of IN determine its format. The format of OUT follows from its extension or from --format. The last
/// lines compare the sizes and list what the format rounds or drops.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The scene
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// The file to write; `-` is standard output
    #[arg(value_name = "OUT", required_unless_present = "price")]
    output: Option<PathBuf>,
    /// Format of OUT [default: by its extension], or one of --price, which may be repeated [default: all]
    #[arg(long, value_parser = formats())]
    format: Vec<SceneFormat>,
    /// Drop the spherical harmonics above this degree
    #[arg(long, value_name = "0..3", value_parser = clap::value_parser!(u32).range(0..=3))]
    degree: Option<u32>,
    /// Version of SPZ [default: 4]
    #[arg(long, value_name = "3|4", value_parser = clap::value_parser!(u8).range(3..=4))]
    spz_version: Option<u8>,
    /// Fail, and write nothing, if the contents of the scene lose more than the chosen format and degree imply
    ///
    /// Such losses are splats that cannot be drawn, a mesh, properties, tags and comments, for instance: `losses` of
    /// --json.
    #[arg(long, conflicts_with = "price")]
    strict: bool,
    /// Write the cameras of --cameras as a cameras.json, moved by --transform as the scene is
    #[arg(long, value_name = "FILE", conflicts_with = "price", requires = "cameras")]
    write_cameras: Option<PathBuf>,
    #[command(flatten)]
    price: PriceArgs,
    #[command(flatten)]
    load: FileOptions,
    // Its heading would apply to all arguments below.
    #[command(flatten)]
    edit: EditArgs,
}

fn formats() -> impl TypedValueParser<Value = SceneFormat> {
    PossibleValuesParser::new(SceneFormat::WRITTEN.map(SceneFormat::extension)).map(|name| {
        let named = |format: &SceneFormat| format.extension() == name;
        SceneFormat::WRITTEN.into_iter().find(named).expect("the parser takes only these names")
    })
}

pub fn format_list() -> String {
    let row = |format: SceneFormat| (format!(".{}", format.extension()), format.summary().to_owned());
    format!("Formats:\n{}", super::help::two_columns(SceneFormat::WRITTEN.map(row).to_vec()))
}

/// Checks the files of the command line. Returns the output path and its format; `None` without an output.
pub(super) fn check_files(args: &Args) -> Result<Option<(&Path, SceneFormat)>, Usage> {
    let mut guard = OutputGuard::default();
    guard.scene("the scene", &args.input)?;
    for path in &args.edit.merge {
        guard.scene("a scene of --merge", path)?;
    }
    for path in args.edit.lists() {
        guard.input("a selection", path)?;
    }
    args.price.claim(&mut guard, &args.input, args.write_cameras.is_some())?;
    args.write_cameras.iter().try_for_each(|path| guard.output("--write-cameras", path))?;
    let Some(output) = args.output.as_deref() else { return Ok(None) };
    guard.output("the output", output)?;
    if is_standard_output(output) {
        options::refuse_terminal("the scene")?;
    }
    let format = match args.format[..] {
        [] => scene_file::format_of(output).map_err(|error| Usage(format!("{error}; or give --format")))?,
        [format] => {
            check_extension(output, format)?;
            format
        }
        _ => return Err(Usage(format!("expected one --format for {}, found several", output.display()))),
    };
    if args.spz_version.is_some() && format != SceneFormat::Spz {
        return Err(Usage("--spz-version is for .spz".into()));
    }
    Ok(Some((output, format)))
}

/// Rejects a file name with the extension of another format, but accepts `.ply` and `.compressed.ply` for each other.
/// Names with other extensions may hold any format.
fn check_extension(output: &Path, format: SceneFormat) -> Result<(), Usage> {
    let last = format.extension().rsplit('.').next();
    let has_last =
        output.extension().is_some_and(|own| last.is_some_and(|last| own.eq_ignore_ascii_case(last)));
    match SceneFormat::of_name(output) {
        Some(named) if named != format && !has_last => {
            Err(Usage(format!("--format differs from the extension of {}", output.display())))
        }
        _ => Ok(()),
    }
}

pub fn run(args: &Args) -> Result<Outcome> {
    let output = check_files(args)?;
    let cameras = match &args.write_cameras {
        Some(path) => {
            let mut dataset = args.price.dataset()?;
            let cameras = dataset.views.iter().map(|view| view.camera.clone()).collect();
            let moved = args.edit.moved(cameras)?;
            dataset.views.iter_mut().zip(moved).for_each(|(view, camera)| view.camera = camera);
            Some((path, dataset))
        }
        None => None,
    };
    let loaded = loading::load_scene(&args.input, &args.load.clone().into())?;
    let mut notes = loaded.notes();
    if cameras.is_some() && args.price.takes_cameras_of(&args.input) {
        // They are kept, in a file of their own.
        notes.cameras = 0;
    }
    let (merged, originals) = args.edit.merged(loaded.with_notes(notes), &args.load)?;
    let paths = [&args.input].into_iter().chain(&args.edit.merge);
    let names: Vec<String> = paths.map(|path| path.display().to_string()).collect();
    let originals: Vec<(&str, &Original)> = names.iter().map(String::as_str).zip(&originals).collect();
    let original_bytes: u64 = originals.iter().map(|(_, original)| original.file_bytes).sum();
    let (original_splats, dropped) = (merged.count(), serde_json::to_value(merged.dropped())?);
    // --price compares with the scene before splats and bands are left out.
    let mut truth = if output.is_none() { args.edit.uncut(&merged)? } else { None };
    let (mut scene, transform_loss) = args.edit.changed(merged)?;
    if let Some(degree) = args.degree.filter(|degree| *degree < scene.stored_degree()) {
        let cut = scene.cut_to_degree(degree)?;
        let whole = std::mem::replace(&mut scene, cut);
        truth = truth.or_else(|| output.is_none().then_some(whole));
    }
    let Some((output, format)) = output else {
        let mut losses = losses::not_loaded(&originals);
        transform_loss.iter().for_each(say);
        losses.extend(transform_loss);
        let lost = json!({ "dropped": dropped, "losses": losses });
        return args.price.run(scene, truth, (&args.input, &args.edit), &args.format, &args.load, lost);
    };
    let mut lost = Losses::of(&originals, &scene, format);
    lost.losses.extend(transform_loss);
    // `None` as the number of bytes: nothing was written.
    let write_json = |bytes: Option<u64>| -> Result<()> {
        let Some(file) = args.price.json() else { return Ok(()) };
        let all = json!({
            "command": options::command_line(), "scene": options::text_of(&args.input), "output": bytes.map(|_| options::text_of(output)),
            "format": format.extension(), "splats": scene.count(), "original_splats": original_splats,
            "bytes": bytes, "original_bytes": original_bytes, "dropped": dropped,
        });
        options::write_json(file, &options::with_fields(all, serde_json::to_value(&lost)?))
    };
    if args.strict && !lost.losses.is_empty() {
        write_json(None)?;
        bail!("expected no losses with --strict, found {}", lost.losses.join("; "));
    }
    let progress = Mutex::new(Progress::new(format!("writing {}", output.display())));
    let tell = |done, of| {
        if let Ok(mut progress) = progress.lock() {
            progress.set(done, of, "");
        }
        ControlFlow::Continue(())
    };
    let version =
        args.spz_version.map(|version| if version == 3 { SpzVersion::V3 } else { SpzVersion::default() });
    let bytes = scene_file::write(&scene, format, version, &tell, output)?;
    drop(progress);
    if let Some((path, dataset)) = &cameras {
        options::write_json(path, &cameras::as_json(dataset)?)?;
        cameras::tell_lost(dataset, path);
        let cameras: Vec<_> =
            dataset.views.iter().map(|view| view.camera.relative_to(scene.offset())).collect();
        let views: Vec<_> = cameras.iter().map(|camera| (camera, Rules::of_view(&scene, camera))).collect();
        blind::cut(&scene, &views).iter().for_each(say);
    } else if let Some(file) = camera::beside(&args.input) {
        let file = file.display().to_string();
        let word = shell_word(&file);
        if args.edit.transforms() {
            say(format!(
                "{file} is not moved: `-c {word} --write-cameras FILE` writes the cameras of the transformed scene"
            ));
        } else if !is_standard_output(output) && camera::beside(output).is_none() {
            say(format!("no cameras are beside {}: draw it with `-c {word}`", output.display()));
        }
    }

    write_json(Some(bytes))?;
    let written = [Some(output), args.price.json(), args.write_cameras.as_deref()];
    let stdout = Stdout::of(written.into_iter().flatten());
    let before = originals[0].1;
    let (path, from, size) = (args.input.display(), &before.format, grouped(before.file_bytes));
    let splats = losses::splats(before.count);
    stdout.line(&format!("{path}: {from}, {splats} of degree {}, {size} bytes", before.degree))?;
    if bytes == 0 {
        // A scene has at least one splat, so 0 bytes mean a closed pipe.
        let output = output.display();
        stdout.line(&format!("{output}: the reader closed the pipe before the end of the scene"))?;
        return Ok(Outcome::Done);
    }
    let percent = 100.0 * bytes as f64 / original_bytes.max(1) as f64;
    let originals = match args.edit.merge.len() {
        0 => "the original".to_owned(),
        more => format!("the {} originals", more + 1),
    };
    let (path, to) = (output.display(), format.extension());
    let count = u64::from(scene.count());
    let splats = if count == before.count { String::new() } else { losses::splats(count) + ", " };
    let size = grouped(bytes);
    stdout.line(&format!("{path}: {to}, {splats}{size} bytes, {percent:.1} % of {originals}"))?;
    for loss in lost.losses.iter().chain(&lost.chosen_losses) {
        stdout.line(&format!("  lost: {loss}"))?;
    }
    for loss in &lost.invisible_losses {
        stdout.line(&format!("  lost, but in no picture: {loss}"))?;
    }
    if let Some(empty) = losses::empty_bands(&scene, format) {
        stdout.line(&format!("  {empty}"))?;
    }
    Ok(Outcome::Done)
}
