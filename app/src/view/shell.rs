//! Runs the viewer without a window system: a [`Viewer`], the panels around it, and the graph that draws both.
//!
//! The window's graph, `pipelines/view/window.ron`, draws the pictures of the scene (one, two with a split line, or their
//! difference) and egui's triangles over them. A [`Shell`] turns input into a frame of that graph, for a window to present or
//! a test to read back.

use super::events::{Event, RendererId};
use super::history::History;
use super::paint::{self, Composition, Mode, Painter};
use super::panels::{Command, Panels};
use super::profile::{self, zone};
use super::renderer::{Failure, PlanInputs, Renderer, Wake};
use super::viewer::{Viewer, ViewerError};
use super::viewport::Viewport;
use egui::epaint::ClippedPrimitive;
use egui::epaint::textures::TexturesDelta;
use egui::{Context, FontDefinitions, FontFamily, RawInput, Rect};
use splatgraph_api::{BackendError, Device, FrameInputs, Pixels, Running};
use splatgraph_framework::ir::Catalog;
use splatgraph_framework::plan::Plan;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The longest wait for a picture of the window that is read back.
const READING: Duration = Duration::from_secs(10);

/// The size and destination of a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameRequest {
    /// Size of the window, in pixels.
    pub size: (u32, u32),
    /// Pixels per point of the user interface.
    pub pixels_per_point: f32,
    /// True to present the frame in the device's window.
    pub present: bool,
    /// True to read the frame back.
    pub read: bool,
}

/// The results of a frame.
pub struct Frame {
    /// Output for the window system: clipboard, pointer shape.
    pub platform: egui::PlatformOutput,
    /// Requests to the window.
    pub commands: Vec<Command>,
    /// True if the window was drawn; false until its own graph is built.
    pub drawn: bool,
    /// Pixels of the window, if requested and drawn.
    pub picture: Option<Pixels>,
    /// The error that ended the device or its window. Nothing more is drawn until [`Shell::release`] and [`Shell::give`].
    pub lost: Option<BackendError>,
}

/// The viewer with its panels and its window's graph.
pub struct Shell<D: Device> {
    /// The scene and its viewports.
    pub viewer: Viewer<D>,
    /// The panels.
    pub panels: Panels,
    ctx: Context,
    painter: Painter,
    canvas: Renderer<D>,
    catalog: Arc<Catalog>,
    history: History,
    events: Vec<Event>,
    /// A picture was drawn, and not shown yet.
    owed: bool,
}

impl<D: Device> Shell<D> {
    /// Creates a shell. `canvas` draws the window; it must be the device of the window, if there is one.
    pub fn new(viewer: Viewer<D>, canvas: D, wake: Wake) -> Result<Shell<D>, ViewerError> {
        Shell::with_graph(viewer, canvas, paint::GRAPH, wake)
    }

    /// Creates a shell with another window graph, a built-in one's name or a path, with the imports of [`paint::offer`].
    pub fn with_graph(
        viewer: Viewer<D>,
        canvas: D,
        graph: &str,
        wake: Wake,
    ) -> Result<Shell<D>, ViewerError> {
        let ctx = Context::default();
        ctx.set_theme(egui::Theme::Dark);
        ctx.set_fonts(fonts());
        // A press on the picture gives the keys back to the camera, not only a click.
        ctx.options_mut(|options| {
            options.input_options.surrender_focus_on = egui::SurrenderFocusOn::Presses;
        });
        let mut catalog = Catalog::default();
        paint::offer(&mut catalog);
        Ok(Shell {
            viewer,
            panels: Panels::default(),
            ctx,
            painter: Painter::default(),
            canvas: Renderer::new(canvas, graph, &[], wake)?,
            catalog: Arc::new(catalog),
            history: History::default(),
            events: Vec::new(),
            owed: false,
        })
    }

    /// Returns the context of the user interface.
    pub fn context(&self) -> &Context {
        &self.ctx
    }

    /// Returns the renderer of the window.
    pub fn window(&self) -> &Renderer<D> {
        &self.canvas
    }

    /// Returns the renderer of the window, for changes of its patience.
    pub fn window_mut(&mut self) -> &mut Renderer<D> {
        &mut self.canvas
    }

    /// Returns the device of the window; `None` while it is lost.
    pub fn canvas_mut(&mut self) -> Option<&mut D> {
        self.canvas.device_mut()
    }

    /// Returns the failure of the window's own graph if it has no plan, so that nothing can be shown.
    pub fn is_blind(&self) -> Option<&Failure> {
        if self.canvas.plan().is_some() { None } else { self.canvas.failure() }
    }

    /// Describes what prevents that the requested state is shown, without colours; none if nothing does.
    ///
    /// These are the problems of A, of B if it is shown, of A's inspection, and of the window itself.
    pub fn problem(&self) -> Option<String> {
        let Viewer { a, b, compare, .. } = &self.viewer;
        let b = b.as_ref().filter(|_| *compare != Mode::A);
        let in_part = [Some(a), b].into_iter().flatten().find_map(Viewport::stays_in_part);
        let viewports = [Some(&a.renderer), b.map(|b| &b.renderer), Some(&self.canvas)];
        let drawn = viewports.into_iter().flatten().find_map(|renderer| renderer.problem(false));
        let inspected =
            a.inspection.as_ref().and_then(|inspection| inspection.found.as_ref()?.as_ref().err());
        drawn.or_else(|| inspected.map(ToString::to_string).or(in_part).map(|text| format!("error: {text}")))
    }

    /// Applies the input and draws the pictures and the window.
    pub fn frame(&mut self, input: RawInput, request: FrameRequest) -> Frame {
        zone!("window frame");
        for file in &input.dropped_files {
            self.viewer.open(file.path());
        }
        let ready = self.is_ready(self.canvas.patience);
        // A picture that took longer than the patience is shown before the next one begins, or none would ever be.
        let shows_first = ready && std::mem::take(&mut self.owed);
        for renderer in self.renderers() {
            renderer.paused = !ready || shows_first;
        }
        let problem = self.canvas.problem(true);
        let (mut view, mut commands) = (Rect::ZERO, Vec::new());
        let output = self.ctx.run_ui(input, |ui| {
            let (panels, viewer) = (&mut self.panels, &mut self.viewer);
            let window = (&self.history, self.canvas.plan().map(|plan| plan.as_ref()));
            let shown = panels.show(ui, viewer, window, problem.as_deref());
            // The closure may run twice, the first time only for the layout.
            view = shown.view;
            commands.extend(shown.commands);
        });
        let pixels_per_point = output.pixels_per_point;
        let primitives = self.ctx.tessellate(output.shapes, pixels_per_point);

        let pixel = |v: f32| (v * request.pixels_per_point).round().max(0.0) as u32;
        let Rect { min, max } = view;
        let (left, top) = (pixel(min.x), pixel(min.y));
        let view = [left, top, pixel(max.x).saturating_sub(left), pixel(max.y).saturating_sub(top)];
        self.viewer.frame((view[2], view[3]));
        for event in self.viewer.take_events() {
            self.report(event);
        }
        if shows_first {
            self.canvas.paused = false;
        } else if ready && self.canvas.reads_block() {
            // Presenting waits for what was submitted before, too.
            self.owed = !self.is_ready(self.canvas.patience);
            self.canvas.paused = self.owed;
        }
        let interface = (output.textures_delta, primitives.as_slice(), pixels_per_point);
        let (drawn, picture) = self.paint(request, view, interface);
        profile::frame();
        let lost = self.viewer.lost().or_else(|| self.canvas.lost()).cloned();
        Frame { platform: output.platform_output, commands, drawn, picture, lost }
    }

    fn renderers(&mut self) -> impl Iterator<Item = &mut Renderer<D>> {
        let b = self.viewer.b.as_mut().map(|b| &mut b.renderer);
        [Some(&mut self.viewer.a.renderer), b, Some(&mut self.canvas)].into_iter().flatten()
    }

    /// Returns true if frames can be submitted without a wait for one that runs for long.
    ///
    /// Where [reads block](Renderer::reads_block), waits for the newest frame of all and takes the results of the others only
    /// then.
    fn is_ready(&mut self, patience: Duration) -> bool {
        if !self.canvas.reads_block() {
            return true;
        }
        if let Some(newest) = self.renderers().max_by_key(|renderer| renderer.newest()) {
            match newest.wait_for_newest(patience) {
                Ok(true) => {}
                Ok(false) => return false,
                Err(error) => newest.report(error),
            }
        }
        for renderer in self.renderers() {
            if let Err(error) = renderer.collect_all() {
                renderer.report(error);
            }
        }
        true
    }

    /// Draws the window.
    fn paint(
        &mut self,
        request: FrameRequest,
        view: [u32; 4],
        (textures, primitives, pixels_per_point): (TexturesDelta, &[ClippedPrimitive], f32),
    ) -> (bool, Option<Pixels>) {
        let inputs =
            PlanInputs { scene: None, catalog: self.catalog.clone(), size: request.size, share_memory: true };
        self.canvas.poll(&inputs, Instant::now());
        let [a, b] = self.viewer.pictures().map(|picture| picture.map(Into::into));
        let composition = Composition {
            window: [request.size.0, request.size.1],
            view,
            mode: self.viewer.compare,
            split: self.viewer.split,
            amplification: self.viewer.gain,
            background: [0.0; 3],
            a,
            b,
        };
        // A new plan may start with another picture; and a graph of the user's may keep none.
        let keeps = |plan: &Arc<Plan>| plan.resource(plan.output).history.is_some();
        if self.canvas.is_first_next() || !self.canvas.plan().is_some_and(keeps) {
            self.painter.forget();
        }
        let painted = self.painter.paint(textures, primitives, pixels_per_point, &composition);
        let mut inputs =
            FrameInputs { present: request.present, read_output: request.read, ..FrameInputs::default() };
        composition.give(&mut inputs);
        painted.give(&mut inputs.buffers);
        let mut drawn = self.canvas.submit(inputs);
        if request.read && matches!(drawn, Ok(true)) {
            // The picture comes with this frame or not at all.
            drawn = self.canvas.finish(READING).map(|()| true);
        }
        match &drawn {
            Ok(true) => self.painter.drawn(),
            Ok(false) => {}
            Err(_) => self.painter.forget(),
        }
        let drawn = drawn.unwrap_or_else(|error| {
            self.canvas.report(error);
            false
        });
        let mut picture = None;
        for mut done in self.canvas.take_done() {
            if done.first {
                self.history.next_plan();
            }
            self.history.push(&done.plan, &done.result);
            picture = done.result.output.take().or(picture);
        }
        for event in self.canvas.take_events() {
            self.report(Event::of(RendererId::Window, event));
        }
        (drawn, picture)
    }

    /// Takes the events since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Reports an event from outside of the shell.
    pub fn report(&mut self, event: Event) {
        self.panels.log_event(&event);
        self.events.push(event);
    }

    /// Waits for the frames in flight.
    ///
    /// # Errors
    /// As [`Renderer::finish`].
    pub fn finish(&mut self, within: Duration) -> Result<(), BackendError> {
        if !self.is_ready(within) {
            let place = self.stalled().map_or_else(String::new, |running| running.place.clone());
            return Err(BackendError::Stuck { place, seconds: within.as_secs() });
        }
        self.viewer.finish(within)?;
        self.canvas.finish(within)
    }

    /// Waits for the builds that are running, at most until `end`; returns true if none is left.
    pub fn is_idle(&mut self, end: Instant) -> bool {
        loop {
            let idle = self.viewer.is_idle() && self.canvas.is_idle();
            if idle || Instant::now() >= end {
                return idle;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Returns what the device has worked on for longer than the patience of the renderers.
    pub fn stalled(&self) -> Option<&Running> {
        self.viewer.stalled().or_else(|| self.canvas.stalled())
    }

    /// Drops the device and all that is on it.
    pub fn release(&mut self) {
        self.viewer.release();
        self.canvas.release();
    }

    /// Returns true if nothing of the dropped device is in use by a build.
    pub fn is_released(&mut self) -> bool {
        let viewer = self.viewer.is_released();
        self.canvas.is_released() && viewer
    }

    /// Continues on another device. `canvas` draws the window, as in [`Shell::new`], and `device` the scene.
    ///
    /// # Errors
    /// As [`Viewer::give`].
    pub fn give(&mut self, canvas: D, device: D) -> Result<(), BackendError> {
        self.canvas.give(canvas);
        self.viewer.give(device)
    }

    /// Returns the device of the window, after everything else is closed; `None` if it is lost.
    pub fn into_device(self) -> Option<D> {
        let Shell { viewer, canvas, .. } = self;
        drop(viewer);
        canvas.into_device()
    }
}

/// Returns egui's fonts, with the monospace font as the first fallback for labels, because it has the most signs.
fn fonts() -> FontDefinitions {
    let mut fonts = FontDefinitions::default();
    let signs = fonts.families.get(&FontFamily::Monospace).and_then(|names| names.first()).cloned();
    let labels = fonts.families.entry(FontFamily::Proportional).or_default();
    if let Some(signs) = signs {
        labels.insert(labels.len().min(1), signs);
    }
    fonts
}
