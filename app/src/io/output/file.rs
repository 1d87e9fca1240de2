//! Writes files atomically: each is either complete or absent.
//!
//! The bytes go into an unnamed file in the target's folder (`O_TMPFILE`). Once all of them are on the disk, the file
//! is named in one step. If the program ends earlier, nothing is left behind, and an existing file is unchanged. No
//! system call replaces a file by an unnamed one, so a file that replaces another has a hidden name between two calls.
//! On file systems without unnamed files, the file has a hidden name from the start; errors and signals remove it.
//!
//! The new file gets the permissions of the file that it replaces. A link is followed, not replaced; in a folder like
//! `/tmp`, another user's link is refused. Anything but a regular file (a pipe, a terminal, `/dev/null`) is written
//! directly.

// Only this module and `log` create files. The lint forbids it elsewhere.
#![allow(clippy::disallowed_methods)]

use super::faults;
use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};
use tracing::info_span;

/// The cause of a failure, from any writer.
pub type Cause = Box<dyn std::error::Error + Send + Sync>;

/// An error while writing a file.
#[derive(Debug, thiserror::Error)]
#[error("{} cannot be written: {cause}", shown(path))]
pub struct OutputError {
    /// Path of the file, as given.
    pub path: PathBuf,
    /// Reason why the file could not be written.
    pub cause: Cause,
}

fn shown(path: &Path) -> std::path::Display<'_> {
    if is_standard_output(path) { Path::new("standard output").display() } else { path.display() }
}

impl OutputError {
    /// Returns true if a new file was not written because its name is taken.
    pub fn is_taken(&self) -> bool {
        let cause = self.cause.downcast_ref::<io::Error>();
        cause.is_some_and(|error| error.kind() == ErrorKind::AlreadyExists)
    }
}

const BUFFER_BYTES: usize = 1 << 17;

/// Maximum number of links that are followed to a target, as on Linux.
const MAX_LINKS: usize = 40;

/// Writes a file, and creates its folder. `-` is standard output, whose reader may close the pipe early without an
/// error.
///
/// # Errors
/// The folder or the file cannot be created or written, or `body` fails. An existing file is then kept.
pub fn write(path: &Path, body: impl FnOnce(&mut dyn Write) -> Result<(), Cause>) -> Result<(), OutputError> {
    write_to(path, body).map_err(|cause| OutputError { path: path.to_owned(), cause })
}

/// Writes a file with these bytes, as [`write()`] does.
///
/// # Errors
/// See [`write()`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    write(path, |out| Ok(out.write_all(bytes)?))
}

/// Writes a new file, as [`write()`] does, and replaces nothing: of two programs that write one file, one fails.
///
/// # Errors
/// Those of [`write()`]. If anything has the name, even a dangling link, the cause is an [`io::Error`] of the kind
/// [`ErrorKind::AlreadyExists`].
pub fn write_new(
    path: &Path,
    body: impl FnOnce(&mut dyn Write) -> Result<(), Cause>,
) -> Result<(), OutputError> {
    let write = || match fs::symlink_metadata(path) {
        Ok(_) => Err(io::Error::from(ErrorKind::AlreadyExists).into()),
        Err(_) => fill_file(path.to_owned(), Existing::Kept, body),
    };
    write().map_err(|cause| OutputError { path: path.to_owned(), cause })
}

/// Writes a new file with these bytes, as [`write_new()`] does.
///
/// # Errors
/// See [`write_new()`].
pub fn write_new_bytes(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    write_new(path, |out| Ok(out.write_all(bytes)?))
}

/// Returns true for `-`, which stands for standard output, and for other names of it, such as `/dev/stdout`.
pub fn is_standard_output(path: &Path) -> bool {
    matches!(Target::of(path), Ok(Target::StandardOutput))
}

/// Checks that [`write()`] could create or replace this file. Its folder must exist.
pub(super) fn check(target: PathBuf) -> io::Result<()> {
    Unfinished::create(target).map(drop)
}

fn write_to(path: &Path, body: impl FnOnce(&mut dyn Write) -> Result<(), Cause>) -> Result<(), Cause> {
    match Target::of(path)? {
        Target::StandardOutput => {
            let mut pipe = Pipe { closed: false };
            match fill(&mut pipe, body) {
                Err(_) if pipe.closed => Ok(()),
                filled => filled,
            }
        }
        Target::Direct(path) => {
            // Appends, so existing contents are neither truncated nor overwritten.
            let file = OpenOptions::new().append(true).open(path)?;
            fill(&mut Faulty(&file), body)
        }
        Target::File(target) => fill_file(target, Existing::Replaced, body),
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Existing {
    Replaced,
    /// The existing file is kept, and writing the new one fails.
    Kept,
}

/// Removes a file, and returns true if it was there.
///
/// # Errors
/// The file cannot be removed.
pub fn remove(path: &Path) -> Result<bool, OutputError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
        removed => {
            removed.map(|()| true).map_err(|error| OutputError { path: path.to_owned(), cause: error.into() })
        }
    }
}

/// Runs `body` on a file, and names it `target` once it is complete.
fn fill_file(
    target: PathBuf,
    existing: Existing,
    body: impl FnOnce(&mut dyn Write) -> Result<(), Cause>,
) -> Result<(), Cause> {
    let folder = folder_of(&target);
    fs::create_dir_all(folder)
        .map_err(|e| format!("the folder {} cannot be created: {e}", folder.display()))?;
    let unfinished = Unfinished::create(target)?;
    fill(&mut Faulty(&unfinished.file), body)?;
    Ok(unfinished.finish(existing)?)
}

fn fill(writer: &mut dyn Write, body: impl FnOnce(&mut dyn Write) -> Result<(), Cause>) -> Result<(), Cause> {
    let mut out = BufWriter::with_capacity(BUFFER_BYTES, writer);
    let filled = body(&mut out).and_then(|()| Ok(out.flush()?));
    // Discards the buffer: dropping the writer would write it again after a failure.
    let _ = out.into_parts();
    filled
}

/// Standard output. It records that its reader closed the pipe, because libraries wrap that error in their own.
struct Pipe {
    closed: bool,
}

impl Pipe {
    fn noted<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        self.closed |= result.as_ref().is_err_and(|error| error.kind() == ErrorKind::BrokenPipe);
        result
    }
}

impl Write for Pipe {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = io::stdout().lock().write(bytes);
        self.noted(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        let flushed = io::stdout().lock().flush();
        self.noted(flushed)
    }
}

struct Faulty<'a>(&'a File);

impl Write for Faulty<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        faults::step()?;
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// The destination that a path leads to.
pub(super) enum Target {
    StandardOutput,
    /// Not a regular file, or a file that a process has open: written directly.
    Direct(PathBuf),
    /// A regular file, or a path without a file, with all links followed.
    File(PathBuf),
}

impl Target {
    pub(super) fn of(path: &Path) -> io::Result<Target> {
        if path == Path::new("-") {
            return Ok(Target::StandardOutput);
        }
        let mut target = path.to_owned();
        for _ in 0..MAX_LINKS {
            if ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"].iter().any(|name| target == Path::new(name)) {
                return Ok(Target::StandardOutput);
            }
            if is_open_file(&target) {
                return Ok(Target::Direct(target));
            }
            match fs::symlink_metadata(&target) {
                Ok(found) if found.is_symlink() => {
                    refuse_planted(&target, &found)?;
                    target = folder_of(&target).join(fs::read_link(&target)?);
                }
                Ok(found) if found.is_dir() => return Err(ErrorKind::IsADirectory.into()),
                Ok(found) if found.is_file() => return Ok(Target::File(target)),
                Ok(_) => return Ok(Target::Direct(target)),
                Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Target::File(target)),
                Err(error) => return Err(error),
            }
        }
        Err(io::Error::other("too many symbolic links"))
    }
}

/// Returns an error for another user's link in a folder like `/tmp`, as Linux does with `fs.protected_symlinks`: its
/// owner chose the file that would be replaced. The kernel itself is never asked to follow the link.
#[cfg(unix)]
fn refuse_planted(link: &Path, found: &fs::Metadata) -> io::Result<()> {
    use std::os::unix::fs::MetadataExt;
    let folder = fs::metadata(folder_of(link))?;
    let is_shared = folder.mode() & 0o1002 == 0o1002;
    if is_shared && ![rustix::process::geteuid().as_raw(), folder.uid()].contains(&found.uid()) {
        let found = found.uid();
        let text = format!(
            "expected no other user's link in a folder that all can write, found one of user {found}"
        );
        return Err(io::Error::new(ErrorKind::PermissionDenied, text));
    }
    Ok(())
}

#[cfg(not(unix))]
fn refuse_planted(_: &Path, _: &fs::Metadata) -> io::Result<()> {
    Ok(())
}

/// Returns true for the name of a file that a process has open. Replacing or truncating such a file would lose what
/// other processes wrote to it.
fn is_open_file(path: &Path) -> bool {
    let is_in = |folder: &Path| {
        folder == Path::new("/dev/fd") || folder.starts_with("/proc") && folder.ends_with("fd")
    };
    path == Path::new("/dev/stderr") || path.parent().is_some_and(is_in)
}

/// Returns the folder of a path; `.` for a bare name.
pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Hidden names in use, to remove on a signal. A thread holds the lock while it names a file, writes lines of a log, or
/// ends the program.
static HIDDEN: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

pub(super) fn hidden_names() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    HIDDEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes unfinished files. No file can be named while the returned guard lives.
///
/// `None` if another thread holds the lock for half a second, because the reader of a full pipe blocks it.
pub(super) fn abandon() -> Option<MutexGuard<'static, BTreeSet<PathBuf>>> {
    for _ in 0..100 {
        let mut names = match HIDDEN.try_lock() {
            Ok(names) => names,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => {
                std::thread::sleep(std::time::Duration::from_millis(5));
                continue;
            }
        };
        for name in std::mem::take(&mut *names) {
            let _ = fs::remove_file(name);
        }
        return Some(names);
    }
    None
}

/// Calls `create` with a hidden name in `folder` that no other running process uses, and adds it to `names`.
fn hide<T>(
    folder: &Path,
    names: &mut BTreeSet<PathBuf>,
    create: impl Fn(&Path) -> io::Result<T>,
) -> io::Result<(PathBuf, T)> {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    // Names are not repeated, so the loop ends.
    loop {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = folder.join(format!(".splatgraph-{}-{number}.tmp", std::process::id()));
        match create(&name) {
            // Left by a killed process with the same ID.
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
            Ok(created) => {
                names.insert(name.clone());
                return Ok((name, created));
            }
        }
    }
}

/// A file that is being written.
struct Unfinished {
    file: File,
    target: PathBuf,
    /// Path of the hidden file; `None` for an unnamed file.
    hidden: Option<PathBuf>,
}

impl Unfinished {
    fn create(target: PathBuf) -> io::Result<Unfinished> {
        faults::step()?;
        if let Ok(old) = fs::metadata(&target) {
            refuse_protected(&target, &old)?;
        }
        let folder = folder_of(&target);
        if let Some(file) = nameless::create(folder)? {
            return Ok(Unfinished { file, target, hidden: None });
        }
        let create = |name: &Path| OpenOptions::new().write(true).create_new(true).open(name);
        let (name, file) = hide(folder, &mut hidden_names(), create)?;
        Ok(Unfinished { file, target, hidden: Some(name) })
    }

    /// Syncs the contents to the disk, then names the file. It gets the permissions of a file that it replaces.
    fn finish(mut self, existing: Existing) -> io::Result<()> {
        if let Ok(old) = fs::metadata(&self.target) {
            hand_on_permissions(&old, &self.file);
        }
        faults::step()?;
        info_span!("put on the disk").in_scope(|| synced(self.file.sync_all()))?;
        self.name(existing)?;
        // The name survives a crash only once the folder is synced. The file is complete even if that fails, for
        // instance because the folder is unreadable.
        if let Ok(folder) = File::open(folder_of(&self.target)) {
            let _ = info_span!("put on the disk").in_scope(|| folder.sync_all());
        }
        Ok(())
    }

    fn name(&mut self, existing: Existing) -> io::Result<()> {
        let mut names = hidden_names();
        faults::step()?;
        if self.hidden.is_none() {
            match nameless::link(&self.file, &self.target) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists && existing == Existing::Replaced => {}
                linked => return linked,
            }
            let link = |name: &Path| nameless::link(&self.file, name);
            self.hidden = Some(hide(folder_of(&self.target), &mut names, link)?.0);
        }
        if let Some(name) = &self.hidden {
            faults::step()?;
            match existing {
                Existing::Replaced => fs::rename(name, &self.target)?,
                Existing::Kept => rename_to_new(name, &self.target)?,
            }
            names.remove(name);
            self.hidden = None;
        }
        Ok(())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if let Some(name) = self.hidden.take() {
            let mut names = hidden_names();
            let _ = fs::remove_file(&name);
            names.remove(&name);
        }
    }
}

/// Renames a file, unless anything has the new name.
fn rename_to_new(from: &Path, to: &Path) -> io::Result<()> {
    match fs::hard_link(from, to) {
        // The file is complete, even if its hidden name stays.
        Ok(()) => {
            let _ = fs::remove_file(from);
            Ok(())
        }
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(error),
        // On a file system without links, an empty file takes the name first.
        Err(_) => {
            OpenOptions::new().write(true).create_new(true).open(to)?;
            fs::rename(from, to).inspect_err(|_| {
                let _ = fs::remove_file(to);
            })
        }
    }
}

fn is_unsupported(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::Unsupported | ErrorKind::InvalidInput)
}

/// Ignores the error of a file system that cannot sync.
fn synced(result: io::Result<()>) -> io::Result<()> {
    result.or_else(|error| if is_unsupported(&error) { Ok(()) } else { Err(error) })
}

/// Returns an error for a file without write permission: permission on its folder would be enough to replace it.
#[cfg(unix)]
pub(super) fn refuse_protected(target: &Path, _: &fs::Metadata) -> io::Result<()> {
    Ok(rustix::fs::access(target, rustix::fs::Access::WRITE_OK)?)
}

#[cfg(not(unix))]
pub(super) fn refuse_protected(_: &Path, old: &fs::Metadata) -> io::Result<()> {
    if old.permissions().readonly() { Err(ErrorKind::PermissionDenied.into()) } else { Ok(()) }
}

fn hand_on_permissions(old: &fs::Metadata, file: &File) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
        if let Ok(new) = file.metadata()
            && (new.uid(), new.gid()) != (old.uid(), old.gid())
        {
            // Only root can change the owner.
            let _ = fchown(file, Some(old.uid()), Some(old.gid()));
        }
        // Without the set-user-ID, set-group-ID and sticky bits.
        let _ = file.set_permissions(fs::Permissions::from_mode(old.permissions().mode() & 0o777));
    }
    #[cfg(not(unix))]
    let _ = file.set_permissions(old.permissions());
}

#[cfg(target_os = "linux")]
mod nameless {
    use super::{File, Path, io, is_unsupported};
    use rustix::fs::{AtFlags, CWD, Mode, OFlags, linkat, open};
    use rustix::io::Errno;
    use std::os::fd::AsRawFd;

    /// Creates an unnamed file; `None` if the file system does not support it, or without `/proc`, which naming needs.
    pub fn create(folder: &Path) -> io::Result<Option<File>> {
        #[cfg(test)]
        if crate::io::output::faults::hidden_only() {
            return Ok(None);
        }
        if !Path::new("/proc/self/fd").is_dir() {
            return Ok(None);
        }
        let flags = OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC;
        match open(folder, flags, Mode::from_raw_mode(0o666)) {
            Ok(file) => Ok(Some(file.into())),
            // Kernels and file systems without `O_TMPFILE` ignore the flag, and fail to open the folder for writing.
            Err(Errno::ISDIR | Errno::NOENT) => Ok(None),
            Err(error) if is_unsupported(&error.into()) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Gives the file a name. Fails if the target exists.
    pub fn link(file: &File, target: &Path) -> io::Result<()> {
        let handle = format!("/proc/self/fd/{}", file.as_raw_fd());
        Ok(linkat(CWD, handle, CWD, target, AtFlags::SYMLINK_FOLLOW)?)
    }
}

#[cfg(not(target_os = "linux"))]
mod nameless {
    use super::{ErrorKind, File, Path, io};

    pub fn create(_: &Path) -> io::Result<Option<File>> {
        Ok(None)
    }

    pub fn link(_: &File, _: &Path) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn long(out: &mut dyn Write) -> Result<(), Cause> {
        for _ in 0..5 {
            out.write_all(&[7; BUFFER_BYTES])?;
        }
        Ok(())
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_full_disk_at_any_step_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        assert!(faults::at_every_step(&path, |path| write(path, long)) >= 7);
        assert!(faults::with_hidden_files(|| faults::at_every_step(&path, |path| write(path, long))) >= 7);
        assert_eq!(fs::read(&path).unwrap().len(), 5 * BUFFER_BYTES);
    }

    #[test]
    fn of_several_that_write_one_new_file_one_succeeds() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/a.txt");
        for hidden in [false, true] {
            let attempt = |own: usize| {
                let attempt = || write_new_bytes(&path, own.to_string().as_bytes());
                let result = if hidden { faults::with_hidden_files(attempt) } else { attempt() };
                result
                    .map(|()| own)
                    .map_err(|error| error.cause.downcast::<io::Error>().map(|error| error.kind()).ok())
            };
            let results: Vec<_> = std::thread::scope(|scope| {
                let threads: Vec<_> = (0..8).map(|own| scope.spawn(move || attempt(own))).collect();
                threads.into_iter().map(|thread| thread.join().unwrap()).collect()
            });
            let (written, refused): (Vec<_>, Vec<_>) = results.into_iter().partition(Result::is_ok);
            assert_eq!(written.len(), 1, "{refused:?}");
            assert_eq!(fs::read_to_string(&path).unwrap(), written[0].unwrap().to_string());
            assert!(refused.iter().all(|error| *error == Err(Some(ErrorKind::AlreadyExists))), "{refused:?}");
            assert_eq!(names(path.parent().unwrap()), ["a.txt"]);
            fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn a_failing_writer_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        fs::write(&path, "old").unwrap();
        for hidden in [false, true] {
            let attempt = || {
                write(&path, |out| {
                    long(out)?;
                    Err("no more".into())
                })
            };
            let error = if hidden { faults::with_hidden_files(attempt) } else { attempt() }.unwrap_err();
            assert_eq!(error.to_string(), format!("{} cannot be written: no more", path.display()));
            assert_eq!(
                (fs::read_to_string(&path).unwrap().as_str(), names(folder.path())),
                ("old", vec!["a.txt".into()])
            );
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_replaced_file_hands_on_its_permissions_and_a_link_stays_a_link() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let [real, link, dangling, found] =
            ["real", "link", "dangling", "found"].map(|name| folder.path().join(name));
        fs::write(&real, "old").unwrap();
        fs::set_permissions(&real, fs::Permissions::from_mode(0o640)).unwrap();
        symlink("real", &link).unwrap();
        symlink("found", &dangling).unwrap();
        write_bytes(&link, b"new").unwrap();
        write_bytes(&dangling, b"new").unwrap();
        assert_eq!(fs::read_to_string(&real).unwrap(), "new");
        assert_eq!(fs::read_to_string(&found).unwrap(), "new");
        assert_eq!(fs::metadata(&real).unwrap().permissions().mode() & 0o777, 0o640);
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(names(folder.path()), ["dangling", "found", "link", "real"]);
        symlink("round", folder.path().join("round")).unwrap();
        assert!(write_bytes(&folder.path().join("round"), b"").is_err());
    }

    #[cfg(unix)]
    #[test]
    fn another_users_link_in_a_shared_folder_is_refused() {
        use std::os::unix::fs::{PermissionsExt, lchown, symlink};
        let folder = tempfile::tempdir().unwrap();
        let [victim, link] = ["victim", "link"].map(|name| folder.path().join(name));
        fs::write(&victim, "precious").unwrap();
        symlink("victim", &link).unwrap();
        let written = |mode| {
            fs::set_permissions(folder.path(), fs::Permissions::from_mode(mode)).unwrap();
            write_bytes(&link, b"new").map_err(|error| error.to_string())
        };
        assert_eq!(written(0o1777), Ok(()));
        fs::write(&victim, "precious").unwrap();
        // Only root can give a link away.
        if lchown(&link, Some(65_534), None).is_ok() {
            let error = written(0o1777).unwrap_err();
            assert!(error.ends_with("found one of user 65534"), "{error}");
            assert_eq!(fs::read_to_string(&victim).unwrap(), "precious");
            assert_eq!(written(0o755), Ok(()));
        }
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_file_is_written_directly_and_stays_what_it_is() {
        use std::os::unix::fs::FileTypeExt;
        write_bytes(Path::new("/dev/null"), b"gone").unwrap();
        assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
        #[cfg(target_os = "linux")]
        {
            let error = write_bytes(Path::new("/dev/full"), b"too much").unwrap_err().to_string();
            assert!(error.starts_with("/dev/full cannot be written: No space left"), "{error}");
        }
        let folder = tempfile::tempdir().unwrap();
        let error = write_bytes(folder.path(), b"").unwrap_err().to_string();
        assert!(error.contains("directory"), "{error}");
    }
}
