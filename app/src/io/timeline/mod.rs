//! Records the timeline of a command, as a trace for Perfetto and a summary as text.

mod record;
mod summary;
mod trace;

use crate::io::output::{self, OutputError};
use serde_json::Value as Json;
use std::path::{Path, PathBuf};
use std::time::Instant;

pub use record::{Frame, Pass, completed, submitted};

/// A timeline in progress, and the file to which its trace is written.
pub struct Timeline {
    path: PathBuf,
}

impl Timeline {
    /// Starts recording. The command's work began earlier, at `begun`.
    pub fn start(path: &Path, begun: Instant) -> Timeline {
        record::start(begun, "read the command line");
        Timeline { path: path.to_owned() }
    }

    /// Ends the recording, writes the trace, and returns the summary. `command` is the command line.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(self, command: &str) -> Result<String, OutputError> {
        let recording = record::finish().unwrap_or_default();
        let trace: Json = trace::json(&recording, command);
        output::write_bytes(&self.path, format!("{trace}\n").as_bytes())?;
        Ok(summary::text(&recording))
    }
}
