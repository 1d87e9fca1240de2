//! Waits for other threads. Ctrl-C interrupts the wait.

use crate::errors::Error;
use pyo3::prelude::*;
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::Builder;
use std::time::Duration;

/// Interval at which Python is polled for signals.
const ASK_EVERY: Duration = Duration::from_millis(50);

/// Checks that this process may use the pool of threads on which scenes and pictures are processed.
///
/// # Errors
/// This process is a fork of one that used the pool.
pub fn pool() -> PyResult<()> {
    static OWNER: OnceLock<Owner> = OnceLock::new();
    OWNER.get_or_init(Owner::current).check()
}

/// Runs `work` on its own thread and returns its result.
///
/// # Errors
/// The errors of [`pool`] and [`receive`], or the thread cannot be started. After an interruption, the thread finishes
/// its work, and the result is dropped.
pub fn run<T: Send + 'static>(py: Python<'_>, work: impl FnOnce() -> T + Send + 'static) -> PyResult<T> {
    pool()?;
    let (sender, mut receiver) = channel();
    Builder::new().name("splatgraph".into()).spawn(move || {
        // After an interruption, the receiver is gone.
        let _ = sender.send(work());
    })?;
    receive(py, &mut receiver)
}

/// The process that started threads. A fork copies handles and channels, but not the threads: a wait would hang.
#[derive(Clone, Copy)]
pub struct Owner(u32);

impl Owner {
    pub fn current() -> Owner {
        Owner(std::process::id())
    }

    pub fn is_current(self) -> bool {
        self.0 == std::process::id()
    }

    /// Checks that this process is the owner.
    ///
    /// # Errors
    /// This process is a fork of the owner.
    pub fn check(self) -> PyResult<()> {
        match self.is_current() {
            true => Ok(()),
            false => Err(Error::new_err(format!(
                "expected a call in process {}, whose threads do the work, found one in its fork {}: start workers with \
                 `spawn` or `forkserver`",
                self.0,
                std::process::id()
            ))),
        }
    }
}

/// Waits for a thread's answer, and polls Python for signals meanwhile.
///
/// # Errors
/// `KeyboardInterrupt` or another exception of a signal handler, or the thread ended without an answer.
pub fn receive<T: Send>(py: Python<'_>, receiver: &mut Receiver<T>) -> PyResult<T> {
    loop {
        let receiver = &mut *receiver;
        match py.detach(move || receiver.recv_timeout(ASK_EVERY)) {
            Ok(answer) => return Ok(answer),
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => {
                return Err(Error::new_err("a thread ended early; standard error has its message"));
            }
        }
    }
}
