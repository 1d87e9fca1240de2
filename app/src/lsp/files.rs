//! Finds the graphs that may use a file, and provides the facts to build them with.

use crate::draw::facts::{self, SceneFacts};
use crate::draw::requirements::Case;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Maximum number of directory entries that a search visits, because the editor's folder may be a whole disk.
const MAX_ENTRIES: usize = 20_000;

/// Maximum depth of the search below each searched folder.
const MAX_DEPTH: usize = 6;

/// Subgroup sizes for which graphs are built: the usual ones of GPUs and of CPUs.
pub const LANES: [u32; 2] = [facts::USUAL_SUBGROUP_SIZE, 8];

pub fn is_graph(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "ron")
}

pub fn nominal_case(lanes: u32) -> Case {
    let device = facts::portable_device(lanes);
    Case { device, scene: SceneFacts::NOMINAL, size: facts::DEFAULT_SIZE }
}

/// Resolves the links and `..` in an absolute path that exists. Returns other paths unchanged.
pub fn canonical(path: &Path) -> PathBuf {
    if path.is_absolute() { path.canonicalize().unwrap_or_else(|_| path.to_owned()) } else { path.to_owned() }
}

/// Lists the open graphs, and all graphs below the editor's `folders` that contain the file `path`. If no such folder
/// contains it, searches the file's own folder instead, and `pipelines` in that folder and in the two folders above it.
pub fn graphs_near(path: &Path, open: &BTreeMap<PathBuf, String>, folders: &[PathBuf]) -> Vec<String> {
    let path = canonical(path);
    let mut searched: Vec<PathBuf> =
        folders.iter().map(|f| canonical(f)).filter(|f| path.starts_with(f)).collect();
    if searched.is_empty() {
        searched.extend(path.parent().map(Path::to_owned));
        searched.extend(path.ancestors().skip(1).take(3).map(|folder| folder.join("pipelines")));
    }
    let mut found: BTreeSet<PathBuf> = open.keys().filter(|p| is_graph(p)).map(|p| canonical(p)).collect();
    let mut left = MAX_ENTRIES;
    for folder in searched {
        collect(&folder, MAX_DEPTH, &mut left, &mut found);
    }
    found.iter().map(|path| path.display().to_string()).collect()
}

fn collect(folder: &Path, depth: usize, left: &mut usize, found: &mut BTreeSet<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        if *left == 0 {
            return;
        }
        *left -= 1;
        let path = entry.path();
        let name = entry.file_name();
        // Symbolic links are not followed: they can form cycles.
        match entry.file_type() {
            Ok(kind) if kind.is_dir() && depth > 0 => {
                let is_output = ["target", "node_modules"].iter().any(|other| name == *other);
                if !is_output && !name.to_string_lossy().starts_with('.') {
                    collect(&path, depth - 1, left, found);
                }
            }
            Ok(kind) if kind.is_file() && is_graph(&path) => drop(found.insert(canonical(&path))),
            _ => {}
        }
    }
}
