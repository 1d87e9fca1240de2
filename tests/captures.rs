//! Finds the captured scenes, and reports tests that are not run.

use std::io::Write;
use std::path::PathBuf;

/// Reports that a test is not run, in a line that `./x test` counts.
///
/// `println!` is not used: its output is hidden in tests that pass.
pub fn not_run(test: &str, needs: &str) {
    let _ = writeln!(std::io::stderr(), "NOT RUN: {test} needs {needs}");
}

/// Returns the folder of captured scenes in `SPLATGRAPH_DATA`; `None`, with a report, if the variable is not set. Fails
/// if it is set and the folder lacks `scenes/`.
pub fn captures(test: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("SPLATGRAPH_DATA").map(|folder| PathBuf::from(folder).join("scenes"));
    match &folder {
        Some(scenes) => assert!(scenes.is_dir(), "SPLATGRAPH_DATA lacks {}", scenes.display()),
        None => not_run(test, "captured scenes; set SPLATGRAPH_DATA"),
    }
    folder
}
