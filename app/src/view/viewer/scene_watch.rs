//! Watches the files of the shown scenes. A changed scene is loaded again; the camera stays.

use crate::view::events::RendererId;
use crate::view::opening;
use crate::view::renderer::Wake;
use splatgraph_framework::reload::{Wanted, Watcher};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

#[derive(Default)]
pub(super) struct SceneWatch {
    /// Watcher of the files; `None` until the first file is watched.
    watcher: Option<Watcher>,
    /// Scenes of A and B.
    scenes: [Watched; 2],
}

/// A viewport's watched scenes: the shown one, and the one whose error is shown.
#[derive(Clone, Default)]
struct Watched {
    /// Files of each scene, with their stamps from before the load.
    files: BTreeMap<PathBuf, Vec<Wanted>>,
    /// Scenes with a changed file.
    changed: BTreeSet<PathBuf>,
}

impl SceneWatch {
    /// Watches the files of a scene. `files` has their stamps from before the load, so a write during the load counts
    /// as a change.
    ///
    /// # Errors
    /// The watcher cannot be started.
    pub fn follow(
        &mut self,
        id: RendererId,
        path: &Path,
        files: Vec<Wanted>,
        wake: &Wake,
    ) -> std::io::Result<()> {
        self.scenes[opening::index(id)].files.insert(path.to_owned(), files);
        if self.watcher.is_none() {
            let wake = wake.clone();
            self.watcher = Some(Watcher::of_large_files(move || wake())?);
        }
        self.watch();
        Ok(())
    }

    /// Stops watching a viewport's scenes, except `shown` and `failed`.
    pub fn retain(&mut self, id: RendererId, shown: &Path, failed: Option<&Path>) {
        let Watched { files, changed } = &mut self.scenes[opening::index(id)];
        files.retain(|path, _| path == shown || Some(path.as_path()) == failed);
        changed.retain(|path| files.contains_key(path));
        self.watch();
    }

    /// Returns the paths of the watched files of a scene; empty if it is not watched.
    pub fn files(&self, id: RendererId, path: &Path) -> Vec<PathBuf> {
        let files = self.scenes[opening::index(id)].files.get(path).into_iter().flatten();
        files.map(|file| file.path.clone()).collect()
    }

    /// Counts a watched scene as changed again, because the load that its change started was cancelled.
    pub fn postpone(&mut self, id: RendererId, path: PathBuf) {
        let scenes = &mut self.scenes[opening::index(id)];
        if scenes.files.contains_key(&path) {
            scenes.changed.insert(path);
        }
    }

    /// Stops watching all scenes of a viewport.
    pub fn forget(&mut self, id: RendererId) {
        self.scenes[opening::index(id)] = Watched::default();
        self.watch();
    }

    pub fn exchange(&mut self) {
        self.scenes.swap(0, 1);
    }

    /// Watches A's scene for B, too, after B got a copy of it.
    pub fn copy_to_b(&mut self) {
        let [a, b] = &mut self.scenes;
        b.files.extend(a.files.clone());
    }

    /// Takes the path of one changed scene of a viewport; `None` if none has changed since it was loaded.
    pub fn take(&mut self, id: RendererId) -> Option<PathBuf> {
        let change = self.watcher.as_mut().and_then(Watcher::take);
        let changed = change.map_or_else(BTreeSet::new, |change| change.files.into_iter().collect());
        for Watched { files, changed: scenes } in &mut self.scenes {
            let has_changed = |files: &[Wanted]| files.iter().any(|file| changed.contains(&file.path));
            let paths = files.iter().filter(|(_, files)| has_changed(files)).map(|(path, _)| path.clone());
            scenes.extend(paths);
        }
        self.scenes[opening::index(id)].changed.pop_first()
    }

    fn watch(&mut self) {
        let Some(watcher) = &mut self.watcher else { return };
        let files = self.scenes.iter().flat_map(|scenes| scenes.files.values().flatten());
        watcher.watch(&files.cloned().collect::<Vec<_>>());
    }
}
