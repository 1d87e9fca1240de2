//! Lists the selectable graphs: the built-in graphs, and files that were used in this window.

use super::controls::Controls;
use super::widgets;
use crate::draw::builtin;
use crate::view::renderer::Renderer;
use egui::{RichText, Ui};
use std::path::Path;

#[derive(Clone, Debug)]
struct Entry {
    /// Name of a built-in graph, or path of a file.
    graph: String,
    summary: String,
}

/// The list of graphs, and its search text.
pub struct Presets {
    entries: Vec<Entry>,
    search: String,
}

impl Presets {
    pub fn new() -> Presets {
        let entry =
            |preset: builtin::Preset| Entry { graph: preset.name.to_owned(), summary: preset.summary };
        Presets { entries: builtin::presets().into_iter().map(entry).collect(), search: String::new() }
    }

    /// Draws the list; returns a chosen graph. With a search text, Enter chooses the best match.
    pub fn show(&mut self, ui: &mut Ui, renderer: &Renderer, controls: &mut Controls) -> Option<String> {
        self.remember(renderer);
        let mut chosen = None;
        let wanted = widgets::search_or_open(ui, &mut self.search, "graph_search", controls);
        let rank =
            |Entry { graph, summary }: &&Entry| widgets::rank(&wanted, &[graph, &file_name(graph)], summary);
        let row = |ui: &mut Ui, Entry { graph, summary }: &&Entry| {
            // Show only the last component: the tooltip has the whole path.
            let name = Path::new(graph).file_name().unwrap_or_default().to_string_lossy();
            let label = ui.horizontal(|ui| {
                let name = RichText::new(name).family(super::theme::strong());
                let response = ui.selectable_label(graph == renderer.graph(), name);
                ui.add(egui::Label::new(RichText::new(summary).weak()).truncate());
                response
            });
            (format!("preset:{graph}"), widgets::hint(label.inner, format!("{graph}\n{summary}")))
        };
        let height = (ui.ctx().content_rect().height() - 140.0).max(100.0);
        // By default, egui limits the height of a menu to 400 points.
        egui::ScrollArea::vertical().max_height(height).min_scrolled_height(height).show(ui, |ui| {
            let found = widgets::list(ui, controls, &wanted, &self.entries, rank, row);
            chosen = found.map(|entry| entry.graph.clone());
        });
        chosen
    }

    /// Adds the current graph, so that it can be selected again, and updates its summary.
    fn remember(&mut self, renderer: &Renderer) {
        let graph = renderer.graph();
        // While another graph is being built, the plan is still the previous graph's.
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

/// Returns the last component of a path, without its extension.
pub fn file_name(graph: &str) -> String {
    Path::new(graph).file_stem().map_or_else(|| graph.to_owned(), |stem| stem.to_string_lossy().into_owned())
}
