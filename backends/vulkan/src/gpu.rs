//! Holds the open device, and defines objects that are destroyed on drop.
//!
//! Every object holds its device by an [`Arc<VulkanGpu>`], so the device outlives it in any drop order. Objects that
//! the GPU may still be using are not guarded here: the owner of frames in flight ([`splatgraph_runtime::Executor`])
//! waits before it drops anything.
//!
//! One device serves several executors and the threads that prepare plans, concurrently. Vulkan requires external
//! synchronization for the queue (it is behind a lock) and for pools (each has one owner). Creating and destroying
//! objects is allowed from any thread.

use crate::device::{self, Physical};
use crate::error::api;
use crate::instance::{Instance, changing_devices, searching_devices};
use crate::lower::PipelineKey;
use ash::{ext, vk};
use gpu_allocator::AllocationSizes;
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};
use splatgraph_api::{BackendError, Options};
use splatgraph_runtime::{Common, lock};
use std::ffi::{CStr, CString};
use std::fmt::Arguments;
use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// Sizes of the allocator's first and largest blocks in memory that is not host-visible, in bytes.
///
/// Each block is twice as large as the one before. Drivers clear or map a block when it is allocated, and large blocks
/// take longer than drawing a small picture.
pub(crate) const DEVICE_BLOCKS: (u64, u64) = (64 << 20, 256 << 20);
/// Sizes of the first and largest blocks in host-visible memory, in bytes. They must be below `DEVICE_BLOCKS.0`:
/// `available` tells the two kinds apart by their size.
const HOST_BLOCKS: (u64, u64) = (4 << 20, 32 << 20);

/// An open Vulkan device; see [`crate::Vulkan`].
pub struct VulkanGpu {
    pub(crate) device: ash::Device,
    pub(crate) queue: Mutex<vk::Queue>,
    pub(crate) family: u32,
    pub(crate) common: Common,
    pub(crate) physical: vk::PhysicalDevice,
    pub(crate) budget: bool,
    /// Pipeline cache, kept across loads, so that reloading a plan is fast.
    pub(crate) pipeline_cache: vk::PipelineCache,
    /// Pipelines that plans can share. Plans own them.
    pipelines: Mutex<Vec<(PipelineKey, Weak<Pipeline>)>>,
    /// The memory allocator; `None` only while the device is being created or destroyed.
    pub(crate) allocator: Mutex<Option<Allocator>>,
    /// Fences of idle waits that a submission may still signal. If the wait failed or timed out, its fence is destroyed
    /// with the device.
    fences: Mutex<Vec<vk::Fence>>,
    labels: Option<ext::debug_utils::Device>,
    // Dropped after the device is destroyed.
    pub(crate) instance: Instance,
}

impl VulkanGpu {
    pub(crate) fn new(
        instance: Instance,
        physical: &Physical,
        extensions: &[&CStr],
        options: &Options,
    ) -> Result<VulkanGpu, BackendError> {
        let device = device::create(&instance, physical, extensions, options.unchecked)?;
        // SAFETY: the device was created with one queue of this family.
        let queue = unsafe { device.get_device_queue(physical.family, 0) };
        let labels = instance
            .labels
            .then(|| searching_devices(|| ext::debug_utils::Device::new(&instance.raw, &device)));
        let mut gpu = VulkanGpu {
            device,
            queue: Mutex::new(queue),
            family: physical.family,
            common: Common::new(&physical.info, physical.limits.clone(), instance.messages.clone(), options),
            physical: physical.handle,
            budget: physical.budget,
            pipeline_cache: vk::PipelineCache::null(),
            pipelines: Mutex::default(),
            allocator: Mutex::new(None),
            fences: Mutex::default(),
            labels,
            instance,
        };
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: gpu.instance.raw.clone(),
            device: gpu.device.clone(),
            physical_device: physical.handle,
            debug_settings: Default::default(),
            buffer_device_address: false,
            allocation_sizes: AllocationSizes::new(DEVICE_BLOCKS.0, HOST_BLOCKS.0)
                .with_max_device_memblock_size(DEVICE_BLOCKS.1)
                .with_max_host_memblock_size(HOST_BLOCKS.1),
        });
        let allocator =
            allocator.map_err(|e| BackendError::Api { call: "Allocator::new", answer: e.to_string() })?;
        gpu.allocator = Mutex::new(Some(allocator));
        // SAFETY: an empty cache of a live device.
        gpu.pipeline_cache = unsafe { gpu.device.create_pipeline_cache(&Default::default(), None) }
            .map_err(api("vkCreatePipelineCache"))?;
        gpu.name(queue, "queue");
        Ok(gpu)
    }

    /// Keeps a fence until [`VulkanGpu::release`], or else until the device is destroyed.
    pub(crate) fn keep(&self, fence: vk::Fence) {
        lock(&self.fences).push(fence);
    }

    /// Destroys a kept fence. No submission may use it any more.
    pub(crate) fn release(&self, fence: vk::Fence) {
        lock(&self.fences).retain(|&kept| kept != fence);
        // SAFETY: no submission uses the fence, and it was just removed from the list.
        unsafe { self.device.destroy_fence(fence, None) };
    }

    /// Returns the live pipeline with this key, if any.
    pub(crate) fn find_pipeline(&self, key: &PipelineKey) -> Option<Arc<Pipeline>> {
        let known = lock(&self.pipelines);
        known.iter().filter(|(other, _)| other == key).find_map(|(_, pipeline)| pipeline.upgrade())
    }

    /// Lets later plans reuse a pipeline while it is alive.
    pub(crate) fn share_pipeline(&self, key: PipelineKey, pipeline: &Arc<Pipeline>) {
        let mut known = lock(&self.pipelines);
        known.retain(|(_, pipeline)| pipeline.strong_count() > 0);
        known.push((key, Arc::downgrade(pipeline)));
    }

    /// Returns the device's optimal-tiling features for a format.
    pub(crate) fn format_features(&self, format: vk::Format) -> vk::FormatFeatureFlags {
        // SAFETY: queries a device of a live instance.
        let properties =
            unsafe { self.instance.raw.get_physical_device_format_properties(self.physical, format) };
        properties.optimal_tiling_features
    }

    /// Names an object for captures and validation messages. Does nothing without `VK_EXT_debug_utils`.
    pub(crate) fn name(&self, object: impl vk::Handle, name: &str) {
        let Some(labels) = &self.labels else { return };
        let name = c_string(name);
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
        // SAFETY: `object` is alive and of this device. A failure to set a name is ignored.
        let _ = searching_devices(|| unsafe { labels.set_debug_utils_object_name(&info) });
    }

    pub(crate) fn begin_label(&self, commands: vk::CommandBuffer, name: Arguments) {
        let Some(labels) = &self.labels else { return };
        let name = c_string(&name.to_string());
        let label = vk::DebugUtilsLabelEXT::default().label_name(&name);
        // SAFETY: the command buffer is being recorded.
        unsafe { labels.cmd_begin_debug_utils_label(commands, &label) };
    }

    pub(crate) fn end_label(&self, commands: vk::CommandBuffer) {
        let Some(labels) = &self.labels else { return };
        // SAFETY: the command buffer is being recorded, and a label was opened in it.
        unsafe { labels.cmd_end_debug_utils_label(commands) };
    }
}

impl Drop for VulkanGpu {
    fn drop(&mut self) {
        // Frees the allocator's memory before the device is destroyed.
        *self.allocator.get_mut().unwrap_or_else(PoisonError::into_inner) = None;
        // SAFETY: every object of the device holds the `VulkanGpu`, so none is left.
        unsafe {
            for &fence in self.fences.get_mut().unwrap_or_else(PoisonError::into_inner).iter() {
                self.device.destroy_fence(fence, None);
            }
            self.device.destroy_pipeline_cache(self.pipeline_cache, None);
            changing_devices(|| self.device.destroy_device(None));
        }
    }
}

fn c_string(text: &str) -> CString {
    CString::new(text.replace('\0', " ")).unwrap_or_default()
}

/// A handle type that [`Owned`] can destroy.
pub trait Destroy: vk::Handle + Copy {
    /// Destroys the object.
    ///
    /// # Safety
    /// The object must belong to this device and be unused. It must not be destroyed again.
    unsafe fn destroy(self, device: &ash::Device);
}

macro_rules! destroy {
    ($($handle:ident by $function:ident),* $(,)?) => {
        $(impl Destroy for vk::$handle {
            unsafe fn destroy(self, device: &ash::Device) {
                // SAFETY: promised by the caller.
                unsafe { device.$function(self, None) }
            }
        })*
    };
}
destroy!(
    Buffer by destroy_buffer,
    CommandPool by destroy_command_pool,
    DescriptorPool by destroy_descriptor_pool,
    DescriptorSetLayout by destroy_descriptor_set_layout,
    Fence by destroy_fence,
    Image by destroy_image,
    ImageView by destroy_image_view,
    Pipeline by destroy_pipeline,
    PipelineLayout by destroy_pipeline_layout,
    QueryPool by destroy_query_pool,
    Semaphore by destroy_semaphore,
    ShaderModule by destroy_shader_module,
);

/// A Vulkan object that is destroyed when it is dropped.
pub struct Owned<H: Destroy> {
    gpu: Arc<VulkanGpu>,
    raw: H,
}

impl<H: Destroy> Owned<H> {
    /// Takes ownership of a new object, which must belong to `gpu`.
    pub(crate) fn new(gpu: &Arc<VulkanGpu>, raw: H) -> Owned<H> {
        Owned { gpu: gpu.clone(), raw }
    }
}

impl<H: Destroy> Deref for Owned<H> {
    type Target = H;
    fn deref(&self) -> &H {
        &self.raw
    }
}

impl<H: Destroy> Drop for Owned<H> {
    fn drop(&mut self) {
        // SAFETY: this is the only owner, and it is dropped when the GPU no longer uses it (see the module's
        // documentation).
        unsafe { self.raw.destroy(&self.gpu.device) };
    }
}

/// A pipeline layout, with its descriptor set layout.
pub struct PipelineLayout {
    pub(crate) raw: Owned<vk::PipelineLayout>,
    pub(crate) set: Owned<vk::DescriptorSetLayout>,
    pub(crate) stages: vk::ShaderStageFlags,
}

/// A compute or graphics pipeline.
pub struct Pipeline {
    pub(crate) raw: Owned<vk::Pipeline>,
    pub(crate) bind_point: vk::PipelineBindPoint,
    pub(crate) layout: Arc<PipelineLayout>,
}
