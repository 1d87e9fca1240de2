//! Shows the progress and the messages of a study on standard error.

use crate::io::output::say;
use crate::io::progress::Progress;
use crate::studies::study::Listener;
use std::ops::ControlFlow;

/// Listener with a bar for the current task. It never cancels: a signal ends the whole program.
#[derive(Default)]
pub struct Console(Option<(String, Progress)>);

impl Listener for Console {
    fn progress(&mut self, task: &str, done: u64, of: u64, step: &str) -> ControlFlow<()> {
        let former = self.0.take().filter(|(former, _)| former == task);
        let (_, progress) = self.0.insert(former.unwrap_or_else(|| (task.to_owned(), Progress::new(task))));
        progress.set(done, of, step);
        ControlFlow::Continue(())
    }

    fn say(&mut self, message: &str) {
        match &self.0 {
            Some((_, progress)) => progress.suspend(|| say(message)),
            None => say(message),
        }
    }
}
