//! Formats a dump for Graphviz: passes as boxes in execution order, and edges for the dependencies of barriers.

use super::form::{Dump, DumpBarrier};
use super::text::{cause_line, subject};
use crate::ir::Hazard;
use std::collections::HashMap;

/// Formats a dump as a DOT graph.
///
/// Edges are the dependencies of barriers, from the earlier passes to the waiting pass. An edge is solid for a read
/// after write, and dashed for other hazards and for hazards from the previous frame. A read of data that an earlier
/// barrier made visible has no edge.
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
    for barrier in dump.barriers() {
        write_edges(&mut out, barrier);
    }
    out + "}\n"
}

fn write_edges(out: &mut String, barrier: &DumpBarrier) {
    for cause in &barrier.dependencies {
        let conflict = &cause.conflict;
        for after in &conflict.after {
            let kept_apart = conflict.hazard != Hazard::ReadAfterWrite;
            let style = if kept_apart || conflict.previous_frame { "dashed" } else { "solid" };
            // An edge from the previous frame must not reverse the layout.
            let constraint = if conflict.previous_frame { ", constraint=false" } else { "" };
            let tip = format!("barrier {} {}\n{}", barrier.id, subject(barrier), cause_line(barrier, cause));
            *out += &format!(
                "  {} -> {} [label={}, tooltip={}, style={style}{constraint}];\n",
                quote(&after.name),
                quote(&conflict.before.name),
                quote(&conflict.resource.name),
                quote(&tip)
            );
        }
    }
}

/// Quotes a DOT string. Line breaks become `\n`, which labels display as line breaks.
fn quote(s: &str) -> String {
    format!("\"{}\"", s.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n"))
}
