//! Selects, hides and writes splats of the viewer's scenes.

use super::Viewer;
use super::subject::{Combine, Marks, Part, SceneSettings, Search, SplatsKey, Subject};
use crate::draw::select::{Reach, Region, select};
use crate::draw::splat_set::{Masked, SplatSet};
use crate::view::events::{Event, RendererId};
use crate::view::export::Written;
use crate::view::opening;
use splatgraph_assets::Scene;
use std::path::{Path, PathBuf};
use std::sync::Arc;

impl Viewer {
    /// Returns the selected and hidden splats of a viewport's scene, as indices into the scene as loaded.
    pub fn marks(&self, id: RendererId) -> &Marks {
        self.subject_of(id).marks()
    }

    /// Returns a viewport's scene as loaded, without its marks.
    pub fn loaded(&self, id: RendererId) -> &Scene {
        &self.subject_of(id).whole
    }

    /// Selects and hides splats. The picture follows once another thread has made the marked scene.
    ///
    /// Marks that do not fit the scene, or that hide all splats, are rejected with an event. A change of the hidden
    /// splats drops the picked splats.
    pub fn set_marks(&mut self, id: RendererId, marks: Marks) {
        if *self.marks(id) == marks {
            return;
        }
        let hides = self.marks(id).hidden != marks.hidden;
        if let Err(text) = self.subject_mut(id).set_marks(marks) {
            return self.events.push(Event::Problem { text });
        }
        if hides {
            self.forget_picked();
        }
        self.tell_marks(id);
    }

    fn tell_marks(&mut self, id: RendererId) {
        let marks = self.marks(id);
        let (selected, hidden) = (marks.selected.len(), marks.hidden.len());
        self.events.push(Event::Marked { selected, hidden });
    }

    /// Searches on another thread for the splats in a region of a viewport's picture, and changes the selection.
    ///
    /// Searches run one after another. A search with [`Combine::Replace`] cancels all earlier ones.
    /// [`crate::draw::select`] defines which splats are in a region.
    pub fn select(&mut self, id: RendererId, region: Region, reach: Reach, combine: Combine) {
        let search = Search { camera: self.picture_camera_of(id), region, reach, combine };
        let subject = self.subject_mut(id);
        if combine == Combine::Replace {
            subject.cancel_searches();
        }
        subject.searches.push_back(search);
        self.search(id);
    }

    /// Reads a selection file on another thread, and selects its splats that are not hidden. Cancels all searches.
    pub(super) fn select_from(&mut self, id: RendererId, path: &Path) {
        let subject = self.subject_mut(id);
        subject.cancel_searches();
        let (scene, path) = (subject.whole.clone(), path.to_owned());
        let work = move |_: &(dyn Fn() -> bool + Sync)| {
            Some(SplatSet::read(&path, &scene).map(|found| (Combine::Replace, found)))
        };
        if let Err(text) = subject.finder.start(work) {
            self.events.push(Event::Problem { text });
        }
    }

    pub(in crate::view) fn cancel_searches(&mut self, id: RendererId) {
        self.subject_mut(id).cancel_searches();
    }

    fn search(&mut self, id: RendererId) {
        let subject = self.subject_mut(id);
        if subject.finder.busy() {
            return;
        }
        let Some(Search { camera, region, reach, combine }) = subject.searches.pop_front() else { return };
        let (scene, hidden) = (subject.whole.clone(), subject.marks().hidden.clone());
        let work = move |cancelled: &(dyn Fn() -> bool + Sync)| {
            let masked = Masked { scene: &scene, hidden: &hidden };
            Some(Ok((combine, select(&masked, &camera, &region, reach, cancelled)?)))
        };
        if let Err(text) = self.subject_mut(id).finder.start(work) {
            self.events.push(Event::Problem { text });
        }
    }

    /// Returns true while a viewport's splats in a region or in a selection file are being searched.
    pub fn is_selecting(&self, id: RendererId) -> bool {
        self.subject_of(id).is_searching()
    }

    /// Inverts the selection among the splats that are not hidden.
    pub fn invert_selection(&mut self, id: RendererId) {
        let (marks, count) = (self.marks(id).clone(), self.loaded(id).count());
        self.set_marks(id, Marks { selected: Arc::new(marks.rest(count)), ..marks });
    }

    /// Selects all splats that are not hidden, in view or not.
    pub fn select_all(&mut self, id: RendererId) {
        let (marks, count) = (self.marks(id).clone(), self.loaded(id).count());
        self.set_marks(id, Marks { selected: Arc::new(marks.shown(count)), ..marks });
    }

    /// Clears the selection, and cancels all searches.
    pub fn clear_selection(&mut self, id: RendererId) {
        self.cancel_searches(id);
        let hidden = self.marks(id).hidden.clone();
        self.set_marks(id, Marks { hidden, ..Marks::default() });
    }

    /// Hides the selected splats, and clears the selection.
    pub fn hide_selected(&mut self, id: RendererId) {
        let Marks { selected, hidden } = self.marks(id);
        let hidden = Arc::new(hidden.with(selected));
        self.set_marks(id, Marks { hidden, ..Marks::default() });
    }

    /// Shows all hidden splats; the selection stays.
    pub fn show_all(&mut self, id: RendererId) {
        let selected = self.marks(id).selected.clone();
        self.set_marks(id, Marks { selected, ..Marks::default() });
    }

    /// Writes a part of a viewport's scene to a new file on another thread; returns true if writing began.
    ///
    /// A `.json` file gets the splats' indices; any other extension selects a scene format. The result is reported as
    /// an event.
    pub fn export(&mut self, id: RendererId, part: Part, path: &Path) -> bool {
        let subject = self.subject_of(id);
        let marks = subject.marks();
        let splats = match part {
            Part::Selected => marks.selected.clone(),
            Part::Rest => Arc::new(marks.rest(subject.whole.count())),
        };
        let (scene, up, hidden) = (subject.whole.clone(), subject.up, marks.hidden.clone());
        if let Err(error) = self.exporter.start(scene, splats, up, path) {
            self.events.push(Event::FileFailed { path: path.to_owned(), error });
            return false;
        }
        self.saving = (part == Part::Rest).then(|| (self.scene_path_of(id).to_owned(), hidden));
        true
    }

    /// Returns true if a file without the hidden splats of a scene is being written.
    pub(super) fn is_saving(&self, path: &Path, hidden: &SplatSet) -> bool {
        self.saving.as_ref().is_some_and(|(of, left_out)| of == path && **left_out == *hidden)
    }

    /// Describes the file that is being written; `None` if there is none.
    pub fn exporting(&self) -> Option<String> {
        self.exporter.progress()
    }

    /// Returns the key of a loaded scene's splats. A scene that was loaded again with the same splats in the same order
    /// has the key from before, even if the splats have moved.
    pub(super) fn splats_key(&self, whole: &Scene) -> SplatsKey {
        let identity = whole.identity();
        self.moved.get(&identity).copied().unwrap_or(identity)
    }

    /// Restores the settings of a viewport's scene: now, or once the scene is loaded if another is being loaded. The
    /// marks are restored only if the scene has the splats of then.
    pub(in crate::view) fn restore_settings(&mut self, id: RendererId, settings: &SceneSettings) {
        // A scene that is loaded again carries its marks over.
        if self.loading(id).is_some_and(|path| !self.reloads(id, path)) {
            self.restored[opening::index(id)] = Some(settings.clone());
        } else if id == RendererId::A || self.has_two_scenes() {
            self.cancel_searches(id);
            if settings.splats == Some(self.splats_key(self.loaded(id))) {
                self.set_marks(id, settings.marks.clone());
            }
            self.restore_up(id, settings.up);
        }
    }

    /// Returns the settings of a viewport's scene, also while it is being loaded; a changed file may lose the marks.
    pub(in crate::view) fn scene_settings(&self, id: RendererId) -> SceneSettings {
        match (self.loading(id), &self.restored[opening::index(id)]) {
            (Some(_), Some(restored)) => restored.clone(),
            (Some(path), None) if !self.reloads(id, path) => SceneSettings::default(),
            _ => {
                let Subject { whole, up, .. } = self.subject_of(id);
                SceneSettings { marks: self.marks(id).clone(), splats: Some(self.splats_key(whole)), up: *up }
            }
        }
    }

    pub(super) fn take_splats(&mut self) {
        for id in [RendererId::A, RendererId::B] {
            let subject = self.subject_mut(id);
            match subject.finder.take() {
                None => {}
                Some(Ok((combine, found))) => {
                    let Marks { selected, hidden } = subject.marks().clone();
                    let found = found.without(&hidden);
                    let selected = match combine {
                        Combine::Replace => found,
                        Combine::Add => selected.with(&found),
                        Combine::Remove => selected.without(&found),
                    };
                    self.set_marks(id, Marks { selected: Arc::new(selected), hidden });
                }
                Some(Err(text)) => self.events.push(Event::Problem { text }),
            }
            if let Err(text) = self.subject_mut(id).take_drawn() {
                self.events.push(Event::Problem { text });
                self.tell_marks(id);
            }
            self.search(id);
        }
        if let Some(event) = self.exporter.take().map(exported) {
            if let Some(saved) = self.saving.take()
                && matches!(event, Event::Exported { .. })
            {
                self.left.retain(|left| *left != saved);
                let subjects = [Some(&mut self.subject), self.other.as_mut()].into_iter().flatten();
                let of_scene = subjects.filter(|subject| subject.path == saved.0);
                of_scene.for_each(|subject| subject.left_out = saved.1.clone());
            }
            self.events.push(event);
        }
    }

    /// Waits for the file that is being written, and returns the event of its end; `None` without a file.
    pub(in crate::view) fn finish_export(&mut self) -> Option<Event> {
        self.exporter.wait().map(exported)
    }
}

fn exported((path, result): (PathBuf, Result<Written, String>)) -> Event {
    match result {
        Ok(Written { splats, bytes, tags, lost }) => Event::Exported { path, splats, bytes, tags, lost },
        Err(error) => Event::FileFailed { path, error },
    }
}
