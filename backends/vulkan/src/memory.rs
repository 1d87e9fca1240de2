//! Buffers and images, and the memory that they stand in.
//!
//! Memory is suballocated by `gpu-allocator`. Most objects have a piece of it to themselves; the tenants of a block share
//! one ([`crate::blocks`]). So an object is made in two steps: first without memory ([`UnboundBuffer`], [`UnboundImage`]),
//! which tells what it needs, then bound to some. The memory is given back when the last object in it is dropped. An error
//! names the resource and its size.

use crate::error::{api, mib};
use crate::gpu::{Gpu, Owned};
use crate::lower;
use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use splatgraph_api::BackendError;
use splatgraph_framework::ir::{Format, Usage};
use std::sync::{Arc, PoisonError};

/// A piece of device memory.
pub(crate) struct Memory {
    // An `Option` only so that `drop` can move it out.
    allocation: Option<Allocation>,
    gpu: Arc<Gpu>,
}

/// What an object, or several that share memory, ask of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Needs {
    pub size: u64,
    pub alignment: u64,
    /// A bit for each memory type that will do.
    pub types: u32,
    pub kind: MemoryKind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum MemoryKind {
    /// For buffers, which allocators keep apart from images.
    Linear,
    /// For images, or for both.
    Optimal,
    /// The driver wants an allocation for this object alone.
    DedicatedBuffer(vk::Buffer),
    DedicatedImage(vk::Image),
}

impl Memory {
    pub fn new(
        gpu: &Arc<Gpu>,
        name: &str,
        needs: Needs,
        location: MemoryLocation,
    ) -> Result<Arc<Memory>, BackendError> {
        let describe = AllocationCreateDesc {
            name,
            requirements: vk::MemoryRequirements {
                size: needs.size,
                alignment: needs.alignment,
                memory_type_bits: needs.types,
            },
            location,
            linear: matches!(needs.kind, MemoryKind::Linear | MemoryKind::DedicatedBuffer(_)),
            allocation_scheme: match needs.kind {
                MemoryKind::Linear | MemoryKind::Optimal => AllocationScheme::GpuAllocatorManaged,
                MemoryKind::DedicatedBuffer(buffer) => AllocationScheme::DedicatedBuffer(buffer),
                MemoryKind::DedicatedImage(image) => AllocationScheme::DedicatedImage(image),
            },
        };
        let mut allocator = gpu.allocator.lock().unwrap_or_else(PoisonError::into_inner);
        let allocator = allocator
            .as_mut()
            .ok_or(BackendError::Api { call: "allocate", answer: "the device is closed".to_string() })?;
        let allocation = allocator.allocate(&describe).map_err(|error| {
            BackendError::OutOfMemory(format!("no memory for `{name}` ({}): {error}", mib(needs.size)))
        })?;
        Ok(Arc::new(Memory { allocation: Some(allocation), gpu: gpu.clone() }))
    }

    pub fn bytes(&self) -> u64 {
        self.allocation.as_ref().map_or(0, Allocation::size)
    }

    /// The handle and the offset to bind at.
    fn place(&self) -> (vk::DeviceMemory, u64) {
        // SAFETY: the handle is used only to bind objects that keep this piece of memory alive.
        self.allocation.as_ref().map_or_else(Default::default, |a| (unsafe { a.memory() }, a.offset()))
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        let Some(allocation) = self.allocation.take() else { return };
        let mut allocator = self.gpu.allocator.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(allocator) = allocator.as_mut() {
            // It fails only for an allocation of another allocator.
            let _ = allocator.free(allocation);
        }
    }
}

/// A buffer that has no memory yet.
pub(crate) struct UnboundBuffer {
    raw: Owned<vk::Buffer>,
    bytes: u64,
    usage: vk::BufferUsageFlags,
}

impl UnboundBuffer {
    pub fn new(
        gpu: &Arc<Gpu>,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
    ) -> Result<UnboundBuffer, BackendError> {
        let info =
            vk::BufferCreateInfo::default().size(bytes).usage(usage).sharing_mode(vk::SharingMode::EXCLUSIVE);
        // SAFETY: `info` is complete, and its size is not 0.
        let raw = unsafe { gpu.device.create_buffer(&info, None) }.map_err(api("vkCreateBuffer"))?;
        gpu.name(raw, name);
        Ok(UnboundBuffer { raw: Owned::new(gpu, raw), bytes, usage })
    }

    pub fn needs(&self, gpu: &Gpu) -> Needs {
        let info = vk::BufferMemoryRequirementsInfo2::default().buffer(*self.raw);
        let mut dedicated = vk::MemoryDedicatedRequirements::default();
        let mut requirements = vk::MemoryRequirements2::default().push_next(&mut dedicated);
        // SAFETY: the buffer is alive, and the chain lives until the call returns.
        unsafe { gpu.device.get_buffer_memory_requirements2(&info, &mut requirements) };
        let requirements = requirements.memory_requirements;
        let alone = dedicated.requires_dedicated_allocation == vk::TRUE;
        needs(requirements, if alone { MemoryKind::DedicatedBuffer(*self.raw) } else { MemoryKind::Linear })
    }

    /// Gives it memory of which it asked for no more than is there.
    pub fn bind(self, gpu: &Gpu, memory: Arc<Memory>) -> Result<Buffer, BackendError> {
        let (handle, offset) = memory.place();
        // SAFETY: the memory is of the size, alignment and type that the buffer needs, and lives as long as it.
        unsafe { gpu.device.bind_buffer_memory(*self.raw, handle, offset) }
            .map_err(api("vkBindBufferMemory"))?;
        Ok(Buffer { raw: self.raw, bytes: self.bytes, usage: self.usage, memory })
    }
}

pub(crate) struct Buffer {
    pub raw: Owned<vk::Buffer>,
    pub bytes: u64,
    /// What it was made for.
    pub usage: vk::BufferUsageFlags,
    // Dropped after the buffer.
    pub memory: Arc<Memory>,
}

impl Buffer {
    /// A buffer in device memory of its own.
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
        Self::read_back(gpu, name, bytes, vk::BufferUsageFlags::TRANSFER_DST)
    }

    /// The same, with other uses besides.
    pub fn read_back(
        gpu: &Arc<Gpu>,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
    ) -> Result<Buffer, BackendError> {
        Self::new(gpu, name, bytes, usage, MemoryLocation::GpuToCpu)
    }

    fn new(
        gpu: &Arc<Gpu>,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
        location: MemoryLocation,
    ) -> Result<Buffer, BackendError> {
        let buffer = UnboundBuffer::new(gpu, name, bytes, usage)?;
        let memory = Memory::new(gpu, name, buffer.needs(gpu), location)?;
        buffer.bind(gpu, memory)
    }

    /// What the buffer's memory is seen as by the host; empty if it is not mapped.
    pub fn mapped(&self) -> &[u8] {
        let slice = self.memory.allocation.as_ref().and_then(Allocation::mapped_slice).unwrap_or_default();
        &slice[..slice.len().min(self.bytes as usize)]
    }

    /// Empty also if others stand in the same memory.
    pub fn mapped_mut(&mut self) -> &mut [u8] {
        let bytes = self.bytes as usize;
        let allocation = Arc::get_mut(&mut self.memory).and_then(|memory| memory.allocation.as_mut());
        let slice = allocation.and_then(Allocation::mapped_slice_mut).unwrap_or_default();
        let end = slice.len().min(bytes);
        &mut slice[..end]
    }
}

/// An image that has no memory yet.
pub(crate) struct UnboundImage {
    raw: Owned<vk::Image>,
    name: String,
    format: Format,
    extent: vk::Extent2D,
    usage: vk::ImageUsageFlags,
}

impl UnboundImage {
    /// `usage` is what [`check_format`] was asked about.
    pub fn new(
        gpu: &Arc<Gpu>,
        name: &str,
        format: Format,
        extent: vk::Extent2D,
        usage: vk::ImageUsageFlags,
    ) -> Result<UnboundImage, BackendError> {
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(lower::format(format))
            .extent(vk::Extent3D { width: extent.width, height: extent.height, depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(usage)
            .sharing_mode(vk::SharingMode::EXCLUSIVE)
            .initial_layout(vk::ImageLayout::UNDEFINED);
        // SAFETY: `info` is complete, and the format allows the usage.
        let raw = unsafe { gpu.device.create_image(&info, None) }.map_err(api("vkCreateImage"))?;
        gpu.name(raw, name);
        Ok(UnboundImage { raw: Owned::new(gpu, raw), name: name.to_string(), format, extent, usage })
    }

    pub fn needs(&self, gpu: &Gpu) -> Needs {
        let info = vk::ImageMemoryRequirementsInfo2::default().image(*self.raw);
        let mut dedicated = vk::MemoryDedicatedRequirements::default();
        let mut requirements = vk::MemoryRequirements2::default().push_next(&mut dedicated);
        // SAFETY: the image is alive, and the chain lives until the call returns.
        unsafe { gpu.device.get_image_memory_requirements2(&info, &mut requirements) };
        let requirements = requirements.memory_requirements;
        let alone = dedicated.requires_dedicated_allocation == vk::TRUE;
        needs(requirements, if alone { MemoryKind::DedicatedImage(*self.raw) } else { MemoryKind::Optimal })
    }

    /// Gives it memory of which it asked for no more than is there.
    pub fn bind(self, gpu: &Arc<Gpu>, memory: Arc<Memory>) -> Result<Image, BackendError> {
        let (handle, offset) = memory.place();
        // SAFETY: the memory is of the size, alignment and type that the image needs, and lives as long as it.
        unsafe { gpu.device.bind_image_memory(*self.raw, handle, offset) }
            .map_err(api("vkBindImageMemory"))?;
        let info = vk::ImageViewCreateInfo::default()
            .image(*self.raw)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(lower::format(self.format))
            .subresource_range(WHOLE);
        // SAFETY: the image has memory, and the view is of its own format.
        let view = unsafe { gpu.device.create_image_view(&info, None) }.map_err(api("vkCreateImageView"))?;
        gpu.name(view, &self.name);
        Ok(Image {
            view: Owned::new(gpu, view),
            raw: self.raw,
            format: self.format,
            extent: self.extent,
            usage: self.usage,
            memory,
        })
    }
}

pub(crate) struct Image {
    /// The whole image, as storage image and as colour target.
    pub view: Owned<vk::ImageView>,
    // Dropped after the view.
    pub raw: Owned<vk::Image>,
    pub format: Format,
    pub extent: vk::Extent2D,
    /// What it was made for.
    pub usage: vk::ImageUsageFlags,
    // Dropped after the image.
    pub memory: Arc<Memory>,
}

impl Image {
    pub fn bytes(&self) -> u64 {
        self.format.bytes_per_pixel() as u64 * self.extent.width as u64 * self.extent.height as u64
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
pub(crate) fn check_format(
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

fn needs(requirements: vk::MemoryRequirements, kind: MemoryKind) -> Needs {
    Needs {
        size: requirements.size,
        alignment: requirements.alignment,
        types: requirements.memory_type_bits,
        kind,
    }
}
