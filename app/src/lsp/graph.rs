//! Builds the open graphs, and answers requests about them.

use super::cursor::{self, Meaning, Scan};
use super::files::{self, LANES, is_graph, nominal_case};
use super::index::{Index, Place};
use super::{hints, names, rename, text};
use crate::draw::backend;
use crate::draw::builtin;
use crate::draw::facts::{self, SceneFacts};
use crate::draw::planner::{GraphErrors, PlainDiagnostic, Planner, Severity};
use crate::draw::requirements::{self, Case};
use lsp_types::{
    CompletionItem, CompletionItemKind, CompletionTextEdit, Diagnostic, DiagnosticSeverity, Hover,
    HoverContents, InlayHint, Location, MarkupContent, MarkupKind, Range, TextEdit, Uri,
};
use splatgraph_assets::grouped;
use splatgraph_framework::dump::Dump;
use splatgraph_framework::ir::{Format, LIVE_BLOCK, ParamBinding, Shape};
use splatgraph_framework::lower::{self, Control, ExpressionNames};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::schema::Document;
use splatgraph_framework::source::Kind;
use std::collections::{BTreeMap, BTreeSet};
use std::ops;
use std::path::{Path, PathBuf};

/// The texts of the open files, the planner, and the declarations and plan of every open graph.
#[derive(Default)]
pub struct Workspace {
    /// Texts of the files that are open in the editor, by path.
    pub open: BTreeMap<PathBuf, String>,
    planner: Planner,
    known: BTreeMap<PathBuf, Known>,
    folders: Vec<PathBuf>,
}

/// The declarations of a graph. They are kept from its last valid version while it has errors.
#[derive(Default)]
struct Known {
    /// Descriptions of the resources, by name.
    resources: BTreeMap<String, String>,
    names: ExpressionNames,
    controls: Vec<Control>,
    /// Facts that were changed to meet the requirements, such as `device.int64 = true`; empty if the nominal facts meet
    /// them.
    changed: String,
    /// Dump of the first plan; `None` if none could be built.
    dump: Option<Dump>,
}

impl Workspace {
    pub fn new(folders: Vec<PathBuf>) -> Workspace {
        Workspace { folders, ..Workspace::default() }
    }

    /// Builds the open graphs, and lists the diagnostics of each file, including files that are not open. Every open
    /// graph has an entry in the result, even if it has no diagnostics.
    pub fn diagnostics(&mut self) -> BTreeMap<PathBuf, Vec<Diagnostic>> {
        self.planner.read_unsaved(self.open.clone());
        self.known.retain(|path, _| self.open.contains_key(path));
        let mut found: BTreeMap<PathBuf, Vec<Diagnostic>> = BTreeMap::new();
        let graphs: Vec<PathBuf> = self.open.keys().filter(|path| is_graph(path)).cloned().collect();
        for path in graphs {
            found.entry(path.clone()).or_default();
            for plain in self.check(&path) {
                let (file, diagnostic) = self.placed(&path, plain);
                let of_file = found.entry(file).or_default();
                if !of_file.contains(&diagnostic) {
                    of_file.push(diagnostic);
                }
            }
        }
        found
    }

    /// Builds a graph for a GPU and for a CPU. Graphs of a choice that neither draws are built for devices that meet
    /// their requirements. Returns the first errors, or the warnings if there are no errors.
    fn check(&mut self, path: &Path) -> Vec<PlainDiagnostic> {
        let graph = path.display().to_string();
        self.known.entry(path.to_owned()).or_default().dump = None;
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
        let (catalog, cases) = (facts::nominal_catalog(), LANES.map(nominal_case));
        let mut warnings = Vec::new();
        for build in requirements::builds(&mut self.planner, graph, &cases, &catalog)? {
            if let Some(case) = build.case.as_ref().filter(|_| build.name.is_none()) {
                self.declare(path, graph, case, &build.changed)?;
            }
            if let Some(plan) = build.plan(&mut self.planner, graph, &[], &catalog)? {
                warnings.extend(self.learn(path, &plan));
            }
        }
        Ok(warnings)
    }

    /// Keeps the parameters and the names of a graph. `changed` lists facts of `case` that are not nominal.
    fn declare(&mut self, path: &Path, graph: &str, case: &Case, changed: &str) -> Result<(), GraphErrors> {
        let (facts, catalog) = (case.facts(), facts::nominal_catalog());
        let controls = self.planner.controls(graph, &[], &facts, &catalog)?;
        let names = self.planner.ask((graph, &[]), &facts, &catalog, lower::expression_names)?;
        let known = self.known.entry(path.to_owned()).or_default();
        (known.controls, known.names, known.changed) = (controls, names, changed.to_owned());
        Ok(())
    }

    /// Keeps the resources and the barriers of the first plan of a graph. Returns the plan's warnings.
    fn learn(&mut self, path: &Path, plan: &Plan) -> Vec<PlainDiagnostic> {
        let mut resources = resources(plan);
        let named = self.names_of_includes(&path.display().to_string(), &resources);
        resources.extend(named);
        let known = self.known.entry(path.to_owned()).or_default();
        if known.dump.is_none() {
            (known.resources, known.dump) = (resources, Some(backend::dump(plan)));
        }
        self.planner.plain_warnings(plan)
    }

    /// Describes the names that the includes of a graph provide besides their resources: the output,
    /// `include.picture`, and the `let`s that choose a resource.
    fn names_of_includes(
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

    /// Lists the parameters of a graph that the graph at `path` includes, or of which it is a preset.
    fn parameters(&mut self, path: &Path, included: &str) -> Vec<Control> {
        let from = self.planner.file(None, &path.display().to_string(), Kind::Graph);
        let Some(file) = self.planner.file(from, included, Kind::Graph) else { return Vec::new() };
        let (path, _) = self.planner.path_and_text(file);
        let (facts, catalog) = (nominal_case(LANES[0]).facts(), facts::nominal_catalog());
        let mut of = |graph: &str| self.planner.controls(graph, &[], &facts, &catalog);
        // The path of a built-in graph is not a file's path, so try its name.
        of(&path).or_else(|_| of(included)).unwrap_or_default()
    }

    /// Returns true for a part: a graph without an output or with ports, which is made to be included.
    fn is_part(&mut self, graph: &str) -> bool {
        match self.planner.graph_text(graph).map(|text| Document::parse(&text)) {
            Some(Ok(Document::Graph(graph))) => graph.output.is_none() || !graph.ports.is_empty(),
            _ => false,
        }
    }

    pub fn completion(&mut self, path: &Path, text: &str, offset: usize) -> Vec<CompletionItem> {
        let Some(cursor) = cursor::at(text, offset) else { return Vec::new() };
        let none = Known::default();
        let mut offered: BTreeMap<String, (CompletionItemKind, String)> = BTreeMap::new();
        let mut offer = |name: &str, kind, about: String| {
            offered.entry(name.to_owned()).or_insert((kind, about));
        };
        // A completion replaces the string before the cursor; in an expression, only the name before the cursor.
        let mut start = cursor.inside.start;
        match &cursor.meaning {
            Meaning::Free => {}
            Meaning::Parameter { graph } => {
                for control in graph.iter().flat_map(|graph| self.parameters(path, graph)) {
                    offer(&control.param.name, CompletionItemKind::FIELD, described(&control));
                }
            }
            Meaning::Resource => {
                for (name, about) in &self.known.get(path).unwrap_or(&none).resources {
                    offer(name, CompletionItemKind::VARIABLE, about.clone());
                }
            }
            Meaning::Expression => {
                start = word(text, &cursor.inside, offset).start;
                for (name, value) in self.known.get(path).unwrap_or(&none).names.iter() {
                    offer(name, CompletionItemKind::CONSTANT, format!("= {value}"));
                }
            }
            Meaning::Format => {
                for format in Format::ALL {
                    offer(
                        format.name(),
                        CompletionItemKind::ENUM_MEMBER,
                        format!("{} bytes per pixel", format.bytes_per_pixel()),
                    );
                }
            }
            Meaning::Import => {
                let catalog = facts::nominal_catalog();
                for (name, attribute) in &catalog.attributes {
                    let about =
                        format!("{} planes of {} bytes per splat", attribute.planes, attribute.stride);
                    offer(name, CompletionItemKind::VARIABLE, about);
                }
                for (name, bytes) in &catalog.uniforms {
                    offer(name, CompletionItemKind::VARIABLE, format!("a uniform block of {bytes} bytes"));
                }
            }
            Meaning::Graph => {
                for file in builtin::groups().into_iter().flat_map(|(_, files)| files) {
                    if !file.name.contains('.') {
                        offer(&format!("{}.ron", file.name), CompletionItemKind::FILE, file.summary);
                    }
                }
                for name in beside(path, "ron") {
                    offer(&name, CompletionItemKind::FILE, "beside this graph".into());
                }
            }
            Meaning::Shader { extension } => {
                for file in builtin::groups().into_iter().flat_map(|(_, files)| files) {
                    if has_extension(file.name, extension) {
                        offer(file.name, CompletionItemKind::FILE, file.summary);
                    }
                }
                for name in beside(path, extension) {
                    offer(&name, CompletionItemKind::FILE, "beside this graph".into());
                }
            }
            Meaning::Block { shaders } => {
                let graph = path.display().to_string();
                for shader in shaders {
                    let mut names = BTreeSet::new();
                    blocks(&mut self.planner, &graph, shader, &mut names, 0);
                    for name in names {
                        offer(&name, CompletionItemKind::FIELD, format!("of {shader}"));
                    }
                }
            }
        }
        let range = text::range_of(text, start..offset);
        let item = |(label, (kind, about)): (String, (CompletionItemKind, String))| CompletionItem {
            text_edit: Some(CompletionTextEdit::Edit(TextEdit { range, new_text: label.clone() })),
            label,
            kind: Some(kind),
            detail: Some(about),
            ..CompletionItem::default()
        };
        offered.into_iter().map(item).collect()
    }

    /// Describes the parameter, value or resource at a byte offset, and the value of the whole expression. `None` if
    /// nothing is known.
    pub fn hover(&mut self, path: &Path, text: &str, offset: usize) -> Option<Hover> {
        let cursor = cursor::at(text, offset)?;
        let included = match &cursor.meaning {
            Meaning::Parameter { graph: Some(graph) } => Some(self.parameters(path, graph)),
            _ => None,
        };
        let known = self.known.get(path)?;
        let word = &text[word(text, &cursor.inside, offset)];
        let mut lines = Vec::new();
        let controls = included.as_ref().unwrap_or(&known.controls);
        if let Some(control) = controls.iter().find(|control| control.param.name == word) {
            lines.push(format!("`{word}`: {}", described(control)));
        } else if let Some(value) = known.names.get(word) {
            lines.push(format!("`{word}` = {value}"));
        }
        if let Some(about) = known.resources.get(word) {
            lines.push(format!("`{word}`: {about}"));
        }
        let whole = &text[cursor.inside.clone()];
        let is_expression =
            matches!(cursor.meaning, Meaning::Expression | Meaning::Resource | Meaning::Format);
        if let Some(value) = known.names.evaluate(whole).filter(|_| is_expression && whole != word) {
            lines.push(format!("`{}` = {value}", whole.split_whitespace().collect::<Vec<_>>().join(" ")));
        }
        if lines.is_empty() {
            return None;
        }
        let splats = grouped(SceneFacts::NOMINAL.count);
        let with = if known.changed.is_empty() { String::new() } else { format!(", with {}", known.changed) };
        lines.push(format!("*for {splats} splats, on the least capable supported device{with}*"));
        let value = lines.join("\n\n");
        let contents = HoverContents::Markup(MarkupContent { kind: MarkupKind::Markdown, value });
        Some(Hover { contents, range: Some(text::range_of(text, cursor.inside)) })
    }

    /// Lists the hints of a graph: the barriers before its passes, and the values of its `let`s. A part has no plan of
    /// its own: its passes are looked up in the plans of the other open graphs.
    pub fn hints(&self, path: &Path, text: &str) -> Vec<InlayHint> {
        let own = self.known.get(path);
        let others = self.known.iter().filter(|(other, _)| *other != path).map(|(_, known)| known);
        let dumps: Vec<&Dump> = own.into_iter().chain(others).filter_map(|k| k.dump.as_ref()).collect();
        let mut found = hints::barriers(&files::canonical(path), text, &dumps);
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
        let graphs = files::graphs_near(path, &self.open, &self.folders);
        Index::of(&mut self.planner, &graphs)
    }

    pub fn definitions(&mut self, path: &Path, offset: usize) -> Vec<Location> {
        let index = self.index(path);
        let places = index.definitions(&in_index(path), offset);
        places.iter().filter_map(|place| self.location(&index, place)).collect()
    }

    pub fn references(&mut self, path: &Path, offset: usize) -> Vec<Location> {
        let index = self.index(path);
        let places = index.places(&in_index(path), offset);
        places.iter().filter_map(|(place, _)| self.location(&index, place)).collect()
    }

    /// Returns the range and the text of the name at a byte offset; `None` if no graph declares a name there.
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

    /// Returns the path under which the editor opened a file, or otherwise its canonical path.
    fn as_opened(&self, path: PathBuf) -> PathBuf {
        if self.open.contains_key(&path) || !path.is_absolute() {
            return path;
        }
        let Ok(canonical) = path.canonicalize() else { return path };
        let same = |other: &&PathBuf| other.canonicalize().is_ok_and(|other| other == canonical);
        self.open.keys().find(same).cloned().unwrap_or(canonical)
    }
}

fn described(control: &Control) -> String {
    let kind = match control.param.binding {
        ParamBinding::Const => "constant",
        ParamBinding::Live { .. } => "live",
    };
    let about = if control.help.is_empty() { &control.label } else { &control.help };
    format!("a {kind} parameter, here {}. {about}", control.param.value)
}

fn in_index(path: &Path) -> String {
    files::canonical(path).display().to_string()
}

/// Messages of the errors that every part has when it is built alone.
const ONLY_OF_PARTS: [&str; 2] = ["this graph is made to be included", "this graph has no output"];

/// Describes the resources of a plan, by the names in its graph.
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

/// Returns the range of the name at a byte offset of a string. Names consist of letters, digits, `_` and `.`.
fn word(text: &str, inside: &ops::Range<usize>, offset: usize) -> ops::Range<usize> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '.');
    let before = text[inside.start..offset].rfind(|c| !is_part(c));
    let after = text[offset..inside.end].find(|c| !is_part(c));
    // `rfind` returns the start of a character, which can be several bytes long.
    let width = |at: usize| text[inside.start + at..].chars().next().map_or(0, char::len_utf8);
    before.map_or(inside.start, |at| inside.start + at + width(at))
        ..after.map_or(inside.end, |at| offset + at)
}

fn has_extension(name: &str, extension: &str) -> bool {
    Path::new(name).extension().is_some_and(|other| other == extension)
}

/// Lists the files with this extension in the folder of a graph.
fn beside(graph: &Path, extension: &str) -> Vec<String> {
    let Some(Ok(entries)) = graph.parent().map(std::fs::read_dir) else { return Vec::new() };
    let names = entries.flatten().filter_map(|entry| entry.file_name().into_string().ok());
    names.filter(|name| has_extension(name, extension)).collect()
}

/// Collects the names of the blocks and images that a shader and its includes declare, from their `layout` lines. Scans
/// the text, because the shader may be incomplete and its constants unknown: names in inactive `#if` branches are
/// included.
fn blocks(planner: &mut Planner, graph: &str, shader: &str, names: &mut BTreeSet<String>, depth: u32) {
    let Some((_, text)) = planner.shader(graph, shader).filter(|_| depth < 8) else { return };
    for line in text.lines().map(str::trim_start) {
        if let Some(included) = line.strip_prefix("#include \"").and_then(|rest| rest.split('"').next()) {
            blocks(planner, graph, included, names, depth + 1);
        }
        let Some(declared) = line.strip_prefix("layout(").and_then(|rest| rest.split_once(')')) else {
            continue;
        };
        if !declared.0.contains("binding") {
            continue;
        }
        let words =
            declared.1.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').filter(|w| !w.is_empty());
        let words: Vec<&str> = words.collect();
        let after = |wanted: &dyn Fn(&str) -> bool| {
            words.iter().position(|word| wanted(word)).and_then(|at| words.get(at + 1))
        };
        let name = after(&|w| w == "buffer")
            .or_else(|| after(&|w| w.contains("image2D")))
            .or_else(|| after(&|w| w == "uniform"));
        names.extend(name.map(|name| (*name).to_owned()));
    }
}
