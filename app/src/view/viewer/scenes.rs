//! Manages the viewer's scenes: A's, and B's if it has its own.
//!
//! The camera is in the coordinates of A's scene. B's pictures use the same camera in world coordinates.

use super::camera_list::CameraList;
use super::subject::{LostMarks, Marks, SceneSettings, Subject};
use super::{Viewer, plural};
use crate::draw::camera_path;
use crate::io::load::LoadOptions;
use crate::io::{losses, output};
use crate::view::events::{Event, RendererId};
use crate::view::opening::{self, CamerasBeside, Opened, OpenedScene, ReadScene};
use glam::DVec3;
use splatgraph_assets::{Scene, names_scenes};
use splatgraph_framework::reload::Wanted;
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

    /// Returns the error of loading a viewport's shown scene again, or of opening a list of scenes. The latter has its
    /// location in the list. `None` once a scene is loaded.
    pub fn scene_error(&self, id: RendererId) -> Option<&str> {
        self.scene_errors[opening::index(id)].as_ref().map(|(_, text)| text.as_str())
    }

    /// Returns the path of the scene whose error [`Viewer::scene_error`] returns; `None` without an error.
    fn failed_scene(&self, id: RendererId) -> Option<&Path> {
        self.scene_errors[opening::index(id)].as_ref().map(|(path, _)| path.as_path())
    }

    /// Sets the options of all later loads of scenes.
    pub fn set_load_options(&mut self, load: LoadOptions) {
        self.opening.load = load;
    }

    /// Returns the options of all loads of scenes.
    pub fn load_options(&self) -> &LoadOptions {
        &self.opening.load
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
        self.load_scene(id, path);
    }

    fn load_scene(&mut self, id: RendererId, path: &Path) {
        // This load may cancel a reload. The reload starts again afterwards, if its scene is still shown then.
        if let Some(cancelled) = self.loading(id).filter(|cancelled| *cancelled != path).map(Path::to_owned) {
            self.scene_watch.postpone(id, cancelled);
        }
        self.restored[opening::index(id)] = None;
        if id == RendererId::A {
            self.restored_cameras = None;
        }
        let former = self.scene_watch.files(id, path);
        if let Err(error) = self.opening.open_scene(id, path, former) {
            self.events.push(Event::SceneFailed { path: path.to_owned(), error, stays: false });
        }
    }

    /// Sets the stamps of the files of A's scene from before it was loaded. Without them, a write during the load would
    /// be missed.
    pub fn set_files_read(&mut self, files: Vec<Wanted>) {
        let path = self.scene_path().to_owned();
        self.follow(RendererId::A, &path, files);
    }

    fn follow(&mut self, id: RendererId, path: &Path, files: Vec<Wanted>) {
        if let Err(error) = self.scene_watch.follow(id, path, files, &self.wake) {
            self.events.push(Event::Problem { text: format!("changes are not detected: {error}") });
        }
    }

    /// Loads the changed scenes again, unless another load is running for their viewport. A file that keeps changing
    /// would otherwise restart the load forever.
    pub(super) fn reload_scenes(&mut self) {
        for id in [RendererId::A, RendererId::B] {
            if self.loading(id).is_none()
                && let Some(path) = self.scene_watch.take(id)
            {
                // Not `open_scene_in`: B keeps a scene of its own also from A's file.
                self.load_scene(id, &path);
            }
        }
    }

    /// Ends a load, successful or not: from now on, only the shown scene and one with an error are watched.
    fn settle(&mut self, id: RendererId) {
        let (shown, failed) = (self.scene_path_of(id).to_owned(), self.failed_scene(id).map(Path::to_owned));
        self.scene_watch.retain(id, &shown, failed.as_deref());
    }

    /// Makes B draw A's scene instead of its own, and cancels a load for B.
    pub fn share_scene(&mut self) {
        self.opening.cancel_scene(RendererId::B);
        self.scene_watch.forget(RendererId::B);
        self.scene_errors[opening::index(RendererId::B)] = None;
        self.leave(RendererId::B);
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
            self.scene_watch.copy_to_b();
            self.events.extend(applied.err().map(|text| Event::Problem { text }));
        }
        if let Some(other) = self.other.take() {
            let former = self.replace_subject(other);
            self.other = Some(former);
            self.scene_watch.exchange();
            self.restored.swap(0, 1);
            self.scene_errors.swap(0, 1);
            self.opening.exchange_scenes();
            self.forget_picked();
        }
    }

    /// Replaces A's scene, and returns the previous one. All cameras keep their positions in the world.
    fn replace_subject(&mut self, subject: Subject) -> Subject {
        let offset = DVec3::from(self.scene().offset());
        let former = std::mem::replace(&mut self.subject, subject);
        let scene = self.subject.whole.clone();
        self.navigation.change_scene(&scene.robust_bounds(), DVec3::from(scene.offset()) - offset);
        self.path.set_space(camera_path::length_of_radian(&scene), scene.up());
        former
    }

    pub(super) fn take_scene(&mut self, id: RendererId, opened: Opened<ReadScene>) {
        let Opened { path, number, content } = opened;
        // A loader that panicked names no files.
        let (files, scene) = content.unwrap_or_else(|error| (Vec::new(), Err(error)));
        match scene {
            Ok(OpenedScene { scene, cameras, load_ms }) => {
                self.follow(id, &path, files);
                self.scene_errors[opening::index(id)] = None;
                let (splats, notes) = (scene.count(), losses::notes(&scene));
                self.events.push(Event::Scene { path: path.clone(), splats, load_ms });
                if !notes.is_empty() {
                    self.events.push(Event::SceneNotes { path: path.clone(), notes });
                }
                let reloads = self.reloads(id, &path);
                let mut subject = Subject::new(scene, path, self.wake.clone());
                self.arrange_marks(id, &mut subject, reloads);
                if self.picked_in == id || !self.has_two_scenes() {
                    self.forget_picked();
                }
                if !reloads {
                    self.leave(id);
                }
                let hidden = &subject.marks().hidden;
                self.left.retain(|(path, left)| *path != subject.path || left != hidden);
                match id {
                    RendererId::B => self.other = Some(subject),
                    RendererId::A | RendererId::Window => self.show_scene(subject, number, cameras),
                }
            }
            Err(error) => {
                // A watched file may be missing or half written, and is then not recognised as a list.
                let stays =
                    self.reloads(id, &path) || self.failed_scene(id) == Some(&*path) || names_scenes(&path);
                let event = Event::SceneFailed { path: path.clone(), error, stays };
                if stays && !files.is_empty() {
                    self.follow(id, &path, files);
                }
                if stays {
                    let text = located(&event.to_string(), &path);
                    self.scene_errors[opening::index(id)] = Some((path, text));
                }
                self.events.push(event);
            }
        }
        self.settle(id);
    }

    /// Remembers the hidden splats of a viewport's own scene before it is replaced, if they are in no file. Reports how
    /// to get them back.
    fn leave(&mut self, id: RendererId) {
        if id == RendererId::B && !self.has_two_scenes() {
            return;
        }
        let subject = self.subject_of(id);
        let count = subject.unsaved();
        if count == 0 {
            return;
        }
        let (path, hidden) = (subject.path.clone(), subject.marks().hidden.clone());
        let name = output::one_line(&path.display().to_string()).into_owned();
        let (count, them) = (plural(count.into(), "hidden splat"), if count == 1 { "it" } else { "them" });
        let text = format!("Not saved: {count} of {name}; Undo shows the scene without {them} again");
        let told = (!self.is_saving(&path, &hidden)).then_some(Event::Problem { text });
        self.events.extend(told);
        self.left.retain(|(left, _)| *left != path);
        self.left.push((path, hidden));
    }

    /// Returns true if a scene is being loaded for A that is not the shown one.
    pub(super) fn is_loading_another(&self) -> bool {
        self.loading(RendererId::A).is_some_and(|path| !self.reloads(RendererId::A, path))
    }

    /// Gives a loaded scene its marks and its up direction: those to restore, or those of the shown scene if it was
    /// loaded again. Reports changed numbers of marked splats, then marks that were dropped.
    fn arrange_marks(&mut self, id: RendererId, subject: &mut Subject, reloads: bool) {
        let is_own = id == RendererId::A || self.has_two_scenes();
        let before = if is_own { self.marks(id).clone() } else { Marks::default() };
        let (marks, lost) = match self.restored[opening::index(id)].take() {
            Some(SceneSettings { marks, splats, up }) => {
                subject.up = up;
                let (selected, hidden) = (!marks.selected.is_empty(), !marks.hidden.is_empty());
                let is_same = splats == Some(self.splats_key(&subject.whole)) || marks.is_empty();
                let lost = LostMarks { file: subject.path.clone(), is_listed: true, selected, hidden };
                if is_same { (marks, Vec::new()) } else { (Marks::default(), vec![lost]) }
            }
            None if reloads => self.carried_marks(id, subject),
            None => Default::default(),
        };
        let refused = subject.set_marks(marks).err();
        let count = |marks: &Marks| (marks.selected.len(), marks.hidden.len());
        let (selected, hidden) = count(subject.marks());
        if count(&before) != (selected, hidden) {
            self.events.push(Event::Marked { selected, hidden });
        }
        let problems = lost.iter().map(ToString::to_string).chain(refused);
        self.events.extend(problems.map(|text| Event::Problem { text }));
    }

    /// Returns the marks for a scene that was loaded again, and those that were dropped. Dropped marks are kept: if the
    /// file becomes again what it was, its splats are marked again.
    fn carried_marks(&mut self, id: RendererId, subject: &mut Subject) -> (Marks, Vec<LostMarks>) {
        let former = self.subject_of(id);
        subject.up = former.up;
        let (before, now) = (former.parts(), subject.parts());
        let has_same_splats = |(new, old)| subject.whole.has_splats_of(new, &former.whole, old);
        let is_reindexed = before != now || !now.iter().zip(&before).all(has_same_splats);
        let former_key = self.splats_key(&former.whole);
        let key = if is_reindexed { self.splats_key(&subject.whole) } else { former_key };
        let returned = former.dropped.iter().find(|(of, _)| *of == key).map(|(_, marks)| marks.clone());
        let (marks, lost) = former.carried_marks(subject, &returned.unwrap_or_default());
        subject.dropped = former.dropped.iter().filter(|(of, _)| *of != key).cloned().collect();
        if !lost.is_empty() {
            subject.dropped.retain(|(of, _)| *of != former_key);
            subject.dropped.push((former_key, former.marks().clone()));
        }
        if key != subject.whole.identity() {
            self.moved.insert(subject.whole.identity(), key);
        }
        (marks, lost)
    }

    /// Returns true if the viewport's own scene is that at `path`: loading it again keeps the view and the marks. False
    /// for B while it shares A's scene.
    pub(in crate::view) fn reloads(&self, id: RendererId, path: &Path) -> bool {
        let is_its_own = id == RendererId::A || self.has_two_scenes();
        is_its_own && self.scene_path_of(id) == path
    }

    /// Shows the scene of request `number`. Its cameras are the first of: restored cameras, the cameras of a later
    /// request, the file beside the scene, and the file that the user named. A reloaded scene keeps the view and the
    /// cameras. So does a scene at the same place with the same cameras, such as another file of the capture.
    fn show_scene(&mut self, subject: Subject, number: u64, beside: Option<CamerasBeside>) {
        let restored = self.restored_cameras.take();
        if self.reloads(RendererId::A, &subject.path) {
            self.replace_subject(subject);
            return;
        }
        let is_later = self.cameras_number > number;
        let list = match (restored, beside) {
            (Some(list), _) => list,
            _ if is_later => self.camera_list.clone(),
            (None, Some((path, Ok(cameras)))) => {
                self.events.push(Event::Cameras { path, count: cameras.len() });
                CameraList::beside(cameras)
            }
            (None, Some((path, Err(error)))) => {
                self.events.push(Event::FileFailed { path, error });
                self.camera_list.kept()
            }
            (None, None) => self.camera_list.kept(),
        };
        let is_same = !list.cameras().is_empty() && list == self.camera_list && !is_later;
        if is_same && overlap(&subject.whole, &self.subject.whole) {
            self.replace_subject(subject);
        } else {
            self.navigation = subject.navigation(subject.scene.up());
            self.path.set_space(camera_path::length_of_radian(&subject.scene), subject.scene.up());
            self.subject = subject;
            self.set_cameras(list);
        }
        if let Some(up) = self.subject.up {
            self.set_up(up);
        }
    }
}

/// Returns true if the bounds of two scenes have a common point.
fn overlap(one: &Scene, other: &Scene) -> bool {
    let [one, other] = [one, other].map(|scene| scene.robust_bounds().in_world(scene.offset()));
    (0..3).all(|axis| one.min[axis] <= other.max[axis] && other.min[axis] <= one.max[axis])
}

/// Formats the error of a scene like those of graphs. A list of scenes gets a location: the line and column that the
/// text names, or the start of the file. Other scenes get none.
fn located(text: &str, path: &Path) -> String {
    let number = |name: &str| {
        let after = text.split_once(name)?.1;
        after.split(|c: char| !c.is_ascii_digit()).next()?.parse::<u32>().ok()
    };
    let is_list = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ron"));
    if !is_list && !names_scenes(path) {
        return format!("error: {text}");
    }
    let (line, column) = number(": line ").zip(number(", column ")).unwrap_or((1, 1));
    format!("error: {text}\n --> {}:{line}:{column}", path.display())
}
