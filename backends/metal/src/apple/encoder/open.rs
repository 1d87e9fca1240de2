//! Opens and closes Metal's encoders, with their fences, timestamp samples and targets.

use super::state::{Encoder, Open};
use crate::apple::gpu::MetalGpu;
use crate::sync::{EncoderKind, FenceUse, RenderStages};
use metal::*;
use splatgraph_framework::ir::{DepthAccess, Load, Target};
use splatgraph_runtime::Image;

impl Encoder {
    pub(super) fn update(&mut self, update: FenceUse) {
        // Other encoders may be ordered only through this one. Metal may drop an empty encoder with its fences, so one
        // that has no command yet gets one without effect. Draws need none: each opens its encoder, which loads or
        // clears the targets even if nothing is drawn.
        match self.next {
            Some(EncoderKind::Compute) => {
                if let Some(encoder) = self.compute() {
                    self.gpu.builtin.fill(&encoder, &self.gpu.builtin.scratch, [0, 0]);
                }
            }
            Some(EncoderKind::Blit) => {
                if let Some(encoder) = self.blit() {
                    encoder.fill_buffer(&self.gpu.builtin.scratch, NSRange::new(0, 4), 0);
                }
            }
            Some(EncoderKind::Render) | None => {}
        }
        let (Some(order), Some(division)) = (&self.order, self.walk.division()) else { return };
        let fence = order.fence(division, update.fence);
        match &self.open {
            Open::Compute(encoder) => encoder.update_fence(fence),
            Open::Blit(encoder) => encoder.update_fence(fence),
            Open::Render(encoder) => encoder.update_fence(fence, stages(update, MTLRenderStages::Fragment)),
            Open::None => {}
        }
    }

    pub(super) fn close(&mut self) {
        for _ in 0..std::mem::take(&mut self.groups) {
            self.pop_group();
        }
        if let Some(encoder) = std::mem::replace(&mut self.open, Open::None).raw() {
            encoder.end_encoding();
        }
        self.next = None;
        self.waits.clear();
    }

    pub(super) fn pop_group(&self) {
        if let Some(encoder) = self.open.raw() {
            encoder.pop_debug_group();
        }
    }

    /// Returns the sample buffer for the encoder being opened, and the index of the first of its two samples. `None` if
    /// the encoder is not timed.
    fn samples(&mut self) -> Option<(CounterSampleBuffer, u64)> {
        let first = self.sample.take()?;
        let samples = self.times.as_ref()?.take(first)?;
        Some((samples.clone(), first.into()))
    }

    /// Labels the newly opened encoder, and makes it wait for its fences.
    fn opened(&mut self) {
        self.next = None;
        let waits = std::mem::take(&mut self.waits);
        if let (Some(order), Some(division)) = (&self.order, self.walk.division()) {
            for wait in &waits {
                let fence = order.fence(division, wait.fence);
                match &self.open {
                    Open::Compute(encoder) => encoder.wait_for_fence(fence),
                    Open::Blit(encoder) => encoder.wait_for_fence(fence),
                    Open::Render(encoder) => {
                        encoder.wait_for_fence(fence, stages(*wait, MTLRenderStages::Vertex))
                    }
                    Open::None => {}
                }
            }
        }
        self.waits = waits;
        self.waits.clear();
        if let Some(encoder) = self.open.raw().filter(|_| self.gpu.labels) {
            encoder.set_label(&self.label);
        }
    }

    pub(super) fn compute(&mut self) -> Option<ComputeCommandEncoder> {
        if !matches!(self.open, Open::Compute(_)) {
            if self.next != Some(EncoderKind::Compute) {
                self.interrupt();
            }
            let samples = self.samples();
            let commands = self.commands.as_ref()?;
            let descriptor = ComputePassDescriptor::new();
            // Only barriers and fences order its commands.
            descriptor.set_dispatch_type(MTLDispatchType::Concurrent);
            if let (Some((buffer, first)), Some(samples)) =
                (&samples, descriptor.sample_buffer_attachments().object_at(0))
            {
                samples.set_sample_buffer(buffer);
                samples.set_start_of_encoder_sample_index(*first);
                samples.set_end_of_encoder_sample_index(first + 1);
            }
            self.open =
                Open::Compute(commands.compute_command_encoder_with_descriptor(descriptor).to_owned());
            self.opened();
        }
        let Open::Compute(encoder) = &self.open else { return None };
        Some(encoder.clone())
    }

    pub(super) fn blit(&mut self) -> Option<BlitCommandEncoder> {
        if !matches!(self.open, Open::Blit(_)) {
            if self.next != Some(EncoderKind::Blit) {
                self.interrupt();
            }
            let samples = self.samples();
            let commands = self.commands.as_ref()?;
            let descriptor = BlitPassDescriptor::new();
            if let (Some((buffer, first)), Some(samples)) =
                (&samples, descriptor.sample_buffer_attachments().object_at(0))
            {
                samples.set_sample_buffer(buffer);
                samples.set_start_of_encoder_sample_index(*first);
                samples.set_end_of_encoder_sample_index(first + 1);
            }
            self.open = Open::Blit(commands.blit_command_encoder_with_descriptor(descriptor).to_owned());
            self.opened();
        }
        let Open::Blit(encoder) = &self.open else { return None };
        Some(encoder.clone())
    }

    /// Returns the open render encoder; opens one with these targets if necessary. `None` without a command buffer.
    pub(super) fn render<'a>(
        &mut self,
        targets: impl Iterator<Item = (&'a Target, &'a Image<MetalGpu>)>,
        depth: Option<(DepthAccess, &'a Image<MetalGpu>)>,
    ) -> Option<RenderCommandEncoder> {
        if !matches!(self.open, Open::Render(_)) {
            if self.next != Some(EncoderKind::Render) {
                self.interrupt();
            }
            let samples = self.samples();
            let commands = self.commands.as_ref()?;
            let descriptor = RenderPassDescriptor::new();
            for (index, (target, image)) in targets.enumerate() {
                let Some(attachment) = descriptor.color_attachments().object_at(index as u64) else {
                    continue;
                };
                attachment.set_texture(Some(&image.raw));
                attachment.set_store_action(MTLStoreAction::Store);
                match target.load {
                    Load::Keep => attachment.set_load_action(MTLLoadAction::Load),
                    Load::Clear(r, g, b, a) => {
                        let [r, g, b, a] = [r, g, b, a].map(f64::from);
                        attachment.set_load_action(MTLLoadAction::Clear);
                        attachment.set_clear_color(MTLClearColor::new(r, g, b, a));
                    }
                }
            }
            if let (Some((access, image)), Some(attachment)) = (depth, descriptor.depth_attachment()) {
                attachment.set_texture(Some(&image.raw));
                match access {
                    DepthAccess::Write => {
                        attachment.set_load_action(MTLLoadAction::Clear);
                        attachment.set_clear_depth(0.0);
                    }
                    DepthAccess::TestAndWrite | DepthAccess::Test => {
                        attachment.set_load_action(MTLLoadAction::Load);
                    }
                }
                attachment.set_store_action(MTLStoreAction::Store);
            }
            if let (Some((buffer, first)), Some(samples)) =
                (&samples, descriptor.sample_buffer_attachments().object_at(0))
            {
                /// `MTLCounterDontSample`: no timestamp is sampled at this end of the encoder.
                const NONE: u64 = u64::MAX;
                samples.set_sample_buffer(buffer);
                samples.set_start_of_vertex_sample_index(*first);
                samples.set_end_of_vertex_sample_index(NONE);
                samples.set_start_of_fragment_sample_index(NONE);
                samples.set_end_of_fragment_sample_index(first + 1);
            }
            self.open = Open::Render(commands.new_render_command_encoder(descriptor).to_owned());
            self.opened();
        }
        let Open::Render(encoder) = &self.open else { return None };
        Some(encoder.clone())
    }
}

/// Converts the stages of a fence's use; returns `usual` if it names none.
fn stages(fence: FenceUse, usual: MTLRenderStages) -> MTLRenderStages {
    match fence.stages {
        Some(RenderStages::Vertex) => MTLRenderStages::Vertex,
        Some(RenderStages::Fragment) => MTLRenderStages::Fragment,
        None => usual,
    }
}
