//! Shows the times of frames on GPU and host, per phase and per pass, and the memory.

use crate::stats::median;
use crate::view::history::{History, Quantiles, Row, Series};
use crate::view::viewport::Viewport;
use egui::{Align, Color32, ComboBox, Layout, Response, RichText, Ui};
use egui_plot::{Line, Plot, PlotPoints, VLine};
use splatgraph_api::Device;
use splatgraph_assets::grouped;
use splatgraph_framework::plan::Plan;

/// Colours of the phases, in order of execution; they repeat.
const COLOURS: [Color32; 8] = [
    Color32::from_rgb(86, 180, 233),
    Color32::from_rgb(230, 159, 0),
    Color32::from_rgb(0, 158, 115),
    Color32::from_rgb(240, 228, 66),
    Color32::from_rgb(213, 94, 0),
    Color32::from_rgb(204, 121, 167),
    Color32::from_rgb(150, 150, 255),
    Color32::from_rgb(180, 180, 180),
];

/// Draws the panel of one viewport. `window` is the history of the window's graph, `plotted` the phase with plotted passes.
pub fn show<D: Device>(
    ui: &mut Ui,
    viewport: &Viewport<D>,
    loaded: u32,
    frame_ms: &[f64],
    window: (&History, Option<&Plan>),
    plotted: &mut Option<String>,
) {
    let (window, window_plan) = window;
    let info = viewport.renderer.info();
    ui.label(RichText::new(&info.name).strong()).on_hover_text(&info.driver);
    let interval = median(frame_ms.to_vec()).filter(|ms| *ms > 0.0);
    let (total, record) = (viewport.history.total(), viewport.history.record());
    let mut row = |name: &str, hint: &str, ms: Option<Quantiles>| {
        line(ui, |ui| ui.label(name).on_hover_text(hint), |ui| numbers(ui, ms));
    };
    row(
        "GPU, frame",
        "From the first command of a frame to its last: median and 99th percentile, ms.",
        total,
    );
    row("CPU, recording", "Time of the host for recording and submitting a frame.", record);
    row("GPU, window", "Time for drawing this window: pictures, split line, user interface.", window.total());
    if let Some(ms) = interval {
        let hint = "Interval between frames, including waits for the display.";
        let right = |ui: &mut Ui| {
            ui.monospace(format!("{:6.1} /s", 1e3 / ms));
            ui.monospace(format!("{ms:8.3}"));
        };
        line(ui, |ui| ui.label("between frames").on_hover_text(hint), right);
    }
    let mut counts = vec![format!("{} splats", grouped(loaded.into()))];
    counts.extend(viewport.stats.iter().map(|(name, value)| format!("{} {name}", grouped((*value).into()))));
    ui.label(counts.join(" · "));
    ui.separator();
    let series = viewport.history.phase_series();
    let phases: Vec<String> = series.iter().map(|series| series.name.clone()).collect();
    choose(ui, &phases, plotted);
    let passes = plotted.as_ref().zip(viewport.renderer.plan());
    let series = passes.map_or(series, |(phase, plan)| viewport.history.pass_series(plan, phase));
    plot(ui, series, &viewport.history.changes());
    if let Some(plan) = viewport.renderer.plan() {
        table(ui, &viewport.history.table(plan), &phases, viewport.history.steady_frames());
    }
    if let Some(plan) = window_plan {
        egui::CollapsingHeader::new("Window").show(ui, |ui| {
            let phases: Vec<String> = window.phase_series().into_iter().map(|series| series.name).collect();
            table(ui, &window.table(plan), &phases, window.steady_frames());
        });
    }
    ui.separator();
    memory(ui, &viewport.renderer.device().map(Device::memory).unwrap_or_default());
}

fn colour(index: usize) -> Color32 {
    COLOURS[index % COLOURS.len()]
}

/// Draws a line with one part at its left and one at its right.
fn line(ui: &mut Ui, left: impl FnOnce(&mut Ui) -> Response, right: impl FnOnce(&mut Ui)) {
    ui.horizontal(|ui| {
        left(ui);
        ui.with_layout(Layout::right_to_left(Align::Center), right);
    });
}

/// Draws median and 99th percentile, aligned to the right.
fn numbers(ui: &mut Ui, ms: Option<Quantiles>) {
    match ms {
        Some(Quantiles { median, p99 }) => {
            ui.monospace(format!("{p99:8.3}"));
            ui.monospace(format!("{median:8.3}"));
        }
        None => {
            ui.weak("unknown");
        }
    }
}

/// Draws the choice of the plot: all phases, or the passes of one.
fn choose(ui: &mut Ui, phases: &[String], plotted: &mut Option<String>) {
    if plotted.as_ref().is_some_and(|phase| !phases.contains(phase)) {
        *plotted = None;
    }
    let chosen = plotted.as_ref().map_or("all phases".to_owned(), |phase| format!("passes of {phase}"));
    ComboBox::from_id_salt("plotted").selected_text(chosen).show_ui(ui, |ui| {
        ui.selectable_value(plotted, None, "all phases");
        for phase in phases {
            ui.selectable_value(plotted, Some(phase.clone()), format!("passes of {phase}"));
        }
    });
}

fn plot(ui: &mut Ui, series: Vec<Series>, changes: &[f64]) {
    Plot::new("phases")
        .height(140.0)
        .allow_scroll(false)
        .allow_zoom(false)
        .allow_drag(false)
        .include_y(0.0)
        .y_axis_label("ms")
        .x_axis_formatter(|_, _| String::new())
        .show(ui, |plot| {
            for change in changes {
                plot.vline(VLine::new("another plan", *change).color(Color32::from_gray(90)));
            }
            for (index, series) in series.into_iter().enumerate() {
                let line = Line::new(series.name, PlotPoints::from(series.points));
                plot.line(line.color(colour(index)));
            }
        });
}

/// Draws the table; `phases` are in the order of the plot's colours.
fn table(ui: &mut Ui, rows: &[Row], phases: &[String], frames: usize) {
    let heading = RichText::new(format!("GPU milliseconds, over {frames} frames")).small().weak();
    line(
        ui,
        |ui| ui.label(heading),
        |ui| {
            ui.label(RichText::new("99 %").small().weak());
            ui.add_space(28.0);
            ui.label(RichText::new("median").small().weak());
        },
    );
    for row in rows {
        let left = |ui: &mut Ui| match row.phase {
            None => {
                let index = phases.iter().position(|phase| *phase == row.name).unwrap_or(0);
                let (rect, _) = ui.allocate_exact_size(egui::vec2(9.0, 9.0), egui::Sense::hover());
                ui.painter().rect_filled(rect, 2.0, colour(index));
                ui.label(RichText::new(&row.name).strong())
            }
            Some(_) => {
                ui.add_space(16.0);
                ui.label(RichText::new(&row.name).weak())
            }
        };
        line(ui, left, |ui| numbers(ui, row.ms));
    }
}

fn memory(ui: &mut Ui, pieces: &[(String, u64)]) {
    let total: u64 = pieces.iter().map(|(_, bytes)| bytes).sum();
    egui::CollapsingHeader::new(format!("GPU memory: {}", mebibytes(total))).default_open(true).show(
        ui,
        |ui| {
            let mut pieces = pieces.to_vec();
            pieces.sort_by_key(|(_, bytes)| std::cmp::Reverse(*bytes));
            for (name, bytes) in &pieces {
                let short: String = name.chars().take(34).collect();
                let text = if short.len() < name.len() { format!("{short}...") } else { short };
                line(
                    ui,
                    |ui| ui.label(text).on_hover_text(name),
                    |ui| {
                        ui.monospace(mebibytes(*bytes));
                    },
                );
            }
        },
    );
}

fn mebibytes(bytes: u64) -> String {
    match bytes {
        0..1024 => format!("{bytes} B"),
        1024..1_048_576 => format!("{:.1} KiB", bytes as f64 / 1024.0),
        _ => format!("{:.1} MiB", bytes as f64 / 1_048_576.0),
    }
}
