//! Finds the parts of the plan that depend on each parameter, or the reason why none does.
//!
//! Lowering and linking found the parameters that each pass and each resource of the graph depends on; this module
//! collects them for the passes of the plan. Parameters that a culled pass's accesses depend on shape the plan: the
//! pass separates the passes before and after it, and with other accesses it could be needed.

use std::collections::BTreeMap;

use super::order::Order;
use crate::ir::{Effect, Param, ParamSet, Pass, PassId, Work};
use crate::link::LinkedPass;
use crate::lower::{Lowered, RemovedPass, SkippedUse};
use crate::plan::Plan;
use crate::source::SourceMap;

/// The parameters that each pass and resource of a plan depends on, collected before the passes are numbered.
pub(super) struct Causes {
    passes: Vec<ParamSet>,
    /// The parameters of each resource, by its name.
    resources: BTreeMap<String, ParamSet>,
    /// Parameters that decide which passes exist; see [`Effect::shape`].
    shape: ParamSet,
    /// For each parameter, where it would have an effect, as a phrase. `None` if it has one here, or if no such place
    /// is known.
    hints: Vec<Option<String>>,
}

impl Causes {
    pub fn new(lowered: &Lowered, passes: &[LinkedPass], order: &Order, files: &SourceMap) -> Causes {
        let of_pass = |index: &usize| -> ParamSet {
            let LinkedPass { pass, params, .. } = &passes[*index];
            let bound = pass.bindings.iter().map(|binding| binding.resource);
            let resources = bound.chain(pass.uses.iter().map(|touch| touch.resource));
            let behind = resources
                .flat_map(|resource| [resource, lowered.real(resource)])
                .flat_map(|resource| &lowered.declaration(resource).params);
            params.all.iter().chain(behind).copied().collect()
        };
        let left_out = || passes.iter().zip(&order.live).filter(|(_, live)| !**live).map(|(pass, _)| pass);
        let structure = left_out().flat_map(|pass| &pass.params.structure);
        let shape: ParamSet = lowered.shape.iter().chain(structure).copied().collect();
        let of_passes: Vec<ParamSet> = order.once.iter().chain(&order.frame).map(of_pass).collect();
        let mut used = shape.clone();
        of_passes.iter().for_each(|params| used.extend(params));
        let hint = |param: usize| {
            let unread = || unread_hint(left_out().filter(|pass| pass.params.all.contains(&param)));
            let removed = || {
                let removed = lowered.removed.iter().find(|pass| pass.named.contains(&param))?;
                Some(removed_hint(removed, &lowered.plan.params, files))
            };
            let unreached = || {
                let found = lowered.skipped.iter().find(|found| found.params.contains(&param))?;
                Some(unreached_hint(found, &lowered.plan.params, files))
            };
            let skipped = || {
                let pass = passes.iter().find(|pass| pass.params.skipped.contains(&param))?;
                Some(format!("the shader of `{}` uses it only where an `#if` is false", pass.pass.name))
            };
            if used.contains(&param) {
                None
            } else {
                unread().or_else(removed).or_else(unreached).or_else(skipped)
            }
        };
        let names = lowered.plan.resources.iter().map(|resource| resource.name.clone());
        Causes {
            hints: (0..lowered.plan.params.len()).map(hint).collect(),
            passes: of_passes,
            resources: names.zip(lowered.declarations.iter().map(|d| d.params.clone())).collect(),
            shape,
        }
    }

    /// Returns the effect of each parameter. `starts` are the passes that clear histories, before all others.
    pub fn effects(self, plan: &Plan, starts: &[Pass]) -> Vec<Effect> {
        let none = ParamSet::new();
        let of_start = |start: &Pass| match start.work {
            Work::ClearHistory { resource } => {
                self.resources.get(&plan.resource(resource).name).unwrap_or(&none)
            }
            _ => &none,
        };
        let mut effects = vec![Effect::default(); plan.params.len()];
        for (index, params) in starts.iter().map(of_start).chain(&self.passes).enumerate() {
            params.iter().for_each(|param| effects[*param].passes.push(PassId(index as u32)));
        }
        for (index, (effect, hint)) in effects.iter_mut().zip(self.hints).enumerate() {
            effect.shape = self.shape.contains(&index);
            effect.none = (effect.passes.is_empty() && !effect.shape).then(|| {
                let hint = hint.map(|hint| format!("; {hint}")).unwrap_or_default();
                format!("nothing in this plan depends on it{hint}")
            });
        }
        effects
    }
}

/// Returns the hint for a parameter that only these culled passes use; `None` if there are none.
fn unread_hint<'a>(mut passes: impl Iterator<Item = &'a LinkedPass>) -> Option<String> {
    let first = passes.next()?;
    let (others, those) =
        if passes.next().is_some() { (" and others", "they write") } else { ("", "it writes") };
    Some(format!("it is used by `{}`{others}, and nothing reads what {those}", first.pass.name))
}

/// Returns the hint that a pass uses the parameter, but is left out by a false condition or a count of 0.
fn removed_hint(removed: &RemovedPass, params: &[Param], files: &SourceMap) -> String {
    let origin = files.origin(removed.when);
    let values = values(&removed.decided, params);
    let here = match (values.as_str(), &removed.reason) {
        ("", None) => String::new(),
        ("", Some(reason)) => format!(", and here {reason}"),
        (values, _) => format!(", and here {values}"),
    };
    format!("it is used where {} ({}:{}){here}", removed.condition, origin.file, origin.line)
}

/// Returns the hint that an expression names the parameter but its evaluation did not read it. Adds the values that
/// decided this, or the reason.
fn unreached_hint(found: &SkippedUse, params: &[Param], files: &SourceMap) -> String {
    let origin = files.origin(found.span);
    let text = format!("`{}` ({}:{}) leaves it out", found.name, origin.file, origin.line);
    match (values(&found.decided, params).as_str(), &found.reason) {
        ("", None) => text,
        ("", Some(reason)) => format!("{text}, as {reason}"),
        (values, _) => format!("{text}, as {values}"),
    }
}

/// Formats values: `rasteriser = cells, sorted = pairs`.
fn values(of: &ParamSet, params: &[Param]) -> String {
    let of = of.iter().map(|param| &params[*param]);
    of.map(|param| format!("{} = {}", param.name, param.value)).collect::<Vec<_>>().join(", ")
}
