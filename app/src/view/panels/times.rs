//! Shows the GPU and host times of frames, times per phase and per pass, and memory use.

use super::theme::{self, Palette};
use super::widgets::{self, Control as _, fact, heading, row};
use crate::view::history::{History, Quantiles, Row, Series};
use crate::view::viewport::Viewport;
use egui::{Align, Color32, Label, Layout, Response, RichText, Sense, TextStyle, Ui, vec2};
use egui_plot::{Line, PlotPoints, VLine};
use indexmap::IndexSet;
use splatgraph_api::Device;
use splatgraph_assets::grouped;
use splatgraph_framework::dump;
use splatgraph_framework::plan::Plan;
use std::iter;
use std::sync::Arc;

const COLUMN: f32 = 72.0;

/// Draws the times of one viewport. `loaded` is the scene's number of splats; `interval` is the time between frames, in
/// milliseconds. `window` is the history of the window's graph; `plotted` is the phase whose passes are plotted, `None`
/// to plot all phases.
pub fn show(
    ui: &mut Ui,
    viewport: &Viewport,
    loaded: u32,
    interval: Option<f64>,
    window: &History,
    plotted: &mut Option<String>,
) {
    let info = viewport.renderer.info();
    ui.label(RichText::new(&info.name).family(theme::strong())).hint(&info.driver);
    fact(ui, "Splats", grouped(loaded.into()));
    for (name, value) in &viewport.stats {
        fact(ui, &name.replace('_', " "), grouped((*value).into()));
    }
    if let Some(ms) = interval {
        let text = format!("{} ({} /s)", widgets::time(ms), widgets::three_digits(1e3 / ms));
        fact(ui, "Between frames", text);
    }
    let history = &viewport.history;
    ui.separator();
    columns_heading(ui, history.steady_frames());
    let mut line = |name: &str, about: &str, ms: Option<Quantiles>| {
        row(ui, |ui| ui.label(name).hint(about), |ui| numbers(ui, ms, false));
    };
    line("GPU, frame", "From the first command of a frame to its last.", history.total());
    line("CPU, recording", "Host time for recording and submitting a frame.", history.record());
    line(
        "GPU, window",
        "Time for drawing this window: pictures, split line, user interface.",
        window.total(),
    );
    let series = history.phase_series();
    let phases = phases(history);
    let unreliable = history.is_mostly_unattributed();
    ui.separator();
    if unreliable {
        let text = "More than half of a frame is outside its passes: their times below mean little.";
        let example = "For example, Mesa's driver for CPUs writes the timestamps of compute passes when the whole frame ends.";
        ui.colored_label(Palette::of(ui).caution, text).hint(example);
    } else {
        choose(ui, &series, plotted);
        let coloured: Vec<(usize, Series)> = match plotted {
            Some(phase) => history.pass_series(phase).into_iter().enumerate().collect(),
            None => {
                series.into_iter().map(|line| (phases.get_index_of(&line.name).unwrap_or(0), line)).collect()
            }
        };
        plot(ui, coloured, &history.changes());
    }
    table(ui, &history.table(), &phases, unreliable);
    if let Some(rest) = history.unattributed().filter(|ms| *ms > 0.0) {
        let about =
            "Time of a frame that no pass accounts for: between passes, or where timestamps are too coarse.";
        let ms = Quantiles { median: rest, p99: f64::NAN };
        row(ui, |ui| ui.label("unattributed").hint(about), |ui| numbers(ui, Some(ms), false));
    }
    if window.frames() > 0 {
        egui::CollapsingHeader::new("Window").show(ui, |ui| {
            table(ui, &window.table(), &self::phases(window), window.is_mostly_unattributed());
        });
    }
    ui.separator();
    memory(ui, &viewport.renderer.device().map(Device::memory).unwrap_or_default());
}

/// Lists phases in the order of their colours. The newest plan's come first, prologue included, as in the timeline;
/// then phases of earlier plans only.
fn phases(history: &History) -> IndexSet<String> {
    let of_plan = |plan: &Arc<Plan>| plan.order().map(|pass| plan.pass(pass).phase.clone()).collect();
    let mut phases: IndexSet<String> = history.plan().map(of_plan).unwrap_or_default();
    phases.extend(history.phase_series().into_iter().map(|series| series.name));
    phases
}

fn columns_heading(ui: &mut Ui, frames: usize) {
    let palette = Palette::of(ui);
    let text = if frames == 1 { "Over 1 frame".to_owned() } else { format!("Over {frames} frames") };
    let left = RichText::new(text).color(palette.soft);
    row(
        ui,
        |ui| ui.label(left),
        |ui| {
            cell(ui, "99 %".to_owned(), false);
            cell(ui, "median".to_owned(), false);
        },
    );
}

/// Draws 99th percentile and median, in grey if `grey`. `None` is drawn as unknown; a percentile of NaN is omitted.
fn numbers(ui: &mut Ui, ms: Option<Quantiles>, grey: bool) {
    match ms {
        Some(Quantiles { median, p99 }) => {
            cell(ui, if p99.is_nan() { String::new() } else { widgets::time(p99) }, grey);
            cell(ui, widgets::time(median), grey);
        }
        None => cell(ui, "unknown".to_owned(), true),
    }
}

fn cell(ui: &mut Ui, text: String, grey: bool) {
    let palette = Palette::of(ui);
    let text = if grey { RichText::new(text).color(palette.soft) } else { RichText::new(text) };
    let size = vec2(COLUMN, ui.available_height());
    ui.allocate_ui_with_layout(size, Layout::right_to_left(Align::Center), |ui| {
        ui.set_min_width(COLUMN);
        ui.add(Label::new(text).extend());
    });
}

/// Draws a name, cut at its start so that `reserved` points stay free to its right. It has at least 40 points.
fn label_beside(ui: &mut Ui, reserved: f32, name: &str, colour: Color32) -> Response {
    let size = vec2((ui.available_width() - reserved).max(40.0), ui.available_height());
    let shown = widgets::ending(ui, &TextStyle::Body.resolve(ui.style()), ["", name, ""], size.x);
    let label = Label::new(RichText::new(&shown).color(colour)).truncate();
    let layout = Layout::left_to_right(Align::Center);
    let response = ui.allocate_ui_with_layout(size, layout, |ui| ui.add(label)).inner;
    if shown == name { response } else { response.hint(name) }
}

fn choose(ui: &mut Ui, phases: &[Series], plotted: &mut Option<String>) {
    if plotted.as_ref().is_some_and(|phase| phases.iter().all(|series| series.name != *phase)) {
        *plotted = None;
    }
    let text =
        |phase: Option<&String>| phase.map_or("all phases".to_owned(), |phase| format!("passes of {phase}"));
    let shown = text(plotted.as_ref());
    let all = iter::once(None).chain(phases.iter().map(|series| Some(&series.name)));
    widgets::choice(ui, "plotted", &shown, plotted, all.map(|phase| (phase.cloned(), text(phase))));
}

/// Plots series, each with its colour index. `changes` are the frame numbers at which the plan changed.
fn plot(ui: &mut Ui, series: Vec<(usize, Series)>, changes: &[f64]) {
    let palette = Palette::of(ui);
    let plot = widgets::time_plot("phases", 140.0).grid_spacing(16.0..=120.0).y_axis_min_width(48.0);
    plot.show(ui, |plot| {
        for change in changes {
            plot.vline(VLine::new("another plan", *change).color(palette.line));
        }
        for (index, series) in series {
            let line = Line::new(series.name, PlotPoints::from(series.points));
            plot.line(line.color(theme::phase(index)));
        }
    });
}

fn table(ui: &mut Ui, rows: &[Row], phases: &IndexSet<String>, grey: bool) {
    let palette = Palette::of(ui);
    for line in rows {
        let left = |ui: &mut Ui| match line.phase {
            None => {
                let index = phases.get_index_of(&line.name).unwrap_or(0);
                let (rect, _) = ui.allocate_exact_size(vec2(10.0, 10.0), Sense::hover());
                let colour = if grey { palette.life } else { theme::phase(index) };
                ui.painter().rect_filled(rect, 2.0, colour);
                ui.add(Label::new(RichText::new(&line.name).family(theme::strong())).truncate())
            }
            Some(_) => {
                ui.add_space(18.0);
                label_beside(ui, 2.0 * COLUMN + 24.0, &line.name, palette.soft)
            }
        };
        row(ui, left, |ui| numbers(ui, line.ms, grey));
    }
}

fn memory(ui: &mut Ui, pieces: &[(String, u64)]) {
    let total: u64 = pieces.iter().map(|(_, bytes)| bytes).sum();
    heading(ui, format!("GPU memory: {}", dump::bytes(total)));
    let mut pieces = pieces.to_vec();
    pieces.sort_by_key(|(_, bytes)| std::cmp::Reverse(*bytes));
    for (name, bytes) in &pieces {
        let left = |ui: &mut Ui| label_beside(ui, COLUMN + 12.0, name, ui.visuals().text_color());
        row(ui, left, |ui| cell(ui, dump::bytes(*bytes), false));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::backend;
    use crate::view::panels::timeline::phase_colour;
    use crate::view::tests;
    use splatgraph_api::FrameResult;
    use splatgraph_framework::ir::{PassId, Run};

    #[test]
    fn a_phase_has_one_colour_in_the_times_and_in_the_timeline() {
        let (former, mut plan) =
            (tests::plan(&[("x", "old")]), tests::plan(&[("a", "load"), ("b", "sort"), ("c", "draw")]));
        let prologue = Arc::make_mut(&mut plan);
        prologue.passes[0].run = Run::Once;
        (prologue.prologue, prologue.frame) = (vec![PassId(0)], vec![PassId(1), PassId(2)]);
        let mut history = History::default();
        let result = |ids: &[u32]| FrameResult {
            pass_ms: ids.iter().map(|id| (PassId(*id), Some(1.0))).collect(),
            ..FrameResult::default()
        };
        history.push(&former, &result(&[0]));
        history.push(&plan, &result(&[1, 2]));
        let phases = phases(&history);
        assert_eq!(phases.len(), 4, "the former plan's phase has a colour of its own");
        let dump = backend::dump(&plan);
        for name in ["load", "sort", "draw"] {
            let index = phases.get_index_of(name).unwrap();
            assert_eq!(theme::phase(index), phase_colour(&dump, name), "{name}");
        }
    }
}
