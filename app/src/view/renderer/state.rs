//! Defines the states of a renderer's device and builds.

use crate::draw::backend::Backend;
use crate::view::events::{Cause, Causes};
use indexmap::IndexMap;
use splatgraph_api::{BackendError, Recovery};
use splatgraph_assets::Scene;
use splatgraph_framework::reload::Attempt;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Interval between attempts to draw, and first interval between attempts to build. It follows a transient failure,
/// such as a lack of memory.
pub const RETRY: Duration = Duration::from_millis(250);

/// Maximum interval between attempts to build. The interval doubles with each attempt, because a plan may never fit.
const RARELY: Duration = Duration::from_secs(10);

/// Returns the interval before the next attempt to build, after `failed` failed retries.
pub(super) fn pause_after(failed: u32) -> Duration {
    RETRY.saturating_mul(1 << failed.min(16)).min(RARELY)
}

/// A callback that wakes the window's owner for new content to draw; any thread may call it.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// A graph and its changed parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Built-in name or path of the graph.
    pub graph: String,
    /// The changed parameters with their values as text, in the order of the first change.
    pub set: IndexMap<String, String>,
}

impl Choice {
    /// Chooses a graph, and changes the parameters in `set`.
    pub fn new(graph: &str, set: &[(String, String)]) -> Choice {
        Choice { graph: graph.to_owned(), set: set.iter().cloned().collect() }
    }
}

/// Inputs of a plan, other than its files and parameters.
#[derive(Clone)]
pub struct PlanInputs {
    /// The scene to draw; `None` for the window's graph, which gets the imports of [`crate::view::paint::offer`].
    pub scene: Option<Arc<Scene>>,
    /// Size of the picture, in pixels.
    pub size: (u32, u32),
    /// True to let resources share memory; see [`splatgraph_framework::ir::Request::share_memory`].
    pub share_memory: bool,
}

impl PlanInputs {
    /// Lists the differences from `former` that require a new build; empty if its plan still fits.
    pub(super) fn differs(&self, former: &PlanInputs) -> Causes {
        let identity = |inputs: &PlanInputs| inputs.scene.as_ref().map(|scene| scene.identity());
        let all = [
            (Cause::Scene, identity(self) != identity(former)),
            (Cause::Size, self.size != former.size),
            (Cause::Memory, self.share_memory != former.share_memory),
        ];
        all.into_iter().filter_map(|(cause, differs)| differs.then_some(cause)).collect()
    }
}

pub(super) struct DeviceState {
    /// The device; `None` after it was released, until it is replaced. A lost device is kept until it is released.
    pub device: Option<Backend>,
    pub fault: Option<Fault>,
}

pub(super) enum Fault {
    /// The last frame failed. The next is drawn no earlier than `retry`.
    Failing { error: BackendError, retry: Instant },
    /// The device or its window surface is lost.
    Lost(BackendError),
}

impl DeviceState {
    pub fn new(device: Option<Backend>) -> DeviceState {
        DeviceState { device, fault: None }
    }

    /// Records an error: the device becomes lost, or the next frame waits until `retry`. Does nothing after a loss.
    pub fn fail(&mut self, error: BackendError, retry: Instant) {
        if self.device.is_some() && !matches!(self.fault, Some(Fault::Lost(_))) {
            self.fault =
                Some(if ends_device(&error) { Fault::Lost(error) } else { Fault::Failing { error, retry } });
        }
    }

    /// Clears the failure of the last frame; returns true if there was one.
    pub fn recover(&mut self) -> bool {
        self.fault.take_if(|fault| matches!(fault, Fault::Failing { .. })).is_some()
    }
}

/// Returns true if an error means that the device or its window surface is lost.
pub(super) fn ends_device(error: &BackendError) -> bool {
    let window = matches!(error, BackendError::Unavailable(_) | BackendError::SurfaceLost { .. });
    error.recovery() == Recovery::DeviceEnded || window
}

/// The requested and the running build. If there is neither, the newest build has succeeded or failed.
#[derive(Default)]
pub(super) struct BuildState {
    /// The next build, for the changes since the running one began; `None` without changes.
    pub requested: Option<PendingBuild>,
    pub running: Option<Attempt>,
    /// Reason why nothing is built for now; `None` without one, and while a build is requested or running.
    pub pause: Option<Pause>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Pause {
    /// The device was lost repeatedly; nothing is built until a change.
    Held,
    /// The last build lacked something, such as memory. The next begins at this time.
    Retry(Instant),
}

impl BuildState {
    /// Requests a build, and keeps the causes of earlier requests.
    pub fn ask(&mut self, later: PendingBuild) {
        self.pause = None;
        self.requested = Some(match self.requested.take() {
            Some(former) => former.with(later),
            None => later,
        });
    }

    /// Begins the requested build; `None` if none is requested, or while one is running.
    pub fn begin(&mut self) -> Option<PendingBuild> {
        let build = self.requested.take_if(|_| self.running.is_none())?;
        self.running = Some(build.attempt);
        Some(build)
    }

    pub fn is_busy(&self) -> bool {
        self.requested.is_some() || self.running.is_some()
    }
}

pub(super) struct PendingBuild {
    pub causes: Causes,
    /// Time of the first change.
    pub asked: Instant,
    pub attempt: Attempt,
}

impl PendingBuild {
    /// Combines this request with one for later changes.
    pub fn with(mut self, later: PendingBuild) -> PendingBuild {
        self.causes.add(later.causes);
        PendingBuild { causes: self.causes, asked: self.asked.min(later.asked), attempt: later.attempt }
    }
}

pub(super) struct Crowded {
    pub reason: String,
    /// Time from which frames may request more capacity again; `None` to wait for another change.
    pub retry: Option<Instant>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;
    use splatgraph_framework::reload::LastGood;

    #[test]
    fn a_scene_and_a_size_that_are_built_at_once_are_both_told() {
        let scene = |splats| Some(Arc::new(synth::generate("uniform", splats, 0).expect("a scene")));
        let former = PlanInputs { scene: scene(10), size: (64, 36), share_memory: true };
        let both = PlanInputs { scene: scene(20), size: (32, 18), ..former.clone() };
        assert_eq!(former.differs(&former), Causes::default());
        assert_eq!(both.differs(&former).to_string(), "a change of the scene, another size");
        // The build for the scene is cancelled in favour of one for the new size.
        let mut state: LastGood<(), ()> = LastGood::new();
        let mut build = |causes: Causes, asked| PendingBuild { causes, asked, attempt: state.asked(asked) };
        let now = Instant::now();
        let former = build(Cause::Scene.into(), now);
        let newer = build(Cause::Size.into(), now);
        let attempt = newer.attempt;
        let next = former.with(newer);
        assert_eq!(
            (next.causes.to_string().as_str(), next.attempt),
            ("a change of the scene, another size", attempt)
        );
    }
}
