//! The executor: a device, the plan that it executes, and its frames in flight.

use crate::check::invalid;
use crate::compiled::CompiledPlan;
use crate::frame::{Frame, Pending, Slot};
use crate::gpu::{Gpu, Memory, Window};
use crate::loader::{Loader, Ready};
use crate::outputs::SharedOutput;
use crate::shared::Shared;
use crate::timing::lost_in;
use crate::window::Swapchain;
use raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use splatgraph_api::{
    BackendError, Device, DeviceInfo, DeviceMemory, FRAMES_IN_FLIGHT, FrameId, FrameInputs, FrameResult,
    Heap, Options, Picture, Running, Windowed,
};
use splatgraph_framework::shader::Cancel;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Results that wait to be taken; older ones are dropped, for callers that submit and never ask.
const MOST_RESULTS: usize = 64;

/// The entry of memory that only frames in flight still need: of former plans, of inspected resources, and of shared outputs whose
/// executors have others by now.
const IN_FLIGHT: &str = "frames in flight";

/// An opened device, and the plan that it executes.
///
/// Several share one device ([`Device::new_context`]): its queue, the planes of the scene, its validation messages, and its loss, which the
/// first that meets it tells to all. Each can be used from a thread of its own. An executor has its own plan, frames, results and
/// shared output.
///
/// Dropping it waits for the device and destroys its own objects. The device is closed with the last executor, or with the last
/// [`Loader`] or [`Ready`] taken from one, whichever is later.
pub struct Executor<G: Gpu> {
    /// Tells executors apart, of whatever device.
    id: u64,
    info: DeviceInfo,
    compiled: Option<CompiledPlan<G>>,
    /// Plans that were replaced while frames of theirs were in flight, until those are collected.
    former: Vec<CompiledPlan<G>>,
    /// The number of plans loaded so far.
    plans: u64,
    /// One for each frame in flight.
    slots: Vec<Slot<G>>,
    results: BTreeMap<FrameId, FrameResult>,
    next: u64,
    /// The output of the last frame that was shared.
    output: Option<Arc<SharedOutput<G>>>,
    /// The window's, if it was opened in one.
    swapchain: Option<Swapchain<G>>,
    shared: Arc<Shared<G>>,
}

impl<G: Gpu> Executor<G> {
    /// Lists the machine's devices.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] where the API is not installed.
    pub fn devices() -> Result<Vec<DeviceInfo>, BackendError> {
        G::devices()
    }

    /// Opens a device.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`], with what to install, where a driver, the validation layer or a fit device is missing.
    pub fn open(options: &Options) -> Result<Self, BackendError> {
        let (info, gpu) = G::open(options, None)?;
        Self::new(info, gpu)
    }

    /// Opens a device that shows its frames in `window`, which has `size` pixels (width, height) now. Only devices that can are fit
    /// for it.
    ///
    /// The window is kept until the device, with all executors [on it](Device::new_context), is closed.
    ///
    /// # Errors
    /// As [`Executor::open`], and [`BackendError::Unavailable`] where images cannot be shown in the window.
    pub fn open_in_window<W>(
        options: &Options,
        window: Arc<W>,
        size: (u32, u32),
    ) -> Result<Self, BackendError>
    where
        W: HasDisplayHandle + HasWindowHandle + Send + Sync + 'static,
    {
        let window: Arc<dyn Window> = window;
        let (info, gpu) = G::open(options, Some(window))?;
        Self::in_window(info, gpu, size)
    }

    /// Creates an executor of an opened device, without a window.
    pub fn new(info: DeviceInfo, gpu: Arc<G>) -> Result<Self, BackendError> {
        Self::on(info, Shared::new(gpu))
    }

    /// Creates an executor of a device that was opened with a window of this size.
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
            shared,
        })
    }

    /// Drops the executor, and returns the validation messages that were not taken, of all that share the device. For the last of
    /// them these include the messages of the device's closing: an object that was not destroyed is one. While others are open, so is
    /// the device, and later messages are theirs to take.
    pub fn close(self) -> Vec<String> {
        let messages = self.shared.gpu.messages().clone();
        drop(self);
        messages.take()
    }

    /// Reports the memory of the device, of all that share it: the memory that [`Device::memory`] lists for each of them, and that of
    /// plans that are being made ready. Shared memory counts once.
    pub fn device_memory(&self) -> DeviceMemory {
        self.shared.gpu.memory()
    }

    /// Keeps the result of a slot's frame, if it has one. Waits for it if it is `patient`, and otherwise leaves a frame that is not
    /// done.
    fn collect(&mut self, slot: usize, patient: bool) -> Result<(), BackendError> {
        let Some(Pending { plan: number, prologue, .. }) = self.slots[slot].pending else { return Ok(()) };
        let Some(compiled) = plan(&self.compiled, &self.former, number) else { return Ok(()) };
        let collected = self.slots[slot].collect(&self.shared, compiled, slot, patient);
        if let Some((frame, result)) = collected.map_err(|error| self.losing(error))? {
            if prologue {
                let plans = self.compiled.iter_mut().chain(&mut self.former);
                plans
                    .filter(|compiled| compiled.number == number)
                    .for_each(|c| c.end_prologue(&self.shared.gpu));
            }
            self.results.insert(frame, result);
            if self.results.len() > MOST_RESULTS {
                self.results.pop_first();
            }
        }
        self.drop_former();
        Ok(())
    }

    /// Drops the previous plans that no frame in flight is one of.
    fn drop_former(&mut self) {
        let pending: Vec<u64> = self.slots.iter().flat_map(|slot| &slot.pending).map(|p| p.plan).collect();
        self.former.retain(|compiled| pending.contains(&compiled.number));
    }

    /// Finds the slot of a frame in flight.
    fn slot_of(&self, frame: FrameId) -> Option<usize> {
        let pending = |slot: &Slot<G>| slot.pending.as_ref().is_some_and(|pending| pending.frame == frame);
        self.slots.iter().position(pending)
    }

    /// Returns the slot of the next frame.
    fn next_slot(&self) -> usize {
        (self.next % FRAMES_IN_FLIGHT as u64) as usize
    }

    fn take_result(&mut self, frame: FrameId) -> Result<FrameResult, BackendError> {
        match self.results.remove(&frame) {
            Some(result) => Ok(result),
            None => invalid(format!(
                "frame {} has no result: it was never submitted, its result was taken, or {MOST_RESULTS} newer results wait",
                frame.0
            )),
        }
    }

    /// Passes an error on, and records the device's loss with its place.
    fn losing(&self, error: BackendError) -> BackendError {
        self.shared.losing(error, || self.where_lost())
    }

    /// Names the first frame in flight that is not known to be complete.
    fn where_lost(&self) -> Option<String> {
        let mut place = None;
        for back in 0..FRAMES_IN_FLIGHT as u64 {
            let slot = (self.next + back) as usize % FRAMES_IN_FLIGHT;
            let Some(pending) = &self.slots[slot].pending else { continue };
            let compiled = plan(&self.compiled, &self.former, pending.plan)?;
            let names: Vec<&str> =
                pending.passes.iter().map(|&pass| compiled.plan.pass(pass).name.as_str()).collect();
            let finished = self.slots[slot].finished(&self.shared.gpu, &compiled.slots[slot]);
            place = Some(lost_in(pending.frame, &names, finished.as_deref()));
            if !finished.is_some_and(|finished| finished.iter().all(|&done| done)) {
                break;
            }
        }
        place
    }
}

/// Finds the plan of this number, among the current one and the previous ones.
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
            synchronization: None,
        }
    }

    /// Goes on from the histories of the plan that is current now, whenever the loader was taken.
    fn swap(&mut self, ready: Ready<G>) -> Result<(), BackendError> {
        self.shared.check_lost()?;
        let Ready { mut compiled, executor } = ready;
        if executor != self.id {
            return invalid(format!("`{}` was made ready for another executor", compiled.plan.name));
        }
        let histories = self.compiled.as_ref().map(CompiledPlan::histories).unwrap_or_default();
        compiled.follow(&self.shared.gpu, self.plans, &histories);
        self.plans += 1;
        // Frames of the one before may still be running.
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
            // Others can read it from now on: their frames come after the one that draws it.
            self.shared.outputs.enter(&output, self.output.as_ref());
            self.output = Some(output);
        }
        if let (Some(swapchain), Some(image)) = (&mut self.swapchain, image) {
            swapchain.present(image, slot).map_err(|error| self.losing(error))?;
        }
        Ok(frame)
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
            // A failure is told by the next call that waits.
            self.collect(slot, false).ok()?;
        }
        let oldest = self.slots.iter().flat_map(|slot| &slot.pending).min_by_key(|pending| pending.frame)?;
        Some(self.shared.watch.look(&self.shared.gpu, &oldest.ticket))
    }

    /// Lists the memory of this executor alone. Planes of the scene that it shares with others are listed by each whose plan reads
    /// them.
    fn memory(&self) -> Vec<(String, u64)> {
        let mut memory = self.compiled.as_ref().map(CompiledPlan::memory).unwrap_or_default();
        memory.extend(self.output.iter().map(|own| ("picture".to_string(), own.buffer.memory.bytes())));
        let pending = || self.slots.iter().flat_map(|slot| &slot.pending);
        let inspected = pending().flat_map(|pending| &pending.inspected).map(|buffer| &buffer.memory);
        // Those that other frames can still read are their executors'.
        let gone = |held: &&Arc<SharedOutput<G>>| self.shared.outputs.find(&held.picture).is_none();
        let outputs = pending().flat_map(|pending| &pending.outputs).filter(gone);
        let outputs = outputs.map(|held| &held.buffer.memory);
        // Former plans may share memory with one another and with the current one.
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
        Heap { bytes: self.shared.gpu.limits().heap_bytes, available: self.shared.gpu.available() }
    }

    fn take_messages(&mut self) -> Vec<String> {
        self.shared.gpu.messages().take()
    }
}

/// An executor of a device that was not opened in a window shows nothing.
///
/// A presented frame waits in [`Device::submit`] until the window has an image free: with vsync, until the display's refresh. It waits
/// for two seconds at most, after which the frame is drawn and not shown: some window systems have no image for a hidden window.
impl<G: Gpu> Windowed for Executor<G> {
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
}

impl<G: Gpu> Drop for Executor<G> {
    fn drop(&mut self) {
        if let Some(output) = &self.output {
            self.shared.outputs.remove(output);
        }
        // Everything dropped after this may be in use by the device until it is idle. (Others hold what they use.)
        if self.shared.gpu.wait_idle(self.shared.gpu.patience()) {
            self.shared.drop_abandoned();
        } else {
            let slots = std::mem::take(&mut self.slots);
            let plans = (self.compiled.take(), std::mem::take(&mut self.former));
            self.shared.abandon((slots, plans, self.output.take(), self.swapchain.take()));
        }
    }
}
