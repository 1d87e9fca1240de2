//! Draws over the picture: the frame time, toasts, progress, and the comparison of A and B.

use super::controls::{self, see};
use super::theme::{self, GRID, Palette, TEXT};
use super::widgets::{self, Control as _};
use crate::view::events::{Cause, Event, RendererId};
use crate::view::paint::Mode;
use crate::view::viewer::Viewer;
use crate::view::viewport::Viewport;
use egui::{
    Align2, Area, Color32, Context, CornerRadius, FontId, Frame, Id, InnerResponse, Margin, Order, Pos2,
    Rect, RichText, Stroke, Ui, pos2, vec2,
};
use splatgraph_api::Device;
use splatgraph_assets::grouped;
use splatgraph_reference::metrics::Comparison;
use std::time::{Duration, Instant};

const STAY: Duration = Duration::from_secs(5);
/// Display time of a toast about a failure, a scene's notes, or dropped or restored parameters.
const STAY_LONG: Duration = Duration::from_secs(12);
/// Topic of toasts about loaded scenes.
const SCENE: &str = "the scene";
/// Topic of the toast about a copied text.
const COPIED: &str = "a copy";
const MAX_TOASTS: usize = 4;
const FRAMES: usize = 120;
/// Background of text over the picture, dark enough for white text on any picture.
const SHADE: Color32 = Color32::from_black_alpha(200);

struct Toast {
    number: u64,
    /// Kind of message that a later event removes, often to show only the newest; empty for all others.
    topic: &'static str,
    text: String,
    /// True for the message of a failure.
    failed: bool,
    end: Instant,
    /// Height of its card in the last frame, in points.
    height: f32,
}

/// Messages that appear over the picture and disappear by themselves.
#[derive(Default)]
pub struct Toasts {
    shown: Vec<Toast>,
    count: u64,
}

impl Toasts {
    pub fn done(&mut self, text: String) {
        self.add("", text, false, STAY);
    }

    /// Adds the toast of a copied text, which [`Toasts::show`] always draws.
    pub fn copied(&mut self) {
        self.add(COPIED, "Copied to the clipboard".to_owned(), false, STAY);
    }

    /// Removes the toasts about dropped and restored settings of a renderer: it has another graph, or other settings.
    pub fn forget_settings(&mut self, renderer: RendererId) {
        self.forget(settings_of(renderer));
    }

    fn forget(&mut self, topic: &str) {
        self.shown.retain(|toast| toast.topic != topic);
    }

    /// Adds a toast for the time `stay`. It replaces earlier ones with the same text or, unless empty, the same topic.
    fn add(&mut self, topic: &'static str, text: String, failed: bool, stay: Duration) {
        if !topic.is_empty() {
            self.forget(topic);
        }
        self.push(topic, text, failed, stay);
    }

    /// Adds a toast, which replaces one with the same text. Drops the oldest toast if there are more than
    /// [`MAX_TOASTS`].
    fn push(&mut self, topic: &'static str, text: String, failed: bool, stay: Duration) {
        self.count += 1;
        self.shown.retain(|toast| toast.text != text);
        if self.shown.len() == MAX_TOASTS {
            self.shown.remove(0);
        }
        let end = Instant::now() + stay;
        self.shown.push(Toast { number: self.count, topic, text, failed, end, height: 0.0 });
    }

    /// Shows an event as a toast if the user is waiting for it or needs to know it. For a failed load that the card of
    /// errors shows, removes the scene's toasts instead.
    pub fn tell(&mut self, event: &Event) {
        match event {
            Event::Swapped { renderer, swap } => {
                let files: Vec<String> = swap
                    .causes
                    .iter()
                    .filter(|cause| matches!(cause, Cause::File(_)))
                    .map(Cause::to_string)
                    .collect();
                if !files.is_empty() && *renderer != RendererId::Window {
                    let passes = match swap.passes {
                        _ if swap.same_plan => "the same plan".to_owned(),
                        1 => "1 pass".to_owned(),
                        n => format!("{n} passes"),
                    };
                    let text = format!("{}: {}, {passes}", files.join(", "), widgets::time(swap.latency_ms));
                    self.add("saved files", text, false, STAY);
                }
            }
            Event::Scene { .. } => self.add(SCENE, event.to_string(), false, STAY),
            // Follows the event of the load.
            Event::SceneNotes { .. } => self.add(SCENE, event.to_string(), false, STAY_LONG),
            // The card of errors shows it.
            Event::SceneFailed { stays: true, .. } => self.forget(SCENE),
            Event::Cameras { .. }
            | Event::Saved { .. }
            | Event::Exported { .. }
            | Event::Screenshot { .. }
            | Event::DeviceOpened { .. } => {
                self.done(event.to_string());
            }
            // A graph may drop settings for more than one reason.
            Event::Dropped { renderer, .. } => {
                self.push(settings_of(*renderer), event.to_string(), false, STAY_LONG);
            }
            Event::Restored { renderer, .. } => {
                self.add(settings_of(*renderer), event.to_string(), false, STAY_LONG);
            }
            Event::SceneFailed { .. } | Event::FileFailed { .. } | Event::Problem { .. } => {
                self.add("", event.to_string(), true, STAY_LONG);
            }
            _ => {}
        }
    }

    #[cfg(test)]
    pub fn texts(&self) -> Vec<&str> {
        self.shown.iter().map(|toast| toast.text.as_str()).collect()
    }

    /// Draws the toasts at the top right of the picture, and removes expired and dismissed ones. Unless `all`, removes
    /// every toast but that of a copied text. Toasts that would cover the card of errors, the oldest first, are not
    /// drawn.
    pub fn show(&mut self, ctx: &Context, view: Rect, all: bool) {
        let now = Instant::now();
        self.shown.retain(|toast| toast.end > now && (all || toast.topic == COPIED));
        let Some(next) = self.shown.iter().map(|toast| toast.end).min() else { return };
        ctx.request_repaint_after(next - now);
        let mut dismissed = None;
        let palette = Palette::in_mode(ctx.theme() == egui::Theme::Dark);
        let mut top = view.top() + 3.0 * GRID;
        let gap = 2.0 * GRID;
        let bottom = controls::find(ctx, "mistakes").map_or(f32::INFINITY, |card| card.top());
        let mut room = bottom - top;
        let fits = |toast: &&mut Toast| {
            room -= toast.height + gap;
            room >= 0.0
        };
        let skipped = self.shown.len() - self.shown.iter_mut().rev().take_while(fits).count();
        for toast in &mut self.shown[skipped..] {
            let edge = if toast.failed { palette.error } else { palette.line };
            let (id, at) = (Id::unique(("toast", toast.number)), pos2(view.right() - 3.0 * GRID, top));
            let shown = area(id, at, Align2::RIGHT_TOP, view, Order::Foreground).show(ctx, |ui| {
                card(ui, edge).show(ui, |ui| {
                    ui.set_max_width((view.width() - 8.0 * GRID).clamp(40.0, 420.0));
                    ui.horizontal(|ui| {
                        ui.add(egui::Label::new(&toast.text).wrap());
                        if ui.add(egui::Button::new("✗").frame(false)).clicked() {
                            dismissed = Some(toast.number);
                        }
                    });
                });
            });
            toast.height = shown.response.rect.height();
            top = shown.response.rect.bottom() + gap;
            see(ctx, "toast", shown.response.rect);
        }
        self.shown.retain(|toast| Some(toast.number) != dismissed);
    }
}

/// Returns the topic of toasts about dropped and restored settings.
fn settings_of(renderer: RendererId) -> &'static str {
    match renderer {
        RendererId::A => "settings of A",
        RendererId::B => "settings of B",
        RendererId::Window => "settings of the window",
    }
}

/// Returns the rectangle in which cards are placed: the picture's, or the window's if a tool hides the picture.
pub fn space_for_cards(ctx: &Context, view: Rect) -> Rect {
    if view.is_positive() { view } else { ctx.content_rect() }
}

/// Makes an area within `view`, with its corner or edge `pivot` at `at`.
pub fn area(id: Id, at: Pos2, pivot: Align2, view: Rect, order: Order) -> Area {
    Area::new(id).fixed_pos(at).pivot(pivot).constrain_to(view).order(order)
}

/// Shows an area that is placed by its middle or its end. egui places it by its size in the previous frame, so the
/// frame is laid out again if the size changed.
pub fn show_area(ctx: &Context, area: Area, contents: impl FnOnce(&mut Ui)) -> InnerResponse<()> {
    let id = area.layer().id;
    let before = ctx.memory(|memory| memory.area_rect(id));
    let shown = area.show(ctx, contents);
    let differs = |before: Rect| (before.size() - shown.response.rect.size()).abs().max_elem() > 0.5;
    if before.is_some_and(differs) {
        ctx.request_discard("a card has another size");
    }
    shown
}

/// Returns the background frame of a card over the picture; `edge` is its border's colour.
pub fn card(ui: &Ui, edge: Color32) -> Frame {
    let palette = Palette::of(ui);
    Frame::new()
        .fill(palette.raised)
        .stroke(Stroke::new(1.0, edge))
        .corner_radius(CornerRadius::same(6))
        .inner_margin(Margin::symmetric(12, 8))
        .shadow(ui.visuals().popup_shadow)
}

/// Draws A's frame time, rate, splat count, memory and a sparkline in the top left corner of the picture. Also tells if
/// no splat is in view. `interval` is the time between frames, in milliseconds. Draws nothing before a frame is
/// measured, or if the texts do not fit.
pub fn show(ui: &Ui, viewer: &Viewer, interval: Option<f64>, view: Rect) {
    let viewport = &viewer.a;
    let Some(total) = viewport.history.total() else { return };
    let memory: u64 =
        viewport.renderer.device().map_or(0, |device| device.memory().iter().map(|(_, b)| b).sum());
    let mut text = widgets::time(total.median);
    if let Some(ms) = interval {
        text += &format!("   {}", rate(ms));
    }
    let dropped = match viewer.scene().dropped().total() {
        0 => String::new(),
        count => format!(" ({} dropped)", grouped(count)),
    };
    let second = format!(
        "{} splats{dropped}   {}",
        grouped(viewer.scene().count().into()),
        splatgraph_framework::dump::bytes(memory)
    );
    let strong = FontId::new(TEXT, theme::strong());
    let layout =
        |text: &str, font: FontId| ui.painter().layout_no_wrap(text.to_owned(), font, Color32::WHITE);
    let mut lines = vec![layout(&text, strong.clone()), layout(&second, FontId::proportional(TEXT))];
    let invisible = |(name, count): &(String, u32)| name == "visible" && *count == 0;
    if viewer.scene().count() > 0 && viewport.stats.iter().any(invisible) {
        lines.push(layout("no splat in view, or all nearer than 0.2 units: F shows the scene", strong));
    }
    let recent = viewport.history.recent(FRAMES);
    let spark = if recent.len() > 1 { 20.0 } else { 0.0 };
    let width = lines.iter().map(|line| line.size().x).fold(0.0, f32::max);
    let height: f32 = lines.iter().map(|line| line.size().y).sum::<f32>() + spark;
    let mut rect = Rect::from_min_size(view.min + vec2(12.0, 12.0), vec2(width + 20.0, height + 16.0));
    let line = view.left() + viewer.split * view.width();
    if viewer.compare == Mode::Split && rect.expand2(vec2(32.0, 0.0)).x_range().contains(line) {
        // Keep clear of the letters A and B beside the split line.
        rect = rect.translate(vec2(0.0, 32.0));
    }
    if !view.contains_rect(rect) {
        return;
    }
    let painter = ui.painter();
    painter.rect_filled(rect, 6.0, SHADE);
    let mut at = rect.min + vec2(10.0, 8.0);
    for line in lines {
        let size = line.size();
        painter.galley(at, line, Color32::WHITE);
        at.y += size.y;
    }
    if spark > 0.0 {
        let area = Rect::from_min_size(at + vec2(0.0, 4.0), vec2(width, spark - 4.0));
        widgets::sparkline(painter, area, &recent, Stroke::new(1.5, theme::DARK.accent));
    }
    see(ui.ctx(), "hud", rect);
}

/// Formats the frame rate of an interval in milliseconds.
pub fn rate(interval_ms: f64) -> String {
    format!("{} fps", widgets::three_digits(1e3 / interval_ms))
}

/// Draws the progress of A's build in the middle of the view, until there is a picture or a failure.
pub fn progress(ui: &Ui, viewer: &Viewer, view: Rect) {
    let renderer = &viewer.a.renderer;
    if viewer.pictures()[0].is_some() || renderer.failure().is_some() {
        return;
    }
    let text = match renderer.progress() {
        progress if progress.is_empty() => "building the plan".to_owned(),
        progress => progress,
    };
    let galley = ui.painter().layout_no_wrap(text, FontId::proportional(theme::HEADING), Color32::WHITE);
    let rect = Rect::from_center_size(view.center(), galley.size() + vec2(24.0, 16.0));
    ui.painter().rect_filled(rect, 6.0, SHADE);
    ui.painter().galley(rect.min + vec2(12.0, 8.0), galley, Color32::WHITE);
}

/// Draws the name of a viewport beside the split line at x = `line`, in points. The name is left of the line if
/// `towards` is -1, and right of it if 1.
pub fn side(ui: &Ui, view: Rect, line: f32, text: &str, towards: f32) {
    let at = pos2(line + towards * 18.0, view.top() + 24.0);
    if view.contains(at) {
        ui.painter().circle_filled(at, 11.0, SHADE);
        let font = FontId::new(TEXT, theme::strong());
        ui.painter().text(at, Align2::CENTER_CENTER, text, font, Color32::WHITE);
    }
}

/// Draws the comparison card at the bottom of the split line, above the selection's card, and marks the worst pixel if
/// `marked`. The card has the median times of A and B, the progress or the result, and a button that toggles `marked`.
/// Draws nothing without a finished or running comparison.
pub fn comparison(ctx: &Context, viewer: &mut Viewer, view: Rect, marked: &mut bool) {
    if viewer.comparison().is_none() && !viewer.is_comparing() {
        return;
    }
    let palette = Palette::in_mode(ctx.theme() == egui::Theme::Dark);
    let line = view.left() + viewer.split * view.width();
    let total = |viewport: &Viewport| viewport.history.total().map(|total| widgets::time(total.median));
    let times: Vec<Option<String>> = viewer.viewports().map(total).collect();
    let mut close = false;
    let bottom = controls::find(ctx, "splats").map_or(view.bottom() - 4.0 * GRID, |card| card.top() - GRID);
    let at = pos2(line, bottom);
    let area = area(Id::unique("comparison"), at, Align2::CENTER_BOTTOM, view, Order::Middle);
    let shown = show_area(ctx, area, |ui| {
        card(ui, palette.line).show(ui, |ui| {
            ui.set_max_width((view.width() - 8.0 * GRID).clamp(40.0, 320.0));
            ui.horizontal(|ui| {
                for (name, ms) in ["A", "B"].into_iter().zip(&times) {
                    ui.label(RichText::new(name).family(theme::strong()));
                    ui.label(ms.clone().unwrap_or_else(|| "-".to_owned()));
                }
                if viewer.is_comparing() {
                    ui.spinner();
                }
            });
            let Some((Comparison { psnr_db, ssim, worst, .. }, _)) = viewer.comparison() else { return };
            let worst = worst.difference;
            let psnr = psnr_db.map_or("identical".to_owned(), |psnr| format!("{psnr:.2} dB"));
            ui.horizontal_wrapped(|ui| {
                ui.label(RichText::new(psnr).family(theme::strong()).size(theme::HEADING));
                if let Some(ssim) = ssim {
                    ui.label(format!("SSIM {ssim:.4}"));
                }
                ui.label(format!("worst {worst:.4}"));
            });
            ui.horizontal(|ui| {
                let find = ui.add_enabled(worst > 0.0, egui::Button::new("Worst pixel").selected(*marked));
                if find.named("worst").hint("Mark the pixel with the largest difference").clicked() {
                    *marked = !*marked;
                }
                close = ui.button("Close").clicked();
            });
            if !viewer.comparison_is_current() {
                ui.weak("of an earlier view or setting");
            }
        });
    });
    shown.response.named("comparison");
    if close {
        viewer.forget_comparison();
        *marked = false;
    }
    let Some((found, [width, height])) = viewer.comparison().filter(|_| *marked) else { return };
    let share = |place: usize, size: &usize| (place as f32 + 0.5) / (*size).max(1) as f32;
    let share = vec2(share(found.worst.x, width), share(found.worst.y, height));
    let at = view.min + share * view.size();
    let painter = ctx.layer_painter(egui::LayerId::new(Order::Middle, Id::unique("worst")));
    let painter = painter.with_clip_rect(view);
    painter.circle_stroke(at, 12.0, Stroke::new(4.0, Color32::BLACK));
    painter.circle_stroke(at, 12.0, Stroke::new(2.0, theme::DARK.caution));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::events::Swap;

    #[test]
    fn saves_and_loaded_scenes_have_one_toast_each() {
        let mut toasts = Toasts::default();
        toasts.add("", "grey is now 0.8".into(), false, STAY_LONG);
        for round in 1..=5 {
            let swap = Swap {
                graph: "mine.ron".into(),
                causes: Cause::File("mine.ron".into()).into(),
                passes: round,
                effect: None,
                same_plan: false,
                plan_ms: 1.0,
                prepare_ms: 1.0,
                latency_ms: 2.0,
            };
            toasts.tell(&Event::Swapped { renderer: RendererId::A, swap });
            toasts.tell(&Event::Scene { path: "a.ply".into(), splats: round as u32, load_ms: 1.0 });
        }
        assert_eq!(
            toasts.texts(),
            ["grey is now 0.8", "mine.ron: 2.00 ms, 5 passes", "a.ply: 5 splats in 1 ms"]
        );
        let failed = |stays| Event::SceneFailed { path: "a.ply".into(), error: "it is half".into(), stays };
        toasts.tell(&failed(false));
        assert_eq!(toasts.shown[3].text, "a.ply: it is half");
        toasts.tell(&failed(true));
        let expected = ["grey is now 0.8", "mine.ron: 2.00 ms, 5 passes", "a.ply: it is half"];
        assert_eq!(toasts.texts(), expected, "the card of errors shows the last one");
    }

    #[test]
    fn a_dropped_setting_is_no_longer_shown_once_it_is_restored_or_the_graph_is_another() {
        let mut toasts = Toasts::default();
        let dropped = |renderer, text: &str| {
            let (parameters, text) = (vec!["tint".to_owned()], text.to_owned());
            Event::Dropped { renderer, parameters, text }
        };
        let (a, b) = (RendererId::A, RendererId::B);
        for event in [dropped(b, "gone"), dropped(a, "gone"), dropped(a, "set by the preset")] {
            toasts.tell(&event);
        }
        assert_eq!(toasts.texts(), ["B: gone", "A: gone", "A: set by the preset"]);
        let (parameters, text) = (vec!["tint".to_owned()], "tint is 0.9 again".to_owned());
        toasts.tell(&Event::Restored { renderer: a, parameters, text });
        assert_eq!(toasts.texts(), ["B: gone", "A: tint is 0.9 again"]);
        toasts.forget_settings(b);
        assert_eq!(toasts.texts(), ["A: tint is 0.9 again"]);
    }

    #[test]
    fn a_toast_has_a_place_while_a_tool_hides_the_picture() {
        let ctx = Context::default();
        let mut toasts = Toasts::default();
        toasts.add("", "missing.ply: no such file".into(), true, STAY_LONG);
        // The first frame measures the toast, and the second one places it.
        for _ in 0..2 {
            let mut output = ctx.run_ui(Default::default(), |ui| {
                let view = space_for_cards(ui.ctx(), Rect::NOTHING);
                toasts.show(ui.ctx(), view, true);
            });
            assert!(!output.shapes.is_empty());
            // No texture is uploaded here.
            output.textures_delta.clear();
        }
        assert_eq!(toasts.shown.len(), 1);
    }

    #[test]
    fn toasts_that_would_cover_the_card_of_errors_wait_the_oldest_first() {
        let ctx = Context::default();
        let mut toasts = Toasts::default();
        for text in ["one", "two", "three"] {
            toasts.done(text.into());
        }
        let view = Rect::from_min_size(pos2(0.0, 0.0), vec2(640.0, 360.0));
        let mut drawn = |card: f32| {
            for _ in 0..3 {
                controls::take(&ctx);
                see(&ctx, "mistakes", Rect::from_min_max(pos2(0.0, card), view.max));
                let mut output = ctx.run_ui(Default::default(), |ui| toasts.show(ui.ctx(), view, true));
                output.textures_delta.clear();
            }
            controls::find(&ctx, "toast").map(|last| last.bottom())
        };
        let all = drawn(360.0).expect("all fit");
        let fewer = drawn(all - 1.0).expect("two fit");
        assert!(fewer < all - 1.0, "{fewer} of {all}");
        assert_eq!(drawn(20.0), None);
    }
}
