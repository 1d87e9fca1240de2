//! Lists the folder entries that a path resolves through, symlinks included.
//!
//! `/home/me/graphs/a.ron` resolves through the entry `home` in `/`, `me` in `/home`, and so on. If `graphs` is a
//! symlink, it also resolves through every entry along the link's target. The contents at a path change only if one of
//! these entries or the final file changes, so the watcher watches these entries. For a path that does not resolve, the
//! last entry is the first one that is missing or not a folder.

use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};
use std::{fs, io};

/// Maximum number of symlinks that one path follows, as in Linux.
const MAX_LINKS: u32 = 40;

/// An entry along a path, existing or not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The folder that contains the entry: absolute, without links.
    pub folder: PathBuf,
    pub path: PathBuf,
    pub is_link: bool,
}

/// A cache of entries, so that folders on several paths are read once. Valid for one resolution of all paths.
#[derive(Debug, Default)]
pub struct Walk {
    met: HashMap<PathBuf, Met>,
}

#[derive(Clone, Debug)]
enum Met {
    Folder,
    Link(PathBuf),
    /// A file, a missing or unreadable entry, or any other that is neither folder nor symlink.
    End,
}

impl Walk {
    /// Lists the entries along an absolute path, in order.
    pub fn entries(&mut self, path: &Path) -> Vec<Entry> {
        let mut entries = Vec::new();
        let mut folder = PathBuf::new();
        // The remaining steps, the next one last.
        let mut rest: Vec<Step> = steps(path);
        let mut links = 0;
        while let Some(step) = rest.pop() {
            let name = match step {
                Step::Root(root) => {
                    folder.push(root);
                    continue;
                }
                Step::Up => {
                    folder.pop();
                    continue;
                }
                Step::Into(name) => name,
            };
            let entry = folder.join(&name);
            let met = self.met.entry(entry.clone()).or_insert_with(|| meet(&entry)).clone();
            let is_link = matches!(met, Met::Link(_));
            entries.push(Entry { folder: folder.clone(), path: entry.clone(), is_link });
            match met {
                Met::Folder => folder = entry,
                Met::Link(to) => {
                    links += 1;
                    if links > MAX_LINKS {
                        break;
                    }
                    rest.extend(steps(&to));
                }
                Met::End => break,
            }
        }
        entries
    }
}

enum Step {
    /// A Windows prefix or the root: restarts there.
    Root(OsString),
    Up,
    Into(OsString),
}

/// Returns the steps of a path, in reverse order.
fn steps(path: &Path) -> Vec<Step> {
    let step = |component| match component {
        Component::Prefix(prefix) => Some(Step::Root(prefix.as_os_str().to_owned())),
        Component::RootDir => Some(Step::Root(Component::RootDir.as_os_str().to_owned())),
        Component::CurDir => None,
        Component::ParentDir => Some(Step::Up),
        Component::Normal(name) => Some(Step::Into(name.to_owned())),
    };
    path.components().rev().filter_map(step).collect()
}

fn meet(path: &Path) -> Met {
    let look = || -> io::Result<Met> {
        let kind = fs::symlink_metadata(path)?.file_type();
        Ok(match kind {
            kind if kind.is_symlink() => Met::Link(fs::read_link(path)?),
            kind if kind.is_dir() => Met::Folder,
            _ => Met::End,
        })
    };
    look().unwrap_or(Met::End)
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    /// Lists the entries along a path that are below `root`. Links are marked with an `@`.
    fn below(root: &Path, path: &Path) -> Vec<String> {
        let root = root.canonicalize().expect("a folder");
        let entries = Walk::default().entries(path);
        let show = |entry: &Entry| {
            assert_eq!(entry.path.parent(), Some(entry.folder.as_path()));
            let short = entry.path.strip_prefix(&root).ok()?.to_str()?;
            (!short.is_empty()).then(|| format!("{short}{}", if entry.is_link { "@" } else { "" }))
        };
        entries.iter().filter_map(show).collect()
    }

    #[test]
    fn a_path_leads_through_its_folders_to_the_file() {
        let root = tempfile::tempdir().expect("a folder");
        fs::create_dir_all(root.path().join("a/b")).expect("folders");
        fs::write(root.path().join("a/b/file"), "").expect("a file");
        assert_eq!(below(root.path(), &root.path().join("a/b/file")), ["a", "a/b", "a/b/file"]);
        assert_eq!(below(root.path(), &root.path().join("a/./b/../b/file")), ["a", "a/b", "a/b", "a/b/file"]);
    }

    #[test]
    fn a_path_that_leads_nowhere_ends_with_the_first_entry_that_is_missing() {
        let root = tempfile::tempdir().expect("a folder");
        fs::create_dir(root.path().join("a")).expect("a folder");
        fs::write(root.path().join("a/file"), "").expect("a file");
        assert_eq!(below(root.path(), &root.path().join("a/b/c/file")), ["a", "a/b"]);
        assert_eq!(below(root.path(), &root.path().join("a/file/c")), ["a", "a/file"]);
    }

    #[test]
    fn links_are_entries_and_so_is_the_way_that_they_point_along() {
        let root = tempfile::tempdir().expect("a folder");
        fs::create_dir_all(root.path().join("v1/shaders")).expect("folders");
        fs::write(root.path().join("v1/shaders/a"), "").expect("a file");
        symlink("v1", root.path().join("..data")).expect("a link");
        symlink("..data/shaders", root.path().join("shaders")).expect("a link");
        symlink(root.path().join("shaders/a"), root.path().join("a")).expect("a link");
        assert_eq!(
            below(root.path(), &root.path().join("a")),
            ["a@", "shaders@", "..data@", "v1", "v1/shaders", "v1/shaders/a"]
        );
        // After a link, `..` is the parent of its target.
        assert_eq!(
            below(root.path(), &root.path().join("shaders/../shaders/a")),
            ["shaders@", "..data@", "v1", "v1/shaders", "v1/shaders", "v1/shaders/a"]
        );
    }

    #[test]
    fn a_link_to_itself_ends() {
        let root = tempfile::tempdir().expect("a folder");
        symlink("loop", root.path().join("loop")).expect("a link");
        assert_eq!(below(root.path(), &root.path().join("loop/a")).len(), MAX_LINKS as usize + 1);
    }
}
