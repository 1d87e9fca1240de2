//! Builds on a separate thread, so that drawing never waits.
//!
//! At most one job waits: a newer one replaces it. A running job gets at least [`PATIENCE`]. After that, it is
//! cancelled as soon as a newer job waits, or the owner has one ([`Rebuilder::set_outdated`]). It is also cancelled
//! when the rebuilder is dropped. The function that runs the job learns this from its [`Cancel`]. Every output is
//! returned, in order, because an older one may be the last without an error.

use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::shader::Cancel;

/// Minimum run time of a job before a newer one can cancel it, so that a moving slider shows progress.
pub const PATIENCE: Duration = Duration::from_millis(500);

/// A thread that builds. Dropping it cancels the running job, waits for it, and discards a waiting job.
#[derive(Debug)]
pub struct Rebuilder<Job, Output> {
    shared: Arc<Shared<Job, Output>>,
    thread: Option<JoinHandle<()>>,
}

/// A panic of a build, which is a bug.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the build stopped unexpectedly: {message}")]
pub struct Panicked {
    /// Message of the panic.
    pub message: String,
}

#[derive(Debug)]
struct Shared<Job, Output> {
    state: Mutex<State<Job, Output>>,
    /// Signalled when a job waits or the thread should end.
    called: Condvar,
}

#[derive(Debug)]
struct State<Job, Output> {
    waiting: Option<Job>,
    /// Time at which the running job started; `None` while no job runs.
    building: Option<Instant>,
    done: VecDeque<Result<Output, Panicked>>,
    /// True if the owner has a newer job.
    outdated: bool,
    ending: bool,
}

impl<Job, Output> State<Job, Output> {
    /// Returns true if the rebuilder is dropped, or if [`PATIENCE`] has passed and there is a newer job.
    fn is_cancelled(&self) -> bool {
        let newer = self.outdated || self.waiting.is_some();
        self.ending || newer && self.building.is_some_and(|begun| begun.elapsed() > PATIENCE)
    }
}

impl<Job, Output> Shared<Job, Output> {
    fn state(&self) -> MutexGuard<'_, State<Job, Output>> {
        // Nothing panics while it holds the lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<Job: Send + 'static, Output: Send + 'static> Rebuilder<Job, Output> {
    /// Starts the thread. Fails if the system cannot create one.
    ///
    /// The thread calls `make` before the first job and after a panic, to get the function that runs jobs. The function
    /// may own data that is not `Send`, and should check the [`Cancel`] regularly. The thread calls `wake` when an
    /// output is ready.
    pub fn new<Build: FnMut(Job) -> Output>(
        mut make: impl FnMut(Cancel) -> Build + Send + 'static,
        wake: impl Fn() + Send + 'static,
    ) -> std::io::Result<Self> {
        let state =
            State { waiting: None, building: None, done: VecDeque::new(), outdated: false, ending: false };
        let shared = Arc::new(Shared { state: Mutex::new(state), called: Condvar::new() });
        let builder = thread::Builder::new().name("rebuild".into());
        let thread = builder.spawn({
            let shared = shared.clone();
            let asked = shared.clone();
            let cancel = Cancel::new(move || asked.state().is_cancelled());
            move || work(&shared, || make(cancel.clone()), wake)
        })?;
        Ok(Rebuilder { shared, thread: Some(thread) })
    }
}

impl<Job, Output> Rebuilder<Job, Output> {
    /// Queues a job, and returns the waiting one that it replaces, if any.
    pub fn submit(&self, job: Job) -> Option<Job> {
        let before = self.shared.state().waiting.replace(job);
        self.shared.called.notify_one();
        before
    }

    /// Sets whether the owner holds a newer job, which it will submit once the queued ones have ended.
    pub fn set_outdated(&self, outdated: bool) {
        self.shared.state().outdated = outdated;
    }

    /// Takes the oldest output, if there is one.
    pub fn poll(&self) -> Option<Result<Output, Panicked>> {
        self.shared.state().done.pop_front()
    }

    /// Returns true while a job waits or runs.
    pub fn busy(&self) -> bool {
        let state = self.shared.state();
        state.building.is_some() || state.waiting.is_some()
    }
}

impl<Job, Output> Drop for Rebuilder<Job, Output> {
    fn drop(&mut self) {
        self.shared.state().ending = true;
        self.shared.called.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic there (in `wake`) was already reported, and a second one here would end the process.
            let _ = thread.join();
        }
    }
}

fn work<Job, Output, Build: FnMut(Job) -> Output>(
    shared: &Shared<Job, Output>,
    mut make: impl FnMut() -> Build,
    wake: impl Fn(),
) {
    let mut build: Option<Build> = None;
    loop {
        let job = {
            let mut state = shared.state();
            loop {
                if state.ending {
                    return;
                }
                if let Some(job) = state.waiting.take() {
                    state.building = Some(Instant::now());
                    break job;
                }
                state = shared.called.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        };
        // A panic may leave `build` in an inconsistent state: it is dropped below.
        let output = catch_unwind(AssertUnwindSafe(|| build.get_or_insert_with(&mut make)(job)));
        let output = output.map_err(|payload| {
            // A second panic, in the drop, must not end the thread.
            let _ = catch_unwind(AssertUnwindSafe(|| build = None));
            Panicked { message: panic_message(payload) }
        });
        let mut state = shared.state();
        state.building = None;
        state.done.push_back(output);
        drop(state);
        wake();
    }
}

/// Returns the message of a panic that [`catch_unwind`] caught, or a placeholder if its payload is not text.
pub fn panic_message(payload: Box<dyn Any + Send>) -> String {
    match payload.downcast::<String>() {
        Ok(text) => *text,
        Err(payload) => {
            payload.downcast_ref::<&str>().map_or("for no given reason".into(), |t| t.to_string())
        }
    }
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;
    use std::sync::mpsc::{Receiver, channel};

    use super::*;

    fn started<Job: Send + 'static, Output: Send + 'static, Build: FnMut(Job) -> Output>(
        mut make: impl FnMut() -> Build + Send + 'static,
    ) -> (Rebuilder<Job, Output>, Receiver<()>) {
        let (woken, wakes) = channel();
        let rebuilder = Rebuilder::new(move |_| make(), move || _ = woken.send(())).expect("a thread");
        (rebuilder, wakes)
    }

    #[test]
    fn a_job_comes_out_as_its_output_and_wakes_the_waiting_thread() {
        let (rebuilder, wakes) = started(|| |job: u32| job + 1);
        assert!(!rebuilder.busy());
        assert_eq!(rebuilder.submit(1), None);
        wakes.recv().expect("woken");
        assert_eq!(rebuilder.poll(), Some(Ok(2)));
        assert_eq!(rebuilder.poll(), None);
        assert!(!rebuilder.busy());
    }

    #[test]
    fn what_builds_is_made_on_the_thread_and_may_be_bound_to_it() {
        let (rebuilder, wakes) = started(|| {
            let count = Rc::new(std::cell::Cell::new(0));
            move |job: u32| {
                count.set(count.get() + job);
                (count.get(), thread::current().name().map(str::to_string))
            }
        });
        for (job, sum) in [(1, 1), (2, 3)] {
            rebuilder.submit(job);
            wakes.recv().expect("woken");
            assert_eq!(rebuilder.poll(), Some(Ok((sum, Some("rebuild".into())))));
        }
    }

    #[test]
    fn of_the_jobs_that_wait_only_the_newest_is_done() {
        let (begun, begins) = channel();
        let (go, gate) = channel();
        let gate = Arc::new(Mutex::new(gate));
        let (rebuilder, wakes) = started(move || {
            let (begun, gate) = (begun.clone(), gate.clone());
            move |job: u32| {
                begun.send(()).expect("the test listens");
                gate.lock().expect("a gate").recv().expect("the test goes on");
                job
            }
        });
        rebuilder.submit(1);
        begins.recv().expect("begun");
        assert_eq!(rebuilder.submit(2), None);
        assert_eq!(rebuilder.submit(3), Some(2));
        assert_eq!(rebuilder.submit(4), Some(3));
        assert!(rebuilder.busy());
        for _ in 0..2 {
            go.send(()).expect("a build waits");
            wakes.recv().expect("woken");
        }
        assert_eq!(rebuilder.poll(), Some(Ok(1)));
        assert_eq!(rebuilder.poll(), Some(Ok(4)));
        assert!(!rebuilder.busy());
    }

    #[test]
    fn a_panic_is_an_output_and_the_next_job_is_done_by_a_new_builder() {
        let (rebuilder, wakes) = started(|| {
            let mut done = 0;
            move |job: &str| {
                done += 1;
                assert!(job != "formatted", "this {job} panic is part of a test");
                if job == "plain" {
                    panic!("this panic is part of a test");
                }
                done
            }
        });
        let build = |job| {
            rebuilder.submit(job);
            wakes.recv().expect("woken");
            rebuilder.poll().expect("an output")
        };
        let panicked = |message: &str| Err(Panicked { message: message.into() });
        assert_eq!(build("good"), Ok(1));
        assert_eq!(build("good"), Ok(2));
        assert_eq!(build("formatted"), panicked("this formatted panic is part of a test"));
        assert_eq!(build("good"), Ok(1));
        assert_eq!(build("plain"), panicked("this panic is part of a test"));
        assert!(!rebuilder.busy());
    }

    #[test]
    fn a_builder_that_cannot_be_made_fails_every_job() {
        let make = || -> fn(u32) -> u32 { panic!("this panic is part of a test") };
        let (rebuilder, wakes) = started(make);
        for job in 0..2 {
            rebuilder.submit(job);
            wakes.recv().expect("woken");
            assert!(rebuilder.poll().expect("an output").is_err());
        }
    }

    #[test]
    fn a_long_job_is_asked_to_end_when_a_newer_one_waits_or_the_rebuilder_is_dropped() {
        let (begun, begins) = channel();
        let (woken, wakes) = channel();
        let make = move |cancel: Cancel| {
            let begun = begun.clone();
            move |job: u32| {
                begun.send(()).expect("the test listens");
                let since = Instant::now();
                while !cancel.is_requested() && since.elapsed() < Duration::from_secs(60) {
                    thread::sleep(Duration::from_millis(1));
                }
                (job, since.elapsed())
            }
        };
        let rebuilder = Rebuilder::new(make, move || _ = woken.send(())).expect("a thread");
        rebuilder.submit(1);
        begins.recv().expect("begun");
        rebuilder.submit(2);
        wakes.recv().expect("woken");
        // A job's time begins slightly before the job reads its clock.
        let least = PATIENCE / 2;
        let (job, took) = rebuilder.poll().expect("an output").expect("no panic");
        assert!(job == 1 && took >= least && took < Duration::from_secs(60), "{took:?}");
        begins.recv().expect("begun");
        // The owner has a newer job and has not submitted it.
        rebuilder.set_outdated(true);
        wakes.recv().expect("woken");
        let (job, took) = rebuilder.poll().expect("an output").expect("no panic");
        assert!(job == 2 && took >= least && took < Duration::from_secs(60), "{took:?}");
        rebuilder.set_outdated(false);
        rebuilder.submit(3);
        begins.recv().expect("begun");
        drop(rebuilder);
        wakes.recv().expect("the third ended too");
    }

    #[test]
    fn dropping_waits_for_the_job_that_was_begun() {
        let (begun, begins) = channel();
        let (rebuilder, wakes) = started(move || {
            let begun = begun.clone();
            move |()| begun.send(()).expect("the test listens")
        });
        rebuilder.submit(());
        begins.recv().expect("begun");
        drop(rebuilder);
        assert_eq!(wakes.try_iter().count(), 1, "the job was finished and announced, and the thread is gone");
        assert!(wakes.recv().is_err());
    }
}
