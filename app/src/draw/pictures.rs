//! Encodes and writes pictures on worker threads while the device draws the next ones.
//!
//! Encoding a picture can take much longer than drawing it. [`Pictures`] passes each picture to the thread pool and
//! returns the results in the order of the pictures, so that messages and the first error are the same as without
//! threads.

use anyhow::{Result, bail};
use splatgraph_api::Pixels;
use splatgraph_assets::memory;
use splatgraph_framework::reload::panic_message;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, channel};

/// Unfinished pictures may use 1 / `MEMORY_SHARE` of the available memory.
const MEMORY_SHARE: u64 = 4;

/// Bytes per pixel for encoding, besides the pixels themselves: RGB in f32, RGB in 8 bits, and the file.
const ENCODING_BYTES: u64 = 12 + 3 + 3;

/// Estimates the memory that encoding a picture takes, in bytes.
pub fn encoding_bytes(pixels: &Pixels) -> u64 {
    pixels.bytes.len() as u64 + ENCODING_BYTES * u64::from(pixels.width) * u64::from(pixels.height)
}

/// Queue of pictures that are drawn but not yet written, oldest first.
pub struct Pictures<T> {
    jobs: usize,
    unfinished: VecDeque<Receiver<Result<T>>>,
}

impl<T: Send + 'static> Pictures<T> {
    /// Creates a queue of at most `jobs` unfinished pictures.
    pub fn new(jobs: usize) -> Pictures<T> {
        Pictures { jobs: jobs.max(1), unfinished: VecDeque::new() }
    }

    /// Starts `work`, which needs `bytes` bytes of memory. If called on a thread of the pool, runs it before returning.
    ///
    /// First waits for older pictures if the queue or the memory is full, and returns their results.
    ///
    /// # Errors
    /// One of these pictures failed. The error is the oldest one's; `work` is not started, and the results of the
    /// pictures before the failed one are lost.
    pub fn start(&mut self, bytes: u64, work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<Vec<T>> {
        let room = memory::available().map_or(u64::MAX, |available| available / MEMORY_SHARE / bytes.max(1));
        let most = self.jobs.min(usize::try_from(room).unwrap_or(usize::MAX)).max(1);
        let mut finished = Vec::new();
        while self.unfinished.len() >= most {
            finished.extend(self.wait()?);
        }
        let (sender, receiver) = channel();
        let work = move || {
            // rayon aborts the process if spawned work panics.
            let result = catch_unwind(AssertUnwindSafe(work));
            let result = result.unwrap_or_else(|panic| bail!("internal error: {}", panic_message(panic)));
            // After an error, nobody receives the result.
            _ = sender.send(result);
        };
        // On a thread of the pool, run the work at once: the pool may have no other thread to run it while this one
        // draws.
        if rayon::current_thread_index().is_some() {
            work();
        } else {
            rayon::spawn_fifo(work);
        }
        self.unfinished.push_back(receiver);
        Ok(finished)
    }

    /// Waits for the oldest unfinished picture, and returns its result; `None` if the queue is empty.
    ///
    /// # Errors
    /// The picture's work failed, or panicked.
    pub fn wait(&mut self) -> Result<Option<T>> {
        let Some(oldest) = self.unfinished.pop_front() else { return Ok(None) };
        oldest.recv()?.map(Some)
    }
}

/// Waits for the pictures in progress, even after an error, so that the process does not end within a file.
impl<T> Drop for Pictures<T> {
    fn drop(&mut self) {
        self.unfinished.drain(..).for_each(|picture| _ = picture.recv());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::{Arc, Barrier};

    #[test]
    fn outcomes_come_in_the_order_of_the_pictures_and_no_more_than_the_jobs_are_unfinished() {
        let (mut pictures, most) = (Pictures::new(3), Arc::new(AtomicUsize::new(0)));
        let running = Arc::new(AtomicUsize::new(0));
        let mut order = Vec::new();
        for index in 0..20 {
            let (running, most) = (running.clone(), most.clone());
            let work = move || {
                most.fetch_max(running.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                std::thread::sleep(std::time::Duration::from_millis(3 - index % 3));
                running.fetch_sub(1, Ordering::SeqCst);
                Ok(index)
            };
            order.extend(pictures.start(1, work).unwrap());
        }
        while let Some(index) = pictures.wait().unwrap() {
            order.push(index);
        }
        assert_eq!(order, (0..20).collect::<Vec<_>>());
        assert!(most.load(Ordering::SeqCst) <= 3);
    }

    #[test]
    fn a_picture_is_worked_on_while_the_caller_goes_on() {
        let (mut pictures, met) = (Pictures::new(2), Arc::new(Barrier::new(2)));
        let other = met.clone();
        pictures.start(1, move || Ok(other.wait().is_leader())).unwrap();
        // This would block forever if `start` ran the work itself.
        met.wait();
        assert!(pictures.wait().unwrap().is_some());
    }

    #[test]
    fn without_room_in_memory_each_picture_is_finished_before_the_next_is_begun() {
        let mut pictures = Pictures::new(8);
        assert!(pictures.start(u64::MAX, || Ok(1)).unwrap().is_empty());
        assert_eq!(pictures.start(u64::MAX, || Ok(2)).unwrap(), [1]);
    }

    #[test]
    fn a_panic_in_the_work_of_a_picture_is_its_error() {
        let mut pictures = Pictures::new(2);
        pictures.start(1, || Ok(1)).unwrap();
        pictures.start(1, || panic!("this panic is part of a test")).unwrap();
        assert_eq!(pictures.wait().unwrap(), Some(1));
        let error = pictures.wait().unwrap_err().to_string();
        assert_eq!(error, "internal error: this panic is part of a test");
    }

    #[test]
    fn the_first_error_in_the_order_of_the_pictures_is_told_and_those_begun_are_finished() {
        let written = Arc::new(AtomicUsize::new(0));
        let mut pictures = Pictures::new(8);
        for index in 0..6 {
            let written = written.clone();
            let work = move || {
                if index % 2 == 1 {
                    bail!("the disk is full at {index}");
                }
                written.fetch_add(1, Ordering::SeqCst);
                Ok(index)
            };
            assert!(pictures.start(1, work).unwrap().is_empty());
        }
        assert_eq!(pictures.wait().unwrap(), Some(0));
        assert_eq!(pictures.wait().unwrap_err().to_string(), "the disk is full at 1");
        drop(pictures);
        assert_eq!(written.load(Ordering::SeqCst), 3);
    }
}
