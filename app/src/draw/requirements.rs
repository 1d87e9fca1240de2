//! Finds devices and scenes that meet the requirements of graphs.
//!
//! `check` and the language server use them to check also the graphs of a choice that no given device draws.

use crate::draw::facts::{self, SUBGROUP_SIZES, SceneFacts, set_device_fact};
use crate::draw::planner::{GraphErrors, PlainDiagnostic, Planner, Severity};
use splatgraph_assets::{Filter, SortKey};
use splatgraph_framework::expr::Expr;
use splatgraph_framework::ir::{Catalog, DeviceFacts, Facts, Unmet, Value};
use splatgraph_framework::lower;
use splatgraph_framework::plan::Plan;

/// A device, a scene and the size of a picture, for which a plan is built.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Facts of the device.
    pub device: DeviceFacts,
    /// Facts of the scene.
    pub scene: SceneFacts,
    /// Width and height of the picture, in pixels.
    pub size: (u32, u32),
}

/// A graph to build for a case.
#[derive(Clone, Debug)]
pub struct Build {
    /// Index of the graph in its choice; see [`splatgraph_framework::lower::candidates`].
    pub index: usize,
    /// Name by which the choice refers to a graph that is not drawn. `None` if the graph is drawn or is not part of a
    /// choice.
    pub name: Option<String>,
    /// A case that meets the graph's requirements; `None` if none was found.
    pub case: Option<Case>,
    /// The facts in which `case` differs from the given case, such as `device.int64 = true`; may be empty.
    pub changed: String,
    /// The requirements that the given case does not meet.
    pub unmet: Vec<Unmet>,
}

/// Lists, for each given case, the graph that it draws, and then the graphs that none draws; see [`undrawn`].
///
/// # Errors
/// Errors of the graphs' files and of their `require`.
pub fn builds(
    planner: &mut Planner,
    graph: &str,
    given: &[Case],
    catalog: &Catalog,
) -> Result<Vec<Build>, GraphErrors> {
    let mut all = Vec::new();
    for case in given {
        let standing = planner.ask((graph, &[]), &case.facts(), catalog, lower::standing)?;
        if standing.unmet.is_empty() {
            all.push(Build {
                index: standing.fallbacks.len(),
                name: None,
                case: Some(case.clone()),
                changed: String::new(),
                unmet: Vec::new(),
            });
        }
    }
    let drawn: Vec<usize> = all.iter().map(|build| build.index).collect();
    all.extend(undrawn(planner, graph, given, catalog, &drawn)?);
    Ok(all)
}

/// Finds cases for the graphs of `graph` whose indices are not in `drawn`.
///
/// If a given case does not meet a graph's requirements, the facts that they read are changed until it does. Equal
/// cases of a graph are listed once. `catalog` has the imports of a graph that draws the scene.
///
/// # Errors
/// Errors of the graphs' files and of their `require`.
pub fn undrawn(
    planner: &mut Planner,
    graph: &str,
    given: &[Case],
    catalog: &Catalog,
    drawn: &[usize],
) -> Result<Vec<Build>, GraphErrors> {
    let mut found: Vec<Build> = Vec::new();
    for case in given {
        let mut ask = |case: &Case| planner.ask((graph, &[]), &case.facts(), catalog, lower::candidates);
        let candidates = ask(case)?;
        let is_alone = candidates.len() == 1;
        for (index, candidate) in candidates.into_iter().enumerate().filter(|(i, _)| !drawn.contains(i)) {
            let met = meeting(case, candidate.unmet.clone(), |case| {
                ask(case).ok().map(|mut all| all.swap_remove(index).unmet)
            });
            let changed = met.as_ref().map_or_else(String::new, |met| met.differences(case));
            let name = (!is_alone).then_some(candidate.name);
            let new = Build { index, name, case: met, changed, unmet: candidate.unmet };
            match found.iter_mut().find(|other| (other.index, &other.case) == (index, &new.case)) {
                Some(same) if same.changed.len() > new.changed.len() => *same = new,
                Some(_) => {}
                None => found.push(new),
            }
        }
    }
    // A graph is checked if any of the cases could be changed.
    let checked: Vec<usize> = found.iter().filter(|f| f.case.is_some()).map(|f| f.index).collect();
    found.retain(|build| build.case.is_some() || !checked.contains(&build.index));
    found.sort_by_key(|build| build.index);
    Ok(found)
}

impl Build {
    /// Builds the plan; `None` without a case. `set` is ignored for a graph of a choice that is not drawn: it may lack
    /// the parameters.
    ///
    /// # Errors
    /// See [`Planner::plan_candidate`].
    pub fn plan(
        &self,
        planner: &mut Planner,
        graph: &str,
        set: &[(String, String)],
        catalog: &Catalog,
    ) -> Result<Option<Plan>, GraphErrors> {
        let Some(case) = &self.case else { return Ok(None) };
        let set = if self.name.is_none() { set } else { &[] };
        let plan =
            planner.plan_candidate(graph, Some(self.index), set, &case.facts(), &case.catalog(catalog));
        plan.map(Some).map_err(|errors| match &self.name {
            Some(_) => self.named(errors, "which is not drawn here, has this error"),
            None => with_drawn_graph(planner, (graph, self.index), case, catalog, errors),
        })
    }

    /// Builds a graph with every output that `plan`, the result of [`Build::plan`], offers. `None` if `plan` has them
    /// all, or if a limit of the device was changed and the plan cannot be built: no device may have that limit.
    ///
    /// # Errors
    /// See [`Build::plan`].
    pub fn full_plan(
        &self,
        planner: &mut Planner,
        plan: &Plan,
        (graph, set): (&str, &[(String, String)]),
        catalog: &Catalog,
    ) -> Result<Option<Plan>, GraphErrors> {
        let full = planner.with_every_output(plan, |planner| self.plan(planner, graph, set, catalog));
        if self.changed.contains("device.max_") {
            Ok(full.unwrap_or_default().flatten())
        } else {
            Ok(full?.flatten())
        }
    }

    /// Adds the graph's name and `what` to its errors, if it is one of several graphs of a choice.
    fn named(&self, errors: GraphErrors, what: &str) -> GraphErrors {
        match &self.name {
            Some(name) => errors.with_note(&format!("the choice's graph `{name}`, {what}")),
            None => errors,
        }
    }
}

/// Adds the name of the drawn graph to its errors, if it is one of several graphs of a choice. `index` is its index.
pub fn with_drawn_graph(
    planner: &mut Planner,
    (graph, index): (&str, usize),
    case: &Case,
    catalog: &Catalog,
    errors: GraphErrors,
) -> GraphErrors {
    match planner.ask((graph, &[]), &case.facts(), catalog, lower::candidates) {
        Ok(all) if all.len() > 1 => errors.with_note(&format!(
            "the choice's graph `{}`, which is drawn with device.subgroup_size = {}, has this error",
            all[index].name, case.device.subgroup_size
        )),
        _ => errors,
    }
}

/// Unmet requirements of the graphs for which no case was found.
#[derive(Debug, Default)]
pub struct Unchecked(Vec<GraphErrors>);

impl Unchecked {
    /// Adds the unmet requirements of a graph, unless its plan can be built for `given`.
    pub fn add(
        &mut self,
        planner: &mut Planner,
        (graph, build): (&str, &Build),
        given: &Case,
        catalog: &Catalog,
    ) {
        let built = planner.plan_candidate(graph, Some(build.index), &[], &given.facts(), catalog);
        self.0.extend(
            built.err().map(|errors| build.named(errors, "which was not checked, has this requirement")),
        );
    }

    /// Returns the unmet requirements at their places: as warnings if another graph was checked, or else as errors.
    ///
    /// `checked` is the number of checked graphs.
    ///
    /// # Errors
    /// There are unmet requirements, and no graph was checked.
    pub fn diagnostics(self, checked: usize) -> Result<Vec<PlainDiagnostic>, GraphErrors> {
        match GraphErrors::joined(self.0) {
            Some(errors) if checked == 0 => Err(errors),
            errors => {
                let warning = |error| PlainDiagnostic { severity: Severity::Warning, ..error };
                Ok(errors.into_iter().flat_map(|errors| errors.found).map(warning).collect())
            }
        }
    }
}

/// Changes facts until a case has no unmet requirements. `None` if no such facts are found.
fn meeting(
    given: &Case,
    mut unmet: Vec<Unmet>,
    mut unmet_of: impl FnMut(&Case) -> Option<Vec<Unmet>>,
) -> Option<Case> {
    // Facts that meet one requirement may fail another.
    const ROUNDS: usize = 8;
    let mut case = given.clone();
    for _ in 0..ROUNDS {
        let Some(first) = unmet.first() else { return Some(case) };
        case = case.meeting(&first.reason.expression)?;
        unmet = unmet_of(&case)?;
    }
    unmet.is_empty().then_some(case)
}

impl Case {
    /// Returns the facts of the case, as graphs see them.
    pub fn facts(&self) -> Facts {
        facts::facts(&self.scene, &self.device, self.size)
    }

    /// Returns `catalog` with the scene's number of splats.
    pub fn catalog(&self, catalog: &Catalog) -> Catalog {
        facts::with_count(catalog.clone(), self.scene.count)
    }

    /// Lists the facts that differ from those of another case: `device.int64 = true`.
    fn differences(&self, other: &Case) -> String {
        let (facts, others) = (self.facts().named(), other.facts().named());
        let changed = facts.iter().filter(|(name, value)| others.get(*name) != Some(value));
        changed.map(|(name, value)| format!("{name} = {value}")).collect::<Vec<_>>().join(", ")
    }

    /// Changes the facts that a condition names, so that it holds. `None` if no such values are found.
    fn meeting(&self, condition: &str) -> Option<Case> {
        let condition = Expr::parse(condition).ok()?;
        let all = self.facts();
        let facts = all.named();
        let mut names: Vec<&str> = condition.names().map(|(name, _)| name).collect();
        names.sort_unstable();
        names.dedup();
        let constants = condition.constants();
        let values = |name| match all.texts.get(name) {
            Some(texts) => {
                let present = facts.get(name).cloned();
                (name, present.into_iter().chain(texts.iter().cloned().map(Value::Text)).collect())
            }
            None => (name, values(name, facts.get(name), &constants)),
        };
        let choices: Vec<(&str, Vec<Value>)> = names.into_iter().map(values).collect();
        self.search(&condition, &choices, &mut 10_000)
    }

    /// Searches at most `tries` combinations of values for one with which the condition holds; `None` if none does.
    fn search(&self, condition: &Expr, choices: &[(&str, Vec<Value>)], tries: &mut u32) -> Option<Case> {
        let Some(((name, values), others)) = choices.split_first() else {
            *tries = tries.checked_sub(1)?;
            let holds = condition.eval(&self.facts().named()) == Ok(Value::Bool(true));
            return holds.then(|| self.clone());
        };
        values.iter().find_map(|value| {
            let mut case = self.clone();
            (*tries > 0 && case.set(name, value)).then(|| case.search(condition, others, tries))?
        })
    }

    /// Sets a fact by its name. Returns false if it cannot have the value.
    fn set(&mut self, name: &str, value: &Value) -> bool {
        if name.starts_with("device.") {
            return set_device_fact(&mut self.device, name, value).is_ok();
        }
        let scene = &mut self.scene;
        match (name, value) {
            ("viewport.width", Value::Int(width @ 1..=16384)) => self.size.0 = *width as u32,
            ("viewport.height", Value::Int(height @ 1..=16384)) => self.size.1 = *height as u32,
            ("scene.count", Value::Int(count @ 1..=0xffff_ffff)) => scene.count = *count as u64,
            ("scene.sh_degree", Value::Int(degree @ 0..)) if *degree <= scene.stored_sh_degree.into() => {
                scene.sh_degree = *degree as u32;
            }
            ("scene.key_bits", Value::Int(bits @ 8..=32)) => scene.key_bits = *bits as u32,
            ("scene.largest_sh", Value::Int(largest @ 0..)) => scene.largest_sh = *largest as u64,
            ("scene.brightest", Value::Int(brightest @ 0..)) => scene.brightest = *brightest as u64,
            ("mesh.triangles", Value::Int(count @ 0..=0xffff_ffff)) => scene.triangles = *count as u64,
            ("mesh.possible", Value::Bool(possible)) => scene.mesh_possible = *possible,
            ("scene.wide", Value::Bool(wide)) => scene.wide = *wide,
            ("scene.low_pass", Value::Text(text)) => {
                let Some(filter) = Filter::named(text) else { return false };
                scene.low_pass = filter;
            }
            ("scene.key_of", Value::Text(text)) => {
                let Some(key) = SortKey::named(text) else { return false };
                scene.key_of = key;
            }
            // Not changed: values out of range, and `scene.stored_sh_degree`, on which the strides of the imports
            // depend.
            _ => return self.facts().named().get(name) == Some(value),
        }
        true
    }
}

/// Lists values of a fact with which a condition with these constants may hold, the most similar to `present` first.
fn values(name: &str, present: Option<&Value>, constants: &[Value]) -> Vec<Value> {
    match present {
        Some(Value::Bool(present)) => vec![Value::Bool(*present), Value::Bool(!present)],
        Some(Value::Int(present)) => {
            let constants = constants.iter().filter_map(|constant| match constant {
                Value::Int(number) => Some(*number),
                Value::Float(number) => Some(*number as i64),
                Value::Bool(_) | Value::Text(_) => None,
            });
            let near = |number: i64| [number.saturating_sub(1), number, number.saturating_add(1)];
            let mut all: Vec<i64> = [*present].into_iter().chain(constants).flat_map(near).collect();
            all.extend([1, u32::MAX.into()]);
            if name == "device.subgroup_size" {
                all = SUBGROUP_SIZES.map(i64::from).to_vec();
            }
            all.sort_by_key(|value| (value.abs_diff(*present), *value));
            all.dedup();
            all.into_iter().map(Value::Int).collect()
        }
        // No such fact, for example an output that is not requested. No fact is a float, and texts have a list.
        Some(Value::Float(_) | Value::Text(_)) | None => present.cloned().into_iter().collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given() -> Case {
        let device = facts::portable_device(8);
        Case { device, scene: SceneFacts::NOMINAL, size: facts::DEFAULT_SIZE }
    }

    #[test]
    fn the_facts_that_a_condition_names_are_changed_until_it_holds_and_no_others() {
        for (condition, changed) in [
            ("device.int64", "device.int64 = true"),
            ("device.int64 && !device.subgroup_vote", "device.int64 = true, device.subgroup_vote = false"),
            ("device.max_image_size >= 65536", "device.max_image_size = 65536"),
            ("device.max_invocations >= 1024", "device.max_invocations = 1024"),
            ("device.shared_bytes >= 48 << 10", "device.shared_bytes = 49152"),
            ("device.subgroup_size >= 16 && scene.count > 0", "device.subgroup_size = 16"),
            ("device.subgroup_size > 64", "device.subgroup_size = 128"),
            ("scene.count < 65536", "scene.count = 65535"),
            ("scene.low_pass == 'mip' || false", "scene.low_pass = mip"),
            ("scene.key_of != 'depth'", "scene.key_of = distance"),
            ("viewport.width % 2 == 1", "viewport.width = 959"),
            ("scene.count * 4096 <= device.max_storage_bytes", "scene.count = 4097"),
            ("device.int64 || true", ""),
        ] {
            let met = given().meeting(condition).unwrap_or_else(|| panic!("{condition}"));
            assert_eq!(met.differences(&given()), changed, "{condition}");
        }
        for condition in
            ["device.max_groups_x < 0", "device.subgroup_size == 24", "scene.stored_sh_degree == 0"]
        {
            assert_eq!(given().meeting(condition), None, "{condition}");
        }
    }

    #[test]
    fn the_imports_have_as_many_splats_as_the_facts() {
        let few = given().meeting("scene.count < 1000").expect("there are such scenes");
        let catalog = few.catalog(&facts::nominal_catalog());
        assert_eq!(catalog.attributes["scene.position"].count, 999);
    }
}
