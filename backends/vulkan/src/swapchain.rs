//! Creates swapchains, and blits frames into a window's images.
//!
//! The blit has its own command buffer, submitted right after the frame's. Output and image may differ in size and
//! format. Colours are already display-encoded and are not converted.
//!
//! The semaphore for an acquired image belongs to the frame's slot: a slot is reused only when its frame, blit
//! included, has completed. The semaphore for a completed blit belongs to the *image*: presentation waits for the
//! semaphore, which may be reused only once the image is acquired again.

use crate::encoder::pipeline_barrier;
use crate::gpu::{Owned, VulkanGpu};
use crate::instance::searching_devices;
use crate::lower::{self, LAYER};
use crate::queue::{self, Blit};
use crate::surface::{self, Surface};
use crate::sync::Barriers;
use crate::sync::commands::{self, Scope, image_barrier, memory_barrier};
use ash::{khr, vk};
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT};
use splatgraph_framework::ir::Stages;
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{Acquired, Image, Presented};
use std::sync::Arc;

/// Maximum wait for an image, in nanoseconds: a hidden window may return none.
const PATIENCE: u64 = 2_000_000_000;

/// A window's swapchain, with the semaphores and command buffers of its blits. The device must be idle when it is
/// dropped.
pub struct Swapchain {
    raw: vk::SwapchainKHR,
    // Outlives the swapchain.
    _surface: Arc<Surface>,
    functions: khr::swapchain::Device,
    extent: vk::Extent2D,
    images: Vec<vk::Image>,
    /// A semaphore per slot, signalled when the acquired image may be written.
    acquired: [Owned<vk::Semaphore>; FRAMES_IN_FLIGHT],
    /// A semaphore per image, signalled when the blit into the image completes.
    finished: Vec<Owned<vk::Semaphore>>,
    blits: [(Owned<vk::CommandPool>, vk::CommandBuffer); FRAMES_IN_FLIGHT],
    gpu: Arc<VulkanGpu>,
}

fn window_surface(gpu: &VulkanGpu) -> Result<Arc<Surface>, BackendError> {
    let none = || {
        BackendError::Unavailable("this device was not opened in a window, or the window is gone".to_string())
    };
    gpu.instance.surface().ok_or_else(none)
}

pub(crate) fn window_size(
    gpu: &VulkanGpu,
    (width, height): (u32, u32),
) -> Result<Option<(u32, u32)>, BackendError> {
    let capabilities = window_surface(gpu)?.capabilities(gpu.physical)?;
    let extent = surface::extent(&capabilities, vk::Extent2D { width, height });
    Ok(extent.map(|extent| (extent.width, extent.height)))
}

impl Swapchain {
    pub(crate) fn blit(&self, slot: usize, image: u32) -> Blit {
        Blit {
            commands: self.blits[slot].1,
            acquired: *self.acquired[slot],
            finished: *self.finished[image as usize],
        }
    }
}

impl splatgraph_runtime::Swapchain<VulkanGpu> for Swapchain {
    fn new(
        gpu: &Arc<VulkanGpu>,
        (width, height): (u32, u32),
        vsync: bool,
        former: Option<&Swapchain>,
    ) -> Result<Swapchain, BackendError> {
        let surface = window_surface(gpu)?;
        let capabilities = surface.capabilities(gpu.physical)?;
        if !capabilities.supported_usage_flags.contains(vk::ImageUsageFlags::TRANSFER_DST) {
            return Err(BackendError::Unavailable(
                "this window's images cannot be copied to, so no picture can be shown in it".to_string(),
            ));
        }
        let functions = searching_devices(|| khr::swapchain::Device::new(&gpu.instance.raw, &gpu.device));
        let can_blit = |format| gpu.format_features(format).contains(vk::FormatFeatureFlags::BLIT_DST);
        let format = surface::format(&surface.formats(gpu.physical)?, can_blit)?;
        let extent = vk::Extent2D { width, height };
        let info = vk::SwapchainCreateInfoKHR::default()
            .surface(surface.raw)
            .min_image_count(surface::image_count(&capabilities))
            .image_format(format.format)
            .image_color_space(format.color_space)
            .image_extent(extent)
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::TRANSFER_DST)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(surface::transform(&capabilities))
            .composite_alpha(surface::composite_alpha(capabilities.supported_composite_alpha))
            .present_mode(surface.present_mode(gpu.physical, vsync)?)
            .clipped(true)
            .old_swapchain(former.map_or(vk::SwapchainKHR::null(), |former| former.raw));
        let acquired = [queue::semaphore(gpu)?, queue::semaphore(gpu)?];
        let blits = [queue::command_pool(gpu)?, queue::command_pool(gpu)?];
        for (_, commands) in &blits {
            gpu.name(*commands, "blit to the window");
        }
        // SAFETY: `info` uses what the surface offers, and the previous swapchain belongs to the same surface.
        let raw = searching_devices(|| unsafe { functions.create_swapchain(&info, None) });
        let raw = raw.map_err(surface::window("vkCreateSwapchainKHR"))?;
        let mut swapchain = Swapchain {
            raw,
            _surface: surface,
            functions,
            extent,
            images: Vec::new(),
            acquired,
            finished: Vec::new(),
            blits,
            gpu: gpu.clone(),
        };
        // SAFETY: the swapchain was just created.
        let images = unsafe { swapchain.functions.get_swapchain_images(raw) };
        swapchain.images = images.map_err(surface::window("vkGetSwapchainImagesKHR"))?;
        for &image in &swapchain.images {
            gpu.name(image, "window");
            swapchain.finished.push(queue::semaphore(gpu)?);
        }
        Ok(swapchain)
    }

    fn acquire(&mut self, slot: usize) -> Result<Acquired, BackendError> {
        // SAFETY: the slot's former frame, which waited for the semaphore, has completed, and every image acquired
        // before was presented.
        let answer = unsafe {
            self.functions.acquire_next_image(self.raw, PATIENCE, *self.acquired[slot], vk::Fence::null())
        };
        match answer {
            Ok((index, suboptimal)) => Ok(Acquired::Image { index, suboptimal }),
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => Ok(Acquired::OutOfDate),
            Err(vk::Result::TIMEOUT | vk::Result::NOT_READY) => Ok(Acquired::NotReady),
            Err(answer) => Err(surface::window("vkAcquireNextImageKHR")(answer)),
        }
    }

    /// Records the blit. The export has left the output in the transfer-source layout.
    fn record_blit(
        &mut self,
        image: u32,
        slot: usize,
        output: &Image<VulkanGpu>,
        plan: &Plan,
        barriers: &Barriers,
    ) -> Result<(), BackendError> {
        let gpu = &*self.gpu;
        let (pool, commands) = &self.blits[slot];
        let (image, commands) = (self.images[image as usize], *commands);
        let size = vk::Extent2D { width: output.size.0, height: output.size.1 };
        let features = gpu.format_features(lower::format(output.format));
        let filter = filter(features, size == self.extent);
        queue::begin(gpu, **pool, commands)?;
        gpu.begin_label(commands, format_args!("blit to the window"));
        let region = [vk::ImageBlit::default()
            .src_subresource(LAYER)
            .src_offsets(corners(size))
            .dst_subresource(LAYER)
            .dst_offsets(corners(self.extent))];
        barrier(gpu, commands, before(image));
        // SAFETY: the command buffer is being recorded outside of rendering. The images are alive and allow the copies;
        // the device can blit between their formats with this filter.
        unsafe {
            gpu.device.cmd_blit_image(
                commands,
                *output.raw.raw,
                vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
                image,
                vk::ImageLayout::TRANSFER_DST_OPTIMAL,
                &region,
                filter,
            );
        }
        barrier(gpu, commands, after(image, barriers.waiting_for_copies(plan)));
        gpu.end_label(commands);
        queue::end(gpu, commands)
    }

    fn present(&mut self, image: u32) -> Result<Presented, BackendError> {
        let finished = *self.finished[image as usize];
        match queue::present(&self.gpu, &self.functions, self.raw, image, finished) {
            Ok(false) => Ok(Presented::Shown),
            Ok(true) => Ok(Presented::Suboptimal),
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => Ok(Presented::OutOfDate),
            Err(answer) => Err(surface::window("vkQueuePresentKHR")(answer)),
        }
    }
}

impl Drop for Swapchain {
    fn drop(&mut self) {
        // SAFETY: the device is idle, and the instance keeps the surface alive.
        unsafe { self.functions.destroy_swapchain(self.raw, None) };
    }
}

fn filter(features: vk::FormatFeatureFlags, same_size: bool) -> vk::Filter {
    if same_size || !features.contains(vk::FormatFeatureFlags::SAMPLED_IMAGE_FILTER_LINEAR) {
        vk::Filter::NEAREST
    } else {
        vk::Filter::LINEAR
    }
}

const fn scope(stages: vk::PipelineStageFlags2, accesses: vk::AccessFlags2) -> Scope {
    Scope { stages, accesses }
}

const COLOR: vk::ImageAspectFlags = vk::ImageAspectFlags::COLOR;
const BLIT: Scope = scope(vk::PipelineStageFlags2::BLIT, vk::AccessFlags2::NONE);
const BLIT_WRITES: Scope = scope(vk::PipelineStageFlags2::BLIT, vk::AccessFlags2::TRANSFER_WRITE);

/// The barriers on one side of the blit: on memory for the plan's output, and on the window's image.
type BlitBarriers = (vk::MemoryBarrier2<'static>, vk::ImageMemoryBarrier2<'static>);

/// Returns the barriers before the blit, which chain with the plan's barriers before the export's copies.
///
/// The window's old contents are discarded, and the wait for the acquired image is at the blit's stage.
fn before(image: vk::Image) -> BlitBarriers {
    let layouts = [vk::ImageLayout::UNDEFINED, vk::ImageLayout::TRANSFER_DST_OPTIMAL];
    let copies = scope(vk::PipelineStageFlags2::COPY, vk::AccessFlags2::NONE);
    let reads = scope(vk::PipelineStageFlags2::BLIT, vk::AccessFlags2::TRANSFER_READ);
    (memory_barrier(copies, reads), image_barrier((image, COLOR), layouts, BLIT, BLIT_WRITES))
}

/// Returns the barriers after the blit, for stages that wait for the export's copies.
///
/// A semaphore hands over the window's image, so no barrier is needed on the presentation side.
fn after(image: vk::Image, waiting: Stages) -> BlitBarriers {
    let layouts = [vk::ImageLayout::TRANSFER_DST_OPTIMAL, vk::ImageLayout::PRESENT_SRC_KHR];
    let waiting = scope(commands::stages(waiting), vk::AccessFlags2::NONE);
    (memory_barrier(BLIT, waiting), image_barrier((image, COLOR), layouts, BLIT_WRITES, BLIT))
}

fn barrier(gpu: &VulkanGpu, commands: vk::CommandBuffer, (memory, image): BlitBarriers) {
    let (memory, images) = ([memory], [image]);
    let info = vk::DependencyInfo::default().memory_barriers(&memory).image_memory_barriers(&images);
    pipeline_barrier(gpu, commands, &info);
}

fn corners(extent: vk::Extent2D) -> [vk::Offset3D; 2] {
    // Image sizes are far below the range of `i32`.
    [vk::Offset3D::default(), vk::Offset3D { x: extent.width as i32, y: extent.height as i32, z: 1 }]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_blit_takes_its_place_between_the_exports_copies_and_whatever_waits_for_them() {
        let none = vk::Image::null();
        let (output, _) = before(none);
        let stages = (vk::PipelineStageFlags2::COPY, BLIT.stages);
        assert_eq!((output.src_stage_mask, output.dst_stage_mask), stages);
        assert_eq!(output.dst_access_mask, vk::AccessFlags2::TRANSFER_READ);
        let (output, _) = after(none, Stages::COPY | Stages::COMPUTE);
        let waiting = vk::PipelineStageFlags2::COPY | vk::PipelineStageFlags2::COMPUTE_SHADER;
        assert_eq!((output.src_stage_mask, output.dst_stage_mask), (BLIT.stages, waiting));
        assert_eq!(output.src_access_mask, BLIT.accesses);
    }

    #[test]
    fn pixels_are_interpolated_only_between_sizes_and_where_the_device_can() {
        let linear = vk::FormatFeatureFlags::SAMPLED_IMAGE_FILTER_LINEAR;
        assert_eq!(filter(linear, true), vk::Filter::NEAREST);
        assert_eq!(filter(linear, false), vk::Filter::LINEAR);
        assert_eq!(filter(vk::FormatFeatureFlags::empty(), false), vk::Filter::NEAREST);
    }
}
