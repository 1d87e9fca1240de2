//! Draws small widgets that the panels share, such as rows, hints, numbers and sparklines.

use super::controls::{Command, request, see};
use super::keyboard::moved;
use super::theme::{self, Palette, ROW, TEXT};
use egui::{
    Align, FontId, Key, Layout, Order, Painter, Pos2, Rect, RectAlign, Response, RichText, Stroke, Ui, Vec2,
    pos2, vec2,
};
use egui::{Color32, ComboBox, Context, Popup, ScrollArea, Tooltip, WidgetText};
use egui_plot::Plot;

/// Sides on which a hint may appear without covering its control.
const SIDES: [RectAlign; 6] = [
    RectAlign::RIGHT_START,
    RectAlign::LEFT_START,
    RectAlign::BOTTOM_START,
    RectAlign::BOTTOM_END,
    RectAlign::TOP_START,
    RectAlign::TOP_END,
];

/// Maximum height of a tool's tab and margin above its scroll area, in points.
const TAB: f32 = 40.0;

/// Additions to the response of a control.
pub trait Control: Sized {
    /// Records the control's position under a name, for scripted input.
    fn named(self, name: &str) -> Self;

    /// Shows a tooltip beside the control while it is hovered, without covering it.
    fn hint(self, text: impl Into<WidgetText>) -> Self;
}

impl Control for Response {
    fn named(self, name: &str) -> Response {
        see(&self.ctx, name, self.rect);
        self
    }

    fn hint(self, text: impl Into<WidgetText>) -> Response {
        let mut tooltip =
            if self.enabled() { Tooltip::for_enabled(&self) } else { Tooltip::for_disabled(&self) };
        tooltip.popup = tooltip.popup.align(SIDES[0]).align_alternatives(&SIDES[1..]);
        let text = text.into();
        tooltip.show(|ui| {
            ui.set_max_width(ui.spacing().tooltip_width);
            ui.label(text);
        });
        self
    }
}

pub fn row(ui: &mut Ui, left: impl FnOnce(&mut Ui) -> Response, right: impl FnOnce(&mut Ui)) -> Response {
    ui.horizontal(|ui| {
        ui.set_min_height(ROW - 4.0);
        let response = left(ui);
        ui.with_layout(Layout::right_to_left(Align::Center), right);
        response
    })
    .inner
}

pub fn fact(ui: &mut Ui, name: &str, value: impl Into<String>) {
    let palette = Palette::of(ui);
    row(
        ui,
        |ui| ui.label(RichText::new(name).color(palette.soft)),
        |ui| _ = ui.add(egui::Label::new(value.into()).truncate()),
    );
}

/// Formats a switch as `on` or `off`.
pub fn on_off(on: bool) -> &'static str {
    if on { "on" } else { "off" }
}

/// Draws a ring around the control that has the keyboard focus.
pub fn focus_ring(ctx: &Context) {
    let focused = ctx.memory(|memory| memory.focused()).and_then(|id| ctx.read_response(id));
    let Some(response) = focused.filter(|response| response.interact_rect.is_positive()) else { return };
    let painter = ctx.layer_painter(response.layer_id).with_clip_rect(response.interact_rect.expand(3.0));
    // Not the accent colour, which controls that are on already have.
    let stroke = Stroke::new(2.0, Palette::in_mode(ctx.theme() == egui::Theme::Dark).ink);
    painter.rect_stroke(response.rect.expand(1.0), 4.0, stroke, egui::StrokeKind::Outside);
}

/// Scrolls to the control that has just got the keyboard focus, if it is in this scroll area. Page keys, Home and End
/// scroll the area while the focus is in it, on the tab above it, or elsewhere in its card or window. Must be called
/// after the area's contents.
pub fn follow_focus(ui: &mut Ui) {
    if !ui.is_visible() {
        return;
    }
    let (id, now) = (ui.scope_id().with("focus"), ui.ctx().memory(|memory| memory.focused()));
    let former = ui.data(|data| data.get_temp::<Option<egui::Id>>(id)).flatten();
    ui.data_mut(|data| data.insert_temp(id, now));
    let control = now.and_then(|id| ui.ctx().read_response(id));
    let Some(control) = control.filter(|control| control.layer_id == ui.layer_id()) else { return };
    let (area, centre) = (ui.clip_rect(), control.rect.center());
    // A control that is visible outside belongs to another area, even if it covers a hidden part of this one.
    let elsewhere = control.interact_rect.is_positive() && !area.contains_rect(control.interact_rect);
    let is_inside = !elsewhere && ui.min_rect().contains(centre);
    if is_inside && now != former {
        ui.scroll_to_rect(control.rect.expand(theme::GRID), None);
    }
    let tab = Rect::from_min_max(area.left_top() - vec2(0.0, TAB), area.right_top());
    let is_near = ui.layer_id().order != Order::Background || tab.contains(centre);
    if (is_inside || is_near) && !ui.ctx().text_edit_focused() {
        for key in [Key::PageUp, Key::PageDown, Key::Home, Key::End] {
            if ui.input(|input| input.key_pressed(key)) {
                ui.scroll_with_delta(moved(key, area.height()));
            }
        }
    }
}

/// Returns the keyboard focus to a button when its list or menu closes, if a key opened it. Must be called after the
/// list.
pub fn return_focus(ui: &mut Ui, button: &Response) {
    let id = button.id.with("by key");
    if button.clicked() {
        // Not within `data_mut`, which locks the context.
        let by_key = !button.clicked_by(egui::PointerButton::Primary);
        ui.data_mut(|data| data.insert_temp(id, by_key));
    }
    let by_key = ui.data(|data| data.get_temp::<bool>(id)).unwrap_or(false);
    if by_key && !Popup::is_id_open(ui.ctx(), Popup::default_response_id(button)) {
        ui.data_mut(|data| data.insert_temp(id, false));
        // A click on the picture gives the keys to the camera.
        if !ui.input(|input| input.pointer.any_down() || input.pointer.any_released()) {
            button.request_focus();
        }
    }
}

/// Ranks an item of a searched list; `None` if nothing matches. An equal name comes first, then names that begin with
/// `wanted`, names that contain it, and descriptions that contain it. `wanted` must be in lower case.
pub fn rank(wanted: &str, names: &[&str], about: &str) -> Option<u8> {
    let of = |text: &str| {
        let text = text.to_lowercase();
        let ranks = [text == wanted, text.starts_with(wanted), text.contains(wanted)];
        ranks.iter().position(|fits| *fits).map(|rank| rank as u8)
    };
    names.iter().filter_map(|name| of(name)).min().or_else(|| of(about).map(|_| 3))
}

/// Draws the contents of an open list: a search field, a button to open files if `opens`, and the items.
///
/// The items are those that have a rank for the searched text (in lower case), the best match first. `name` is the name
/// of the field for scripts. `row` draws an item, and returns its name for scripts.
///
/// Returns the item that is clicked, or the best match if Enter is pressed and the field is not empty, and closes the
/// list.
///
/// When the list opens, the field is empty and has the keyboard focus, and the current item is in view. Down in the
/// field moves the focus to that item, or to the best match.
pub fn list<T>(
    ui: &mut Ui,
    (text, name, opens): (&mut String, &str, bool),
    items: impl IntoIterator<Item = T>,
    rank: impl Fn(&T, &str) -> Option<u8>,
    is_current: impl Fn(&T) -> bool,
    row: impl Fn(&mut Ui, &T) -> (String, Response),
) -> Option<T> {
    let id = ui.make_persistent_id(name);
    let now = ui.ctx().cumulative_frame_nr();
    let shown = ui.data(|data| data.get_temp::<u64>(id));
    let is_new = shown.is_none_or(|shown| shown + 1 < now);
    if is_new {
        text.clear();
    }
    let field = ui.horizontal(|ui| {
        let field = egui::TextEdit::singleline(text).id(id).hint_text("Search").desired_width(180.0);
        let field = ui.add(field);
        if opens && ui.button("Open a file…").clicked() {
            request(ui.ctx(), Command::Open(None));
            ui.close();
        }
        field
    });
    let field = field.inner;
    let enters = field.has_focus() && ui.input(|input| input.key_pressed(Key::ArrowDown));
    // egui lays out an opening list once invisibly, at another position, when the field cannot get the focus.
    let is_visible = ui.is_visible();
    if is_visible {
        ui.data_mut(|data| data.insert_temp(id, now));
        if is_new {
            field.request_focus();
        }
        field.named(name);
    }
    let wanted = text.trim().to_lowercase();
    let searches = !wanted.is_empty();
    let enter = searches && ui.input(|input| input.key_pressed(Key::Enter));
    let mut chosen = None;
    let found = ranked(items, |item| rank(item, &wanted));
    if found.is_empty() && searches {
        let text = ui.weak("Nothing matches.");
        if is_visible {
            text.named("nothing_matches");
        }
    }
    let first = if searches { 0 } else { found.iter().position(is_current).unwrap_or(0) };
    let height = (ui.ctx().content_rect().height() - 140.0).max(100.0);
    // By default, egui limits the height of a menu to 400 points.
    ScrollArea::vertical().max_height(height).min_scrolled_height(height).show(ui, |ui| {
        for (place, item) in found.into_iter().enumerate() {
            let (name, response) = row(ui, &item);
            if is_visible {
                see(ui.ctx(), &name, response.rect);
            }
            if place == first && enters {
                response.request_focus();
            }
            // The start of the list stays in view if the first item is the current one.
            if place == first && place > 0 && is_new {
                let at_once = egui::style::ScrollAnimation::none();
                ui.scroll_to_rect_animation(response.rect, Some(Align::Center), at_once);
            }
            if response.clicked() || enter && place == 0 {
                ui.close();
                chosen = Some(item);
            }
        }
        follow_focus(ui);
    });
    chosen
}

fn ranked<T>(items: impl IntoIterator<Item = T>, rank: impl Fn(&T) -> Option<u8>) -> Vec<T> {
    let mut found: Vec<(u8, T)> =
        items.into_iter().filter_map(|item| rank(&item).map(|rank| (rank, item))).collect();
    found.sort_by_key(|(rank, _)| *rank);
    found.into_iter().map(|(_, item)| item).collect()
}

/// Draws a list of choices, which shows `shown` while it is closed. Sets `value` to the choice of the user.
pub fn choice<T: PartialEq, S: AsRef<str>>(
    ui: &mut Ui,
    name: &str,
    shown: &str,
    value: &mut T,
    choices: impl IntoIterator<Item = (T, S)>,
) {
    let list = ComboBox::from_id_salt(name).selected_text(shown).truncate().show_ui(ui, |ui| {
        for (choice, text) in choices {
            let item = ui.selectable_value(value, choice, text.as_ref());
            // egui closes the list only if a pointer chooses.
            if item.clicked() {
                ui.close();
            }
            // egui lays out an opening list once invisibly, at another position.
            if ui.is_visible() {
                item.named(&format!("{name}={}", text.as_ref()));
            }
        }
    });
    return_focus(ui, &list.response);
    // A long name is cut.
    list.response.named(name).hint(shown);
}

/// Creates a plot of times in milliseconds, without zooming and panning. `height` is in points.
pub fn time_plot<'a>(name: &str, height: f32) -> Plot<'a> {
    Plot::new(name)
        .height(height)
        .allow_scroll(false)
        .allow_zoom(false)
        .allow_drag(false)
        .include_y(0.0)
        .x_axis_formatter(|_, _| String::new())
        .y_axis_formatter(|mark, _| time(mark.value))
}

pub fn heading(ui: &mut Ui, text: impl Into<String>) -> Response {
    ui.add_space(theme::GRID);
    ui.label(RichText::new(text).family(theme::strong()))
}

pub fn link(ui: &mut Ui, text: impl Into<String>) -> Response {
    ui.add(egui::Link::new(RichText::new(text).color(Palette::of(ui).accent)))
}

/// Formats milliseconds as in [`three_digits`], such as `0.153 ms`, `12.4 ms`, `5.75 s`.
pub fn time(ms: f64) -> String {
    let (value, unit) = if ms >= 999.5 { (ms / 1e3, "s") } else { (ms, "ms") };
    format!("{} {unit}", three_digits(value))
}

/// Formats a number with three significant digits, but at most three decimals. Integer digits are never dropped.
pub fn three_digits(value: f64) -> String {
    match value.abs() {
        v if v >= 99.95 => format!("{value:.0}"),
        v if v >= 9.995 => format!("{value:.1}"),
        v if v >= 0.9995 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

/// Formats a length with four digits or more, and with four decimals or more.
pub fn length(value: f64) -> String {
    format!("{value:.*}", splatgraph_assets::decimals(value, 4))
}

/// Draws values as a line graph, oldest at the left, scaled from 0 to the largest value. Draws nothing for fewer than
/// two values, or if the largest is not positive and finite.
pub fn sparkline(painter: &Painter, rect: Rect, values: &[f64], stroke: Stroke) {
    let most = values.iter().copied().fold(0.0, f64::max);
    if values.len() < 2 || most <= 0.0 || !most.is_finite() {
        return;
    }
    let step = rect.width() / (values.len() - 1) as f32;
    let point = |(index, value): (usize, &f64)| {
        pos2(rect.left() + index as f32 * step, rect.bottom() - rect.height() * (value / most) as f32)
    };
    painter.line(values.iter().enumerate().map(point).collect(), stroke);
}

/// Returns a text between two others, cut at its start so that all fit in `width` points. Names usually differ at the
/// end.
pub fn ending(ui: &Ui, font: &FontId, [before, text, after]: [&str; 3], width: f32) -> String {
    let fits = |title: &String| {
        ui.painter().layout_no_wrap(title.clone(), font.clone(), Color32::WHITE).size().x <= width
    };
    let ends = text.char_indices().skip(1).map(|(at, _)| format!("{before}…{}{after}", &text[at..]));
    std::iter::once(format!("{before}{text}{after}")).chain(ends).find(fits).unwrap_or_default()
}

/// Lays out one line of text, truncated with an ellipsis at `width` points.
pub fn elided(
    ui: &Ui,
    text: &str,
    font: FontId,
    colour: Color32,
    width: f32,
) -> std::sync::Arc<egui::Galley> {
    let mut job = egui::text::LayoutJob::simple_singleline(text.to_owned(), font, colour);
    job.wrap = egui::text::TextWrapping::truncate_at_width(width);
    ui.fonts_mut(|fonts| fonts.layout_job(job))
}

/// Draws text in a rectangle, vertically centred and truncated at the right edge.
pub fn text_in(ui: &Ui, painter: &Painter, rect: Rect, text: &str, colour: Color32) {
    let galley = elided(ui, text, FontId::proportional(TEXT), colour, rect.width());
    let top = rect.center().y - galley.size().y / 2.0;
    painter.galley(pos2(rect.left(), top), galley, colour);
}

pub fn diamond(painter: &Painter, at: Pos2, radius: f32, fill: egui::Color32, stroke: Stroke) {
    let corners = [Vec2::UP, Vec2::RIGHT, Vec2::DOWN, Vec2::LEFT].map(|side| at + radius * side);
    painter.add(egui::Shape::convex_polygon(corners.to_vec(), fill, stroke));
}

pub fn divider(ui: &mut Ui) {
    let (rect, _) = ui.allocate_exact_size(vec2(2.0 * theme::GRID, ROW), egui::Sense::hover());
    let stroke = ui.visuals().widgets.noninteractive.bg_stroke;
    ui.painter().vline(rect.center().x, rect.y_range().shrink(theme::GRID), stroke);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_finds_equal_names_first_and_descriptions_last() {
        let graphs =
            [("mesh", "blends no splats"), ("my_splat", ""), ("splat2", ""), ("splat", ""), ("x", "")];
        let found = ranked(graphs, |(name, about)| rank("splat", &[name], about));
        let names: Vec<&str> = found.into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["splat", "splat2", "my_splat", "mesh"]);
        assert_eq!(ranked(graphs, |(name, about)| rank("", &[name], about)), graphs);
    }

    #[test]
    fn a_name_that_is_too_long_loses_its_start() {
        let mut names = Vec::new();
        let mut output = Context::default().run_ui(egui::RawInput::default(), |ui| {
            let font = FontId::monospace(10.0);
            let width = 8.5 * ui.fonts_mut(|fonts| fonts.glyph_width(&font, ' '));
            names = ["order.sort[0]", "order.sort[1]", "scan"]
                .map(|name| ending(ui, &font, ["", name, ""], width))
                .into();
        });
        output.textures_delta.clear();
        assert_eq!(names, ["…sort[0]", "…sort[1]", "scan"]);
    }

    #[test]
    fn lengths_have_four_digits_however_small() {
        let texts = [1234.56789, 1.5, 0.00012, 1e-5, 0.0, f64::NAN].map(length);
        assert_eq!(texts, ["1234.5679", "1.5000", "0.0001200", "0.00001000", "0.0000", "NaN"]);
    }

    #[test]
    fn times_have_three_significant_digits_and_seconds_from_one_second_on() {
        let texts = [0.0456, 0.1234, 1.2345, 12.345, 123.45, 999.4, 999.6, 5749.871].map(time);
        let expected = ["0.046 ms", "0.123 ms", "1.23 ms", "12.3 ms", "123 ms", "999 ms", "1.00 s", "5.75 s"];
        assert_eq!(texts, expected);
    }
}
