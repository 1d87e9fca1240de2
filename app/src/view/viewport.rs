//! Draws one of the two pictures of the scene, and records its times and inspections.

use super::history::History;
use super::profile::GpuTrack;
use super::renderer::{Cause, Renderer};
use crate::camera;
use crate::growth::Shortage;
use crate::inspect::{self, Finding};
use crate::stats;
use splatgraph_api::{BackendError, Device, FrameInputs, Inspect, Pixels, Recovery};
use splatgraph_assets::{Camera, Scene};
use std::time::Instant;

/// An inspection of a resource after a pass.
#[derive(Clone, Debug)]
pub struct Inspection {
    /// Name of the resource, as for [`inspect::resolve`].
    pub resource: String,
    /// Name of the pass.
    pub pass: String,
    /// True to read it in every frame, not only on request.
    pub follow: bool,
    /// The last finding, or the reason for its absence.
    pub found: Option<Result<Finding, String>>,
    asked: bool,
}

impl Inspection {
    /// Creates an inspection that reads once.
    pub fn new(resource: &str, pass: &str) -> Inspection {
        let (resource, pass) = (resource.to_owned(), pass.to_owned());
        Inspection { resource, pass, follow: false, found: None, asked: true }
    }

    /// Requests another reading.
    pub fn ask(&mut self) {
        self.asked = true;
    }
}

/// The progress of reading a picture back.
#[derive(Debug, Default)]
enum Reading {
    /// None is wanted.
    #[default]
    Idle,
    /// The next frame is to be read.
    Wanted,
    /// A frame in flight is read.
    InFlight,
    /// The picture, or the reason why there is none.
    Done(Result<Pixels, String>),
}

/// A renderer of the scene with its history and inspection.
pub struct Viewport<D: Device> {
    /// The renderer.
    pub renderer: Renderer<D>,
    /// Times of the frames.
    pub history: History,
    /// The inspection; while there is one, resources do not share memory.
    pub inspection: Option<Inspection>,
    /// The graph's statistics of the newest finished frame.
    pub stats: Vec<(String, u32)>,
    /// Lists that the newest finished frame had no room for.
    pub short: Vec<Shortage>,
    /// The progress of reading a picture back; see [`Viewport::take_picture`].
    reading: Reading,
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
            short: Vec::new(),
            reading: Reading::Idle,
            frames: 0,
            readings: 0,
            track: GpuTrack::default(),
        }
    }

    /// Returns a statistic of the graph by its name.
    pub fn stat(&self, name: &str) -> Option<u32> {
        self.stats.iter().find(|(stat, _)| stat == name).map(|(_, value)| *value)
    }

    /// Describes what is drawn in place of a graph that the device lacks something for.
    pub fn stand_in(&self) -> Option<String> {
        let stand_ins = &self.renderer.plan()?.stand_ins;
        let all: Vec<String> = stand_ins.iter().map(ToString::to_string).collect();
        (!all.is_empty()).then(|| all.join("; "))
    }

    /// Describes what facts chose: the graph behind a preset, and the constants with their reasons.
    pub fn decisions(&self) -> Option<String> {
        let plan = self.renderer.plan()?;
        let decisions = plan.decisions();
        // A plan without decisions is what its name says.
        (!decisions.is_empty()).then(|| {
            let named = plan.based_on.iter().map(|base| format!("{base}: "));
            named.collect::<String>() + &decisions.join("; ")
        })
    }

    /// Describes the newest finished frame if it was drawn in part: `drawn in part: 1,234 of 5,678 entries`.
    pub fn in_part(&self) -> Option<String> {
        if self.short.is_empty() {
            return None;
        }
        let short: Vec<String> = self.short.iter().map(Shortage::to_string).collect();
        Some(format!("drawn in part: {}", short.join(", ")))
    }

    /// Describes the newest finished frame if it was drawn in part and the next will be, too: there is no more room.
    pub fn stays_in_part(&self) -> Option<String> {
        let ended = self.short.iter().any(|short| short.room >= short.most);
        let reason = match self.renderer.crowded() {
            Some(reason) => format!("\n{reason}"),
            None if ended => " (the end of the range)".to_owned(),
            None => return None,
        };
        Some(format!("the picture is {}{reason}", self.in_part()?))
    }

    /// Counts the pairs that tiles left in the order of the file in the newest finished frame, if any: see [`stats::unordered`].
    pub fn unordered(&self) -> Option<String> {
        let (_, pairs) = self.stats.iter().find(|(name, _)| name == "unordered")?;
        stats::unordered((*pairs).into())
    }

    /// Requests the next frame's picture.
    pub fn want_picture(&mut self) {
        self.reading = Reading::Wanted;
    }

    /// Takes the requested picture once it is read back, or the reason why it cannot be.
    pub fn take_picture(&mut self) -> Option<Result<Pixels, String>> {
        match std::mem::take(&mut self.reading) {
            Reading::Done(picture) => Some(picture),
            other => {
                self.reading = other;
                None
            }
        }
    }

    /// Returns true once the requested picture can be taken.
    pub fn has_picture(&self) -> bool {
        matches!(self.reading, Reading::Done(_))
    }

    /// Gives a requested picture up.
    pub(super) fn forget_picture(&mut self) {
        self.reading = Reading::Idle;
    }

    /// Inspects a resource after a pass, by their names.
    pub fn look_at(&mut self, resource: &str, pass: &str) {
        let follow = self.inspection.as_ref().is_some_and(|inspection| inspection.follow);
        self.inspection = Some(Inspection { follow, ..Inspection::new(resource, pass) });
    }

    /// Reports the reason why nothing can be inspected.
    pub fn cannot_look(&mut self, why: &str) {
        self.inspection =
            Some(Inspection { found: Some(Err(why.to_owned())), asked: false, ..Inspection::new("", "") });
    }

    /// Counts the readings; a new number means a new finding.
    pub fn readings(&self) -> u64 {
        self.readings
    }

    /// Draws a frame, if it can be drawn now; errors are noted by the renderer.
    pub(super) fn draw(&mut self, scene: &Scene, camera: &Camera, background: [f32; 3]) {
        let (width, height) = self.renderer.size();
        if width > 0 && height > 0 {
            let camera = camera.resized(width, height);
            let uniforms = camera::frame_uniforms(&camera, &scene.bounds(), background, self.frames);
            let inspect = self.due();
            let mut inputs = FrameInputs {
                uniforms,
                read_output: matches!(self.reading, Reading::Wanted),
                inspect: inspect.into_iter().collect(),
                show: true,
                ..FrameInputs::default()
            };
            match self.submit(&mut inputs) {
                Ok(true) => self.note(&inputs),
                Ok(false) => {}
                Err(error) => self.renderer.report(error),
            }
        }
        self.collect();
    }

    /// Submits a frame. If it fails, leaves out the inspection and the picture's reading, so that these cannot prevent it.
    fn submit(&mut self, inputs: &mut FrameInputs) -> Result<bool, BackendError> {
        loop {
            let error = match self.renderer.submit(inputs.clone()) {
                Err(error) if matches!(error.recovery(), Recovery::User | Recovery::Defect) => error,
                other => return other,
            };
            if !inputs.inspect.is_empty() {
                inputs.inspect.clear();
                self.set_asked(false);
                self.set_found(Err(error.to_string()));
            } else if inputs.read_output {
                inputs.read_output = false;
                self.reading = Reading::Done(Err(error.to_string()));
            } else {
                return Err(error);
            }
        }
    }

    /// Notes what a submitted frame reads.
    fn note(&mut self, inputs: &FrameInputs) {
        self.frames = self.frames.wrapping_add(1);
        if inputs.read_output {
            self.reading = Reading::InFlight;
        }
        if !inputs.inspect.is_empty() {
            self.set_asked(false);
        }
    }

    /// Returns the inspection to read in the next frame.
    fn due(&mut self) -> Option<Inspect> {
        let first = self.renderer.is_first_next();
        let plan = self.renderer.plan()?.clone();
        let inspection = self.inspection.as_mut().filter(|i| i.asked || i.follow)?;
        match inspect::resolve(&plan, &inspection.resource, &inspection.pass) {
            Ok(target) if inspect::in_prologue(&plan, &target) && !first => {
                // The prologue runs once per load, so the plan is loaded again.
                if inspection.asked && !self.renderer.busy() {
                    self.renderer.want(Cause::Prologue, Instant::now());
                }
                None
            }
            Ok(target) => Some(target),
            Err(error) => {
                inspection.asked = false;
                self.set_found(Err(error.to_string()));
                None
            }
        }
    }

    fn set_found(&mut self, found: Result<Finding, String>) {
        if let Some(inspection) = &mut self.inspection {
            inspection.found = Some(found);
        }
    }

    fn set_asked(&mut self, asked: bool) {
        if let Some(inspection) = &mut self.inspection {
            inspection.asked = asked;
        }
    }

    /// Takes the results of finished frames.
    pub(super) fn collect(&mut self) {
        if self.renderer.take_forgot() {
            // What the frames without results were to read is read again.
            if matches!(self.reading, Reading::InFlight) {
                self.reading = Reading::Wanted;
            }
            if self.inspection.as_ref().is_some_and(|inspection| inspection.found.is_none()) {
                self.set_asked(true);
            }
        }
        for mut done in self.renderer.take_done() {
            if done.first {
                self.history.next_plan();
            }
            self.history.push(&done.plan, &done.result);
            self.track.push(&done.plan.name, &done.plan, &done.result);
            self.short = done.short;
            if let Some(picture) = done.result.output.take()
                && matches!(self.reading, Reading::InFlight)
            {
                self.reading = match self.in_part() {
                    None => Reading::Done(Ok(picture)),
                    // A plan with more room is on its way.
                    Some(_) if self.renderer.busy() => Reading::Wanted,
                    Some(text) => Reading::Done(Err(format!("the picture is {text}"))),
                };
            }
            self.stats = done.result.stats;
            let visible = self.stat("visible").map(u64::from);
            for (target, bytes) in done.inspected.iter().zip(&done.result.inspected) {
                self.readings += 1;
                self.set_found(Ok(Finding::new(&done.plan, target, bytes, visible)));
            }
        }
    }
}
