//! Shows the progress of long tasks on standard error.
//!
//! Tasks of less than a second show nothing. After that, a terminal shows a bar; a file or a pipe gets a plain line
//! every ten seconds.

use crate::io::output::{one_line, say};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Time until a task first shows its progress.
const PATIENCE: Duration = Duration::from_secs(1);
/// Time between two plain lines.
const PLAIN_INTERVAL: Duration = Duration::from_secs(10);

/// The progress of one task. Dropping it clears the bar.
pub struct Progress {
    what: String,
    started: Instant,
    said: Option<Instant>,
    bar: Option<ProgressBar>,
    terminal: bool,
}

impl Progress {
    /// Starts a task. `what` is a short phrase such as `loading biker.ply`.
    pub fn new(what: impl Into<String>) -> Progress {
        Progress {
            what: one_line(&what.into()).into_owned(),
            started: Instant::now(),
            said: None,
            bar: None,
            terminal: std::io::stderr().is_terminal(),
        }
    }

    /// Reports that `done` of `of` units are done. `detail` names the current step, or is empty.
    pub fn set(&mut self, done: u64, of: u64, detail: &str) {
        if self.started.elapsed() < PATIENCE {
            return;
        }
        if self.terminal {
            let bar = self.bar.get_or_insert_with(|| {
                let style = ProgressStyle::with_template("{prefix} {bar:30} {percent:>3}% {wide_msg}")
                    .unwrap_or_else(|_| ProgressStyle::default_bar());
                ProgressBar::new(of).with_style(style).with_prefix(self.what.clone())
            });
            bar.set_length(of);
            bar.set_position(done);
            bar.set_message(one_line(detail).into_owned());
        } else if self.said.is_none_or(|said| said.elapsed() >= PLAIN_INTERVAL) {
            self.said = Some(Instant::now());
            let percent = (100.0 * done as f64 / of.max(1) as f64).floor();
            let space = if detail.is_empty() { "" } else { " " };
            say(format!("{}: {percent}%{space}{}", self.what, one_line(detail)));
        }
    }

    /// Hides the bar while `print` runs, so that lines it prints appear above the bar.
    pub fn suspend<T>(&self, print: impl FnOnce() -> T) -> T {
        match &self.bar {
            Some(bar) => bar.suspend(print),
            None => print(),
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
