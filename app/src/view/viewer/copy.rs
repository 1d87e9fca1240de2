//! Measures the device's bandwidth for buffer copies, the reference for judging the times of passes.
//!
//! The copies are made by a separate graph, whose frames alternate with the frames of the pictures.

use super::{Viewer, Viewport};
use crate::view::events::{Event, RendererId};
use crate::view::renderer::{Choice, PlanInputs};
use crate::view::viewport::View;
use std::time::Instant;

/// Name of the graph that makes the copies, in its pass [`PASS`].
const GRAPH: &str = "bench/copy";
const PASS: &str = "copy";
/// Number of frames to draw. The result is the median over the frames without the prologue.
const FRAMES: u64 = 40;
/// Size of the measuring graph's output, in pixels; it is never shown.
const SIZE: (u32, u32) = (16, 16);

impl Viewer {
    /// Returns the copy limit in 10^9 bytes per second, reads plus writes; `None` before it is measured.
    pub fn copy_limit(&self) -> Option<f64> {
        self.copy_limit
    }

    /// Returns true while the copy limit is being measured.
    pub fn is_measuring_copy(&self) -> bool {
        self.copying.is_some()
    }

    /// Starts to measure the copy limit with the next frames; it is unknown meanwhile, and after a failure. Reports a
    /// failure as an event. Does nothing during a measurement.
    pub fn measure_copy(&mut self) {
        if self.is_measuring_copy() {
            return;
        }
        self.copy_limit = None;
        match self.viewport_beside_a(RendererId::A, Choice::new(GRAPH, &[])) {
            Ok(viewport) => self.copying = Some(viewport),
            Err(error) => self.end_copy(Err(error.to_string())),
        }
    }

    pub(super) fn step_copy(&mut self, now: Instant) {
        let Some(viewport) = &mut self.copying else { return };
        let inputs = PlanInputs { scene: Some(self.subject.scene.clone()), size: SIZE, share_memory: true };
        viewport.renderer.paused = self.rests;
        viewport.renderer.poll(&inputs, now);
        let (camera, scene) = (self.navigation.camera(SIZE.0, SIZE.1), &self.subject.scene);
        viewport.draw(&View {
            scene,
            loaded: &self.subject.whole,
            camera: &camera,
            background: [0.0; 3],
            continuous: true,
            to_host: false,
        });
        viewport.renderer.take_events();
        if let Some(problem) = viewport.renderer.problem(false) {
            let first = problem.lines().next().unwrap_or_default().to_owned();
            self.end_copy(Err(first));
        } else if viewport.history.frames() >= FRAMES {
            let rate = rate(viewport).ok_or_else(|| "the device has no timestamps".to_owned());
            self.end_copy(rate);
        }
    }

    fn end_copy(&mut self, rate: Result<f64, String>) {
        self.copying = None;
        match rate {
            Ok(rate) => self.copy_limit = Some(rate),
            Err(error) => {
                self.report(Event::Problem { text: format!("the copy limit cannot be measured: {error}") });
            }
        }
    }
}

/// Computes the bandwidth in 10^9 bytes per second. Uses the time of the pass or, if pass times are unreliable, of the
/// frame; `None` without times.
fn rate(viewport: &Viewport) -> Option<f64> {
    let plan = viewport.renderer.plan()?;
    let pass = plan.passes.iter().find(|pass| pass.name == PASS)?;
    let bytes: u64 = pass.bindings.iter().map(|binding| plan.resource(binding.resource).bytes()).sum();
    let ms = if viewport.history.is_mostly_unattributed() {
        viewport.history.total()?.median
    } else {
        viewport.history.medians(plan).into_iter().find(|(name, _)| name == PASS)?.1
    };
    (ms > 0.0).then(|| bytes as f64 / ms * 1e-6)
}
