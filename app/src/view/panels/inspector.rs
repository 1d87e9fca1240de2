//! Shows the selected pass, barrier or resource, and below it the contents of a resource.

use super::contents::{self, Target};
use super::controls::{Command, request};
use super::selection::{self, Dumped, Selection, bound_bytes};
use super::theme::{self, Palette};
use super::widgets::{self, Control as _, fact, heading, link};
use crate::view::viewport::Viewport;
use egui::{Response, RichText, Ui};
use egui_plot::{Line, PlotPoints};
use splatgraph_framework::dump::{self, Declared, Dump, DumpBarrier, DumpPass, DumpResource};
use splatgraph_framework::ir::{Masks, Origin, Run, Use};

pub fn show(
    ui: &mut Ui,
    viewport: &mut Viewport,
    dumped: &mut Dumped,
    contents: &mut contents::State,
    target: &mut Target,
) {
    let Some(plan) = viewport.renderer.plan().cloned() else { return };
    let dump = dumped.of(&plan);
    if target.selection.as_ref().is_some_and(|selection| !selection.is_in(dump)) {
        *target.selection = None;
    }
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        match target.selection.clone() {
            None if viewport.inspection.is_none() => {
                ui.weak(
                    "Click a pass, a barrier or a resource in the timeline, or a splat in the picture. \
                         Details appear here.",
                );
            }
            Some(Selection::Pass(name)) => {
                if let Some(pass) = dump.pass(&name) {
                    show_pass(ui, viewport, dump, pass, target);
                }
            }
            Some(Selection::Barrier(id)) => {
                if let Some(barrier) = selection::barrier(dump, id) {
                    show_barrier(ui, barrier, target);
                }
            }
            Some(Selection::Resource(name)) => {
                if let Some(resource) = selection::resource(dump, &name) {
                    show_resource(ui, dump, resource, target);
                }
            }
            None | Some(Selection::Splat) => {}
        }
        ui.separator();
        contents.show(ui, viewport, &plan, target);
        widgets::follow_focus(ui);
    });
}

fn place(ui: &mut Ui, origin: &Origin) {
    let response = link(ui, format!("{}:{}", origin.file, origin.line));
    if response.hint("Open this line in an editor").clicked() {
        request(ui.ctx(), Command::Edit(origin.clone()));
    }
}

/// Draws a link that selects an item.
fn item_link(ui: &mut Ui, text: impl Into<String>, item: Selection, target: &mut Target) -> Response {
    let response = link(ui, text);
    if response.clicked() {
        *target.selection = Some(item);
    }
    response
}

fn pass_link(ui: &mut Ui, name: &str, target: &mut Target) {
    item_link(ui, name, Selection::Pass(name.to_owned()), target);
}

fn show_pass(ui: &mut Ui, viewport: &mut Viewport, dump: &Dump, pass: &DumpPass, target: &mut Target) {
    let once = if pass.run == Run::Once { ", runs once" } else { "" };
    ui.label(RichText::new(&pass.name).family(theme::strong()).size(theme::HEADING));
    ui.weak(format!("{} in phase {}{once}", pass.kind, pass.phase));
    place(ui, &pass.declared);
    fact(ui, "Size", &pass.size);
    let row = viewport.history.table().into_iter().find(|row| row.phase.is_some() && row.name == pass.name);
    let ms = row
        .and_then(|row| row.ms)
        .filter(|_| viewport.renderer.plan().is_some_and(|plan| viewport.history.is_of(plan)));
    let (read, written) = bound_bytes(dump, pass);
    fact(ui, "Bound, read", dump::bytes(read));
    fact(ui, "Bound, written", dump::bytes(written));
    if let Some(ms) = ms {
        fact(ui, "Time, median", widgets::time(ms.median));
        fact(ui, "Time, 99th percentile", widgets::time(ms.p99));
        if ms.median > 0.0 {
            let rate = (read + written) as f64 / ms.median / 1e6;
            let text = format!("{} GB/s", widgets::three_digits(rate));
            fact(ui, "If each byte moves once", text);
        }
        against_copy(ui, (read + written) as f64, ms.median, target);
        if viewport.history.is_mostly_unattributed() {
            ui.weak("More than half of a frame is outside its passes, so this time means little.");
        }
        let series = viewport.history.pass_series(&pass.phase);
        if let Some(series) = series.into_iter().find(|series| series.name == pass.name) {
            let colour = super::timeline::phase_colour(dump, &pass.phase);
            widgets::time_plot("pass", 72.0).show(ui, |plot| {
                plot.line(Line::new(series.name, PlotPoints::from(series.points)).color(colour));
            });
        }
    }
    for shader in &pass.shaders {
        heading(ui, &shader.file);
        if !pass.kind.starts_with("draw") {
            let [x, y, z] = shader.local_size;
            let shared = dump::bytes(shader.shared_bytes.into());
            fact(ui, "Workgroup", format!("{x} x {y} x {z}, {shared} shared"));
        }
        let defines: Vec<String> = shader.defines.iter().map(|d| format!("{}={}", d.name, d.value)).collect();
        if !defines.is_empty() {
            ui.add(
                egui::Label::new(RichText::new(defines.join("  ")).monospace().color(Palette::of(ui).soft))
                    .wrap(),
            );
        }
    }
    for (title, uses) in [("Reads", &pass.reads), ("Writes", &pass.writes)] {
        if !uses.is_empty() {
            heading(ui, title);
        }
        for touch in uses {
            show_touch(ui, viewport, pass, touch, target);
        }
    }
    if !pass.dependencies.is_empty() {
        heading(ui, "Comes after");
        for dependency in &pass.dependencies {
            let item = Selection::Pass(dependency.first.name.clone());
            item_link(ui, dump::dependency_line(dependency), item, target);
        }
    }
    if !pass.barriers.is_empty() {
        heading(ui, "Waits at");
        for barrier in &pass.barriers {
            item_link(ui, dump::barrier_line(barrier), Selection::Barrier(barrier.id), target);
        }
    }
    if !pass.push.is_empty() {
        heading(ui, "Push constants");
        for push in &pass.push {
            let name = push.name.clone().unwrap_or_else(|| format!("byte {}", push.offset));
            fact(ui, &name, push.value.to_string());
        }
    }
}

/// Compares a pass's time with a copy of as many bytes as it binds. If the device's copy limit is unknown, draws a
/// button that measures it, or a spinner during the measurement.
fn against_copy(ui: &mut Ui, bytes: f64, ms: f64, target: &mut Target) {
    match target.copy_limit {
        Some(rate) => {
            let limit = bytes / rate * 1e-6;
            let share = widgets::three_digits(100.0 * limit / ms.max(f64::MIN_POSITIVE));
            fact(ui, "A copy of its bytes", format!("{}, {share} % of it", widgets::time(limit)));
        }
        None if *target.measures_copy => {
            ui.horizontal(|ui| {
                ui.spinner();
                ui.weak("measuring how fast the device copies");
            });
        }
        None => {
            let button = ui.button("Compare with a copy").named("measure_copy");
            let about = "Measures how fast the device copies, and shows how long a copy of the bound bytes would take";
            *target.measures_copy = button.hint(about).clicked();
        }
    }
}

fn show_touch(
    ui: &mut Ui,
    viewport: &mut Viewport,
    pass: &DumpPass,
    touch: &Use<String>,
    target: &mut Target,
) {
    ui.horizontal(|ui| {
        let look = ui.small_button("contents").named(&format!("look:{}@{}", touch.resource, pass.name));
        if look.hint("Read its contents after this pass").clicked() {
            viewport.look_at(&touch.resource, &pass.name);
        }
        let masks = format!("{} {}", touch.stages, touch.accesses);
        item_link(ui, &touch.resource, Selection::Resource(touch.resource.clone()), target).hint(masks);
    });
}

fn show_barrier(ui: &mut Ui, barrier: &DumpBarrier, target: &mut Target) {
    ui.label(RichText::new(format!("Barrier {}", barrier.id)).family(theme::strong()).size(theme::HEADING));
    match &barrier.before {
        Some(before) => {
            ui.horizontal_wrapped(|ui| {
                ui.weak("before");
                pass_link(ui, &before.name, target);
            });
        }
        None => _ = ui.weak("between the prologue and the first frame"),
    }
    match &barrier.image {
        Some(image) => fact(ui, "Layout", format!("{}: {:?} to {:?}", image.image, image.old, image.new)),
        None => fact(ui, "On", "all memory"),
    }
    let Masks { source_stages, source_accesses, target_stages, target_accesses } = barrier.masks;
    fact(ui, "Waits for", format!("{source_stages} {source_accesses}").trim_end());
    fact(ui, "Blocks", format!("{target_stages} {target_accesses}").trim_end());
    heading(ui, format!("Hazards resolved: {}", barrier.dependencies.len()));
    for cause in &barrier.dependencies {
        let (kind, dependency) = (dump::cause_line(barrier, cause), &cause.conflict);
        ui.add(egui::Label::new(kind).wrap());
        ui.horizontal_wrapped(|ui| {
            let Declared { name, declared } = &dependency.resource;
            item_link(ui, name, Selection::Resource(name.clone()), target);
            place(ui, declared);
        });
        ui.horizontal_wrapped(|ui| {
            for after in &dependency.after {
                pass_link(ui, &after.name, target);
            }
            ui.weak(if dependency.previous_frame { "(last frame) before" } else { "before" });
            pass_link(ui, &dependency.before.name, target);
        });
        ui.add_space(theme::GRID);
    }
}

fn show_resource(ui: &mut Ui, dump: &Dump, resource: &DumpResource, target: &mut Target) {
    ui.label(RichText::new(&resource.name).family(theme::strong()).size(theme::HEADING));
    place(ui, &resource.declared);
    fact(ui, "Shape", &resource.shape);
    fact(ui, "Size", dump::bytes(resource.bytes));
    let source = match &resource.from {
        Some(from) => format!("{}, {from}", resource.source),
        None => resource.source.clone(),
    };
    fact(ui, "Source", source);
    fact(ui, "Usage", resource.usage.to_string());
    if let Some(block) = resource.block.and_then(|id| dump.blocks.iter().find(|block| block.id == id)) {
        let others: Vec<&str> =
            block.aliases.iter().map(String::as_str).filter(|name| *name != resource.name).collect();
        let text = match others.as_slice() {
            [] => format!("block {}, alone", block.id),
            others => format!("block {}, with {}", block.id, others.join(", ")),
        };
        fact(ui, "Memory", text);
    }
    if let Some(history) = &resource.history {
        fact(ui, "Kept from frame to frame as", history);
    }
    heading(ui, "Used by");
    for pass in &dump.passes {
        let (reads, writes) = selection::touches(pass, &resource.name);
        let how = match (reads, writes) {
            (true, true) => "reads and writes",
            (true, false) => "reads",
            (false, true) => "writes",
            (false, false) => continue,
        };
        ui.horizontal(|ui| {
            pass_link(ui, &pass.name, target);
            ui.weak(how);
        });
    }
}
