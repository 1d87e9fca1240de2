//! Lowers a graph: converts the tree of a graph file to a flat list of passes.
//!
//! A file may be a preset of a graph, or a choice of graphs. A graph may include graphs, repeat passes, omit passes and
//! swap ping-pong resources. Lowering walks the tree once, in file order, and resolves all of these. The result
//! ([`Lowered`]) has only dispatches, draws and fills over numbered resources; every expression has a value, and
//! `front(keys)` is one definite buffer. Lowering does not read shaders; linking checks the names under `bind`.

mod conditions;
mod declared;
mod defines;
mod document;
mod include;
mod lowered;
mod lowering;
mod params;
mod passes;
mod removed;
mod require;
mod reserved;
mod resources;
mod results;
mod scope;

pub(crate) use lowered::{
    Declaration, Extent, Lowered, LoweredBind, LoweredPass, LoweredSize, RemovedPass, RemovedUse, ShaderName,
    SkippedUse, Unswapped,
};
pub use params::parse_value;
pub use results::no_output;

use declared::{Declared, Known, Parameters};
use lowering::{Lowering, Scope};
use params::Resolved;
use require::{Choices, Chosen};
use scope::Values;
use std::rc::Rc;

use crate::expr::Expr;
use crate::ir::{Fallback, LIVE_BLOCK, Param, ParamSet, Request, Shape, Source, Unmet, Value};
use crate::plan::Plan;
use crate::schema::folded;
use crate::source::{Diagnostic, SourceMap};

/// A parameter with its texts for users.
#[derive(Clone, Debug, PartialEq)]
pub struct Control {
    /// Parameter with its value.
    pub param: Param,
    /// The value if the request sets none: a preset's, or the default.
    pub unset: Value,
    /// The declared label, or the parameter's name with spaces for `_`.
    pub label: String,
    /// The help text; may be empty.
    pub help: String,
    /// Name of the outermost include that exposes the parameter, with spaces for `_`; `None` for the graph's own.
    pub part: Option<String>,
}

/// Lowers the graph that `request` names. For a choice, `candidate` is the index of a graph among [`candidates`], where
/// an index beyond the end means the last; `None` takes the first graph whose requirements hold.
///
/// # Errors
/// Errors of the request's settings and outputs, of the graph's file and the files that it refers to, or the unmet
/// requirements of the graph.
pub(crate) fn lower(
    request: &Request,
    candidate: Option<usize>,
    files: &mut SourceMap,
) -> Result<Lowered, Vec<Diagnostic>> {
    let (mut choices, mut known) = (Choices::new(request), Known::default());
    choices.candidate = candidate;
    let Root { chosen, parameters, resolved } = Root::open(request, files, &mut choices, &mut known, None)?;
    let Resolved { params, names, skipped, live_bytes, live: live_params, .. } = resolved;
    let root = &chosen.opened;
    let lowered = Lowered {
        plan: Plan {
            name: request.graph.into(),
            summary: folded(&root.summary),
            based_on: root.based_on.clone(),
            fallbacks: chosen.fallbacks.clone(),
            facts: request.facts.named(),
            params: params.clone(),
            ..Plan::default()
        },
        live_params,
        skipped,
        output_span: root.root.field("output").span(),
        ..Lowered::default()
    };
    let mut walk = Lowering::new(request, files, (choices, known), lowered);
    let scope = Scope { names, params, exposed: parameters.exposed.clone() };
    let mut level = walk.level(root, scope, String::new());
    if let Some(port) = root.graph.ports.keys().next() {
        let span = root.root.field("ports").field(port).key();
        walk.errors.push(
            Diagnostic::new("this graph is made to be included", span, "nothing is bound to this port")
                .with_help("name a graph that includes it"),
        );
        return Err(walk.errors);
    }
    walk.check_outputs(&level);
    if !walk.errors.is_empty() {
        return Err(walk.errors);
    }
    walk.includes.push(root.file);
    walk.declare(&mut level);
    let passes = root.root.field("passes");
    walk.walk(&mut level, &root.graph.passes, &passes);
    level.names.take_notes();
    let output = walk.output(&level);
    walk.lowered.plan.outputs = walk.outputs(&level);
    walk.lowered.plan.offered = root.graph.outputs.keys().cloned().collect();
    walk.stats(&level);
    walk.end_stats();
    walk.lowered.results.extend(level.names.take_notes().all());
    let live_shape = Shape::Buffer { stride: live_bytes.next_multiple_of(16).max(16), count: 1 };
    walk.lowered.live =
        walk.add(LIVE_BLOCK.into(), live_shape, Source::Live, root.root.field("params").key());
    walk.end_histories();
    walk.lowered.swaps = walk.ping_pongs.iter().map(|pair| pair.swaps).collect();
    match output {
        Some(output) if walk.errors.is_empty() => {
            walk.lowered.plan.output = output;
            Ok(walk.lowered)
        }
        _ => Err(Diagnostic::distinct(walk.errors)),
    }
}

/// The graph of a request, with the values of its parameters.
struct Root {
    chosen: Rc<Chosen>,
    parameters: Rc<Parameters>,
    resolved: Resolved,
}

impl Root {
    fn open(
        request: &Request,
        files: &mut SourceMap,
        choices: &mut Choices,
        known: &mut Known,
        rejected: Option<&mut Vec<String>>,
    ) -> Result<Root, Vec<Diagnostic>> {
        let chosen = choices.root(files)?;
        let parameters = declared::parameters(&chosen.opened, choices, files, known)?;
        let mut errors = Vec::new();
        let resolved = params::resolve(&chosen.opened, &parameters, request, files, rejected, &mut errors);
        if !errors.is_empty() {
            return Err(require::explained(errors, &chosen.fallbacks));
        }
        Ok(Root { chosen, parameters, resolved })
    }
}

/// Reads a graph's summary and parameters, without lowering its passes: for lists, help and controls.
///
/// # Errors
/// Those of [`build`](fn@crate::build) about the request's settings, files, parameters and requirements.
pub fn controls(request: &Request, files: &mut SourceMap) -> Result<(String, Vec<Control>), Vec<Diagnostic>> {
    let Root { chosen, parameters, resolved } =
        Root::open(request, files, &mut Choices::new(request), &mut Known::default(), None)?;
    let control = |((param, unset), declared): ((Param, Value), &Declared)| {
        let (label, help) = params::texts(declared.declaration());
        let label = if label.is_empty() { param.name.replace('_', " ") } else { folded(label) };
        Control {
            label,
            help: folded(help),
            part: declared.part.as_ref().map(|part| part.replace('_', " ")),
            param,
            unset,
        }
    };
    let controls =
        resolved.params.into_iter().zip(resolved.unset).zip(&parameters.all).map(control).collect();
    Ok((folded(&chosen.opened.summary), controls))
}

/// Lists the names of a request's settings that its graph rejects. Their parameter is unknown, or its type or range
/// excludes the value. The range may depend on other settings; rejected settings are ignored there.
///
/// Ignores errors of the graph, which [`build`](fn@crate::build) reports.
pub fn rejected_settings(request: &Request, files: &mut SourceMap) -> Vec<String> {
    let mut rejected = Vec::new();
    let _ =
        Root::open(request, files, &mut Choices::new(request), &mut Known::default(), Some(&mut rejected));
    rejected
}

/// The names that a graph's expressions can use, with values: facts, constant parameters and `let`s.
#[derive(Clone, Debug, Default)]
pub struct ExpressionNames(Values);

impl ExpressionNames {
    /// Returns the value of a name; `None` for an unknown name or a live parameter.
    pub fn get(&self, name: &str) -> Option<&Value> {
        self.0.get(name)
    }

    /// Lists the names with their values, in alphabetical order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.0.iter().map(|(name, value)| (name.as_str(), value))
    }

    /// Evaluates an expression. `None` if it is invalid, has no value, or uses another name, such as the variable of a
    /// repeat.
    pub fn evaluate(&self, expression: &str) -> Option<Value> {
        Expr::parse(expression).ok()?.eval(&self.0).ok()
    }
}

/// Evaluates a graph's parameters and `let`s without lowering its passes, for editors. An invalid `let` is left out.
///
/// # Errors
/// Those of [`build`](fn@crate::build) about the request's settings, files, parameters and requirements.
pub fn expression_names(
    request: &Request,
    files: &mut SourceMap,
) -> Result<ExpressionNames, Vec<Diagnostic>> {
    let Root { chosen, resolved: Resolved { mut names, .. }, .. } =
        Root::open(request, files, &mut Choices::new(request), &mut Known::default(), None)?;
    for (name, number) in &chosen.opened.graph.lets {
        let place = chosen.opened.root.field("let").field(name);
        if let Ok(value) = names.evaluate(number, &place) {
            names.define(name, value, ParamSet::new());
        }
    }
    Ok(ExpressionNames(names.values))
}

/// The outcome of a choice, or of the requirements of a single graph.
#[derive(Clone, Debug, PartialEq)]
pub struct Standing {
    /// Graphs of the choice that were passed over, in order.
    pub fallbacks: Vec<Fallback>,
    /// Unmet requirements of the last graph; empty unless no graph suits the facts.
    pub unmet: Vec<Unmet>,
}

/// Checks the `require` of a graph, of its presets and unconditional includes against the facts, without lowering it.
/// For a choice, checks its graphs in order until one suits.
///
/// # Errors
/// Errors of the graph's file, its `require`, and the files that it refers to.
pub fn standing(request: &Request, files: &mut SourceMap) -> Result<Standing, Vec<Diagnostic>> {
    let chosen = Choices::new(request).standing(files)?;
    Ok(Standing { fallbacks: chosen.fallbacks.clone(), unmet: chosen.unmet.clone() })
}

/// A graph of a choice, or the only graph of a request without a choice.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Name by which the innermost choice refers to the graph; without a choice, the request's name.
    pub name: String,
    /// Unmet requirements of the graph, of its presets and unconditional includes, and of the choice for it.
    pub unmet: Vec<Unmet>,
}

/// Lists the graphs of a choice in order of preference, without lowering them. Without a choice, lists one graph.
///
/// # Errors
/// Those of [`standing`], for any of the graphs.
pub fn candidates(request: &Request, files: &mut SourceMap) -> Result<Vec<Candidate>, Vec<Diagnostic>> {
    let candidate = |Chosen { opened, unmet, .. }: Chosen| Candidate {
        name: opened.candidate.clone().unwrap_or_else(|| request.graph.to_owned()),
        unmet,
    };
    Ok(Choices::new(request).candidates(files)?.into_iter().map(candidate).collect())
}

#[cfg(test)]
mod tests;
