//! Rejects outputs that would destroy a file, before anything is drawn.
//!
//! A command lists the files that it reads and the files that it will write. Two paths to one file count as the same
//! file. An output must not be an input, another output or a folder. It must not lie inside a file, its name must not
//! be too long for the file system, and its folder must be writable. The checks leave no file and no folder behind.

use super::file::{self, Target, folder_of, refuse_protected};
use super::names::MAX_NAME_BYTES;
use splatgraph_assets::scene_files;
use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::fmt::Display;
use std::fs::{self, Metadata};
use std::io::{self, ErrorKind};
use std::path::{Component, Path, PathBuf};

/// Maximum length of a path, in bytes, including its terminator.
const MAX_PATH_BYTES: usize = 4096;

/// Error about an output that cannot be written, or would destroy a file.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Conflict(String);

/// The files that a command reads and writes, checked for conflicts.
#[derive(Clone, Debug, Default)]
pub struct OutputGuard {
    inputs: HashMap<Identity, String>,
    outputs: HashMap<Identity, String>,
    /// Folders that do not exist yet, each with the output that needs it.
    folders: HashMap<Identity, String>,
    /// Existing folders in which files can be created.
    writable: HashSet<Existing>,
}

/// The identity of a file, which is the same for all paths to it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Identity {
    StandardOutput,
    /// An existing file: its device and inode, or its canonical path on systems without inodes.
    Existing(Existing),
    /// A new file: an existing folder, and the path relative to it.
    New(Existing, Vec<OsString>),
}

#[cfg(unix)]
type Existing = (u64, u64);
#[cfg(not(unix))]
type Existing = std::path::PathBuf;

#[cfg(unix)]
fn existing(_: &Path, found: &Metadata) -> std::io::Result<Existing> {
    use std::os::unix::fs::MetadataExt;
    Ok((found.dev(), found.ino()))
}

#[cfg(not(unix))]
fn existing(path: &Path, _: &Metadata) -> std::io::Result<Existing> {
    path.canonicalize()
}

impl OutputGuard {
    /// Adds a file that the command reads. A path that does not lead to a regular file is ignored.
    ///
    /// `what` names the file in errors.
    ///
    /// # Errors
    /// A previously added output is the same file.
    pub fn input(&mut self, what: &str, path: &Path) -> Result<(), Conflict> {
        let Ok(found) = fs::metadata(path) else { return Ok(()) };
        let Some(identity) = Some(found)
            .filter(Metadata::is_file)
            .and_then(|found| existing(path, &found).ok())
            .map(Identity::Existing)
        else {
            return Ok(());
        };
        if let Some(output) = self.outputs.get(&identity) {
            return Err(overwrites(output, what, path));
        }
        self.inputs.entry(identity).or_insert_with(|| what.to_owned());
        Ok(())
    }

    /// Adds a scene that the command reads, with the files that it names.
    ///
    /// # Errors
    /// See [`OutputGuard::input`]; and the path is `-`, because no scene is read from standard input.
    pub fn scene(&mut self, what: &str, path: &Path) -> Result<(), Conflict> {
        if path == Path::new("-") && !path.exists() {
            let text = format!("expected a file as {what}, found `-`: standard input is not read");
            return Err(Conflict(text));
        }
        self.input(what, path)?;
        let part = format!("a file of {what}");
        scene_files(path).iter().try_for_each(|file| self.input(&part, file))
    }

    /// Adds a file that the command writes. `what` is its option, such as `--json`.
    ///
    /// Several outputs may go to one device or pipe, but only one to standard output.
    ///
    /// # Errors
    /// The file is an input or another output, or it cannot be written at this path.
    pub fn output(&mut self, what: &str, path: &Path) -> Result<(), Conflict> {
        let Some((identity, target)) = place(what, path)? else { return Ok(()) };
        if let Some(input) = self.inputs.get(&identity) {
            return Err(overwrites(what, input, path));
        }
        let both = |other: &str| match (identity == Identity::StandardOutput, other == what) {
            (true, _) => Conflict(format!(
                "{other} and {what} both go to standard output: name a file for one of them"
            )),
            (_, true) => Conflict(format!("two outputs of {what} go into one file, {}", path.display())),
            _ => Conflict(format!("{other} and {what} name one file, {}", path.display())),
        };
        if let Some(other) = self.outputs.get(&identity) {
            return Err(both(other));
        }
        if let Some(other) = self.folders.get(&identity) {
            return Err(names(what, path, format_args!(", which is the folder of {other}")));
        }
        if let Identity::New(root, parts) = &identity {
            // `Existing` is `Copy` only on Unix.
            #[allow(clippy::clone_on_copy)]
            for length in 1..parts.len() {
                let folder = Identity::New(root.clone(), parts[..length].to_vec());
                if let Some(other) = self.outputs.get(&folder) {
                    return Err(names(what, path, format_args!(", which is inside the file of {other}")));
                }
                self.folders.entry(folder).or_insert_with(|| what.to_owned());
            }
        }
        self.outputs.insert(identity, what.to_owned());
        target.map_or(Ok(()), |target| self.check(target)).map_err(|error| unreachable(what, path, &error))
    }

    /// Checks that a file can be created or replaced. Its folder must exist.
    fn check(&mut self, target: PathBuf) -> io::Result<()> {
        let folder = folder_of(&target);
        let folder = existing(folder, &fs::metadata(folder)?)?;
        if self.writable.contains(&folder) {
            return fs::metadata(&target).map_or(Ok(()), |found| refuse_protected(&target, &found));
        }
        file::check(target)?;
        self.writable.insert(folder);
        Ok(())
    }
}

fn overwrites(output: &str, input: &str, path: &Path) -> Conflict {
    Conflict(format!("{output} would overwrite {input}, {}: name another file", path.display()))
}

fn names(what: &str, path: &Path, problem: impl Display) -> Conflict {
    Conflict(format!("{what} names {}{problem}", path.display()))
}

fn unreachable(what: &str, path: &Path, error: &io::Error) -> Conflict {
    names(what, path, format_args!(", which cannot be written: {error}"))
}

/// Identifies the file of an output; `None` for a device or a pipe, which several outputs may share.
///
/// Also returns the file whose creation shows whether the output can be written: the output, or the outermost of its
/// folders that do not exist. Standard output has none.
fn place(what: &str, path: &Path) -> Result<Option<(Identity, Option<PathBuf>)>, Conflict> {
    if path.as_os_str().len() >= MAX_PATH_BYTES {
        return Err(Conflict(format!(
            "{what} names a path of {} bytes; expected fewer than {MAX_PATH_BYTES}",
            path.as_os_str().len()
        )));
    }
    if let Some(part) = path.iter().find(|part| part.len() > MAX_NAME_BYTES) {
        return Err(too_long(what, path, part.len(), MAX_NAME_BYTES));
    }
    let failed = |error: io::Error| match error.kind() {
        ErrorKind::IsADirectory => names(what, path, ", which is a folder; expected a file"),
        _ => unreachable(what, path, &error),
    };
    match Target::of(path).map_err(failed)? {
        Target::StandardOutput => Ok(Some((Identity::StandardOutput, None))),
        // Opening a pipe would wait for its reader, and closing it again would end the reader's input.
        Target::Direct(target) => {
            fs::metadata(&target).and_then(|found| refuse_protected(&target, &found)).map_err(failed)?;
            Ok(None)
        }
        Target::File(target) => match fs::metadata(&target) {
            Ok(found) => {
                let identity = existing(&target, &found).map(Identity::Existing).map_err(failed)?;
                Ok(Some((identity, Some(target))))
            }
            Err(_) => new(what, path, &target).map(|(identity, first)| Some((identity, Some(first)))),
        },
    }
}

fn too_long(what: &str, path: &Path, found: usize, most: usize) -> Conflict {
    names(what, path, format_args!(", with a component of {found} bytes; the file system allows {most}"))
}

/// Identifies a file that does not exist, by its deepest existing folder and the path below it. Also returns the path
/// of the first of its folders that does not exist, or of the file.
fn new(what: &str, path: &Path, target: &Path) -> Result<(Identity, PathBuf), Conflict> {
    let mut parts: Vec<OsString> = Vec::new();
    let mut rest = target;
    let (root, found) = loop {
        let Some(Component::Normal(name)) = rest.components().next_back() else {
            // There is no file name, or `..` follows a folder that does not exist.
            return Err(names(what, path, "; expected a file name"));
        };
        parts.push(spelling(name.to_owned()));
        rest = folder_of(rest);
        match fs::metadata(rest) {
            Ok(found) if found.is_dir() => break (rest, found),
            Ok(_) => {
                return Err(names(what, path, format_args!(", but {} is not a folder", rest.display())));
            }
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(unreachable(what, path, &error)),
        }
    };
    let most = longest_name(root);
    if let Some(part) = parts.iter().find(|part| part.len() > most) {
        return Err(too_long(what, path, part.len(), most));
    }
    let first = parts.last().map_or_else(|| target.to_owned(), |name| root.join(name));
    parts.reverse();
    let root = existing(root, &found).map_err(|error| unreachable(what, path, &error))?;
    Ok((Identity::New(root, parts), first))
}

/// Converts ASCII letters of a name to lower case on systems whose file names ignore case: Windows and Apple's.
fn spelling(name: OsString) -> OsString {
    if cfg!(any(windows, target_vendor = "apple")) { name.to_ascii_lowercase() } else { name }
}

fn longest_name(folder: &Path) -> usize {
    #[cfg(unix)]
    if let Ok(found) = rustix::fs::statvfs(folder) {
        return (found.f_namemax as usize).clamp(1, MAX_NAME_BYTES);
    }
    let _ = folder;
    MAX_NAME_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(guard: &mut OutputGuard, what: &str, path: &Path) -> String {
        guard.output(what, path).expect_err("it is refused").to_string()
    }

    #[test]
    fn an_output_over_an_input_is_refused_under_any_of_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("in.ply");
        fs::write(&scene, "ply").unwrap();
        let mut names =
            vec![scene.clone(), folder.path().join("./in.ply"), folder.path().join("new/../in.ply")];
        fs::create_dir(folder.path().join("new")).unwrap();
        #[cfg(unix)]
        {
            let [hard, soft] = ["hard", "soft"].map(|name| folder.path().join(name));
            fs::hard_link(&scene, &hard).unwrap();
            std::os::unix::fs::symlink("in.ply", &soft).unwrap();
            std::os::unix::fs::symlink(".", folder.path().join("here")).unwrap();
            names.extend([hard, soft, folder.path().join("here/here/in.ply")]);
        }
        for name in names {
            let mut guard = OutputGuard::default();
            guard.input("the scene", &scene).unwrap();
            let text = refused(&mut guard, "--json", &name);
            assert!(text.starts_with("--json would overwrite the scene, "), "{text}");
            // Some inputs are found after the outputs.
            let mut guard = OutputGuard::default();
            guard.output("--json", &name).unwrap();
            assert!(guard.input("the scene", &scene).is_err(), "{}", name.display());
        }
    }

    #[test]
    fn two_outputs_into_one_file_are_refused_whether_it_exists_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("old"), "").unwrap();
        for (one, other) in [("old", "./old"), ("new", "./new"), ("a/b/new", "a/./b/new")] {
            let mut guard = OutputGuard::default();
            guard.output("-o", &at(one)).unwrap();
            let text = refused(&mut guard, "--json", &at(other));
            assert!(text.starts_with("-o and --json name one file, "), "{text}");
        }
        let mut guard = OutputGuard::default();
        guard.output("-o", &at("z")).unwrap();
        assert!(refused(&mut guard, "--json", &at("z/stats.json")).contains("inside the file of -o"));
        let mut guard = OutputGuard::default();
        guard.output("-o", &at("z/a.png")).unwrap();
        assert!(refused(&mut guard, "--json", &at("z")).contains("the folder of -o"));
        let mut guard = OutputGuard::default();
        guard.output("-o", Path::new("-")).unwrap();
        assert!(refused(&mut guard, "--json", Path::new("-")).contains("standard output"));
    }

    #[test]
    fn an_output_that_cannot_be_written_there_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("file"), "").unwrap();
        for (name, why) in [
            ("", "is a folder"),
            ("file/a.png", "is not a folder"),
            ("file/b/a.png", "is not a folder"),
            ("new/..", "expected a file name"),
            (&"x".repeat(256), "256 bytes; the file system allows 255"),
            (&format!("{}/a.png", "x".repeat(256)), "256 bytes"),
            (&"x/".repeat(2048), "expected fewer than 4096"),
        ] {
            let text = refused(&mut OutputGuard::default(), "-o", &at(name));
            assert!(text.contains(why) || text.contains("Not a directory"), "{name}: {text}");
        }
        let mut guard = OutputGuard::default();
        for name in ["a.png", "A.svg", "deep/er/a.png", "deep/er/b.png", "deep/c.png"] {
            guard.output("-o", &at(name)).unwrap();
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn an_output_in_a_folder_where_nothing_can_be_created_is_refused_and_leaves_no_folder() {
        for name in ["/proc/a.json", "/proc/new/a.json"] {
            let text = refused(&mut OutputGuard::default(), "--json", Path::new(name));
            assert!(text.starts_with(&format!("--json names {name}, which cannot be written: ")), "{text}");
        }
        let folder = tempfile::tempdir().unwrap();
        let mut guard = OutputGuard::default();
        guard.output("--json", &folder.path().join("new/er/a.json")).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        // Opening a pipe would wait for its reader.
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        guard.output("--json", &pipe).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn devices_may_be_used_twice() {
        let mut guard = OutputGuard::default();
        for what in ["-o", "--json"] {
            guard.output(what, Path::new("/dev/null")).unwrap();
        }
    }
}
