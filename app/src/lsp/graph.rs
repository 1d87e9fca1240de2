//! Builds the open graphs, and answers requests about them.

use super::cursor::{self, Scan};
use super::files::{self, LANES, Search, is_graph, nominal_case};
use super::index::{Index, Place};
use super::{hints, names, rename, text};
use crate::draw::backend;
use crate::draw::planner::{GraphErrors, PlainDiagnostic, Planner, Severity};
use crate::draw::requirements::{self, Case, Unchecked};
use lsp_types::{Diagnostic, DiagnosticSeverity, InlayHint, Location, Range, TextEdit, Uri};
use splatgraph_assets::grouped;
use splatgraph_framework::dump::Dump;
use splatgraph_framework::ir::{LIVE_BLOCK, Param, Shape};
use splatgraph_framework::lower::{self, Control, ExpressionNames};
use splatgraph_framework::plan::{Plan, Warning};
use splatgraph_framework::schema::Document;
use splatgraph_framework::source::{self, Kind};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

/// Maximum number of closed graphs that are built to find one that uses an open file.
const MAX_TRIES: usize = 4;

/// The texts of the open files, the planner, and the graphs that were built.
#[derive(Default)]
pub struct Workspace {
    /// Texts of the files that are open in the editor, by path.
    pub open: BTreeMap<PathBuf, String>,
    /// Folders that are open in the editor. They may use files of the folders given by `--include-root`.
    pub folders: Vec<PathBuf>,
    pub(super) planner: Planner,
    /// The open graphs, and closed graphs that use an open shader or part.
    pub(super) built: BTreeMap<PathBuf, Built>,
    /// Graphs to build, the next first.
    queue: VecDeque<PathBuf>,
    /// For open shaders and parts that no open graph uses: closed graphs to try, the last first.
    users: BTreeMap<PathBuf, Vec<PathBuf>>,
    /// True if no graph is left to build, and all diagnostics are published. Changes reset it.
    pub is_settled: bool,
    /// True if a graph was built since the server reset it.
    pub has_built: bool,
}

/// Results of a graph's build. The public fields keep their last values while errors prevent new ones.
#[derive(Default)]
pub(super) struct Built {
    /// Descriptions of the resources, by name.
    pub resources: BTreeMap<String, String>,
    pub names: ExpressionNames,
    pub controls: Vec<Control>,
    /// Facts that were changed to meet the requirements, such as `device.int64 = true`; empty if the nominal facts meet
    /// them.
    pub changed: String,
    /// Dump of the first plan; `None` if none could be built.
    dump: Option<Dump>,
    /// True for a part, which has errors when it is built alone.
    is_part: bool,
    /// True once the text was meant as a graph: it stays one if it is emptied.
    was_graph: bool,
    /// The diagnostics, each with its file.
    diagnostics: Vec<(PathBuf, Diagnostic)>,
    /// Paths that the build looked up, including those of missing files: each as written, and canonical.
    files: BTreeSet<PathBuf>,
}

impl Workspace {
    /// Replaces the text of a file; `None` closes the file. Queues the graphs that depend on it.
    pub fn set(&mut self, path: PathBuf, text: Option<String>) {
        let is_same_set = self.open.contains_key(&path) == text.is_some();
        match text {
            Some(text) => drop(self.open.insert(path.clone(), text)),
            None => drop(self.open.remove(&path)),
        }
        self.planner.read_unsaved(self.open.clone());
        if !is_same_set {
            // Another graph may now use an open file.
            self.users.clear();
            self.built.retain(|graph, _| self.open.contains_key(graph));
            self.queue.retain(|graph| self.open.contains_key(graph));
        }
        self.changed(&path);
    }

    /// Queues the graphs that depend on a changed file. The file itself comes first if it is an open graph.
    pub fn changed(&mut self, path: &Path) {
        self.planner.forget_files();
        self.is_settled = false;
        if !self.open.contains_key(path) {
            // The closed file may now use an open one.
            self.users.clear();
        }
        let canonical = files::canonical(path);
        for (graph, built) in &self.built {
            let depends = built.files.contains(path) || built.files.contains(&canonical);
            if depends && !self.queue.contains(graph) {
                self.queue.push_back(graph.clone());
            }
        }
        if self.open.contains_key(path) && is_graph(path) {
            self.queue.retain(|graph| graph != path);
            self.queue.push_front(path.to_owned());
        }
    }

    /// Builds the next graph that a change affects, or that an open file needs. Returns false if there is none.
    pub fn build_next(&mut self) -> bool {
        if let Some(graph) = self.queue.pop_front() {
            self.build(&graph);
            return true;
        }
        let alone: Vec<PathBuf> = self.open.keys().filter(|path| !self.is_covered(path)).cloned().collect();
        for path in alone {
            if !self.users.contains_key(&path) {
                let users = self.users_of(&path);
                self.users.insert(path.clone(), users);
            }
            if let Some(user) = self.users.get_mut(&path).and_then(Vec::pop) {
                self.build(&user);
                // The graph may use the file only with other parameters.
                if !self.is_covered(&path) {
                    self.built.remove(&user);
                }
                return true;
            }
        }
        false
    }

    /// Builds an open graph if it was never built.
    pub(super) fn ensure_built(&mut self, path: &Path) {
        if !self.built.contains_key(path) {
            self.queue.retain(|graph| graph != path);
            self.build(path);
        }
    }

    /// Returns true if a graph that is not a part was built and used the file.
    fn is_covered(&self, path: &Path) -> bool {
        let canonical = files::canonical(path);
        let covers = |built: &Built| !built.is_part && built.files.contains(&canonical);
        self.built.values().any(covers)
    }

    /// Lists at most [`MAX_TRIES`] closed graphs that use a file, are no parts and were not built. The best is last:
    /// graphs of the file's folder are better than others, and a `Graph` is better than a preset or a choice.
    fn users_of(&mut self, path: &Path) -> Vec<PathBuf> {
        let name = in_index(path);
        let index = self.index(path);
        let mut users = index.users(&BTreeSet::from([name.clone()]));
        users.retain(|user| *user != name && Path::new(user).is_absolute());
        let rank = |user: &String| {
            let is_plain = index
                .text(user)
                .is_some_and(|text| Scan::of(text).groups.get(1).is_some_and(|group| group.name == "Graph"));
            (Path::new(user).parent() == Path::new(&name).parent(), is_plain)
        };
        users.sort_by_cached_key(rank);
        let whole = users.into_iter().rev().filter(|user| !self.is_part(user));
        let mut best: Vec<PathBuf> = whole.take(MAX_TRIES).map(PathBuf::from).collect();
        best.retain(|user| !self.built.contains_key(user));
        best.reverse();
        best
    }

    /// Lists the diagnostics of each file. Every open graph that was built has an entry in the result, even if it has
    /// no diagnostics. Closed graphs show only what is in open files.
    pub fn diagnostics(&self) -> BTreeMap<PathBuf, Vec<Diagnostic>> {
        let mut found: BTreeMap<PathBuf, Vec<Diagnostic>> = BTreeMap::new();
        for (graph, built) in &self.built {
            let is_open = self.open.contains_key(graph);
            if is_open {
                found.entry(graph.clone()).or_default();
            }
            for (file, diagnostic) in &built.diagnostics {
                if is_open || self.open.contains_key(file) {
                    let of_file = found.entry(file.clone()).or_default();
                    if !of_file.contains(diagnostic) {
                        of_file.push(diagnostic.clone());
                    }
                }
            }
        }
        found
    }

    /// Returns true if a queued graph has diagnostics in the file from its last build. Their positions are out of date.
    pub fn is_outdated(&self, file: &Path) -> bool {
        let has = |built: &Built| built.diagnostics.iter().any(|(other, _)| other == file);
        self.queue.iter().filter_map(|graph| self.built.get(graph)).any(has)
    }

    /// Returns true for an open file for which a closed graph may still be built. Its diagnostics come from that graph.
    pub fn is_waiting(&self, file: &Path) -> bool {
        !self.is_settled && self.open.contains_key(file) && !self.is_covered(file)
    }

    fn build(&mut self, path: &Path) {
        self.has_built = true;
        self.planner.forget_files();
        let is_graph = self.open.get(path).is_none_or(|text| !cursor::is_foreign(&Scan::of(text)));
        let built = self.built.entry(path.to_owned()).or_default();
        built.dump = None;
        built.was_graph |= is_graph;
        let found = if built.was_graph { self.check(path) } else { Vec::new() };
        let diagnostics = found.into_iter().map(|plain| self.placed(path, plain)).collect();
        let is_part = self.is_part(&path.display().to_string());
        let wanted = self.planner.wanted().into_iter().map(|wanted| wanted.path);
        let files = wanted.flat_map(|path| [files::canonical(&path), path]).collect();
        let built = self.built.entry(path.to_owned()).or_default();
        (built.diagnostics, built.is_part, built.files) = (diagnostics, is_part, files);
    }

    /// Builds a graph for a GPU and for a CPU. Graphs of a choice that neither draws are built for devices that meet
    /// their requirements. Each is also built with every output requested. Returns the first errors, or the warnings if
    /// there are no errors. For a part, leaves out [`ONLY_OF_PARTS`].
    fn check(&mut self, path: &Path) -> Vec<PlainDiagnostic> {
        let graph = path.display().to_string();
        match self.warnings(path, &graph) {
            Ok(warnings) => warnings,
            Err(errors) if self.is_part(&graph) => {
                // A part lacks what its includer provides. Errors that only follow from this are dropped.
                let of_its_own = |error: &PlainDiagnostic| !ONLY_OF_PARTS.contains(&error.message.as_str());
                errors.found.into_iter().filter(of_its_own).collect()
            }
            Err(errors) => errors.found,
        }
    }

    fn warnings(&mut self, path: &Path, graph: &str) -> Result<Vec<PlainDiagnostic>, GraphErrors> {
        let (catalog, cases) = (files::nominal_catalog(), LANES.map(nominal_case));
        let (mut warnings, mut checked, mut unchecked) = (Vec::new(), 0, Unchecked::default());
        for build in requirements::builds(&mut self.planner, graph, &cases, &catalog)? {
            if let Some(case) = build.case.as_ref().filter(|_| build.name.is_none()) {
                self.declare(path, graph, case, &build.changed)?;
            }
            match build.plan(&mut self.planner, graph, &[], &catalog)? {
                Some(mut plan) => {
                    checked += 1;
                    warn_of_unused(&mut self.planner, graph, &mut plan);
                    warnings.extend(self.learn(path, &plan));
                    let full = build.full_plan(&mut self.planner, &plan, (graph, &[]), &catalog)?;
                    warnings.extend(full.iter().flat_map(|full| self.planner.plain_warnings(&full.warnings)));
                }
                None => unchecked.add(&mut self.planner, (graph, &build), &cases[0], &catalog),
            }
        }
        warnings.extend(unchecked.diagnostics(checked)?);
        Ok(warnings)
    }

    /// Keeps the parameters and the names of a graph. `changed` lists facts of `case` that are not nominal.
    fn declare(&mut self, path: &Path, graph: &str, case: &Case, changed: &str) -> Result<(), GraphErrors> {
        let (facts, catalog) = (case.facts(), files::nominal_catalog());
        let controls = self.planner.controls(graph, &[], &facts, &catalog)?;
        let names = self.planner.ask((graph, &[]), &facts, &catalog, lower::expression_names)?;
        let built = self.built.entry(path.to_owned()).or_default();
        (built.controls, built.names, built.changed) = (controls, names, changed.to_owned());
        Ok(())
    }

    /// Keeps the resources and the barriers of the first plan of a graph. Returns the plan's warnings.
    fn learn(&mut self, path: &Path, plan: &Plan) -> Vec<PlainDiagnostic> {
        let mut resources = resources(plan);
        let named = self.names_of_includes(&path.display().to_string(), &resources);
        resources.extend(named);
        let built = self.built.entry(path.to_owned()).or_default();
        if built.dump.is_none() {
            (built.resources, built.dump) = (resources, Some(backend::dump(plan)));
        }
        self.planner.plain_warnings(&plan.warnings)
    }

    /// Lists the names that the includes of a graph provide besides their resources, each with a description.
    ///
    /// These are the output, `include.picture`, and the `let`s that choose one of `resources`, the plan's resources
    /// with descriptions.
    pub(super) fn names_of_includes(
        &mut self,
        graph: &str,
        resources: &BTreeMap<String, String>,
    ) -> Vec<(String, String)> {
        let Some(file) = self.planner.file(None, graph, Kind::Graph) else { return Vec::new() };
        let includes = Scan::of(&self.planner.path_and_text(file).1).groups;
        let mut found = Vec::new();
        for include in includes.iter().filter(|group| group.name == "Include") {
            let Some((name, included)) = include.value("name").zip(include.value("graph")) else { continue };
            let Some(inner) = self.planner.file(Some(file), included, Kind::Graph) else { continue };
            let text = self.planner.path_and_text(inner).1;
            let described = |resource: &str| resources.get(&format!("{name}.{resource}"));
            let mut about = format!("the output of `{included}`");
            match Document::parse(&text) {
                Ok(Document::Graph(graph)) => {
                    let scan = Scan::of(&text);
                    for place in scan.texts.iter().filter(|place| scan.groups[place.group].lead == "let") {
                        // The choice may depend on facts: describe a resource that the plan has.
                        let chosen =
                            text[place.inside.clone()].split('\'').skip(1).step_by(2).find_map(described);
                        if let Some((key, shape)) = place.key.as_ref().zip(chosen) {
                            found
                                .push((format!("{name}.{key}"), format!("{shape}: `{key}` of `{included}`")));
                        }
                    }
                    let Some(output) = graph.output else { continue };
                    about =
                        described(&output.text).map_or(about.clone(), |shape| format!("{shape}: {about}"));
                }
                Ok(_) => {}
                Err(_) => continue,
            }
            found.push((format!("{name}.{}", names::PICTURE), about));
        }
        found
    }

    /// Returns true for a part: a graph without an output or with ports, which is made to be included.
    fn is_part(&mut self, graph: &str) -> bool {
        match self.planner.graph_text(graph).map(|text| Document::parse(&text)) {
            Some(Ok(Document::Graph(graph))) => graph.output.is_none() || !graph.ports.is_empty(),
            _ => false,
        }
    }

    /// Returns the editor's text of a graph; `None` if the file is not open or no graph.
    pub fn open_graph(&self, path: &Path) -> Option<String> {
        self.open.get(path).filter(|_| is_graph(path)).cloned()
    }

    /// Lists the hints of a graph: the passes that its passes wait for, and the values of its `let`s.
    ///
    /// First builds the graph if it is queued. A part has no plan of its own: all graphs that remain are built, and its
    /// passes are looked up in their plans.
    pub fn hints(&mut self, path: &Path) -> Vec<InlayHint> {
        let Some(text) = &self.open_graph(path) else { return Vec::new() };
        if self.queue.iter().any(|graph| graph == path) {
            self.queue.retain(|graph| graph != path);
            self.build(path);
        }
        if self.built.get(path).is_some_and(|built| built.is_part) {
            while self.build_next() {}
        }
        let own = self.built.get(path);
        let others = self.built.iter().filter(|(other, _)| *other != path).map(|(_, built)| built);
        let dumps: Vec<&Dump> = own.into_iter().chain(others).filter_map(|k| k.dump.as_ref()).collect();
        let mut found = hints::waits(&files::canonical(path), text, &dumps);
        let Some(own) = own.filter(|own| own.dump.is_some()) else { return found };
        let scan = Scan::of(text);
        let lets = scan.texts.iter().filter(|place| scan.groups[place.group].lead == "let");
        let value = |place: &cursor::Text| {
            let value = own.names.get(place.key.as_deref()?)?;
            Some((place.inside.end + 1, value.to_string()))
        };
        found.extend(hints::values(text, lets.filter_map(value)));
        found
    }

    fn index(&mut self, path: &Path) -> Index {
        let graphs = self.open.keys().filter(|path| is_graph(path)).map(|path| files::canonical(path));
        let graphs = graphs.collect();
        let search = Search::new(self.planner.include_roots(), &self.folders);
        Index::of(&mut self.planner, &files::canonical(path), graphs, search)
    }

    pub fn definitions(&mut self, path: &Path, offset: usize) -> Vec<Location> {
        let index = self.index(path);
        let places = index.definitions(&in_index(path), offset);
        places.iter().filter_map(|place| self.location(&index, place)).collect()
    }

    /// Lists the uses of the name at a byte offset, and its declarations if `is_declared` is true.
    pub fn references(&mut self, path: &Path, offset: usize, is_declared: bool) -> Vec<Location> {
        let index = self.index(path);
        let places = index.places(&in_index(path), offset);
        let places = places.iter().filter(|(place, _)| is_declared || !index.is_declaration(place));
        places.filter_map(|(place, _)| self.location(&index, place)).collect()
    }

    /// Returns the range and the text of the name at a byte offset; `None` if no graph declares such a name.
    pub fn renamed_name(&mut self, path: &Path, offset: usize) -> Option<(Range, String)> {
        let index = self.index(path);
        let (place, _, _) = index.name_at(&in_index(path), offset)?;
        let text = index.text(&place.file)?[place.start..place.end].to_owned();
        Some((self.location(&index, &place)?.range, text))
    }

    /// Lists the edits, by file, that rename the name at a byte offset; see [`rename::rename`].
    pub fn rename(
        &mut self,
        path: &Path,
        offset: usize,
        new: &str,
    ) -> Result<Vec<(Uri, Vec<TextEdit>)>, String> {
        let index = self.index(path);
        let edits = rename::rename(&mut self.planner, &index, &self.open, (&in_index(path), offset), new)?;
        let of_file = |(file, edits): (String, Vec<rename::Edit>)| {
            let edit = |(range, new_text): rename::Edit| {
                let place = Place { file: file.clone(), start: range.start, end: range.end };
                Some(TextEdit { range: self.location(&index, &place)?.range, new_text })
            };
            let uri = text::uri_of(&self.as_opened(PathBuf::from(&file)))?;
            Some((uri, edits.into_iter().filter_map(edit).collect()))
        };
        Ok(edits.into_iter().filter_map(of_file).collect())
    }

    /// Converts a place to an editor's location; `None` for a file that is built into the program.
    fn location(&self, index: &Index, place: &Place) -> Option<Location> {
        let path = Some(PathBuf::from(&place.file)).filter(|path| path.is_absolute())?;
        let range = text::range_of(index.text(&place.file)?, place.start..place.end);
        Some(Location { uri: text::uri_of(&self.as_opened(path))?, range })
    }

    /// Converts a diagnostic to the editor's form. Also returns the file in which it is shown. An error in a built-in
    /// file, which no editor can open, is shown at the start of the graph.
    fn placed(&self, graph: &Path, plain: PlainDiagnostic) -> (PathBuf, Diagnostic) {
        let path = self.as_opened(PathBuf::from(&plain.file));
        let text = match self.open.get(&path) {
            Some(text) => Some(text.clone()),
            None if path.is_absolute() => std::fs::read_to_string(&path).ok(),
            None => None,
        };
        let mut message = plain.message;
        if !plain.label.is_empty() {
            message += &format!(": {}", plain.label);
        }
        for help in &plain.help {
            message += &format!("\nhelp: {help}");
        }
        let (file, range) = match text {
            Some(text) => {
                let start = text::position_of_column(&text, plain.line, plain.column);
                let end = text::position_of_column(&text, plain.end_line, plain.end_column);
                (path, Range { start, end })
            }
            None => {
                message = format!("{}:{}:{}: {message}", plain.file, plain.line, plain.column);
                (graph.to_owned(), Range::default())
            }
        };
        let severity = match plain.severity {
            Severity::Error => DiagnosticSeverity::ERROR,
            Severity::Warning => DiagnosticSeverity::WARNING,
        };
        let source = Some("splatgraph".to_owned());
        (file, Diagnostic { range, severity: Some(severity), source, message, ..Diagnostic::default() })
    }

    /// Returns the path under which the editor opened a file, or otherwise its canonical path. Relative paths, which
    /// built-in files have, stay unchanged.
    fn as_opened(&self, path: PathBuf) -> PathBuf {
        if self.open.contains_key(&path) || !path.is_absolute() {
            return path;
        }
        let canonical = files::canonical(&path);
        self.open.keys().find(|other| files::canonical(other) == canonical).cloned().unwrap_or(canonical)
    }
}

/// Adds warnings about parameters of the graph's own file that nothing mentions: neither the file nor its shaders.
///
/// Parameters that only the current settings leave without an effect are mentioned.
pub fn warn_of_unused(planner: &mut Planner, graph: &str, plan: &mut Plan) {
    let Some(file) = planner.file(None, graph, Kind::Graph) else { return };
    let (path, _) = planner.path_and_text(file);
    let is_idle = |param: &&Param| param.origin.file == path && plan.no_effect(&param.name).is_some();
    let idle: Vec<Param> = plan.params.iter().filter(is_idle).cloned().collect();
    if idle.is_empty() {
        return;
    }
    let index = Index::of_graph(planner, file);
    for Param { name, origin, .. } in idle {
        let Some(span) = index.unused(file, &name) else { continue };
        let message = format!("nothing uses the parameter `{name}`");
        let label = "no expression of this file and no shader mentions it";
        plan.warnings.push(Warning { diagnostic: source::Diagnostic::new(message, span, label), origin });
    }
}

fn in_index(path: &Path) -> String {
    files::canonical(path).display().to_string()
}

/// Messages of the errors that a part has only because it is built alone.
const ONLY_OF_PARTS: [&str; 2] = ["this graph is made to be included", "this graph has no output"];

/// Describes the resources of a plan, by the names in its graph. Resources that no graph names are left out.
fn resources(plan: &Plan) -> BTreeMap<String, String> {
    let about = |shape: &Shape| match shape {
        Shape::Buffer { stride, count } => format!("a buffer of {} x {stride} bytes", grouped(*count)),
        Shape::Image { format, width, height } => {
            format!("an image of {width} x {height}, {}", format.name())
        }
    };
    // Graphs write a ping-pong half (`keys#0`) and a plane (`sh[0]`) without the suffix.
    let name = |full: &str| full.split(['#', '[']).next().unwrap_or(full).to_owned();
    let named = |full: &str| !full.contains('(') && full != LIVE_BLOCK;
    plan.resources.iter().filter(|r| named(&r.name)).map(|r| (name(&r.name), about(&r.shape))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::planner::Settings;

    #[test]
    fn uses_of_a_file_in_an_include_root_are_found_in_the_folders_that_are_open() {
        let [library, project] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
        let [part, user] = [library.path().join("part.ron"), project.path().join("deep/user.ron")];
        let text =
            "Graph(version: 1, summary: \"\", params: { \"width\": Const(Bool(default: true)) }, passes: [])";
        std::fs::write(&part, text).expect("writable");
        std::fs::create_dir(user.parent().expect("a folder")).expect("writable");
        let preset =
            format!("Preset(graph: \"{}\", summary: \"\", set: {{ \"width\": false }})", part.display());
        std::fs::write(&user, preset).expect("writable");
        let settings = Settings { include_roots: vec![library.path().to_owned()], ..Settings::default() };
        let mut workspace = Workspace { planner: Planner::new(settings), ..Workspace::default() };
        let declared = text.find("width").expect("there");
        assert_eq!(workspace.references(&part, declared, false), []);
        workspace.folders = vec![files::canonical(project.path())];
        let found = workspace.references(&part, declared, false);
        assert_eq!(found.iter().map(|use_| text::path_of(&use_.uri)).collect::<Vec<_>>(), [Some(user)]);
    }

    #[test]
    fn a_change_queues_the_graphs_that_depend_on_it_and_the_edited_one_first() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        let mut workspace = Workspace::default();
        // `b.ron` refers to a graph that does not exist yet.
        for (name, graph) in [("a.ron", "b"), ("b.ron", "missing"), ("c.ron", "splat")] {
            let preset = format!("Preset(graph: \"{graph}\", summary: \"\", set: {{}})");
            workspace.set(path(name), Some(preset));
        }
        while workspace.build_next() {}
        let queued = |workspace: &mut Workspace, name: &str| {
            workspace.changed(&path(name));
            let queue = std::mem::take(&mut workspace.queue);
            queue.iter().map(|path| path.file_name().expect("a name").to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(queued(&mut workspace, "b.ron"), ["b.ron", "a.ron"]);
        assert_eq!(queued(&mut workspace, "c.ron"), ["c.ron"]);
        assert_eq!(queued(&mut workspace, "missing.ron"), ["a.ron", "b.ron"]);
        assert!(queued(&mut workspace, "other.comp").is_empty());

        // The hints of a part need other graphs. Their diagnostics are published afterwards.
        let part = "Graph(version: 1, summary: \"\", passes: [])";
        workspace.set(path("part.ron"), Some(part.to_owned()));
        workspace.has_built = false;
        workspace.hints(&path("part.ron"));
        assert!(workspace.queue.is_empty() && !workspace.is_settled && workspace.has_built);
    }
}
