//! Why a plan is built, and what came of it.

use crate::planner::GraphErrors;
use splatgraph_api::BackendError;
use std::fmt;
use std::path::PathBuf;

/// Why a plan is built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cause {
    /// There was none.
    Start,
    /// These files changed.
    Files(Vec<PathBuf>),
    /// This constant parameter changed, or several.
    Parameters(Vec<String>),
    /// Another graph was chosen.
    Graph,
    /// The picture has another size.
    Size,
    /// Another scene was opened.
    Scene,
    /// Resources shall share memory, or shall not.
    Memory,
    /// The prologue shall run again, so that what it leaves can be looked at.
    Prologue,
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
        }
    }
}

/// Why there is no new plan.
#[derive(Debug)]
pub enum Failure {
    /// The graph or its shaders have errors.
    Graph(GraphErrors),
    /// The device refused the plan.
    Backend(BackendError),
    /// A mistake of this program's own.
    Panicked(String),
}

impl Failure {
    /// As a terminal shows it, with ANSI colours where asked.
    pub fn text(&self, colour: bool) -> String {
        match self {
            Failure::Graph(errors) => errors.text(colour).trim_end().to_owned(),
            Failure::Backend(error) => format!("error: {error}"),
            Failure::Panicked(message) => {
                format!("error: the program made a mistake of its own while building the plan: {message}")
            }
        }
    }
}

/// A plan that took the place of another, and how long that took.
#[derive(Clone, Debug, PartialEq)]
pub struct Swap {
    /// Of the new plan.
    pub graph: String,
    /// Why it was built.
    pub cause: Cause,
    /// Passes of its frame.
    pub passes: usize,
    /// From the files to the plan: reading, compiling, solving.
    pub plan_ms: f64,
    /// Making it ready on the device: memory, pipelines, uploads.
    pub prepare_ms: f64,
    /// From the change (of a file: as the system told of it) until the device had finished the first frame of the new plan.
    pub latency_ms: f64,
}

/// Names the renderer of an event.
#[derive(Clone, Debug, PartialEq)]
pub enum RendererEvent {
    /// Frames are drawn by a new plan now.
    Swapped(Swap),
    /// There is no new plan; the one before goes on. The text is without colours.
    Failed(String),
    /// What had failed does no longer.
    Mended,
    /// The settings of these names are not for this graph, and were dropped.
    Dropped(Vec<String>),
}

impl Cause {
    /// Of two changes that are built together.
    pub(super) fn and(self, other: Cause) -> Cause {
        match (self, other) {
            (Cause::Parameters(a), Cause::Parameters(b)) => Cause::Parameters(joined(a, b)),
            (Cause::Files(a), Cause::Files(b)) => Cause::Files(joined(a, b)),
            (Cause::Start, _) => Cause::Start,
            (Cause::Graph, _) | (_, Cause::Graph) => Cause::Graph,
            // Files are what people wait for.
            (Cause::Files(files), _) | (_, Cause::Files(files)) => Cause::Files(files),
            (_, other) => other,
        }
    }
}

/// Both lists, without what is in the first already.
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
    }
}
