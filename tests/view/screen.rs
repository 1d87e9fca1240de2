//! A screen for the real program. It is an X server without a display (Xvfb), with a user's input through the XTEST
//! extension.

use std::time::{Duration, Instant};
use x11rb::connection::Connection;
use x11rb::errors::ReplyError;
use x11rb::protocol::xproto::*;
use x11rb::protocol::xtest::ConnectionExt as _;
use x11rb::rust_connection::RustConnection;
use x11rb::wrapper::ConnectionExt as _;

mod xvfb;

pub use xvfb::Screen;

/// Time limit of every wait, generous for slow machines.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Polling interval. Polling more often would slow the program down.
const LOOK: Duration = Duration::from_millis(25);

/// Polls a condition. Returns true once it holds, and false after [`PATIENCE`].
pub fn comes(mut is_there: impl FnMut() -> bool) -> bool {
    let begun = Instant::now();
    while !is_there() {
        if begun.elapsed() > PATIENCE {
            return false;
        }
        std::thread::sleep(LOOK);
    }
    true
}

/// Pixels of a part of a window, row 0 at the top.
#[derive(Clone, PartialEq, Eq)]
pub struct Pixels {
    pub width: usize,
    pub height: usize,
    /// Red, green and blue.
    pub rgb: Vec<[u8; 3]>,
}

impl Pixels {
    pub fn at(&self, x: usize, y: usize) -> [u8; 3] {
        self.rgb[y * self.width + x]
    }

    /// Returns the share of pixels that differ; 1 if the sizes differ.
    pub fn differs(&self, other: &Pixels) -> f64 {
        if (self.width, self.height) != (other.width, other.height) {
            return 1.0;
        }
        let different = self.rgb.iter().zip(&other.rgb).filter(|(a, b)| a != b).count();
        different as f64 / self.rgb.len().max(1) as f64
    }
}

/// A window of another program, and the keyboard and the pointer that act on it.
pub struct Window {
    connection: RustConnection,
    root: u32,
    id: u32,
    /// Keysyms that need no modifier, each with its keycode.
    keys: Vec<(u32, u8)>,
}

impl Window {
    /// Returns a window that has not appeared yet.
    pub fn on(screen: &Screen) -> Window {
        let (connection, number) =
            RustConnection::connect(Some(screen.display())).expect("the server answers");
        let root = connection.setup().roots[number].root;
        let (least, most) = (connection.setup().min_keycode, connection.setup().max_keycode);
        let map = connection.get_keyboard_mapping(least, most - least + 1);
        let map = map.expect("asked").reply().expect("answered");
        let codes = map.keysyms.chunks(map.keysyms_per_keycode.into());
        let keys = codes.zip(least..=most).map(|(syms, code)| (syms[0], code)).collect();
        Window { connection, root, id: 0, keys }
    }

    /// Waits for a visible window that can be asked to close (WM_PROTOCOLS). Returns true if it appeared.
    pub fn appears(&mut self) -> bool {
        let polite = self.atom("WM_PROTOCOLS");
        let look = || -> Result<Option<u32>, ReplyError> {
            let ask = &self.connection;
            for child in ask.query_tree(self.root)?.reply()?.children {
                let viewable = ask.get_window_attributes(child)?.reply()?.map_state == MapState::VIEWABLE;
                let property = ask.get_property(false, child, polite, AtomEnum::ANY, 0, 1)?.reply()?;
                if viewable && property.value_len > 0 {
                    return Ok(Some(child));
                }
            }
            Ok(None)
        };
        let mut found = None;
        comes(|| {
            // If a window vanishes during the query, try again.
            found = look().unwrap_or(None);
            found.is_some()
        });
        self.id = found.unwrap_or(self.id);
        found.is_some()
    }

    fn atom(&self, name: &str) -> u32 {
        let asked = self.connection.intern_atom(false, name.as_bytes()).expect("asked");
        asked.reply().expect("answered").atom
    }

    fn sync(&self) {
        self.connection.sync().expect("the server answers");
    }

    /// Gives the window the keyboard focus, as a window manager would.
    pub fn focus(&self) {
        let sent = self.connection.set_input_focus(InputFocus::PARENT, self.id, x11rb::CURRENT_TIME);
        sent.expect("sent").check().expect("the window takes the keyboard");
    }

    pub fn size(&self) -> (u32, u32) {
        let size = self.connection.get_geometry(self.id).expect("asked").reply().expect("answered");
        (size.width.into(), size.height.into())
    }

    pub fn title(&self) -> String {
        let (name, utf8) = (self.atom("_NET_WM_NAME"), self.atom("UTF8_STRING"));
        let asked = self.connection.get_property(false, self.id, name, utf8, 0, 1024).expect("asked");
        String::from_utf8_lossy(&asked.reply().expect("answered").value).into_owned()
    }

    pub fn resize(&self, width: u32, height: u32) {
        let size = ConfigureWindowAux::new().width(width).height(height);
        let sent = self.connection.configure_window(self.id, &size).expect("sent");
        sent.check().expect("the window is resized");
    }

    pub fn unmap(&self) {
        self.connection.unmap_window(self.id).expect("sent").check().expect("the window goes");
    }

    pub fn map(&self) {
        self.connection.map_window(self.id).expect("sent").check().expect("the window comes back");
    }

    /// Tells the window whether it is iconified, as a window manager would.
    pub fn set_minimised(&self, minimised: bool) {
        let (state, hidden) = (self.atom("_NET_WM_STATE"), self.atom("_NET_WM_STATE_HIDDEN"));
        let states: &[u32] = if minimised { &[hidden] } else { &[] };
        let sent =
            self.connection.change_property32(PropMode::REPLACE, self.id, state, AtomEnum::ATOM, states);
        sent.expect("sent").check().expect("the property is set");
    }

    /// Asks the window to close, as a window manager would.
    pub fn ask_to_close(&self) {
        let (protocols, delete) = (self.atom("WM_PROTOCOLS"), self.atom("WM_DELETE_WINDOW"));
        let event = ClientMessageEvent::new(32, self.id, protocols, [delete, x11rb::CURRENT_TIME, 0, 0, 0]);
        let sent = self.connection.send_event(false, self.id, EventMask::NO_EVENT, event);
        sent.expect("sent").check().expect("the message is sent");
    }

    /// Reads a rectangle of the window from the server: left, top, right, bottom.
    pub fn pixels(&self, [left, top, right, bottom]: [i32; 4]) -> Pixels {
        let (width, height) = ((right - left) as usize, (bottom - top) as usize);
        let rgb =
            xvfb::pixels(&self.connection, self.id, (left as i16, top as i16), (width as u16, height as u16));
        Pixels { width, height, rgb }
    }

    fn fake(&self, kind: u8, detail: u8, [x, y]: [i32; 2]) {
        let sent = self.connection.xtest_fake_input(kind, detail, 0, self.root, x as i16, y as i16, 0);
        sent.expect("sent").check().expect("the server has the extension XTEST");
        self.sync();
    }

    /// Moves the pointer to a place in the window.
    pub fn point(&self, [x, y]: [i32; 2]) {
        let origin = self.connection.translate_coordinates(self.id, self.root, 0, 0);
        let origin = origin.expect("asked").reply().expect("answered");
        let place = [x + i32::from(origin.dst_x), y + i32::from(origin.dst_y)];
        self.fake(MOTION_NOTIFY_EVENT, 0, place);
    }

    /// Presses a button of the pointer. 1 is left, 2 middle and 3 right; 4 and 5 are a notch of the wheel up and down.
    pub fn press(&self, button: u8) {
        self.fake(BUTTON_PRESS_EVENT, button, [0, 0]);
    }

    pub fn release(&self, button: u8) {
        self.fake(BUTTON_RELEASE_EVENT, button, [0, 0]);
    }

    /// Presses a key, by its X11 keysym, and releases it.
    pub fn key(&self, keysym: u32) {
        let code = self.keys.iter().find(|(sym, _)| *sym == keysym).map(|(_, code)| *code);
        let code = code.unwrap_or_else(|| panic!("the keyboard has no key {keysym:#x}"));
        self.fake(KEY_PRESS_EVENT, code, [0, 0]);
        self.fake(KEY_RELEASE_EVENT, code, [0, 0]);
    }
}
