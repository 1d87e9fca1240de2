//! Makes unique file names from the cameras' names.
//!
//! The list of names determines the file names, so two runs give the same files. Names that are valid file names stay
//! unchanged, except for a leading `images/`, the usual folder of photographs, which is left out. In other names,
//! characters that some system rejects become `_`: separators, control characters, `< > : " | ? *`, and a leading dot.
//! The names of Windows devices (`CON`, `NUL`, ...) get a leading `_`. An empty name becomes [`unnamed`]. Among equal
//! results, one stays: the first name that was valid, or else the first. The others get `-` and the camera's index, and
//! then a number, until all differ, ignoring case. A name that is too long is cut, and ends in `~` and eight digits of
//! the hash of the whole name. [`first_free`] numbers the files that a window writes.

use super::file::{OutputError, write_new_bytes};
use super::terminal::{is_harmful, one_line};
use splatgraph_assets::unnamed;
use std::collections::HashSet;
use std::path::{Path, PathBuf, is_separator};

/// Maximum length of a file name on common file systems, in bytes.
pub const MAX_NAME_BYTES: usize = 255;

/// Minimum length that is left for a camera's name, in bytes: for its hash, its index, and a recognisable part.
pub const MIN_ROOM_BYTES: usize = 48;

/// Returns true if the path ends in a separator, and therefore names a folder, whatever its extension.
pub fn ends_in_separator(path: &Path) -> bool {
    path.as_os_str().as_encoded_bytes().last().is_some_and(|byte| is_separator(char::from(*byte)))
}

/// Returns the name of a scene's file up to the first dot, or `scene` if that is empty.
///
/// It names files that are made from the scene.
pub fn of_scene(scene: &Path) -> String {
    let name = scene.file_name().unwrap_or_default().to_string_lossy();
    name.split('.').next().filter(|stem| !stem.is_empty()).unwrap_or("scene").to_owned()
}

/// Returns the first path, numbered from 1, that does not exist yet.
pub fn first_free(path: impl Fn(u32) -> PathBuf) -> PathBuf {
    (1..).map(&path).find(|path| !path.exists()).unwrap_or_else(|| path(0))
}

/// Writes a new file with these bytes at the first path, numbered from 1, that does not exist. Returns the path.
///
/// If two programs do so at once, each gets a file of its own.
///
/// # Errors
/// See [`write_new_bytes`].
pub fn write_first_free(path: impl Fn(u32) -> PathBuf, bytes: &[u8]) -> Result<PathBuf, OutputError> {
    let mut number = 1;
    loop {
        let path = path(number);
        match write_new_bytes(&path, bytes) {
            Err(error) if error.is_taken() => number += 1,
            written => return written.map(|()| path),
        }
    }
}

/// Describes the files in a folder that have this extension and are not in `own`; `None` if there are none.
///
/// `own` are the files that a command writes there. The others are pictures of an earlier run, and an encoder would
/// take them for pictures of this one.
pub fn others(folder: &Path, extension: &str, own: &HashSet<PathBuf>) -> Option<String> {
    let is_picture =
        |path: &PathBuf| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension));
    let files = folder.read_dir().ok()?.flatten().map(|entry| folder.join(entry.file_name()));
    let others: Vec<PathBuf> = files.filter(is_picture).filter(|path| !own.contains(path)).collect();
    let first = others.iter().min()?.file_name()?.to_string_lossy().into_owned();
    let name = one_line(&first);
    Some(match others.len() {
        1 => format!("{}: {name} is not of this run", folder.display()),
        count => format!("{}: {count} files are not of this run, such as {name}", folder.display()),
    })
}

/// Makes a unique file name from each name, without extension, of at most `room` bytes.
///
/// A `room` below [`MIN_ROOM_BYTES`] is raised to it.
pub fn unique(names: &[String], room: usize) -> Vec<String> {
    let room = room.max(MIN_ROOM_BYTES);
    let names: Vec<&str> = names.iter().map(|name| name.strip_prefix("images/").unwrap_or(name)).collect();
    let fit: Vec<String> = names
        .iter()
        .enumerate()
        .map(|(at, name)| shortened(&sanitized(name, at, names.len()), room))
        .collect();
    let mut taken: HashSet<String> = HashSet::with_capacity(names.len());
    let mut found: Vec<Option<String>> = vec![None; names.len()];
    // Unchanged names are assigned first, so that no changed name can displace them.
    for changed in [false, true] {
        for (index, name) in fit.iter().enumerate() {
            if (*name != names[index]) == changed && taken.insert(key(name)) {
                found[index] = Some(name.clone());
            }
        }
    }
    let mut own = |index: usize| {
        let mut candidates =
            suffixes(index).map(|suffix| shortened(&fit[index], room - suffix.len()) + &suffix);
        candidates.find(|name| taken.insert(key(name))).unwrap_or_default()
    };
    let found = found.into_iter().enumerate();
    found.map(|(index, name)| name.unwrap_or_else(|| own(index))).collect()
}

/// Lists the endings that tell equal names apart: the index of the camera, then also a number.
fn suffixes(index: usize) -> impl Iterator<Item = String> {
    std::iter::once(format!("-{index}")).chain((2..).map(move |n| format!("-{index}-{n}")))
}

/// Makes the names of cameras unique, and keeps the first of equal names.
///
/// The others get the same endings as in [`unique`]. An empty name becomes [`unnamed`].
pub fn distinct(names: &[String]) -> Vec<String> {
    let mut taken = HashSet::with_capacity(names.len());
    // Names that stay are taken first, so that no changed name equals one.
    let stays: Vec<bool> = names.iter().map(|name| !name.is_empty() && taken.insert(name.clone())).collect();
    let own = |(index, name): (usize, &String)| {
        if stays[index] {
            return name.clone();
        }
        let name = if name.is_empty() { unnamed(index, names.len()) } else { name.clone() };
        let endings = std::iter::once(String::new()).chain(suffixes(index));
        let mut candidates = endings.map(|ending| format!("{name}{ending}"));
        candidates.find(|name| taken.insert(name.clone())).unwrap_or_default()
    };
    names.iter().enumerate().map(own).collect()
}

/// Folds the case of a name, as a file system that ignores case does.
fn key(name: &str) -> String {
    name.to_uppercase().to_lowercase()
}

/// Makes a name valid on all systems.
///
/// Replaces characters that a system refuses, and a leading dot. Puts `_` before a name that Windows reserves for a
/// device. An empty name becomes [`unnamed`].
fn sanitized(name: &str, index: usize, count: usize) -> String {
    let is_refused = |c: char| {
        matches!(c, '/' | '\\' | '<' | '>' | ':' | '"' | '|' | '?' | '*' | '\n' | '\t') || is_harmful(c)
    };
    let mut name: String = name.chars().map(|c| if is_refused(c) { '_' } else { c }).collect();
    if name.is_empty() {
        return unnamed(index, count);
    }
    if name.starts_with('.') {
        name.replace_range(..1, "_");
    }
    let stem = name.split('.').next().unwrap_or_default().trim_end().to_ascii_uppercase();
    let numbered =
        |device: &str| stem.strip_prefix(device).is_some_and(|rest| matches!(rest.as_bytes(), [b'0'..=b'9']));
    if ["CON", "PRN", "AUX", "NUL"].contains(&stem.as_str()) || numbered("COM") || numbered("LPT") {
        name.insert(0, '_');
    }
    name
}

/// Cuts a name to at most `room` bytes; then it ends in a hash of the whole name. `room` is at least 9.
fn shortened(name: &str, room: usize) -> String {
    if name.len() <= room {
        return name.to_owned();
    }
    let hash = format!("~{:08x}", fnv1a(name.as_bytes()));
    name[..name.floor_char_boundary(room - hash.len())].to_owned() + &hash
}

/// Computes the 32-bit hash FNV-1a (Fowler, Noll and Vo; RFC 9923).
fn fnv1a(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811c_9dc5, |hash, byte| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(names: &[&str]) -> Vec<String> {
        unique(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>(), 100)
    }

    #[test]
    fn cameras_whose_names_differ_little_or_not_at_all_get_files_of_their_own() {
        assert_eq!(of(&["a", "b.jpg", "Ü 1"]), ["a", "b.jpg", "Ü 1"]);
        assert_eq!(of(&["a/b", "a_b"]), ["a_b-0", "a_b"]);
        assert_eq!(of(&["images/0001", "images/b/1", "left/images/1"]), ["0001", "b_1", "left_images_1"]);
        assert_eq!(of(&["a-2", "a", "a"]), ["a-2", "a", "a-2-2"]);
        assert_eq!(of(&["a", "A", "a"]), ["a", "A-1", "a-2"]);
        assert_eq!(of(&["", "camera0", "camera0"]), ["camera0-0", "camera0", "camera0-2"]);
        let many = of(&[""; 11]);
        assert_eq!((many[1].as_str(), many[10].as_str()), ("camera01", "camera10"), "they sort by index");
    }

    #[test]
    fn names_in_results_stay_except_empty_and_repeated_ones() {
        let of = |names: &[&str]| distinct(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
        assert_eq!(of(&["t 0/a", "t 0/b", "T 0/b", "t 0/b"]), ["t 0/a", "t 0/b", "T 0/b", "t 0/b-3"]);
        assert_eq!(of(&["a", "a", "a-1"]), ["a", "a-1-2", "a-1"]);
        assert_eq!(of(&["", "camera0", ""]), ["camera0-0", "camera0", "camera2"]);
    }

    #[test]
    fn names_that_a_system_refuses_or_hides_are_changed() {
        assert_eq!(of(&[".", "..", "../../etc/passwd"]), ["_", "_.", "_._.._etc_passwd"]);
        assert_eq!(of(&["a\nb\x1b[2J", "C:\\x", "nul", "con.jpg"]), ["a_b_[2J", "C__x", "_nul", "_con.jpg"]);
        assert_eq!(of(&["console", "com", "lpt10"]), ["console", "com", "lpt10"]);
    }

    #[test]
    fn long_names_are_cut_between_characters_and_stay_different() {
        let long = "ä".repeat(300);
        let names = of(&[&long, &format!("{long}x"), &long]);
        assert!(names.iter().all(|name| name.len() <= 100), "{names:?}");
        assert!(names[0].starts_with("ää") && names[0] != names[1] && names[0] != names[2]);
    }

    #[test]
    fn numbered_files_that_are_written_at_once_are_all_kept() {
        let folder = tempfile::tempdir().unwrap();
        let start = std::sync::Barrier::new(8);
        let write = |content: u8| {
            start.wait();
            let path = write_first_free(|number| folder.path().join(format!("a-{number}.png")), &[content]);
            (content, path.unwrap())
        };
        let write = &write;
        let written: Vec<_> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|content| scope.spawn(move || write(content))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        for (content, path) in written {
            assert_eq!(std::fs::read(&path).unwrap(), [content], "{}", path.display());
        }
        assert!((1..=8).all(|number| folder.path().join(format!("a-{number}.png")).exists()));
    }

    fn name() -> impl Strategy<Value = String> {
        prop_oneof![
            "[aAbB_/.-]{0,4}",
            "[aA](-[0-3]){0,2}",
            Just("a".repeat(60)),
            "[a-c]{46,60}",
            any::<String>(),
        ]
    }

    proptest! {
        #[test]
        fn any_names_give_files_that_differ_in_more_than_case_and_that_every_system_takes(
            names in prop::collection::vec(name(), 0..24),
            room in MIN_ROOM_BYTES..MAX_NAME_BYTES,
        ) {
            let found = unique(&names, room);
            prop_assert_eq!(&found, &unique(&names, room));
            prop_assert_eq!(found.len(), names.len());
            let keys: HashSet<String> = found.iter().map(|name| key(name)).collect();
            prop_assert_eq!(keys.len(), names.len(), "{:?}", found);
            for name in &found {
                prop_assert!(!name.is_empty() && name.len() <= room && !name.starts_with('.'), "{}", name);
                prop_assert!(!name.contains(['/', '\\', '\0', '\n', '\t']) && !name.contains(is_harmful), "{}", name);
            }
        }
    }
}
