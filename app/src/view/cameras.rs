//! Keeps the user's saved views, and writes cameras to files.
//!
//! Cameras are stored in the world's coordinates, as in a `cameras.json`, so they stay valid when another part of the
//! world is opened.

use crate::io::output::{self, OutputError, harmless};
use splatgraph_assets::Camera;
use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::iter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The user's saved views. A view's name is its camera's `img_name`, and is unique.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Views {
    /// Shared with the steps that can be undone.
    list: Arc<Vec<Camera>>,
}

impl Views {
    /// Returns the saved views, in the world's coordinates.
    pub fn list(&self) -> &[Camera] {
        &self.list
    }

    /// Adds a view at the end, and returns its index. A name already in use gets a number; an empty one becomes `view`.
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

/// An error of [`CameraFiles::save`].
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The list of cameras is empty.
    #[error("expected at least one camera to save, found none")]
    Empty,
    /// The file's extension is not `.json`.
    #[error("expected a file name with the extension .json, found {}", .0.display())]
    Extension(PathBuf),
    /// The file exists, and this window did not write its contents.
    #[error("expected a new file, found one that this window did not write: {}", .0.display())]
    Exists(PathBuf),
    /// The file cannot be read or written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// Writes camera files; overwrites only files that this window wrote itself.
#[derive(Clone, Debug, Default)]
pub struct CameraFiles {
    /// Text of each file that this window wrote, by absolute path.
    written: BTreeMap<PathBuf, String>,
}

impl CameraFiles {
    /// Writes a `cameras.json` of cameras in the world's coordinates, atomically.
    ///
    /// # Errors
    /// See [`SaveError`].
    pub fn save(&mut self, cameras: &[Camera], path: &Path) -> Result<(), SaveError> {
        if cameras.is_empty() {
            return Err(SaveError::Empty);
        }
        if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json")) {
            return Err(SaveError::Extension(path.to_owned()));
        }
        let failed = |cause: std::io::Error| OutputError { path: path.to_owned(), cause: cause.into() };
        let target = std::path::absolute(path).map_err(failed)?;
        let is_own = match fs::symlink_metadata(&target) {
            Err(error) if error.kind() == ErrorKind::NotFound => false,
            Err(error) => return Err(failed(error).into()),
            Ok(found) => {
                // Another program may have replaced the file since this window wrote it.
                let own = |text: &String| {
                    found.is_file()
                        && found.len() == text.len() as u64
                        && fs::read(&target).is_ok_and(|bytes| bytes == text.as_bytes())
                };
                if !self.written.get(&target).is_some_and(own) {
                    return Err(SaveError::Exists(path.to_owned()));
                }
                true
            }
        };
        let json = serde_json::to_string_pretty(cameras).map_err(|error| failed(error.into()))?;
        let text = harmless(&json).into_owned() + "\n";
        let written = match is_own {
            true => output::write_bytes(&target, text.as_bytes()),
            false => output::write_new_bytes(&target, text.as_bytes()),
        };
        // Another window may have written the file meanwhile.
        written.map_err(|error| match error.is_taken() {
            true => SaveError::Exists(path.to_owned()),
            false => error.into(),
        })?;
        self.written.insert(target, text);
        Ok(())
    }
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
    fn saved_cameras_are_read_back_bit_by_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/views.json");
        let mut views = Views::default();
        for (index, name) in ["a", "b \u{202e}\u{9b}", "it's \"c\""].into_iter().enumerate() {
            views.add(name, camera(index as f64));
        }
        CameraFiles::default().save(views.list(), &path).unwrap();
        assert_eq!(Camera::load(&path).unwrap(), views.list());
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.ends_with("]\n") && !text.contains(['\u{202e}', '\u{9b}']), "{text}");
    }

    #[test]
    fn only_files_that_this_window_wrote_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let mut files = CameraFiles::default();
        files.save(&[camera(1.0)], &at("own.json")).unwrap();
        files.save(&[camera(2.0)], &at("own.json")).unwrap();
        assert_eq!(Camera::load(at("own.json")).unwrap(), [camera(2.0)]);
        // Another program replaces the file with a text of the same length.
        let text = fs::read_to_string(at("own.json")).unwrap().replace("64", "65");
        fs::write(at("own.json"), &text).unwrap();
        fs::write(at("other.json"), "mine").unwrap();
        fs::create_dir(at("folder.json")).unwrap();
        let mut taken = vec!["own.json", "other.json", "folder.json"];
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("nowhere.json", at("link.json")).unwrap();
            taken.push("link.json");
        }
        for name in taken {
            let error = files.save(&[camera(3.0)], &at(name)).unwrap_err();
            assert!(matches!(error, SaveError::Exists(_)), "{name}: {error}");
            assert!(error.to_string().starts_with("expected a new file, found one that"), "{error}");
        }
        assert_eq!(fs::read_to_string(at("own.json")).unwrap(), text);
        assert_eq!(fs::read_to_string(at("other.json")).unwrap(), "mine");
        // A removed file can be written again.
        fs::remove_file(at("own.json")).unwrap();
        files.save(&[camera(4.0)], &at("own.json")).unwrap();
    }

    #[test]
    fn of_two_windows_that_save_one_new_file_one_is_told_that_it_exists() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("views.json");
        for _ in 0..20 {
            let save = |x: f64| CameraFiles::default().save(&[camera(x)], &path);
            let (first, second) = std::thread::scope(|scope| {
                let other = scope.spawn(|| save(2.0));
                (save(1.0), other.join().unwrap())
            });
            let saved = match (first, second) {
                (Ok(()), Err(SaveError::Exists(_))) => 1.0,
                (Err(SaveError::Exists(_)), Ok(())) => 2.0,
                both => panic!("{both:?}"),
            };
            assert_eq!(Camera::load(&path).unwrap(), [camera(saved)]);
            fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn cameras_that_cannot_be_saved_leave_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let mut files = CameraFiles::default();
        let said = |result: Result<(), SaveError>| result.unwrap_err().to_string();
        assert!(said(files.save(&[], &at("a.json"))).contains("at least one camera"));
        assert!(said(files.save(&[camera(0.0)], &at("scene.ply"))).contains("extension .json"));
        assert!(said(files.save(&[camera(0.0)], Path::new("-"))).contains("extension .json"));
        fs::write(at("file"), "").unwrap();
        assert!(said(files.save(&[camera(0.0)], &at("file/a.json"))).contains("cannot be written"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
