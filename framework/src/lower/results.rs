//! Resolves the output and the statistics of a graph and its parts.

use super::ResourceHandle;
use super::passes::{Level, Lowering};
use super::scope::Place;
use crate::ir::{Shape, Span, Stat};
use crate::source::{Diagnostic, Path};

impl Lowering<'_> {
    pub(super) fn output(&mut self, level: &Level) -> Option<(ResourceHandle, Span)> {
        let root = Place::new(&level.outline, Path::root());
        let Some(name) = &level.graph.output else {
            self.errors.push(Diagnostic::new(
                "this graph has no output",
                level.outline.head(&Path::root()),
                "add `output: \"name of an image\"`",
            ));
            return None;
        };
        let at = root.field("output");
        match self.look_up_one(level, name, &at).and_then(|id| self.of_this_frame(id, &at)) {
            Ok(Some(id)) if matches!(self.resources[id.index()].shape, Shape::Image { .. }) => {
                Some((id, at.span()))
            }
            Ok(None) => None,
            Ok(Some(_)) => {
                self.errors.push(at.error(format!("`{}` is a buffer", name.text), "the output is an image"));
                None
            }
            Err(diagnostic) => {
                self.errors.push(diagnostic);
                None
            }
        }
    }

    /// Refuses `last(name)` as a result: this frame has overwritten it by then.
    fn of_this_frame(
        &self,
        id: Option<ResourceHandle>,
        at: &Place,
    ) -> Result<Option<ResourceHandle>, Diagnostic> {
        match id.and_then(|id| self.histories.iter().find(|history| history.previous_frame == id)) {
            None => Ok(id),
            Some(history) => Err(at
                .error("a frame's results are what it leaves itself", "contents of the previous frame")
                .with_help(format!(
                    "name `{0}`, or copy `last({0})` to another resource in a pass",
                    history.name
                ))),
        }
    }

    /// Adds the statistics of a graph.
    pub(super) fn stats(&mut self, level: &Level) {
        for (name, (buffer, offset)) in &level.graph.stats {
            let at = Place::new(&level.outline, Path::root().field("stats").key(name));
            let word = format!("the word of `{name}` does not stand");
            let found = self.words(level, (buffer, offset), (4, &word), &at).and_then(|found| {
                self.of_this_frame(found.map(|(id, _)| id), &at.index(0))?;
                match self.stats.iter().find(|(stat, _)| stat.name == *name) {
                    None => Ok(found),
                    Some((_, first)) => {
                        let message = format!("two statistics are called `{name}`");
                        Err(Diagnostic::new(message, at.key(), "the second").with_label(*first, "the first"))
                    }
                }
            });
            match found {
                Ok(Some((buffer, offset))) => {
                    self.stats.push((Stat { name: name.clone(), buffer, offset }, at.key()));
                }
                Ok(None) => {}
                Err(diagnostic) => self.errors.push(diagnostic),
            }
        }
    }
}
