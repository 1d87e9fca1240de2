//! The state that all executors of a device share.

use crate::attributes::AttributeCache;
use crate::gpu::{Buffer, Gpu};
use crate::outputs::SharedOutputs;
use splatgraph_api::BackendError;
use std::sync::{Arc, OnceLock};

/// An opened device, the scene's planes and the outputs on it, and its loss.
pub(crate) struct Shared<G: Gpu> {
    pub attributes: AttributeCache<Buffer<G>>,
    pub outputs: SharedOutputs<G>,
    /// The first report of the device's loss; nothing works after that.
    lost: OnceLock<String>,
    pub gpu: Arc<G>,
}

impl<G: Gpu> Shared<G> {
    pub fn new(gpu: Arc<G>) -> Arc<Self> {
        Arc::new(Shared {
            attributes: AttributeCache::default(),
            outputs: SharedOutputs::default(),
            lost: OnceLock::new(),
            gpu,
        })
    }

    /// Refuses once the device is lost.
    pub fn check_lost(&self) -> Result<(), BackendError> {
        match self.lost.get() {
            Some(text) => Err(BackendError::DeviceLost(text.clone())),
            None => Ok(()),
        }
    }

    /// Passes an error on. If it is the device's loss, adds the `place` where it was, and records it, unless another was first.
    pub fn losing(&self, error: BackendError, place: impl FnOnce() -> Option<String>) -> BackendError {
        let BackendError::DeviceLost(answer) = error else { return error };
        let text = || match place() {
            Some(place) => format!("{answer}, {place}"),
            None => answer,
        };
        BackendError::DeviceLost(self.lost.get_or_init(text).clone())
    }
}
