//! Implements the worker's side of [`super::worker`]: a loop over compilations, and a thread that enforces the limits.

use std::io::{self, Write};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

use super::generate::{self, Failure, Key};
use super::worker::{
    Limits, MAGIC, NO_THREAD, OUT_OF_MEMORY, OUT_OF_TIME, Reply, SERVES, VARIABLE, receive, send,
};

/// Stack sizes to try for the compiler's thread, largest first. glslang recurses once per operand of a sum; the first
/// size suffices for the longest text. Only used pages take memory.
pub(super) const STACK_BYTES: [usize; 3] = [256 << 20, 64 << 20, 8 << 20];

/// Bytes of address space that the process needs beyond the limit, for its program and its stacks.
const BESIDES: u64 = 1 << 30;

/// Interval at which memory and time are checked during a compilation.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// Serves as the compiler of a [`Worker`](super::Worker) and then exits, if this process was started as a worker.
/// Otherwise returns at once.
///
/// A program that serves as its own worker must call this at the start of `main`.
pub fn serve_if_asked() {
    SERVES.store(true, Ordering::Relaxed);
    let Ok(Ok(limits)) = std::env::var(VARIABLE).map(|text| serde_json::from_str::<Limits>(&text)) else {
        return;
    };
    system::restrict(limits.memory_bytes.saturating_add(BESIDES));
    let output = system::private_output();
    let (turns, watched) = channel();
    // Only the watching thread enforces the limits, so do not compile without it.
    let watch = thread::Builder::new().spawn(move || watch(limits, &watched));
    let served = watch.ok().and_then(|_| on_large_stack(move || serve(limits.memory_bytes, &turns, output)));
    std::process::exit(if served.is_some() { 0 } else { NO_THREAD });
}

/// Runs `work` on a thread with the largest available stack. `None` if no thread starts, or if it panicked.
pub(super) fn on_large_stack<T: Send, W: FnOnce() -> T + Send>(work: W) -> Option<T> {
    thread::scope(|scope| {
        for bytes in STACK_BYTES {
            let (sender, receiver) = channel::<W>();
            let builder = thread::Builder::new().name("glslang".into()).stack_size(bytes);
            // A failed spawn drops its closure, so send the work only to a thread that has started.
            let spawned = builder.spawn_scoped(scope, move || receiver.recv().ok().map(|work| work()));
            if let Ok(thread) = spawned {
                sender.send(work).ok()?;
                return thread.join().ok().flatten();
            }
        }
        None
    })
}

enum Turn {
    Begin,
    End,
}

/// Answers requests until the pipe closes, or until a compilation leaves over a quarter of the memory limit in use.
fn serve(memory_bytes: u64, turns: &Sender<Turn>, mut output: impl Write) {
    let mut input = io::stdin().lock();
    if output.write_all(MAGIC).and_then(|()| output.flush()).is_err() {
        return;
    }
    while let Ok(request) = receive(&mut input) {
        let _ = turns.send(Turn::Begin);
        let generated = match serde_json::from_slice::<Key>(&request) {
            Ok(key) => generate::generate(&key),
            Err(error) => Err(Failure::Log(format!("ERROR: the request cannot be read: {error}"))),
        };
        let _ = turns.send(Turn::End);
        let words = |words: &Vec<u32>| words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let bytes: Option<Vec<u8>> = generated.as_ref().ok().map(words);
        let Ok(reply) = serde_json::to_vec::<Reply>(&generated.map(drop)) else { return };
        if [Some(reply), bytes].iter().flatten().any(|message| send(&mut output, message).is_err()) {
            return;
        }
        if system::memory() > memory_bytes / 4 {
            return;
        }
    }
}

/// Ends the process when a compilation exceeds a limit, or when the parent ends during one.
fn watch(limits: Limits, turns: &Receiver<Turn>) {
    let (parent, idle) = (system::parent(), system::memory());
    let mut begun = None;
    loop {
        let turn = match begun {
            None => turns.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(_) => turns.recv_timeout(LOOK_EVERY),
        };
        match turn {
            Ok(Turn::Begin) => begun = Some(system::processor_time()),
            Ok(Turn::End) => begun = None,
            Err(RecvTimeoutError::Disconnected) => return,
            Err(RecvTimeoutError::Timeout) => {}
        }
        if system::parent() != parent {
            std::process::exit(0);
        }
        if begun.is_some_and(|begun| system::processor_time().saturating_sub(begun) > limits.time) {
            system::exit_now(OUT_OF_TIME);
        }
        if system::memory().saturating_sub(idle) > limits.memory_bytes {
            system::exit_now(OUT_OF_MEMORY);
        }
    }
}

#[cfg(unix)]
mod system {
    use std::fs::File;
    use std::io::Read;
    use std::mem::MaybeUninit;
    use std::os::fd::FromRawFd;
    use std::time::Duration;

    /// Limits the address space as a second line of defence, and disables core files.
    pub fn restrict(bytes: u64) {
        lower(libc::RLIMIT_AS, bytes as libc::rlim_t);
        lower(libc::RLIMIT_CORE, 0);
    }

    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    type Resource = libc::__rlimit_resource_t;
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    type Resource = libc::c_int;

    fn lower(resource: Resource, to: libc::rlim_t) {
        // SAFETY: both calls get a valid pointer to a local.
        unsafe {
            let mut limit = MaybeUninit::<libc::rlimit>::zeroed().assume_init();
            if libc::getrlimit(resource, &mut limit) == 0 {
                limit.rlim_cur = limit.rlim_cur.min(to);
                let _ = libc::setrlimit(resource, &limit);
            }
        }
    }

    /// Returns a private copy of standard output for messages. Anything that is printed later is discarded.
    pub fn private_output() -> File {
        // SAFETY: descriptors 1 and 2 are open (the parent set both), and the copy has no other owner.
        unsafe {
            let copy = libc::dup(1);
            libc::dup2(2, 1);
            File::from_raw_fd(copy)
        }
    }

    pub fn parent() -> i32 {
        // SAFETY: has no preconditions.
        unsafe { libc::getppid() }
    }

    /// Ends the process without running destructors or exit handlers, which may need locks.
    pub fn exit_now(code: i32) -> ! {
        // SAFETY: has no preconditions.
        unsafe { libc::_exit(code) }
    }

    fn usage() -> libc::rusage {
        // SAFETY: zero is a valid rusage, and the pointer is to a local.
        unsafe {
            let mut usage = MaybeUninit::<libc::rusage>::zeroed().assume_init();
            libc::getrusage(libc::RUSAGE_SELF, &mut usage);
            usage
        }
    }

    pub fn processor_time() -> Duration {
        let usage = usage();
        let of = |time: libc::timeval| {
            Duration::from_secs(time.tv_sec.unsigned_abs())
                + Duration::from_micros(u64::try_from(time.tv_usec).unwrap_or(0))
        };
        of(usage.ru_utime) + of(usage.ru_stime)
    }

    /// Returns the memory of the process in bytes; its peak if the system does not report the current value.
    pub fn memory() -> u64 {
        if let Some(pages) = resident_pages() {
            // SAFETY: has no preconditions.
            let page = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
            return pages * page.unsigned_abs();
        }
        let unit = if cfg!(target_os = "macos") { 1 } else { 1024 };
        usage().ru_maxrss.unsigned_abs() * unit
    }

    /// Returns the resident memory in pages, from `statm`; `None` on systems without it. (On Linux, `ru_maxrss`
    /// includes memory of the parent from before `exec`.)
    fn resident_pages() -> Option<u64> {
        // On the stack, because the heap may be exhausted.
        let mut text = [0; 128];
        let length = File::open("/proc/self/statm").ok()?.read(&mut text).ok()?;
        std::str::from_utf8(&text[..length]).ok()?.split(' ').nth(1)?.parse().ok()
    }
}

#[cfg(not(unix))]
mod system {
    use std::sync::OnceLock;
    use std::time::{Duration, Instant};

    pub fn restrict(_: u64) {}

    pub fn private_output() -> std::io::Stdout {
        std::io::stdout()
    }

    /// Returns 0: the pipe closes when the parent ends, so its id is not needed.
    pub fn parent() -> i32 {
        0
    }

    pub fn exit_now(code: i32) -> ! {
        std::process::exit(code)
    }

    /// Returns the time since the first call, an upper bound of the processor time.
    pub fn processor_time() -> Duration {
        static START: OnceLock<Instant> = OnceLock::new();
        START.get_or_init(Instant::now).elapsed()
    }

    pub fn memory() -> u64 {
        0
    }
}
