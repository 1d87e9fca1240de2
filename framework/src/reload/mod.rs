//! Reloads graphs: from a saved file to a plan that can be drawn, without a GPU or a window.
//!
//! Three parts, each of which can be used alone:
//!
//! 1. a [`Watcher`] watches the files that a build read ([`SourceMap::wanted`](crate::source::SourceMap::wanted)) and reports
//!    changed contents;
//! 2. a [`Rebuilder`] builds on a thread, so that frames go on meanwhile; of several waiting jobs it runs the newest;
//! 3. [`LastGood`] keeps the last product without an error, and decides when to show an error.
//!
//! A viewer joins them in a loop: take a [`FileChange`], begin an [`Attempt`], submit a job with it; poll for
//! outputs, pass them to [`LastGood`], and pass the build's files to the watcher. Each build reads its files through a new
//! source map and may keep its compiler, which knows unchanged shaders by their texts.
//!
//! Editors do not save a file in one step: it is emptied first, or removed and created again, or half written. So there are
//! three delays, in this order. The watcher waits until a file stops changing (some 20 ms), and longer for one that is empty or
//! gone ([`watch::GONE`]); and an error right after a change is shown later ([`last_good::GRACE`]), as half a file is seldom a
//! graph.

pub mod last_good;
pub mod rebuild;
pub mod watch;

pub use crate::source::{Content, Wanted};
pub use last_good::{Attempt, LastGood};
pub use rebuild::{Panicked, Rebuilder};
pub use watch::{FileChange, WatchError, WatchKind, Watcher};
