//! Lowers another graph's passes with the includer's resources and parameters.

use indexmap::IndexMap;
use std::collections::BTreeMap;

use super::declared;
use super::document::{MAX_DEPTH, Opened};
use super::lowered::LoweredInclude;
use super::lowering::{Handle, Level, Lowering, PICTURE, Scope};
use super::params;
use super::scope::{Names, check_identifier};
use crate::ir::{Output, Param, ParamSet, Span, Value};
use crate::schema::{Expose, Graph, Number, ParamDecl, ParamKind, Part, Reference, ResourceName, is_choice};
use crate::source::{Diagnostic, Kind, Place};

fn hides_the_output(inner: &Level) -> Diagnostic {
    let Graph { imports, resources, .. } = &*inner.graph;
    let list = match () {
        () if resources.contains_key(PICTURE) => "resources",
        () if imports.contains_key(PICTURE) => "imports",
        () => "let",
    };
    let at = inner.root.field(list).field(PICTURE);
    let output = inner.root.field("output");
    Diagnostic::new(
        "to an includer, `picture` is the name of a graph's output",
        at.key(),
        "is not the output",
    )
    .with_label(output.span(), "the output")
    .with_help("rename it, or make it the output")
}

/// Refuses an entry of `with` for which the included graph `graph` has no port.
pub(super) fn unknown_port(
    name: &str,
    graph: &Graph,
    with: &IndexMap<String, Reference>,
    place: &Place,
) -> Result<(), Diagnostic> {
    let Some(unknown) = with.keys().find(|port| !graph.ports.contains_key(*port)) else { return Ok(()) };
    let at = place.field("with").field(unknown);
    let error = Diagnostic::new(format!("`{name}` has no port `{unknown}`"), at.key(), "given here");
    Err(error.with_nearest(unknown, graph.ports.keys().map(String::as_str), ""))
}

/// The fields of an include as written, without `when`.
pub(super) struct Written<'a> {
    pub graph: &'a str,
    pub name: &'a str,
    pub with: &'a IndexMap<String, Reference>,
    pub set: &'a IndexMap<String, Number>,
    pub expose: &'a Expose,
    pub place: &'a Place,
}

impl Lowering<'_> {
    pub(super) fn include(&mut self, level: &mut Level, include: &Written) -> Result<(), Diagnostic> {
        let Written { graph, name, with, place, .. } = *include;
        let decided = level.names.take_notes().decided;
        let graph_place = place.field("graph");
        let file =
            self.files.find(Some(level.file), graph, Kind::Graph).map_err(|e| e.at(graph_place.span()))?;
        if self.includes.len() > MAX_DEPTH {
            return Err(graph_place.error(
                format!("includes are nested deeper than {MAX_DEPTH}"),
                "the limit is exceeded here",
            ));
        }
        let chosen = self.choices.choose(file, self.files, 0);
        let Some(chosen) = self.reported(chosen) else { return Ok(()) };
        let opened = &chosen.opened;
        if self.includes.contains(&opened.file) {
            return Err(declared::circular(graph, file, &graph_place, self.files));
        }
        if !chosen.errors.is_empty() {
            let here = |error: &Diagnostic| error.clone().with_label(graph_place.span(), "included here");
            self.errors.extend(chosen.errors.iter().map(here));
            return Ok(());
        }
        let parameters = declared::parameters(opened, &mut self.choices, self.files, &mut self.known);
        let Some(parameters) = self.reported(parameters) else { return Ok(()) };
        let Graph { lets, imports, resources, .. } = &*opened.graph;
        if !self.count(parameters.all.len() + lets.len() + imports.len() + resources.len(), place) {
            return Ok(());
        }
        let (names, params) = self.include_params(level, opened, &parameters, include)?;
        self.check_other_graphs(opened, include)?;
        let full = format!("{}{name}{}", level.prefix, level.suffix);
        let span = place.field("name").span();
        check_identifier(name, "an include", span)?;
        if let Some(first) = self.include_names.insert(full.clone(), span) {
            let message = format!("two includes are called `{full}`");
            return Err(Diagnostic::new(message, span, "the second").with_label(first, "the first"));
        }
        let prefix = format!("{full}.");
        let before = self.errors.len();
        let scope = Scope { names, params, exposed: parameters.exposed.clone() };
        let mut inner = self.level(opened, scope, prefix);
        if self.errors.len() > before {
            return Ok(());
        }
        let mut include = LoweredInclude { name: full, span, parent: level.include, given: Vec::new() };
        unknown_port(graph, &opened.graph, with, place)?;
        for (port_name, port) in &opened.graph.ports {
            let Some(given) = with.get(port_name) else {
                let span = opened.root.field("ports").field(port_name).key();
                return Err(Diagnostic::new(
                    format!("nothing is given for the port `{port_name}`"),
                    place.field("with").span(),
                    "missing here",
                )
                .with_label(span, "the port"));
            };
            let at = place.field("with").field(port_name);
            let handle = match level.handles.get(&given.text) {
                Some(handle) => {
                    level.note_given(&given.text);
                    handle.clone()
                }
                None if self.look_up(level, given, &at)?.is_none() => None,
                None => {
                    let text = &given.text;
                    let found = match (&given.choice, &given.name) {
                        (Some(_), _) => "an expression that chooses one".to_string(),
                        (None, Some(name)) if name.part == Part::Whole => format!("the constant `{text}`"),
                        (None, _) => format!("`{text}`, a part of one"),
                    };
                    let expected = format!("expected the name of a resource, found {found}");
                    return Err(at.error("a port takes a whole resource by its name", expected));
                }
            };
            let resources = match &handle {
                Some(Handle::PingPong(index)) => self.ping_pongs[*index].halves.to_vec(),
                Some(Handle::Plain(ids)) => ids.clone(),
                None => Vec::new(),
            };
            include.given.push((given.text.clone(), resources));
            let port_at = opened.root.field("ports").field(port_name);
            let handle =
                handle.map(|handle| self.port(port_name, port, handle, &inner, &port_at, &at)).transpose()?;
            inner.handles.insert(port_name.clone(), handle);
        }
        inner.include = Some(self.lowered.includes.len());
        let ports = level.names.take_notes().decided;
        inner.around = level.around.iter().copied().chain(decided).chain(ports).collect();
        self.lowered.includes.push(include);
        self.declare(&mut inner);
        if self.errors.len() > before {
            return Ok(());
        }
        self.includes.push(opened.file);
        let passes = opened.root.field("passes");
        self.walk(&mut inner, &opened.graph.passes, &passes);
        self.includes.pop();
        if self.errors.len() > before {
            return Ok(());
        }
        inner.names.take_notes();
        self.stats(&inner);
        self.lowered.results.extend(inner.names.take_notes().all());
        self.give(level, name, &inner);
        level.included.insert(name.into(), chosen);
        Ok(())
    }

    /// Adds the names of an included graph's resources, except its ports, to the includer: `include.resource`.
    ///
    /// Each refers to the resource at the end of the included graph: the front of a ping-pong buffer is the half in
    /// front there. Also adds constants that hold a resource's name, and the output as `picture`.
    fn give(&mut self, level: &mut Level, include: &str, inner: &Level) {
        let ports = &inner.graph.ports;
        let own = inner.handles.iter().filter(|(name, _)| !ports.contains_key(*name));
        let mut given: IndexMap<String, Option<Handle>> =
            own.map(|(name, handle)| (name.clone(), handle.clone())).collect();
        let mut decided: BTreeMap<String, ParamSet> = inner.given.clone();
        for (name, value) in &inner.names.values {
            let Value::Text(text) = value else { continue };
            let parsed = ResourceName::parse(text).filter(|_| !is_choice(text));
            if let (Some(of), false) = (parsed, given.contains_key(name))
                && let Some(handle) = inner.handles.get(&of.name)
            {
                let mut params = inner.names.params.get(name).cloned().unwrap_or_default();
                params.extend(inner.given.get(&of.name).into_iter().flatten());
                decided.insert(name.clone(), params);
                given.insert(name.clone(), handle.as_ref().and_then(|handle| self.part(handle, of.part)));
            }
        }
        if inner.graph.output.is_some() {
            let (output, params) = inner.names.traced(|| self.output(inner));
            let full = format!("{}{PICTURE}", inner.prefix);
            self.lowered.plan.pictures.extend(output.map(|image| Output { name: full, image }));
            let output = output.map(|id| Handle::Plain(vec![id]));
            decided.insert(PICTURE.into(), params);
            let hidden = given.insert(PICTURE.into(), output.clone());
            if hidden.is_some_and(|hidden| hidden != output) {
                self.errors.push(hides_the_output(inner));
            }
        }
        for (output, image) in &inner.graph.outputs {
            if let Some(Some(Handle::Plain(ids))) = inner.handles.get(&image.text) {
                self.lowered.offered.extend(ids.iter().map(|id| (*id, output.clone())));
            }
        }
        level.handles.extend(given.into_iter().map(|(name, handle)| (format!("{include}.{name}"), handle)));
        level.given.extend(decided.into_iter().map(|(name, params)| (format!("{include}.{name}"), params)));
    }

    /// Checks that the graphs of an included choice that are not drawn have the parameters in `set` and `expose`, too.
    /// Other devices draw them.
    fn check_other_graphs(&mut self, drawn: &Opened, include: &Written) -> Result<(), Diagnostic> {
        let Written { set, expose, place, .. } = *include;
        let given = set.keys().map(|name| (name, place.field("set").field(name).key(), "set here"));
        let mut named: Vec<(&String, Span, &str)> = given.collect();
        if let Expose::Only(names) = expose {
            let at = place.field("expose").index(0);
            named
                .extend(names.iter().enumerate().map(|(i, name)| (name, at.index(i).span(), "exposed here")));
        }
        if named.is_empty() {
            return Ok(());
        }
        for other in drawn.others.iter().filter(|other| other.file != drawn.file) {
            // Other errors of the graph are reported when it is drawn.
            let Ok(parameters) = declared::parameters(other, &mut self.choices, self.files, &mut self.known)
            else {
                continue;
            };
            if let Some((name, span, label)) = named.iter().find(|(name, ..)| !parameters.contains(name)) {
                let graph = other.candidate.as_deref().unwrap_or_default();
                let mut error = parameters.unknown(name, *span, label);
                error.message = format!("`{graph}` has no parameter `{name}`");
                return Err(error.with_help(format!(
                    "all graphs of an included choice must have the parameters that `set` and `Only` name, and \
                     `{graph}` is one of them"
                )));
            }
        }
        Ok(())
    }

    /// Resolves an included graph's parameters. Exposed parameters have the includer's value. The others have the value
    /// in `set`, or else the value from the included graph's preset or declaration.
    fn include_params(
        &self,
        level: &Level,
        opened: &Opened,
        parameters: &declared::Parameters,
        include: &Written,
    ) -> Result<(Names, Vec<Param>), Diagnostic> {
        let Written { set, place, .. } = *include;
        if let Some((name, setting)) =
            opened.set.iter().find(|(k, _)| !parameters.contains(k) && !parameters.elsewhere.contains(*k))
        {
            return Err(parameters.unknown(name, setting.place.key(), "set here"));
        }
        if let Some(name) = set.keys().find(|k| !parameters.contains(k)) {
            return Err(parameters.unknown(name, place.field("set").field(name).key(), "set here"));
        }
        let exposed = level.exposed.get(&place.id());
        // A hidden capacity would not grow, and its overflow would go unnoticed.
        let must_be_exposed = |declared: &declared::Declared| match declared.declaration() {
            ParamDecl::Live(_) => true,
            ParamDecl::Const(kind) => {
                matches!(kind, ParamKind::Int { grows: Some(_), .. }) && !set.contains_key(&declared.name)
            }
        };
        let mut names = Names::of(self.request.facts);
        let mut params = Vec::new();
        let (order, circle) = parameters.order(&opened.set);
        if let Some(circle) = circle {
            return Err(circle.with_label(place.field("graph").span(), "included here"));
        }
        let shared = |name: &String| {
            exposed.filter(|exposed| exposed.contains(name))?;
            level.params.iter().find(|param| param.name == *name)
        };
        for index in &order {
            let declared = &parameters.all[*index];
            let name = &declared.name;
            if let Some(param) = shared(name) {
                names.adopt(name, &level.names);
                params.push(param.clone());
                continue;
            }
            if must_be_exposed(declared) {
                let all = order.iter().map(|index| &parameters.all[*index]);
                let hidden: Vec<&String> = all
                    .filter(|declared| must_be_exposed(declared))
                    .map(|declared| &declared.name)
                    .filter(|name| shared(name).is_none())
                    .collect();
                let only: Vec<&String> =
                    exposed.into_iter().flatten().chain(hidden.iter().copied()).collect();
                // `All` leaves out the parameters of `set`. The graphs of a choice may have different ones.
                let is_set = hidden.iter().any(|name| set.contains_key(*name));
                let only = format!("`expose: Only({only:?})`");
                let write = match (is_set, opened.candidate.is_some()) {
                    (true, _) => only,
                    (false, true) => "`expose: All`".to_string(),
                    (false, false) => format!("`expose: All`, or {only}"),
                };
                let message = format!(
                    "expected parameters that are live, or grow and are not in `set`, to be exposed, found {} only in \
                     the included graph",
                    hidden.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
                );
                return Err(Diagnostic::new(message, place.field("graph").span(), "included here")
                    .with_label(declared.place.key(), "declared here")
                    .with_help(format!("they must be exposed up to the outermost graph: {write}")));
            }
            let given = set.get(name).map(|number| (number, &level.names, place.field("set").field(name)));
            let (param, behind) =
                params::included(declared, opened.set.get(name), given, &names, self.files)?;
            names.define_param(name, param.value.clone(), behind, &param.domain);
            params.push(param);
        }
        Ok((names, params))
    }
}
