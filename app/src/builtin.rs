//! The graphs and shaders that are part of the program.
//!
//! The build script embeds everything under `pipelines/` and `shaders/`, so that an installed program needs no checkout.
//! Files on disk come first (see [`SourceMap::find`]), so in a checkout edits show at once.

use crate::facts::{self, SceneFacts};
use splatgraph_framework::build::Request;
use splatgraph_framework::lower;
use splatgraph_framework::plan::Param;
use splatgraph_framework::source::{Library, SourceMap};

/// Path (`pipelines/splat.ron`, `shaders/sort/scatter.comp`) and text, sorted by path.
pub const FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/builtin.rs"));

/// A source map that finds files on disk and the built-in ones.
pub fn source_map() -> SourceMap {
    SourceMap::new(Library { builtin: FILES, ..Library::default() })
}

/// A built-in graph that can be rendered by name.
#[derive(Clone, Debug)]
pub struct Preset {
    /// What `--pipeline` takes.
    pub name: String,
    /// One line that says what it does.
    pub summary: String,
    /// Its parameters, with the values for a nominal scene.
    pub params: Vec<Param>,
}

/// The built-in graphs that draw something, sorted by name. Graphs made to be included have no output and are not listed.
pub fn presets() -> Vec<Preset> {
    let facts = facts::facts(&SceneFacts::NOMINAL, &facts::portable_device(), facts::DEFAULT_SIZE);
    let catalog = facts::nominal_catalog();
    let mut presets = Vec::new();
    for (path, text) in FILES {
        let name = path.strip_prefix("pipelines/").and_then(|name| name.strip_suffix(".ron"));
        let Some(name) = name.filter(|name| !name.contains('/')) else { continue };
        // A map of nothing but this library: what lies in the current folder must not change the list.
        let mut files = source_map();
        files.add(*path, *text);
        let request = Request { graph: name, set: &[], facts: &facts, catalog: &catalog };
        if let Ok(flat) = lower::lower(&request, &mut files) {
            presets.push(Preset { name: name.to_owned(), summary: flat.summary, params: flat.params });
        }
    }
    presets
}
