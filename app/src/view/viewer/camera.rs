//! Lists the selectable cameras, moves the camera, saves views, and plays paths. Views and keys are in world
//! coordinates; the navigation is in scene coordinates.

use super::Viewer;
use super::camera_list::CameraList;
use crate::draw::camera::mean_up;
use crate::draw::camera_path::KeyError;
use crate::draw::facts;
use crate::draw::projection;
use crate::draw::render_command;
use crate::view::events::{Event, RendererId};
use crate::view::navigation::{Input, Navigation};
use crate::view::opening::CameraRole;
use splatgraph_assets::{Camera, Projection};
use std::path::Path;

/// Picture size for comparing cameras; any size would do.
const ANY_SIZE: (u32, u32) = (1, 1);

impl Viewer {
    /// Replaces the selectable cameras, selects the first, and jumps to it. Without cameras, the view stays.
    ///
    /// The navigation's up direction becomes that of the scene's tag, or else of the cameras.
    pub fn set_cameras(&mut self, list: impl Into<CameraList>) {
        self.camera_list = list.into();
        if let Some(camera) = self.cameras().first() {
            let camera = camera.relative_to(self.scene().offset());
            let up = self.own_up().into();
            self.navigation = Navigation::new(&self.subject.whole.robust_bounds(), &camera, up);
        }
        self.camera = (!self.cameras().is_empty()).then_some(0);
    }

    /// Returns the selectable cameras, in world coordinates.
    pub fn cameras(&self) -> &[Camera] {
        self.camera_list.cameras()
    }

    /// Selects the camera at `index` and flies to it; does nothing if there is none.
    pub fn look_through(&mut self, index: usize) {
        if let Some(camera) = self.cameras().get(index) {
            let camera = camera.relative_to(self.scene().offset());
            self.camera = Some(index);
            self.navigation.set_camera(&camera);
        }
    }

    /// Returns the selectable cameras; during a load, those that were restored for the new scene, if any.
    pub(in crate::view) fn camera_list(&self) -> &CameraList {
        let restored = self.restored_cameras.as_ref().filter(|_| self.is_loading_another());
        restored.unwrap_or(&self.camera_list)
    }

    /// Replaces the selectable cameras. The view stays. If another scene is being loaded for A, the cameras are kept
    /// for it.
    pub(in crate::view) fn restore_cameras(&mut self, list: CameraList) {
        if self.is_loading_another() {
            self.restored_cameras = Some(list);
        } else if list != self.camera_list {
            (self.camera_list, self.camera) = (list, None);
        }
    }

    /// Returns the current camera in world coordinates, as in files, at the size of the last frame's pictures.
    pub fn world_camera(&self) -> Camera {
        self.world_camera_of(self.asked)
    }

    /// Returns the camera of A's picture; see [`Viewer::picture_camera_of`].
    pub fn picture_camera(&self) -> Camera {
        self.picture_camera_of(RendererId::A)
    }

    /// Returns the current camera in the coordinates of a viewport's scene, with the projection of the viewport's
    /// graph. The camera's size is that of the last frame's pictures.
    pub fn picture_camera_of(&self, id: RendererId) -> Camera {
        let graph = self.graph_projection(id).unwrap_or_default();
        projection::shown(&self.camera_of(id, self.asked), graph, self.loaded(id))
    }

    /// Returns the projection of a viewport's graph; `None` without the viewport or before its first plan.
    fn graph_projection(&self, id: RendererId) -> Option<Projection> {
        let viewport = if id == RendererId::B { self.b.as_ref() } else { Some(&self.a) };
        let plan = viewport.and_then(|viewport| viewport.renderer.plan());
        plan.map(|plan| projection::of_params(&plan.params))
    }

    /// Sets the up direction of the navigation and of exported files. With selectable cameras, the view stays; without,
    /// most of the scene is shown upright.
    pub fn set_up(&mut self, up: [f64; 3]) {
        self.subject.up = Some(up);
        match self.cameras().is_empty() {
            true => self.navigation = self.subject.navigation(up),
            false => self.navigation.set_up(up.into()),
        }
    }

    /// Returns the up direction of the scene's tag. Without a tag, returns the mean of the cameras', or else -y.
    ///
    /// Cameras that look down have up directions along the ground, so their mean is less reliable than a tag.
    fn own_up(&self) -> [f64; 3] {
        let scene = self.scene();
        let mean = || mean_up(self.cameras()).map(Into::into);
        scene.notes().up.or_else(mean).unwrap_or(scene.up())
    }

    /// Sets the up direction of the navigation and of exported files; `None` for that of the file or the cameras. Flies
    /// to an upright view of most of the scene.
    pub fn show_upright(&mut self, up: Option<[f64; 3]>) {
        self.subject.up = up;
        let up = up.unwrap_or_else(|| self.own_up());
        self.navigation.set_up(up.into());
        let camera = Camera::framing_upright(self.scene(), up, None, facts::DEFAULT_SIZE);
        self.navigation.set_camera(&camera);
    }

    /// Restores the up direction that the user chose for a viewport's scene. Another one for A's scene turns the view
    /// upright; see [`Viewer::show_upright`].
    pub(super) fn restore_up(&mut self, id: RendererId, up: Option<[f64; 3]>) {
        match id {
            _ if self.subject_of(id).up == up => {}
            RendererId::B => self.subject_mut(id).up = up,
            RendererId::A | RendererId::Window => self.show_upright(up),
        }
    }

    /// Returns the camera for a viewport's pictures of this size. It is converted to world coordinates and back, which
    /// rounds it if the scene is far from the world's origin. A command that reads the camera from a file thus draws
    /// exactly the same picture.
    pub(super) fn camera_of(&self, id: RendererId, size: (u32, u32)) -> Camera {
        self.world_camera_of(size).relative_to(self.scene_of(id).offset())
    }

    fn world_camera_of(&self, (width, height): (u32, u32)) -> Camera {
        self.navigation.camera(width, height).in_world(self.scene().offset())
    }

    /// Advances the path if it is played, and applies the user's input; returns true if the camera moved.
    ///
    /// Makes the navigation orthographic if A's graph is.
    ///
    /// Playback pauses on input that moves the camera, and if anything else moved it since the last call.
    pub fn navigate(&mut self, input: &Input) -> bool {
        let now = |viewer: &Self| viewer.navigation.camera(ANY_SIZE.0, ANY_SIZE.1);
        if self.played.take().is_some_and(|shown| self.navigation.is_moving() || shown != now(self)) {
            self.play.pause();
        }
        let played = self.play.advance(input.seconds, &self.path);
        if let Some(camera) = &played {
            self.navigation.jump_to(&camera.relative_to(self.scene().offset()));
        }
        if let Some(graph) = self.graph_projection(RendererId::A) {
            self.navigation.set_orthographic(graph == Projection::Orthographic);
        }
        let moved = self.navigation.update(input);
        if moved && played.is_some() {
            self.play.pause();
        }
        self.played = self.play.is_playing().then(|| now(self));
        moved || played.is_some()
    }

    /// Returns the index of the selectable camera that is shown or flown to; `None` if the camera is elsewhere.
    pub fn shown_camera(&self) -> Option<usize> {
        let (cameras, offset) = (self.cameras(), self.scene().offset());
        let is_shown = |camera: &Camera| self.navigation.shows(&camera.relative_to(offset));
        let shows = |index: &usize| cameras.get(*index).is_some_and(is_shown);
        self.camera.filter(shows).or_else(|| (0..cameras.len()).find(shows))
    }

    /// Returns true while the camera moves without input: during a flight to another camera, or while a path is played.
    pub fn is_moving(&self) -> bool {
        self.navigation.is_moving() || self.play.is_playing()
    }

    /// Moves the camera to a time of the path, in seconds from its start. Playback continues from there.
    pub fn seek_path(&mut self, seconds: f64) {
        self.play.seek(seconds, &self.path);
        if let Some(camera) = self.path.at(self.play.position()) {
            self.navigation.jump_to(&camera.relative_to(self.scene().offset()));
            self.played = None;
        }
    }

    /// Adds the current camera to the end of the path.
    ///
    /// # Errors
    /// See [`crate::draw::camera_path::CameraPath::insert`].
    pub fn record_key(&mut self) -> Result<(), KeyError> {
        let camera = self.world_camera();
        self.path.insert(usize::MAX, camera)
    }

    /// Adds the current camera to the saved views as [`crate::view::cameras::Views::add`] does; returns its index.
    pub fn save_view(&mut self, name: &str) -> usize {
        let camera = self.world_camera();
        self.views.add(name, camera)
    }

    /// Flies to the saved view at `index`; does nothing if there is none.
    pub fn look_through_view(&mut self, index: usize) {
        if let Some(view) = self.views.list().get(index) {
            self.navigation.set_camera(&view.relative_to(self.scene().offset()));
        }
    }

    /// Reads cameras on another thread, to be used as `role`; reports an error as an event.
    pub(in crate::view) fn open_cameras_as(&mut self, role: CameraRole, path: &Path) {
        if let Err(error) = self.opening.open_cameras(role, path) {
            self.events.push(Event::FileFailed { path: path.to_owned(), error });
        }
    }

    /// Uses a file's cameras as `role` says: views are appended, keys and selectable cameras are replaced. New keys
    /// also pause and rewind the path. Fails if the keys cannot form a path.
    pub(super) fn take_world_cameras(
        &mut self,
        role: CameraRole,
        cameras: Vec<Camera>,
    ) -> Result<(), String> {
        match role {
            CameraRole::Selectable => self.set_cameras(cameras),
            CameraRole::Views => {
                for camera in cameras {
                    let name = camera.img_name.clone();
                    let index = self.views.add(&name, camera);
                    self.in_files.push(self.views.list()[index].clone());
                }
            }
            CameraRole::Path => {
                self.path.set_keys(cameras).map_err(|error| error.to_string())?;
                self.in_files.extend_from_slice(self.path.keys());
                self.play.pause();
                self.play.seek(0.0, &self.path);
            }
        }
        Ok(())
    }

    /// Returns the command line that draws a viewport's picture to a file; `None` if there is no such viewport.
    pub fn render_command(&mut self, id: RendererId, output: &Path) -> Option<String> {
        let mut camera = self.world_camera();
        if !camera.projection.is_pinhole() {
            // The command would refuse a camera with another projection than the graph's.
            let Camera { fx, fy, principal_offset, projection, .. } = self.picture_camera_of(id);
            camera = Camera { fx, fy, principal_offset, projection, ..camera };
        }
        let (scene, background) = (self.scene_path_of(id).to_owned(), self.background);
        let load = self.opening.load.clone();
        let renderer = &self.viewport(id)?.renderer;
        let set = renderer.set().iter().map(|(name, value)| (name.as_str(), value.as_str()));
        Some(render_command::line((&scene, &load), &camera, renderer.graph(), set, background, output))
    }
}
