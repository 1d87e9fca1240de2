//! Loads scenes, with or without the tags of their files.

use splatgraph_assets::{Content, LoadError, Progress, Scene, SceneHeader};
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

static IGNORES_TAGS: AtomicBool = AtomicBool::new(false);

static LEVEL: OnceLock<u32> = OnceLock::new();

/// Makes all later loads ignore the tags of scenes' files.
pub fn ignore_tags() {
    IGNORES_TAGS.store(true, Ordering::Relaxed);
}

/// Sets the level of all scenes that are loaded from now on. Only the first call has an effect.
pub fn set_level(level: u32) {
    LEVEL.get_or_init(|| level);
}

/// Reads the header of a scene file.
///
/// # Errors
/// Those of [`SceneHeader::load_level`].
pub fn header(path: &Path) -> Result<SceneHeader, LoadError> {
    SceneHeader::load_level(path, LEVEL.get().copied())
}

/// Loads a scene.
///
/// # Errors
/// See [`Scene::load_level`].
pub fn scene(path: &Path, progress: Progress) -> Result<Scene, LoadError> {
    Ok(tagged(Scene::load_level(path, LEVEL.get().copied(), progress)?))
}

/// Loads a scene, or a mesh that is drawn together with one.
///
/// # Errors
/// See [`Scene::load_any`].
pub fn any(path: &Path, progress: Progress) -> Result<Content, LoadError> {
    Ok(match Scene::load_any(path, LEVEL.get().copied(), progress)? {
        Content::Splats(scene) => Content::Splats(tagged(*scene).into()),
        mesh => mesh,
    })
}

/// Removes the tags of a loaded scene if they are to be ignored.
fn tagged(scene: Scene) -> Scene {
    if IGNORES_TAGS.load(Ordering::Relaxed) { scene.without_tags() } else { scene }
}
