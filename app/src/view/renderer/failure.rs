//! Defines the reasons for a failed build.

use crate::draw::planner::GraphErrors;
use splatgraph_api::{BackendError, Recovery};

/// A reason for a failed build.
#[derive(Debug)]
pub enum Failure {
    /// The graph or its shaders have errors.
    Graph(GraphErrors),
    /// The device rejected the plan, or failed.
    Backend(BackendError),
    /// The build panicked, which is a bug in this program.
    Panicked(String),
    /// The device was lost repeatedly with this graph. The graph is not built again until its files, its parameters or
    /// the scene change. The field is the error text of the loss.
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
            Failure::Graph(_) | Failure::Panicked(_) | Failure::Held(_) => false,
        }
    }
}
