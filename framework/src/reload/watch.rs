//! Tells when files that a build looked at hold something else.
//!
//! The operating system's events say *when* to look, and no more. They come in bursts, differ between systems and editors, and
//! are often about nothing: so at each, all wanted files are looked at, and what counts is a hash of what they hold. Folders
//! are watched rather than files, since most editors save by putting a new file in the place of the old one. Of each wanted
//! path these are all folders that it leads through, links included (the `trail` module), so that it is noticed, too, when a
//! folder appears, goes away and comes back, or when a link is turned to another place.
//!
//! A thread does this. Beside events it looks round every now and then ([`ROUNDS`]), for what no event tells: some network and
//! virtual file systems have none for what others write. Where there are no events at all, it looks more often ([`POLLING`]).
//! That is the better part of what `notify`'s own polling would do, which lists whole folders, while here it is known which files
//! matter.
//!
//! How much patience there is with files that are being written is said by the constants below.

mod subject;
#[cfg(test)]
mod tests;
mod trail;

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
use trail::Walk;

/// How long a file has to stand still before its change counts.
pub const QUIET: Duration = Duration::from_millis(20);
/// A file that never stands still counts after this, as it is.
pub const MOVING: Duration = Duration::from_secs(1);
/// A file that is gone, or empty, counts after this: a save may have just begun.
pub const GONE: Duration = Duration::from_secs(1);
/// How long a change waits for other files that are still moving, so that files saved together are one change.
pub const GATHER: Duration = Duration::from_millis(100);
/// All files are looked at this often, even where events would tell.
pub const ROUNDS: Duration = Duration::from_secs(2);
/// And this often where there are no events.
pub const POLLING: Duration = Duration::from_millis(200);

/// Files changed since they were built, or announced.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// Which, as [`Wanted::path`] has them, sorted. Also those that are gone, or were not there before.
    pub files: Vec<PathBuf>,
    /// When the first of the events came that led to this: close to when somebody pressed "save".
    pub first_seen: Instant,
}

/// There is no watcher.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    #[error("no thread can be started to watch files: {0}")]
    Thread(#[from] std::io::Error),
}

/// How a watcher learns of changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WatchKind {
    /// The system tells.
    Events,
    /// It looks, again and again. The text says why, as in "polling, because ...".
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

/// See the module's documentation. Dropping it ends its thread.
#[derive(Debug)]
pub struct Watcher {
    inbox: Sender<Message>,
    shared: Arc<Mutex<Shared>>,
    thread: Option<JoinHandle<()>>,
}

/// What the thread has to say.
#[derive(Debug)]
struct Shared {
    kind: WatchKind,
    found: Option<Found>,
}

/// A change that was not taken yet.
#[derive(Debug)]
struct Found {
    /// What each file holds.
    files: BTreeMap<PathBuf, Content>,
    first_seen: Instant,
}

enum Message {
    Event(Instant, notify::Result<notify::Event>),
    Watch(Vec<Wanted>),
    Stop,
    /// Answered at once: everything sent before was seen to.
    #[cfg(test)]
    Answer(Sender<()>),
}

type Native = Box<dyn notify::Watcher + Send>;
type Handler = Box<dyn FnMut(notify::Result<notify::Event>) + Send>;

impl Watcher {
    /// Starts to watch, nothing yet. `wake` is called, on a thread of the watcher's own, when there is a change to take, and
    /// when the [kind](Watcher::kind) is another.
    pub fn new(wake: impl Fn() + Send + 'static) -> Result<Watcher, WatchError> {
        let native =
            |handler| -> notify::Result<Native> { Ok(Box::new(notify::recommended_watcher(handler)?)) };
        Watcher::start(PATIENCE, native, wake)
    }

    /// The same without the system's events, for file systems that have none worth trusting.
    pub fn polling(wake: impl Fn() + Send + 'static) -> Result<Watcher, WatchError> {
        Watcher::start(PATIENCE, |_| Err(notify::Error::generic(ON_DEMAND)), wake)
    }

    fn start(
        patience: Patience,
        native: impl FnOnce(Handler) -> notify::Result<Native>,
        wake: impl Fn() + Send + 'static,
    ) -> Result<Watcher, WatchError> {
        let (inbox, messages) = channel();
        let events = inbox.clone();
        let native = native(Box::new(move |event| {
            // That files are read is no news; above all not that we read them.
            if !event.as_ref().is_ok_and(|event| is_reading(&event.kind)) {
                // The watcher is gone, or will be.
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

    /// Watches these paths and no others. To be called after each build, with everything that it looked at, whether it
    /// succeeded or not; what changed since the build read it is a change at once. A path may be there several times, with
    /// what several builds have read.
    pub fn watch(&mut self, wanted: &[Wanted]) {
        let mut shared = lock(&self.shared);
        if let Some(found) = &mut shared.found {
            // What the build has read already need not be built again.
            found.files.retain(|path, content| {
                wanted.iter().any(|wanted| wanted.path == *path && wanted.content != *content)
            });
            if found.files.is_empty() {
                shared.found = None;
            }
        }
        drop(shared);
        // Without a thread there was a panic, in `wake`: it was reported, and nobody listens.
        let _ = self.inbox.send(Message::Watch(wanted.to_vec()));
    }

    /// What changed since the last call. Whoever takes a change has to begin a build after that: the watcher counts on it.
    pub fn take(&mut self) -> Option<Change> {
        let Found { files, first_seen } = lock(&self.shared).found.take()?;
        Some(Change { files: files.into_keys().collect(), first_seen })
    }

    /// How changes are noticed at present.
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

const PATIENCE: Patience =
    Patience { quiet: QUIET, moving: MOVING, gone: GONE, gather: GATHER, rounds: Some(ROUNDS) };

const ON_DEMAND: &str = "that is wanted";

/// Messages that are read before the files are looked at again.
const MOST_AT_ONCE: usize = 1000;
/// How often the folders to watch are worked out before giving way; they may change meanwhile.
const MOST_WALKS: usize = 8;

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    // Nothing panics while it holds the lock.
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn is_reading(kind: &EventKind) -> bool {
    matches!(kind, EventKind::Access(access) if *access != AccessKind::Close(AccessMode::Write))
}

/// Why there are no events, to be read after "because".
fn reason(error: &notify::Error) -> String {
    match &error.kind {
        ErrorKind::Generic(text) => text.clone(),
        ErrorKind::MaxFilesWatch => "the system's limit on watched folders is reached".into(),
        ErrorKind::Io(error) => format!("the system does not tell of changes ({error})"),
        _ => format!("the system does not tell of changes ({error})"),
    }
}

/// The thread's part.
struct LookOut<Wake> {
    patience: Patience,
    /// `None` while polling.
    native: Option<Native>,
    shared: Arc<Mutex<Shared>>,
    wake: Wake,
    subjects: Vec<Subject>,
    /// The paths of all entries that the subjects lead through: events about anything else do not matter.
    entries: HashSet<PathBuf>,
    /// Folders whose events come.
    watched: BTreeSet<PathBuf>,
    /// Of these, those that may be other folders by now.
    stale: BTreeSet<PathBuf>,
    /// When everything was looked at last.
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
                    for message in std::iter::once(first).chain(messages.try_iter().take(MOST_AT_ONCE)) {
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
            // Also where messages that do not matter come without end.
            let now = Instant::now();
            let noticed = noticed.or(next_look.filter(|time| *time <= now).map(|_| now));
            if let Some(noticed) = noticed {
                self.look(noticed);
            }
            self.announce();
        }
    }

    /// When to look again if nothing happens before.
    fn next_look(&self) -> Option<Instant> {
        let rounds = if self.native.is_some() { self.patience.rounds } else { Some(POLLING) };
        let rounds = rounds.filter(|_| !self.subjects.is_empty()).map(|rounds| self.looked + rounds);
        let differences = self.subjects.iter().filter_map(|subject| subject.difference(&self.patience));
        let due = differences.map(|difference| {
            // What is due already waits for others.
            if difference.due > self.looked { difference.due } else { difference.due + self.patience.gather }
        });
        due.chain(rounds).min()
    }

    /// Takes on a new set of paths.
    fn want(&mut self, wanted: Vec<Wanted>) {
        let mut before: HashMap<PathBuf, Subject> =
            self.subjects.drain(..).map(|subject| (subject.given.clone(), subject)).collect();
        let mut read: BTreeMap<PathBuf, Vec<Content>> = BTreeMap::new();
        for Wanted { path, content } in wanted {
            read.entry(path).or_default().push(content);
        }
        let subject = |path: &PathBuf| before.remove(path).unwrap_or_else(|| Subject::new(path));
        self.subjects = read.keys().map(subject).collect();
        // Before looking: what happens afterwards is an event.
        self.watch_folders();
        let now = Instant::now();
        for (subject, read) in self.subjects.iter_mut().zip(read.values()) {
            subject.look();
            subject.built(read);
            subject.weigh(now, now);
        }
        self.looked = now;
    }

    /// Whether an event may be about a wanted file.
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
            // A folder that went, came or was renamed is not the one that is watched, nor are those in it.
            if !matches!(event.kind, EventKind::Modify(ModifyKind::Data(_) | ModifyKind::Metadata(_))) {
                self.stale.extend(self.watched.iter().filter(|folder| folder.starts_with(path)).cloned());
            }
        }
        matters
    }

    /// Looks at everything.
    fn look(&mut self, noticed: Instant) {
        self.watch_folders();
        let now = Instant::now();
        for subject in &mut self.subjects {
            subject.look();
            subject.weigh(noticed.min(now), now);
        }
        self.looked = now;
    }

    /// Watches the folders that the subjects lead through now, and no others.
    fn watch_folders(&mut self) {
        for _ in 0..MOST_WALKS {
            let mut walk = Walk::default();
            // And whether it matters most: a wanted file is in it, or would be.
            let mut folders: BTreeMap<PathBuf, bool> = BTreeMap::new();
            self.entries.clear();
            for subject in &self.subjects {
                let trail = walk.trail(&subject.path);
                for (index, entry) in trail.iter().enumerate() {
                    let is_last = index + 1 == trail.len();
                    if EVERY_FOLDER || entry.is_link || index + 2 >= trail.len() {
                        *folders.entry(entry.folder.clone()).or_default() |= is_last;
                    }
                    self.entries.insert(spelling(&entry.path).into_owned());
                }
            }
            // A folder that begins to be watched may have changed just before that: walk again.
            if !self.update(&folders) {
                return;
            }
        }
    }

    /// Makes `watched` the same as `folders`. Whether any was added.
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
            // It may be gone, and its watch with it.
            let _ = paths.remove(folder);
        }
        for (folder, matters) in add {
            match paths.add(folder, RecursiveMode::NonRecursive) {
                Ok(()) => added.push(folder.clone()),
                Err(error) if is_gone(&error) => {}
                Err(error) if *matters || matches!(error.kind, ErrorKind::MaxFilesWatch) => {
                    failure = Some(error)
                }
                // Far above the files (`/home`, say, where one may not look). The rounds have to do.
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

    /// Gives up events.
    fn poll(&mut self, error: &notify::Error) {
        self.native = None;
        self.watched.clear();
        lock(&self.shared).kind = WatchKind::Polling(reason(error));
        (self.wake)();
    }

    /// Announces what is due, unless it had better wait for other files.
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

/// Whether to watch every folder that a path leads through, up to the root, or only the last ones and those with links. On
/// macOS a watched folder brings the events of all that is below it, which of the root is the whole machine; there, what happens
/// further up waits for the next round.
const EVERY_FOLDER: bool = !cfg!(target_os = "macos");

/// A path as events may spell it: on systems whose names differ in case only by decree, all in lower case.
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
