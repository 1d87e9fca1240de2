//! Creates command pools, fences and semaphores, submits command buffers, and presents.

use crate::error::api;
use crate::gpu::{Owned, VulkanGpu};
use ash::{khr, vk};
use splatgraph_api::BackendError;
use splatgraph_runtime::lock;
use std::sync::Arc;
use std::time::{Duration, Instant};

pub(crate) fn command_pool(
    gpu: &Arc<VulkanGpu>,
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
    // SAFETY: the pool is alive, and owns the command buffer.
    let buffers =
        unsafe { gpu.device.allocate_command_buffers(&info) }.map_err(api("vkAllocateCommandBuffers"))?;
    Ok((pool, buffers[0]))
}

/// Begins recording into a pool's command buffer. Its last submission must have completed.
pub(crate) fn begin(
    gpu: &VulkanGpu,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
) -> Result<(), BackendError> {
    // SAFETY: the command buffer, the only one of the pool, is not in use.
    unsafe { gpu.device.reset_command_pool(pool, vk::CommandPoolResetFlags::empty()) }
        .map_err(api("vkResetCommandPool"))?;
    let info = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
    // SAFETY: as above.
    unsafe { gpu.device.begin_command_buffer(commands, &info) }.map_err(api("vkBeginCommandBuffer"))
}

pub(crate) fn end(gpu: &VulkanGpu, commands: vk::CommandBuffer) -> Result<(), BackendError> {
    // SAFETY: the command buffer is being recorded.
    unsafe { gpu.device.end_command_buffer(commands) }.map_err(api("vkEndCommandBuffer"))
}

pub(crate) fn fence(gpu: &Arc<VulkanGpu>) -> Result<Owned<vk::Fence>, BackendError> {
    // SAFETY: a plain creation on a live device.
    let fence = unsafe { gpu.device.create_fence(&vk::FenceCreateInfo::default(), None) };
    Ok(Owned::new(gpu, fence.map_err(api("vkCreateFence"))?))
}

pub(crate) fn semaphore(gpu: &Arc<VulkanGpu>) -> Result<Owned<vk::Semaphore>, BackendError> {
    // SAFETY: a plain creation on a live device.
    let semaphore = unsafe { gpu.device.create_semaphore(&vk::SemaphoreCreateInfo::default(), None) };
    Ok(Owned::new(gpu, semaphore.map_err(api("vkCreateSemaphore"))?))
}

/// The recorded blit of a frame's output to the window, with the semaphores for its start and end.
#[derive(Clone, Copy, Default)]
pub(crate) struct Blit {
    pub commands: vk::CommandBuffer,
    /// Signalled when the window's image may be written.
    pub acquired: vk::Semaphore,
    /// Signalled when the window's image may be presented.
    pub finished: vk::Semaphore,
}

/// Submits commands, followed by the blit of a frame's output, if any. `fence` is signalled when both complete.
///
/// The blit is a separate batch: a driver may delay a whole batch until its semaphores are signalled, and the frame
/// must not wait for the window.
pub(crate) fn submit(
    gpu: &VulkanGpu,
    commands: vk::CommandBuffer,
    blit: Option<Blit>,
    fence: vk::Fence,
) -> Result<(), BackendError> {
    let frame = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
    let batches = if blit.is_some() { 2 } else { 1 };
    let Blit { commands, acquired, finished } = blit.unwrap_or_default();
    let blits = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
    let waits =
        [vk::SemaphoreSubmitInfo::default().semaphore(acquired).stage_mask(vk::PipelineStageFlags2::BLIT)];
    let signals = [vk::SemaphoreSubmitInfo::default()
        .semaphore(finished)
        .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)];
    let submits = [
        vk::SubmitInfo2::default().command_buffer_infos(&frame),
        vk::SubmitInfo2::default()
            .wait_semaphore_infos(&waits)
            .command_buffer_infos(&blits)
            .signal_semaphore_infos(&signals),
    ];
    let queue = lock(&gpu.queue);
    // SAFETY: the command buffers were recorded and are not in use, nor is the fence. The acquire signals the semaphore
    // `acquired`; the last wait for `finished` has completed. The queue is locked.
    unsafe { gpu.device.queue_submit2(*queue, &submits[..batches], fence) }.map_err(api("vkQueueSubmit2"))
}

/// Presents a swapchain image once `finished` is signalled. Returns true if the swapchain is suboptimal.
pub(crate) fn present(
    gpu: &VulkanGpu,
    functions: &khr::swapchain::Device,
    swapchain: vk::SwapchainKHR,
    image: u32,
    finished: vk::Semaphore,
) -> Result<bool, vk::Result> {
    let (waits, swapchains, images) = ([finished], [swapchain], [image]);
    let info =
        vk::PresentInfoKHR::default().wait_semaphores(&waits).swapchains(&swapchains).image_indices(&images);
    let queue = lock(&gpu.queue);
    // SAFETY: the image was acquired, and a submission that signals the semaphore brings it into the present layout.
    // The swapchain is used by one window only, and the queue is locked.
    unsafe { functions.queue_present(*queue, &info) }
}

/// Maximum time to poll a fence of a GPU before the thread sleeps. Waking a thread takes 0.1 ms, as long as a short
/// frame, and the GPU is idle meanwhile. On a CPU, polling would take time from the frame.
const POLLED: Duration = Duration::from_micros(500);

/// Polls the fence until it is signalled or `limit` has passed. Errors are left to the wait that follows.
fn poll(gpu: &VulkanGpu, fence: vk::Fence, limit: Duration) {
    let begun = Instant::now();
    // SAFETY: the fence is alive.
    while unsafe { gpu.device.get_fence_status(fence) } == Ok(false) && begun.elapsed() < limit {
        std::hint::spin_loop();
    }
}

/// Blocks until the fence is signalled, for at most `limit`, without locking the queue. If it was signalled, resets it
/// and returns true.
pub(crate) fn wait(gpu: &VulkanGpu, fence: vk::Fence, limit: Duration) -> Result<bool, BackendError> {
    let polled = if gpu.common.is_cpu { Duration::ZERO } else { POLLED.min(limit) };
    if !polled.is_zero() {
        poll(gpu, fence, polled);
    }
    let nanoseconds = u64::try_from((limit - polled).as_nanos()).unwrap_or(u64::MAX);
    // SAFETY: the fence is alive, and a submission will signal it.
    match unsafe { gpu.device.wait_for_fences(&[fence], true, nanoseconds) } {
        Ok(()) => {}
        Err(vk::Result::TIMEOUT) => return Ok(false),
        Err(answer) => return Err(api("vkWaitForFences")(answer)),
    }
    // SAFETY: the fence is signalled, so no submission uses it.
    unsafe { gpu.device.reset_fences(&[fence]) }.map_err(api("vkResetFences"))?;
    Ok(true)
}

/// Blocks until all earlier submissions have completed, for at most `limit`. Returns false if the limit has passed.
///
/// It waits for a fence of an empty submission: `vkDeviceWaitIdle` has no time limit, and needs exclusive access to the
/// queue.
pub(crate) fn idle(gpu: &VulkanGpu, limit: Duration) -> Result<bool, BackendError> {
    // SAFETY: a plain creation on a live device.
    let fence = unsafe { gpu.device.create_fence(&vk::FenceCreateInfo::default(), None) }
        .map_err(api("vkCreateFence"))?;
    // If the wait times out, the queue may still use the fence, so it is kept until the device is destroyed.
    gpu.keep(fence);
    // SAFETY: the fence is not in use; the queue is locked.
    unsafe { gpu.device.queue_submit2(*lock(&gpu.queue), &[], fence) }.map_err(api("vkQueueSubmit2"))?;
    let idle = wait(gpu, fence, limit)?;
    if idle {
        gpu.release(fence);
    }
    Ok(idle)
}
