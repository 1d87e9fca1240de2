//! From a graph's name to a plan.

use crate::builtin;
use splatgraph_framework::build;
use splatgraph_framework::ir::{Catalog, Facts, Request};
use splatgraph_framework::lower;
use splatgraph_framework::plan::{Param, Plan};
use splatgraph_framework::reload::Wanted;
use splatgraph_framework::shader::Glslang;
use splatgraph_framework::source::{Diagnostic, SourceMap, render};
use std::fmt;

/// Builds plans, and remembers the shaders that it compiled.
pub struct Planner {
    /// See [`Request::share_memory`].
    pub share_memory: bool,
    files: SourceMap,
    compiler: Glslang,
}

impl Default for Planner {
    fn default() -> Planner {
        Planner { share_memory: true, files: builtin::source_map(), compiler: Glslang::default() }
    }
}

impl Planner {
    /// The plan of `graph` (a preset's name or a path) with the parameters of `set` changed (the last of a name wins).
    pub fn plan(
        &mut self,
        graph: &str,
        set: &[(String, String)],
        facts: &Facts,
        catalog: &Catalog,
    ) -> Result<Plan, GraphErrors> {
        let request = Request { graph, set, facts, catalog, share_memory: self.share_memory };
        build(&request, &mut self.files, &mut self.compiler)
            .map_err(|found| GraphErrors::new(&self.files, &found))
    }

    /// The parameters that `graph` declares, with their defaults.
    pub fn params(
        &mut self,
        graph: &str,
        facts: &Facts,
        catalog: &Catalog,
    ) -> Result<Vec<Param>, GraphErrors> {
        let request = Request { graph, set: &[], facts, catalog, share_memory: self.share_memory };
        lower::params(&request, &mut self.files)
            .map(|(_, params)| params)
            .map_err(|found| GraphErrors::new(&self.files, &found))
    }

    /// Lets the next plan read its files anew. Shaders whose texts and constants are the same are not compiled again.
    pub fn forget_files(&mut self) {
        self.files = builtin::source_map();
    }

    /// What of the disk the plans since [`Planner::forget_files`] depend on.
    pub fn wanted(&self) -> Vec<Wanted> {
        self.files.wanted()
    }
}

/// What is wrong with a graph or its shaders, drawn under the text that it is about.
#[derive(Debug)]
pub struct GraphErrors {
    /// How many errors there are, at least one.
    pub count: usize,
    plain: String,
    coloured: String,
}

impl GraphErrors {
    fn new(files: &SourceMap, found: &[Diagnostic]) -> GraphErrors {
        GraphErrors {
            count: found.len(),
            plain: render(files, found, false),
            coloured: render(files, found, true),
        }
    }

    /// The errors, each with its place, ready to be printed.
    pub fn text(&self, colour: bool) -> &str {
        if colour { &self.coloured } else { &self.plain }
    }
}

impl fmt::Display for GraphErrors {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.plain.trim_end())
    }
}

impl std::error::Error for GraphErrors {}
