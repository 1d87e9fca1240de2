//! Generates and finds the demo scene, the default of `render` and `view`.
//!
//! The first use writes it as an ordinary `.ply` in the layout of the reference implementation; later uses load that file.

use splatgraph_assets::{Camera, Scene, synth};
use std::env;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Name of the generator.
pub const NAME: &str = "demo";

/// Returns the demo scene's path: `assets/splats/demo.ply` in a checkout, else in the user's cache folder.
pub fn path() -> PathBuf {
    let here = env::current_dir().unwrap_or_default();
    let in_checkout =
        |folder: &&Path| folder.join("pipelines/splat.ron").is_file() && folder.join("assets").is_dir();
    match here.ancestors().find(in_checkout) {
        Some(root) => root.join("assets/splats/demo.ply"),
        // Another version of the program may make another scene.
        None => cache_folder().join(concat!("splatgraph/demo-", env!("CARGO_PKG_VERSION"), ".ply")),
    }
}

fn cache_folder() -> PathBuf {
    let variable = |name| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let home = || variable("HOME");
    let folder = if cfg!(windows) {
        variable("LOCALAPPDATA")
    } else if cfg!(target_os = "macos") {
        home().map(|home| home.join("Library/Caches"))
    } else {
        variable("XDG_CACHE_HOME").or_else(|| home().map(|home| home.join(".cache")))
    };
    folder.unwrap_or_else(env::temp_dir)
}

/// Generates the demo scene if `path` does not exist; returns true if it did.
pub fn ensure(path: &Path) -> io::Result<bool> {
    if path.is_file() {
        return Ok(false);
    }
    write(&generate().map_err(io::Error::other)?, path)?;
    Ok(true)
}

fn generate() -> Result<Scene, synth::SynthError> {
    let generator = synth::generators().iter().find(|g| g.name == NAME);
    synth::generate(NAME, generator.map_or(0, |g| g.default_count), 0)
}

/// Writes a scene atomically, through a temporary file: no reader finds half of it.
pub fn write(scene: &Scene, path: &Path) -> io::Result<()> {
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder)?;
    }
    let unfinished = path.with_extension(format!("{}.tmp", std::process::id()));
    let written = scene.write_ply(&unfinished).and_then(|()| fs::rename(&unfinished, path));
    if written.is_err() {
        // The first error is the one to report.
        let _ = fs::remove_file(&unfinished);
    }
    written
}

/// Makes the demo scene's first camera.
pub fn camera() -> Option<Camera> {
    synth::demo_cameras().into_iter().next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scene_is_written_once_and_loads() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/demo.ply");
        assert!(ensure(&path).unwrap());
        assert!(!ensure(&path).unwrap());
        let scene = Scene::load(&path, &|_, _| {}).unwrap();
        assert_eq!((scene.stored_degree(), scene.dropped().total()), (3, 0));
        let beside: Vec<_> = fs::read_dir(path.parent().unwrap()).unwrap().collect();
        assert_eq!(beside.len(), 1, "nothing unfinished is left");
    }

    #[test]
    fn in_a_checkout_the_scene_lies_among_the_assets() {
        // Tests run in app/.
        assert!(path().ends_with("assets/splats/demo.ply"), "{}", path().display());
    }

    #[test]
    fn it_has_a_camera() {
        assert!(camera().is_some());
    }
}
