//! Defines the viewer's events, for the log in the window and for `--events` (one JSON object per line).

use indexmap::IndexSet;
use serde::{Serialize, Serializer};
use std::fmt;
use std::path::{Path, PathBuf};

/// Renderer that an event concerns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RendererId {
    /// The first renderer: its picture fills the view, is left of the split line, or has B's subtracted from it.
    #[default]
    A,
    /// The renderer that A is compared with: its picture is right of the split line, or subtracted from A's.
    B,
    /// The renderer of the window's own graph, which draws the pictures and the user interface.
    Window,
}

impl fmt::Display for RendererId {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            RendererId::A => "A",
            RendererId::B => "B",
            RendererId::Window => "window",
        })
    }
}

/// Serialises a path lossily: serde rejects a path that is not UTF-8.
fn displayed<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
}

/// Makes a path absolute, if possible: generated names are relative to the working directory.
fn whole(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// A cause of a build.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Cause {
    /// There is no plan yet.
    Start,
    /// This file changed.
    File(PathBuf),
    /// This constant parameter changed.
    Parameter(String),
    /// Another graph was selected.
    Graph,
    /// The picture's size changed.
    Size,
    /// The scene as drawn changed: another was opened, or splats were selected or hidden.
    Scene,
    /// Memory sharing between resources was turned on or off.
    Memory,
    /// The prologue must run again, for an inspection of its results.
    Prologue,
    /// The device was lost and opened again.
    Device,
    /// A frame overflowed a list, so this parameter, the list's capacity, was raised.
    Room(String),
    /// The last build failed for lack of something that may be available now, such as memory.
    Retry,
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Cause::Start => f.write_str("start"),
            Cause::File(file) => f.write_str(&file.file_name().unwrap_or_default().to_string_lossy()),
            Cause::Parameter(name) => f.write_str(name),
            Cause::Graph => f.write_str("another graph"),
            Cause::Size => f.write_str("another size"),
            Cause::Scene => f.write_str("a change of the scene"),
            Cause::Memory => f.write_str("memory sharing"),
            Cause::Prologue => f.write_str("the prologue"),
            Cause::Device => f.write_str("another device"),
            Cause::Room(name) => write!(f, "growth of {name}"),
            Cause::Retry => f.write_str("another attempt"),
        }
    }
}

/// Causes of a build without duplicates, in the order of the changes; a list of strings in JSON.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Causes(IndexSet<Cause>);

impl Causes {
    /// Returns true if `cause` is among the causes.
    pub fn contains(&self, cause: &Cause) -> bool {
        self.0.contains(cause)
    }

    /// Iterates over the causes in the order of the changes.
    pub fn iter(&self) -> impl Iterator<Item = &Cause> {
        self.0.iter()
    }

    pub(super) fn add(&mut self, later: Causes) {
        self.0.extend(later.0);
    }

    /// Returns true if there are causes, and all are overflows.
    pub(super) fn is_room_alone(&self) -> bool {
        !self.0.is_empty() && self.0.iter().all(|cause| matches!(cause, Cause::Room(_)))
    }

    /// Returns true if no cause is external: all are overflows or retries.
    pub(super) fn are_own(&self) -> bool {
        self.0.iter().all(|cause| matches!(cause, Cause::Room(_) | Cause::Retry))
    }

    /// Returns true if all causes are changes of files and parameters.
    pub(super) fn are_edits(&self) -> bool {
        self.0.iter().all(|cause| matches!(cause, Cause::File(_) | Cause::Parameter(_)))
    }

    /// Returns true if a file changed.
    pub fn has_file(&self) -> bool {
        self.0.iter().any(|cause| matches!(cause, Cause::File(_)))
    }
}

impl From<Cause> for Causes {
    fn from(cause: Cause) -> Causes {
        Causes(IndexSet::from([cause]))
    }
}

impl FromIterator<Cause> for Causes {
    fn from_iter<I: IntoIterator<Item = Cause>>(all: I) -> Causes {
        Causes(all.into_iter().collect())
    }
}

impl fmt::Display for Causes {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let texts: Vec<String> = self.0.iter().map(Cause::to_string).collect();
        f.write_str(&texts.join(", "))
    }
}

impl Serialize for Causes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(Cause::to_string))
    }
}

/// A renderer's new plan, with the causes and times of its build.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Swap {
    /// Name of the graph.
    pub graph: String,
    /// Causes of the build.
    pub causes: Causes,
    /// Number of passes in the new plan's frame.
    pub passes: usize,
    /// Difference from the plan of the former frame, such as `63 → 75 passes: sort 12 → 24`. `None` if each phase has
    /// as many passes as before, and for the first plan.
    #[serde(skip)]
    pub effect: Option<String>,
    /// True if the files or parameters changed, but not the commands. The device keeps its buffers and images, so that
    /// a simulation continues.
    pub same_plan: bool,
    /// Milliseconds to read the graph, compile its shaders, and solve the plan.
    pub plan_ms: f64,
    /// Milliseconds to prepare the device: memory, pipelines, uploads.
    pub prepare_ms: f64,
    /// Milliseconds from the change, or its notification by the system, to the end of the plan's first frame.
    pub latency_ms: f64,
}

impl Swap {
    /// Lists the constant parameters whose changes caused the build.
    pub fn parameters(&self) -> Vec<String> {
        let name = |cause: &Cause| match cause {
            Cause::Parameter(name) => Some(name.clone()),
            _ => None,
        };
        self.causes.iter().filter_map(name).collect()
    }
}

/// An event in the viewer, for the log in the window and for `--events`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The first frame of a new plan has ended; see [`Swap`].
    Swapped {
        /// Renderer of the plan.
        renderer: RendererId,
        /// Reason for the new plan and the times of its build.
        #[serde(flatten)]
        swap: Swap,
    },
    /// A plan could not be built, or a frame could not be drawn. The previous plan and picture, if any, stay.
    Failed {
        /// Renderer that failed.
        renderer: RendererId,
        /// Error messages, without colours.
        text: String,
    },
    /// A plan was built or a frame drawn after a failure, or the device was replaced.
    Mended {
        /// Renderer that works again.
        renderer: RendererId,
    },
    /// Settings were dropped: the new graph lacks their parameters, sets them itself, or excludes their values.
    Dropped {
        /// Renderer with the new graph.
        renderer: RendererId,
        /// Names of the parameters.
        parameters: Vec<String>,
        /// Reasons, as text for the user.
        text: String,
    },
    /// Dropped settings apply again, because the new graph accepts them.
    Restored {
        /// Renderer with the new graph.
        renderer: RendererId,
        /// Names of the parameters.
        parameters: Vec<String>,
        /// Restored values, as text for the user.
        text: String,
    },
    /// A scene was loaded.
    Scene {
        /// Path of the scene.
        #[serde(serialize_with = "displayed")]
        path: PathBuf,
        /// Number of splats in the scene.
        splats: u32,
        /// Loading time, in milliseconds.
        load_ms: f64,
    },
    /// A loaded scene is unusual, for example because of dropped splats; see [`crate::io::losses::notes`].
    SceneNotes {
        /// Path of the scene.
        #[serde(serialize_with = "displayed")]
        path: PathBuf,
        /// One text for each peculiarity, as printed on standard error at the start.
        notes: Vec<String>,
    },
    /// A scene could not be loaded; the previous one stays.
    SceneFailed {
        /// Path of the scene.
        #[serde(serialize_with = "displayed")]
        path: PathBuf,
        /// Cause of the failure.
        error: String,
        /// True if the error stays over the picture until a scene is loaded. The shown scene then changed, or a list of
        /// scenes has an error.
        stays: bool,
    },
    /// Cameras were loaded.
    Cameras {
        /// Path of the cameras.
        #[serde(serialize_with = "displayed")]
        path: PathBuf,
        /// Number of cameras.
        count: usize,
    },
    /// A file could not be read or written, or has an unknown type; or a frame could not be captured.
    FileFailed {
        /// Path of the file.
        #[serde(serialize_with = "displayed")]
        path: PathBuf,
        /// Cause of the failure.
        error: String,
    },
    /// A file with cameras was written.
    Saved {
        /// Path of the written file.
        #[serde(serialize_with = "displayed")]
        path: PathBuf,
    },
    /// A picture was written.
    Screenshot {
        /// Path of the written file.
        #[serde(serialize_with = "displayed")]
        path: PathBuf,
    },
    /// The selected or hidden splats changed.
    Marked {
        /// Number of selected splats after the change.
        selected: u32,
        /// Number of hidden splats after the change.
        hidden: u32,
    },
    /// Splats were written to a file.
    Exported {
        /// Path of the written file.
        #[serde(serialize_with = "displayed")]
        path: PathBuf,
        /// Number of splats in the file.
        splats: u32,
        /// Size of the file, in bytes.
        bytes: u64,
        /// Tags of the file with their values; see [`super::export::Written::tags`].
        tags: Vec<String>,
        /// Data of the scene that the file lacks; see [`super::export::Written::lost`].
        lost: Vec<String>,
    },
    /// The device or its window surface was lost, with everything on the device. The scene stays in host memory.
    DeviceLost {
        /// Error of the device.
        error: String,
    },
    /// A device was opened as a replacement for the lost one.
    DeviceOpened {
        /// Name of the device.
        name: String,
        /// Number of attempts to open it, including the successful one.
        attempts: u32,
    },
    /// A request could not be fulfilled, or the viewer dropped something, such as the marks of a changed file.
    Problem {
        /// Message, with its context.
        text: String,
    },
    /// The device has been running one pass (on a CPU, one frame) for more than a second, which delays pictures.
    Slow {
        /// Name of the pass or frame.
        place: String,
    },
    /// A and B were exchanged: earlier events about A now apply to B, and vice versa.
    Exchanged,
    /// A and B were compared.
    Compared {
        /// PSNR in decibels; infinite for identical pictures, which is `null` in JSON.
        psnr: f64,
        /// SSIM; `None` for pictures smaller than the window of SSIM.
        ssim: Option<f64>,
        /// Largest difference in a colour channel, from 0 to 1.
        worst: f64,
        /// True if the pictures are identical as shown, clamped to 0..1.
        identical: bool,
    },
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Event::Swapped { renderer, swap } => {
                let Swap { graph, causes, passes, same_plan, plan_ms, prepare_ms, latency_ms, .. } = swap;
                if *same_plan {
                    return write!(f, "{renderer}: {graph} after {causes}: the same plan");
                }
                write!(
                    f,
                    "{renderer}: {graph} after {causes}: {latency_ms:.0} ms to its first frame ({passes} passes; plan \
                     {plan_ms:.0} ms, device {prepare_ms:.0} ms)"
                )
            }
            Event::Failed { renderer, text } => {
                write!(f, "{renderer}: {}", text.lines().next().unwrap_or_default())
            }
            Event::Mended { renderer } => write!(f, "{renderer}: mended"),
            Event::Dropped { renderer, text, .. } | Event::Restored { renderer, text, .. } => {
                write!(f, "{renderer}: {text}")
            }
            Event::Scene { path, splats, load_ms } => {
                let splats = splatgraph_assets::grouped((*splats).into());
                write!(f, "{}: {splats} splats in {load_ms:.0} ms", path.display())
            }
            Event::SceneNotes { path, notes } => write!(f, "{}: {}", path.display(), notes.join("; ")),
            Event::SceneFailed { path, error, .. } | Event::FileFailed { path, error } => {
                // Most error messages already contain the file's name.
                let name = path.display().to_string();
                if error.contains(&name) { f.write_str(error) } else { write!(f, "{name}: {error}") }
            }
            Event::Cameras { path, count } => write!(f, "{}: {count} cameras", path.display()),
            Event::DeviceLost { error } => write!(f, "{error}"),
            Event::Problem { text } => f.write_str(text),
            Event::Exchanged => f.write_str("A and B exchanged"),
            Event::Slow { place } => write!(f, "{place} has been running for more than a second"),
            Event::DeviceOpened { name, attempts: 1 } => write!(f, "{name} was reopened"),
            Event::DeviceOpened { name, attempts } => {
                write!(f, "{name} was reopened at attempt {attempts}")
            }
            Event::Screenshot { path } | Event::Saved { path } => {
                write!(f, "{} written", whole(path).display())
            }
            Event::Marked { selected, hidden } => {
                let count = |count: u32| splatgraph_assets::grouped(count.into());
                write!(f, "{} splats selected, {} hidden", count(*selected), count(*hidden))
            }
            Event::Exported { path, splats, bytes, tags, lost } => {
                let count = splatgraph_assets::grouped;
                let path = whole(path);
                write!(f, "{}: {} splats, {} bytes", path.display(), count((*splats).into()), count(*bytes))?;
                if !tags.is_empty() {
                    write!(f, "; tags: {}", tags.join("; "))?;
                }
                if lost.is_empty() { Ok(()) } else { write!(f, "; lost: {}", lost.join("; ")) }
            }
            Event::Compared { psnr, ssim, worst, identical } => {
                if psnr.is_infinite() {
                    return f.write_str("A against B: identical");
                }
                write!(f, "A against B: {psnr:.2} dB PSNR, worst pixel {worst:.4}")?;
                ssim.map_or(Ok(()), |ssim| write!(f, ", SSIM {ssim:.4}"))?;
                f.write_str(if *identical { ": identical" } else { "" })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_that_are_built_together_are_all_told_each_once_in_their_order() {
        let mut causes = Causes::from(Cause::Size);
        causes.add([Cause::Scene, Cause::Size].into_iter().collect());
        causes.add(Cause::File("shaders/splat.frag".into()).into());
        assert!(causes.contains(&Cause::Size) && causes.contains(&Cause::Scene));
        assert_eq!(causes.to_string(), "another size, a change of the scene, splat.frag");
        let json = serde_json::to_string(&causes).unwrap();
        assert_eq!(json, r#"["another size","a change of the scene","splat.frag"]"#);
    }

    #[cfg(unix)]
    #[test]
    fn an_event_with_a_path_that_is_not_utf_8_is_written() {
        use std::os::unix::ffi::OsStrExt;
        let path = Path::new(std::ffi::OsStr::from_bytes(b"caf\xe9")).to_owned();
        let json = serde_json::to_string(&Event::Saved { path }).unwrap();
        assert_eq!(json, "{\"event\":\"saved\",\"path\":\"caf\u{fffd}\"}");
    }

    #[test]
    fn a_written_file_is_told_with_its_tags() {
        let (path, tags) = (PathBuf::from("/a.ply"), vec!["up 0,0,1".to_owned()]);
        let event = Event::Exported { path, splats: 2, bytes: 1000, tags, lost: Vec::new() };
        assert_eq!(event.to_string(), "/a.ply: 2 splats, 1,000 bytes; tags: up 0,0,1");
    }

    #[test]
    fn more_room_alone_is_told_from_more_room_with_another_change() {
        let room = |name: &str| Cause::Room(name.to_owned());
        let mut causes: Causes = [room("x"), room("y")].into_iter().collect();
        assert!(causes.is_room_alone());
        assert_eq!(causes.to_string(), "growth of x, growth of y");
        causes.add(Cause::Size.into());
        assert!(!causes.is_room_alone());
        assert!(!Causes::default().is_room_alone());
    }
}
