//! Connects to the display, and reports its loss as an error.
//!
//! If the connection to an X server breaks, winit panics, which [`guarded`] converts to an error, or libX11 exits the
//! process with code 1 and a line on standard error: see [`set_open`]. A panic of this program in a winit callback is
//! instead an internal error.

use anyhow::{Context as _, Result, anyhow};
use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Once};
use winit::event_loop::{ActiveEventLoop, EventLoop};
use winit::window::{Window, WindowAttributes};

/// Approximate fraction of a display's height that remains for a window beside title bars and panels.
const USABLE_HEIGHT: f64 = 0.92;

pub fn event_loop() -> Result<EventLoop<()>> {
    let mut builder = EventLoop::builder();
    #[cfg(all(unix, not(target_os = "macos")))]
    if !wayland::answers() && is_set("DISPLAY") {
        // Otherwise winit would choose Wayland because `WAYLAND_DISPLAY` is set.
        winit::platform::x11::EventLoopBuilderExtX11::with_x11(&mut builder);
    }
    // winit reports some errors by a panic.
    let built = guarded(|| builder.build().map_err(|error| error.to_string()));
    let built = built.map_err(|panic| panic.message).and_then(|built| built);
    built.map_err(|error| {
        // Drop the prefix, a location in winit's source.
        let why = error.rsplit(": ").next().unwrap_or_default().trim_end_matches('.');
        anyhow!("{} ({why}); `splatgraph render` draws without a window", lacking(why))
    })
}

/// Describes what is missing, a display or a shared library, given the window library's error.
fn lacking(why: &str) -> &'static str {
    // Libraries that are opened at run time are in no list of dependencies, so the message lists all packages.
    match why.contains("load") {
        true => {
            "a library that windows need is missing: on Debian and Ubuntu, windows on X11 need the packages libx11-6, \
             libx11-xcb1, libxcursor1, libxi6, libxkbcommon0 and libxkbcommon-x11-0, those on Wayland libwayland-client0 \
             and libxkbcommon0"
        }
        false => "there is no display to open a window on",
    }
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

    /// Returns true if a Wayland compositor accepts connections, as far as a check without a client can tell.
    pub fn answers() -> bool {
        // An inherited socket can be used only once, so it is not tried.
        is_set("WAYLAND_SOCKET") || socket().is_some_and(|path| UnixStream::connect(path).is_ok())
    }

    /// Returns the path of the compositor's socket: `WAYLAND_DISPLAY`, in `XDG_RUNTIME_DIR` unless absolute. `None` if
    /// these variables do not give it.
    fn socket() -> Option<PathBuf> {
        let name = std::env::var_os("WAYLAND_DISPLAY").filter(|name| !name.is_empty())?;
        let name = PathBuf::from(name);
        if name.is_absolute() {
            return Some(name);
        }
        Some(PathBuf::from(std::env::var_os("XDG_RUNTIME_DIR")?).join(name))
    }
}

thread_local! {
    /// Owner of the code that this thread runs within [`guarded`].
    static RUNNING: Cell<Option<Whose>> = const { Cell::new(None) };
    /// The last panic within [`guarded`] on this thread.
    static PANIC: RefCell<Option<Panic>> = const { RefCell::new(None) };
}

/// Owner of running code, to whom a panic is attributed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Whose {
    Program,
    /// The window library, including egui's adapter for it.
    Library,
}

/// A panic caught by [`guarded`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.text())]
pub struct Panic {
    whose: Whose,
    message: String,
    /// File, line and column.
    place: String,
}

impl Panic {
    fn text(&self) -> String {
        let Panic { whose, message, place } = self;
        match whose {
            Whose::Program => format!(
                "internal error at {place}: {message}\nThis is a bug in splatgraph. Please report it with this text."
            ),
            Whose::Library => {
                format!("the display is gone, or the window library failed: {message} ({place})")
            }
        }
    }
}

/// Runs the event loop, or another call of the window library, until it returns or panics.
///
/// Callbacks of the library must run in [`own`], and calls back into the library in [`library`]. The innermost one
/// determines the owner of a panic.
///
/// # Errors
/// The library panicked because the display or the connection to it is gone; or this program panicked, which is a bug.
pub fn guarded<T>(work: impl FnOnce() -> T) -> Result<T, Panic> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            let whose = RUNNING.get();
            if let Some(whose) = whose {
                let message = panic.payload_as_str().unwrap_or("a panic without a message").to_owned();
                let place = panic.location().map_or_else(String::new, ToString::to_string);
                PANIC.set(Some(Panic { whose, message, place }));
            }
            if whose != Some(Whose::Library) {
                usual(panic);
            }
        }));
    });
    let result = catch_unwind(AssertUnwindSafe(|| library(work)));
    result.map_err(|_| PANIC.take().expect("what unwinds was recorded by the hook"))
}

/// Runs code of this program inside a callback of the window library.
pub fn own<T>(work: impl FnOnce() -> T) -> T {
    run_as(Whose::Program, work)
}

/// Runs a call into the window library.
pub fn library<T>(call: impl FnOnce() -> T) -> T {
    run_as(Whose::Library, call)
}

fn run_as<T>(whose: Whose, work: impl FnOnce() -> T) -> T {
    struct Restore(Option<Whose>);
    impl Drop for Restore {
        fn drop(&mut self) {
            RUNNING.set(self.0);
        }
    }
    let _restore = Restore(RUNNING.replace(Some(whose)));
    work()
}

/// A window whose methods run winit's calls within [`library`].
pub struct Handle(Arc<Window>);

impl Handle {
    /// Opens a window. Fails if the display server refuses it.
    pub fn open(target: &ActiveEventLoop, attributes: WindowAttributes) -> Result<Handle> {
        let window = library(|| target.create_window(attributes)).context("the window cannot be opened")?;
        Ok(Handle(Arc::new(window)))
    }

    pub fn with<T>(&self, call: impl FnOnce(&Window) -> T) -> T {
        library(|| call(&self.0))
    }

    /// Returns the window, for a device to create its surface on.
    pub fn surface(&self) -> Arc<Window> {
        self.0.clone()
    }

    /// Returns the size of the window's content, in pixels.
    pub fn size(&self) -> (u32, u32) {
        self.with(Window::inner_size).into()
    }
}

/// True while devices are open, and other threads may be using them.
static OPEN: AtomicBool = AtomicBool::new(false);

/// Records whether devices are open. Exit handlers of drivers free memory that other threads may still use. While
/// devices are open, the process must end without these handlers: see [`is_left_open`]. libX11 calls `exit` by itself,
/// so this installs a handler that runs before the others.
pub fn set_open(open: bool) {
    OPEN.store(open, Ordering::Relaxed);
    #[cfg(unix)]
    if open {
        extern "C" fn end() {
            if is_left_open() {
                crate::io::output::signals::end_now(1);
            }
        }
        static HANDLER: Once = Once::new();
        // Exit handlers run in reverse order, and drivers register theirs when they are loaded.
        //
        // SAFETY: `end` is a function of the program, and nothing unwinds from it.
        HANDLER.call_once(|| _ = unsafe { libc::atexit(end) });
    }
}

/// Returns true if devices are open. At exit, this means that they were busy or could not be closed.
pub fn is_left_open() -> bool {
    OPEN.load(Ordering::Relaxed)
}

/// Returns `size`, in pixels, reduced to fit on the display; unchanged if the display's size is unknown.
pub fn at_most(target: &ActiveEventLoop, size: (u32, u32)) -> (u32, u32) {
    let monitor = library(|| target.primary_monitor().or_else(|| target.available_monitors().next()));
    let monitor =
        monitor.map(|monitor| library(|| monitor.size())).filter(|size| size.width > 0 && size.height > 0);
    monitor.map_or(size, |monitor| fitted(size, (monitor.width, monitor.height)))
}

fn fitted(size: (u32, u32), monitor: (u32, u32)) -> (u32, u32) {
    let height = (f64::from(monitor.1) * USABLE_HEIGHT) as u32;
    // A size equal to the monitor's was chosen on purpose, so it is kept.
    let height = if size == monitor { monitor.1 } else { height };
    (size.0.min(monitor.0), size.1.min(height.max(1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_library_is_no_missing_display() {
        for why in ["Failed to load one of xlib's shared libraries", "libxkbcommon.so could not be loaded"] {
            assert!(lacking(why).starts_with("a library that windows need is missing"), "{why}");
        }
        assert!(lacking("Failed to open connection to X server").contains("no display"));
    }

    #[test]
    fn a_window_is_no_larger_than_its_monitor_and_leaves_room_for_title_bars() {
        assert_eq!(fitted((1600, 900), (1440, 900)), (1440, 828));
        assert_eq!(fitted((1600, 900), (2560, 1440)), (1600, 900));
        assert_eq!(fitted((1280, 800), (1280, 800)), (1280, 800));
        assert_eq!(fitted((900, 720), (1280, 800)), (900, 720));
    }

    const PLACE: &str = "display.rs:";

    #[test]
    fn a_panic_of_the_window_library_is_told_as_the_end_of_the_display() {
        let error = guarded(|| panic!("this panic is part of a test")).unwrap_err().to_string();
        assert!(
            error.starts_with("the display is gone, or the window library failed: this panic"),
            "{error}"
        );
        assert!(error.contains(PLACE), "{error}");
        assert_eq!(guarded(|| 3).unwrap(), 3);
    }

    #[test]
    fn a_panic_in_a_callback_is_a_bug_of_the_program_with_its_message_and_place() {
        let error = guarded(|| own(|| panic!("this panic is part of a test"))).unwrap_err().to_string();
        assert!(error.starts_with("internal error at ") && error.contains(PLACE), "{error}");
        assert!(error.contains(": this panic is part of a test\n"), "{error}");
        assert!(error.contains("This is a bug in splatgraph"), "{error}");
        // A caught panic must not be reported as the cause of the event loop's end.
        let error = guarded(|| {
            let caught = catch_unwind(|| own(|| panic!("this panic is part of a test, too")));
            assert!(caught.is_err());
            panic!("this panic is part of a test")
        });
        assert!(error.unwrap_err().to_string().starts_with("the display is gone"));
    }

    #[test]
    fn a_call_of_the_window_library_from_a_callback_panics_for_the_display() {
        let error = guarded(|| own(|| library(|| panic!("this panic is part of a test")))).unwrap_err();
        assert!(error.to_string().starts_with("the display is gone"), "{error}");
        let error = guarded(|| {
            own(|| {
                library(|| ());
                panic!("this panic is part of a test")
            })
        });
        assert!(error.unwrap_err().to_string().starts_with("internal error"));
    }
}
