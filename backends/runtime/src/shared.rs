//! Holds the state shared by all executors of a device.

use crate::attributes::AttributeCache;
use crate::gpu::{Buffer, Gpu};
use crate::lock::lock;
use crate::outputs::SharedOutputs;
use crate::pipelines::Compilers;
use crate::results::Results;
use crate::watch::Watch;
use splatgraph_api::BackendError;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

pub(crate) struct Shared<G: Gpu> {
    pub attributes: AttributeCache<Buffer<G>>,
    pub results: Results<G>,
    pub outputs: SharedOutputs<G>,
    pub watch: Arc<Watch<G>>,
    pub compilers: Compilers,
    lost: OnceLock<String>,
    /// Objects that the device may use until it is idle.
    abandoned: Mutex<Vec<Box<dyn Send>>>,
    pub gpu: Arc<G>,
}

impl<G: Gpu> Shared<G> {
    pub fn new(gpu: Arc<G>) -> Arc<Self> {
        Arc::new(Shared {
            attributes: AttributeCache::default(),
            results: Results::default(),
            outputs: SharedOutputs::default(),
            watch: Arc::default(),
            compilers: Compilers::default(),
            lost: OnceLock::new(),
            abandoned: Mutex::default(),
            gpu,
        })
    }

    /// Keeps objects alive until [`Shared::drop_abandoned`] finds the device idle, possibly forever.
    pub fn abandon(&self, objects: impl Send + 'static) {
        lock(&self.abandoned).push(Box::new(objects));
    }

    pub fn drop_abandoned(&self) {
        if !lock(&self.abandoned).is_empty() && self.gpu.wait_idle(Duration::ZERO) {
            lock(&self.abandoned).clear();
        }
    }

    pub fn check_lost(&self) -> Result<(), BackendError> {
        match self.lost.get() {
            Some(text) => Err(BackendError::DeviceLost(text.clone())),
            None => Ok(()),
        }
    }

    /// Records the device's first loss, with `place` added, and returns it for every later loss. Returns other errors
    /// unchanged.
    pub fn losing(&self, error: BackendError, place: impl FnOnce() -> Option<String>) -> BackendError {
        let BackendError::DeviceLost(answer) = error else { return error };
        let text = || match place() {
            Some(place) => format!("{answer}, {place}"),
            None => answer,
        };
        BackendError::DeviceLost(self.lost.get_or_init(text).clone())
    }
}

impl<G: Gpu> Drop for Shared<G> {
    fn drop(&mut self) {
        self.drop_abandoned();
        let abandoned = std::mem::take(&mut *lock(&self.abandoned));
        if !abandoned.is_empty() {
            // Leaks both, so the device is never closed.
            Box::leak(Box::new((abandoned, self.gpu.clone())));
        }
    }
}
