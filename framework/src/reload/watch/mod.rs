//! Reports changed contents of the files that a build read.
//!
//! Events of the operating system only tell *when* to look. They come in bursts, differ between systems and editors,
//! and are often spurious. So each event makes the watcher look at all wanted files: it rereads a file if its metadata
//! changed or is recent, and compares hashes of the contents ([`Watcher::of_large_files`] compares only metadata). It
//! watches folders rather than files, because most editors save by replacing the file. For each wanted path it watches
//! the folders along it, including through symlinks (module `symlink_path`), so that it notices folders that appear and
//! disappear, and redirected links.
//!
//! The watcher has a thread. It also looks at regular intervals ([`ROUNDS`]), because some network and virtual file
//! systems send no events for writes by other machines. If it cannot receive events, it looks more often ([`POLLING`]).

mod subject;
mod symlink_path;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use notify::event::{AccessKind, AccessMode, EventKind, ModifyKind};
use notify::{ErrorKind, RecursiveMode};

use crate::source::{Content, Wanted};
use subject::{Patience, Subject};
use symlink_path::Walk;

/// Time for which a changed file must stay the same before it is reported.
pub const QUIET: Duration = Duration::from_millis(20);
/// Maximum time until a file that keeps changing is reported.
pub const MOVING: Duration = Duration::from_secs(1);
/// As [`QUIET`], for large files, whose writers pause.
pub const LARGE_QUIET: Duration = Duration::from_millis(100);
/// As [`MOVING`], for large files, which take long to write and are read from their beginning after each report.
pub const LARGE_MOVING: Duration = Duration::from_secs(10);
/// Time until a missing or empty file is reported: a save may have just begun.
pub const GONE: Duration = Duration::from_secs(1);
/// Maximum time that a change waits for other files to stop changing, so that files saved together are one change.
pub const GATHER: Duration = Duration::from_millis(100);
/// Interval between looks at all files while the system sends events.
pub const ROUNDS: Duration = Duration::from_secs(2);
/// Interval between looks at all files if the watcher cannot receive events.
pub const POLLING: Duration = Duration::from_millis(200);

/// Files that changed since a build read them, or since they were last reported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileChange {
    /// Sorted paths, as in [`Wanted::path`], including missing and new files.
    pub files: Vec<PathBuf>,
    /// Time of the first event, close to the moment of saving. Without an event, time of the look that found a change.
    pub first_seen: Instant,
}

/// The mechanism by which a watcher notices changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WatchKind {
    /// The system sends events.
    Events,
    /// The watcher polls. The text completes "polling, because ...".
    Polling(String),
}

impl fmt::Display for WatchKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            WatchKind::Events => f.write_str("events"),
            WatchKind::Polling(why) => write!(f, "polling, because {why}"),
        }
    }
}

/// A watcher of files; see the module's documentation. Dropping it ends its thread.
#[derive(Debug)]
pub struct Watcher {
    inbox: Sender<Message>,
    shared: Arc<Mutex<Shared>>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    kind: WatchKind,
    found: Option<Found>,
}

#[derive(Debug)]
struct Found {
    files: BTreeMap<PathBuf, Content>,
    first_seen: Instant,
}

enum Message {
    Event(Instant, notify::Result<notify::Event>),
    Watch(Vec<Wanted>),
    Stop,
    /// A request for a reply once all earlier messages have been handled.
    #[cfg(test)]
    Answer(Sender<()>),
}

type Native = Box<dyn notify::Watcher + Send>;
type Handler = Box<dyn FnMut(notify::Result<notify::Event>) + Send>;

impl Watcher {
    /// Starts a watcher without files. `wake` is called on the watcher's thread when there is a change to take, and
    /// when the [kind](Watcher::kind) changes. Fails if the system cannot create a thread.
    pub fn new(wake: impl Fn() + Send + 'static) -> std::io::Result<Watcher> {
        Watcher::start(PATIENCE, native, wake)
    }

    /// Starts a watcher of large files, as [`Watcher::new`] does. It does not read them: contents are those of
    /// [`Content::stamp`]. It waits longer until they have been written: [`LARGE_QUIET`] and [`LARGE_MOVING`].
    pub fn of_large_files(wake: impl Fn() + Send + 'static) -> std::io::Result<Watcher> {
        let patience =
            Patience { quiet: LARGE_QUIET, moving: LARGE_MOVING, content: Content::stamp, ..PATIENCE };
        Watcher::start(patience, native, wake)
    }

    fn start(
        patience: Patience,
        native: impl FnOnce(Handler) -> notify::Result<Native>,
        wake: impl Fn() + Send + 'static,
    ) -> std::io::Result<Watcher> {
        let (inbox, messages) = channel();
        let events = inbox.clone();
        let native = native(Box::new(move |event| {
            // Ignore reads, most of which are the watcher's own.
            if !event.as_ref().is_ok_and(|event| is_reading(&event.kind)) {
                // This fails only if the watcher is being dropped, or after a panic in `wake`.
                let _ = events.send(Message::Event(Instant::now(), event));
            }
        }));
        let (native, kind) = match native {
            Ok(native) => (Some(native), WatchKind::Events),
            Err(error) => (None, WatchKind::Polling(reason(&error))),
        };
        let shared = Arc::new(Mutex::new(Shared { kind, found: None }));
        let look_out = LookOut {
            patience,
            native,
            shared: shared.clone(),
            wake,
            subjects: Vec::new(),
            entries: HashSet::new(),
            watched: BTreeSet::new(),
            stale: BTreeSet::new(),
            looked: Instant::now(),
        };
        let builder = thread::Builder::new().name("watch".into());
        let thread = builder.spawn(move || look_out.run(&messages))?;
        Ok(Watcher { inbox, shared, thread: Some(thread) })
    }

    /// Replaces the watched paths.
    ///
    /// Call it after each build, successful or not, with all files that the build read. A file that has changed since
    /// is reported after the usual delays. A path may occur several times, with the contents of several builds.
    pub fn watch(&mut self, wanted: &[Wanted]) {
        let mut shared = lock(&self.shared);
        if let Some(found) = &mut shared.found {
            // Drop the changes that the build has read, and those of files that are no longer wanted.
            found.files.retain(|path, content| {
                wanted.iter().any(|wanted| wanted.path == *path && wanted.content != *content)
            });
            if found.files.is_empty() {
                shared.found = None;
            }
        }
        drop(shared);
        // The thread ends early only by a panic in `wake`, which was reported.
        let _ = self.inbox.send(Message::Watch(wanted.to_vec()));
    }

    /// Takes the changes since the last call; `None` if there are none. The caller must then begin a build: the watcher
    /// assumes that this build reads the new contents.
    pub fn take(&mut self) -> Option<FileChange> {
        let Found { files, first_seen } = lock(&self.shared).found.take()?;
        Some(FileChange { files: files.into_keys().collect(), first_seen })
    }

    /// Returns the mechanism by which changes are currently noticed.
    pub fn kind(&self) -> WatchKind {
        lock(&self.shared).kind.clone()
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        let _ = self.inbox.send(Message::Stop);
        if let Some(thread) = self.thread.take() {
            // A panic there (in `wake`) was already reported.
            let _ = thread.join();
        }
    }
}

const PATIENCE: Patience = Patience {
    quiet: QUIET,
    moving: MOVING,
    gone: GONE,
    gather: GATHER,
    rounds: Some(ROUNDS),
    content: Content::at,
};

/// Maximum number of messages read before the next look at the files.
const MAX_AT_ONCE: usize = 1000;
/// Maximum number of attempts to find the folders to watch, which may change meanwhile.
const MAX_WALKS: usize = 8;

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    // Nothing panics while it holds the lock.
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn native(handler: Handler) -> notify::Result<Native> {
    Ok(Box::new(notify::recommended_watcher(handler)?))
}

fn is_reading(kind: &EventKind) -> bool {
    matches!(kind, EventKind::Access(access) if *access != AccessKind::Close(AccessMode::Write))
}

/// Describes why there are no events; the text completes "because ...".
fn reason(error: &notify::Error) -> String {
    match &error.kind {
        ErrorKind::Generic(text) => text.clone(),
        ErrorKind::MaxFilesWatch => "the system's limit on watched folders is reached".into(),
        ErrorKind::Io(error) => format!("the system does not report changes ({error})"),
        _ => format!("the system does not report changes ({error})"),
    }
}

struct LookOut<Wake> {
    patience: Patience,
    /// `None` while polling.
    native: Option<Native>,
    shared: Arc<Mutex<Shared>>,
    wake: Wake,
    subjects: Vec<Subject>,
    /// All entries along the subjects' paths: events about other paths are ignored.
    entries: HashSet<PathBuf>,
    /// Folders that send events, and folders whose watch failed and is not tried again.
    watched: BTreeSet<PathBuf>,
    /// Watched folders that may have been replaced.
    stale: BTreeSet<PathBuf>,
    looked: Instant,
}

impl<Wake: Fn()> LookOut<Wake> {
    fn run(mut self, messages: &Receiver<Message>) {
        loop {
            let next_look = self.next_look();
            let first = match next_look {
                None => messages.recv().map_err(|_| RecvTimeoutError::Disconnected),
                Some(time) => messages.recv_timeout(time.saturating_duration_since(Instant::now())),
            };
            let mut noticed = None;
            match first {
                Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => {}
                Ok(first) => {
                    for message in std::iter::once(first).chain(messages.try_iter().take(MAX_AT_ONCE)) {
                        match message {
                            Message::Stop => return,
                            Message::Watch(wanted) => self.want(wanted),
                            #[cfg(test)]
                            Message::Answer(to) => _ = to.send(()),
                            Message::Event(time, event) => {
                                if self.matters(&event) {
                                    noticed = noticed.or(Some(time));
                                }
                            }
                        }
                    }
                }
            }
            // A look can be due even if only irrelevant messages arrive.
            let now = Instant::now();
            let noticed = noticed.or(next_look.filter(|time| *time <= now).map(|_| now));
            if let Some(noticed) = noticed {
                self.look(noticed);
            }
            self.announce();
        }
    }

    /// Returns the time of the next look if no event comes; `None` to wait for a message.
    fn next_look(&self) -> Option<Instant> {
        let rounds = if self.native.is_some() { self.patience.rounds } else { Some(POLLING) };
        let rounds = rounds.filter(|_| !self.subjects.is_empty()).map(|rounds| self.looked + rounds);
        let differences = self.subjects.iter().filter_map(|subject| subject.difference(&self.patience));
        let due = differences.map(|difference| {
            // A change that is due may still wait for other files.
            if difference.due > self.looked { difference.due } else { difference.due + self.patience.gather }
        });
        due.chain(rounds).min()
    }

    fn want(&mut self, wanted: Vec<Wanted>) {
        let mut before: HashMap<PathBuf, Subject> =
            self.subjects.drain(..).map(|subject| (subject.given.clone(), subject)).collect();
        let mut read: BTreeMap<PathBuf, Vec<Content>> = BTreeMap::new();
        for Wanted { path, content } in wanted {
            read.entry(path).or_default().push(content);
        }
        let subject = |path: &PathBuf| before.remove(path).unwrap_or_else(|| Subject::new(path));
        self.subjects = read.keys().map(subject).collect();
        // Watch before looking, so that any change after the look causes an event.
        self.watch_folders();
        let now = Instant::now();
        for (subject, read) in self.subjects.iter_mut().zip(read.values()) {
            subject.look(self.patience.content);
            subject.built(read);
            subject.weigh(now, now);
        }
        self.looked = now;
    }

    /// Returns true if an event may concern a wanted file. Marks the watches that it may have broken as stale. Starts
    /// to poll if the system has no watch left.
    fn matters(&mut self, event: &notify::Result<notify::Event>) -> bool {
        let event = match event {
            Ok(event) if !event.need_rescan() => event,
            // Events were lost.
            Ok(_) => {
                self.stale = self.watched.clone();
                return true;
            }
            Err(error) => {
                if matches!(error.kind, ErrorKind::MaxFilesWatch) {
                    self.poll(error);
                }
                self.stale = self.watched.clone();
                return true;
            }
        };
        let mut matters = event.paths.is_empty();
        for path in &event.paths {
            matters |= self.entries.contains(&*spelling(path));
            // After a folder was removed, created or renamed, the watches on it and its subfolders refer to the old
            // folder.
            if !matches!(event.kind, EventKind::Modify(ModifyKind::Data(_) | ModifyKind::Metadata(_))) {
                self.stale.extend(self.watched.iter().filter(|folder| folder.starts_with(path)).cloned());
            }
        }
        matters
    }

    /// Updates the watched folders, and rereads the files that may have changed. `noticed` is the time of the event or
    /// timeout that caused the look.
    fn look(&mut self, noticed: Instant) {
        self.watch_folders();
        let now = Instant::now();
        for subject in &mut self.subjects {
            subject.look(self.patience.content);
            subject.weigh(noticed.min(now), now);
        }
        self.looked = now;
    }

    fn watch_folders(&mut self) {
        for _ in 0..MAX_WALKS {
            let mut walk = Walk::default();
            // The flag is true if a wanted file is in the folder, or would be.
            let mut folders: BTreeMap<PathBuf, bool> = BTreeMap::new();
            self.entries.clear();
            for subject in &self.subjects {
                let entries = walk.entries(&subject.path);
                for (index, entry) in entries.iter().enumerate() {
                    let is_last = index + 1 == entries.len();
                    if EVERY_FOLDER || entry.is_link || index + 2 >= entries.len() {
                        *folders.entry(entry.folder.clone()).or_default() |= is_last;
                    }
                    self.entries.insert(spelling(&entry.path).into_owned());
                }
            }
            // A folder may have changed just before its watch began: walk again.
            if !self.update(&folders) {
                return;
            }
        }
    }

    /// Watches exactly these folders, without missing ones. Returns true if it added any. Starts to poll if the watch
    /// of a folder with a set flag fails, or the system has no watch left. Does nothing while polling.
    fn update(&mut self, folders: &BTreeMap<PathBuf, bool>) -> bool {
        let Some(native) = &mut self.native else { return false };
        let stale = std::mem::take(&mut self.stale);
        let kept = |folder: &&PathBuf| folders.contains_key(*folder) && !stale.contains(*folder);
        let keep: BTreeSet<PathBuf> = self.watched.iter().filter(kept).cloned().collect();
        let drop: Vec<&PathBuf> = self.watched.difference(&keep).collect();
        let add: Vec<(&PathBuf, &bool)> =
            folders.iter().filter(|(folder, _)| !keep.contains(*folder)).collect();
        if drop.is_empty() && add.is_empty() {
            return false;
        }
        let (mut added, mut failure) = (Vec::new(), None);
        let mut paths = native.paths_mut();
        for folder in drop {
            // The folder may be gone, and its watch with it.
            let _ = paths.remove(folder);
        }
        for (folder, matters) in add {
            match paths.add(folder, RecursiveMode::NonRecursive) {
                Ok(()) => added.push(folder.clone()),
                Err(error) if is_gone(&error) => {}
                Err(error) if *matters || matches!(error.kind, ErrorKind::MaxFilesWatch) => {
                    failure = Some(error)
                }
                // A folder far above the files, such as an unreadable `/home`: rely on the regular looks.
                Err(_) => added.push(folder.clone()),
            }
        }
        let committed = paths.commit();
        self.watched = keep;
        let any = !added.is_empty();
        self.watched.extend(added);
        if let Some(error) = failure.or(committed.err()) {
            self.poll(&error);
        }
        any
    }

    fn poll(&mut self, error: &notify::Error) {
        self.native = None;
        self.watched.clear();
        lock(&self.shared).kind = WatchKind::Polling(reason(error));
        (self.wake)();
    }

    /// Reports the changes that are due, unless they should wait for other files.
    fn announce(&mut self) {
        let differences =
            self.subjects.iter().enumerate().filter_map(|(i, s)| Some((i, s.difference(&self.patience)?)));
        let (due, moving): (Vec<_>, Vec<_>) = differences.partition(|(_, d)| d.due <= self.looked);
        let patient = |(_, d): &(usize, subject::Difference)| self.looked < d.due + self.patience.gather;
        if due.is_empty() || (moving.iter().any(|(_, d)| !d.gone) && due.iter().all(patient)) {
            return;
        }
        let mut shared = lock(&self.shared);
        for (index, difference) in due {
            let subject = &mut self.subjects[index];
            let first_seen = difference.first_seen;
            let found = shared.found.get_or_insert(Found { files: BTreeMap::new(), first_seen });
            found.first_seen = found.first_seen.min(first_seen);
            found.files.insert(subject.given.clone(), subject.announce());
        }
        drop(shared);
        (self.wake)();
    }
}

/// True if all folders along a path are watched, false if only the last two and those that contain links. On macOS,
/// watching `/` would send the events of the whole machine, so changes further up wait for the next regular look.
const EVERY_FOLDER: bool = !cfg!(target_os = "macos");

/// Normalises a path for comparison with the paths of events: to lower case on systems that ignore case.
fn spelling(path: &Path) -> std::borrow::Cow<'_, Path> {
    if cfg!(any(target_os = "macos", windows)) {
        PathBuf::from(path.to_string_lossy().to_lowercase()).into()
    } else {
        path.into()
    }
}

fn is_gone(error: &notify::Error) -> bool {
    match &error.kind {
        ErrorKind::PathNotFound => true,
        ErrorKind::Io(error) => {
            matches!(error.kind(), std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory)
        }
        _ => false,
    }
}
