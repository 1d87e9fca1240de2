//! Provides splats, loading and data files to the tests of this crate.

use crate::scene::{Scene, Splat};
use std::io::Write;
use std::path::PathBuf;

/// Returns a splat that differs for each index.
pub(crate) fn splat(index: usize) -> Splat {
    let t = index as f32;
    Splat {
        position: [t.sin(), (0.7 * t).cos(), 3.0 + (0.3 * t).sin()],
        scale: [0.01 + 0.001 * (t % 7.0), 0.02, 0.03],
        rotation: [0.5, -0.5, 0.5, 0.5],
        opacity: 0.25 + 0.5 * (t % 3.0) / 3.0,
        sh: std::array::from_fn(|k| 0.01 * (k as f32 + 1.0) + (t % 5.0)),
    }
}

pub(crate) fn parse(bytes: &[u8]) -> Result<Scene, crate::error::SceneError> {
    Scene::parse(bytes, crate::QUIET)
}

/// Returns the folder of captured scenes in `SPLATGRAPH_DATA`; reports the test as not run without it.
pub(crate) fn captures(test: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("SPLATGRAPH_DATA").map(|folder| PathBuf::from(folder).join("scenes"));
    if folder.is_none() {
        // Not `println!`, whose output is hidden in tests that pass.
        let _ = writeln!(std::io::stderr(), "NOT RUN: {test} needs captured scenes; set SPLATGRAPH_DATA");
    }
    folder
}

pub(crate) fn golden() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("golden")
}
