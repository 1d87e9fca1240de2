//! Shows the system's file dialog without blocking the window.

use crate::view::latest::Latest;
use crate::view::opening::CameraRole;
use crate::view::renderer::Wake;
use rfd::AsyncFileDialog;
use splatgraph_assets::SceneFormat;
use std::env;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The chosen file, and the role of its cameras; `None` if the request was for any file.
type Chosen = (PathBuf, Option<CameraRole>);

/// The chosen file (`None` if the user cancelled), and how long the dialog was open.
type Answer = (Option<Chosen>, Duration);

/// Time within which no user can cancel a dialog; a dialog that ends earlier was never shown.
const SHOWN: Duration = Duration::from_millis(500);

/// File dialog; at most one is open.
pub struct Dialog {
    answer: Latest<Answer>,
}

impl Dialog {
    /// Creates a closed dialog. It calls `wake` when the user has chosen a file or cancelled.
    pub fn new(wake: Wake) -> Dialog {
        Dialog { answer: Latest::new("choose a file", wake) }
    }

    /// Opens the dialog in the folder of `near`, for any file or, with `cameras`, for cameras of this role. Does
    /// nothing while it is open. Fails if the system cannot start a thread.
    pub fn ask(
        &mut self,
        window: &winit::window::Window,
        near: &Path,
        cameras: Option<CameraRole>,
    ) -> Result<(), String> {
        if self.answer.busy() {
            return Ok(());
        }
        let (title, filter, endings) = match cameras {
            None => ("Open a scene, a graph, cameras or a selection", "Files of the viewer", openable()),
            Some(_) => ("Open cameras", "Cameras", vec!["json"]),
        };
        let mut dialog = AsyncFileDialog::new()
            .set_parent(window)
            .set_title(title)
            .add_filter(filter, &endings)
            .add_filter("All files", &["*"]);
        if let Some(folder) = near.parent().and_then(|folder| dunce::canonicalize(folder).ok()) {
            dialog = dialog.set_directory(folder);
        }
        let answer = dialog.pick_file();
        self.answer.start(move |_| {
            let begun = Instant::now();
            let chosen = pollster::block_on(answer).map(|file| (file.path().to_owned(), cameras));
            Some(Ok((chosen, begun.elapsed())))
        })
    }

    /// Takes the chosen file; `None` while the dialog is open, if it was cancelled, or without a request. Fails if the
    /// system has no dialog to show.
    pub fn take(&mut self) -> Option<Result<Chosen, String>> {
        match self.answer.take()? {
            Ok((Some(chosen), _)) => Some(Ok(chosen)),
            Ok((None, time)) => lacking(time, &env::var_os("PATH").unwrap_or_default()).map(Err),
            Err(error) => Some(Err(error)),
        }
    }
}

/// Returns an error if a dialog ended without a file so soon that nothing can have shown it. `after` is its duration.
/// `None` on systems other than Linux, and if `path` has zenity, which shows the dialog without a desktop portal.
fn lacking(after: Duration, path: &OsStr) -> Option<String> {
    let has_zenity = || env::split_paths(path).any(|folder| folder.join("zenity").is_file());
    let is_lacking = cfg!(target_os = "linux") && after < SHOWN && !has_zenity();
    is_lacking.then(|| {
        "expected xdg-desktop-portal or zenity, which show the file dialog, found neither; drop the file on the window, \
         or name it on the command line"
            .to_owned()
    })
}

/// Lists the extensions of the files that [`Viewer::open_in`](crate::view::viewer::Viewer::open_in) opens.
fn openable() -> Vec<&'static str> {
    let scenes = SceneFormat::ALL.into_iter().flat_map(SceneFormat::extensions).copied();
    // `ply` covers `compressed.ply`; not every system accepts a dot here.
    scenes.filter(|extension| !extension.contains('.')).chain(["ron", "json"]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn a_dialog_that_ends_at_once_is_lacking_unless_a_program_shows_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().as_os_str();
        let error = lacking(Duration::from_millis(20), path).expect("no dialog");
        assert!(error.contains("drop the file on the window"), "{error}");
        assert_eq!(lacking(Duration::from_secs(2), path), None, "the user cancelled");
        std::fs::write(folder.path().join("zenity"), "").expect("writable");
        assert_eq!(lacking(Duration::from_millis(20), path), None);
    }

    #[test]
    fn the_dialog_offers_every_file_that_the_viewer_opens() {
        let found = openable();
        for wanted in ["ply", "spz", "ksplat", "sog", "rad", "usdz", "glb", "gltf", "ron", "json"] {
            assert!(found.contains(&wanted), "{wanted} is not in {found:?}");
        }
        let is_known =
            |extension: &&str| SceneFormat::of_name(Path::new(&format!("a.{extension}"))).is_some();
        assert!(found.iter().all(|extension| ["ron", "json"].contains(extension) || is_known(extension)));
    }
}
