//! Implements the viewer without a window.
//!
//! A [`Viewer`] has a scene, a camera, and one or two viewports: A, and B for comparison. [`Viewer::frame`] takes the results of
//! other threads (plans, scenes, comparisons) and draws both pictures. Windows and tests drive it alike; results are reported
//! as [`Event`]s.

use super::events::{Event, RendererId};
use super::navigation::{self, Navigation};
use super::paint::Mode;
use super::profile::zone;
use super::renderer::{PlanInputs, Renderer, Wake};
use super::viewport::Viewport;
use crate::facts;
use crate::metrics;
use crate::session::image_of;
use indexmap::IndexMap;
use splatgraph_api::{BackendError, Device, Picture};
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::ir::Catalog;
use splatgraph_framework::reload::WatchError;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Instant;

/// An error of opening the viewer.
#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    /// The device failed.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// Files cannot be watched.
    #[error(transparent)]
    Watch(#[from] WatchError),
}

/// A result of another thread.
enum Finished {
    Scene { path: PathBuf, load_ms: f64, scene: Result<Box<Scene>, String> },
    Compared(Result<Event, String>),
}

/// A scene, a camera and one or two viewports; see the module's documentation.
pub struct Viewer<D: Device> {
    scene: Arc<Scene>,
    scene_path: PathBuf,
    catalog: Arc<Catalog>,
    /// Selectable cameras.
    pub cameras: Vec<Camera>,
    /// Index of the camera that was selected last.
    pub camera: Option<usize>,
    /// Position of the camera.
    pub navigation: Navigation,
    /// The viewport of the picture, or of its left part.
    pub a: Viewport<D>,
    /// The viewport for comparison. It keeps its parameters while it is hidden.
    pub b: Option<Viewport<D>>,
    /// The comparison.
    pub compare: Mode,
    /// Position of the split line, as a share of the width.
    pub split: f32,
    /// Amplification of the difference.
    pub gain: f32,
    /// Background colour, display-encoded.
    pub background: [f32; 3],
    /// Pixels of the picture per pixel of the window, across and down.
    pub scale: f32,
    loading: Option<PathBuf>,
    comparing: bool,
    finished: (Sender<Finished>, Receiver<Finished>),
    events: Vec<Event>,
    wake: Wake,
}

impl<D: Device> Viewer<D> {
    /// Creates a viewer of `scene`, loaded from `path`, with `graph` and the parameters in `set`.
    pub fn new(
        device: D,
        (scene, path): (Scene, PathBuf),
        graph: &str,
        set: &[(String, String)],
        wake: Wake,
    ) -> Result<Viewer<D>, ViewerError> {
        let navigation = at_start(&scene);
        let catalog = Arc::new(facts::catalog(&scene));
        let renderer = Renderer::new(device, graph, set, wake.clone())?;
        Ok(Viewer {
            scene: Arc::new(scene),
            scene_path: path,
            catalog,
            cameras: Vec::new(),
            camera: None,
            navigation,
            a: Viewport::new(renderer),
            b: None,
            compare: Mode::A,
            split: 0.5,
            gain: 8.0,
            background: [0.0; 3],
            scale: 1.0,
            loading: None,
            comparing: false,
            finished: channel(),
            events: Vec::new(),
            wake,
        })
    }

    /// Returns the scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns the scene's file.
    pub fn scene_path(&self) -> &Path {
        &self.scene_path
    }

    /// Returns the file that is being loaded.
    pub fn loading(&self) -> Option<&Path> {
        self.loading.as_deref()
    }

    /// Returns a viewport; `None` for the window, and for B before the first comparison.
    pub fn viewport(&mut self, id: RendererId) -> Option<&mut Viewport<D>> {
        match id {
            RendererId::A => Some(&mut self.a),
            RendererId::B => self.b.as_mut(),
            RendererId::Window => None,
        }
    }

    /// Returns true while anything is being built, loaded or compared.
    pub fn busy(&self) -> bool {
        let b = self.b.as_ref().is_some_and(|b| self.compare != Mode::A && b.renderer.busy());
        self.a.renderer.busy() || b || self.loading.is_some() || self.comparing
    }

    /// Shows A alone, or both. B starts as a copy of A.
    pub fn set_compare(&mut self, compare: Mode) -> Result<(), ViewerError> {
        self.compare = compare;
        if compare != Mode::A && self.b.is_none() {
            let a = &self.a.renderer;
            let set: Vec<_> = a.set().iter().map(|(name, value)| (name.clone(), value.clone())).collect();
            let device = a.device().new_context()?;
            self.b = Some(Viewport::new(Renderer::new(device, a.graph(), &set, self.wake.clone())?));
        }
        Ok(())
    }

    /// Exchanges A and B.
    pub fn exchange(&mut self) {
        if let Some(b) = &mut self.b {
            std::mem::swap(&mut self.a, b);
        }
    }

    /// Opens a scene, a graph or cameras, by extension. Scenes are loaded in the background.
    pub fn open(&mut self, path: &Path) {
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        match ending.as_str() {
            "ron" => self.a.renderer.choose(&path.to_string_lossy(), IndexMap::new()),
            "json" => self.open_cameras(path),
            "ply" => self.open_scene(path),
            _ => self.events.push(Event::FileFailed {
                path: path.to_owned(),
                error: "expected a scene (.ply), a graph (.ron) or cameras (.json)".into(),
            }),
        }
    }

    /// Loads a scene on another thread; the former stays until then.
    pub fn open_scene(&mut self, path: &Path) {
        let (path, done, wake) = (path.to_owned(), self.finished.0.clone(), self.wake.clone());
        self.loading = Some(path.clone());
        std::thread::spawn(move || {
            let begun = Instant::now();
            let scene = Scene::load(&path, &|_, _| {}).map_err(|error| error.to_string()).inspect(|scene| {
                // Computed here, off the frame's thread, and cached.
                scene.identity();
            });
            let load_ms = begun.elapsed().as_secs_f64() * 1e3;
            // The viewer may be closed by now.
            let _ = done.send(Finished::Scene { path, load_ms, scene: scene.map(Box::new) });
            wake();
        });
    }

    /// Loads cameras and selects the first.
    pub fn open_cameras(&mut self, path: &Path) {
        match Camera::load(path) {
            Ok(cameras) if cameras.is_empty() => self.events.push(Event::FileFailed {
                path: path.to_owned(),
                error: "expected at least one camera, found none".into(),
            }),
            Ok(cameras) => {
                self.events.push(Event::Cameras { path: path.to_owned(), count: cameras.len() });
                self.set_cameras(cameras);
            }
            Err(error) => {
                self.events.push(Event::FileFailed { path: path.to_owned(), error: error.to_string() });
            }
        }
    }

    /// Replaces the cameras and selects the first. Their mean direction up becomes the viewer's.
    pub fn set_cameras(&mut self, cameras: Vec<Camera>) {
        if let Some(camera) = cameras.first() {
            let up = navigation::mean_up(&cameras).unwrap_or(navigation::DEFAULT_UP);
            self.navigation = Navigation::new(&self.scene.robust_bounds(), camera, up);
        }
        self.camera = if cameras.is_empty() { None } else { Some(0) };
        self.cameras = cameras;
    }

    /// Selects a camera.
    pub fn look_through(&mut self, index: usize) {
        if let Some(camera) = self.cameras.get(index) {
            self.camera = Some(index);
            self.navigation.set_camera(camera);
        }
    }

    /// Compares the next pictures of A and B; the result is an event.
    pub fn measure(&mut self) {
        if let (Some(b), false) = (&mut self.b, self.comparing) {
            self.comparing = true;
            self.a.want_picture();
            b.want_picture();
        }
    }

    /// Takes finished results and draws. `size` is the view's, in pixels of the window.
    pub fn frame(&mut self, size: (u32, u32)) -> Result<(), BackendError> {
        zone!("pictures");
        while let Ok(finished) = self.finished.1.try_recv() {
            self.take(finished);
        }
        let now = Instant::now();
        let scaled = |length: u32| match length {
            0 => 0,
            _ => ((length as f32 * self.scale).round() as u32).max(1),
        };
        let size = (scaled(size.0), scaled(size.1));
        let camera = self.navigation.camera(size.0.max(1), size.1.max(1));
        let shown_b = self.b.as_mut().filter(|_| self.compare != Mode::A);
        let viewports = [Some((RendererId::A, &mut self.a)), shown_b.map(|b| (RendererId::B, b))];
        for (id, viewport) in viewports.into_iter().flatten() {
            let inputs = PlanInputs {
                scene: Some(self.scene.clone()),
                catalog: self.catalog.clone(),
                size,
                share_memory: viewport.inspection.is_none(),
            };
            viewport.renderer.poll(&inputs, now)?;
            viewport.draw(&self.scene, &camera, self.background)?;
            let events = viewport.renderer.take_events();
            self.events.extend(events.into_iter().map(|event| Event::of(id, event)));
        }
        self.compare_pictures();
        Ok(())
    }

    /// Returns the newest pictures.
    pub fn pictures(&self) -> [Option<Picture>; 2] {
        let of = |viewport: &Viewport<D>| viewport.renderer.device().picture();
        let b = self.b.as_ref().filter(|_| self.compare != Mode::A);
        [of(&self.a), b.and_then(of)]
    }

    /// Takes the events since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Returns A's device, after everything else is closed.
    pub fn into_device(self) -> D {
        let Viewer { a, b, .. } = self;
        drop(b);
        a.renderer.into_device()
    }

    /// Waits for the frames in flight.
    pub fn finish(&mut self) -> Result<(), BackendError> {
        for viewport in [Some(&mut self.a), self.b.as_mut()].into_iter().flatten() {
            viewport.renderer.finish()?;
            viewport.collect();
        }
        Ok(())
    }

    fn take(&mut self, finished: Finished) {
        match finished {
            Finished::Scene { path, load_ms, scene } => {
                if self.loading.as_ref() == Some(&path) {
                    self.loading = None;
                }
                match scene {
                    Ok(scene) => {
                        let splats = scene.count();
                        self.events.push(Event::Scene { path: path.clone(), splats, load_ms });
                        self.catalog = Arc::new(facts::catalog(&scene));
                        self.cameras.clear();
                        self.camera = None;
                        self.navigation = at_start(&scene);
                        self.scene = Arc::new(*scene);
                        if let Some(cameras) = cameras_of(&path) {
                            self.open_cameras(&cameras);
                        }
                        self.scene_path = path;
                    }
                    Err(error) => self.events.push(Event::SceneFailed { path, error }),
                }
            }
            Finished::Compared(compared) => {
                self.comparing = false;
                self.events.push(compared.unwrap_or_else(|error| Event::FileFailed {
                    path: self.scene_path.clone(),
                    error: format!("A and B cannot be compared: {error}"),
                }));
            }
        }
    }

    /// Compares both pictures of [`Viewer::measure`] on another thread, once they are read back.
    fn compare_pictures(&mut self) {
        let Some(b) = self.b.as_mut().filter(|_| self.comparing) else { return };
        let (true, true) = (self.a.has_picture(), b.has_picture()) else { return };
        let (Some(a), Some(b)) = (self.a.take_picture(), b.take_picture()) else { return };
        let (done, wake) = (self.finished.0.clone(), self.wake.clone());
        std::thread::spawn(move || {
            let compare = || {
                let image = |pixels| image_of(pixels).ok_or("the output has no colours");
                let (a, b) = (image(&a)?.clamped(), image(&b)?.clamped());
                let found = metrics::compare(&a, &b).map_err(|error| error.to_string())?;
                Ok(Event::Compared { psnr: found.psnr(), ssim: found.ssim, worst: found.worst.difference })
            };
            let _ = done.send(Finished::Compared(compare().map_err(|error: String| error)));
            wake();
        });
    }
}

/// Makes the first view of a scene without cameras.
fn at_start(scene: &Scene) -> Navigation {
    let (width, height) = facts::DEFAULT_SIZE;
    let camera = Camera::framing(scene, width, height);
    Navigation::new(&scene.robust_bounds(), &camera, navigation::DEFAULT_UP)
}

/// Finds the cameras of a scene, as the reference implementation places them.
///
/// They are `NAME.cameras.json`, or `cameras.json` in its folder or, for `point_cloud/iteration_N/point_cloud.ply`, up to three
/// folders above.
pub fn cameras_of(scene: &Path) -> Option<PathBuf> {
    let own = scene.with_extension("cameras.json");
    if own.is_file() {
        return Some(own);
    }
    let folders = scene.parent()?.ancestors().take(if scene.ends_with("point_cloud.ply") { 4 } else { 1 });
    folders.map(|folder| folder.join("cameras.json")).find(|file| file.is_file())
}
