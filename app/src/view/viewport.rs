//! Draws one of the two pictures of the scene, and records its times and inspections.
//!
//! A frame is drawn if it would differ from the last one, if something is to be read from it, if the last one failed or
//! lost its results, if the plan has no times except the prologue frame's, or if the window does not show this scene
//! and graph yet. A plan whose frames may differ for equal inputs is drawn continuously, as is every plan on request.
//!
//! The window's graph reads the picture on the device. If the window has its own device, the picture is copied through
//! host memory.

use super::events::Cause;
use super::history::History;
use super::paint::Shown;
use super::profile::GpuTrack;
use super::renderer::{FinishedFrame, Renderer};
use crate::draw::animation::is_animated;
use crate::draw::camera;
use crate::draw::capacity::Overflow;
use crate::draw::inspect::{self, Finding};
use crate::draw::projection;
use splatgraph_api::{BackendError, BufferContents, Device, FrameInputs, Inspect, Pixels, Recovery};
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::ir::Fallback;
use splatgraph_framework::plan::Plan;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::Instant;

/// A request to read a resource back after a pass, with its result.
#[derive(Clone, Debug)]
pub struct Inspection {
    /// Name of the resource, as for [`inspect::resolve`].
    pub resource: String,
    /// Name of the pass.
    pub pass: String,
    /// True to read the resource in every frame, not only on request.
    pub follow: bool,
    /// Latest finding, or the reason why there is none; `None` before the first reading.
    pub found: Option<Result<Finding, String>>,
    /// Number of the frame that the last finding was read from; see [`Renderer::submitted`].
    pub frame: u64,
    /// Plan of the last reading, which may be in flight. With another plan or none, a reading is requested.
    read: Weak<Plan>,
    /// Plan that `found` was read from.
    found_in: Weak<Plan>,
}

impl Inspection {
    /// Creates an inspection that reads the resource once per plan.
    pub fn new(resource: &str, pass: &str) -> Inspection {
        let (resource, pass) = (resource.to_owned(), pass.to_owned());
        let (read, found_in) = Default::default();
        Inspection { resource, pass, follow: false, found: None, frame: 0, read, found_in }
    }

    /// Requests another reading in the next frame.
    pub fn ask(&mut self) {
        self.read = Weak::new();
    }

    fn set_found(&mut self, found: Result<Finding, String>, plan: &Arc<Plan>) {
        self.found = Some(found);
        self.found_in = Arc::downgrade(plan);
    }
}

#[derive(Debug, Default)]
enum Reading {
    #[default]
    Idle,
    /// The next frame is to be read back.
    Wanted,
    /// The frame with this number is being read back; see [`Renderer::submitted`].
    InFlight(u64),
    Done(Result<Pixels, String>),
}

/// Inputs of a viewport's picture, except its graph.
pub(super) struct View<'a> {
    /// The scene as drawn, without its hidden splats.
    pub scene: &'a Scene,
    /// The scene as loaded. It determines the scale of orthographic views, which hiding splats must not change.
    pub loaded: &'a Scene,
    pub camera: &'a Camera,
    /// Background colour, display-encoded.
    pub background: [f32; 3],
    /// True to draw a frame even if nothing changed.
    pub continuous: bool,
    /// True if the picture goes to the window through host memory.
    pub to_host: bool,
}

struct Drawn {
    plan: Arc<Plan>,
    uniforms: BTreeMap<String, Vec<u8>>,
    live: Vec<u8>,
}

impl PartialEq for Drawn {
    fn eq(&self, other: &Drawn) -> bool {
        Arc::ptr_eq(&self.plan, &other.plan) && (&self.uniforms, &self.live) == (&other.uniforms, &other.live)
    }
}

/// The picture that the window shows, and its origin.
struct Exhibit {
    shown: Shown,
    /// Number of the picture, unique among all viewports.
    number: u64,
    plan: Arc<Plan>,
    /// Value of [`Renderer::subject`] when the picture was drawn.
    subject: u64,
}

/// A renderer of the scene with its history and inspection.
pub struct Viewport {
    /// Renderer of the picture.
    pub renderer: Renderer,
    /// Times of recent frames.
    pub history: History,
    /// The inspection; while there is one, resources do not share memory.
    pub inspection: Option<Inspection>,
    /// Names and values of the graph's statistics in the newest finished frame.
    pub stats: Vec<(String, u32)>,
    /// Lists that overflowed in the newest finished frame.
    pub short: Vec<Overflow>,
    reading: Reading,
    drawn: Option<Drawn>,
    /// Picture that the window shows; `None` before the first on the current device.
    exhibit: Option<Exhibit>,
    animated: bool,
    /// True if a frame is due, but could not be submitted.
    waits: bool,
    readings: u64,
    track: GpuTrack,
}

impl Viewport {
    pub(super) fn new(renderer: Renderer) -> Viewport {
        Viewport {
            renderer,
            history: History::default(),
            inspection: None,
            stats: Vec::new(),
            short: Vec::new(),
            reading: Reading::Idle,
            drawn: None,
            exhibit: None,
            animated: false,
            waits: false,
            readings: 0,
            track: GpuTrack::default(),
        }
    }

    /// Describes the fallback that is drawn because a preferred graph's own requirements are not met. `None` if they
    /// are met, or without a plan.
    pub fn fallback(&self) -> Option<String> {
        let lacking = Fallback::lacking(&self.renderer.plan()?.fallbacks);
        let all: Vec<String> = lacking.map(ToString::to_string).collect();
        (!all.is_empty()).then(|| all.join("; "))
    }

    /// Describes the constant choices and bools whose values follow from facts, with reasons, after the graphs that a
    /// preset or choice resolves to. `None` without such a constant, or without a plan.
    pub fn decisions(&self) -> Option<String> {
        let plan = self.renderer.plan()?;
        let decisions = plan.decisions();
        (!decisions.is_empty()).then(|| {
            let named = plan.based_on.iter().map(|base| format!("{base}: "));
            named.collect::<String>() + &decisions.join("; ")
        })
    }

    /// Describes the newest finished frame if a list overflowed: `partially drawn: 1,234 of 5,678 entries`. `None` for
    /// a complete frame, or if the window does not show the frame.
    pub fn in_part(&self) -> Option<String> {
        if self.is_held_back() { None } else { self.part() }
    }

    /// Names the lists that overflowed in the newest finished frame, which may not be shown; `None` if none did.
    fn part(&self) -> Option<String> {
        let short: Vec<String> = self.short.iter().map(Overflow::to_string).collect();
        (!short.is_empty()).then(|| format!("partially drawn: {}", short.join(", ")))
    }

    /// Describes the newest finished frame if it was incomplete and capacity cannot grow any further; otherwise `None`.
    pub fn stays_in_part(&self) -> Option<String> {
        let ended = self.short.iter().any(|short| short.room >= short.most);
        let reason = match self.renderer.crowded() {
            Some(reason) => format!("\n{reason}"),
            None if ended => " (the end of the range)".to_owned(),
            None => return None,
        };
        Some(format!("the picture is {}{reason}", self.part()?))
    }

    /// Requests a read-back of the next frame's picture; see [`Viewport::take_picture`].
    pub fn want_picture(&mut self) {
        self.reading = Reading::Wanted;
    }

    /// Returns true if a picture was requested, and no submitted frame reads it back yet.
    pub(super) fn wants_picture(&self) -> bool {
        matches!(self.reading, Reading::Wanted)
    }

    /// Takes the requested picture, or the error, once it has been read back; `None` until then, and without a request.
    pub fn take_picture(&mut self) -> Option<Result<Pixels, String>> {
        match std::mem::take(&mut self.reading) {
            Reading::Done(picture) => Some(picture),
            other => {
                self.reading = other;
                None
            }
        }
    }

    /// Returns true if [`Viewport::take_picture`] would return the requested picture or an error.
    pub fn has_picture(&self) -> bool {
        matches!(self.reading, Reading::Done(_))
    }

    pub(super) fn forget_picture(&mut self) {
        self.reading = Reading::Idle;
    }

    /// Inspects a resource after a pass, both by name; keeps [`Inspection::follow`] of the previous inspection.
    pub fn look_at(&mut self, resource: &str, pass: &str) {
        let follow = self.inspection.as_ref().is_some_and(|inspection| inspection.follow);
        self.inspection = Some(Inspection { follow, ..Inspection::new(resource, pass) });
    }

    /// Returns true if there is an inspection that has neither a finding nor an error from the current plan yet.
    pub fn lacks_finding(&self) -> bool {
        let current = self.renderer.plan().map(Arc::downgrade).unwrap_or_default();
        self.inspection.as_ref().is_some_and(|i| i.found.is_none() || !i.found_in.ptr_eq(&current))
    }

    /// Returns the number of inspection results read back so far. Pictures are not counted.
    pub fn readings(&self) -> u64 {
        self.readings
    }

    /// Returns the picture that the window shows, and its unique number; `None` before the first on the current device.
    pub fn picture(&self) -> Option<(Shown, u64)> {
        self.exhibit.as_ref().map(|exhibit| (exhibit.shown.clone(), exhibit.number))
    }

    /// Returns true if the window does not show this scene and graph yet. No frame of them was then drawn, or every
    /// frame overflowed. False without a plan.
    pub fn is_held_back(&self) -> bool {
        self.renderer.plan().is_some()
            && self.exhibit.as_ref().map(|exhibit| exhibit.subject) != Some(self.renderer.subject())
    }

    /// Returns true until the window shows a picture of the current plan, unless an error prevents it. False without a
    /// plan.
    pub(super) fn is_coming(&self) -> bool {
        let is_shown = |plan| self.exhibit.as_ref().is_some_and(|exhibit| Arc::ptr_eq(&exhibit.plan, plan));
        self.renderer.trouble().is_none() && self.renderer.plan().is_some_and(|plan| !is_shown(plan))
    }

    pub(super) fn is_animated(&self) -> bool {
        self.animated
    }

    pub(super) fn waits(&self) -> bool {
        self.waits
    }

    /// Returns true if a frame of the current plan can be shown. An incomplete frame is shown only if capacity cannot
    /// grow, or if the window already shows this scene and graph.
    fn can_show(&self) -> bool {
        !self.is_held_back() || self.renderer.is_at_best()
    }

    /// Draws a frame if one is due and can be drawn now. Errors are reported to the renderer.
    pub(super) fn draw(&mut self, view: &View) {
        self.collect(view.to_host);
        self.waits = false;
        let (width, height) = self.renderer.size();
        // A camera of the new scene would not show anything useful in the previous one.
        let can_draw = width > 0 && height > 0 && self.renderer.draws(view.scene);
        let Some(plan) = self.renderer.plan().cloned().filter(|_| can_draw) else { return };
        let graph = projection::of_params(&plan.params);
        let camera = projection::shown(&view.camera.resized(width, height), graph, view.loaded);
        let uniforms =
            |number| camera::frame_uniforms(&camera, &view.scene.bounds(), view.background, number);
        let drawn = Drawn { live: self.renderer.live(&plan), plan, uniforms: uniforms(0) };
        if self.drawn.as_ref().is_none_or(|former| !Arc::ptr_eq(&former.plan, &drawn.plan)) {
            self.animated = is_animated(&drawn.plan);
        }
        let (show, inspect) = (self.can_show(), self.due());
        let due = view.continuous
            || self.drawn.as_ref() != Some(&drawn)
            || self.animated
            || self.renderer.must_redraw()
            || inspect.is_some() && self.asks(&drawn.plan)
            || self.wants_picture()
            || self.lacks_times(&drawn.plan)
            || show && self.is_held_back() && self.renderer.in_flight() == 0;
        if !due {
            return;
        }
        let mut inputs = FrameInputs {
            uniforms: uniforms(self.renderer.submitted() as u32),
            read_output: view.to_host || matches!(self.reading, Reading::Wanted),
            inspect: inspect.into_iter().collect(),
            show: show && !view.to_host,
            ..FrameInputs::default()
        };
        match self.submit(&mut inputs, &drawn.plan, view.to_host) {
            Ok(true) => {
                self.note(&inputs, &drawn.plan);
                if inputs.show
                    && let Some(picture) = self.renderer.device().and_then(Device::picture)
                {
                    self.exhibit(picture.into(), drawn.plan.clone());
                }
                self.drawn = Some(drawn);
            }
            Ok(false) => self.waits = true,
            Err(error) => {
                self.waits = true;
                self.renderer.report(error);
            }
        }
        self.collect(view.to_host);
    }

    /// Returns true if all finished frames of a plan ran the prologue and none is in flight. Such frames' times are not
    /// representative.
    fn lacks_times(&self, plan: &Arc<Plan>) -> bool {
        let measured = self.history.is_of(plan) && self.history.steady_frames() == 0;
        measured && self.renderer.in_flight() == 0
    }

    fn exhibit(&mut self, shown: Shown, plan: Arc<Plan>) {
        static NUMBERS: AtomicU64 = AtomicU64::new(0);
        let number = NUMBERS.fetch_add(1, Ordering::Relaxed);
        self.exhibit = Some(Exhibit { shown, number, plan, subject: self.renderer.subject() });
    }

    pub(super) fn release(&mut self) {
        self.renderer.release();
        (self.drawn, self.exhibit) = (None, None);
        self.collect(false);
    }

    /// Submits a frame. If the device refuses it, retries without the inspection and then without the read-back, so
    /// that neither prevents the frame. The read-back stays if `to_host`, where each picture is read back.
    fn submit(
        &mut self,
        inputs: &mut FrameInputs,
        plan: &Arc<Plan>,
        to_host: bool,
    ) -> Result<bool, BackendError> {
        loop {
            let error = match self.renderer.submit(inputs.clone()) {
                Err(error) if matches!(error.recovery(), Recovery::User | Recovery::Defect) => error,
                other => return other,
            };
            if !inputs.inspect.is_empty() {
                inputs.inspect.clear();
                if let Some(inspection) = &mut self.inspection {
                    inspection.read = Arc::downgrade(plan);
                    inspection.set_found(Err(error.to_string()), plan);
                }
            } else if matches!(self.reading, Reading::Wanted) {
                inputs.read_output = to_host;
                self.reading = Reading::Done(Err(error.to_string()));
            } else {
                return Err(error);
            }
        }
    }

    /// Records that the requested read-back and inspection are in flight.
    fn note(&mut self, inputs: &FrameInputs, plan: &Arc<Plan>) {
        if inputs.read_output && matches!(self.reading, Reading::Wanted) {
            self.reading = Reading::InFlight(self.renderer.submitted());
        }
        if let Some(inspection) = self.inspection.as_mut().filter(|_| !inputs.inspect.is_empty()) {
            inspection.read = Arc::downgrade(plan);
        }
    }

    fn due(&mut self) -> Option<Inspect> {
        let first = self.renderer.is_first_next();
        let plan = self.renderer.plan()?.clone();
        let asks = self.asks(&plan);
        let inspection = self.inspection.as_mut().filter(|inspection| asks || inspection.follow)?;
        match inspect::resolve(&plan, &inspection.resource, &inspection.pass) {
            Ok(target) if inspect::in_prologue(&plan, &target) && !first => {
                // The prologue has already run; only a new plan runs it again.
                if asks && !self.renderer.busy() {
                    self.renderer.want(Cause::Prologue, Instant::now());
                }
                None
            }
            Ok(target) => Some(target),
            Err(error) => {
                inspection.read = Arc::downgrade(&plan);
                inspection.set_found(Err(error.to_string()), &plan);
                None
            }
        }
    }

    /// Returns true if a reading of the inspection was requested, which makes a frame due.
    fn asks(&self, plan: &Arc<Plan>) -> bool {
        let plan = Arc::downgrade(plan);
        self.inspection.as_ref().is_some_and(|inspection| !inspection.read.ptr_eq(&plan))
    }

    /// Takes the results of finished frames. If `to_host`, the window gets their pictures, as far as they can be shown.
    pub(super) fn collect(&mut self, to_host: bool) {
        if self.renderer.take_forgot() {
            // Repeat the reads that were lost with these frames.
            if matches!(self.reading, Reading::InFlight(_)) {
                self.reading = Reading::Wanted;
            }
            if let Some(inspection) = &mut self.inspection {
                inspection.read = Weak::new();
            }
        }
        for mut done in self.renderer.take_done() {
            self.history.push(&done.plan, &done.result);
            self.track.push(&done.plan.name, &done.plan, &done.result);
            self.short = std::mem::take(&mut done.short);
            if let Some(picture) = done.result.output.take() {
                self.take_output(picture, &done, to_host);
            }
            self.stats = done.result.stats;
            for (target, bytes) in done.inspected.iter().zip(&done.result.inspected) {
                self.readings += 1;
                if let Some(inspection) = &mut self.inspection {
                    let found = Finding::new(&done.plan, target, bytes, &self.stats);
                    inspection.set_found(Ok(found), &done.plan);
                    inspection.frame = done.number;
                }
            }
        }
    }

    /// Takes a picture that was read back: for the request, and for the window if `to_host`. An incomplete picture
    /// fails the request, or repeats it while a plan with more capacity is being built.
    fn take_output(&mut self, picture: Pixels, done: &FinishedFrame, to_host: bool) {
        if matches!(self.reading, Reading::InFlight(number) if number <= done.number) {
            self.reading = match self.part() {
                None => Reading::Done(Ok(picture.clone())),
                // A plan with more capacity is being built.
                Some(_) if self.renderer.busy() => Reading::Wanted,
                Some(text) => Reading::Done(Err(format!("the picture is {text}"))),
            };
        }
        let is_current = self.renderer.plan().is_some_and(|plan| Arc::ptr_eq(plan, &done.plan));
        if to_host && (is_current || !self.is_held_back()) && self.can_show() {
            let Pixels { format, width, height, bytes } = picture;
            let pixels = BufferContents::Bytes(Arc::new(bytes.to_vec()));
            self.exhibit(Shown { format, width, height, pixels }, done.plan.clone());
        }
    }
}
