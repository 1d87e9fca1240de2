//! Resolves the output, the other requested outputs, and the statistics of a graph and its parts.

use super::lowering::{Level, Lowering};
use crate::ir::{Format, OUTPUTS, Output, Param, ResourceId, Shape, Stat, Value};
use crate::schema::Reference;
use crate::source::{Diagnostic, Place};

/// Returns the error message for a requested output that the graph does not have.
pub fn no_output(name: &str) -> String {
    format!("this graph has no output `{name}`")
}

impl<'a> Lowering<'a> {
    pub(super) fn output(&mut self, level: &Level) -> Option<ResourceId> {
        let root = level.root.clone();
        let Some(name) = &level.graph.output else {
            self.errors.push(Diagnostic::new(
                "this graph has no output",
                level.root.head(),
                "add `output: \"name of an image\"`",
            ));
            return None;
        };
        let at = root.field("output");
        let id = self.output_image(level, name, &at)?;
        // A part's picture is a resource for its includer.
        let is_picture = level.include.is_none();
        if is_picture
            && let Shape::Image { format: Format::R32Uint, .. } = self.lowered.plan.resource(id).shape
        {
            let message = "expected an output of the format rgba8, rgba16f, rgba32f or r32f, found r32ui";
            let error = at.error(message, "whole numbers are not colours");
            let help =
                "name it in `outputs` (`render --output NAME=FILE.npy`), or read it with `render --inspect`";
            self.errors.push(error.with_help(help));
            return None;
        }
        Some(id)
    }

    /// Reports requested outputs (facts such as `outputs.depth`) that the graph does not have.
    pub(super) fn check_outputs(&mut self, level: &Level) {
        let known = || level.graph.outputs.keys().map(String::as_str);
        for name in self.asked().filter(|name| known().all(|other| other != *name)).collect::<Vec<_>>() {
            let label = match level.graph.outputs.len() {
                0 => "outputs only its picture".to_owned(),
                _ => format!("outputs {} besides its picture", known().collect::<Vec<_>>().join(", ")),
            };
            let error = Diagnostic::new(no_output(name), level.root.head(), label);
            self.errors.push(error.with_nearest(name, known(), ""));
        }
    }

    /// Checks the images of all outputs besides the picture, and returns the requested ones.
    pub(super) fn outputs(&mut self, level: &Level) -> Vec<Output> {
        let root = level.root.clone();
        let mut found = Vec::new();
        for (name, image) in &level.graph.outputs {
            let at = root.field("outputs").field(name);
            if let Some(image) = self.output_image(level, image, &at)
                && self.asked().any(|asked| asked == name)
            {
                found.push(Output { name: name.clone(), image });
                self.lowered.more_output_spans.push(at.span());
            }
        }
        found
    }

    fn asked(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        let asked = self.request.facts.host.iter().filter(|(_, value)| **value == Value::Bool(true));
        asked.filter_map(|(name, _)| name.strip_prefix(OUTPUTS))
    }

    /// Finds the image of an output; `None` after an error.
    fn output_image(&mut self, level: &Level, name: &Reference, at: &Place) -> Option<ResourceId> {
        match self.look_up_one(level, name, at).and_then(|id| self.of_this_frame(id, at)) {
            Ok(Some(id)) => match self.lowered.plan.resource(id).shape {
                Shape::Image { format: Format::Depth32Float, .. } => {
                    let message = format!("`{}` holds depth-test values, not a picture", name.text);
                    self.errors.push(at.error(message, "cannot be an output"));
                    None
                }
                Shape::Image { .. } => Some(id),
                Shape::Buffer { .. } => {
                    let message = format!("`{}` is a buffer", name.text);
                    self.errors.push(at.error(message, "the output is an image"));
                    None
                }
            },
            Ok(None) => None,
            Err(diagnostic) => {
                self.errors.push(diagnostic);
                None
            }
        }
    }

    /// Rejects `last(name)` as a result: by the end of the frame it is overwritten.
    fn of_this_frame(&self, id: Option<ResourceId>, at: &Place) -> Result<Option<ResourceId>, Diagnostic> {
        match id.and_then(|id| self.histories.iter().find(|history| history.previous_frame == id)) {
            None => Ok(id),
            Some(history) => Err(at
                .error("a frame's results must come from the frame itself", "contents of the previous frame")
                .with_help(format!(
                    "name `{0}`, or copy `last({0})` to another resource in a pass",
                    history.name
                ))),
        }
    }

    /// Adds the statistics of a graph. If a name is already in use, the name of the include is put before it.
    pub(super) fn stats(&mut self, level: &Level) {
        for (name, (buffer, offset)) in &level.graph.stats {
            let at = level.root.field("stats").field(name);
            let word = format!("the word of `{name}` does not fit");
            let found = self.words(level, (buffer, offset), (4, &word), &at).and_then(|found| {
                self.of_this_frame(found.map(|(id, _)| id), &at.index(0))?;
                let is_taken = |name: &str| self.lowered.plan.stats.iter().position(|s| s.name == name);
                let full = match is_taken(name) {
                    None => name.clone(),
                    Some(_) => format!("{}{name}", level.prefix),
                };
                match is_taken(&full) {
                    None => Ok(found.map(|(buffer, offset)| (full, buffer, offset))),
                    Some(first) => {
                        let error = Diagnostic::new(
                            format!("two statistics are called `{full}`"),
                            at.key(),
                            "the second",
                        );
                        let error = error.with_label(self.lowered.stat_spans[first], "the first");
                        Err(error.with_help("rename one of them"))
                    }
                }
            });
            match found {
                Ok(Some((full, buffer, offset))) => {
                    let file = self.files.origin(at.key()).file;
                    let is_grown =
                        |param: &&Param| param.grows.as_ref() == Some(name) && param.origin.file == file;
                    let grown = level.params.iter().filter(is_grown);
                    let grows = grown.map(|param| param.name.clone()).collect();
                    self.lowered.plan.stats.push(Stat { name: full, buffer, offset, grows });
                    self.lowered.stat_spans.push(at.key());
                }
                Ok(None) => {}
                Err(diagnostic) => self.errors.push(diagnostic),
            }
        }
    }
    /// Replaces the names in `grows`, of a graph's own statistics, by those in the plan.
    pub(super) fn end_stats(&mut self) {
        let plan = &mut self.lowered.plan;
        for param in &mut plan.params {
            let grown = plan.stats.iter().find(|stat| stat.grows.contains(&param.name));
            param.grows = grown.map(|stat| stat.name.clone()).or(param.grows.take());
        }
    }
}
