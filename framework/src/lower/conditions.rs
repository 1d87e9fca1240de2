//! Conditions: leaves out passes, includes, repeats and swaps whose `when` is false, and notes what went with them.

use super::RemovedUse;
use super::passes::{Head, Level, Lowering};
use super::resources::Handle;
use super::scope::Place;
use crate::ir::{Culled, Run, Value};
use crate::schema::{Call, Number, Part, PassDecl, Reference, ResourceName, Size, SwapDecl};
use crate::source::Diagnostic;

/// A `when` that is false.
struct False<'a> {
    /// Begins the reason: `its condition` or `the condition of its repeat`.
    whose: &'a str,
    condition: &'a Number,
    /// The `when` in the file.
    at: &'a Place,
}

impl Lowering<'_> {
    /// Evaluates the pass's `when`; a pass where it is false is listed as culled.
    pub(super) fn wanted(
        &mut self,
        level: &Level,
        when: &Option<Number>,
        head: &Head,
        users: &[&Reference],
    ) -> Result<bool, Diagnostic> {
        let Some(condition) = when else { return Ok(true) };
        let at = head.place.field("when");
        if level.names.truth(condition, &at)? {
            return Ok(true);
        }
        self.leave_out(level, head, users, &False { whose: "its condition", condition, at: &at });
        Ok(false)
    }

    /// Evaluates the `when` of a repeat.
    ///
    /// A false one lists the passes of the body as culled, once each.
    pub(super) fn repeats(
        &mut self,
        level: &mut Level,
        when: &Option<Number>,
        var: &str,
        body: &[PassDecl],
        place: &Place,
    ) -> Result<bool, Diagnostic> {
        let Some(condition) = when else { return Ok(true) };
        let at = place.field("when");
        if level.names.truth(condition, &at)? {
            return Ok(true);
        }
        let why = False { whose: "the condition of its repeat", condition, at: &at };
        self.leave_out_body(level, var, body, &place.field("body"), &why);
        Ok(false)
    }

    /// Exchanges the halves of a ping-pong resource, unless the `when` of the swap is false.
    pub(super) fn swap(&mut self, level: &Level, swap: &SwapDecl, place: &Place) -> Result<(), Diagnostic> {
        let (name, at, when) = match swap {
            SwapDecl::Always(name) => (name, place.index(0), &None),
            SwapDecl::When { name, when } => (name, place.field("name"), when),
        };
        // A wrong name is an error whether the condition holds or not.
        let pair = match level.handles.get(name) {
            Some(Some(Handle::PingPong(index))) => Some(*index),
            Some(None) => None,
            // A plain resource and an unknown one are told apart by the usual look-up.
            _ => {
                let front = ResourceName { name: name.clone(), part: Part::Front, range: 0..name.len() };
                self.look_up_name(level, Some(&front), &at, at.span())?;
                None
            }
        };
        let swaps = match when {
            Some(condition) => level.names.truth(condition, &place.field("when"))?,
            None => true,
        };
        if let Some(pair) = pair.filter(|_| swaps) {
            let pair = &mut self.ping_pongs[pair];
            pair.front = 1 - pair.front;
        }
        Ok(())
    }

    /// Lists a pass as culled, and the uses that go with it.
    fn leave_out(&mut self, level: &Level, head: &Head, users: &[&Reference], why: &False) {
        let name = format!("{}{}{}", level.prefix, head.name, level.suffix);
        let condition = match why.condition {
            Number::Expression(expression) => expression.text.clone(),
            Number::Literal(value) => value.to_string(),
        };
        for user in users {
            for id in self.look_up(level, user, why.at).ok().flatten().unwrap_or_default() {
                self.unwritten.push(RemovedUse { resource: id, pass: name.clone(), when: why.at.span() });
            }
        }
        let origin = self.files.origin(head.place.span());
        let why = format!("{} is false: {condition}", why.whose);
        self.culled.push(Culled { pass: name, why, origin });
    }

    fn leave_out_body(&mut self, level: &mut Level, var: &str, body: &[PassDecl], at: &Place, why: &False) {
        // Names in the body may depend on the counter, as in its first turn.
        let hidden = level.names.values.insert(var.into(), Value::Int(0));
        for (i, pass) in body.iter().enumerate() {
            let place = at.index(i);
            if !self.count(1, &place) {
                break;
            }
            let (name, users): (_, Vec<&Reference>) = match pass {
                PassDecl::Dispatch { name, bind, size, .. } => {
                    let arguments = match size {
                        Size::Indirect(buffer, _) => Some(buffer),
                        Size::Threads(_) | Size::Groups(_) => None,
                    };
                    (name, bind.values().chain(arguments).collect())
                }
                PassDecl::Draw { name, bind, targets, call, .. } => {
                    let arguments = match call {
                        Call::Indirect(buffer, _) => Some(buffer),
                        Call::Direct { .. } => None,
                    };
                    let targets = targets.iter().map(|target| &target.image);
                    (name, bind.values().chain(targets).chain(arguments).collect())
                }
                PassDecl::Fill { name, buffer, .. } => (name, vec![buffer]),
                PassDecl::Include { name, with, .. } => (name, with.values().collect()),
                PassDecl::Repeat { var, body, .. } => {
                    self.leave_out_body(level, var, body, &place.field("body"), why);
                    continue;
                }
                PassDecl::Swap(_) => continue,
            };
            self.leave_out(level, &Head { name, phase: &None, run: Run::Frame, place: &place }, &users, why);
        }
        match hidden {
            Some(value) => drop(level.names.values.insert(var.into(), value)),
            None => drop(level.names.values.remove(var)),
        }
    }
}
