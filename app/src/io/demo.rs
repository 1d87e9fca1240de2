//! Generates and finds the demo scene, which commands draw if no scene is given.
//!
//! The first use writes the scene as a `.ply`; later uses load that file. If it cannot be written, each use generates
//! the scene.

use crate::io::folders;
use crate::io::output::file::Cause;
use splatgraph_assets::{Camera, synth};
use std::env;
use std::path::{Path, PathBuf};

/// Name of the demo scene's generator.
pub const NAME: &str = "demo";

/// Returns the demo scene's path: `assets/splats/demo.ply` in a checkout, otherwise in the user's cache folder.
///
/// `None` if there is no cache folder. The temporary folder is not used: its names are predictable, and another user
/// could plant a file.
pub fn path() -> Option<PathBuf> {
    let here = env::current_dir().unwrap_or_default();
    let in_checkout =
        |folder: &&Path| folder.join("pipelines/splat.ron").is_file() && folder.join("assets").is_dir();
    match here.ancestors().find(in_checkout) {
        Some(root) => Some(root.join("assets/splats/demo.ply")),
        // Another version may generate another scene.
        None => Some(folders::cache()?.join(concat!("splatgraph/demo-", env!("CARGO_PKG_VERSION"), ".ply"))),
    }
}

/// Generates the demo scene, as the bytes of its file.
///
/// # Errors
/// There is not enough memory.
pub fn generate() -> Result<Vec<u8>, Cause> {
    let generator = synth::generators().iter().find(|g| g.name == NAME);
    let scene = synth::generate(NAME, generator.map_or(0, |g| g.default_count), 0)?;
    let mut bytes = Vec::new();
    scene.write_ply_to(&mut bytes)?;
    Ok(bytes)
}

/// Returns the initial camera of the demo scene.
pub fn camera() -> Option<Camera> {
    synth::demo_cameras().into_iter().next()
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::Scene;

    #[test]
    fn its_file_is_a_complete_scene() {
        let scene = Scene::parse(&generate().unwrap(), splatgraph_assets::QUIET).unwrap();
        assert_eq!((scene.stored_degree(), scene.dropped().total()), (3, 0));
    }

    #[test]
    fn in_a_checkout_the_scene_lies_among_the_assets() {
        assert!(path().is_some_and(|path| path.ends_with("assets/splats/demo.ply")), "{:?}", path());
    }

    #[test]
    fn it_has_a_camera() {
        assert!(camera().is_some());
    }
}
