//! Manages the viewer's scenes: A's, and B's if it has its own.
//!
//! The camera is in the coordinates of A's scene. B's pictures use the same camera in world coordinates.

use super::Viewer;
use super::subject::{Marks, Subject};
use crate::draw::camera_path;
use crate::io::load::LoadOptions;
use crate::io::output;
use crate::view::events::{Event, RendererId};
use crate::view::navigation::Navigation;
use crate::view::opening::{self, CameraRole, CamerasBeside, Content, Opened, OpenedScene};
use glam::DVec3;
use splatgraph_assets::Scene;
use splatgraph_framework::reload::Content as FileContent;
use splatgraph_framework::source::canonical;
use std::path::Path;

impl Viewer {
    pub(super) fn subject_of(&self, id: RendererId) -> &Subject {
        self.other.as_ref().filter(|_| id == RendererId::B).unwrap_or(&self.subject)
    }

    pub(super) fn subject_mut(&mut self, id: RendererId) -> &mut Subject {
        self.other.as_mut().filter(|_| id == RendererId::B).unwrap_or(&mut self.subject)
    }

    /// Returns A's scene as drawn: without hidden splats, and with selected ones tinted.
    pub fn scene(&self) -> &Scene {
        &self.subject.scene
    }

    /// Returns a viewport's scene as drawn; see [`Viewer::scene`].
    pub fn scene_of(&self, id: RendererId) -> &Scene {
        &self.subject_of(id).scene
    }

    /// Returns the path of A's scene.
    pub fn scene_path(&self) -> &Path {
        &self.subject.path
    }

    /// Returns the path of a viewport's scene.
    pub fn scene_path_of(&self, id: RendererId) -> &Path {
        &self.subject_of(id).path
    }

    /// Returns the error of the list of scenes that was read last for a viewport, with its location; `None` once a
    /// scene is loaded.
    pub fn list_error(&self, id: RendererId) -> Option<&str> {
        self.list_errors[opening::index(id)].as_ref().map(|(_, text)| text.as_str())
    }

    /// Returns the path of the list of scenes whose error [`Viewer::list_error`] returns.
    fn failed_list(&self, id: RendererId) -> Option<&Path> {
        self.list_errors[opening::index(id)].as_ref().map(|(path, _)| path.as_path())
    }

    /// Sets the options of all later loads of scenes.
    pub fn set_load_options(&mut self, load: LoadOptions) {
        self.opening.load = load;
    }

    /// Returns true if viewport B has its own scene.
    pub fn has_two_scenes(&self) -> bool {
        self.other.is_some()
    }

    /// Returns the path of the scene that is being loaded for a viewport; `None` if none is.
    pub fn loading(&self, id: RendererId) -> Option<&Path> {
        self.opening.scene(id)
    }

    /// Loads a scene for a viewport on another thread, and shows it when done. A later request replaces this one. If B
    /// is given A's file, by any path, it shares A's scene. Failures become events.
    pub fn open_scene_in(&mut self, id: RendererId, path: &Path) {
        if id == RendererId::B && canonical(path) == self.subject.file {
            return self.share_scene();
        }
        self.restored[opening::index(id)] = None;
        if let Err(error) = self.placed.follow(id, path, &self.wake) {
            self.events.push(Event::Problem { text: format!("changes are not detected: {error}") });
        }
        if let Err(error) = self.opening.open_scene(id, path) {
            self.events.push(Event::SceneFailed { path: path.to_owned(), error });
        }
    }

    /// Sets the contents that A's list of scenes had before its scenes were loaded. Without them, a save during the
    /// load would be missed.
    pub fn set_list_read(&mut self, content: FileContent) {
        let path = self.scene_path().to_owned();
        self.placed.read_as(RendererId::A, &path, content);
    }

    pub(super) fn reload_scenes(&mut self) {
        for path in self.placed.take() {
            for id in [RendererId::A, RendererId::B] {
                match self.loading(id) {
                    // The file may have been read before it changed.
                    Some(loading) if loading == path => {
                        let restored = self.restored[opening::index(id)].take();
                        self.open_scene_in(id, &path);
                        self.restored[opening::index(id)] = restored;
                    }
                    Some(_) if self.awaits(id, &path) => self.placed.postpone(id, path.clone()),
                    None if self.awaits(id, &path) => self.open_scene_in(id, &path),
                    Some(_) | None => {}
                }
            }
        }
    }

    /// Ends a load, successful or not: from now on, only the shown list of scenes and a list with an error are watched.
    /// If one of them changed during the load, loads it again.
    fn settle(&mut self, id: RendererId) {
        let (shown, failed) = (self.scene_path_of(id).to_owned(), self.failed_list(id).map(Path::to_owned));
        if let Some(changed) = self.placed.settle(id, &shown, failed.as_deref())
            && self.awaits(id, &changed)
        {
            self.open_scene_in(id, &changed);
        }
    }

    /// Returns true if a change of the list of scenes at `path` must load it again: the viewport shows the list or its
    /// error.
    fn awaits(&self, id: RendererId, path: &Path) -> bool {
        self.reloads(id, path) || self.failed_list(id) == Some(path)
    }

    /// Makes B draw A's scene instead of its own, and cancels a load for B.
    pub fn share_scene(&mut self) {
        self.opening.cancel_scene(RendererId::B);
        self.placed.forget(RendererId::B);
        self.list_errors[opening::index(RendererId::B)] = None;
        if self.other.take().is_some() && self.picked_in == RendererId::B {
            self.forget_picked();
        }
    }

    /// Exchanges graphs, parameters and scenes of A and B, if there is a B. The camera keeps its position in the world.
    ///
    /// If B shares A's scene while another scene is being loaded for B, B keeps the shared scene as its own, and A
    /// shows the other scene once it is loaded.
    pub fn exchange(&mut self) {
        let Some(b) = &mut self.b else { return };
        // Events from before the exchange keep the former names.
        for viewport in [&mut self.a, &mut *b] {
            self.events.extend(viewport.renderer.take_events());
        }
        std::mem::swap(&mut self.a, b);
        std::mem::swap(&mut self.a.renderer.id, &mut b.renderer.id);
        self.events.push(Event::Exchanged);
        if self.other.is_none() && self.loading(RendererId::B).is_some() {
            let (copy, applied) = self.subject.copied(self.wake.clone());
            self.other = Some(copy);
            self.placed.copy_to_b();
            self.events.extend(applied.err().map(|text| Event::Problem { text }));
        }
        if let Some(other) = self.other.take() {
            let former = self.replace_subject(other);
            self.other = Some(former);
            self.placed.exchange();
            self.restored.swap(0, 1);
            self.list_errors.swap(0, 1);
            self.opening.exchange_scenes();
            self.forget_picked();
        }
    }

    /// Replaces A's scene, and returns the previous one. All cameras keep their positions in the world.
    fn replace_subject(&mut self, subject: Subject) -> Subject {
        let camera = self.world_camera();
        let offset = self.scene().offset();
        let former = std::mem::replace(&mut self.subject, subject);
        let scene = self.subject.whole.clone();
        let up = self.navigation.up();
        self.navigation = Navigation::new(&scene.robust_bounds(), &camera.relative_to(scene.offset()), up);
        self.move_cameras(offset);
        self.path.set_radian(camera_path::length_of_radian(&scene));
        former
    }

    /// Converts the selectable cameras to A's scene, from a scene whose origin is at `former` in the world.
    fn move_cameras(&mut self, former: [f64; 3]) {
        let moved = DVec3::from(self.scene().offset()) - DVec3::from(former);
        for camera in &mut self.cameras {
            *camera = camera.relative_to(moved.into());
        }
    }

    pub(super) fn take(&mut self, opened: Opened) {
        let Opened { path, number, content } = opened;
        match content {
            Content::Scene(id, Ok(OpenedScene { scene, cameras, load_ms })) => {
                self.list_errors[opening::index(id)] = None;
                let splats = scene.count();
                self.events.push(Event::Scene { path: path.clone(), splats, load_ms });
                let mut subject = Subject::new(scene, path, self.wake.clone());
                if self.reloads(id, &subject.path) {
                    subject.up = self.subject_of(id).up;
                }
                if let Some(marks) = self.marks_for(id, &subject)
                    && let Err(text) = subject.set_marks(marks)
                {
                    self.events.push(Event::Problem { text });
                }
                if self.picked_in == id || !self.has_two_scenes() {
                    self.forget_picked();
                }
                match id {
                    RendererId::B => self.other = Some(subject),
                    RendererId::A | RendererId::Window => self.show_scene(subject, number, cameras),
                }
                self.settle(id);
            }
            Content::Scene(id, Err(error)) => {
                let is_list = self.placed.follows(id, &path);
                let event = Event::SceneFailed { path: path.clone(), error };
                if is_list {
                    let text = placed_error(&event.to_string(), &path);
                    self.list_errors[opening::index(id)] = Some((path, text));
                }
                self.events.push(event);
                self.settle(id);
            }
            Content::Cameras(role, cameras) => {
                if role == CameraRole::Selectable {
                    self.cameras_number = number;
                }
                self.take_cameras(role, path, cameras);
            }
        }
    }

    /// Returns the marks for a newly loaded scene: restored ones, or those of a list that was loaded again; otherwise
    /// `None`. Reports marks that were dropped because their file changed, and records reindexed lists.
    fn marks_for(&mut self, id: RendererId, subject: &Subject) -> Option<Marks> {
        let restored = self.restored[opening::index(id)].take();
        if restored.is_some() || !self.reloads(id, &subject.path) {
            return restored;
        }
        let former = self.subject_of(id);
        let (marks, dropped) = former.marks().carried(&former.whole, &subject.whole);
        let reindexed = !dropped.is_empty() || former.whole.parts() != subject.whole.parts();
        self.reindexed.extend(reindexed.then(|| subject.path.clone()));
        for file in dropped {
            let name = output::one_line(&file.display().to_string()).into_owned();
            let text = format!("{name} changed: its hidden splats are shown again, and none is selected");
            self.events.push(Event::Problem { text });
        }
        Some(marks)
    }

    /// Returns true if the viewport's own scene is the list of scenes at `path`: loading it again keeps its marks.
    /// False for B while it shares A's scene.
    pub(super) fn reloads(&self, id: RendererId, path: &Path) -> bool {
        let is_its_own = id == RendererId::A || self.has_two_scenes();
        is_its_own && self.scene_path_of(id) == path && self.placed.follows(id, path)
    }

    /// Shows the scene of request `number` with the cameras beside it, or with the selectable cameras of a later
    /// request. A list that was loaded again keeps the view and the cameras.
    fn show_scene(&mut self, subject: Subject, number: u64, beside: Option<CamerasBeside>) {
        // The file was edited: keep the view while the user adjusts the placement.
        if self.reloads(RendererId::A, &subject.path) {
            self.replace_subject(subject);
            return;
        }
        let former = self.scene().offset();
        self.navigation = subject.navigation(subject.scene.up());
        self.path.set_radian(camera_path::length_of_radian(&subject.scene));
        self.subject = subject;
        if self.cameras_number > number {
            self.move_cameras(former);
            let cameras = std::mem::take(&mut self.cameras);
            return self.set_cameras(cameras);
        }
        self.set_cameras(Vec::new());
        if let Some((file, cameras)) = beside {
            self.take_cameras(CameraRole::Selectable, file, cameras);
        }
    }
}

/// Adds the location to the error of a list of scenes, as in the errors of graphs: the line and column that the text
/// names, or the start of the file.
fn placed_error(text: &str, path: &Path) -> String {
    let number = |name: &str| {
        let after = text.split_once(name)?.1;
        after.split(|c: char| !c.is_ascii_digit()).next()?.parse::<u32>().ok()
    };
    let (line, column) = number(": line ").zip(number(", column ")).unwrap_or((1, 1));
    format!("error: {text}\n --> {}:{line}:{column}", path.display())
}
