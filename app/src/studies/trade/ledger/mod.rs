//! Stores the rows of a ledger in a file, and summarises them.

#[cfg(test)]
mod tests;

use super::measure::Row;
use crate::io::report::text::hex;
use crate::io::{output, own_file};
use crate::studies::measurement::error::{joint_psnr, mean, weighted_psnr};
use crate::studies::measurement::noise::{self, Mark, Point, Share};
use crate::studies::measurement::plans::SamePlan;
use crate::studies::measurement::settings::EXACT;
use crate::studies::measurement::time;
use crate::studies::measurement::view::Measured;
use crate::studies::provenance::Provenance;
use crate::studies::study::StudyError;
use indexmap::IndexSet;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;
use splatgraph_assets::file;
use splatgraph_reference::metrics::{decibels, squared_error};
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{BufRead as _, BufReader, ErrorKind};
use std::path::{Path, PathBuf};

/// The inputs that all rows of a ledger depend on, besides the plan of each setting ([`Row::plan`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// The program, the device, the scene and the views.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Hash of the executable, which contains the exact renderer and the metrics.
    pub program: String,
    /// Hash of the scene's contents.
    pub content: String,
    /// The scene's tags that pictures depend on.
    pub tags: Vec<(String, String)>,
    /// Name of the graph, or of its file.
    pub pipeline: String,
    /// Names and values of the parameters that are the same in every setting, in the graph's order.
    #[serde(default)]
    pub set: Vec<(String, String)>,
    /// Hash of the plans of the exact settings, the baseline of all times; empty if one cannot be built.
    pub exact: String,
    /// `reference` for the exact renderer's pictures, or the name of the folder of the true pictures, for headings.
    pub truth: String,
    /// Hash of the pixels in the folder's pictures; empty for `reference`.
    pub truth_content: String,
    /// Facts of the device, its handling of accesses out of bounds, and [`Wanted::opened`](super::Wanted::opened).
    pub opened: String,
    /// Maximum number of rounds.
    pub rounds: u32,
    /// Frames per round; `None` if chosen from the time of a frame.
    pub frames: Option<u32>,
}

impl Origin {
    /// Lists the inputs that differ from another origin's, in words for the user. The names of the scene and
    /// the truth are not compared.
    pub fn changes(&self, other: &Origin) -> Vec<&'static str> {
        let (own, others) = (&self.provenance, &other.provenance);
        let differs = [
            ("program", own.version != others.version || self.program != other.program),
            ("scene", (own.splats, &self.content) != (others.splats, &other.content)),
            ("set of tags", self.tags != other.tags),
            ("set of cameras", own.cameras != others.cameras),
            ("set of --set values", self.set != other.set),
            // The exact settings contain the values of --set.
            (
                "graph",
                self.pipeline != other.pipeline || (self.set == other.set && self.exact != other.exact),
            ),
            ("truth", self.truth_content != other.truth_content),
            ("device", own.device != others.device),
            ("set of device options", self.opened != other.opened),
            ("number of rounds", self.rounds != other.rounds),
            ("number of frames", self.frames != other.frames),
        ];
        differs.into_iter().filter(|(_, differs)| *differs).map(|(name, _)| name).collect()
    }
}

/// The rows of a run, with their origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    /// The command that wrote the file last; empty while it measures. If it was `merge`, the line before has the
    /// command of a shard.
    #[serde(default)]
    pub command: String,
    /// The commands that measured rows, or joined them, in their order.
    #[serde(default)]
    pub commands: Vec<String>,
    /// The inputs on which the numbers depend.
    pub origin: Origin,
    /// For a setting, the settings with equal plans, which are not measured.
    #[serde(default)]
    pub same_plan: SamePlan,
    /// A row per setting and camera.
    pub rows: Vec<Row>,
}

/// The fields of a ledger's file.
#[derive(Serialize)]
struct Saved<'a> {
    #[serde(flatten)]
    ledger: &'a Ledger,
    /// Views without rows of the exact settings.
    missing: Vec<String>,
}

/// A ledger, and the file to which it is saved.
pub struct Book {
    /// Ledger with the rows so far.
    pub ledger: Ledger,
    path: Option<PathBuf>,
    /// Lock of the file's folder, held as long as the book exists.
    _lock: Option<File>,
}

/// Checks that [`Book::save`] may replace a file. It must be a ledger of any version of the program, empty, or missing.
/// Returns the settings that have rows in the ledger, or equal plans to one that has.
///
/// # Errors
/// The path is not a regular file, or the file cannot be read or has other contents.
pub fn replaceable(path: &Path) -> Result<BTreeSet<String>, StudyError> {
    let settings = || -> std::io::Result<Option<BTreeSet<String>>> {
        if !fs::metadata(path)?.is_file() {
            return Ok(None);
        }
        let mut file = BufReader::new(file::open(path)?);
        match file.fill_buf()?.first() {
            None => return Ok(Some(BTreeSet::new())),
            Some(b'{') => {}
            // Not read further: the file may be a scene of gigabytes.
            Some(_) => return Ok(None),
        }
        let json: Json = serde_json::from_reader(file).unwrap_or_default();
        let Some(rows) = json["rows"].as_array().filter(|_| json["origin"].is_object()) else {
            return Ok(None);
        };
        let text = |json: &Json| json.as_str().map(str::to_owned);
        let mut settings: BTreeSet<String> = rows.iter().filter_map(|row| text(&row["setting"])).collect();
        // An interrupted run also lists settings whose plans equal one that it had yet to measure.
        let same = json["same_plan"].as_object().into_iter().flatten();
        let same = same.filter(|(setting, _)| settings.contains(*setting));
        let same = same.filter_map(|(_, others)| others.as_array()).flatten();
        let same: Vec<String> = same.filter_map(text).collect();
        settings.extend(same);
        Ok(Some(settings))
    };
    match settings() {
        Ok(Some(settings)) => return Ok(settings),
        Ok(None) => {}
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(BTreeSet::new()),
        Err(error) => return Err(StudyError::Input(format!("{}: {error}", path.display()))),
    }
    Err(StudyError::Input(format!(
        "{}: expected a ledger of an earlier run, or no file, found a file with other contents, which would be lost; choose another name",
        path.display()
    )))
}

impl Book {
    /// Opens the ledger in a file, with the rows of plans that have not changed, and locks the file's folder.
    ///
    /// `plans` are the settings, each with the hash of its plans; without any, all rows are kept, with the entries of
    /// their settings in [`Ledger::same_plan`]. Also returns why rows of the file are dropped, `None` if none are.
    /// Without a path, nothing is saved. A ledger of another program or device is set aside.
    ///
    /// # Errors
    /// The file has rows of other inputs, or another process measures in the folder: rows would be lost. Or the folder
    /// cannot be locked, or a ledger cannot be set aside.
    pub fn open(
        path: Option<PathBuf>,
        origin: Origin,
        plans: &[(&str, Option<u64>)],
    ) -> Result<(Book, Option<String>), StudyError> {
        let lock = path.as_deref().map_or(Ok(None), |path| {
            output::lock(path).map_err(|error| match error.kind() {
                ErrorKind::WouldBlock => StudyError::Input(format!(
                    "{}: expected a folder that no other process measures into, found one in use: wait, or name another folder",
                    path.display()
                )),
                _ => StudyError::Input(format!("{}: {error}", path.display())),
            })
        })?;
        let bytes =
            path.as_ref().and_then(|path| own_file::read(path).ok()).filter(|bytes| !bytes.is_empty());
        let shown = path.as_deref().unwrap_or(Path::new("")).display();
        let mut lost = None;
        let found = bytes.as_deref().map_or(Ok(Default::default()), |bytes| read(bytes, &origin));
        let Found { mut rows, mut same_plan, commands } = match found {
            Ok(found) => found,
            // Not an error: a nightly job has to survive updates of the program and of the driver.
            Err(changes) if changes.iter().all(|change| ["program", "device"].contains(change)) => {
                let (kept, removed) = set_aside(path.as_deref(), &bytes.unwrap_or_default())?;
                let changes = changes.join(" and another ");
                let removed = if removed { "; its CSV, page and plots are removed" } else { "" };
                lost = Some(format!(
                    "{shown}: measured with another {changes}: it is kept as {}, and all settings are measured again{removed}",
                    kept.display()
                ));
                Default::default()
            }
            Err(changes) => {
                return Err(StudyError::Input(format!(
                    "{shown}: expected a ledger of the same inputs, found one measured with another {}: keep the new one elsewhere, or delete this one",
                    changes.join(" and another ")
                )));
            }
        };
        let is_current =
            |row: &Row| plans.iter().any(|(name, plan)| row.setting == *name && row.plan == plan.map(hex));
        let all = rows.len();
        rows.retain(|row| plans.is_empty() || is_current(row));
        // With plans, the caller knows which are equal now.
        same_plan.retain(|setting, _| plans.is_empty() && rows.iter().any(|row| row.setting == *setting));
        if rows.len() < all {
            let count = all - rows.len();
            lost = Some(format!(
                "{shown}: {count} rows of an earlier run are measured again or left out: their settings' plans have changed, or equal another's"
            ));
        }
        let ledger = Ledger { command: String::new(), commands, origin, same_plan, rows };
        Ok((Book { ledger, path, _lock: lock }, lost))
    }

    /// Returns true if there is a row of the setting in this view, even one that failed.
    pub fn has(&self, setting: &str, camera: &str) -> bool {
        self.ledger.rows.iter().any(|row| row.setting == setting && row.camera == camera)
    }

    /// Returns the exact settings' milliseconds in a view; `None` before its first measured row, or without timestamps.
    pub fn exact_ms(&self, camera: &str) -> Option<f64> {
        let first = self.ledger.rows.iter().find(|row| row.camera == camera && row.found.is_ok())?;
        Some(first.found.as_ref().ok()?.time.as_ref()?.exact_ms)
    }

    /// Adds a row, in place of one of the same setting and camera. [`Book::save`] writes it to the file.
    ///
    /// Rows are sorted by camera, even if several processes measured them in another order.
    pub fn insert(&mut self, row: Row) {
        let Ledger { origin, rows, .. } = &mut self.ledger;
        let cameras = &origin.provenance.cameras;
        let index = |row: &Row| cameras.iter().position(|camera| camera.img_name == row.camera);
        rows.retain(|other| (&other.setting, &other.camera) != (&row.setting, &row.camera));
        let own = index(&row);
        let at = rows.partition_point(|other| index(other) <= own);
        rows.insert(at, row);
    }

    /// Writes the file; does nothing without a path.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self) -> Result<(), output::OutputError> {
        self.path.as_ref().map_or(Ok(()), |path| self.ledger.save(path))
    }
}

/// Copies a ledger with these contents, so that another can replace it, and removes the files that show it: an
/// interrupted run would leave them beside its own rows. Returns the copy's path, and true if files were removed.
fn set_aside(path: Option<&Path>, bytes: &[u8]) -> Result<(PathBuf, bool), output::OutputError> {
    let Some(path) = path else { return Ok(Default::default()) };
    let mut hash = DefaultHasher::new();
    bytes.hash(&mut hash);
    let copy = path.with_file_name(format!("ledger-{}.json", hex(hash.finish())));
    output::write_bytes(&copy, bytes)?;
    let mut removed = false;
    for extension in ["csv", "html", "svg", "png"] {
        removed |= output::remove(&path.with_extension(extension))?;
    }
    Ok((copy, removed))
}

/// The parts of an earlier ledger that [`Book::open`] keeps.
#[derive(Default)]
struct Found {
    rows: Vec<Row>,
    same_plan: SamePlan,
    commands: Vec<String>,
}

/// Reads what an earlier ledger has. The error lists what differs from `origin`; a ledger without rows fits any origin.
fn read(bytes: &[u8], origin: &Origin) -> Result<Found, Vec<&'static str>> {
    // Another version of the program wrote other fields.
    let mut ledger: Ledger = serde_json::from_slice(bytes).map_err(|_| vec!["program"])?;
    if ledger.rows.is_empty() {
        return Ok(Found::default());
    }
    // Earlier versions wrote only the last command.
    if ledger.commands.is_empty() {
        ledger.add_command(&ledger.command.clone());
    }
    let Ledger { origin: own, rows, same_plan, commands, .. } = ledger;
    match own.changes(origin) {
        changes if changes.is_empty() => Ok(Found { rows, same_plan, commands }),
        changes => Err(changes),
    }
}

/// The measurements of a setting, summarised over the views.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// The setting's name.
    pub setting: String,
    /// Mean time over the views, in milliseconds; `None` without timestamps.
    pub gpu_ms: Option<f64>,
    /// Largest spread over the views, in milliseconds; `None` without timestamps, or with one round.
    pub spread_ms: Option<f64>,
    /// Mean share of the exact settings' time over the views, with its range; `None` without timestamps.
    pub share: Option<Share>,
    /// PSNR of the mean squared error over all views, in decibels; infinite for equal pictures.
    #[serde(serialize_with = "decibels::serialize_number")]
    pub psnr_db: f64,
    /// PSNR of the covered pixels of all views, in decibels; infinite for equal pictures, or without covered pixels.
    #[serde(serialize_with = "decibels::serialize_number")]
    pub covered_psnr_db: f64,
    /// Lowest SSIM over the views; `None` if a view has none.
    pub ssim: Option<f64>,
    /// Mean FLIP over the views.
    pub flip: f64,
    /// Largest absolute difference of a channel in any view.
    pub worst: f64,
    /// Mean share of pixels in which a channel differs by more than 1/255.
    pub off: f64,
    /// Number of pairs of splats in the wrong order, summed over the views; `None` if it is unknown for a view.
    pub inversions: Option<u64>,
    /// Share of the host's frame time that the device spends drawing, at most 1; the lowest of the views. `None`
    /// without timestamps.
    pub busy: Option<f64>,
    /// Largest use of device memory in any view, in bytes.
    pub gpu_bytes: u64,
    /// Phases; see [`time::phases`].
    pub phases: Vec<(String, f64, Option<f64>)>,
    /// Names of the settings with the same plan, which are not measured.
    pub same_plan: Vec<String>,
    /// Position of the setting relative to the Pareto front.
    pub mark: Mark,
}

impl Ledger {
    /// Lists the views without rows of the exact settings.
    pub fn missing(&self) -> Vec<String> {
        let is_measured = |name: &str| self.rows.iter().any(|row| row.setting == EXACT && row.camera == name);
        self.origin.provenance.missing(is_measured)
    }

    /// Formats the names of the scene and the graph, for headings.
    pub fn title(&self) -> String {
        let Origin { provenance, pipeline, set, .. } = &self.origin;
        provenance.title(pipeline, set, self.missing().len())
    }

    /// Adds a command line, unless it is empty or was added before.
    pub fn add_command(&mut self, command: &str) {
        if !command.is_empty() && !self.commands.iter().any(|other| other == command) {
            self.commands.push(command.to_owned());
        }
    }

    /// Adds settings with equal plans to those of earlier runs.
    pub fn add_same_plan(&mut self, found: SamePlan) {
        for (setting, others) in found {
            self.same_plan.entry(setting).or_default().extend(others);
        }
    }

    /// Returns the camera at which a setting has its lowest PSNR, and that PSNR, `None` for equal pictures.
    ///
    /// `None` if the setting was not drawn.
    pub fn farthest(&self, setting: &str) -> Option<(&str, Option<f64>)> {
        let rows = self.rows.iter().filter(|row| row.setting == setting);
        let drawn =
            rows.filter_map(|row| Some((row.camera.as_str(), row.found.as_ref().ok()?.error.psnr_db)));
        // Of equal rows, the first: `Album::keep` stores its pictures.
        drawn.reduce(|a, b| if squared_error(b.1) > squared_error(a.1) { b } else { a })
    }

    /// Writes the ledger as JSON.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), output::OutputError> {
        let saved = Saved { ledger: self, missing: self.missing() };
        let text = serde_json::to_string_pretty(&saved).unwrap_or_default();
        output::write_bytes(path, format!("{text}\n").as_bytes())
    }

    /// Summarises each setting that was drawn in every view of the exact settings, in the order of the first rows.
    /// Widens the ranges to the noise floor, and marks the Pareto front. The second list has the other settings, each
    /// with the reason: it failed in a view, or a view is not measured yet.
    pub fn lines(&self) -> (Vec<Line>, Vec<(String, String)>) {
        let mut names: Vec<&str> = Vec::new();
        for row in &self.rows {
            if !names.contains(&row.setting.as_str()) {
                names.push(&row.setting);
            }
        }
        let (mut lines, mut failed) = (Vec::new(), Vec::new());
        let of = |name: &str| self.rows.iter().filter(|row| row.setting == name).collect::<Vec<_>>();
        let views = of(EXACT).len();
        for &name in &names {
            let rows = of(name);
            match rows.iter().map(|row| row.found.as_ref()).collect::<Result<Vec<_>, _>>() {
                Ok(found) if found.len() < views => {
                    failed.push((name.into(), format!("measured in only {} of {views} views", found.len())));
                }
                Ok(found) => {
                    // A setting that was measured by itself is not called equal, in case its plan has changed since.
                    let same = self.same_plan.get(name).into_iter().flatten();
                    let same = same.filter(|other| !names.contains(&other.as_str())).cloned().collect();
                    lines.push(Line { same_plan: same, ..line(name, &found) });
                }
                Err(text) => failed.push((name.to_string(), text.clone())),
            }
        }
        mark(&mut lines);
        (lines, failed)
    }
}

fn line(name: &str, views: &[&Measured]) -> Line {
    let times: Option<Vec<_>> = views.iter().map(|view| view.time.as_ref()).collect();
    let errors = || views.iter().map(|view| &view.error);
    let most = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    Line {
        setting: name.to_string(),
        gpu_ms: times.as_ref().map(|times| mean(times.iter().map(|time| time.gpu_ms))),
        spread_ms: times.iter().flatten().filter_map(|time| time.spread_ms).reduce(f64::max),
        share: times
            .as_ref()
            .and_then(|times| Share::mean(&times.iter().map(|time| time.share).collect::<Vec<_>>())),
        psnr_db: joint_psnr(errors().map(|error| error.psnr_db)),
        covered_psnr_db: weighted_psnr(errors().map(|error| (error.covered_psnr_db, error.covered))),
        ssim: errors().map(|error| error.ssim).reduce(|a, b| a.zip(b).map(|(a, b)| a.min(b))).flatten(),
        flip: mean(errors().map(|error| error.flip)),
        worst: most(&mut errors().map(|error| error.worst)),
        off: mean(errors().map(|error| error.off)),
        inversions: views.iter().map(|view| view.inversions).sum(),
        busy: times.as_ref().and_then(|times| times.iter().map(|time| time.busy).reduce(f64::min)),
        gpu_bytes: views.iter().map(|view| view.gpu_bytes).max().unwrap_or(0),
        phases: time::phases(&times.unwrap_or_default()),
        same_plan: Vec::new(),
        mark: if views.iter().any(|view| view.of_last_frame) { Mark::Hidden } else { Mark::Beaten },
    }
}

pub(super) fn phase_names(lines: &[Line]) -> Vec<String> {
    let names: IndexSet<&String> =
        lines.iter().flat_map(|line| line.phases.iter().map(|(name, ..)| name)).collect();
    names.into_iter().cloned().collect()
}

/// Widens the ranges of all lines to the noise floor of the exact settings, and marks the Pareto front.
fn mark(lines: &mut [Line]) {
    let floor = lines.iter().find(|line| line.setting == EXACT).and_then(|exact| exact.share?.floor());
    for line in lines.iter_mut() {
        line.share = line.share.map(|share| share.widened(floor));
    }
    let points = lines.iter().map(|line| Point {
        name: &line.setting,
        // The exact settings' share is 1 by definition. Their measured share only gives the noise floor.
        share: if line.setting == EXACT { line.share.map(|_| Share::EXACT) } else { line.share },
        psnr_db: line.psnr_db,
        hidden: line.mark == Mark::Hidden,
    });
    let marks = noise::front(&points.collect::<Vec<_>>());
    for (line, mark) in lines.iter_mut().zip(marks) {
        line.mark = mark;
    }
}

#[cfg(test)]
pub(crate) mod testing {
    use super::*;
    use crate::studies::measurement::error::Error;
    use crate::studies::measurement::time::Time;
    use splatgraph_assets::Camera;

    fn camera() -> Camera {
        Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (32, 24))
    }

    pub fn origin() -> Origin {
        Origin {
            provenance: Provenance {
                version: "1".into(),
                device: "none".into(),
                is_cpu: false,
                scene: "a.ply".into(),
                splats: 3,
                cameras: vec![camera()],
            },
            program: "1".into(),
            content: "0".into(),
            tags: Vec::new(),
            pipeline: "splat".into(),
            set: Vec::new(),
            exact: "0".into(),
            truth: "reference".into(),
            truth_content: String::new(),
            opened: String::new(),
            rounds: 1,
            frames: None,
        }
    }

    pub fn ledger(rows: Vec<Row>) -> Ledger {
        let (command, commands, same_plan) = Default::default();
        Ledger { command, commands, origin: origin(), same_plan, rows }
    }

    pub fn measured(ms: f64, psnr_db: Option<f64>) -> Measured {
        within(ms, 0.005, psnr_db)
    }

    /// Returns measurements with a time of `ms`; the share's range is ± `half`.
    pub fn within(ms: f64, half: f64, psnr_db: Option<f64>) -> Measured {
        let share = ms / 4.0;
        let time = Time {
            gpu_ms: ms,
            spread_ms: Some(0.1),
            share: Share { median: share, range: Some((share - half, share + half)) },
            exact_ms: 4.0,
            exact_spread_ms: Some(0.1),
            turns: vec![share; 8],
            rounds: 8,
            busy: 0.9,
            phases: [("draw".to_string(), ms)].into(),
            phase_spreads: [("draw".to_string(), Some(0.05))].into(),
        };
        let error = Error {
            psnr_db,
            ssim: Some(0.9),
            flip: 0.1,
            worst: 0.5,
            off: 0.25,
            covered: 3,
            covered_psnr_db: psnr_db,
            covered_off: 0.5,
        };
        Measured { time: Some(time), error, inversions: Some(7), of_last_frame: false, gpu_bytes: 1 << 20 }
    }

    pub fn row(setting: &str, camera: &str, found: Result<Measured, String>) -> Row {
        Row { setting: setting.into(), plan: Some(hex(1)), camera: camera.into(), found }
    }

    pub fn line(setting: &str, gpu_ms: f64, psnr_db: f64, mark: Mark) -> Line {
        Line {
            setting: setting.into(),
            gpu_ms: Some(gpu_ms),
            spread_ms: Some(0.1),
            share: Some(Share {
                median: gpu_ms / 4.0,
                range: Some((gpu_ms / 4.0 - 0.01, gpu_ms / 4.0 + 0.01)),
            }),
            psnr_db,
            covered_psnr_db: psnr_db,
            ssim: Some(0.9),
            flip: 0.1,
            worst: 0.5,
            off: 0.25,
            inversions: Some(7),
            busy: Some(0.9),
            gpu_bytes: 1 << 20,
            phases: vec![("draw".into(), gpu_ms, Some(0.1))],
            same_plan: Vec::new(),
            mark,
        }
    }
}
