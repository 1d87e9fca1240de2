//! Implements the runtime's [`Gpu`](splatgraph_runtime::Gpu) trait with Metal.

use crate::apple::descriptors::ArgumentTables;
use crate::apple::device;
use crate::apple::encoder::Encoder;
use crate::apple::gpu::MetalGpu;
use crate::apple::memory::{self, Memory};
use crate::apple::objc;
use crate::apple::pipelines::Pipelines;
use crate::apple::queue::{self, Timestamps};
use crate::apple::swapchain::Swapchain;
use crate::features;
use metal::{Buffer, Texture, TextureDescriptor};
use splatgraph_api::{BackendError, DeviceInfo, DeviceMemory, Options, Validation};
use splatgraph_framework::ir::Format;
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{
    BufferDesc, Common, FormatSupport, Gpu, ImageDesc, NextPipeline, Requirements, Window,
};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

impl Gpu for MetalGpu {
    type Memory = Memory;
    // A heap creates a buffer or an image from its description.
    type UnboundBuffer = ();
    type UnboundImage = TextureDescriptor;
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
        chosen: &mut dyn FnMut(&DeviceInfo),
    ) -> Result<(DeviceInfo, Arc<Self>), BackendError> {
        check_validation(options.validation)?;
        let physical = device::choose(device::all(), options.device.as_deref())?;
        let info = physical.info.clone();
        chosen(&info);
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

    fn create_buffer(self: &Arc<Self>, desc: &BufferDesc) -> Result<((), Requirements), BackendError> {
        Ok(((), memory::buffer_requirements(self, desc)))
    }

    fn create_image(
        self: &Arc<Self>,
        desc: &ImageDesc,
    ) -> Result<(TextureDescriptor, Requirements), BackendError> {
        Ok(memory::create_image(self, desc))
    }

    fn bind_buffer(
        self: &Arc<Self>,
        desc: &BufferDesc,
        (): (),
        memory: &Memory,
    ) -> Result<Buffer, BackendError> {
        objc::pool(|| memory::bind_buffer(desc, memory))
    }

    fn bind_image(
        self: &Arc<Self>,
        desc: &ImageDesc,
        image: TextureDescriptor,
        memory: &Memory,
    ) -> Result<Texture, BackendError> {
        objc::pool(|| memory::bind_image(desc.name, &image, memory))
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

    fn create_timestamps(self: &Arc<Self>, count: u32) -> Result<Option<Timestamps>, BackendError> {
        Ok(Some(Timestamps::new(self, count)))
    }

    fn read_timestamps(&self, timestamps: &Timestamps, count: u32) -> Result<Vec<Option<u64>>, BackendError> {
        Ok(timestamps.read(count))
    }

    fn window_size(&self, wanted: (u32, u32)) -> Result<Option<(u32, u32)>, BackendError> {
        Ok((wanted.0 > 0 && wanted.1 > 0).then_some(wanted))
    }

    /// Does nothing: a layer is never lost.
    fn renew_surface(&self) -> Result<(), BackendError> {
        Ok(())
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
