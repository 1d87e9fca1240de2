//! One of the two pictures of the scene: a renderer, what its frames took, and what of them is looked at.

use super::history::History;
use super::profile::GpuTrack;
use super::renderer::{Cause, Renderer};
use crate::camera;
use crate::inspect::{self, Finding};
use splatgraph_api::{BackendError, Device, FrameInputs, Inspect, Pixels};
use splatgraph_assets::{Camera, Scene};
use std::time::Instant;

/// A resource that is looked at.
#[derive(Clone, Debug)]
pub struct Inspection {
    /// As in [`inspect::resolve`].
    pub resource: String,
    /// The pass after which it is read.
    pub pass: String,
    /// Read it in every frame, not only when asked.
    pub follow: bool,
    /// What was found last, or why nothing could be.
    pub found: Option<Result<Finding, String>>,
    asked: bool,
}

impl Inspection {
    /// Looks once.
    pub fn new(resource: &str, pass: &str) -> Inspection {
        let (resource, pass) = (resource.to_owned(), pass.to_owned());
        Inspection { resource, pass, follow: false, found: None, asked: true }
    }

    /// Looks again.
    pub fn ask(&mut self) {
        self.asked = true;
    }
}

/// See the module's documentation.
pub struct Viewport<D: Device> {
    /// Draws it.
    pub renderer: Renderer<D>,
    /// What the frames took.
    pub history: History,
    /// What is looked at; while something is, resources do not share memory.
    pub inspection: Option<Inspection>,
    /// The graph's statistics, as of the newest frame that is done.
    pub stats: Vec<(String, u32)>,
    /// The picture is read back when this is set; see [`Viewport::take_picture`].
    wants_picture: bool,
    picture: Option<Pixels>,
    frames: u32,
    readings: u64,
    track: GpuTrack,
}

impl<D: Device> Viewport<D> {
    pub(super) fn new(renderer: Renderer<D>) -> Viewport<D> {
        Viewport {
            renderer,
            history: History::default(),
            inspection: None,
            stats: Vec::new(),
            wants_picture: false,
            picture: None,
            frames: 0,
            readings: 0,
            track: GpuTrack::default(),
        }
    }

    /// A number that the graph computes, by its name.
    pub fn stat(&self, name: &str) -> Option<u32> {
        self.stats.iter().find(|(stat, _)| stat == name).map(|(_, value)| *value)
    }

    /// Reads the next frame's picture back.
    pub fn want_picture(&mut self) {
        self.wants_picture = true;
        self.picture = None;
    }

    /// The picture that was wanted, once it is there.
    pub fn take_picture(&mut self) -> Option<Pixels> {
        self.picture.take()
    }

    /// Whether the picture that was wanted is there.
    pub fn has_picture(&self) -> bool {
        self.picture.is_some()
    }

    /// Looks at a resource after a pass, by their names.
    pub fn look_at(&mut self, resource: &str, pass: &str) {
        let follow = self.inspection.as_ref().is_some_and(|inspection| inspection.follow);
        self.inspection = Some(Inspection { follow, ..Inspection::new(resource, pass) });
    }

    /// Tells why there is nothing to look at.
    pub fn cannot_look(&mut self, why: &str) {
        self.inspection =
            Some(Inspection { found: Some(Err(why.to_owned())), asked: false, ..Inspection::new("", "") });
    }

    /// Counts what was read back: a new number is a new finding.
    pub fn readings(&self) -> u64 {
        self.readings
    }

    /// Submits a frame, if there is a plan; says whether it did.
    pub(super) fn draw(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        background: [f32; 3],
    ) -> Result<bool, BackendError> {
        let (width, height) = self.renderer.size();
        if width == 0 || height == 0 {
            return Ok(false);
        }
        let camera = camera.resized(width, height);
        let uniforms = camera::frame_uniforms(&camera, &scene.bounds(), background, self.frames);
        self.frames = self.frames.wrapping_add(1);
        let inputs = FrameInputs {
            uniforms,
            read_output: std::mem::take(&mut self.wants_picture),
            inspect: self.due().into_iter().collect(),
            show: true,
            ..FrameInputs::default()
        };
        let drawn = match self.renderer.submit(inputs.clone()) {
            // What cannot be looked at is no reason not to draw.
            Err(BackendError::Invalid(why)) if !inputs.inspect.is_empty() => {
                self.say(Err(why));
                self.renderer.submit(FrameInputs { inspect: Vec::new(), ..inputs })?
            }
            other => other?,
        };
        self.collect();
        Ok(drawn)
    }

    /// What of the inspection is to be read in the next frame.
    fn due(&mut self) -> Option<Inspect> {
        let first = self.renderer.is_first_next();
        let plan = self.renderer.plan()?.clone();
        let inspection = self.inspection.as_mut().filter(|i| i.asked || i.follow)?;
        match inspect::resolve(&plan, &inspection.resource, &inspection.pass) {
            Ok(target) if inspect::in_prologue(&plan, &target) && !first => {
                // It is left once per load: the plan is loaded again.
                if inspection.asked && !self.renderer.busy() {
                    self.renderer.want(Cause::Prologue, Instant::now());
                }
                None
            }
            Ok(target) => {
                inspection.asked = false;
                Some(target)
            }
            Err(error) => {
                inspection.asked = false;
                self.say(Err(error.to_string()));
                None
            }
        }
    }

    fn say(&mut self, found: Result<Finding, String>) {
        if let Some(inspection) = &mut self.inspection {
            inspection.found = Some(found);
        }
    }

    /// Takes what the frames that are done gave.
    pub(super) fn collect(&mut self) {
        for mut done in self.renderer.take_done() {
            if done.first {
                self.history.next_plan();
            }
            self.history.push(&done.plan, &done.result);
            self.track.push(&done.plan.name, &done.plan, &done.result);
            if let Some(picture) = done.result.output.take() {
                self.picture = Some(picture);
            }
            self.stats = done.result.stats;
            let visible = self.stat("visible").map(u64::from);
            for (target, bytes) in done.inspected.iter().zip(&done.result.inspected) {
                self.readings += 1;
                self.say(Ok(Finding::new(&done.plan, target, bytes, visible)));
            }
        }
    }
}
