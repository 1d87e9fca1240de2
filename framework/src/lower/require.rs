//! Checks the requirements of graphs against the facts, and chooses a graph accordingly.

use std::collections::HashMap;
use std::rc::Rc;

use super::document::{self, MAX_DEPTH, Opened, Requirement};
use super::scope::Names;
use crate::ir::{Fallback, FileId, Reason, Request, Unmet, Value};
use crate::schema::{Number, PassDecl, folded};
use crate::source::{Diagnostic, Kind, SourceMap};

/// A graph that a file leads to, with its unmet requirements.
#[derive(Debug)]
pub(super) struct Chosen {
    pub opened: Rc<Opened>,
    pub fallbacks: Vec<Fallback>,
    pub unmet: Vec<Unmet>,
    /// The unmet requirements as errors.
    pub errors: Vec<Diagnostic>,
}

type Found = Result<Rc<Chosen>, Vec<Diagnostic>>;

/// The graphs that were chosen by the facts of a request, one per file.
pub(super) struct Choices<'a> {
    request: &'a Request<'a>,
    /// The graph chosen for each file; `None` while the file's own includes are being visited.
    known: HashMap<FileId, Option<Found>>,
    /// Index of the graph to use if the request's graph is a choice; `None` for the first whose requirements hold.
    pub candidate: Option<usize>,
}

impl<'a> Choices<'a> {
    pub fn new(request: &'a Request<'a>) -> Self {
        Choices { request, known: HashMap::new(), candidate: None }
    }

    /// Returns the graph with index [`Self::candidate`], or else the one that [`Self::standing`] finds. Fails with the
    /// graph's unmet requirements.
    pub fn root(&mut self, files: &mut SourceMap) -> Result<Rc<Chosen>, Vec<Diagnostic>> {
        let chosen = match self.candidate {
            Some(index) => {
                let mut all = self.candidates(files)?;
                Rc::new(all.swap_remove(index.min(all.len() - 1)))
            }
            None => self.standing(files)?,
        };
        if chosen.unmet.is_empty() {
            Ok(chosen)
        } else {
            Err(explained(chosen.errors.clone(), &chosen.fallbacks))
        }
    }

    pub fn standing(&mut self, files: &mut SourceMap) -> Result<Rc<Chosen>, Vec<Diagnostic>> {
        let file = document::find(files, self.request.graph)?;
        self.choose(file, files, 0)
    }

    /// Returns every graph of the request's choice, at least one, with its unmet requirements.
    pub fn candidates(&mut self, files: &mut SourceMap) -> Result<Vec<Chosen>, Vec<Diagnostic>> {
        let file = document::find(files, self.request.graph)?;
        let mut found = Vec::new();
        for opened in document::follow(files, file)? {
            let Needs { unmet, errors, .. } = self.needs(&opened, files, 0)?;
            found.push(Chosen { opened: Rc::new(opened), fallbacks: Vec::new(), unmet, errors });
        }
        Ok(found)
    }

    /// Returns the first graph of `file` whose requirements hold, or else the last one.
    pub fn choose(
        &mut self,
        file: FileId,
        files: &mut SourceMap,
        depth: usize,
    ) -> Result<Rc<Chosen>, Vec<Diagnostic>> {
        if let Some(Some(known)) = self.known.get(&file) {
            return known.clone();
        }
        self.known.insert(file, None);
        let chosen = self.first(file, files, depth).map(Rc::new);
        self.known.insert(file, Some(chosen.clone()));
        chosen
    }

    fn first(
        &mut self,
        file: FileId,
        files: &mut SourceMap,
        depth: usize,
    ) -> Result<Chosen, Vec<Diagnostic>> {
        let mut all = document::follow(files, file)?.into_iter().peekable();
        let asked = self.request.graph;
        let name = |opened: &Opened| opened.candidate.clone().unwrap_or_else(|| asked.to_string());
        let mut fallbacks = Vec::new();
        loop {
            let opened = all.next().expect("a choice has a graph, and each turn but the last leaves one");
            let Needs { unmet, errors, preference } = self.needs(&opened, files, depth)?;
            match all.peek() {
                Some(next) if !unmet.is_empty() => {
                    fallbacks.push(Fallback { wanted: name(&opened), taken: name(next), unmet, preference });
                }
                _ => return Ok(Chosen { opened: Rc::new(opened), fallbacks, unmet, errors }),
            }
        }
    }

    /// Collects the unmet requirements of a graph, and of the graphs that it includes unconditionally.
    fn needs(
        &mut self,
        opened: &Opened,
        files: &mut SourceMap,
        depth: usize,
    ) -> Result<Needs, Vec<Diagnostic>> {
        let mut needs = unmet(&opened.require, &Names::of(self.request.facts))?;
        // The walk reports circular and missing includes.
        if depth < MAX_DEPTH {
            for graph in always_included(&opened.graph.passes) {
                let Ok(file) = files.find(Some(opened.file), graph, Kind::Graph) else { continue };
                if matches!(self.known.get(&file), Some(None)) {
                    continue;
                }
                let Ok(chosen) = self.choose(file, files, depth + 1) else { continue };
                needs.preference &= chosen.unmet.is_empty();
                // Report a requirement once, even if its part is included several times.
                for (unmet, error) in chosen.unmet.iter().zip(&chosen.errors) {
                    if !needs.unmet.contains(unmet) {
                        needs.unmet.push(unmet.clone());
                        needs.errors.push(error.clone());
                    }
                }
            }
        }
        Ok(needs)
    }
}

#[derive(Default)]
struct Needs {
    unmet: Vec<Unmet>,
    errors: Vec<Diagnostic>,
    /// True if all unmet requirements come from a choice: the graph could run, but another is preferred.
    preference: bool,
}

fn always_included(passes: &[PassDecl]) -> Vec<&str> {
    let graphs = passes.iter().flat_map(|pass| match pass {
        PassDecl::Include { graph, when: None, .. } => vec![graph.as_str()],
        PassDecl::Repeat { count: Number::Literal(Value::Int(1..)), body, .. } => always_included(body),
        _ => Vec::new(),
    });
    graphs.collect()
}

fn unmet(require: &[Requirement], names: &Names) -> Result<Needs, Vec<Diagnostic>> {
    let mut needs = Needs { preference: true, ..Needs::default() };
    let mut errors = Vec::new();
    for requirement in require {
        let at = requirement.place.index(0);
        let condition = Number::Expression(requirement.condition.clone());
        match names.truth(&condition, &at) {
            Ok(true) => {}
            Ok(false) => {
                let expression = requirement.condition.line();
                let literal = Reason { expression, values: Default::default() };
                let reason = names.reason(&condition).unwrap_or(literal);
                let words = folded(&requirement.words);
                let message = format!("this graph needs {words}");
                let found =
                    if reason.values.is_empty() { "is false".into() } else { format!("found {reason}") };
                needs.errors.push(Diagnostic::new(message, at.span(), found).with_help(
                    "a `Choice` names graphs in order of preference, and draws the first whose requirements are met",
                ));
                needs.unmet.push(Unmet { needs: words, reason });
                needs.preference &= requirement.preference;
            }
            Err(diagnostic) => errors.push(diagnostic),
        }
    }
    if errors.is_empty() { Ok(needs) } else { Err(errors) }
}

/// Adds every fallback to the errors as help. The errors may be about a graph that the user did not ask for.
pub(super) fn explained(errors: Vec<Diagnostic>, fallbacks: &[Fallback]) -> Vec<Diagnostic> {
    let explain = |error: Diagnostic| fallbacks.iter().fold(error, |error, s| error.with_help(s.to_string()));
    errors.into_iter().map(explain).collect()
}
