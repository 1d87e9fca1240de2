//! Makes inlay hints: the passes that each pass of a graph file waits for, and the value of each `let`.

use super::files::canonical;
use super::text;
use lsp_types::{InlayHint, InlayHintLabel, InlayHintTooltip, Position};
use splatgraph_framework::dump::{self, Dump, DumpPass};
use splatgraph_framework::plan::Since;
use std::collections::BTreeMap;
use std::path::Path;

/// Lists a hint for each declared pass that waits for other passes or a layout transition. The hint is at the end of
/// the first line of the declaration. `dumps` are the plans that may contain passes of the file, and `path` is
/// canonical. The first plan that contains a pass determines its hint.
pub fn waits(path: &Path, text: &str, dumps: &[&Dump]) -> Vec<InlayHint> {
    // Passes that the framework adds, such as the export, have no line of their own in the file.
    let is_written = |pass: &DumpPass| !["start", "export", "host"].contains(&pass.kind.as_str());
    let is_here = |pass: &&DumpPass| is_written(pass) && canonical(Path::new(&pass.declared.file)) == path;
    // Passes by line and column of their declaration. A `Repeat` makes several passes of one declaration.
    let mut found: BTreeMap<(u32, u32), Vec<&DumpPass>> = BTreeMap::new();
    for dump in dumps {
        let mut of_plan: BTreeMap<(u32, u32), Vec<&DumpPass>> = BTreeMap::new();
        for pass in dump.passes.iter().filter(is_here) {
            of_plan.entry((pass.declared.line, pass.declared.column)).or_default().push(pass);
        }
        for (declared, passes) in of_plan {
            found.entry(declared).or_insert(passes);
        }
    }
    let of_passes = |((line, _), passes): ((u32, u32), Vec<&DumpPass>)| {
        let waits = |pass: &&&DumpPass| !pass.dependencies.is_empty() || !pass.barriers.is_empty();
        let waiting: Vec<&&DumpPass> = passes.iter().filter(waits).collect();
        let first = waiting.iter().find(|pass| !pass.barriers.is_empty()).or(waiting.first())?;
        let mut label = format!("waits for {}", after(first).join(", "));
        if first.barriers.is_empty() {
            // An earlier barrier covers the dependencies.
            label += " (no barrier here)";
        }
        if passes.len() > 1 {
            label += &format!(" ({} of {} iterations wait)", waiting.len(), passes.len());
        }
        let mut lines = Vec::new();
        for barrier in &first.barriers {
            lines.push(dump::barrier_line(barrier));
            lines.extend(barrier.dependencies.iter().map(|d| dump::cause_line(barrier, d)));
        }
        if lines.is_empty() {
            lines.extend(first.dependencies.iter().map(dump::dependency_line));
        }
        let width = text.lines().nth(line as usize - 1)?.encode_utf16().count() as u32;
        let position = Position { line: line - 1, character: width };
        Some(hint(position, label, Some(format!("{}\n{}", first.name, lines.join("\n")))))
    };
    found.into_iter().filter_map(of_passes).collect()
}

fn hint(position: Position, label: String, tooltip: Option<String>) -> InlayHint {
    InlayHint {
        position,
        label: InlayHintLabel::String(label),
        kind: None,
        text_edits: None,
        tooltip: tooltip.map(InlayHintTooltip::String),
        padding_left: Some(true),
        padding_right: None,
        data: None,
    }
}

/// Lists the passes that a pass waits for; without any, the layout transitions before it.
fn after(pass: &DumpPass) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for dependency in &pass.dependencies {
        let when = match dependency.since {
            Since::Same => "",
            Since::Prologue => " of the prologue",
            Since::PreviousFrame => " of the previous frame",
        };
        let name = format!("{}{when}", dependency.first.name);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    if names.is_empty() {
        let images = pass.barriers.iter().filter_map(|barrier| barrier.image.as_ref());
        names.extend(images.map(|transition| format!("a layout transition of {}", transition.image)));
    }
    names
}

pub fn within(hints: Vec<InlayHint>, first: u32, last: u32) -> Vec<InlayHint> {
    hints.into_iter().filter(|hint| (first..=last).contains(&hint.position.line)).collect()
}

/// Makes a hint for each value of a `let`. The hint follows the expression, at the given byte offset.
pub fn values(text: &str, lets: impl Iterator<Item = (usize, String)>) -> Vec<InlayHint> {
    lets.map(|(end, value)| hint(text::position_of(text, end), format!("= {value}"), None)).collect()
}
