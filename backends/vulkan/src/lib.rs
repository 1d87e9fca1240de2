//! Runs plans on a Vulkan 1.3 device, with or without a window system.
//!
//! [`Vulkan`] opens a device and implements [`splatgraph_api::Device`]. A plan's way through the crate:
//!
//! 1. `limits` holds it against what the device allows;
//! 2. `lower` and `barriers` rewrite it in Vulkan's terms, as plain data, without calling Vulkan;
//! 3. `pipelines`, `resources` (with `blocks` and `history`) and `upload` create what that data lists, which together is a
//!    `loaded` plan;
//! 4. `record` records a frame of it, step by step, and `frame` submits it and reads the results back.
//!
//! Under these lie `instance` (the loader and the validation layer), `device` (which device, with what limits), `gpu`
//! (the opened device and ownership of what is made from it), `memory` and `queue`.
//!
//! The crate decides nothing about order or barriers: it records the barriers of the plan, and adds some only for what it
//! does itself (uploads, readback, inspection, the change from one plan to the next).

mod barriers;
mod blocks;
mod device;
mod error;
mod frame;
mod gpu;
mod history;
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
use resources::Estate;
use splatgraph_api::{
    BackendError, Device, DeviceInfo, FRAMES_IN_FLIGHT, FrameId, FrameInputs, FrameResult, Progress,
    SceneData,
};
use splatgraph_framework::plan::Plan;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// Results that wait to be taken; older ones are dropped, for callers that submit and never ask.
const MOST_RESULTS: usize = 64;

/// What memory is listed under that only frames in flight still need: of former plans, and for what is inspected.
const IN_FLIGHT: &str = "frames in flight";

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
    /// Plans that were replaced while frames of theirs were in flight, until those are collected.
    former: Vec<Loaded>,
    /// How many plans were loaded.
    plans: u64,
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
            former: Vec::new(),
            plans: 0,
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
        let Some(pending) = &self.slots[slot].pending else { return Ok(()) };
        let Some(loaded) = plan(&self.loaded, &self.former, pending.plan) else { return Ok(()) };
        let collected = self.slots[slot].collect(&self.gpu, loaded, slot);
        if let Some((frame, result)) = collected.map_err(|error| self.losing(error))? {
            self.results.insert(frame, result);
            if self.results.len() > MOST_RESULTS {
                self.results.pop_first();
            }
        }
        self.drop_former();
        Ok(())
    }

    /// Drops the former plans that no frame in flight is one of.
    fn drop_former(&mut self) {
        let pending: Vec<u64> = self.slots.iter().flat_map(|slot| &slot.pending).map(|p| p.plan).collect();
        self.former.retain(|loaded| pending.contains(&loaded.number));
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
        let mut place = None;
        for back in 0..FRAMES_IN_FLIGHT as u64 {
            let slot = (self.next + back) as usize % FRAMES_IN_FLIGHT;
            let Some(pending) = &self.slots[slot].pending else { continue };
            let loaded = plan(&self.loaded, &self.former, pending.plan)?;
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

/// The plan of this number, among the current one and the former ones.
fn plan<'a>(current: &'a Option<Loaded>, former: &'a [Loaded], number: u64) -> Option<&'a Loaded> {
    current.iter().chain(former).find(|loaded| loaded.number == number)
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
        let estate = self.loaded.as_ref().map_or_else(Estate::default, Loaded::estate);
        let loaded = Loaded::new(&self.gpu, plan, self.plans, scene, &estate, progress);
        let loaded = loaded.map_err(|error| self.losing(error))?;
        self.plans += 1;
        // Frames of the one before may still be running.
        self.former.extend(self.loaded.replace(loaded));
        self.drop_former();
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
        let mut memory = self.loaded.as_ref().map(Loaded::memory).unwrap_or_default();
        let pending = self.slots.iter().flat_map(|slot| &slot.pending);
        let inspected = pending.flat_map(|pending| &pending.inspected).map(|buffer| &buffer.memory);
        // Former plans may share memory with one another and with the current one.
        let pieces = self.former.iter().flat_map(Loaded::pieces).chain(inspected);
        let mut other: HashMap<_, u64> = pieces.map(|piece| (Arc::as_ptr(piece), piece.bytes())).collect();
        for piece in self.loaded.iter().flat_map(Loaded::pieces) {
            other.remove(&Arc::as_ptr(piece));
        }
        if !other.is_empty() {
            memory.push((IN_FLIGHT.to_string(), other.values().sum()));
        }
        memory
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
