//! Evaluates expressions in a scope of names with values.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use super::lowered::Extent;
use crate::expr::{Expr, ExprError, ImpossibleText, Scope, name_unknown_in};
use crate::ir::{Domain, Facts, OUTPUTS, ParamSet, Reason, Span, Value};
use crate::schema::{self, Expression, Number, Reference};
use crate::source::{Diagnostic, Place};

pub(super) type Values = BTreeMap<String, Value>;

/// Names visible to the expressions of one graph: facts, constant parameters, `let`s and repeat variables. Every
/// evaluation records the parameters of the root graph that it read; [`Names::take_notes`] returns them.
#[derive(Clone, Debug, Default)]
pub(super) struct Names {
    pub values: Values,
    /// Live parameters, which have no value when the plan is built.
    pub live: BTreeSet<String>,
    /// `let`s with the same value in every plan.
    pub constants: BTreeSet<String>,
    /// The parameters of the root graph that each name depends on; names without any are absent.
    pub params: BTreeMap<String, ParamSet>,
    /// The possible values of names that are texts: parameters that are choices, facts, and `let`s of these.
    options: BTreeMap<String, Vec<String>>,
    notes: RefCell<Notes>,
}

/// Parameters that evaluations read.
#[derive(Clone, Debug, Default)]
pub(super) struct Notes {
    /// Read by numbers: sizes, push constants, offsets.
    pub read: ParamSet,
    /// Read by conditions, counts of repeats, and choices of resources and shaders.
    pub decided: ParamSet,
}

impl Notes {
    pub fn all(mut self) -> ParamSet {
        self.read.append(&mut self.decided);
        self.read
    }
}

impl Scope for Names {
    fn get(&self, name: &str) -> Option<Value> {
        if let Some(params) = self.params.get(name) {
            self.notes.borrow_mut().read.extend(params);
        }
        // A missing fact of this prefix is an output that was not requested.
        let unasked = || name.starts_with(OUTPUTS).then_some(Value::Bool(false));
        self.values.get(name).cloned().or_else(unasked)
    }

    fn has(&self, name: &str) -> bool {
        self.values.contains_key(name) || name.starts_with(OUTPUTS)
    }

    fn names(&self) -> Vec<String> {
        self.values.keys().cloned().collect()
    }
}

impl Names {
    pub fn of(facts: &Facts) -> Names {
        Names { values: facts.named(), options: facts.texts.clone(), ..Names::default() }
    }

    pub fn define(&mut self, name: &str, value: Value, params: ParamSet) {
        self.values.insert(name.into(), value);
        if !params.is_empty() {
            self.params.insert(name.into(), params);
        }
    }

    /// Defines a constant parameter. Comparisons with texts outside its domain become errors.
    pub fn define_param(&mut self, name: &str, value: Value, params: ParamSet, domain: &Domain) {
        if let Domain::Choice(of) = domain {
            self.options.insert(name.into(), of.clone());
        }
        self.define(name, value, params);
    }

    /// Defines a `let`. If its expression can only be some texts, comparisons with other texts become errors. A literal
    /// text is exempt: an edit may change it.
    pub fn define_let(&mut self, name: &str, number: &Number, value: Value, params: ParamSet) {
        if let Number::Expression(Expression { parsed: Ok(expr), .. }) = number
            && expr.names().next().is_some()
            && let Some(texts) = expr.texts(&self.options)
        {
            self.options.insert(name.into(), texts);
        }
        self.define(name, value, params);
    }

    /// Returns true if a name has a value or is a live parameter.
    pub fn contains(&self, name: &str) -> bool {
        self.values.contains_key(name) || self.live.contains(name)
    }

    /// Removes a value or a live parameter.
    pub fn forget(&mut self, name: &str) {
        self.values.remove(name);
        self.live.remove(name);
        self.params.remove(name);
        self.options.remove(name);
    }

    /// Defines a constant parameter in place of another value or a live parameter.
    pub fn shadow(&mut self, name: &str, value: Value, params: ParamSet, domain: &Domain) {
        self.forget(name);
        self.define_param(name, value, params, domain);
    }

    /// Copies a parameter from the includer's names: its value or, if it is live, its name.
    pub fn adopt(&mut self, name: &str, from: &Names) {
        if let Some(value) = from.values.get(name) {
            self.define(name, value.clone(), from.params.get(name).cloned().unwrap_or_default());
            self.options.extend(from.options.get(name).map(|of| (name.to_owned(), of.clone())));
        }
        if from.live.contains(name) {
            self.live.insert(name.into());
            self.params.extend(from.params.get(name).map(|params| (name.to_owned(), params.clone())));
        }
    }

    /// Refuses a name that is in use or not an identifier. `what` describes the named thing, and `taken` says that the
    /// name is in use.
    pub fn check_new(&self, name: &str, what: &str, taken: &str, span: Span) -> Result<(), Diagnostic> {
        if self.contains(name) {
            return Err(Diagnostic::new(format!("`{name}` is declared twice"), span, taken));
        }
        check_identifier(name, what, span)
    }

    /// Returns the parameters recorded since the last call, and clears the record.
    pub fn take_notes(&self) -> Notes {
        self.notes.take()
    }

    /// Evaluates without recording, and returns the result and the parameters read.
    pub fn traced<T>(&self, evaluate: impl FnOnce() -> T) -> (T, ParamSet) {
        let outer = self.notes.take();
        let result = evaluate();
        (result, self.notes.replace(outer).all())
    }

    /// Evaluates a condition, a count or a name, and records the parameters read as [`Notes::decided`].
    pub fn deciding<T>(&self, evaluate: impl FnOnce() -> T) -> T {
        let (result, read) = self.traced(evaluate);
        self.note_decided(&read);
        result
    }

    pub fn note_decided(&self, params: &ParamSet) {
        self.notes.borrow_mut().decided.extend(params);
    }

    /// Returns the parameters that any name in a number depends on, even if its evaluation does not read the name.
    pub fn named_by(&self, number: &Number) -> ParamSet {
        number.expression().map(|expression| self.named(expression)).unwrap_or_default()
    }

    /// Returns the parameters that a reference depends on: by the names in its choice, or by the constant it names.
    pub fn named_by_choice(&self, reference: &Reference) -> ParamSet {
        match &reference.choice {
            Some(choice) => self.named(choice),
            None => self.params.get(&reference.text).cloned().unwrap_or_default(),
        }
    }

    pub fn named(&self, expression: &Expression) -> ParamSet {
        let names = expression.parsed.iter().flat_map(|expr| expr.names());
        names.filter_map(|(name, _)| self.params.get(name)).flatten().copied().collect()
    }

    /// Returns true if a number uses no parameter, no fact, and no variable of a repeat. It then has the same value in
    /// every plan.
    pub fn is_constant(&self, number: &Number) -> bool {
        let is_constant = |expr: &Expr| expr.names().all(|(name, _)| self.constants.contains(name));
        number.expression().is_none_or(|expression| expression.parsed.as_ref().is_ok_and(is_constant))
    }

    pub fn evaluate(&self, number: &Number, place: &Place) -> Result<Value, Diagnostic> {
        match number {
            Number::Literal(value) => Ok(value.clone()),
            Number::Expression(expression) => self.expression(expression, place),
        }
    }

    pub fn expression(&self, expression: &Expression, place: &Place) -> Result<Value, Diagnostic> {
        let expr = self.check(expression, place)?;
        expr.eval(self).map_err(|error| self.error(&error, place))
    }

    /// Checks the syntax of an expression, its names, and the texts with which it compares them. Also checks operands
    /// that an evaluation would skip. Does not evaluate the expression.
    pub fn check<'e>(&self, expression: &'e Expression, place: &Place) -> Result<&'e Expr, Diagnostic> {
        let expr = expression.parsed.as_ref().map_err(|error| self.error(error, place))?;
        if let Some((name, range)) = expr.names().find(|(name, _)| self.live.contains(*name)) {
            let message = format!("`{name}` is a live parameter");
            let span = place.within_string(range);
            return Err(Diagnostic::new(message, span, "has no value when the plan is built")
                .with_help("declare it `Const` if sizes, conditions or repeats depend on it"));
        }
        if let Some(error) = expr.unknown_name(self) {
            return Err(self.error(&error, place));
        }
        if let Some(ImpossibleText { operand, text, place: range, expected }) =
            expr.impossible_text(&self.options)
        {
            let options =
                expected.iter().map(|option| format!("`{option}`")).collect::<Vec<_>>().join(" or ");
            let message = format!("`{}` has no value `{text}`", &expression.text[operand]);
            let label = format!("expected {options}, found `{text}`");
            let error = Diagnostic::new(message, place.within_string(range), label);
            return Err(error.with_nearest(text, expected.iter().map(String::as_str), ""));
        }
        Ok(expr)
    }

    /// Like [`Self::check`], for a number that may be an expression.
    pub fn check_number(&self, number: &Number, place: &Place) -> Result<(), Diagnostic> {
        number.expression().map_or(Ok(()), |expression| self.check(expression, place).map(drop))
    }

    fn error(&self, error: &ExprError, place: &Place) -> Diagnostic {
        let span = place.within_string(error.start..error.end);
        let unknown = name_unknown_in(&error.message);
        let option = self.options.values().flatten().find(|option| Some(option.as_str()) == unknown);
        let option = option.map(|option| format!("texts are in single quotes: `'{option}'`"));
        let diagnostic = Diagnostic::new("this expression has no value", span, error.message.as_str());
        match option.or_else(|| error.help.clone()) {
            Some(help) => diagnostic.with_help(help),
            None => diagnostic,
        }
    }

    /// Returns the names that an expression's evaluation read, with their values. `None` if the expression has no value
    /// or reads no names, and for a literal.
    pub fn reason(&self, number: &Number) -> Option<Reason> {
        let expression = number.expression()?;
        let reached = Reached { names: self, values: RefCell::default() };
        expression.parsed.as_ref().ok()?.eval(&reached).ok()?;
        let values = reached.values.into_inner();
        (!values.is_empty()).then(|| Reason { expression: expression.line(), values })
    }

    pub fn integer(&self, number: &Number, place: &Place) -> Result<i64, Diagnostic> {
        match self.evaluate(number, place)? {
            Value::Int(v) => Ok(v),
            other => Err(place.error("an integer is needed here", format!("this is {}", describe(&other)))),
        }
    }

    pub fn natural(&self, number: &Number, place: &Place) -> Result<u64, Diagnostic> {
        let v = self.integer(number, place)?;
        u64::try_from(v).map_err(|_| place.error("this cannot be negative", format!("is {v}")))
    }

    pub fn extent(&self, extent: &schema::Extent, place: &Place) -> Result<Extent, Diagnostic> {
        let mut size = [1; 3];
        for (axis, number) in extent.0.iter().enumerate() {
            size[axis] = self.natural(number, &place.index(axis))?;
        }
        Ok(Extent { size, dimensions: extent.0.len() })
    }

    pub fn positive(&self, number: &Number, place: &Place) -> Result<u64, Diagnostic> {
        match self.natural(number, place)? {
            0 => Err(place.error("this must be at least 1", "is 0")),
            v => Ok(v),
        }
    }

    pub fn truth(&self, number: &Number, place: &Place) -> Result<bool, Diagnostic> {
        match self.evaluate(number, place)? {
            Value::Bool(v) => Ok(v),
            other => Err(place
                .error("a condition is needed here", format!("this is {}", describe(&other)))
                .with_help("compare it with something, for instance `x != 0`")),
        }
    }
}

/// A scope that records the names which an evaluation reads.
struct Reached<'a> {
    names: &'a Names,
    values: RefCell<Values>,
}

impl Scope for Reached<'_> {
    fn get(&self, name: &str) -> Option<Value> {
        let value = self.names.get(name)?;
        self.values.borrow_mut().insert(name.to_string(), value.clone());
        Some(value)
    }

    fn names(&self) -> Vec<String> {
        self.names.names()
    }
}

pub(super) fn is_identifier(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// Refuses a name that is not an identifier, or that expressions read as a literal. `what` describes the named thing.
pub(super) fn check_identifier(name: &str, what: &str, span: Span) -> Result<(), Diagnostic> {
    let rule = match name {
        "true" | "false" => "is a truth value in expressions",
        _ if is_identifier(name) => return Ok(()),
        _ => "use letters, digits and `_`, without a leading digit",
    };
    Err(Diagnostic::new(format!("`{name}` cannot name {what}"), span, rule))
}

pub(super) fn describe(value: &Value) -> String {
    match value {
        Value::Bool(v) => v.to_string(),
        Value::Int(v) => format!("the integer {v}"),
        Value::Float(v) => format!("the number {v:?}"),
        Value::Text(v) => format!("the string '{v}'"),
    }
}
