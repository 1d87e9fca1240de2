//! Measures this process: its memory, its open files and its threads.

use std::fs;
use std::time::{Duration, Instant};

pub fn resident() -> u64 {
    let text = fs::read_to_string("/proc/self/statm").expect("there is a /proc");
    let pages: u64 = text.split(' ').nth(1).and_then(|pages| pages.parse().ok()).expect("a number of pages");
    pages * 4096
}

fn open_files() -> usize {
    fs::read_dir("/proc/self/fd").expect("there is a /proc").count()
}

/// Returns the names of the threads, sorted, without those of Mesa's shader cache on disk, which come and go.
fn threads() -> Vec<String> {
    let tasks = fs::read_dir("/proc/self/task").expect("there is a /proc");
    // A thread that has ended meanwhile has no name.
    let name = |task: std::io::Result<fs::DirEntry>| fs::read_to_string(task.ok()?.path().join("comm")).ok();
    let names = tasks.filter_map(name).map(|name| name.trim_end().to_owned());
    let mut names: Vec<String> = names.filter(|name| !name.contains(":disk$")).collect();
    names.sort();
    names
}

/// Returns the smallest number of open files, and the shortest list of threads, within 50 ms: finished threads end, and
/// other threads open files only for a moment, such as the watcher and Mesa's shader cache.
pub(super) fn settled() -> (usize, Vec<String>) {
    let mut least = (open_files(), threads());
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_millis(50) {
        std::thread::sleep(Duration::from_millis(5));
        let threads = threads();
        least.0 = least.0.min(open_files());
        if threads.len() < least.1.len() {
            least.1 = threads;
        }
    }
    least
}
