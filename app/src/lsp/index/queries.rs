//! Answers questions about the names of an index: definitions, occurrences, other meanings, and users of files.

use super::{Declaration, Form, Found, Graph, Index, Place};
use crate::lsp::cursor::is_foreign;
use crate::lsp::names::{self, Kind};
use splatgraph_framework::ir::{FileId, Span};
use splatgraph_framework::schema::Document;
use std::collections::BTreeSet;

impl Index {
    fn at(&self, path: &str, offset: usize) -> Option<(&(FileId, usize), &Found)> {
        let (file, _) = self.paths.iter().find(|(_, (other, _))| other == path)?;
        let (key, found) = self.found.range((*file, 0)..=(*file, offset)).next_back()?;
        (offset <= found.end).then_some((key, found))
    }

    /// Lists the definitions of the name at a byte offset: declarations in graphs, words of shaders, and named files.
    pub fn definitions(&self, path: &str, offset: usize) -> Vec<Place> {
        let Some((_, found)) = self.at(path, offset) else { return Vec::new() };
        let declared = found.declarations.iter().map(|d| self.place_of(&self.declarations[*d]));
        found.places.iter().cloned().chain(declared).collect()
    }

    /// Returns the place of the name at a byte offset, the name as declared, and its spelling at the place. `None` if
    /// no graph declares it.
    pub fn name_at(&self, path: &str, offset: usize) -> Option<(Place, &str, Form)> {
        let ((_, start), found) = self.at(path, offset)?;
        let declared = &self.declarations[*found.declarations.first()?];
        let place = Place { file: path.to_owned(), start: *start, end: found.end };
        Some((place, &declared.name, found.form))
    }

    /// Lists all occurrences, in all files, of the name at a byte offset, sorted; empty if no graph declares it.
    pub fn places(&self, path: &str, offset: usize) -> Vec<(Place, Form)> {
        let Some(class) = self.at(path, offset).and_then(|(_, found)| found.declarations.first()) else {
            return Vec::new();
        };
        let class = self.representative(*class);
        let same = |found: &Found| found.declarations.iter().any(|d| self.representative(*d) == class);
        let place = |((file, start), found): (&(FileId, usize), &Found)| {
            let file = self.paths[file].0.clone();
            (Place { file, start: *start, end: found.end }, found.form)
        };
        let mut places: Vec<_> = self.found.iter().filter(|(_, found)| same(found)).map(place).collect();
        places.sort_by(|a, b| a.0.cmp(&b.0));
        places
    }

    /// Returns the place of a parameter that a graph declares; `None` if another place in the index mentions it.
    pub fn unused(&self, graph: FileId, parameter: &str) -> Option<Span> {
        let declared = *self.declared(graph, |d| d.kind == Kind::Parameter && d.name == parameter).first()?;
        let mentions = self.found.values().filter(|found| found.declarations.contains(&declared)).count();
        let range = self.declarations[declared].range.clone();
        (mentions == 1).then(|| Span::new(graph, range))
    }

    /// Returns true if a name is declared at this place.
    pub fn is_declaration(&self, place: &Place) -> bool {
        self.declarations.iter().any(|declared| self.place_of(declared) == *place)
    }

    /// Describes what `new` already means in one of `files`, if it could be mistaken for the name at a byte offset.
    ///
    /// `new` may be a value, a resource, an option of a choice, or a quoted text in an expression. `None` if it is none
    /// of these, or if the name at the offset is that of a pass, an include or a statistic.
    pub fn other_meaning(
        &self,
        path: &str,
        offset: usize,
        files: &BTreeSet<String>,
        new: &str,
    ) -> Option<String> {
        // Passes, includes and statistics have names of their own.
        let is_shared = |kind| matches!(kind, Kind::Parameter | Kind::Let | Kind::Resource | Kind::Variable);
        let (_, found) = self.at(path, offset)?;
        let declared = &self.declarations[*found.declarations.first()?];
        if !is_shared(declared.kind) {
            return None;
        }
        let is_here = |file: &FileId| files.contains(&self.paths[file].0);
        let other = |other: &&Declaration| other.name == new && is_shared(other.kind) && is_here(&other.file);
        if let Some(other) = self.declarations.iter().find(other) {
            return Some(format!("{} already declares `{new}`", self.paths[&other.file].0));
        }
        let has_text = |(file, graph): &(&FileId, &Graph)| {
            let text = &self.paths[file].1;
            graph.scan.texts.iter().any(|place| {
                let inside = &text[place.inside.clone()];
                let is_option = graph.scan.groups[place.group].lead == "of" && inside == new;
                is_option || inside.split('\'').skip(1).step_by(2).any(|literal| literal == new)
            })
        };
        let (file, _) = self.graphs.iter().filter(|(file, _)| is_here(file)).find(has_text)?;
        Some(format!("`{new}` is already a text in {}", self.paths[file].0))
    }

    /// Returns the path and the line of an error in a graph that may use a name; `None` if all can be parsed. Such a
    /// graph is one of `users`, or contains the name.
    ///
    /// Not all names in such a graph are known: a missing quote swaps texts and code.
    pub fn unparsed(&self, users: &[String], name: &str) -> Option<String> {
        self.graphs.iter().find_map(|(file, graph)| {
            let (path, text) = &self.paths[file];
            let is_whole = |at: usize| {
                !text[..at].ends_with(names::continues_name)
                    && !text[at + name.len()..].starts_with(names::continues_name)
            };
            let may_use = || users.contains(path) || text.match_indices(name).any(|(at, _)| is_whole(at));
            let error = Document::parse(text).err().filter(|_| may_use() && !is_foreign(&graph.scan))?;
            Some(format!("{path}:{}", error.span.start.line))
        })
    }

    /// Lists the paths of the graphs that a change of these files can affect.
    pub fn users(&self, changed: &BTreeSet<String>) -> Vec<String> {
        let mut users: BTreeSet<FileId> = BTreeSet::new();
        loop {
            let before = users.len();
            for (file, graph) in &self.graphs {
                let changes = |file: &FileId| changed.contains(&self.paths[file].0);
                let is_user = changes(file)
                    || graph.graphs.values().any(|named| users.contains(named) || changes(named))
                    || self.with_includes(graph.shaders.values().copied()).any(|(file, _)| changes(&file));
                if is_user {
                    users.insert(*file);
                }
            }
            if users.len() == before {
                return users.iter().map(|file| self.paths[file].0.clone()).collect();
            }
        }
    }

    /// Returns the text of a file; `None` if the index did not read it.
    pub fn text(&self, path: &str) -> Option<&str> {
        self.paths.values().find(|(other, _)| other == path).map(|(_, text)| text.as_str())
    }
}
