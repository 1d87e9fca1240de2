//! Sizes the pool of worker threads to fit the system's limits.
//!
//! rayon's pool panics at its first use if one of its threads cannot be started, for example under `ulimit -u` or
//! `ulimit -v`. After a failed attempt, the global pool cannot be built again. Therefore, the threads are started
//! first, and the pool gets half of those that did start.

use crate::io::output::say;
use rayon::{ThreadBuilder, ThreadPoolBuilder};
use std::io;
use std::sync::mpsc::{Sender, channel};
use std::thread::{Builder, available_parallelism};

/// Environment variable with the number of worker threads; 0 or nothing for one per core.
const VARIABLE: &str = "RAYON_NUM_THREADS";

pub fn build_pool() {
    let text = std::env::var_os(VARIABLE).unwrap_or_default();
    let number = text.to_str().and_then(|text| text.parse().ok());
    if number.is_none() && !text.is_empty() {
        say(format!(
            "{VARIABLE}: expected a number of threads, found {}: one per core is used",
            text.display()
        ));
    }
    let wanted = number.filter(|number| *number > 0);
    let wanted = wanted.unwrap_or_else(|| available_parallelism().map_or(1, usize::from));
    spare_addresses();
    // Start twice as many and drop half: the graphics driver and the rest of the program need threads and memory too.
    let mut waiting = start(wanted.saturating_mul(2));
    waiting.truncate(waiting.len().div_ceil(2));
    let pool = ThreadPoolBuilder::new();
    let built = match waiting.len() {
        0 => pool.num_threads(1).use_current_thread().build_global(),
        threads => {
            let give = |worker: ThreadBuilder| {
                let thread = waiting.pop().ok_or(io::ErrorKind::WouldBlock)?;
                thread.send(worker).map_err(|_| io::ErrorKind::WouldBlock.into())
            };
            pool.num_threads(threads).spawn_handler(give).build_global()
        }
    };
    // Cannot be an error: the pool is the first one, and its threads are already running.
    drop(built);
}

/// Stops the allocator from reserving 64 MiB of address space per thread, if address space is limited (`ulimit -v`).
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn spare_addresses() {
    use rustix::process::{Resource, getrlimit};
    if getrlimit(Resource::As).current.is_some() {
        // SAFETY: the call sets an integer option of glibc's allocator, under the allocator's own lock.
        unsafe { libc::mallopt(libc::M_ARENA_MAX, 1) };
    }
}

/// Does nothing: other allocators do not reserve address space per thread.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn spare_addresses() {}

/// Starts up to `wanted` threads. Each waits for its work, and ends if the sender is dropped.
fn start(wanted: usize) -> Vec<Sender<ThreadBuilder>> {
    let mut waiting = Vec::new();
    while waiting.len() < wanted {
        let (sender, receiver) = channel::<ThreadBuilder>();
        let work = move || {
            if let Ok(worker) = receiver.recv() {
                worker.run();
            }
        };
        let name = format!("worker {}", waiting.len() + 1);
        match Builder::new().name(name).spawn(work) {
            Ok(_) => waiting.push(sender),
            Err(_) => break,
        }
    }
    waiting
}
