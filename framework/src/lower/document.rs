//! Loads graph files, and follows presets and choices to them.

use indexmap::IndexMap;
use ron::error::Error;
use std::rc::Rc;

use crate::ir::{FileId, Span};
use crate::schema::{Document, Expression, GRAPH_VERSION, Graph, Number};
use crate::source::{Diagnostic, Kind, Outline, Place, SourceMap, ron_error};

/// A graph with the settings of its presets.
#[derive(Clone, Debug)]
pub(super) struct Opened {
    pub file: FileId,
    pub graph: Rc<Graph>,
    pub root: Place,
    /// The summary of the outermost preset or choice, or of the graph.
    pub summary: String,
    /// Settings of the presets, merged; outer presets win.
    pub set: IndexMap<String, Setting>,
    /// The names that presets and choices refer to, outermost first; the last one names this graph. Empty if the
    /// requested file is itself a graph.
    pub based_on: Vec<String>,
    /// Name by which the innermost choice refers to the graph; `None` if the graph comes from no choice.
    pub candidate: Option<String>,
    /// All graphs of the choice, including this one; empty if there is only one.
    pub others: Rc<Vec<Opened>>,
    /// Requirements of choices, presets and the graph, outermost first.
    pub require: Vec<Requirement>,
}

/// An entry of `require` of a graph, of a preset, or of a choice for one of its graphs.
#[derive(Clone, Debug)]
pub(super) struct Requirement {
    pub condition: Expression,
    pub words: String,
    pub place: Place,
    /// True if the requirement is in a choice: the graph would run, but another is preferred.
    pub preference: bool,
}

#[derive(Clone, Debug)]
pub(super) struct Setting {
    pub number: Number,
    pub place: Place,
}

/// Maximum nesting of presets, choices and includes, so that the stack cannot overflow.
pub(super) const MAX_DEPTH: usize = 16;

/// Maximum number of graphs reachable from a choice: nested choices could double them at each level.
const MAX_CANDIDATES: usize = 64;

/// Finds the file of a request's graph. An error points into the file, or into the name if there is no file.
pub(super) fn find(files: &mut SourceMap, name: &str) -> Result<FileId, Vec<Diagnostic>> {
    files.find(None, name, Kind::Graph).map_err(|error| {
        let (path, text) = match (&error.place, &error.why, error.tried.last()) {
            (Some(_), ..) => return vec![Diagnostic { secondary: Vec::new(), ..error.at(Span::default()) }],
            // The text of an unreadable file is not known.
            (None, Some(_), Some(path)) => (path.as_str(), ""),
            _ => ("command line", name),
        };
        let file = files.add(path, text);
        vec![error.at(Span::new(file, 0..text.len()))]
    })
}

/// Reads a file and follows presets and choices to the possible graphs, in order of preference. Reads all of them, so
/// that mistakes are found on every device.
pub(super) fn follow(files: &mut SourceMap, file: FileId) -> Result<Vec<Opened>, Vec<Diagnostic>> {
    let mut all = Follow { files, chain: Vec::new(), found: 0 }.file(file)?;
    if all.len() > 1 {
        let others = Rc::new(all.clone());
        all.iter_mut().for_each(|opened| opened.others = others.clone());
    }
    Ok(all)
}

struct Follow<'a> {
    files: &'a mut SourceMap,
    /// Presets and choices on the path, each with the place where it names the next.
    chain: Vec<(FileId, Span)>,
    found: usize,
}

impl Follow<'_> {
    fn file(&mut self, file: FileId) -> Result<Vec<Opened>, Vec<Diagnostic>> {
        let (document, root) = parse(self.files, file)?;
        match document {
            Document::Graph(graph) => {
                if graph.version != GRAPH_VERSION {
                    let at = root.field("version").span();
                    let message = format!("this graph has version {}", graph.version);
                    let read = format!("this program reads version {GRAPH_VERSION}");
                    return Err(vec![Diagnostic::new(message, at, read)]);
                }
                self.found += 1;
                let require = requirements(&graph.require, &root, false);
                let summary = graph.summary.clone();
                let (set, based_on) = (IndexMap::new(), Vec::new());
                let graph = Rc::new(graph);
                Ok(vec![Opened {
                    file,
                    graph,
                    root,
                    summary,
                    set,
                    based_on,
                    candidate: None,
                    others: Rc::default(),
                    require,
                }])
            }
            Document::Preset(preset) => {
                let at = root.field("graph").span();
                let mut all = self.next(file, &preset.graph, at, "these presets are based on each other")?;
                for opened in &mut all {
                    opened.summary.clone_from(&preset.summary);
                    let mut set = IndexMap::new();
                    for (name, number) in &preset.set {
                        let (number, place) = (number.clone(), root.field("set").field(name));
                        set.insert(name.clone(), Setting { number, place });
                    }
                    for (name, setting) in std::mem::take(&mut opened.set) {
                        set.entry(name).or_insert(setting);
                    }
                    opened.set = set;
                    opened.based_on.insert(0, preset.graph.clone());
                    opened.require.splice(0..0, requirements(&preset.require, &root, false));
                }
                Ok(all)
            }
            Document::Choice(choice) => {
                let mut all = Vec::new();
                for (index, candidate) in choice.of.iter().enumerate() {
                    let place = root.field("of").index(index);
                    let at = place.field("graph").span();
                    let mut found =
                        self.next(file, &candidate.graph, at, "these choices lead to each other")?;
                    for opened in &mut found {
                        opened.summary.clone_from(&choice.summary);
                        opened.based_on.insert(0, candidate.graph.clone());
                        opened.candidate.get_or_insert_with(|| candidate.graph.clone());
                        opened.require.splice(0..0, requirements(&candidate.require, &place, true));
                    }
                    all.append(&mut found);
                    if self.found > MAX_CANDIDATES {
                        let message = format!("this is a choice of over {MAX_CANDIDATES} graphs");
                        return Err(vec![Diagnostic::new(message, at, "the limit is exceeded here")]);
                    }
                }
                if all.is_empty() {
                    let at = root.field("of").span();
                    return Err(vec![Diagnostic::new("this choice has no graph", at, "is empty")]);
                }
                Ok(all)
            }
        }
    }

    /// Follows the reference of a preset or a choice to its graphs. `at` is the place of the reference in `file`, and
    /// `circle` the error message for a cycle.
    fn next(
        &mut self,
        file: FileId,
        name: &str,
        at: Span,
        circle: &str,
    ) -> Result<Vec<Opened>, Vec<Diagnostic>> {
        let next = self.files.find(Some(file), name, Kind::Graph).map_err(|e| vec![e.at(at)])?;
        self.chain.push((file, at));
        if self.chain.len() > MAX_DEPTH {
            let message = format!("presets and choices are nested deeper than {MAX_DEPTH}");
            return Err(vec![Diagnostic::new(message, at, "the limit is exceeded here")]);
        }
        if let Some(first) = self.chain.iter().position(|(seen, _)| *seen == next) {
            let others = &self.chain[first..self.chain.len() - 1];
            let diagnostic = Diagnostic::new(circle, at, "leads back");
            return Err(vec![others.iter().fold(diagnostic, |d, (_, span)| d.with_label(*span, "leads on"))]);
        }
        let found = self.file(next)?;
        self.chain.pop();
        Ok(found)
    }
}

fn requirements(needs: &[(Expression, String)], of: &Place, preference: bool) -> Vec<Requirement> {
    let requirement = |(index, (condition, words)): (usize, &(Expression, String))| {
        let (condition, words) = (condition.clone(), words.clone());
        Requirement { condition, words, place: of.field("require").index(index), preference }
    };
    needs.iter().enumerate().map(requirement).collect()
}

pub(super) fn parse(files: &SourceMap, file: FileId) -> Result<(Document, Place), Vec<Diagnostic>> {
    let text = files.text(file);
    // The outline comes first because it limits the nesting, on which the RON parser recurses.
    let outline = Outline::parse(file, text).map_err(|e| vec![e])?;
    let read = |text: &str| Document::parse(text).map(drop);
    let document = Document::parse(text).map_err(|error| {
        let mut found = ron_error(&outline, text, &error, &read);
        if matches!(&error.code, Error::NoSuchEnumVariant { found, outer, .. }
            if found.as_str() == "Scenes" && outer.as_deref() == Some("Document"))
        {
            found.message = "expected a graph, a preset or a choice, found a list of scenes".into();
            found.primary.text.clear();
            found.help = vec!["commands take a list of scenes in place of a scene".into()];
        }
        vec![found]
    })?;
    match outline.duplicates() {
        [] => Ok((document, Place::root(&Rc::new(outline)))),
        twice => Err(twice.to_vec()),
    }
}
