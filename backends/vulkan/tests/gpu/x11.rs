//! Plain X11 windows for tests.

use raw_window_handle::{
    DisplayHandle, HandleError, HasDisplayHandle, HasWindowHandle, RawWindowHandle, WindowHandle,
    XcbWindowHandle,
};
use std::ffi::CString;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use x11rb::connection::Connection;
use x11rb::protocol::xproto::*;
use x11rb::xcb_ffi::XCBConnection;

#[path = "../../../../tests/view/screen/xvfb.rs"]
mod xvfb;

pub use xvfb::Screen;

impl Screen {
    pub fn window(&self, width: u16, height: u16) -> Arc<Window> {
        let display = CString::new(self.display()).expect("no zeros");
        let (connection, screen) = XCBConnection::connect(Some(&display)).expect("the server answers");
        let root = &connection.setup().roots[screen];
        let (parent, depth, visual) = (root.root, root.root_depth, root.root_visual);
        assert_eq!(depth, 24);
        let id = connection.generate_id().expect("a new window");
        let values = CreateWindowAux::new().background_pixel(0);
        let class = WindowClass::INPUT_OUTPUT;
        connection
            .create_window(depth, id, parent, 0, 0, width, height, 0, class, visual, &values)
            .and_then(|_| connection.map_window(id))
            .expect("the window is created");
        let window = Window {
            id: NonZeroU32::new(id).expect("an id"),
            connection,
            is_suspended: AtomicBool::new(false),
        };
        until("the window is on the screen", || {
            let attributes = window.connection.get_window_attributes(id).expect("asked");
            attributes.reply().expect("answered").map_state == MapState::VIEWABLE
        });
        Arc::new(window)
    }
}

pub struct Window {
    connection: XCBConnection,
    id: NonZeroU32,
    is_suspended: AtomicBool,
}

impl Window {
    /// Resizes the window, and waits until it has its new size.
    pub fn resize(&self, width: u32, height: u32) {
        let size = ConfigureWindowAux::new().width(width).height(height);
        let sent = self.connection.configure_window(self.id.get(), &size).expect("the request is sent");
        sent.check().expect("the window is resized");
    }

    /// Makes the window refuse to give its handle, as the windows of a suspended Android application do.
    pub fn suspend(&self, is_suspended: bool) {
        self.is_suspended.store(is_suspended, Ordering::Relaxed);
    }

    /// Closes the window, and waits until it is gone.
    pub fn close(&self) {
        let sent = self.connection.destroy_window(self.id.get()).expect("the request is sent");
        sent.check().expect("the window is closed");
    }

    /// Reads red, green and blue of every pixel, row 0 at the top.
    pub fn pixels(&self) -> Vec<[u8; 3]> {
        let size = self.connection.get_geometry(self.id.get()).expect("asked").reply().expect("answered");
        xvfb::pixels(&self.connection, self.id.get(), (0, 0), (size.width, size.height))
    }

    /// Waits until the window shows these pixels, each value within `off`: presented images arrive after a delay.
    /// Panics after [`PATIENCE`], or if the window has another number of pixels.
    pub fn expect(&self, expected: &[[u8; 3]], off: u8) {
        let close = |a: &[u8; 3], b: &[u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= off);
        let start = Instant::now();
        loop {
            let shown = self.pixels();
            assert_eq!(shown.len(), expected.len());
            let wrong = shown.iter().zip(expected).position(|(shown, expected)| !close(shown, expected));
            let Some(pixel) = wrong else { return };
            if start.elapsed() >= PATIENCE {
                panic!("pixel {pixel} of the window is {:?}, and not {:?}", shown[pixel], expected[pixel]);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

const PATIENCE: Duration = Duration::from_secs(20);

fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < PATIENCE, "in vain: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

impl HasDisplayHandle for Window {
    fn display_handle(&self) -> Result<DisplayHandle<'_>, HandleError> {
        self.connection.display_handle()
    }
}

impl HasWindowHandle for Window {
    fn window_handle(&self) -> Result<WindowHandle<'_>, HandleError> {
        if self.is_suspended.load(Ordering::Relaxed) {
            return Err(HandleError::Unavailable);
        }
        let handle = RawWindowHandle::Xcb(XcbWindowHandle::new(self.id));
        // SAFETY: the window exists as long as the server's connection is open.
        Ok(unsafe { WindowHandle::borrow_raw(handle) })
    }
}
