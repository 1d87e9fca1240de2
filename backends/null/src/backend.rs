//! Implements the runtime's [`Gpu`](splatgraph_runtime::Gpu) trait with the null device.

use crate::encoder::Encoder;
use crate::fault::Point;
use crate::gpu::{Bindings, Config, Memory, NullGpu, Swapchain, Synchronization, Timestamps};
use crate::journal::{Call, Object, Owned};
use splatgraph_api::{BackendError, DeviceInfo, DeviceMemory, Options};
use splatgraph_framework::ir::Format;
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{
    BufferDesc, Common, FormatSupport, Gpu, ImageDesc, MemoryKind, NextPipeline, PipelineStates,
    Requirements, Window, lock,
};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

impl Gpu for NullGpu {
    type Memory = Memory;
    type UnboundBuffer = Owned;
    type UnboundImage = Owned;
    type Buffer = Owned;
    type Image = Owned;
    type Synchronization = Synchronization;
    type Pipelines = Owned;
    type Bindings = Bindings;
    type Timestamps = Timestamps;
    type Encoder = Encoder;
    type Swapchain = Swapchain;

    fn devices() -> Result<Vec<DeviceInfo>, BackendError> {
        Ok(vec![NullGpu::new(&Config::default()).0])
    }

    fn open(
        _: &Options,
        _: Option<Arc<dyn Window>>,
        chosen: &mut dyn FnMut(&DeviceInfo),
    ) -> Result<(DeviceInfo, Arc<Self>), BackendError> {
        let (info, gpu) = NullGpu::new(&Config::default());
        chosen(&info);
        Ok((info, gpu))
    }

    fn common(&self) -> &Common {
        &self.common
    }

    fn memory(&self) -> DeviceMemory {
        let used = self.used.load(Ordering::Relaxed);
        DeviceMemory { used, reserved: used }
    }

    fn available(&self) -> Option<u64> {
        Some(self.budget?.saturating_sub(self.used.load(Ordering::Relaxed)))
    }

    fn format_support(&self, _: Format) -> FormatSupport {
        FormatSupport { storage: true, target: true, blend: true, blit: true }
    }

    fn wait_idle(&self, limit: Duration) -> bool {
        self.journal.call(Call::WaitIdle);
        if self.journal.is_hung(None) {
            std::thread::sleep(limit.min(self.common.patience));
            return false;
        }
        self.journal.complete(None);
        true
    }

    fn create_buffer(self: &Arc<Self>, desc: &BufferDesc) -> Result<(Owned, Requirements), BackendError> {
        let buffer = self.create(Object::Buffer, desc.name)?;
        let kind = MemoryKind::Linear;
        Ok((buffer, Requirements { size: desc.bytes, alignment: 16, types: 1, kind }))
    }

    fn create_image(self: &Arc<Self>, desc: &ImageDesc) -> Result<(Owned, Requirements), BackendError> {
        let image = self.create(Object::Image, desc.name)?;
        let pixels = desc.size.0 as u64 * desc.size.1 as u64;
        let size = pixels * desc.format.bytes_per_pixel() as u64;
        Ok((image, Requirements { size, alignment: 64, types: 1, kind: MemoryKind::Optimal }))
    }

    fn bind_buffer(
        self: &Arc<Self>,
        _: &BufferDesc,
        buffer: Owned,
        _: &Memory,
    ) -> Result<Owned, BackendError> {
        Ok(buffer)
    }

    fn bind_image(self: &Arc<Self>, _: &ImageDesc, image: Owned, _: &Memory) -> Result<Owned, BackendError> {
        Ok(image)
    }

    fn synchronization(plan: &Plan) -> Result<Synchronization, BackendError> {
        Ok(Synchronization::new(plan))
    }

    fn create_pipelines(
        self: &Arc<Self>,
        plan: &Plan,
        next: &mut dyn FnMut(NextPipeline) -> Result<(), BackendError>,
    ) -> Result<Owned, BackendError> {
        let pipelines = PipelineStates::new(plan, |_| ());
        for done in 0..pipelines.states.len() {
            next(pipelines.next(done))?;
            self.journal.compile();
        }
        self.create(Object::Pipelines, &plan.name)
    }

    fn create_timestamps(self: &Arc<Self>, count: u32) -> Result<Option<Timestamps>, BackendError> {
        if self.common.limits.timestamp_bits == 0 {
            return Ok(None);
        }
        let ticks = Arc::new(Mutex::new(vec![None; count as usize]));
        Ok(Some(Timestamps { _owned: self.create(Object::Timestamps, "timestamps")?, ticks }))
    }

    fn read_timestamps(&self, timestamps: &Timestamps, count: u32) -> Result<Vec<Option<u64>>, BackendError> {
        let ticks = lock(&timestamps.ticks);
        Ok(ticks[..count as usize].to_vec())
    }

    fn window_size(&self, wanted: (u32, u32)) -> Result<Option<(u32, u32)>, BackendError> {
        if self.journal.fails(Point::Surface) {
            return Err(BackendError::SurfaceLost { call: "window_size" });
        }
        Ok((wanted.0 > 0 && wanted.1 > 0).then_some(wanted))
    }

    fn renew_surface(&self) -> Result<(), BackendError> {
        self.journal.call(Call::RenewSurface);
        Ok(())
    }
}
