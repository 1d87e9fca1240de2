//! Windows for tests: an X server without a display (Xvfb), and plain windows on it.

use raw_window_handle::{
    DisplayHandle, HandleError, HasDisplayHandle, HasWindowHandle, RawWindowHandle, WindowHandle,
    XcbWindowHandle,
};
use std::ffi::CString;
use std::io::{BufRead, BufReader};
use std::num::NonZeroU32;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use x11rb::connection::Connection;
use x11rb::protocol::xproto::*;
use x11rb::xcb_ffi::XCBConnection;

pub struct Server {
    process: Child,
    display: CString,
}

impl Server {
    pub fn start() -> Server {
        // Xvfb picks a free display number and writes it to its standard output.
        let mut process = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "640x480x24", "-nolisten", "tcp", "-noreset"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap_or_else(|why| {
                panic!("these tests need the X server Xvfb (Debian and Ubuntu: package `xvfb`): {why}")
            });
        let mut number = String::new();
        let output = process.stdout.take().expect("the output is a pipe");
        let read = BufReader::new(output).read_line(&mut number);
        let server = |number: &str| CString::new(format!(":{}", number.trim())).expect("digits");
        // From here on, the server is stopped even after a panic.
        let server = Server { process, display: server(&number) };
        assert!(read.is_ok() && !number.trim().is_empty(), "Xvfb ended before it had a display");
        server
    }

    pub fn window(&self, width: u16, height: u16) -> Arc<Window> {
        let (connection, screen) = XCBConnection::connect(Some(&self.display)).expect("the server answers");
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
        let window = Window { id: NonZeroU32::new(id).expect("an id"), connection };
        until("the window is on the screen", || {
            let attributes = window.connection.get_window_attributes(id).expect("asked");
            attributes.reply().expect("answered").map_state == MapState::VIEWABLE
        });
        Arc::new(window)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

pub struct Window {
    connection: XCBConnection,
    id: NonZeroU32,
}

impl Window {
    /// Resizes the window, and waits until it has its new size.
    pub fn resize(&self, width: u32, height: u32) {
        let size = ConfigureWindowAux::new().width(width).height(height);
        let sent = self.connection.configure_window(self.id.get(), &size).expect("the request is sent");
        sent.check().expect("the window is resized");
    }

    /// Closes the window, and waits until it is gone.
    pub fn close(&self) {
        let sent = self.connection.destroy_window(self.id.get()).expect("the request is sent");
        sent.check().expect("the window is closed");
    }

    /// Reads red, green and blue of every pixel, row 0 at the top.
    pub fn pixels(&self) -> Vec<[u8; 3]> {
        let size = self.connection.get_geometry(self.id.get()).expect("asked").reply().expect("answered");
        let (format, all) = (ImageFormat::Z_PIXMAP, u32::MAX);
        let image = self.connection.get_image(format, self.id.get(), 0, 0, size.width, size.height, all);
        let image = image.expect("asked").reply().expect("answered");
        // Pixels of depth 24 take 32 bits, which the assertion below checks.
        let pixels: Vec<[u8; 3]> = match self.connection.setup().image_byte_order {
            ImageOrder::LSB_FIRST => image.data.chunks_exact(4).map(|p| [p[2], p[1], p[0]]).collect(),
            _ => image.data.chunks_exact(4).map(|p| [p[1], p[2], p[3]]).collect(),
        };
        assert_eq!(pixels.len(), size.width as usize * size.height as usize);
        pixels
    }

    /// Waits until the window shows these pixels, each value within `off`: presented images arrive after a delay.
    pub fn expect(&self, expected: &[[u8; 3]], off: u8) {
        let close = |a: &[u8; 3], b: &[u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= off);
        let mut shown = self.pixels();
        let start = Instant::now();
        while shown.len() == expected.len() && start.elapsed() < PATIENCE {
            let wrong = shown.iter().zip(expected).position(|(shown, expected)| !close(shown, expected));
            if wrong.is_none() {
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
            shown = self.pixels();
        }
        assert_eq!(shown.len(), expected.len());
        let wrong = shown.iter().zip(expected).position(|(shown, expected)| !close(shown, expected));
        if let Some(pixel) = wrong {
            panic!("pixel {pixel} of the window is {:?}, and not {:?}", shown[pixel], expected[pixel]);
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
        let handle = RawWindowHandle::Xcb(XcbWindowHandle::new(self.id));
        // SAFETY: the window exists as long as the server's connection is open.
        Ok(unsafe { WindowHandle::borrow_raw(handle) })
    }
}
