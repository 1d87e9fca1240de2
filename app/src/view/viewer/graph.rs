//! Selects graphs, and carries parameter settings over to the new graph.

use super::Viewer;
use crate::draw::builtin;
use crate::view::events::{Event, RendererId};
use indexmap::IndexMap;
use splatgraph_framework::schema::Document;
use splatgraph_framework::source::Kind;

/// Maximum length of a chain of presets; a longer chain may be a cycle.
const MAX_PRESETS: usize = 8;

impl Viewer {
    /// Draws a viewport with another graph. Parameters keep their settings, except parameters that a preset `graph`
    /// sets itself: their settings are dropped and reported. The renderer sets aside, and reports, settings that the
    /// graph rejects.
    pub fn choose_graph(&mut self, id: RendererId, graph: &str) {
        let Some(viewport) = self.viewport(id) else { return };
        let renderer = &mut viewport.renderer;
        let own = preset_settings(graph);
        let (kept, dropped): (IndexMap<_, _>, IndexMap<_, _>) =
            renderer.set().clone().into_iter().partition(|(name, _)| !own.contains(name));
        renderer.choose(graph, kept);
        if !dropped.is_empty() {
            let values: Vec<String> = dropped.iter().map(|(name, value)| format!("{name}={value}")).collect();
            let text = format!("{} is dropped: this graph sets it itself", values.join(", "));
            self.report(Event::Dropped { renderer: id, parameters: dropped.into_keys().collect(), text });
        }
    }
}

/// Lists the parameters set by a preset and by the presets that it is based on; empty for other graphs.
fn preset_settings(graph: &str) -> Vec<String> {
    let mut files = builtin::source_map();
    let (mut names, mut graph, mut from) = (Vec::new(), graph.to_owned(), None);
    for _ in 0..MAX_PRESETS {
        let Ok(file) = files.find(from, &graph, Kind::Graph) else { break };
        let Ok(Document::Preset(preset)) = Document::parse(files.text(file)) else { break };
        names.extend(preset.set.into_keys());
        (graph, from) = (preset.graph, Some(file));
    }
    names
}
