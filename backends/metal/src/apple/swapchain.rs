//! Acquires drawables of a window's layer, and draws a frame's output into them.
//!
//! The output is the texture of a triangle that covers the drawable, and is scaled if the sizes differ. The draw has
//! its own command buffer, so the frame does not wait for the window.

use crate::apple::capture;
use crate::apple::gpu::MetalGpu;
use crate::apple::objc;
use crate::error::no_object;
use crate::lower;
use metal::*;
use splatgraph_api::BackendError;
use splatgraph_framework::ir::Format;
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{Acquired, Image, Presented};
use std::sync::Arc;

/// The drawables of a window's layer, all of one size. A resize replaces the swapchain.
pub struct Swapchain {
    layer: MetalLayer,
    size: (u32, u32),
    drawable: Option<MetalDrawable>,
    output: Option<Output>,
}

struct Output {
    texture: Texture,
    format: Format,
    size: (u32, u32),
}

impl splatgraph_runtime::Swapchain<MetalGpu> for Swapchain {
    /// Sets the layer's drawable size and vsync. Fails if the device was opened without a window.
    fn new(
        gpu: &Arc<MetalGpu>,
        size: (u32, u32),
        vsync: bool,
        _: Option<&Swapchain>,
    ) -> Result<Swapchain, BackendError> {
        let Some(surface) = &gpu.surface else {
            return Err(BackendError::Invalid("the device was opened without a window".to_string()));
        };
        let layer = surface.layer.clone();
        let mut pixels = layer.drawable_size();
        (pixels.width, pixels.height) = (size.0.into(), size.1.into());
        layer.set_drawable_size(pixels);
        layer.set_display_sync_enabled(vsync);
        Ok(Swapchain { layer, size, drawable: None, output: None })
    }

    /// Acquires a drawable. Blocks until one is free; returns [`Acquired::NotReady`] if none is after a second
    /// (`allowsNextDrawableTimeout`).
    fn acquire(&mut self, _: usize) -> Result<Acquired, BackendError> {
        self.drawable = objc::pool(|| self.layer.next_drawable().map(ToOwned::to_owned));
        Ok(match &self.drawable {
            Some(_) => Acquired::Image { index: 0, suboptimal: false },
            None => Acquired::NotReady,
        })
    }

    /// Stores the output to draw. The draw is recorded at submission, when the frame's fences are known.
    fn record_blit(
        &mut self,
        _: u32,
        _: usize,
        output: &Image<MetalGpu>,
        _: &Plan,
        (): &(),
    ) -> Result<(), BackendError> {
        self.output = Some(Output { texture: output.raw.clone(), format: output.format, size: output.size });
        Ok(())
    }

    /// Ends a running capture. The draw's command buffer presents the drawable.
    fn present(&mut self, _: u32) -> Result<Presented, BackendError> {
        capture::end();
        Ok(Presented::Shown)
    }
}

impl Swapchain {
    /// Records the draw of the output into the drawable, then the drawable's presentation. Returns the commands to
    /// commit.
    ///
    /// Uses up the output and the drawable; fails if one is missing.
    ///
    /// The draw takes part in the export's order: it waits for the export's fences and updates them. If there are none,
    /// it waits for the frame's event.
    pub(crate) fn draw(
        &mut self,
        gpu: &MetalGpu,
        fences: &[&Fence],
        frame: (&EventRef, u64),
    ) -> Result<CommandBuffer, BackendError> {
        let (Some(drawable), Some(output)) = (self.drawable.take(), self.output.take()) else {
            return Err(BackendError::Invalid(
                "a frame is shown without a drawable or an output".to_string(),
            ));
        };
        let commands = gpu.commands("window")?;
        if fences.is_empty() {
            commands.encode_wait_for_event(frame.0, frame.1);
        }
        let descriptor = RenderPassDescriptor::new();
        let target =
            descriptor.color_attachments().object_at(0).ok_or_else(|| no_object("colorAttachments"))?;
        target.set_texture(Some(drawable.texture()));
        target.set_load_action(MTLLoadAction::DontCare);
        target.set_store_action(MTLStoreAction::Store);
        let encoder = commands.new_render_command_encoder(descriptor);
        if gpu.labels {
            encoder.set_label("window");
        }
        fences.iter().for_each(|fence| encoder.wait_for_fence(fence, MTLRenderStages::Fragment));
        let builtin = &gpu.builtin;
        let interpolates = lower::interpolates(output.format, output.size == self.size, gpu.filters_floats);
        encoder.set_render_pipeline_state(&builtin.show);
        encoder.set_fragment_texture(0, Some(&output.texture));
        encoder.set_fragment_sampler_state(
            0,
            Some(if interpolates { &builtin.linear } else { &builtin.nearest }),
        );
        encoder.draw_primitives(MTLPrimitiveType::Triangle, 0, 3);
        fences.iter().for_each(|fence| encoder.update_fence(fence, MTLRenderStages::Fragment));
        encoder.end_encoding();
        commands.present_drawable(&drawable);
        Ok(commands)
    }
}
