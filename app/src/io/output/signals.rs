//! Ends the program cleanly on a signal.
//!
//! SIGINT, SIGTERM and SIGHUP end it at once, whatever its threads are doing: finished files stay, unfinished ones go, and the exit
//! code is 128 and the signal's number. A second signal does not even wait for that. A signal that the parent had set to be
//! ignored, as `nohup` does, stays ignored. A file that grows beyond the limit of the process is an error, not the end.

/// Starts to handle signals. Call it once, at the start of the program.
///
/// Child processes are not concerned: they start with the defaults. Without a free thread, signals end the program as they
/// would any other, which leaves nothing unfinished either where files are without a name until they are whole.
#[cfg(unix)]
pub fn end_cleanly() {
    use super::file;
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::{flag, iterator::Signals, low_level};
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    use std::thread::Builder;

    // A handler that does nothing makes the write fail instead.
    let _ = flag::register(libc::SIGXFSZ, Arc::default());
    let wanted: Vec<i32> =
        [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| !is_ignored(*signal)).collect();
    let wait = move || {
        let Ok(mut signals) = Signals::new(&wanted) else { return };
        let again: Arc<AtomicBool> = Arc::default();
        // In this order, the first signal only arms what ends the program at the second.
        for signal in &wanted {
            let _ = flag::register_conditional_shutdown(*signal, 128 + signal, again.clone());
            let _ = flag::register(*signal, again.clone());
        }
        if let Some(signal) = signals.forever().next() {
            let _held = file::abandon();
            low_level::exit(128 + signal);
        }
    };
    let _ = Builder::new().name("signals".into()).spawn(wait);
}

/// Ends the process without the exit handlers of its libraries. Unfinished files go, as at a signal.
#[cfg(unix)]
pub fn end_now(code: u8) {
    use std::io::Write;

    // What cannot be written is lost either way.
    let _ = std::io::stdout().flush();
    let _held = super::file::abandon();
    signal_hook::low_level::exit(code.into());
}

/// Does nothing: the process ends as any other does.
#[cfg(not(unix))]
pub fn end_now(_: u8) {}

/// Starts to handle signals, which this system does not have.
#[cfg(not(unix))]
pub fn end_cleanly() {}

/// Returns true if the parent process had this signal ignored.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    // SAFETY: all zeros are a valid `sigaction`, and with a null action the call only writes the present one to `old`.
    unsafe {
        let mut old: libc::sigaction = std::mem::zeroed();
        libc::sigaction(signal, std::ptr::null(), &raw mut old) == 0 && old.sa_sigaction == libc::SIG_IGN
    }
}
