//! Tracks one wanted file: whether its contents differ from those that a build read, and when to report a difference.
//!
//! A difference is *pending* until the file has been unchanged for a while, so that a burst of writes is one change,
//! or has kept changing for too long. The delay is longer for a missing or empty file, because many editors begin a
//! save that way.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use crate::source::{Content, Stamp};

#[derive(Clone, Copy)]
pub struct Patience {
    pub quiet: Duration,
    pub moving: Duration,
    pub gone: Duration,
    pub gather: Duration,
    /// Minimum interval between looks at all files; slow looks are less frequent.
    pub interval: Duration,
    /// Returns the contents of a path.
    pub content: fn(&Path) -> Content,
}

/// A watched file, or a place where one may appear.
#[derive(Debug)]
pub struct Subject {
    /// The path as the caller wrote it.
    pub given: PathBuf,
    pub path: PathBuf,
    /// The contents last built or reported.
    pub told: Content,
    /// True if `told` has been reported but not built yet.
    announced: bool,
    glance: Option<Glance>,
    pending: Option<Pending>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Glance {
    stamp: Option<Stamp>,
    content: Content,
}

/// A difference that has not been reported yet.
#[derive(Clone, Copy, Debug)]
struct Pending {
    first_seen: Instant,
    /// True if the file is missing or empty; `gone_since` is when this last changed.
    gone: bool,
    gone_since: Instant,
    /// Time since which all looks gave this `glance`.
    steady_since: Instant,
    glance: Glance,
}

/// A file's difference from the contents last built or reported.
#[derive(Clone, Copy, Debug)]
pub struct Difference {
    pub first_seen: Instant,
    pub gone: bool,
    /// Time to report the difference if nothing changes until then.
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

    /// Records the contents that builds have read. Call it right after a [`Subject::look`].
    pub fn built(&mut self, read: &[Content]) {
        let Some(now) = self.glance.map(|glance| glance.content) else { return };
        if let Some(other) = read.iter().find(|content| **content != now) {
            // If the file's contents were already reported, a build that reads them is under way.
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

    /// Reads the file with `content` if it may have changed since the last look.
    pub fn look(&mut self, content: fn(&Path) -> Content) {
        let before = stamp(&self.path);
        // A path without a stamp is looked at again: nothing may have become a link to nothing.
        if self.glance.is_some_and(|glance| glance.stamp == before) && before.is_some_and(is_old) {
            return;
        }
        let content = content(&self.path);
        // If the file changed while it was read, its stamp is left out, so that the next look reads it again.
        let stamp = stamp(&self.path).filter(|after| before == Some(*after));
        self.glance = Some(Glance { stamp, content });
    }

    /// Updates the pending difference according to the last look, at `now`; does nothing before the first look.
    pub fn weigh(&mut self, now: Instant) {
        let Some(glance) = self.glance else { return };
        if glance.content == self.told {
            self.pending = None;
            return;
        }
        let gone = glance.content.is_empty();
        let pending = self.pending.get_or_insert(Pending {
            first_seen: now,
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
            (steady_since + patience.quiet).min(first_seen + patience.moving)
        };
        Some(Difference { first_seen, gone, due })
    }

    /// Marks a pending difference as reported. Returns the contents last built or reported.
    pub fn announce(&mut self) -> Content {
        if let Some(pending) = self.pending.take() {
            (self.told, self.announced) = (pending.glance.content, true);
        }
        self.told
    }
}

fn stamp(path: &Path) -> Option<Stamp> {
    fs::metadata(path).ok().map(|metadata| Stamp::of(&metadata))
}

/// Returns true if any later write must have a different time, at any resolution of the clock (2 s on FAT).
fn is_old(stamp: Stamp) -> bool {
    const RESOLUTION: Duration = Duration::from_secs(3);
    let age = stamp.modified.and_then(|modified| SystemTime::now().duration_since(modified).ok());
    age.is_some_and(|age| age > RESOLUTION)
}
