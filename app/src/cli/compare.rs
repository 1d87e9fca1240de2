//! Runs `splatgraph compare`: measures the difference between pictures.

use super::options;
use super::outcome::{Outcome, Usage};
use crate::io::image::{Depth, ENCODING, Format, Image, npz_names, split_member};
use crate::io::output::names::{self, MAX_NAME_BYTES};
use crate::io::output::{OutputGuard, is_standard_output, one_line, say};
use crate::io::report::text;
use crate::studies::evaluation::{Mean, mean};
use anyhow::{Context, Result, bail};
use serde::Serialize;
use serde_json::{Value, json};
use splatgraph_reference::metrics::flip::Seen;
use splatgraph_reference::metrics::{self, Comparison, ImageRef, MetricError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Compare pictures: PSNR, SSIM, FLIP and the worst pixel
///
/// A and B are pictures (.png, .exr, .npy, or ARCHIVE.npz#ARRAY), or folders of pictures. A .npz archive counts as a
/// folder of arrays. Pictures of two folders are matched by name without extension, and the means over all pictures are
/// printed. A picture without a partner is an error.
///
/// PSNR is 10 log10(1 / MSE) over all pixels and channels, of values clamped to 0..1. SSIM (Wang et al. 2004, Gaussian
/// window of 11 x 11, sigma 1.5) is the mean over the channels. FLIP (Andersson et al. 2020) is the mean over the
/// pixels, 0 for equal pictures. It is computed from the values themselves and from the values in 8 bits, as in
/// `trade`. The worst pixel has the largest difference of a channel, unclamped. If one picture has only 8 or 16 bits,
/// values are clamped to 0..1.
///
/// Alpha is not compared; `evaluate` blends it. Values are compared as they are in the files: a line tells if EXR files
/// declare different encodings, or different places in the frame. If both pictures have one channel and values outside
/// of 0..1, as depths have, the range of the values of both (with 0 and 1) becomes 0..1. Only the worst pixel keeps its
/// unit.
///
/// All measures are computed in f64, also for float64 arrays.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph compare out.npy golden.npz#camera0
  splatgraph compare --json before/ after/
  splatgraph compare --by-number renders/ golden.npz      # biker-0.npy with camera0, ...
  splatgraph compare a.png b.png --diff difference.png --gain 16
  splatgraph compare a.npy b.npy --min-psnr 70            # exit code 1 if below")]
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

struct Found {
    all: Comparison,
    /// Length of the range of values that becomes 0..1 for all measures but the worst pixel; 1 for pictures.
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
    fn of(found: &[Found]) -> Means {
        let of = |score: &dyn Fn(&Found) -> Option<f64>| mean(found.iter().map(score));
        let psnr_db = of(&|found| Some(found.psnr()));
        let (ssim, flip) = (of(&|found| found.all.ssim), of(&|found| Some(found.flip)));
        let flip_8_bits = of(&|found| Some(found.flip_8_bits));
        Means { of_values: Mean { psnr_db, ssim, flip }, flip_8_bits }
    }
}

struct Pair {
    name: String,
    a: PathBuf,
    b: PathBuf,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let (text, below) = compare(args)?;
    let printed = match &args.json {
        Some(path) => options::write_text(Some(path), &format!("{text}\n")),
        None => options::print(&text),
    };
    if let Some(below) = &below {
        say(format!("error: {below}"));
    }
    printed?;
    Ok(if below.is_some() { Outcome::Failed } else { Outcome::Done })
}

pub(super) struct Work {
    pairs: Vec<Pair>,
    /// True if the arguments are folders or archives.
    folders: bool,
    /// One file per pair for its differences; empty without `--diff`.
    diffs: Vec<PathBuf>,
}

/// Finds the pictures to compare, and chooses the files of the differences.
///
/// # Errors
/// One argument is a picture and the other a folder, a picture has no partner, `--diff` is no picture, or an output
/// would overwrite a picture or another output.
pub(super) fn prepare(args: &Args) -> Result<Work> {
    let (a, b) = (Pictures::of(&args.a)?, Pictures::of(&args.b)?);
    let (pairs, folders) = match (a, b) {
        (Pictures::One(a), Pictures::One(b)) => (vec![Pair { name: a.display().to_string(), a, b }], false),
        (Pictures::Many(a), Pictures::Many(b)) => (pairs(args, a, b)?, true),
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
    for path in pairs.iter().flat_map(|pair| [&pair.a, &pair.b]) {
        let file = split_member(path).map_or_else(|| path.clone(), |(archive, _)| archive);
        guard.input("a compared picture", &file).map_err(Usage::from)?;
    }
    diffs.iter().try_for_each(|path| guard.output("--diff", path)).map_err(Usage::from)?;
    args.json.iter().try_for_each(|path| guard.output("--json", path)).map_err(Usage::from)?;
    Ok(Work { pairs, folders, diffs })
}

/// Compares the pictures. Returns the text to print, and an error if a PSNR is below `--min-psnr`.
fn compare(args: &Args) -> Result<(String, Option<String>)> {
    let Work { pairs, folders, diffs } = prepare(args)?;
    let mut found = Vec::with_capacity(pairs.len());
    for (index, pair) in pairs.iter().enumerate() {
        let (mut a, mut b, are_grey) = load(pair)?;
        let (least, most) = if are_grey { range_of(&a, &b) } else { (0.0, 1.0) };
        let peak = most - least;
        let unscaled = (peak != 1.0).then(|| metrics::worst_pixel((&a).into(), (&b).into()));
        if peak != 1.0 {
            say(format!(
                "{}: the range of the values, {least} to {most}, becomes 0 to 1 for all but the worst pixel",
                pair.name
            ));
            let values = [&mut a, &mut b].map(|image| image.rgb.as_flattened_mut()).into_iter().flatten();
            values.for_each(|value| *value = (*value - least) / peak);
        }
        let mut all = metrics::compare((&a).into(), (&b).into()).with_context(|| cannot(pair))?;
        if let Some(worst) = unscaled {
            // Scaling rounds, and different values may become equal.
            all = Comparison { worst, identical: worst.difference == 0.0, ..all };
        }
        if let Some(out) = diffs.get(index) {
            Image::difference(&a, &b, args.gain).save(out)?;
        }
        let flip = |seen: fn(ImageRef) -> Seen| seen((&b).into()).flip(&seen((&a).into()));
        let (flip, flip_8_bits) = (flip(Seen::of_floats), flip(Seen::of_8_bits));
        found.push(Found { all, peak, flip, flip_8_bits });
    }

    let worst = (0..found.len()).min_by(|&i, &j| found[i].psnr().total_cmp(&found[j].psnr()));
    let Some(worst) = worst else { bail!("expected at least one picture, found none") };
    let text = if args.json.is_some() {
        format!("{:#}", report(&pairs, &found, worst, folders))
    } else if folders {
        table(&pairs, &found, worst)
    } else {
        sentence(&found[0])
    };
    let psnr = found[worst].psnr();
    let below = args.min_psnr.filter(|least| psnr < *least).map(|least| {
        let name = one_line(&pairs[worst].name);
        format!("{name}: expected at least the {least} dB of --min-psnr, found {psnr:.4} dB")
    });
    Ok((text, below))
}

enum Pictures {
    One(PathBuf),
    /// Pictures of a folder by name without extension, or arrays of an archive by name.
    Many(BTreeMap<String, PathBuf>),
}

impl Pictures {
    fn of(path: &Path) -> Result<Pictures> {
        if split_member(path).is_some() {
            return Ok(Pictures::One(path.to_owned()));
        }
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz")) {
            let named = npz_names(path)?.into_iter().map(|name| {
                let member = PathBuf::from(format!("{}#{name}", path.display()));
                (name, member)
            });
            return Ok(Pictures::Many(named.collect()));
        }
        if !path.is_dir() {
            return Ok(Pictures::One(path.to_owned()));
        }
        let mut pictures = BTreeMap::new();
        let entries =
            std::fs::read_dir(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        for entry in entries {
            let file = entry.with_context(|| format!("{}: cannot be read", path.display()))?.path();
            let Some(stem) = file.file_stem() else { continue };
            // The folder may hold other files, such as statistics.
            if Format::of(&file).is_none() {
                continue;
            }
            // Names that are not UTF-8 must stay distinct.
            let escaped = || stem.as_encoded_bytes().escape_ascii().to_string();
            let name = stem.to_str().map_or_else(escaped, str::to_owned);
            if let Some(other) = pictures.insert(name, file.clone()) {
                bail!("{} and {} have the same name without extension", other.display(), file.display());
            }
        }
        Ok(Pictures::Many(pictures))
    }
}

/// Pairs the pictures of two folders or archives. An error lists the pictures without a partner.
fn pairs(args: &Args, a: BTreeMap<String, PathBuf>, b: BTreeMap<String, PathBuf>) -> Result<Vec<Pair>> {
    let (a, mut b) = if args.by_number { (numbered(a)?, numbered(b)?) } else { (plain(a), plain(b)) };
    let mut pairs = Vec::new();
    let mut alone = Vec::new();
    for (key, (name, a_path)) in a {
        match b.remove(&key) {
            Some((_, b_path)) => pairs.push(Pair { name, a: a_path, b: b_path }),
            None => alone.push(a_path),
        }
    }
    alone.extend(b.into_values().map(|(_, path)| path));
    if alone.is_empty() {
        return Ok(pairs);
    }
    let list: Vec<String> = alone.iter().map(|p| format!("\n  {}", p.display())).collect();
    let hint = if pairs.is_empty() && !args.by_number {
        "\nno two names match; --by-number matches by the number at the end"
    } else {
        ""
    };
    bail!("these pictures have no partner:{}{hint}", list.concat());
}

/// Names and files of one side, by the key that pairs them with the other side.
type Keyed = BTreeMap<(u64, String), (String, PathBuf)>;

fn plain(pictures: BTreeMap<String, PathBuf>) -> Keyed {
    pictures.into_iter().map(|(stem, path)| ((0, stem.clone()), (stem, path))).collect()
}

fn numbered(pictures: BTreeMap<String, PathBuf>) -> Result<Keyed> {
    let mut keyed = Keyed::new();
    for (stem, path) in pictures {
        let digits = stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        match stem[digits..].parse::<u64>() {
            Ok(number) => {
                if let Some((_, other)) = keyed.insert((number, String::new()), (stem, path.clone())) {
                    bail!("{} and {} end in the same number", other.display(), path.display());
                }
            }
            Err(_) => say(format!("skipped: {} (its name does not end in a number)", path.display())),
        }
    }
    Ok(keyed)
}

fn cannot(pair: &Pair) -> String {
    format!("{} and {} cannot be compared", pair.a.display(), pair.b.display())
}

/// Loads two pictures. The last value is true if both have one channel.
fn load(pair: &Pair) -> Result<(Image<f64>, Image<f64>, bool)> {
    let headers = [Image::header(&pair.a)?, Image::header(&pair.b)?];
    let [(a_width, a_height), (b_width, b_height)] = headers.each_ref().map(|header| header.size);
    if (a_width, a_height) != (b_width, b_height) {
        // Reject pictures of two sizes before either is decoded.
        let error = MetricError::Sizes { a_width, a_height, b_width, b_height };
        return Err(anyhow::Error::new(error).context(cannot(pair)));
    }
    let ((a, a_depth), (b, b_depth)) = (Image::load_wide(&pair.a)?, Image::load_wide(&pair.b)?);
    for (path, header) in [&pair.a, &pair.b].into_iter().zip(&headers) {
        if header.has_alpha {
            say(format!("{}: its alpha is not compared", path.display()));
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
    let (a, b) = match (a_depth, b_depth) {
        (Depth::Levels(greatest), Depth::Double) => (a.levels(greatest).clamped(), b.clamped()),
        (Depth::Double, Depth::Levels(greatest)) => (a.clamped(), b.levels(greatest).clamped()),
        (Depth::Levels(_), _) | (_, Depth::Levels(_)) => (a.clamped(), b.clamped()),
        _ => (a, b),
    };
    Ok((a, b, headers.iter().all(|header| header.is_grey)))
}

/// Returns the least and the largest value of two grey pictures, at most 0 and at least 1.
fn range_of(a: &Image<f64>, b: &Image<f64>) -> (f64, f64) {
    let values = a.rgb.iter().chain(&b.rgb).map(|pixel| pixel[0]).filter(|value| value.is_finite());
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

fn table(pairs: &[Pair], found: &[Found], worst: usize) -> String {
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
    let Means { of_values: Mean { psnr_db, ssim, flip }, flip_8_bits } = Means::of(found);
    let [ssim, flip, flip_8_bits] = [ssim, flip, flip_8_bits].map(|mean| text::number(mean, 6));
    let (psnr, count) = (text::number(psnr_db, 2), format!("{} pictures", found.len()));
    let mean = vec!["mean".into(), psnr, ssim, flip, flip_8_bits, String::new(), count];
    text::table(head, rows.chain([mean]))
        + &format!("worst: {}, {}", one_line(&pairs[worst].name), sentence(&found[worst]))
}

/// Makes the JSON report. An infinite PSNR is the text `inf`.
fn report(pairs: &[Pair], found: &[Found], worst: usize, folders: bool) -> Value {
    let entry = |pair: &Pair, found: &Found| {
        let mut entry =
            json!({ "name": pair.name, "a": options::text_of(&pair.a), "b": options::text_of(&pair.b) });
        if let (Value::Object(entry), Ok(Value::Object(metrics))) =
            (&mut entry, serde_json::to_value(found.all))
        {
            entry.extend(metrics);
            entry.insert("peak".into(), found.peak.into());
            entry.insert("flip".into(), found.flip.into());
            entry.insert("flip_8_bits".into(), found.flip_8_bits.into());
        }
        entry
    };
    if !folders {
        return entry(&pairs[0], &found[0]);
    }
    let entries: Vec<Value> = pairs.iter().zip(found).map(|(p, c)| entry(p, c)).collect();
    json!({ "pictures": entries, "mean": Means::of(found), "worst": pairs[worst].name })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;

    fn grey(value: f32) -> Image {
        Image { width: 12, height: 12, rgb: vec![[value; 3]; 144] }
    }

    fn folders(a: &[(&str, f32)], b: &[(&str, f32)]) -> (tempfile::TempDir, PathBuf, PathBuf) {
        let root = tempfile::tempdir().unwrap();
        let folder = |name: &str, pictures: &[(&str, f32)]| {
            let folder = root.path().join(name);
            for (name, value) in pictures {
                grey(*value).save(&folder.join(name)).unwrap();
            }
            folder
        };
        let (a, b) = (folder("a", a), folder("b", b));
        (root, a, b)
    }

    /// Returns the printed text, and the error of `--min-psnr`.
    fn told(a: &Path, b: &Path, options: &[&str]) -> Result<(String, Option<String>)> {
        let line = [&["compare", a.to_str().unwrap(), b.to_str().unwrap()], options].concat();
        compare(&parsed(line)?)
    }

    fn compared(a: &Path, b: &Path, options: &[&str]) -> Result<Option<String>> {
        told(a, b, options).map(|(_, below)| below)
    }

    #[test]
    fn folders_are_matched_by_stem_whatever_the_format_and_the_worst_decides() {
        let (_root, a, b) = folders(&[("x.npy", 0.5), ("y.exr", 0.5)], &[("x.exr", 0.5), ("y.png", 0.6)]);
        std::fs::write(a.join("stats.json"), "{}").unwrap();
        // 0.6 is 153 / 255, and a difference of 0.1 is 20 dB.
        assert_eq!(compared(&a, &b, &["--min-psnr", "19.9"]).unwrap(), None);
        let error = compared(&a, &b, &["--min-psnr", "20.1"]).unwrap().unwrap();
        assert!(error.starts_with("y: expected at least the 20.1 dB of --min-psnr, found 20.00"), "{error}");
    }

    #[test]
    fn the_means_of_two_folders_are_those_of_decibels() {
        let (_root, a, b) = folders(&[("x.npy", 0.5), ("y.npy", 0.5)], &[("x.npy", 0.6), ("y.npy", 0.51)]);
        let json: Value = serde_json::from_str(&told(&a, &b, &["--json"]).unwrap().0).unwrap();
        let near = |name: &str, expected: f64| {
            let found = json["mean"][name].as_f64().unwrap();
            assert!((found - expected).abs() < 1e-4, "{name}: {found}, expected {expected}");
        };
        near("psnr_db", 30.0);
        for name in ["ssim", "flip", "flip_8_bits"] {
            let of = |picture: usize| json["pictures"][picture][name].as_f64().unwrap();
            near(name, 0.5 * (of(0) + of(1)));
        }
        let text = told(&a, &b, &[]).unwrap().0;
        let mean = text.lines().find(|line| line.starts_with("mean")).unwrap();
        assert!(mean.contains(" 30.00 ") && mean.ends_with("2 pictures"), "{text}");
        std::fs::copy(a.join("x.npy"), b.join("x.npy")).unwrap();
        assert!(told(&a, &b, &["--json"]).unwrap().0.contains("\"psnr_db\": \"inf\""));
    }

    #[test]
    fn float64_arrays_keep_their_digits_and_8_bits_are_the_nearest_float_of_either_kind() {
        let root = tempfile::tempdir().unwrap();
        let path = |name: &str| root.path().join(name);
        let said = |a: &str, b: &str, options: &[&str]| told(&path(a), &path(b), options).unwrap().0;
        let double = |name: &str, value: f64| {
            crate::io::image::save_words(&path(name), &[12, 12, 3], &[value; 3 * 144]).unwrap();
        };
        double("a.npy", 0.2);
        double("b.npy", 0.2 + 1e-9);
        let text = said("a.npy", "b.npy", &[]);
        assert!(text.starts_with("PSNR 180.00 dB") && text.contains("worst pixel 1.0e-9 at"), "{text}");
        assert!(!text.contains("identical"), "{text}");
        let json: Value = serde_json::from_str(&said("a.npy", "b.npy", &["--json"])).unwrap();
        assert!(json["identical"] == false && json["flip"].as_f64() > Some(0.0), "{json}");
        assert_eq!(json["flip_8_bits"], 0.0, "{json}");
        // 51 / 255 is 0.2 in single and in double precision.
        grey(0.2).save(&path("single.npy")).unwrap();
        grey(0.2).save(&path("levels.png")).unwrap();
        for name in ["a.npy", "single.npy"] {
            assert!(said("levels.png", name, &[]).ends_with(": identical"), "{name}");
            assert!(said(name, "levels.png", &[]).ends_with(": identical"), "{name}");
        }
        assert!(!said("a.npy", "single.npy", &[]).contains("identical"));
    }

    #[test]
    fn depths_and_counts_of_the_program_s_own_outputs_are_compared() {
        let root = tempfile::tempdir().unwrap();
        let (a, b) = (root.path().join("a.npy"), root.path().join("b.npy"));
        crate::io::image::save_words(&a, &[12, 12], &[3u32; 144]).unwrap();
        crate::io::image::save_words(&b, &[12, 12], &[5u32; 144]).unwrap();
        let text = told(&a, &b, &[]).unwrap().0;
        assert!(text.contains("worst pixel 2.000000 at (0, 0)") && !text.contains("identical"), "{text}");
        // 20 log10(5 / 2)
        assert!(text.starts_with("PSNR 7.96 dB"), "{text}");
        assert!(compared(&a, &b, &["--min-psnr", "8"]).unwrap().is_some());
        // Negative values differ, too: 20 log10((1 + 4) / 1).
        for (path, value) in [(&a, -3.0), (&b, -4.0)] {
            crate::io::image::save_words(path, &[12, 12], &[value; 144]).unwrap();
        }
        assert!(told(&a, &b, &[]).unwrap().0.starts_with("PSNR 13.98 dB"));
        // A grey picture in colour channels is clamped like every picture.
        [(&a, 1.0), (&b, 7.0)].iter().for_each(|(path, value)| grey(*value).save(path).unwrap());
        assert!(told(&a, &b, &[]).unwrap().0.starts_with("PSNR inf dB"));
    }

    #[test]
    fn pictures_without_a_partner_are_an_error_that_lists_them() {
        let (_root, a, b) = folders(&[("x.npy", 0.5), ("y.npy", 0.5)], &[("x.npy", 0.5), ("z.npy", 0.5)]);
        let message = compared(&a, &b, &[]).unwrap_err().to_string();
        assert!(
            message.contains("y.npy") && message.contains("z.npy") && !message.contains("x.npy"),
            "{message}"
        );
    }

    #[test]
    fn names_can_be_matched_by_the_number_at_their_end() {
        let (_root, a, b) = folders(
            &[("biker-0.npy", 0.5), ("biker-10.npy", 0.2)],
            &[("camera0.npy", 0.5), ("camera10.npy", 0.2)],
        );
        grey(0.9).save(&b.join("camera0-background.npy")).unwrap();
        assert_eq!(compared(&a, &b, &["--by-number", "--min-psnr", "999"]).unwrap(), None);
        let message = compared(&a, &b, &[]).unwrap_err().to_string();
        assert!(message.contains("--by-number"), "{message}");
    }

    #[test]
    fn two_pictures_of_one_name_in_a_folder_are_an_error() {
        let (_root, a, b) = folders(&[("x.npy", 0.5), ("x.png", 0.5)], &[("x.npy", 0.5)]);
        assert!(compared(&a, &b, &[]).unwrap_err().to_string().contains("have the same name"));
    }

    #[test]
    fn the_difference_pictures_of_folders_go_into_a_folder() {
        let (root, a, b) = folders(&[("x.npy", 0.5)], &[("x.npy", 0.75)]);
        let out = root.path().join("differences");
        compared(&a, &b, &["--diff", out.to_str().unwrap(), "--gain", "2"]).unwrap();
        assert_eq!(Image::load(&out.join("x.png")).unwrap().rgb[0], [128.0 / 255.0; 3]);
    }

    #[test]
    fn pictures_of_two_sizes_are_refused_before_either_is_decoded() {
        let (_root, a, b) = folders(&[("x.npy", 0.5)], &[("x.npy", 0.5)]);
        let (a, b) = (a.join("x.npy"), b.join("x.npy"));
        let wide = Image { width: 13, height: 12, rgb: vec![[0.5; 3]; 156] };
        wide.save(&b).unwrap();
        // Neither file holds all its pixels, so decoding it would report another error.
        for path in [&a, &b] {
            let bytes = std::fs::read(path).unwrap();
            std::fs::write(path, &bytes[..200]).unwrap();
        }
        let error = format!("{:#}", compared(&a, &b, &[]).unwrap_err());
        assert!(error.contains("expected pictures of the same size, found 12 x 12 and 13 x 12"), "{error}");
    }

    #[test]
    fn a_picture_and_a_folder_are_bad_usage() {
        let (_root, a, b) = folders(&[("x.npy", 0.5)], &[("x.npy", 0.5)]);
        assert!(compared(&a.join("x.npy"), &b, &[]).unwrap_err().is::<Usage>());
    }
}
