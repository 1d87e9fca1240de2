//! Hot reload, as far as it needs neither a GPU nor a window: from a saved file to a plan that can be drawn.
//!
//! Three parts, each of which can be used alone:
//!
//! 1. a [`Watcher`] is told what a build looked at ([`SourceMap::wanted`](crate::source::SourceMap::wanted)) and says when some
//!    of it holds something else;
//! 2. a [`Rebuilder`] is a thread that builds, so that frames go on meanwhile; of jobs that pile up it does the newest;
//! 3. [`LastGood`] keeps what was built last without an error, and decides when an error is worth showing.
//!
//! Whoever shows pictures joins them in a loop: take a [`Change`], begin an [`Attempt`], submit a job with it; poll for
//! outputs, hand them to [`LastGood`], and tell the watcher what the build wanted. Each build reads its files through a new
//! source map and may keep its compiler, which knows unchanged shaders by their texts.
//!
//! Nobody saves a file in one go: it is emptied first, or goes away and comes back, or is there in half. So there are three
//! moments of patience, in this order. The watcher waits for a file to stand still (some 20 ms), and longer for one that is
//! empty or gone ([`watch::GONE`]); and an error right after a change waits to be shown ([`steady::GRACE`]), as half a file is
//! seldom a graph.

pub mod rebuild;
pub mod steady;
pub mod watch;

pub use crate::source::{Content, Wanted};
pub use rebuild::{Panicked, Rebuilder};
pub use steady::{Attempt, LastGood};
pub use watch::{Change, WatchError, WatchKind, Watcher};
