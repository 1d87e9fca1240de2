//! Reports changed contents of the files that a build read.
//!
//! A thread looks at all wanted files at regular intervals ([`INTERVAL`]). It rereads a file if its metadata changed or
//! is recent, and compares hashes of the contents ([`Watcher::of_large_files`] compares only metadata). A look follows
//! symlinks, and takes 0.1 ms for a hundred files.
//!
//! An event of the operating system in a wanted file's folder only triggers a look: events come in bursts, are often
//! spurious, do not cover links and folders that are yet to be created, and are missing on network drives. The watcher
//! asks for the events of folders, not of files, because most editors save by replacing the file.

mod subject;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ffi::OsStr;
use std::iter;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use notify::event::{AccessKind, AccessMode, EventKind};
use notify::{RecommendedWatcher, RecursiveMode, Watcher as _};

use crate::source::{Content, Wanted};
use subject::{Patience, Subject};

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
/// Interval between looks at all files without an event. It is longer where a look takes long: see `SHARE`.
pub const INTERVAL: Duration = Duration::from_millis(200);

/// Files that changed since a build read them, or since they were last reported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileChange {
    /// Sorted paths, as in [`Wanted::path`], including missing and new files.
    pub files: Vec<PathBuf>,
    /// Time of the look that found the first change.
    pub first_seen: Instant,
}

/// A watcher of files; see the module's documentation. Dropping it ends its thread.
#[derive(Debug)]
pub struct Watcher {
    inbox: Sender<Message>,
    found: Arc<Mutex<Option<Found>>>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Found {
    files: BTreeMap<PathBuf, Content>,
    first_seen: Instant,
}

enum Message {
    /// An event at these paths; without paths, anywhere.
    Event(Vec<PathBuf>),
    Watch(Vec<Wanted>),
    Stop,
    /// A request for a reply once all earlier messages have been handled.
    #[cfg(test)]
    Answer(Sender<()>),
}

impl Watcher {
    /// Starts a watcher without files. `wake` is called on the watcher's thread when there is a change to take. Fails
    /// if the system cannot create a thread.
    pub fn new(wake: impl Fn() + Send + 'static) -> std::io::Result<Watcher> {
        Watcher::start(PATIENCE, wake)
    }

    /// Starts a watcher of large files, as [`Watcher::new`] does. It does not read them: contents are those of
    /// [`Content::stamp`]. It waits longer until they have been written: [`LARGE_QUIET`] and [`LARGE_MOVING`].
    pub fn of_large_files(wake: impl Fn() + Send + 'static) -> std::io::Result<Watcher> {
        let patience =
            Patience { quiet: LARGE_QUIET, moving: LARGE_MOVING, content: Content::stamp, ..PATIENCE };
        Watcher::start(patience, wake)
    }

    fn start(patience: Patience, wake: impl Fn() + Send + 'static) -> std::io::Result<Watcher> {
        let (inbox, messages) = channel();
        let found = Arc::new(Mutex::new(None));
        let look_out = LookOut {
            patience,
            events: events(inbox.clone()),
            folders: BTreeSet::new(),
            found: found.clone(),
            wake,
            subjects: Vec::new(),
            looked: Instant::now(),
            next_round: Instant::now(),
        };
        let builder = thread::Builder::new().name("watch".into());
        let thread = builder.spawn(move || look_out.run(&messages))?;
        Ok(Watcher { inbox, found, thread: Some(thread) })
    }

    /// Replaces the watched paths.
    ///
    /// Call it after each build, successful or not, with all files that the build read. A file that has changed since
    /// is reported after the usual delays. A path may occur several times, with the contents of several builds.
    pub fn watch(&mut self, wanted: &[Wanted]) {
        let mut shown = lock(&self.found);
        if let Some(found) = &mut *shown {
            // Drop the changes that the build has read, and those of files that are no longer wanted.
            found.files.retain(|path, content| {
                wanted.iter().any(|wanted| wanted.path == *path && wanted.content != *content)
            });
        }
        shown.take_if(|found| found.files.is_empty());
        drop(shown);
        // The thread ends early only by a panic in `wake`, which was reported.
        let _ = self.inbox.send(Message::Watch(wanted.to_vec()));
    }

    /// Takes the changes since the last call; `None` if there are none. The caller must then begin a build: the watcher
    /// assumes that this build reads the new contents.
    pub fn take(&mut self) -> Option<FileChange> {
        let Found { files, first_seen } = lock(&self.found).take()?;
        Some(FileChange { files: files.into_keys().collect(), first_seen })
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
    interval: INTERVAL,
    content: Content::at,
};

/// Inverse of the share of time that looks may take. On a slow network drive, looks are less frequent.
const SHARE: u32 = 20;
/// Maximum interval between looks that take long.
const MAX_INTERVAL: Duration = Duration::from_secs(2);

fn lock(found: &Mutex<Option<Found>>) -> MutexGuard<'_, Option<Found>> {
    // Nothing panics while it holds the lock.
    found.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Starts sending the system's file events, except reads, to `inbox`. `None` if the system offers none.
fn events(inbox: Sender<Message>) -> Option<RecommendedWatcher> {
    let handler = move |event: notify::Result<notify::Event>| {
        let paths = match event {
            // Most of these reads are the watcher's own.
            Ok(event) if is_reading(&event.kind) => return,
            Ok(event) => event.paths,
            // Events were lost.
            Err(_) => Vec::new(),
        };
        // This fails only if the watcher is being dropped, or after a panic in `wake`.
        let _ = inbox.send(Message::Event(paths));
    };
    notify::recommended_watcher(handler).ok()
}

fn is_reading(kind: &EventKind) -> bool {
    matches!(kind, EventKind::Access(access) if *access != AccessKind::Close(AccessMode::Write))
}

/// Maximum number of messages that are handled before the next look.
const MAX_AT_ONCE: usize = 1000;

struct LookOut<Wake> {
    patience: Patience,
    events: Option<RecommendedWatcher>,
    /// The folders that send events.
    folders: BTreeSet<PathBuf>,
    found: Arc<Mutex<Option<Found>>>,
    wake: Wake,
    subjects: Vec<Subject>,
    looked: Instant,
    next_round: Instant,
}

impl<Wake: Fn()> LookOut<Wake> {
    fn run(mut self, messages: &Receiver<Message>) {
        loop {
            let next_look = self.next_look();
            let first = match next_look {
                None => messages.recv().map_err(|_| RecvTimeoutError::Disconnected),
                Some(time) => messages.recv_timeout(time.saturating_duration_since(Instant::now())),
            };
            let (mut looks, mut renews) = (false, false);
            let messages = match first {
                Ok(first) => Some(iter::once(first).chain(messages.try_iter().take(MAX_AT_ONCE))),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            for message in messages.into_iter().flatten() {
                match message {
                    Message::Stop => return,
                    Message::Watch(wanted) => self.want(wanted),
                    Message::Event(paths) => {
                        looks |= self.concerns(&paths);
                        renews |= self.may_replace_a_folder(&paths);
                    }
                    #[cfg(test)]
                    Message::Answer(to) => _ = to.send(()),
                }
            }
            if renews {
                self.listen(true);
                // Earlier changes in the new folder had no event.
                looks = true;
            }
            // A look can be due even if messages keep coming.
            if looks || next_look.is_some_and(|time| time <= Instant::now()) {
                self.look();
            }
            self.announce();
        }
    }

    /// Returns the time of the next look; `None` to wait for a message.
    fn next_look(&self) -> Option<Instant> {
        let differences = self.subjects.iter().filter_map(|subject| subject.difference(&self.patience));
        let due = differences.map(|difference| {
            // A change that is due may still wait for other files.
            if difference.due > self.looked { difference.due } else { difference.due + self.patience.gather }
        });
        due.chain((!self.subjects.is_empty()).then_some(self.next_round)).min()
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
        // Before the look, so that any change after it has an event.
        self.listen(false);
        self.look();
        for (subject, read) in self.subjects.iter_mut().zip(read.values()) {
            subject.built(read);
            subject.weigh(self.looked);
        }
    }

    /// Asks for the events of the wanted files' folders. The regular looks suffice for a folder that is missing, or
    /// that the system cannot report on. `renew` if one may have been replaced: its watch is that of the old folder.
    fn listen(&mut self, renew: bool) {
        let Some(events) = &mut self.events else { return };
        let folders = self.subjects.iter().filter_map(|subject| subject.path.parent());
        let folders: BTreeSet<PathBuf> =
            folders.filter(|folder| folder.is_dir()).map(Path::to_owned).collect();
        // On some systems, any change to the watched folders restarts the event stream.
        if folders == self.folders && !renew {
            return;
        }
        let mut paths = events.paths_mut();
        for folder in &self.folders {
            let _ = paths.remove(folder);
        }
        for folder in &folders {
            let _ = paths.add(folder, RecursiveMode::NonRecursive);
        }
        let _ = paths.commit();
        self.folders = folders;
    }

    /// Returns true if an event at these paths may be one of a wanted file. The names are compared, because some
    /// systems report other folders for a path through a link.
    fn concerns(&self, paths: &[PathBuf]) -> bool {
        let mut wanted = self.subjects.iter().filter_map(|subject| subject.path.file_name());
        let is_named = |name: &OsStr| {
            paths.iter().any(|path| path.file_name().is_some_and(|own| own.eq_ignore_ascii_case(name)))
        };
        paths.is_empty() || wanted.any(is_named)
    }

    /// Returns true if an event at these paths may be that a wanted file's folder was created, renamed or removed.
    fn may_replace_a_folder(&self, paths: &[PathBuf]) -> bool {
        let mut folders = self.subjects.iter().filter_map(|subject| subject.path.parent());
        folders.any(|folder| paths.iter().any(|path| path == folder))
    }

    /// Rereads the files that may have changed.
    fn look(&mut self) {
        let now = Instant::now();
        for subject in &mut self.subjects {
            subject.look(self.patience.content);
            subject.weigh(now);
        }
        self.looked = now;
        self.next_round = now + self.patience.interval.max((SHARE * now.elapsed()).min(MAX_INTERVAL));
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
        let mut shown = lock(&self.found);
        for (index, difference) in due {
            let subject = &mut self.subjects[index];
            let first_seen = difference.first_seen;
            let found = shown.get_or_insert(Found { files: BTreeMap::new(), first_seen });
            found.first_seen = found.first_seen.min(first_seen);
            found.files.insert(subject.given.clone(), subject.announce());
        }
        drop(shown);
        (self.wake)();
    }
}
