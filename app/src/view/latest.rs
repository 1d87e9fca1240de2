//! Runs work on another thread. A new request cancels the previous one.
//!
//! Two requests of one worker never run at once: two copies of a scene may not fit in memory. A request cancelled while
//! it waits for its turn is skipped. A panic in the work is returned as its error.

use super::renderer::Wake;
use splatgraph_framework::reload::panic_message;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};

/// A request in progress. Dropping it cancels the work.
struct Request<T> {
    result: Receiver<Result<T, String>>,
    cancelled: Arc<AtomicBool>,
}

impl<T> Drop for Request<T> {
    fn drop(&mut self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }
}

/// A worker that runs one request at a time on another thread. It holds the newest request's result until it is taken.
pub struct Latest<T> {
    name: &'static str,
    request: Option<Request<T>>,
    /// Lock that is held while work runs, so that requests run one at a time.
    turn: Arc<Mutex<()>>,
    wake: Wake,
}

impl<T: Send + 'static> Latest<T> {
    /// Creates an idle worker. `name` is a verb phrase: it names the threads, and completes the error `no thread can be
    /// started to`. `wake` is called when a result is ready.
    pub fn new(name: &'static str, wake: Wake) -> Latest<T> {
        Latest { name, request: None, turn: Arc::default(), wake }
    }

    /// Starts `work`, and cancels the previous request.
    ///
    /// `work` gets a function that returns true once the request is cancelled. `work` returns `None` if it has no
    /// result.
    ///
    /// # Errors
    /// The system cannot start a thread. The previous request then continues.
    pub fn start(
        &mut self,
        work: impl FnOnce(&(dyn Fn() -> bool + Sync)) -> Option<Result<T, String>> + Send + 'static,
    ) -> Result<(), String> {
        let (done, result) = channel();
        let request = Request { result, cancelled: Arc::default() };
        let (cancelled, turn, wake) = (request.cancelled.clone(), self.turn.clone(), self.wake.clone());
        let work = move || {
            // The mutex guards no data, so a panic of `wake` leaves nothing inconsistent.
            let _turn = turn.lock().unwrap_or_else(PoisonError::into_inner);
            let is_cancelled = || cancelled.load(Ordering::Relaxed);
            if is_cancelled() {
                return;
            }
            // A panic is a bug, but must not leave the caller without an answer.
            let result = catch_unwind(AssertUnwindSafe(|| work(&is_cancelled)));
            let result = result
                .unwrap_or_else(|payload| Some(Err(format!("internal error: {}", panic_message(payload)))));
            // If the request was cancelled just now, its receiver is gone and the send fails.
            if result.is_some_and(|result| done.send(result).is_ok()) {
                wake();
            }
        };
        let thread = std::thread::Builder::new().name(self.name.to_owned()).spawn(work);
        thread.map_err(|error| format!("no thread can be started to {}: {error}", self.name))?;
        // Dropping the previous request cancels it.
        self.request = Some(request);
        Ok(())
    }

    /// Cancels the request, or drops its result.
    pub fn cancel(&mut self) {
        self.request = None;
    }

    /// Returns true while a request is in progress, and until its result is taken.
    pub fn busy(&self) -> bool {
        self.request.is_some()
    }

    /// Takes the result of the newest request; `None` without a request, while it runs, or if it has no result.
    ///
    /// The error is the work's own, or the message of its panic.
    pub fn take(&mut self) -> Option<Result<T, String>> {
        let result = self.request.as_ref()?.result.try_recv();
        if !matches!(result, Err(TryRecvError::Empty)) {
            self.request = None;
        }
        result.ok()
    }

    /// Waits for the result of the newest request; `None` without a request, or if it has no result.
    pub fn wait(&mut self) -> Option<Result<T, String>> {
        self.request.take()?.result.recv().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{RecvTimeoutError, Sender};
    use std::time::Duration;

    fn worker() -> (Latest<u32>, Receiver<()>) {
        let (woken, wakes): (Sender<()>, _) = channel();
        (Latest::new("count", Arc::new(move || woken.send(()).unwrap_or(()))), wakes)
    }

    #[test]
    fn of_many_requests_only_the_newest_is_answered() {
        let (mut worker, wakes) = worker();
        let (ends, end) = channel();
        let running = Arc::new(AtomicBool::new(false));
        for number in 0..30 {
            let (ends, running) = (ends.clone(), running.clone());
            let work = move |cancelled: &(dyn Fn() -> bool + Sync)| {
                assert!(!running.swap(true, Ordering::SeqCst), "two requests run at once");
                // All requests but the last run until the next one cancels them.
                while number < 29 && !cancelled() {
                    std::thread::sleep(Duration::from_millis(1));
                }
                running.store(false, Ordering::SeqCst);
                ends.send(()).unwrap();
                Some(Ok(number))
            };
            worker.start(work).unwrap();
        }
        drop(ends);
        let end = loop {
            if let Err(end) = end.recv_timeout(Duration::from_secs(60)) {
                break end;
            }
        };
        assert_eq!(end, RecvTimeoutError::Disconnected, "every thread ends");
        let result = loop {
            wakes.recv_timeout(Duration::from_secs(60)).expect("a call of wake");
            if let Some(result) = worker.take() {
                break result;
            }
        };
        assert_eq!(result, Ok(29));
        worker.start(|_| Some(Ok(1))).unwrap();
        worker.cancel();
        assert_eq!((worker.busy(), worker.take()), (false, None));
    }

    #[test]
    fn work_without_a_result_ends_the_request() {
        let (mut worker, _wakes) = worker();
        worker.start(|_| None).unwrap();
        while worker.busy() {
            assert_eq!(worker.take(), None);
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn a_panic_is_the_result_of_its_request_and_the_next_one_runs() {
        let (mut worker, wakes) = worker();
        let mut result_of = |work: fn() -> u32| {
            worker.start(move |_| Some(Ok(work()))).unwrap();
            wakes.recv_timeout(Duration::from_secs(60)).expect("a call of wake");
            worker.take()
        };
        assert_eq!(result_of(|| panic!("out of luck")), Some(Err("internal error: out of luck".to_owned())));
        assert_eq!(result_of(|| 5), Some(Ok(5)));
    }
}
