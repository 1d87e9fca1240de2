//! Runs plans on a Vulkan 1.3 device, with or without a window system.
//!
//! [`Vulkan`] opens a device and implements [`splatgraph_api::Device`]. A plan's way through the crate:
//!
//! 1. `limits` holds it against what the device allows;
//! 2. `lower` rewrites it in Vulkan's terms, as plain data, without calling Vulkan;
//! 3. `pipelines`, `resources` and `upload` create what that data lists, which together is a `loaded` plan;
//! 4. `record` records a frame of it, step by step, and `frame` submits it and reads the results back.
//!
//! Under these lie `instance` (the loader and the validation layer), `device` (which device, with what limits), `gpu`
//! (the opened device and ownership of what is made from it), `memory` and `queue`.
//!
//! The crate decides nothing about order or barriers: it records the barriers of the plan, and adds some only around
//! transfers of its own (uploads, readback, inspection).

mod device;
mod error;
mod frame;
mod gpu;
mod instance;
mod limits;
mod loaded;
mod lower;
mod memory;
mod pipelines;
mod queue;
mod record;
mod resources;
#[cfg(test)]
mod testing;
mod upload;

pub use instance::Validation;

use frame::Slot;
use gpu::Gpu;
use instance::Instance;
use limits::invalid;
use loaded::Loaded;
use resources::Planes;
use splatgraph_api::{
    BackendError, Device, DeviceInfo, FRAMES_IN_FLIGHT, FrameId, FrameInputs, FrameResult, Progress,
    SceneData,
};
use splatgraph_framework::plan::Plan;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Results that wait to be taken; older ones are dropped, for callers that submit and never ask.
const MOST_RESULTS: usize = 64;

/// How to open a device.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// A part of the device's name in any case, or its index in [`Vulkan::devices`]. Without it the first discrete GPU
    /// is taken, else the first integrated one, else another, a CPU last.
    pub device: Option<String>,
    pub validation: Validation,
}

/// An opened Vulkan device, and the plan that it executes.
///
/// Dropping it waits for the device and destroys everything.
pub struct Vulkan {
    info: DeviceInfo,
    loaded: Option<Loaded>,
    slots: [Slot; FRAMES_IN_FLIGHT],
    results: BTreeMap<FrameId, FrameResult>,
    next: u64,
    /// What was said when the device was lost; nothing works after that.
    lost: Option<String>,
    gpu: Arc<Gpu>,
}

impl Vulkan {
    /// Every device that Vulkan knows on this machine.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] without a Vulkan 1.3 loader.
    pub fn devices() -> Result<Vec<DeviceInfo>, BackendError> {
        let instance = Instance::new(Validation::Off, &[])?;
        Ok(device::all(&instance)?.into_iter().map(|device| device.info).collect())
    }

    /// Opens a device.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`], with what to install, where the loader, the validation layer or a fit device is
    /// missing.
    pub fn open(options: &Options) -> Result<Vulkan, BackendError> {
        let instance = Instance::new(options.validation, &[])?;
        let physical = device::choose(device::all(&instance)?, options.device.as_deref())?;
        let gpu = Arc::new(Gpu::new(instance, &physical, &[])?);
        let slots = [Slot::new(&gpu)?, Slot::new(&gpu)?];
        Ok(Vulkan {
            info: physical.info,
            loaded: None,
            slots,
            results: BTreeMap::new(),
            next: 0,
            lost: None,
            gpu,
        })
    }

    /// Closes the device and gives the validation messages that nobody took, with those of the closing itself: an
    /// object that was not destroyed is one.
    pub fn close(self) -> Vec<String> {
        let messages = self.gpu.instance.messages.clone();
        drop(self);
        messages.take()
    }

    /// Waits for the frame of a slot, if it has one, and keeps its result.
    fn collect(&mut self, slot: usize) -> Result<(), BackendError> {
        let Some(loaded) = &self.loaded else { return Ok(()) };
        let collected = self.slots[slot].collect(&self.gpu, &loaded.plan, &loaded.slots[slot]);
        if let Some((frame, result)) = collected.map_err(|error| self.losing(error))? {
            self.results.insert(frame, result);
            if self.results.len() > MOST_RESULTS {
                self.results.pop_first();
            }
        }
        Ok(())
    }

    fn collect_all(&mut self) -> Result<(), BackendError> {
        // The older frame first.
        for back in 0..FRAMES_IN_FLIGHT as u64 {
            self.collect((self.next + back) as usize % FRAMES_IN_FLIGHT)?;
        }
        Ok(())
    }

    /// Passes an error on. If it is the device's loss, says where that was, and remembers it.
    fn losing(&mut self, error: BackendError) -> BackendError {
        let BackendError::DeviceLost(answer) = error else { return error };
        let text = match self.where_lost() {
            Some(place) => format!("{answer}, {place}"),
            None => answer,
        };
        self.lost = Some(text.clone());
        BackendError::DeviceLost(text)
    }

    /// The first frame in flight that is not known to be complete.
    fn where_lost(&self) -> Option<String> {
        let loaded = self.loaded.as_ref()?;
        let mut place = None;
        for back in 0..FRAMES_IN_FLIGHT as u64 {
            let slot = (self.next + back) as usize % FRAMES_IN_FLIGHT;
            let Some(pending) = &self.slots[slot].pending else { continue };
            let names: Vec<&str> =
                pending.passes.iter().map(|&pass| loaded.plan.pass(pass).name.as_str()).collect();
            let finished = self.slots[slot].finished(&self.gpu, &loaded.slots[slot]);
            place = Some(frame::lost_in(pending.frame, &names, finished.as_deref()));
            if !finished.is_some_and(|finished| finished.iter().all(|&done| done)) {
                break;
            }
        }
        place
    }

    fn check_lost(&self) -> Result<(), BackendError> {
        match &self.lost {
            Some(text) => Err(BackendError::DeviceLost(text.clone())),
            None => Ok(()),
        }
    }
}

impl Device for Vulkan {
    fn info(&self) -> &DeviceInfo {
        &self.info
    }

    fn load(
        &mut self,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), BackendError> {
        self.check_lost()?;
        let none = Planes::new();
        let kept = self.loaded.as_ref().map_or(&none, |loaded| &loaded.resources.planes);
        let loaded = Loaded::new(&self.gpu, plan, scene, kept, progress);
        let loaded = loaded.map_err(|error| self.losing(error))?;
        // The former plan's frames may still be running.
        self.collect_all()?;
        self.loaded = Some(loaded);
        Ok(())
    }

    fn submit(&mut self, inputs: &FrameInputs) -> Result<FrameId, BackendError> {
        self.check_lost()?;
        let frame = FrameId(self.next);
        let slot = (self.next % FRAMES_IN_FLIGHT as u64) as usize;
        self.collect(slot)?;
        let Some(loaded) = &mut self.loaded else {
            return invalid("a frame was submitted before a plan was loaded".to_string());
        };
        let submitted = self.slots[slot].submit(&self.gpu, loaded, slot, frame, inputs);
        submitted.map_err(|error| self.losing(error))?;
        self.next += 1;
        Ok(frame)
    }

    fn wait(&mut self, frame: FrameId) -> Result<FrameResult, BackendError> {
        let pending = |slot: &Slot| slot.pending.as_ref().is_some_and(|pending| pending.frame == frame);
        if let Some(slot) = self.slots.iter().position(pending) {
            self.check_lost()?;
            self.collect(slot)?;
        }
        match self.results.remove(&frame) {
            Some(result) => Ok(result),
            None => invalid(format!(
                "frame {} has no result: it was never submitted, or its result was taken, or {MOST_RESULTS} newer ones \
                 wait to be",
                frame.0
            )),
        }
    }

    fn memory(&self) -> Vec<(String, u64)> {
        self.loaded.as_ref().map(Loaded::memory).unwrap_or_default()
    }

    fn take_messages(&mut self) -> Vec<String> {
        self.gpu.instance.messages.take()
    }
}

impl Drop for Vulkan {
    fn drop(&mut self) {
        // What is dropped after this may be in use by the device until it is idle.
        self.gpu.wait_idle();
    }
}
