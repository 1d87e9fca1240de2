//! Connects to the display, and outlives its end.
//!
//! Winit panics where its connection to an X server breaks, and libX11 ends the process by itself, with code 1 and a line on
//! standard error. Both are an error of the display here, and neither reads like a defect of this program.

use anyhow::{Result, anyhow};
use std::panic::{AssertUnwindSafe, catch_unwind};
#[cfg(unix)]
use std::time::Duration;
use winit::event_loop::{ActiveEventLoop, EventLoop};

/// The share of a display's height that title bars and panels of a desktop leave to a window, about.
const USABLE_HEIGHT: f64 = 0.92;

/// The time that the process has to end by itself.
#[cfg(unix)]
const ENDING: Duration = Duration::from_secs(2);

/// Opens the connection to the display.
///
/// # Errors
/// There is none.
pub fn event_loop() -> Result<EventLoop<()>> {
    let mut builder = EventLoop::builder();
    #[cfg(all(unix, not(target_os = "macos")))]
    if !wayland::answers() && is_set("DISPLAY") {
        // Winit takes Wayland wherever its variable is set.
        winit::platform::x11::EventLoopBuilderExtX11::with_x11(&mut builder);
    }
    // Some errors are panics.
    let built = guarded(|| builder.build().map_err(|error| error.to_string()));
    let built = built.map_err(|error| error.to_string()).and_then(|built| built);
    built.map_err(|error| {
        // The text before it is a place in winit's source.
        let why = error.rsplit(": ").next().unwrap_or_default().trim_end_matches('.');
        anyhow!("there is no display to open a window on ({why}); `splatgraph render` draws without one")
    })
}

#[cfg(all(unix, not(target_os = "macos")))]
fn is_set(variable: &str) -> bool {
    std::env::var_os(variable).is_some_and(|value| !value.is_empty())
}

#[cfg(all(unix, not(target_os = "macos")))]
mod wayland {
    use super::is_set;
    use std::os::unix::net::UnixStream;
    use std::path::PathBuf;

    /// Returns true if a compositor accepts connections, as far as that can be found out without being its client.
    pub fn answers() -> bool {
        // An inherited connection can be used once.
        is_set("WAYLAND_SOCKET") || socket().is_some_and(|path| UnixStream::connect(path).is_ok())
    }

    /// Returns the compositor's socket: WAYLAND_DISPLAY, in XDG_RUNTIME_DIR unless it is an absolute path.
    fn socket() -> Option<PathBuf> {
        let name = std::env::var_os("WAYLAND_DISPLAY").filter(|name| !name.is_empty())?;
        let name = PathBuf::from(name);
        if name.is_absolute() {
            return Some(name);
        }
        Some(PathBuf::from(std::env::var_os("XDG_RUNTIME_DIR")?).join(name))
    }
}

/// Runs what talks to the display; a panic of the window library is an error.
///
/// # Errors
/// The display, or the connection to it, is gone.
pub fn guarded<T>(work: impl FnOnce() -> T) -> Result<T> {
    let thread = std::thread::current().id();
    let former = std::sync::Arc::new(std::panic::take_hook());
    let hook = former.clone();
    std::panic::set_hook(Box::new(move |panic| {
        let library = panic.location().is_some_and(|place| is_of_window_library(place.file()));
        if !(library && std::thread::current().id() == thread) {
            (*hook)(panic);
        }
    }));
    let result = catch_unwind(AssertUnwindSafe(work));
    // A hook cannot be changed while its thread panics.
    if !std::thread::panicking() {
        drop(std::panic::take_hook());
        if let Ok(former) = std::sync::Arc::try_unwrap(former) {
            std::panic::set_hook(former);
        }
    }
    result.map_err(|payload| {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or(payload.downcast_ref::<&str>().copied()).unwrap_or_default();
        anyhow!("the display is gone, or the window library failed ({text})")
    })
}

/// Ends the process shortly, unless it ends by itself: a driver may wait for its device at the end, too.
pub fn end_soon(code: i32) {
    #[cfg(not(unix))]
    let _ = code;
    #[cfg(unix)]
    {
        let end = move || {
            std::thread::sleep(ENDING);
            signal_hook::low_level::exit(code);
        };
        // Without a free thread, the process ends when the driver does.
        let _ = std::thread::Builder::new().name("end".to_owned()).spawn(end);
    }
}

/// Returns true for sources of the crates that talk to the display.
fn is_of_window_library(file: &str) -> bool {
    ["/winit-", "/x11rb-", "/x11-dl-", "/wayland-", "/calloop-"].iter().any(|name| file.contains(name))
}

/// Returns the largest size up to `size` that fits a display, in pixels.
pub fn at_most(target: &ActiveEventLoop, size: (u32, u32)) -> (u32, u32) {
    let monitor = target.primary_monitor().or_else(|| target.available_monitors().next());
    let monitor = monitor.map(|monitor| monitor.size()).filter(|size| size.width > 0 && size.height > 0);
    monitor.map_or(size, |monitor| fitted(size, (monitor.width, monitor.height)))
}

fn fitted(size: (u32, u32), monitor: (u32, u32)) -> (u32, u32) {
    let height = (f64::from(monitor.1) * USABLE_HEIGHT) as u32;
    // A size that the monitor has exactly was meant for it.
    let height = if size == monitor { monitor.1 } else { height };
    (size.0.min(monitor.0), size.1.min(height.max(1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_is_no_larger_than_its_monitor_and_leaves_room_for_title_bars() {
        assert_eq!(fitted((1600, 900), (1440, 900)), (1440, 828));
        assert_eq!(fitted((1600, 900), (2560, 1440)), (1600, 900));
        assert_eq!(fitted((1280, 800), (1280, 800)), (1280, 800));
        assert_eq!(fitted((900, 720), (1280, 800)), (900, 720));
    }

    #[test]
    fn a_panic_of_the_window_library_is_an_error_and_the_hook_is_as_before() {
        let error = guarded(|| panic!("this panic is part of a test")).unwrap_err();
        assert!(error.to_string().contains("this panic is part of a test"), "{error}");
        assert_eq!(guarded(|| 3).unwrap(), 3);
    }
}
