//! Draws a control for each parameter of the graph.
//!
//! No parameter is known by name: label, help, range, step and choices come from the graph's file.

use super::Controls;
use crate::view::renderer::Renderer;
use egui::{Color32, ComboBox, RichText, Slider, Ui};
use splatgraph_api::Device;
use splatgraph_framework::ir::{Domain, Param, ParamBinding, Value};
use splatgraph_framework::lower::Control;

/// Range in powers of ten above which sliders are logarithmic.
const DECADES: f64 = 2.0;

/// Draws the controls and applies changes.
pub fn show<D: Device>(ui: &mut Ui, renderer: &mut Renderer<D>, command: &str, controls: &mut Controls) {
    ui.horizontal_wrapped(|ui| {
        let modified = renderer.set().len();
        let text = match modified {
            0 => "unchanged".to_owned(),
            1 => "1 changed".to_owned(),
            n => format!("{n} changed"),
        };
        ui.label(text);
        let reset = ui.add_enabled(modified > 0, egui::Button::new("Reset all"));
        controls.see("reset_all", reset.rect);
        if reset.clicked() {
            renderer.reset_params();
        }
        let copy = ui.add_enabled(modified > 0, egui::Button::new("Copy as --set"));
        controls.see("copy_set", copy.rect);
        if copy.on_hover_text(format!("{command}{}", set_line(renderer))).clicked() {
            ui.ctx().copy_text(set_line(renderer).trim_start().to_owned());
        }
    });
    ui.separator();
    let mut changes: Vec<(String, Option<Value>)> = Vec::new();
    for described in renderer.controls() {
        let param = &described.param;
        let modified = renderer.set().contains_key(&param.name);
        ui.horizontal(|ui| {
            heading(ui, described, modified);
            if modified && ui.small_button("⟲").on_hover_text(format!("back to {}", param.default)).clicked()
            {
                changes.push((param.name.clone(), None));
            }
        });
        ui.horizontal(|ui| {
            if let Some(value) = control(ui, param, controls) {
                changes.push((param.name.clone(), Some(value)));
            }
            if let Some(exact) = param.exact.as_ref().filter(|exact| **exact != param.value) {
                let text =
                    RichText::new(format!("exact: {exact}")).small().color(Color32::from_rgb(214, 160, 60));
                ui.label(text).on_hover_text("This value has no error.");
            }
        });
        ui.add_space(4.0);
    }
    for (name, value) in changes {
        renderer.set_param(&name, value);
    }
}

/// Formats the changed parameters as options: ` --set a=1 --set b=2`.
pub fn set_line<D: Device>(renderer: &Renderer<D>) -> String {
    renderer.set().iter().map(|(name, value)| format!(" --set {name}={value}")).collect()
}

fn heading(ui: &mut Ui, described: &Control, modified: bool) {
    let Control { param, label: name, help: about } = described;
    let label = match modified {
        true => RichText::new(format!("● {name}")).strong(),
        false => RichText::new(name),
    };
    let mut help = format!("{} = {}", param.name, param.value);
    if !about.is_empty() {
        help = format!("{about}\n\n{help}");
    }
    help += match param.binding {
        ParamBinding::Const => "\nConstant: a change builds a new plan.",
        ParamBinding::Live { .. } => "\nLive: a change takes effect in the next frame.",
    };
    if let Some(stat) = &param.grows {
        help += &format!("\nGrows with what frames need: the statistic {stat}.");
    }
    help += &format!("\nDeclared at {}:{}", param.origin.file, param.origin.line);
    ui.label(label).on_hover_text(help);
}

/// Draws the control; returns the value if the user changed it.
fn control(ui: &mut Ui, param: &Param, controls: &mut Controls) -> Option<Value> {
    let name = format!("param:{}", param.name);
    match (&param.domain, &param.value) {
        (Domain::Bool, Value::Bool(value)) => {
            let mut value = *value;
            let text = if value { "on" } else { "off" };
            let response = ui.checkbox(&mut value, text);
            controls.see(&name, response.rect);
            response.changed().then_some(Value::Bool(value))
        }
        (Domain::Int { min, max }, Value::Int(value)) => {
            let mut value = *value;
            let slider = Slider::new(&mut value, *min..=*max).logarithmic(wide(*min as f64, *max as f64));
            // A number acts once it is written, not digit by digit.
            let response = ui.add(slider.update_while_editing(false));
            controls.see(&name, rail(ui, response.rect));
            response.changed().then_some(Value::Int(value))
        }
        (Domain::Float { min, max, step }, Value::Float(value)) => {
            let mut value = *value;
            let slider = Slider::new(&mut value, *min..=*max).logarithmic(wide(*min, *max));
            let slider = slider.update_while_editing(false);
            let response = ui.add(if *step > 0.0 { slider.step_by(*step) } else { slider });
            controls.see(&name, rail(ui, response.rect));
            response.changed().then_some(Value::Float(value))
        }
        (Domain::Choice(choices), Value::Text(value)) => {
            let mut chosen = value.clone();
            let response = ComboBox::from_id_salt(&name)
                .selected_text(chosen.as_str())
                .width(ui.spacing().slider_width + 60.0)
                .show_ui(ui, |ui| {
                    for choice in choices {
                        let item = ui.selectable_value(&mut chosen, choice.clone(), choice);
                        // A list that opens is laid out once unseen, somewhere else.
                        if ui.is_visible() {
                            controls.see(&format!("{name}={choice}"), item.rect);
                        }
                    }
                })
                .response;
            controls.see(&name, response.rect);
            (chosen != *value).then_some(Value::Text(chosen))
        }
        // A plan's values fit their domains.
        (_, value) => {
            ui.label(value.to_string());
            None
        }
    }
}

fn wide(min: f64, max: f64) -> bool {
    min > 0.0 && (max / min).log10() > DECADES
}

/// Computes the draggable part of a slider, without the number at its right.
fn rail(ui: &Ui, whole: egui::Rect) -> egui::Rect {
    egui::Rect::from_min_size(whole.min, egui::vec2(ui.spacing().slider_width, whole.height()))
}
