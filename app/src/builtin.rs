//! Lists the graphs and shaders that are built into the program.
//!
//! The build script embeds everything under `pipelines/` and `shaders/`, so that an installed program needs no checkout.
//! Files on disk come first (see [`SourceMap::find`]), so in a checkout edits show at once.

use crate::facts::{self, SceneFacts};
use splatgraph_framework::ir::Request;
use splatgraph_framework::lower::{self, Control};
use splatgraph_framework::schema::Document;
use splatgraph_framework::source::{Library, SourceMap};

/// Path (`pipelines/splat.ron`, `shaders/sort/scatter.comp`) and text of each file, sorted by path.
pub const FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/builtin.rs"));

/// Makes a source map of the files on disk and the built-in ones.
pub fn source_map() -> SourceMap {
    SourceMap::new(Library { builtin: FILES, ..Library::default() })
}

/// Lists the names of the built-in graphs that draw a scene, sorted.
///
/// Graphs for includes have no output and are left out, and so are those in subfolders, which draw for the program itself.
pub fn names() -> Vec<&'static str> {
    let draws = |text: &str| match Document::parse(text) {
        Ok(Document::Graph(graph)) => graph.output.is_some(),
        Ok(Document::Preset(_) | Document::Choice(_)) => true,
        // It is listed, and its use reports the error.
        Err(_) => true,
    };
    let graph = |(path, text): &(&'static str, &str)| {
        let name = path.strip_prefix("pipelines/")?.strip_suffix(".ron")?;
        (!name.contains('/') && draws(text)).then_some(name)
    };
    FILES.iter().filter_map(graph).collect()
}

/// A built-in graph, for lists.
#[derive(Clone, Debug)]
pub struct Preset {
    /// The name, as `--pipeline` takes it.
    pub name: &'static str,
    /// A description in one line.
    pub summary: String,
    /// The parameters, with their values for a nominal scene.
    pub params: Vec<Control>,
}

/// Lists the built-in graphs that draw a scene, sorted by name.
pub fn presets() -> Vec<Preset> {
    let device = facts::portable_device(facts::USUAL_SUBGROUP_SIZE);
    let facts = facts::facts(&SceneFacts::NOMINAL, &device, facts::DEFAULT_SIZE);
    let catalog = facts::nominal_catalog();
    let mut files = source_map();
    let mut preset = |name: &'static str| {
        let request = Request {
            graph: name,
            set: &[],
            grown: &[],
            facts: &facts,
            catalog: &catalog,
            share_memory: true,
        };
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
