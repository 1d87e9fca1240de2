//! The parameters of a graph: its own, and the exposed parameters of included graphs.
//!
//! An exposed parameter is the includer's as if its declaration stood after the includer's own: its default and its range are
//! evaluated over the includer's parameters, and its value is the included graph's as well. Two includes that expose a parameter of one
//! declaration share it.

use indexmap::IndexMap;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::rc::Rc;

use super::document::{MAX_DEPTH, Opened, Setting};
use super::require::Choices;
use super::scope::Place;
use crate::ir::{FileId, Span};
use crate::schema::{Expose, Graph, Number, ParamDecl, ParamKind, PassDecl};
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

    /// Collects the names in its expressions and in `setting`, which replaces its default.
    pub fn names(&self, setting: Option<&Setting>) -> BTreeSet<String> {
        let (ParamDecl::Const(kind) | ParamDecl::Live(kind)) = self.declaration();
        let default = self.default.as_ref().map_or_else(|| kind.default(), |setting| setting.number.clone());
        let mut numbers = vec![default];
        numbers.extend(kind.exact());
        numbers.extend(setting.map(|setting| setting.number.clone()));
        // Of a choice, a text that is one of its names stands for itself.
        let mut texts: &[String] = &[];
        match kind {
            ParamKind::Bool { .. } => {}
            ParamKind::Int { range, .. } => numbers.extend([range.0.clone(), range.1.clone()]),
            ParamKind::Float { range, step, .. } => {
                numbers.extend([range.0.clone(), range.1.clone()].into_iter().chain(step.clone()));
            }
            ParamKind::Choice { of, .. } => texts = of,
        }
        let mut names = BTreeSet::new();
        for number in &numbers {
            if let Number::Expression(expression) = number
                && !texts.contains(&expression.text)
                && let Ok(parsed) = &expression.parsed
            {
                names.extend(parsed.names().map(|(name, _)| name.to_owned()));
            }
        }
        names
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
    /// Names that a preset of a choice may set, since other graphs of the choice have them.
    pub elsewhere: BTreeSet<String>,
}

impl Parameters {
    /// Sorts parameters by dependency, and by declaration where there is none; returns their indices.
    ///
    /// `settings` replace defaults. Parameters on a cycle, and their dependants, come last.
    pub fn order(&self, settings: &IndexMap<String, Setting>) -> Vec<usize> {
        let known: BTreeMap<&str, usize> =
            self.names().enumerate().map(|(index, name)| (name, index)).collect();
        let mut needed_by: Vec<Vec<usize>> = vec![Vec::new(); self.all.len()];
        let mut needs = vec![0; self.all.len()];
        for (index, declared) in self.all.iter().enumerate() {
            let names = declared.names(settings.get(&declared.name));
            let names: BTreeSet<usize> =
                names.iter().filter_map(|name| known.get(name.as_str()).copied()).collect();
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

    /// Makes the error for a name that no parameter has.
    pub fn unknown(&self, name: &str, span: Span, label: &str) -> Diagnostic {
        let all: Vec<_> = self.names().map(|known| format!("`{known}`")).collect();
        let otherwise = match all[..] {
            [] => "this graph has no parameters".to_string(),
            _ => format!("it has {}", all.join(", ")),
        };
        let diagnostic = Diagnostic::new(format!("the graph has no parameter `{name}`"), span, label);
        diagnostic.with_nearest(name, self.names(), otherwise)
    }

    pub fn contains(&self, name: &str) -> bool {
        self.all.iter().any(|declared| declared.name == name)
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.all.iter().map(|declared| declared.name.as_str())
    }
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
            // Errors of a candidate are reported when it is drawn.
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
            return Err(vec![inner.unknown(&names[i], at.index(0).index(i).span(), "exposed here")]);
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
