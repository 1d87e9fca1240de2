//! Sets parameters of a renderer's graph, and sets aside the settings that a new plan's graph rejects.

use super::Renderer;
use crate::view::events::{Cause, Event};
use indexmap::IndexMap;
use splatgraph_framework::ir::{ParamBinding, Value};
use splatgraph_framework::lower::{Control, parse_value};
use std::time::Instant;

impl Renderer {
    /// Sets a parameter; `None` restores the value of the graph or its preset. An unknown name cannot be set.
    ///
    /// A constant requests a build. The parameter's raised capacity is forgotten. The value's type and range are not
    /// checked here: they must fit the parameter's domain.
    pub fn set_param(&mut self, name: &str, value: Option<Value>) {
        let control = self.controls.iter_mut().find(|control| control.param.name == name);
        let Some(Control { param, unset, .. }) = control else {
            // Before the first plan, no parameter is known.
            if value.is_none() && self.choice.set.shift_remove(name).is_some() {
                self.want(Cause::Parameter(name.to_owned()), Instant::now());
            }
            return;
        };
        let value = value.filter(|value| value != unset);
        match &value {
            Some(value) => {
                self.choice.set.insert(name.to_owned(), value.to_string());
            }
            None => {
                self.choice.set.shift_remove(name);
            }
        }
        param.value = value.unwrap_or_else(|| unset.clone());
        self.rejected.shift_remove(name);
        self.capacities.forget(name);
        if param.binding == ParamBinding::Const {
            self.want(Cause::Parameter(name.to_owned()), Instant::now());
        }
    }

    /// Resets all parameters to their defaults, and drops rejected settings.
    pub fn reset_params(&mut self) {
        self.rejected.clear();
        let names: Vec<String> = self.choice.set.keys().cloned().collect();
        for name in names {
            self.set_param(&name, None);
        }
    }

    /// Replaces the changed parameters with `set`; all others return to their defaults.
    ///
    /// A parameter keeps its value if the text in `set` is invalid. Names that the graph lacks are ignored. Before the
    /// first plan, no parameter is known, and the next build checks `set`.
    pub fn replace_set(&mut self, set: &IndexMap<String, String>) {
        if self.controls.is_empty() && self.choice.set != *set {
            return self.choose(&self.choice.graph.clone(), set.clone());
        }
        let of = |Control { param, .. }: &Control| {
            let value = set.get(&param.name).map(|text| parse_value(text, &param.domain)).transpose();
            value.ok().map(|value| (param.name.clone(), value))
        };
        let wanted: Vec<(String, Option<Value>)> = self.controls.iter().filter_map(of).collect();
        for (name, value) in wanted {
            let text = value.as_ref().map(ToString::to_string);
            if self.choice.set.get(&name) != text.as_ref() {
                self.set_param(&name, value);
            }
        }
    }

    /// Sets aside the settings that the new plan's graph rejects, and restores rejected settings that it accepts again.
    /// Both are reported as events.
    pub(super) fn sort_settings(&mut self) {
        let control = |name: &str| self.controls.iter().find(|control| control.param.name == name);
        let fits = |name: &String, text: &mut String| {
            control(name).is_some_and(|control| parse_value(text, &control.param.domain).is_ok())
        };
        let restored: IndexMap<_, _> = self.rejected.extract_if(.., fits).collect();
        let dropped: IndexMap<_, _> =
            self.choice.set.extract_if(.., |name, text| !fits(name, text)).collect();
        if !dropped.is_empty() {
            let reason = |(name, text): (&String, &String)| match control(name) {
                None => format!("this graph has no parameter {name}, which was {text}"),
                Some(Control { param, .. }) => {
                    format!("{name} is now {}: expected {}, found {text}", param.value, param.domain)
                }
            };
            let text = dropped.iter().map(reason).collect::<Vec<_>>().join("; ");
            let parameters = dropped.keys().cloned().collect();
            self.events.push(Event::Dropped { renderer: self.id, parameters, text });
        }
        if !restored.is_empty() {
            let value = |(name, text): (&String, &String)| format!("{name} is {text} again");
            let text = restored.iter().map(value).collect::<Vec<_>>().join("; ");
            let parameters = restored.keys().cloned().collect();
            self.events.push(Event::Restored { renderer: self.id, parameters, text });
        }
        self.choice.set.extend(restored);
        self.rejected.extend(dropped);
    }

    /// Sets the new plan's parameters to the current settings, which may have changed since the build was requested. A
    /// constant without a setting, and any parameter with an invalid one, keeps its value in the plan.
    pub(super) fn apply_set(&mut self) {
        for Control { param, unset, .. } in &mut self.controls {
            match self.choice.set.get(&param.name).map(|text| parse_value(text, &param.domain)) {
                Some(Ok(value)) => param.value = param.with_room(value, self.capacities.values()),
                None if param.binding != ParamBinding::Const => param.value.clone_from(unset),
                None | Some(Err(_)) => {}
            }
        }
    }
}
