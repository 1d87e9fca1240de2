//! Loads scenes, with or without the tags of their files.

use splatgraph_assets::{Content, LoadError, Progress, Scene};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

static IGNORES_TAGS: AtomicBool = AtomicBool::new(false);

/// Makes all later loads ignore the tags of scenes' files.
pub fn ignore_tags() {
    IGNORES_TAGS.store(true, Ordering::Relaxed);
}

/// Loads a scene.
///
/// # Errors
/// See [`Scene::load`].
pub fn scene(path: &Path, progress: Progress) -> Result<Scene, LoadError> {
    let scene = Scene::load(path, progress)?;
    Ok(if IGNORES_TAGS.load(Ordering::Relaxed) { scene.without_tags() } else { scene })
}

/// Loads a scene, or a mesh that is drawn together with one.
///
/// # Errors
/// See [`Scene::load_any`].
pub fn any(path: &Path, progress: Progress) -> Result<Content, LoadError> {
    Ok(match Scene::load_any(path, progress)? {
        Content::Splats(scene) if IGNORES_TAGS.load(Ordering::Relaxed) => {
            Content::Splats(scene.without_tags().into())
        }
        other => other,
    })
}
