//! Keeps the user's saved views, and writes cameras to files.
//!
//! Cameras are stored in world coordinates, as in a `cameras.json`, so they stay valid for a scene with another offset.

use crate::io::output::{OutputError, harmless, names};
use splatgraph_assets::Camera;
use std::iter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The user's saved views. A view's name is its camera's `img_name`, and is unique.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Views {
    /// Saved views, shared with the undo history.
    list: Arc<Vec<Camera>>,
}

impl Views {
    /// Returns the saved views, in world coordinates.
    pub fn list(&self) -> &[Camera] {
        &self.list
    }

    /// Adds a view at the end, and returns its index. `camera` is in world coordinates; its name is replaced by `name`,
    /// trimmed, or `view` if that is empty. A name in use gets a number, as in `view 2`.
    pub fn add(&mut self, name: &str, camera: Camera) -> usize {
        let img_name = self.free_name(name);
        Arc::make_mut(&mut self.list).push(Camera { img_name, ..camera });
        self.list.len() - 1
    }

    /// Removes the view at this index, if there is one.
    pub fn remove(&mut self, index: usize) {
        if index < self.list.len() {
            Arc::make_mut(&mut self.list).remove(index);
        }
    }

    fn free_name(&self, name: &str) -> String {
        let name = Some(name.trim()).filter(|name| !name.is_empty()).unwrap_or("view");
        let taken = |name: &str| self.list.iter().any(|view| view.img_name == name);
        let numbered = (2u64..).map(|number| format!("{name} {number}"));
        iter::once(name.to_owned()).chain(numbered).find(|name| !taken(name)).unwrap_or_default()
    }
}

/// Writes cameras in world coordinates to a new file in `folder`: `STEM-1.cameras.json`, or the next free number. Their
/// ids are their indices. Returns the path.
///
/// # Errors
/// The file cannot be written.
pub fn write(cameras: &[Camera], folder: &Path, stem: &str) -> Result<PathBuf, OutputError> {
    let path = |number| folder.join(format!("{stem}-{number}.cameras.json"));
    let numbered = (0..).zip(cameras).map(|(id, camera)| Camera { id, ..camera.clone() });
    let json = serde_json::to_string_pretty(&numbered.collect::<Vec<_>>());
    let json = json.map_err(|error| OutputError { path: path(1), cause: error.into() })?;
    names::write_first_free(path, (harmless(&json).into_owned() + "\n").as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(x: f64) -> Camera {
        Camera::looking_at([x, 0.1, 1.0 / 3.0], [1.0, 2.0, 3.0], 60.0, (64, 48))
    }

    fn names(views: &Views) -> Vec<&str> {
        views.list().iter().map(|view| view.img_name.as_str()).collect()
    }

    #[test]
    fn every_view_has_a_name_of_its_own() {
        let mut views = Views::default();
        for name in ["front", " front ", "", "front", "  ", "front 2"] {
            views.add(name, camera(0.0));
        }
        assert_eq!(names(&views), ["front", "front 2", "view", "front 3", "view 2", "front 2 2"]);
        views.remove(1);
        views.remove(9);
        assert_eq!(views.add("front 2", camera(7.0)), 5);
        assert_eq!(names(&views), ["front", "view", "front 3", "view 2", "front 2 2", "front 2"]);
        assert_eq!(views.list()[5].position, camera(7.0).position);
    }

    #[test]
    fn saved_cameras_are_read_back_bit_by_bit_and_no_file_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let mut views = Views::default();
        for (index, name) in ["a", "b \u{202e}\u{9b}", "it's \"c\""].into_iter().enumerate() {
            views.add(name, camera(index as f64));
        }
        let first = write(views.list(), &folder.path().join("new"), "views").unwrap();
        assert_eq!(first, folder.path().join("new/views-1.cameras.json"));
        let second = write(&[camera(7.0)], &folder.path().join("new"), "views").unwrap();
        assert_eq!(second, folder.path().join("new/views-2.cameras.json"));
        let numbered = (0..).zip(views.list()).map(|(id, view)| Camera { id, ..view.clone() });
        assert_eq!(Camera::load(&first).unwrap(), numbered.collect::<Vec<_>>());
        let text = std::fs::read_to_string(&first).unwrap();
        assert!(text.ends_with("]\n") && !text.contains(['\u{202e}', '\u{9b}']), "{text}");
    }
}
