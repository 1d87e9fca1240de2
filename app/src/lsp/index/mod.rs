//! Resolves names in graphs and shaders to their declarations, across files.
//!
//! A name can have several declarations: a choice leads to several graphs, and several graphs may use one shader.
//! Declarations that share an occurrence of a name can only be renamed together, so they form a class.

mod queries;

use super::cursor::{Group, Scan, Text};
use super::files::{Search, canonical, is_graph};
use super::names::{self, Kind, Mention, Role, Word, mentions, words};
use crate::draw::planner::Planner;
use indexmap::IndexSet;
use splatgraph_framework::ir::FileId;
use splatgraph_framework::source;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Maximum depth of nested includes, as in the framework's `lower`.
const MAX_DEPTH: usize = 16;

/// A range of bytes in a file, from `start` to before `end`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// The file's path; relative if the file is built into the program.
    pub file: String,
    pub start: usize,
    pub end: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Spelled as in the declaration.
    Plain,
    /// In capitals, as the name of the constant in a shader.
    Macro,
}

struct Found {
    end: usize,
    form: Form,
    declarations: IndexSet<usize>,
    /// Definitions that are not renamed with the name: whole files, words of shaders, and the output of an include.
    places: Vec<Place>,
}

impl Found {
    fn new(end: usize, form: Form, declarations: Vec<usize>, places: Vec<Place>) -> Found {
        Found { end, form, declarations: declarations.into_iter().collect(), places }
    }
}

struct Declaration {
    file: FileId,
    range: Range<usize>,
    kind: Kind,
    name: String,
    /// Index of the bracket that contains the declaration.
    group: usize,
    /// True for a `Live` parameter: shaders read its value under the declared name, not in capitals.
    is_live: bool,
    /// The options of a parameter that is a choice, otherwise empty.
    choices: Vec<String>,
}

struct Graph {
    scan: Scan,
    mentions: Vec<Mention>,
    /// Graphs that this graph names, by the name as written.
    graphs: HashMap<String, FileId>,
    shaders: HashMap<String, FileId>,
}

struct Shader {
    words: Vec<Word>,
    /// Files that the shader includes, each with the range of its name.
    includes: Vec<(Range<usize>, FileId)>,
    /// True if the shader itself includes `live.glsl`, which is generated.
    includes_live: bool,
}

#[derive(Default)]
pub struct Index {
    paths: HashMap<FileId, (String, String)>,
    graphs: BTreeMap<FileId, Graph>,
    shaders: BTreeMap<FileId, Shader>,
    declarations: Vec<Declaration>,
    of_file: HashMap<FileId, Vec<usize>>,
    found: BTreeMap<(FileId, usize), Found>,
    /// For each declaration, its parent in the union-find forest of classes. A representative is its own parent.
    class: Vec<usize>,
}

impl Index {
    /// Indexes a file, some graphs, and the files that they name or that may name them, directly or indirectly. The
    /// paths are canonical.
    pub fn of(planner: &mut Planner, path: &Path, graphs: Vec<PathBuf>, mut search: Search) -> Index {
        let mut index = Index::default();
        let (mut waiting, mut searched) = (graphs, BTreeSet::new());
        waiting.extend(search.users_of(path));
        while let Some(graph) = waiting.pop() {
            if let Some(file) = planner.file(None, &graph.display().to_string(), source::Kind::Graph) {
                index.read_graphs(planner, file);
            }
            for (file, (path, _)) in &index.paths {
                if searched.insert(*file) && Path::new(path).is_absolute() {
                    waiting.extend(search.users_of(Path::new(path)));
                }
            }
        }
        // Last: a shader may include files of the folders of the graph that names it.
        if !is_graph(path)
            && let Some(file) = planner.file(None, &path.display().to_string(), source::Kind::Shader)
        {
            index.read_shader(planner, file);
        }
        index.resolve();
        index
    }

    /// Indexes a graph, and the files that it names, directly or indirectly.
    pub fn of_graph(planner: &mut Planner, graph: FileId) -> Index {
        let mut index = Index::default();
        index.read_graphs(planner, graph);
        index.resolve();
        index
    }

    fn read_graphs(&mut self, planner: &mut Planner, graph: FileId) {
        let mut named = vec![graph];
        while let Some(file) = named.pop() {
            if !self.graphs.contains_key(&file) {
                self.read_graph(planner, file, &mut named);
            }
        }
    }

    fn read_graph(&mut self, planner: &mut Planner, file: FileId, waiting: &mut Vec<FileId>) {
        let (path, text) = read(planner, file);
        let scan = Scan::of(&text);
        let mentions = mentions(&text, &scan);
        let (mut graphs, mut shaders) = (HashMap::new(), HashMap::new());
        for mention in &mentions {
            let kind = match mention.role {
                Role::Graph => source::Kind::Graph,
                Role::Shader => source::Kind::Shader,
                _ => continue,
            };
            let Some(named) = planner.file(Some(file), &mention.name, kind) else { continue };
            if kind == source::Kind::Graph {
                graphs.insert(mention.name.clone(), named);
                waiting.push(named);
            } else {
                shaders.insert(mention.name.clone(), named);
                self.read_shader(planner, named);
            }
        }
        for mention in &mentions {
            let Role::Declares(kind) = mention.role else { continue };
            // The outer bracket of the parameter's value, such as `Live(Choice(of: [...]))`.
            let is_value = |group: &Group| group.lead == mention.name && group.parent == Some(mention.group);
            let value = scan.groups.iter().position(is_value).filter(|_| kind == Kind::Parameter);
            let is_live = value.is_some_and(|value| scan.groups[value].name == "Live");
            let is_choice = |text: &&Text| {
                scan.groups[text.group].lead == "of"
                    && value.is_some_and(|value| {
                        scan.around(text.group).any(|group| std::ptr::eq(group, &scan.groups[value]))
                    })
            };
            let choices = scan.texts.iter().filter(is_choice).map(|t| text[t.inside.clone()].to_owned());
            self.of_file.entry(file).or_default().push(self.declarations.len());
            self.class.push(self.declarations.len());
            self.declarations.push(Declaration {
                file,
                range: mention.range.clone(),
                kind,
                name: mention.name.clone(),
                group: mention.group,
                is_live,
                choices: choices.collect(),
            });
        }
        self.paths.insert(file, (path, text));
        self.graphs.insert(file, Graph { scan, mentions, graphs, shaders });
    }

    fn read_shader(&mut self, planner: &mut Planner, file: FileId) {
        if self.shaders.contains_key(&file) {
            return;
        }
        let (path, text) = read(planner, file);
        let words = words(&text);
        let included = words.iter().filter_map(|word| match word {
            Word::Include(range) => {
                let file = planner.file(Some(file), &text[range.clone()], source::Kind::Shader)?;
                Some((range.clone(), file))
            }
            Word::Name(_) | Word::Local(_) => None,
        });
        let includes: Vec<(Range<usize>, FileId)> = included.collect();
        let is_live =
            |word: &Word| matches!(word, Word::Include(range) if text[range.clone()] == *"live.glsl");
        let includes_live = words.iter().any(is_live);
        self.paths.insert(file, (path, text));
        self.shaders.insert(file, Shader { words, includes: includes.clone(), includes_live });
        for (_, included) in includes {
            self.read_shader(planner, included);
        }
    }

    fn resolve(&mut self) {
        let mut all = Vec::new();
        for (shader, read) in &self.shaders {
            for (range, file) in &read.includes {
                let found = Found::new(range.end, Form::Plain, Vec::new(), vec![self.start_of(*file)]);
                all.push(((*shader, range.start), found));
            }
        }
        for (file, graph) in &self.graphs {
            for mention in &graph.mentions {
                let (declarations, places) = self.meant(*file, mention);
                let found = Found::new(mention.range.end, Form::Plain, declarations, places);
                all.push(((*file, mention.range.start), found));
            }
            self.in_shaders(*file, &mut all);
        }
        for (at, new) in all {
            let empty = Found::new(new.end, new.form, Vec::new(), Vec::new());
            let found = self.found.entry(at).or_insert(empty);
            found.places.extend(new.places);
            found.declarations.extend(new.declarations);
            let declarations: Vec<usize> = found.declarations.iter().copied().collect();
            for pair in declarations.windows(2) {
                let (a, b) = (self.representative(pair[0]), self.representative(pair[1]));
                self.class[a] = b;
            }
        }
    }

    fn representative(&self, declaration: usize) -> usize {
        let mut at = declaration;
        while self.class[at] != at {
            at = self.class[at];
        }
        at
    }

    /// Returns the declarations that a name refers to, and its other definitions; see [`Found::places`].
    fn meant(&self, file: FileId, mention: &Mention) -> (Vec<usize>, Vec<Place>) {
        let graph = &self.graphs[&file];
        let name = mention.name.as_str();
        let declarations = match &mention.role {
            Role::Declares(kind) => self.declared(file, |d| d.range == mention.range && d.kind == *kind),
            Role::Value => {
                let variables = self.declared(file, |d| {
                    let around = || graph.scan.around(mention.group);
                    d.kind == Kind::Variable
                        && d.name == name
                        && around().any(|group| std::ptr::eq(group, &graph.scan.groups[d.group]))
                });
                if variables.is_empty() { self.value(file, name) } else { variables }
            }
            Role::Resource(within) => {
                let inside = self.inside(file, within);
                inside.into_iter().flat_map(|file| self.resource(file, name)).collect()
            }
            Role::Include(within) => {
                let includes = |file| self.declared(file, |d| d.kind == Kind::Include && d.name == name);
                self.inside(file, within).into_iter().flat_map(includes).collect()
            }
            Role::ParameterOf(other) => self.parameter_of(file, other, name),
            Role::PortOf(other) => {
                self.leaves(file, other).into_iter().flat_map(|file| self.resource(file, name)).collect()
            }
            Role::Statistic => self.declared(file, |d| d.kind == Kind::Statistic && d.name == name),
            Role::Graph | Role::Shader | Role::OfShaders(_) => Vec::new(),
        };
        let start_of = |file: &FileId| self.start_of(*file);
        let places = match &mention.role {
            Role::Graph => graph.graphs.get(name).map(start_of).into_iter().collect(),
            Role::Shader => graph.shaders.get(name).map(start_of).into_iter().collect(),
            Role::OfShaders(shaders) => {
                let shaders = shaders.iter().filter_map(|shader| graph.shaders.get(shader));
                shaders.filter_map(|shader| self.first_word(*shader, name)).collect()
            }
            // `picture` is not the output's own name, so renaming the output must not change it.
            Role::Resource(within) if declarations.is_empty() && is_picture(within, name) => {
                let outputs = self.inside(file, within).into_iter().flat_map(|file| self.output(file, 0));
                outputs.map(|declared| self.place_of(&self.declarations[declared])).collect()
            }
            _ => Vec::new(),
        };
        (declarations, places)
    }

    fn place_of(&self, declared: &Declaration) -> Place {
        let file = self.paths[&declared.file].0.clone();
        Place { file, start: declared.range.start, end: declared.range.end }
    }

    fn start_of(&self, file: FileId) -> Place {
        Place { file: self.paths[&file].0.clone(), start: 0, end: 0 }
    }

    fn declared(&self, file: FileId, wanted: impl Fn(&Declaration) -> bool) -> Vec<usize> {
        let all = self.of_file.get(&file).into_iter().flatten().copied();
        all.filter(|id| wanted(&self.declarations[*id])).collect()
    }

    /// Finds a `let` or a parameter by its name.
    fn value(&self, file: FileId, name: &str) -> Vec<usize> {
        let lets = self.declared(file, |d| d.kind == Kind::Let && d.name == name);
        if lets.is_empty() { self.parameter(file, name, 0) } else { lets }
    }

    /// Finds a resource by its name; without one, a `let` or a parameter, whose value may name a resource.
    fn resource(&self, file: FileId, name: &str) -> Vec<usize> {
        let own = self.declared(file, |d| d.kind == Kind::Resource && d.name == name);
        if own.is_empty() { self.value(file, name) } else { own }
    }

    /// Finds the resource that is a graph's output, in the graph or in those that it includes.
    fn output(&self, file: FileId, depth: usize) -> Vec<usize> {
        let graph = &self.graphs[&file];
        let is_output = |text: &&Text| text.group == 1 && text.key.as_deref() == Some("output");
        let Some(output) = graph.scan.texts.iter().find(is_output).filter(|_| depth < MAX_DEPTH) else {
            return Vec::new();
        };
        let is_inside = |mention: &&Mention| output.inside.contains(&mention.range.start);
        let named = graph.mentions.iter().filter(is_inside).flat_map(|mention| {
            let Role::Resource(within) = &mention.role else { return Vec::new() };
            let declared = |file| match self.resource(file, &mention.name) {
                own if own.is_empty() && is_picture(within, &mention.name) => self.output(file, depth + 1),
                own => own,
            };
            self.inside(file, within).into_iter().flat_map(declared).collect()
        });
        named.collect()
    }

    /// Finds a parameter that a graph declares, or that one of its includes exposes.
    fn parameter(&self, file: FileId, name: &str, depth: usize) -> Vec<usize> {
        let own = self.declared(file, |d| d.kind == Kind::Parameter && d.name == name);
        if !own.is_empty() || depth > MAX_DEPTH {
            return own;
        }
        let exposed = self.includes(file).into_iter().filter(|include| include.exposes(name));
        let leaves = exposed.flat_map(|include| self.leaves(file, &include.graph)).collect::<BTreeSet<_>>();
        leaves.into_iter().flat_map(|leaf| self.parameter(leaf, name, depth + 1)).collect()
    }

    /// Finds a parameter of a graph that another one names `other`.
    fn parameter_of(&self, file: FileId, other: &str, name: &str) -> Vec<usize> {
        self.leaves(file, other).into_iter().flat_map(|leaf| self.parameter(leaf, name, 0)).collect()
    }

    /// Lists the options of a graph's parameter, or of one of `other`, which the graph names. Empty unless it is a
    /// choice.
    pub fn choices(&self, file: FileId, other: Option<&str>, name: &str) -> Vec<String> {
        let declared = match other {
            Some(other) => self.parameter_of(file, other, name),
            None => self.value(file, name),
        };
        declared.into_iter().flat_map(|d| self.declarations[d].choices.clone()).collect()
    }

    fn parameters(&self, file: FileId, depth: usize) -> BTreeSet<String> {
        let own = self.declared(file, |d| d.kind == Kind::Parameter);
        let mut names: BTreeSet<String> =
            own.into_iter().map(|d| self.declarations[d].name.clone()).collect();
        if depth > MAX_DEPTH {
            return names;
        }
        for include in self.includes(file) {
            for leaf in self.leaves(file, &include.graph) {
                names.extend(self.parameters(leaf, depth + 1).into_iter().filter(|n| include.exposes(n)));
            }
        }
        names
    }

    /// Finds the graphs to which a chain of includes leads.
    fn inside(&self, file: FileId, within: &[String]) -> Vec<FileId> {
        within.iter().fold(vec![file], |files, name| {
            let included = |file: FileId| {
                let includes = self.includes(file).into_iter().filter(|include| include.name == *name);
                includes.flat_map(|include| self.leaves(file, &include.graph)).collect::<Vec<_>>()
            };
            files.into_iter().flat_map(included).collect()
        })
    }

    /// Finds the graphs to which a name leads, through presets and choices.
    fn leaves(&self, file: FileId, name: &str) -> Vec<FileId> {
        let mut leaves = BTreeSet::new();
        let mut seen = BTreeSet::new();
        let mut waiting: Vec<FileId> =
            self.graphs.get(&file).and_then(|graph| graph.graphs.get(name)).copied().into_iter().collect();
        while let Some(file) = waiting.pop() {
            let Some(graph) = self.graphs.get(&file).filter(|_| seen.insert(file)) else { continue };
            if graph.scan.groups.get(1).is_some_and(|group| group.name == "Graph") {
                leaves.insert(file);
            } else {
                waiting.extend(graph.graphs.values());
            }
        }
        leaves.into_iter().collect()
    }

    fn includes(&self, file: FileId) -> Vec<Include> {
        let Some(graph) = self.graphs.get(&file) else { return Vec::new() };
        let entries = |include: usize, lead: &str| -> Vec<String> {
            let include = &graph.scan.groups[include];
            let stands_in = |mention: &&Mention| {
                let around: Vec<_> = graph.scan.around(mention.group).collect();
                around.iter().any(|group| std::ptr::eq(*group, include))
                    && around.iter().any(|group| group.lead == lead)
                    && matches!(mention.role, Role::ParameterOf(_))
            };
            graph.mentions.iter().filter(stands_in).map(|mention| mention.name.clone()).collect()
        };
        let all = graph.scan.groups.iter().enumerate().filter(|(_, group)| group.name == "Include");
        let include = |(at, group): (usize, &Group)| {
            Some(Include {
                name: group.value("name")?.to_owned(),
                graph: group.value("graph")?.to_owned(),
                set: entries(at, "set"),
                only: entries(at, "expose"),
                exposes_all: group.value("expose") == Some("All"),
            })
        };
        all.filter_map(include).collect()
    }

    /// Finds the occurrences of a graph's constants and live parameters in its shaders.
    fn in_shaders(&self, file: FileId, found: &mut Vec<((FileId, usize), Found)>) {
        // Words of the shaders, each with the length of the parameter's name in it: `MODE` in `MODE_FAST`.
        let mut known: HashMap<String, (usize, Form, Vec<usize>)> = HashMap::new();
        let lets = self.declared(file, |d| d.kind == Kind::Let);
        let lets = lets.into_iter().map(|d| self.declarations[d].name.clone());
        for name in self.parameters(file, 0).into_iter().chain(lets) {
            let declarations = self.value(file, &name);
            let capital = capital(&name);
            let mut know = |word: String, form| {
                known.entry(word).or_insert((name.len(), form, declarations.clone()));
            };
            for declared in declarations.iter().map(|d| &self.declarations[*d]) {
                for choice in &declared.choices {
                    know(format!("{capital}_{}", self::capital(choice)), Form::Macro);
                }
                if declared.is_live {
                    know(name.clone(), Form::Plain);
                }
            }
            know(capital, Form::Macro);
        }
        let shaders = self.graphs[&file].shaders.values().copied();
        let has_live = |shader: &FileId| self.with_includes([*shader]).any(|(_, read)| read.includes_live);
        let live = self.with_includes(shaders.clone().filter(has_live)).map(|(shader, _)| shader);
        let live: BTreeSet<FileId> = live.collect();
        for (shader, read) in self.with_includes(shaders) {
            for word in &read.words {
                // Macros replace every word. A live parameter exists only beside `live.glsl`, and is hidden by a name
                // that the shader declares.
                let (range, is_local) = match word {
                    Word::Name(range) => (range, false),
                    Word::Local(range) => (range, true),
                    Word::Include(_) => continue,
                };
                let known = known.get(&self.paths[&shader].1[range.clone()]);
                let is_live = !is_local && live.contains(&shader);
                let known = known.filter(|(_, form, _)| is_live || *form == Form::Macro);
                if let Some((length, form, declarations)) = known {
                    let name = Found::new(range.start + length, *form, declarations.clone(), Vec::new());
                    found.push(((shader, range.start), name));
                }
            }
        }
    }

    /// Finds the first occurrence of a name, usually its declaration, in a shader or else in its includes.
    fn first_word(&self, shader: FileId, name: &str) -> Option<Place> {
        self.with_includes([shader]).find_map(|(shader, read)| {
            let (path, text) = &self.paths[&shader];
            let range = read.words.iter().find_map(|word| match word {
                Word::Name(range) | Word::Local(range) if text[range.clone()] == *name => Some(range),
                _ => None,
            })?;
            Some(Place { file: path.clone(), start: range.start, end: range.end })
        })
    }

    /// Iterates over shaders and the files that they include, directly or indirectly, each once.
    fn with_includes(
        &self,
        shaders: impl IntoIterator<Item = FileId>,
    ) -> impl Iterator<Item = (FileId, &Shader)> {
        let mut seen = BTreeSet::new();
        let mut waiting: Vec<FileId> = shaders.into_iter().collect();
        std::iter::from_fn(move || {
            loop {
                let shader = waiting.pop()?;
                let Some(read) = self.shaders.get(&shader).filter(|_| seen.insert(shader)) else { continue };
                waiting.extend(read.includes.iter().map(|(_, file)| *file));
                return Some((shader, read));
            }
        })
    }
}

/// Returns true for the name of an include's output.
fn is_picture(within: &[String], name: &str) -> bool {
    !within.is_empty() && name == names::PICTURE
}

fn read(planner: &Planner, file: FileId) -> (String, String) {
    let (path, text) = planner.path_and_text(file);
    (canonical(Path::new(&path)).display().to_string(), text)
}

struct Include {
    name: String,
    graph: String,
    set: Vec<String>,
    only: Vec<String>,
    exposes_all: bool,
}

impl Include {
    fn exposes(&self, name: &str) -> bool {
        let is_named = |names: &[String]| names.iter().any(|other| other == name);
        if self.exposes_all { !is_named(&self.set) } else { is_named(&self.only) }
    }
}

/// Converts a name to the constant's name in the graph's shaders: capitals, with `_` for other characters.
pub fn capital(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' }).collect()
}
