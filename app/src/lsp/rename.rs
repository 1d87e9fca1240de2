//! Renames a declaration of a graph in all files. The graphs are first built with the new name, as a check.

use super::files::{LANES, nominal};
use super::index::{Form, Index, Place, capital};
use super::names::continues_name;
use crate::draw::planner::Planner;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

pub type Edit = (std::ops::Range<usize>, String);

/// Lists the edits in each file that rename the name at a byte offset of a file.
///
/// `open` holds the editor's texts. They are restored in the planner after the check.
///
/// # Errors
/// The byte has no name that a graph declares, the new name is not valid, the name occurs in a built-in file, or the
/// new name would break a graph or change its plan.
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
            (Ok(before), Err(error)) => {
                return Err(format!("renaming `{old}` to `{new}` would break {user} ({before}): {error}"));
            }
            (Ok(before), Ok(after)) if before != after => {
                return Err(format!(
                    "renaming `{old}` to `{new}` would change the plan of {user}: expected {before}, found {after}"
                ));
            }
            // A graph that failed to build before, such as a part or one with an error, is not compared.
            _ => {}
        }
    }
    Ok(edits)
}

/// Builds each graph for a GPU and for a CPU. Returns, for each graph, a summary of its plans without names, or the
/// first error.
fn results(planner: &mut Planner, graphs: &[String]) -> Vec<Result<String, String>> {
    let build = |graph: &String| {
        let mut summaries = Vec::new();
        for lanes in LANES {
            let (facts, catalog) = nominal(lanes);
            let plan = planner.plan(graph, &[], &facts, &catalog).map_err(|errors| {
                let first = errors.found.first();
                first.map_or_else(String::new, |e| format!("{}:{}: {}", e.file, e.line, e.message))
            })?;
            let dependencies = plan.dependencies.len();
            let bytes: u64 = plan.resources.iter().map(|resource| resource.bytes()).sum();
            let values: Vec<String> = plan.params.iter().map(|param| param.value.to_string()).collect();
            summaries.push(format!(
                "{} passes, {dependencies} dependencies, {bytes} bytes, parameters {}",
                plan.passes.len(),
                values.join(" ")
            ));
        }
        summaries.dedup();
        Ok(summaries.join("; "))
    };
    graphs.iter().map(build).collect()
}
