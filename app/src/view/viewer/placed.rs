//! Watches lists of scenes (`.ron`), which place several scenes in one world. A changed list is loaded again; the
//! camera stays.

use crate::view::events::RendererId;
use crate::view::opening;
use crate::view::renderer::Wake;
use splatgraph_framework::reload::{Content, Wanted, Watcher};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[derive(Default)]
pub(super) struct PlacedFiles {
    /// `None` until the first file is watched.
    watcher: Option<Watcher>,
    /// Lists of scenes of A and B.
    lists: [Lists; 2],
}

/// A viewport's watched lists of scenes: the shown one, the one whose error is shown, and any that are being loaded.
#[derive(Clone, Default)]
struct Lists {
    /// Contents when last read.
    read: BTreeMap<PathBuf, Content>,
    /// A file that changed while another scene was being loaded.
    postponed: Option<PathBuf>,
}

impl PlacedFiles {
    /// Watches a scene file that is about to be loaded, if it is a list of scenes.
    ///
    /// The file on the screen stays watched until [`PlacedFiles::settle`], because the load may fail. Returns an error
    /// if no watcher can be started.
    pub fn follow(&mut self, id: RendererId, path: &Path, wake: &Wake) -> std::io::Result<()> {
        // A watched file may be missing or half written, and is then not recognised.
        if !self.follows(id, path) && !splatgraph_assets::names_scenes(path) {
            return Ok(());
        }
        self.lists[opening::index(id)].read.insert(path.to_owned(), Content::at(path));
        if self.watcher.is_none() {
            let wake = wake.clone();
            self.watcher = Some(Watcher::new(move || wake())?);
        }
        self.watch();
        Ok(())
    }

    /// Sets the contents that a watched file had when it was read. If the contents differ by now, the file counts as
    /// changed.
    pub fn read_as(&mut self, id: RendererId, path: &Path, content: Content) {
        if let Some(read) = self.lists[opening::index(id)].read.get_mut(path) {
            *read = content;
            self.watch();
        }
    }

    /// Stops watching a viewport's files after a load, except `shown` and `failed`. Returns which of the two changed
    /// while another scene was loaded; `None` if neither did.
    pub fn settle(&mut self, id: RendererId, shown: &Path, failed: Option<&Path>) -> Option<PathBuf> {
        let lists = &mut self.lists[opening::index(id)];
        lists.read.retain(|path, _| path == shown || Some(path.as_path()) == failed);
        let changed = lists.postponed.take().filter(|path| lists.read.contains_key(path));
        self.watch();
        changed
    }

    /// Stops watching all files of a viewport.
    pub fn forget(&mut self, id: RendererId) {
        self.lists[opening::index(id)] = Lists::default();
        self.watch();
    }

    /// Returns true if the list of scenes at `path` is watched for a viewport.
    pub fn follows(&self, id: RendererId, path: &Path) -> bool {
        self.lists[opening::index(id)].read.contains_key(path)
    }

    /// Records that a file changed while another scene is being loaded for the viewport.
    pub fn postpone(&mut self, id: RendererId, path: PathBuf) {
        self.lists[opening::index(id)].postponed = Some(path);
    }

    pub fn exchange(&mut self) {
        self.lists.swap(0, 1);
    }

    /// Watches A's files for B, too, after B got a copy of A's scene.
    pub fn copy_to_b(&mut self) {
        let [a, b] = &mut self.lists;
        b.read.extend(a.read.clone());
    }

    /// Takes the watched files that changed since the last call.
    pub fn take(&mut self) -> Vec<PathBuf> {
        self.watcher.as_mut().and_then(Watcher::take).map_or_else(Vec::new, |change| change.files)
    }

    fn watch(&mut self) {
        let Some(watcher) = &mut self.watcher else { return };
        let read = self.lists.iter().flat_map(|lists| &lists.read);
        let wanted = |(path, content): (&PathBuf, &Content)| Wanted { path: path.clone(), content: *content };
        watcher.watch(&read.map(wanted).collect::<Vec<_>>());
    }
}
