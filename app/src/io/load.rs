//! Loads scenes, with the tags of their files or without them.

use splatgraph_assets::{LoadError, Progress, Scene};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

static IGNORES_TAGS: AtomicBool = AtomicBool::new(false);

/// Drops the tags of all scenes that are loaded from now on.
pub fn ignore_tags() {
    IGNORES_TAGS.store(true, Ordering::Relaxed);
}

/// Loads a scene.
///
/// # Errors
/// Those of [`Scene::load`].
pub fn scene(path: &Path, progress: Progress) -> Result<Scene, LoadError> {
    let scene = Scene::load(path, progress)?;
    Ok(if IGNORES_TAGS.load(Ordering::Relaxed) { scene.without_tags() } else { scene })
}
