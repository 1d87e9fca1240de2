//! Runs plans on a Vulkan 1.3 device, with or without a window system.
//!
//! [`Vulkan`] opens a device and implements [`splatgraph_api::Device`]. A plan's way through the crate:
//!
//! 1. `limits` holds it against what the device allows;
//! 2. `lower` and `barriers` rewrite it in Vulkan's terms, as plain data, without calling Vulkan;
//! 3. `pipelines`, `resources` (with `blocks`, `planes` and `given`) and `upload` create what that data lists, which together
//!    is a `loaded` plan; `loader` does all this on any thread;
//! 4. the plan becomes the current one, and goes on from the `history` of the one before;
//! 5. `record` records a frame of it, step by step, and `frame` submits it and reads the results back; what it drew can be
//!    another's `picture`.
//!
//! In a window, `screen` shows what a frame drew, in images of a swapchain that fits the window's `surface`.
//!
//! Under these lie `instance` (Vulkan's own loader and the validation layer), `device` (which device, with what limits), `gpu`
//! (the opened device and ownership of what is made from it), `memory` and `queue`.
//!
//! The crate decides nothing about order or barriers: it records the barriers of the plan, and adds some only for what it
//! does itself (uploads, readback, inspection, pictures, the change from one plan to the next).

mod barriers;
mod blocks;
mod device;
mod error;
mod frame;
mod given;
mod gpu;
mod history;
mod instance;
mod limits;
mod loaded;
mod loader;
mod lower;
mod memory;
mod picture;
mod pipelines;
mod planes;
mod queue;
mod record;
mod resources;
mod screen;
mod surface;
#[cfg(test)]
mod testing;
mod upload;

pub use instance::Validation;
pub use loader::{Loader, Ready};

use frame::{Slot, Viewers};
use gpu::Gpu;
use instance::Instance;
use limits::invalid;
use loaded::Loaded;
use picture::PictureBuffer;
use raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use screen::Screen;
use splatgraph_api::{
    BackendError, Device, DeviceInfo, FRAMES_IN_FLIGHT, FrameId, FrameInputs, FrameResult, Picture, Windowed,
};
use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError};

/// Results that wait to be taken; older ones are dropped, for callers that submit and never ask.
const MOST_RESULTS: usize = 64;

/// What memory is listed under that only frames in flight still need: of former plans, for what is inspected, and of pictures
/// whose executors have others by now.
const IN_FLIGHT: &str = "frames in flight";

/// How to open a device.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// A part of the device's name in any case, or its index in [`Vulkan::devices`]. Without it the first discrete GPU
    /// is taken, else the first integrated one, else another, a CPU last.
    pub device: Option<String>,
    pub validation: Validation,
}

/// Bytes of a device's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceMemory {
    /// Something stands in them.
    pub used: u64,
    /// The device gave them: those in use, and the rest of the pieces that they were cut from.
    pub reserved: u64,
}

/// An opened Vulkan device, and the plan that it executes.
///
/// Several share one device ([`Device::beside`]): its queue, the planes of the scene, its validation messages, and its loss,
/// which the first that meets it tells to all. Each can be used from a thread of its own. What belongs to one alone are its
/// plan, its frames and their numbers, its results and its picture.
///
/// Dropping it waits for the device and destroys what is its own. The device is closed with the last of them, or the last
/// [`Loader`] or [`Ready`] taken from one, whichever is later.
pub struct Vulkan {
    /// Tells executors apart, of whatever device.
    executor: u64,
    info: DeviceInfo,
    loaded: Option<Loaded>,
    /// Plans that were replaced while frames of theirs were in flight, until those are collected.
    former: Vec<Loaded>,
    /// How many plans were loaded.
    plans: u64,
    slots: [Slot; FRAMES_IN_FLIGHT],
    results: BTreeMap<FrameId, FrameResult>,
    next: u64,
    /// What the last frame that was shown left.
    picture: Option<Arc<PictureBuffer>>,
    /// The window, if it was opened in one.
    screen: Option<Screen>,
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
        Vulkan::on(physical.info, gpu)
    }

    /// Opens a device that shows what it draws in `window`, which has `size` pixels (width, height) now. Only devices that can
    /// are fit for it.
    ///
    /// The window is kept until the device, and all that were opened [beside](Device::beside) it, are dropped.
    ///
    /// # Errors
    /// As [`Vulkan::open`], and [`BackendError::Unavailable`] where pictures cannot be shown in the window.
    pub fn open_in_window<W>(
        options: &Options,
        window: Arc<W>,
        size: (u32, u32),
    ) -> Result<Vulkan, BackendError>
    where
        W: HasDisplayHandle + HasWindowHandle + Send + Sync + 'static,
    {
        let instance = Instance::in_window(options.validation, window)?;
        let physical = device::choose(device::all(&instance)?, options.device.as_deref())?;
        let gpu = Arc::new(Gpu::new(instance, &physical, &[ash::khr::swapchain::NAME])?);
        let screen = Screen::new(&gpu, size)?;
        let mut vulkan = Vulkan::on(physical.info, gpu)?;
        vulkan.screen = Some(screen);
        Ok(vulkan)
    }

    /// One more executor of an opened device, without a window.
    fn on(info: DeviceInfo, gpu: Arc<Gpu>) -> Result<Vulkan, BackendError> {
        static EXECUTORS: AtomicU64 = AtomicU64::new(0);
        let slots = [Slot::new(&gpu)?, Slot::new(&gpu)?];
        Ok(Vulkan {
            executor: EXECUTORS.fetch_add(1, Ordering::Relaxed),
            info,
            loaded: None,
            former: Vec::new(),
            plans: 0,
            slots,
            results: BTreeMap::new(),
            next: 0,
            picture: None,
            screen: None,
            gpu,
        })
    }

    /// Drops it, and gives the validation messages that nobody took, of all that share the device. For the last of them these
    /// are also the messages of the device's closing: an object that was not destroyed is one. While others are there, the
    /// device stays open for them, and what is said later is theirs to take.
    pub fn close(self) -> Vec<String> {
        let messages = self.gpu.instance.messages.clone();
        drop(self);
        messages.take()
    }

    /// The memory of the device, of all that share it: what [`Device::memory`] lists for each of them, and the plans that are
    /// being made ready. What several share counts once.
    pub fn device_memory(&self) -> DeviceMemory {
        let allocator = self.gpu.allocator.lock().unwrap_or_else(PoisonError::into_inner);
        allocator.as_ref().map_or(DeviceMemory::default(), |allocator| {
            let report = allocator.generate_report();
            DeviceMemory { used: report.total_allocated_bytes, reserved: report.total_capacity_bytes }
        })
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

    /// Passes an error on. If it is the device's loss, says where that was, and remembers it, unless another was first.
    fn losing(&self, error: BackendError) -> BackendError {
        let BackendError::DeviceLost(answer) = error else { return error };
        let text = match self.where_lost() {
            Some(place) => format!("{answer}, {place}"),
            None => answer,
        };
        BackendError::DeviceLost(self.gpu.lost.get_or_init(|| text).clone())
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
}

/// The plan of this number, among the current one and the former ones.
fn plan<'a>(current: &'a Option<Loaded>, former: &'a [Loaded], number: u64) -> Option<&'a Loaded> {
    current.iter().chain(former).find(|loaded| loaded.number == number)
}

impl Device for Vulkan {
    type Loader = Loader;

    fn info(&self) -> &DeviceInfo {
        &self.info
    }

    fn beside(&self) -> Result<Vulkan, BackendError> {
        self.gpu.check_lost()?;
        Vulkan::on(self.info.clone(), self.gpu.clone())
    }

    fn loader(&self) -> Loader {
        Loader { gpu: self.gpu.clone(), executor: self.executor }
    }

    /// Whatever the loader was taken before: the plan goes on from the histories of the one that is current now.
    fn swap(&mut self, ready: Ready) -> Result<(), BackendError> {
        self.gpu.check_lost()?;
        let Ready { mut loaded, executor } = ready;
        if executor != self.executor {
            return invalid(format!("`{}` was made ready for another executor", loaded.plan.name));
        }
        let histories = self.loaded.as_ref().map(Loaded::histories).unwrap_or_default();
        loaded.follow(&self.gpu, self.plans, &histories);
        self.plans += 1;
        // Frames of the one before may still be running.
        self.former.extend(self.loaded.replace(loaded));
        self.drop_former();
        Ok(())
    }

    fn picture(&self) -> Option<Picture> {
        self.picture.as_ref().map(|own| own.picture)
    }

    fn submit(&mut self, inputs: &FrameInputs) -> Result<FrameId, BackendError> {
        self.gpu.check_lost()?;
        let frame = FrameId(self.next);
        let slot = (self.next % FRAMES_IN_FLIGHT as u64) as usize;
        self.collect(slot)?;
        let Some(loaded) = &mut self.loaded else {
            return invalid("a frame was submitted before a plan was loaded".to_string());
        };
        let picture = match loaded.resources.image(loaded.plan.output) {
            Some(output) if inputs.show => Some(PictureBuffer::of(&self.gpu, output, self.picture.as_ref())?),
            _ => None,
        };
        let screen = self.screen.as_mut().filter(|_| inputs.present);
        let to = Viewers { picture: picture.as_ref(), screen };
        let submitted = self.slots[slot].submit(&self.gpu, loaded, slot, frame, inputs, to);
        let presentation = submitted.map_err(|error| self.losing(error))?;
        self.next += 1;
        if let Some(picture) = picture {
            // Others can be given it from now on: their frames come after the one that draws it.
            self.gpu.pictures.enter(&picture, self.picture.as_ref());
            self.picture = Some(picture);
        }
        if let (Some(screen), Some(presentation)) = (&mut self.screen, presentation) {
            screen.present(presentation).map_err(|error| self.losing(error))?;
        }
        Ok(frame)
    }

    fn wait(&mut self, frame: FrameId) -> Result<FrameResult, BackendError> {
        let pending = |slot: &Slot| slot.pending.as_ref().is_some_and(|pending| pending.frame == frame);
        if let Some(slot) = self.slots.iter().position(pending) {
            self.gpu.check_lost()?;
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

    /// Of this executor alone. Planes of the scene that it shares with others are listed by each whose plan reads them.
    fn memory(&self) -> Vec<(String, u64)> {
        let mut memory = self.loaded.as_ref().map(Loaded::memory).unwrap_or_default();
        memory.extend(self.picture.iter().map(|own| ("picture".to_string(), own.buffer.memory.bytes())));
        let pending = || self.slots.iter().flat_map(|slot| &slot.pending);
        let inspected = pending().flat_map(|pending| &pending.inspected).map(|buffer| &buffer.memory);
        // Those that can still be given are their executors'.
        let gone = |held: &&Arc<PictureBuffer>| self.gpu.pictures.find(&held.picture).is_none();
        let pictures = pending().flat_map(|pending| &pending.pictures).filter(gone);
        let pictures = pictures.map(|held| &held.buffer.memory);
        // Former plans may share memory with one another and with the current one.
        let pieces = self.former.iter().flat_map(Loaded::pieces).chain(inspected).chain(pictures);
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

/// Of a device that was not opened in a window, nothing is shown anywhere.
///
/// A frame that is presented waits in [`Device::submit`] until the window has an image free: with vsync, that is until the
/// display's refresh. It waits for no more than two seconds, after which the frame is drawn and not shown: some window systems
/// have no image for a window that is hidden.
impl Windowed for Vulkan {
    fn resize_window(&mut self, width: u32, height: u32) {
        if let Some(screen) = &mut self.screen {
            screen.resize(width, height);
        }
    }

    fn set_vsync(&mut self, vsync: bool) {
        if let Some(screen) = &mut self.screen {
            screen.set_vsync(vsync);
        }
    }
}

impl Drop for Vulkan {
    fn drop(&mut self) {
        if let Some(picture) = &self.picture {
            self.gpu.pictures.remove(picture);
        }
        // What is dropped after this may be in use by the device until it is idle. (What others use, they hold.)
        self.gpu.wait_idle();
    }
}
