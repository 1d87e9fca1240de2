//! Builds a plan before its device is opened.
//!
//! A driver takes longer to create a device than a plan takes to build, and the plan needs only the device's
//! description.

use crate::draw::facts::{self, SceneFacts};
use crate::draw::planner::{GraphErrors, Planner};
use splatgraph_assets::Scene;
use splatgraph_framework::ir::{Catalog, DeviceFacts, Facts};
use splatgraph_framework::plan::Plan;
use tracing::info_span;

/// A plan that was built before its device was opened, for [`Session::with_plan`](super::Session::with_plan).
pub struct EarlyPlan {
    pub(super) planner: Planner,
    pub(super) size: (u32, u32),
    pub(super) plan: Plan,
}

impl EarlyPlan {
    /// Builds the plan of a graph and its `outputs` for a picture size, on the device with these facts.
    ///
    /// # Errors
    /// See [`Planner::plan`].
    pub fn new(
        (pipeline, set): (&str, &[(String, String)]),
        outputs: Vec<String>,
        scene: &Scene,
        device: &DeviceFacts,
        size: (u32, u32),
    ) -> Result<EarlyPlan, GraphErrors> {
        let mut planner = Planner::default();
        planner.outputs = outputs;
        let plan = plan_on(&mut planner, (pipeline, set), scene, device, size)?;
        Ok(EarlyPlan { planner, size, plan })
    }
}

pub(super) fn plan_on(
    planner: &mut Planner,
    (pipeline, set): (&str, &[(String, String)]),
    scene: &Scene,
    device: &DeviceFacts,
    size: (u32, u32),
) -> Result<Plan, GraphErrors> {
    let (facts, catalog) = info_span!("collect facts").in_scope(|| facts_of(scene, device, size));
    info_span!("build the plan").in_scope(|| planner.plan(pipeline, set, &facts, &catalog))
}

pub(super) fn facts_of(scene: &Scene, device: &DeviceFacts, size: (u32, u32)) -> (Facts, Catalog) {
    (facts::facts(&SceneFacts::of(scene), device, size), facts::catalog(scene))
}
