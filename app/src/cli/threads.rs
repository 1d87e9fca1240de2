//! Fits the pool of worker threads to what the system allows.
//!
//! The pool of rayon panics at its first use if one of its threads cannot be started, as under `ulimit -u` or `ulimit -v`. So the
//! threads are started once for trial, and the pool gets as many as did start.

use std::sync::{Arc, Mutex};
use std::thread::{Builder, JoinHandle, available_parallelism};

/// Builds the pool, smaller than usual if the system has not enough threads.
pub fn build_pool() {
    let wanted = std::env::var("RAYON_NUM_THREADS").ok().and_then(|number| number.parse().ok());
    let wanted =
        wanted.filter(|number| *number > 0).unwrap_or_else(|| available_parallelism().map_or(1, usize::from));
    // Twice as many for trial: what follows, the driver among it, wants threads and memory too. Built here rather than at the
    // first use, by when the memory that was free at the trial can have been taken.
    let pool = rayon::ThreadPoolBuilder::new();
    let built = match startable(wanted.saturating_mul(2)) / 2 {
        0 => pool.num_threads(1).use_current_thread().build_global(),
        threads => pool.num_threads(threads).build_global(),
    };
    // Nothing has used the pool yet, so it is the first.
    drop(built);
}

/// Counts how many of `wanted` threads can run at once.
fn startable(wanted: usize) -> usize {
    // Each thread waits until this one lets it go.
    let gate = Arc::new(Mutex::new(()));
    let closed = gate.lock();
    let mut threads: Vec<JoinHandle<()>> = Vec::new();
    while threads.len() < wanted {
        let gate = gate.clone();
        match Builder::new().spawn(move || drop(gate.lock())) {
            Ok(thread) => threads.push(thread),
            Err(_) => break,
        }
    }
    drop(closed);
    let found = threads.len();
    threads.into_iter().for_each(|thread| drop(thread.join()));
    found
}
