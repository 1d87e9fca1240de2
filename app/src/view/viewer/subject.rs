//! Holds a viewport's scene: as loaded, and as drawn.
//!
//! The scene as drawn lacks the hidden splats, and its selected splats are tinted. It is a copy made on another thread,
//! so that any graph can draw it. Without marks, it is the loaded scene itself.

use crate::draw::facts;
use crate::draw::select::{Reach, Region};
use crate::draw::splat_set::SplatSet;
use crate::io::output;
use crate::view::latest::Latest;
use crate::view::navigation::Navigation;
use crate::view::renderer::Wake;
use splatgraph_assets::{Camera, SH_C0, Scene, SceneMemoryError, ScenePart, Splat};
use splatgraph_framework::source::canonical;
use std::collections::VecDeque;
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

/// Display-encoded colour of selected splats.
const TINT: [f32; 3] = [1.0, 0.62, 0.0];

/// Weight of the tint in a selected splat's colour, from 0 to 1.
const SHARE: f32 = 0.75;

/// The selected and the hidden splats of a scene. No splat is both.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Marks {
    /// The selected splats.
    pub selected: Arc<SplatSet>,
    /// The hidden splats.
    pub hidden: Arc<SplatSet>,
}

impl Marks {
    /// Returns true if no splat is selected or hidden.
    pub fn is_empty(&self) -> bool {
        self.selected.is_empty() && self.hidden.is_empty()
    }

    /// Returns the splats that are not hidden, in a scene of `count` splats.
    pub fn shown(&self, count: u32) -> SplatSet {
        SplatSet::first(count).without(&self.hidden)
    }

    /// Lists the selected and the hidden splats of a part of the scene, as indices into the part.
    fn within(&self, part: &ScenePart) -> [Vec<u32>; 2] {
        [&self.selected, &self.hidden].map(|set| {
            let marked = part.splats.clone().filter(|at| set.contains(*at));
            marked.map(|at| at - part.splats.start).collect()
        })
    }

    /// Returns the splats that are neither selected nor hidden, in a scene of `count` splats.
    pub fn rest(&self, count: u32) -> SplatSet {
        self.shown(count).without(&self.selected)
    }
}

/// Identifies the splats of a scene and their order: a number of the first scene that was loaded with them. Marks are
/// indices of splats, and have a meaning only with the same key.
pub type SplatsKey = u64;

/// The settings of a scene that can be undone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneSettings {
    /// Selected and hidden splats.
    pub marks: Marks,
    /// Key of the splats that are marked; `None` while the scene is being loaded for the first time.
    pub splats: Option<SplatsKey>,
    /// Up direction that the user chose; `None` for that of the file.
    pub up: Option<[f64; 3]>,
}

/// Marks of a file's splats that were dropped when the scene was loaded again.
pub(super) struct LostMarks {
    pub file: PathBuf,
    /// True if the scene still has the file, with other splats.
    pub is_listed: bool,
    pub selected: bool,
    pub hidden: bool,
}

impl fmt::Display for LostMarks {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let name = output::one_line(&self.file.display().to_string()).into_owned();
        match (self.is_listed, self.selected, self.hidden) {
            (true, false, _) => write!(f, "{name} changed: its hidden splats are shown again"),
            (true, true, false) => write!(f, "{name} changed: none of its splats is selected any more"),
            (true, true, true) => {
                write!(f, "{name} changed: its hidden splats are shown again, and none is selected")
            }
            (false, selected, hidden) => {
                let lost = match (selected, hidden) {
                    (true, true) => "selection and its hidden splats",
                    (true, false) => "selection",
                    (false, _) => "hidden splats",
                };
                write!(f, "{name} is no longer in the list; its {lost} went with it")
            }
        }
    }
}

/// Effect of a search result on the selection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Combine {
    /// The found splats become the selection.
    Replace,
    /// The found splats are added to the selection.
    Add,
    /// The found splats are removed from the selection.
    Remove,
}

/// Part of a scene to write to a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The selected splats.
    Selected,
    /// The splats that are neither selected nor hidden.
    Rest,
}

pub(super) struct Search {
    /// Camera of the picture, in scene coordinates.
    pub camera: Camera,
    pub region: Region,
    pub reach: Reach,
    pub combine: Combine,
}

pub(super) struct Subject {
    /// The scene as drawn, with its marks applied.
    pub scene: Arc<Scene>,
    /// The scene as loaded.
    pub whole: Arc<Scene>,
    pub path: PathBuf,
    /// Canonical path of the scene's file when it was read: without links and `..`.
    pub file: PathBuf,
    /// Up direction that the user chose for the scene; `None` if the user chose none.
    pub up: Option<[f64; 3]>,
    /// The hidden splats when the rest was last written to a file; empty before.
    pub left_out: Arc<SplatSet>,
    /// The requested marks; `scene` shows them once the marked copy is made.
    marks: Marks,
    /// Marks that were dropped when a changed file was loaded again, each with the key of its scene.
    pub dropped: Vec<(SplatsKey, Marks)>,
    maker: Latest<Arc<Scene>>,
    /// The running search for the splats of a region or of a selection file.
    pub finder: Latest<(Combine, SplatSet)>,
    /// Queued searches, oldest first.
    pub searches: VecDeque<Search>,
}

impl Subject {
    pub fn new(scene: impl Into<Arc<Scene>>, path: PathBuf, wake: Wake) -> Subject {
        let scene = scene.into();
        Subject {
            whole: scene.clone(),
            scene,
            file: canonical(&path),
            path,
            up: None,
            left_out: Arc::default(),
            marks: Marks::default(),
            dropped: Vec::new(),
            maker: Latest::new("show", wake.clone()),
            finder: Latest::new("select", wake),
            searches: VecDeque::new(),
        }
    }

    /// Creates a subject with the same scene and marks, but without searches.
    ///
    /// Also returns an error if marks are being applied, and no thread can be started to apply them to the copy.
    pub fn copied(&self, wake: Wake) -> (Subject, Result<(), String>) {
        let mut copy = Subject::new(self.whole.clone(), self.path.clone(), wake);
        copy.file.clone_from(&self.file);
        (copy.up, copy.left_out) = (self.up, self.left_out.clone());
        copy.dropped.clone_from(&self.dropped);
        copy.scene.clone_from(&self.scene);
        if self.maker.busy() {
            let applied = copy.set_marks(self.marks.clone());
            return (copy, applied);
        }
        copy.marks = self.marks.clone();
        (copy, Ok(()))
    }

    /// Creates the navigation for the scene as drawn, without cameras. The box around most splats is in view, upright
    /// with respect to `up`.
    pub fn navigation(&self, up: [f64; 3]) -> Navigation {
        let camera = Camera::framing_upright(&self.scene, up, None, facts::DEFAULT_SIZE);
        Navigation::new(&self.scene.robust_bounds(), &camera, up.into())
    }

    /// Returns the files of the scene with their splats: the entries of a list, or the scene itself.
    pub fn parts(&self) -> Vec<ScenePart> {
        match self.whole.parts() {
            [] => vec![ScenePart { file: self.path.clone(), splats: 0..self.whole.count() }],
            parts => parts.to_vec(),
        }
    }

    /// Maps the marks to a later load of the scene. A file's marks follow it to its new position in a list if it has
    /// the same splats; otherwise they are dropped, and returned. A file that a list names several times is matched in
    /// order. `former` has marks of the later load's splats from before they were dropped: a file whose splats differ
    /// from those of this scene gets its part of them.
    pub fn carried_marks(&self, new: &Subject, former: &Marks) -> (Marks, Vec<LostMarks>) {
        let (mut carried, mut lost) = ([Vec::new(), Vec::new()], Vec::new());
        let mut carry = |own: &ScenePart, marked: &[Vec<u32>; 2]| {
            for (indices, marked) in carried.iter_mut().zip(marked) {
                indices.extend(marked.iter().map(|at| at + own.splats.start));
            }
        };
        let mut left = new.parts();
        for part in self.parts() {
            let own = left.iter().position(|new| new.file == part.file).map(|at| left.remove(at));
            let marked = self.marks.within(&part);
            let returned = own.as_ref().map(|own| former.within(own)).unwrap_or_default();
            if marked.iter().chain(&returned).all(Vec::is_empty) {
                continue;
            }
            let [selected, hidden] = marked.each_ref().map(|marked| !marked.is_empty());
            match &own {
                Some(own) if new.whole.has_splats_of(own, &self.whole, &part) => carry(own, &marked),
                own => {
                    own.iter().for_each(|own| carry(own, &returned));
                    if selected || hidden {
                        let is_listed = own.is_some();
                        lost.push(LostMarks { file: part.file, is_listed, selected, hidden });
                    }
                }
            }
        }
        left.iter().for_each(|own| carry(own, &former.within(own)));
        let [selected, hidden] = carried.map(|indices| Arc::new(indices.into_iter().collect()));
        (Marks { selected, hidden }, lost)
    }

    /// Counts the hidden splats; 0 if the last file of the rest was written with the same splats hidden.
    pub fn unsaved(&self) -> u32 {
        if self.left_out == self.marks.hidden { 0 } else { self.marks.hidden.len() }
    }

    pub fn marks(&self) -> &Marks {
        &self.marks
    }

    /// Returns true while marks are being applied to the scene, or splats are searched.
    pub fn busy(&self) -> bool {
        self.maker.busy() || self.is_searching()
    }

    pub fn is_searching(&self) -> bool {
        self.finder.busy() || !self.searches.is_empty()
    }

    pub fn cancel_searches(&mut self) {
        self.finder.cancel();
        self.searches.clear();
    }

    /// Replaces the marks, and starts to build the marked scene on another thread. Without marks, the loaded scene is
    /// drawn at once. Fails, without changes, if all splats would be hidden, a mark is out of range, or the system
    /// cannot start a thread.
    pub fn set_marks(&mut self, marks: Marks) -> Result<(), String> {
        let count = self.whole.count();
        let end = marks.selected.end().max(marks.hidden.end());
        if end > count {
            return Err(format!("expected a selection of {count} splats, found one of {end} or more"));
        }
        if count > 0 && marks.hidden.len() == count {
            return Err(
                "expected a splat that stays, found that all would be hidden; nothing was hidden".to_owned()
            );
        }
        if marks == self.marks {
            return Ok(());
        }
        if marks.is_empty() {
            self.maker.cancel();
            self.scene = self.whole.clone();
        } else {
            let (whole, of) = (self.whole.clone(), marks.clone());
            self.maker.start(move |_| {
                let marked = marked(&whole, &of).map_err(|error| error.to_string());
                Some(marked.map(|scene| {
                    // Computed here rather than on the frame's thread; the scene caches it.
                    scene.identity();
                    Arc::new(scene)
                }))
            })?;
        }
        self.marks = marks;
        Ok(())
    }

    /// Takes the marked scene once it is made. If it cannot be made, for example for lack of memory, drops all marks
    /// and returns the error.
    pub fn take_drawn(&mut self) -> Result<(), String> {
        match self.maker.take() {
            None => {}
            Some(Ok(drawn)) => self.scene = drawn,
            Some(Err(error)) => {
                self.marks = Marks::default();
                self.scene = self.whole.clone();
                return Err(error);
            }
        }
        Ok(())
    }
}

fn marked(whole: &Scene, marks: &Marks) -> Result<Scene, SceneMemoryError> {
    let shown = marks.shown(whole.count()).indices();
    whole.picked_as(&shown, |index, splat| if marks.selected.contains(index) { tinted(splat) } else { splat })
}

fn tinted(mut splat: Splat) -> Splat {
    for (at, value) in splat.sh.iter_mut().enumerate() {
        let tint = if at < 3 { (TINT[at] - 0.5) / SH_C0 as f32 } else { 0.0 };
        *value += SHARE * (tint - *value);
    }
    splat
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;

    fn set(indices: &[u32]) -> Arc<SplatSet> {
        Arc::new(indices.iter().copied().collect())
    }

    #[test]
    fn the_scene_as_drawn_lacks_hidden_splats_and_tints_selected_ones() {
        let whole = synth::generate("uniform", 100, 2).unwrap();
        let marks = Marks { selected: set(&[5]), hidden: set(&[0, 3, 99]) };
        let drawn = marked(&whole, &marks).unwrap();
        assert_eq!(drawn.count(), 97);
        for (at, index) in (0..100).filter(|index| ![0, 3, 99].contains(index)).enumerate() {
            let (expected, found) = (whole.splat(index), drawn.splat(at));
            if index == 5 {
                assert_eq!(found, tinted(expected));
                assert_eq!((found.position, found.opacity), (expected.position, expected.opacity));
                assert!(found.sh != expected.sh);
            } else {
                assert_eq!(found.sh, expected.sh);
            }
        }
    }

    #[test]
    fn marks_of_another_scene_and_those_that_hide_everything_are_refused() {
        let mut subject =
            Subject::new(synth::generate("uniform", 10, 0).unwrap(), "a.ply".into(), Arc::new(|| {}));
        let loaded = subject.scene.clone();
        let marks = |selected: &[u32], hidden: &[u32]| Marks { selected: set(selected), hidden: set(hidden) };
        let all: Vec<u32> = (0..10).collect();
        for (wrong, expected) in [
            (marks(&[10], &[]), "expected a selection of 10 splats"),
            (marks(&[], &[64]), "found one of 65 or more"),
            (marks(&[], &all), "expected a splat that stays"),
        ] {
            let error = subject.set_marks(wrong).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        assert!(subject.marks().is_empty() && !subject.busy());
        subject.set_marks(marks(&[1], &[2])).unwrap();
        while subject.busy() {
            subject.take_drawn().unwrap();
        }
        assert_eq!(subject.scene.count(), 9);
        subject.set_marks(Marks::default()).unwrap();
        assert!(Arc::ptr_eq(&subject.scene, &loaded), "without marks, the loaded scene is drawn");
    }
}
