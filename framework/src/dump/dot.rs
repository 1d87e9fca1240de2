//! Formats a dump for Graphviz: passes as boxes in execution order, and edges for their dependencies.

use super::form::{Declared, Dump, DumpCause, DumpPass};
use super::text::dependency_line;
use crate::ir::Hazard;
use crate::plan::{Cause, Dependency, Since};
use indexmap::{IndexMap, IndexSet};
use std::collections::HashMap;

type Edge = Dependency<Declared, Declared>;

/// Formats a dump as a DOT graph.
///
/// Edges are the dependencies of passes, from the earlier pass to the later one. An edge is solid for reads after
/// writes, and dashed for other hazards and for dependencies on the previous frame. Its tooltip names the barriers that
/// were placed for it.
pub fn dot(dump: &Dump) -> String {
    let mut out = format!(
        "digraph {} {{\n  rankdir=TB;\n  node [shape=box, style=\"rounded,filled\", fontname=\"sans-serif\"];\n  edge [fontname=\"sans-serif\", fontsize=9];\n",
        quote(&dump.graph)
    );
    let mut phases: HashMap<&str, usize> = HashMap::new();
    for pass in &dump.passes {
        let next = phases.len();
        let phase = *phases.entry(&pass.phase).or_insert(next);
        // Hues at multiples of the golden angle stay distinct for any count.
        let hue = (phase as f64 * 0.381_966).fract();
        let mut lines = vec![pass.name.clone(), format!("{} {}", pass.kind, pass.size).trim_end().into()];
        lines.extend(pass.gpu_ms.map(|ms| format!("{ms:.3} ms")));
        out += &format!(
            "  {} [label={}, fillcolor=\"{hue:.3} 0.25 0.95\"];\n",
            quote(&pass.name),
            quote(&lines.join("\n"))
        );
    }
    for pass in &dump.passes {
        write_edges(&mut out, dump, pass);
    }
    out + "}\n"
}

fn write_edges(out: &mut String, dump: &Dump, pass: &DumpPass) {
    let mut edges: IndexMap<(&str, Since, bool), Vec<&Edge>> = IndexMap::new();
    for dependency in &pass.dependencies {
        let is_read = dependency.hazard == Hazard::ReadAfterWrite;
        edges.entry((&dependency.first.name, dependency.since, is_read)).or_default().push(dependency);
    }
    for ((first, since, is_read), dependencies) in edges {
        let previous_frame = since == Since::PreviousFrame;
        let style = if is_read && !previous_frame { "solid" } else { "dashed" };
        // An edge from the previous frame must not reverse the layout.
        let constraint = if previous_frame { ", constraint=false" } else { "" };
        let names: IndexSet<&str> = dependencies.iter().map(|d| d.resource.name.as_str()).collect();
        let label = names.into_iter().collect::<Vec<_>>().join("\n");
        let lines = dependencies.iter().map(|dependency| tip(dump, pass, dependency));
        *out += &format!(
            "  {} -> {} [label={}, tooltip={}, style={style}{constraint}];\n",
            quote(first),
            quote(&pass.name),
            quote(&label),
            quote(&lines.collect::<Vec<_>>().join("\n"))
        );
    }
}

/// Formats a dependency, with the barriers that name it as a reason; none if an earlier barrier already covers it.
fn tip(dump: &Dump, pass: &DumpPass, dependency: &Edge) -> String {
    let is_reason = |cause: &DumpCause| {
        let Cause { before, resource, hazard, after, .. } = &cause.conflict;
        (&before.name, &resource.name, *hazard) == (&pass.name, &dependency.resource.name, dependency.hazard)
            && after.iter().any(|after| after.name == dependency.first.name)
    };
    let barriers = dump.barriers().filter(|barrier| barrier.dependencies.iter().any(is_reason));
    let barriers = barriers.map(|barrier| format!("barrier {}: ", barrier.id));
    format!("{}{}", barriers.collect::<String>(), dependency_line(dependency))
}

/// Quotes a DOT string. Line breaks become `\n`, which labels display as line breaks.
fn quote(s: &str) -> String {
    format!("\"{}\"", s.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n"))
}
