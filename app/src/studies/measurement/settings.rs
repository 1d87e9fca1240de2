//! Lists the settings of a graph that studies compare.

use crate::draw::builtin::{self, Preset};
use crate::draw::planner::without_effect;
use crate::draw::projection;
use crate::studies::study::Setting;
use splatgraph_assets::Projection;
use splatgraph_framework::ir::{Domain, Param, Value};
use splatgraph_framework::lower::Control;
use splatgraph_framework::plan::Plan;

/// Name of the exact settings, against which the others are measured.
pub const EXACT: &str = "exact";

/// Name of the setting with the graph's defaults.
pub const DEFAULTS: &str = "defaults";

/// Lists the built-in graphs to measure for a projection: all but `auto`, which chooses among the others.
pub fn measured_names(projection: Projection) -> Vec<&'static str> {
    let is_measured = |preset: &Preset| {
        projection::of_controls(&preset.params) == projection && preset.name != builtin::DEFAULT_PIPELINE
    };
    builtin::presets().iter().filter(|preset| is_measured(preset)).map(|preset| preset.name).collect()
}

/// Beginning of the names of settings that draw another graph; the rest is the graph, as `--pipeline` takes it.
pub const GRAPH: &str = "graph ";

/// Returns the setting that draws another graph with its defaults, and with the parameters of `set` at fixed values.
pub fn of_graph(graph: &str, set: &[(String, String)]) -> Setting {
    Setting { name: format!("{GRAPH}{graph}"), ..Setting::of_graph(graph, set) }
}

/// Lists the settings of a graph that studies measure, with the parameters of `set` at fixed values.
pub fn measured(pipeline: &str, set: &[(String, String)], controls: &[Control]) -> Vec<Setting> {
    let all = list(pipeline, controls, &measured_names(projection::of_controls(controls)));
    if set.is_empty() {
        return all;
    }
    let presets = builtin::presets();
    let has = |graph: &str, name: &str| {
        let preset = presets.iter().find(|preset| preset.name == graph);
        preset.is_some_and(|preset| preset.params.iter().any(|control| control.param.name == name))
    };
    fixed(all, set, has)
}

/// Lists a graph's exact settings, the settings that change one parameter of them, its defaults, and other `presets`.
///
/// `controls` are the graph's parameters. A parameter without an exact value is in none of the settings, and keeps its
/// default.
pub fn list(pipeline: &str, controls: &[Control], presets: &[&str]) -> Vec<Setting> {
    let params = || controls.iter().map(|control| &control.param);
    let exact: Vec<(String, String)> =
        params().filter_map(|param| Some((param.name.clone(), param.exact.as_ref()?.to_string()))).collect();
    let setting = |name: String, set: Vec<(String, String)>| Setting { name, pipeline: pipeline.into(), set };
    let mut all = vec![setting(EXACT.into(), exact.clone())];
    for param in params().filter(|param| param.exact.is_some()) {
        for value in alternatives(param) {
            let set = exact.iter().filter(|(name, _)| *name != param.name).cloned();
            let set = set.chain([(param.name.clone(), value.to_string())]).collect();
            all.push(setting(format!("{} = {value}", param.name), set));
        }
    }
    all.push(setting(DEFAULTS.into(), Vec::new()));
    let others = presets.iter().filter(|preset| **preset != pipeline);
    all.extend(others.map(|preset| Setting {
        name: format!("preset {preset}"),
        pipeline: preset.to_string(),
        set: Vec::new(),
    }));
    all
}

/// Adds the setting `text`, of the form `NAME = VALUE`, after the others of this parameter.
///
/// Adds nothing if `text` has another form or is in the list, if `set` fixes the parameter, or if the exact settings
/// lack it.
pub fn add(all: &mut Vec<Setting>, set: &[(String, String)], text: &str) {
    let Some((name, value)) = text.split_once(" = ") else { return };
    let is_fixed = set.iter().any(|(fixed, _)| fixed == name);
    let Some(exact) = all.first().filter(|_| !is_fixed && all.iter().all(|setting| setting.name != text))
    else {
        return;
    };
    let mut setting = Setting { name: text.into(), ..exact.clone() };
    let Some(pair) = setting.set.iter_mut().find(|(of, _)| of == name) else { return };
    pair.1 = value.into();
    let last =
        all.iter().rposition(|setting| setting.name.split_once(" = ").is_some_and(|(of, _)| of == name));
    all.insert(last.unwrap_or(0) + 1, setting);
}

/// Sets parameters in every setting, and leaves out the settings that vary one of them.
///
/// A setting of another graph is kept only if `has` accepts that graph with each of these parameters.
fn fixed(all: Vec<Setting>, set: &[(String, String)], has: impl Fn(&str, &str) -> bool) -> Vec<Setting> {
    let Some(pipeline) = all.first().map(|exact| exact.pipeline.clone()) else { return all };
    let is_fixed = |name: &str| set.iter().any(|(fixed, _)| fixed == name);
    let changes = |setting: &Setting| setting.name.split_once(" = ").is_some_and(|(name, _)| is_fixed(name));
    let knows = |setting: &Setting| {
        setting.pipeline == pipeline || set.iter().all(|(name, _)| has(&setting.pipeline, name))
    };
    let kept = all.into_iter().filter(|setting| !changes(setting) && knows(setting));
    let give = |mut setting: Setting| {
        setting.set.retain(|(name, _)| !is_fixed(name));
        setting.set.extend_from_slice(set);
        setting
    };
    kept.map(give).collect()
}

/// Leaves out the settings that change only a parameter without an effect in `plan`, the plan of the exact settings.
///
/// The exact settings are the first of `all`. Also returns a message for each of these parameters.
pub fn with_effect(mut all: Vec<Setting>, plan: &Plan) -> (Vec<Setting>, Vec<String>) {
    let Some(exact) = all.first().cloned() else { return (all, Vec::new()) };
    let mut lines: Vec<String> = Vec::new();
    all.retain(|setting| {
        let changed: Vec<_> = setting.set.iter().filter(|pair| !exact.set.contains(pair)).cloned().collect();
        let lengths = (setting.set.len(), changed.len());
        let alone = setting.pipeline == exact.pipeline && lengths == (exact.set.len(), 1);
        let Some((_, text)) = without_effect(plan, &changed).pop().filter(|_| alone) else { return true };
        let line = format!("not measured: {text}");
        if !lines.contains(&line) {
            lines.push(line);
        }
        false
    });
    (all, lines)
}

/// Lists values of a parameter besides its exact one. These are all values of a switch or a choice, or five across an
/// integer's range.
///
/// A float has four, without its minimum, at which most parameters draw nothing. [`add`] adds others.
fn alternatives(param: &Param) -> Vec<Value> {
    let mut values: Vec<Value> = match &param.domain {
        Domain::Bool => vec![Value::Bool(false), Value::Bool(true)],
        Domain::Choice(names) => names.iter().map(|name| Value::Text(name.clone())).collect(),
        Domain::Int { min, max } => {
            (0..=4).map(|i| Value::Int(min + (i128::from(max - min) * i / 4) as i64)).collect()
        }
        Domain::Float { min, max, .. } => {
            let rounded = |v: f64| (v * 1000.0).round() / 1000.0;
            (1..=4).map(|i| Value::Float(rounded(min + (max - min) * f64::from(i) / 4.0))).collect()
        }
    };
    values.dedup();
    values.retain(|value| Some(value) != param.exact.as_ref());
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::planner::testing;

    #[test]
    fn every_parameter_with_an_exact_value_leaves_it_and_the_others_stay() {
        for (name, exact) in [("splat", ("target", "rgba32f")), ("tiled", ("sorted", "splats"))] {
            settings_of(name, exact);
        }
    }

    #[test]
    fn a_fixed_parameter_has_its_value_in_every_setting_and_is_not_changed() {
        let presets = builtin::presets();
        let splat = presets.iter().find(|preset| preset.name == "splat").expect("it is built in");
        let all = list("splat", &splat.params, &["splat", "key16", "tiled"]);
        let set = [("target".to_owned(), "rgba8".to_owned()), ("cutoff".to_owned(), "2".to_owned())];
        let has = |graph: &str, _: &str| graph == "key16";
        let fixed = fixed(all.clone(), &set, has);
        assert!(all.iter().any(|s| s.name.starts_with("cutoff = ")));
        for setting in &fixed {
            assert!(!setting.name.starts_with("cutoff = ") && !setting.name.starts_with("target = "));
            assert_eq!(setting.set.iter().filter(|(name, _)| name == "target").count(), 1);
            assert!(set.iter().all(|pair| setting.set.contains(pair)), "{setting:?}");
        }
        let names: Vec<&str> = fixed.iter().map(|s| s.name.as_str()).collect();
        assert!(names.contains(&"defaults") && names.contains(&"preset key16"), "{names:?}");
        assert!(!names.contains(&"preset tiled") && names[0] == EXACT, "{names:?}");
    }

    #[test]
    fn a_value_that_is_asked_for_is_added_once_after_the_others_of_its_parameter() {
        let presets = builtin::presets();
        let splat = presets.iter().find(|preset| preset.name == "splat").expect("it is built in");
        let listed = list("splat", &splat.params, &[]);
        let added = |set: &[(String, String)], text: &str| {
            let mut all = listed.clone();
            add(&mut all, set, text);
            all
        };
        let all = added(&[], "cutoff = 0.125");
        let at = all.iter().position(|setting| setting.name == "cutoff = 0.125").expect("it is added");
        assert!(all[at - 1].name.starts_with("cutoff = ") && !all[at + 1].name.starts_with("cutoff = "));
        assert!(all[at].set.contains(&("cutoff".into(), "0.125".into())));
        assert_eq!((all[at].set.len(), all.len()), (all[0].set.len(), listed.len() + 1));
        let fixed = [("cutoff".to_owned(), "2".to_owned())];
        for (set, text) in [
            (&[][..], all[at - 1].name.as_str()),
            (&[], "cutoff"),
            (&[], "preset digit8"),
            (&[], "cutof = 1"),
            (&fixed, "cutoff = 0.125"),
        ] {
            assert_eq!(added(set, text).len(), listed.len(), "{text}");
        }
    }

    #[test]
    fn settings_of_a_parameter_without_an_effect_are_left_out_and_it_is_named_once() {
        let presets = builtin::presets();
        let tiled = presets.iter().find(|preset| preset.name == "tiled").expect("it is built in");
        let all = list("tiled", &tiled.params, &["tiled", "key16"]);
        // `tiled` sorts pairs and draws all splats.
        let (kept, lines) = with_effect(all.clone(), &testing::plan("tiled", &[], 8));
        let left_out: Vec<&Setting> = all.iter().filter(|setting| !kept.contains(setting)).collect();
        assert!(
            left_out.len() > 1 && left_out.iter().all(|s| s.name.starts_with("budget = ")),
            "{left_out:?}"
        );
        assert!(
            lines.len() == 1 && lines[0].starts_with("not measured: `budget` has no effect: "),
            "{lines:?}"
        );
        assert!(kept.iter().any(|s| s.name == "defaults") && kept.iter().any(|s| s.name == "preset key16"));
    }

    fn settings_of(graph: &str, (name, exactly): (&str, &str)) {
        let presets = builtin::presets();
        let built_in = presets.iter().find(|preset| preset.name == graph).expect("it is built in");
        let all = list(graph, &built_in.params, &[graph, "key16"]);
        assert_eq!((all[0].name.as_str(), all.last().unwrap().name.as_str()), (EXACT, "preset key16"));
        let exact = &all[0].set;
        let value = |set: &[(String, String)], name: &str| {
            set.iter().find(|(n, _)| n == name).map(|(_, v)| v.clone()).unwrap_or_default()
        };
        assert_eq!(value(exact, name), exactly);
        assert_eq!(value(exact, "digit_bits"), "", "it changes no picture");
        for control in built_in.params.iter().filter(|control| control.param.exact.is_some()) {
            let name = &control.param.name;
            let changed: Vec<&Setting> =
                all.iter().filter(|s| s.name.split(' ').next() == Some(name.as_str())).collect();
            assert!(!changed.is_empty(), "{name}");
            for setting in changed {
                let differ = exact.iter().filter(|(n, v)| value(&setting.set, n) != *v);
                assert_eq!(differ.map(|(n, _)| n.as_str()).collect::<Vec<_>>(), [name.as_str()]);
            }
        }
        let widths: Vec<&str> =
            all.iter().filter_map(|setting| setting.name.strip_prefix("key_bits = ")).collect();
        assert_eq!(widths, ["8", "14", "20", "26"]);
        for name in
            ["key_map = equalised", "sh_storage = q8", "position_storage = fixed16", "cull_margin = 0.25"]
        {
            assert!(all.iter().any(|setting| setting.name == name), "{graph}: {name}");
        }
    }
}
