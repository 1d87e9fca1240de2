//! Implements the viewer without a window.
//!
//! A [`Viewer`] has a scene, a camera, and one or two viewports: A, and B for comparison, which may have its own scene.
//! [`Viewer::frame`] takes the results of other threads (plans, scenes, comparisons) and draws the pictures that are
//! due.

use super::cameras::Views;
use super::events::{Event, RendererId};
use super::export::Exporter;
use super::latest::Latest;
use super::navigation::Navigation;
use super::opening::{self, CameraRole, Opened, Opening};
use super::paint::{Mode, Shown};
use super::profile::zone;
use super::renderer::{self, Choice, PlanInputs, Renderer, Wake};
use super::viewport::{View, Viewport};
use crate::draw::backend::Backend;
use crate::draw::camera_path::{self, CameraPath, Playback};
use crate::draw::pick::{Picked, pick};
use crate::draw::splat_set::{Masked, SplatSet};
use crate::io::{losses, output};
use glam::DVec3;
use splatgraph_api::{BackendError, Device, Running};
use splatgraph_assets::{Camera, Scene, grouped, names_scenes};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

mod camera;
mod camera_list;
mod comparing;
mod comparison;
mod copy;
mod graph;
mod scene_watch;
mod scenes;
mod splats;
mod subject;

pub use camera_list::CameraList;
use comparing::Comparing;
pub use comparing::Differences;
use scene_watch::SceneWatch;
pub use subject::{Combine, Marks, Part, SceneSettings};
use subject::{SplatsKey, Subject};

/// An error of creating or changing the viewer.
#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    /// The device failed.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// The system cannot start a thread that watches files or builds plans.
    #[error("no thread can be started to watch files or to build plans: {0}")]
    Thread(#[from] std::io::Error),
    /// The device is lost, and has not been replaced yet.
    #[error("the device is lost")]
    NoDevice,
}

/// A scene, a camera and one or two viewports; see the module's documentation.
pub struct Viewer {
    /// A's scene. The camera is in its coordinates.
    subject: Subject,
    /// B's scene; `None` if B draws A's.
    other: Option<Subject>,
    camera_list: CameraList,
    /// Selectable cameras for the scene that is being loaded for A; `None` to use those beside it.
    restored_cameras: Option<CameraList>,
    /// Index of the last selected camera in [`Viewer::cameras`]; `None` if none of the current list was selected.
    pub camera: Option<usize>,
    /// Position and controls of the camera.
    pub navigation: Navigation,
    /// Saved views, in world coordinates.
    pub views: Views,
    /// Camera path, in world coordinates.
    pub path: CameraPath,
    /// Views and keys that were read from or written to files.
    pub(in crate::view) in_files: Vec<Camera>,
    /// Playback of the path.
    pub play: Playback,
    /// Camera that playback set last. If the camera differs, something else has moved it.
    played: Option<Camera>,
    /// Viewport of picture A, which is shown alone or compared with B.
    pub a: Viewport,
    /// Viewport that A is compared with; `None` before the first comparison, and if [`Viewer::give`] failed. Hiding it
    /// keeps its parameters.
    pub b: Option<Viewport>,
    /// Pictures to show: A alone, or a comparison of A and B.
    pub compare: Mode,
    /// Position of the split line from the left, as a fraction of the view's width.
    pub split: f32,
    /// Factor that amplifies the difference of A and B.
    pub gain: f32,
    /// Background colour, display-encoded.
    pub background: [f32; 3],
    /// Picture pixels per window pixel, along each axis.
    pub scale: f32,
    /// True to draw frames continuously, even if nothing changes.
    pub continuous: bool,
    /// Folder for files that are named automatically.
    pub folder: PathBuf,
    /// Result of the last completed [`Viewer::pick`], without splats for a pixel of the background. `None` before the
    /// viewport's first result, after a pick outside the picture, and after [`Viewer::forget_picked`].
    pub picked: Option<Picked>,
    /// Viewport of `picked`, and of the search in progress.
    picked_in: RendererId,
    picker: Latest<Picked>,
    /// Position of the splat that was selected before the last pick, in world coordinates.
    picked_before: Option<[f64; 3]>,
    /// Settings of the scenes that are being loaded for A and B.
    restored: [Option<SceneSettings>; 2],
    /// Paths of scenes, with their hidden splats that were in no file when another scene was opened.
    left: Vec<(PathBuf, Arc<SplatSet>)>,
    /// Path of the scene of which the rest is being written, with its hidden splats.
    saving: Option<(PathBuf, Arc<SplatSet>)>,
    /// Keys of scenes that were loaded again with the same splats in the same order, by their identity; see
    /// [`Viewer::splats_key`].
    moved: BTreeMap<u64, SplatsKey>,
    exporter: Exporter,
    /// True if the window uses another device, so that pictures are copied through host memory.
    pub(super) to_host: bool,
    pub(super) rests: bool,
    /// Size of the pictures requested by the last frame, in pixels.
    asked: (u32, u32),
    opening: Opening,
    scene_watch: SceneWatch,
    /// Paths and errors of A's and B's watched scenes. An error stays until a scene is loaded for the viewport.
    scene_errors: [Option<(PathBuf, String)>; 2],
    /// Number of the last request that opened selectable cameras separately from a scene; 0 before the first.
    cameras_number: u64,
    comparing: Comparing,
    /// Bandwidth for copies, in 10^9 bytes per second; `None` before it is measured.
    copy_limit: Option<f64>,
    /// Viewport that measures the copy limit.
    copying: Option<Viewport>,
    events: Vec<Event>,
    wake: Wake,
}

impl Viewer {
    /// Creates a viewer of `scene`, loaded from `path`, with `graph` and the parameters in `set`.
    ///
    /// # Errors
    /// The system cannot start a thread.
    pub fn new(
        device: Backend,
        (scene, path): (Scene, PathBuf),
        graph: &str,
        set: &[(String, String)],
        wake: Wake,
    ) -> Result<Viewer, ViewerError> {
        let path_of_camera = CameraPath::new(camera_path::length_of_radian(&scene), scene.up());
        let renderer = Renderer::new(RendererId::A, device, Choice::new(graph, set), wake.clone())?;
        let mut scene_watch = SceneWatch::default();
        scene_watch.follow(RendererId::A, &path, opening::files(&path), &wake)?;
        let notes = losses::notes(&scene);
        let notes = (!notes.is_empty()).then(|| Event::SceneNotes { path: path.clone(), notes });
        let subject = Subject::new(scene, path, wake.clone());
        Ok(Viewer {
            navigation: subject.navigation(subject.scene.up()),
            subject,
            other: None,
            camera_list: CameraList::default(),
            restored_cameras: None,
            camera: None,
            views: Views::default(),
            path: path_of_camera,
            in_files: Vec::new(),
            play: Playback::default(),
            played: None,
            a: Viewport::new(renderer),
            b: None,
            compare: Mode::A,
            split: 0.5,
            gain: 8.0,
            background: [0.0; 3],
            scale: 1.0,
            continuous: false,
            folder: PathBuf::new(),
            picked: None,
            picked_in: RendererId::A,
            picker: Latest::new("pick", wake.clone()),
            picked_before: None,
            restored: [const { None }; 2],
            left: Vec::new(),
            saving: None,
            moved: BTreeMap::new(),
            exporter: Exporter::new(wake.clone()),
            to_host: false,
            rests: false,
            asked: (0, 0),
            opening: Opening::new(&wake),
            scene_watch,
            scene_errors: [const { None }; 2],
            cameras_number: 0,
            comparing: Comparing::new(wake.clone()),
            copy_limit: None,
            copying: None,
            events: notes.into_iter().collect(),
            wake,
        })
    }

    /// Returns a viewport; `None` for the window, and for B while there is no [`Viewer::b`].
    pub fn viewport(&mut self, id: RendererId) -> Option<&mut Viewport> {
        match id {
            RendererId::A => Some(&mut self.a),
            RendererId::B => self.b.as_mut(),
            RendererId::Window => None,
        }
    }

    /// Returns true while a build, load, comparison, pick, selection or export is pending. Also while a list may still
    /// grow, or a picture is not shown yet.
    pub fn busy(&self) -> bool {
        self.changes_soon() || self.is_comparing() || self.picker.busy() || self.exporter.busy()
    }

    /// Returns true while the pictures do not show the requested state.
    fn changes_soon(&self) -> bool {
        let busy = |viewport: &Viewport| {
            viewport.renderer.busy() || viewport.renderer.may_grow() || viewport.is_coming()
        };
        let scenes = [Some(&self.subject), self.other.as_ref()];
        self.drawing().any(busy) || self.opening.busy() || scenes.into_iter().flatten().any(Subject::busy)
    }

    /// Describes the user's work that is in no file: saved views, keys, and hidden splats. Hidden splats of scenes that
    /// are no longer shown are included, those of a file that is being written are not. `None` if there is none.
    pub fn unsaved(&self) -> Option<String> {
        let new =
            |cameras: &[Camera]| cameras.iter().filter(|camera| !self.in_files.contains(camera)).count();
        let scenes = [Some(&self.subject), self.other.as_ref()].into_iter().flatten();
        let scenes = scenes.filter(|subject| !self.is_saving(&subject.path, &subject.marks().hidden));
        let hidden = (scenes.map(|subject| u64::from(subject.unsaved())).sum(), "hidden splat");
        let cameras = [(new(self.views.list()) as u64, "view"), (new(self.path.keys()) as u64, "keyframe")];
        let left = self.left.iter().filter(|(path, hidden)| !self.is_saving(path, hidden));
        let left = left.map(|(path, hidden)| {
            let text = plural(u64::from(hidden.len()), "hidden splat");
            format!("{text} of {}", output::one_line(&path.display().to_string()))
        });
        let named = |counts: &[(u64, &str)]| {
            let counts = counts.iter().filter(|(count, _)| *count > 0);
            counts.map(|(count, name)| plural(*count, name)).collect::<Vec<String>>()
        };
        let parts = [named(&[hidden]), left.collect(), named(&cameras)].concat();
        (!parts.is_empty()).then(|| parts.join(", "))
    }

    /// Iterates over A, and B if there is one.
    pub fn viewports(&self) -> impl Iterator<Item = &Viewport> {
        [Some(&self.a), self.b.as_ref()].into_iter().flatten()
    }

    fn viewports_mut(&mut self) -> impl Iterator<Item = &mut Viewport> {
        [Some(&mut self.a), self.b.as_mut()].into_iter().flatten()
    }

    /// Iterates over A, and B unless it is hidden.
    pub fn shown(&self) -> impl Iterator<Item = &Viewport> {
        let b = self.b.as_ref().filter(|_| self.compare != Mode::A);
        [Some(&self.a), b].into_iter().flatten()
    }

    /// Iterates over A, B, and the viewport of the copy measurement while it runs.
    fn all(&self) -> impl Iterator<Item = &Viewport> {
        self.viewports().chain(&self.copying)
    }

    fn all_mut(&mut self) -> impl Iterator<Item = &mut Viewport> {
        [Some(&mut self.a), self.b.as_mut(), self.copying.as_mut()].into_iter().flatten()
    }

    /// Iterates over the shown viewports, and the viewport of the copy measurement while it runs.
    fn drawing(&self) -> impl Iterator<Item = &Viewport> {
        self.shown().chain(&self.copying)
    }

    /// Returns true if frames are drawn continuously: on request, for a measurement, or because they may differ for
    /// equal inputs.
    pub(super) fn is_animated(&self) -> bool {
        self.continuous || self.is_measuring_copy() || self.drawing().any(Viewport::is_animated)
    }

    pub(super) fn waits(&self) -> bool {
        self.drawing().any(Viewport::waits)
    }

    /// Returns a counter of changes that panels show: finished frames, and [`Renderer::changes`].
    pub(super) fn changes(&self) -> u64 {
        let of = |viewport: &Viewport| viewport.renderer.changes() + viewport.history.frames();
        self.all().map(of).sum()
    }

    /// Returns the time of the next frame, unless a wake or the end of a frame comes first. `None` if only these cause
    /// a frame.
    pub(super) fn next(&self) -> Option<Instant> {
        let of = |viewport: &Viewport| {
            let retry = viewport.renderer.retry().filter(|_| viewport.waits());
            [viewport.renderer.next(), retry]
        };
        self.drawing().flat_map(of).flatten().min()
    }

    /// Takes the results of finished frames; see [`renderer::frames::collect`].
    pub(super) fn collect(&mut self, patience: Duration) -> bool {
        let to_host = self.to_host;
        let mut renderers: Vec<_> = self.all_mut().map(|viewport| &mut viewport.renderer).collect();
        let ready = renderer::frames::collect(&mut renderers, patience);
        self.all_mut().for_each(|viewport| viewport.collect(to_host));
        ready
    }

    /// Returns the submission time of the newest frame in flight; `None` if there is none.
    pub(super) fn newest(&self) -> Option<Instant> {
        self.all().filter_map(|viewport| viewport.renderer.newest()).max()
    }

    /// Selects the pictures to show. B is created on first use, as a copy of A.
    ///
    /// # Errors
    /// B cannot be created; A is then shown alone.
    pub fn set_compare(&mut self, compare: Mode) -> Result<(), ViewerError> {
        if compare != Mode::A && self.b.is_none() {
            let a = &self.a.renderer;
            let mut b = self.viewport_beside_a(RendererId::B, a.choice().clone())?;
            b.renderer.patience = a.patience;
            b.renderer.take_room_of(a);
            self.b = Some(b);
        }
        self.compare = compare;
        Ok(())
    }

    /// Creates a viewport that draws with a context of its own on A's device.
    fn viewport_beside_a(&self, id: RendererId, choice: Choice) -> Result<Viewport, ViewerError> {
        let device = self.a.renderer.device().ok_or(ViewerError::NoDevice)?.new_context()?;
        Ok(Viewport::new(Renderer::new(id, device, choice, self.wake.clone())?))
    }

    /// Selects the pictures to show, as [`Viewer::set_compare`] does; reports an error as an event.
    pub fn choose_compare(&mut self, compare: Mode) {
        if let Err(error) = self.set_compare(compare) {
            self.events.push(Event::Problem { text: format!("B cannot be shown: {error}") });
        }
    }

    /// Opens a scene or a graph in A, or cameras; see [`Viewer::open_in`].
    pub fn open(&mut self, path: &Path) {
        self.open_in(RendererId::A, path);
    }

    /// Opens a scene or a graph in viewport `id`, selects its splats, or replaces the viewer's cameras. A `.ron` file
    /// that is no list of scenes is a graph, a `.json` file without a scene's header is a selection or has cameras, and
    /// any other file is a scene, loaded on another thread. Failures become events.
    pub fn open_in(&mut self, id: RendererId, path: &Path) {
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        match ending.as_str() {
            "ron" if !path.is_dir() && !names_scenes(path) => {
                self.choose_graph(id, &path.to_string_lossy());
            }
            // SOG and glTF scenes can also be `.json` files.
            "json" if self.opening.load.header(path).is_err() => {
                if SplatSet::begins_in(path) {
                    return self.select_from(id, path);
                }
                self.open_cameras_as(CameraRole::Selectable, path);
            }
            _ => self.open_scene_in(id, path),
        }
    }

    fn take_cameras(&mut self, role: CameraRole, opened: Opened<Vec<Camera>>) {
        let Opened { path, number, content: cameras } = opened;
        if role == CameraRole::Selectable {
            self.cameras_number = number;
        }
        let count = cameras.as_ref().map_or(0, Vec::len);
        match cameras.and_then(|cameras| self.take_world_cameras(role, cameras)) {
            Ok(()) => self.events.push(Event::Cameras { path, count }),
            Err(error) => self.events.push(Event::FileFailed { path, error }),
        }
    }

    /// Searches on another thread for the splats at a pixel of a viewport's picture.
    ///
    /// `at` is in picture pixels, from the top left; a position outside the picture picks nothing. A later frame stores
    /// the result in [`Viewer::picked`]. The newest request replaces all earlier ones, and the result of another
    /// viewport. The rules are those of [`crate::draw::pick`], whatever the graph.
    pub fn pick(&mut self, id: RendererId, at: [f32; 2]) {
        let (width, height) = self.asked;
        let inside = (0.0..width as f32).contains(&at[0]) && (0.0..height as f32).contains(&at[1]);
        // Indices of another viewport's splats may be of another scene.
        if !inside || self.picked_in != id {
            self.forget_picked();
        }
        if !inside {
            return;
        }
        let pixel = at.map(|v| v as u32);
        let (subject, camera) = (self.subject_of(id), self.picture_camera_of(id));
        let (scene, hidden) = (subject.whole.clone(), subject.marks().hidden.clone());
        self.picked_in = id;
        let work = move |cancelled: &(dyn Fn() -> bool + Sync)| {
            pick(&Masked { scene: &scene, hidden: &hidden }, &camera, pixel, cancelled).map(Ok)
        };
        if let Err(error) = self.picker.start(work) {
            self.events.push(Event::Problem { text: error });
        }
    }

    /// Returns the viewport in which [`Viewer::picked`] was picked.
    pub fn picked_in(&self) -> RendererId {
        self.picked_in
    }

    /// Returns true while the splats at a pixel are being searched.
    pub fn is_picking(&self) -> bool {
        self.picker.busy()
    }

    /// Drops the picked splats, and cancels the current search.
    pub fn forget_picked(&mut self) {
        self.picker.cancel();
        (self.picked, self.picked_before) = (None, None);
    }

    /// Returns the world distance from the selected splat to the one selected before the last pick. `None` if either is
    /// missing.
    pub fn picked_distance(&self) -> Option<f64> {
        let [here, before] =
            [self.picked.as_ref()?.splat()?.gaussian.position, self.picked_before?].map(DVec3::from);
        Some(here.distance(before))
    }

    /// Takes finished results, and draws the pictures that are due. `size` is the view's, in window pixels.
    ///
    /// Errors are kept in the renderers: see [`Renderer::problem`] and [`Viewer::lost`].
    pub fn frame(&mut self, size: (u32, u32)) {
        zone!("pictures");
        // First, so that the cameras beside a scene replace those of a file requested earlier.
        while let Some((role, opened)) = self.opening.take_cameras() {
            self.take_cameras(role, opened);
        }
        for id in [RendererId::A, RendererId::B] {
            if let Some(opened) = self.opening.take_scene(id) {
                self.take_scene(id, opened);
            }
        }
        self.reload_scenes();
        self.take_comparison();
        match self.picker.take() {
            None => {}
            Some(Ok(picked)) => {
                let before = self.picked.replace(picked);
                let before = before.as_ref().and_then(Picked::splat).map(|splat| splat.gaussian.position);
                self.picked_before = before.or(self.picked_before);
            }
            Some(Err(text)) => self.events.push(Event::Problem { text }),
        }
        self.take_splats();
        let now = Instant::now();
        let scaled = |length: u32| match length {
            0 => 0,
            _ => ((length as f32 * self.scale).round() as u32).max(1),
        };
        let size = (scaled(size.0), scaled(size.1));
        self.asked = size;
        self.start_comparison();
        let cameras = [RendererId::A, RendererId::B].map(|id| self.camera_of(id, size));
        let ready = self.collect(self.a.renderer.patience);
        let subjects = [&self.subject, self.other.as_ref().unwrap_or(&self.subject)];
        let shown_b = self.b.as_mut().filter(|_| self.compare != Mode::A);
        let viewports = [Some(&mut self.a), shown_b].into_iter().flatten();
        for (viewport, (subject, camera)) in viewports.zip(subjects.into_iter().zip(&cameras)) {
            let inputs = PlanInputs {
                scene: Some(subject.scene.clone()),
                size,
                share_memory: viewport.inspection.is_none(),
            };
            viewport.renderer.paused = self.rests || !ready;
            viewport.renderer.poll(&inputs, now);
            viewport.draw(&View {
                scene: &subject.scene,
                loaded: &subject.whole,
                camera,
                background: self.background,
                continuous: self.continuous,
                to_host: self.to_host,
            });
            self.events.extend(viewport.renderer.take_events());
        }
        self.compare_pictures();
        self.step_copy(now);
    }

    /// Returns the error that reported the loss of the device; `None` while it works, and after [`Viewer::release`].
    pub fn lost(&self) -> Option<&BackendError> {
        self.viewports().find_map(|viewport| viewport.renderer.lost())
    }

    /// Drops the lost device and everything on it. The scene stays in host memory.
    pub fn release(&mut self) {
        self.all_mut().for_each(Viewport::release);
    }

    /// Suspends builds until something changes; see [`Renderer::hold`].
    pub fn hold(&mut self, loss: &str) {
        self.viewports_mut().for_each(|viewport| viewport.renderer.hold(loss));
    }

    /// Returns true once no build holds the released device.
    pub fn is_released(&mut self) -> bool {
        self.all_mut().all(|viewport| viewport.renderer.is_released())
    }

    /// Continues on another device after [`Viewer::release`]. Forgets the copy limit.
    ///
    /// # Errors
    /// A context for B cannot be created; B is then dropped, with its scene.
    pub fn give(&mut self, device: Backend) -> Result<(), BackendError> {
        // The copy limit must be measured again on the new device.
        (self.copy_limit, self.copying) = (None, None);
        let b = self.b.as_ref().map(|_| device.new_context()).transpose();
        self.a.renderer.give(device);
        match (&mut self.b, b) {
            (Some(viewport), Ok(Some(device))) => viewport.renderer.give(device),
            (_, Ok(_)) => {}
            (_, Err(error)) => {
                (self.b, self.compare) = (None, Mode::A);
                self.share_scene();
                return Err(error);
            }
        }
        Ok(())
    }

    /// Returns true if the last frame's view had no pixels, and before the first frame.
    pub fn is_empty(&self) -> bool {
        self.asked.0 == 0 || self.asked.1 == 0
    }

    /// Returns the pictures of A and B for the window, each with a unique number. `None` before a viewport's first
    /// picture on the current device, and for B while it is hidden.
    pub fn pictures(&self) -> [Option<(Shown, u64)>; 2] {
        let b = self.b.as_ref().filter(|_| self.compare != Mode::A);
        [self.a.picture(), b.and_then(Viewport::picture)]
    }

    /// Queues an event for [`Viewer::take_events`].
    pub fn report(&mut self, event: Event) {
        self.events.push(event);
    }

    /// Takes the events reported since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Closes the viewer, and returns A's device; `None` if it was released.
    pub fn into_device(self) -> Option<Backend> {
        let Viewer { a, b, copying, .. } = self;
        drop((b, copying));
        a.renderer.into_device()
    }

    /// Waits up to `within` for each viewport's frames in flight.
    ///
    /// # Errors
    /// See [`Renderer::finish`].
    pub fn finish(&mut self, within: Duration) -> Result<(), BackendError> {
        if !self.collect(within) {
            let place = self.stalled().map_or_else(String::new, |running| running.place.clone());
            return Err(BackendError::Stuck { place, seconds: within.as_secs() });
        }
        let to_host = self.to_host;
        for viewport in self.all_mut() {
            viewport.renderer.finish(within)?;
            viewport.collect(to_host);
        }
        Ok(())
    }

    pub(super) fn is_idle(&self) -> bool {
        self.all().all(|viewport| viewport.renderer.is_idle())
    }

    /// Returns the pass or frame that the device did not finish in time; see [`Renderer::stalled`].
    pub fn stalled(&self) -> Option<&Running> {
        self.all().find_map(|viewport| viewport.renderer.stalled())
    }
}

/// Formats a number of things, such as `1 view` or `4,000 views`.
fn plural(count: u64, name: &str) -> String {
    format!("{} {name}{}", grouped(count), if count == 1 { "" } else { "s" })
}
