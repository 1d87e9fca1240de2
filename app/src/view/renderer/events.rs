//! Defines the causes of building a plan, and the events that report the results.

use crate::draw::planner::GraphErrors;
use indexmap::IndexSet;
use serde::{Serialize, Serializer};
use splatgraph_api::{BackendError, Recovery};
use std::fmt;
use std::path::PathBuf;

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
    /// A frame overflowed a list; this parameter sets the list's capacity, and was raised.
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
            Cause::Scene => f.write_str("another scene"),
            Cause::Memory => f.write_str("memory sharing"),
            Cause::Prologue => f.write_str("the prologue"),
            Cause::Device => f.write_str("another device"),
            Cause::Room(name) => write!(f, "growth of {name}"),
            Cause::Retry => f.write_str("another attempt"),
        }
    }
}

/// Causes of a build without duplicates, in the order of the changes. In JSON, they are a list of texts.
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

    /// Returns true if there are causes, and all are overflowed lists.
    pub(super) fn is_room_alone(&self) -> bool {
        !self.0.is_empty() && self.0.iter().all(|cause| matches!(cause, Cause::Room(_)))
    }

    /// Returns true if all causes are the renderer's own: another attempt, or an overflowed list.
    pub(super) fn are_own(&self) -> bool {
        self.0.iter().all(|cause| matches!(cause, Cause::Room(_) | Cause::Retry))
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

/// A reason why a build failed.
#[derive(Debug)]
pub enum Failure {
    /// The graph or its shaders have errors.
    Graph(GraphErrors),
    /// The device rejected the plan.
    Backend(BackendError),
    /// The build panicked, which is a bug in this program.
    Panicked(String),
    /// The build took long and was cancelled in favour of a newer request.
    Cancelled,
    /// The device was lost repeatedly with this graph, which is not built again before something changes. The field is
    /// the text of the loss.
    Held(String),
}

impl Failure {
    /// Formats the failure as text, with ANSI colours if `colour`.
    pub fn text(&self, colour: bool) -> String {
        match self {
            Failure::Graph(errors) => errors.text(colour).trim_end().to_owned(),
            Failure::Backend(error) => format!("error: {error}"),
            Failure::Panicked(message) => {
                format!("error: internal error while building the plan: {message}")
            }
            Failure::Cancelled => "error: the build was cancelled".to_owned(),
            Failure::Held(loss) => format!(
                "error: {loss}\nThe device was lost repeatedly. This graph is not drawn until its files, its parameters or the \
                 scene change."
            ),
        }
    }

    /// Returns true if the same build may succeed later, without a change of files or parameters.
    pub fn may_pass(&self) -> bool {
        match self {
            Failure::Backend(error) => {
                matches!(error, BackendError::OutOfMemory { .. }) || error.recovery() == Recovery::Retry
            }
            Failure::Graph(_) | Failure::Panicked(_) | Failure::Cancelled | Failure::Held(_) => false,
        }
    }
}

/// The replacement of a plan, with the times of its build.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Swap {
    /// Name of the graph.
    pub graph: String,
    /// Causes of the build.
    pub causes: Causes,
    /// Number of passes in the new plan's frame.
    pub passes: usize,
    /// Milliseconds to read the graph, compile its shaders, and solve the plan.
    pub plan_ms: f64,
    /// Milliseconds to prepare the device: memory, pipelines, uploads.
    pub prepare_ms: f64,
    /// Milliseconds from the change, or the system's notification of it, to the end of the plan's first frame on the
    /// device.
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

/// An event of a renderer.
#[derive(Clone, Debug, PartialEq)]
pub enum RendererEvent {
    /// A new plan replaced the previous one.
    Swapped(Swap),
    /// The build or a frame failed; the previous plan and picture stay. The text is without colours.
    Failed(String),
    /// A plan was built, or a frame drawn, for the first time after a failure.
    Mended,
    /// The graph rejects the settings of these parameters since its files changed.
    Dropped {
        /// Names of the parameters.
        parameters: Vec<String>,
        /// The reasons.
        text: String,
    },
    /// The graph accepts dropped settings of these parameters again.
    Restored {
        /// Names of the parameters.
        parameters: Vec<String>,
        /// The values.
        text: String,
    },
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
        assert_eq!(causes.to_string(), "another size, another scene, splat.frag");
        let json = serde_json::to_string(&causes).unwrap();
        assert_eq!(json, r#"["another size","another scene","splat.frag"]"#);
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
