//! Attaches a layer to a window. The layer provides the drawables that the window shows.

use crate::apple::objc;
use metal::{MTLPixelFormat, MetalLayer};
use raw_window_handle::{HandleError, RawWindowHandle};
use splatgraph_api::BackendError;
use splatgraph_runtime::Window;
use std::sync::Arc;

/// Pixel format of the drawables. It is not sRGB, because colours are already display-encoded.
pub(crate) const FORMAT: MTLPixelFormat = MTLPixelFormat::BGRA8Unorm;

pub(crate) struct Surface {
    pub layer: MetalLayer,
    // The view belongs to the window.
    _window: Arc<dyn Window>,
}

impl Surface {
    pub fn new(window: Arc<dyn Window>, device: &metal::DeviceRef) -> Result<Surface, BackendError> {
        let handle = window.window_handle().map_err(no_handle)?.as_raw();
        let RawWindowHandle::AppKit(handle) = handle else {
            return Err(BackendError::Unavailable("Metal shows pictures only in AppKit windows".to_string()));
        };
        if !objc::is_main_thread() {
            return Err(BackendError::Invalid(
                "a window's device was opened on a thread other than the main one".to_string(),
            ));
        }
        let layer = MetalLayer::new();
        layer.set_device(device);
        layer.set_pixel_format(FORMAT);
        layer.set_framebuffer_only(true);
        layer.set_opaque(true);
        objc::set_srgb(&layer);
        // SAFETY: the handle's view lives as long as the window, which is kept; this is the main thread.
        unsafe { objc::show_in_view(handle.ns_view, &layer) };
        Ok(Surface { layer, _window: window })
    }
}

fn no_handle(error: HandleError) -> BackendError {
    BackendError::Unavailable(format!("the window cannot be drawn in: {error}"))
}
