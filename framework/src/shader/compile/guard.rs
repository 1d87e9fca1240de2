//! Contains crashes of the compiler, so that the process survives them.
//!
//! glslang checks itself with assertions, and some broken shaders make it read through a null pointer (at the time of
//! writing, a `shared` array with the name of a buffer block does). Editing a shader beside a running renderer must not end
//! the renderer. So the compiler runs on a thread of its own, and while it does, the signals that a crash raises
//! are caught: if the compiler's thread raised one, that thread stops there, for good. It is never resumed and what it
//! holds is lost, which is some memory, as glslang keeps its state per thread. A crash of any other thread goes to the
//! handler that was installed before.
//!
//! On systems that are not Unix there is only the thread.

use std::thread;

/// Explains why the thread of [`run`] returned nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lost {
    /// It could not be started.
    NotStarted,
    Panicked,
    /// It raised a signal, or took longer than it may.
    #[cfg_attr(not(unix), expect(dead_code))]
    Crashed,
    #[cfg_attr(not(unix), expect(dead_code))]
    TookTooLong,
}

fn spawn<T: Send + 'static>(
    stack_bytes: usize,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<thread::JoinHandle<T>, Lost> {
    let builder = thread::Builder::new().name("glslang".into()).stack_size(stack_bytes);
    builder.spawn(work).map_err(|_| Lost::NotStarted)
}

#[cfg(not(unix))]
pub(super) fn run<T: Send + 'static>(
    stack_bytes: usize,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Lost> {
    spawn(stack_bytes, work)?.join().map_err(|_| Lost::Panicked)
}

#[cfg(unix)]
pub(super) use unix::run;

#[cfg(unix)]
mod unix {
    use std::mem::MaybeUninit;
    use std::os::unix::thread::JoinHandleExt;
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
    use std::sync::mpsc::{RecvTimeoutError, channel};
    use std::sync::{Mutex, OnceLock, PoisonError};
    use std::time::{Duration, Instant};
    use std::{mem, ptr};

    use super::{Lost, spawn};

    /// Shaders take milliseconds. What takes this long will not end: macros can grow without bounds.
    const LONGEST: Duration = Duration::from_secs(20);
    /// Interval of checking for a crash. The thread's end is noticed at once.
    const LOOK_EVERY: Duration = Duration::from_millis(10);

    /// Signals of crashes, and [`STOP`].
    const SIGNALS: [libc::c_int; 6] =
        [libc::SIGSEGV, libc::SIGABRT, libc::SIGBUS, libc::SIGFPE, libc::SIGILL, STOP];
    /// Sent to a thread that takes too long. Ignored by default: the thread may end just before it comes.
    const STOP: libc::c_int = libc::SIGURG;

    /// Held while a guarded thread runs: there is one at a time.
    static TURN: Mutex<()> = Mutex::new(());
    /// The guarded thread's `pthread_t`; 0 where there is none.
    static GUARDED: AtomicUsize = AtomicUsize::new(0);
    /// The guarded thread raised a signal, and is stopped.
    static CRASHED: AtomicBool = AtomicBool::new(false);
    /// Handlers of [`SIGNALS`] that were installed before.
    static BEFORE: OnceLock<[libc::sigaction; SIGNALS.len()]> = OnceLock::new();

    /// Runs `work` on a thread with a stack of `stack_bytes` and gives its result, whatever becomes of the thread.
    pub(in super::super) fn run<T: Send + 'static>(
        stack_bytes: usize,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Lost> {
        let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        catch_signals();
        CRASHED.store(false, Ordering::SeqCst);
        let (sender, receiver) = channel();
        let thread = spawn(stack_bytes, move || {
            GUARDED.store(this_thread(), Ordering::SeqCst);
            let result = work();
            GUARDED.store(0, Ordering::SeqCst);
            // The receiver waits until now, or has given up.
            let _ = sender.send(result);
        })?;
        let started = Instant::now();
        let lost = loop {
            match receiver.recv_timeout(LOOK_EVERY) {
                Ok(result) => {
                    // What the thread's end runs belongs to it, too.
                    let _ = thread.join();
                    return Ok(result);
                }
                Err(RecvTimeoutError::Disconnected) => break Lost::Panicked,
                Err(RecvTimeoutError::Timeout) if CRASHED.load(Ordering::SeqCst) => break Lost::Crashed,
                Err(RecvTimeoutError::Timeout) if started.elapsed() > LONGEST => {
                    stop(thread.as_pthread_t());
                    break Lost::TookTooLong;
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
        };
        GUARDED.store(0, Ordering::SeqCst);
        Err(lost)
    }

    fn this_thread() -> usize {
        // SAFETY: has no preconditions. On the platforms that we build for a pthread_t is an integer or a pointer.
        unsafe { libc::pthread_self() as usize }
    }

    /// Stops a thread that is still running, and waits for it to be stopped.
    fn stop(thread: libc::pthread_t) {
        // SAFETY: the thread has not been joined, so its id is valid, even if it ended just now.
        unsafe { libc::pthread_kill(thread, STOP) };
        let asked = Instant::now();
        while !CRASHED.load(Ordering::SeqCst) && asked.elapsed() < Duration::from_secs(1) {
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// Installs [`on_signal`], once for the life of the process: taking it out again could take out a handler that came
    /// after it.
    fn catch_signals() {
        BEFORE.get_or_init(|| {
            SIGNALS.map(|signal| {
                let mut before = MaybeUninit::<libc::sigaction>::zeroed();
                // SAFETY: zero is a valid sigaction (default action, empty mask); only documented fields are set, and
                // both pointers are to locals that live across the call.
                unsafe {
                    let mut ours = MaybeUninit::<libc::sigaction>::zeroed().assume_init();
                    ours.sa_sigaction = on_signal as *const () as usize;
                    // On the alternate stack that Rust gives its threads: the compiler may have used up its own.
                    ours.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
                    libc::sigaction(signal, ptr::null(), before.as_mut_ptr());
                    libc::sigaction(signal, &ours, ptr::null_mut());
                    before.assume_init()
                }
            })
        });
    }

    /// Stops the guarded thread; for any other, does what was to be done before us.
    ///
    /// Runs as a signal handler: only atomics and async-signal-safe calls.
    extern "C" fn on_signal(signal: libc::c_int, info: *mut libc::siginfo_t, context: *mut libc::c_void) {
        if GUARDED.load(Ordering::SeqCst) == this_thread() {
            CRASHED.store(true, Ordering::SeqCst);
            loop {
                // SAFETY: has no preconditions.
                unsafe { libc::pause() };
            }
        }
        let before = SIGNALS.iter().position(|s| *s == signal).and_then(|i| Some(BEFORE.get()?[i]));
        match before {
            Some(before) if before.sa_sigaction == libc::SIG_IGN => {}
            Some(before) if before.sa_sigaction == libc::SIG_DFL && signal == STOP => {}
            Some(before) if before.sa_sigaction != libc::SIG_DFL => {
                // SAFETY: the address was installed as a handler for this signal, of the kind that its flags say, and
                // gets what the kernel gave us.
                unsafe {
                    if before.sa_flags & libc::SA_SIGINFO != 0 {
                        let handler: extern "C" fn(libc::c_int, *mut libc::siginfo_t, *mut libc::c_void) =
                            mem::transmute(before.sa_sigaction);
                        handler(signal, info, context);
                    } else {
                        let handler: extern "C" fn(libc::c_int) = mem::transmute(before.sa_sigaction);
                        handler(signal);
                    }
                }
            }
            // Back to the default action; raised again it ends the process, as it would have.
            _ => {
                // SAFETY: both are async-signal-safe and take a valid signal number.
                unsafe {
                    libc::signal(signal, libc::SIG_DFL);
                    libc::raise(signal);
                }
            }
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn a_thread_that_crashes_is_lost_and_the_process_lives() {
            // SAFETY: has no preconditions.
            assert_eq!(run(1 << 20, || unsafe { libc::abort() }), Err::<(), _>(Lost::Crashed));
            // SAFETY: raises a signal on this thread, as an invalid read would.
            assert_eq!(run(1 << 20, || unsafe { libc::raise(libc::SIGSEGV) }), Err(Lost::Crashed));
            assert_eq!(run(1 << 20, || 7), Ok(7));
        }

        #[test]
        fn a_thread_that_overflows_its_stack_is_lost_and_the_process_lives() {
            fn deep(n: u64) -> u64 {
                std::hint::black_box(if n == 0 { 0 } else { deep(n - 1) + std::hint::black_box(n) })
            }
            assert_eq!(run(256 << 10, || deep(1 << 30)), Err(Lost::Crashed));
            assert_eq!(run(1 << 20, || 7), Ok(7));
        }
    }
}
