//! Shows the plan as in `splatgraph dump`: passes in order, the barriers between them, and the accesses of each.

use super::Controls;
use crate::view::viewport::Viewport;
use egui::{Color32, RichText, ScrollArea, Ui};
use splatgraph_api::Device;
use splatgraph_framework::dump::{self, Dump, DumpBarrier, DumpPass, DumpTouch};
use splatgraph_framework::plan::Plan;
use std::sync::Arc;

/// Font size of the details, in points.
const SMALL: f32 = 11.0;

const BARRIER: Color32 = Color32::from_rgb(230, 159, 0);
const READ: Color32 = Color32::from_rgb(120, 190, 255);
const WRITE: Color32 = Color32::from_rgb(255, 150, 120);

/// The open item, and the dump of the shown plan.
#[derive(Default)]
pub struct State {
    dumped: Option<(Arc<Plan>, Dump)>,
    open: Option<Open>,
}

/// The pass or barrier with open details.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Open {
    Pass(String),
    Barrier(u32),
}

/// The clicked items.
#[derive(Default)]
struct Clicked {
    open: Option<Open>,
    look: Option<(String, String)>,
}

impl State {
    /// Draws the panel.
    pub fn show<D: Device>(&mut self, ui: &mut Ui, viewport: &mut Viewport<D>, controls: &mut Controls) {
        let Some(plan) = viewport.renderer.plan().cloned() else { return };
        if !self.dumped.as_ref().is_some_and(|(of, _)| Arc::ptr_eq(of, &plan)) {
            self.dumped = Some((plan.clone(), dump::dump(&plan)));
        }
        let Some((_, dump)) = &self.dumped else { return };
        let times = viewport.history.medians(&plan);
        let ms = |pass: &str| times.iter().find(|(name, _)| name == pass).map(|(_, ms)| *ms);
        let frame = dump.totals.frame;
        ui.label(format!(
            "{}: {} passes, {} barrier calls with {} barriers against {} hazards; {} KiB of memory, {} KiB saved by sharing",
            dump.graph,
            dump.totals.frame_passes,
            frame.calls,
            frame.barriers,
            frame.dependencies,
            dump.totals.transient_bytes >> 10,
            dump.totals.saved_bytes >> 10,
        ));
        for warning in &dump.warnings {
            let place = format!("{}:{}", warning.declared.file, warning.declared.line);
            ui.colored_label(ui.visuals().warn_fg_color, format!("warning: {} ({place})", warning.message))
                .on_hover_text(warning.help.join("\n"));
        }
        let mut clicked = Clicked::default();
        let open = self.open.clone();
        ScrollArea::both().auto_shrink(false).show(ui, |ui| {
            for pass in &dump.passes {
                for barrier in &pass.barriers {
                    barrier_row(ui, barrier, &open, &mut clicked, controls);
                }
                pass_row(ui, pass, ms(&pass.name), &open, &mut clicked, controls);
            }
            if !dump.handover.is_empty() {
                ui.weak("handover, between the prologue and the first frame");
                for barrier in &dump.handover {
                    barrier_row(ui, barrier, &open, &mut clicked, controls);
                }
            }
            for left_out in &dump.left_out {
                ui.weak(format!("culled: {} ({})", left_out.pass, left_out.why));
            }
        });
        if let Some(open) = clicked.open {
            // A second click closes it.
            self.open = if self.open.as_ref() == Some(&open) { None } else { Some(open) };
        }
        if let Some((resource, pass)) = clicked.look {
            viewport.look_at(&resource, &pass);
        }
    }
}

fn barrier_row(
    ui: &mut Ui,
    barrier: &DumpBarrier,
    open: &Option<Open>,
    clicked: &mut Clicked,
    controls: &mut Controls,
) {
    let this = Open::Barrier(barrier.id);
    let selected = *open == Some(this.clone());
    let text = RichText::new(format!("    | {}", dump::barrier_line(barrier)))
        .monospace()
        .size(SMALL)
        .color(BARRIER);
    let row = ui.selectable_label(selected, text);
    controls.see(&format!("barrier:{}", barrier.id), row.rect);
    if row.clicked() {
        clicked.open = Some(this);
    }
    if selected {
        for dependency in &barrier.dependencies {
            ui.monospace(
                RichText::new(format!("        {}", dump::dependency_line(barrier, dependency))).small(),
            );
        }
    }
}

fn pass_row(
    ui: &mut Ui,
    pass: &DumpPass,
    ms: Option<f64>,
    open: &Option<Open>,
    clicked: &mut Clicked,
    controls: &mut Controls,
) {
    let this = Open::Pass(pass.name.clone());
    let selected = *open == Some(this.clone());
    let time = ms.map_or(String::new(), |ms| format!("  {ms:.3} ms"));
    let once = if pass.run == splatgraph_framework::ir::Run::Once { "once, " } else { "" };
    let text = format!("{}  [{once}{}] {} {}{time}", pass.name, pass.phase, pass.kind, pass.size);
    let row = ui.selectable_label(selected, RichText::new(text).monospace());
    controls.see(&format!("pass:{}", pass.name), row.rect);
    if row.clicked() {
        clicked.open = Some(this);
    }
    if !selected {
        return;
    }
    ui.indent(&pass.name, |ui| {
        for shader in &pass.shaders {
            let defines: Vec<String> =
                shader.defines.iter().map(|d| format!("{}={}", d.name, d.value)).collect();
            ui.monospace(
                RichText::new(format!("{}  {}", shader.file, defines.join(" "))).monospace().size(SMALL),
            );
        }
        for (what, uses, colour) in [("reads", &pass.reads, READ), ("writes", &pass.writes, WRITE)] {
            for touch in uses {
                touch_row(ui, pass, what, touch, colour, clicked, controls);
            }
        }
        for push in &pass.push {
            let name = push.name.clone().unwrap_or_else(|| format!("byte {}", push.offset));
            ui.monospace(RichText::new(format!("push {name} = {}", push.value)).monospace().size(SMALL));
        }
        ui.monospace(
            RichText::new(format!("{}:{}", pass.declared.file, pass.declared.line))
                .monospace()
                .size(SMALL)
                .weak(),
        );
    });
}

fn touch_row(
    ui: &mut Ui,
    pass: &DumpPass,
    what: &str,
    touch: &DumpTouch,
    colour: Color32,
    clicked: &mut Clicked,
    controls: &mut Controls,
) {
    ui.horizontal(|ui| {
        ui.monospace(RichText::new(format!("{what:6}")).small().color(colour));
        let link = ui.link(RichText::new(&touch.resource).monospace().size(SMALL));
        controls.see(&format!("look:{}@{}", touch.resource, pass.name), link.rect);
        if link.on_hover_text("Inspect its contents after this pass").clicked() {
            clicked.look = Some((touch.resource.clone(), pass.name.clone()));
        }
        ui.monospace(
            RichText::new(format!("{} {}", touch.stages.join("|"), touch.accesses.join("|"))).small().weak(),
        );
    });
}
