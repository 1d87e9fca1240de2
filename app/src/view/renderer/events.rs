//! Defines the causes and results of building a plan.

use crate::planner::GraphErrors;
use serde::{Serialize, Serializer};
use splatgraph_api::{BackendError, Recovery};
use std::fmt;
use std::path::PathBuf;

/// The cause of a build.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cause {
    /// There was no plan.
    Start,
    /// These files changed.
    Files(Vec<PathBuf>),
    /// Constant parameters changed.
    Parameters(Vec<String>),
    /// Another graph was selected.
    Graph,
    /// The picture's size changed.
    Size,
    /// Another scene was opened.
    Scene,
    /// Memory sharing between resources was turned on or off.
    Memory,
    /// The prologue must run again, for an inspection of its results.
    Prologue,
    /// The device was lost and opened again.
    Device,
    /// A frame had no room in the lists of these parameters.
    Room(Vec<String>),
    /// The last attempt failed for want of something that may be there by now, such as memory.
    Retry,
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Cause::Start => f.write_str("start"),
            Cause::Files(files) => {
                let names: Vec<_> =
                    files.iter().map(|p| p.file_name().unwrap_or_default().to_string_lossy()).collect();
                write!(f, "{}", names.join(", "))
            }
            Cause::Parameters(names) => write!(f, "{}", names.join(", ")),
            Cause::Graph => f.write_str("another graph"),
            Cause::Size => f.write_str("another size"),
            Cause::Scene => f.write_str("another scene"),
            Cause::Memory => f.write_str("memory sharing"),
            Cause::Prologue => f.write_str("the prologue"),
            Cause::Device => f.write_str("another device"),
            Cause::Room(names) => write!(f, "growth of {}", names.join(", ")),
            Cause::Retry => f.write_str("another attempt"),
        }
    }
}

impl Serialize for Cause {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The failure of a build.
#[derive(Debug)]
pub enum Failure {
    /// The graph or its shaders have errors.
    Graph(GraphErrors),
    /// The device refused the plan.
    Backend(BackendError),
    /// The build panicked, which is a bug of this program.
    Panicked(String),
    /// Something newer was to be built, and this took long.
    Cancelled,
    /// The device was lost again and again with this graph, which therefore waits for a change.
    Held(String),
}

impl Failure {
    /// Formats the failure as for a terminal, with ANSI colours if requested.
    pub fn text(&self, colour: bool) -> String {
        match self {
            Failure::Graph(errors) => errors.text(colour).trim_end().to_owned(),
            Failure::Backend(error) => format!("error: {error}"),
            Failure::Panicked(message) => {
                format!("error: internal error while building the plan: {message}")
            }
            Failure::Cancelled => "error: the build was cancelled".to_owned(),
            Failure::Held(loss) => format!(
                "error: {loss}\nThe device was lost again and again. This graph is drawn again after the next change of its \
                 files, its parameters or the scene."
            ),
        }
    }

    /// Returns true if the same build may succeed later without a change of files or parameters.
    pub fn may_pass(&self) -> bool {
        match self {
            Failure::Backend(error) => {
                matches!(error, BackendError::OutOfMemory { .. }) || error.recovery() == Recovery::Retry
            }
            Failure::Graph(_) | Failure::Panicked(_) | Failure::Cancelled | Failure::Held(_) => false,
        }
    }
}

/// A plan that replaced another, with the times of its build.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Swap {
    /// Name of the graph.
    pub graph: String,
    /// Cause of the build.
    pub cause: Cause,
    /// Number of passes in its frame.
    pub passes: usize,
    /// Milliseconds of reading, compiling and solving.
    pub plan_ms: f64,
    /// Milliseconds of preparing the device: memory, pipelines, uploads.
    pub prepare_ms: f64,
    /// Milliseconds from the change, or the system's notice of it, to the end of the first frame on the device.
    pub latency_ms: f64,
}

/// An event of a renderer.
#[derive(Clone, Debug, PartialEq)]
pub enum RendererEvent {
    /// A new plan draws the frames.
    Swapped(Swap),
    /// The build or a frame failed; the former plan and picture stay. The text is without colours.
    Failed(String),
    /// The graph is drawn again after a failure.
    Mended,
    /// Settings were dropped because the graph does not have these parameters.
    Dropped(Vec<String>),
}

impl Cause {
    /// Combines the causes of two changes that are built together.
    pub(super) fn and(self, other: Cause) -> Cause {
        match (self, other) {
            (Cause::Parameters(a), Cause::Parameters(b)) => Cause::Parameters(joined(a, b)),
            (Cause::Files(a), Cause::Files(b)) => Cause::Files(joined(a, b)),
            (Cause::Room(a), Cause::Room(b)) => Cause::Room(joined(a, b)),
            (Cause::Start, _) => Cause::Start,
            (Cause::Graph, _) | (_, Cause::Graph) => Cause::Graph,
            // Nobody asked for these.
            (Cause::Retry | Cause::Room(_), other) | (other, Cause::Retry | Cause::Room(_)) => other,
            // Users wait for edits of files.
            (Cause::Files(files), _) | (_, Cause::Files(files)) => Cause::Files(files),
            (_, other) => other,
        }
    }
}

/// Concatenates two lists without duplicates of the first.
fn joined<T: PartialEq>(mut a: Vec<T>, b: Vec<T>) -> Vec<T> {
    for item in b {
        if !a.contains(&item) {
            a.push(item);
        }
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_that_are_built_together_are_told_together_and_files_before_the_rest() {
        let files = |names: &[&str]| Cause::Files(names.iter().map(PathBuf::from).collect());
        let params = |names: &[&str]| Cause::Parameters(names.iter().map(|n| n.to_string()).collect());
        assert_eq!(params(&["a"]).and(params(&["b", "a"])), params(&["a", "b"]));
        assert_eq!(files(&["x"]).and(files(&["x", "y"])), files(&["x", "y"]));
        assert_eq!(params(&["a"]).and(files(&["x"])), files(&["x"]));
        assert_eq!(Cause::Size.and(params(&["a"])), params(&["a"]));
        assert_eq!(Cause::Start.and(files(&["x"])), Cause::Start);
        assert_eq!(files(&["x"]).and(Cause::Graph), Cause::Graph);
        assert_eq!(Cause::Retry.and(Cause::Size), Cause::Size);
        let room = |name: &str| Cause::Room(vec![name.to_owned()]);
        assert_eq!(room("x").and(room("y")), Cause::Room(vec!["x".into(), "y".into()]));
        assert_eq!(room("x").and(Cause::Size), Cause::Size);
        assert_eq!(params(&["a"]).and(room("x")), params(&["a"]));
    }
}
