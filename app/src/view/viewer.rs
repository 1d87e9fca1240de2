//! Implements the viewer without a window.
//!
//! A [`Viewer`] has a scene, a camera, and one or two viewports: A, and B for comparison. [`Viewer::frame`] takes the results of
//! other threads (plans, scenes, comparisons) and draws the pictures that are due. Windows and tests drive it alike; results are
//! reported as [`Event`]s.

use super::cameras::{CameraFiles, Views};
use super::events::{Event, RendererId};
use super::navigation::{self, Navigation};
use super::opening::{CameraRole, Content, Opened, Opening};
use super::paint::{Mode, Shown};
use super::picking::Picker;
use super::profile::zone;
use super::renderer::{self, PlanInputs, Renderer, Wake};
use super::viewport::{View, Viewport};
use crate::camera_path::{self, CameraPath, Playback};
use crate::facts;
use crate::metrics;
use crate::pick::Picked;
use crate::session::image_of;
use glam::DVec3;
use indexmap::IndexMap;
use splatgraph_api::{BackendError, Device, Running};
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::ir::Catalog;
use splatgraph_framework::reload::WatchError;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

mod camera;

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

/// The differences between the pictures of A and B.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// PSNR in decibels; infinite for identical pictures.
    pub psnr: f64,
    /// SSIM; `None` for pictures smaller than its window.
    pub ssim: Option<f64>,
    /// Largest difference of a channel, of 1.
    pub worst: f64,
    /// Column and row of that pixel.
    pub at: [usize; 2],
    /// Width and height of the pictures, in pixels.
    pub size: [usize; 2],
}

/// Everything that a comparison depends on.
#[derive(Clone, Debug, PartialEq)]
struct Compared {
    camera: Camera,
    sides: [Option<(String, IndexMap<String, String>)>; 2],
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
    /// The views that were saved.
    pub views: Views,
    /// The path of the camera, in the world's coordinates.
    pub path: CameraPath,
    /// The player of the path.
    pub play: Playback,
    /// The camera that the player showed last.
    played: Option<Camera>,
    camera_files: CameraFiles,
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
    /// True to draw every frame, also while nothing changes.
    pub continuous: bool,
    /// The splats of the pixel that was picked last; see [`Viewer::pick`].
    pub picked: Option<Picked>,
    picker: Picker,
    /// True if the window's device is another one, so that pictures go there through the memory of the host.
    pub(super) to_host: bool,
    /// True to draw no pictures for now.
    pub(super) rests: bool,
    /// Size of the picture that the last frame asked for, in pixels.
    asked: (u32, u32),
    opening: Opening,
    /// Number of the request of the cameras, if they were opened by themselves.
    cameras_number: u64,
    comparing: Comparing,
    compared: (Sender<ComparisonResult>, Receiver<ComparisonResult>),
    /// The newest comparison, with what it was made of.
    comparison: Option<(Comparison, Compared)>,
    /// What the running comparison is made of.
    compares: Option<Compared>,
    events: Vec<Event>,
    wake: Wake,
}

/// A comparison, or the reason that there is none.
type ComparisonResult = Result<Comparison, String>;

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
        let path_of_camera = CameraPath::new(camera_path::length_of_radian(&scene));
        let catalog = Arc::new(facts::catalog(&scene));
        let renderer = Renderer::new(device, graph, set, wake.clone())?;
        Ok(Viewer {
            scene: Arc::new(scene),
            scene_path: path,
            catalog,
            cameras: Vec::new(),
            camera: None,
            navigation,
            views: Views::default(),
            path: path_of_camera,
            play: Playback::default(),
            played: None,
            camera_files: CameraFiles::default(),
            a: Viewport::new(renderer),
            b: None,
            compare: Mode::A,
            split: 0.5,
            gain: 8.0,
            background: [0.0; 3],
            scale: 1.0,
            continuous: false,
            picked: None,
            picker: Picker::new(wake.clone()),
            to_host: false,
            rests: false,
            asked: (0, 0),
            opening: Opening::new(wake.clone()),
            cameras_number: 0,
            comparing: Comparing::No,
            compared: channel(),
            comparison: None,
            compares: None,
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

    /// Returns true while anything is being built, loaded, compared or picked, may have to be built with more room, or is not shown
    /// yet.
    pub fn busy(&self) -> bool {
        let busy = |viewport: &Viewport<D>| {
            viewport.renderer.busy() || viewport.renderer.may_grow() || viewport.is_coming()
        };
        let measures = self.comparing != Comparing::No || self.picker.busy();
        self.shown().any(busy) || self.opening.busy() || measures
    }

    /// Iterates over A, and B if it is shown.
    fn shown(&self) -> impl Iterator<Item = &Viewport<D>> {
        let b = self.b.as_ref().filter(|_| self.compare != Mode::A);
        [Some(&self.a), b].into_iter().flatten()
    }

    /// Returns true if frames are drawn all the time, because that was asked for, or because they differ by themselves.
    pub(super) fn is_animated(&self) -> bool {
        self.continuous || self.shown().any(Viewport::is_animated)
    }

    /// Returns true if a frame is due that the device could not take yet.
    pub(super) fn waits(&self) -> bool {
        self.shown().any(Viewport::waits)
    }

    /// Counts changes of what panels show: see [`Renderer::changes`]; finished frames count, too.
    pub(super) fn changes(&self) -> u64 {
        let of = |viewport: &Viewport<D>| viewport.renderer.changes() + viewport.history.frames();
        of(&self.a) + self.b.as_ref().map_or(0, of)
    }

    /// Returns the time of the next frame that is due although nothing wakes the owner and no frame in flight ends.
    pub(super) fn next(&self) -> Option<Instant> {
        let of = |viewport: &Viewport<D>| {
            let retry = viewport.renderer.retry().filter(|_| viewport.waits());
            [viewport.renderer.next(), retry]
        };
        self.shown().flat_map(of).flatten().min()
    }

    /// Takes the results of finished frames; see [`renderer::collect`].
    pub(super) fn collect(&mut self, patience: Duration) -> bool {
        let both = [Some(&mut self.a), self.b.as_mut()];
        let mut renderers: Vec<_> =
            both.into_iter().flatten().map(|viewport| &mut viewport.renderer).collect();
        let ready = renderer::collect(&mut renderers, patience);
        for viewport in [Some(&mut self.a), self.b.as_mut()].into_iter().flatten() {
            viewport.collect(self.to_host);
        }
        ready
    }

    /// Returns the time of the newest submission in flight.
    pub(super) fn newest(&self) -> Option<Instant> {
        self.a.renderer.newest().max(self.b.as_ref().and_then(|b| b.renderer.newest()))
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
            b.take_room_of(a);
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
        self.open_cameras_as(CameraRole::Selectable, path);
    }

    fn take_cameras(&mut self, role: CameraRole, path: PathBuf, cameras: Result<Vec<Camera>, String>) {
        let count = cameras.as_ref().map_or(0, Vec::len);
        match cameras.and_then(|cameras| self.take_world_cameras(role, cameras)) {
            Ok(()) => self.events.push(Event::Cameras { path, count }),
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

    /// Compares the next pictures of A and B; the result is an event, and [`Viewer::comparison`].
    pub fn measure(&mut self) {
        let compares = self.compares_now();
        if let (Some(b), Comparing::No) = (&mut self.b, self.comparing) {
            self.comparing = Comparing::Reading;
            self.compares = Some(compares);
            self.a.want_picture();
            b.want_picture();
        }
    }

    /// Returns true while pictures are compared.
    pub fn is_comparing(&self) -> bool {
        self.comparing != Comparing::No
    }

    /// Returns the newest comparison of A and B.
    pub fn comparison(&self) -> Option<&Comparison> {
        self.comparison.as_ref().map(|(found, _)| found)
    }

    /// Returns true if the comparison was made of what is shown now.
    pub fn comparison_is_current(&self) -> bool {
        self.comparison.as_ref().is_some_and(|(_, of)| *of == self.compares_now())
    }

    /// Forgets the comparison.
    pub fn forget_comparison(&mut self) {
        self.comparison = None;
    }

    fn compares_now(&self) -> Compared {
        let side =
            |viewport: &Viewport<D>| (viewport.renderer.graph().to_owned(), viewport.renderer.set().clone());
        let camera = self.navigation.camera(self.asked.0.max(1), self.asked.1.max(1));
        Compared { camera, sides: [Some(side(&self.a)), self.b.as_ref().map(side)] }
    }

    /// Looks for the splats at a place of the picture, in its pixels from the top left corner, on another thread.
    ///
    /// They are in [`Viewer::picked`] when a later frame has taken them; the newest request replaces all before it. A place outside
    /// of the picture picks nothing. The rules are those of [`crate::pick`], whatever graph draws.
    pub fn pick(&mut self, at: [f32; 2]) {
        let (width, height) = self.asked;
        let inside = (0.0..width as f32).contains(&at[0]) && (0.0..height as f32).contains(&at[1]);
        if !inside {
            return self.forget_picked();
        }
        let pixel = at.map(|v| v as u32);
        if let Err(error) = self.picker.start(self.scene.clone(), self.picture_camera(), pixel) {
            self.events.push(Event::Problem { text: error });
        }
    }

    /// Returns true while splats are looked for.
    pub fn is_picking(&self) -> bool {
        self.picker.busy()
    }

    /// Drops the picked splats, and cancels the search for others.
    pub fn forget_picked(&mut self) {
        self.picker.cancel();
        self.picked = None;
    }

    /// Takes finished results, and draws the pictures that are due. `size` is the view's, in pixels of the window.
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
                Ok(found) => {
                    let Comparison { psnr, ssim, worst, .. } = found;
                    self.events.push(Event::Compared { psnr, ssim, worst });
                    self.comparison = self.compares.take().map(|of| (found, of));
                }
                Err(error) => self.cannot_compare(&error),
            }
        }
        if let Some(picked) = self.picker.take() {
            self.picked = Some(picked);
        }
        let now = Instant::now();
        let scaled = |length: u32| match length {
            0 => 0,
            _ => ((length as f32 * self.scale).round() as u32).max(1),
        };
        let size = (scaled(size.0), scaled(size.1));
        self.asked = size;
        let camera = self.camera_of(size);
        let ready = self.collect(self.a.renderer.patience);
        let view = View {
            scene: &self.scene,
            camera: &camera,
            background: self.background,
            continuous: self.continuous,
            to_host: self.to_host,
        };
        let shown_b = self.b.as_mut().filter(|_| self.compare != Mode::A);
        let viewports = [Some((RendererId::A, &mut self.a)), shown_b.map(|b| (RendererId::B, b))];
        for (id, viewport) in viewports.into_iter().flatten() {
            let inputs = PlanInputs {
                scene: Some(self.scene.clone()),
                catalog: self.catalog.clone(),
                size,
                share_memory: viewport.inspection.is_none(),
            };
            viewport.renderer.paused = self.rests || !ready;
            viewport.renderer.poll(&inputs, now);
            viewport.draw(&view);
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
            viewport.release();
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

    /// Returns the pictures for the window, each with a number that tells it from all others.
    pub fn pictures(&self) -> [Option<(Shown, u64)>; 2] {
        let b = self.b.as_ref().filter(|_| self.compare != Mode::A);
        [self.a.picture(), b.and_then(Viewport::picture)]
    }

    /// Reports an event of the user interface.
    pub fn report(&mut self, event: Event) {
        self.events.push(event);
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
        if !self.collect(within) {
            let place = self.stalled().map_or_else(String::new, |running| running.place.clone());
            return Err(BackendError::Stuck { place, seconds: within.as_secs() });
        }
        for viewport in [Some(&mut self.a), self.b.as_mut()].into_iter().flatten() {
            viewport.renderer.finish(within)?;
            viewport.collect(self.to_host);
        }
        Ok(())
    }

    /// Returns true if no build is running.
    pub(super) fn is_idle(&self) -> bool {
        self.a.renderer.is_idle() && self.b.as_ref().is_none_or(|b| b.renderer.is_idle())
    }

    /// Returns what the device was working on when a frame was not done at the last look.
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
                self.forget_picked();
                self.path.set_radian(camera_path::length_of_radian(&self.scene));
                self.scene_path = path;
                // Cameras that were opened after the scene stay.
                if self.cameras_number > number {
                    let cameras = std::mem::take(&mut self.cameras);
                    self.set_cameras(cameras.iter().map(|c| c.relative_to(moved.into())).collect());
                } else {
                    self.set_cameras(Vec::new());
                    if let Some((file, cameras)) = cameras {
                        self.take_cameras(CameraRole::Selectable, file, cameras);
                    }
                }
            }
            Content::Scene(Err(error), _) => self.events.push(Event::SceneFailed { path, error }),
            Content::Cameras(role, cameras) => {
                if role == CameraRole::Selectable {
                    self.cameras_number = number;
                }
                self.take_cameras(role, path, cameras);
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
                Ok(Comparison {
                    psnr: found.psnr(),
                    ssim: found.ssim,
                    worst: found.worst.difference,
                    at: [found.worst.x, found.worst.y],
                    size: [a.width, a.height],
                })
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
