//! Uploads of the scene, in chunks through a staging buffer.
//!
//! The staging buffer has two halves: while the device copies out of one, the host fills the other. However large the
//! scene, no more than [`CHUNK`] bytes twice are mapped, and progress is told after every chunk.

use crate::error::api;
use crate::gpu::{Gpu, Owned};
use crate::memory::Buffer;
use crate::planes::{PlaneKey, Planes};
use crate::queue::{command_pool, fence, submit, wait};
use ash::vk;
use splatgraph_api::{BackendError, Progress, SceneData};
use std::sync::Arc;

/// Bytes of one copy at most.
const CHUNK: u64 = 16 << 20;

/// Fetches the data of the planes `missing` and brings it to the device. When this returns, also with an error, the
/// device uses none of it any more: `missing` is on the device, or can be dropped.
pub(crate) fn upload(
    gpu: &Arc<Gpu>,
    scene: &dyn SceneData,
    missing: &[PlaneKey],
    planes: &Planes,
    progress: &mut dyn FnMut(Progress),
) -> Result<(), BackendError> {
    if missing.is_empty() {
        return Ok(());
    }
    Uploader::new(gpu, missing)?.run(scene, missing, planes, progress)
}

/// A chunk on its way.
struct Half {
    staging: Buffer,
    pool: Owned<vk::CommandPool>,
    commands: vk::CommandBuffer,
    fence: Owned<vk::Fence>,
    busy: bool,
}

struct Uploader<'a> {
    gpu: &'a Arc<Gpu>,
    halves: [Half; 2],
    done: u64,
    total: u64,
}

impl<'a> Uploader<'a> {
    fn new(gpu: &'a Arc<Gpu>, missing: &[PlaneKey]) -> Result<Self, BackendError> {
        let total: u64 = missing.iter().map(|key| key.bytes).sum();
        let half = || -> Result<Half, BackendError> {
            let (pool, commands) = command_pool(gpu)?;
            Ok(Half {
                staging: Buffer::to_device(
                    gpu,
                    "staging",
                    total.min(CHUNK),
                    vk::BufferUsageFlags::TRANSFER_SRC,
                )?,
                pool,
                commands,
                fence: fence(gpu)?,
                busy: false,
            })
        };
        Ok(Uploader { gpu, halves: [half()?, half()?], done: 0, total })
    }

    fn run(
        &mut self,
        scene: &dyn SceneData,
        missing: &[PlaneKey],
        planes: &Planes,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), BackendError> {
        progress(Progress::Upload { done_bytes: 0, of_bytes: self.total });
        let mut bytes = Vec::new();
        let mut next = 0;
        for key in missing {
            bytes.clear();
            bytes.resize(key.bytes as usize, 0);
            scene.write(&key.attribute, key.plane, &mut bytes).map_err(BackendError::Scene)?;
            let target = &planes[key];
            for (index, chunk) in bytes.chunks(CHUNK as usize).enumerate() {
                self.send(next, chunk, target, index as u64 * CHUNK)?;
                next = 1 - next;
                self.done += chunk.len() as u64;
                progress(Progress::Upload { done_bytes: self.done, of_bytes: self.total });
            }
        }
        self.wait(0)?;
        self.wait(1)
    }

    /// Copies `chunk` to byte `offset` of `target` through one of the halves.
    fn send(&mut self, half: usize, chunk: &[u8], target: &Buffer, offset: u64) -> Result<(), BackendError> {
        self.wait(half)?;
        let Half { staging, pool, commands, fence, busy } = &mut self.halves[half];
        let device = &self.gpu.device;
        staging.mapped_mut()[..chunk.len()].copy_from_slice(chunk);
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        let region = [vk::BufferCopy::default().dst_offset(offset).size(chunk.len() as u64)];
        // Whatever reads the plane later, in any stage of any later submission.
        let barrier = [vk::BufferMemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::COPY)
            .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .dst_access_mask(vk::AccessFlags2::MEMORY_READ)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .buffer(*target.raw)
            .offset(offset)
            .size(chunk.len() as u64)];
        // SAFETY: the half's last submission is done, so that its pool and staging memory are free; the copy lies
        // within both buffers.
        unsafe {
            device
                .reset_command_pool(**pool, vk::CommandPoolResetFlags::empty())
                .map_err(api("vkResetCommandPool"))?;
            device.begin_command_buffer(*commands, &begin).map_err(api("vkBeginCommandBuffer"))?;
            device.cmd_copy_buffer(*commands, *staging.raw, *target.raw, &region);
            let dependency = vk::DependencyInfo::default().buffer_memory_barriers(&barrier);
            device.cmd_pipeline_barrier2(*commands, &dependency);
            device.end_command_buffer(*commands).map_err(api("vkEndCommandBuffer"))?;
        }
        submit(self.gpu, *commands, **fence)?;
        *busy = true;
        Ok(())
    }

    fn wait(&mut self, half: usize) -> Result<(), BackendError> {
        let half = &mut self.halves[half];
        if half.busy {
            wait(self.gpu, *half.fence)?;
            half.busy = false;
        }
        Ok(())
    }
}

impl Drop for Uploader<'_> {
    /// An error, or a panic of the scene's, leaves copies on their way out of the staging buffers.
    fn drop(&mut self) {
        for half in 0..self.halves.len() {
            // A device that is lost has nothing left to do.
            let _ = self.wait(half);
        }
    }
}
