//! Command pools, fences and submissions: what uploads and frames have in common.

use crate::error::api;
use crate::gpu::{Gpu, Owned};
use ash::vk;
use splatgraph_api::BackendError;
use std::sync::Arc;

/// A pool with one primary command buffer.
pub(crate) fn command_pool(
    gpu: &Arc<Gpu>,
) -> Result<(Owned<vk::CommandPool>, vk::CommandBuffer), BackendError> {
    let info = vk::CommandPoolCreateInfo::default()
        .flags(vk::CommandPoolCreateFlags::TRANSIENT)
        .queue_family_index(gpu.family);
    // SAFETY: the family is the device's.
    let pool = unsafe { gpu.device.create_command_pool(&info, None) }.map_err(api("vkCreateCommandPool"))?;
    let pool = Owned::new(gpu, pool);
    let info = vk::CommandBufferAllocateInfo::default()
        .command_pool(*pool)
        .level(vk::CommandBufferLevel::PRIMARY)
        .command_buffer_count(1);
    // SAFETY: the pool is alive; the command buffer goes with it.
    let buffers =
        unsafe { gpu.device.allocate_command_buffers(&info) }.map_err(api("vkAllocateCommandBuffers"))?;
    Ok((pool, buffers[0]))
}

pub(crate) fn fence(gpu: &Arc<Gpu>) -> Result<Owned<vk::Fence>, BackendError> {
    // SAFETY: a plain creation on a live device.
    let fence = unsafe { gpu.device.create_fence(&vk::FenceCreateInfo::default(), None) };
    Ok(Owned::new(gpu, fence.map_err(api("vkCreateFence"))?))
}

/// Submits one command buffer; `fence` is signalled when it is done.
pub(crate) fn submit(gpu: &Gpu, commands: vk::CommandBuffer, fence: vk::Fence) -> Result<(), BackendError> {
    let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
    let submits = [vk::SubmitInfo2::default().command_buffer_infos(&buffers)];
    // SAFETY: the command buffer was recorded and is not in use, nor is the fence; `Vulkan` owns the queue.
    unsafe { gpu.device.queue_submit2(gpu.queue, &submits, fence) }.map_err(api("vkQueueSubmit2"))
}

/// Blocks until the fence is signalled, and resets it.
pub(crate) fn wait(gpu: &Gpu, fence: vk::Fence) -> Result<(), BackendError> {
    // SAFETY: the fence is alive, and a submission will signal it.
    unsafe { gpu.device.wait_for_fences(&[fence], true, u64::MAX) }.map_err(api("vkWaitForFences"))?;
    // SAFETY: the fence is signalled, so that no submission uses it.
    unsafe { gpu.device.reset_fences(&[fence]) }.map_err(api("vkResetFences"))
}
