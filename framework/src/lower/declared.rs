//! The parameters of a graph: its own, and those that it exposes of the graphs that it includes.
//!
//! An exposed parameter is the includer's as if its declaration stood after the includer's own: its default and its range are
//! evaluated over the includer's parameters, and its value is the included graph's as well. Two includes that expose a parameter of one
//! declaration share it.

use indexmap::IndexMap;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::rc::Rc;

use super::document::{MAX_DEPTH, Opened, Setting};
use super::params::unknown;
use super::require::Choices;
use super::scope::Place;
use crate::expr::Expr;
use crate::ir::FileId;
use crate::schema::{Expose, Expression, Graph, Number, ParamDecl, ParamKind, PassDecl};
use crate::source::{Diagnostic, Kind, Path, SourceMap};

/// A parameter of a graph, with the file that declares it.
#[derive(Clone, Debug)]
pub(super) struct Declared {
    pub name: String,
    /// The graph that declares it.
    graph: Rc<Graph>,
    /// The declaration.
    pub place: Place,
    /// Takes the place of the default in the declaration: a preset of an included graph, or the includer's `set`.
    pub default: Option<Setting>,
    /// The include that it comes from, in the graph whose parameter it is; none for its own.
    pub part: Option<String>,
}

impl Declared {
    pub fn declaration(&self) -> &ParamDecl {
        &self.graph.params[&self.name]
    }

    /// The names in its expressions, and in what is set in place of its default.
    pub fn names<'a>(&'a self, setting: Option<&'a Setting>) -> BTreeSet<&'a str> {
        let expressions = expressions(self.declaration(), self.default.as_ref(), setting).into_iter();
        expressions
            .flat_map(|expression| expression.parsed.iter().flat_map(Expr::names))
            .map(|(name, _)| name)
            .collect()
    }

    /// The graph whose statistics it can grow with.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }
}

/// Names of parameters by the places of the includes that expose them.
pub(super) type Exposed = HashMap<Path, BTreeSet<String>>;

/// The parameters of a graph, in order.
#[derive(Clone, Debug, Default)]
pub(super) struct Parameters {
    pub all: Vec<Declared>,
    /// The parameters that each include exposes, by the include's place in the file.
    pub exposed: Exposed,
    /// Of a graph that was chosen: names that a preset of the choice may set, since other graphs of the choice have them.
    pub elsewhere: BTreeSet<String>,
}

impl Parameters {
    /// Lists indices so that each parameter comes after those that its expressions name, and else in their order.
    ///
    /// `settings` stand in for defaults. Parameters in a circle, and those that need them, come last.
    pub fn order(&self, settings: &IndexMap<String, Setting>) -> Vec<usize> {
        let known: BTreeMap<&str, usize> =
            self.names().enumerate().map(|(index, name)| (name, index)).collect();
        let mut needed_by: Vec<Vec<usize>> = vec![Vec::new(); self.all.len()];
        let mut needs = vec![0; self.all.len()];
        for (index, declared) in self.all.iter().enumerate() {
            let names = declared.names(settings.get(&declared.name));
            let names: BTreeSet<usize> = names.iter().filter_map(|name| known.get(name).copied()).collect();
            needs[index] = names.len();
            names.into_iter().for_each(|name| needed_by[name].push(index));
        }
        let mut ready: BTreeSet<usize> = (0..needs.len()).filter(|index| needs[*index] == 0).collect();
        let mut order = Vec::new();
        while let Some(index) = ready.pop_first() {
            order.push(index);
            for other in &needed_by[index] {
                needs[*other] -= 1;
                if needs[*other] == 0 {
                    ready.insert(*other);
                }
            }
        }
        order.extend((0..needs.len()).filter(|index| needs[*index] > 0));
        order
    }

    pub fn contains(&self, name: &str) -> bool {
        self.all.iter().any(|declared| declared.name == name)
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.all.iter().map(|declared| declared.name.as_str())
    }
}

/// The expressions of a declaration, with what replaces the default, and that of what is set.
fn expressions<'a>(
    declaration: &'a ParamDecl,
    replaced: Option<&'a Setting>,
    setting: Option<&'a Setting>,
) -> Vec<&'a Expression> {
    let (ParamDecl::Const(kind) | ParamDecl::Live(kind)) = declaration;
    let (default, range, step, exact) = match kind {
        ParamKind::Bool { default, exact, .. } => (Some(default), None, None, exact.as_ref()),
        ParamKind::Int { default, range, exact, .. } => (Some(default), Some(range), None, exact.as_ref()),
        ParamKind::Float { default, range, step, exact, .. } => {
            (Some(default), Some(range), step.as_ref(), exact.as_ref())
        }
        ParamKind::Choice { .. } => (None, None, None, None),
    };
    // Of a choice, a text that is one of its names stands for itself.
    let (chosen, names): (Vec<&Expression>, &[String]) = match kind {
        ParamKind::Choice { default, of, exact, .. } => {
            (exact.iter().chain(replaced.is_none().then_some(default)).collect(), of)
        }
        _ => (Vec::new(), &[]),
    };
    let default = replaced.map(|setting| &setting.number).or(default);
    let ends = range.into_iter().flat_map(|(from, to)| [from, to]);
    let setting = setting.map(|setting| &setting.number);
    let numbers = default.into_iter().chain(ends).chain(step).chain(exact).chain(setting);
    let expressions = numbers.filter_map(|number| match number {
        Number::Expression(expression) => Some(expression),
        Number::Literal(_) => None,
    });
    expressions.chain(chosen).filter(|expression| !names.contains(&expression.text)).collect()
}

/// Parameters by the file of their graph, each listed once: parts may include parts several times over.
pub(super) type Known = HashMap<FileId, Rc<Parameters>>;

/// Lists the parameters of a graph.
///
/// # Errors
/// Names that are exposed twice or not there, and those of the files that are included.
pub(super) fn parameters(
    opened: &Opened,
    choices: &mut Choices,
    files: &mut SourceMap,
    known: &mut Known,
) -> Result<Rc<Parameters>, Vec<Diagnostic>> {
    let mut collect = Collect { choices, files, known, around: Vec::new() };
    let mut found = collect.graph(opened)?;
    if opened.set.keys().any(|name| !found.contains(name)) {
        for other in opened.others.iter() {
            // The mistakes of a graph that is not drawn are told where it is.
            if let Ok(other) = collect.graph(other) {
                Rc::make_mut(&mut found).elsewhere.extend(other.names().map(str::to_owned));
            }
        }
    }
    Ok(found)
}

struct Collect<'a, 'r> {
    choices: &'a mut Choices<'r>,
    files: &'a mut SourceMap,
    known: &'a mut Known,
    /// The files whose parameters are being listed, outermost first.
    around: Vec<FileId>,
}

impl Collect<'_, '_> {
    fn graph(&mut self, opened: &Opened) -> Result<Rc<Parameters>, Vec<Diagnostic>> {
        if let Some(known) = self.known.get(&opened.file) {
            return Ok(known.clone());
        }
        let params = Path::root().field("params");
        let own = opened.graph.params.keys().map(|name| Declared {
            name: name.clone(),
            graph: opened.graph.clone(),
            place: Place::new(&opened.outline, params.key(name)),
            default: None,
            part: None,
        });
        let mut found = Parameters { all: own.collect(), ..Parameters::default() };
        // Includes that lead back are an error of the walk, which says more.
        if self.around.contains(&opened.file) || self.around.len() > MAX_DEPTH {
            return Ok(Rc::new(found));
        }
        self.around.push(opened.file);
        let passes = Place::new(&opened.outline, Path::root().field("passes"));
        let result = self.passes(opened, &opened.graph.passes, &passes, &mut found);
        self.around.pop();
        result?;
        let found = Rc::new(found);
        self.known.insert(opened.file, found.clone());
        Ok(found)
    }

    fn passes(
        &mut self,
        opened: &Opened,
        passes: &[PassDecl],
        at: &Place,
        found: &mut Parameters,
    ) -> Result<(), Vec<Diagnostic>> {
        for (i, pass) in passes.iter().enumerate() {
            match pass {
                PassDecl::Repeat { body, .. } => {
                    self.passes(opened, body, &at.index(i).field("body"), found)?;
                }
                PassDecl::Include { expose: Expose::Only(names), .. } if names.is_empty() => {}
                PassDecl::Include { .. } => self.include(opened, pass, &at.index(i), found)?,
                _ => {}
            }
        }
        Ok(())
    }

    fn include(
        &mut self,
        opened: &Opened,
        pass: &PassDecl,
        place: &Place,
        found: &mut Parameters,
    ) -> Result<(), Vec<Diagnostic>> {
        let PassDecl::Include { graph, name, set, expose, .. } = pass else { return Ok(()) };
        let graph_place = place.field("graph");
        let file = self.files.find(Some(opened.file), graph, Kind::Graph);
        let file = file.map_err(|e| vec![e.at(graph_place.span())])?;
        let chosen = self.choices.choose(file, self.files, 0)?;
        let inner = self.graph(&chosen.opened)?;
        let at = place.field("expose");
        if let Expose::Only(names) = expose
            && let Some(i) = names.iter().position(|wanted| !inner.contains(wanted))
        {
            return Err(vec![unknown(&names[i], at.index(0).index(i).span(), "exposed here", inner.names())]);
        }
        for declared in &inner.all {
            let wanted = match expose {
                Expose::All => !set.contains_key(&declared.name),
                Expose::Only(names) => names.contains(&declared.name),
            };
            if !wanted {
                continue;
            }
            let name_of = &declared.name;
            let given = set.get(name_of).map(|number| {
                let path = place.field("set").field(name_of).path;
                Setting { number: number.clone(), outline: place.outline.clone(), path }
            });
            let default =
                given.or_else(|| chosen.opened.set.get(name_of).cloned()).or(declared.default.clone());
            if let Some(first) = found.all.iter().find(|other| other.name == *name_of) {
                let span = |setting: &Setting| setting.outline.value(&setting.path);
                let same_default = first.default.as_ref().map(span) == default.as_ref().map(span);
                if first.place.key() == declared.place.key() && same_default {
                    found.exposed.entry(place.path.clone()).or_default().insert(name_of.clone());
                    continue;
                }
                let message = format!("this graph has the parameter `{name_of}` already");
                let error = Diagnostic::new(message, at.span(), "exposed here")
                    .with_label(first.place.key(), "the first");
                let help = format!(
                    "give it the first one's value, and do not expose it: `set: {{ \"{name_of}\": \"{name_of}\" }}`"
                );
                return Err(vec![error.with_help(help)]);
            }
            found.exposed.entry(place.path.clone()).or_default().insert(name_of.clone());
            found.all.push(Declared { default, part: Some(name.clone()), ..declared.clone() });
        }
        Ok(())
    }
}
