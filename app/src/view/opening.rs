//! Reads scenes and cameras on other threads.
//!
//! A request cancels the previous one of its kind, so that a slow file never replaces one that was opened later. A
//! cancelled load of a scene ends at its next report of progress.

use super::events::RendererId;
use super::renderer::Wake;
use crate::draw::camera;
use crate::io::load::LoadOptions;
use splatgraph_assets::{Camera, Scene};
use std::any::Any;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Instant;

/// The result of reading a file.
pub struct Opened {
    /// Path of the file.
    pub path: PathBuf,
    /// Loading time, in milliseconds.
    pub load_ms: f64,
    /// Sequence number of the request, from 1.
    pub number: u64,
    /// Content of the file, or the error of reading it.
    pub content: Content,
}

/// The content of a file.
pub enum Content {
    /// A scene for a viewport; and the cameras beside it, with the path of their file. There are no cameras if none
    /// were found, or if the scene could not be read.
    Scene(RendererId, Result<Box<Scene>, String>, Option<(PathBuf, Result<Vec<Camera>, String>)>),
    /// Cameras, in the world's coordinates.
    Cameras(CameraRole, Result<Vec<Camera>, String>),
}

/// Use of a file's cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraRole {
    /// Selectable cameras of the scene.
    Selectable,
    /// Saved views.
    Views,
    /// Keys of a path.
    Path,
}

/// A file that is being read. Dropping it cancels the read.
struct Request {
    number: u64,
    path: PathBuf,
    cancelled: Arc<AtomicBool>,
}

impl Drop for Request {
    fn drop(&mut self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }
}

/// Reader of files on other threads, with its requests in progress.
pub struct Opening {
    /// Options of loading scenes.
    pub load: LoadOptions,
    next: u64,
    /// Requests for the scenes of A and B.
    scenes: [Option<Request>; 2],
    /// Requests for cameras, by [`CameraRole`].
    cameras: [Option<Request>; 3],
    finished: (Sender<Opened>, Receiver<Opened>),
    wake: Wake,
}

impl Opening {
    /// Creates a reader that calls `wake` whenever a file has been read or has failed.
    pub fn new(wake: Wake) -> Opening {
        Opening {
            load: LoadOptions::default(),
            next: 1,
            scenes: [const { None }; 2],
            cameras: [const { None }; 3],
            finished: channel(),
            wake,
        }
    }

    /// Returns the path of the scene that is being read for a viewport.
    pub fn scene(&self, id: RendererId) -> Option<&Path> {
        self.scenes[index(id)].as_ref().map(|request| request.path.as_path())
    }

    /// Returns true while a file is being read.
    pub fn busy(&self) -> bool {
        self.scenes.iter().chain(&self.cameras).any(Option::is_some)
    }

    /// Cancels reading of a viewport's scene.
    pub fn cancel_scene(&mut self, id: RendererId) {
        self.scenes[index(id)] = None;
    }

    /// Reads a scene for a viewport, and the cameras beside it, if any; cancels the viewport's previous request.
    ///
    /// # Errors
    /// The system cannot start a thread.
    pub fn open_scene(&mut self, id: RendererId, path: &Path) -> Result<(), String> {
        self.scenes[index(id)] = None;
        let failed = move |error| Content::Scene(id, Err(error), None);
        let load = self.load;
        let request = self.start(path, failed, move |path, cancelled| {
            let progress = |_, _| match cancelled.load(Ordering::Relaxed) {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            };
            let scene = load.scene(path, &progress).map(Box::new).map_err(|error| error.to_string());
            if let Ok(scene) = &scene {
                // Computed here rather than on the frame's thread; the scene caches it.
                scene.identity();
            }
            let cameras = scene.as_ref().ok().and_then(|_| camera::beside(path));
            Content::Scene(id, scene, cameras.map(|file| (file.clone(), load_cameras(&file))))
        })?;
        self.scenes[index(id)] = Some(request);
        Ok(())
    }

    /// Reads cameras; cancels the previous request for the same role.
    ///
    /// # Errors
    /// The system cannot start a thread.
    pub fn open_cameras(&mut self, role: CameraRole, path: &Path) -> Result<(), String> {
        self.cameras[role as usize] = None;
        let read = move |path: &Path, _: &AtomicBool| Content::Cameras(role, load_cameras(path));
        let failed = move |error| Content::Cameras(role, Err(error));
        self.cameras[role as usize] = Some(self.start(path, failed, read)?);
        Ok(())
    }

    /// Restarts the loads in progress for the opposite viewports, after A and B were exchanged.
    ///
    /// # Errors
    /// The system cannot start a thread.
    pub fn exchange_scenes(&mut self) -> Result<(), String> {
        let paths = [RendererId::A, RendererId::B].map(|id| (id, self.scene(id).map(Path::to_owned)));
        for (id, path) in paths {
            let other = if id == RendererId::A { RendererId::B } else { RendererId::A };
            match path {
                Some(path) => self.open_scene(other, &path)?,
                None => self.cancel_scene(other),
            }
        }
        Ok(())
    }

    /// Takes the next result; `None` if there is none. Results of cancelled requests are dropped.
    pub fn take(&mut self) -> Option<Opened> {
        loop {
            let opened = self.finished.1.try_recv().ok()?;
            for request in self.scenes.iter_mut().chain(&mut self.cameras) {
                if request.as_ref().is_some_and(|request| request.number == opened.number) {
                    *request = None;
                    return Some(opened);
                }
            }
        }
    }

    /// Reads a file on another thread. If `read` panics, `failed` converts the panic's message to content.
    fn start(
        &mut self,
        path: &Path,
        failed: impl FnOnce(String) -> Content + Send + 'static,
        read: impl FnOnce(&Path, &AtomicBool) -> Content + Send + 'static,
    ) -> Result<Request, String> {
        let (number, cancelled) = (self.next, Arc::new(AtomicBool::new(false)));
        self.next += 1;
        let request = Request { number, path: path.to_owned(), cancelled: cancelled.clone() };
        let (path, done, wake) = (path.to_owned(), self.finished.0.clone(), self.wake.clone());
        let work = move || {
            let begun = Instant::now();
            // A panic is a bug in the reader, but must not end the program.
            let content = catch_unwind(AssertUnwindSafe(|| read(&path, &cancelled)));
            if cancelled.load(Ordering::Relaxed) {
                return;
            }
            let content =
                content.unwrap_or_else(|payload| failed(format!("internal error: {}", message(&*payload))));
            let load_ms = begun.elapsed().as_secs_f64() * 1e3;
            // If the viewer was closed meanwhile, the receiver is gone and the send fails.
            let _ = done.send(Opened { path, load_ms, number, content });
            wake();
        };
        let thread = std::thread::Builder::new().name("open".to_owned()).spawn(work);
        thread.map(|_| request).map_err(|error| format!("no thread can be started to read it: {error}"))
    }
}

/// Returns the index of a viewport's scene. The window has no scene, so it maps to A.
pub(super) fn index(id: RendererId) -> usize {
    usize::from(id == RendererId::B)
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<String>().map(String::as_str);
    text.or(payload.downcast_ref::<&str>().copied()).unwrap_or("a panic without a message").to_owned()
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

    fn waited(opening: &mut Opening) -> Opened {
        let begun = Instant::now();
        loop {
            if let Some(opened) = opening.take() {
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
        let mut opening = Opening::new(Arc::new(|| {}));
        opening.open_scene(RendererId::A, &slow).unwrap();
        opening.open_scene(RendererId::A, &fast).unwrap();
        assert_eq!(opening.scene(RendererId::A), Some(fast.as_path()));
        let opened = waited(&mut opening);
        assert_eq!(opened.path, fast);
        assert!(matches!(opened.content, Content::Scene(_, Ok(scene), None) if scene.count() == 100));
        assert!(!opening.busy());
        // The slow scene does not arrive later either.
        std::thread::sleep(Duration::from_millis(300));
        assert!(opening.take().is_none());
    }

    #[test]
    fn folders_pipes_and_devices_are_refused_and_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe.ply");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let mut opening = Opening::new(Arc::new(|| {}));
        for (path, expected) in [
            (folder.path().to_owned(), "folder"),
            (pipe, "FIFO"),
            (PathBuf::from("/dev/zero"), "device"),
            (folder.path().join("nothing.ply"), "No such file"),
        ] {
            opening.open_scene(RendererId::A, &path).unwrap();
            let Content::Scene(_, Err(error), None) = waited(&mut opening).content else {
                panic!("{} is a scene", path.display());
            };
            assert!(error.contains(expected), "{error}");
            // A folder is searched for cameras before it is rejected.
            let expected = if path.is_dir() { "found none of them" } else { expected };
            opening.open_cameras(CameraRole::Selectable, &path).unwrap();
            let Content::Cameras(CameraRole::Selectable, Err(error)) = waited(&mut opening).content else {
                panic!("{} has cameras", path.display());
            };
            assert!(error.contains(expected), "{error}");
        }
    }
}
