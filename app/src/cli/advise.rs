//! Runs `splatgraph advise`: reports what a scene needs, and finds the fastest setting within a budget.

use super::console::Console;
use super::loading;
use super::options::{self, BackendArgs, DEFAULT_PIPELINE, Drawing, EffortArgs};
use super::outcome::{Outcome, Usage, claim_graph_files};
use crate::draw::keys::{self, Mapping, Need, WIDTHS};
use crate::draw::{fit, planner, projection};
use crate::io::load::LoadOptions;
use crate::io::output::{OutputGuard, shell_word};
use crate::studies::advise::harmonics::Band;
use crate::studies::advise::search::{Best, Budget, Tried};
use crate::studies::advise::{Advice, Description, Wanted, describe, study};
use crate::studies::measurement::noise::MIN_SAVING;
use crate::studies::measurement::settings::EXACT;
use crate::studies::provenance::Provenance;
use crate::studies::study::{Setting, Subject};
use anyhow::{Context, Result};
use serde_json::json;
use splatgraph_api::Device;
use std::path::{Path, PathBuf};

/// Recommend settings for a scene: depth keys, harmonics, and the fastest setting within a budget
///
/// Without a budget, this needs no graphics device. It reports dropped and unusual splats; a width of depth keys, for
/// each mapping, that is sufficient to keep all splats that overlap on the screen in order; and how much each band of
/// spherical harmonics changes the colours. Narrower keys may draw the same picture. The change of the colours is the
/// root mean square over all directions and splats. Splats are weighted by opacity times area, so a few large ones can
/// outweigh the others. Splats below the alpha floor of 1/255 are never visible, and are ignored for keys and
/// harmonics.
///
/// With --psnr or --ms, it changes one parameter at a time, predicts combinations, draws the most promising ones, and
/// prints a command with the best setting that it measured to be within the budget. PSNR is measured for each view
/// against the exact renderer (`render --backend reference`), as in `compare`. The exit code is 1 if no setting is
/// within the budget.
///
/// If the times of several settings differ only within the noise, it recommends the most accurate of them, and lists
/// the others as too noisy to tell. If the defaults are within the budget, it recommends them unless another setting is
/// better beyond the noise.
#[derive(Debug, clap::Args)]
#[command(mut_arg("backend", options::that_draws))]
#[command(mut_arg("pipeline", options::that_is_changed))]
#[command(mut_arg("set", options::that_is_fixed))]
#[command(mut_arg("cameras", |arg| arg.help(CAMERAS).long_help(None)))]
#[command(after_help = "Examples:
  splatgraph advise scene.ply -c cameras.json                # a report on the scene
  splatgraph advise scene.ply -c cameras.json --psnr 45      # the fastest setting with 45 dB in every view
  splatgraph advise scene.ply --ms 2 --size 1920x1080        # the most accurate within 2 ms
  splatgraph advise --psnr 50 --json=advice.json             # the demo scene")]
pub struct Args {
    #[arg(help = options::optional_scene_help())]
    scene: Option<PathBuf>,
    #[command(flatten)]
    drawing: Drawing,
    /// Lowest allowed PSNR of any view against the exact renderer, in decibels
    #[arg(long, value_name = "DB", value_parser = options::positive::<f64>)]
    psnr: Option<f64>,
    /// Largest allowed GPU time of a frame, mean over the views, in milliseconds
    #[arg(long, value_name = "MS", value_parser = options::positive::<f64>)]
    ms: Option<f64>,
    /// Number of pairs of overlapping splats per view that a depth key may leave in the wrong order
    #[arg(long, value_name = "N", default_value_t = 0)]
    errors: u64,
    /// Print everything as JSON instead of the text, or write it to FILE
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
    #[command(flatten)]
    effort: EffortArgs,
    #[command(flatten)]
    device: BackendArgs,
    #[command(flatten)]
    load: LoadOptions,
}

const CAMERAS: &str = "Cameras: a COLMAP folder, a transforms.json, a cameras.json or a glTF file; `#2` or `#NAME` selects one [default: four around the first camera beside the scene, or around the scene]";

const AROUND: u32 = 4;

pub fn run(args: &Args) -> Result<Outcome> {
    let given = args.drawing.cameras(args.scene.as_deref())?;
    let mut guard = guard(args)?;
    let sampled = args.drawing.cameras.is_none();
    let is_one = given.as_ref().is_none_or(|cameras| cameras.len() == 1);
    let scene = args.scene.as_deref();
    let (scene, mut cameras) = loading::scene_and_cameras(scene, &args.load, given, args.drawing.size)?;
    if sampled {
        cameras = keys::around(&scene, cameras.first().context("no cameras")?, AROUND);
    }
    let Drawing { pipeline, set, size, .. } = &args.drawing;
    // The exact renderer draws each camera in its own projection.
    let graph = projection::of_graph_for(pipeline, set, &cameras);
    cameras = projection::convert_all(&cameras, graph, &scene, *size)?;
    let found = describe(&scene, &cameras, args.errors);
    let name = loading::scene_name(args.scene.as_deref());
    // A standard output that is full or closed is an error only after the JSON is written.
    let mut told = Ok(());
    let mut tell = |text: &str| {
        if told.is_ok() {
            told = options::print_beside(args.json.as_deref(), text);
        }
    };
    let Description { report, keys, bands } = &found;
    tell(&format!("{name}: {report}{}{}", keys_text(keys, args.errors), bands_text(bands)));

    let budget = Budget { psnr: args.psnr, ms: args.ms };
    let mut outcome = Outcome::Done;
    let mut all = json!({ "scene": args.scene.as_deref().map(options::text_of), "cameras": cameras, "report": report, "keys": keys, "bands": bands });
    if budget != Budget::default() {
        let device = args.device.open()?;
        if let Some(path) = &args.scene {
            fit::check_header(path, &args.load, device.info(), pipeline, set)?;
        }
        let subject = Subject { device, name, scene: scene.into(), cameras };
        let setting = Setting::of_graph(pipeline, set);
        claim_graph_files(&mut guard, &subject.check(&[setting])?)?;
        let (pipeline, set) = (pipeline.clone(), set.clone());
        let wanted = Wanted { pipeline, set, budget, frames: args.effort.frames() };
        let advice = study(&subject, keys, &wanted, &mut Console::default())?;
        let (Advice { tried, unsure, .. }, Best { found, hidden }) = (&advice, advice.best());
        let origin = Provenance::of(&subject);
        let command = |found| command(args, is_one, found, (tried, &origin.device));
        tell(&found.map_or_else(|| nothing(tried, &budget), command));
        tell(&noise(found, &hidden, unsure));
        if found.is_none() {
            outcome = Outcome::Failed;
        }
        all["command"] = options::command_line().into();
        all["origin"] = json!({
            "version": origin.version, "device": origin.device, "is_cpu": origin.is_cpu, "splats": origin.splats,
            "pipeline": wanted.pipeline, "set": wanted.set, "rounds": wanted.frames.rounds, "frames": wanted.frames.frames,
        });
        all["budget"] = serde_json::to_value(budget)?;
        all["advised"] = serde_json::to_value(found)?;
        all["tried"] = serde_json::to_value(tried)?;
        let names = |of: &[&Tried]| of.iter().map(|tried| tried.setting.name.clone()).collect::<Vec<_>>();
        all["too_noisy_to_tell"] = json!({ "better": names(&hidden), "not_combined": unsure });
        if super::outcome::validated(args.device.validate, &subject.device.close()) == Outcome::Failed {
            outcome = Outcome::Failed;
        }
    }
    if let Some(path) = &args.json {
        options::write_json(path, &all)?;
    }
    told.map(|()| outcome)
}

pub(super) fn guard(args: &Args) -> Result<OutputGuard, Usage> {
    let mut guard = options::claim_inputs(args.scene.as_deref(), args.drawing.cameras.as_deref())?;
    guard.input("the graph", Path::new(&args.drawing.pipeline))?;
    args.json.iter().try_for_each(|path| guard.output("--json", path))?;
    Ok(guard)
}

/// Returns the depth mapping that needs the fewest key bits, the first of equals; `None` if none is sufficient.
fn narrowest(needs: &[Need]) -> Option<(Mapping, u32)> {
    let of = |need: &Need| Some((need.map, need.bits?));
    needs.iter().filter_map(of).reduce(|best, other| if other.1 < best.1 { other } else { best })
}

pub(super) fn keys_text(needs: &[Need], errors: u64) -> String {
    let wrong = match errors {
        0 => "no two overlapping splats change places".to_owned(),
        errors => format!("at most {errors} pairs of overlapping splats change places in a view"),
    };
    let mut text = format!("  depth keys            bits that suffice so that {wrong}: ");
    let of = |need: &Need| match need.bits {
        Some(bits) => format!("{} {bits}", need.map.name()),
        None => format!("{} more than {}", need.map.name(), WIDTHS.end()),
    };
    text += &needs.iter().map(of).collect::<Vec<_>>().join(", ");
    match narrowest(needs) {
        Some((map, bits)) => text + &format!("; narrowest: key_map={} key_bits={bits}\n", map.name()),
        None => text + "\n",
    }
}

pub(super) fn bands_text(bands: &[Band]) -> String {
    let of = |band: &Band| {
        let share = 100.0 * band.share;
        format!(
            "  band {:<17}adds {:.4} to a colour (rms, splats weighted by opacity x area), {share:.1} % of the view-dependent energy\n",
            band.band, band.rms
        )
    };
    let text: String = bands.iter().skip(1).map(of).collect();
    match bands.iter().rposition(|band| band.rms > 0.0).unwrap_or(0) {
        0 => text + "  view dependence       none: sh_degree=0 draws the same picture\n",
        _ => text,
    }
}

/// Maximum number of settings within the noise to print.
const NAMED: usize = 5;

/// Joins the first [`NAMED`] names, and adds how many others there are.
fn some(names: &[String]) -> String {
    let more = names.len().saturating_sub(NAMED);
    let named = names[..names.len() - more].join("; ");
    if more == 0 { named } else { format!("{named}; and {more} more") }
}

/// Formats the settings that noise hides: `hidden` by ascending time, then `unsure` as given. Empty if there are none.
fn noise(found: Option<&Tried>, hidden: &[&Tried], unsure: &[String]) -> String {
    let mut text = String::new();
    if !hidden.is_empty() {
        let mut hidden = hidden.to_vec();
        hidden.sort_by(|a, b| a.median().total_cmp(&b.median()));
        let of = |tried: &&Tried| {
            let (share, db) = (100.0 * tried.median(), tried.least_psnr());
            format!("{} ({db:.2} dB, {share:.1} %)", tried.setting.name)
        };
        let question = if found.is_some() { "better" } else { "fast enough" };
        let names: Vec<String> = hidden.iter().map(of).collect();
        text += &format!("  too noisy to tell whether these are {question}: {}\n", some(&names));
    }
    if !unsure.is_empty() {
        let least = 100.0 * MIN_SAVING;
        text += &format!(
            "  too noisy to tell whether these save {least:.0} %, and not combined: {}\n",
            some(unsure)
        );
    }
    text
}

fn list(psnr_db: &[f64]) -> String {
    psnr_db.iter().map(|db| format!("{db:.2}")).collect::<Vec<_>>().join(", ")
}

fn time(tried: &Tried) -> String {
    match tried.gpu_ms.zip(tried.share) {
        Some((ms, share)) => format!("{ms:.3} ms, {share} of the exact settings' time"),
        None => "the device has no timestamps".into(),
    }
}

/// Formats a complete `render` command and its measurements. `is_one`: the command draws a single picture.
fn command(args: &Args, is_one: bool, found: &Tried, (tried, device): (&[Tried], &str)) -> String {
    let mut command = "splatgraph render".to_owned();
    let mut add = |word: &str| command += &format!(" {}", shell_word(word));
    for root in planner::settings().include_roots {
        ["--include-root", &root.display().to_string()].into_iter().for_each(&mut add);
    }
    args.load.words().iter().for_each(|word| add(word));
    args.scene.iter().for_each(|path| add(&path.display().to_string()));
    args.drawing.cameras.iter().for_each(|cameras| ["-c", cameras].into_iter().for_each(&mut add));
    if args.drawing.ignore_distortion {
        add("--ignore-distortion");
    }
    args.drawing
        .size
        .iter()
        .for_each(|(w, h)| ["--size", &format!("{w}x{h}")].into_iter().for_each(&mut add));
    if found.setting.pipeline != DEFAULT_PIPELINE {
        ["--pipeline", &found.setting.pipeline].into_iter().for_each(&mut add);
    }
    for (name, value) in &found.setting.set {
        ["--set", &format!("{name}={value}")].into_iter().for_each(&mut add);
    }
    args.device.words().iter().for_each(|word| add(word));
    ["-o", if is_one { "advised.png" } else { "advised/" }].into_iter().for_each(&mut add);
    format!(
        "\n{command}\n  PSNR by view: {} dB\n  {}\n  the best of {} measured settings, on {device}\n",
        list(&found.psnr_db),
        time(found),
        tried.len()
    )
}

/// Formats the message that no setting is within the budget, with the most accurate and the fastest setting.
fn nothing(tried: &[Tried], budget: &Budget) -> String {
    let accurate = tried.iter().reduce(|a, b| if b.least_psnr() > a.least_psnr() { b } else { a });
    let quick = |tried: &Tried| tried.gpu_ms.unwrap_or(f64::INFINITY);
    let fast = tried.iter().reduce(|a, b| if quick(b) < quick(a) { b } else { a });
    let limits =
        [budget.psnr.map(|db| format!("at least {db} dB")), budget.ms.map(|ms| format!("at most {ms} ms"))];
    let mut text = format!(
        "\nnone of the {} measured settings has {}\n",
        tried.len(),
        limits.into_iter().flatten().collect::<Vec<_>>().join(" and ")
    );
    for (what, tried) in [("most accurate", accurate), ("fastest", fast)] {
        if let Some(tried) = tried {
            text +=
                &format!("  {what}: {}: {} dB, {}\n", tried.setting.name, list(&tried.psnr_db), time(tried));
        }
    }
    if budget.psnr.is_some() && accurate.is_some_and(|best| best.setting.name == EXACT) {
        text += "  the remaining error is inherent in the graph: see docs/accuracy.md\n";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;
    use crate::studies::measurement::noise::Share;
    use crate::studies::study::Setting;

    #[test]
    fn the_command_loads_the_scene_as_advise_did() {
        let words = "advise lod-meta.json --ignore-tags --level 2 --size 8x4";
        let args = parsed(words.split(' ')).expect("a command line");
        let setting = Setting { name: "x".into(), pipeline: "splat".into(), set: Vec::new() };
        let found = Tried { setting, psnr_db: vec![50.0], gpu_ms: None, share: None };
        let text = command(&args, true, &found, (&[], "none"));
        let wanted = "splatgraph render --ignore-tags --level 2 lod-meta.json --size 8x4 --pipeline splat -o advised.png";
        assert!(text.contains(wanted), "{text}");
    }

    #[test]
    fn without_a_setting_in_the_budget_the_nearest_are_told() {
        let tried = |name: &str, db: f64, ms: f64| Tried {
            setting: Setting { name: name.into(), pipeline: "splat".into(), set: Vec::new() },
            psnr_db: vec![db, db + 1.0],
            gpu_ms: Some(ms),
            share: Some(Share { median: ms / 10.0, range: Some((ms / 10.0 - 0.01, ms / 10.0 + 0.01)) }),
        };
        let all = [tried(EXACT, 80.0, 10.0), tried("target = h", 60.0, 2.5)];
        let text = nothing(&all, &Budget { psnr: Some(90.0), ms: Some(1.0) });
        assert!(
            text.contains("none of the 2 measured settings has at least 90 dB and at most 1 ms"),
            "{text}"
        );
        assert!(text.contains("most accurate: exact: 80.00, 81.00 dB, 10.000 ms, 100.0 ± 1.0 %"), "{text}");
        assert!(text.contains("fastest: target = h: 60.00, 61.00 dB, 2.500 ms, 25.0 ± 1.0 %"), "{text}");
        let text = noise(Some(&all[0]), &[&all[1]], &["key_bits = 8".into()]);
        assert!(text.contains("whether these are better: target = h (60.00 dB, 25.0 %)\n"), "{text}");
        assert!(text.contains("save 2 %, and not combined: key_bits = 8\n"), "{text}");
        let many: Vec<String> = (0..9).map(|at| at.to_string()).collect();
        assert!(noise(None, &[], &many).ends_with("not combined: 0; 1; 2; 3; 4; and 4 more\n"));
        assert!(noise(None, &[&all[1]], &[]).contains("fast enough: target = h"));
        assert_eq!(noise(None, &[], &[]), "");
    }
}
