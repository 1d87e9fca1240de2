//! Ends the program cleanly on a signal.
//!
//! SIGINT, SIGTERM and SIGHUP end the program at once, regardless of what its threads are doing. Finished files stay,
//! and unfinished ones are removed. The program then dies of the signal: shells report 128 plus its number. A second
//! signal ends it without that cleanup. A signal that the parent process set to be ignored, as `nohup` does, stays
//! ignored. A file that exceeds the process's size limit causes an error, and does not end the program. On Windows,
//! Ctrl-C, Ctrl-Break and a closed console do the same, with the exit code of Ctrl-C.

/// Installs the signal handlers. Call it once, at the start of the program.
///
/// Child processes start with the default handlers. If no thread can be started, signals keep their default effect,
/// which leaves no unfinished file either, if the file system supports unnamed files.
#[cfg(unix)]
pub fn end_cleanly() {
    use super::file;
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::{flag, iterator::Signals, low_level};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::thread::Builder;

    // A handler that does nothing replaces the default, which would end the program. The write then fails.
    let _ = flag::register(libc::SIGXFSZ, Arc::default());
    let wanted: Vec<i32> =
        [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| !is_ignored(*signal)).collect();
    let wait = move || {
        let Ok(mut signals) = Signals::new(&wanted) else { return };
        let again: Arc<AtomicBool> = Arc::default();
        for signal in wanted {
            let again = again.clone();
            let end_on_second = move || {
                if again.swap(true, Ordering::Relaxed) {
                    die_of(signal);
                }
            };
            // SAFETY: the handler only calls async-signal-safe functions.
            let _ = unsafe { low_level::register(signal, end_on_second) };
        }
        if let Some(signal) = signals.forever().next() {
            let _held = file::abandon();
            die_of(signal);
        }
    };
    let _ = Builder::new().name("signals".into()).spawn(wait);
}

/// Ends the process by the signal's default action. An exit code would not do: bash continues a loop after Ctrl-C,
/// unless the program dies of SIGINT. Handlers may call this function.
#[cfg(unix)]
fn die_of(signal: i32) -> ! {
    // SAFETY: the calls are async-signal-safe, zeros are a valid `sigset_t`, and the pointers are to it or null.
    unsafe {
        libc::signal(signal, libc::SIG_DFL);
        let mut set: libc::sigset_t = std::mem::zeroed();
        libc::sigemptyset(&raw mut set);
        libc::sigaddset(&raw mut set, signal);
        libc::pthread_sigmask(libc::SIG_UNBLOCK, &raw const set, std::ptr::null_mut());
        libc::raise(signal);
    }
    // The first process of a container ignores signals that have no handler.
    signal_hook::low_level::exit(128 + signal)
}

/// Flushes standard output, and ends the process without running its libraries' exit handlers. Unfinished files are
/// removed as on a signal.
#[cfg(unix)]
pub fn end_now(code: u8) {
    use std::io::Write;

    let _ = std::io::stdout().flush();
    let _held = super::file::abandon();
    signal_hook::low_level::exit(code.into());
}

/// Does nothing: the process exits normally.
#[cfg(not(unix))]
pub fn end_now(_: u8) {}

/// Installs the handler of the console's events. Call it once, at the start of the program.
#[cfg(windows)]
pub fn end_cleanly() {
    /// `STATUS_CONTROL_C_EXIT`, with which Windows ends a program that has no handler.
    const ENDED: i32 = 0xC000_013A_u32.cast_signed();
    let end = || {
        let _held = super::file::abandon();
        std::process::exit(ENDED);
    };
    // Without the handler's thread, an unfinished file can stay behind.
    let _ = ctrlc::set_handler(end);
}

#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    // SAFETY: all zeros are a valid `sigaction`, and with a null action the call only writes the present one to `old`.
    unsafe {
        let mut old: libc::sigaction = std::mem::zeroed();
        libc::sigaction(signal, std::ptr::null(), &raw mut old) == 0 && old.sa_sigaction == libc::SIG_IGN
    }
}
