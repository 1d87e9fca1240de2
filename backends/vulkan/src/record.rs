//! The recording of a frame: the plan's steps, one after another, into a command buffer.
//!
//! Between the passes stands what the plan says and nothing else: one `vkCmdPipelineBarrier2` per step that has
//! barriers, and one for the handover. The backend adds barriers only for what it does itself: at the start of a plan
//! that goes on from another's histories, around the copies that somebody asked to inspect, around that to a picture
//! ([`crate::picture`]), and before the host reads what no step of the plan shows it.

use crate::barriers::{ANYTHING, Dependency, Scope, going_on, take_over};
use crate::error::api;
use crate::gpu::Gpu;
use crate::limits::invalid;
use crate::loaded::{Loaded, queries};
use crate::lower::LoweredStep;
use crate::memory::{Buffer, WHOLE};
use crate::picture::PictureBuffer;
use ash::vk;
use splatgraph_api::{BackendError, FrameId, FrameInputs, Inspect};
use splatgraph_framework::ir::*;
use std::sync::Arc;

/// What a recorded frame does.
pub(crate) struct Recorded {
    /// The passes that it runs, in order.
    pub passes: Vec<PassId>,
    /// A buffer for each resource to inspect, in the order asked.
    pub inspected: Vec<Buffer>,
    /// The layouts that it leaves the images in.
    pub layouts: Vec<vk::ImageLayout>,
}

/// Everything that the recording needs to know.
pub(crate) struct Recorder<'a> {
    pub gpu: &'a Arc<Gpu>,
    pub loaded: &'a Loaded,
    pub inputs: &'a FrameInputs,
    pub frame: FrameId,
    pub slot: usize,
    pub commands: vk::CommandBuffer,
    /// Where the output is to be copied to.
    pub picture: Option<&'a PictureBuffer>,
}

impl Recorder<'_> {
    /// Records the frame into the command buffer, whose pool was reset.
    pub fn record(&self) -> Result<Recorded, BackendError> {
        let mut recorded = Recorded {
            passes: Vec::new(),
            inspected: self.inspection_buffers()?,
            layouts: self.loaded.layouts.clone(),
        };
        let device = &self.gpu.device;
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the command buffer is not in use.
        unsafe { device.begin_command_buffer(self.commands, &begin) }.map_err(api("vkBeginCommandBuffer"))?;
        self.gpu.begin_label(self.commands, &format!("frame {}", self.frame.0));
        self.reset_timestamps();
        self.timestamp(0);
        self.take_over(&mut recorded.layouts);
        for step in self.loaded.prologue() {
            self.step(step, &going_on(&step.dependency, &self.loaded.carried), &mut recorded);
        }
        if self.loaded.prologue_due {
            self.barrier(&self.loaded.lowered.handover, &mut recorded.layouts);
        }
        for step in &self.loaded.lowered.frame {
            self.step(step, &step.dependency, &mut recorded);
        }
        self.copy_to_picture();
        self.host_barrier();
        self.timestamp(1);
        self.gpu.end_label(self.commands);
        // SAFETY: the command buffer is being recorded.
        unsafe { device.end_command_buffer(self.commands) }.map_err(api("vkEndCommandBuffer"))?;
        Ok(recorded)
    }

    /// Histories that another plan's frames wrote, and may still be writing.
    fn take_over(&self, layouts: &mut [vk::ImageLayout]) {
        if self.loaded.carried.is_empty() {
            return;
        }
        let images = self.loaded.carried.iter().filter(|&&id| self.loaded.resources.image(id).is_some());
        let dependency = take_over(images.map(|&id| (id, layouts[id.index()])));
        self.barrier(&dependency, layouts);
    }

    /// Barriers, the pass of a step, and what is to be inspected after it.
    fn step(&self, step: &LoweredStep, barriers: &Dependency, recorded: &mut Recorded) {
        let pass = self.loaded.plan.pass(step.pass);
        self.gpu.begin_label(self.commands, &pass.name);
        self.barrier(barriers, &mut recorded.layouts);
        if pass.work != Work::Host && !self.loaded.is_left_out(step) {
            let query = queries(recorded.passes.len());
            self.timestamp(query);
            self.bind(step, pass);
            match &pass.work {
                Work::Dispatch { groups, .. } => self.dispatch(*groups),
                Work::Draw { call, targets, .. } => self.draw(*call, targets),
                Work::Fill { buffer, value } => self.fill(*buffer, *value),
                Work::Start { resource } => self.zero(*resource),
                Work::Export => self.export(),
                Work::Host => {}
            }
            self.timestamp(query + 1);
            recorded.passes.push(step.pass);
        }
        self.gpu.end_label(self.commands);
        for (inspect, buffer) in self.inputs.inspect.iter().zip(&recorded.inspected) {
            if inspect.after == step.pass {
                self.gpu.begin_label(self.commands, &format!("inspect after {}", pass.name));
                self.inspect(*inspect, buffer, &recorded.layouts);
                self.gpu.end_label(self.commands);
            }
        }
    }

    /// The barriers of one call.
    fn barrier(&self, dependency: &Dependency, layouts: &mut [vk::ImageLayout]) {
        if dependency.is_empty() {
            return;
        }
        let memory: Vec<_> = dependency.memory.iter().map(|b| memory_barrier(b.source, b.target)).collect();
        let images: Vec<_> = dependency
            .images
            .iter()
            .filter_map(|b| {
                layouts[b.resource.index()] = b.new;
                let image = *self.loaded.resources.image(b.resource)?.raw;
                Some(image_barrier(image, b.source, b.target, b.old, b.new))
            })
            .collect();
        let info = vk::DependencyInfo::default().memory_barriers(&memory).image_memory_barriers(&images);
        self.pipeline_barrier(&info);
    }

    pub(crate) fn pipeline_barrier(&self, info: &vk::DependencyInfo) {
        // SAFETY: the command buffer is being recorded outside of rendering, and the resources are alive.
        unsafe { self.gpu.device.cmd_pipeline_barrier2(self.commands, info) };
    }

    /// Pipeline, descriptor set and push constants.
    fn bind(&self, step: &LoweredStep, pass: &Pass) {
        let Some(pipeline) = step.pipeline else { return };
        let pipeline = &self.loaded.pipelines.pipelines[pipeline];
        let layout = &self.loaded.pipelines.layouts[pipeline.layout];
        let set = self.loaded.sets.of(step.pass.index(), self.slot);
        let device = &self.gpu.device;
        // SAFETY: pipeline, layout and set were made for one another and are alive.
        unsafe {
            device.cmd_bind_pipeline(self.commands, pipeline.bind_point, *pipeline.raw);
            if !pass.bindings.is_empty() {
                device.cmd_bind_descriptor_sets(
                    self.commands,
                    pipeline.bind_point,
                    *layout.raw,
                    0,
                    &[set],
                    &[],
                );
            }
            if !pass.push.is_empty() {
                device.cmd_push_constants(self.commands, *layout.raw, layout.stages, 0, &pass.push);
            }
        }
    }

    fn dispatch(&self, groups: Groups) {
        let device = &self.gpu.device;
        // SAFETY: a compute pipeline with its set is bound; sizes and offsets were checked with the plan.
        unsafe {
            match groups {
                Groups::Direct([x, y, z]) => device.cmd_dispatch(self.commands, x, y, z),
                Groups::Indirect { buffer, offset } => {
                    let buffer = *self.loaded.resources.buffer(buffer, self.slot).raw;
                    device.cmd_dispatch_indirect(self.commands, buffer, offset);
                }
            }
        }
    }

    fn draw(&self, call: DrawCall, targets: &[Target]) {
        let images: Vec<_> =
            targets.iter().filter_map(|t| Some((t, self.loaded.resources.image(t.image)?))).collect();
        let attachments: Vec<_> = images
            .iter()
            .map(|(target, image)| {
                let info = vk::RenderingAttachmentInfo::default()
                    .image_view(*image.view)
                    .image_layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)
                    .store_op(vk::AttachmentStoreOp::STORE);
                match target.load {
                    Load::Keep => info.load_op(vk::AttachmentLoadOp::LOAD),
                    Load::Clear(r, g, b, a) => info
                        .load_op(vk::AttachmentLoadOp::CLEAR)
                        .clear_value(clear_value(image.format, [r, g, b, a])),
                }
            })
            .collect();
        let extent = images.first().map(|(_, image)| image.extent).unwrap_or_default();
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent };
        let viewport = vk::Viewport {
            x: 0.0,
            y: 0.0,
            width: extent.width as f32,
            height: extent.height as f32,
            min_depth: 0.0,
            max_depth: 1.0,
        };
        let rendering =
            vk::RenderingInfo::default().render_area(area).layer_count(1).color_attachments(&attachments);
        let device = &self.gpu.device;
        // SAFETY: a graphics pipeline for targets of these formats is bound with its set; the views are alive and of
        // one size; the indirect words lie within their buffer.
        unsafe {
            device.cmd_set_viewport(self.commands, 0, &[viewport]);
            device.cmd_set_scissor(self.commands, 0, &[area]);
            device.cmd_begin_rendering(self.commands, &rendering);
            match call {
                DrawCall::Direct { vertices, instances } => {
                    device.cmd_draw(self.commands, vertices, instances, 0, 0);
                }
                DrawCall::Indirect { buffer, offset } => {
                    let buffer = *self.loaded.resources.buffer(buffer, self.slot).raw;
                    device.cmd_draw_indirect(self.commands, buffer, offset, 1, 16);
                }
            }
            device.cmd_end_rendering(self.commands);
        }
    }

    fn fill(&self, buffer: ResourceId, value: u32) {
        let buffer = *self.loaded.resources.buffer(buffer, self.slot).raw;
        // SAFETY: the buffer is alive and a target of transfers, and its size is in whole words.
        unsafe { self.gpu.device.cmd_fill_buffer(self.commands, buffer, 0, vk::WHOLE_SIZE, value) };
    }

    /// Zeros for a buffer, or for an image that is in the layout of a transfer's target.
    fn zero(&self, resource: ResourceId) {
        let Some(image) = self.loaded.resources.image(resource) else { return self.fill(resource, 0) };
        // Zero has the same bits in every format.
        let zero = vk::ClearColorValue { uint32: [0; 4] };
        // SAFETY: the image is alive and a target of transfers.
        unsafe {
            self.gpu.device.cmd_clear_color_image(
                self.commands,
                *image.raw,
                vk::ImageLayout::TRANSFER_DST_OPTIMAL,
                &zero,
                &[WHOLE],
            );
        }
    }

    /// Statistics, and the output if it is read, to where the host finds them.
    fn export(&self) {
        if let Some(target) = self.loaded.readback(self.slot) {
            for (index, stat) in self.loaded.plan.stats.iter().enumerate() {
                let source = self.loaded.resources.buffer(stat.buffer, self.slot);
                self.copy_buffer(source, stat.offset, target, 4 * index as u64, 4);
            }
        }
        let output = &self.loaded.slots[self.slot].output;
        if let (true, Some(target)) = (self.inputs.read_output, output) {
            self.copy_image(self.loaded.plan.output, target);
        }
    }

    fn copy_buffer(&self, source: &Buffer, from: u64, target: &Buffer, to: u64, bytes: u64) {
        let region = [vk::BufferCopy { src_offset: from, dst_offset: to, size: bytes }];
        // SAFETY: both buffers are alive, allow the copy, and hold the ranges.
        unsafe { self.gpu.device.cmd_copy_buffer(self.commands, *source.raw, *target.raw, &region) };
    }

    /// Copies an image that is in the layout of a transfer's source, rows tightly packed.
    pub(crate) fn copy_image(&self, image: ResourceId, target: &Buffer) {
        let Some(image) = self.loaded.resources.image(image) else { return };
        let region = [vk::BufferImageCopy::default()
            .image_subresource(vk::ImageSubresourceLayers {
                aspect_mask: vk::ImageAspectFlags::COLOR,
                mip_level: 0,
                base_array_layer: 0,
                layer_count: 1,
            })
            .image_extent(vk::Extent3D { width: image.extent.width, height: image.extent.height, depth: 1 })];
        // SAFETY: image and buffer are alive, and the buffer holds the whole image.
        unsafe {
            self.gpu.device.cmd_copy_image_to_buffer(
                self.commands,
                *image.raw,
                vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
                *target.raw,
                &region,
            );
        }
    }

    /// Makes the copies that this frame was asked for visible to the host, which waiting for the fence alone does not.
    /// Where the plan shows the statistics to the host, that shows what was copied before as well.
    fn host_barrier(&self) {
        let inspect = &self.inputs.inspect;
        let copies = self.inputs.read_output || !inspect.is_empty();
        let late = inspect.iter().any(|i| self.loaded.plan.pass(i.after).work == Work::Host);
        if !copies || (self.loaded.lowered.host_sees_copies && !late) {
            return;
        }
        let barrier = [vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::COPY)
            .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::HOST)
            .dst_access_mask(vk::AccessFlags2::HOST_READ)];
        self.pipeline_barrier(&vk::DependencyInfo::default().memory_barriers(&barrier));
    }

    /// A host buffer for each resource to inspect; refuses what this frame cannot show.
    fn inspection_buffers(&self) -> Result<Vec<Buffer>, BackendError> {
        let plan = &self.loaded.plan;
        let mut buffers = Vec::new();
        for inspect in &self.inputs.inspect {
            let (Some(resource), Some(pass)) =
                (plan.resources.get(inspect.resource.index()), plan.passes.get(inspect.after.index()))
            else {
                return invalid(format!("there is nothing to inspect by {inspect:?} in this plan"));
            };
            let Some(last) = self.loaded.steps().position(|step| step.pass == inspect.after) else {
                return invalid(format!(
                    "`{}` cannot be inspected after pass `{}`, which does not run in this frame",
                    resource.name, pass.name
                ));
            };
            self.check_contents(inspect, last)?;
            let bytes = match self.loaded.resources.image(inspect.resource) {
                Some(image) => image.bytes(),
                None => self.loaded.resources.part(inspect.resource, self.slot).1,
            };
            buffers.push(Buffer::to_host(self.gpu, "inspection", bytes)?);
        }
        Ok(buffers)
    }

    /// Refuses to inspect what has no contents of its own right after step `last` of this frame: an image that nothing has
    /// written, or a resource whose memory belongs to another at that time (changing the layout of such an image would
    /// spoil what is there).
    fn check_contents(&self, inspect: &Inspect, last: usize) -> Result<(), BackendError> {
        let (plan, id) = (&self.loaded.plan, inspect.resource);
        let (resource, pass) = (plan.resource(id), plan.pass(inspect.after));
        let touches = || self.loaded.steps().take(last + 1).flat_map(|step| &plan.pass(step.pass).touches);
        if plan.aliases(id).next().is_some() {
            let holds = |touch: &&Touch| plan.resource(touch.resource).block == resource.block;
            let holder = touches().filter(holds).last().map(|touch| touch.resource);
            if holder != Some(id) {
                let holder = match holder {
                    Some(holder) => format!("holds `{}` then", plan.resource(holder).name),
                    None => "holds nothing yet".to_string(),
                };
                return invalid(format!(
                    "`{}` cannot be inspected after pass `{}`: it shares its memory, which {holder}",
                    resource.name, pass.name
                ));
            }
        }
        let written = !self.loaded.prologue_due
            || self.loaded.carried.contains(&id)
            || touches().any(|touch| touch.resource == id && touch.accesses.writes());
        if self.loaded.resources.image(id).is_some() && !written {
            return invalid(format!(
                "image `{}` has no contents yet after pass `{}`",
                resource.name, pass.name
            ));
        }
        Ok(())
    }

    /// Copies a resource as it is now. The full barriers on both sides keep the copy out of the plan's hazards.
    fn inspect(&self, inspect: Inspect, target: &Buffer, layouts: &[vk::ImageLayout]) {
        let any = ANYTHING;
        let memory = [memory_barrier(any, any)];
        let image = self.loaded.resources.image(inspect.resource).map(|image| *image.raw);
        let layout = layouts[inspect.resource.index()];
        let between = |old, new| {
            let images: Vec<_> =
                image.iter().map(|&image| image_barrier(image, any, any, old, new)).collect();
            let info = vk::DependencyInfo::default().memory_barriers(&memory).image_memory_barriers(&images);
            self.pipeline_barrier(&info);
        };
        between(layout, vk::ImageLayout::TRANSFER_SRC_OPTIMAL);
        if image.is_some() {
            self.copy_image(inspect.resource, target);
        } else {
            let (source, bytes) = self.loaded.resources.part(inspect.resource, self.slot);
            self.copy_buffer(source, 0, target, 0, bytes);
        }
        between(vk::ImageLayout::TRANSFER_SRC_OPTIMAL, layout);
    }

    fn reset_timestamps(&self) {
        if let Some(pool) = &self.loaded.slots[self.slot].timestamps {
            let count = queries(self.loaded.steps().count());
            // SAFETY: the frame that last used this slot's pool is done, and the pool has this many queries.
            unsafe { self.gpu.device.reset_query_pool(**pool, 0, count) };
        }
    }

    /// Written once everything before it is done: the difference of two is the time that what is between them kept
    /// the device from going on, also where passes overlap.
    fn timestamp(&self, query: u32) {
        if let Some(pool) = &self.loaded.slots[self.slot].timestamps {
            // SAFETY: the command buffer is being recorded outside of rendering, and the query was reset.
            unsafe {
                self.gpu.device.cmd_write_timestamp2(
                    self.commands,
                    vk::PipelineStageFlags2::ALL_COMMANDS,
                    **pool,
                    query,
                );
            }
        }
    }
}

fn clear_value(format: Format, [r, g, b, a]: [f32; 4]) -> vk::ClearValue {
    let color = match format {
        Format::R32Uint => vk::ClearColorValue { uint32: [r as u32, g as u32, b as u32, a as u32] },
        _ => vk::ClearColorValue { float32: [r, g, b, a] },
    };
    vk::ClearValue { color }
}

fn memory_barrier(source: Scope, target: Scope) -> vk::MemoryBarrier2<'static> {
    vk::MemoryBarrier2::default()
        .src_stage_mask(source.stages)
        .src_access_mask(source.accesses)
        .dst_stage_mask(target.stages)
        .dst_access_mask(target.accesses)
}

fn image_barrier(
    image: vk::Image,
    source: Scope,
    target: Scope,
    old: vk::ImageLayout,
    new: vk::ImageLayout,
) -> vk::ImageMemoryBarrier2<'static> {
    vk::ImageMemoryBarrier2::default()
        .src_stage_mask(source.stages)
        .src_access_mask(source.accesses)
        .dst_stage_mask(target.stages)
        .dst_access_mask(target.accesses)
        .old_layout(old)
        .new_layout(new)
        .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .image(image)
        .subresource_range(WHOLE)
}
