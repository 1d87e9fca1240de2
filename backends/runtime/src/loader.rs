//! Loading beside the frames: a plan is made ready on one thread while another draws.
//!
//! A [`Loader`] holds the device alone, so it can be taken at any time and go to any thread. It makes a [`Ready`], a compiled plan
//! that no executor has yet. Everything that takes long is done by then, uploads included. The thread that draws only binds the
//! plan to the histories that it continues from ([`crate::history`]).

use crate::compiled::CompiledPlan;
use crate::gpu::Gpu;
use crate::shared::Shared;
use splatgraph_api::{BackendError, Progress, SceneData};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Cancel;
use std::sync::Arc;

/// Makes plans ready for one [`Executor`](crate::Executor); see [`splatgraph_api::Device::loader`].
///
/// It keeps the device open. Memory of a plan that is being made ready is listed nowhere until the plan is swapped in.
pub struct Loader<G: Gpu> {
    pub(crate) shared: Arc<Shared<G>>,
    pub(crate) executor: u64,
    pub(crate) cancel: Cancel,
    pub(crate) share_results: bool,
    pub(crate) synchronization: Option<G::Synchronization>,
}

impl<G: Gpu> Loader<G> {
    /// Orders the passes by these commands instead of those that the plan's dependencies are lowered to: for tests of what is missed
    /// without some of them.
    #[must_use]
    pub fn synchronized_by(self, synchronization: G::Synchronization) -> Self {
        Loader { synchronization: Some(synchronization), ..self }
    }
}

/// A plan that [`splatgraph_api::Device::swap`] makes the current one, of the [`Executor`](crate::Executor) that the loader was
/// taken from. Dropped unused, it frees all that was made for it, on whichever thread that is.
pub struct Ready<G: Gpu> {
    pub(crate) compiled: CompiledPlan<G>,
    pub(crate) executor: u64,
}

impl<G: Gpu> splatgraph_api::Loader for Loader<G> {
    type Ready = Ready<G>;

    fn cancelled_by(self, cancel: Cancel) -> Self {
        Loader { cancel, ..self }
    }

    fn sharing_results(self) -> Self {
        Loader { share_results: true, ..self }
    }

    fn prepare(
        self,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Ready<G>, BackendError> {
        self.shared.check_lost()?;
        self.shared.drop_abandoned();
        let Loader { shared, executor, cancel, share_results, synchronization } = self;
        let options = (&cancel, share_results, synchronization);
        let compiled = CompiledPlan::new(&shared, plan, scene, options, progress)
            .map_err(|error| shared.losing(error, || None))?;
        Ok(Ready { compiled, executor })
    }
}
