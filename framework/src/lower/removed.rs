//! Checks the names in passes and includes that are removed from the plan.

use indexmap::IndexMap;

use super::declared;
use super::include::unknown_port;
use super::lowering::{Level, Lowering};
use super::params;
use crate::schema::{Call, Expression, Number, PassDecl, Reference, Size, is_choice};
use crate::source::{Diagnostic, Kind, Place};

/// The names that a pass or an include mentions, with their places.
pub(super) struct Parts<'a> {
    pub name: &'a str,
    pub users: Vec<(&'a Reference, Place)>,
    pub numbers: Vec<(&'a Number, Place)>,
    pub shaders: Vec<(&'a Expression, Place)>,
}

fn entries<'a, T>(map: &'a IndexMap<String, T>, place: &Place) -> Vec<(&'a T, Place)> {
    map.iter().map(|(name, entry)| (entry, place.field(name))).collect()
}

impl Parts<'_> {
    /// Collects the names of a pass or an include; `None` for repeats and swaps.
    pub fn of<'a>(pass: &'a PassDecl, place: &Place) -> Option<Parts<'a>> {
        Some(match pass {
            PassDecl::Dispatch { name, shader, size, bind, push, .. } => {
                let mut users = entries(bind, &place.field("bind"));
                let mut numbers = entries(push, &place.field("push"));
                let at = place.field("size");
                match size {
                    Size::Indirect(buffer, offset) => {
                        users.push((buffer, at.index(0)));
                        numbers.push((offset, at.index(1)));
                    }
                    Size::Threads(extent) | Size::Groups(extent) => {
                        numbers.extend(extent.0.iter().enumerate().map(|(axis, n)| (n, at.index(axis))));
                    }
                }
                Parts { name, users, numbers, shaders: vec![(shader, place.field("shader"))] }
            }
            PassDecl::Draw { name, vertex, fragment, call, bind, push, targets, depth, .. } => {
                let mut users = entries(bind, &place.field("bind"));
                let mut numbers = entries(push, &place.field("push"));
                let at = place.field("call");
                match call {
                    Call::Indirect(buffer, offset) => {
                        users.push((buffer, at.index(0)));
                        numbers.push((offset, at.index(1)));
                    }
                    Call::Direct { vertices, instances } => {
                        numbers.push((vertices, at.field("vertices")));
                        numbers.push((instances, at.field("instances")));
                    }
                }
                let mut attach = |image, when: &'a Option<Number>, at: Place| {
                    users.push((image, at.field("image")));
                    numbers.extend(when.iter().map(|when| (when, at.field("when"))));
                };
                for (i, target) in targets.iter().enumerate() {
                    attach(&target.image, &target.when, place.field("targets").index(i));
                }
                if let Some(depth) = depth {
                    attach(&depth.image, &depth.when, place.field("depth"));
                }
                let shaders = vec![(vertex, place.field("vertex")), (fragment, place.field("fragment"))];
                Parts { name, users, numbers, shaders }
            }
            PassDecl::Fill { name, buffer, value, .. } => Parts {
                name,
                users: vec![(buffer, place.field("buffer"))],
                numbers: vec![(value, place.field("value"))],
                shaders: Vec::new(),
            },
            PassDecl::Include { name, with, set, .. } => Parts {
                name,
                users: entries(with, &place.field("with")),
                numbers: entries(set, &place.field("set")),
                shaders: Vec::new(),
            },
            PassDecl::Repeat { .. } | PassDecl::Swap(_) => return None,
        })
    }
}

impl Lowering<'_> {
    /// Reports unknown names in a removed pass or include, and lists its shaders in
    /// [`Lowered::removed_shaders`](super::lowered::Lowered::removed_shaders).
    ///
    /// The caller checks the body of a repeat. Does not evaluate numbers: the condition that removes the pass may
    /// protect them.
    pub(super) fn check_removed(&mut self, level: &mut Level, pass: &PassDecl, place: &Place) {
        match pass {
            PassDecl::Repeat { count, .. } => {
                self.errors.extend(level.names.check_number(count, &place.field("count")).err());
            }
            PassDecl::Swap(name) => {
                let swapped = Reference::from(name.clone());
                self.errors.extend(self.look_up_removed(level, &swapped, &place.index(0)).err());
            }
            PassDecl::Include { graph, with, set, .. } => {
                let result = self.check_removed_include(level, (graph, with, set), place);
                self.errors.extend(result.err());
            }
            PassDecl::Dispatch { .. } | PassDecl::Draw { .. } | PassDecl::Fill { .. } => {
                let Some(Parts { users, numbers, shaders, .. }) = Parts::of(pass, place) else { return };
                for (number, at) in &numbers {
                    self.errors.extend(level.names.check_number(number, at).err());
                }
                for (user, at) in &users {
                    self.errors.extend(self.look_up_removed(level, user, at).err());
                }
                for (shader, at) in &shaders {
                    if is_choice(&shader.text) {
                        self.errors.extend(level.names.check(shader, at).err());
                    } else if let Ok(found) = self.shader(level, shader, at) {
                        self.lowered.removed_shaders.push((level.file, found));
                    }
                }
            }
        }
    }

    fn check_removed_include(
        &mut self,
        level: &Level,
        (graph, with, set): (&str, &IndexMap<String, Reference>, &IndexMap<String, Number>),
        place: &Place,
    ) -> Result<(), Diagnostic> {
        let at = place.field("graph");
        let file = self.files.find(Some(level.file), graph, Kind::Graph).map_err(|e| e.at(at.span()))?;
        let found = self.choices.choose(file, self.files, 0).and_then(|chosen| {
            let parameters =
                declared::parameters(&chosen.opened, &mut self.choices, self.files, &mut self.known)?;
            Ok((chosen, parameters))
        });
        let Some((chosen, parameters)) = self.reported(found) else { return Ok(()) };
        // The condition may ask which graph a choice takes, so another one may have the port or the parameter.
        let others = &chosen.opened.others;
        if others.iter().all(|other| unknown_port(graph, &other.graph, with, place).is_err()) {
            unknown_port(graph, &chosen.opened.graph, with, place)?;
        }
        for (given, at) in entries(with, &place.field("with")) {
            self.look_up_removed(level, given, &at)?;
        }
        for (name, number) in set {
            let at = place.field("set").field(name);
            if !others.is_empty() {
                level.names.check_number(number, &at)?;
                continue;
            }
            let Some(declared) = parameters.get(name) else {
                return Err(parameters.unknown(name, at.key(), "set here"));
            };
            params::check_given(number, declared.declaration().kind(), &level.names, &at)?;
        }
        Ok(())
    }
}
