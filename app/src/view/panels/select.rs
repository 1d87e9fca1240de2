//! Selects splats in the picture with a box or a brush, and draws the card of the selection. The card has the tools,
//! the number of selected splats, and the buttons for them.
//!
//! While a tool is active, the left button selects instead of moving the camera. The card is shown while a tool is
//! active, or any splat is selected or hidden.

use super::hud;
use super::number::NumberField;
use super::theme::{self, GRID, Palette};
use super::widgets::{Control as _, follow_focus};
use crate::draw::select::{Reach, Region};
use crate::io::output::names;
use crate::view::events::RendererId;
use crate::view::viewer::{Combine, Marks, Part, Viewer};
use egui::{
    Align2, Button, Color32, Context, CornerRadius, Id, Key, Modifiers, Order, Pos2, Rect, RichText, Shape,
    Stroke, StrokeKind, TextEdit, Ui, Vec2,
};
use splatgraph_assets::grouped;
use std::path::{Path, PathBuf};

/// Range of the brush's radius, in points.
const RADII: std::ops::RangeInclusive<f64> = 2.0..=400.0;

/// Factor by which one key press changes the brush's radius.
const STEP: f32 = 1.25;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SelectTool {
    Box,
    /// Selects the splats along the pointer's path.
    Brush,
}

struct Drag {
    viewport: RendererId,
    combine: Combine,
    /// Positions of the pointer, in points of the window.
    points: Vec<Pos2>,
}

pub struct State {
    /// The active tool; `None` if the left button moves the camera.
    tool: Option<SelectTool>,
    reach: Reach,
    radius: f32,
    drag: Option<Drag>,
    /// Viewport of the last drag; see [`State::take_touched`].
    touched: Option<RendererId>,
    path: String,
    /// Path of the scene for which `path` was proposed, and the proposal.
    proposed: (PathBuf, String),
}

impl Default for State {
    fn default() -> State {
        State {
            tool: None,
            reach: Reach::default(),
            radius: 24.0,
            drag: None,
            touched: None,
            path: String::new(),
            proposed: Default::default(),
        }
    }
}

impl State {
    /// Returns true while the brush is active; a click then paints instead of picking.
    pub fn is_brush(&self) -> bool {
        self.tool == Some(SelectTool::Brush)
    }

    pub fn is_active(&self) -> bool {
        self.tool.is_some()
    }

    /// Activates a tool; deactivates it if it was active.
    pub fn toggle(&mut self, tool: SelectTool) {
        self.tool = if self.tool == Some(tool) { None } else { Some(tool) };
        self.drag = None;
    }

    /// Deactivates the tools: the left button moves the camera again.
    pub fn leave(&mut self) {
        (self.tool, self.drag) = (None, None);
    }

    fn resize(&mut self, steps: i32) {
        self.radius = (self.radius * STEP.powi(steps)).clamp(*RADII.start() as f32, *RADII.end() as f32);
    }

    /// Begins a drag in a viewport's picture, at a position in points of the window. With Shift, the drag adds to the
    /// selection; with Ctrl, or Cmd on macOS, it removes splats.
    pub fn begin(&mut self, viewport: RendererId, at: Pos2, modifiers: Modifiers) {
        let combine = match modifiers {
            Modifiers { shift: true, .. } => Combine::Add,
            Modifiers { ctrl: true, .. } | Modifiers { command: true, .. } => Combine::Remove,
            _ => Combine::Replace,
        };
        self.drag = Some(Drag { viewport, combine, points: vec![at] });
        self.touched = Some(viewport);
    }

    /// Takes the viewport of the last drag, to whose scene keys and card then apply. `None` if no drag has begun since
    /// the last call.
    pub fn take_touched(&mut self) -> Option<RendererId> {
        self.touched.take()
    }

    pub fn extend(&mut self, points: impl IntoIterator<Item = Pos2>) {
        let Some(drag) = &mut self.drag else { return };
        // Each splat is tested against each segment, so nearby points are merged.
        let least = self.radius / 8.0;
        for at in points {
            match drag.points.as_mut_slice() {
                [.., before, last] if before.distance(at) < least => *last = at,
                _ => drag.points.push(at),
            }
        }
        if self.tool == Some(SelectTool::Box) {
            // A box needs only its first and last points, which are opposite corners.
            drag.points.drain(1..drag.points.len().saturating_sub(1).max(1));
        }
    }

    /// Ends the drag, and requests a selection of the splats in its region. A box without a second corner has none.
    /// `view` is the picture's rectangle, in points.
    pub fn end(&mut self, view: Rect, viewer: &mut Viewer) {
        let (Some(tool), Some(drag)) = (self.tool, self.drag.take()) else { return };
        let camera = viewer.picture_camera_of(drag.viewport);
        let scale = Vec2::new(camera.width as f32, camera.height as f32) / view.size().max(Vec2::splat(1.0));
        let pixel = |at: &Pos2| {
            let at = (*at - view.min) * scale;
            [at.x, at.y].map(f64::from)
        };
        let line: Vec<[f64; 2]> = drag.points.iter().map(pixel).collect();
        let region = match (tool, line.as_slice()) {
            (SelectTool::Box, [first, .., last]) => Region::Box([*first, *last]),
            (SelectTool::Box, _) => return,
            (SelectTool::Brush, _) => Region::Brush { line, radius: f64::from(self.radius * scale.x) },
        };
        viewer.select(drag.viewport, region, self.reach, drag.combine);
    }

    /// Applies a key to the scene of viewport `id`; returns false if it is not a selection key. `command` is true if
    /// Ctrl is held, or Cmd on macOS.
    pub fn key(&mut self, key: Key, command: bool, viewer: &mut Viewer, id: RendererId) -> bool {
        match (key, command) {
            (Key::A, true) => viewer.select_all(id),
            (_, true) => return false,
            (Key::R, _) => self.toggle(SelectTool::Box),
            (Key::B, _) => self.toggle(SelectTool::Brush),
            (Key::Minus, _) if self.is_brush() => self.resize(-1),
            (Key::Equals | Key::Plus, _) if self.is_brush() => self.resize(1),
            (Key::I, _) => viewer.invert_selection(id),
            (Key::X | Key::Delete, _) => viewer.hide_selected(id),
            (Key::U, _) => viewer.show_all(id),
            _ => return false,
        }
        true
    }

    pub fn draw(&self, ui: &Ui, view: Rect) {
        let painter = ui.painter().with_clip_rect(view);
        let (dark, light) = (Color32::from_black_alpha(200), theme::DARK.caution);
        let pointer = ui.input(|input| input.pointer.latest_pos()).filter(|at| view.contains(*at));
        match (self.tool, &self.drag) {
            (Some(SelectTool::Box), Some(Drag { points, .. })) => {
                let rect = Rect::from_two_pos(points[0], points[points.len() - 1]);
                for stroke in [Stroke::new(3.0, dark), Stroke::new(1.5, light)] {
                    painter.rect_stroke(rect, CornerRadius::ZERO, stroke, StrokeKind::Middle);
                }
            }
            (Some(SelectTool::Brush), drag) => {
                if let Some(Drag { points, .. }) = drag {
                    let fill = light.gamma_multiply(0.25);
                    painter.add(Shape::line(points.clone(), Stroke::new(2.0 * self.radius, fill)));
                }
                if let Some(at) = pointer {
                    painter.circle_stroke(at, self.radius, Stroke::new(3.0, dark));
                    painter.circle_stroke(at, self.radius, Stroke::new(1.5, light));
                }
            }
            _ => {}
        }
    }

    /// Draws the card at the bottom of the picture, for the scene of viewport `id`. Draws only its line of text if not
    /// `whole`, and nothing if no tool is active and no splat is marked.
    pub fn card(&mut self, ctx: &Context, viewer: &mut Viewer, id: RendererId, view: Rect, whole: bool) {
        if !self.is_active() && viewer.marks(id).is_empty() {
            return;
        }
        let palette = Palette::in_mode(ctx.theme() == egui::Theme::Dark);
        let at = view.center_bottom() - Vec2::new(0.0, 4.0 * GRID);
        let area = hud::area(Id::unique("splats"), at, Align2::CENTER_BOTTOM, view, Order::Middle);
        let shown = hud::show_area(ctx, area, |ui| {
            hud::card(ui, palette.line).show(ui, |ui| {
                ui.set_max_width((view.width() - 8.0 * GRID).clamp(40.0, 640.0));
                if !whole {
                    ui.label(self.line(viewer.marks(id)));
                    return;
                }
                let height = (view.height() - 12.0 * GRID).max(40.0);
                let scroll = egui::ScrollArea::vertical().max_height(height).min_scrolled_height(height);
                scroll.show(ui, |ui| {
                    self.tools(ui);
                    marks(ui, viewer, id);
                    self.files(ui, viewer, id);
                    follow_focus(ui);
                });
            });
        });
        shown.response.named("splats");
    }

    fn line(&self, marks: &Marks) -> String {
        let tool = match self.tool {
            Some(SelectTool::Box) => "Box (R): ",
            Some(SelectTool::Brush) => "Brush (B): ",
            None => "",
        };
        let [selected, hidden] = [marks.selected.len(), marks.hidden.len()].map(|n| grouped(n.into()));
        format!("{tool}{selected} selected, {hidden} hidden; H shows the tools")
    }

    fn tools(&mut self, ui: &mut Ui) {
        ui.horizontal_wrapped(|ui| {
            for (tool, name, text, about) in [
                (SelectTool::Box, "splats:box", "Box (R)", "Drag a box over the picture"),
                (
                    SelectTool::Brush,
                    "splats:brush",
                    "Brush (B)",
                    "Paint over the picture; − and + change the radius",
                ),
            ] {
                let button = ui.selectable_label(self.tool == Some(tool), text).named(name);
                let about = format!("{about}. Shift adds to the selection, Ctrl removes from it");
                if button.hint(about).clicked() {
                    self.toggle(tool);
                }
            }
            let field = NumberField::new("splats:radius", "Radius of the brush", RADII);
            let field = NumberField { speed: 0.5, suffix: " points", ..field };
            let (response, radius) = field.show(ui, self.radius.into());
            response.hint("Radius of the brush");
            if let Some(radius) = radius {
                self.radius = radius as f32;
            }
            for (reach, name, text, about) in [
                (
                    Reach::Through,
                    "splats:through",
                    "through",
                    "All visible splats with their centres inside, at any depth",
                ),
                (Reach::Front, "splats:front", "front", "Only splats that contribute most to a pixel inside"),
            ] {
                ui.selectable_value(&mut self.reach, reach, text).named(name).hint(about);
            }
        });
    }

    /// Draws the path field and the buttons that write a file, and the progress of a file being written.
    fn files(&mut self, ui: &mut Ui, viewer: &mut Viewer, id: RendererId) {
        let writing = viewer.exporting();
        match &writing {
            Some(text) => {
                ui.horizontal(|ui| {
                    ui.spinner();
                    ui.add(egui::Label::new(text).truncate());
                });
            }
            // The controls below keep their ids, and thus the keyboard focus.
            None => ui.skip_ahead_auto_ids(1),
        }
        let scene = viewer.scene_path_of(id);
        // The name of another scene is not kept, unless the user wrote it.
        let is_stale = self.path.is_empty() || self.path == self.proposed.1 && self.proposed.0 != scene;
        if is_stale && writing.is_none() {
            self.path = fresh(&viewer.folder, scene).display().to_string();
            self.proposed = (scene.to_owned(), self.path.clone());
        }
        ui.horizontal_wrapped(|ui| {
            // Disabled rather than left out: a button that disappears would lose the keyboard focus.
            if writing.is_some() {
                ui.disable();
            }
            let field = TextEdit::singleline(&mut self.path).desired_width(240.0);
            let field = ui
                .add(field)
                .named("splats:path")
                .hint("A new file; its extension is that of a scene format, or .json for a list of indices");
            let enter = field.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            let any = !viewer.marks(id).selected.is_empty();
            for (part, name, text, about, enabled) in [
                (Part::Selected, "splats:save", "Save the selection", "Write the selected splats", any),
                (
                    Part::Rest,
                    "splats:save_rest",
                    "Save the rest",
                    "Write the splats that are neither selected nor hidden",
                    true,
                ),
            ] {
                let button = ui.add_enabled(enabled, Button::new(text)).named(name);
                let saves = button.hint(about).clicked() || enter && any && part == Part::Selected;
                if saves && viewer.export(id, part, Path::new(self.path.trim())) {
                    // The next file gets a new name.
                    self.path.clear();
                }
            }
        });
    }
}

fn marks(ui: &mut Ui, viewer: &mut Viewer, id: RendererId) {
    let Marks { selected, hidden } = viewer.marks(id).clone();
    let count = |count: u32| grouped(count.into());
    ui.horizontal_wrapped(|ui| {
        let text =
            format!("{} of {} splats selected", count(selected.len()), count(viewer.loaded(id).count()));
        ui.label(RichText::new(text).family(theme::strong()));
        if !hidden.is_empty() {
            ui.label(format!("{} hidden", count(hidden.len())));
        }
        if viewer.is_selecting(id) {
            ui.spinner();
        }
    });
    type Act = fn(&mut Viewer, RendererId);
    let rows: [(&str, &str, bool, &str, Act); 4] = [
        (
            "splats:invert",
            "Invert (I)",
            true,
            "Select the splats that are neither selected nor hidden",
            Viewer::invert_selection,
        ),
        (
            "splats:clear",
            "Clear (Esc)",
            !selected.is_empty() || viewer.is_selecting(id),
            "Select nothing",
            Viewer::clear_selection,
        ),
        ("splats:hide", "Hide (X)", !selected.is_empty(), "Hide the selected splats", Viewer::hide_selected),
        ("splats:show", "Show all (U)", !hidden.is_empty(), "Show the hidden splats", Viewer::show_all),
    ];
    ui.horizontal_wrapped(|ui| {
        for (name, text, enabled, about, act) in rows {
            let button = ui.add_enabled(enabled, Button::new(text)).named(name);
            if button.hint(about).clicked() {
                act(viewer, id);
            }
        }
    });
}

/// Returns the first path of `SCENE-part-1.ply`, `SCENE-part-2.ply`, ... in `folder` at which no file exists.
fn fresh(folder: &Path, scene: &Path) -> PathBuf {
    let stem = names::of_scene(scene);
    names::first_free(|number| folder.join(format!("{stem}-part-{number}.ply")))
}
