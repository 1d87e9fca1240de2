//! Keeps the rows of a ledger in a file, and prints them.

use super::measure::{Measured, Row, Time};
use crate::metrics::squared_error;
use crate::output;
use crate::report::text;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Everything that decides the numbers of a ledger. Rows of another origin are not mixed with it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// The program's version.
    pub version: String,
    /// The scene's file, and its number of splats.
    pub scene: String,
    /// See `scene`.
    pub splats: u32,
    /// A hash of what the scene and the graph's files hold.
    pub content: String,
    /// The cameras, as in cameras.json.
    pub cameras: Json,
    /// The graph.
    pub pipeline: String,
    /// The truth: `reference`, or the folder of the pictures.
    pub truth: String,
    /// The device and its driver.
    pub device: String,
    /// Rounds of frames.
    pub rounds: u32,
    /// Frames in a round; `None` where the time of a frame decides.
    pub frames: Option<u32>,
}

impl Origin {
    /// The scene's name and the graph's, for headings.
    pub fn title(&self) -> String {
        let name = Path::new(&self.scene)
            .file_stem()
            .map_or_else(|| self.scene.as_str().into(), |s| s.to_string_lossy());
        format!("{name}, {}", self.pipeline)
    }

    /// The number of cameras.
    pub fn views(&self) -> usize {
        self.cameras.as_array().map_or(0, Vec::len)
    }
}

/// The rows of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    /// The origin of the numbers.
    pub origin: Origin,
    /// A row per setting and camera.
    pub rows: Vec<Row>,
}

/// A ledger that is kept in a file as it grows.
pub struct Book {
    /// The rows so far.
    pub ledger: Ledger,
    path: PathBuf,
}

impl Book {
    /// Opens the ledger in a file; an empty one if there is none of this origin.
    ///
    /// A ledger of another origin is replaced when the first row is added.
    pub fn open(path: PathBuf, origin: Origin) -> Book {
        let found: Option<Ledger> =
            fs::read(&path).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let rows = found.filter(|found| found.origin == origin).map_or_else(Vec::new, |found| found.rows);
        Book { ledger: Ledger { origin, rows }, path }
    }

    /// Returns true if the setting has been measured in this view.
    pub fn has(&self, setting: &str, camera: &str) -> bool {
        self.ledger.rows.iter().any(|row| row.setting == setting && row.camera == camera)
    }

    /// Adds a row, and writes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn add(&mut self, row: Row) -> Result<(), output::OutputError> {
        self.ledger.rows.push(row);
        let text = serde_json::to_string_pretty(&self.ledger).unwrap_or_default();
        output::write_bytes(&self.path, format!("{text}\n").as_bytes())
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// A setting over all of its views.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// The setting's name.
    pub setting: String,
    /// Mean of the views' times, in milliseconds.
    pub gpu_ms: Option<f64>,
    /// Largest spread of a view, in milliseconds.
    pub spread_ms: Option<f64>,
    /// Mean of the views' shares of the exact settings' time.
    pub of_exact: Option<f64>,
    /// PSNR of the mean squared error of all views, in decibels; infinite for equal pictures.
    pub psnr_db: f64,
    /// The same, over the covered pixels.
    pub covered_psnr_db: f64,
    /// Least SSIM of a view.
    pub ssim: Option<f64>,
    /// Mean FLIP.
    pub flip: f64,
    /// Largest difference of a channel in any view.
    pub worst: f64,
    /// Mean share of pixels that are off by more than 1/255.
    pub off: f64,
    /// Pairs of splats in the wrong order, in all views.
    pub inversions: Option<u64>,
    /// Most bytes on the device.
    pub gpu_bytes: u64,
    /// The phases: a name, the mean of the views' milliseconds, and the largest spread of a view.
    pub phases: Vec<(String, f64, f64)>,
    /// No setting is at least as fast and as accurate, and better in one of both.
    pub best: bool,
}

impl Ledger {
    /// Sums the rows of each setting up, in the order of the rows; settings that failed come as their message.
    pub fn lines(&self) -> (Vec<Line>, Vec<(String, String)>) {
        let mut names: Vec<&str> = Vec::new();
        for row in &self.rows {
            if !names.contains(&row.setting.as_str()) {
                names.push(&row.setting);
            }
        }
        let (mut lines, mut failed) = (Vec::new(), Vec::new());
        for name in names {
            let rows: Vec<&Row> = self.rows.iter().filter(|row| row.setting == name).collect();
            match rows.iter().map(|row| row.found.as_ref()).collect::<Result<Vec<_>, _>>() {
                Ok(views) => lines.push(line(name, &views)),
                Err(text) => failed.push((name.to_string(), text.clone())),
            }
        }
        mark_best(&mut lines);
        (lines, failed)
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0u32), |(sum, count), v| (sum + v, count + 1));
    sum / f64::from(count.max(1))
}

/// The PSNR of the mean of several mean squared errors.
fn joint_psnr(of_views: impl Iterator<Item = Option<f64>>) -> f64 {
    -10.0 * mean(of_views.map(squared_error)).log10()
}

fn line(name: &str, views: &[&Measured]) -> Line {
    let times: Option<Vec<_>> = views.iter().map(|view| view.time.as_ref()).collect();
    let errors = || views.iter().map(|view| &view.error);
    let most = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    Line {
        setting: name.to_string(),
        gpu_ms: times.as_ref().map(|times| mean(times.iter().map(|time| time.gpu_ms))),
        spread_ms: times.as_ref().map(|times| most(&mut times.iter().map(|time| time.spread_ms))),
        of_exact: times.as_ref().map(|times| mean(times.iter().map(|time| time.of_exact))),
        psnr_db: joint_psnr(errors().map(|error| error.psnr_db)),
        covered_psnr_db: joint_psnr(errors().map(|error| error.covered_psnr_db)),
        ssim: errors().map(|error| error.ssim).reduce(|a, b| a.zip(b).map(|(a, b)| a.min(b))).flatten(),
        flip: mean(errors().map(|error| error.flip)),
        worst: most(&mut errors().map(|error| error.worst)),
        off: mean(errors().map(|error| error.off)),
        inversions: views.iter().map(|view| view.inversions).sum(),
        gpu_bytes: views.iter().map(|view| view.gpu_bytes).max().unwrap_or(0),
        phases: phases(&times.unwrap_or_default()),
        best: false,
    }
}

/// Sums the phases of all views up.
fn phases(times: &[&Time]) -> Vec<(String, f64, f64)> {
    let names: BTreeSet<&String> = times.iter().flat_map(|time| time.phases.keys()).collect();
    let of = |name: &String| {
        let ms = mean(times.iter().map(|time| time.phases.get(name).copied().unwrap_or(0.0)));
        let spreads = times.iter().filter_map(|time| time.phase_spreads.get(name).copied());
        (name.clone(), ms, spreads.fold(0.0, f64::max))
    };
    names.into_iter().map(of).collect()
}

/// Lists the phases of all lines.
pub(super) fn phase_names(lines: &[Line]) -> Vec<String> {
    let names: BTreeSet<&String> =
        lines.iter().flat_map(|line| line.phases.iter().map(|(name, ..)| name)).collect();
    names.into_iter().cloned().collect()
}

/// Marks the lines that no other dominates in time and PSNR: the Pareto front. Without times, the most accurate.
fn mark_best(lines: &mut [Line]) {
    let values: Vec<(f64, f64)> =
        lines.iter().map(|line| (line.of_exact.unwrap_or(0.0), line.psnr_db)).collect();
    for (line, (time, psnr)) in lines.iter_mut().zip(&values) {
        let better = |(t, p): &(f64, f64)| t <= time && p >= psnr && (t < time || p > psnr);
        line.best = !values.iter().any(better);
    }
}

/// The columns of the tables.
pub(super) const COLUMNS: [&str; 12] = [
    "setting",
    "GPU ms",
    "spread",
    "of exact",
    "PSNR dB",
    "covered",
    "SSIM",
    "FLIP",
    "worst",
    "off",
    "inversions",
    "MiB",
];

/// The cells of a line, with as many digits as people read.
pub(super) fn cells(line: &Line) -> [String; COLUMNS.len()] {
    let optional = |value: Option<f64>, digits: usize| value.map_or("-".into(), |v| format!("{v:.digits$}"));
    let db = |value: f64| if value.is_finite() { format!("{value:.1}") } else { "equal".into() };
    [
        line.setting.clone(),
        optional(line.gpu_ms, 3),
        optional(line.spread_ms, 3),
        line.of_exact.map_or("-".into(), |share| format!("{:.1} %", 100.0 * share)),
        db(line.psnr_db),
        db(line.covered_psnr_db),
        optional(line.ssim, 5),
        format!("{:.4}", line.flip),
        format!("{:.4}", line.worst),
        format!("{:.2} %", 100.0 * line.off),
        line.inversions.map_or("-".into(), |count| count.to_string()),
        format!("{:.1}", line.gpu_bytes as f64 / f64::from(1 << 20)),
    ]
}

/// Sets lines as a table for a terminal; `*` marks the Pareto front.
pub fn table(lines: &[Line]) -> String {
    let marked = |mark: &str, mut row: Vec<String>| {
        row[0].insert_str(0, mark);
        row
    };
    let header = marked("  ", COLUMNS.map(String::from).to_vec());
    let row = |line: &Line| marked(if line.best { "* " } else { "  " }, cells(line).to_vec());
    text::table(&std::iter::once(header).chain(lines.iter().map(row)).collect::<Vec<_>>())
}

/// Writes lines as CSV (RFC 4180), with all digits; a value that there is none of is empty.
pub fn csv(lines: &[Line]) -> String {
    let mut text = String::from(
        "setting,gpu_ms,spread_ms,of_exact,psnr_db,covered_psnr_db,ssim,flip,worst,off,inversions,gpu_bytes,pareto",
    );
    let phases = phase_names(lines);
    phases.iter().for_each(|name| text += &format!(",{name}_ms,{name}_spread_ms"));
    text += "\n";
    let optional = |value: Option<f64>| value.map_or(String::new(), |v| v.to_string());
    for line in lines {
        let mut cells = vec![
            text::quoted(&line.setting),
            optional(line.gpu_ms),
            optional(line.spread_ms),
            optional(line.of_exact),
            line.psnr_db.to_string(),
            line.covered_psnr_db.to_string(),
            optional(line.ssim),
            line.flip.to_string(),
            line.worst.to_string(),
            line.off.to_string(),
            line.inversions.map_or(String::new(), |count| count.to_string()),
            line.gpu_bytes.to_string(),
            line.best.to_string(),
        ];
        for name in &phases {
            let phase = line.phases.iter().find(|(own, ..)| own == name);
            cells.push(optional(phase.map(|(_, ms, _)| *ms)));
            cells.push(optional(phase.map(|(.., spread)| *spread)));
        }
        text += &(cells.join(",") + "\n");
    }
    text
}

/// Ledgers for tests.
#[cfg(test)]
pub(super) mod testing {
    use super::*;

    pub fn origin() -> Origin {
        Origin {
            version: "1".into(),
            scene: "a.ply".into(),
            splats: 3,
            content: "0".into(),
            cameras: Json::Array(vec![Json::Null]),
            pipeline: "splat".into(),
            truth: "reference".into(),
            device: "none".into(),
            rounds: 1,
            frames: None,
        }
    }

    pub fn ledger(rows: Vec<Row>) -> Ledger {
        Ledger { origin: origin(), rows }
    }

    pub fn line(setting: &str, gpu_ms: f64, psnr_db: f64, best: bool) -> Line {
        Line {
            setting: setting.into(),
            gpu_ms: Some(gpu_ms),
            spread_ms: Some(0.1),
            of_exact: Some(gpu_ms / 4.0),
            psnr_db,
            covered_psnr_db: psnr_db,
            ssim: Some(0.9),
            flip: 0.1,
            worst: 0.5,
            off: 0.25,
            inversions: Some(7),
            gpu_bytes: 1 << 20,
            phases: vec![("draw".into(), gpu_ms, 0.1)],
            best,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::error::Error;
    use super::super::measure::Time;
    use super::testing::{ledger, origin};
    use super::*;

    fn measured(ms: f64, psnr_db: Option<f64>) -> Measured {
        let time = Time {
            gpu_ms: ms,
            spread_ms: 0.1,
            of_exact: ms / 4.0,
            phases: [("draw".to_string(), ms)].into(),
            phase_spreads: [("draw".to_string(), 0.05)].into(),
        };
        let error = Error {
            psnr_db,
            ssim: Some(0.9),
            flip: 0.1,
            worst: 0.5,
            off: 0.25,
            covered_psnr_db: psnr_db,
            covered_off: 0.5,
        };
        Measured { time: Some(time), error, inversions: Some(7), gpu_bytes: 1 << 20 }
    }

    fn row(setting: &str, camera: &str, found: Result<Measured, String>) -> Row {
        Row { setting: setting.into(), camera: camera.into(), found }
    }

    #[test]
    fn views_are_joined_by_their_squared_errors_and_what_is_dominated_is_not_best() {
        let rows = vec![
            row("exact", "a", Ok(measured(4.0, None))),
            row("exact", "b", Ok(measured(4.0, None))),
            row("fast", "a", Ok(measured(1.0, Some(40.0)))),
            row("fast", "b", Ok(measured(3.0, None))),
            row("bad", "a", Ok(measured(3.0, Some(30.0)))),
            row("bad", "b", Ok(measured(3.0, Some(30.0)))),
            row("broken", "a", Err("error: no".into())),
        ];
        let (lines, failed) = ledger(rows).lines();
        assert_eq!(failed, [("broken".to_string(), "error: no".to_string())]);
        let best: Vec<bool> = lines.iter().map(|line| line.best).collect();
        assert_eq!(best, [true, true, false]);
        assert!(lines[0].psnr_db.is_infinite());
        // Half of the squared error of 40 dB.
        assert!((lines[1].psnr_db - (40.0 + 10.0 * 2f64.log10())).abs() < 1e-9);
        assert_eq!((lines[1].gpu_ms, lines[1].inversions), (Some(2.0), Some(14)));
        let table = table(&lines);
        assert!(table.contains("* fast") && table.contains("  bad") && table.contains("equal"), "{table}");
        let csv = csv(&lines);
        assert_eq!(csv.lines().count(), 4);
        assert!(csv.starts_with("setting,gpu_ms") && csv.contains(",draw_ms,draw_spread_ms\n"), "{csv}");
        assert_eq!(lines[1].phases, [("draw".to_string(), 2.0, 0.05)]);
    }

    #[test]
    fn a_ledger_goes_on_where_it_stopped_unless_it_is_of_another_origin() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ledger.json");
        let mut book = Book::open(path.clone(), origin());
        book.add(row("exact", "a", Ok(measured(4.0, Some(61.25))))).unwrap();
        book.add(row("broken", "a", Err("no".into()))).unwrap();
        let again = Book::open(path.clone(), origin());
        assert_eq!(again.ledger, book.ledger);
        assert!(again.has("exact", "a") && !again.has("exact", "b"));
        let other = Book::open(path, Origin { splats: 4, ..origin() });
        assert!(other.ledger.rows.is_empty());
    }
}
