//! Finds the cameras of a command: those of `--cameras`, or the first of the file beside the scene.

use super::{Usage, options};
use crate::draw::camera;
use crate::io::output::{OutputGuard, say};
use anyhow::Result;
use splatgraph_assets::Camera;
use std::path::{Path, PathBuf};

/// Returns the file that is used without `--cameras`; see [`camera::beside`].
fn beside(spec: Option<&str>, scene: Option<&Path>) -> Option<PathBuf> {
    scene.filter(|_| spec.is_none()).and_then(camera::beside)
}

/// Loads all cameras of `--cameras`, or else the first camera of the file beside the scene, and says so.
///
/// A file beside the scene that holds no cameras is named, and not used.
///
/// # Errors
/// The file of `--cameras` cannot be read, or holds no cameras.
pub fn load(spec: Option<&str>, scene: Option<&Path>) -> Result<Option<Vec<Camera>>> {
    if let Some(spec) = spec {
        return Ok(Some(options::cameras(spec)?));
    }
    let Some(file) = beside(spec, scene) else { return Ok(None) };
    let file_name = file.display();
    match options::cameras(&file.to_string_lossy()) {
        Ok(mut all) => {
            let others = match all.len() {
                1 => String::new(),
                count => format!(" of {count}; --cameras {file_name} takes all"),
            };
            say(format!("the camera is the first of {file_name}{others}"));
            all.truncate(1);
            Ok(Some(all))
        }
        Err(error) => {
            say(format!("the cameras beside the scene are not used: {error}"));
            Ok(None)
        }
    }
}

/// Adds the file of the cameras to the inputs.
pub fn claim(guard: &mut OutputGuard, spec: Option<&str>, scene: Option<&Path>) -> Result<(), Usage> {
    if let Some(spec) = spec {
        return options::claim_cameras(guard, spec);
    }
    match beside(spec, scene) {
        Some(file) => Ok(guard.input("the cameras", &file)?),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;

    #[test]
    fn the_first_camera_beside_a_scene_is_taken_unless_others_are_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let (scene, own) = (folder.path().join("a.ply"), folder.path().join("a.cameras.json"));
        assert_eq!(load(None, Some(&scene)).expect("no cameras"), None);
        let cameras = synth::demo_cameras();
        Camera::save(&cameras, &own).expect("written");
        let found = load(None, Some(&scene)).expect("cameras").expect("beside the scene");
        assert_eq!(found, cameras[..1]);
        let spec = own.display().to_string();
        assert_eq!(
            load(Some(&spec), Some(&scene)).expect("cameras").map(|all| all.len()),
            Some(cameras.len())
        );
        assert_eq!(load(None, None).expect("no scene"), None);
        std::fs::write(&own, "{}").expect("written");
        assert_eq!(load(None, Some(&scene)).expect("a file without cameras is not used"), None);
        let mut guard = OutputGuard::default();
        claim(&mut guard, None, Some(&scene)).expect("an input");
        assert!(guard.output("--output", &own).is_err(), "no output replaces it");
    }
}
