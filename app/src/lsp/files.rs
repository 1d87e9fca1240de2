//! Finds the graphs that may use a file, and provides the facts to build them with.

use crate::draw::facts::{self, SceneFacts};
use crate::draw::requirements::Case;
use splatgraph_framework::ir::Catalog;
use splatgraph_framework::source;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Names of the folders whose graphs and shaders the folders beside them may use.
const LIBRARIES: [&str; 2] = ["pipelines", "shaders"];

/// Subgroup sizes for which graphs are built: the usual ones of GPUs and of CPUs.
pub const LANES: [u32; 2] = [facts::USUAL_SUBGROUP_SIZE, 8];

pub fn is_graph(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "ron")
}

pub fn nominal_case(lanes: u32) -> Case {
    let device = facts::portable_device(lanes);
    Case { device, scene: SceneFacts::NOMINAL, size: facts::DEFAULT_SIZE }
}

/// Lists the imports that graphs may use. They come from a nominal scene and, with the feature `window`, from the
/// viewer's window.
pub fn nominal_catalog() -> Catalog {
    #[cfg_attr(not(feature = "window"), expect(unused_mut))]
    let mut catalog = facts::nominal_catalog();
    #[cfg(feature = "window")]
    crate::view::paint::offer(&mut catalog);
    catalog
}

/// Resolves the links and `..` in an absolute path as the framework does. Returns relative paths, which built-in files
/// have, unchanged.
pub fn canonical(path: &Path) -> PathBuf {
    if path.is_absolute() { source::canonical(path) } else { path.to_owned() }
}

/// A search for the graphs that may use files. It lists a folder again only if more levels below it are needed.
///
/// A graph may use the files below its own folder, and those in the folders `pipelines` and `shaders` that are around
/// or beside its own. Therefore, the whole disk need not be searched. Files in a folder given by `--include-root` may
/// be used from anywhere, so for these, the folders that are open in the editor are searched, too.
#[derive(Default)]
pub struct Search {
    include_roots: Vec<PathBuf>,
    folders: Vec<PathBuf>,
    /// Listed folders, each with the number of levels below it that were also listed.
    listed: BTreeMap<PathBuf, usize>,
}

impl Search {
    pub fn new(include_roots: &[PathBuf], folders: &[PathBuf]) -> Search {
        let include_roots = include_roots.iter().map(|root| source::canonical(root)).collect();
        Search { include_roots, folders: folders.to_vec(), listed: BTreeMap::new() }
    }

    /// Lists the graphs that may use the file at a canonical path. Leaves out folders that were listed before. May list
    /// a graph twice.
    pub fn users_of(&mut self, file: &Path) -> Vec<PathBuf> {
        let mut found = Vec::new();
        for folder in file.ancestors().skip(1) {
            self.list(folder, 0, &mut found);
            let is_library =
                folder.file_name().is_some_and(|name| LIBRARIES.iter().any(|other| name == *other));
            if let Some(project) = folder.parent().filter(|_| is_library) {
                self.list(project, 1, &mut found);
                LIBRARIES.iter().for_each(|name| self.list(&project.join(name), usize::MAX, &mut found));
            }
        }
        if self.include_roots.iter().any(|root| file.starts_with(root)) {
            self.folders.clone().iter().for_each(|folder| self.list(folder, usize::MAX, &mut found));
        }
        found
    }

    /// Adds the graphs in a folder, and in the folders at most `levels` below it. Does not follow links to folders.
    fn list(&mut self, folder: &Path, levels: usize, found: &mut Vec<PathBuf>) {
        if self.listed.get(folder).is_some_and(|listed| *listed >= levels) {
            return;
        }
        self.listed.insert(folder.to_owned(), levels);
        let Ok(entries) = std::fs::read_dir(folder) else { return };
        for entry in entries.flatten() {
            let path = entry.path();
            match entry.file_type() {
                Ok(kind) if kind.is_dir() && levels > 0 => self.list(&path, levels - 1, found),
                Ok(_) if is_graph(&path) && path.is_file() => found.push(canonical(&path)),
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn users_of_a_file_stand_in_the_folders_above_it_and_around_its_library() {
        let folder = tempfile::tempdir().expect("a folder");
        let root = folder.path().canonicalize().expect("there");
        for name in [
            "pipelines/top.ron",
            "pipelines/.parts/a/b/c/d/e/f/part.ron",
            "views/window.ron",
            "views/below/far.ron",
            "shaders/sort/scan.comp",
            ".deep/1/2/3/4/5/6/7/top.ron",
            ".deep/1/2/3/4/5/6/7/lib/blur.comp",
        ] {
            std::fs::create_dir_all(root.join(name).parent().expect("a folder")).expect("writable");
            std::fs::write(root.join(name), "").expect("writable");
        }
        let users = |name: &str| {
            let found = Search::default().users_of(&root.join(name));
            let below = found.iter().filter_map(|path| path.strip_prefix(&root).ok());
            let mut below: Vec<String> = below.map(|path| path.display().to_string()).collect();
            below.sort();
            below.dedup();
            below
        };
        let of_the_library =
            ["pipelines/.parts/a/b/c/d/e/f/part.ron", "pipelines/top.ron", "views/window.ron"];
        assert_eq!(users("shaders/sort/scan.comp"), of_the_library);
        assert_eq!(users("pipelines/new.ron"), of_the_library);
        assert_eq!(users(".deep/1/2/3/4/5/6/7/lib/blur.comp"), [".deep/1/2/3/4/5/6/7/top.ron"]);
    }
}
