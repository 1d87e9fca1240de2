//! Creates the surface of a window, and queries its properties.
//!
//! A surface belongs to an instance, not to a device. The choices based on its properties ([`format()`],
//! [`present_mode`], [`extent`] and others) are pure functions.

use crate::error::api;
use ash::{khr, vk};
use raw_window_handle::{HandleError, RawDisplayHandle};
use splatgraph_api::BackendError;
use splatgraph_runtime::Window;
use std::ffi::CStr;

pub(crate) fn extensions(window: &dyn Window) -> Result<Vec<&'static CStr>, BackendError> {
    let display = window.display_handle().map_err(no_handle)?;
    let names = ash_window::enumerate_required_extensions(display.as_raw()).map_err(|_| {
        BackendError::Unavailable("Vulkan does not support surfaces for this window system".to_string())
    })?;
    // SAFETY: the names are constants of `ash`.
    Ok(names.iter().map(|&name| unsafe { CStr::from_ptr(name) }).collect())
}

/// A surface, destroyed on drop. That must happen before its instance is destroyed.
pub(crate) struct Surface {
    pub raw: vk::SurfaceKHR,
    is_wayland: bool,
    functions: khr::surface::Instance,
}

impl Surface {
    /// Creates a window's surface. The instance must have the window system's [`extensions`].
    pub fn new(
        entry: &ash::Entry,
        instance: &ash::Instance,
        window: &dyn Window,
    ) -> Result<Surface, BackendError> {
        let display = window.display_handle().map_err(no_handle)?.as_raw();
        let handle = window.window_handle().map_err(no_handle)?.as_raw();
        // SAFETY: both handles are valid as long as the window exists. The owner of the instance keeps the window, and
        // drops the surface first.
        let raw = unsafe { ash_window::create_surface(entry, instance, display, handle, None) };
        let raw = raw.map_err(api("vkCreate*SurfaceKHR"))?;
        let is_wayland = matches!(display, RawDisplayHandle::Wayland(_));
        Ok(Surface { raw, is_wayland, functions: khr::surface::Instance::new(entry, instance) })
    }

    /// Returns true if queues of this family can present to the window; false also if the query fails.
    pub fn can_show(&self, device: vk::PhysicalDevice, family: u32) -> bool {
        // SAFETY: the device belongs to the instance, and the family to the device.
        unsafe { self.functions.get_physical_device_surface_support(device, family, self.raw) }
            .unwrap_or(false)
    }

    pub fn capabilities(
        &self,
        device: vk::PhysicalDevice,
    ) -> Result<vk::SurfaceCapabilitiesKHR, BackendError> {
        // SAFETY: the device belongs to the instance and can present to the window.
        unsafe { self.functions.get_physical_device_surface_capabilities(device, self.raw) }
            .map_err(window("vkGetPhysicalDeviceSurfaceCapabilitiesKHR"))
    }

    pub fn formats(&self, device: vk::PhysicalDevice) -> Result<Vec<vk::SurfaceFormatKHR>, BackendError> {
        // SAFETY: as above.
        unsafe { self.functions.get_physical_device_surface_formats(device, self.raw) }
            .map_err(window("vkGetPhysicalDeviceSurfaceFormatsKHR"))
    }

    pub fn present_mode(
        &self,
        device: vk::PhysicalDevice,
        vsync: bool,
    ) -> Result<vk::PresentModeKHR, BackendError> {
        // SAFETY: as above.
        let offered = unsafe { self.functions.get_physical_device_surface_present_modes(device, self.raw) }
            .map_err(window("vkGetPhysicalDeviceSurfacePresentModesKHR"))?;
        Ok(present_mode(&offered, vsync && !self.is_wayland))
    }
}

impl Drop for Surface {
    fn drop(&mut self) {
        // SAFETY: the instance is alive, and all swapchains of the surface have been destroyed.
        unsafe { self.functions.destroy_surface(self.raw, None) };
    }
}

/// Returns a converter for `map_err` that turns the result codes of the window function `call` into errors.
pub(crate) fn window(call: &'static str) -> impl Fn(vk::Result) -> BackendError {
    move |answer| match answer {
        vk::Result::ERROR_SURFACE_LOST_KHR => BackendError::SurfaceLost { call },
        vk::Result::ERROR_NATIVE_WINDOW_IN_USE_KHR => BackendError::Unavailable(format!(
            "{call} reported that something else already draws in this window"
        )),
        _ => api(call)(answer),
    }
}

fn no_handle(error: HandleError) -> BackendError {
    BackendError::Unavailable(format!("the window cannot be drawn in now: {error}"))
}

/// Formats to choose from, best first. None is sRGB, because colours are already display-encoded. An X11 window may
/// offer only the format that matches its visual.
const FORMATS: [vk::Format; 5] = [
    vk::Format::B8G8R8A8_UNORM,
    vk::Format::R8G8B8A8_UNORM,
    vk::Format::A2B10G10R10_UNORM_PACK32,
    vk::Format::A2R10G10B10_UNORM_PACK32,
    vk::Format::R5G6B5_UNORM_PACK16,
];

/// Chooses the format of the window's images. It is the first of [`FORMATS`] that is `offered` in the colour space
/// `SRGB_NONLINEAR` and that the device can blit to. The error is [`BackendError::Unavailable`] if there is none.
pub(crate) fn format(
    offered: &[vk::SurfaceFormatKHR],
    can_blit: impl Fn(vk::Format) -> bool,
) -> Result<vk::SurfaceFormatKHR, BackendError> {
    let plain = |format| vk::SurfaceFormatKHR { format, color_space: vk::ColorSpaceKHR::SRGB_NONLINEAR };
    let found = FORMATS.into_iter().map(plain).find(|want| offered.contains(want) && can_blit(want.format));
    found.ok_or_else(|| {
        let offered: Vec<String> =
            offered.iter().map(|offer| format!("{:?} as {:?}", offer.format, offer.color_space)).collect();
        BackendError::Unavailable(format!(
            "this device cannot copy pictures into the window as they are: that takes one of {FORMATS:?} in the colour \
             space SRGB_NONLINEAR, and the window offers {offered:?}"
        ))
    })
}

/// Chooses the present mode: FIFO, which every window offers, if presenting may wait for the display. Otherwise the
/// first offered of MAILBOX, IMMEDIATE (which can tear) and FIFO.
///
/// On Wayland, presenting must not wait: with FIFO, `vkQueuePresentKHR` waits without a limit for the compositor's
/// frame callback, and a hidden window gets none. Compositors do not tear, and every Wayland driver offers MAILBOX.
fn present_mode(offered: &[vk::PresentModeKHR], may_wait: bool) -> vk::PresentModeKHR {
    let wanted: &[vk::PresentModeKHR] =
        if may_wait { &[] } else { &[vk::PresentModeKHR::MAILBOX, vk::PresentModeKHR::IMMEDIATE] };
    wanted.iter().copied().find(|mode| offered.contains(mode)).unwrap_or(vk::PresentModeKHR::FIFO)
}

/// Returns the size of the swapchain's images; `None` while the window has no pixels.
///
/// On some window systems the images determine the window's size. There, the size is `wanted`, the one last reported to
/// the program, clamped to the surface's limits.
pub(crate) fn extent(
    capabilities: &vk::SurfaceCapabilitiesKHR,
    wanted: vk::Extent2D,
) -> Option<vk::Extent2D> {
    const ANY: vk::Extent2D = vk::Extent2D { width: u32::MAX, height: u32::MAX };
    let (least, most) = (capabilities.min_image_extent, capabilities.max_image_extent);
    let extent = match capabilities.current_extent {
        _ if wanted.width == 0 || wanted.height == 0 => return None,
        ANY => vk::Extent2D {
            width: wanted.width.min(most.width).max(least.width),
            height: wanted.height.min(most.height).max(least.height),
        },
        current => current,
    };
    (extent.width > 0 && extent.height > 0).then_some(extent)
}

/// Returns the number of images to request: one more than the minimum, but at most the surface's maximum. The
/// additional image can be drawn without waiting.
pub(crate) fn image_count(capabilities: &vk::SurfaceCapabilitiesKHR) -> u32 {
    let most = if capabilities.max_image_count == 0 { u32::MAX } else { capabilities.max_image_count };
    (capabilities.min_image_count + 1).min(most)
}

pub(crate) fn composite_alpha(offered: vk::CompositeAlphaFlagsKHR) -> vk::CompositeAlphaFlagsKHR {
    use vk::CompositeAlphaFlagsKHR as Alpha;
    let known = [Alpha::OPAQUE, Alpha::INHERIT, Alpha::PRE_MULTIPLIED, Alpha::POST_MULTIPLIED];
    known.into_iter().find(|&alpha| offered.contains(alpha)).unwrap_or(Alpha::OPAQUE)
}

/// Chooses the transform: identity if supported, otherwise the current one. With identity, the window system rotates
/// the picture for a rotated display.
pub(crate) fn transform(capabilities: &vk::SurfaceCapabilitiesKHR) -> vk::SurfaceTransformFlagsKHR {
    if capabilities.supported_transforms.contains(vk::SurfaceTransformFlagsKHR::IDENTITY) {
        vk::SurfaceTransformFlagsKHR::IDENTITY
    } else {
        capabilities.current_transform
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offer(format: vk::Format) -> vk::SurfaceFormatKHR {
        vk::SurfaceFormatKHR { format, color_space: vk::ColorSpaceKHR::SRGB_NONLINEAR }
    }

    #[test]
    fn the_format_is_the_first_that_encodes_nothing_and_can_be_blitted_to() {
        use vk::Format as F;
        let all =
            [F::B8G8R8A8_SRGB, F::A2B10G10R10_UNORM_PACK32, F::R8G8B8A8_UNORM, F::B8G8R8A8_UNORM].map(offer);
        assert_eq!(format(&all, |_| true).unwrap(), offer(F::B8G8R8A8_UNORM));
        assert_eq!(format(&all, |format| format != F::B8G8R8A8_UNORM).unwrap(), offer(F::R8G8B8A8_UNORM));
        assert_eq!(format(&all[..2], |_| true).unwrap(), offer(F::A2B10G10R10_UNORM_PACK32));
        for alone in [F::A2R10G10B10_UNORM_PACK32, F::R5G6B5_UNORM_PACK16].map(offer) {
            assert_eq!(format(&[alone], |_| true).unwrap(), alone);
        }
    }

    #[test]
    fn a_window_that_only_encodes_or_has_another_colour_space_is_refused_with_what_it_has() {
        let wide = vk::SurfaceFormatKHR {
            format: vk::Format::B8G8R8A8_UNORM,
            color_space: vk::ColorSpaceKHR::DISPLAY_P3_NONLINEAR_EXT,
        };
        let said = format(&[offer(vk::Format::B8G8R8A8_SRGB), wide], |_| true).unwrap_err().to_string();
        assert!(said.contains("B8G8R8A8_SRGB as SRGB_NONLINEAR"), "{said}");
        assert!(said.contains("B8G8R8A8_UNORM as DISPLAY_P3_NONLINEAR"), "{said}");
        assert!(format(&[offer(vk::Format::B8G8R8A8_UNORM)], |_| false).is_err());
    }

    #[test]
    fn without_a_wait_images_do_not_queue_and_tearing_is_the_second_choice() {
        use vk::PresentModeKHR as Mode;
        let all = [Mode::IMMEDIATE, Mode::FIFO_RELAXED, Mode::FIFO, Mode::MAILBOX];
        assert_eq!(present_mode(&all, true), Mode::FIFO);
        assert_eq!(present_mode(&all, false), Mode::MAILBOX);
        assert_eq!(present_mode(&all[..3], false), Mode::IMMEDIATE);
        assert_eq!(present_mode(&[Mode::FIFO], false), Mode::FIFO);
    }

    fn size(width: u32, height: u32) -> vk::Extent2D {
        vk::Extent2D { width, height }
    }

    fn capabilities(current: vk::Extent2D) -> vk::SurfaceCapabilitiesKHR {
        vk::SurfaceCapabilitiesKHR {
            current_extent: current,
            min_image_extent: size(16, 16),
            max_image_extent: size(4096, 2048),
            ..Default::default()
        }
    }

    #[test]
    fn the_window_tells_its_size_or_leaves_it_to_the_program_within_limits() {
        let fixed = capabilities(size(640, 480));
        assert_eq!(extent(&fixed, size(800, 600)), Some(size(640, 480)));
        let free = capabilities(size(u32::MAX, u32::MAX));
        assert_eq!(extent(&free, size(800, 600)), Some(size(800, 600)));
        assert_eq!(extent(&free, size(1, 5000)), Some(size(16, 2048)));
    }

    #[test]
    fn a_window_without_pixels_has_no_extent() {
        assert_eq!(extent(&capabilities(size(0, 0)), size(800, 600)), None);
        assert_eq!(extent(&capabilities(size(640, 480)), size(0, 600)), None);
        assert_eq!(extent(&capabilities(size(u32::MAX, u32::MAX)), size(800, 0)), None);
        // A hidden window can have no extent at all.
        let none = vk::SurfaceCapabilitiesKHR {
            min_image_extent: size(0, 0),
            max_image_extent: size(0, 0),
            ..capabilities(size(u32::MAX, u32::MAX))
        };
        assert_eq!(extent(&none, size(800, 600)), None);
    }

    #[test]
    fn there_is_one_image_more_than_the_least_unless_that_is_the_most() {
        let count = |min_image_count, max_image_count| {
            image_count(&vk::SurfaceCapabilitiesKHR {
                min_image_count,
                max_image_count,
                ..Default::default()
            })
        };
        assert_eq!([count(2, 0), count(3, 8), count(2, 2)], [3, 4, 2]);
    }

    #[test]
    fn alpha_is_ignored_where_that_can_be_had() {
        use vk::CompositeAlphaFlagsKHR as Alpha;
        assert_eq!(composite_alpha(Alpha::INHERIT | Alpha::OPAQUE), Alpha::OPAQUE);
        assert_eq!(composite_alpha(Alpha::PRE_MULTIPLIED | Alpha::INHERIT), Alpha::INHERIT);
        assert_eq!(composite_alpha(Alpha::POST_MULTIPLIED), Alpha::POST_MULTIPLIED);
    }

    #[test]
    fn a_lost_surface_is_told_in_words() {
        let said = window("vkQueuePresentKHR")(vk::Result::ERROR_SURFACE_LOST_KHR).to_string();
        assert!(said.contains("vkQueuePresentKHR") && said.contains("surface is lost"), "{said}");
        let other = window("vkQueuePresentKHR")(vk::Result::ERROR_DEVICE_LOST);
        assert!(matches!(other, BackendError::DeviceLost(_)));
    }
}
