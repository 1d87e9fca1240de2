//! Lists the graphs and shaders that are built into the program.
//!
//! The build script embeds every graph under `pipelines/` and every shader under `shaders/`, so that an installed
//! program needs no checkout. Files on disk take precedence (see [`SourceMap::find`]), so edits in a checkout take
//! effect immediately.

use crate::draw::facts;
use splatgraph_framework::ir::Request;
use splatgraph_framework::lower::{self, Control};
use splatgraph_framework::schema::Document;
use splatgraph_framework::schema::folded;
use splatgraph_framework::source::{Library, SourceMap, nearest};

/// Default of `--pipeline`: chooses a graph by the device's facts.
pub const DEFAULT_PIPELINE: &str = "auto";

/// Path (`pipelines/splat.ron`, `shaders/sort/scatter.comp`) and text of each file, sorted by path.
pub const FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/builtin.rs"));

/// Makes a source map of the files on disk and the built-in files.
pub fn source_map() -> SourceMap {
    SourceMap::new(Library { builtin: FILES, ..Library::default() })
}

/// Lists the names of the built-in graphs that draw a scene, sorted.
///
/// Excludes graphs without an output, and graphs in subfolders: parts, filters, and the program's own.
pub fn names() -> Vec<&'static str> {
    let graph = |(path, text): &(&'static str, &str)| {
        let name = path.strip_prefix("pipelines/")?.strip_suffix(".ron")?;
        (!name.contains('/') && draws(text)).then_some(name)
    };
    FILES.iter().filter_map(graph).collect()
}

fn draws(text: &str) -> bool {
    match Document::parse(text) {
        Ok(Document::Graph(graph)) => graph.output.is_some(),
        Ok(Document::Preset(_) | Document::Choice(_)) => true,
        // A graph with errors is listed: using it reports them.
        Err(_) => true,
    }
}

/// Returns the summary of a graph that draws a picture, from its file's text; `has errors` if the graph is invalid.
///
/// `None` for a graph without a picture, and for text that is not a graph.
pub fn drawn(text: &str) -> Option<String> {
    let code = text.lines().map(str::trim_start).find(|line| !line.is_empty() && !line.starts_with("//"))?;
    let is_graph = ["Graph", "Preset", "Choice"].iter().any(|kind| code.starts_with(kind));
    (is_graph && draws(text)).then(|| summary(".ron", text))
}

/// Lists the names of the built-in graphs that process the picture of another graph, sorted.
pub fn filters() -> Vec<&'static str> {
    let name = |(path, _): &(&'static str, &str)| {
        path.strip_prefix("pipelines/")?.strip_suffix(".ron").filter(|name| name.starts_with("filters/"))
    };
    FILES.iter().filter_map(name).collect()
}

/// Lists the names of the built-in graphs that declare an output named `output` besides the picture, sorted by path.
/// Presets and choices of these graphs are not listed.
pub fn giving(output: &str) -> Vec<&'static str> {
    let gives = |text: &str| matches!(Document::parse(text), Ok(Document::Graph(graph)) if graph.outputs.contains_key(output));
    let files = FILES.iter().filter(|(path, text)| path.starts_with("pipelines/") && gives(text));
    files.map(|(path, _)| name_of(path)).collect()
}

/// A built-in file, as lists show it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    /// Name in graphs and commands: `splat`, `parts/sort`, `sort/scatter.comp`.
    pub name: &'static str,
    /// Contents of the file.
    pub text: &'static str,
    /// The graph's summary, or the first sentence of the shader's comment. Empty if there is none; `has errors` for an
    /// invalid graph.
    pub summary: String,
}

/// Lists the built-in files in titled groups: graphs, filters, parts, the program's own graphs, and shaders.
pub fn groups() -> Vec<(&'static str, Vec<File>)> {
    let group_of = |path: &str| match path.split_once('/') {
        Some(("shaders", _)) => "Shaders",
        Some((_, name)) if !name.contains('/') => "Graphs",
        Some((_, name)) if name.starts_with("filters/") => "Filters",
        Some((_, name)) if name.starts_with("parts/") => "Parts",
        _ => "Graphs of the program itself",
    };
    let mut groups: Vec<(&str, Vec<File>)> =
        ["Graphs", "Filters", "Parts", "Graphs of the program itself", "Shaders"]
            .map(|title| (title, Vec::new()))
            .into();
    for (path, text) in FILES {
        let title = group_of(path);
        let file = File { name: name_of(path), text, summary: summary(path, text) };
        if let Some((_, files)) = groups.iter_mut().find(|(other, _)| *other == title) {
            files.push(file);
        }
    }
    groups
}

/// Finds a built-in file by its name, with or without the folder `pipelines/` or `shaders/` and the extension `.ron`.
///
/// # Errors
/// No file has the name. The error lists similar names, if there are any.
pub fn find(name: &str) -> Result<File, Vec<&'static str>> {
    let matches = |path: &'static str| {
        let inside = path.split_once('/').map_or(path, |(_, inside)| inside);
        [path, inside, name_of(path)].contains(&name) || path.strip_suffix(".ron") == Some(name)
    };
    if let Some((path, text)) = FILES.iter().find(|(path, _)| matches(path)) {
        return Ok(File { name: name_of(path), text, summary: summary(path, text) });
    }
    let last = |name: &'static str| name.rsplit('/').next().unwrap_or(name);
    let names = || FILES.iter().map(|(path, _)| name_of(path));
    let in_folders: Vec<&str> =
        names().filter(|other| last(other) == name.trim_end_matches(".ron")).collect();
    if !in_folders.is_empty() {
        return Err(in_folders);
    }
    let near = nearest(name, names()).or_else(|| {
        let near = nearest(name, names().map(last))?;
        names().find(|name| last(name) == near)
    });
    Err(near.and_then(|near| names().find(|name| *name == near)).into_iter().collect())
}

fn name_of(path: &'static str) -> &'static str {
    let inside = path.split_once('/').map_or(path, |(_, inside)| inside);
    inside.strip_suffix(".ron").unwrap_or(inside)
}

fn summary(path: &str, text: &str) -> String {
    if path.ends_with(".ron") {
        return match Document::parse(text) {
            Ok(Document::Graph(graph)) => folded(&graph.summary),
            Ok(Document::Preset(preset)) => folded(&preset.summary),
            Ok(Document::Choice(choice)) => folded(&choice.summary),
            Err(_) => "has errors".to_owned(),
        };
    }
    let comment = text.lines().skip_while(|line| !line.starts_with("//"));
    let comment: Vec<&str> = comment.map_while(|line| Some(line.strip_prefix("//")?.trim())).collect();
    let comment = comment.join(" ");
    comment.split_once(". ").map_or(comment.as_str(), |(first, _)| first).trim_end_matches('.').to_owned()
}

/// A built-in graph, as lists show it.
#[derive(Clone, Debug)]
pub struct Preset {
    /// Name for `--pipeline`.
    pub name: &'static str,
    /// Summary in one line.
    pub summary: String,
    /// Parameters, with their values for a nominal scene; empty if the graph has errors.
    pub params: Vec<Control>,
}

/// Lists the built-in graphs that draw a scene, sorted by name. A graph with errors has no parameters, and a summary
/// that says so.
pub fn presets() -> Vec<Preset> {
    let facts = facts::nominal(facts::USUAL_SUBGROUP_SIZE);
    let catalog = facts::nominal_catalog();
    let mut files = source_map();
    let mut preset = |name: &'static str| {
        let request = Request::new(name, &facts, &catalog);
        let (summary, params) = lower::controls(&request, &mut files)
            .unwrap_or_else(|_| (format!("has errors, see `splatgraph check {name}`"), Vec::new()));
        Preset { name, summary, params }
    };
    names().into_iter().map(&mut preset).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_found_by_its_name_with_or_without_folder_and_extension() {
        for name in ["parts/sort", "parts/sort.ron", "pipelines/parts/sort", "pipelines/parts/sort.ron"] {
            assert_eq!(find(name).map(|file| file.name), Ok("parts/sort"), "{name}");
        }
        for name in ["sort/scatter.comp", "shaders/sort/scatter.comp"] {
            assert_eq!(find(name).map(|file| file.name), Ok("sort/scatter.comp"), "{name}");
        }
        let found = find("splat.frag").expect("a shader");
        assert_eq!(
            found.summary,
            "Shades one splat at one pixel: the Gaussian's value times the opacity, premultiplied for blending"
        );
        assert!(found.text.starts_with("#version 460"), "{}", found.text);
    }

    #[test]
    fn a_file_that_is_not_there_has_near_names() {
        assert_eq!(find("splt"), Err(vec!["splat"]));
        assert_eq!(find("sort"), Err(vec!["parts/sort"]));
        assert_eq!(find("sort.ron"), Err(vec!["parts/sort"]));
        assert_eq!(find("depth_ordr"), Err(vec!["parts/depth_order"]));
        assert_eq!(find("histogram.cmp"), Err(vec!["sort/histogram.comp"]));
        assert_eq!(find("nothing like it"), Err(Vec::new()));
    }

    #[test]
    fn every_file_is_in_a_group_once_and_has_a_summary() {
        let groups = groups();
        let files: Vec<&File> = groups.iter().flat_map(|(_, files)| files).collect();
        assert_eq!(files.len(), FILES.len());
        for file in files {
            assert!(!file.summary.is_empty(), "{}", file.name);
            assert_eq!(find(file.name).as_ref(), Ok(file));
        }
        assert!(groups.iter().all(|(_, files)| !files.is_empty()), "{groups:?}");
    }

    #[test]
    fn graphs_that_draw_are_listed_and_their_includes_are_not() {
        let presets = presets();
        let names: Vec<&str> = presets.iter().map(|p| p.name).collect();
        for name in ["splat", "unsorted", "front_to_back", "digit4", "key16"] {
            assert!(names.contains(&name), "{name} is not among {names:?}");
        }
        assert!(!names.contains(&"sort"), "{names:?}");
        assert!(!names.iter().any(|name| name.contains("window")), "{names:?}");
        assert!(presets.iter().all(|p| !p.params.is_empty()), "{presets:?}");
    }
}
