//! Offers completions and hover texts, from a graph's text and its last build.

use super::cursor::{self, Meaning, Scan};
use super::files::{self, LANES, nominal_case};
use super::graph::Workspace;
use super::index::Index;
use super::names::{self, Role, Word, mentions};
use super::text;
use crate::draw::builtin;
use crate::draw::facts::SceneFacts;
use crate::draw::planner::Planner;
use lsp_types::{
    CompletionItem, CompletionItemKind, CompletionTextEdit, Hover, HoverContents, MarkupContent, MarkupKind,
    TextEdit,
};
use splatgraph_assets::grouped;
use splatgraph_framework::ir::{Format, ParamBinding};
use splatgraph_framework::lower::Control;
use splatgraph_framework::schema::{Document, Port, is_choice};
use splatgraph_framework::source::Kind;
use std::collections::{BTreeMap, BTreeSet};
use std::ops;
use std::path::{Path, PathBuf};

impl Workspace {
    /// Lists the parameters of `included`; empty if it has errors.
    ///
    /// An include or a preset in the graph at `path` names the graph `included`.
    fn parameters(&mut self, path: &Path, included: &str) -> Vec<Control> {
        let from = self.planner.file(None, &path.display().to_string(), Kind::Graph);
        let Some(file) = self.planner.file(from, included, Kind::Graph) else { return Vec::new() };
        let (path, _) = self.planner.path_and_text(file);
        let (facts, catalog) = (nominal_case(LANES[0]).facts(), files::nominal_catalog());
        let mut of = |graph: &str| self.planner.controls(graph, &[], &facts, &catalog);
        // The path of a built-in graph is not a file's path, so try its name.
        of(&path).or_else(|_| of(included)).unwrap_or_default()
    }

    /// Lists the ports of `included`, each with a description; empty if it is no valid `Graph`.
    ///
    /// The graph at `path` includes `included`.
    fn ports(&mut self, path: &Path, included: &str) -> Vec<(String, String)> {
        let from = self.planner.file(None, &path.display().to_string(), Kind::Graph);
        let Some(file) = self.planner.file(from, included, Kind::Graph) else { return Vec::new() };
        let Ok(Document::Graph(graph)) = Document::parse(&self.planner.path_and_text(file).1) else {
            return Vec::new();
        };
        let described = |port| match port {
            Port::Buffer { ping_pong: true, .. } => "a ping-pong buffer",
            Port::Buffer { .. } => "a buffer",
            Port::Image { .. } => "an image",
        };
        graph.ports.into_iter().map(|(name, port)| (name, described(port).to_owned())).collect()
    }

    /// Lists the options of a choice: of a parameter of `included`, or of the graph at `path` itself. Empty for other
    /// parameters.
    fn choices(&mut self, path: &Path, included: Option<&str>, parameter: &str) -> Vec<String> {
        let file = self.planner.file(None, &path.display().to_string(), Kind::Graph);
        let of = |file| Index::of_graph(&mut self.planner, file).choices(file, included, parameter);
        file.map(of).unwrap_or_default()
    }

    /// Lists the user's files that the graph at `path` can name, without the graph itself. They are in the folders that
    /// are searched, and one folder below.
    fn own_files(&mut self, path: &Path, kind: Kind, extension: &str) -> Vec<String> {
        let entries = |folder: &Path| {
            let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
            entries.filter_map(|entry| Some((entry.file_name().into_string().ok()?, entry.path())))
        };
        let Some(file) = self.planner.file(None, &path.display().to_string(), Kind::Graph) else {
            return Vec::new();
        };
        let folders = self.planner.folders(file, kind);
        let files = folders.iter().flat_map(|folder| entries(Path::new(folder))).flat_map(|(name, at)| {
            let below = entries(&at).map(|(inner, at)| (format!("{name}/{inner}"), at)).collect::<Vec<_>>();
            below.into_iter().chain([(name, at)])
        });
        let graph = files::canonical(path);
        let is_offered =
            |(name, at): &(String, PathBuf)| has_extension(name, extension) && files::canonical(at) != graph;
        files.filter(is_offered).map(|(name, _)| name).collect()
    }

    pub fn completion(&mut self, path: &Path, offset: usize) -> Vec<CompletionItem> {
        let Some(text) = &self.open_graph(path) else { return Vec::new() };
        let Some(cursor) = cursor::at(text, offset) else { return Vec::new() };
        self.ensure_built(path);
        let mut offered: BTreeMap<String, (CompletionItemKind, String)> = BTreeMap::new();
        let mut offer = |name: &str, kind, about: String| {
            offered.entry(name.to_owned()).or_insert((kind, about));
        };
        let whole = &text[cursor.inside.clone()];
        let before = &text[cursor.inside.start..offset];
        let quote = before.rfind('\'').filter(|_| before.matches('\'').count() % 2 == 1);
        let is_quoted = quote.is_some();
        let compared = quote.and_then(|quote| {
            let end = whole[before.len()..].find('\'').map_or(whole.len(), |end| before.len() + end);
            names::compared(whole, &(quote + 1..end))
        });
        let choice = match (&cursor.meaning, compared) {
            (_, Some(name)) => Some((None, name)),
            (Meaning::Value { graph: Some(graph), parameter }, _) => {
                Some((Some(graph.as_str()), parameter.as_str()))
            }
            _ => None,
        };
        if let Some((graph, name)) = choice {
            for option in self.choices(path, graph, name) {
                offer(&option, CompletionItemKind::ENUM_MEMBER, format!("a value of `{name}`"));
            }
        }
        let meaning = match cursor.meaning {
            // Names of values do not stand in quotes, and a comparison has only the options there.
            _ if compared.is_some() => Meaning::Free,
            Meaning::Expression | Meaning::Value { .. } if is_quoted => Meaning::Free,
            // The condition of an expression that chooses a resource, a shader or a format.
            Meaning::Resource | Meaning::Shader { .. } | Meaning::Format
                if is_choice(whole) && !is_quoted =>
            {
                Meaning::Expression
            }
            meaning => meaning,
        };
        // A completion replaces the name around the cursor. The name of a file may contain more characters.
        let is_file = matches!(meaning, Meaning::Graph | Meaning::Shader { .. });
        let is_part = |c: char| is_in_name(c) || is_file && matches!(c, '/' | '-' | ' ');
        let mut range = around(text, &cursor.inside, offset, is_part);
        // A string that is not closed reaches to the end of its line.
        range.end = offset + text[offset..range.end].trim_end().len();
        match &meaning {
            Meaning::Free => {}
            Meaning::Parameter { graph } => {
                for control in graph.iter().flat_map(|graph| self.parameters(path, graph)) {
                    offer(&control.param.name, CompletionItemKind::FIELD, described(&control));
                }
            }
            Meaning::Port { graph } => {
                for (name, port) in graph.iter().flat_map(|graph| self.ports(path, graph)) {
                    offer(&name, CompletionItemKind::FIELD, port);
                }
            }
            Meaning::Resource => {
                for (name, about) in self.built.get(path).iter().flat_map(|built| &built.resources) {
                    offer(name, CompletionItemKind::VARIABLE, about.clone());
                }
                for (name, about) in self.names_of_includes(&path.display().to_string(), &BTreeMap::new()) {
                    offer(&name, CompletionItemKind::VARIABLE, about);
                }
                for name in declared(text, &[names::Kind::Resource]) {
                    offer(&name, CompletionItemKind::VARIABLE, "of this graph".into());
                }
            }
            Meaning::Expression | Meaning::Value { .. } => {
                for (name, value) in self.built.get(path).iter().flat_map(|built| built.names.iter()) {
                    offer(name, CompletionItemKind::CONSTANT, format!("= {value}"));
                }
                for (name, value) in nominal_case(LANES[0]).facts().named() {
                    offer(&name, CompletionItemKind::CONSTANT, format!("= {value}"));
                }
                for name in declared(text, &[names::Kind::Parameter, names::Kind::Let]) {
                    offer(&name, CompletionItemKind::CONSTANT, "of this graph".into());
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
                let catalog = files::nominal_catalog();
                for (name, attribute) in &catalog.attributes {
                    let about =
                        format!("{} planes of {} bytes per element", attribute.planes, attribute.stride);
                    offer(name, CompletionItemKind::VARIABLE, about);
                }
                for (name, bytes) in &catalog.uniforms {
                    offer(name, CompletionItemKind::VARIABLE, format!("a uniform block of {bytes} bytes"));
                }
                for (name, buffer) in &catalog.buffers {
                    let about = format!("a buffer of {} bytes per element", buffer.stride);
                    offer(name, CompletionItemKind::VARIABLE, about);
                }
            }
            Meaning::Graph => {
                for file in builtin::groups().into_iter().flat_map(|(_, files)| files) {
                    if !file.name.contains('.') {
                        offer(&format!("{}.ron", file.name), CompletionItemKind::FILE, file.summary);
                    }
                }
                for name in self.own_files(path, Kind::Graph, "ron") {
                    offer(&name, CompletionItemKind::FILE, "of this project".into());
                }
            }
            Meaning::Shader { extension } => {
                for file in builtin::groups().into_iter().flat_map(|(_, files)| files) {
                    if has_extension(file.name, extension) {
                        offer(file.name, CompletionItemKind::FILE, file.summary);
                    }
                }
                for name in self.own_files(path, Kind::Shader, extension) {
                    offer(&name, CompletionItemKind::FILE, "of this project".into());
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
        let range = text::range_of(text, range);
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
    pub fn hover(&mut self, path: &Path, offset: usize) -> Option<Hover> {
        let text = &self.open_graph(path)?;
        let cursor = cursor::at(text, offset)?;
        self.ensure_built(path);
        let word = &text[around(text, &cursor.inside, offset, is_in_name)];
        let is_expression = matches!(
            cursor.meaning,
            Meaning::Expression | Meaning::Value { .. } | Meaning::Resource | Meaning::Format
        );
        let role = mentions(text, &Scan::of(text))
            .into_iter()
            .find(|mention| (mention.range.start..=mention.range.end).contains(&offset))
            .map(|mention| mention.role);
        let included = match &role {
            Some(Role::ParameterOf(graph)) => self.parameters(path, graph),
            _ => Vec::new(),
        };
        let built = self.built.get(path)?;
        let control = match &role {
            Some(Role::ParameterOf(_)) => included.iter().find(|control| control.param.name == word),
            Some(Role::Value | Role::Declares(names::Kind::Parameter)) => {
                built.controls.iter().find(|control| control.param.name == word)
            }
            _ => None,
        };
        let value = match &role {
            Some(Role::Value | Role::Declares(names::Kind::Let) | Role::Resource(_)) => built.names.get(word),
            // The name of a fact has a dot, and is declared nowhere.
            None if is_expression && word.contains('.') => built.names.get(word),
            _ => None,
        };
        let resource = match &role {
            Some(Role::Resource(_) | Role::Include(_) | Role::Declares(names::Kind::Resource)) => {
                built.resources.get(word)
            }
            _ => None,
        };
        let mut lines = Vec::new();
        match (control, value) {
            (Some(control), _) => lines.push(format!("`{word}`: {}", described(control))),
            (None, Some(value)) => lines.push(format!("`{word}` = {value}")),
            (None, None) => {}
        }
        lines.extend(resource.map(|about| format!("`{word}`: {about}")));
        let whole = &text[cursor.inside.clone()];
        if let Some(value) = built.names.evaluate(whole).filter(|_| is_expression && whole != word) {
            lines.push(format!("`{}` = {value}", whole.split_whitespace().collect::<Vec<_>>().join(" ")));
        }
        if lines.is_empty() {
            return None;
        }
        let splats = grouped(SceneFacts::NOMINAL.count);
        let with = if built.changed.is_empty() { String::new() } else { format!(", with {}", built.changed) };
        lines.push(format!("*for {splats} splats, on the least capable supported device{with}*"));
        let value = lines.join("\n\n");
        let contents = HoverContents::Markup(MarkupContent { kind: MarkupKind::Markdown, value });
        Some(Hover { contents, range: Some(text::range_of(text, cursor.inside)) })
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

fn is_in_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '_' | '.')
}

/// Extends a byte offset to the range of adjacent characters for which `is_part` is true. The range stays within the
/// bytes `inside` of a string.
fn around(
    text: &str,
    inside: &ops::Range<usize>,
    offset: usize,
    is_part: impl Fn(char) -> bool,
) -> ops::Range<usize> {
    let before = text[inside.start..offset].trim_end_matches(&is_part).len();
    let after = text[offset..inside.end].find(|c| !is_part(c));
    inside.start + before..after.map_or(inside.end, |at| offset + at)
}

/// Lists the names of these kinds that the text declares. The text may be invalid, and not built yet.
fn declared(text: &str, kinds: &[names::Kind]) -> Vec<String> {
    let is_wanted = |role: &Role| matches!(role, Role::Declares(kind) if kinds.contains(kind));
    let all = mentions(text, &Scan::of(text)).into_iter();
    all.filter(|mention| is_wanted(&mention.role)).map(|mention| mention.name).collect()
}

fn has_extension(name: &str, extension: &str) -> bool {
    Path::new(name).extension().is_some_and(|other| other == extension)
}

/// Collects the names of the blocks and images that a shader and its includes declare, from their `layout` lines. Scans
/// the text, because the shader may be incomplete and its constants unknown: names in inactive `#if` branches are
/// included.
fn blocks(planner: &mut Planner, graph: &str, shader: &str, found: &mut BTreeSet<String>, depth: u32) {
    let Some((_, text)) = planner.shader(graph, shader).filter(|_| depth < 8) else { return };
    for word in names::words(&text) {
        if let Word::Include(range) = word {
            blocks(planner, graph, &text[range], found, depth + 1);
        }
    }
    for line in text.lines().map(str::trim_start) {
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
        found.extend(name.map(|name| (*name).to_owned()));
    }
}
