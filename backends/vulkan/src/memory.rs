//! Buffers and images, each with its memory, freed together.
//!
//! Memory is suballocated by `gpu-allocator`. An error names the resource and its size.

use crate::error::{api, mib};
use crate::gpu::{Gpu, Owned};
use crate::lower;
use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use splatgraph_api::BackendError;
use splatgraph_framework::plan::{Format, Usage};
use std::sync::{Arc, PoisonError};

pub(crate) struct Buffer {
    pub raw: vk::Buffer,
    pub bytes: u64,
    // An `Option` only so that `drop` can move it out.
    allocation: Option<Allocation>,
    gpu: Arc<Gpu>,
}

impl Buffer {
    /// A buffer in device memory.
    pub fn on_device(
        gpu: &Arc<Gpu>,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
    ) -> Result<Buffer, BackendError> {
        Self::new(gpu, name, bytes, usage, MemoryLocation::GpuOnly)
    }

    /// A mapped buffer that the host writes and the device reads.
    pub fn to_device(
        gpu: &Arc<Gpu>,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
    ) -> Result<Buffer, BackendError> {
        Self::new(gpu, name, bytes, usage, MemoryLocation::CpuToGpu)
    }

    /// A mapped buffer that the device copies into and the host reads.
    pub fn to_host(gpu: &Arc<Gpu>, name: &str, bytes: u64) -> Result<Buffer, BackendError> {
        Self::new(gpu, name, bytes, vk::BufferUsageFlags::TRANSFER_DST, MemoryLocation::GpuToCpu)
    }

    fn new(
        gpu: &Arc<Gpu>,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
        location: MemoryLocation,
    ) -> Result<Buffer, BackendError> {
        let info =
            vk::BufferCreateInfo::default().size(bytes).usage(usage).sharing_mode(vk::SharingMode::EXCLUSIVE);
        // SAFETY: `info` is complete, and its size is not 0.
        let raw = unsafe { gpu.device.create_buffer(&info, None) }.map_err(api("vkCreateBuffer"))?;
        let mut buffer = Buffer { raw, bytes, allocation: None, gpu: gpu.clone() };
        gpu.name(raw, name);
        // SAFETY: the buffer was just created.
        let requirements = unsafe { gpu.device.get_buffer_memory_requirements(raw) };
        let allocation = allocate(gpu, name, requirements, location, true)?;
        // SAFETY: the memory is the allocator's, of the size, alignment and type that the buffer requires.
        unsafe { gpu.device.bind_buffer_memory(raw, allocation.memory(), allocation.offset()) }
            .map_err(api("vkBindBufferMemory"))?;
        buffer.allocation = Some(allocation);
        Ok(buffer)
    }

    /// What the buffer's memory is seen as by the host; empty if it is not mapped.
    pub fn mapped(&self) -> &[u8] {
        let slice = self.allocation.as_ref().and_then(Allocation::mapped_slice).unwrap_or_default();
        &slice[..slice.len().min(self.bytes as usize)]
    }

    pub fn mapped_mut(&mut self) -> &mut [u8] {
        let bytes = self.bytes as usize;
        let slice = self.allocation.as_mut().and_then(Allocation::mapped_slice_mut).unwrap_or_default();
        let end = slice.len().min(bytes);
        &mut slice[..end]
    }

    pub fn allocated_bytes(&self) -> u64 {
        self.allocation.as_ref().map_or(0, Allocation::size)
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        // SAFETY: the only owner drops what the GPU no longer uses; the memory is given back after the buffer.
        unsafe { self.gpu.device.destroy_buffer(self.raw, None) };
        free(&self.gpu, self.allocation.take());
    }
}

pub(crate) struct Image {
    pub raw: vk::Image,
    /// The whole image, as storage image and as colour target.
    pub view: Owned<vk::ImageView>,
    pub format: Format,
    pub extent: vk::Extent2D,
    // Dropped after the view.
    memory: ImageMemory,
}

impl Image {
    pub fn new(
        gpu: &Arc<Gpu>,
        name: &str,
        format: Format,
        extent: vk::Extent2D,
        usage: Usage,
        blended: bool,
    ) -> Result<Image, BackendError> {
        let kind = lower::format(format);
        check_format(gpu, name, format, usage, blended)?;
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(kind)
            .extent(vk::Extent3D { width: extent.width, height: extent.height, depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(lower::image_usage(usage))
            .sharing_mode(vk::SharingMode::EXCLUSIVE)
            .initial_layout(vk::ImageLayout::UNDEFINED);
        // SAFETY: `info` is complete, and the format allows the usage.
        let raw = unsafe { gpu.device.create_image(&info, None) }.map_err(api("vkCreateImage"))?;
        let mut memory = ImageMemory { raw, allocation: None, gpu: gpu.clone() };
        gpu.name(raw, name);
        // SAFETY: the image was just created.
        let requirements = unsafe { gpu.device.get_image_memory_requirements(raw) };
        let allocation = allocate(gpu, name, requirements, MemoryLocation::GpuOnly, false)?;
        // SAFETY: the memory is the allocator's, of the size, alignment and type that the image requires.
        unsafe { gpu.device.bind_image_memory(raw, allocation.memory(), allocation.offset()) }
            .map_err(api("vkBindImageMemory"))?;
        memory.allocation = Some(allocation);

        let info = vk::ImageViewCreateInfo::default()
            .image(raw)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(kind)
            .subresource_range(WHOLE);
        // SAFETY: the image has memory, and the view is of its own format.
        let view = unsafe { gpu.device.create_image_view(&info, None) }.map_err(api("vkCreateImageView"))?;
        gpu.name(view, name);
        Ok(Image { raw, view: Owned::new(gpu, view), format, extent, memory })
    }

    pub fn bytes(&self) -> u64 {
        self.format.bytes_per_pixel() as u64 * self.extent.width as u64 * self.extent.height as u64
    }

    pub fn allocated_bytes(&self) -> u64 {
        self.memory.allocation.as_ref().map_or(0, Allocation::size)
    }
}

/// The image itself and its memory; apart from [`Image`], so that the view goes first.
struct ImageMemory {
    raw: vk::Image,
    allocation: Option<Allocation>,
    gpu: Arc<Gpu>,
}

impl Drop for ImageMemory {
    fn drop(&mut self) {
        // SAFETY: the only owner drops what the GPU no longer uses; the memory is given back after the image.
        unsafe { self.gpu.device.destroy_image(self.raw, None) };
        free(&self.gpu, self.allocation.take());
    }
}

/// The one mip level and layer that images have.
pub(crate) const WHOLE: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};

/// Not every device can blend or store every format.
fn check_format(
    gpu: &Gpu,
    name: &str,
    format: Format,
    usage: Usage,
    blended: bool,
) -> Result<(), BackendError> {
    // SAFETY: a query of a live instance's device.
    let properties = unsafe {
        gpu.instance.raw.get_physical_device_format_properties(gpu.physical, lower::format(format))
    };
    let has = |feature| properties.optimal_tiling_features.contains(feature);
    for (wanted, feature, what) in [
        (usage.contains(Usage::STORAGE), vk::FormatFeatureFlags::STORAGE_IMAGE, "store to it"),
        (usage.contains(Usage::COLOR_TARGET), vk::FormatFeatureFlags::COLOR_ATTACHMENT, "draw into it"),
        (blended, vk::FormatFeatureFlags::COLOR_ATTACHMENT_BLEND, "blend into it"),
    ] {
        if wanted && !has(feature) {
            return Err(BackendError::Limit(format!(
                "image `{name}` has the format {format:?}, and this device cannot {what}"
            )));
        }
    }
    Ok(())
}

fn allocate(
    gpu: &Gpu,
    name: &str,
    requirements: vk::MemoryRequirements,
    location: MemoryLocation,
    linear: bool,
) -> Result<Allocation, BackendError> {
    let describe = AllocationCreateDesc {
        name,
        requirements,
        location,
        linear,
        allocation_scheme: AllocationScheme::GpuAllocatorManaged,
    };
    let mut allocator = gpu.allocator.lock().unwrap_or_else(PoisonError::into_inner);
    let allocator = allocator
        .as_mut()
        .ok_or(BackendError::Api { call: "allocate", answer: "the device is closed".to_string() })?;
    allocator.allocate(&describe).map_err(|error| {
        BackendError::OutOfMemory(format!("no memory for `{name}` ({}): {error}", mib(requirements.size)))
    })
}

fn free(gpu: &Gpu, allocation: Option<Allocation>) {
    let Some(allocation) = allocation else { return };
    let mut allocator = gpu.allocator.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(allocator) = allocator.as_mut() {
        // It fails only for an allocation of another allocator.
        let _ = allocator.free(allocation);
    }
}
