//! Computes the values of parameters from their declarations, presets, and the request's settings and capacities.
//! Generates `live.glsl`.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use super::declared::{Declared, Hidden, Parameters, Reach};
use super::document::{Opened, Setting};
use super::lowered::SkippedUse;
use super::reserved::is_reserved;
use super::scope::{Names, check_identifier, describe, is_identifier};
use crate::expr::name_unknown_in;
use crate::ir::{
    Domain, LIVE_BINDING, LIVE_BLOCK, Param, ParamBinding, ParamSet, Reason, Request, Span, Value,
};
use crate::schema::{Expression, Number, ParamDecl, ParamKind};
use crate::source::{Diagnostic, Place, SourceMap, nearest};

pub(super) struct Resolved {
    pub params: Vec<Param>,
    /// Value of each parameter if the request sets none.
    pub unset: Vec<Value>,
    /// Facts and parameters, for `let`s and passes.
    pub names: Names,
    pub live_bytes: u64,
    pub live: BTreeMap<String, ParamSet>,
    pub skipped: Vec<SkippedUse>,
}

/// A setting of the request: its text, and the place that errors about it point to.
struct Text<'a> {
    value: &'a str,
    span: Span,
}

/// Evaluates the parameters of the root graph: defaults, then presets, then the request's settings and capacities.
///
/// A setting of an unknown parameter, or outside the parameter's domain, is an error. If `rejected` is given, a
/// setting of the request is ignored instead, and the parameter's name is added to `rejected`. Parameters with
/// errors, and those that depend on them, are missing from the result.
pub(super) fn resolve(
    root: &Opened,
    parameters: &Parameters,
    request: &Request,
    files: &mut SourceMap,
    mut rejected: Option<&mut Vec<String>>,
    errors: &mut Vec<Diagnostic>,
) -> Resolved {
    let unknown_here = |name: &str| !parameters.contains(name) && !parameters.elsewhere.contains(name);
    for (name, setting) in root.set.iter().filter(|(name, _)| unknown_here(name)) {
        errors.push(parameters.unknown(name, setting.place.key(), "set here"));
    }
    let mut texts = Vec::new();
    for (name, value) in request.set {
        let file = files.add("--set", format!("{name}={value}"));
        if !parameters.contains(name) {
            match &mut rejected {
                Some(rejected) if rejected.contains(name) => {}
                Some(rejected) => rejected.push(name.clone()),
                None => errors.push(parameters.unknown(name, Span::new(file, 0..name.len()), "set here")),
            }
        }
        let span = Span::new(file, name.len() + 1..name.len() + 1 + value.len());
        texts.push((name.as_str(), Text { value, span }));
    }

    let mut names = Names::of(request.facts);
    let mut params: Vec<Option<(Param, Value)>> = vec![None; parameters.all.len()];
    let (mut live, mut skipped) = (BTreeMap::new(), Vec::new());
    let is_live = |declared: &&Declared| matches!(declared.declaration(), ParamDecl::Live(_));
    let live_bytes = |until: usize| 4 * parameters.all[..until].iter().filter(is_live).count() as u64;
    let mut failed: BTreeSet<&str> = BTreeSet::new();
    let (order, circle) = parameters.order(&root.set);
    errors.extend(circle);
    for index in order {
        let declared = &parameters.all[index];
        let name = &declared.name;
        if declared.reach(root.set.get(name)).names.iter().any(|name| failed.contains(name.as_str())) {
            // An error here would only be a consequence of the other parameter's error.
            failed.insert(name);
            continue;
        }
        let text = texts.iter().rev().find(|(n, _)| n == name).map(|(_, t)| t);
        let mut made = one(declared, root.set.get(name), text, &names, live_bytes(index), files);
        if let (Err(error), Some(text), Some(rejected)) = (&made, text, &mut rejected)
            && error.primary.span == text.span
        {
            rejected.push(name.clone());
            made = one(declared, root.set.get(name), None, &names, live_bytes(index), files);
        }
        let made = made.and_then(|made| Ok((made, grows(declared)?)));
        match made {
            Ok((Made { mut param, unset, params: mut behind, range, skipped: others }, grows)) => {
                param.grows = grows;
                let value = param.with_room(param.value.clone(), request.capacities);
                if request.capacities.iter().any(|(capacities, _)| capacities == name) {
                    // The capacity is clamped to the range, so the value also depends on the range's parameters.
                    behind.extend(&range);
                }
                if !others.is_empty() {
                    let (name, span, decided) = (name.clone(), declared.place.key(), behind.clone());
                    let reason = param.reason.clone();
                    skipped.push(SkippedUse { params: others, name, span, decided, reason });
                }
                // The reason explains the value in the file, not a value raised to a capacity.
                param.reason.take_if(|_| value != param.value);
                param.value = value;
                behind.insert(index);
                match param.binding {
                    ParamBinding::Const => {
                        names.define_param(name, param.value.clone(), behind, &param.domain);
                    }
                    ParamBinding::Live { .. } => {
                        names.live.insert(name.clone());
                        names.params.insert(name.clone(), behind.clone());
                        live.insert(name.clone(), behind);
                    }
                }
                params[index] = Some((param, unset));
            }
            Err(mut diagnostic) => {
                failed.insert(name);
                let levels = || 0..=declared.around.len();
                let is_unset = |name: &str| levels().any(|at| declared.unset(at).iter().any(|n| *n == name));
                if name_unknown_in(&diagnostic.primary.text).is_some_and(is_unset) {
                    let other = match declared.around.is_empty() {
                        true => "",
                        false => ", or do not expose the parameter that needs it",
                    };
                    diagnostic.help = vec![format!(
                        "parameters get their values before any `let` or `Repeat`: use parameters and facts{other}"
                    )];
                }
                errors.push(diagnostic);
            }
        }
    }
    let (params, unset) = params.into_iter().flatten().unzip();
    Resolved { params, unset, names, live_bytes: live_bytes(parameters.all.len()), live, skipped }
}

struct Made {
    param: Param,
    /// Value if the request sets none.
    unset: Value,
    /// Parameters that the value depends on.
    params: ParamSet,
    /// Parameters that the range, the default and the exact value depend on.
    range: ParamSet,
    /// Parameters that the value's expression names but its evaluation did not read.
    skipped: ParamSet,
}

fn one(
    declared: &Declared,
    setting: Option<&Setting>,
    text: Option<&Text>,
    names: &Names,
    offset: u64,
    files: &SourceMap,
) -> Result<Made, Diagnostic> {
    let Declared { name, place, default: replaced, .. } = declared;
    let (kind, binding) = match declared.declaration() {
        ParamDecl::Const(kind) => (kind, ParamBinding::Const),
        ParamDecl::Live(kind) => (kind, ParamBinding::Live { offset: offset as u32 }),
    };
    check_identifier(name, "a parameter", place.key())?;
    if binding != ParamBinding::Const && is_reserved(name) {
        let message = format!("`{name}` cannot name a live parameter");
        return Err(Diagnostic::new(message, place.key(), "shaders have something else of this name")
            .with_help("a live parameter is a variable of the same name in shaders: rename it"));
    }
    let kind_place = place.index(0);
    let (written, level) = match replaced {
        Some((Setting { number, place }, level)) => ((number.clone(), place.clone()), *level),
        None => ((kind.default(), kind_place.field("default")), 0),
    };
    let around = around(declared, setting, names)?;
    let (inner, outer) = (&around[0], &around[level]);
    let (found, mut range) =
        inner.traced(|| outer.traced(|| domain(kind, &kind_place, &written, inner, outer)));
    let (found, behind_default) = found;
    range.extend(behind_default);
    let (domain, default, exact) = found?;
    let preset = |setting: &Setting| given(&setting.number, &domain, names, &setting.place);
    let (value, unset, (reason, params, skipped)) = match (text, setting) {
        (Some(text), _) => {
            // The text overrides the preset's value: ignore its errors, and the parameters that it depends on.
            let unset = setting.and_then(|setting| names.traced(|| preset(setting)).0.ok());
            let value = parse_value(text.value, &domain).map_err(|m| {
                let error = Diagnostic::new(format!("`{name}` cannot be set to this"), text.span, m);
                match range_reason(kind, inner) {
                    Some(reason) => error.with_help(format!("its range depends on {reason}")),
                    None => error,
                }
            })?;
            (value, unset.unwrap_or_else(|| default.clone()), Default::default())
        }
        (None, Some(setting)) => {
            let value = preset(setting)?;
            (value.clone(), value, reason(&setting.number, &domain, names))
        }
        (None, None) => (default.clone(), default.clone(), reason(&written.0, &domain, outer)),
    };
    let origin = files.origin(place.key());
    let param =
        Param { name: name.into(), value, default, reason, exact, grows: None, domain, binding, origin };
    Ok(Made { param, unset, params, range, skipped })
}

/// Returns the scopes of a parameter's expressions. There is one per include around it, innermost first, then that of
/// the graph that has it. An include adds only the values of `set` that the parameter needs: others may use `let`s of
/// the includer, which have no values yet.
fn around<'a>(
    declared: &Declared,
    setting: Option<&Setting>,
    names: &'a Names,
) -> Result<Vec<Cow<'a, Names>>, Diagnostic> {
    let Reach { set, hidden, .. } = declared.reach(setting);
    if let Some(Hidden { name: hidden, declared: at, exposed }) = hidden {
        let name = &declared.name;
        let message =
            format!("`{name}` is exposed and needs `{hidden}`, which the include neither exposes nor sets");
        return Err(Diagnostic::new(message, exposed, "is exposed")
            .with_label(declared.place.key(), "declared here")
            .with_label(at, "has its default in the included graph")
            .with_help(format!("add `{hidden}` to `expose`, or give it a value in `set`")));
    }
    let mut all = vec![Cow::Borrowed(names)];
    for (level, around) in declared.around.iter().enumerate().rev() {
        let outside = &all[all.len() - 1];
        let mut inside = outside.clone();
        // A `let` or the variable of a repeat hides a parameter of the same name further out.
        for name in declared.unset(level) {
            if outside.contains(name) {
                inside.to_mut().forget(name);
            }
        }
        for (_, name) in set.iter().filter(|(at, _)| *at == level) {
            let given = &around.set[name];
            let Setting { number, place: at } = &given.setting;
            let domain = any(&given.kind);
            let (value, read) = outside.traced(|| self::given(number, &domain, outside, at));
            let explain = |error: Diagnostic| {
                let needs = format!("`{}` is exposed, and needs this value", declared.name);
                error.with_label(declared.place.key(), needs)
            };
            inside.to_mut().shadow(name, value.map_err(explain)?, read, &domain);
        }
        all.push(inside);
    }
    all.reverse();
    Ok(all)
}

/// Returns the domain of a parameter without its range: all values of the type.
fn any(kind: &ParamKind) -> Domain {
    match kind {
        ParamKind::Bool { .. } => Domain::Bool,
        ParamKind::Int { .. } => Domain::Int { min: i64::MIN, max: i64::MAX },
        ParamKind::Float { .. } => Domain::Float { min: f64::NEG_INFINITY, max: f64::INFINITY, step: 0.0 },
        ParamKind::Choice { of, .. } => Domain::Choice(of.clone()),
    }
}

/// Returns the name of the statistic that a parameter grows with; `None` if it does not grow. Fails for a live
/// parameter, and if the declaring graph lacks the statistic.
fn grows(declared: &Declared) -> Result<Option<String>, Diagnostic> {
    let declaration = declared.declaration();
    let ParamKind::Int { grows: Some(name), .. } = declaration.kind() else { return Ok(None) };
    let at = declared.place.index(0).field("grows");
    if matches!(declaration, ParamDecl::Live(_)) {
        return Err(
            at.error("a live parameter cannot grow", "the capacity of a plan depends only on its constants")
        );
    }
    let graph = declared.graph();
    if graph.stats.contains_key(name) {
        return Ok(Some(name.clone()));
    }
    let all: Vec<_> = graph.stats.keys().map(|stat| format!("`{stat}`")).collect();
    let otherwise = match all[..] {
        [] => "this graph has no statistics: declare one in `stats`".to_string(),
        _ => format!("it has {}", all.join(", ")),
    };
    let error = at.error("`grows` names no statistic", format!("the graph has no statistic `{name}`"));
    Err(error.with_nearest(name, graph.stats.keys().map(String::as_str), otherwise))
}

pub(super) fn texts(declaration: &ParamDecl) -> (&str, &str) {
    match declaration.kind() {
        ParamKind::Bool { label, help, .. }
        | ParamKind::Int { label, help, .. }
        | ParamKind::Float { label, help, .. }
        | ParamKind::Choice { label, help, .. } => (label, help),
    }
}

/// Evaluates the domain, the default and the exact value of a declaration. The default has its own place and scope.
fn domain(
    kind: &ParamKind,
    place: &Place,
    (default, default_at): &(Number, Place),
    names: &Names,
    default_names: &Names,
) -> Result<(Domain, Value, Option<Value>), Diagnostic> {
    let value =
        |number: &Number, field: &str, domain: &Domain| given(number, domain, names, &place.field(field));
    // Parameters reach shaders as 32-bit numbers, so ranges must fit.
    let too_wide = |at: Place, v: &dyn std::fmt::Display, kind: &str, from: &str, to: &str| {
        at.error(format!("a parameter is {kind} of 32 bits"), format!("expected {from} to {to}, found {v}"))
    };
    let bound = |number: &Number, index: usize| -> Result<f64, Diagnostic> {
        let at = place.field("range").index(index);
        let value = names.evaluate(number, &at)?;
        let Some(v) = value.as_f64() else {
            return Err(at.error("a range needs numbers", format!("this is {}", describe(&value))));
        };
        if (v as f32).is_finite() {
            Ok(v)
        } else {
            Err(too_wide(at, &format!("{v:?}"), "a float", "-3.4e38", "3.4e38"))
        }
    };
    let empty = |min: Value, max: Value| {
        let label = format!("expected an end of at least {min}, found {max}");
        Err(place.field("range").error("this range is empty", label))
    };
    let domain = match kind {
        ParamKind::Bool { .. } => Domain::Bool,
        ParamKind::Int { range, .. } => {
            let bound = |number: &Number, index: usize| {
                let at = place.field("range").index(index);
                let v = names.integer(number, &at)?;
                if i32::try_from(v).is_err() {
                    let (from, to) = (i32::MIN.to_string(), i32::MAX.to_string());
                    return Err(too_wide(at, &v, "an integer", &from, &to));
                }
                Ok(v)
            };
            let (min, max) = (bound(&range.0, 0)?, bound(&range.1, 1)?);
            if max < min {
                return empty(Value::Int(min), Value::Int(max));
            }
            Domain::Int { min, max }
        }
        ParamKind::Float { range, step, .. } => {
            let (min, max) = (bound(&range.0, 0)?, bound(&range.1, 1)?);
            if max < min {
                return empty(Value::Float(min), Value::Float(max));
            }
            let step = match step {
                None => (max - min) / 100.0,
                Some(number) => {
                    let at = place.field("step");
                    let value = names.evaluate(number, &at)?;
                    match value.as_f64() {
                        Some(v) if v > 0.0 => v,
                        Some(_) => return Err(at.error("a step must be above 0", "this is not")),
                        None => return Err(at.error("a step must be a number", describe(&value))),
                    }
                }
            };
            Domain::Float { min, max, step }
        }
        ParamKind::Choice { of, .. } => {
            let at = place.field("of");
            if of.is_empty() {
                return Err(at.error("expected at least one value to choose from, found none", "is empty"));
            }
            if let Some(i) = (0..of.len()).find(|i| of[..*i].contains(&of[*i])) {
                let error = at.index(i).error(format!("`{}` is in this choice twice", of[i]), "again here");
                let first = of.iter().position(|option| *option == of[i]).unwrap_or(0);
                return Err(error.with_label(at.index(first).span(), "the first"));
            }
            Domain::Choice(of.clone())
        }
    };
    let default = given(default, &domain, default_names, default_at)?;
    let exact = kind.exact().map(|e| value(&e, "exact", &domain)).transpose()?;
    Ok((domain, default, exact))
}

/// Evaluates a value that a file gives a parameter. In a choice, a string equal to one of its options is a literal,
/// and so is an unknown identifier, so that the error lists the options.
pub(super) fn given(
    number: &Number,
    domain: &Domain,
    names: &Names,
    at: &Place,
) -> Result<Value, Diagnostic> {
    let value = match (number, domain) {
        (Number::Expression(Expression { text, .. }), Domain::Choice(of)) if is_literal(text, of, names) => {
            Value::Text(text.clone())
        }
        _ => names.evaluate(number, at)?,
    };
    within(value, domain).map_err(|m| at.error("this value does not fit the parameter", m))
}

/// Checks the names in a value that a file gives a parameter, like [`given`], without evaluating it.
pub(super) fn check_given(
    number: &Number,
    kind: &ParamKind,
    names: &Names,
    at: &Place,
) -> Result<(), Diagnostic> {
    match (number, kind) {
        (Number::Expression(Expression { text, .. }), ParamKind::Choice { of, .. })
            if is_literal(text, of, names) =>
        {
            given(number, &any(kind), names, at).map(drop)
        }
        _ => names.check_number(number, at),
    }
}

/// Returns true if a string in place of a choice's value is a literal. It is then one of the options, or an identifier
/// that is not a name.
fn is_literal(text: &String, of: &[String], names: &Names) -> bool {
    of.contains(text) || is_identifier(text) && !names.values.contains_key(text)
}

/// Explains a value of [`given`]: its reason, the parameters read, and the parameters named but not read. All three are
/// empty for a literal.
fn reason(number: &Number, domain: &Domain, names: &Names) -> (Option<Reason>, ParamSet, ParamSet) {
    if let (Number::Expression(expression), Domain::Choice(of)) = (number, domain)
        && of.contains(&expression.text)
    {
        return Default::default();
    }
    let (reason, read) = names.traced(|| names.reason(number));
    let skipped = names.named_by(number).difference(&read).copied().collect();
    (reason, read, skipped)
}

/// Returns the values that a parameter's range depends on: `sorter = serial`. `None` if it has no range, or a
/// constant one.
fn range_reason(kind: &ParamKind, names: &Names) -> Option<String> {
    let (ParamKind::Int { range, .. } | ParamKind::Float { range, .. }) = kind else { return None };
    let mut values = BTreeMap::new();
    for bound in [&range.0, &range.1] {
        values.extend(names.traced(|| names.reason(bound)).0.into_iter().flat_map(|r| r.values));
    }
    let reason = Reason { expression: String::new(), values };
    (!reason.values.is_empty()).then(|| reason.to_string())
}

/// Converts a value to the domain's type, or describes why it does not fit.
fn within(value: Value, domain: &Domain) -> Result<Value, String> {
    let number = value.as_f64();
    match (domain, value, number) {
        (Domain::Bool, Value::Bool(v), _) => Ok(Value::Bool(v)),
        (Domain::Int { min, max }, Value::Int(v), _) if (*min..=*max).contains(&v) => Ok(Value::Int(v)),
        (Domain::Int { min, max }, Value::Int(v), _) => Err(format!("{v} is not in {min} to {max}")),
        (Domain::Float { min, max, .. }, _, Some(v)) if (*min..=*max).contains(&v) => Ok(Value::Float(v)),
        (Domain::Float { min, max, .. }, _, Some(v)) => Err(format!("{v:?} is not in {min:?} to {max:?}")),
        (Domain::Choice(of), Value::Text(v), _) => {
            if of.contains(&v) {
                return Ok(Value::Text(v));
            }
            let near = match nearest(&v, of.iter().map(String::as_str)) {
                Some(near) => format!("; did you mean `{near}`?"),
                None => String::new(),
            };
            Err(format!("`{v}` is not one of {}{near}", of.join(", ")))
        }
        (domain, value, _) => Err(format!("{} is not {domain}", describe(&value))),
    }
}

/// Parses a value given as text: `true` or `false`, an integer, a finite number, or one of a choice's names. Fails if
/// the value is outside the domain.
///
/// The error is a phrase about the value, such as `9 is not in 1 to 5` or `is not true or false`.
pub fn parse_value(text: &str, domain: &Domain) -> Result<Value, String> {
    let parsed = match domain {
        Domain::Bool => text.parse().ok().map(Value::Bool),
        Domain::Int { .. } => text.parse().ok().map(Value::Int),
        Domain::Float { .. } => text.parse().ok().filter(|v: &f64| v.is_finite()).map(Value::Float),
        Domain::Choice(_) => Some(Value::Text(text.into())),
    };
    within(parsed.ok_or_else(|| format!("is not {domain}"))?, domain)
}

/// Evaluates a parameter of an included graph. Also returns the parameters of the root graph that its value depends on.
///
/// `setting` is the value in the included file's presets. `given_here`, the value in the includer's `set` with its
/// scope and place, overrides it.
pub(super) fn included(
    declared: &Declared,
    setting: Option<&Setting>,
    given_here: Option<(&Number, &Names, Place)>,
    names: &Names,
    files: &SourceMap,
) -> Result<(Param, ParamSet), Diagnostic> {
    let Made { mut param, mut params, .. } = one(declared, setting, None, names, 0, files)?;
    if let Some((number, outer, at)) = given_here {
        param.value = given(number, &param.domain, outer, &at)?;
        (_, params, _) = reason(number, &param.domain, outer);
        param.reason = None;
    }
    Ok((param, params))
}

/// Generates `live.glsl` for a graph. It has the block of live parameters with the members in `params`, or only a
/// comment if none is live. Members of other graphs are left out: their names could clash with names in the graph's
/// shaders.
pub(super) fn live_glsl(params: &[Param]) -> String {
    let member = |param: &Param| {
        let ParamBinding::Live { offset } = param.binding else { return None };
        let (kind, name) = (param.domain.glsl(), &param.name);
        Some((offset, format!("    layout(offset = {offset}) {kind} {name};\n")))
    };
    // GLSL requires ascending offsets.
    let members: BTreeMap<u32, String> = params.iter().filter_map(member).collect();
    if members.is_empty() {
        return "// This graph has no live parameters.\n".into();
    }
    let members: String = members.into_values().collect();
    format!(
        "// Generated: the live parameters.\n#ifndef LIVE_GLSL\n#define LIVE_GLSL\n\
         layout(set = 0, binding = {LIVE_BINDING}, std140) uniform {LIVE_BLOCK} {{\n{members}}};\n#endif\n",
    )
}
