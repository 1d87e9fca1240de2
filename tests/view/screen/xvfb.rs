//! A headless X server (Xvfb) for tests, and the pixels of its windows. The Vulkan backend's tests use it, too.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use x11rb::connection::Connection;
use x11rb::protocol::xproto::*;

/// An X server for one test; dropping it stops the server.
pub struct Screen {
    process: Child,
    display: String,
}

impl Screen {
    pub fn start(width: u32, height: u32) -> Screen {
        // Xvfb picks a free display number and writes it to its standard output.
        let mut process = Command::new("Xvfb")
            .args(["-displayfd", "1", "-nolisten", "tcp", "-noreset"])
            .args(["-screen", "0", &format!("{width}x{height}x24")])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap_or_else(|why| {
                panic!("this test needs the X server Xvfb (Debian and Ubuntu: package `xvfb`): {why}")
            });
        let output = process.stdout.take().expect("the output is a pipe");
        // From here on, the server is stopped even after a panic.
        let mut screen = Screen { process, display: String::new() };
        let mut number = String::new();
        let read = BufReader::new(output).read_line(&mut number);
        assert!(read.is_ok() && !number.trim().is_empty(), "Xvfb ended before it had a display");
        screen.display = format!(":{}", number.trim());
        screen
    }

    pub fn display(&self) -> &str {
        &self.display
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Reads red, green and blue of the pixels in a rectangle of a window, row 0 at the top.
pub fn pixels(
    connection: &impl Connection,
    window: u32,
    (left, top): (i16, i16),
    (width, height): (u16, u16),
) -> Vec<[u8; 3]> {
    let image = connection.get_image(ImageFormat::Z_PIXMAP, window, left, top, width, height, u32::MAX);
    let image = image.expect("asked").reply().expect("answered");
    // Pixels of depth 24 take 32 bits, which the assertion below checks.
    let rgb: Vec<[u8; 3]> = match connection.setup().image_byte_order {
        ImageOrder::LSB_FIRST => image.data.chunks_exact(4).map(|p| [p[2], p[1], p[0]]).collect(),
        _ => image.data.chunks_exact(4).map(|p| [p[1], p[2], p[3]]).collect(),
    };
    assert_eq!(rgb.len(), usize::from(width) * usize::from(height));
    rgb
}
