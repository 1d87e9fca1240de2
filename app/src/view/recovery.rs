//! Opens another device after the device was lost.
//!
//! A [`Recovery`] draws the frames of a [`Shell`]. If the device or the window's surface is lost, everything on the
//! device is dropped, another device is opened, and the scene, which is still in host memory, is uploaded again. The
//! contents of history resources are lost.
//!
//! If the new device is lost soon after, the graph is the likely cause. The graph is not built again until its files,
//! its parameters or the scene change.

use super::events::Event;
use super::shell::{Frame, FrameRequest, Shell};
use crate::draw::backend::Backend;
use anyhow::{Result, bail};
use egui::RawInput;
use splatgraph_api::{BackendError, Device};
use std::time::{Duration, Instant};

/// Interval between attempts to open a device.
const INTERVAL: Duration = Duration::from_millis(500);

const ATTEMPTS: u32 = 20;

/// Maximum wait for a build that still holds the lost device.
const BUILDS: Duration = Duration::from_secs(5);

/// Time after a device is reopened within which a loss is attributed to the same cause as the loss before.
const SOON: Duration = Duration::from_secs(30);

/// A function that opens the window's and the scene's device, given the window's size in pixels.
pub type Open = Box<dyn FnMut((u32, u32)) -> Result<(Backend, Backend), BackendError>>;

struct Loss {
    error: BackendError,
    since: Instant,
    attempts: u32,
    next: Instant,
    /// True if the device was lost within [`SOON`] after it had replaced a lost one. False for a lost surface.
    again: bool,
}

/// Device opener with the state of the current loss; see the module's documentation.
pub struct Recovery {
    open: Open,
    loss: Option<Loss>,
    /// Time at which a device was last reopened; `None` if none was.
    opened: Option<Instant>,
}

impl Recovery {
    /// Creates a recovery that opens devices with `open`.
    pub fn new(open: Open) -> Recovery {
        Recovery { open, loss: None, opened: None }
    }

    /// Returns the error that reported the loss; `None` while there is a device.
    pub fn loss(&self) -> Option<&BackendError> {
        self.loss.as_ref().map(|loss| &loss.error)
    }

    /// Draws a frame of the shell; `None` while there is no device. After a frame that lost the device, releases the
    /// shell's devices; later calls open others.
    ///
    /// # Errors
    /// No device could be opened within `ATTEMPTS` attempts.
    pub fn frame(
        &mut self,
        shell: &mut Shell,
        input: RawInput,
        request: FrameRequest,
    ) -> Result<Option<Frame>> {
        if !self.reopen(shell, request.size)? {
            return Ok(None);
        }
        let frame = shell.frame(input, request);
        if let Some(error) = &frame.lost {
            self.lose(shell, error.clone());
        }
        Ok(Some(frame))
    }

    fn lose(&mut self, shell: &mut Shell, error: BackendError) {
        shell.release();
        shell.report(Event::DeviceLost { error: error.to_string() });
        let again = matches!(error, BackendError::DeviceLost(_))
            && self.opened.is_some_and(|opened| opened.elapsed() < SOON);
        let now = Instant::now();
        self.loss = Some(Loss { error, since: now, attempts: 0, next: now, again });
    }

    /// Tries to open another device if one was lost; returns true if there is a device now. Fails after [`ATTEMPTS`]
    /// failed attempts.
    fn reopen(&mut self, shell: &mut Shell, size: (u32, u32)) -> Result<bool> {
        let Some(loss) = &mut self.loss else { return Ok(true) };
        // A running build holds the previous device, and some window systems allow only one per window.
        let released = shell.is_released() || loss.since.elapsed() > BUILDS;
        if !released || Instant::now() < loss.next {
            return Ok(false);
        }
        loss.attempts += 1;
        let attempts = loss.attempts;
        let (canvas, device) = match (self.open)(size) {
            Ok(devices) => devices,
            Err(error) if attempts >= ATTEMPTS => {
                bail!("{}; no device can be opened in its place: {error}", loss.error);
            }
            Err(_) => {
                loss.next = Instant::now() + INTERVAL;
                return Ok(false);
            }
        };
        let name = device.info().name.clone();
        if let Err(error) = shell.give(canvas, device) {
            shell.report(Event::Problem { text: format!("B is closed: {error}") });
        }
        shell.report(Event::DeviceOpened { name, attempts });
        if loss.again {
            shell.viewer.hold(&loss.error.to_string());
        }
        shell.panels.show_notice(format!(
            "{}. The device was reopened, the scene uploaded again and all histories reset.",
            loss.error
        ));
        self.opened = Some(Instant::now());
        self.loss = None;
        Ok(true)
    }
}
