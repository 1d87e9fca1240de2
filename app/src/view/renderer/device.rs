//! Releases a renderer's device after a loss, and replaces it.

use super::Renderer;
use super::failure::Failure;
use super::state::{BuildState, DeviceState, Fault, Pause};
use crate::draw::backend::Backend;
use crate::view::events::Cause;
use splatgraph_api::{BackendError, Device, DeviceInfo};
use splatgraph_framework::reload::LastGood;
use std::time::Instant;

impl Renderer {
    /// Returns the device, even if it is lost; `None` between [`Renderer::release`] and [`Renderer::give`].
    pub fn device(&self) -> Option<&Backend> {
        self.device.device.as_ref()
    }

    /// Returns the device, for changes that do not affect a plan; `None` as for [`Renderer::device`].
    pub fn device_mut(&mut self) -> Option<&mut Backend> {
        self.device.device.as_mut()
    }

    /// Returns the device's description, which stays available after a loss.
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// Returns true if polling an older frame blocks until newer frames are finished. On a CPU, Mesa's Vulkan driver
    /// waits for all submissions before it returns a timestamp.
    pub(in crate::view) fn reads_block(&self) -> bool {
        self.info.is_cpu()
    }

    /// Returns the error that reported the loss of the device or its window surface; `None` also after
    /// [`Renderer::release`].
    pub fn lost(&self) -> Option<&BackendError> {
        match &self.device.fault {
            Some(Fault::Lost(error)) => Some(error),
            _ => None,
        }
    }

    /// Drops the lost device with its plan and its frames in flight, whose results are lost. Graph and settings stay.
    pub fn release(&mut self) {
        self.device = DeviceState::new(None);
        self.epoch += 1;
        self.changes += 1;
        self.forgot |= !self.in_flight.is_empty();
        self.in_flight.clear();
        self.stalled = None;
        self.pending_swap = None;
        self.build = BuildState::default();
        (self.size, self.scene) = ((0, 0), None);
        self.whole = None;
        self.state = LastGood::new();
        self.want(Cause::Device, Instant::now());
    }

    /// Returns true once no build holds the released device.
    pub fn is_released(&mut self) -> bool {
        self.take_builds();
        self.device.device.is_none() && self.jobs.is_empty()
    }

    /// Continues on another device after [`Renderer::release`], and builds the plan again.
    pub fn give(&mut self, device: Backend) {
        self.info = device.info().clone();
        self.device = DeviceState::new(Some(device));
    }

    /// Suspends builds until files, parameters, graph or scene change; `loss` is shown as the reason.
    pub fn hold(&mut self, loss: &str) {
        self.build = BuildState { pause: Some(Pause::Held), ..BuildState::default() };
        let attempt = self.state.asked(self.now);
        self.state.failed(attempt, Failure::Held(loss.to_owned()));
    }

    /// Returns the device, even if it is lost; `None` if it was released.
    pub fn into_device(self) -> Option<Backend> {
        self.device.device
    }
}
