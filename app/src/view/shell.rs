//! Runs the viewer without a window system: a [`Viewer`], the panels around it, and the graph that draws both.
//!
//! The window's graph, `pipelines/view/window.ron`, draws the pictures of the scene (one, two with a split line, or their
//! difference) and egui's triangles over them. A [`Shell`] turns input into a frame of that graph, for a window to present or
//! a test to read back.

use super::events::{Event, RendererId};
use super::history::History;
use super::paint::{self, Composition, Painted, Painter};
use super::panels::{Command, PanelOutput, Panels};
use super::profile::{self, zone};
use super::renderer::{Failure, PlanInputs, Renderer, Wake};
use super::viewer::{Viewer, ViewerError};
use egui::{Context, FontDefinitions, FontFamily, RawInput, Rect};
use splatgraph_api::{BackendError, Device, FrameInputs, Pixels};
use splatgraph_framework::ir::Catalog;
use std::sync::Arc;
use std::time::Instant;

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

    /// Returns the device of the window.
    pub fn canvas_mut(&mut self) -> &mut D {
        self.canvas.device_mut()
    }

    /// Returns the failure of the window's own graph if it has no plan, so that nothing can be shown.
    pub fn is_blind(&self) -> Option<&Failure> {
        if self.canvas.plan().is_some() { None } else { self.canvas.failure() }
    }

    /// Applies the input and draws the pictures and the window.
    pub fn frame(&mut self, input: RawInput, request: FrameRequest) -> Result<Frame, ViewerError> {
        zone!("window frame");
        for file in &input.dropped_files {
            self.viewer.open(file.path());
        }
        let failure = self.canvas.failure().map(|failure| failure.text(true));
        let mut shown: Option<Result<PanelOutput, ViewerError>> = None;
        let output = self.ctx.run_ui(input, |ui| {
            let (panels, viewer) = (&mut self.panels, &mut self.viewer);
            let window = (&self.history, self.canvas.plan().map(|plan| plan.as_ref()));
            shown = Some(panels.show(ui, viewer, window, failure.as_deref()));
        });
        let pixels_per_point = output.pixels_per_point;
        let primitives = self.ctx.tessellate(output.shapes, pixels_per_point);
        let painted = self.painter.paint(output.textures_delta, &primitives, pixels_per_point);
        let Some(shown) = shown.transpose()? else { unreachable!("the closure runs at least once") };

        let pixel = |v: f32| (v * request.pixels_per_point).round().max(0.0) as u32;
        let Rect { min, max } = shown.view;
        let (left, top) = (pixel(min.x), pixel(min.y));
        let view = [left, top, pixel(max.x).saturating_sub(left), pixel(max.y).saturating_sub(top)];
        let size = (view[2], view[3]);
        self.viewer.frame(size)?;
        for event in self.viewer.take_events() {
            self.panels.log_event(&event);
            self.events.push(event);
        }
        let (drawn, picture) = self.paint(request, view, &painted)?;
        profile::frame();
        Ok(Frame { platform: output.platform_output, commands: shown.commands, drawn, picture })
    }

    /// Draws the window.
    fn paint(
        &mut self,
        request: FrameRequest,
        view: [u32; 4],
        painted: &Painted,
    ) -> Result<(bool, Option<Pixels>), BackendError> {
        let inputs =
            PlanInputs { scene: None, catalog: self.catalog.clone(), size: request.size, share_memory: true };
        self.canvas.poll(&inputs, Instant::now())?;
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
        let mut inputs =
            FrameInputs { present: request.present, read_output: request.read, ..FrameInputs::default() };
        composition.give(&mut inputs);
        painted.give(&mut inputs.buffers);
        let drawn = self.canvas.submit(inputs)?;
        if request.read {
            self.canvas.finish()?;
        }
        let mut picture = None;
        for mut done in self.canvas.take_done() {
            if done.first {
                self.history.next_plan();
            }
            self.history.push(&done.plan, &done.result);
            picture = done.result.output.take().or(picture);
        }
        for event in self.canvas.take_events() {
            let event = Event::of(RendererId::Window, event);
            self.panels.log_event(&event);
            self.events.push(event);
        }
        Ok((drawn, picture))
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
    pub fn finish(&mut self) -> Result<(), BackendError> {
        self.viewer.finish()?;
        self.canvas.finish()
    }

    /// Returns the device of the window, after everything else is closed.
    pub fn into_device(self) -> D {
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
