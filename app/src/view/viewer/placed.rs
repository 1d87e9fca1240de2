//! Watches placement files, which place several scenes in one world. A changed file is loaded again; the camera stays.

use crate::view::events::RendererId;
use crate::view::opening;
use crate::view::renderer::Wake;
use splatgraph_framework::reload::{Content, Wanted, Watcher};
use std::path::{Path, PathBuf};

#[derive(Default)]
pub(super) struct PlacedFiles {
    /// `None` until the first file is watched.
    watcher: Option<Watcher>,
    /// Placement files of A and B, with their contents when last read.
    wanted: [Option<Wanted>; 2],
}

impl PlacedFiles {
    /// Watches a viewport's scene file from now on, if it is a placement file; stops watching the previous one.
    pub fn follow(&mut self, id: RendererId, path: &Path, wake: &Wake) -> std::io::Result<()> {
        let places = splatgraph_assets::names_scenes(path);
        let wanted = places.then(|| Wanted { path: path.to_owned(), content: Content::at(path) });
        if wanted.is_none() && self.watcher.is_none() {
            return Ok(());
        }
        self.wanted[opening::index(id)] = wanted;
        let watcher = match &mut self.watcher {
            Some(watcher) => watcher,
            none => {
                let wake = wake.clone();
                none.insert(Watcher::new(move || wake())?)
            }
        };
        let all: Vec<Wanted> = self.wanted.iter().flatten().cloned().collect();
        watcher.watch(&all);
        Ok(())
    }

    /// Returns true if the placement file at `path` is watched for a viewport.
    pub fn follows(&self, id: RendererId, path: &Path) -> bool {
        self.wanted[opening::index(id)].as_ref().is_some_and(|wanted| wanted.path == path)
    }

    pub fn exchange(&mut self) {
        self.wanted.swap(0, 1);
    }

    /// Takes the watched files that changed since the last call.
    pub fn take(&mut self) -> Vec<PathBuf> {
        self.watcher.as_mut().and_then(Watcher::take).map_or_else(Vec::new, |change| change.files)
    }
}
