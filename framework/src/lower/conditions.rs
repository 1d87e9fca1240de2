//! Removes passes and includes whose `when` is false, and records the uses removed with them. Also resolves swaps.

use super::lowered::{RemovedPass, RemovedUse};
use super::lowering::{Handle, Level, Lowering};
use crate::ir::{Culled, ParamSet, Reason};
use crate::schema::{Call, Expression, Number, Part, PassDecl, Reference, ResourceName, Size, is_choice};
use crate::source::{Diagnostic, Place};

struct False<'a> {
    condition: &'a Number,
    at: &'a Place,
    reason: Option<Reason>,
    decided: ParamSet,
}

impl Lowering<'_> {
    /// Evaluates the `when` of a pass or an include; true if there is none. If it is false, lists the pass as culled.
    pub(super) fn wanted(
        &mut self,
        level: &Level,
        when: &Option<Number>,
        pass: &PassDecl,
        place: &Place,
    ) -> Result<bool, Diagnostic> {
        let Some(condition) = when else { return Ok(true) };
        let at = &place.field("when");
        let (holds, decided) = level.names.traced(|| level.names.truth(condition, at));
        self.lowered.shape.extend(&decided);
        level.names.note_decided(&decided);
        if holds? {
            return Ok(true);
        }
        let reason = match condition {
            Number::Expression(expression) => level.names.traced(|| level.names.reason(expression)).0,
            Number::Literal(_) => None,
        };
        self.leave_out(level, pass, place, &False { condition, at, reason, decided });
        Ok(false)
    }

    pub(super) fn swap(&mut self, level: &Level, name: &str, at: &Place) -> Result<(), Diagnostic> {
        match level.handles.get(name) {
            Some(Some(Handle::PingPong(index))) => {
                let pair = &mut self.ping_pongs[*index];
                pair.front = 1 - pair.front;
                pair.swaps += 1;
            }
            Some(None) => {}
            // Looking up the front reports the right error: the resource is unknown, or not a ping-pong resource.
            _ => {
                let front = ResourceName { name: name.into(), part: Part::Front, range: 0..name.len() };
                self.look_up_name(level, Some(&front), at, at.span())?;
            }
        }
        Ok(())
    }

    /// Lists a pass or an include as culled, and records the resources and parameters that it would have used.
    fn leave_out(&mut self, level: &Level, pass: &PassDecl, place: &Place, why: &False) {
        let Some(Parts { name, users, numbers, shaders }) = Parts::of(pass) else { return };
        let name = format!("{}{name}{}", level.prefix, level.suffix);
        let condition = match why.condition {
            Number::Expression(expression) => expression.line(),
            Number::Literal(value) => value.to_string(),
        };
        for user in &users {
            for id in self.look_up(level, user, why.at).ok().flatten().unwrap_or_default() {
                let (pass, when) = (name.clone(), why.at.span());
                self.lowered.unwritten.push(RemovedUse { resource: id, pass, when });
            }
        }
        let chooses = shaders.iter().filter(|shader| is_choice(&shader.text));
        let chosen: Vec<ParamSet> = chooses.map(|shader| level.names.named(shader)).collect();
        let shader = |text: &Expression| self.shader(level, text, why.at).ok().map(|shader| shader.name);
        let shaders = shaders.into_iter().filter_map(shader).collect();
        let numbers = numbers.into_iter().flat_map(|number| level.names.named_by(number));
        let numbers = numbers.chain(chosen.into_iter().flatten());
        let choices = users.iter().flat_map(|user| level.names.named_by_choice(user));
        let exposed = match pass {
            PassDecl::Include { .. } => level.exposed.get(&place.id()),
            _ => None,
        };
        let exposed = exposed.into_iter().flatten().filter_map(|name| level.names.params.get(name)).flatten();
        self.lowered.removed.push(RemovedPass {
            condition: condition.clone(),
            when: why.at.span(),
            reason: why.reason.clone(),
            decided: why.decided.clone(),
            named: numbers.chain(choices).chain(exposed.copied()).collect(),
            file: level.file,
            shaders,
            constants: level.constants.clone(),
        });
        let origin = self.files.origin(place.span());
        let why = format!("its condition is false: {condition}");
        self.lowered.plan.culled.push(Culled { pass: name, why, origin });
    }
}

struct Parts<'a> {
    name: &'a str,
    users: Vec<&'a Reference>,
    numbers: Vec<&'a Number>,
    shaders: Vec<&'a Expression>,
}

impl Parts<'_> {
    /// Collects the names that a pass or an include mentions; `None` for repeats and swaps.
    fn of(pass: &PassDecl) -> Option<Parts<'_>> {
        Some(match pass {
            PassDecl::Dispatch { name, shader, size, bind, push, .. } => {
                let (argument, numbers) = match size {
                    Size::Indirect(buffer, offset) => (Some(buffer), vec![offset]),
                    Size::Threads(extent) | Size::Groups(extent) => (None, extent.0.iter().collect()),
                };
                Parts {
                    name,
                    users: bind.values().chain(argument).collect(),
                    numbers: numbers.into_iter().chain(push.values()).collect(),
                    shaders: vec![shader],
                }
            }
            PassDecl::Draw { name, vertex, fragment, call, bind, push, targets, depth, .. } => {
                let (argument, numbers) = match call {
                    Call::Indirect(buffer, offset) => (Some(buffer), vec![offset]),
                    Call::Direct { vertices, instances } => (None, vec![vertices, instances]),
                };
                let depth = depth.iter().map(|depth| &depth.image);
                let targets = targets.iter().map(|target| &target.image).chain(depth);
                Parts {
                    name,
                    users: bind.values().chain(targets).chain(argument).collect(),
                    numbers: numbers.into_iter().chain(push.values()).collect(),
                    shaders: vec![vertex, fragment],
                }
            }
            PassDecl::Fill { name, buffer, value, .. } => {
                Parts { name, users: vec![buffer], numbers: vec![value], shaders: Vec::new() }
            }
            PassDecl::Include { name, with, set, .. } => {
                let (users, numbers) = (with.values().collect(), set.values().collect());
                Parts { name, users, numbers, shaders: Vec::new() }
            }
            PassDecl::Repeat { .. } | PassDecl::Swap(_) => return None,
        })
    }
}
