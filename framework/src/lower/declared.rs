//! Lists the parameters of a graph: its own, and the exposed parameters of included graphs.
//!
//! An exposed parameter becomes a parameter of the includer, listed after the includer's own, and the included graph
//! uses the includer's value. The parameter's expressions can name other parameters of the included graph. If such a
//! parameter is exposed as well, the name means the includer's parameter; if it is in `set`, the name means the value
//! there ([`Around`]); otherwise, the name is an error. So is the name of a `let`, or of a repeat's variable around an
//! include, at the level of the expression. All other names are resolved in the includer's scope. Includes that expose
//! the same declaration share one parameter, and must agree on its default.

use indexmap::IndexMap;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::rc::Rc;

use super::document::{MAX_DEPTH, Opened, Setting};
use super::require::Choices;
use crate::ir::{FileId, Span};
use crate::schema::{Expose, Expression, Graph, Number, ParamDecl, ParamKind, PassDecl};
use crate::source::{Diagnostic, Kind, Place, SourceMap};

/// A parameter of a graph: its own, or one that an include exposes.
#[derive(Clone, Debug)]
pub(super) struct Declared {
    pub name: String,
    graph: Rc<Graph>,
    pub place: Place,
    /// Replacement for the declared default: a value from an included graph's preset, or from the includer's `set`.
    /// The number is the level whose names the value uses: 0 is the declaring graph, 1 its includer, and so on.
    pub default: Option<(Setting, usize)>,
    /// Name of the outermost include that exposes the parameter; `None` for the graph's own.
    pub part: Option<String>,
    /// The includes through which the parameter is exposed, innermost first.
    pub around: Vec<Rc<Around>>,
}

/// The way in which an includer treats the parameters of an included graph.
#[derive(Debug, Default)]
pub(super) struct Around {
    /// Parameters in `set` that are not exposed, with their values: expressions over the includer's names.
    pub set: BTreeMap<String, Given>,
    /// Parameters neither exposed nor in `set`, with the places of their declarations.
    hidden: BTreeMap<String, Span>,
    /// Exposed parameters, with their places in `expose`; empty for `expose: All`.
    exposed: BTreeMap<String, Span>,
    /// `let`s of the includer and variables of the repeats around the include: they have no values yet.
    unset: BTreeSet<String>,
}

#[derive(Debug)]
pub(super) struct Given {
    pub setting: Setting,
    pub kind: ParamKind,
}

/// The names that the expressions of a parameter depend on.
#[derive(Debug, Default)]
pub(super) struct Reach {
    /// Names in the scope of the graph that has the parameter.
    pub names: BTreeSet<String>,
    /// Names in the `set` of an include, each with the include's index in [`Declared::around`].
    pub set: BTreeSet<(usize, String)>,
    /// A parameter that an expression uses but an include neither exposes nor sets, if any.
    pub hidden: Option<Hidden>,
}

/// A parameter that an exposed parameter depends on, but that the include neither exposes nor sets.
#[derive(Debug)]
pub(super) struct Hidden {
    pub name: String,
    pub declared: Span,
    /// The place of the exposed parameter in `expose`.
    pub exposed: Span,
}

impl Declared {
    pub fn declaration(&self) -> &ParamDecl {
        &self.graph.params[&self.name]
    }

    /// Lists the names of a level that have no values yet: see [`Around::unset`].
    pub fn unset(&self, level: usize) -> Vec<&String> {
        match level.checked_sub(1) {
            None => self.graph.lets.keys().collect(),
            Some(include) => self.around[include].unset.iter().collect(),
        }
    }

    /// Collects the names that the parameter's expressions and `setting` depend on, through the includes around it.
    /// `setting` is a preset's value that overrides the default.
    pub fn reach(&self, setting: Option<&Setting>) -> Reach {
        let kind = self.declaration().kind();
        let mut open: Vec<(usize, String)> = Vec::new();
        let mut add = |level: usize, number: &Number, kind: &ParamKind| {
            open.extend(names_in(number, kind).into_iter().map(|name| (level, name)));
        };
        match &self.default {
            Some((setting, level)) => add(*level, &setting.number, kind),
            None => add(0, &kind.default(), kind),
        }
        kind.exact().iter().for_each(|number| add(0, number, kind));
        setting.iter().for_each(|setting| add(self.around.len(), &setting.number, kind));
        match kind {
            ParamKind::Int { range, .. } => [&range.0, &range.1].into_iter().for_each(|n| add(0, n, kind)),
            ParamKind::Float { range, step, .. } => {
                [&range.0, &range.1].into_iter().chain(step).for_each(|number| add(0, number, kind));
            }
            ParamKind::Bool { .. } | ParamKind::Choice { .. } => {}
        }
        let mut reach = Reach::default();
        while let Some((level, name)) = open.pop() {
            let is_unset = |at: usize| self.unset(at).contains(&&name);
            let is_known = |at: usize| {
                let around = self.around.get(at);
                around.is_some_and(|a| a.set.contains_key(&name) || a.hidden.contains_key(&name))
            };
            let Some(at) = (level..=self.around.len()).find(|at| is_unset(*at) || is_known(*at)) else {
                reach.names.insert(name);
                continue;
            };
            // The evaluation reports a name without a value.
            if is_unset(at) {
                continue;
            }
            match self.around[at].set.get(&name) {
                Some(given) => {
                    if reach.set.insert((at, name)) {
                        let names = names_in(&given.setting.number, &given.kind);
                        open.extend(names.into_iter().map(|name| (at + 1, name)));
                    }
                }
                None => {
                    let Around { hidden, exposed, .. } = &*self.around[at];
                    let (declared, exposed) = (hidden[&name], exposed[&self.name]);
                    reach.hidden = Some(Hidden { name, declared, exposed });
                }
            }
        }
        reach
    }

    /// Lists the values of `set` that the parameter's expressions depend on. Two includes that share a parameter must
    /// agree on them.
    fn values_around(&self) -> Vec<(usize, String, &Number)> {
        let set = self.reach(None).set.into_iter();
        set.map(|(level, name)| {
            let number = &self.around[level].set[&name].setting.number;
            (level, name, number)
        })
        .collect()
    }

    /// Returns true if another include's parameter of the same declaration has the same default: an equal text with
    /// names that mean the same.
    fn has_default_of(&self, other: &Declared) -> bool {
        let kind = self.declaration().kind();
        let default = |of: &Declared| match &of.default {
            Some((setting, level)) => (setting.number.clone(), Some(setting.place.span()), *level),
            None => (kind.default(), None, 0),
        };
        let (own, others) = (default(self), default(other));
        let names = names_in(&own.0, kind);
        // A `let`, a parameter that an include hides, and the variable of a repeat around an include have their meaning
        // only there.
        let is_global = |of: &Declared, level: usize| {
            (level..=of.around.len()).all(|at| !of.unset(at).into_iter().any(|name| names.contains(name)))
                && of.around[level..]
                    .iter()
                    .all(|around| !names.iter().any(|name| around.hidden.contains_key(name)))
        };
        own.0 == others.0
            && (own.1 == others.1 || is_global(self, own.2) && is_global(other, others.2))
            && self.values_around() == other.values_around()
    }

    pub fn graph(&self) -> &Graph {
        &self.graph
    }
}

/// Lists the names in a parameter's value. In a choice, a string equal to one of its options is a literal, not a name.
fn names_in(number: &Number, kind: &ParamKind) -> Vec<String> {
    let is_text = |text| matches!(kind, ParamKind::Choice { of, .. } if of.contains(text));
    match number {
        Number::Expression(Expression { text, parsed: Ok(parsed) }) if !is_text(text) => {
            parsed.names().map(|(name, _)| name.to_owned()).collect()
        }
        _ => Vec::new(),
    }
}

/// Names of parameters by the [ids](Place::id) of the includes that expose them.
pub(super) type Exposed = HashMap<usize, BTreeSet<String>>;

#[derive(Clone, Debug, Default)]
pub(super) struct Parameters {
    pub all: Vec<Declared>,
    pub exposed: Exposed,
    /// Names that a preset of a choice may set because other graphs of the choice have them.
    pub elsewhere: BTreeSet<String>,
}

impl Parameters {
    /// Sorts parameters topologically, with ties in declaration order; returns their indices. `settings` replace
    /// defaults. Parameters on a cycle, and their dependants, are left out; the error describes one cycle.
    pub fn order(&self, settings: &IndexMap<String, Setting>) -> (Vec<usize>, Option<Diagnostic>) {
        let known: BTreeMap<&str, usize> =
            self.names().enumerate().map(|(index, name)| (name, index)).collect();
        let mut needed_by: Vec<Vec<usize>> = vec![Vec::new(); self.all.len()];
        let mut needs = vec![0; self.all.len()];
        let needed: Vec<BTreeSet<usize>> = (self.all.iter())
            .map(|declared| {
                let names = declared.reach(settings.get(&declared.name)).names;
                names.iter().filter_map(|name| known.get(name.as_str()).copied()).collect()
            })
            .collect();
        for (index, names) in needed.iter().enumerate() {
            needs[index] = names.len();
            names.iter().for_each(|name| needed_by[*name].push(index));
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
        let first = (0..needs.len()).find(|index| needs[*index] > 0);
        (
            order,
            first.map(|first| {
                let next = |index: usize| {
                    // Each has an unresolved dependency, or it would have been sorted.
                    needed[index].iter().copied().find(|name| needs[*name] > 0).unwrap_or(first)
                };
                self.circle(first, next, settings)
            }),
        )
    }

    fn circle(
        &self,
        first: usize,
        next: impl Fn(usize) -> usize,
        settings: &IndexMap<String, Setting>,
    ) -> Diagnostic {
        let mut way = vec![first];
        let start = loop {
            let after = next(way[way.len() - 1]);
            match way.iter().position(|index| *index == after) {
                Some(start) => break start,
                None => way.push(after),
            }
        };
        let mut circle = way.split_off(start);
        // The declarations of a valid graph have no cycle: a value that replaces a default closed it.
        let closing = (0..circle.len()).find_map(|at| {
            let next = circle[(at + 1) % circle.len()];
            Some((at, self.replacement(circle[at], next, settings)?))
        });
        circle.rotate_left(closing.as_ref().map_or(0, |(at, _)| *at));
        let quoted = |index: &usize| format!("`{}`", self.all[*index].name);
        let names: Vec<String> = circle.iter().chain(&circle[..1]).map(quoted).collect();
        let message = match &circle[..] {
            [one] => format!("the parameter {} needs its own value", quoted(one)),
            _ => format!("these parameters need each other's values: {}", names.join(" needs ")),
        };
        let key = |index: usize| self.all[index].place.key();
        let error = match closing {
            Some((_, (span, label))) => {
                Diagnostic::new(message, span, label).with_label(key(circle[0]), "declared here")
            }
            None => Diagnostic::new(message, key(circle[0]), "the cycle leads back here"),
        };
        circle[1..].iter().fold(error, |error, index| error.with_label(key(*index), "needed on the way"))
    }

    /// Returns the place, with a label, of the value by which the parameter `from` depends on the parameter `on`. A
    /// preset or an include gives the value. `None` if only the declaration of `from` depends on `on`.
    fn replacement(
        &self,
        from: usize,
        on: usize,
        settings: &IndexMap<String, Setting>,
    ) -> Option<(Span, String)> {
        let (declared, on) = (&self.all[from], &self.all[on].name);
        let needs = |setting: &Setting, kind: &ParamKind| {
            names_in(&setting.number, kind).contains(on).then(|| setting.place.span())
        };
        let setting = settings.get(&declared.name);
        let mut own = setting.into_iter().chain(declared.default.as_ref().map(|(setting, _)| setting));
        if let Some(span) = own.find_map(|setting| needs(setting, declared.declaration().kind())) {
            return Some((span, format!("needs `{on}`")));
        }
        declared.reach(setting).set.iter().find_map(|(level, name)| {
            let given = &declared.around[*level].set[name];
            let label = format!("needs `{on}`, and `{}` needs this value of `{name}`", declared.name);
            Some((needs(&given.setting, &given.kind)?, label))
        })
    }

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
        self.get(name).is_some()
    }

    pub fn get(&self, name: &str) -> Option<&Declared> {
        self.all.iter().find(|declared| declared.name == name)
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.all.iter().map(|declared| declared.name.as_str())
    }
}

/// A cache of parameters by graph file, because a part may be included several times.
pub(super) type Known = HashMap<FileId, Rc<Parameters>>;

/// Lists the parameters of a graph: its own, then those that its includes expose.
///
/// Fails if an exposed name is unknown or stands for two parameters, and on errors of the included files.
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

/// Returns the error for an include of `graph`, found as `file`, that leads back to a graph around it.
pub(super) fn circular(graph: &str, file: FileId, place: &Place, files: &SourceMap) -> Diagnostic {
    let error = match file == place.span().file {
        true => place.error("this graph includes itself", "an include of this file"),
        false => {
            place.error("these graphs include each other", "leads back to a graph that includes this one")
        }
    };
    if !files.hides_built_in(file, graph) {
        return error.with_help("a `Repeat` runs passes once for each level, whose number is its variable");
    }
    let path = files.path(file);
    error.with_help(format!("{path} takes precedence over the built-in `{graph}`: give it another name"))
}

struct Collect<'a, 'r> {
    choices: &'a mut Choices<'r>,
    files: &'a mut SourceMap,
    known: &'a mut Known,
    /// Files whose parameters are being listed, outermost first.
    around: Vec<FileId>,
}

impl Collect<'_, '_> {
    fn graph(&mut self, opened: &Opened) -> Result<Rc<Parameters>, Vec<Diagnostic>> {
        if let Some(known) = self.known.get(&opened.file) {
            return Ok(known.clone());
        }
        let params = opened.root.field("params");
        let own = opened.graph.params.keys().map(|name| Declared {
            name: name.clone(),
            graph: opened.graph.clone(),
            place: params.field(name),
            default: None,
            part: None,
            around: Vec::new(),
        });
        let mut found = Parameters { all: own.collect(), ..Parameters::default() };
        // The walk over the passes reports includes that are nested too deeply.
        if self.around.len() > MAX_DEPTH {
            return Ok(Rc::new(found));
        }
        self.around.push(opened.file);
        let passes = opened.root.field("passes");
        let lets = opened.graph.lets.keys().cloned().collect();
        let result = self.passes(opened, &opened.graph.passes, &passes, &lets, &mut found);
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
        unset: &BTreeSet<String>,
        found: &mut Parameters,
    ) -> Result<(), Vec<Diagnostic>> {
        for (i, pass) in passes.iter().enumerate() {
            match pass {
                PassDecl::Repeat { var, body, .. } => {
                    let unset = unset.iter().chain([var]).cloned().collect();
                    self.passes(opened, body, &at.index(i).field("body"), &unset, found)?;
                }
                PassDecl::Include { expose: Expose::Only(names), .. } if names.is_empty() => {}
                PassDecl::Include { .. } => self.include(opened, pass, &at.index(i), unset, found)?,
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
        unset: &BTreeSet<String>,
        found: &mut Parameters,
    ) -> Result<(), Vec<Diagnostic>> {
        let PassDecl::Include { graph, name, set, expose, .. } = pass else { return Ok(()) };
        let graph_place = place.field("graph");
        let file = self.files.find(Some(opened.file), graph, Kind::Graph);
        let file = file.map_err(|e| vec![e.at(graph_place.span())])?;
        let chosen = self.choices.choose(file, self.files, 0)?;
        if self.around.contains(&chosen.opened.file) {
            return Err(vec![circular(graph, file, &graph_place, self.files)]);
        }
        let inner = self.graph(&chosen.opened)?;
        let at = place.field("expose");
        if let Expose::Only(names) = expose
            && let Some(i) = names.iter().position(|wanted| !inner.contains(wanted))
        {
            return Err(vec![inner.unknown(&names[i], at.index(0).index(i).span(), "exposed here")]);
        }
        let is_exposed = |name: &String| match expose {
            Expose::All => !set.contains_key(name),
            Expose::Only(names) => names.contains(name),
        };
        let given = |name: &String| {
            Some(Setting { number: set.get(name)?.clone(), place: place.field("set").field(name) })
        };
        let mut around = Around { unset: unset.clone(), ..Around::default() };
        for hidden in inner.all.iter().filter(|inner| !is_exposed(&inner.name)) {
            let (name, kind) = (hidden.name.clone(), hidden.declaration().kind().clone());
            match given(&name) {
                Some(setting) => drop(around.set.insert(name, Given { setting, kind })),
                None => drop(around.hidden.insert(name, hidden.place.key())),
            }
        }
        if let Expose::Only(names) = expose {
            let place = |(i, name): (usize, &String)| (name.clone(), at.index(0).index(i).span());
            around.exposed = names.iter().enumerate().map(place).collect();
        }
        let around = Rc::new(around);
        for declared in inner.all.iter().filter(|inner| is_exposed(&inner.name)) {
            let name_of = &declared.name;
            // A value in `set` uses this graph's names; a preset's value uses the included graph's.
            let level = declared.around.len();
            let default = (given(name_of).map(|setting| (setting, level + 1)))
                .or_else(|| Some((chosen.opened.set.get(name_of)?.clone(), level)))
                .or(declared.default.clone());
            let mut exposed = Declared { default, part: Some(name.clone()), ..declared.clone() };
            exposed.around.push(around.clone());
            if let Some(first) = found.all.iter().find(|other| other.name == *name_of) {
                let is_shared = first.place.key() == declared.place.key();
                if is_shared && first.has_default_of(&exposed) {
                    found.exposed.entry(place.id()).or_default().insert(name_of.clone());
                    continue;
                }
                let (default, remedy) = match is_shared {
                    true => (" with another default", "give both the same default"),
                    false => ("", "rename the first"),
                };
                let span =
                    first.default.as_ref().filter(|_| is_shared).map(|(setting, _)| setting.place.span());
                let span = span.unwrap_or_else(|| first.place.key());
                let message = format!("this graph already has the parameter `{name_of}`{default}");
                let error = Diagnostic::new(message, at.span(), "exposed here").with_label(span, "the first");
                let help = format!(
                    "{remedy}; or, if both mean the same, do not expose this one, and give it the first one's value: \
                     `set: {{ \"{name_of}\": \"{name_of}\" }}`"
                );
                return Err(vec![error.with_help(help)]);
            }
            found.exposed.entry(place.id()).or_default().insert(name_of.clone());
            found.all.push(exposed);
        }
        Ok(())
    }
}
