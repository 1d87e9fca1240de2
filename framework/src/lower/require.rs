//! Requirements: the needs of a graph held against the facts, and the fallbacks that stand in for it.

use super::Standing;
use super::document::{self, Fallback, MAX_DEPTH, Opened, Requirement};
use super::scope::{Names, Place};
use crate::ir::{FileId, Reason, Request, StandIn, Unmet};
use crate::schema::Number;
use crate::source::{Diagnostic, Kind, SourceMap};

/// Opens the graph that a request names, or the fallback that stands in for it.
///
/// An error says which needs do not hold where nothing suits the facts.
pub(super) fn open(
    request: &Request,
    files: &mut SourceMap,
) -> Result<(Opened, Vec<StandIn>), Vec<Diagnostic>> {
    let (opened, Standing { stand_ins, .. }, unmet) = standing(request, files)?;
    if unmet.is_empty() { Ok((opened, stand_ins)) } else { Err(explained(unmet, &stand_ins)) }
}

/// Follows the fallbacks to the first graph whose needs all hold.
///
/// The last part has an error for each need of the last one that does not.
pub(super) fn standing(
    request: &Request,
    files: &mut SourceMap,
) -> Result<(Opened, Standing, Vec<Diagnostic>), Vec<Diagnostic>> {
    let mut chain = chain(request.graph, files)?.into_iter().peekable();
    let names = Names::of(request.facts);
    let mut stand_ins = Vec::new();
    loop {
        let (wanted, opened) =
            chain.next().expect("a chain has an element, and each turn but the last leaves one");
        let (unmet, errors) = unmet(&opened.require, &names)?;
        match chain.peek() {
            Some((taken, _)) if !unmet.is_empty() => {
                stand_ins.push(StandIn { wanted, taken: taken.clone(), unmet });
            }
            _ => return Ok((opened, Standing { stand_ins, unmet }, errors)),
        }
    }
}

/// Reads the graph and its fallback, the fallback's own, and so on, with their names.
///
/// All are read whether they are needed or not: a mistake is to be found on every device.
fn chain(name: &str, files: &mut SourceMap) -> Result<Vec<(String, Opened)>, Vec<Diagnostic>> {
    let mut file = document::find(files, name)?;
    let mut name = name.to_string();
    let mut seen: Vec<(FileId, Option<Fallback>)> = Vec::new();
    let mut chain = Vec::new();
    loop {
        let opened = document::follow(files, file)?;
        let fallback = opened.fallback.clone();
        let needs = !opened.require.is_empty();
        chain.push((name, opened));
        let Some(next) = fallback else { return Ok(chain) };
        if !needs {
            let diagnostic =
                Diagnostic::new("this fallback is never taken", next.span, "the graph needs nothing");
            return Err(vec![
                diagnostic.with_help("state what it needs: `require: [(\"condition\", \"words\")]`"),
            ]);
        }
        let found = files.find(Some(next.file), &next.name, Kind::Graph);
        let found = found.map_err(|error| vec![error.at(next.span)])?;
        seen.push((file, Some(next.clone())));
        if let Some(first) = seen.iter().position(|(file, _)| *file == found) {
            let diagnostic = Diagnostic::new("these fallbacks lead to each other", next.span, "leads back");
            let others = seen[first..seen.len() - 1].iter().filter_map(|(_, fallback)| fallback.as_ref());
            return Err(vec![
                others.fold(diagnostic, |d, other| d.with_label(other.span, "falls back to this")),
            ]);
        }
        if seen.len() > MAX_DEPTH {
            let message = format!("fallbacks follow one another deeper than {MAX_DEPTH}");
            return Err(vec![Diagnostic::new(message, next.span, "the limit is passed here")]);
        }
        (name, file) = (next.name, found);
    }
}

/// Finds the needs that do not hold, each with the error that it is where no fallback stands in.
fn unmet(require: &[Requirement], names: &Names) -> Result<(Vec<Unmet>, Vec<Diagnostic>), Vec<Diagnostic>> {
    let (mut unmet, mut refused, mut errors) = (Vec::new(), Vec::new(), Vec::new());
    for requirement in require {
        let at = Place::new(&requirement.outline, requirement.path.index(0));
        let condition = Number::Expression(requirement.condition.clone());
        match names.truth(&condition, &at) {
            Ok(true) => {}
            Ok(false) => {
                let literal =
                    Reason { expression: requirement.condition.text.clone(), values: Default::default() };
                let reason = names.reason(&requirement.condition).unwrap_or(literal);
                let needs = requirement.words.clone();
                let message = format!("this graph needs {needs}");
                let found =
                    if reason.values.is_empty() { "is false".into() } else { format!("found {reason}") };
                refused.push(
                    Diagnostic::new(message, at.span(), found)
                        .with_help("a `fallback` names a graph that stands in where it does not hold"),
                );
                unmet.push(Unmet { needs, reason });
            }
            Err(diagnostic) => errors.push(diagnostic),
        }
    }
    if errors.is_empty() { Ok((unmet, refused)) } else { Err(errors) }
}

/// Adds to errors that another graph stands in for the one that was asked for.
pub(super) fn explained(errors: Vec<Diagnostic>, stand_ins: &[StandIn]) -> Vec<Diagnostic> {
    let explain = |error: Diagnostic| stand_ins.iter().fold(error, |error, s| error.with_help(s.to_string()));
    errors.into_iter().map(explain).collect()
}
