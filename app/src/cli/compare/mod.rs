//! Runs `splatgraph compare`: measures the difference between pictures.

mod pairs;

use super::options;
use super::outcome::{Outcome, Usage};
use crate::io::image::{Depth, ENCODING, Format, Image, keep_archives, split_member};
use crate::io::output::names::{self, MAX_NAME_BYTES};
use crate::io::output::{OutputGuard, is_standard_output, one_line, say};
use crate::io::report::text;
use crate::studies::evaluation::{Mean, mean, pooled};
use anyhow::{Context, Result, bail};
use pairs::{Named, Pair, Pictures};
use serde::Serialize;
use serde_json::{Value, json};
use splatgraph_reference::metrics::flip::Seen;
use splatgraph_reference::metrics::{self, Comparison, ImageRef, MetricError};
use std::path::PathBuf;

/// Compare pictures: PSNR, SSIM, FLIP and the worst pixel
///
/// A and B are pictures (.png, .jpg, .exr, .npy, or ARCHIVE.npz#ARRAY), or folders of pictures. A .npz archive counts
/// as a folder of arrays. Pictures of two folders are matched by name without extension, and the means over all
/// pictures are printed. If a folder has only folders, their pictures count: `cam0/a` matches `cam0_a`. A picture
/// without a partner, or a pair that cannot be compared, does not stop the others: it is listed, there are no means,
/// and the exit code is 1.
///
/// PSNR is 10 log10(1 / MSE) over all pixels and channels, of values clamped to 0..1. SSIM (Wang et al. 2004, Gaussian
/// window of 11 x 11, sigma 1.5) is the mean over the channels. FLIP (Andersson et al. 2020) is the mean over the
/// pixels, 0 for equal pictures, seen with 67.02 pixels per degree. It is computed from the values themselves (`flip`
/// of --json) and from the values in 8 bits (`flip_8_bits`), as `flip` of all other commands. The worst pixel has the
/// largest difference of a channel, unclamped. If one picture has only 8 or 16 bits, values are first clamped to 0..1,
/// and --range must be within 0..1.
///
/// Alpha is not compared; `evaluate` blends it. Values are compared as they are in the files: a line tells if EXR files
/// declare different encodings or none, or different places in the frame. If both pictures have one channel, and B has
/// values outside of 0..1, as depths have, the range of B's values (with 0 and 1) becomes 0..1, and A is clamped to it.
/// Only the worst pixel keeps its unit. --range sets one range for all pictures.
///
/// Indices have no distances: if both pictures have one channel, and one has the value 4294967295, as the output
/// `index` has without splats, then unequal pixels differ by 1, and a line tells their number.
///
/// All measures are computed in f64, also for float64 arrays.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph compare out.npy golden.npz#camera0
  splatgraph compare --json before/ after/
  splatgraph compare --by-number renders/ golden.npz      # biker-0.npy with camera0, ...
  splatgraph compare a.png b.png --diff difference.png --gain 16
  splatgraph compare a.npy b.npy --min-psnr 70            # exit code 1 if below
  splatgraph compare depths/ true-depths/ --range 0,8     # 8 units are 1 in all pictures")]
pub struct Args {
    /// A picture, a folder or a .npz archive
    a: PathBuf,
    /// The picture, folder or archive to compare A with
    b: PathBuf,
    /// Print JSON instead of a table, or write it to a file
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true, default_missing_value = "-")]
    json: Option<PathBuf>,
    /// Write a picture of the absolute differences (for folders, a folder of pictures)
    #[arg(long, value_name = "OUT.png")]
    diff: Option<PathBuf>,
    /// Factor by which the differences are amplified in --diff
    #[arg(long, default_value_t = 10.0, value_parser = options::positive::<f32>, requires = "diff")]
    gain: f32,
    /// Values that become 0 and 1 before pictures are clamped; only the worst pixel keeps its unit
    #[arg(long, value_name = "LOW,HIGH", allow_hyphen_values = true, value_parser = range)]
    range: Option<(f64, f64)>,
    /// Exit with code 1 if a picture's PSNR is below this
    #[arg(long, value_name = "DB", allow_hyphen_values = true, value_parser = least_psnr)]
    min_psnr: Option<f64>,
    /// In folders, match pictures by the number at the end of their names; pictures without one are skipped and listed
    #[arg(long)]
    by_number: bool,
}

/// Parses a PSNR, which may be infinite: equal pictures have an infinite PSNR.
fn least_psnr(text: &str) -> Result<f64, String> {
    let db = text.parse().ok().filter(|db: &f64| !db.is_nan());
    db.ok_or_else(|| "expected a number of decibels, for instance 70".into())
}

/// Parses the ends of a range of values.
fn range(text: &str) -> Result<(f64, f64), String> {
    let ends = text.split_once(',').and_then(|(low, high)| Some((low.parse().ok()?, high.parse().ok()?)));
    let finite = ends.filter(|(low, high): &(f64, f64)| low < high && (high - low).is_finite());
    finite.ok_or_else(|| "expected two numbers, the lower one first, for instance 0,8".into())
}

struct Found {
    all: Comparison,
    /// Length of the value range that becomes 0..1; 1 if values are not scaled. The worst pixel is not scaled.
    peak: f64,
    flip: f64,
    flip_8_bits: f64,
}

impl Found {
    fn psnr(&self) -> f64 {
        self.all.psnr()
    }
}

/// Means over the pictures of two folders, as in `evaluate`.
#[derive(Serialize)]
struct Means {
    #[serde(flatten)]
    of_values: Mean,
    flip_8_bits: Option<f64>,
}

impl Means {
    /// Computes the means: `None` if a pair or its score is missing, because a partial mean could mislead.
    fn of(found: &[Found], missing: usize) -> Means {
        let of =
            |score: &dyn Fn(&Found) -> Option<f64>| mean(found.iter().map(score)).filter(|_| missing == 0);
        let psnr_db = of(&|found| Some(found.psnr()));
        let (ssim, flip) = (of(&|found| found.all.ssim), of(&|found| Some(found.flip)));
        let flip_8_bits = of(&|found| Some(found.flip_8_bits));
        let pooled_psnr_db = pooled(found.iter().map(|found| found.all.psnr_db)).filter(|_| missing == 0);
        Means { of_values: Mean { psnr_db, pooled_psnr_db, ssim, flip }, flip_8_bits }
    }
}

pub fn run(args: &Args) -> Result<Outcome> {
    let (text, failures) = keep_archives(|| compare(args))?;
    let printed = match &args.json {
        Some(path) => options::write_text(Some(path), &format!("{text}\n")),
        None => options::print(&text),
    };
    failures.iter().for_each(|failure| say(format!("error: {failure}")));
    printed?;
    Ok(if failures.is_empty() { Outcome::Done } else { Outcome::Failed })
}

pub(super) struct Work {
    pairs: Vec<Pair>,
    /// Pictures without a partner.
    alone: Vec<Named>,
    /// True if the arguments are folders or archives.
    folders: bool,
    /// One file per pair for its differences; empty without `--diff`.
    diffs: Vec<PathBuf>,
}

/// Finds the pictures to compare, and chooses the files of the differences.
///
/// # Errors
/// An argument does not exist, one is a picture and the other a folder, no picture has a partner, `--diff` is no
/// picture, or an output would overwrite a picture or another output.
pub(super) fn prepare(args: &Args) -> Result<Work> {
    let (a, b) = (Pictures::of(&args.a)?, Pictures::of(&args.b)?);
    let ((pairs, alone), folders) = match (a, b) {
        (Pictures::One(a), Pictures::One(b)) => {
            ((vec![Pair { name: a.display().to_string(), a, b }], Vec::new()), false)
        }
        (Pictures::Many(a), Pictures::Many(b)) => (pairs::pairs(args.by_number, a, b)?, true),
        _ => {
            let message = "expected two pictures or two folders, found one of each";
            return Err(Usage(message.into()).into());
        }
    };

    let diffs = match &args.diff {
        None => Vec::new(),
        Some(out) if is_standard_output(out) => {
            return Err(Usage(
                "expected a file for --diff, found `-`: standard output has the result".into(),
            )
            .into());
        }
        Some(out) if folders => {
            // Array names in an archive may be any text.
            let names: Vec<String> = pairs.iter().map(|pair| pair.name.clone()).collect();
            let names = names::unique(&names, MAX_NAME_BYTES - ".png".len());
            names.iter().map(|name| out.join(format!("{name}.png"))).collect()
        }
        Some(out) if Format::of(out).is_none() => {
            return Err(Usage(format!(
                "expected a picture for --diff (.png, .exr or .npy), found {}",
                out.display()
            ))
            .into());
        }
        Some(out) => vec![out.clone()],
    };
    let mut guard = OutputGuard::default();
    let unpaired = alone.iter().map(|(_, path)| path);
    for path in pairs.iter().flat_map(|pair| [&pair.a, &pair.b]).chain(unpaired) {
        let file = split_member(path).map_or_else(|| path.clone(), |(archive, _)| archive);
        guard.input("a compared picture", &file).map_err(Usage::from)?;
    }
    diffs.iter().try_for_each(|path| guard.output("--diff", path)).map_err(Usage::from)?;
    args.json.iter().try_for_each(|path| guard.output("--json", path)).map_err(Usage::from)?;
    Ok(Work { pairs, alone, folders, diffs })
}

/// Facts of all pairs, for lines that are printed once.
#[derive(Default)]
struct Notes {
    /// EXR files of colours that do not declare their encoding.
    undeclared: Vec<PathBuf>,
    /// Number of differences that are smaller because values are clamped, and number of all differences.
    lessened: (usize, usize),
}

impl Notes {
    fn tell(&self) {
        if let Some(first) = self.undeclared.first() {
            let (files, declare) = match self.undeclared.len() - 1 {
                0 => (String::new(), "declares"),
                more => (format!(" and {more} more"), "declare"),
            };
            let first = first.display();
            say(format!("{first}{files} {declare} no encoding: values are compared as display-encoded"));
        }
        let (lessened, all) = self.lessened;
        if lessened > 0 {
            say(format!(
                "{lessened} of {all} differences are smaller because values are clamped; the worst pixel's is not (--range sets the range, for colours 0 to 1 by default)"
            ));
        }
    }
}

/// Compares the pictures, and writes the files of `--diff`. Returns the text to print, and the reasons to fail: a PSNR
/// below `--min-psnr`, and pictures of folders that cannot be compared. Fails if no pair can be compared.
fn compare(args: &Args) -> Result<(String, Vec<String>)> {
    let Work { pairs, alone, folders, diffs } = prepare(args)?;
    let mut notes = Notes::default();
    let (mut drawn, mut found, mut missing) = (Vec::new(), Vec::new(), Vec::new());
    for (index, pair) in pairs.iter().enumerate() {
        match measure(pair, args, &mut notes) {
            Ok((of_pair, difference)) => {
                if let Some((out, difference)) = diffs.get(index).zip(difference) {
                    difference.save(out)?;
                }
                drawn.push(pair);
                found.push(of_pair);
            }
            Err(error) if folders => {
                say(format!("{error:#}"));
                missing.push(pair.name.as_str());
            }
            Err(error) => return Err(error),
        }
    }
    for (name, path) in &alone {
        say(format!("{} has no partner", path.display()));
        missing.push(name);
    }
    notes.tell();

    let worst = (0..found.len()).min_by(|&i, &j| found[i].psnr().total_cmp(&found[j].psnr()));
    let Some(worst) = worst else { bail!("expected at least one pair that can be compared, found none") };
    let text = if args.json.is_some() {
        format!("{:#}", report(&drawn, &found, worst, folders.then_some(&missing)))
    } else if folders {
        table(&drawn, &found, worst, missing.len())
    } else {
        sentence(&found[0])
    };
    let psnr = found[worst].psnr();
    let below = args.min_psnr.filter(|least| psnr < *least).map(|least| {
        let name = one_line(&drawn[worst].name);
        format!("{name}: expected at least the {least} dB of --min-psnr, found {psnr:.4} dB")
    });
    let incomplete =
        format!("{} of {} pictures cannot be compared", missing.len(), found.len() + missing.len());
    let failures = below.into_iter().chain((!missing.is_empty()).then_some(incomplete));
    Ok((text, failures.collect()))
}

/// Compares two pictures. Also returns the picture of their differences, if `--diff` wants one.
fn measure(pair: &Pair, args: &Args, notes: &mut Notes) -> Result<(Found, Option<Image>)> {
    let Loaded { mut a, mut b, are_grey, has_levels } = load(pair, args.range, notes)?;
    if are_grey && args.range.is_none() && [&a, &b].into_iter().any(has_indices) {
        let unequal = mark_unequal(&mut a, &mut b);
        say(format!("{}: {unequal} of {} indices are unequal, and differ by 1 here", pair.name, a.rgb.len()));
    }
    let (least, most) = args.range.unwrap_or_else(|| if are_grey { range_of(&b) } else { (0.0, 1.0) });
    let (peak, is_scaled) = (most - least, (least, most) != (0.0, 1.0));
    let unscaled = is_scaled.then(|| metrics::worst_pixel((&a).into(), (&b).into()));
    if is_scaled {
        if args.range.is_none() {
            say(format!(
                "{}: the range of B's values, {least} to {most}, becomes 0 to 1 for all but the worst pixel",
                pair.name
            ));
        }
        let values = [&mut a, &mut b].map(|image| image.rgb.as_flattened_mut()).into_iter().flatten();
        values.for_each(|value| *value = (*value - least) / peak);
    }
    let mut all = metrics::compare((&a).into(), (&b).into()).with_context(|| cannot(pair))?;
    if let Some(worst) = unscaled {
        // Scaling rounds, and different values may become equal.
        all = Comparison { worst, identical: worst.difference == 0.0, ..all };
    }
    // Integers have no values outside of 0 to 1, so nothing is known of such differences.
    if !has_levels {
        // A grey value is in all three channels.
        let step = if are_grey { 3 } else { 1 };
        let values = || a.rgb.as_flattened().iter().zip(b.rgb.as_flattened()).step_by(step);
        let is_smaller = |(a, b): &(&f64, &f64)| {
            let [a_shown, b_shown] = [a, b].map(|value| value.clamp(0.0, 1.0));
            (a_shown - b_shown).abs() < (*a - *b).abs()
        };
        notes.lessened.0 += values().filter(is_smaller).count();
        notes.lessened.1 += values().len();
    }
    let difference = args.diff.is_some().then(|| Image::difference(&a, &b, args.gain));
    let flip = |seen: fn(ImageRef) -> Seen| seen((&b).into()).flip(&seen((&a).into()), None);
    let (flip, flip_8_bits) = (flip(Seen::of_floats), flip(Seen::of_8_bits));
    Ok((Found { all, peak, flip, flip_8_bits }, difference))
}

/// Returns true if a picture of one channel contains 4294967295, which stands for no splat.
fn has_indices(picture: &Image<f64>) -> bool {
    picture.rgb.iter().any(|pixel| pixel[0] == f64::from(u32::MAX))
}

/// Sets unequal pixels to 1 in `a` and 0 in `b`, and equal ones to 0 in both. Returns the number of unequal pixels.
fn mark_unequal(a: &mut Image<f64>, b: &mut Image<f64>) -> usize {
    let mut unequal = 0;
    for (a, b) in a.rgb.iter_mut().zip(&mut b.rgb) {
        let is_unequal = a != b;
        unequal += usize::from(is_unequal);
        (*a, *b) = ([f64::from(u8::from(is_unequal)); 3], [0.0; 3]);
    }
    unequal
}

fn cannot(pair: &Pair) -> String {
    format!("{} and {} cannot be compared", pair.a.display(), pair.b.display())
}

struct Loaded {
    a: Image<f64>,
    b: Image<f64>,
    /// True if both have one channel.
    are_grey: bool,
    /// True if one has only 8 or 16 bits: both are then clamped.
    has_levels: bool,
}

/// Loads two pictures. `range` is that of `--range`.
///
/// # Errors
/// A picture cannot be read, or the sizes differ. Or a picture has only 8 or 16 bits, and the range is not within 0 to
/// 1, or the other one is a grey map with other values.
fn load(pair: &Pair, range: Option<(f64, f64)>, notes: &mut Notes) -> Result<Loaded> {
    let headers = [Image::header(&pair.a)?, Image::header(&pair.b)?];
    let [(a_width, a_height), (b_width, b_height)] = headers.each_ref().map(|header| header.size);
    if (a_width, a_height) != (b_width, b_height) {
        // Reject pictures of two sizes before either is decoded.
        let error = MetricError::Sizes { a_width, a_height, b_width, b_height };
        return Err(anyhow::Error::new(error).context(cannot(pair)));
    }
    let ((a, a_depth), (b, b_depth)) = (Image::load_wide(&pair.a)?, Image::load_wide(&pair.b)?);
    for ((path, header), depth) in [&pair.a, &pair.b].into_iter().zip(&headers).zip([a_depth, b_depth]) {
        // Levels hold no values outside of 0 to 1, and the other picture is clamped to that range, too.
        if let (Depth::Levels(greatest), Some((least, most))) = (depth, range)
            && (least < 0.0 || most > 1.0)
        {
            let path = path.display();
            bail!(
                "{path}: expected floats for --range {least},{most}, found levels 0 to {greatest}, which are 0 to 1"
            );
        }
        if header.has_alpha {
            say(format!("{}: its alpha is not compared", path.display()));
        }
        let is_colour = Format::of(path) == Some(Format::Exr) && !header.is_grey;
        if is_colour && header.encoding.is_none() {
            notes.undeclared.push(path.clone());
        }
    }
    let (a_name, b_name) = (pair.a.display(), pair.b.display());
    let [a_encoding, b_encoding] = headers.each_ref().map(|h| h.encoding.as_deref().unwrap_or(ENCODING));
    if a_encoding != b_encoding {
        say(format!(
            "{a_name} and {b_name} are compared without conversion, though their encodings are {a_encoding} and {b_encoding}"
        ));
    }
    let [a_corner, b_corner] = headers.each_ref().map(|header| header.corner);
    if a_corner != b_corner {
        say(format!(
            "{a_name} and {b_name} are compared from their first pixels, which are at {a_corner:?} and {b_corner:?} of the frame"
        ));
    }
    // Each integer level becomes the nearest float of the other picture's precision.
    let levels = [a_depth, b_depth].map(|depth| matches!(depth, Depth::Levels(_)));
    let has_levels = levels.contains(&true);
    let are_grey = headers.iter().all(|header| header.is_grey);
    let beside_levels = match levels {
        [true, false] => Some((&b, b_name, a_name)),
        [false, true] => Some((&a, a_name, b_name)),
        _ => None,
    };
    // Clamped to the range of levels, a map of depths would be white.
    if are_grey
        && let Some((floats, name, levels_name)) = beside_levels
        && let Some(found) = farthest_outside(floats)
    {
        bail!(
            "{name}: expected values of 0 to 1, which {levels_name} has by its levels, found {found}; give both as floats (.npy, .exr)"
        );
    }
    let (a, b) = match (a_depth, b_depth) {
        (Depth::Levels(greatest), Depth::Double) => (a.levels(greatest).clamped(), b.clamped()),
        (Depth::Double, Depth::Levels(greatest)) => (a.clamped(), b.levels(greatest).clamped()),
        _ if has_levels => (a.clamped(), b.clamped()),
        _ => (a, b),
    };
    Ok(Loaded { a, b, are_grey, has_levels })
}

/// Returns the value of a grey picture that is farthest outside of 0 to 1; `None` if all are within.
fn farthest_outside(picture: &Image<f64>) -> Option<f64> {
    let beyond = |value: f64| (value - value.clamp(0.0, 1.0)).abs();
    let values = picture.rgb.iter().map(|pixel| pixel[0]).filter(|value| beyond(*value) > 0.0);
    values.max_by(|a, b| beyond(*a).total_cmp(&beyond(*b)))
}

/// Returns the range of a grey picture's finite values, extended to contain 0 and 1.
fn range_of(picture: &Image<f64>) -> (f64, f64) {
    let values = picture.rgb.iter().map(|pixel| pixel[0]).filter(|value| value.is_finite());
    values.fold((0.0, 1.0), |(least, most), value| (value.min(least), value.max(most)))
}

fn decibels(c: &Comparison) -> String {
    format!("{:.2}", c.psnr())
}

fn similarity(c: &Comparison) -> String {
    c.ssim.map_or("-".into(), |v| format!("{v:.6}"))
}

fn sentence(found: &Found) -> String {
    let (c, worst) = (&found.all, &found.all.worst);
    format!(
        "PSNR {} dB, SSIM {}, FLIP {:.6} ({:.6} in 8 bits), worst pixel {} at ({}, {}){}",
        decibels(c),
        similarity(c),
        found.flip,
        found.flip_8_bits,
        digits(worst.difference),
        worst.x,
        worst.y,
        if c.identical { ": identical" } else { "" }
    )
}

fn digits(difference: f64) -> String {
    if difference > 0.0 && difference < 1e-6 {
        format!("{difference:.1e}")
    } else {
        format!("{difference:.6}")
    }
}

fn table(pairs: &[&Pair], found: &[Found], worst: usize, missing: usize) -> String {
    let head = ["picture", "PSNR dB", "SSIM", "FLIP", "FLIP 8 bits", "worst pixel", "at"];
    let rows = pairs.iter().zip(found).map(|(pair, found)| {
        let (c, worst) = (&found.all, &found.all.worst);
        vec![
            one_line(&pair.name).into_owned(),
            decibels(c),
            similarity(c),
            format!("{:.6}", found.flip),
            format!("{:.6}", found.flip_8_bits),
            digits(worst.difference),
            format!("({}, {})", worst.x, worst.y),
        ]
    });
    let Means { of_values, flip_8_bits } = Means::of(found, missing);
    let Mean { psnr_db, ssim, flip, .. } = of_values;
    let [ssim, flip, flip_8_bits] = [ssim, flip, flip_8_bits].map(|mean| text::number(mean, 6));
    let (psnr, count) = (
        text::number(psnr_db, 2),
        match missing {
            0 => format!("{} pictures", found.len()),
            missing => format!("{} of {} pictures", found.len(), found.len() + missing),
        },
    );
    let mean = vec!["mean".into(), psnr, ssim, flip, flip_8_bits, String::new(), count];
    text::table(head, rows.chain([mean]).chain(of_values.pooled_row(head.len())))
        + &format!("worst: {}, {}", one_line(&pairs[worst].name), sentence(&found[worst]))
}

/// Makes the JSON report. `missing` names the pictures of folders that cannot be compared; `None` without folders. An
/// infinite PSNR is the text `inf`.
fn report(pairs: &[&Pair], found: &[Found], worst: usize, missing: Option<&Vec<&str>>) -> Value {
    let entry = |pair: &Pair, found: &Found| {
        let pair =
            json!({ "name": pair.name, "a": options::text_of(&pair.a), "b": options::text_of(&pair.b) });
        let rest = json!({ "peak": found.peak, "flip": found.flip, "flip_8_bits": found.flip_8_bits });
        options::with_fields(options::with_fields(pair, json!(found.all)), rest)
    };
    let Some(missing) = missing else { return entry(pairs[0], &found[0]) };
    let entries: Vec<Value> = pairs.iter().zip(found).map(|(p, c)| entry(p, c)).collect();
    let mean = Means::of(found, missing.len());
    json!({ "pictures": entries, "missing": missing, "mean": mean, "worst": pairs[worst].name })
}

#[cfg(test)]
mod tests;
