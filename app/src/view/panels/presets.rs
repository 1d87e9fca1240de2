//! Lists the selectable graphs: the built-in ones, and files that were used in this window.

use super::Controls;
use crate::builtin;
use crate::view::renderer::Renderer;
use egui::{RichText, Ui};
use indexmap::IndexMap;
use splatgraph_api::Device;
use std::path::Path;

/// A graph of the list.
#[derive(Clone, Debug)]
struct Entry {
    /// A built-in graph's name, or a path.
    graph: String,
    summary: String,
}

/// The list. Summaries of built-in graphs are read once, those of files come from their newest plans.
pub struct Presets {
    entries: Vec<Entry>,
}

impl Presets {
    pub fn new() -> Presets {
        let entry =
            |preset: builtin::Preset| Entry { graph: preset.name.to_owned(), summary: preset.summary };
        Presets { entries: builtin::presets().into_iter().map(entry).collect() }
    }

    /// Draws the list, and changes to the clicked graph.
    pub fn show<D: Device>(&mut self, ui: &mut Ui, renderer: &mut Renderer<D>, controls: &mut Controls) {
        self.remember(renderer);
        let mut chosen = None;
        for Entry { graph, summary } in &self.entries {
            let selected = graph == renderer.graph();
            // A built-in one's name has no folders, and a file's are below the pointer.
            let name = Path::new(graph).file_name().unwrap_or_default().to_string_lossy();
            let response = ui.selectable_label(selected, RichText::new(name).strong());
            controls.see(&format!("preset:{graph}"), response.rect);
            ui.add(egui::Label::new(RichText::new(summary).small().weak()).truncate());
            if response.on_hover_text(format!("{graph}\n{summary}")).clicked() && !selected {
                chosen = Some(graph.clone());
            }
        }
        if let Some(graph) = chosen {
            renderer.choose(&graph, IndexMap::new());
        }
    }

    /// Adds the current graph to the list, so that it can be selected again.
    fn remember<D: Device>(&mut self, renderer: &Renderer<D>) {
        let graph = renderer.graph();
        // While another graph is being built, the plan is still that of the one before.
        let summary = renderer.plan().filter(|plan| plan.name == graph).map(|plan| &plan.summary);
        match self.entries.iter_mut().find(|entry| entry.graph == graph) {
            None => {
                let summary = summary.cloned().unwrap_or_default();
                self.entries.push(Entry { graph: graph.to_owned(), summary });
            }
            Some(entry) => {
                if let Some(summary) = summary.filter(|summary| **summary != entry.summary) {
                    entry.summary.clone_from(summary);
                }
            }
        }
    }
}

/// Returns the last part of a path, without `.ron`.
pub fn file_name(graph: &str) -> String {
    Path::new(graph).file_stem().map_or_else(|| graph.to_owned(), |stem| stem.to_string_lossy().into_owned())
}
