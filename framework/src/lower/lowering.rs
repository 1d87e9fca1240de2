//! Defines the state of the walk over the passes, and the state of each graph file in it.

use indexmap::IndexMap;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use super::declared::{Exposed, Known};
use super::defines::{Constants, capital, defines, option_define};
use super::document::Opened;
use super::lowered::{Lowered, SkippedUse};
use super::params::live_glsl;
use super::require::{Choices, Chosen};
use super::reserved::is_macro;
use super::scope::Names;
use crate::expr::name_unknown_in;
use crate::ir::{Domain, EXPORT, FileId, HOST, Param, ParamSet, Request, ResourceId, Span};
use crate::schema::{Expression, Graph, Number};
use crate::source::{Diagnostic, MAX_RENDERED, Place, SourceMap};

/// Name of an included graph's output: the includer refers to it as `include.picture`.
pub(super) const PICTURE: &str = "picture";

/// Maximum number of passes after repeats, so that a typing error cannot exhaust memory.
pub(super) const MAX_PASSES: usize = 20_000;

const RENAME: &str =
    "constants are in capitals there, and a choice adds one for each of its values: rename one of them";

/// Maximum number of steps of the walk. These are one step each: a pass, an entry of a pass's lists (such as `bind` and
/// `push`), an iteration of a repeat, and a declaration of an included graph.
const MAX_STEPS: usize = 25 * MAX_PASSES;

pub(super) struct Lowering<'a> {
    pub request: &'a Request<'a>,
    pub files: &'a mut SourceMap,
    pub errors: Vec<Diagnostic>,
    /// The result so far.
    pub lowered: Lowered,
    pub resource_names: BTreeMap<String, Span>,
    pub ping_pongs: Vec<PingPong>,
    /// Number of steps so far. The walk ends once it exceeds [`MAX_STEPS`].
    steps: usize,
    pub choices: Choices<'a>,
    pub known: Known,
    /// Names of passes, with their places; `None` for reserved names.
    pub pass_names: BTreeMap<String, Option<Span>>,
    pub include_names: BTreeMap<String, Span>,
    pub histories: Vec<History>,
    /// The requested graph's file and the files being included, outermost first.
    pub includes: Vec<FileId>,
}

/// One graph file in the walk: the root, or an include.
pub(super) struct Level {
    pub file: FileId,
    pub graph: Rc<Graph>,
    pub root: Place,
    pub names: Names,
    pub params: Vec<Param>,
    pub exposed: Exposed,
    /// Resources by name; `None` for an invalid declaration.
    pub handles: IndexMap<String, Option<Handle>>,
    /// For each name of an included resource (`include.name`), the parameters that decide which resource it means.
    pub given: BTreeMap<String, ParamSet>,
    /// Includes without resources, with the place of the `when` or `count` that removed them; `None` for invalid ones.
    pub absent: BTreeMap<String, Option<Span>>,
    /// The graphs of the includes so far, by the include's name.
    pub included: BTreeMap<String, Rc<Chosen>>,
    /// Prefix for the names of passes and resources.
    pub prefix: String,
    /// Suffix for the names of passes and includes: the indices of repeats.
    pub suffix: String,
    /// Index into [`Lowered::includes`]; `None` for the root.
    pub include: Option<usize>,
    /// Parameters that the includes and repeats around the current pass depend on.
    pub around: ParamSet,
    pub defines: Rc<Vec<(String, String)>>,
    pub unfit: Rc<Vec<(String, String)>>,
    pub live_glsl: Rc<str>,
    /// Parameters that each constant depends on; see [`LoweredPass::constants`].
    pub constants: Rc<BTreeMap<String, ParamSet>>,
}

impl Level {
    /// Records the parameters that decide which resource of an include a name refers to.
    pub fn note_given(&self, name: &str) {
        if let Some(params) = self.given.get(name) {
            self.names.note_decided(params);
        }
    }

    /// Returns true if the graph declares a resource of this name, or if an include can have it. It can if it is
    /// removed or invalid, if any graph of its choice declares the resource, or if the name is of a nested include,
    /// which is not searched.
    pub fn may_have(&self, name: &str) -> bool {
        let Some((include, rest)) = name.split_once('.') else { return self.handles.contains_key(name) };
        let declares = |graph: &Graph| {
            let Graph { resources, imports, lets, params, output, .. } = graph;
            let is_declared = resources.contains_key(rest) || imports.contains_key(rest);
            // A constant can hold a resource's name.
            let is_constant = lets.contains_key(rest) || params.contains_key(rest);
            is_declared || is_constant || rest == PICTURE && output.is_some()
        };
        let has = |chosen: &Rc<Chosen>| {
            let Opened { graph, others, .. } = &*chosen.opened;
            rest.contains('.') || declares(graph) || others.iter().any(|other| declares(&other.graph))
        };
        self.absent.contains_key(include) || self.included.get(include).is_some_and(has)
    }
}

pub(super) struct Scope {
    /// Facts and parameters.
    pub names: Names,
    pub params: Vec<Param>,
    pub exposed: Exposed,
}

/// The resources that a name of a graph refers to.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Handle {
    /// One resource, or the planes of an attribute.
    Plain(Vec<ResourceId>),
    /// Index into [`Lowering::ping_pongs`].
    PingPong(usize),
}

/// Two buffers. `Swap` changes which one is the front.
#[derive(Clone, Debug)]
pub(super) struct PingPong {
    pub halves: [ResourceId; 2],
    pub front: usize,
    /// Number of swaps so far.
    pub swaps: usize,
}

impl PingPong {
    pub fn in_front(&self) -> ResourceId {
        self.halves[self.front]
    }
}

#[derive(Clone, Debug)]
pub(super) struct History {
    pub name: String,
    pub previous_frame: ResourceId,
    pub of: Handle,
}

/// Returns the places of the graph's own parameters and `let`s that define the constant `define`, also as an option.
fn declarations_of(define: &str, opened: &Opened, params: &[Param]) -> Vec<Span> {
    let names = |name: &str| {
        let options = params.iter().find(|param| param.name == *name).map(|param| &param.domain);
        let mut options = match options {
            Some(Domain::Choice(of)) => of.iter(),
            _ => [].iter(),
        };
        capital(name) == define || options.any(|option| option_define(name, option) == define)
    };
    let own =
        |list: &'static str, name: &String| names(name).then(|| opened.root.field(list).field(name).key());
    let params = opened.graph.params.keys().filter_map(|name| own("params", name));
    params.chain(opened.graph.lets.keys().filter_map(|name| own("let", name))).collect()
}

/// Returns true if the value of the `let` `from` depends on the `let` `on`, directly or through other `let`s.
fn needs(lets: &IndexMap<String, Number>, from: &str, on: &str) -> bool {
    let (mut open, mut seen) = (vec![from], BTreeSet::new());
    while let Some(name) = open.pop() {
        let Some(Number::Expression(Expression { parsed: Ok(expression), .. })) = lets.get(name) else {
            continue;
        };
        for (name, _) in expression.names() {
            if name == on {
                return true;
            }
            if seen.insert(name) {
                open.push(name);
            }
        }
    }
    false
}

impl<'a> Lowering<'a> {
    pub fn new(
        request: &'a Request<'a>,
        files: &'a mut SourceMap,
        (choices, known): (Choices<'a>, Known),
        lowered: Lowered,
    ) -> Self {
        Lowering {
            request,
            files,
            errors: Vec::new(),
            lowered,
            resource_names: BTreeMap::new(),
            ping_pongs: Vec::new(),
            steps: 0,
            choices,
            known,
            // Reserved for the frame's last passes, which the solver adds.
            pass_names: [EXPORT, HOST].map(|name| (name.to_string(), None)).into(),
            include_names: BTreeMap::new(),
            histories: Vec::new(),
            includes: Vec::new(),
        }
    }

    /// Creates a level: evaluates its `let`s, and lists its defines. Their errors are added to [`Self::errors`].
    pub(super) fn level(&mut self, opened: &Opened, scope: Scope, prefix: String) -> Level {
        let Scope { mut names, params, exposed } = scope;
        let lets = &opened.graph.lets;
        let mut failed = BTreeSet::new();
        for (at, (name, number)) in lets.iter().enumerate() {
            let place = opened.root.field("let").field(name);
            let taken = "the name is already used by a parameter, a fact or a `let`";
            if let Err(error) = names.check_new(name, "a `let`", taken, place.key()) {
                self.errors.push(error);
                continue;
            }
            let (value, read) = names.traced(|| names.evaluate(number, &place));
            match value {
                Ok(value) => {
                    let params: ParamSet = names.named_by(number).difference(&read).copied().collect();
                    if !params.is_empty() {
                        let reason = names.traced(|| names.reason(number)).0;
                        let (name, span, decided) = (name.clone(), place.key(), read.clone());
                        self.lowered.skipped.push(SkippedUse { params, name, span, decided, reason });
                    }
                    if names.is_constant(number) {
                        names.constants.insert(name.clone());
                    }
                    names.define_let(name, number, value, read);
                }
                Err(diagnostic) => {
                    let unknown = name_unknown_in(&diagnostic.primary.text);
                    // If the unknown name is a `let` that failed, this error is only a consequence.
                    let told = unknown.is_some_and(|other| failed.contains(other));
                    failed.insert(name.as_str());
                    if told {
                        continue;
                    }
                    let key_of = |name: &String| opened.root.field("let").field(name).key();
                    let known = unknown.and_then(|other| lets.get_full(other));
                    let later = known.filter(|(other, ..)| *other >= at).map(|(_, name, _)| name);
                    self.errors.push(match later {
                        None => diagnostic,
                        // Each search may walk all `let`s, so errors that are not printed have none.
                        Some(later) if self.errors.len() < MAX_RENDERED && needs(lets, later, name) => {
                            let message = format!("the value of `{name}` depends on itself");
                            let span = diagnostic.primary.span;
                            let error = Diagnostic::new(message, span, format!("needs `{later}`"));
                            match later == name {
                                true => error,
                                false => error
                                    .with_label(key_of(later), format!("needs `{name}`, directly or not")),
                            }
                        }
                        Some(later) => Diagnostic { help: Vec::new(), ..diagnostic }
                            .with_label(key_of(later), "declared below")
                            .with_help("a `let` can use only those above it: move this one down"),
                    });
                }
            }
        }
        let Constants { defines, unfit, params: constants, of } = defines(&names, &params);
        for (define, mut of) in of {
            let places = || declarations_of(&define, opened, &params);
            // An exposed parameter has no place here: the graph that declares it reports the error.
            if is_macro(&define)
                && defines.iter().any(|(name, _)| *name == define)
                && let Some(place) = places().first()
            {
                let message = format!("`{define}` cannot name a constant of shaders");
                let error = Diagnostic::new(message, *place, "GLSL reserves this macro");
                self.errors.push(error.with_help(RENAME));
            }
            // A `let` may repeat the constant of the same name in shaders, such as a fact: the value is the same.
            let is_alias = |name: &str| match lets.get(name) {
                Some(Number::Expression(Expression { text, .. })) => {
                    names.values.contains_key(text) && capital(text) == define
                }
                _ => false,
            };
            of.retain(|constant| !is_alias(&constant.name));
            if of.len() > 1 {
                let all = of.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ");
                let message = format!("expected different names in shaders, found `{define}` for {all}");
                let mut places = places().into_iter().rev();
                let error = match places.next() {
                    Some(last) => Diagnostic::new(message, last, "declared here"),
                    None => Diagnostic::new(message, opened.root.head(), "in this graph"),
                };
                let error = places.rev().fold(error, |error, place| error.with_label(place, "and here"));
                self.errors.push(error.with_help(RENAME));
            }
        }
        let live_glsl = live_glsl(&params).into();
        Level {
            file: opened.file,
            graph: opened.graph.clone(),
            root: opened.root.clone(),
            names,
            params,
            exposed,
            handles: IndexMap::new(),
            given: BTreeMap::new(),
            absent: BTreeMap::new(),
            included: BTreeMap::new(),
            prefix,
            suffix: String::new(),
            include: None,
            around: ParamSet::new(),
            defines: Rc::new(defines),
            unfit: Rc::new(unfit),
            live_glsl,
            constants: Rc::new(constants),
        }
    }

    /// Unwraps a result. Adds its errors to [`Self::errors`] and returns `None` if it failed.
    pub(super) fn reported<T>(&mut self, result: Result<T, Vec<Diagnostic>>) -> Option<T> {
        result.map_err(|errors| self.errors.extend(errors)).ok()
    }

    /// Adds `steps` to the steps so far. Returns false if the sum exceeds [`MAX_STEPS`]; the first time, adds an error
    /// at `place`.
    pub(super) fn count(&mut self, steps: usize, place: &Place) -> bool {
        let before = self.steps;
        self.steps = before.saturating_add(steps);
        if before <= MAX_STEPS && self.steps > MAX_STEPS {
            let message = format!("this graph has over {MAX_STEPS} steps, including repeats");
            self.errors.push(place.error(message, "while walking this one"));
        }
        self.steps <= MAX_STEPS
    }
}
