//! Implements a device that executes nothing, with its objects.

use crate::fault::{Fault, Point};
use crate::journal::{Call, Journal, Object, Owned, Used};
use splatgraph_api::{BackendError, DeviceInfo, Heap, Robustness};
use splatgraph_framework::ir::{Binding, PassId};
use splatgraph_framework::plan::{LayoutChange, Plan, Since};
use splatgraph_runtime::{
    Acquired, BindingTarget, Common, Image, Limits, Location, Presented, Requirements, binding_copies,
};
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Options for opening a null device.
#[derive(Clone, Debug)]
pub struct Config {
    /// The device's limits.
    pub limits: Limits,
    /// Size of the window in pixels; `None` for a device without a window.
    pub window: Option<(u32, u32)>,
    /// Bytes of device memory reported as available at first; `None` if unknown. Allocations may exceed it.
    pub budget: Option<u64>,
    /// The calls that fail.
    pub faults: Vec<Fault>,
    /// False to leave the journal's list of calls empty, for a device whose calls nobody reads.
    pub records: bool,
    /// Time limit of one pass; see [`splatgraph_api::Options::patience`].
    pub patience: Duration,
    /// Time limit for compiling one pipeline; see [`splatgraph_api::Options::compile_patience`].
    pub compile_patience: Duration,
    /// The word that fills all data read by the host: statistics, pictures and inspected resources.
    pub read: u32,
}

impl Default for Config {
    fn default() -> Config {
        Config {
            limits: limits(),
            window: None,
            budget: None,
            faults: Vec::new(),
            records: true,
            patience: Duration::from_millis(20),
            // Long enough for a thread to be scheduled on a busy machine.
            compile_patience: Duration::from_secs(1),
            read: 0,
        }
    }
}

/// An open device that executes nothing; see [`crate::Null`].
pub struct NullGpu {
    pub(crate) common: Common,
    pub(crate) budget: Option<u64>,
    pub(crate) read: u32,
    pub(crate) journal: Journal,
    pub(crate) used: Arc<AtomicU64>,
    pub(crate) tick: AtomicU64,
    _owned: Owned,
}

/// Returns the limits of the device that [`Config::default`] opens.
pub fn limits() -> Limits {
    Limits::desktop()
}

impl NullGpu {
    pub(crate) fn new(config: &Config) -> (DeviceInfo, Arc<NullGpu>) {
        let journal = Journal::new(&config.faults, config.records);
        let info = DeviceInfo {
            index: 0,
            name: "null".to_string(),
            kind: "other".to_string(),
            driver: String::new(),
            facts: config.limits.facts,
            robustness: Robustness::default(),
            heap: Heap { bytes: config.limits.heap_bytes, available: config.budget },
            unfit: None,
        };
        let gpu = NullGpu {
            common: Common {
                limits: config.limits.clone(),
                is_cpu: false,
                messages: journal.messages().clone(),
                patience: config.patience,
                compile_patience: config.compile_patience,
            },
            budget: config.budget,
            read: config.read,
            used: Arc::default(),
            tick: AtomicU64::new(1),
            _owned: journal.create(Object::Device, "null"),
            journal,
        };
        (info, Arc::new(gpu))
    }

    pub(crate) fn create(&self, object: Object, name: &str) -> Result<Owned, BackendError> {
        if self.journal.fails(Point::Create) {
            let reason = format!("a fault prevents the creation of {object:?}");
            return Err(BackendError::OutOfMemory { name: name.to_string(), bytes: 0, reason });
        }
        Ok(self.journal.create(object, name))
    }

    pub(crate) fn check_lost(&self, call: &str) -> Result<(), BackendError> {
        if self.journal.is_lost() {
            return Err(BackendError::DeviceLost(format!("{call} found the device lost")));
        }
        Ok(())
    }
}

/// A memory allocation. It is mapped unless its [location](splatgraph_runtime::Location) is `Device` or `Host`.
pub struct Memory {
    pub(crate) bytes: u64,
    pub(crate) mapped: Vec<u8>,
    pub(crate) used: Arc<AtomicU64>,
    _owned: Owned,
}

impl splatgraph_runtime::Memory<NullGpu> for Memory {
    fn allocate(
        gpu: &Arc<NullGpu>,
        name: &str,
        requirements: &Requirements,
        location: Location,
    ) -> Result<Memory, BackendError> {
        let (name, bytes) = (name.to_string(), requirements.size);
        if gpu.journal.fails(Point::Allocate) {
            let reason = "a fault prevents the allocation".to_string();
            return Err(BackendError::OutOfMemory { name, bytes, reason });
        }
        let _owned = gpu.journal.create(Object::Memory, &name);
        gpu.journal.call(Call::Allocate { name, bytes, location });
        gpu.used.fetch_add(bytes, Ordering::Relaxed);
        let mapped = match location {
            Location::Device | Location::Host => Vec::new(),
            Location::Readback => gpu.read.to_le_bytes().into_iter().cycle().take(bytes as usize).collect(),
            _ => vec![0; bytes as usize],
        };
        Ok(Memory { bytes, mapped, used: gpu.used.clone(), _owned })
    }

    fn bytes(&self) -> u64 {
        self.bytes
    }

    fn mapped(&self) -> &[u8] {
        &self.mapped
    }

    fn mapped_mut(&mut self) -> &mut [u8] {
        &mut self.mapped
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        self.used.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// For each (binding, element), the number of the object that is bound.
pub(crate) type Targets = HashMap<(u32, u32), u64>;

/// The dependencies and layout changes before each pass and in the handover, from the plan.
pub struct Synchronization {
    /// For each pass, then for the handover, the number of dependencies and the layout changes.
    waits: Vec<(usize, Vec<LayoutChange>)>,
}

impl Synchronization {
    pub(crate) fn new(plan: &Plan) -> Synchronization {
        let handover = plan.dependencies.iter().filter(|dependency| dependency.since == Since::Prologue);
        let ids = (0..plan.passes.len() as u32).map(PassId);
        let passes = ids.map(|id| (plan.dependencies_of(id).len(), Some(id)));
        let waits = passes.chain([(handover.count(), None)]);
        let waits = waits.map(|(count, at)| (count, plan.layout_changes_at(at).copied().collect()));
        Synchronization { waits: waits.collect() }
    }

    pub(crate) fn at(&self, at: Option<PassId>) -> &(usize, Vec<LayoutChange>) {
        &self.waits[at.map_or(self.waits.len() - 1, PassId::index)]
    }
}

/// The bindings of one plan.
pub struct Bindings {
    pub(crate) owned: Owned,
    /// The bound objects by pass, then by copy.
    pub(crate) passes: HashMap<PassId, Vec<Targets>>,
    pub(crate) names: Vec<String>,
}

impl splatgraph_runtime::Bindings<NullGpu> for Bindings {
    fn new(gpu: &Arc<NullGpu>, plan: &Plan, _: &Owned) -> Result<Bindings, BackendError> {
        let copies = |id| vec![HashMap::new(); binding_copies(plan, plan.pass(id))];
        Ok(Bindings {
            owned: gpu.create(Object::Bindings, &plan.name)?,
            passes: plan.order().map(|id| (id, copies(id))).collect(),
            names: plan.passes.iter().map(|pass| pass.name.clone()).collect(),
        })
    }

    fn write(
        &mut self,
        gpu: &NullGpu,
        pass: PassId,
        copy: usize,
        binding: &Binding,
        target: BindingTarget<NullGpu>,
    ) {
        let name = &self.names[pass.index()];
        let used = Used::Bindings(self.owned.number, pass.0, copy);
        gpu.journal.check_unused(used, || format!("a binding of pass `{name}` is written"));
        let (object, bytes) = match target {
            BindingTarget::Buffer(buffer, bytes) => (&buffer.raw, Some(bytes.end - bytes.start)),
            BindingTarget::Image(image) => (&image.raw, None),
        };
        gpu.journal.call(Call::WriteBinding { pass: name.clone(), copy, target: object.name.clone(), bytes });
        if let Some(copies) = self.passes.get_mut(&pass) {
            copies[copy].insert((binding.binding, binding.element), object.number);
        }
    }
}

/// A swapchain of three images, which are acquired in turn.
pub struct Swapchain {
    _owned: Owned,
    next: u32,
    gpu: Arc<NullGpu>,
}

impl splatgraph_runtime::Swapchain<NullGpu> for Swapchain {
    fn new(
        gpu: &Arc<NullGpu>,
        size: (u32, u32),
        vsync: bool,
        _: Option<&Swapchain>,
    ) -> Result<Swapchain, BackendError> {
        gpu.journal.call(Call::CreateSwapchain { size, vsync });
        Ok(Swapchain { _owned: gpu.create(Object::Swapchain, "swapchain")?, next: 0, gpu: gpu.clone() })
    }

    fn acquire(&mut self, slot: usize) -> Result<Acquired, BackendError> {
        self.gpu.check_lost("acquire")?;
        self.gpu.journal.call(Call::Acquire { slot });
        if self.gpu.journal.fails(Point::AcquireLost) {
            return Err(BackendError::SurfaceLost { call: "acquire" });
        }
        if self.gpu.journal.fails(Point::AcquireOutOfDate) {
            return Ok(Acquired::OutOfDate);
        }
        if self.gpu.journal.fails(Point::AcquireTimeout) {
            return Ok(Acquired::NotReady);
        }
        self.next = (self.next + 1) % 3;
        let suboptimal = self.gpu.journal.fails(Point::AcquireSuboptimal);
        Ok(Acquired::Image { index: self.next, suboptimal })
    }

    fn record_blit(
        &mut self,
        image: u32,
        _: usize,
        output: &Image<NullGpu>,
        _: &Plan,
        _: &Synchronization,
    ) -> Result<(), BackendError> {
        self.gpu.journal.call(Call::RecordBlit { output: output.raw.name.clone(), image });
        Ok(())
    }

    fn present(&mut self, image: u32) -> Result<Presented, BackendError> {
        self.gpu.check_lost("present")?;
        self.gpu.journal.call(Call::Present { image });
        if self.gpu.journal.fails(Point::Present) {
            self.gpu.journal.lose();
            self.gpu.check_lost("present")?;
        }
        if self.gpu.journal.fails(Point::PresentLost) {
            return Err(BackendError::SurfaceLost { call: "present" });
        }
        if self.gpu.journal.fails(Point::PresentSuboptimal) {
            return Ok(Presented::Suboptimal);
        }
        Ok(if self.gpu.journal.fails(Point::PresentOutOfDate) {
            Presented::OutOfDate
        } else {
            Presented::Shown
        })
    }
}

/// A set of timestamps in ticks; `None` for those not written yet.
pub(crate) type Ticks = Arc<Mutex<Vec<Option<u64>>>>;

/// A set of timestamps, counted as an object.
pub struct Timestamps {
    pub(crate) _owned: Owned,
    pub(crate) ticks: Ticks,
}
