//! Loading of graph files, and the chain of presets that leads to one.

use indexmap::IndexMap;
use std::rc::Rc;

use crate::ir::{FileId, Span};
use crate::schema::{Document, Expression, GRAPH_VERSION, Graph, Number};
use crate::source::{Diagnostic, Kind, Outline, Path, SourceMap, ron_error};

/// A graph with what presets changed of it.
#[derive(Clone, Debug)]
pub(super) struct Opened {
    pub file: FileId,
    pub graph: Rc<Graph>,
    pub outline: Rc<Outline>,
    /// The summary of the outermost preset, or of the graph.
    pub summary: String,
    /// Settings of the presets, outer ones already laid over inner ones.
    pub set: IndexMap<String, Setting>,
    /// The graphs and presets that it is based on, as the presets name them, the graph last.
    pub based_on: Vec<String>,
    /// The needs of the presets and the graph.
    pub require: Vec<Requirement>,
    /// The fallback of the outermost preset that has one, or of the graph.
    pub fallback: Option<Fallback>,
}

/// A need of a graph or a preset: an entry of `require`.
#[derive(Clone, Debug)]
pub(super) struct Requirement {
    pub condition: Expression,
    pub words: String,
    pub outline: Rc<Outline>,
    pub path: Path,
}

/// The `fallback` of a graph or a preset.
#[derive(Clone, Debug)]
pub(super) struct Fallback {
    pub name: String,
    /// The file that names it.
    pub file: FileId,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub(super) struct Setting {
    pub number: Number,
    pub outline: Rc<Outline>,
    pub path: Path,
}

/// Limits how deep presets and includes nest, so that the stack cannot overflow.
pub(super) const MAX_DEPTH: usize = 16;

/// Finds a graph that is named on the command line.
pub(super) fn find(files: &mut SourceMap, name: &str) -> Result<FileId, Vec<Diagnostic>> {
    files.find(None, name, Kind::Graph).map_err(|error| {
        // There is no file to point into: the name is shown as a text of its own.
        let file = files.add("command line", name);
        vec![error.at(Span { file, start: 0, end: name.len() })]
    })
}

/// Reads a file; where it is a preset, goes on to its graph.
pub(super) fn follow(files: &mut SourceMap, mut file: FileId) -> Result<Opened, Vec<Diagnostic>> {
    let mut set = IndexMap::new();
    let mut summary = None;
    let (mut based_on, mut require, mut fallback) = (Vec::new(), Vec::new(), None);
    let mut chain: Vec<(FileId, Span)> = Vec::new();
    loop {
        let (document, outline) = parse(files, file)?;
        let (needs, stand_in) = match &document {
            Document::Graph(graph) => (&graph.require, &graph.fallback),
            Document::Preset(preset) => (&preset.require, &preset.fallback),
        };
        require.extend(needs.iter().enumerate().map(|(index, (condition, words))| Requirement {
            condition: condition.clone(),
            words: words.clone(),
            outline: outline.clone(),
            path: Path::root().field("require").index(index),
        }));
        if let (None, Some(name)) = (&fallback, stand_in) {
            let span = outline.value(&Path::root().field("fallback"));
            fallback = Some(Fallback { name: name.clone(), file, span });
        }
        match document {
            Document::Graph(graph) => {
                if graph.version != GRAPH_VERSION {
                    let at = outline.value(&Path::root().field("version"));
                    return Err(vec![Diagnostic::new(
                        format!("this graph is of version {}", graph.version),
                        at,
                        format!("this program reads version {GRAPH_VERSION}"),
                    )]);
                }
                let summary = summary.unwrap_or_else(|| graph.summary.clone());
                return Ok(Opened {
                    file,
                    graph: Rc::new(graph),
                    outline,
                    summary,
                    set,
                    based_on,
                    require,
                    fallback,
                });
            }
            Document::Preset(preset) => {
                let base = outline.value(&Path::root().field("graph"));
                chain.push((file, base));
                summary.get_or_insert(preset.summary);
                for (name, number) in preset.set {
                    let path = Path::root().field("set").key(&name);
                    set.entry(name).or_insert(Setting { number, outline: outline.clone(), path });
                }
                let next =
                    files.find(Some(file), &preset.graph, Kind::Graph).map_err(|e| vec![e.at(base)])?;
                if chain.len() > MAX_DEPTH {
                    let message = format!("presets are based on one another deeper than {MAX_DEPTH}");
                    return Err(vec![Diagnostic::new(message, base, "the limit is passed here")]);
                }
                if chain.iter().any(|(seen, _)| *seen == next) {
                    let mut diagnostic =
                        Diagnostic::new("these presets are based on each other", base, "leads back");
                    for (_, span) in &chain[..chain.len() - 1] {
                        diagnostic = diagnostic.with_label(*span, "based on this");
                    }
                    return Err(vec![diagnostic]);
                }
                based_on.push(preset.graph);
                file = next;
            }
        }
    }
}

/// Reads one file, without following anything.
pub(super) fn parse(files: &SourceMap, file: FileId) -> Result<(Document, Rc<Outline>), Vec<Diagnostic>> {
    let text = files.text(file);
    // The outline is made first because it limits the depth of nesting, which the RON parser recurses into.
    let outline = Outline::parse(file, text).map_err(|e| vec![e])?;
    let document = Document::parse(text).map_err(|e| vec![ron_error(file, text, &e)])?;
    let twice = outline.duplicates();
    if twice.is_empty() { Ok((document, Rc::new(outline))) } else { Err(twice) }
}
