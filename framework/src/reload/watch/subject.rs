//! One wanted file over time: whether it holds something else than a build has read, and whether that is worth telling yet.
//!
//! No event is believed. Whenever one comes, all files are looked at; what counts is what they hold. A difference is *pending*
//! until the file has stood still for a while, so that a burst of writes is one change; a file that is gone or empty gets longer,
//! as that is how many editors begin to save.

use std::fs::{self, Metadata};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use crate::source::Content;

/// How patient a watcher is.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    pub quiet: Duration,
    pub moving: Duration,
    pub gone: Duration,
    pub gather: Duration,
    /// Between two looks at everything, whether something happened or not; `None`: never.
    pub rounds: Option<Duration>,
}

/// A file (or a place where one may appear) that is watched.
#[derive(Debug)]
pub struct Subject {
    /// As whoever watches calls it.
    pub given: PathBuf,
    /// Absolute.
    pub path: PathBuf,
    /// What needs no more telling: what was built, or announced since.
    pub told: Content,
    /// `told` was announced and not built yet.
    announced: bool,
    glance: Option<Glance>,
    pending: Option<Pending>,
}

/// What one look at a file showed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Glance {
    stamp: Option<Stamp>,
    content: Content,
}

/// What changes with a file's content, unless it changes twice within the clock's resolution.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stamp {
    length: u64,
    modified: Option<SystemTime>,
    /// Device, inode, and the time of the last change of either content or inode, in nanoseconds.
    inode: (u64, u64, i128),
}

/// A difference that was not announced yet.
#[derive(Clone, Copy, Debug)]
struct Pending {
    first_seen: Instant,
    /// Whether there is nothing, or an empty file, and since when that is so (or not).
    gone: bool,
    gone_since: Instant,
    /// Since when every look showed the same.
    steady_since: Instant,
    glance: Glance,
}

/// A difference, as it stands.
#[derive(Clone, Copy, Debug)]
pub struct Difference {
    pub first_seen: Instant,
    /// There is nothing, or an empty file.
    pub gone: bool,
    /// When it is worth telling, if nothing moves until then.
    pub due: Instant,
}

impl Subject {
    pub fn new(given: &Path) -> Subject {
        Subject {
            given: given.to_path_buf(),
            path: std::path::absolute(given).unwrap_or_else(|_| given.to_path_buf()),
            told: Content::Missing,
            announced: false,
            glance: None,
            pending: None,
        }
    }

    /// A build, or several, have read this. Call it right after a [`Subject::look`].
    pub fn built(&mut self, read: &[Content]) {
        let Some(now) = self.glance.map(|glance| glance.content) else { return };
        if let Some(other) = read.iter().find(|content| **content != now) {
            // What was announced since, a build on its way will read.
            if !(self.announced && self.told == now) {
                (self.told, self.announced) = (*other, false);
            }
        } else {
            (self.told, self.announced) = (now, false);
        }
        if self.told == now {
            self.pending = None;
        }
    }

    /// Reads the file, if it may have changed since the last time.
    pub fn look(&mut self) {
        let before = stamp(&self.path);
        if let Some(glance) = self.glance
            && glance.stamp == before
            && before.is_none_or(|stamp| stamp.is_old())
            && (before.is_some() || glance.content == Content::Missing)
        {
            return;
        }
        let content = Content::at(&self.path);
        // Of a file that is written while it is read, this may be half: it is read again the next time.
        let stamp = stamp(&self.path).filter(|after| before == Some(*after));
        self.glance = Some(Glance { stamp, content });
    }

    /// Weighs what the last look showed. `noticed` is when the event came that was the reason to look.
    pub fn weigh(&mut self, noticed: Instant, now: Instant) {
        let Some(glance) = self.glance else { return };
        if glance.content == self.told {
            self.pending = None;
            return;
        }
        let gone = glance.content.is_empty();
        let pending = self.pending.get_or_insert(Pending {
            first_seen: noticed,
            gone,
            gone_since: now,
            steady_since: now,
            glance,
        });
        if pending.gone != gone {
            (pending.gone, pending.gone_since) = (gone, now);
        }
        if pending.glance != glance {
            (pending.glance, pending.steady_since) = (glance, now);
        }
    }

    pub fn difference(&self, patience: &Patience) -> Option<Difference> {
        let Pending { first_seen, gone, gone_since, steady_since, .. } = self.pending?;
        let due = if gone {
            gone_since + patience.gone
        } else {
            (steady_since + patience.quiet).min(gone_since + patience.moving)
        };
        Some(Difference { first_seen, gone, due })
    }

    /// Counts the difference as told. Returns what the file holds.
    pub fn announce(&mut self) -> Content {
        if let Some(pending) = self.pending.take() {
            (self.told, self.announced) = (pending.glance.content, true);
        }
        self.told
    }
}

fn stamp(path: &Path) -> Option<Stamp> {
    let metadata = fs::metadata(path).ok()?;
    Some(Stamp { length: metadata.len(), modified: metadata.modified().ok(), inode: inode(&metadata) })
}

#[cfg(unix)]
fn inode(metadata: &Metadata) -> (u64, u64, i128) {
    use std::os::unix::fs::MetadataExt;
    let changed = i128::from(metadata.ctime()) * 1_000_000_000 + i128::from(metadata.ctime_nsec());
    (metadata.dev(), metadata.ino(), changed)
}

#[cfg(not(unix))]
fn inode(_: &Metadata) -> (u64, u64, i128) {
    (0, 0, 0)
}

impl Stamp {
    /// Old enough that a later write has another time, whatever the clock's resolution (2 s on FAT) and whoever's clock it is.
    fn is_old(self) -> bool {
        const RESOLUTION: Duration = Duration::from_secs(3);
        let age = self.modified.and_then(|modified| SystemTime::now().duration_since(modified).ok());
        age.is_some_and(|age| age > RESOLUTION)
    }
}
