//! Allocates buffers, images and their memory.
//!
//! `gpu-allocator` suballocates memory, which is freed on drop. Creation has two steps, because several objects may
//! share memory: create the object, which gives its memory requirements, then bind it to memory.

use crate::error::api;
use crate::gpu::{Owned, VulkanGpu};
use crate::lower;
use ash::vk::{self, Handle};
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use splatgraph_api::BackendError;
use splatgraph_runtime::{BufferDesc, ImageDesc, Location, MemoryKind, Requirements, lock};
use std::sync::Arc;

/// A device memory allocation.
pub struct Memory {
    // An `Option` so that `drop` can move it out.
    allocation: Option<Allocation>,
    gpu: Arc<VulkanGpu>,
}

impl Memory {
    /// Returns the memory handle, and the offset at which to bind objects.
    fn handle_and_offset(&self) -> (vk::DeviceMemory, u64) {
        // SAFETY: the handle is used only to bind objects, and their owner keeps this allocation alive.
        self.allocation.as_ref().map_or_else(Default::default, |a| (unsafe { a.memory() }, a.offset()))
    }
}

impl splatgraph_runtime::Memory<VulkanGpu> for Memory {
    fn allocate(
        gpu: &Arc<VulkanGpu>,
        name: &str,
        requirements: &Requirements,
        location: Location,
    ) -> Result<Memory, BackendError> {
        let describe = AllocationCreateDesc {
            name,
            requirements: vk::MemoryRequirements {
                size: requirements.size,
                alignment: requirements.alignment,
                memory_type_bits: requirements.types,
            },
            location: match location {
                Location::Device => MemoryLocation::GpuOnly,
                Location::Upload => MemoryLocation::CpuToGpu,
                // Not `CpuToGpu`, which may be device memory: slow for the host to write.
                Location::Staging | Location::Readback | Location::Host => MemoryLocation::GpuToCpu,
            },
            linear: matches!(requirements.kind, MemoryKind::Linear | MemoryKind::DedicatedBuffer(_)),
            allocation_scheme: match requirements.kind {
                MemoryKind::Linear | MemoryKind::Optimal => AllocationScheme::GpuAllocatorManaged,
                MemoryKind::DedicatedBuffer(buffer) => {
                    AllocationScheme::DedicatedBuffer(vk::Buffer::from_raw(buffer))
                }
                MemoryKind::DedicatedImage(image) => {
                    AllocationScheme::DedicatedImage(vk::Image::from_raw(image))
                }
            },
        };
        let out_of_memory = |reason: String| BackendError::OutOfMemory {
            name: name.to_string(),
            bytes: requirements.size,
            reason,
        };
        let mut allocator = lock(&gpu.allocator);
        let allocator =
            allocator.as_mut().ok_or_else(|| out_of_memory("the device is closed".to_string()))?;
        let allocation = allocator.allocate(&describe).map_err(|error| out_of_memory(error.to_string()))?;
        Ok(Memory { allocation: Some(allocation), gpu: gpu.clone() })
    }

    fn bytes(&self) -> u64 {
        self.allocation.as_ref().map_or(0, Allocation::size)
    }

    fn mapped(&self) -> &[u8] {
        self.allocation.as_ref().and_then(Allocation::mapped_slice).unwrap_or_default()
    }

    fn mapped_mut(&mut self) -> &mut [u8] {
        self.allocation.as_mut().and_then(Allocation::mapped_slice_mut).unwrap_or_default()
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        let Some(allocation) = self.allocation.take() else { return };
        let mut allocator = lock(&self.gpu.allocator);
        if let Some(allocator) = allocator.as_mut() {
            // It fails only for an allocation of another allocator.
            let _ = allocator.free(allocation);
        }
    }
}

pub(crate) fn create_buffer(
    gpu: &Arc<VulkanGpu>,
    desc: &BufferDesc,
) -> Result<(Owned<vk::Buffer>, Requirements), BackendError> {
    let info = vk::BufferCreateInfo::default()
        .size(desc.bytes)
        .usage(lower::buffer_usage(desc.usage))
        .sharing_mode(vk::SharingMode::EXCLUSIVE);
    // SAFETY: `info` is complete, and its size is not 0.
    let raw = unsafe { gpu.device.create_buffer(&info, None) }.map_err(api("vkCreateBuffer"))?;
    let buffer = Owned::new(gpu, raw);
    gpu.name(raw, desc.name);
    let info = vk::BufferMemoryRequirementsInfo2::default().buffer(raw);
    let kinds = [MemoryKind::Linear, MemoryKind::DedicatedBuffer(raw.as_raw())];
    // SAFETY: the buffer is alive, and the chain lives until the call returns.
    let needs = requirements(kinds, |to| unsafe { gpu.device.get_buffer_memory_requirements2(&info, to) });
    Ok((buffer, needs))
}

pub(crate) fn bind_buffer(
    gpu: &VulkanGpu,
    buffer: Owned<vk::Buffer>,
    memory: &Memory,
) -> Result<Owned<vk::Buffer>, BackendError> {
    let (handle, offset) = memory.handle_and_offset();
    // SAFETY: the memory meets the buffer's requirements, and its owner keeps it as long as the buffer.
    unsafe { gpu.device.bind_buffer_memory(*buffer, handle, offset) }.map_err(api("vkBindBufferMemory"))?;
    Ok(buffer)
}

/// An image and a view of it.
pub struct Image {
    pub(crate) view: Owned<vk::ImageView>,
    // Dropped after the view.
    pub(crate) raw: Owned<vk::Image>,
}

pub(crate) fn create_image(
    gpu: &Arc<VulkanGpu>,
    desc: &ImageDesc,
) -> Result<(Owned<vk::Image>, Requirements), BackendError> {
    let info = vk::ImageCreateInfo::default()
        .image_type(vk::ImageType::TYPE_2D)
        .format(lower::format(desc.format))
        .extent(vk::Extent3D { width: desc.size.0, height: desc.size.1, depth: 1 })
        .mip_levels(1)
        .array_layers(1)
        .samples(vk::SampleCountFlags::TYPE_1)
        .tiling(vk::ImageTiling::OPTIMAL)
        .usage(lower::image_usage(desc.usage))
        .sharing_mode(vk::SharingMode::EXCLUSIVE)
        .initial_layout(vk::ImageLayout::UNDEFINED);
    // SAFETY: `info` is complete, and the format supports the usage.
    let raw = unsafe { gpu.device.create_image(&info, None) }.map_err(api("vkCreateImage"))?;
    let image = Owned::new(gpu, raw);
    gpu.name(raw, desc.name);
    let info = vk::ImageMemoryRequirementsInfo2::default().image(raw);
    let kinds = [MemoryKind::Optimal, MemoryKind::DedicatedImage(raw.as_raw())];
    // SAFETY: the image is alive, and the chain lives until the call returns.
    let needs = requirements(kinds, |to| unsafe { gpu.device.get_image_memory_requirements2(&info, to) });
    Ok((image, needs))
}

pub(crate) fn bind_image(
    gpu: &Arc<VulkanGpu>,
    desc: &ImageDesc,
    image: Owned<vk::Image>,
    memory: &Memory,
) -> Result<Image, BackendError> {
    let (handle, offset) = memory.handle_and_offset();
    // SAFETY: the memory meets the image's requirements, and its owner keeps it as long as the image.
    unsafe { gpu.device.bind_image_memory(*image, handle, offset) }.map_err(api("vkBindImageMemory"))?;
    let info = vk::ImageViewCreateInfo::default()
        .image(*image)
        .view_type(vk::ImageViewType::TYPE_2D)
        .format(lower::format(desc.format))
        .subresource_range(vk::ImageSubresourceRange {
            aspect_mask: lower::aspect(desc.format),
            ..lower::WHOLE
        });
    // SAFETY: the image has memory, and the view is of its own format.
    let view = unsafe { gpu.device.create_image_view(&info, None) }.map_err(api("vkCreateImageView"))?;
    gpu.name(view, desc.name);
    Ok(Image { view: Owned::new(gpu, view), raw: image })
}

/// Returns the requirements that `query` writes. The kind is `alone` if the driver requires a dedicated allocation.
fn requirements(
    [shared, alone]: [MemoryKind; 2],
    query: impl FnOnce(&mut vk::MemoryRequirements2),
) -> Requirements {
    let mut dedicated = vk::MemoryDedicatedRequirements::default();
    let mut answer = vk::MemoryRequirements2::default().push_next(&mut dedicated);
    query(&mut answer);
    let vk::MemoryRequirements { size, alignment, memory_type_bits: types } = answer.memory_requirements;
    let must_be_alone = dedicated.requires_dedicated_allocation == vk::TRUE;
    Requirements { size, alignment, types, kind: if must_be_alone { alone } else { shared } }
}
