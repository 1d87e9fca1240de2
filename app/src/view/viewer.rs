//! Implements the viewer without a window.
//!
//! A [`Viewer`] has a scene, a camera, and one or two viewports: A, and B for comparison. [`Viewer::frame`] takes the results of
//! other threads (plans, scenes, comparisons) and draws both pictures. Windows and tests drive it alike; results are reported
//! as [`Event`]s.

use super::events::{Event, RendererId};
use super::navigation::{self, Navigation};
use super::opening::{Content, Opened, Opening};
use super::paint::Mode;
use super::profile::zone;
use super::renderer::{PlanInputs, Renderer, Wake};
use super::viewport::Viewport;
use crate::facts;
use crate::metrics;
use crate::session::image_of;
use glam::DVec3;
use indexmap::IndexMap;
use splatgraph_api::{BackendError, Device, Picture, Running};
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::ir::Catalog;
use splatgraph_framework::reload::WatchError;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

pub use super::opening::cameras_of;

/// An error of opening the viewer.
#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    /// The device failed.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// Files cannot be watched.
    #[error(transparent)]
    Watch(#[from] WatchError),
    /// The device is lost, and not opened again yet.
    #[error("the device is lost")]
    NoDevice,
}

/// The progress of a comparison of both pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Comparing {
    No,
    /// The pictures are read back.
    Reading,
    /// Another thread computes the differences.
    Computing,
}

/// A scene, a camera and one or two viewports; see the module's documentation.
pub struct Viewer<D: Device> {
    scene: Arc<Scene>,
    scene_path: PathBuf,
    catalog: Arc<Catalog>,
    /// Selectable cameras, in the scene's coordinates.
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
    /// Size of the picture that the last frame asked for, in pixels.
    asked: (u32, u32),
    opening: Opening,
    /// Number of the request of the cameras, if they were opened by themselves.
    cameras_number: u64,
    comparing: Comparing,
    compared: (Sender<Compared>, Receiver<Compared>),
    events: Vec<Event>,
    wake: Wake,
}

/// The event of a comparison, or the reason that there is none.
type Compared = Result<Event, String>;

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
            asked: (0, 0),
            opening: Opening::new(wake.clone()),
            cameras_number: 0,
            comparing: Comparing::No,
            compared: channel(),
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
        self.opening.scene()
    }

    /// Returns a viewport; `None` for the window, and for B before the first comparison.
    pub fn viewport(&mut self, id: RendererId) -> Option<&mut Viewport<D>> {
        match id {
            RendererId::A => Some(&mut self.a),
            RendererId::B => self.b.as_mut(),
            RendererId::Window => None,
        }
    }

    /// Returns true while anything is being built, loaded or compared, or may have to be built with more room.
    pub fn busy(&self) -> bool {
        let busy = |viewport: &Viewport<D>| viewport.renderer.busy() || viewport.renderer.may_grow();
        let b = self.b.as_ref().is_some_and(|b| self.compare != Mode::A && busy(b));
        busy(&self.a) || b || self.opening.busy() || self.comparing != Comparing::No
    }

    /// Shows A alone, or both. B starts as a copy of A.
    ///
    /// # Errors
    /// B cannot be created; A then stays alone.
    pub fn set_compare(&mut self, compare: Mode) -> Result<(), ViewerError> {
        if compare != Mode::A && self.b.is_none() {
            let a = &self.a.renderer;
            let device = match a.device() {
                Some(device) => device.new_context()?,
                None => return Err(ViewerError::NoDevice),
            };
            let set: Vec<_> = a.set().iter().map(|(name, value)| (name.clone(), value.clone())).collect();
            let mut b = Renderer::new(device, a.graph(), &set, self.wake.clone())?;
            b.patience = a.patience;
            self.b = Some(Viewport::new(b));
        }
        self.compare = compare;
        Ok(())
    }

    /// Does the same, and reports an error as an event.
    pub fn choose_compare(&mut self, compare: Mode) {
        if let Err(error) = self.set_compare(compare) {
            self.events.push(Event::Problem { text: format!("B cannot be shown: {error}") });
        }
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

    /// Loads a scene on another thread; the former stays until then. Of several, the last is shown.
    pub fn open_scene(&mut self, path: &Path) {
        if let Err(error) = self.opening.open_scene(path) {
            self.events.push(Event::SceneFailed { path: path.to_owned(), error });
        }
    }

    /// Loads cameras on another thread and selects the first.
    pub fn open_cameras(&mut self, path: &Path) {
        if let Err(error) = self.opening.open_cameras(path) {
            self.events.push(Event::FileFailed { path: path.to_owned(), error });
        }
    }

    fn take_cameras(&mut self, path: PathBuf, cameras: Result<Vec<Camera>, String>) {
        match cameras {
            Ok(cameras) => {
                self.events.push(Event::Cameras { path, count: cameras.len() });
                let offset = self.scene.offset();
                self.set_cameras(cameras.iter().map(|camera| camera.relative_to(offset)).collect());
            }
            Err(error) => self.events.push(Event::FileFailed { path, error }),
        }
    }

    /// Replaces the cameras by ones in the scene's coordinates, and selects the first. Their mean direction up becomes the viewer's.
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
        if let (Some(b), Comparing::No) = (&mut self.b, self.comparing) {
            self.comparing = Comparing::Reading;
            self.a.want_picture();
            b.want_picture();
        }
    }

    /// Takes finished results and draws. `size` is the view's, in pixels of the window.
    ///
    /// Errors are the renderers': see [`Renderer::problem`] and [`Viewer::lost`].
    pub fn frame(&mut self, size: (u32, u32)) {
        zone!("pictures");
        while let Some(opened) = self.opening.take() {
            self.take(opened);
        }
        while let Ok(compared) = self.compared.1.try_recv() {
            self.comparing = Comparing::No;
            match compared {
                Ok(event) => self.events.push(event),
                Err(error) => self.cannot_compare(&error),
            }
        }
        let now = Instant::now();
        let scaled = |length: u32| match length {
            0 => 0,
            _ => ((length as f32 * self.scale).round() as u32).max(1),
        };
        let size = (scaled(size.0), scaled(size.1));
        self.asked = size;
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
            viewport.renderer.poll(&inputs, now);
            viewport.draw(&self.scene, &camera, self.background);
            let events = viewport.renderer.take_events();
            self.events.extend(events.into_iter().map(|event| Event::of(id, event)));
        }
        self.compare_pictures();
    }

    /// Returns the error that ended the device, if any did.
    pub fn lost(&self) -> Option<&BackendError> {
        self.a.renderer.lost().or_else(|| self.b.as_ref()?.renderer.lost())
    }

    /// Drops the device and all that is on it. The scene stays in the memory of the host.
    pub fn release(&mut self) {
        for viewport in [Some(&mut self.a), self.b.as_mut()].into_iter().flatten() {
            viewport.renderer.release();
            viewport.collect();
        }
    }

    /// Builds nothing before a change; see [`Renderer::hold`].
    pub fn hold(&mut self, loss: &str) {
        for viewport in [Some(&mut self.a), self.b.as_mut()].into_iter().flatten() {
            viewport.renderer.hold(loss);
        }
    }

    /// Returns true if nothing of the dropped device is in use by a build.
    pub fn is_released(&mut self) -> bool {
        let b = self.b.as_mut().is_none_or(|b| b.renderer.is_released());
        self.a.renderer.is_released() && b
    }

    /// Continues on another device.
    ///
    /// # Errors
    /// Of B: it is not shown then.
    pub fn give(&mut self, device: D) -> Result<(), BackendError> {
        let b = self.b.as_ref().map(|_| device.new_context()).transpose();
        self.a.renderer.give(device);
        match (&mut self.b, b) {
            (Some(viewport), Ok(Some(device))) => viewport.renderer.give(device),
            (_, Ok(_)) => {}
            (_, Err(error)) => {
                (self.b, self.compare) = (None, Mode::A);
                return Err(error);
            }
        }
        Ok(())
    }

    /// Returns true if the view of the last frame had no pixels.
    pub fn is_empty(&self) -> bool {
        self.asked.0 == 0 || self.asked.1 == 0
    }

    /// Returns the newest pictures.
    pub fn pictures(&self) -> [Option<Picture>; 2] {
        let of = |viewport: &Viewport<D>| viewport.renderer.device().and_then(Device::picture);
        let b = self.b.as_ref().filter(|_| self.compare != Mode::A);
        [of(&self.a), b.and_then(of)]
    }

    /// Takes the events since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Returns A's device, after everything else is closed; `None` if it is lost.
    pub fn into_device(self) -> Option<D> {
        let Viewer { a, b, .. } = self;
        drop(b);
        a.renderer.into_device()
    }

    /// Waits for the frames in flight.
    ///
    /// # Errors
    /// As [`Renderer::finish`].
    pub fn finish(&mut self, within: Duration) -> Result<(), BackendError> {
        for viewport in [Some(&mut self.a), self.b.as_mut()].into_iter().flatten() {
            viewport.renderer.finish(within)?;
            viewport.collect();
        }
        Ok(())
    }

    /// Returns true if no build is running.
    pub(super) fn is_idle(&self) -> bool {
        self.a.renderer.is_idle() && self.b.as_ref().is_none_or(|b| b.renderer.is_idle())
    }

    /// Returns what the device has worked on for longer than the patience.
    pub fn stalled(&self) -> Option<&Running> {
        self.a.renderer.stalled().or_else(|| self.b.as_ref()?.renderer.stalled())
    }

    fn take(&mut self, opened: Opened) {
        let Opened { path, load_ms, number, content } = opened;
        match content {
            Content::Scene(Ok(scene), cameras) => {
                let splats = scene.count();
                self.events.push(Event::Scene { path: path.clone(), splats, load_ms });
                self.catalog = Arc::new(facts::catalog(&scene));
                self.navigation = at_start(&scene);
                // From the coordinates of the former scene into those of this one.
                let moved = DVec3::from(scene.offset()) - DVec3::from(self.scene.offset());
                self.scene = Arc::new(*scene);
                self.scene_path = path;
                // Cameras that were opened after the scene stay.
                if self.cameras_number > number {
                    let cameras = std::mem::take(&mut self.cameras);
                    self.set_cameras(cameras.iter().map(|c| c.relative_to(moved.into())).collect());
                } else {
                    self.set_cameras(Vec::new());
                    if let Some((file, cameras)) = cameras {
                        self.take_cameras(file, cameras);
                    }
                }
            }
            Content::Scene(Err(error), _) => self.events.push(Event::SceneFailed { path, error }),
            Content::Cameras(cameras) => {
                self.cameras_number = number;
                self.take_cameras(path, cameras);
            }
        }
    }

    fn cannot_compare(&mut self, why: &str) {
        self.comparing = Comparing::No;
        self.events.push(Event::Problem { text: format!("A and B cannot be compared: {why}") });
    }

    /// Compares both pictures of [`Viewer::measure`] on another thread, once they are read back.
    fn compare_pictures(&mut self) {
        if self.comparing != Comparing::Reading {
            return;
        }
        let pictures = match self.b.as_mut().filter(|_| self.compare != Mode::A) {
            None => Err("B is not shown".to_owned()),
            Some(b) if self.a.has_picture() && b.has_picture() => {
                let (Some(a), Some(b)) = (self.a.take_picture(), b.take_picture()) else { return };
                a.and_then(|a| Ok((a, b?)))
            }
            // A picture that cannot be drawn is not waited for.
            Some(b) => match [&self.a, b].into_iter().find_map(|viewport| viewport.renderer.problem(false)) {
                Some(problem) => Err(problem.lines().next().unwrap_or_default().to_owned()),
                None => return,
            },
        };
        let (a, b) = match pictures {
            Ok(pictures) => pictures,
            Err(why) => {
                for viewport in [Some(&mut self.a), self.b.as_mut()].into_iter().flatten() {
                    viewport.forget_picture();
                }
                return self.cannot_compare(&why);
            }
        };
        self.comparing = Comparing::Computing;
        let (done, wake) = (self.compared.0.clone(), self.wake.clone());
        let work = move || {
            let compare = || {
                let image = |pixels| image_of(pixels).ok_or("the output has no colours");
                let (a, b) = (image(&a)?.clamped(), image(&b)?.clamped());
                let found = metrics::compare(&a, &b).map_err(|error| error.to_string())?;
                Ok(Event::Compared { psnr: found.psnr(), ssim: found.ssim, worst: found.worst.difference })
            };
            let _ = done.send(compare().map_err(|error: String| error));
            wake();
        };
        if let Err(error) = std::thread::Builder::new().name("compare".to_owned()).spawn(work) {
            self.cannot_compare(&format!("no thread can be started: {error}"));
        }
    }
}

/// Makes the first view of a scene without cameras.
fn at_start(scene: &Scene) -> Navigation {
    let (width, height) = facts::DEFAULT_SIZE;
    let camera = Camera::framing(scene, width, height);
    Navigation::new(&scene.robust_bounds(), &camera, navigation::DEFAULT_UP)
}
