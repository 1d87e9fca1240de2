//! Implements the runtime's [`Gpu`](splatgraph_runtime::Gpu) trait with Vulkan.

use crate::descriptors::DescriptorSets;
use crate::encoder::Encoder;
use crate::error::api;
use crate::gpu::{DEVICE_BLOCKS, Owned, VulkanGpu};
use crate::instance::Instance;
use crate::memory::{Image, Memory, requirements};
use crate::pipelines::Pipelines;
use crate::swapchain::{self, Swapchain};
use crate::sync::{self, Barriers};
use crate::{device, lower, queue};
use ash::khr;
use ash::vk::{self, Handle};
use splatgraph_api::{BackendError, DeviceInfo, DeviceMemory, Options, Robustness, Validation};
use splatgraph_framework::ir::Format;
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{
    BufferDesc, Common, FormatSupport, Gpu, ImageDesc, MemoryKind, NextPipeline, Requirements, Window, lock,
};
use std::ffi::CStr;
use std::sync::Arc;
use std::time::Duration;
use tracing::info_span;

impl Gpu for VulkanGpu {
    type Memory = Memory;
    type UnboundBuffer = Owned<vk::Buffer>;
    type UnboundImage = Owned<vk::Image>;
    type Buffer = Owned<vk::Buffer>;
    type Image = Image;
    type Synchronization = Barriers;
    type Pipelines = Pipelines;
    type Bindings = DescriptorSets;
    type Timestamps = Owned<vk::QueryPool>;
    type Encoder = Encoder;
    type Swapchain = Swapchain;

    fn devices() -> Result<Vec<DeviceInfo>, BackendError> {
        let instance = Instance::new(Validation::Off, &[])?;
        Ok(device::all(&instance)?.into_iter().map(|device| device.info).collect())
    }

    fn open(
        options: &Options,
        window: Option<Arc<dyn Window>>,
        chosen: &mut dyn FnMut(&DeviceInfo),
    ) -> Result<(DeviceInfo, Arc<Self>), BackendError> {
        let creating = info_span!("create the instance").entered();
        let (instance, extensions): (_, &[&CStr]) = match window {
            Some(window) => (Instance::in_window(options.validation, window)?, &[khr::swapchain::NAME]),
            None => (Instance::new(options.validation, &[])?, &[]),
        };
        drop(creating);
        let found = info_span!("list the devices").in_scope(|| device::all(&instance))?;
        let physical = device::choose(found, options.device.as_deref())?;
        let mut info = physical.info.clone();
        if options.unchecked {
            info.robustness = Robustness::default();
        }
        chosen(&info);
        let gpu = info_span!("create the device")
            .in_scope(|| VulkanGpu::new(instance, &physical, extensions, options))?;
        Ok((info, Arc::new(gpu)))
    }

    fn common(&self) -> &Common {
        &self.common
    }

    fn memory(&self) -> DeviceMemory {
        let allocator = lock(&self.allocator);
        allocator.as_ref().map_or(DeviceMemory::default(), |allocator| {
            let report = allocator.generate_report();
            DeviceMemory { used: report.total_allocated_bytes, reserved: report.total_capacity_bytes }
        })
    }

    fn available(&self) -> Option<u64> {
        let available = device::heap(&self.instance, self.physical, self.budget).available?;
        let allocator = lock(&self.allocator);
        let report = allocator.as_ref()?.generate_report();
        // The driver counts free space in the allocator's blocks as used, although it is available. On a discrete GPU,
        // the blocks that the host can access, which are smaller, are in another heap.
        // SAFETY: the physical device is one of the instance's.
        let properties = unsafe { self.instance.raw.get_physical_device_properties(self.physical) };
        let is_discrete = properties.device_type == vk::PhysicalDeviceType::DISCRETE_GPU;
        let blocks = report.blocks.iter().filter(|block| !is_discrete || block.size >= DEVICE_BLOCKS.0);
        let free = blocks.map(|block| {
            let used = report.allocations[block.allocations.clone()].iter().map(|allocation| allocation.size);
            block.size.saturating_sub(used.sum())
        });
        Some(available.saturating_add(free.sum()))
    }

    fn format_support(&self, format: Format) -> FormatSupport {
        let features = self.format_features(lower::format(format));
        FormatSupport {
            storage: features.contains(vk::FormatFeatureFlags::STORAGE_IMAGE),
            target: features.contains(match format {
                Format::Depth32Float => vk::FormatFeatureFlags::DEPTH_STENCIL_ATTACHMENT,
                _ => vk::FormatFeatureFlags::COLOR_ATTACHMENT,
            }),
            blend: features.contains(vk::FormatFeatureFlags::COLOR_ATTACHMENT_BLEND),
            blit: features.contains(vk::FormatFeatureFlags::BLIT_SRC),
        }
    }

    fn wait_idle(&self, limit: Duration) -> bool {
        match queue::idle(self, limit) {
            Ok(idle) => idle,
            // A lost device has no work left.
            Err(BackendError::DeviceLost(_)) => true,
            Err(_) => false,
        }
    }

    fn create_buffer(
        self: &Arc<Self>,
        desc: &BufferDesc,
    ) -> Result<(Owned<vk::Buffer>, Requirements), BackendError> {
        let info = vk::BufferCreateInfo::default()
            .size(desc.bytes)
            .usage(lower::buffer_usage(desc.usage))
            .sharing_mode(vk::SharingMode::EXCLUSIVE);
        // SAFETY: `info` is complete, and its size is not 0.
        let raw = unsafe { self.device.create_buffer(&info, None) }.map_err(api("vkCreateBuffer"))?;
        let buffer = Owned::new(self, raw);
        self.name(raw, desc.name);
        let info = vk::BufferMemoryRequirementsInfo2::default().buffer(raw);
        let kinds = [MemoryKind::Linear, MemoryKind::DedicatedBuffer(raw.as_raw())];
        // SAFETY: the buffer is alive, and the chain lives until the call returns.
        let needs =
            requirements(kinds, |to| unsafe { self.device.get_buffer_memory_requirements2(&info, to) });
        Ok((buffer, needs))
    }

    fn create_image(
        self: &Arc<Self>,
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
        let raw = unsafe { self.device.create_image(&info, None) }.map_err(api("vkCreateImage"))?;
        let image = Owned::new(self, raw);
        self.name(raw, desc.name);
        let info = vk::ImageMemoryRequirementsInfo2::default().image(raw);
        let kinds = [MemoryKind::Optimal, MemoryKind::DedicatedImage(raw.as_raw())];
        // SAFETY: the image is alive, and the chain lives until the call returns.
        let needs =
            requirements(kinds, |to| unsafe { self.device.get_image_memory_requirements2(&info, to) });
        Ok((image, needs))
    }

    fn bind_buffer(
        self: &Arc<Self>,
        _: &BufferDesc,
        buffer: Owned<vk::Buffer>,
        memory: &Memory,
    ) -> Result<Owned<vk::Buffer>, BackendError> {
        let (handle, offset) = memory.handle_and_offset();
        // SAFETY: the memory meets the buffer's requirements, and its owner keeps it as long as the buffer.
        unsafe { self.device.bind_buffer_memory(*buffer, handle, offset) }
            .map_err(api("vkBindBufferMemory"))?;
        Ok(buffer)
    }

    fn bind_image(
        self: &Arc<Self>,
        desc: &ImageDesc,
        image: Owned<vk::Image>,
        memory: &Memory,
    ) -> Result<Image, BackendError> {
        let (handle, offset) = memory.handle_and_offset();
        // SAFETY: the memory meets the image's requirements, and its owner keeps it as long as the image.
        unsafe { self.device.bind_image_memory(*image, handle, offset) }.map_err(api("vkBindImageMemory"))?;
        let info = vk::ImageViewCreateInfo::default()
            .image(*image)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(lower::format(desc.format))
            .subresource_range(vk::ImageSubresourceRange {
                aspect_mask: lower::aspect(desc.format),
                ..lower::WHOLE
            });
        // SAFETY: the image has memory, and the view is of its own format.
        let view = unsafe { self.device.create_image_view(&info, None) }.map_err(api("vkCreateImageView"))?;
        self.name(view, desc.name);
        Ok(Image { view: Owned::new(self, view), raw: image })
    }

    fn synchronization(plan: &Plan) -> Result<Barriers, BackendError> {
        sync::barriers(plan)
    }

    fn create_pipelines(
        self: &Arc<Self>,
        plan: &Plan,
        next: &mut dyn FnMut(NextPipeline) -> Result<(), BackendError>,
    ) -> Result<Pipelines, BackendError> {
        Pipelines::new(self, plan, next)
    }

    fn create_timestamps(self: &Arc<Self>, count: u32) -> Result<Option<Owned<vk::QueryPool>>, BackendError> {
        if self.common.limits.timestamp_bits == 0 {
            return Ok(None);
        }
        let info = vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(count);
        // SAFETY: a plain creation on a live device.
        let pool = unsafe { self.device.create_query_pool(&info, None) };
        Ok(Some(Owned::new(self, pool.map_err(api("vkCreateQueryPool"))?)))
    }

    fn read_timestamps(
        &self,
        timestamps: &Owned<vk::QueryPool>,
        count: u32,
    ) -> Result<Vec<Option<u64>>, BackendError> {
        // Each value is followed by its availability.
        let mut values = vec![[0u64; 2]; count as usize];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WITH_AVAILABILITY;
        // SAFETY: the pool has at least this many timestamps.
        match unsafe { self.device.get_query_pool_results(**timestamps, 0, &mut values, flags) } {
            Ok(()) | Err(vk::Result::NOT_READY) => {}
            Err(answer) => return Err(api("vkGetQueryPoolResults")(answer)),
        }
        Ok(values.iter().map(|[value, written]| (*written != 0).then_some(*value)).collect())
    }

    fn window_size(&self, wanted: (u32, u32)) -> Result<Option<(u32, u32)>, BackendError> {
        swapchain::window_size(self, wanted)
    }

    fn renew_surface(&self) -> Result<(), BackendError> {
        self.instance.renew_surface()?;
        // A closed window can still have a surface, but queries on it fail.
        match self.instance.surface() {
            Some(surface) if surface.can_show(self.physical, self.family) => Ok(()),
            _ => Err(BackendError::SurfaceLost { call: "vkGetPhysicalDeviceSurfaceSupportKHR" }),
        }
    }
}
