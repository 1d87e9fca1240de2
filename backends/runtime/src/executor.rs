//! Implements the executor: a device, the plan that it executes, and its frames in flight.

use crate::check::invalid;
use crate::compiled::CompiledPlan;
use crate::frame::{Frame, Pending, Slot};
use crate::gpu::{Gpu, Memory, Window};
use crate::history::Start;
use crate::loader::{Loader, Ready};
use crate::outputs::SharedOutput;
use crate::shared::Shared;
use crate::timing::lost_in;
use crate::window::Swapchain;
use raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use splatgraph_api::{
    BackendError, Device, DeviceInfo, DeviceMemory, FRAMES_IN_FLIGHT, FrameId, FrameInputs, FrameResult,
    Heap, Options, Picture, Running,
};
use splatgraph_framework::shader::Cancel;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Maximum number of results kept for the caller. Older ones are dropped, so that a caller that never waits does not
/// leak.
const MAX_RESULTS: usize = 64;

/// Name of the memory entry for objects that only frames in flight still need. They are former plans, readback buffers
/// of inspected resources, and replaced shared outputs.
const IN_FLIGHT: &str = "frames in flight";

/// An open device and the plan that it executes.
///
/// Several executors can share one device ([`Device::new_context`]), with its queue, the scene's planes and the
/// validation messages. If one of them finds the device lost, all report the loss. Each executor has its own plan,
/// frames, results and shared output, and can be used from its own thread.
///
/// Dropping it waits until the device is idle, then destroys the executor's objects. If the wait exceeds the device's
/// patience, the objects are kept until the device is idle. The device is closed with its last executor, [`Loader`],
/// [`Ready`], [`Compiled`](splatgraph_api::Compiled) or abandoned compiler thread.
pub struct Executor<G: Gpu> {
    id: u64,
    info: DeviceInfo,
    compiled: Option<CompiledPlan<G>>,
    /// Replaced plans with frames still in flight. They are dropped when the frames are collected.
    former: Vec<CompiledPlan<G>>,
    plans: u64,
    slots: Vec<Slot<G>>,
    results: BTreeMap<FrameId, FrameResult>,
    next: u64,
    output: Option<Arc<SharedOutput<G>>>,
    swapchain: Option<Swapchain<G>>,
    /// See [`Device::missed_window`].
    missed_window: bool,
    shared: Arc<Shared<G>>,
}

impl<G: Gpu> Executor<G> {
    /// Lists the machine's devices.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] if the API is not installed.
    pub fn devices() -> Result<Vec<DeviceInfo>, BackendError> {
        G::devices()
    }

    /// Opens a device.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`], with what to install, if a driver, the validation layer or a usable device is
    /// missing.
    pub fn open(options: &Options) -> Result<Self, BackendError> {
        Self::open_telling(options, &mut |_| {})
    }

    /// Opens a device, and calls `chosen` with its description before the device is created, which takes long.
    ///
    /// # Errors
    /// See [`Executor::open`].
    pub fn open_telling(
        options: &Options,
        chosen: &mut dyn FnMut(&DeviceInfo),
    ) -> Result<Self, BackendError> {
        let (info, gpu) = G::open(options, None, chosen)?;
        Self::new(info, gpu)
    }

    /// Opens a device that can present to `window`, whose current size is `size` pixels (width, height).
    ///
    /// The window is kept until the device and all executors [on it](Device::new_context) are closed.
    ///
    /// # Errors
    /// The errors of [`Executor::open`], and [`BackendError::Unavailable`] if no device can present to the window.
    pub fn open_in_window<W>(
        options: &Options,
        window: Arc<W>,
        size: (u32, u32),
    ) -> Result<Self, BackendError>
    where
        W: HasDisplayHandle + HasWindowHandle + Send + Sync + 'static,
    {
        let window: Arc<dyn Window> = window;
        let (info, gpu) = G::open(options, Some(window), &mut |_| {})?;
        Self::in_window(info, gpu, size)
    }

    /// Creates an executor without a window on an open device.
    pub fn new(info: DeviceInfo, gpu: Arc<G>) -> Result<Self, BackendError> {
        Self::on(info, Shared::new(gpu))
    }

    /// Creates an executor on a device that was opened with a window of `size` pixels.
    pub fn in_window(info: DeviceInfo, gpu: Arc<G>, size: (u32, u32)) -> Result<Self, BackendError> {
        let swapchain = Swapchain::new(&gpu, size)?;
        let mut executor = Self::new(info, gpu)?;
        executor.swapchain = Some(swapchain);
        Ok(executor)
    }

    fn on(info: DeviceInfo, shared: Arc<Shared<G>>) -> Result<Self, BackendError> {
        static EXECUTORS: AtomicU64 = AtomicU64::new(0);
        let slots = (0..FRAMES_IN_FLIGHT).map(|_| Slot::new(&shared.gpu)).collect::<Result<_, _>>()?;
        Ok(Executor {
            id: EXECUTORS.fetch_add(1, Ordering::Relaxed),
            info,
            compiled: None,
            former: Vec::new(),
            plans: 0,
            slots,
            results: BTreeMap::new(),
            next: 0,
            output: None,
            swapchain: None,
            missed_window: false,
            shared,
        })
    }

    /// Drops the executor, and returns the remaining validation messages of the device.
    ///
    /// For the device's last executor, these include the messages of closing the device, such as an object that was not
    /// destroyed.
    pub fn close(self) -> Vec<String> {
        let messages = self.shared.gpu.common().messages.clone();
        drop(self);
        messages.take()
    }

    /// Reports the memory of the device across its executors: the entries of [`Device::memory`], and the memory of
    /// plans being prepared. Shared memory counts once.
    pub fn device_memory(&self) -> DeviceMemory {
        self.shared.gpu.memory()
    }

    /// Moves the result of the slot's frame, if there is one, to `results`. If `patient`, blocks until the frame has
    /// completed; otherwise leaves an unfinished frame alone.
    fn collect(&mut self, slot: usize, patient: bool) -> Result<(), BackendError> {
        let Some(Pending { plan: number, prologue, .. }) = self.slots[slot].pending else { return Ok(()) };
        let Some(compiled) = plan(&self.compiled, &self.former, number) else { return Ok(()) };
        let collected = self.slots[slot].collect(&self.shared, compiled, slot, patient);
        if let Some((frame, result)) = collected.map_err(|error| self.losing(error))? {
            if prologue {
                let plans = self.compiled.iter_mut().chain(&mut self.former);
                plans.filter(|compiled| compiled.number == number).for_each(CompiledPlan::end_prologue);
            }
            self.results.insert(frame, result);
            if self.results.len() > MAX_RESULTS {
                self.results.pop_first();
            }
        }
        self.drop_former();
        Ok(())
    }

    fn drop_former(&mut self) {
        let pending: Vec<u64> = self.slots.iter().flat_map(|slot| &slot.pending).map(|p| p.plan).collect();
        self.former.retain(|compiled| pending.contains(&compiled.number));
    }

    fn slot_of(&self, frame: FrameId) -> Option<usize> {
        let pending = |slot: &Slot<G>| slot.pending.as_ref().is_some_and(|pending| pending.frame == frame);
        self.slots.iter().position(pending)
    }

    fn next_slot(&self) -> usize {
        (self.next % FRAMES_IN_FLIGHT as u64) as usize
    }

    fn take_result(&mut self, frame: FrameId) -> Result<FrameResult, BackendError> {
        match self.results.remove(&frame) {
            Some(result) => Ok(result),
            None => invalid(format!(
                "frame {} has no result: it was never submitted, its result was taken, or {MAX_RESULTS} newer results wait",
                frame.0
            )),
        }
    }

    fn losing(&self, error: BackendError) -> BackendError {
        self.shared.losing(error, || self.where_lost())
    }

    /// Describes where the device stopped: in the first pending frame not known to be complete, else after the last.
    /// `None` if no frame is pending.
    fn where_lost(&self) -> Option<String> {
        let mut place = None;
        for back in 0..FRAMES_IN_FLIGHT as u64 {
            let slot = (self.next + back) as usize % FRAMES_IN_FLIGHT;
            let Some(pending) = &self.slots[slot].pending else { continue };
            let compiled = plan(&self.compiled, &self.former, pending.plan)?;
            let names: Vec<&str> =
                pending.passes.iter().map(|&pass| compiled.plan.pass(pass).name.as_str()).collect();
            let timestamps = compiled.timestamps[slot].as_deref();
            let finished = self.slots[slot].finished(&self.shared.gpu, timestamps);
            place = Some(lost_in(pending.frame, &names, finished.as_deref()));
            if !finished.is_some_and(|finished| finished.iter().all(|&done| done)) {
                break;
            }
        }
        place
    }
}

fn plan<'a, G: Gpu>(
    current: &'a Option<CompiledPlan<G>>,
    former: &'a [CompiledPlan<G>],
    number: u64,
) -> Option<&'a CompiledPlan<G>> {
    current.iter().chain(former).find(|compiled| compiled.number == number)
}

impl<G: Gpu> Device for Executor<G> {
    type Loader = Loader<G>;

    fn info(&self) -> &DeviceInfo {
        &self.info
    }

    fn new_context(&self) -> Result<Self, BackendError> {
        self.shared.check_lost()?;
        Self::on(self.info.clone(), self.shared.clone())
    }

    fn shares_device(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.shared, &other.shared)
    }

    fn loader(&self) -> Loader<G> {
        Loader {
            shared: self.shared.clone(),
            executor: self.id,
            cancel: Cancel::default(),
            share_results: false,
            histories: Start::Current,
            synchronization: None,
        }
    }

    /// Swaps to a prepared plan, which continues state as its `Start` says. It takes state over from the plan that is
    /// current now, not from the plan that was current when the loader was taken.
    fn swap(&mut self, ready: Ready<G>) -> Result<(), BackendError> {
        self.shared.check_lost()?;
        let Ready { mut compiled, histories, executor } = ready;
        if executor != self.id {
            return invalid(format!("`{}` was prepared for another executor", compiled.plan.name));
        }
        let former = match (histories, &self.compiled) {
            (Start::Current | Start::Grown, Some(former)) => former.histories(),
            (Start::Saved, Some(former)) => former.saved_histories(),
            (Start::Zeros, _) | (_, None) => Vec::new(),
        };
        compiled.follow(&self.shared.gpu, self.plans, (histories, &former));
        self.plans += 1;
        // Frames of the replaced plan may still be running.
        self.former.extend(self.compiled.replace(compiled));
        self.drop_former();
        Ok(())
    }

    fn picture(&self) -> Option<Picture> {
        self.output.as_ref().map(|own| own.picture)
    }

    fn submit(&mut self, inputs: &FrameInputs) -> Result<FrameId, BackendError> {
        self.shared.check_lost()?;
        let frame = FrameId(self.next);
        let slot = self.next_slot();
        self.collect(slot, true)?;
        let Some(compiled) = &mut self.compiled else {
            return invalid("a frame was submitted before a plan was loaded".to_string());
        };
        let output = match compiled.resources.image(compiled.plan.output) {
            Some(image) if inputs.show => {
                Some(self.shared.outputs.target(&self.shared.gpu, image, self.output.as_ref())?)
            }
            _ => None,
        };
        let swapchain = self.swapchain.as_mut().filter(|_| inputs.present);
        let request = Frame { id: frame, slot, inputs, output: output.as_ref(), swapchain };
        let submitted = self.slots[slot].submit(&self.shared, compiled, request);
        let image = submitted.map_err(|error| self.losing(error))?;
        self.next += 1;
        if let Some(output) = output {
            // From here on other executors can read it: their frames come later in the queue.
            self.shared.outputs.enter(&output, self.output.as_ref());
            self.output = Some(output);
        }
        self.missed_window = self.swapchain.is_some() && inputs.present;
        if let (Some(swapchain), Some(image)) = (&mut self.swapchain, image) {
            self.missed_window = !swapchain.present(image).map_err(|error| self.losing(error))?;
        }
        Ok(frame)
    }

    fn missed_window(&self) -> bool {
        self.missed_window
    }

    fn resize_window(&mut self, width: u32, height: u32) {
        if let Some(swapchain) = &mut self.swapchain {
            swapchain.resize((width, height));
        }
    }

    fn set_vsync(&mut self, vsync: bool) {
        if let Some(swapchain) = &mut self.swapchain {
            swapchain.set_vsync(vsync);
        }
    }

    fn wait(&mut self, frame: FrameId) -> Result<FrameResult, BackendError> {
        if let Some(slot) = self.slot_of(frame) {
            self.shared.check_lost()?;
            self.collect(slot, true)?;
        }
        self.take_result(frame)
    }

    fn try_wait(&mut self, frame: FrameId) -> Result<Option<FrameResult>, BackendError> {
        if let Some(slot) = self.slot_of(frame) {
            self.shared.check_lost()?;
            self.collect(slot, false)?;
            if self.slot_of(frame).is_some() {
                return Ok(None);
            }
        }
        self.take_result(frame).map(Some)
    }

    fn is_ready(&mut self) -> Result<bool, BackendError> {
        self.shared.check_lost()?;
        let slot = self.next_slot();
        self.collect(slot, false)?;
        Ok(self.slots[slot].pending.is_none())
    }

    fn running(&mut self) -> Option<Running> {
        for slot in 0..self.slots.len() {
            // A failure is reported by the next call that waits.
            self.collect(slot, false).ok()?;
        }
        let oldest = self.slots.iter().flat_map(|slot| &slot.pending).min_by_key(|pending| pending.frame)?;
        Some(self.shared.watch.look(&self.shared.gpu, &oldest.ticket))
    }

    /// Lists the memory of this executor, including all planes that its plan reads, shared or not.
    fn memory(&self) -> Vec<(String, u64)> {
        let mut memory = self.compiled.as_ref().map(CompiledPlan::memory).unwrap_or_default();
        memory.extend(self.output.iter().map(|own| ("picture".to_string(), own.buffer.memory.bytes())));
        let pending = || self.slots.iter().flat_map(|slot| &slot.pending);
        let inspected = pending().flat_map(|pending| &pending.inspected).map(|buffer| &buffer.memory);
        // Outputs that other frames can still read are listed by their executors.
        let gone = |held: &&Arc<SharedOutput<G>>| self.shared.outputs.find(&held.picture).is_none();
        let outputs = pending().flat_map(|pending| &pending.outputs).filter(gone);
        let outputs = outputs.map(|held| &held.buffer.memory);
        // Former plans can share memory with each other and with the current plan.
        let pieces = self.former.iter().flat_map(CompiledPlan::pieces).chain(inspected).chain(outputs);
        let mut other: HashMap<_, u64> = pieces.map(|piece| (Arc::as_ptr(piece), piece.bytes())).collect();
        for piece in self.compiled.iter().flat_map(CompiledPlan::pieces) {
            other.remove(&Arc::as_ptr(piece));
        }
        if !other.is_empty() {
            memory.push((IN_FLIGHT.to_string(), other.values().sum()));
        }
        memory
    }

    fn heap(&self) -> Heap {
        Heap { bytes: self.shared.gpu.common().limits.heap_bytes, available: self.shared.gpu.available() }
    }

    fn take_messages(&mut self) -> Vec<String> {
        self.shared.gpu.common().messages.take()
    }
}

impl<G: Gpu> Drop for Executor<G> {
    fn drop(&mut self) {
        if let Some(output) = &self.output {
            self.shared.outputs.remove(output);
        }
        // The device may use the fields' objects until it is idle. (Other executors hold what they use.)
        if self.shared.gpu.wait_idle(self.shared.gpu.common().patience) {
            self.shared.drop_abandoned();
        } else {
            let slots = std::mem::take(&mut self.slots);
            let plans = (self.compiled.take(), std::mem::take(&mut self.former));
            self.shared.abandon((slots, plans, self.output.take(), self.swapchain.take()));
        }
    }
}
