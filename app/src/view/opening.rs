//! Reads scenes and cameras on other threads.
//!
//! A request cancels the previous one for the same viewport or [`CameraRole`], so that a slow file never replaces one
//! that was opened later. A cancelled load of a scene ends at its next report of progress; only then does the next one
//! begin.

use super::events::RendererId;
use super::latest::Latest;
use super::renderer::Wake;
use crate::draw::camera;
use crate::io::load::LoadOptions;
use splatgraph_assets::{Camera, Scene, scene_paths};
use splatgraph_framework::reload::{Content, Wanted};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// The result of reading a file.
pub struct Opened<T> {
    /// Path of the file.
    pub path: PathBuf,
    /// Sequence number of the request, from 1.
    pub number: u64,
    /// Content of the file, or the error of reading it.
    pub content: Result<T, String>,
}

/// Path of the camera file beside a scene, and its cameras or the error of reading the file.
pub type CamerasBeside = (PathBuf, Result<Vec<Camera>, String>);

/// A scene, with the cameras beside it.
pub struct OpenedScene {
    /// The scene.
    pub scene: Arc<Scene>,
    /// The cameras beside the scene; `None` if there is no such file.
    pub cameras: Option<CamerasBeside>,
    /// Loading time of the scene and the cameras, in milliseconds.
    pub load_ms: f64,
}

/// Stamps of a scene's files from before they were read, and the scene or its error. After an error, the files include
/// those of an earlier load.
pub type ReadScene = (Vec<Wanted>, Result<OpenedScene, String>);

/// Use of a file's cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraRole {
    /// Selectable cameras of the scene.
    Selectable,
    /// Saved views.
    Views,
    /// Keys of the camera path.
    Path,
}

/// Reader of one kind of content, with its newest request.
struct Slot<T> {
    reader: Latest<T>,
    number: u64,
    path: PathBuf,
}

impl<T: Send + 'static> Slot<T> {
    fn new(wake: &Wake) -> Slot<T> {
        Slot { reader: Latest::new("read", wake.clone()), number: 0, path: PathBuf::new() }
    }

    fn start(
        &mut self,
        number: u64,
        path: &Path,
        read: impl FnOnce(&Path, &(dyn Fn() -> bool + Sync)) -> Result<T, String> + Send + 'static,
    ) -> Result<(), String> {
        // The previous file must not appear after a later one was requested, even if the later request fails.
        self.reader.cancel();
        (self.number, self.path) = (number, path.to_owned());
        let path = path.to_owned();
        self.reader.start(move |is_cancelled| Some(read(&path, is_cancelled)))
    }

    fn take(&mut self) -> Option<Opened<T>> {
        let content = self.reader.take()?;
        Some(Opened { path: self.path.clone(), number: self.number, content })
    }
}

/// Reader of files on other threads, with its requests in progress.
pub struct Opening {
    /// Options for loading scenes.
    pub load: LoadOptions,
    /// Number of the newest request.
    newest: u64,
    /// Readers of the scenes of A and B.
    scenes: [Slot<ReadScene>; 2],
    /// Readers of camera files, indexed by [`CameraRole`].
    cameras: [Slot<Vec<Camera>>; 3],
}

impl Opening {
    /// Creates a reader that calls `wake` whenever a file has been read or has failed.
    pub fn new(wake: &Wake) -> Opening {
        Opening {
            load: LoadOptions::default(),
            newest: 0,
            scenes: std::array::from_fn(|_| Slot::new(wake)),
            cameras: std::array::from_fn(|_| Slot::new(wake)),
        }
    }

    /// Returns the path of the scene requested for a viewport, until its result is taken; `None` without a request.
    pub fn scene(&self, id: RendererId) -> Option<&Path> {
        let slot = &self.scenes[index(id)];
        slot.reader.busy().then_some(&slot.path)
    }

    /// Returns true while a file is being read, and until its result is taken.
    pub fn busy(&self) -> bool {
        self.scenes.iter().any(|slot| slot.reader.busy())
            || self.cameras.iter().any(|slot| slot.reader.busy())
    }

    /// Cancels reading of a viewport's scene, or drops the scene that was read.
    pub fn cancel_scene(&mut self, id: RendererId) {
        self.scenes[index(id)].reader.cancel();
    }

    /// Starts to read a scene for a viewport, with the cameras beside it, if any.
    ///
    /// Cancels the viewport's previous request and drops its result. [`Opening::take_scene`] returns the scene or the
    /// file's error. `former` lists the files of an earlier load: a scene that fails may be half written, and not name
    /// all of its files.
    ///
    /// # Errors
    /// The system cannot start a thread. The previous request is cancelled even then.
    pub fn open_scene(&mut self, id: RendererId, path: &Path, former: Vec<PathBuf>) -> Result<(), String> {
        self.newest += 1;
        let load = self.load.clone();
        self.scenes[index(id)].start(self.newest, path, move |path, is_cancelled| {
            let (begun, mut files) = (Instant::now(), files(path));
            let named = files.len();
            let is_unnamed = |former: &PathBuf| files.iter().all(|file| file.path != *former);
            let unnamed: Vec<Wanted> = former.into_iter().filter(is_unnamed).map(stamped).collect();
            files.extend(unnamed);
            let progress =
                |_, _| if is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
            let opened = load.scene(path, &progress).map_err(|error| error.to_string()).map(|scene| {
                // Computed here rather than on the frame's thread; the scene caches both.
                scene.identity();
                scene.robust_bounds();
                let cameras = camera::beside(path).map(|file| (file.clone(), load_cameras(&file)));
                let load_ms = begun.elapsed().as_secs_f64() * 1e3;
                OpenedScene { scene: Arc::new(scene), cameras, load_ms }
            });
            if opened.is_ok() {
                files.truncate(named);
            }
            Ok((files, opened))
        })
    }

    /// Starts to read cameras, which [`Opening::take_cameras`] returns. Cancels the previous request for the same role.
    ///
    /// # Errors
    /// The system cannot start a thread. The previous request is cancelled even then.
    pub fn open_cameras(&mut self, role: CameraRole, path: &Path) -> Result<(), String> {
        self.newest += 1;
        self.cameras[role as usize].start(self.newest, path, |path, _| load_cameras(path))
    }

    /// Exchanges the loads of scenes for A and B.
    pub fn exchange_scenes(&mut self) {
        self.scenes.swap(0, 1);
    }

    /// Takes the result of reading cameras, in world coordinates; `None` if none is ready. Results of cancelled
    /// requests are dropped.
    pub fn take_cameras(&mut self) -> Option<(CameraRole, Opened<Vec<Camera>>)> {
        use CameraRole::{Path, Selectable, Views};
        let mut slots = [Selectable, Views, Path].into_iter().zip(&mut self.cameras);
        slots.find_map(|(role, slot)| Some((role, slot.take()?)))
    }

    /// Takes the scene that was requested for a viewport, once it is read. The error is that of a load that panicked.
    pub fn take_scene(&mut self, id: RendererId) -> Option<Opened<ReadScene>> {
        self.scenes[index(id)].take()
    }
}

/// Lists the paths that decide what the scene at `path` contains ([`scene_paths`]), with stamps of the files' metadata.
pub fn files(path: &Path) -> Vec<Wanted> {
    scene_paths(path).into_iter().map(stamped).collect()
}

fn stamped(path: PathBuf) -> Wanted {
    Wanted { content: Content::stamp(&path), path }
}

/// Returns the index of a viewport's scene. The window has no scene, so it maps to A.
pub(super) fn index(id: RendererId) -> usize {
    usize::from(id == RendererId::B)
}

fn load_cameras(path: &Path) -> Result<Vec<Camera>, String> {
    match Camera::load(path) {
        Ok(cameras) if cameras.is_empty() => Err("expected at least one camera, found none".to_owned()),
        Ok(cameras) => Ok(cameras),
        Err(error) => Err(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;
    use std::time::Duration;

    fn waited<T>(mut take: impl FnMut() -> Option<T>) -> T {
        let begun = Instant::now();
        loop {
            if let Some(opened) = take() {
                return opened;
            }
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing is opened");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    #[test]
    fn of_two_scenes_the_last_is_opened_also_if_the_first_takes_longer() {
        let folder = tempfile::tempdir().unwrap();
        let (slow, fast) = (folder.path().join("slow.ply"), folder.path().join("fast.ply"));
        synth::generate("demo", 200_000, 0).unwrap().write_ply(&slow).unwrap();
        synth::generate("demo", 100, 0).unwrap().write_ply(&fast).unwrap();
        let mut opening = Opening::new(&(Arc::new(|| {}) as Wake));
        opening.open_scene(RendererId::A, &slow, Vec::new()).unwrap();
        opening.open_scene(RendererId::A, &fast, Vec::new()).unwrap();
        assert_eq!(opening.scene(RendererId::A), Some(fast.as_path()));
        let opened = waited(|| opening.take_scene(RendererId::A));
        assert_eq!(opened.path, fast);
        let Ok((_, Ok(OpenedScene { scene, cameras: None, .. }))) = opened.content else {
            panic!("{} is no scene without cameras", fast.display());
        };
        assert_eq!(scene.count(), 100);
        assert!(!opening.busy());
        // The slow scene does not arrive later either.
        std::thread::sleep(Duration::from_millis(300));
        assert!(opening.take_scene(RendererId::A).is_none());
    }

    #[test]
    fn folders_pipes_and_devices_are_refused_and_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe.ply");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let mut opening = Opening::new(&(Arc::new(|| {}) as Wake));
        for (path, expected) in [
            (folder.path().to_owned(), "folder"),
            (pipe, "FIFO"),
            (PathBuf::from("/dev/zero"), "device"),
            (folder.path().join("nothing.ply"), "No such file"),
        ] {
            opening.open_scene(RendererId::A, &path, Vec::new()).unwrap();
            let Ok((_, Err(error))) = waited(|| opening.take_scene(RendererId::A)).content else {
                panic!("{} is a scene", path.display());
            };
            assert!(error.contains(expected), "{error}");
            // A folder is searched for cameras before it is rejected.
            let expected = if path.is_dir() { "found none of them" } else { expected };
            opening.open_cameras(CameraRole::Selectable, &path).unwrap();
            let error = waited(|| opening.take_cameras()).1.content.expect_err("no cameras");
            assert!(error.contains(expected), "{error}");
        }
    }
}
