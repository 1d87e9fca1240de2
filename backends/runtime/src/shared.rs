//! Holds the state shared by all executors of a device.

use crate::attributes::AttributeCache;
use crate::gpu::{Buffer, Gpu};
use crate::lock::lock;
use crate::outputs::SharedOutputs;
use crate::pipelines::Compilers;
use crate::results::Results;
use crate::watch::Watch;
use splatgraph_api::BackendError;
use std::mem;
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
        drop_if_idle(&self.abandoned, || self.gpu.wait_idle(Duration::ZERO));
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

/// Drops the objects if `is_idle` returns true. Objects that are abandoned meanwhile stay: the device may still use
/// them.
fn drop_if_idle(abandoned: &Mutex<Vec<Box<dyn Send>>>, is_idle: impl FnOnce() -> bool) {
    let before = mem::take(&mut *lock(abandoned));
    if !before.is_empty() && !is_idle() {
        lock(abandoned).extend(before);
    }
}

impl<G: Gpu> Drop for Shared<G> {
    fn drop(&mut self) {
        self.drop_abandoned();
        let abandoned = mem::take(&mut *lock(&self.abandoned));
        if !abandoned.is_empty() {
            // Leaks both, so the device is never closed.
            Box::leak(Box::new((abandoned, self.gpu.clone())));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_that_is_abandoned_during_the_wait_for_the_device_stays() {
        let [before, during] = [Arc::new(()), Arc::new(())];
        let abandoned: Mutex<Vec<Box<dyn Send>>> = Mutex::new(vec![Box::new(before.clone())]);
        let held = || (Arc::strong_count(&before) - 1, Arc::strong_count(&during) - 1);
        drop_if_idle(&abandoned, || false);
        assert_eq!(held(), (1, 0), "the device is busy");
        drop_if_idle(&abandoned, || {
            lock(&abandoned).push(Box::new(during.clone()));
            true
        });
        assert_eq!(held(), (0, 1));
    }
}
