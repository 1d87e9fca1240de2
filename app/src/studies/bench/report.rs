//! Stores the numbers of a run, as JSON and as CSV.

use super::limit::CopyLimit;
use super::measure::{Figures, Found, Outcome, Part};
use crate::draw::interleaved::{Figure, Frames};
use crate::draw::stats::Opened;
use crate::io::program;
use crate::io::report::text::{self, optional, quoted};
use indexmap::IndexSet;
use serde::Serialize;
use splatgraph_api::DeviceInfo;
use splatgraph_assets::Camera;
use std::path::{Path, PathBuf};

/// Version of the JSON; increases when a field is removed or changes its meaning.
pub const VERSION: u32 = 1;

/// Program, device and settings of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Origin {
    /// Version of the JSON, [`VERSION`].
    pub version: u32,
    /// The program's version and commit.
    pub program: String,
    /// The device's name.
    pub device: String,
    /// The device's driver, with its version.
    pub driver: String,
    /// The copy limit; `None` if it cannot be measured, and on a CPU.
    pub copy: Option<CopyLimit>,
    /// Options of the device.
    #[serde(flatten)]
    pub opened: Opened,
    /// True for a device on the CPU, where a driver may write a pass's timestamp before the pass is done.
    pub is_cpu: bool,
    /// Numbers of frames and rounds.
    pub effort: Frames,
    /// Parameters given with `--set`.
    pub set: Vec<(String, String)>,
}

impl Origin {
    /// Formats a CSV, and appends the columns `set`, `device` and `program`. The header and the lines lack their line
    /// breaks.
    pub fn csv(&self, header: &str, lines: impl IntoIterator<Item = String>) -> String {
        let more = [
            ("set", quoted(&text::parameters(&self.set))),
            ("device", quoted(&format!("{} ({})", self.device, self.driver))),
            ("program", quoted(&self.program)),
        ];
        text::csv(header, lines, &more)
    }

    /// Formats the parameters and the device, for titles.
    pub fn title(&self) -> String {
        let set = text::parameters(&self.set);
        if set.is_empty() { self.device.clone() } else { format!("{set}, {}", self.device) }
    }

    /// Creates the origin of a run on a device, without [`Origin::opened`].
    pub fn new(
        device: &DeviceInfo,
        copy: Option<CopyLimit>,
        effort: Frames,
        set: &[(String, String)],
    ) -> Origin {
        Origin {
            version: VERSION,
            program: program::VERSION.into(),
            device: device.name.clone(),
            driver: device.driver.clone(),
            copy,
            opened: Opened::default(),
            is_cpu: device.is_cpu(),
            effort,
            set: set.to_vec(),
        }
    }
}

/// A scene that was drawn.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneOrigin {
    /// The file, or `demo`.
    pub scene: String,
    /// Number of splats of the scene as loaded.
    pub splats: u32,
    /// The cameras, with the fields of cameras.json, in the scene's coordinates.
    pub cameras: Vec<Camera>,
}

/// The measurements of one candidate for one scene, number of splats and picture size.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The scene's file, or `demo`.
    pub scene: String,
    /// Number of splats to which the scene was enlarged or cut.
    pub splats: u32,
    /// Width and height in pixels; `None` if each camera has its own size.
    pub size: Option<(u32, u32)>,
    /// Name or path of the graph.
    pub pipeline: String,
    /// The measurements, or the error.
    pub found: Outcome,
}

/// All numbers of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Program, device and settings of the run.
    #[serde(flatten)]
    pub origin: Origin,
    /// True once all scenes, numbers of splats and sizes are measured; until then, the report is partial.
    pub complete: bool,
    /// Scenes of the run, with their cameras.
    pub scenes: Vec<SceneOrigin>,
    /// The candidates, grouped by scene, number of splats and size.
    pub rows: Vec<Row>,
}

/// Formats a picture size. `None` stands for the cameras' own sizes.
pub fn size_text(size: Option<(u32, u32)>) -> String {
    size.map_or("cameras' size".into(), |(width, height)| format!("{width}x{height}"))
}

/// Shortens the paths of scenes to their stems, each with the fewest parent folders that tell it from the others. If no
/// number of folders does, as for `scene.ply` beside `scene.spz`, the path stays whole.
pub fn scene_names(scenes: impl IntoIterator<Item = String>) -> Vec<String> {
    let scenes: Vec<String> = scenes.into_iter().collect();
    let named = |scene: &str, folders: usize| -> String {
        let stem = Path::new(scene).with_extension("");
        let parts: Vec<_> = stem.iter().collect();
        let kept = parts.len().saturating_sub(folders + 1);
        parts[kept..].iter().collect::<PathBuf>().to_string_lossy().into_owned()
    };
    let name = |scene: &String| {
        let is_unique = |folders: &usize| {
            let own = named(scene, *folders);
            scenes.iter().all(|other| other == scene || named(other, *folders) != own)
        };
        let folders = (0..Path::new(scene).iter().count()).find(is_unique);
        folders.map_or_else(|| scene.clone(), |folders| named(scene, folders))
    };
    scenes.iter().map(name).collect()
}

impl Report {
    /// Formats every figure, memory size and failure as CSV (RFC 4180), one per line, with all digits. Missing values
    /// are empty.
    ///
    /// Times without a camera are means of the cameras' medians; those of kind `once` are single times.
    pub fn csv(&self) -> String {
        let header =
            "scene,splats,width,height,pipeline,camera,kind,name,median_ms,spread_ms,bytes,gb_per_s,of_copy";
        let mut all = Vec::new();
        for row in &self.rows {
            let start = |size: Option<(u32, u32)>, camera: &str| {
                let (width, height) =
                    size.map_or(Default::default(), |(w, h)| (w.to_string(), h.to_string()));
                let (scene, pipeline) = (quoted(&row.scene), quoted(&row.pipeline));
                format!("{scene},{},{width},{height},{pipeline},{}", row.splats, quoted(camera))
            };
            match &row.found {
                Ok(found) => {
                    for view in &found.views {
                        let start = start(Some((view.width, view.height)), &view.camera);
                        all.extend(lines(&start, &view.figures));
                    }
                    let mean = start(row.size, "");
                    all.extend(lines(&mean, &found.mean));
                    for (name, bytes) in found.memory.iter().map(|size| (&size.name, size.bytes)) {
                        all.push(format!("{mean},memory,{},,,{bytes},,", quoted(name)));
                    }
                    all.extend(found.once.iter().map(|part| part_line(&mean, "once", part)));
                }
                Err(why) => {
                    all.push(format!("{},failed,{},,,,,", start(row.size, ""), quoted(&summary(why))));
                }
            }
        }
        self.origin.csv(header, all)
    }

    /// Shortens the path of a scene to a name that no other scene of the run has; see [`scene_names`].
    pub fn name_of(&self, scene: &str) -> String {
        let rows = self.rows.iter().map(|row| &row.scene);
        let scenes: IndexSet<&String> = self.scenes.iter().map(|origin| &origin.scene).chain(rows).collect();
        let at = scenes.iter().position(|other| *other == scene);
        let names = scene_names(scenes.into_iter().cloned());
        at.map_or_else(|| scene.to_owned(), |at| names[at].clone())
    }

    /// Returns the measurements of the candidates that were drawn.
    pub fn drawn(&self) -> impl Iterator<Item = &Found> {
        self.rows.iter().filter_map(|row| row.found.as_ref().ok())
    }
}

/// Returns the first line of an error message, and the label of its first place. The JSON keeps the whole message.
pub(super) fn summary(why: &str) -> String {
    let line = why.lines().next().unwrap_or_default();
    let line = line.strip_prefix("error: ").unwrap_or(line);
    // An underlined place, such as `  |     ^^^^ 12 is not in 1 to 11`.
    let label =
        why.lines().find_map(|line| line.trim_start().strip_prefix('|')?.trim_start().strip_prefix('^'));
    match label.map(|label| label.trim_start_matches('^').trim()) {
        None | Some("") => line.to_owned(),
        Some(label) => format!("{line}: {label}"),
    }
}

fn lines(start: &str, figures: &Figures) -> Vec<String> {
    let frame = [
        ("gpu", figures.gpu_ms),
        ("between", figures.between_ms),
        ("submit", figures.submit_ms),
        ("record", figures.record_ms),
        ("wall", figures.wall_ms),
    ];
    let frame = frame.into_iter().map(|(name, figure)| {
        let [median, spread] = times(figure);
        format!("{start},frame,{name},{median},{spread},,,")
    });
    let phases = figures.phases.iter().map(|part| part_line(start, "phase", part));
    let passes = figures.passes.iter().map(|part| part_line(start, "pass", part));
    frame.chain(phases).chain(passes).collect()
}

fn part_line(start: &str, kind: &str, part: &Part) -> String {
    let [median, spread] = times(part.gpu_ms);
    let (name, bytes) = (quoted(&part.name), part.bytes);
    let [rate, share] = [part.gb_per_s, part.of_copy].map(optional);
    format!("{start},{kind},{name},{median},{spread},{bytes},{rate},{share}")
}

fn times(figure: Option<Figure>) -> [String; 2] {
    [figure.map(|f| f.median), figure.and_then(|f| f.spread)].map(optional)
}

#[cfg(test)]
pub(super) mod testing {
    use super::*;

    pub fn report(rows: Vec<(&str, u32, Outcome)>) -> Report {
        let copy =
            CopyLimit { bytes: 1000, gpu_ms: Figure { median: 0.5, spread: Some(0.0) }, gb_per_s: 2000.0 };
        let origin = Origin {
            version: VERSION,
            program: "1".into(),
            device: "none".into(),
            driver: "0".into(),
            copy: Some(copy),
            opened: Opened::default(),
            is_cpu: false,
            effort: Frames { rounds: 3, frames: None },
            set: Vec::new(),
        };
        let row = |(pipeline, splats, found): (&str, u32, Outcome)| Row {
            scene: "scenes/a.ply".into(),
            splats,
            size: Some((64, 48)),
            pipeline: pipeline.into(),
            found,
        };
        Report { origin, complete: true, scenes: Vec::new(), rows: rows.into_iter().map(row).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::super::measure::testing::found;
    use super::super::table::tables;
    use super::testing::report;
    use super::{scene_names, summary};

    #[test]
    fn scenes_of_one_name_are_told_apart_by_their_folders() {
        let names = |scenes: &[&str]| scene_names(scenes.iter().map(|scene| (*scene).to_owned()));
        assert_eq!(names(&["a/b/scene.ply", "demo"]), ["scene", "demo"]);
        let scenes = ["x/30/point_cloud.ply", "y/30/point_cloud.ply", "y/7/point_cloud.ply", "other.spz"];
        assert_eq!(names(&scenes), ["x/30/point_cloud", "y/30/point_cloud", "7/point_cloud", "other"]);
        assert_eq!(names(&["scene.ply", "scene.spz"]), ["scene.ply", "scene.spz"]);
        let mut report =
            report(vec![("splat", 1000, Ok(found(Some(2.0)))), ("splat", 1000, Ok(found(None)))]);
        report.rows[1].scene = "other/a.ply".into();
        let text = tables(&report);
        assert!(text.contains("\nscenes/a, 1,000") && text.contains("\nother/a, 1,000"), "{text}");
    }

    #[test]
    fn a_failure_is_told_in_one_line_with_what_was_found() {
        let why = "error: this graph needs warps\n --> a.ron:3:4\n  |\n3 |   (\"x\")\n  |    ^^^ found 8\n  |\n  = help: none";
        assert_eq!(summary(why), "this graph needs warps: found 8");
        assert_eq!(summary("error: no\n --> here\n  |  ^^^\n"), "no");
        assert_eq!(summary("no memory"), "no memory");
    }

    #[test]
    fn every_line_of_the_csv_has_the_columns_of_its_header() {
        let rows = vec![("a", 1000, Ok(found(Some(2.0)))), ("b", 1000, Err("error: no\n --> here".into()))];
        let csv = report(rows).csv();
        let commas = |line: &str| line.matches(',').count();
        let header = csv.lines().next().expect("a header");
        assert!(csv.lines().all(|line| commas(line) == commas(header)), "{csv}");
        // The header; five times of the frame, one phase and one pass, for two views and the mean; one memory size; one
        // failed candidate.
        assert_eq!(csv.lines().count(), 1 + 3 * (5 + 1 + 1) + 1 + 1, "{csv}");
        for line in [
            r#""scenes/a.ply",1000,64,48,"a","two",pass,"draw",2,0.25,4000000,2,0.001,"","none (0)","1""#,
            r#""scenes/a.ply",1000,64,48,"a","",memory,"color",,,1048576,,,"#,
            r#""scenes/a.ply",1000,64,48,"b","",failed,"no",,,,,,"#,
        ] {
            assert!(csv.contains(line), "{line}:\n{csv}");
        }
    }
}
