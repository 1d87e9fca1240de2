//! Draws a row for each parameter of the graph.
//!
//! No parameter is hard-coded: label, help, range, step and choices come from the graph's file. Drawing a row never
//! rounds or clamps the value.

use super::number::{NumberField, Scale};
use super::theme::{self, Palette, ROW};
use super::widgets::{self, Control as _};
use crate::view::events::{RendererId, Swap};
use crate::view::renderer::Renderer;
use egui::{Align, Id, Layout, RichText, Ui, UiBuilder};
use indexmap::IndexMap;
use splatgraph_framework::ir::{Domain, Param, ParamBinding, Value};
use splatgraph_framework::lower::Control;
use splatgraph_framework::plan::Plan;
use std::collections::HashMap;

const RESET: f32 = 24.0;

#[derive(Default)]
pub struct State {
    filter: String,
    groups: Groups,
    /// Renderer and name of the last changed constant, and a sentence about its effect.
    effect: Option<(RendererId, String, String)>,
}

/// Name and new value of a parameter; `None` restores the default.
type Change = (String, Option<Value>);

impl State {
    /// Shows the effect of a change of one constant on the plan, in a line above the list. A change of several
    /// constants and any other change of the passes remove the line.
    pub fn tell(&mut self, renderer: RendererId, swap: &Swap) {
        match (swap.parameters().as_slice(), &swap.effect) {
            ([parameter], effect) => {
                let as_before = || format!("{} passes, as before", swap.passes);
                let effect = effect.clone().unwrap_or_else(as_before);
                self.effect = Some((renderer, parameter.clone(), effect));
            }
            ([], None) => {}
            _ => self.forget_effect(),
        }
    }

    /// Removes the line above the list.
    pub fn forget_effect(&mut self) {
        self.effect = None;
    }

    /// Groups the parameters anew: a file of the graph has changed.
    pub fn regroup(&mut self) {
        self.groups = Groups::default();
    }

    /// Draws the list and applies changes. `command` is the command line that draws the same scene and graph, without
    /// `--set`.
    pub fn show(&mut self, ui: &mut Ui, renderer: &mut Renderer, command: &str) {
        self.head(ui, renderer, command);
        let mut changes: Vec<Change> = Vec::new();
        let wanted = self.filter.trim().to_lowercase();
        let fits = |control: &&Control| {
            [&control.label, &control.param.name].iter().any(|text| text.to_lowercase().contains(&wanted))
        };
        let mut shown = 0;
        egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            let plan = renderer.plan().map(|plan| plan.as_ref());
            self.groups.update(plan, renderer.controls());
            for (title, mut members) in self.groups.list(renderer.controls()) {
                members.retain(fits);
                if members.is_empty() {
                    continue;
                }
                shown += members.len();
                widgets::heading(ui, title).named(&format!("group:{title}"));
                for control in members {
                    let modified = renderer.set().contains_key(&control.param.name);
                    changes.extend(row(ui, plan, control, modified));
                }
            }
            widgets::follow_focus(ui);
            if shown == 0 {
                ui.weak(match plan {
                    None => "The parameters appear once the graph is built.",
                    Some(_) if wanted.is_empty() => "This graph has no parameters.",
                    Some(_) => "No parameter matches.",
                });
            }
        });
        for (name, value) in changes {
            if self.effect.as_ref().is_some_and(|(_, parameter, _)| *parameter == name) {
                self.effect = None;
            }
            renderer.set_param(&name, value);
        }
    }

    fn head(&mut self, ui: &mut Ui, renderer: &mut Renderer, command: &str) {
        let modified = renderer.set().len();
        ui.horizontal_wrapped(|ui| {
            let filter = egui::TextEdit::singleline(&mut self.filter).hint_text("Filter");
            ui.add_sized([104.0, ROW - 2.0], filter).named("filter");
            let text = if modified > 0 { format!("Reset {modified}") } else { "Reset all".to_owned() };
            let reset = ui.add_enabled(modified > 0, egui::Button::new(text)).named("reset_all");
            let text = match modified {
                1 => "1 parameter differs from its default".to_owned(),
                n => format!("{n} parameters differ from their defaults"),
            };
            let reset = reset.hint(text).clicked();
            let copy = ui.add_enabled(modified > 0, egui::Button::new("Copy --set")).named("copy_set");
            if copy.hint(format!("{command}{}", set_line(renderer))).clicked() {
                ui.copy_text(set_line(renderer).trim_start().to_owned());
            }
            if reset {
                renderer.reset_params();
            }
        });
        let label = |name: &str| {
            let named = renderer.controls().iter().find(|control| control.param.name == name);
            named.map(|control| control.label.clone())
        };
        let effect = self.effect.as_ref().filter(|(id, ..)| *id == renderer.id);
        let effect = effect.and_then(|(_, name, effect)| Some((name, label(name)?, effect)));
        let text = match &effect {
            Some((_, label, effect)) => format!("{label}: {effect}"),
            None if renderer.plan().is_none() && modified == 0 => String::new(),
            None if modified == 0 => "All parameters have their defaults.".to_owned(),
            None => set_line(renderer).trim_start().to_owned(),
        };
        let line = ui.add(egui::Label::new(RichText::new(&text).color(Palette::of(ui).soft)).truncate());
        let line = line.hint(text);
        if let Some((name, _, _)) = &effect {
            line.named(&format!("effect:{name}"));
        }
    }
}

/// Returns the title of a parameter's group. In a graph with parts, this is the part that declares it, or `this graph`.
/// In a graph without parts, it is the phase of the passes that depend on it, `Several phases`, or `Other` if none do.
fn group(plan: &Plan, control: &Control, has_parts: bool) -> String {
    if let Some(part) = &control.part {
        return part.clone();
    }
    if has_parts {
        return "this graph".to_owned();
    }
    match plan.affected_phases(&control.param.name).as_slice() {
        [phase] => (*phase).to_owned(),
        [] => "Other".to_owned(),
        _ => "Several phases".to_owned(),
    }
}

/// Groups of parameters. A parameter keeps the group of its first plan until a file changes, so that rows do not move
/// when its effects change.
#[derive(Default)]
struct Groups {
    graph: String,
    /// Title of each parameter's group, by the parameter's name.
    titles: HashMap<String, String>,
}

impl Groups {
    fn update(&mut self, plan: Option<&Plan>, all: &[Control]) {
        let Some(plan) = plan else { return };
        if self.graph != plan.name {
            *self = Groups { graph: plan.name.clone(), titles: HashMap::new() };
        }
        let has_parts = all.iter().any(|control| control.part.is_some());
        for control in all {
            let name = &control.param.name;
            if !self.titles.contains_key(name) {
                self.titles.insert(name.clone(), group(plan, control, has_parts));
            }
        }
    }

    /// Lists the groups in the order of their first parameters, with "Other" last.
    fn list<'a>(&self, all: &'a [Control]) -> Vec<(&str, Vec<&'a Control>)> {
        let mut groups: IndexMap<&str, Vec<&Control>> = IndexMap::new();
        for control in all {
            if let Some(title) = self.titles.get(&control.param.name) {
                groups.entry(title).or_default().push(control);
            }
        }
        let mut groups = Vec::from_iter(groups);
        groups.sort_by_key(|(title, _)| *title == "Other");
        groups
    }
}

/// Formats the changed parameters as options, such as ` --set a=1 --set b=2`.
pub fn set_line(renderer: &Renderer) -> String {
    renderer.set().iter().map(|(name, value)| format!(" --set {name}={value}")).collect()
}

fn row(ui: &mut Ui, plan: Option<&Plan>, control: &Control, modified: bool) -> Option<Change> {
    // By default, egui counts widgets to identify them: if a reload inserted a row above, the keyboard and the mouse
    // would go on with another parameter.
    let builder = UiBuilder::new().scope_id(Id::unique(("parameter", &control.param.name)));
    ui.scope_builder(builder, |ui| cells(ui, plan, control, modified)).inner
}

fn cells(ui: &mut Ui, plan: Option<&Plan>, control: &Control, modified: bool) -> Option<Change> {
    let Control { param, label, .. } = control;
    let palette = Palette::of(ui);
    let idle = plan.and_then(|plan| plan.no_effect(&param.name)).is_some();
    // A default can be exact for this scene although another value is exact for all scenes.
    let inexact = modified && param.exact.as_ref().is_some_and(|exact| *exact != param.value);
    let mut change = None;
    ui.horizontal(|ui| {
        ui.set_min_height(ROW);
        ui.spacing_mut().item_spacing.x = theme::GRID;
        let whole = ui.available_width();
        let name_width = (0.42 * whole).max(60.0);
        // Not only a colour, which not everybody can tell apart.
        let mut text = RichText::new(if inexact { format!("≈ {label}") } else { label.clone() });
        if modified {
            text = text.family(theme::strong());
        }
        if idle {
            text = text.color(palette.soft);
        } else if inexact {
            text = text.color(palette.caution);
        }
        let size = egui::vec2(name_width, ROW);
        let name = ui
            .allocate_ui_with_layout(size, Layout::left_to_right(Align::Center), |ui| {
                ui.set_min_width(name_width);
                ui.add(egui::Label::new(text).truncate().sense(egui::Sense::hover()))
            })
            .inner;
        name.hint(help(plan, control));
        let width = (ui.available_width() - RESET).max(60.0);
        // The parameter may take effect if another value changes, so it stays editable.
        let edited = ui.scope(|ui| {
            if idle {
                ui.set_opacity(0.6);
            }
            editor(ui, param, width)
        });
        if let Some(value) = edited.inner {
            change = Some((param.name.clone(), Some(value)));
        }
        // Drawn invisibly without a change: a button that disappears would lose the keyboard focus. Drawn in a child,
        // so that its symbol, which is higher than a row, does not move the rows below.
        let (_, rect) = ui.allocate_space(egui::vec2(RESET - theme::GRID, ROW - 4.0));
        let layout = Layout::centered_and_justified(egui::Direction::LeftToRight);
        let mut child = ui.new_child(UiBuilder::new().max_rect(rect).layout(layout));
        let reset = child.add_visible(modified, egui::Button::new("↺").frame(false));
        if modified {
            let reset =
                reset.named(&format!("reset:{}", param.name)).hint(format!("Back to {}", control.unset));
            if reset.clicked() {
                change = Some((param.name.clone(), None));
            }
        }
    });
    change
}

fn help(plan: Option<&Plan>, control: &Control) -> String {
    let Control { param, help: about, .. } = control;
    let mut text = format!("{} = {}", param.name, param.value);
    if let Some(effect) = plan.and_then(|plan| plan.effect_text(&param.name)) {
        text += &format!("\n{effect}");
    }
    if !about.is_empty() {
        text = format!("{about}\n\n{text}");
    }
    match &param.exact {
        Some(exact) if *exact == param.value => text += "\nExact: this value costs no accuracy.",
        // The help text tells whether the default is exact for this scene.
        Some(exact) if param.value == param.default => {
            text += &format!("\nThe default. {exact} never costs accuracy.");
        }
        Some(exact) => text += &format!("\nMay cost accuracy: {exact} never does."),
        None => {}
    }
    text += match param.binding {
        ParamBinding::Const => "\nConstant: a change builds a new plan.",
        ParamBinding::Live { .. } => "\nLive: a change takes effect in the next frame.",
    };
    if let Some(stat) = &param.grows {
        text += &format!("\nGrows with what frames need: the statistic {stat}.");
    }
    text + &format!("\nDeclared at {}:{}", param.origin.file, param.origin.line)
}

/// Draws a parameter's control; returns the value if the user changed it.
fn editor(ui: &mut Ui, param: &Param, width: f32) -> Option<Value> {
    let name = format!("param:{}", param.name);
    match (&param.domain, &param.value) {
        (Domain::Bool, Value::Bool(value)) => {
            let mut value = *value;
            let text = widgets::on_off(value);
            let response = ui
                .add_sized([width, ROW], |ui: &mut Ui| {
                    ui.with_layout(Layout::left_to_right(Align::Center), |ui| ui.checkbox(&mut value, text))
                        .inner
                })
                .named(&name);
            response.changed().then_some(Value::Bool(value))
        }
        (Domain::Int { min, max }, Value::Int(value)) => {
            let scale = Scale { min: *min as f64, max: *max as f64, step: 1.0 };
            let field = NumberField::new(&name, &param.name, scale);
            let changed = field.show_with_slider(ui, *value as f64, width)?;
            let changed = (changed.round() as i64).clamp(*min, *max);
            (changed != *value).then_some(Value::Int(changed))
        }
        (Domain::Float { min, max, step }, Value::Float(value)) => {
            let scale = Scale { min: *min, max: *max, step: *step };
            let field = NumberField::new(&name, &param.name, scale);
            field.show_with_slider(ui, *value, width).map(Value::Float)
        }
        (Domain::Choice(choices), Value::Text(value)) => {
            let mut chosen = value.clone();
            ui.spacing_mut().combo_width = width;
            widgets::choice(ui, &name, value, &mut chosen, choices.iter().map(|text| (text.clone(), text)));
            (chosen != *value).then_some(Value::Text(chosen))
        }
        // Unreachable for a valid plan.
        (_, value) => {
            ui.label(value.to_string());
            None
        }
    }
}
