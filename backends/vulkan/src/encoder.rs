//! Records commands into a command buffer.

use crate::descriptors::DescriptorSets;
use crate::gpu::{Owned, VulkanGpu};
use crate::lower::{self, LAYER, WHOLE};
use crate::pipelines::Pipelines;
use crate::queue;
use crate::sync::Barriers;
use crate::sync::commands::{
    ANYTHING, COPIES, Dependency, HOST, READERS, image_barrier, layout, memory_barrier,
};
use ash::vk;
use splatgraph_api::BackendError;
use splatgraph_framework::ir::*;
use splatgraph_framework::plan::Transition;
use splatgraph_runtime::{Buffer, Draw, Image, ImageLayout, Show};
use std::fmt::Arguments;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// A command buffer, and the fence that its submission signals.
pub struct Encoder {
    commands: vk::CommandBuffer,
    fence: Owned<vk::Fence>,
    pool: Owned<vk::CommandPool>,
    gpu: Arc<VulkanGpu>,
    // Reused lists, so that recording does not allocate.
    dependency: Dependency,
    attachments: Vec<vk::RenderingAttachmentInfo<'static>>,
}

impl Encoder {
    fn flush(&mut self) {
        let Dependency { memory, images, .. } = &self.dependency;
        if memory.is_empty() && images.is_empty() {
            return;
        }
        let info = vk::DependencyInfo::default().memory_barriers(memory).image_memory_barriers(images);
        pipeline_barrier(&self.gpu, self.commands, &info);
    }

    fn set_area(&self, area: vk::Rect2D) {
        let viewport = vk::Viewport {
            x: 0.0,
            y: 0.0,
            width: area.extent.width as f32,
            height: area.extent.height as f32,
            min_depth: 0.0,
            max_depth: 1.0,
        };
        // SAFETY: the command buffer is being recorded.
        unsafe {
            self.gpu.device.cmd_set_viewport(self.commands, 0, &[viewport]);
            self.gpu.device.cmd_set_scissor(self.commands, 0, &[area]);
        }
    }
}

impl splatgraph_runtime::Encoder<VulkanGpu> for Encoder {
    fn new(gpu: &Arc<VulkanGpu>, name: &str) -> Result<Encoder, BackendError> {
        let (pool, commands) = queue::command_pool(gpu)?;
        gpu.name(commands, name);
        Ok(Encoder {
            commands,
            fence: queue::fence(gpu)?,
            pool,
            gpu: gpu.clone(),
            dependency: Dependency::default(),
            attachments: Vec::new(),
        })
    }

    fn begin(&mut self) -> Result<(), BackendError> {
        queue::begin(&self.gpu, *self.pool, self.commands)
    }

    fn end(&mut self) -> Result<(), BackendError> {
        queue::end(&self.gpu, self.commands)
    }

    fn submit(&mut self, show: Option<Show<VulkanGpu>>) -> Result<(), BackendError> {
        let blit = show.map(|show| show.swapchain.blit(show.slot, show.image));
        queue::submit(&self.gpu, self.commands, blit, *self.fence)
    }

    fn wait(&mut self, limit: Duration) -> Result<bool, BackendError> {
        queue::wait(&self.gpu, *self.fence, limit)
    }

    fn push_label(&mut self, name: Arguments) {
        self.gpu.begin_label(self.commands, name);
    }

    fn pop_label(&mut self) {
        self.gpu.end_label(self.commands);
    }

    fn synchronize<'a>(
        &mut self,
        barriers: &Barriers,
        at: Option<PassId>,
        image: impl Fn(ResourceId) -> Option<&'a Image<VulkanGpu>>,
    ) {
        let raw = |change: Transition| {
            image(change.image).map(|image| (*image.raw.raw, lower::aspect(image.format)))
        };
        self.dependency.lower(barriers.at(at).iter().map(|barrier| (barrier, barrier.image.and_then(raw))));
        self.flush();
    }

    fn full_barrier<'a>(&mut self, changes: impl Iterator<Item = ImageLayout<'a, VulkanGpu>>) {
        self.dependency.clear();
        self.dependency.memory.push(memory_barrier(ANYTHING, ANYTHING));
        self.dependency.images.extend(changes.map(|ImageLayout { image, old, new }| {
            let changed = (*image.raw.raw, lower::aspect(image.format));
            image_barrier(changed, [old, new].map(layout), ANYTHING, ANYTHING)
        }));
        self.flush();
    }

    fn after_copy(&mut self, target: &Buffer<VulkanGpu>, range: Range<u64>) {
        let barrier = [vk::BufferMemoryBarrier2::default()
            .src_stage_mask(COPIES.stages)
            .src_access_mask(COPIES.accesses)
            .dst_stage_mask(READERS.stages)
            .dst_access_mask(READERS.accesses)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .buffer(*target.raw)
            .offset(range.start)
            .size(range.end - range.start)];
        let info = vk::DependencyInfo::default().buffer_memory_barriers(&barrier);
        pipeline_barrier(&self.gpu, self.commands, &info);
    }

    fn copies_to_host(&mut self) {
        self.dependency.clear();
        self.dependency.memory.push(memory_barrier(COPIES, HOST));
        self.flush();
    }

    fn bind(
        &mut self,
        pipelines: &Pipelines,
        bindings: &DescriptorSets,
        id: PassId,
        pass: &Pass,
        slot: usize,
    ) {
        let Some((pipeline, layout)) = pipelines.find(id) else { return };
        let device = &self.gpu.device;
        // SAFETY: pipeline, layout and set were created for one another and are alive.
        unsafe {
            device.cmd_bind_pipeline(self.commands, pipeline.bind_point, *pipeline.raw);
            if !pass.bindings.is_empty() {
                let sets = [bindings.set(id, slot)];
                device.cmd_bind_descriptor_sets(
                    self.commands,
                    pipeline.bind_point,
                    *layout.raw,
                    0,
                    &sets,
                    &[],
                );
            }
            if !pass.push.is_empty() {
                device.cmd_push_constants(self.commands, *layout.raw, layout.stages, 0, &pass.push);
            }
        }
    }

    fn dispatch(&mut self, [x, y, z]: [u32; 3]) {
        // SAFETY: a compute pipeline with its set is bound; the size was checked with the plan.
        unsafe { self.gpu.device.cmd_dispatch(self.commands, x, y, z) };
    }

    fn dispatch_indirect(&mut self, arguments: &Buffer<VulkanGpu>, offset: u64) {
        // SAFETY: a compute pipeline with its set is bound; the words lie within their buffer.
        unsafe { self.gpu.device.cmd_dispatch_indirect(self.commands, *arguments.raw, offset) };
    }

    fn draw<'a>(
        &mut self,
        targets: impl Iterator<Item = (&'a Target, &'a Image<VulkanGpu>)>,
        depth: Option<(DepthAccess, &'a Image<VulkanGpu>)>,
        draw: Draw<VulkanGpu>,
    ) {
        let mut extent = vk::Extent2D::default();
        self.attachments.clear();
        self.attachments.extend(targets.map(|(target, image)| {
            (extent.width, extent.height) = image.size;
            attachment(target, image)
        }));
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent };
        self.set_area(area);
        let depth = depth.map(|(access, image)| depth_attachment(access, image));
        let mut rendering = vk::RenderingInfo::default()
            .render_area(area)
            .layer_count(1)
            .color_attachments(&self.attachments);
        if let Some(depth) = &depth {
            rendering = rendering.depth_attachment(depth);
        }
        let device = &self.gpu.device;
        // SAFETY: a graphics pipeline for targets of these formats is bound with its set; the views are alive and of
        // one size; the indirect words lie within their buffer.
        unsafe {
            device.cmd_begin_rendering(self.commands, &rendering);
            match draw {
                Draw::Direct { vertices, instances } => {
                    device.cmd_draw(self.commands, vertices, instances, 0, 0);
                }
                Draw::Indirect(buffer, offset) => {
                    device.cmd_draw_indirect(self.commands, *buffer.raw, offset, 1, 16);
                }
            }
            device.cmd_end_rendering(self.commands);
        }
    }

    fn fill(&mut self, buffer: &Buffer<VulkanGpu>, value: u32) {
        // SAFETY: the buffer is alive and a target of transfers, and its size is in whole words.
        unsafe { self.gpu.device.cmd_fill_buffer(self.commands, *buffer.raw, 0, vk::WHOLE_SIZE, value) };
    }

    fn clear(&mut self, image: &Image<VulkanGpu>) {
        // Zero has the same bits in every format.
        let zero = vk::ClearColorValue { uint32: [0; 4] };
        let layout = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        // SAFETY: the image is alive, a target of transfers, and in this layout.
        unsafe {
            self.gpu.device.cmd_clear_color_image(self.commands, *image.raw.raw, layout, &zero, &[WHOLE]);
        }
    }

    fn copy_buffer(
        &mut self,
        source: (&Buffer<VulkanGpu>, u64),
        target: (&Buffer<VulkanGpu>, u64),
        bytes: u64,
    ) {
        let region = [vk::BufferCopy { src_offset: source.1, dst_offset: target.1, size: bytes }];
        // SAFETY: both buffers are alive, allow the copy, and hold the ranges.
        unsafe {
            self.gpu.device.cmd_copy_buffer(self.commands, *source.0.raw, *target.0.raw, &region);
        }
    }

    fn copy_image(&mut self, image: &Image<VulkanGpu>, target: &Buffer<VulkanGpu>) {
        let (width, height) = image.size;
        let layer = vk::ImageSubresourceLayers { aspect_mask: lower::aspect(image.format), ..LAYER };
        let region = [vk::BufferImageCopy::default().image_subresource(layer).image_extent(vk::Extent3D {
            width,
            height,
            depth: 1,
        })];
        let layout = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        // SAFETY: image and buffer are alive, the image is in this layout, and the buffer holds the whole image.
        unsafe {
            self.gpu.device.cmd_copy_image_to_buffer(
                self.commands,
                *image.raw.raw,
                layout,
                *target.raw,
                &region,
            );
        }
    }

    fn copy_to_image(&mut self, image: &Image<VulkanGpu>, target: &Image<VulkanGpu>) {
        let (width, height) = image.size;
        let layer = vk::ImageSubresourceLayers { aspect_mask: lower::aspect(image.format), ..LAYER };
        let extent = vk::Extent3D { width, height, depth: 1 };
        let region = [vk::ImageCopy::default().src_subresource(layer).dst_subresource(layer).extent(extent)];
        let layouts = [vk::ImageLayout::TRANSFER_SRC_OPTIMAL, vk::ImageLayout::TRANSFER_DST_OPTIMAL];
        // SAFETY: both images are alive, of one format and size, allow the copy, and are in these layouts.
        unsafe {
            self.gpu.device.cmd_copy_image(
                self.commands,
                *image.raw.raw,
                layouts[0],
                *target.raw.raw,
                layouts[1],
                &region,
            );
        }
    }

    fn reset_timestamps(&mut self, timestamps: &Owned<vk::QueryPool>, count: u32) {
        // SAFETY: the frame that last used this pool is done, and the pool has this many queries.
        unsafe { self.gpu.device.reset_query_pool(**timestamps, 0, count) };
    }

    /// Writes a timestamp at the end of the pipeline.
    ///
    /// The difference of two timestamps is the time by which the commands between them delay completion, even if passes
    /// overlap.
    fn timestamp(&mut self, timestamps: &Owned<vk::QueryPool>, index: u32) {
        let stage = vk::PipelineStageFlags2::ALL_COMMANDS;
        // SAFETY: the command buffer is being recorded outside of rendering, and the query was reset.
        unsafe { self.gpu.device.cmd_write_timestamp2(self.commands, stage, **timestamps, index) };
    }
}

/// Records a pipeline barrier. Rendering must not be active.
pub(crate) fn pipeline_barrier(gpu: &VulkanGpu, commands: vk::CommandBuffer, info: &vk::DependencyInfo) {
    // SAFETY: the command buffer is being recorded outside of rendering, and the resources are alive.
    unsafe { gpu.device.cmd_pipeline_barrier2(commands, info) };
}

fn attachment(target: &Target, image: &Image<VulkanGpu>) -> vk::RenderingAttachmentInfo<'static> {
    let info = vk::RenderingAttachmentInfo::default()
        .image_view(*image.raw.view)
        .image_layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)
        .store_op(vk::AttachmentStoreOp::STORE);
    match target.load {
        Load::Keep => info.load_op(vk::AttachmentLoadOp::LOAD),
        Load::Clear(r, g, b, a) => {
            info.load_op(vk::AttachmentLoadOp::CLEAR).clear_value(clear_value(image.format, [r, g, b, a]))
        }
    }
}

/// Returns the depth attachment of a draw. `Write` first clears it to 0, the far plane of reversed depth. `Test` stores
/// nothing, because a store counts as a write.
fn depth_attachment(access: DepthAccess, image: &Image<VulkanGpu>) -> vk::RenderingAttachmentInfo<'static> {
    let info = vk::RenderingAttachmentInfo::default()
        .image_view(*image.raw.view)
        .image_layout(vk::ImageLayout::DEPTH_STENCIL_ATTACHMENT_OPTIMAL);
    let far = vk::ClearValue { depth_stencil: vk::ClearDepthStencilValue { depth: 0.0, stencil: 0 } };
    match access {
        DepthAccess::Write => {
            info.load_op(vk::AttachmentLoadOp::CLEAR).clear_value(far).store_op(vk::AttachmentStoreOp::STORE)
        }
        DepthAccess::TestAndWrite => {
            info.load_op(vk::AttachmentLoadOp::LOAD).store_op(vk::AttachmentStoreOp::STORE)
        }
        DepthAccess::Test => info.load_op(vk::AttachmentLoadOp::LOAD).store_op(vk::AttachmentStoreOp::NONE),
    }
}

fn clear_value(format: Format, [r, g, b, a]: [f32; 4]) -> vk::ClearValue {
    let color = match format {
        Format::R32Uint => vk::ClearColorValue { uint32: [r as u32, g as u32, b as u32, a as u32] },
        _ => vk::ClearColorValue { float32: [r, g, b, a] },
    };
    vk::ClearValue { color }
}
