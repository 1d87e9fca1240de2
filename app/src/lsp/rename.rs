//! Renames a declaration of a graph in all files. The graphs are first built with the new name, as a check.

use super::files::{self, LANES, nominal_case};
use super::index::{Form, Index, Place, capital};
use super::names::continues_name;
use crate::draw::planner::{GraphErrors, Planner};
use crate::draw::requirements;
use splatgraph_framework::plan::Plan;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

pub type Edit = (std::ops::Range<usize>, String);

/// Lists the edits in each file that rename the name at a byte offset of a file.
///
/// `open` holds the editor's texts. They are restored in the planner after the check.
///
/// # Errors
/// No graph declares the name at the byte, the new name is not valid, the name occurs in a built-in file, or the new
/// name would break a graph or change its plan.
pub fn rename(
    planner: &mut Planner,
    index: &Index,
    open: &BTreeMap<PathBuf, String>,
    (path, offset): (&str, usize),
    new: &str,
) -> Result<BTreeMap<String, Vec<Edit>>, String> {
    let Some((_, old, form)) = index.name_at(path, offset) else {
        return Err(
            "expected a parameter, a `let`, a resource, a pass, an include or a statistic of a graph, \
                    found something else"
                .into(),
        );
    };
    let is_name = new.chars().next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_')
        && new.chars().all(continues_name);
    if !is_name {
        return Err(format!("expected a name of letters, digits and `_`, found `{new}`"));
    }
    // A new name for a shader's constant is entered in capitals.
    let new = if form == Form::Macro { new.to_ascii_lowercase() } else { new.to_owned() };
    let mut edits: BTreeMap<String, Vec<Edit>> = BTreeMap::new();
    for (Place { file, start, end }, form) in index.places(path, offset) {
        if !PathBuf::from(&file).is_absolute() {
            return Err(format!(
                "`{old}` is also in {file}, which is built into the program and cannot be changed; `splatgraph source` \
                 prints a copy to put beside the graph"
            ));
        }
        let text = if form == Form::Macro { capital(&new) } else { new.clone() };
        edits.entry(file).or_default().push((start..end, text));
    }
    let changed: BTreeSet<String> = edits.keys().cloned().collect();
    let users = index.users(&changed);
    let before = results(planner, &users);
    let mut texts = open.clone();
    for (file, edits) in &edits {
        let mut text = index.text(file).unwrap_or_default().to_owned();
        for (range, new) in edits.iter().rev() {
            text.replace_range(range.clone(), new);
        }
        texts.retain(|path, _| super::files::canonical(path).display().to_string() != *file);
        texts.insert(file.into(), text);
    }
    planner.read_unsaved(texts);
    let after = results(planner, &users);
    planner.read_unsaved(open.clone());
    for ((user, before), after) in users.iter().zip(before).zip(after) {
        match (before, after) {
            (Ok(_), Err(error)) => {
                return Err(format!("renaming `{old}` to `{new}` would break {user}: {error}"));
            }
            (Ok(before), Ok(after)) => {
                if let Some(changed) =
                    before.iter().zip(&after).find_map(|(before, after)| before.change(after))
                {
                    return Err(format!("renaming `{old}` to `{new}` would change {user}: {changed}"));
                }
            }
            // A graph that failed to build before, such as a part or one with an error, is not compared.
            (Err(_), _) => {}
        }
    }
    Ok(edits)
}

/// The parts of a plan that a rename must not change. The only names among them are those of shader files.
struct NamelessPlan {
    passes: usize,
    dependencies: usize,
    bytes: u64,
    values: Vec<String>,
    /// Each shader's file and its code without names.
    shaders: Vec<(String, Vec<u32>)>,
}

impl NamelessPlan {
    fn of(plan: &Plan) -> NamelessPlan {
        NamelessPlan {
            passes: plan.passes.len(),
            dependencies: plan.dependencies.len(),
            bytes: plan.resources.iter().map(|resource| resource.bytes()).sum(),
            values: plan.params.iter().map(|param| param.value.to_string()).collect(),
            shaders: plan.shaders.iter().map(|s| (s.name.clone(), nameless(&s.spirv))).collect(),
        }
    }

    /// Describes the first difference; `None` if the plans are equivalent.
    fn change(&self, after: &NamelessPlan) -> Option<String> {
        let shader = self.shaders.iter().zip(&after.shaders).find(|(before, after)| before != after);
        if let Some(((shader, _), _)) = shader {
            // The usual cause: a variable, a function or a constant of the shader already has the new name.
            return Some(format!(
                "expected {shader} to compile to the same code, found other code; choose a name that the shader \
                 does not use"
            ));
        }
        let changes = |what: &str, before: String, after: String| {
            (before != after).then(|| format!("expected {what} {before}, found {after}"))
        };
        changes("passes:", self.passes.to_string(), after.passes.to_string())
            .or_else(|| {
                changes("dependencies:", self.dependencies.to_string(), after.dependencies.to_string())
            })
            .or_else(|| changes("bytes of resources:", self.bytes.to_string(), after.bytes.to_string()))
            .or_else(|| changes("parameter values:", self.values.join(", "), after.values.join(", ")))
    }
}

/// Returns SPIR-V without its debug instructions, which hold names, texts and lines.
fn nameless(spirv: &[u32]) -> Vec<u32> {
    // OpSourceContinued, OpSource, OpSourceExtension, OpName, OpMemberName, OpString, OpLine; OpNoLine;
    // OpModuleProcessed.
    let is_debug = |opcode: u32| matches!(opcode, 2..=8 | 317 | 330);
    let (header, mut rest) = spirv.split_at(spirv.len().min(5));
    let mut code = header.to_vec();
    while let Some(first) = rest.first() {
        let (instruction, others) = rest.split_at(((first >> 16) as usize).clamp(1, rest.len()));
        if !is_debug(first & 0xffff) {
            code.extend(instruction);
        }
        rest = others;
    }
    code
}

/// Builds each graph for a GPU and for a CPU. Graphs of a choice that neither draws are built, too. Returns the plans
/// of each graph, or the first error.
fn results(planner: &mut Planner, graphs: &[String]) -> Vec<Result<Vec<NamelessPlan>, String>> {
    let build = |graph: &String| {
        let first = |errors: GraphErrors| {
            let first = errors.found.first();
            first.map_or_else(String::new, |e| format!("{}:{}: {}", e.file, e.line, e.message))
        };
        let (catalog, cases) = (files::nominal_catalog(), LANES.map(nominal_case));
        let builds = requirements::builds(planner, graph, &cases, &catalog).map_err(first)?;
        let plans = builds.iter().filter_map(|build| build.plan(planner, graph, &[], &catalog).transpose());
        plans.map(|plan| Ok(NamelessPlan::of(&plan.map_err(first)?))).collect()
    };
    graphs.iter().map(build).collect()
}
