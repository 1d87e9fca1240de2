//! Undoes and redoes the user's changes.
//!
//! These are changes of scene, selectable cameras, selected and hidden splats, up direction, graphs, parameters,
//! comparison, background, resolution, saved views and camera path.
//!
//! After each frame, the viewer's [`Settings`] are compared with the previous frame's. A change becomes a step once no
//! mouse button is held. Changes by the program itself, such as dropping a parameter that a new graph lacks, become
//! part of the previous step.

use super::cameras::Views;
use super::events::RendererId;
use super::paint::Mode;
use super::renderer::Choice;
use super::viewer::{CameraList, Marks, SceneSettings, Viewer};
use crate::draw::camera_path::PathSettings;
use crate::draw::splat_set::SplatSet;
use std::path::{Path, PathBuf};

const STEPS: usize = 200;

/// The undoable settings of a viewer.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    scene: PathBuf,
    /// Path of B's scene, if B has its own.
    other: Option<PathBuf>,
    cameras: CameraList,
    /// Settings of A's and of B's scene.
    sides: [SceneSettings; 2],
    a: Choice,
    b: Option<Choice>,
    compare: Mode,
    background: [f32; 3],
    scale: f32,
    views: Views,
    path: PathSettings,
}

impl Settings {
    /// Returns the settings of a viewer. A scene that is being loaded counts as loaded.
    pub fn of(viewer: &Viewer) -> Settings {
        let own = viewer.has_two_scenes().then(|| viewer.scene_path_of(RendererId::B));
        let other = viewer.loading(RendererId::B).or(own);
        let side_b = other.map(|_| viewer.scene_settings(RendererId::B)).unwrap_or_default();
        Settings {
            sides: [viewer.scene_settings(RendererId::A), side_b],
            scene: viewer.loading(RendererId::A).unwrap_or(viewer.scene_path()).to_owned(),
            other: other.map(Path::to_owned),
            cameras: viewer.camera_list().clone(),
            a: viewer.a.renderer.choice().clone(),
            b: viewer.b.as_ref().map(|b| b.renderer.choice().clone()),
            compare: viewer.compare,
            background: viewer.background,
            scale: viewer.scale,
            views: viewer.views.clone(),
            path: viewer.path.settings().clone(),
        }
    }

    /// Returns these settings without the selected and hidden splats.
    pub fn without_marks(self) -> Settings {
        let sides = self.sides.map(|side| SceneSettings { up: side.up, ..SceneSettings::default() });
        Settings { sides, ..self }
    }

    /// Applies these settings to a viewer, where they differ from its own.
    fn apply(&self, viewer: &mut Viewer) {
        let mut now = Settings::of(viewer);
        if now.scene != self.scene && now.other.as_ref() == Some(&self.scene) {
            // The scenes were exchanged, so neither has to be loaded again.
            viewer.exchange();
            now = Settings::of(viewer);
        }
        if now.scene != self.scene {
            viewer.open_scene_in(RendererId::A, &self.scene);
        }
        viewer.restore_cameras(self.cameras.clone());
        match &self.other {
            other if *other == now.other => {}
            Some(path) => viewer.open_scene_in(RendererId::B, path),
            None => viewer.share_scene(),
        }
        for (id, side) in [RendererId::A, RendererId::B].into_iter().zip(&self.sides) {
            viewer.restore_settings(id, side);
        }
        if now.compare != self.compare {
            viewer.choose_compare(self.compare);
        }
        (viewer.background, viewer.scale) = (self.background, self.scale);
        viewer.views.clone_from(&self.views);
        viewer.path.restore(&self.path);
        for (id, side) in [(RendererId::A, Some(&self.a)), (RendererId::B, self.b.as_ref())] {
            if let (Some(side), Some(viewport)) = (side, viewer.viewport(id)) {
                let renderer = &mut viewport.renderer;
                if renderer.graph() != side.graph {
                    renderer.choose(&side.graph, side.set.clone());
                } else {
                    renderer.replace_set(&side.set);
                }
            }
        }
    }

    /// Describes a change to other settings, such as `digit_bits`, `graph splat → tiled` or `5 settings`; empty without
    /// one.
    fn difference(&self, other: &Settings) -> String {
        let mut parts: Vec<String> = Vec::new();
        if self.scene != other.scene || self.other != other.other {
            parts.push("scene".to_owned());
        } else if self.cameras != other.cameras {
            parts.push("cameras".to_owned());
        } else if self.sides.iter().zip(&other.sides).any(|(a, b)| a.up != b.up) {
            parts.push("up direction".to_owned());
        }
        let differs = |of: fn(&Marks) -> &SplatSet| {
            self.sides.iter().zip(&other.sides).any(|(a, b)| of(&a.marks) != of(&b.marks))
        };
        if differs(|marks| &marks.hidden) {
            parts.push("hidden splats".to_owned());
        } else if differs(|marks| &marks.selected) {
            parts.push("selected splats".to_owned());
        }
        for (a, b) in [(Some(&self.a), Some(&other.a)), (self.b.as_ref(), other.b.as_ref())] {
            let (Some(a), Some(b)) = (a, b) else { continue };
            if a.graph != b.graph {
                parts.push(format!("graph {} → {}", a.graph, b.graph));
                continue;
            }
            let names = a.set.keys().chain(b.set.keys().filter(|name| !a.set.contains_key(*name)));
            parts.extend(names.filter(|name| a.set.get(*name) != b.set.get(*name)).cloned());
        }
        if self.compare != other.compare {
            parts.push("comparison".to_owned());
        }
        if self.background != other.background {
            parts.push("background".to_owned());
        }
        if self.scale != other.scale {
            parts.push("scale".to_owned());
        }
        if self.views != other.views {
            parts.push("saved views".to_owned());
        }
        if self.path != other.path {
            parts.push("camera path".to_owned());
        }
        match parts.len() {
            0..=3 => parts.join(", "),
            n => format!("{n} settings"),
        }
    }
}

/// Steps that can be undone and redone.
#[derive(Debug, Default)]
pub struct History {
    past: Vec<Settings>,
    now: Option<Settings>,
    future: Vec<Settings>,
}

impl History {
    /// Records the settings after a frame. If they changed, adds a step and drops the steps to redo. With `by_program`,
    /// the program made the change: it becomes part of the previous step.
    pub fn observe(&mut self, settings: Settings, by_program: bool) {
        let Some(now) = &mut self.now else {
            self.now = Some(settings);
            return;
        };
        if *now == settings {
            return;
        }
        let former = std::mem::replace(now, settings);
        if !by_program {
            self.future.clear();
            if self.past.len() == STEPS {
                self.past.remove(0);
            }
            self.past.push(former);
        }
    }

    #[cfg(test)]
    pub(in crate::view) fn steps(&self) -> usize {
        self.past.len()
    }

    /// Returns true if there is a step to undo.
    pub fn can_undo(&self) -> bool {
        !self.past.is_empty()
    }

    /// Returns true if there is a step to redo.
    pub fn can_redo(&self) -> bool {
        !self.future.is_empty()
    }

    /// Undoes the newest step that has an effect. Returns a description of the change; `None` if there is none. Drops
    /// steps without effect, such as a change of a parameter that the file no longer declares.
    pub fn undo(&mut self, viewer: &mut Viewer) -> Option<String> {
        go(&mut self.past, &mut self.now, &mut self.future, viewer)
    }

    /// Redoes the last undone step that has an effect. Returns a description of the change; `None` if there is none.
    pub fn redo(&mut self, viewer: &mut Viewer) -> Option<String> {
        go(&mut self.future, &mut self.now, &mut self.past, viewer)
    }
}

/// Applies the last settings of `steps` that have an effect, and drops those without. The former settings become a step
/// of `back`. Returns a description of the change; `None` if no settings had an effect.
fn go(
    steps: &mut Vec<Settings>,
    now: &mut Option<Settings>,
    back: &mut Vec<Settings>,
    viewer: &mut Viewer,
) -> Option<String> {
    while let (Some(to), Some(former)) = (steps.pop(), now.clone()) {
        to.apply(viewer);
        // Settings that could not be applied, such as B without a device, must not appear as a new step.
        let reached = Settings::of(viewer);
        let text = former.difference(&reached);
        *now = Some(reached);
        if !text.is_empty() {
            back.push(former);
            return Some(text);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::camera_path::CameraPath;

    fn settings(graph: &str, set: &[(&str, &str)]) -> Settings {
        let set = set.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        Settings {
            other: None,
            cameras: CameraList::default(),
            sides: Default::default(),
            scene: "scene.ply".into(),
            a: Choice { graph: graph.to_owned(), set },
            b: None,
            compare: Mode::A,
            background: [0.0; 3],
            scale: 1.0,
            views: Views::default(),
            path: CameraPath::new(1.0, [0.0; 3]).settings().clone(),
        }
    }

    #[test]
    fn a_step_names_what_it_changed() {
        let (plain, narrow) = (settings("splat", &[]), settings("splat", &[("digit_bits", "4")]));
        assert_eq!(plain.difference(&narrow), "digit_bits");
        assert_eq!(settings("tiled", &[]).difference(&narrow), "graph tiled → splat");
    }

    #[test]
    fn what_the_program_changes_by_itself_is_no_step() {
        let mut history = History::default();
        history.observe(settings("splat", &[("budget", "0.5")]), false);
        history.observe(settings("unsorted", &[("budget", "0.5")]), false);
        history.observe(settings("unsorted", &[]), true);
        assert_eq!(history.past.len(), 1);
        history.observe(settings("unsorted", &[]), false);
        assert_eq!(history.past.len(), 1, "nothing changed");
        for step in 0..STEPS + 5 {
            history.observe(settings("unsorted", &[("n", &step.to_string())]), false);
        }
        assert_eq!(history.past.len(), STEPS);
    }
}
