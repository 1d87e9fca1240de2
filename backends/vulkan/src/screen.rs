//! The screen: frames that are shown in a window.
//!
//! A window's pixels are the images of a swapchain, which go back and forth between the window system and us. To show a frame,
//! its output is blitted into an image that was acquired, and the image is presented. The blit has a command buffer of its own
//! that is submitted right behind the frame's, so that the frame itself never waits for the window, and its timestamps do not
//! count such a wait. Output and image may differ in size and format; colours are display-encoded already, and nothing
//! converts them.
//!
//! A swapchain fits its window until the window is resized, or is to be paced in another way. Then it is *stale*, and the next
//! frame to be shown makes a new one. A window without pixels has none, and nothing is shown in it.
//!
//! Semaphores, and why they belong where they do: the one that says an image was acquired belongs to the frame's slot, since a
//! slot is used again only when its frame, blit included, is done. The one that says a blit is done belongs to the *image*: it
//! is waited for by the window system, of which all we know is that it is through with it when it gives the image back.

use crate::error::api;
use crate::gpu::{Gpu, Owned};
use crate::limits::invalid;
use crate::lower;
use crate::memory::{Image, WHOLE};
use crate::queue::{self, Blit};
use crate::surface::{self, Surface};
use ash::{khr, vk};
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT};
use splatgraph_framework::ir::Format;
use std::sync::Arc;

/// How long to wait for an image, in nanoseconds. Some window systems give none while the window is hidden, and do not say that
/// it is: the program must go on.
const PATIENCE: u64 = 2_000_000_000;

/// A window's side of a device.
pub(crate) struct Screen {
    // Dropped first: its window system may be done with it only when the device is idle.
    swapchain: Option<Swapchain>,
    /// A command buffer for each frame in flight.
    blits: [(Owned<vk::CommandPool>, vk::CommandBuffer); FRAMES_IN_FLIGHT],
    functions: khr::swapchain::Device,
    /// The window's size in pixels, as far as we were told.
    told: vk::Extent2D,
    vsync: bool,
    /// The swapchain, if there is one, must be replaced before the next frame is shown.
    stale: bool,
    /// An image was acquired and not presented yet.
    acquired: bool,
    gpu: Arc<Gpu>,
}

/// An image that was acquired, with the blit into it recorded.
#[derive(Clone, Copy)]
pub(crate) struct Presentation {
    pub blit: Blit,
    image: u32,
}

impl Screen {
    /// The device was made for its instance's window, which has `size` pixels (width, height).
    pub fn new(gpu: &Arc<Gpu>, (width, height): (u32, u32)) -> Result<Screen, BackendError> {
        let mut screen = Screen {
            swapchain: None,
            blits: [queue::command_pool(gpu)?, queue::command_pool(gpu)?],
            functions: khr::swapchain::Device::new(&gpu.instance.raw, &gpu.device),
            told: vk::Extent2D { width, height },
            vsync: true,
            stale: true,
            acquired: false,
            gpu: gpu.clone(),
        };
        for (_, commands) in &screen.blits {
            gpu.name(*commands, "blit to the window");
        }
        // So that a window that cannot be drawn in is refused now.
        screen.renew()?;
        Ok(screen)
    }

    /// See [`splatgraph_api::Windowed::resize_window`].
    pub fn resize(&mut self, width: u32, height: u32) {
        let told = vk::Extent2D { width, height };
        self.stale |= told != self.told;
        self.told = told;
    }

    /// See [`splatgraph_api::Windowed::set_vsync`].
    pub fn set_vsync(&mut self, vsync: bool) {
        self.stale |= vsync != self.vsync;
        self.vsync = vsync;
    }

    /// Acquires an image of the window and records the blit of `output` into it, to be submitted behind the frame in `slot` with
    /// [`queue::submit_and_blit`] and then [`Screen::present`]ed. None if nothing can be shown now. The frame that last used this
    /// slot must be done.
    ///
    /// Blocks while all images are with the window system: with vsync, until the display's next refresh.
    pub fn prepare(&mut self, output: &Image, slot: usize) -> Result<Option<Presentation>, BackendError> {
        let features = format_features(&self.gpu, lower::format(output.format));
        check_output(output.format, features)?;
        let Some(image) = self.acquire(slot)? else { return Ok(None) };
        let Some(swapchain) = &self.swapchain else { return Ok(None) };
        let (pool, commands) = &self.blits[slot];
        let filter = filter(features, output.extent == swapchain.extent);
        record(&self.gpu, **pool, *commands, output, swapchain, image, filter)?;
        let blit = Blit {
            commands: *commands,
            acquired: *swapchain.acquired[slot],
            finished: *swapchain.finished[image as usize],
        };
        Ok(Some(Presentation { blit, image }))
    }

    /// Shows an image whose blit was submitted.
    pub fn present(&mut self, presentation: Presentation) -> Result<(), BackendError> {
        let Some(swapchain) = &self.swapchain else { return Ok(()) };
        self.acquired = false;
        match queue::present(
            &self.gpu,
            &self.functions,
            swapchain.raw,
            presentation.image,
            presentation.blit.finished,
        ) {
            Ok(suboptimal) => self.stale |= suboptimal,
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => self.stale = true,
            Err(answer) => return Err(surface::window("vkQueuePresentKHR")(answer)),
        }
        Ok(())
    }

    /// The index of an image to draw in; none if the window shows nothing now.
    fn acquire(&mut self, slot: usize) -> Result<Option<u32>, BackendError> {
        // A submission failed, and nobody will wait for the slot's semaphore: only a new swapchain has fresh ones.
        self.stale |= self.acquired;
        // The window may change its size between the two calls, once; if it goes on, the next frame will fit.
        for _ in 0..2 {
            if self.stale {
                self.renew()?;
            }
            let Some(swapchain) = self.swapchain.as_ref().filter(|_| !self.stale) else { return Ok(None) };
            match swapchain.acquire(slot) {
                Ok((image, suboptimal)) => {
                    self.acquired = true;
                    self.stale |= suboptimal;
                    return Ok(Some(image));
                }
                Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => self.stale = true,
                Err(vk::Result::TIMEOUT | vk::Result::NOT_READY) => return Ok(None),
                Err(answer) => return Err(surface::window("vkAcquireNextImageKHR")(answer)),
            }
        }
        Ok(None)
    }

    /// Replaces the swapchain by one that fits the window, unless the window has no pixels.
    fn renew(&mut self) -> Result<(), BackendError> {
        let Some(surface) = &self.gpu.instance.surface else {
            return invalid("this device was not opened in a window".to_string());
        };
        let capabilities = surface.capabilities(self.gpu.physical)?;
        let Some(extent) = surface::extent(&capabilities, self.told) else { return Ok(()) };
        // Nothing may use what is destroyed. This waits for more than it must, but happens only when a window changes.
        self.gpu.wait_idle();
        // It is of no use after this, also if there will be no other.
        let former = self.swapchain.take();
        let description = Description { surface, capabilities, extent, vsync: self.vsync };
        let swapchain = Swapchain::new(&self.gpu, &self.functions, &description, former.as_ref())?;
        self.swapchain = Some(swapchain);
        self.stale = false;
        self.acquired = false;
        Ok(())
    }
}

/// What a swapchain is to be like.
struct Description<'a> {
    surface: &'a Surface,
    capabilities: vk::SurfaceCapabilitiesKHR,
    extent: vk::Extent2D,
    vsync: bool,
}

/// The window's images, and what goes with them. The device must be idle when it is dropped.
struct Swapchain {
    raw: vk::SwapchainKHR,
    functions: khr::swapchain::Device,
    extent: vk::Extent2D,
    images: Vec<vk::Image>,
    /// For each slot: the image that its frame is shown in may be written.
    acquired: [Owned<vk::Semaphore>; FRAMES_IN_FLIGHT],
    /// For each image: the blit into it is done.
    finished: Vec<Owned<vk::Semaphore>>,
}

impl Swapchain {
    /// `former` is the window's swapchain until now.
    fn new(
        gpu: &Arc<Gpu>,
        functions: &khr::swapchain::Device,
        description: &Description,
        former: Option<&Swapchain>,
    ) -> Result<Swapchain, BackendError> {
        let Description { surface, capabilities, extent, vsync } = description;
        if !capabilities.supported_usage_flags.contains(vk::ImageUsageFlags::TRANSFER_DST) {
            return Err(BackendError::Unavailable(
                "this window's images cannot be copied to, so that no picture can be shown in it".to_string(),
            ));
        }
        let can_blit = |format| format_features(gpu, format).contains(vk::FormatFeatureFlags::BLIT_DST);
        let format = surface::format(&surface.formats(gpu.physical)?, can_blit)?;
        let info = vk::SwapchainCreateInfoKHR::default()
            .surface(surface.raw)
            .min_image_count(surface::image_count(capabilities))
            .image_format(format.format)
            .image_color_space(format.color_space)
            .image_extent(*extent)
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::TRANSFER_DST)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(surface::transform(capabilities))
            .composite_alpha(surface::composite_alpha(capabilities.supported_composite_alpha))
            .present_mode(surface::present_mode(&surface.present_modes(gpu.physical)?, *vsync))
            .clipped(true)
            .old_swapchain(former.map_or(vk::SwapchainKHR::null(), |former| former.raw));
        let acquired = [queue::semaphore(gpu)?, queue::semaphore(gpu)?];
        // SAFETY: `info` has what the surface offers, and the former swapchain was made of the same surface.
        let raw = unsafe { functions.create_swapchain(&info, None) };
        let raw = raw.map_err(surface::window("vkCreateSwapchainKHR"))?;
        let mut swapchain = Swapchain {
            raw,
            functions: functions.clone(),
            extent: *extent,
            images: Vec::new(),
            acquired,
            finished: Vec::new(),
        };
        // SAFETY: the swapchain was just created.
        let images = unsafe { functions.get_swapchain_images(raw) };
        swapchain.images = images.map_err(surface::window("vkGetSwapchainImagesKHR"))?;
        for &image in &swapchain.images {
            gpu.name(image, "window");
            swapchain.finished.push(queue::semaphore(gpu)?);
        }
        Ok(swapchain)
    }

    /// An image, and whether the swapchain does not fit the window as well as another would.
    fn acquire(&self, slot: usize) -> Result<(u32, bool), vk::Result> {
        // SAFETY: the slot's former frame is done, which waited for the semaphore; all images that were acquired before were
        // presented.
        unsafe {
            self.functions.acquire_next_image(self.raw, PATIENCE, *self.acquired[slot], vk::Fence::null())
        }
    }
}

impl Drop for Swapchain {
    fn drop(&mut self) {
        // SAFETY: the device is idle, and the surface is alive, which the instance keeps.
        unsafe { self.functions.destroy_swapchain(self.raw, None) };
    }
}

/// What the device can do with images of this format.
fn format_features(gpu: &Gpu, format: vk::Format) -> vk::FormatFeatureFlags {
    // SAFETY: a query of a live instance's device.
    let properties = unsafe { gpu.instance.raw.get_physical_device_format_properties(gpu.physical, format) };
    properties.optimal_tiling_features
}

/// Not every output is a picture that the device can show.
fn check_output(format: Format, features: vk::FormatFeatureFlags) -> Result<(), BackendError> {
    if format == Format::R32Uint {
        return invalid(format!(
            "the plan's output has the format {}, whose whole numbers are no colours: it cannot be shown in a window",
            format.name()
        ));
    }
    if !features.contains(vk::FormatFeatureFlags::BLIT_SRC) {
        return Err(BackendError::Limit(format!(
            "the plan's output has the format {}, which this device cannot blit to a window",
            format.name()
        )));
    }
    Ok(())
}

/// Pixels are copied one to one, or interpolated if the device can.
fn filter(features: vk::FormatFeatureFlags, same_size: bool) -> vk::Filter {
    if same_size || !features.contains(vk::FormatFeatureFlags::SAMPLED_IMAGE_FILTER_LINEAR) {
        vk::Filter::NEAREST
    } else {
        vk::Filter::LINEAR
    }
}

/// Records the blit of `output`, which its frame's export leaves as a transfer's source.
fn record(
    gpu: &Gpu,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    output: &Image,
    swapchain: &Swapchain,
    image: u32,
    filter: vk::Filter,
) -> Result<(), BackendError> {
    let device = &gpu.device;
    let image = swapchain.images[image as usize];
    let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
    // SAFETY: the frame that last used this slot is done, its blit included.
    unsafe {
        device
            .reset_command_pool(pool, vk::CommandPoolResetFlags::empty())
            .map_err(api("vkResetCommandPool"))?;
        device.begin_command_buffer(commands, &begin).map_err(api("vkBeginCommandBuffer"))?;
    }
    gpu.begin_label(commands, "blit to the window");
    let region = [vk::ImageBlit::default()
        .src_subresource(COLOR)
        .src_offsets(corners(output.extent))
        .dst_subresource(COLOR)
        .dst_offsets(corners(swapchain.extent))];
    // SAFETY: the command buffer is being recorded outside of rendering. The images are alive and were made to be copied from
    // and to; the device can blit between their formats, with this filter.
    unsafe {
        barrier(device, commands, BEFORE, image);
        device.cmd_blit_image(
            commands,
            *output.raw,
            vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
            image,
            vk::ImageLayout::TRANSFER_DST_OPTIMAL,
            &region,
            filter,
        );
        barrier(device, commands, AFTER, image);
    }
    gpu.end_label(commands);
    // SAFETY: the command buffer is being recorded.
    unsafe { device.end_command_buffer(commands) }.map_err(api("vkEndCommandBuffer"))
}

/// A barrier around the blit: one on memory for the plan's output, and one on the window's image.
#[derive(Clone, Copy)]
struct Around {
    output: [(vk::PipelineStageFlags2, vk::AccessFlags2); 2],
    window: [(vk::PipelineStageFlags2, vk::AccessFlags2, vk::ImageLayout); 2],
}

/// The plan made its output ready for the export's copies, and no more; the blit goes on from there. The window's image has no
/// contents that matter, and was acquired for the stage of the blit.
const BEFORE: Around = Around {
    output: [
        (vk::PipelineStageFlags2::COPY, vk::AccessFlags2::NONE),
        (vk::PipelineStageFlags2::BLIT, vk::AccessFlags2::TRANSFER_READ),
    ],
    window: [
        (vk::PipelineStageFlags2::BLIT, vk::AccessFlags2::NONE, vk::ImageLayout::UNDEFINED),
        (
            vk::PipelineStageFlags2::BLIT,
            vk::AccessFlags2::TRANSFER_WRITE,
            vk::ImageLayout::TRANSFER_DST_OPTIMAL,
        ),
    ],
};

/// What the next frame does to the output once the export's copies are done, it may do once the blit is. The window's image is
/// handed over by a semaphore, which needs no barrier's second half.
const AFTER: Around = Around {
    output: [
        (vk::PipelineStageFlags2::BLIT, vk::AccessFlags2::NONE),
        (vk::PipelineStageFlags2::COPY, vk::AccessFlags2::NONE),
    ],
    window: [
        (
            vk::PipelineStageFlags2::BLIT,
            vk::AccessFlags2::TRANSFER_WRITE,
            vk::ImageLayout::TRANSFER_DST_OPTIMAL,
        ),
        (vk::PipelineStageFlags2::BLIT, vk::AccessFlags2::NONE, vk::ImageLayout::PRESENT_SRC_KHR),
    ],
};

/// # Safety
/// The command buffer is being recorded outside of rendering, and the window's image is alive.
unsafe fn barrier(device: &ash::Device, commands: vk::CommandBuffer, around: Around, window: vk::Image) {
    let [(from, before), (to, after)] = around.output;
    let memory = [vk::MemoryBarrier2::default()
        .src_stage_mask(from)
        .src_access_mask(before)
        .dst_stage_mask(to)
        .dst_access_mask(after)];
    let [(from, before, old), (to, after, new)] = around.window;
    let images = [vk::ImageMemoryBarrier2::default()
        .src_stage_mask(from)
        .src_access_mask(before)
        .dst_stage_mask(to)
        .dst_access_mask(after)
        .old_layout(old)
        .new_layout(new)
        .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .image(window)
        .subresource_range(WHOLE)];
    let info = vk::DependencyInfo::default().memory_barriers(&memory).image_memory_barriers(&images);
    // SAFETY: promised by the caller.
    unsafe { device.cmd_pipeline_barrier2(commands, &info) };
}

const COLOR: vk::ImageSubresourceLayers = vk::ImageSubresourceLayers {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    mip_level: 0,
    base_array_layer: 0,
    layer_count: 1,
};

/// An image of this size, whole.
fn corners(extent: vk::Extent2D) -> [vk::Offset3D; 2] {
    // Sizes of images are far below the range of `i32`.
    [vk::Offset3D::default(), vk::Offset3D { x: extent.width as i32, y: extent.height as i32, z: 1 }]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_output_that_is_no_picture_or_cannot_be_blitted_is_refused_by_its_format() {
        let blit = vk::FormatFeatureFlags::BLIT_SRC;
        assert!(check_output(Format::Rgba16Float, blit).is_ok());
        let numbers = check_output(Format::R32Uint, blit).unwrap_err().to_string();
        assert!(numbers.contains("r32ui") && numbers.contains("no colours"), "{numbers}");
        let unable = check_output(Format::Rgba32Float, vk::FormatFeatureFlags::empty());
        assert!(unable.unwrap_err().to_string().contains("rgba32f, which this device cannot blit"));
    }

    #[test]
    fn the_blit_takes_its_place_between_the_exports_copies_and_whatever_waits_for_them() {
        // The second half is beyond what the validation layer compares between submissions.
        let [(after, _), (blit, access)] = BEFORE.output;
        assert_eq!((after, blit), (vk::PipelineStageFlags2::COPY, vk::PipelineStageFlags2::BLIT));
        assert_eq!(access, vk::AccessFlags2::TRANSFER_READ);
        let [(blit, _), (before, _)] = AFTER.output;
        assert_eq!((blit, before), (vk::PipelineStageFlags2::BLIT, vk::PipelineStageFlags2::COPY));
    }

    #[test]
    fn pixels_are_interpolated_only_between_sizes_and_where_the_device_can() {
        let linear = vk::FormatFeatureFlags::SAMPLED_IMAGE_FILTER_LINEAR;
        assert_eq!(filter(linear, true), vk::Filter::NEAREST);
        assert_eq!(filter(linear, false), vk::Filter::LINEAR);
        assert_eq!(filter(vk::FormatFeatureFlags::empty(), false), vk::Filter::NEAREST);
    }
}
