//! Builds a plan and prepares it on the device, on the build thread.

use super::failure::Failure;
use super::state::PlanInputs;
use crate::draw::backend::{Loader, Ready};
use crate::draw::capacity::Capacities;
use crate::draw::facts::{self, SceneFacts};
use crate::draw::fingerprint::commands;
use crate::draw::planner::Planner;
use crate::draw::session::Upload;
use crate::view::events::Causes;
use crate::view::paint;
use crate::view::profile::zone;
use splatgraph_api::{Loader as _, Progress};
use splatgraph_framework::ir::{Catalog, DeviceFacts};
use splatgraph_framework::lower::Control;
use splatgraph_framework::plan::Plan;
use splatgraph_framework::reload::Wanted;
use splatgraph_framework::shader::Cancel;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

pub(super) struct Job {
    pub graph: String,
    pub set: Vec<(String, String)>,
    pub capacities: Capacities,
    /// True if a setting that the graph rejects is an error; false to build without it.
    pub strict: bool,
    pub inputs: PlanInputs,
    pub device: DeviceFacts,
    pub loader: Loader,
    pub causes: Causes,
    /// The current plan, if a new plan with the same commands need not replace it on the device.
    pub drawn: Option<Arc<Plan>>,
    pub asked: Instant,
    pub progress: Arc<Mutex<String>>,
}

pub(super) struct Built {
    /// The new plan, or the failure; `Err(None)` if a newer request cancelled the build. `Ready` is `None` if the plan
    /// has the same commands as [`Job::drawn`].
    pub outcome: Result<(Plan, Vec<Control>, Option<Ready>), Option<Failure>>,
    pub wanted: Vec<Wanted>,
    /// The graph's name, and true if it is built in.
    pub source: (String, bool),
    pub capacities: Capacities,
    pub inputs: PlanInputs,
    pub causes: Causes,
    pub asked: Instant,
    pub plan_ms: f64,
    pub prepare_ms: f64,
}

/// Creates the build thread's function, which owns the cache of compiled shaders.
pub(super) fn builder(cancel: Cancel) -> impl FnMut(Job) -> Built {
    let mut planner = Planner::default();
    planner.set_cancel(cancel.clone());
    move |job| build(&mut planner, &cancel, job)
}

fn build(planner: &mut Planner, cancel: &Cancel, job: Job) -> Built {
    let Job { graph, mut set, capacities, strict, inputs, device, loader, causes, drawn, asked, progress } =
        job;
    let milliseconds = |since: Instant| since.elapsed().as_secs_f64() * 1e3;
    zone!("build a plan");
    let begun = Instant::now();
    planner.forget_files();
    planner.share_memory = inputs.share_memory;
    planner.capacities.clone_from(&capacities);
    let scene = inputs.scene.as_deref();
    let (facts, catalog) = match scene {
        Some(scene) => (facts::facts(&SceneFacts::of(scene), &device, inputs.size), facts::catalog(scene)),
        None => {
            let mut catalog = Catalog::default();
            paint::offer(&mut catalog);
            (facts::without_scene(&device, inputs.size), catalog)
        }
    };
    if !strict {
        let rejected = planner.rejected_settings(&graph, &set, &facts, &catalog);
        set.retain(|(name, _)| !rejected.contains(name));
    }
    let plan = planner.plan(&graph, &set, &facts, &catalog);
    let plan = plan.and_then(|plan| Ok((plan, planner.controls(&graph, &set, &facts, &catalog)?)));
    let plan_ms = milliseconds(begun);
    let is_built_in = planner.is_built_in(&graph);
    let wanted = planner.wanted();
    let begun = Instant::now();
    let outcome = plan.map_err(Failure::Graph).and_then(|(plan, controls)| {
        if drawn.is_some_and(|drawn| commands(&drawn) == commands(&plan)) {
            return Ok((plan, controls, None));
        }
        let loader = loader.cancelled_by(cancel.clone());
        // A plan for inspections runs its whole prologue, so that each pass's output can be read.
        let loader = if inputs.share_memory { loader.sharing_results() } else { loader };
        let loader = if causes.is_room_alone() { loader.keeping_state() } else { loader };
        let ready = loader
            .prepare(plan.clone(), &Upload(scene), &mut |step| set_progress(&progress, describe(&step)));
        set_progress(&progress, String::new());
        Ok((plan, controls, Some(ready.map_err(Failure::Backend)?)))
    });
    // After cancellation, any error is irrelevant.
    let outcome = outcome.map_err(|failure| (!cancel.is_requested()).then_some(failure));
    let prepare_ms = milliseconds(begun);
    let source = (graph, is_built_in);
    Built { outcome, wanted, source, capacities, inputs, causes, asked, plan_ms, prepare_ms }
}

fn set_progress(progress: &Mutex<String>, text: String) {
    *progress.lock().unwrap_or_else(PoisonError::into_inner) = text;
}

fn describe(progress: &Progress) -> String {
    match progress {
        Progress::Pipeline { done, of, shader } => format!("pipeline {} of {of}: {shader}", done + 1),
        Progress::Upload { done_bytes, of_bytes } => {
            format!("uploading the scene, {} of {} MiB", done_bytes >> 20, of_bytes >> 20)
        }
    }
}
