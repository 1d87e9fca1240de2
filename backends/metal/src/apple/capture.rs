//! Captures a frame of the window for Xcode, as a `.gputrace`.
//!
//! The capture begins with the first commands recorded after the request, and ends when the window's next frame is
//! submitted. Metal writes documents only for programs started with `METAL_CAPTURE_ENABLED=1` (or by Xcode).

use crate::apple::objc;
use metal::{CaptureDescriptor, CaptureManager, DeviceRef, MTLCaptureDestination};
use splatgraph_runtime::lock;
use std::path::PathBuf;
use std::sync::Mutex;

enum State {
    Idle,
    /// A capture to this document was requested. It begins with the next commands.
    Asked(PathBuf),
    Running,
}

static STATE: Mutex<State> = Mutex::new(State::Idle);

/// Requests a capture of the window's next frame to the document `path`, which must not exist. If Metal fails to begin
/// it, a message of the device gives the reason.
///
/// # Errors
/// The program was started without support for captures, or a capture is already requested or running.
pub fn capture_next_frame(path: PathBuf) -> Result<(), String> {
    let able =
        objc::pool(|| CaptureManager::shared().supports_destination(MTLCaptureDestination::GpuTraceDocument));
    if !able {
        return Err(
            "Metal cannot capture this process: start the program with METAL_CAPTURE_ENABLED=1".to_string()
        );
    }
    let mut state = lock(&STATE);
    match *state {
        State::Idle => *state = State::Asked(path),
        State::Asked(_) | State::Running => return Err("a frame is already being captured".to_string()),
    }
    Ok(())
}

/// Begins the requested capture, if any, before commands are recorded. If that fails, drops the request and returns
/// Metal's reason.
pub(crate) fn begin(device: &DeviceRef) -> Option<String> {
    let mut state = lock(&STATE);
    let State::Asked(path) = &*state else { return None };
    let begun = objc::pool(|| {
        let descriptor = CaptureDescriptor::new();
        descriptor.set_capture_device(device);
        descriptor.set_destination(MTLCaptureDestination::GpuTraceDocument);
        objc::set_output(&descriptor, path)?;
        CaptureManager::shared().start_capture(&descriptor)
    });
    *state = if begun.is_ok() { State::Running } else { State::Idle };
    begun.err()
}

/// Ends the running capture, if any. Call it once a frame was submitted to the window.
pub(crate) fn end() {
    let mut state = lock(&STATE);
    if matches!(*state, State::Running) {
        objc::pool(|| CaptureManager::shared().stop_capture());
        *state = State::Idle;
    }
}
