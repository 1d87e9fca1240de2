//! Prepares a plan on one thread while another draws.
//!
//! A [`Loader`] creates a [`Ready`]: a compiled plan that is not current yet. All slow work happens here, uploads
//! included. Only binding the plan to the histories that it continues ([`crate::history`]) is left to the drawing
//! thread.

use crate::check;
use crate::compiled::CompiledPlan;
use crate::gpu::Gpu;
use crate::history::Start;
use crate::shared::Shared;
use splatgraph_api::{BackendError, Compiled, Progress, SceneData};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Cancel;
use std::sync::Arc;

/// A handle that prepares one plan for an [`Executor`](crate::Executor), and keeps the device open; see
/// [`splatgraph_api::Device::loader`].
pub struct Loader<G: Gpu> {
    pub(crate) shared: Arc<Shared<G>>,
    pub(crate) executor: u64,
    pub(crate) cancel: Cancel,
    pub(crate) share_results: bool,
    pub(crate) histories: Start,
    pub(crate) synchronization: Option<G::Synchronization>,
}

impl<G: Gpu> Loader<G> {
    /// Replaces the synchronization commands lowered from the plan's dependencies, for tests that leave out barriers.
    #[must_use]
    pub fn synchronized_by(self, synchronization: G::Synchronization) -> Self {
        Loader { synchronization: Some(synchronization), ..self }
    }
}

/// A prepared plan, made current by [`splatgraph_api::Device::swap`] on the [`Executor`](crate::Executor) that its
/// loader came from. Dropping it unused frees its objects, on any thread.
pub struct Ready<G: Gpu> {
    pub(crate) compiled: CompiledPlan<G>,
    pub(crate) histories: Start,
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

    fn clearing_histories(self) -> Self {
        Loader { histories: Start::Zeros, ..self }
    }

    fn keeping_state(self) -> Self {
        Loader { histories: Start::Grown, ..self }
    }

    fn restoring_histories(self) -> Self {
        Loader { histories: Start::Saved, ..self }
    }

    fn compile(self, plan: Plan) -> Result<Compiled, BackendError> {
        self.shared.check_lost()?;
        check::check(&plan, &self.shared.gpu.common().limits)?;
        let pipelines =
            self.shared.compilers.create(&self.shared.gpu, &Arc::new(plan), &self.cancel, &mut |_| {});
        pipelines.map(Compiled::new).map_err(|error| self.shared.losing(error, || None))
    }

    fn prepare(
        self,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Ready<G>, BackendError> {
        self.shared.check_lost()?;
        self.shared.drop_abandoned();
        let Loader { shared, executor, cancel, share_results, histories, synchronization } = self;
        let options = (&cancel, share_results, synchronization);
        let compiled = CompiledPlan::new(&shared, plan, scene, options, progress)
            .map_err(|error| shared.losing(error, || None))?;
        Ok(Ready { compiled, histories, executor })
    }
}
