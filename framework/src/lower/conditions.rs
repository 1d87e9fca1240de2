//! Removes passes and includes whose `when` is false, and the bodies of repeats whose count is 0. Records the uses
//! removed with them. Also resolves swaps.

use super::lowered::{RemovedPass, RemovedUse};
use super::lowering::{Handle, Level, Lowering};
use super::removed::Parts;
use crate::ir::{Culled, ParamSet, Reason, Value};
use crate::schema::{Expression, Number, Part, PassDecl, ResourceName, is_choice};
use crate::source::{Diagnostic, Place};

/// A condition that is false, or the count of a repeat that is 0.
pub(super) struct False<'a> {
    condition: &'a Number,
    at: &'a Place,
    /// `false` or `0`.
    value: &'static str,
    reason: Option<Reason>,
    decided: ParamSet,
}

impl<'a> False<'a> {
    pub fn new(
        level: &Level,
        condition: &'a Number,
        at: &'a Place,
        value: &'static str,
        decided: ParamSet,
    ) -> False<'a> {
        let reason = level.names.traced(|| level.names.reason(condition)).0;
        False { condition, at, value, reason, decided }
    }
}

impl Lowering<'_> {
    /// Evaluates the `when` of a pass or an include; true if there is none. If it is false, lists the pass as culled.
    pub(super) fn wanted(
        &mut self,
        level: &mut Level,
        pass: &PassDecl,
        place: &Place,
    ) -> Result<bool, Diagnostic> {
        let Some(condition) = pass.when() else { return Ok(true) };
        let at = &place.field("when");
        let (holds, decided) = level.names.traced(|| level.names.truth(condition, at));
        self.lowered.shape.extend(&decided);
        level.names.note_decided(&decided);
        if holds? {
            return Ok(true);
        }
        let why = False::new(level, condition, at, "false", decided);
        self.leave_out(level, pass, place, &why);
        Ok(false)
    }

    /// Lists the body of a repeat as culled. `why` is the count that is 0, of this repeat or of one around it.
    pub(super) fn leave_out_body(
        &mut self,
        level: &mut Level,
        (var, body): (&str, &[PassDecl]),
        place: &Place,
        why: &False,
    ) {
        let outer = level.names.values.insert(var.into(), Value::Int(0));
        for (i, pass) in body.iter().enumerate() {
            let at = place.field("body").index(i);
            if !self.count(1, &at) {
                break;
            }
            if let Some(when) = pass.when() {
                self.errors.extend(level.names.check_number(when, &at.field("when")).err());
            }
            self.leave_out(level, pass, &at, why);
            if let PassDecl::Repeat { var, body, .. } = pass {
                self.leave_out_body(level, (var, body), &at, why);
            }
        }
        match outer {
            Some(outer) => level.names.values.insert(var.into(), outer),
            None => level.names.values.remove(var),
        };
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
    fn leave_out(&mut self, level: &mut Level, pass: &PassDecl, place: &Place, why: &False) {
        self.check_removed(level, pass, place);
        if let PassDecl::Include { name, .. } = pass {
            level.absent.insert(name.clone(), Some(why.at.span()));
        }
        let Some(Parts { name, users, numbers, shaders }) = Parts::of(pass, place) else { return };
        let name = format!("{}{name}{}", level.prefix, level.suffix);
        let condition = match why.condition {
            Number::Expression(expression) => expression.line(),
            Number::Literal(value) => value.to_string(),
        };
        for (user, at) in &users {
            for id in self.look_up_removed(level, user, at).unwrap_or_default() {
                let (pass, when, value) = (name.clone(), why.at.span(), why.value);
                self.lowered.unwritten.push(RemovedUse { resource: id, pass, when, value });
            }
        }
        let chooses = shaders.iter().filter(|(shader, _)| is_choice(&shader.text));
        let chosen: Vec<ParamSet> = chooses.map(|(shader, _)| level.names.named(shader)).collect();
        let shader = |(text, at): (&Expression, Place)| Some(self.shader(level, text, &at).ok()?.name);
        let shaders = shaders.into_iter().filter_map(shader).collect();
        let numbers = numbers.into_iter().flat_map(|(number, _)| level.names.named_by(number));
        let numbers = numbers.chain(chosen.into_iter().flatten());
        let choices = users.iter().flat_map(|(user, _)| level.names.named_by_choice(user));
        let exposed = match pass {
            PassDecl::Include { .. } => level.exposed.get(&place.id()),
            _ => None,
        };
        let exposed = exposed.into_iter().flatten().filter_map(|name| level.names.params.get(name)).flatten();
        self.lowered.removed.push(RemovedPass {
            condition: match why.value {
                "0" => format!("`{condition}` is above 0"),
                _ => format!("`{condition}`"),
            },
            when: why.at.span(),
            reason: why.reason.clone(),
            decided: why.decided.clone(),
            named: numbers.chain(choices).chain(exposed.copied()).collect(),
            file: level.file,
            shaders,
            constants: level.constants.clone(),
        });
        let origin = self.files.origin(place.span());
        let why = match why.value {
            "0" => format!("the count of its repeat is 0: {condition}"),
            _ => format!("its condition is false: {condition}"),
        };
        self.lowered.plan.culled.push(Culled { pass: name, why, origin });
    }
}
