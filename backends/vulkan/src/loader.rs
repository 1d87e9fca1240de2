//! Loading beside the frames: a plan is made ready on one thread while another draws.
//!
//! A [`Loader`] holds nothing but the device, so it can be taken at any time and go to any thread. What it makes, a [`Ready`],
//! is a whole plan that no executor has yet. Everything that takes long is done by then, uploads included. What is left for
//! the thread that draws is to settle what the plan goes on from ([`crate::history`]).

use crate::gpu::Gpu;
use crate::loaded::Loaded;
use splatgraph_api::{BackendError, Progress, SceneData};
use splatgraph_framework::plan::Plan;
use std::sync::Arc;

/// Makes plans ready for one [`Vulkan`](crate::Vulkan); see [`splatgraph_api::Device::loader`].
///
/// It keeps the device open. Memory of a plan that is being made ready is listed nowhere until the plan is swapped in.
pub struct Loader {
    pub(crate) gpu: Arc<Gpu>,
    pub(crate) executor: u64,
}

/// A plan that [`splatgraph_api::Device::swap`] makes the current one, of the [`Vulkan`](crate::Vulkan) that the loader was
/// taken from. Dropped unused, it frees all that was made for it, on whichever thread that is.
pub struct Ready {
    pub(crate) loaded: Loaded,
    pub(crate) executor: u64,
}

impl splatgraph_api::Loader for Loader {
    type Ready = Ready;

    fn prepare(
        self,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Ready, BackendError> {
        self.gpu.check_lost()?;
        Ok(Ready { loaded: Loaded::new(&self.gpu, plan, scene, progress)?, executor: self.executor })
    }
}
