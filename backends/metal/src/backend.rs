//! Implements the runtime's [`Gpu`](splatgraph_runtime::Gpu) trait with Metal.

use crate::capture;
use crate::descriptors::ArgumentTables;
use crate::device;
use crate::encoder::Encoder;
use crate::features;
use crate::gpu::MetalGpu;
use crate::memory::{self, Memory, UnboundBuffer, UnboundImage};
use crate::objc;
use crate::pipelines::Pipelines;
use crate::queue::{self, Timestamps};
use crate::swapchain::Swapchain;
use metal::{Buffer, Texture};
use splatgraph_api::{BackendError, DeviceInfo, DeviceMemory, Options, Validation};
use splatgraph_framework::ir::{Binding, Format, PassId};
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{
    Acquired, BindingTarget, BufferDesc, Common, FormatSupport, Gpu, ImageDesc, Location, NextPipeline,
    Presented, Requirements, Show, Window,
};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

impl Gpu for MetalGpu {
    type Memory = Memory;
    type UnboundBuffer = UnboundBuffer;
    type UnboundImage = UnboundImage;
    type Buffer = Buffer;
    type Image = Texture;
    // Fences and encoders come with the pipelines.
    type Synchronization = ();
    type Pipelines = Pipelines;
    type Bindings = ArgumentTables;
    type Timestamps = Timestamps;
    type Encoder = Encoder;
    type Swapchain = Swapchain;

    fn devices() -> Result<Vec<DeviceInfo>, BackendError> {
        Ok(device::all().into_iter().map(|device| device.info).collect())
    }

    fn open(
        options: &Options,
        window: Option<Arc<dyn Window>>,
    ) -> Result<(DeviceInfo, Arc<Self>), BackendError> {
        check_validation(options.validation)?;
        let physical = device::choose(device::all(), options.device.as_deref())?;
        let info = physical.info.clone();
        Ok((info, Arc::new(MetalGpu::new(physical, window, options)?)))
    }

    fn common(&self) -> &Common {
        &self.common
    }

    fn memory(&self) -> DeviceMemory {
        let used = self.allocated.load(Ordering::Relaxed);
        DeviceMemory { used, reserved: used.max(objc::allocated_bytes(&self.device)) }
    }

    fn available(&self) -> Option<u64> {
        Some(self.common.limits.heap_bytes.saturating_sub(objc::allocated_bytes(&self.device)))
    }

    fn format_support(&self, format: Format) -> FormatSupport {
        features::format_support(format, self.filters_floats)
    }

    fn wait_idle(&self, limit: Duration) -> bool {
        queue::idle(self, limit)
    }

    fn create_buffer(
        self: &Arc<Self>,
        desc: &BufferDesc,
    ) -> Result<(UnboundBuffer, Requirements), BackendError> {
        Ok(memory::create_buffer(self, desc))
    }

    fn create_image(
        self: &Arc<Self>,
        desc: &ImageDesc,
    ) -> Result<(UnboundImage, Requirements), BackendError> {
        Ok(memory::create_image(self, desc))
    }

    fn allocate(
        self: &Arc<Self>,
        name: &str,
        requirements: &Requirements,
        location: Location,
    ) -> Result<Memory, BackendError> {
        objc::pool(|| Memory::new(self, name, requirements, location))
    }

    fn bind_buffer(self: &Arc<Self>, buffer: UnboundBuffer, memory: &Memory) -> Result<Buffer, BackendError> {
        objc::pool(|| memory::bind_buffer(&buffer, memory))
    }

    fn bind_image(self: &Arc<Self>, image: UnboundImage, memory: &Memory) -> Result<Texture, BackendError> {
        objc::pool(|| memory::bind_image(&image, memory))
    }

    fn synchronization(_: &Plan) -> Result<(), BackendError> {
        Ok(())
    }

    fn create_pipelines(
        self: &Arc<Self>,
        plan: &Plan,
        next: &mut dyn FnMut(NextPipeline) -> Result<(), BackendError>,
    ) -> Result<Pipelines, BackendError> {
        Pipelines::new(self, plan, next)
    }

    fn create_bindings(
        self: &Arc<Self>,
        plan: &Plan,
        pipelines: &Pipelines,
    ) -> Result<ArgumentTables, BackendError> {
        Ok(ArgumentTables::new(plan, pipelines))
    }

    fn write_binding(
        &self,
        bindings: &mut ArgumentTables,
        pass: PassId,
        copy: usize,
        binding: &Binding,
        target: BindingTarget<Self>,
    ) {
        bindings.write(pass, copy, binding, &target);
    }

    fn clear_bindings(&self, bindings: &mut ArgumentTables, pass: PassId) {
        bindings.clear(pass);
    }

    fn create_timestamps(self: &Arc<Self>, count: u32) -> Result<Option<Timestamps>, BackendError> {
        Ok(Some(Timestamps::new(self, count)))
    }

    fn read_timestamps(&self, timestamps: &Timestamps, count: u32) -> Result<Vec<Option<u64>>, BackendError> {
        Ok(timestamps.read(count))
    }

    fn create_encoder(self: &Arc<Self>, name: &str) -> Result<Encoder, BackendError> {
        Ok(Encoder::new(self, name))
    }

    fn submit(&self, encoder: &mut Encoder, show: Option<Show<Self>>) -> Result<(), BackendError> {
        objc::pool(|| encoder.submit(show.map(|show| show.swapchain)))
    }

    fn wait(&self, encoder: &mut Encoder, limit: Duration) -> Result<bool, BackendError> {
        objc::pool(|| encoder.wait(limit))
    }

    fn window_size(&self, wanted: (u32, u32)) -> Result<Option<(u32, u32)>, BackendError> {
        Ok((wanted.0 > 0 && wanted.1 > 0).then_some(wanted))
    }

    /// Does nothing: a layer is never lost.
    fn renew_surface(&self) -> Result<(), BackendError> {
        Ok(())
    }

    fn create_swapchain(
        self: &Arc<Self>,
        size: (u32, u32),
        vsync: bool,
        _: Option<&Swapchain>,
    ) -> Result<Swapchain, BackendError> {
        Swapchain::new(self, size, vsync)
    }

    fn acquire(&self, swapchain: &mut Swapchain, _: usize) -> Result<Acquired, BackendError> {
        Ok(swapchain.acquire())
    }

    /// Stores the output to draw. The draw is recorded at submission, when the frame's fences are known.
    fn record_blit(
        &self,
        show: Show<Self>,
        output: &splatgraph_runtime::Image<Self>,
        _: &Plan,
        _: &(),
    ) -> Result<(), BackendError> {
        show.swapchain.set_output(output);
        Ok(())
    }

    /// Ends a running capture. The draw's command buffer presents the drawable.
    fn present(&self, _: Show<Self>) -> Result<Presented, BackendError> {
        capture::end();
        Ok(Presented::Shown)
    }
}

/// Refuses validation unless the process was started with Metal's validation, which cannot be enabled later.
fn check_validation(validation: Validation) -> Result<(), BackendError> {
    let names = ["MTL_DEBUG_LAYER", "METAL_DEVICE_WRAPPER_TYPE"];
    let is_on = names.iter().any(|name| std::env::var_os(name).is_some_and(|value| value == "1"));
    if validation == Validation::Off || is_on {
        return Ok(());
    }
    Err(BackendError::Unavailable(
        "validation was requested, but Metal enables it only when a program starts: set MTL_DEBUG_LAYER=1 (and \
         MTL_SHADER_VALIDATION=1 for the shaders); it ends the program at the first error, and prints the reason to standard error"
            .to_string(),
    ))
}
