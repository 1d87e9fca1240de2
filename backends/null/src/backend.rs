//! Implements the runtime's [`Gpu`](splatgraph_runtime::Gpu) trait with the null device.

use crate::encoder::Encoder;
use crate::fault::Point;
use crate::gpu::{Bindings, Config, Memory, NullGpu, Swapchain, Synchronization, Timestamps};
use crate::journal::{Call, Hung, Object, Owned, Used};
use splatgraph_api::{BackendError, DeviceInfo, DeviceMemory, Options};
use splatgraph_framework::ir::{Binding, Format, PassId};
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{
    Acquired, BindingTarget, BufferDesc, Common, FormatSupport, Gpu, ImageDesc, Location, MemoryKind,
    NextPipeline, PipelineStates, Presented, Requirements, Show, Window, binding_copies,
};
use std::collections::HashMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
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

    fn open(_: &Options, _: Option<Arc<dyn Window>>) -> Result<(DeviceInfo, Arc<Self>), BackendError> {
        Ok(NullGpu::new(&Config::default()))
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

    fn allocate(
        self: &Arc<Self>,
        name: &str,
        requirements: &Requirements,
        location: Location,
    ) -> Result<Memory, BackendError> {
        let (name, bytes) = (name.to_string(), requirements.size);
        if self.journal.fails(Point::Allocate) {
            let reason = "a fault prevents the allocation".to_string();
            return Err(BackendError::OutOfMemory { name, bytes, reason });
        }
        let owned = self.journal.create(Object::Memory, &name);
        self.journal.call(Call::Allocate { name, bytes, location });
        self.used.fetch_add(bytes, Ordering::Relaxed);
        let mapped = match location {
            Location::Device | Location::Host => Vec::new(),
            Location::Readback => self.read.to_le_bytes().into_iter().cycle().take(bytes as usize).collect(),
            _ => vec![0; bytes as usize],
        };
        Ok(Memory { bytes, mapped, used: self.used.clone(), owned })
    }

    fn bind_buffer(self: &Arc<Self>, buffer: Owned, memory: &Memory) -> Result<Owned, BackendError> {
        let (name, memory) = (buffer.name.clone(), memory.owned.name.clone());
        self.journal.call(Call::Bind { object: Object::Buffer, name, memory });
        Ok(buffer)
    }

    fn bind_image(self: &Arc<Self>, image: Owned, memory: &Memory) -> Result<Owned, BackendError> {
        let (name, memory) = (image.name.clone(), memory.owned.name.clone());
        self.journal.call(Call::Bind { object: Object::Image, name, memory });
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

    fn create_bindings(self: &Arc<Self>, plan: &Plan, _: &Owned) -> Result<Bindings, BackendError> {
        let copies = |id| vec![HashMap::new(); binding_copies(plan, plan.pass(id))];
        Ok(Bindings {
            owned: self.create(Object::Bindings, &plan.name)?,
            passes: plan.order().map(|id| (id, copies(id))).collect(),
            names: plan.passes.iter().map(|pass| pass.name.clone()).collect(),
        })
    }

    fn write_binding(
        &self,
        bindings: &mut Bindings,
        pass: PassId,
        copy: usize,
        binding: &Binding,
        target: BindingTarget<Self>,
    ) {
        let name = &bindings.names[pass.index()];
        let used = Used::Bindings(bindings.owned.number, pass.0, copy);
        self.journal.check_unused(used, || format!("a binding of pass `{name}` is written"));
        let (object, bytes) = match target {
            BindingTarget::Buffer(buffer, bytes) => (&buffer.raw, Some(bytes.end - bytes.start)),
            BindingTarget::Image(image) => (&image.raw, None),
        };
        self.journal.call(Call::WriteBinding {
            pass: name.clone(),
            copy,
            block: binding.name.clone(),
            kind: binding.kind,
            target: object.name.clone(),
            bytes,
        });
        if let Some(copies) = bindings.passes.get_mut(&pass) {
            copies[copy].insert((binding.binding, binding.element), object.number);
        }
    }

    fn create_timestamps(self: &Arc<Self>, count: u32) -> Result<Option<Timestamps>, BackendError> {
        if self.common.limits.timestamp_bits == 0 {
            return Ok(None);
        }
        let ticks = Arc::new(Mutex::new(vec![None; count as usize]));
        Ok(Some(Timestamps { _owned: self.create(Object::Timestamps, "timestamps")?, ticks }))
    }

    fn read_timestamps(&self, timestamps: &Timestamps, count: u32) -> Result<Vec<Option<u64>>, BackendError> {
        let ticks = timestamps.ticks.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(ticks[..count as usize].to_vec())
    }

    fn create_encoder(self: &Arc<Self>, name: &str) -> Result<Encoder, BackendError> {
        Ok(Encoder::new(self.create(Object::Encoder, name)?))
    }

    fn submit(&self, encoder: &mut Encoder, show: Option<Show<Self>>) -> Result<(), BackendError> {
        self.check_lost("submit")?;
        let show = show.map(|show| show.image);
        self.journal.call(Call::Submit { encoder: encoder.owned.name.clone(), show });
        if self.journal.fails(Point::Submit) {
            self.journal.lose();
            return self.check_lost("submit");
        }
        let lost = self.journal.fails(Point::Execute);
        let hung = self.journal.hangs();
        let written = match (lost || hung.is_some(), hung) {
            (_, Some(Hung::Behind)) => 0,
            (true, _) => encoder.timestamps.len() / 2,
            (false, _) => encoder.timestamps.len(),
        };
        for (ticks, index) in &encoder.timestamps[..written] {
            let tick = self.tick.fetch_add(1, Ordering::Relaxed);
            ticks.lock().unwrap_or_else(PoisonError::into_inner)[*index as usize] = Some(tick);
        }
        if lost {
            self.journal.lose();
        } else {
            self.journal.submit(&encoder.owned, std::mem::take(&mut encoder.used), hung.is_some());
        }
        if self.journal.fails(Point::LateSubmit) {
            std::thread::sleep(Duration::from_millis(50));
        }
        Ok(())
    }

    fn wait(&self, encoder: &mut Encoder, limit: Duration) -> Result<bool, BackendError> {
        self.journal.call(Call::Wait { encoder: encoder.owned.name.clone(), blocks: !limit.is_zero() });
        self.check_lost("wait")?;
        if self.journal.fails(Point::Wait) {
            let reason = "a fault prevents the wait".to_string();
            return Err(BackendError::OutOfMemory { name: "a wait".to_string(), bytes: 0, reason });
        }
        if self.journal.is_hung(Some(&encoder.owned)) {
            std::thread::sleep(limit);
            return Ok(false);
        }
        self.journal.complete(Some(&encoder.owned));
        Ok(true)
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

    fn create_swapchain(
        self: &Arc<Self>,
        size: (u32, u32),
        vsync: bool,
        _: Option<&Swapchain>,
    ) -> Result<Swapchain, BackendError> {
        self.journal.call(Call::CreateSwapchain { size, vsync });
        Ok(Swapchain { _owned: self.create(Object::Swapchain, "swapchain")?, next: 0 })
    }

    fn acquire(&self, swapchain: &mut Swapchain, slot: usize) -> Result<Acquired, BackendError> {
        self.check_lost("acquire")?;
        self.journal.call(Call::Acquire { slot });
        if self.journal.fails(Point::AcquireLost) {
            return Err(BackendError::SurfaceLost { call: "acquire" });
        }
        if self.journal.fails(Point::AcquireOutOfDate) {
            return Ok(Acquired::OutOfDate);
        }
        if self.journal.fails(Point::AcquireTimeout) {
            return Ok(Acquired::NotReady);
        }
        swapchain.next = (swapchain.next + 1) % 3;
        let suboptimal = self.journal.fails(Point::AcquireSuboptimal);
        Ok(Acquired::Image { index: swapchain.next, suboptimal })
    }

    fn record_blit(
        &self,
        show: Show<Self>,
        output: &splatgraph_runtime::Image<Self>,
        _: &Plan,
        _: &Synchronization,
    ) -> Result<(), BackendError> {
        self.journal.call(Call::RecordBlit { output: output.raw.name.clone(), image: show.image });
        Ok(())
    }

    fn present(&self, show: Show<Self>) -> Result<Presented, BackendError> {
        self.check_lost("present")?;
        self.journal.call(Call::Present { image: show.image });
        if self.journal.fails(Point::Present) {
            self.journal.lose();
            self.check_lost("present")?;
        }
        if self.journal.fails(Point::PresentLost) {
            return Err(BackendError::SurfaceLost { call: "present" });
        }
        if self.journal.fails(Point::PresentSuboptimal) {
            return Ok(Presented::Suboptimal);
        }
        Ok(if self.journal.fails(Point::PresentOutOfDate) { Presented::OutOfDate } else { Presented::Shown })
    }
}
