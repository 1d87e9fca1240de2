//! Lists the selectable graphs: the built-in graphs, files that were used in this window, and files in folders. The
//! folders are those where `-p` and the current graph look for graphs.

use super::theme;
use super::widgets::{self, Control as _};
use crate::draw::builtin;
use crate::view::renderer::Renderer;
use egui::{FontId, RichText, Ui};
use splatgraph_framework::source::canonical;
use std::collections::HashMap;
use std::ffi::OsString;
use std::fs;
use std::path::Path;

/// Maximum number of `.ron` files of a folder that are looked at.
const MAX_LISTED: usize = 1000;
/// Maximum width of a graph's name in the list, in points.
const MAX_WIDTH: f32 = 320.0;
/// Maximum size of a file that may be a graph, in bytes.
const MAX_BYTES: u64 = 1 << 20;

#[derive(Clone, Debug)]
struct Entry {
    /// Name of a built-in graph, or path of a file.
    graph: String,
    summary: String,
}

/// The list of graphs, and its search text.
pub struct Presets {
    entries: Vec<Entry>,
    /// Files that were found when the list was opened.
    found: Vec<Entry>,
    /// Number of egui's pass that drew the list last.
    drawn: u64,
    search: String,
}

impl Default for Presets {
    fn default() -> Presets {
        let entry =
            |preset: builtin::Preset| Entry { graph: preset.name.to_owned(), summary: preset.summary };
        let entries = builtin::presets().into_iter().map(entry).collect();
        Presets { entries, found: Vec::new(), drawn: 0, search: String::new() }
    }
}

impl Presets {
    /// Draws the list; returns the graph that the user chose. With a search text, Enter chooses the best match.
    pub fn show(&mut self, ui: &mut Ui, renderer: &Renderer) -> Option<String> {
        self.remember(renderer);
        let pass = ui.ctx().cumulative_pass_nr();
        if std::mem::replace(&mut self.drawn, pass) + 1 < pass {
            self.found = self.look(Path::new("."), renderer.graph());
        }
        let rank = |Entry { graph, summary }: &&Entry, wanted: &str| {
            widgets::rank(wanted, &[graph, &file_name(graph)], summary)
        };
        let is_current = |Entry { graph, .. }: &&Entry| graph == renderer.graph();
        let entries = self.entries.iter().chain(&self.found);
        let names = names(entries.clone().map(|entry| entry.graph.as_str()));
        let font = FontId::new(theme::TEXT, theme::strong());
        let row = |ui: &mut Ui, Entry { graph, summary }: &&Entry| {
            // The tooltip has the whole path.
            let name = widgets::ending(ui, &font, ["", &names[graph.as_str()], ""], MAX_WIDTH);
            let label = ui.horizontal(|ui| {
                let name = RichText::new(name).family(theme::strong());
                let response = ui.selectable_label(graph == renderer.graph(), name);
                ui.add(egui::Label::new(RichText::new(summary).weak()).truncate());
                response
            });
            (format!("preset:{graph}"), label.inner.hint(format!("{graph}\n{summary}")))
        };
        let chosen =
            widgets::list(ui, (&mut self.search, "graph_search", true), entries, rank, is_current, row)?;
        Some(chosen.graph.clone())
    }

    /// Lists the graphs in the working directory `root`, in its folder `pipelines`, and beside the current graph.
    /// Omits each file that the name of a listed graph refers to.
    fn look(&self, root: &Path, current: &str) -> Vec<Entry> {
        let folders = [Path::new(""), Path::new("pipelines")];
        let place = |folder: &Path| canonical(&root.join(folder));
        let is_other = |beside: &&Path| folders.iter().all(|folder| place(folder) != place(beside));
        let beside = Path::new(current).parent().filter(is_other);
        let mut found: Vec<Entry> = Vec::new();
        for folder in folders.into_iter().chain(beside) {
            let Ok(files) = fs::read_dir(root.join(folder)) else { continue };
            let is_graph = |name: &OsString| Path::new(name).extension().is_some_and(|end| end == "ron");
            let names = files.flatten().map(|file| file.file_name()).filter(is_graph);
            let mut names: Vec<_> = names.take(MAX_LISTED).collect();
            names.sort();
            for name in &names {
                let path = folder.join(name);
                let graph = path.to_string_lossy().into_owned();
                // `mine` names `mine.ron`, and `pipelines/mine.ron` if there is no `mine.ron`.
                let is_near = folder == Path::new("pipelines") && !root.join(name).exists();
                let means = |other: &str| {
                    let other = other.strip_suffix(".ron").unwrap_or(other);
                    graph.strip_suffix(".ron") == Some(other) || is_near && file_name(&graph) == other
                };
                if self.entries.iter().chain(&found).any(|entry| means(&entry.graph)) {
                    continue;
                }
                let path = root.join(path);
                // Not a FIFO, which would block.
                if fs::metadata(&path).is_ok_and(|data| data.is_file() && data.len() <= MAX_BYTES)
                    && let Ok(text) = fs::read_to_string(&path)
                    && let Some(summary) = builtin::drawn(&text)
                {
                    found.push(Entry { graph, summary });
                }
            }
        }
        found
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

/// Returns the name of each graph in the list. It is the last component of the path, or the whole path if another graph
/// has the same last component.
fn names<'a>(graphs: impl Iterator<Item = &'a str>) -> HashMap<&'a str, String> {
    let mut equal: HashMap<String, Vec<&str>> = HashMap::new();
    for graph in graphs {
        let name = Path::new(graph).file_name().unwrap_or_default().to_string_lossy();
        equal.entry(name.into_owned()).or_default().push(graph);
    }
    let named = |(name, graphs): (String, Vec<&'a str>)| match graphs[..] {
        [graph] => vec![(graph, name)],
        _ => graphs.into_iter().map(|graph| (graph, graph.to_owned())).collect(),
    };
    equal.into_iter().flat_map(named).collect()
}

/// Returns the last component of a path, without its extension.
pub fn file_name(graph: &str) -> String {
    Path::new(graph).file_stem().map_or_else(|| graph.to_owned(), |stem| stem.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn graphs_of_the_same_file_name_are_listed_with_their_folders() {
        let graphs = ["splat", "a.ron", "pipelines/a.ron", "/home/me/b.ron"];
        let names = names(graphs.into_iter());
        assert_eq!(graphs.map(|graph| names[graph].as_str()), ["splat", "a.ron", "pipelines/a.ron", "b.ron"]);
    }

    #[test]
    fn graphs_in_the_folders_of_names_and_beside_the_current_graph_are_listed() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        let preset = "// A comment.\nPreset(graph: \"splat\", summary: \"Mine\", set: {})";
        for name in
            ["a.ron", "splat.ron", "pipelines/a.ron", "pipelines/b.ron", "pipelines/splat.ron", "c/d.ron"]
        {
            write(name, preset);
        }
        write("broken.ron", "Graph(");
        write("part.ron", "Graph(version: 1, summary: \"A part\", passes: [])");
        write("scenes.ron", "Scenes([Scene(file: \"a.ply\")])");
        write("a.txt", preset);
        let mut presets = Presets::default();
        let listed = |presets: &Presets| -> Vec<String> {
            let found = presets.look(folder.path(), "c/e.ron").into_iter();
            found.map(|Entry { graph, summary }| format!("{graph}: {summary}")).collect()
        };
        // `splat` and `a` mean files of the folder itself, so those of `pipelines` are other graphs.
        let all = [
            "a.ron: Mine",
            "broken.ron: has errors",
            "pipelines/a.ron: Mine",
            "pipelines/b.ron: Mine",
            "pipelines/splat.ron: Mine",
            "c/d.ron: Mine",
        ];
        assert_eq!(listed(&presets), all);
        // Graphs that were used by their names.
        for graph in ["a", "b"] {
            presets.entries.push(Entry { graph: graph.to_owned(), summary: String::new() });
        }
        assert_eq!(listed(&presets), [all[1], all[2], all[4], all[5]]);
    }
}
