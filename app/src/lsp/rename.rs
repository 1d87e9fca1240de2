//! Renames a declaration of a graph in all files. The graphs are first built with the new name, as a check.

use super::files::{self, LANES, nominal_case};
use super::index::{Form, Index, Place, capital};
use super::names::continues_name;
use crate::draw::fingerprint::code;
use crate::draw::planner::{GraphErrors, Planner};
use crate::draw::requirements;
use splatgraph_framework::ir::Pass;
use splatgraph_framework::plan::{Plan, Resource};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

pub type Edit = (std::ops::Range<usize>, String);

/// Lists the edits in each file that rename the name at a byte offset of a file.
///
/// `open` holds the editor's texts. They are restored in the planner after the check.
///
/// # Errors
/// No graph declares the name at the byte, the new name is not valid, the name occurs in a built-in file or in a graph
/// that cannot be parsed, or the new name would break a graph or change its plan.
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
    if let Some(place) = index.unparsed(&users, old) {
        return Err(format!("renaming `{old}` to `{new}` could miss uses: fix the error at {place} first"));
    }
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
                    before.iter().zip(&after).find_map(|(before, after)| change(before, after, (old, &new)))
                {
                    return Err(format!("renaming `{old}` to `{new}` would change {user}: {changed}"));
                }
            }
            // A graph that failed to build before, such as a part or one with an error, is not compared.
            (Err(_), _) => {}
        }
    }
    // The graphs were compared at the default settings. At others, an expression may choose the other meaning.
    if let Some(other) = index.other_meaning(path, offset, &changed, &new) {
        return Err(format!("renaming `{old}` to `{new}` could change a graph: {other}"));
    }
    Ok(edits)
}

/// Describes the first difference of two plans, apart from the new name; `None` if they are equivalent.
fn change(before: &Plan, after: &Plan, renamed: (&str, &str)) -> Option<String> {
    let expected = |what: &str, before: &str, after: &str| format!("expected {what} {before}, found {after}");
    let joined =
        |names: &mut dyn Iterator<Item = &String>| names.map(String::as_str).collect::<Vec<_>>().join(", ");
    let names = |plan: &Plan| {
        [
            ("the output", plan.resource(plan.output).name.clone()),
            ("the resources", joined(&mut plan.resources.iter().map(|resource| &resource.name))),
            ("the passes", joined(&mut plan.passes.iter().map(|pass| &pass.name))),
        ]
    };
    for ((what, before), (_, after)) in names(before).into_iter().zip(names(after)) {
        if !is_renamed(&before, &after, renamed) {
            return Some(expected(what, &before, &after));
        }
    }
    for (before, after) in before.shaders.iter().zip(&after.shaders) {
        if before.name != after.name {
            return Some(expected("the shader", &before.name, &after.name));
        }
        if code(&before.spirv) != code(&after.spirv) {
            // The usual cause: a variable, a function or a constant of the shader already has the new name.
            return Some(format!(
                "expected {} to compile to the same code, found other code; choose a name that the shader does not use",
                before.name
            ));
        }
    }
    // Resources and shaders are referred to by index.
    let resource = |resource: &Resource| {
        let Resource { name: _, shape, usage, source, block, history, origin: _ } = resource;
        format!("{:?}", (shape, usage, source, block, history.is_some()))
    };
    let mut resources = before.resources.iter().zip(&after.resources);
    if let Some((before, _)) = resources.find(|(before, after)| resource(before) != resource(after)) {
        return Some(format!("expected the resource {} to stay the same, found another", before.name));
    }
    let pass = |pass: &Pass| {
        // A pass without a phase has its name as its phase.
        let Pass { name: _, phase: _, run, work, bindings, push, uses, origin: _ } = pass;
        format!("{:?}", (run, work, bindings, push, uses))
    };
    let mut passes = before.passes.iter().zip(&after.passes);
    if let Some((before, _)) = passes.find(|(before, after)| pass(before) != pass(after)) {
        return Some(format!("expected the pass {} to use the same resources, found others", before.name));
    }
    let rest = |plan: &Plan| {
        let stats: Vec<_> = plan.stats.iter().map(|stat| (stat.buffer, stat.offset)).collect();
        let values: Vec<_> = plan.params.iter().map(|param| param.value.to_string()).collect();
        [
            ("the order", format!("{:?}", (&plan.prologue, &plan.frame, &plan.outputs, stats))),
            ("parameter values:", values.join(", ")),
        ]
    };
    let mut rest = rest(before).into_iter().zip(rest(after));
    rest.find_map(|((what, before), (_, after))| (before != after).then(|| expected(what, &before, &after)))
}

/// Returns true if `after` is `before` with some words `old` replaced by `new`, such as `s.old#0` and `s.new#0`.
fn is_renamed(before: &str, after: &str, (old, new): (&str, &str)) -> bool {
    let words = |text: &'_ str| text.split(|c| !continues_name(c)).map(str::to_owned).collect::<Vec<_>>();
    let (before, after) = (words(before), words(after));
    before.len() == after.len()
        && before.iter().zip(&after).all(|(before, after)| before == after || (before == old && after == new))
}

/// Builds each graph for a GPU and for a CPU. Graphs of a choice that neither draws are built, too. Returns the plans
/// of each graph, or the first error.
fn results(planner: &mut Planner, graphs: &[String]) -> Vec<Result<Vec<Plan>, String>> {
    let build = |graph: &String| {
        let first = |errors: GraphErrors| {
            let first = errors.found.first();
            first.map_or_else(String::new, |e| format!("{}:{}: {}", e.file, e.line, e.message))
        };
        let (catalog, cases) = (files::nominal_catalog(), LANES.map(nominal_case));
        let builds = requirements::builds(planner, graph, &cases, &catalog).map_err(first)?;
        let plans = builds.iter().filter_map(|build| build.plan(planner, graph, &[], &catalog).transpose());
        plans.map(|plan| plan.map_err(first)).collect()
    };
    graphs.iter().map(build).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::planner::testing;

    #[test]
    fn plans_with_other_bindings_or_another_output_differ_and_plans_with_the_new_name_do_not() {
        let folder = tempfile::tempdir().expect("a folder");
        let image = |number: usize, name: &str| {
            format!("layout(rgba8, set = 0, binding = {number}) uniform image2D {name};\n")
        };
        let shader = |images: &[&str], code: &str| {
            let images: String =
                images.iter().enumerate().map(|(number, name)| image(number, name)).collect();
            format!(
                "#version 460\nlayout(local_size_x = 8, local_size_y = 8) in;\n{images}void main() {{ {code} }}\n"
            )
        };
        let paint = shader(&["to"], "imageStore(to, ivec2(0), vec4(1));");
        let add = "imageStore(to, ivec2(0), imageLoad(one, ivec2(0)) - imageLoad(other, ivec2(0)));";
        for (name, text) in [("paint.comp", paint), ("add.comp", shader(&["one", "other", "to"], add))] {
            std::fs::write(folder.path().join(name), text).expect("writable");
        }
        let built = |[a, b, c]: [&str; 3], (one, other): (&str, &str), output: &str| {
            let image = |name: &str| format!("\"{name}\": Image(format: \"rgba8\", size: (8, 8))");
            let pass = |name: &str, shader: &str, bind: &str| {
                format!(
                    "Dispatch(name: \"{name}\", shader: \"{shader}\", size: Threads(8, 8), bind: {{ {bind} }})"
                )
            };
            let text = format!(
                "Graph(version: 1, summary: \"\", resources: {{ {}, {}, {} }}, passes: [{}, {}, {}], output: \"{output}\")",
                image(a),
                image(b),
                image(c),
                pass("p0", "paint.comp", &format!("\"to\": \"{a}\"")),
                pass("p1", "paint.comp", &format!("\"to\": \"{b}\"")),
                pass(
                    "p2",
                    "add.comp",
                    &format!("\"one\": \"{one}\", \"other\": \"{other}\", \"to\": \"{c}\"")
                ),
            );
            let path = folder.path().join("graph.ron");
            std::fs::write(&path, text).expect("writable");
            testing::plan(&path.display().to_string(), &[], 8)
        };
        let names = ["a", "b", "c"];
        let before = built(names, ("a", "b"), "c");
        let change = |after: Plan| change(&before, &after, ("b", "d"));
        assert_eq!(change(built(["a", "d", "c"], ("a", "d"), "c")), None);
        let other = "expected the pass p2 to use the same resources, found others";
        assert_eq!(change(built(names, ("b", "a"), "c")).as_deref(), Some(other));
        assert_eq!(change(built(names, ("a", "b"), "a")).as_deref(), Some("expected the output c, found a"));
    }
}
