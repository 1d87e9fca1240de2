//! Includes: lowers another graph's passes with the includer's resources and parameters.

use indexmap::IndexMap;
use std::rc::Rc;

use super::LoweredInclude;
use super::document::{self, MAX_DEPTH, Opened};
use super::params;
use super::passes::{Level, Lowering};
use super::resources::Handle;
use super::scope::{Names, Place};
use crate::ir::Param;
use crate::schema::{Graph, Number, ParamDecl, Reference};
use crate::source::{Diagnostic, Kind, Path};

impl Lowering<'_> {
    pub(super) fn include(
        &mut self,
        level: &mut Level,
        graph: &str,
        name: &str,
        with: &IndexMap<String, Reference>,
        set: &IndexMap<String, Number>,
        place: &Place,
    ) -> Result<(), Diagnostic> {
        let decided = level.names.take_notes().decided;
        let graph_place = place.field("graph");
        let file =
            self.files.find(Some(level.file), graph, Kind::Graph).map_err(|e| e.at(graph_place.span()))?;
        if self.includes.contains(&file) {
            return Err(graph_place
                .error("these graphs include each other", "leads back to a graph that includes this one"));
        }
        if self.includes.len() > MAX_DEPTH {
            return Err(graph_place
                .error(format!("includes are nested deeper than {MAX_DEPTH}"), "the limit is passed here"));
        }
        let opened = match self.opened.get(&file) {
            Some(opened) => opened.clone(),
            None => match document::follow(self.files, file) {
                Ok(opened) => self.opened.entry(file).or_insert(Rc::new(opened)).clone(),
                Err(errors) => {
                    self.errors.extend(errors);
                    return Ok(());
                }
            },
        };
        let Graph { params, lets, imports, resources, .. } = &*opened.graph;
        if !self.count(params.len() + lets.len() + imports.len() + resources.len(), place) {
            return Ok(());
        }
        let (names, params) = self.include_params(level, &opened, set, place)?;
        let full = format!("{}{name}{}", level.prefix, level.suffix);
        let span = place.field("name").span();
        if let Some(first) = self.include_names.insert(full.clone(), span) {
            let message = format!("two includes are called `{full}`");
            return Err(Diagnostic::new(message, span, "the second").with_label(first, "the first"));
        }
        let prefix = format!("{full}.");
        let before = self.errors.len();
        let mut inner = self.level(&opened, names, &params, prefix);
        let mut include = LoweredInclude { name: full, span, parent: level.include, given: Vec::new() };
        for (port_name, port) in &opened.graph.ports {
            let Some(given) = with.get(port_name) else {
                let span = opened.outline.key(&Path::root().field("ports").key(port_name));
                return Err(Diagnostic::new(
                    format!("nothing is given for the port `{port_name}`"),
                    place.field("with").span(),
                    "missing here",
                )
                .with_label(span, "the port"));
            };
            let at = place.field("with").field(port_name);
            let handle = match level.handles.get(&given.text) {
                Some(handle) => handle.clone(),
                None => {
                    self.look_up(level, given, &at)?;
                    return Err(at.error("a port takes a whole resource", "not the front or the back of one"));
                }
            };
            let resources = match &handle {
                Some(Handle::PingPong(index)) => self.ping_pongs[*index].halves.to_vec(),
                Some(Handle::Plain(ids)) => ids.clone(),
                None => Vec::new(),
            };
            include.given.push((given.text.clone(), resources));
            let stride =
                Place::new(&opened.outline, Path::root().field("ports").key(port_name)).field("stride");
            let handle = match handle {
                Some(handle) => Some(self.port(port_name, port, handle, &inner.names, &stride, &at)?),
                None => None,
            };
            inner.handles.insert(port_name.clone(), handle);
        }
        if let Some(unknown) = with.keys().find(|k| !opened.graph.ports.contains_key(*k)) {
            let at = place.field("with").field(unknown);
            let diagnostic =
                Diagnostic::new(format!("`{graph}` has no port `{unknown}`"), at.key(), "given here");
            let ports = opened.graph.ports.keys().map(String::as_str);
            return Err(diagnostic.with_nearest(unknown, ports, ""));
        }
        for field in ["output", "stats"] {
            let set = if field == "output" {
                opened.graph.output.is_some()
            } else {
                !opened.graph.stats.is_empty()
            };
            if set {
                let span = opened.outline.key(&Path::root().field(field));
                return Err(Diagnostic::new(
                    format!("an included graph has no `{field}` of its own"),
                    span,
                    "declared here",
                )
                .with_label(graph_place.span(), "included here"));
            }
        }
        if let Some(requirement) = opened.require.first() {
            let span = requirement.outline.value(&requirement.path);
            return Err(Diagnostic::new(
                "an included graph has no `require` of its own",
                span,
                "declared here",
            )
            .with_label(graph_place.span(), "included here")
            .with_help("state it in the graph that includes this one, with a `fallback` for all of it"));
        }
        inner.include = Some(self.included.len());
        inner.around = level.around.iter().copied().chain(decided).collect();
        self.included.push(include);
        self.declare(&mut inner);
        if self.errors.len() > before {
            return Ok(());
        }
        self.includes.push(file);
        let passes = Place::new(&opened.outline, Path::root().field("passes"));
        self.walk(&mut inner, &opened.graph.passes, &passes);
        self.includes.pop();
        Ok(())
    }

    /// The parameters of an included graph: from `set`, in the includer's names, over its own defaults.
    fn include_params(
        &self,
        level: &Level,
        opened: &Opened,
        set: &IndexMap<String, Number>,
        place: &Place,
    ) -> Result<(Names, Vec<Param>), Diagnostic> {
        let graph = &opened.graph;
        if let Some((name, setting)) = opened.set.iter().find(|(k, _)| !graph.params.contains_key(*k)) {
            return Err(params::unknown(name, setting.outline.key(&setting.path), graph));
        }
        if let Some(name) = set.keys().find(|k| !graph.params.contains_key(*k)) {
            return Err(params::unknown(name, place.field("set").field(name).key(), graph));
        }
        let mut names = Names::of(self.request.facts);
        let mut params = Vec::new();
        for (name, declaration) in &opened.graph.params {
            let at = Place::new(&opened.outline, Path::root().field("params").key(name));
            if matches!(declaration, ParamDecl::Live(_)) {
                return Err(Diagnostic::new(
                    "an included graph has no live parameters of its own",
                    at.key(),
                    "declared here",
                )
                .with_help("declare it in the graph that includes it: its shaders see it all the same"));
            }
            let given = set.get(name).map(|number| (number, &level.names, place.field("set").field(name)));
            let (param, behind) =
                params::included(name, declaration, &at, opened.set.get(name), given, &names, self.files)?;
            names.define(name, param.value.clone(), behind);
            params.push(param);
        }
        Ok((names, params))
    }
}
