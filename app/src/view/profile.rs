//! Connects the profilers Tracy and RenderDoc, each behind a feature, and frame capture on Apple's systems.
//!
//! With the feature `tracy`, host code is marked with zones (`zone!`), and the GPU times of every pass appear in a GPU
//! context. Host and device share no clock, so the durations are laid end to end before the time at which the host saw
//! the frame's end. With the feature `renderdoc`, the program can capture a frame if RenderDoc started it or its
//! library is preloaded. On Apple's systems, Metal writes the frame as a document for Xcode. See `docs/profiling.md`.

use splatgraph_api::FrameResult;
use splatgraph_framework::plan::Plan;
use std::path::PathBuf;

/// Opens a Tracy zone with this name, until the end of the block; expands to nothing without the feature `tracy`.
macro_rules! zone {
    ($name:literal) => {
        #[cfg(feature = "tracy")]
        let _zone = tracy_client::span!($name);
    };
}
pub(crate) use zone;

/// Starts the compiled-in profilers. Must be called before the device is opened, for RenderDoc.
pub fn start() {
    #[cfg(feature = "tracy")]
    tracy_client::Client::start();
    #[cfg(feature = "renderdoc")]
    capture::start();
}

/// Marks the end of a frame in Tracy; does nothing without it.
pub fn frame() {
    #[cfg(feature = "tracy")]
    if let Some(client) = tracy_client::Client::running() {
        client.frame_mark();
    }
}

/// Name of the tool that captures a frame of the window on request; `None` if none is compiled in.
pub const CAPTURES: Option<&str> = if cfg!(feature = "renderdoc") {
    Some("RenderDoc")
} else if cfg!(target_vendor = "apple") {
    Some("Metal, for Xcode")
} else {
    None
};

/// Captures the next frame of the window, with RenderDoc if it is compiled in. `document` returns a new path for
/// Metal's capture.
///
/// # Errors
/// No capture tool is compiled in or available, or a capture by Metal is already requested or running.
pub fn capture_next_frame(document: impl FnOnce() -> PathBuf) -> Result<(), String> {
    #[cfg(feature = "renderdoc")]
    {
        let _ = document;
        capture::next_frame()
    }
    #[cfg(all(target_vendor = "apple", not(feature = "renderdoc")))]
    return splatgraph_metal::capture_next_frame(document());
    #[cfg(not(any(target_vendor = "apple", feature = "renderdoc")))]
    {
        let _ = document;
        Err("the program was built without the feature `renderdoc`".to_owned())
    }
}

/// A Tracy track with the GPU times of one renderer's frames.
#[derive(Default)]
pub struct GpuTrack {
    #[cfg(feature = "tracy")]
    track: Option<tracy::Track>,
}

impl GpuTrack {
    /// Adds the passes of a finished frame. `name` names the track on the first call; later calls ignore it. Does
    /// nothing unless a Tracy client runs.
    pub fn push(&mut self, name: &str, plan: &Plan, result: &FrameResult) {
        #[cfg(feature = "tracy")]
        if let Some(client) = tracy_client::Client::running() {
            self.track.get_or_insert_with(|| tracy::Track::new(&client, name)).push(plan, result);
        }
        #[cfg(not(feature = "tracy"))]
        let _ = (name, plan, result);
    }
}

#[cfg(feature = "tracy")]
mod tracy {
    use super::*;
    use std::time::Instant;
    use tracy_client::{Client, GpuContext, GpuContextType};

    /// A GPU context whose clock counts nanoseconds of host time since its creation.
    pub struct Track {
        context: Option<GpuContext>,
        begun: Instant,
        /// End of the last span, in nanoseconds of the context's clock.
        end: i64,
    }

    impl Track {
        pub fn new(client: &Client, name: &str) -> Track {
            let context = client.clone().new_gpu_context(Some(name), GpuContextType::Vulkan, 0, 1.0);
            Track { context: context.ok(), begun: Instant::now(), end: 0 }
        }

        pub fn push(&mut self, plan: &Plan, result: &FrameResult) {
            let Some(context) = &self.context else { return };
            let nanoseconds = |ms: f64| (ms * 1e6) as i64;
            let all: f64 = result.pass_ms.iter().filter_map(|(_, ms)| *ms).sum();
            let now = self.begun.elapsed().as_nanos() as i64;
            let mut at = (now - nanoseconds(all)).max(self.end);
            for &(id, ms) in &result.pass_ms {
                let (pass, Some(ms)) = (plan.pass(id), ms) else { continue };
                // Tracy limits the number of spans in flight; further spans are dropped.
                let Ok(mut span) =
                    context.span_alloc(&pass.name, &pass.phase, &pass.origin.file, pass.origin.line)
                else {
                    continue;
                };
                span.end_zone();
                span.upload_timestamp_start(at);
                at += nanoseconds(ms);
                span.upload_timestamp_end(at);
            }
            self.end = at;
        }
    }
}

#[cfg(feature = "renderdoc")]
mod capture {
    use renderdoc::{RenderDoc, V110};
    use std::sync::{Mutex, OnceLock, PoisonError};

    type Api = Result<Mutex<RenderDoc<V110>>, String>;

    static API: OnceLock<Api> = OnceLock::new();

    pub fn start() {
        API.get_or_init(|| RenderDoc::new().map(Mutex::new).map_err(|error| error.to_string()));
    }

    pub fn next_frame() -> Result<(), String> {
        match API.get() {
            Some(Ok(api)) => {
                api.lock().unwrap_or_else(PoisonError::into_inner).trigger_capture();
                Ok(())
            }
            Some(Err(error)) => {
                Err(format!("RenderDoc is not available ({error}): start the program from it"))
            }
            None => Err("RenderDoc was not loaded when the program started".to_owned()),
        }
    }
}
