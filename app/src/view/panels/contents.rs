//! Shows the contents of a resource after a pass: numbers, a histogram, an image, and the order of sorted keys.

use super::number::{NumberField, Scale};
use super::selection::Selection;
use super::theme::Palette;
use super::widgets::{self, Control as _};
use crate::draw::inspect::{Finding, ReadAs, sorted_keys};
use crate::view::viewport::{Inspection, Viewport};
use egui::style::ScrollAnimation;
use egui::{
    Align, Button, Color32, ColorImage, Label, Rect, RichText, ScrollArea, Sense, TextureHandle,
    TextureOptions, Ui,
};
use egui_plot::{Bar, BarChart, Plot};
use splatgraph_framework::ir::PassId;
use splatgraph_framework::plan::Plan;

/// Shared state that the inspector reads and changes while it draws.
pub struct Target<'a> {
    pub selection: &'a mut Option<Selection>,
    /// The device's copy limit in 10^9 bytes per second, reads plus writes; `None` before it is measured.
    pub copy_limit: Option<f64>,
    /// True while the copy limit is being measured; set to true to start.
    pub measures_copy: &'a mut bool,
}

const LINES: usize = 16;

const BINS: usize = 64;

/// Maximum number of an element's words to show.
const WORDS: usize = 16;

/// Maximum width and height of a resource's image, in pixels. Larger images are scaled down, because they occupy the
/// user interface's texture memory.
const MAX_WIDTH: usize = 512;

#[derive(Default)]
pub struct State {
    first: usize,
    /// Resource for which the user chose a type, and the type. All other resources are read as declared.
    read: Option<(String, ReadAs)>,
    channel: usize,
    picture: Option<TextureHandle>,
    /// Reading whose image is shown; see [`Viewport::readings`].
    shown: Option<u64>,
    /// Resource and pass of the last result to which the view was scrolled.
    revealed: Option<(String, String)>,
}

impl State {
    /// Draws the selectors of resource and pass, and the contents that were read back.
    pub fn show(&mut self, ui: &mut Ui, viewport: &mut Viewport, plan: &Plan, target: &mut Target) {
        ui.horizontal_wrapped(|ui| {
            let sorted = sorted_keys(plan);
            let keys =
                ui.add_enabled(sorted.is_some(), Button::new("Are the keys sorted?")).named("keys_sorted");
            let text = match &sorted {
                Some((resource, pass)) => {
                    format!("Read {resource} back after {pass} and check that the keys ascend")
                }
                None => "No pass of this plan writes sort keys (`keys` or `*_keys`)".to_owned(),
            };
            if keys.hint(text).clicked()
                && let Some((resource, pass)) = sorted
            {
                viewport.look_at(&resource, &pass);
            }
            if let Some(Selection::Resource(name)) = target.selection.as_ref()
                && let Some(pass) = last_writer(plan, name)
            {
                let read = ui.button("Contents").named("contents");
                if read.hint(format!("Read {name} back after {pass}, which writes it last")).clicked() {
                    viewport.look_at(name, &pass);
                }
            }
            if viewport.inspection.is_some() && ui.button("Close").clicked() {
                viewport.inspection = None;
            }
        });
        let top = ui.cursor().top();
        ui.weak(
            "While contents are read back, resources do not share memory: a pass that reads stale contents may draw \
             another picture.",
        );
        let (number, submitted) = (viewport.readings(), viewport.renderer.submitted());
        let palette = Palette::of(ui);
        let Some(inspection) = &mut viewport.inspection else {
            self.revealed = None;
            return;
        };
        choose(ui, plan, inspection);
        match &inspection.found {
            None => {
                ui.spinner();
            }
            Some(Err(error)) => {
                ui.colored_label(palette.error, error);
            }
            Some(Ok(finding)) => {
                ui.weak(format!("read in frame {} of {submitted}", inspection.frame));
                self.finding(ui, finding, number);
            }
        }
        // A result below the visible part would look as if the button had no effect.
        let asked = Some((inspection.resource.clone(), inspection.pass.clone()));
        if inspection.found.is_some() && self.revealed != asked {
            self.revealed = asked;
            let rect = Rect::from_x_y_ranges(ui.min_rect().x_range(), top..=ui.min_rect().bottom());
            ui.scroll_to_rect_animation(rect, Some(Align::Min), ScrollAnimation::none());
        }
    }

    fn finding(&mut self, ui: &mut Ui, finding: &Finding, number: u64) {
        if let Some(order) = &finding.order {
            let palette = Palette::of(ui);
            let colour = if order.ascending { palette.good } else { palette.error };
            ui.label(RichText::new(order.to_string()).strong().color(colour));
            if let Some(at) = order.first_descent
                && ui.button("Show where").clicked()
            {
                self.first = (at as usize).saturating_sub(LINES / 2);
            }
        }
        if let Some(reason) = &finding.unknown_order {
            ui.label(reason);
        }
        // An image has two outer dimensions, a buffer one. The inner dimensions make up an element.
        let inner = if finding.is_image { 2 } else { 1 };
        let per_element = finding.shape.iter().skip(inner).product::<u64>().max(1) as usize;
        let elements = finding.words.len() / per_element;
        let shape: Vec<String> = finding.shape.iter().map(u64::to_string).collect();
        ui.horizontal(|ui| {
            ui.label(shape.join(" x "));
            // The format determines the type of an image.
            if !finding.is_image {
                let kinds = [
                    (None, "as declared"),
                    (Some(ReadAs::Uint), "integers"),
                    (Some(ReadAs::Float), "floats"),
                ];
                for (kind, text) in kinds {
                    if ui.selectable_label(self.chosen(finding) == kind, text).clicked() {
                        self.read = kind.map(|kind| (finding.resource.clone(), kind));
                    }
                }
            }
        });
        if finding.is_image {
            self.picture(ui, finding, number);
        }
        self.histogram(ui, finding, per_element);
        self.numbers(ui, finding, per_element, elements);
    }

    /// Returns the type that the user chose for the resource; `None` for the declared types.
    fn chosen(&self, finding: &Finding) -> Option<ReadAs> {
        let chosen = self.read.as_ref().filter(|(resource, _)| *resource == finding.resource);
        chosen.map(|(_, read)| *read)
    }

    fn read_as(&self, finding: &Finding, channel: usize) -> ReadAs {
        self.chosen(finding).unwrap_or(finding.channels[channel].read)
    }

    fn picture(&mut self, ui: &mut Ui, finding: &Finding, number: u64) {
        if self.shown != Some(number) {
            self.shown = Some(number);
            self.picture = finding.words.picture(&finding.shape).map(|image| {
                let step = image.width.max(image.height).div_ceil(MAX_WIDTH).max(1);
                let (width, height) = (image.width.div_ceil(step), image.height.div_ceil(step));
                let pixels = (0..width * height).map(|i| {
                    let [r, g, b] =
                        image.at(i % width * step, i / width * step).map(|v| (v * 255.0).round() as u8);
                    Color32::from_rgb(r, g, b)
                });
                let image = ColorImage::new([width, height], pixels.collect());
                ui.ctx().load_texture("inspected", image, TextureOptions::NEAREST)
            });
        }
        if let Some(picture) = &self.picture {
            let size = picture.size_vec2();
            let scale = (ui.available_width() / size.x).min(1.0);
            let image = egui::Image::new((picture.id(), size * scale)).sense(Sense::click());
            let shown = ui.add(image).named("inspected_picture");
            let Some(at) = shown.hover_pos().or_else(|| shown.interact_pointer_pos()) else { return };
            let [height, width] = [0, 1].map(|axis| finding.shape[axis] as usize);
            let share = (at - shown.rect.min) / shown.rect.size();
            let pixel = |share: f32, count: usize| ((share * count as f32) as usize).min(count - 1);
            let (x, y) = (pixel(share.x, width), pixel(share.y, height));
            let element = y * width + x;
            if shown.clicked() {
                self.first = element;
            }
            let values = self.row(finding, element).join("  ");
            shown.on_hover_text_at_pointer(format!("{x}, {y}: {values}\nClick to list the values from here"));
        }
    }

    fn histogram(&mut self, ui: &mut Ui, finding: &Finding, per_element: usize) {
        let channels = per_element;
        self.channel = self.channel.min(channels - 1);
        if channels > 1 {
            ui.horizontal(|ui| {
                ui.label("Histogram of");
                let shown = finding.name(self.channel);
                let all = (0..channels).map(|channel| (channel, finding.name(channel)));
                widgets::choice(ui, "word", &shown, &mut self.channel, all);
            });
        }
        let end = finding.counted.map_or(finding.words.len(), |n| n as usize * channels);
        let found =
            finding.words.histogram(self.channel..end, channels, self.read_as(finding, self.channel), BINS);
        let [least, greatest] = found.range;
        // If all values are equal, their single bar still needs a visible width.
        let range = if greatest > least { greatest - least } else { 1.0 };
        let width = range / BINS as f64;
        let bar = |(index, count): (usize, &u64)| {
            Bar::new(least + (index as f64 + 0.5) * width, *count as f64).width(width)
        };
        let bars: Vec<Bar> = found.counts.iter().enumerate().map(bar).collect();
        Plot::new("histogram").height(90.0).allow_scroll(false).allow_drag(false).allow_zoom(false).show(
            ui,
            |plot| {
                plot.bar_chart(BarChart::new("values", bars));
            },
        );
        let mut text = format!("from {least} to {greatest}");
        if found.not_finite > 0 {
            let colour = if finding.is_image { " (magenta in the picture)" } else { "" };
            text += &format!(", {} not finite{colour}", found.not_finite);
        }
        ui.weak(text);
    }

    fn numbers(&mut self, ui: &mut Ui, finding: &Finding, per_element: usize, elements: usize) {
        let last = elements.saturating_sub(LINES);
        ui.horizontal(|ui| {
            if ui.button("first").clicked() {
                self.first = 0;
            }
            let scale = Scale { min: 0.0, max: last as f64, step: 1.0 };
            let field = NumberField::new("inspect:first", "First element", scale);
            let field = NumberField { speed: 1.0, prefix: "from ", ..field };
            if let (_, Some(first)) = field.show(ui, self.first as f64) {
                self.first = first as usize;
            }
            if ui.button("last").clicked() {
                self.first = last;
            }
            if let Some(counted) = finding.counted
                && ui.button(format!("last of {counted}")).on_hover_text("Visible splats").clicked()
            {
                self.first = (counted as usize).saturating_sub(LINES).min(last);
            }
        });
        self.first = self.first.min(last);
        let mut lines: Vec<(String, Vec<String>)> = (self.first..(self.first + LINES).min(elements))
            .map(|element| (element.to_string(), self.row(finding, element)))
            .collect();
        if finding.channels.iter().any(|channel| !channel.name.is_empty()) {
            let names = (0..per_element.min(WORDS)).map(|channel| finding.name(channel));
            lines.insert(0, (String::new(), names.collect()));
        }
        let width =
            |column: usize| lines.iter().filter_map(|(_, words)| words.get(column)).map(String::len).max();
        let widths: Vec<usize> = (0..WORDS).map_while(width).collect();
        let digits = lines.iter().map(|(element, _)| element.len()).max().unwrap_or(0);
        let line = |(element, words): &(String, Vec<String>)| {
            let words = words.iter().zip(&widths).map(|(word, width)| format!("{word:>width$}"));
            format!("{element:>digits$}  {}", words.collect::<Vec<_>>().join("  "))
        };
        let text = lines.iter().map(line).collect::<Vec<_>>().join("\n");
        ScrollArea::horizontal().id_salt("words").show(ui, |ui| {
            ui.add(Label::new(RichText::new(text).monospace()).extend());
        });
    }

    /// Formats the first words of an element.
    fn row(&self, finding: &Finding, element: usize) -> Vec<String> {
        let all = finding.channels.len();
        let word = |channel| finding.words.text(element * all + channel, self.read_as(finding, channel));
        (0..all.min(WORDS)).map_while(word).collect()
    }
}

fn choose(ui: &mut Ui, plan: &Plan, inspection: &mut Inspection) {
    ui.horizontal_wrapped(|ui| {
        let former = (inspection.resource.clone(), inspection.pass.clone());
        let resources = plan.resources.iter().map(|resource| (resource.name.clone(), &resource.name));
        widgets::choice(ui, "resource", &former.0, &mut inspection.resource, resources);
        ui.label("after");
        let passes = plan.order().map(|pass| &plan.pass(pass).name).map(|name| (name.clone(), name));
        widgets::choice(ui, "pass", &former.1, &mut inspection.pass, passes);
        let changed = (&inspection.resource, &inspection.pass) != (&former.0, &former.1);
        let read = ui.button("Read").clicked();
        ui.checkbox(&mut inspection.follow, "every frame");
        if changed || read {
            inspection.ask();
        }
    });
}

/// Finds the pass that writes a resource last: in the frame or, failing that, in the prologue. `None` if no pass does.
fn last_writer(plan: &Plan, resource: &str) -> Option<String> {
    let writes = |pass: &PassId| {
        let uses = &plan.pass(*pass).uses;
        uses.iter().any(|touch| touch.accesses.writes() && plan.resource(touch.resource).name == resource)
    };
    let pass = plan.order().rfind(writes)?;
    Some(plan.pass(pass).name.clone())
}
