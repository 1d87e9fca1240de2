//! The dump for Graphviz: passes as boxes in the order they run, and between them what flows, with its barrier.

use super::Dump;
use super::text::barrier_line;

/// A DOT graph. Edges are barriers, from the passes that they wait for to the one that they stand before; dashed ones only keep
/// passes apart. Who reads what a barrier made visible to an earlier pass has no edge of its own.
pub fn dot(dump: &Dump) -> String {
    let quote = |s: &str| format!("\"{}\"", s.replace('\\', "\\\\").replace('"', "\\\""));
    let mut out = format!(
        "digraph {} {{\n  rankdir=TB;\n  node [shape=box, style=\"rounded,filled\", fontname=\"sans-serif\"];\n  edge [fontname=\"sans-serif\", fontsize=9];\n",
        quote(&dump.graph)
    );
    let mut phases: Vec<&str> = Vec::new();
    for pass in &dump.passes {
        if !phases.contains(&pass.phase.as_str()) {
            phases.push(&pass.phase);
        }
        let phase = phases.iter().position(|p| *p == pass.phase).unwrap_or(0);
        // Hues a golden angle apart are easily told from each other, however many there are.
        let hue = (phase as f64 * 0.381_966).fract();
        let detail = format!("{}\\n{} {}", pass.name, pass.kind, pass.size);
        out += &format!(
            "  {} [label={}, fillcolor=\"{hue:.3} 0.25 0.95\"];\n",
            quote(&pass.name),
            quote(&detail).replace("\\\\n", "\\n")
        );
    }
    for pass in &dump.passes {
        for barrier in &pass.barriers {
            for after in &barrier.after {
                let kept_apart = barrier.hazard != "ReadAfterWrite";
                let style = if kept_apart || barrier.across_frames { "dashed" } else { "solid" };
                // An edge from the frame before must not turn the picture upside down.
                let constraint = if barrier.across_frames { ", constraint=false" } else { "" };
                out += &format!(
                    "  {} -> {} [label={}, tooltip={}, style={style}{constraint}];\n",
                    quote(after),
                    quote(&pass.name),
                    quote(&barrier.resource),
                    quote(&barrier_line(barrier))
                );
            }
        }
    }
    out + "}\n"
}
