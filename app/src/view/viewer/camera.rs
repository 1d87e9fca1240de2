//! The viewer's camera: who moves it, and where it is kept.
//!
//! The user's input moves it ([`Viewer::navigate`]), or a path that is played, until anything else moves it. Views and keys are in
//! the world's coordinates; the navigation is in the scene's.

use super::Viewer;
use crate::draw::camera_path::KeyError;
use crate::draw::render_command::RenderCommand;
use crate::view::cameras::SaveError;
use crate::view::events::{Event, RendererId};
use crate::view::navigation::Input;
use crate::view::opening::CameraRole;
use splatgraph_api::Device;
use splatgraph_assets::Camera;
use std::path::Path;

/// Size of the camera by which a change is noticed.
const ANY_SIZE: (u32, u32) = (1, 1);

impl<D: Device> Viewer<D> {
    /// Returns the camera of the last frame's pictures in the world's coordinates, as files have it, in the pictures' size.
    pub fn world_camera(&self) -> Camera {
        self.world_camera_of(self.asked)
    }

    /// Returns the camera of the last frame's pictures, in the coordinates of A's scene and the pictures' size.
    pub fn picture_camera(&self) -> Camera {
        self.picture_camera_of(RendererId::A)
    }

    /// Returns the camera of the last frame's pictures, in the coordinates of a viewport's scene.
    pub fn picture_camera_of(&self, id: RendererId) -> Camera {
        self.camera_of(id, self.asked)
    }

    /// Returns the camera for a viewport's pictures of this size.
    ///
    /// It takes the way through the world's coordinates, which round it where the scene is far from the world's origin: a command
    /// that reads it from a file draws the same picture.
    pub(super) fn camera_of(&self, id: RendererId, size: (u32, u32)) -> Camera {
        self.world_camera_of(size).relative_to(self.scene_of(id).offset())
    }

    fn world_camera_of(&self, (width, height): (u32, u32)) -> Camera {
        self.navigation.camera(width, height).relative_to(self.scene().offset().map(|v| -v))
    }

    /// Applies the user's input to the camera, or plays the path on; returns true if the camera moved.
    ///
    /// A playing path is paused by input that moves the camera, and by whatever else moved it since the last call.
    pub fn navigate(&mut self, input: &Input) -> bool {
        let now = |viewer: &Self| viewer.navigation.camera(ANY_SIZE.0, ANY_SIZE.1);
        if self.played.take().is_some_and(|shown| self.navigation.is_moving() || shown != now(self)) {
            self.play.pause();
        }
        let played = self.play.advance(input.seconds, &self.path);
        if let Some(camera) = &played {
            self.navigation.jump_to(&camera.relative_to(self.scene().offset()));
        }
        let moved = self.navigation.update(input);
        if moved && played.is_some() {
            self.play.pause();
        }
        self.played = self.play.is_playing().then(|| now(self));
        moved || played.is_some()
    }

    /// Returns true while the camera moves without input: on the way to another camera, or on a path that is played.
    pub fn is_moving(&self) -> bool {
        self.navigation.is_moving() || self.play.is_playing()
    }

    /// Shows the path at a time, in seconds from its start. If it is played, it continues from there.
    pub fn seek_path(&mut self, seconds: f64) {
        self.play.seek(seconds, &self.path);
        if let Some(camera) = self.path.at(self.play.position()) {
            self.navigation.jump_to(&camera.relative_to(self.scene().offset()));
            self.played = None;
        }
    }

    /// Inserts the current camera into the path, before the key at `index`, or at the end.
    ///
    /// # Errors
    /// See [`crate::draw::camera_path::CameraPath::insert`].
    pub fn record_key(&mut self, index: usize) -> Result<(), KeyError> {
        let camera = self.world_camera();
        self.path.insert(index, camera)
    }

    /// Adds the current camera to the saved views; returns its index. See [`crate::view::cameras::Views::add`] for the name.
    pub fn save_view(&mut self, name: &str) -> usize {
        let camera = self.world_camera();
        self.views.add(name, camera)
    }

    /// Goes to a saved view.
    pub fn look_through_view(&mut self, index: usize) {
        if let Some(view) = self.views.list().get(index) {
            self.navigation.set_camera(&view.relative_to(self.scene().offset()));
        }
    }

    /// Writes the saved views to a `cameras.json`; never over a file that this window did not write.
    ///
    /// # Errors
    /// See [`crate::view::cameras::CameraFiles::save`].
    pub fn write_views(&mut self, path: &Path) -> Result<(), SaveError> {
        self.camera_files.save(self.views.list(), path)
    }

    /// Writes the keys of the path to a `cameras.json`; never over a file that this window did not write.
    ///
    /// # Errors
    /// See [`crate::view::cameras::CameraFiles::save`].
    pub fn write_path(&mut self, path: &Path) -> Result<(), SaveError> {
        self.camera_files.save(self.path.keys(), path)
    }

    /// Reads a `cameras.json` on another thread, and adds its cameras to the saved views.
    pub fn open_views(&mut self, path: &Path) {
        self.open_cameras_as(CameraRole::Views, path);
    }

    /// Reads a `cameras.json` on another thread, and makes its cameras the keys of the path.
    pub fn open_path(&mut self, path: &Path) {
        self.open_cameras_as(CameraRole::Path, path);
    }

    /// Reads cameras on another thread.
    pub(in crate::view) fn open_cameras_as(&mut self, role: CameraRole, path: &Path) {
        if let Err(error) = self.opening.open_cameras(role, path) {
            self.events.push(Event::FileFailed { path: path.to_owned(), error });
        }
    }

    /// Takes cameras that were read: views, or the keys of the path.
    pub(super) fn take_world_cameras(
        &mut self,
        role: CameraRole,
        cameras: Vec<Camera>,
    ) -> Result<(), String> {
        match role {
            CameraRole::Selectable => {
                let offset = self.scene().offset();
                self.set_cameras(cameras.iter().map(|camera| camera.relative_to(offset)).collect());
            }
            CameraRole::Views => {
                for camera in cameras {
                    let name = camera.img_name.clone();
                    self.views.add(&name, camera);
                }
            }
            CameraRole::Path => {
                self.path.set_keys(cameras).map_err(|error| error.to_string())?;
                self.play.pause();
                self.play.seek(0.0, &self.path);
            }
        }
        Ok(())
    }

    /// Writes the command that draws the picture of a viewport to a file; `None` for one that is not there.
    pub fn render_command(&mut self, id: RendererId, output: &Path) -> Option<String> {
        let camera = self.world_camera();
        let (scene, background) = (self.scene_path_of(id).to_owned(), self.background);
        let renderer = &self.viewport(id)?.renderer;
        let set = renderer.set().iter().map(|(name, value)| (name.as_str(), value.as_str()));
        let command = RenderCommand {
            scene: &scene,
            camera: &camera,
            graph: renderer.graph(),
            set,
            background,
            output,
        };
        Some(command.line())
    }
}
