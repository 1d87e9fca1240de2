//! Provides splats, loading and data files to the tests of this crate.

#[path = "../../tests/captures.rs"]
mod captures;

use crate::scene::{Scene, Splat};
use crate::scene_format::SceneFormat;
pub(crate) use captures::captures;
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

pub(crate) fn written(scene: &Scene, format: SceneFormat) -> Vec<u8> {
    let mut bytes = Vec::new();
    scene.write(format, crate::QUIET, &mut bytes).unwrap();
    bytes
}

#[track_caller]
pub(crate) fn says(message: impl std::fmt::Display, expected: &str) {
    let message = message.to_string();
    assert!(message.contains(expected), "{message}; expected {expected}");
}

pub(crate) fn golden() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("golden")
}
