//! Runs the viewer without a window system: a [`Viewer`], the panels around it, and the graph that draws both.
//!
//! The window's graph, `pipelines/view/window.ron`, draws the pictures of the scene (one, two with a split line, or
//! their difference) and egui's triangles over them. A window presents its frames, or a test reads them back.
//!
//! A frame of the window is drawn if it would differ from the last one, if the last one failed or was not shown, if the
//! window's graph has a new plan, or if a [`FrameRequest`] demands it. It is also drawn if frames are drawn
//! continuously. A [`Frame`] contains the time of the next one. The shell's owner sleeps until then, or until an event,
//! and polls for finished frames ([`Shell::collect`]) while some are in flight.
//!
//! On a CPU, the scene has its own device ([`crate::draw::backend::Backend::open_beside`]), so that the window stays
//! responsive during a long picture. On a GPU, both share one queue, in which frames of the window would wait behind a
//! picture; during a long picture, the window submits no frames.

use super::events::{Event, RendererId};
use super::history::History;
use super::paint::{Composition, Painter};
use super::panels::{Command, Panels, theme};
use super::profile::{self, zone};
use super::renderer::{self, Choice, Failure, PlanInputs, Renderer, Wake};
use super::viewer::{Viewer, ViewerError};
use super::viewport::Viewport;
use crate::draw::backend::Backend;
use egui::epaint::ClippedPrimitive;
use egui::epaint::textures::TexturesDelta;
use egui::{Context, RawInput, Rect, Vec2, ViewportId, vec2};
use splatgraph_api::{BackendError, BufferContents, Device, FrameInputs, Pixels, Running};
use splatgraph_framework::plan::Plan;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Interval between frames while progress of a build or load is shown.
const PROGRESS: Duration = Duration::from_millis(250);

/// Minimum interval between frames on a CPU, which also draws the scene.
const ANIMATION: Duration = Duration::from_millis(33);

/// Pause after a frame that drew nothing, if the next frame is due immediately.
const UNDRAWN: Duration = Duration::from_millis(8);

/// Pause before the window is drawn again, after a frame that could not be presented.
const UNSHOWN: Duration = Duration::from_millis(250);

/// Age of a picture in flight at which the window stops submitting frames: they would only queue up behind it.
const QUEUE: Duration = Duration::from_millis(100);

/// Size and destination of a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameRequest {
    /// Size of the window, in pixels.
    pub size: (u32, u32),
    /// True to present the frame in the device's window.
    pub present: bool,
    /// True to read the frame back.
    pub read: bool,
    /// True to draw the frame even if nothing changed, because the window may have lost its content.
    pub redraw: bool,
}

/// Results of a window frame.
pub struct Frame {
    /// Output for the window system, such as clipboard and pointer shape.
    pub platform: egui::PlatformOutput,
    /// Requests to the window, ordered as in [`PanelOutput::commands`](super::panels::PanelOutput::commands).
    pub commands: Vec<Command>,
    /// True if the window was drawn; false if nothing changed, the frame could not be submitted yet, or drawing failed.
    pub drawn: bool,
    /// Time of the next frame; `None` to wait for an event. Completion of frames in flight is not included: see
    /// [`Shell::in_flight`].
    pub next: Option<Instant>,
    /// Pixels of the window; `None` unless the picture of a frame that was to be read back is ready.
    pub picture: Option<Pixels>,
    /// Error that reported the loss of the device or of its window surface. Nothing is drawn until [`Shell::release`]
    /// and [`Shell::give`] were called.
    pub lost: Option<BackendError>,
}

/// The viewer with its panels and the window's graph.
pub struct Shell {
    /// Scene, camera and viewports.
    pub viewer: Viewer,
    /// Panels around the pictures.
    pub panels: Panels,
    ctx: Context,
    painter: Painter,
    canvas: Renderer,
    history: History,
    events: Vec<Event>,
    /// Content of the window's newest frame, without the user interface. `None` before the first, on new devices, and
    /// if the window did not show the frame.
    shown: Option<Content>,
    /// Time to draw the window again, after a frame that was drawn but not presented; otherwise `None`.
    again: Option<Instant>,
    /// True if a frame of the window is due, but its device could not accept it yet, or failed.
    owed: bool,
    /// True if a frame in flight is to be read back.
    reading: bool,
    presented: (u32, u32),
    reported: u64,
    /// [`Shell::changes`] before the panels of the last frame were drawn.
    seen: u64,
}

/// Numbers and composition of the pictures in the window; the window is drawn again if they change.
#[derive(PartialEq)]
struct Content {
    pictures: [Option<u64>; 2],
    arrangement: Vec<u8>,
}

impl Shell {
    /// Creates a shell. `canvas` draws the window; it must be the device of the window, if there is one. `graph` is
    /// `paint::GRAPH`, or another graph (a built-in name or a path) with the imports of `paint::offer`.
    ///
    /// # Errors
    /// See [`Renderer::new`].
    pub fn new(mut viewer: Viewer, canvas: Backend, graph: &str, wake: Wake) -> Result<Shell, ViewerError> {
        let ctx = Context::default();
        ctx.set_theme(egui::Theme::Dark);
        theme::install(&ctx);
        // Pressing on the picture, not only clicking it, returns keyboard focus to the camera.
        ctx.options_mut(|options| {
            options.input_options.surrender_focus_on = egui::SurrenderFocusOn::Presses;
        });
        viewer.to_host = !viewer.a.renderer.device().is_some_and(|device| device.shares_device(&canvas));
        Ok(Shell {
            viewer,
            panels: Panels::new(),
            ctx,
            painter: Painter::default(),
            canvas: Renderer::new(RendererId::Window, canvas, Choice::new(graph, &[]), wake)?,
            history: History::default(),
            events: Vec::new(),
            shown: None,
            again: None,
            owed: false,
            reading: false,
            presented: (0, 0),
            reported: 0,
            seen: 0,
        })
    }

    /// Returns the context of the user interface.
    pub fn context(&self) -> &Context {
        &self.ctx
    }

    /// Returns the renderer of the window.
    pub fn window(&self) -> &Renderer {
        &self.canvas
    }

    /// Returns the window's renderer, to change its device or how long it waits for a frame.
    pub fn window_mut(&mut self) -> &mut Renderer {
        &mut self.canvas
    }

    /// Returns the failure of the window's graph, if it has no plan: nothing can be shown then.
    pub fn is_blind(&self) -> Option<&Failure> {
        if self.canvas.plan().is_some() { None } else { self.canvas.failure() }
    }

    /// Describes the first error that prevents showing the requested state, without colours; `None` if there is none.
    ///
    /// Covers A, B if it is shown, A's inspection, the requested selection, the window itself, and pictures that stay
    /// incomplete.
    pub fn problem(&self) -> Option<String> {
        let viewer = &self.viewer;
        let in_part = viewer.shown().find_map(Viewport::stays_in_part);
        let renderers = viewer.shown().map(|viewport| &viewport.renderer);
        let drawn = renderers.chain([&self.canvas]).find_map(|renderer| renderer.problem(false));
        let inspected =
            viewer.a.inspection.as_ref().and_then(|inspection| inspection.found.as_ref()?.as_ref().err());
        let requested = inspected.map(ToString::to_string).or_else(|| self.panels.missing());
        drawn.or_else(|| requested.or(in_part).map(|text| format!("error: {text}")))
    }

    /// Returns true if the next frame shows the requested state, or [`Shell::problem`] prevents it.
    pub fn is_settled(&self) -> bool {
        let waits = self.viewer.a.lacks_finding() || self.panels.waits_for_picture();
        !self.viewer.busy() && (!waits || self.problem().is_some())
    }

    /// Opens dropped files, applies the input, and draws the pictures and the window if they changed.
    pub fn frame(&mut self, mut input: RawInput, request: FrameRequest) -> Frame {
        zone!("window frame");
        let begun = Instant::now();
        for file in &input.dropped_files {
            self.viewer.open_in(self.panels.selected, file.path());
        }
        self.panels.prepare(&mut input);
        self.collect_all();
        self.seen = self.changes();
        let before = self.viewer.navigation.camera(1, 1);
        let problem = self.canvas.problem(true);
        let (mut view, mut commands) = (Rect::ZERO, Vec::new());
        let first = self.ctx.cumulative_pass_nr() == 0;
        let output = self.ctx.run_ui(input, |ui| {
            let (panels, viewer) = (&mut self.panels, &mut self.viewer);
            let shown = panels.show(ui, viewer, &self.history, problem.as_deref());
            // egui may run the closure twice, the first time only for the layout.
            view = shown.view;
            commands.extend(shown.commands);
            if first {
                // Panel sizes, and thus the size of the picture, are only known in a second pass.
                ui.ctx().request_discard("the panels take their sizes");
            }
            if viewer.is_animated() || viewer.is_moving() || viewer.navigation.camera(1, 1) != before {
                // A motion needs another frame. egui measures the time between frames only if the second was requested.
                ui.ctx().request_repaint();
            }
        });
        let pixels_per_point = output.pixels_per_point;
        let primitives = self.ctx.tessellate(output.shapes, pixels_per_point);

        let [_, _, width, height] = pixels(view, Vec2::splat(pixels_per_point));
        // Recreating the swapchain waits for all frames in flight, which would block this thread.
        let resized = request.present && request.size != self.presented;
        let drains = resized && !self.viewer.to_host && self.in_flight().is_some();
        self.viewer.rests = drains;
        self.viewer.frame((width, height));
        for event in self.viewer.take_events() {
            self.report(event);
        }
        let interface = (output.textures_delta, primitives, pixels_per_point);
        self.canvas.paused = drains || !self.is_free();
        if let Some(canvas) = self.canvas.device_mut() {
            canvas.set_vsync(self.panels.vsync);
        }
        let (drawn, picture) = self.paint(request, view, interface);
        if drawn {
            self.presented = request.size;
        }
        profile::frame();
        let repaint = output.viewport_output.get(&ViewportId::ROOT).map(|viewport| viewport.repaint_delay);
        let next = self.next(begun, drawn, repaint.unwrap_or(Duration::MAX));
        let lost = self.viewer.lost().or_else(|| self.canvas.lost()).cloned();
        Frame { platform: output.platform_output, commands, drawn, next, picture, lost }
    }

    /// Returns the time of the next frame after one that began at `begun`; `None` to wait for an event. `drawn` is true
    /// if that frame drew the window; `repaint` is the delay that egui requests.
    fn next(&self, begun: Instant, drawn: bool, repaint: Duration) -> Option<Instant> {
        if self.changes() != self.seen {
            // Something changed after the panels were drawn.
            return Some(begun);
        }
        let least = match drawn {
            _ if self.canvas.reads_block() => ANIMATION,
            // Presentation limits the frame rate.
            true => Duration::ZERO,
            false => UNDRAWN,
        };
        let repaint = match self.viewer.is_animated() {
            // The end of the picture in flight triggers the next frame.
            true if self.viewer.waits() || self.viewer.to_host && self.viewer.newest().is_some() => None,
            true => Some(begun + least),
            // egui means "never" by a delay that overflows `Instant`.
            false => begun.checked_add(repaint.max(least)),
        };
        let busy = self.viewer.busy() || self.canvas.busy();
        let progress = busy.then(|| begun + PROGRESS);
        let retry = self.canvas.retry().filter(|_| self.owed);
        let all = [repaint, progress, retry, self.again, self.viewer.next(), self.canvas.next()];
        all.into_iter().flatten().min()
    }

    fn changes(&self) -> u64 {
        self.viewer.changes() + self.canvas.changes() + self.reported
    }

    /// Takes the results of finished frames; returns true if another frame should be drawn now.
    pub fn collect(&mut self) -> bool {
        self.collect_all();
        let waits = self.owed || self.reading || self.viewer.waits() || self.viewer.is_animated();
        self.changes() != self.seen || waits && self.in_flight().is_none()
    }

    fn collect_all(&mut self) {
        self.viewer.collect(Duration::ZERO);
        self.collect_window(Duration::ZERO);
    }

    /// Returns the submission time of the newest frame in flight; `None` if there is none.
    pub fn in_flight(&self) -> Option<Instant> {
        self.viewer.newest().max(self.canvas.newest())
    }

    /// Takes the results of the window's finished frames; returns true if another can be submitted. Waits up to
    /// `patience` for that.
    fn collect_window(&mut self, patience: Duration) -> bool {
        renderer::frames::collect(&mut [&mut self.canvas], patience)
    }

    /// Takes the results of the window's finished frames; returns true if another would not wait long behind a picture.
    fn is_free(&mut self) -> bool {
        let behind = |since: Instant| since.elapsed() >= QUEUE;
        let apart = self.viewer.to_host;
        self.collect_window(self.canvas.patience) && (apart || !self.viewer.newest().is_some_and(behind))
    }

    /// Draws the window if its content changed or `request` demands it. Returns whether it was drawn, and the pixels of
    /// a frame that was read back. `view` is in points.
    fn paint(
        &mut self,
        request: FrameRequest,
        view: Rect,
        (textures, primitives, pixels_per_point): (TexturesDelta, Vec<ClippedPrimitive>, f32),
    ) -> (bool, Option<Pixels>) {
        let inputs = PlanInputs { scene: None, size: request.size, share_memory: true };
        self.canvas.poll(&inputs, Instant::now());
        // After a resize, the plan keeps its size until another is built, which an error may prevent. Presenting its
        // picture stretches it over the window, so everything is drawn at the plan's scale.
        let size = if self.canvas.plan().is_some() { self.canvas.size() } else { request.size };
        let ratio = |of: u32, to: u32| of as f32 / to.max(1) as f32;
        let scale = vec2(ratio(size.0, request.size.0), ratio(size.1, request.size.1)) * pixels_per_point;
        let [a, b] = self.viewer.pictures();
        let pictures = [&a, &b].map(|picture| picture.as_ref().map(|(_, number)| *number));
        let composition = Composition {
            window: [size.0, size.1],
            view: pixels(view, scale),
            mode: self.viewer.compare,
            split: self.viewer.split,
            amplification: self.viewer.gain,
            a: a.map(|(shown, _)| shown),
            b: b.map(|(shown, _)| shown),
        };
        // A new plan has an empty history, and a user's graph may have none: repaint the whole window.
        let keeps = |plan: &Arc<Plan>| plan.resource(plan.output).history.is_some();
        if self.canvas.is_first_next() || !self.canvas.plan().is_some_and(keeps) {
            self.painter.forget();
        }
        let painted = self.painter.paint(textures, primitives, scale, &composition);
        let content = Content { pictures, arrangement: composition.bytes() };
        self.reading &= !self.canvas.take_forgot();
        let due = request.read && !self.reading
            || request.redraw
            || self.viewer.continuous && !self.viewer.waits()
            || self.canvas.is_first_next()
            || self.canvas.must_redraw()
            || self.painter.differs()
            || self.shown.as_ref() != Some(&content);
        (self.owed, self.again) = (false, None);
        let mut drawn = Ok(false);
        if due {
            let mut inputs = FrameInputs {
                present: request.present,
                read_output: request.read && !self.reading,
                ..FrameInputs::default()
            };
            let reads = inputs.read_output;
            composition.give(&mut inputs);
            let painted =
                painted.into_iter().map(|(name, bytes)| (name.to_owned(), BufferContents::Bytes(bytes)));
            inputs.buffers.extend(painted);
            drawn = self.canvas.submit(inputs);
            if reads && matches!(drawn, Ok(true)) {
                self.reading = true;
                // If the wait times out, a later frame returns the picture.
                match self.canvas.finish(self.canvas.patience) {
                    Ok(()) | Err(BackendError::Stuck { .. }) => {}
                    Err(error) => drawn = Err(error),
                }
            }
            match &drawn {
                Ok(true) => {
                    self.painter.drawn();
                    let missed = self.canvas.device().is_some_and(Device::missed_window);
                    self.shown = (!missed).then_some(content);
                    self.again = missed.then(|| Instant::now() + UNSHOWN);
                }
                Ok(false) => self.owed = true,
                Err(_) => {
                    self.owed = true;
                    self.painter.forget();
                }
            }
        }
        let drawn = drawn.unwrap_or_else(|error| {
            self.canvas.report(error);
            false
        });
        let mut picture = None;
        for mut done in self.canvas.take_done() {
            self.history.push(&done.plan, &done.result);
            picture = done.result.output.take().or(picture);
        }
        self.reading &= picture.is_none();
        for event in self.canvas.take_events() {
            self.report(event);
        }
        (drawn, picture)
    }

    /// Takes the events reported since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Logs an event, and queues it for [`Shell::take_events`].
    pub fn report(&mut self, event: Event) {
        self.panels.log_event(&event);
        self.reported += 1;
        self.events.push(event);
    }

    /// Waits up to `within` for each renderer's frames in flight.
    ///
    /// # Errors
    /// See [`Renderer::finish`].
    pub fn finish(&mut self, within: Duration) -> Result<(), BackendError> {
        self.viewer.finish(within)?;
        self.canvas.finish(within)
    }

    /// Waits for running builds until `end` at the latest; returns true if none is running.
    pub fn is_idle(&mut self, end: Instant) -> bool {
        loop {
            let idle = self.viewer.is_idle() && self.canvas.is_idle();
            if idle || Instant::now() >= end {
                return idle;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Returns the pass or frame that the device did not finish in time; see [`Renderer::stalled`].
    pub fn stalled(&self) -> Option<&Running> {
        self.viewer.stalled().or_else(|| self.canvas.stalled())
    }

    /// Drops the devices and everything on them, after a loss.
    pub fn release(&mut self) {
        self.viewer.release();
        self.canvas.release();
    }

    /// Returns true once no build holds a dropped device.
    pub fn is_released(&mut self) -> bool {
        let viewer = self.viewer.is_released();
        self.canvas.is_released() && viewer
    }

    /// Continues on new devices: `canvas` draws the window, as in [`Shell::new`]; `device` draws the scene.
    ///
    /// # Errors
    /// See [`Viewer::give`].
    pub fn give(&mut self, canvas: Backend, device: Backend) -> Result<(), BackendError> {
        self.viewer.to_host = !device.shares_device(&canvas);
        self.shown = None;
        self.canvas.give(canvas);
        self.viewer.give(device)
    }

    /// Closes the shell, and returns the devices of the scene and of the window, except released ones.
    pub fn into_devices(self) -> Vec<Backend> {
        let Shell { viewer, canvas, .. } = self;
        [viewer.into_device(), canvas.into_device()].into_iter().flatten().collect()
    }
}

/// Converts a rectangle from points to whole pixels: left, top, width, height.
fn pixels(Rect { min, max }: Rect, pixels_per_point: Vec2) -> [u32; 4] {
    let pixel = |v: f32, scale: f32| (v * scale).round().max(0.0) as u32;
    let (left, top) = (pixel(min.x, pixels_per_point.x), pixel(min.y, pixels_per_point.y));
    let (right, bottom) = (pixel(max.x, pixels_per_point.x), pixel(max.y, pixels_per_point.y));
    [left, top, right.saturating_sub(left), bottom.saturating_sub(top)]
}
