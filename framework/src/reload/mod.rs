//! Rebuilds plans when files change, independent of GPU and window.
//!
//! It has three independent parts:
//!
//! 1. a [`Watcher`] watches the files that a build read ([`SourceMap::wanted`](crate::source::SourceMap::wanted)) and
//!    reports changed contents;
//! 2. a [`Rebuilder`] builds on a thread while drawing continues; of several waiting jobs it runs the newest;
//! 3. [`LastGood`] keeps the last good product, and decides when to show an error.
//!
//! A viewer connects them in a loop: take a [`FileChange`], begin an [`Attempt`], submit a job with it; poll for
//! outputs, pass them to [`LastGood`], and pass the build's files to the watcher. Each build reads its files through a
//! new source map and may keep its compiler, which caches shaders by their texts.
//!
//! Editors save a file in several steps: they empty it first, remove and create it again, or write it in parts. There
//! are therefore three delays: until a file has stopped changing ([`watch::QUIET`]), longer if it is empty or missing
//! ([`watch::GONE`]), and until an error right after a change is shown ([`last_good::GRACE`]).

pub mod last_good;
pub mod rebuild;
pub mod watch;

pub use crate::source::{Content, Wanted};
pub use last_good::{Attempt, LastGood};
pub use rebuild::{Panicked, Rebuilder, panic_message};
pub use watch::{FileChange, Watcher};
