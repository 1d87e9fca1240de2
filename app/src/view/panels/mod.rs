//! Draws the user interface: tools around the picture, and cards over it.
//!
//! `layout` docks the tools around the picture. All tools share one [`Selection`]. Panels read and change a [`Viewer`].
//! They do not depend on a window, so tests can operate them.

mod cameras;
mod contents;
mod controls;
mod errors;
mod failures;
mod help;
mod hud;
mod inspector;
mod keyboard;
mod keys;
mod layout;
mod number;
mod params;
mod pointer;
mod presets;
mod select;
pub mod selection;
mod splat;
mod status;
pub mod theme;
mod timeline;
mod times;
mod tools;
mod top_bar;
mod widgets;

use super::events::{Event, RendererId};
use super::history::{History, WINDOW};
use super::paint::Mode;
use super::undo::{self, Settings};
use super::viewer::{Combine, Viewer};
use super::wheel::Wheel;
use crate::draw::select::{Reach, Region};
use crate::draw::stats::median;
use controls::see;
use egui::{Align2, CentralPanel, Context, Panel, RawInput, Rect, Ui};
use keyboard::Keyboard;
use layout::Layout;
use presets::Presets;
use selection::{Dumped, Selection};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::path::{Path, PathBuf, absolute};
use std::time::{Duration, Instant};
use theme::Palette;
use widgets::Control as _;

pub use controls::{Command, Controls};
pub use layout::Tool;
pub use params::set_line;

/// Fixed height of the status line, in points.
const STATUS_HEIGHT: f32 = 24.0;

const LOG: usize = 200;

/// Time without a new picture after which the frame rate is no longer shown.
const REST: Duration = Duration::from_secs(1);

const RECENT: usize = 12;

/// Minimum scale of the user interface: texts of about 8 points stay readable.
const LEAST_ZOOM: f32 = 0.6;

/// Results of drawing the panels.
#[derive(Clone, Debug)]
pub struct PanelOutput {
    /// Rectangle of the view that shows the pictures, in points; [`Rect::NOTHING`] if a tool's tab hides it.
    pub view: Rect,
    /// Requests to the window: those of shortcuts, then those of controls in the order in which they are drawn.
    pub commands: Vec<Command>,
}

/// The arrangement of the tools, as saved for the next start.
#[derive(Clone, Serialize, Deserialize)]
pub struct Arrangement {
    layout: Layout,
    hud: bool,
    /// Recently opened scenes, the newest first.
    recent: Vec<PathBuf>,
    /// Scale of the user interface.
    #[serde(default = "unscaled")]
    zoom: f32,
}

fn unscaled() -> f32 {
    1.0
}

/// The panels and their state between frames; see [`Panels::new`].
#[derive(Default)]
pub struct Panels {
    /// True to hide the bars and the tools, so that the picture fills the window.
    pub hidden: bool,
    /// True to synchronise presentation with the display's refresh.
    pub vsync: bool,
    /// True to show the frame time and toasts over the picture. Errors, notices and the toast of a copied text are
    /// always shown.
    pub hud: bool,
    /// Viewport that the tools show and change.
    pub selected: RendererId,
    /// Positions of controls, for scripted input, and the user's requests to the window.
    pub controls: Controls,
    /// True to show the window of keys and mouse controls.
    pub help: bool,
    keyboard: Keyboard,
    layout: Layout,
    selection: Option<Selection>,
    /// Item that the command line selected, until a plan of A contains it.
    requested: Option<Selection>,
    select: select::State,
    /// Position to pick once there is a first picture, as fractions of its width and height.
    pick_first: Option<[f32; 2]>,
    /// Box to select once there is a first picture, as fractions of its size: left, top, right, bottom.
    select_first: Option<[f32; 4]>,
    dumped: Dumped,
    timeline: timeline::State,
    contents: contents::State,
    params: params::State,
    presets: Presets,
    notice: Option<String>,
    errors: errors::State,
    toasts: hud::Toasts,
    /// Graphs of A and B in the last frame.
    graphs: [Option<String>; 2],
    log: VecDeque<String>,
    undo: undo::History,
    /// True if the program itself may have changed settings since the last frame. It then dropped or restored
    /// parameters, or loaded a scene, whose selected and hidden splats may have new indices.
    by_program: bool,
    /// Recently opened scenes, the newest first.
    recent: Vec<PathBuf>,
    scene_search: String,
    camera_search: String,
    restored: bool,
    drag: pointer::Drag,
    wheel: Wheel,
    /// True to mark the comparison's worst pixel in the picture.
    marked: bool,
    /// Milliseconds between recent frames of A.
    frame_ms: VecDeque<f64>,
    /// Phase whose passes are plotted; `None` to plot all phases.
    plotted: Option<String>,
    /// Time of the last frame if it had a new picture of A, otherwise `None`.
    before: Option<Instant>,
    /// Time of A's newest picture; `None` before the first.
    newest: Option<Instant>,
    /// Total number of A's frames when the panels were last drawn.
    drawn: u64,
}

impl Panels {
    /// Creates the panels of the first start, with vsync and with texts over the picture.
    pub fn new() -> Panels {
        Panels { vsync: true, hud: true, ..Panels::default() }
    }

    /// Adds an event to the log, and shows it as a toast if the user should see it now. Also updates the panels for an
    /// event that changes the scene, the graph or settings.
    pub fn log_event(&mut self, event: &Event) {
        if self.log.len() == LOG {
            self.log.pop_front();
        }
        self.log.push_back(event.to_string());
        self.toasts.tell(event);
        match event {
            Event::Dropped { .. } | Event::Restored { .. } | Event::Scene { .. } => self.by_program = true,
            Event::SceneFailed { stays: true, .. } => self.errors.reopen(),
            Event::Exchanged => {
                self.params.forget_effect();
                self.frame_ms.clear();
            }
            Event::Swapped { renderer, swap } if *renderer != RendererId::Window => {
                self.params.tell(*renderer, swap);
                if swap.causes.has_file() {
                    self.params.regroup();
                }
                if *renderer == RendererId::A {
                    self.frame_ms.clear();
                }
            }
            _ => {}
        }
    }

    /// Shows a text over the picture, until the user dismisses it.
    pub fn show_notice(&mut self, text: String) {
        self.notice = Some(text);
    }

    /// Opens these tools and closes all others.
    pub fn open_tools(&mut self, tools: &[Tool]) {
        for tool in Tool::ALL {
            self.layout.set_open(tool, false);
        }
        for tool in tools {
            self.layout.reveal(*tool);
        }
    }

    /// Returns the arrangement to save for the next start, with the scale of `ctx`.
    pub fn arrangement(&self, ctx: &Context) -> Arrangement {
        Arrangement {
            layout: self.layout.clone(),
            hud: self.hud,
            recent: self.recent.clone(),
            zoom: ctx.zoom_factor(),
        }
    }

    /// Restores a saved arrangement, except scenes that no longer exist. Returns false, without changes, if it is
    /// invalid or lacks a tool.
    pub fn restore(&mut self, arrangement: Arrangement, ctx: &Context) -> bool {
        let Arrangement { layout, hud, mut recent, zoom } = arrangement;
        if !layout.is_sound() {
            return false;
        }
        // Not `is_file`: a SOG scene can be a folder.
        recent.retain(|scene| scene.exists());
        (self.layout, self.hud, self.recent, self.restored) = (layout, hud, recent, true);
        // Not `set_zoom_factor`: before the first frame, it would take another size for that of the window.
        ctx.options_mut(|options| options.zoom_factor = zoom.clamp(LEAST_ZOOM, 5.0));
        true
    }

    /// Returns true if a saved arrangement was restored.
    pub fn is_restored(&self) -> bool {
        self.restored
    }

    fn remember_scene(&mut self, scene: &Path) {
        // A relative path may refer to another file at the next start.
        let scene = absolute(scene).unwrap_or_else(|_| scene.to_owned());
        if self.recent.first() != Some(&scene) {
            self.recent.retain(|recent| *recent != scene);
            self.recent.insert(0, scene);
            self.recent.truncate(RECENT);
        }
    }

    /// Selects an item in all tools, and opens the inspector.
    pub fn select(&mut self, selection: Selection) {
        self.selection = Some(selection);
        self.layout.reveal(Tool::Inspector);
    }

    /// Selects an item that A's plan is required to contain; see [`Panels::missing`].
    pub fn select_requested(&mut self, selection: Selection) {
        self.requested = Some(selection.clone());
        self.select(selection);
    }

    /// Returns an error message if an item was requested and no plan of A has contained it so far.
    pub fn missing(&self) -> Option<String> {
        self.requested.as_ref().map(|selection| format!("the plan has no {selection}"))
    }

    /// Picks a splat of A once there is a picture, and opens the inspector. `share` is the position, as fractions of
    /// width and height.
    pub fn pick_first(&mut self, share: [f32; 2]) {
        self.pick_first = Some(share);
        self.select(Selection::Splat);
    }

    /// Selects the splats of A in a box once there is a picture. `corners` are left, top, right and bottom, as
    /// fractions of the picture's width and height.
    pub fn select_first(&mut self, corners: [f32; 4]) {
        self.select_first = Some(corners);
    }

    /// Returns true while a pick or a selection waits for the first picture.
    pub fn waits_for_picture(&self) -> bool {
        self.pick_first.is_some() || self.select_first.is_some()
    }

    #[cfg(test)]
    pub(in crate::view) fn undo_steps(&self) -> usize {
        self.undo.steps()
    }

    #[cfg(test)]
    pub(in crate::view) fn toasts(&self) -> Vec<&str> {
        self.toasts.texts()
    }

    /// Returns the item that is selected in all tools; `None` if none is.
    pub fn selection(&self) -> Option<&Selection> {
        self.selection.as_ref()
    }

    /// Prepares the input of a frame for egui; see [`Keyboard::rename`].
    pub fn prepare(&mut self, input: &mut RawInput) {
        self.keyboard.rename(&mut input.events);
    }

    /// Draws the panels and applies the user's input to the viewer. `window` has the times of the window's graph;
    /// `window_failure` is its problem, with ANSI colours.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        viewer: &mut Viewer,
        window: &History,
        window_failure: Option<&str>,
    ) -> PanelOutput {
        self.time(ui.ctx(), viewer.a.history.frames(), viewer.a.renderer.in_flight() == 0);
        self.keys(ui.ctx(), viewer);
        if viewer.b.is_none() || viewer.compare == Mode::A {
            self.selected = RendererId::A;
        }
        if let (Some(requested), Some(plan)) = (&self.requested, viewer.a.renderer.plan())
            && requested.is_in(self.dumped.of(plan))
        {
            self.requested = None;
        }
        if !self.hidden {
            Panel::top("menu").show(ui, |ui| self.top_bar(ui, viewer));
            Panel::bottom("status").exact_size(STATUS_HEIGHT).show(ui, |ui| self.status(ui, viewer));
        }
        let area = ui.available_rect_before_wrap();
        let before = self.selection.clone();
        let view = CentralPanel::no_frame().show(ui, |ui| self.docked(ui, viewer, window)).inner;
        if self.selection.is_some() && self.selection != before {
            self.layout.reveal(Tool::Inspector);
        }
        if !self.hidden {
            self.floating(ui, viewer, window, area);
        }
        self.forget_settings(viewer);
        self.over_picture(ui.ctx(), viewer, window_failure, view);
        help::show(ui.ctx(), &mut self.help, self.keyboard.scrolling());
        self.controls = controls::take(ui.ctx());
        if let Some(text) = self.controls.refused.take() {
            self.log_event(&Event::Problem { text });
        }
        self.keyboard.keep_focus(ui.ctx());
        widgets::focus_ring(ui.ctx());
        self.report_copy(ui.ctx());
        self.observe(ui.ctx(), viewer);
        if ui.ctx().zoom_factor() < LEAST_ZOOM {
            ui.set_zoom_factor(LEAST_ZOOM);
        }
        PanelOutput { view, commands: std::mem::take(&mut self.controls.commands) }
    }

    /// Removes messages about settings that another graph dropped. Must be called after all controls, but before events
    /// of this frame are shown.
    fn forget_settings(&mut self, viewer: &mut Viewer) {
        for (id, former) in [RendererId::A, RendererId::B].into_iter().zip(&mut self.graphs) {
            let graph = viewer.viewport(id).map(|viewport| viewport.renderer.graph());
            if former.as_deref() != graph {
                *former = graph.map(str::to_owned);
                self.toasts.forget_settings(id);
            }
        }
    }

    fn over_picture(&mut self, ctx: &Context, viewer: &mut Viewer, window_failure: Option<&str>, view: Rect) {
        let cards = hud::space_for_cards(ctx, view);
        // The card of the selection scrolls, and the comparison above it does not.
        let mut below = cards;
        if let Some(comparison) = self.controls.find("comparison") {
            below.min.y = (below.min.y + comparison.height()).min(below.max.y - 40.0);
        }
        self.select.card(ctx, viewer, self.selected, below, !self.hidden);
        if viewer.compare != Mode::A && !self.hidden && view.width() >= 200.0 && view.height() >= 140.0 {
            hud::comparison(ctx, viewer, view, &mut self.marked);
        }
        self.errors.show(ctx, viewer, window_failure, cards);
        self.show_notice_card(ctx, cards);
        self.toasts.show(ctx, cards, self.hud);
    }

    /// Records the interval between two consecutive frames of A. `drawn` is the number of A's frames so far.
    ///
    /// Clears the intervals once no frame is in flight (`rests`) and none was drawn for [`REST`]. Until then, requests
    /// a repaint for that time.
    fn time(&mut self, ctx: &Context, drawn: u64, rests: bool) {
        let now = Instant::now();
        // Count only frames with a new picture of the scene.
        if std::mem::replace(&mut self.drawn, drawn) != drawn {
            self.newest = Some(now);
            if let Some(before) = self.before.replace(now) {
                if self.frame_ms.len() == WINDOW {
                    self.frame_ms.pop_front();
                }
                self.frame_ms.push_back((now - before).as_secs_f64() * 1e3);
            }
        } else {
            // The first interval after a pause is not a frame time.
            self.before = None;
        }
        let left =
            self.newest.map_or(Duration::ZERO, |newest| (newest + REST).saturating_duration_since(now));
        if rests && left.is_zero() {
            self.frame_ms.clear();
        } else if rests && !self.frame_ms.is_empty() && (self.hud || !self.hidden) {
            ctx.request_repaint_after(left);
        }
    }

    /// Returns the median interval between recent frames of A, in milliseconds. `None` at rest, and until two frames of
    /// the plan were drawn without a pause between them.
    pub(in crate::view) fn interval(&self) -> Option<f64> {
        median(self.frame_ms.iter().copied().collect()).filter(|ms| *ms > 0.0)
    }

    /// Undoes a step, or redoes one if `redo`.
    fn step(&mut self, viewer: &mut Viewer, redo: bool) {
        let what = if redo { self.undo.redo(viewer) } else { self.undo.undo(viewer) };
        if let Some(what) = what {
            self.toasts.done(format!("{}: {what}", if redo { "Redone" } else { "Undone" }));
        }
    }

    /// Records the user's changes as an undo step; those of a drag once it has ended.
    fn observe(&mut self, ctx: &Context, viewer: &mut Viewer) {
        // Record a drag as one step, when it ends.
        if !ctx.input(|input| input.pointer.any_down()) {
            self.undo.observe(Settings::of(viewer), std::mem::take(&mut self.by_program));
        }
    }

    /// Draws the view, and applies the input to the camera, the split line and the selection. Returns its rectangle, in
    /// points.
    fn view(&mut self, ui: &mut Ui, viewer: &mut Viewer) -> Rect {
        let rect = ui.max_rect();
        see(ui.ctx(), "view", rect);
        if let Some((id, at)) =
            self.drag.act(ui, rect, viewer, &mut self.wheel, &mut self.select, &self.keyboard)
        {
            viewer.pick(id, at);
            self.selection = Some(Selection::Splat);
        }
        if let Some(id) = self.select.take_touched().filter(|_| viewer.has_two_scenes()) {
            self.selected = id;
        }
        if viewer.pictures()[0].is_some() {
            let camera = viewer.picture_camera();
            let pixel = |x: f32, y: f32| [x * camera.width as f32, y * camera.height as f32];
            if let Some([x, y]) = self.pick_first.take() {
                viewer.pick(RendererId::A, pixel(x, y));
            }
            if let Some([left, top, right, bottom]) = self.select_first.take() {
                let corners = [pixel(left, top), pixel(right, bottom)].map(|corner| corner.map(f64::from));
                viewer.select(RendererId::A, Region::Box(corners), Reach::default(), Combine::Replace);
            }
        }
        self.select.draw(ui, rect);
        if self.selection == Some(Selection::Splat) {
            splat::draw_outline(ui, viewer, rect);
        }
        if self.hud {
            hud::show(ui, viewer, self.interval(), rect);
        }
        hud::progress(ui, viewer, rect);
        rect
    }

    /// Shows a toast if a control copied a text in this frame.
    fn report_copy(&mut self, ctx: &Context) {
        let copies = |command: &egui::OutputCommand| matches!(command, egui::OutputCommand::CopyText(_));
        if ctx.output(|output| output.commands.iter().any(copies)) {
            self.toasts.copied();
            ctx.request_repaint();
        }
    }

    /// Returns the text of the last [`Panels::show_notice`]; `None` before it, and once the text is dismissed.
    pub fn notice(&self) -> Option<&str> {
        self.notice.as_deref()
    }

    fn show_notice_card(&mut self, ctx: &Context, view: Rect) {
        let Some(text) = self.notice.clone() else { return };
        let (id, at) = (egui::Id::unique("notice"), view.center_top() + egui::vec2(0.0, 12.0));
        let area = hud::area(id, at, Align2::CENTER_TOP, view, egui::Order::Foreground);
        hud::show_area(ctx, area, |ui| {
            let palette = Palette::of(ui);
            let shown = hud::card(ui, palette.caution).show(ui, |ui| {
                ui.set_max_width((view.width() - 48.0).clamp(0.0, 560.0));
                ui.label(text);
                if ui.button("Dismiss").named("notice:dismiss").clicked() {
                    self.notice = None;
                }
            });
            shown.response.named("notice");
        });
    }
}
