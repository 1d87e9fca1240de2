//! Draws the plan as a timeline: bars for passes, diamonds for barriers between them, and memory below. The widths of a
//! frame's bars follow the passes' times, or are equal if the user chooses so or the times are missing or unreliable.
//! The lanes match the dump page.
//!
//! The wheel over the passes zooms (elsewhere with Ctrl), and dragging pans. Clicking a pass, a barrier or a resource
//! selects it for all tools; Tab and Enter do the same from the keyboard.

use super::controls::see;
use super::selection::{Selection, barrier, touches};
use super::theme::{self, GRID, Palette, ROW, TEXT};
use super::widgets::{self, Control as _, text_in};
use egui::{
    Align, Color32, FontId, Id, Layout, Painter, Pos2, Rect, RichText, Sense, Stroke, StrokeKind, Ui, pos2,
    vec2,
};
use indexmap::IndexSet;
use splatgraph_framework::dump::{self, Dump, DumpPass};
use splatgraph_framework::ir::Run;

/// Width reserved for the barriers before a pass, in points.
const GAP: f32 = 16.0;
/// Minimum width of a pass at zoom 1, in points.
const MIN_WIDTH: f32 = 4.0;
/// Width of a pass of the prologue at zoom 1, in points.
const ONCE: f32 = 12.0;
/// Width of the column with the lanes' names, in points.
const NAMES: f32 = 152.0;
const LANE: f32 = 20.0;
const PHASES: f32 = 20.0;
const PASSES: f32 = 28.0;
const BARRIERS: f32 = 20.0;
/// Maximum zoom; 1 fits the width.
const CLOSEST: f32 = 200.0;

/// Times of a plan's passes.
#[derive(Clone)]
pub struct Times {
    /// Pairs of pass name and median milliseconds; empty until a frame of the plan is measured that did not run the
    /// prologue.
    pub passes: Vec<(String, f64)>,
    /// Median GPU time of a frame outside its passes, in milliseconds; `None` without measured times.
    pub unattributed: Option<f64>,
    /// True if `unattributed` is more than half of the frame, so that the passes' times are unreliable.
    pub unreliable: bool,
}

impl Times {
    fn of(&self, pass: &str) -> Option<f64> {
        self.passes.iter().find(|(name, _)| name == pass).map(|(_, ms)| *ms)
    }
}

pub struct State {
    /// Zoom factor; 1 fits the width.
    zoom: f32,
    /// Position of the left end of the visible part, in points of the zoomed timeline.
    offset: f32,
    /// True for passes of equal width.
    equal: bool,
    filter: String,
    /// Graph, number of passes, and times when the pointer entered. They stay fixed while the pointer is inside.
    held: Option<(String, usize, Times)>,
}

impl Default for State {
    fn default() -> State {
        State { zoom: 1.0, offset: 0.0, equal: false, filter: String::new(), held: None }
    }
}

/// Position of a pass, in points from the timeline's left end.
struct Column {
    /// Index into [`Dump::passes`].
    pass: usize,
    left: f32,
    right: f32,
    /// Barriers before the pass: pairs of number and position in points.
    barriers: Vec<(u32, f32)>,
}

/// A row of memory: one resource, or several that share a memory block at different times.
struct Lane<'a> {
    title: String,
    resources: Vec<&'a dump::DumpResource>,
}

impl State {
    /// Draws the timeline, and applies clicks to the selection.
    pub fn show(&mut self, ui: &mut Ui, dump: &Dump, times: &Times, selection: &mut Option<Selection>) {
        let held =
            self.held.take().filter(|(graph, count, _)| *graph == dump.graph && *count == dump.passes.len());
        let held = held.map_or_else(|| times.clone(), |(_, _, times)| times);
        let times = &held;
        self.summary(ui, dump, times);
        for warning in &dump.warnings {
            let place = format!("{}:{}", warning.declared.file, warning.declared.line);
            let text = RichText::new(format!("warning: {} ({place})", warning.message));
            ui.label(text.color(Palette::of(ui).caution)).hint(warning.help.join("\n"));
        }
        let width = (ui.available_width() - NAMES - 12.0).max(160.0);
        let equal = self.equal || times.unreliable || times.passes.is_empty();
        let (columns, whole) = columns(dump, times, width, self.zoom, equal);
        self.offset = self.offset.clamp(0.0, (whole - width).max(0.0));
        let area = self.area(ui, "timeline", PHASES + PASSES + BARRIERS, whole, width, true);
        let (offset, palette) = (self.offset, Palette::of(ui));
        let view =
            View { dump, times, columns: &columns, selection: selection.as_ref(), area, offset, palette };
        let mut clicked = view.draw_head(ui);
        let lanes = lanes(dump, &self.filter);
        egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            let area = self.area(ui, "lanes", LANE * lanes.len() as f32, whole, width, false);
            clicked = View { area, ..view }.draw_lanes(ui, &lanes).or(clicked.take());
            if lanes.is_empty() {
                ui.weak("No resource matches.");
            }
        });
        if ui.rect_contains_pointer(area) {
            self.held = Some((dump.graph.clone(), dump.passes.len(), times.clone()));
        }
        if let Some(clicked) = clicked {
            // Clicking the selected item again clears the selection.
            *selection = if selection.as_ref() == Some(&clicked) { None } else { Some(clicked) };
        }
    }

    fn summary(&mut self, ui: &mut Ui, dump: &Dump, times: &Times) {
        ui.horizontal(|ui| {
            let frame = dump.totals.frame;
            let mut text = format!(
                "{}: {} passes, {} barrier calls with {} barriers against {} hazards, {} of memory, {} saved by sharing",
                dump.graph,
                dump.totals.frame_passes,
                frame.calls,
                frame.barriers,
                frame.dependencies,
                dump::bytes(dump.totals.transient_bytes),
                dump::bytes(dump.totals.saved_bytes),
            );
            if let Some(rest) = times.unattributed.filter(|_| times.unreliable) {
                text += &format!(" — {} of a frame are outside its passes", widgets::time(rest));
            }
            // The controls are at the right end, but not laid out from there: Tab would go through them backwards.
            let id = ui.scope_id().with("controls");
            let width = ui.data(|data| data.get_temp::<f32>(id)).unwrap_or(340.0);
            let gap = ui.spacing().item_spacing.x;
            let size = vec2((ui.available_width() - width - gap).max(0.0), ui.available_height());
            ui.allocate_ui_with_layout(size, Layout::left_to_right(Align::Center), |ui| {
                ui.set_min_width(size.x);
                let label = ui.add(egui::Label::new(&text).truncate());
                label.hint(text);
            });
            let start = ui.cursor().left();
            let button = ui.button("Legend").named("legend");
            egui::Popup::menu(&button).show(|ui| legend(ui, dump));
            ui.add(egui::TextEdit::singleline(&mut self.filter).hint_text("Filter memory").desired_width(112.0));
            let timed = !times.unreliable && !times.passes.is_empty();
            ui.add_enabled_ui(timed, |ui| {
                ui.selectable_value(&mut self.equal, false, "by time");
                ui.selectable_value(&mut self.equal, true, "equal");
            });
            if ui.add_enabled(self.zoom > 1.0, egui::Button::new("Fit")).clicked() {
                (self.zoom, self.offset) = (1.0, 0.0);
            }
            let end = ui.cursor().left() - gap;
            ui.data_mut(|data| data.insert_temp(id, end - start));
        });
    }

    /// Reserves an area to the right of the lanes' names, in which the pointer zooms and pans. `whole` is the width of
    /// the contents and `width` the visible width, in points. `plain` is true if the wheel zooms without Ctrl.
    fn area(&mut self, ui: &mut Ui, id: &str, height: f32, whole: f32, width: f32, plain: bool) -> Rect {
        let (rect, _) = ui.allocate_exact_size(vec2(ui.available_width(), height), Sense::hover());
        let area = Rect::from_min_max(pos2(rect.left() + NAMES, rect.top()), rect.max);
        // Registered before the items, so that items on top of it receive the clicks.
        let back = ui.interact(area, ui.scope_id().with(id), Sense::DRAG);
        if back.dragged() {
            self.offset -= back.drag_delta().x;
        }
        if !back.contains_pointer() {
            return area;
        }
        let (wheel, pinch) = ui.input(|input| (input.smooth_scroll_delta(), input.zoom_delta()));
        let mut factor = pinch;
        if plain {
            factor *= (wheel.y / 200.0).exp();
            self.offset -= wheel.x;
        }
        if factor == 1.0 {
            return area;
        }
        let zoom = (self.zoom * factor).clamp(1.0, CLOSEST);
        if let Some(pointer) = ui.input(|input| input.pointer.hover_pos()) {
            let at = pointer.x - area.left();
            let share = (self.offset + at) / whole.max(1.0);
            let grown = width.max(whole * zoom / self.zoom);
            self.offset = share * grown - at;
        }
        self.zoom = zoom;
        area
    }
}

/// The visible part of the timeline, and its content.
struct View<'a> {
    dump: &'a Dump,
    times: &'a Times,
    columns: &'a [Column],
    selection: Option<&'a Selection>,
    area: Rect,
    offset: f32,
    palette: Palette,
}

impl View<'_> {
    fn x(&self, at: f32) -> f32 {
        self.area.left() + at - self.offset
    }

    fn span(&self, left: f32, right: f32, top: f32, height: f32) -> Rect {
        Rect::from_min_max(pos2(self.x(left), top), pos2(self.x(right), top + height))
    }

    fn shows(&self, rect: Rect) -> bool {
        rect.right() > self.area.left() && rect.left() < self.area.right()
    }

    /// Draws phases, passes and barriers; returns the item that was clicked.
    fn draw_head(&self, ui: &Ui) -> Option<Selection> {
        let View { dump, times, columns, selection, area, palette, .. } = *self;
        let mut clicked = None;
        let (passes, barriers) = (area.top() + PHASES, area.top() + PHASES + PASSES);
        for (name, top, height) in
            [("phase", area.top(), PHASES), ("pass", passes, PASSES), ("barrier", barriers, BARRIERS)]
        {
            let rect = Rect::from_min_size(pos2(area.left() - NAMES, top), vec2(NAMES - 8.0, height));
            text_in(ui, ui.painter(), rect, name, palette.soft);
        }
        let painter = ui.painter().with_clip_rect(area.intersect(ui.clip_rect()));
        painter.rect_filled(area, 0.0, palette.paper);
        self.draw_phases(ui, &painter);
        for column in columns {
            let pass = &dump.passes[column.pass];
            let rect = self.span(column.left, column.right, passes + 2.0, PASSES - 4.0);
            for (id, at) in &column.barriers {
                let centre = pos2(self.x(*at), barriers + BARRIERS / 2.0);
                let place = Rect::from_center_size(centre, vec2(GAP, BARRIERS));
                if !self.shows(place) {
                    continue;
                }
                let selected = selection == Some(&Selection::Barrier(*id));
                let colour = if selected { palette.accent } else { palette.barrier };
                painter.vline(centre.x, passes..=barriers + 4.0, Stroke::new(1.0, colour));
                let response = ui.interact(place.intersect(area), Id::unique(("barrier", *id)), Sense::CLICK);
                see(ui.ctx(), &format!("barrier:{id}"), place.intersect(area));
                let radius = if response.hovered() || response.has_focus() || selected { 7.0 } else { 5.0 };
                widgets::diamond(&painter, centre, radius, colour, Stroke::new(1.0, palette.paper));
                if response.clicked() {
                    clicked = Some(Selection::Barrier(*id));
                }
                if response.hovered()
                    && let Some(barrier) = barrier(dump, *id)
                {
                    response.hint(dump::barrier_line(barrier));
                }
            }
            if !self.shows(rect) {
                continue;
            }
            let selected = selection == Some(&Selection::Pass(pass.name.clone()));
            let visible = rect.intersect(area);
            let response = ui.interact(visible, Id::unique(("pass", &pass.name)), Sense::CLICK);
            see(ui.ctx(), &format!("pass:{}", pass.name), visible);
            self.draw_pass(ui, &painter, pass, rect, selected || response.hovered());
            if selected || response.has_focus() {
                painter.rect_stroke(rect, 2.0, Stroke::new(2.0, palette.accent), StrokeKind::Outside);
            }
            if response.clicked() {
                clicked = Some(Selection::Pass(pass.name.clone()));
            }
            if response.hovered() {
                response.hint(describe(pass, times.of(&pass.name).filter(|_| !times.unreliable)));
            }
        }
        if let Some(Selection::Barrier(id)) = selection {
            self.draw_dependencies(&painter, *id, barriers + BARRIERS / 2.0);
        }
        clicked
    }

    /// Draws a bar with a phase's name over each run of its passes; grey if the times are unreliable.
    fn draw_phases(&self, ui: &Ui, painter: &Painter) {
        let View { dump, columns, area, palette, .. } = *self;
        let grey = self.times.unreliable;
        let mut start = 0;
        for end in 1..=columns.len() {
            let phase = |index: usize| {
                (&dump.passes[columns[index].pass].phase, dump.passes[columns[index].pass].run)
            };
            if end < columns.len() && phase(end) == phase(start) {
                continue;
            }
            let (name, _) = phase(start);
            let rect = self.span(columns[start].left, columns[end - 1].right, area.top() + 2.0, PHASES - 4.0);
            if self.shows(rect) {
                let colour = phase_colour(dump, name);
                let colour = if grey { palette.life } else { colour };
                painter.rect_filled(rect, 2.0, colour);
                let inner = rect.intersect(area).shrink2(vec2(4.0, 0.0));
                if inner.width() > 14.0 {
                    let ink = if grey { palette.ink } else { theme::ink_on(colour) };
                    text_in(ui, painter, inner, name, ink);
                }
            }
            start = end;
        }
    }

    fn draw_pass(&self, ui: &Ui, painter: &Painter, pass: &DumpPass, rect: Rect, lit: bool) {
        let palette = self.palette;
        let colour = phase_colour(self.dump, &pass.phase);
        let colour = if lit { colour } else { theme::dimmed(colour, palette.paper) };
        let inner =
            Rect::from_min_max(rect.min, pos2((rect.right() - 1.0).max(rect.left() + 1.0), rect.bottom()));
        // Passes of the prologue are hollow, because they do not belong to a frame.
        match pass.run {
            Run::Once => _ = painter.rect_stroke(inner, 2.0, Stroke::new(1.0, colour), StrokeKind::Inside),
            Run::Frame => _ = painter.rect_filled(inner, 2.0, colour),
        }
        let (reads, writes) = match self.selection {
            Some(Selection::Resource(name)) => touches(pass, name),
            _ => (false, false),
        };
        let mark = match (reads, writes) {
            (true, true) => Some("RW"),
            (true, false) => Some("R"),
            (false, true) => Some("W"),
            (false, false) => None,
        };
        let text_area = inner.intersect(self.area).shrink2(vec2(4.0, 0.0));
        let ink = if pass.run == Run::Once { palette.ink } else { theme::ink_on(colour) };
        if let Some(mark) = mark {
            painter.rect_stroke(inner, 2.0, Stroke::new(2.0, palette.ink), StrokeKind::Inside);
            let font = FontId::new(TEXT, theme::strong());
            painter.text(inner.center(), egui::Align2::CENTER_CENTER, mark, font, ink);
        } else if text_area.width() > 24.0 {
            // Drop the prefix (the part of the graph): the phase above shows it.
            let name = pass.name.rsplit('.').next().unwrap_or(&pass.name);
            text_in(ui, painter, text_area, name, ink);
        }
    }

    /// Draws an arrow for each hazard of a barrier, from the earlier pass to the waiting one. `y` is their vertical
    /// position, in points of the window.
    fn draw_dependencies(&self, painter: &Painter, id: u32, y: f32) {
        let Some(barrier) = barrier(self.dump, id) else { return };
        let middle = |name: &str| {
            let column = self.columns.iter().find(|column| self.dump.passes[column.pass].name == name)?;
            Some(self.x((column.left + column.right) / 2.0))
        };
        let stroke = Stroke::new(1.5, self.palette.accent);
        for dependency in barrier.dependencies.iter().map(|cause| &cause.conflict) {
            let Some(to) = middle(&dependency.before.name) else { continue };
            for after in &dependency.after {
                let Some(from) = middle(&after.name) else { continue };
                // Hazards with the previous frame start at the left edge.
                let from = if dependency.previous_frame { self.area.left() } else { from };
                painter.line_segment([pos2(from, y), pos2(to, y)], stroke);
                painter.circle_filled(pos2(from, y), 3.0, self.palette.accent);
            }
            painter.line_segment([pos2(to - 5.0, y - 4.0), pos2(to, y)], stroke);
            painter.line_segment([pos2(to - 5.0, y + 4.0), pos2(to, y)], stroke);
        }
    }

    /// Draws memory: a bar for each resource's lifetime, or over all passes if it has none. Circles are reads, squares
    /// are writes. Returns the resource that was clicked.
    fn draw_lanes(&self, ui: &Ui, lanes: &[Lane]) -> Option<Selection> {
        let View { dump, columns, selection, area, palette, .. } = *self;
        let mut clicked = None;
        let painter = ui.painter().with_clip_rect(area.intersect(ui.clip_rect()));
        painter.rect_filled(area, 0.0, palette.paper);
        for (index, lane) in lanes.iter().enumerate() {
            let top = area.top() + LANE * index as f32;
            let row = Rect::from_min_size(pos2(area.left(), top), vec2(area.width(), LANE));
            if !ui.is_rect_visible(row) {
                continue;
            }
            if index % 2 == 1 {
                painter.rect_filled(row, 0.0, palette.raised);
            }
            let name = Rect::from_min_size(pos2(area.left() - NAMES, top), vec2(NAMES - 8.0, LANE));
            text_in(ui, ui.painter(), name, &lane.title, palette.ink);
            for resource in &lane.resources {
                let (left, right) = match resource.lifetime {
                    Some(lifetime) => (columns[lifetime.first].left, columns[lifetime.last].right),
                    None => (0.0, columns.last().map_or(0.0, |column| column.right)),
                };
                let bar = self.span(left, right, top + 3.0, LANE - 6.0);
                let this = Selection::Resource(resource.name.clone());
                let selected = selection == Some(&this);
                // A name that belongs to a single resource is clickable like its bar.
                let place = if lane.resources.len() == 1 { bar.union(name) } else { bar };
                let visible = place.intersect(Rect::from_min_max(name.min, area.max));
                let response = ui.interact(visible, Id::unique(("resource", &resource.name)), Sense::CLICK);
                see(ui.ctx(), &format!("resource:{}", resource.name), visible);
                let fill = if selected { palette.accent.gamma_multiply(0.5) } else { palette.life };
                let edge = if response.hovered() || response.has_focus() || selected {
                    palette.accent
                } else {
                    fill
                };
                painter.rect(bar, 3.0, fill, Stroke::new(1.0, edge), StrokeKind::Inside);
                for column in columns {
                    let (reads, writes) = touches(&dump.passes[column.pass], &resource.name);
                    let centre = pos2(self.x((column.left + column.right) / 2.0), bar.center().y);
                    draw_use(&painter, &palette, centre, reads, writes);
                }
                if response.clicked() {
                    clicked = Some(this);
                }
                if response.hovered() {
                    let text = format!(
                        "{}\n{}, {}\nCircles read it, squares write it.\n{}:{}",
                        resource.name,
                        resource.shape,
                        dump::bytes(resource.bytes),
                        resource.declared.file,
                        resource.declared.line
                    );
                    response.hint(text);
                }
            }
        }
        clicked
    }
}

fn legend(ui: &mut Ui, dump: &Dump) {
    let palette = Palette::of(ui);
    let mut row = |text: String, sign: &dyn Fn(&Painter, Rect)| {
        ui.horizontal(|ui| {
            let (rect, _) = ui.allocate_exact_size(vec2(3.0 * GRID + 4.0, ROW - 4.0), Sense::hover());
            sign(ui.painter(), Rect::from_center_size(rect.center(), vec2(16.0, 12.0)));
            ui.label(text);
        });
    };
    for (index, phase) in phases(dump).into_iter().enumerate() {
        let count = dump.passes.iter().filter(|pass| pass.phase == phase).count();
        let passes = if count == 1 { "1 pass".to_owned() } else { format!("{count} passes") };
        row(format!("{phase}: {passes}"), &|painter, rect| {
            painter.rect_filled(rect, 2.0, theme::phase(index));
        });
    }
    let line = Stroke::new(1.0, palette.ink);
    row("runs once, before the first frame".to_owned(), &|painter, rect| {
        painter.rect_stroke(rect, 2.0, line, StrokeKind::Inside);
    });
    row("barrier".to_owned(), &|painter, rect| {
        widgets::diamond(painter, rect.center(), 5.0, palette.barrier, Stroke::NONE);
    });
    row("memory in use".to_owned(), &|painter, rect| _ = painter.rect_filled(rect, 3.0, palette.life));
    for (text, reads, writes) in [
        ("read by the pass above", true, false),
        ("written by it", false, true),
        ("read and written by it", true, true),
    ] {
        row(text.to_owned(), &|painter, rect| draw_use(painter, &palette, rect.center(), reads, writes));
    }
}

/// Draws the symbol for a pass's use of a resource: a square for writes, a circle for reads.
fn draw_use(painter: &Painter, palette: &Palette, centre: Pos2, reads: bool, writes: bool) {
    if writes {
        painter.rect_filled(Rect::from_center_size(centre, vec2(6.0, 6.0)), 1.0, palette.ink);
    }
    if reads {
        let (radius, inner) = if writes { (2.0, palette.life) } else { (3.5, palette.paper) };
        painter.circle(centre, radius, inner, Stroke::new(1.0, palette.ink));
    }
}

/// Computes the positions of all passes and barriers, and the total width, in points. At a `zoom` of 1, they fit in
/// `width` if possible. The frame's passes are equally wide if `equal`; otherwise, their widths follow their times.
fn columns(dump: &Dump, times: &Times, width: f32, zoom: f32, equal: bool) -> (Vec<Column>, f32) {
    let frame = |pass: &&DumpPass| pass.run == Run::Frame;
    let count = dump.passes.iter().filter(frame).count().max(1) as f32;
    let total: f64 = dump.passes.iter().filter(frame).filter_map(|pass| times.of(&pass.name)).sum();
    let once = dump.passes.iter().filter(|pass| pass.run == Run::Once).count() as f32 * ONCE;
    let gaps = dump.passes.iter().filter(|pass| !pass.barriers.is_empty()).count() as f32 * GAP;
    let room = (width - gaps - once - GAP).max(count * MIN_WIDTH);
    let (mut columns, mut x) = (Vec::with_capacity(dump.passes.len()), 0.0);
    let mut in_frame = false;
    for (index, pass) in dump.passes.iter().enumerate() {
        let mut barriers = Vec::new();
        if pass.run == Run::Frame && !in_frame {
            in_frame = true;
            if !dump.handover.is_empty() {
                barriers.extend(dump.handover.iter().map(|barrier| (barrier.id, x + GAP / 2.0)));
                x += GAP;
            }
        }
        if !pass.barriers.is_empty() {
            barriers.extend(pass.barriers.iter().map(|barrier| (barrier.id, x + GAP / 2.0)));
            x += GAP;
        }
        let share = match (equal, times.of(&pass.name)) {
            (false, Some(ms)) if total > 0.0 => (ms / total) as f32 * (room - count * MIN_WIDTH) + MIN_WIDTH,
            (false, _) => MIN_WIDTH,
            (true, _) => room / count,
        };
        let wide = if pass.run == Run::Once { ONCE } else { share.max(MIN_WIDTH) } * zoom;
        columns.push(Column { pass: index, left: x, right: x + wide, barriers });
        x += wide;
    }
    (columns, x.max(1.0))
}

/// Groups the resources into rows: shared blocks, then transient resources, then all others. Keeps the rows in which
/// the title or any resource's name contains `filter`, in upper or lower case.
fn lanes<'a>(dump: &'a Dump, filter: &str) -> Vec<Lane<'a>> {
    let wanted = filter.trim().to_lowercase();
    let find = |name: &String| dump.resources.iter().find(|resource| resource.name == *name);
    let mut lanes = Vec::new();
    for block in dump.blocks.iter().filter(|block| block.aliases.len() > 1) {
        let mut resources: Vec<_> = block.aliases.iter().filter_map(find).collect();
        resources.sort_by_key(|resource| resource.lifetime.map_or(0, |lifetime| lifetime.first));
        let title = format!("block {}, {} share {}", block.id, resources.len(), dump::bytes(block.bytes));
        lanes.push(Lane { title, resources });
    }
    let shared = |resource: &dump::DumpResource| {
        lanes.iter().any(|lane| lane.resources.iter().any(|other| other.name == resource.name))
    };
    let alone: Vec<_> = dump.resources.iter().filter(|resource| !shared(resource)).collect();
    let own = |resource: &&dump::DumpResource| resource.source == "transient";
    for resource in alone.iter().filter(|r| own(r)).chain(alone.iter().filter(|r| !own(r))) {
        lanes.push(Lane { title: resource.name.clone(), resources: vec![resource] });
    }
    lanes.retain(|lane| {
        lane.title.to_lowercase().contains(&wanted)
            || lane.resources.iter().any(|resource| resource.name.to_lowercase().contains(&wanted))
    });
    lanes
}

pub fn phase_colour(dump: &Dump, phase: &str) -> Color32 {
    theme::phase(phases(dump).get_index_of(phase).unwrap_or(0))
}

/// Lists the names of the phases; a phase of both the prologue and the frame counts once.
fn phases(dump: &Dump) -> IndexSet<&str> {
    dump.phases.iter().map(|phase| phase.name.as_str()).collect()
}

fn describe(pass: &DumpPass, ms: Option<f64>) -> String {
    let mut text = format!("{}\n{} in phase {}, {}", pass.name, pass.kind, pass.phase, pass.size);
    if pass.run == Run::Once {
        text += "\nRuns once, before the first frame.";
    }
    if let Some(ms) = ms {
        text += &format!("\n{} (median)", widgets::time(ms));
    }
    text + &format!("\n{}:{}", pass.declared.file, pass.declared.line)
}

/// Height of the timeline with its summary and six lanes, in points.
pub const HEIGHT: f32 = ROW + PHASES + PASSES + BARRIERS + 6.0 * LANE + 4.0 * GRID;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::backend;
    use crate::view::tests;

    fn times(all: &[(&str, f64)]) -> Times {
        let passes = all.iter().map(|(name, ms)| ((*name).to_owned(), *ms)).collect();
        Times { passes, unattributed: None, unreliable: false }
    }

    #[test]
    fn a_pass_is_as_wide_as_its_time_and_none_vanishes() {
        let plan = tests::plan(&[("a", "x"), ("b", "x"), ("c", "y")]);
        let dump = backend::dump(&plan);
        let (columns, whole) =
            columns(&dump, &times(&[("a", 3.0), ("b", 1.0), ("c", 0.0)]), 1000.0, 1.0, false);
        let wide: Vec<f32> = columns.iter().map(|column| column.right - column.left).collect();
        assert!((wide[0] - MIN_WIDTH) / (wide[1] - MIN_WIDTH) > 2.99, "{wide:?}");
        assert_eq!(wide[2], MIN_WIDTH);
        assert!(whole <= 1000.0, "{whole}");
    }

    #[test]
    fn without_times_all_passes_are_equally_wide() {
        let plan = tests::plan(&[("a", "x"), ("b", "x")]);
        let (columns, _) = columns(&backend::dump(&plan), &times(&[]), 500.0, 1.0, true);
        assert_eq!(columns[0].right - columns[0].left, columns[1].right - columns[1].left);
    }
}
