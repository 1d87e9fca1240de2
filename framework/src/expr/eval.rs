//! Evaluates expressions. Where C would overflow or be undefined, evaluation fails with the place in the text.

use std::collections::BTreeMap;

use super::tree::{BinaryOp, ExprError, Function, Node, NodeKind, Scope, UnaryOp};
use crate::ir::Value;
use crate::source::nearest;

pub(super) fn collect_constants(node: &Node, found: &mut Vec<Value>) {
    match eval(node, &BTreeMap::new()) {
        Ok(value) => found.push(value),
        Err(_) => node.operands().iter().for_each(|operand| collect_constants(operand, found)),
    }
}

pub(super) fn eval(node: &Node, scope: &dyn Scope) -> Result<Value, ExprError> {
    match &node.kind {
        NodeKind::Literal(value) => Ok(value.clone()),
        NodeKind::Name(name) => scope.get(name).ok_or_else(|| unknown(node, name, scope)),
        NodeKind::Unary(UnaryOp::Not, operand) => {
            let value = truth(operand, eval(operand, scope)?, "`!`")?;
            Ok(Value::Bool(!value))
        }
        NodeKind::Unary(UnaryOp::Negate, operand) => match number(operand, eval(operand, scope)?, "`-`")? {
            Number::Int(v) => integer(node, v.checked_neg()),
            Number::Float(v) => float(node, -v),
        },
        NodeKind::Conditional(parts) => {
            let [condition, yes, no] = &**parts;
            let holds = truth(condition, eval(condition, scope)?, "the condition before `?`")?;
            eval(if holds { yes } else { no }, scope)
        }
        NodeKind::Binary(op, operands) => binary(node, *op, operands, scope),
        NodeKind::Call(function, arguments) => {
            let values = arguments.iter().map(|a| eval(a, scope)).collect::<Result<Vec<_>, _>>()?;
            call(node, *function, arguments, values)
        }
    }
}

pub(super) fn first_unknown(node: &Node, scope: &dyn Scope) -> Option<ExprError> {
    match &node.kind {
        NodeKind::Name(name) if !scope.has(name) => Some(unknown(node, name, scope)),
        _ => node.operands().iter().find_map(|operand| first_unknown(operand, scope)),
    }
}

#[derive(Clone, Copy)]
enum Number {
    Int(i64),
    Float(f64),
}

impl Number {
    fn to_float(self) -> f64 {
        match self {
            Number::Int(v) => v as f64,
            Number::Float(v) => v,
        }
    }
}

fn binary(node: &Node, op: BinaryOp, operands: &[Node; 2], scope: &dyn Scope) -> Result<Value, ExprError> {
    let [left, right] = operands;
    let symbol = format!("`{}`", op.symbol());
    let a = eval(left, scope)?;
    if let BinaryOp::And | BinaryOp::Or = op {
        let a = truth(left, a, &symbol)?;
        // False decides `x && y`; true decides `x || y`.
        let decided = a == (op == BinaryOp::Or);
        return Ok(Value::Bool(if decided { a } else { truth(right, eval(right, scope)?, &symbol)? }));
    }
    let b = eval(right, scope)?;
    if let BinaryOp::Equal | BinaryOp::NotEqual = op {
        let equal = equal(right, &symbol, a, b)?;
        return Ok(Value::Bool(equal == (op == BinaryOp::Equal)));
    }
    if let BinaryOp::ShiftLeft | BinaryOp::ShiftRight = op {
        let a = whole(left, a, &symbol)?;
        let b = whole(right, b, &symbol)?;
        return shift(node, op, right, a, b);
    }
    let a = number(left, a, &symbol).map_err(|error| match &left.kind {
        NodeKind::Binary(first, _) if compares(*first) && compares(op) => {
            error.with_help("`a < b < c` is written `a < b && b < c`")
        }
        _ => error,
    })?;
    let b = number(right, b, &symbol)?;
    if compares(op) {
        let order = match (a, b) {
            (Number::Int(a), Number::Int(b)) => Some(a.cmp(&b)),
            _ => a.to_float().partial_cmp(&b.to_float()),
        };
        // Comparisons with NaN, which a scope may contain, are false, as in C.
        return Ok(Value::Bool(match op {
            BinaryOp::Less => order.is_some_and(|o| o.is_lt()),
            BinaryOp::LessEqual => order.is_some_and(|o| o.is_le()),
            BinaryOp::Greater => order.is_some_and(|o| o.is_gt()),
            _ => order.is_some_and(|o| o.is_ge()),
        }));
    }
    if let BinaryOp::Divide | BinaryOp::Remainder = op
        && b.to_float() == 0.0
    {
        return Err(division_by_zero(right));
    }
    match (a, b) {
        (Number::Int(a), Number::Int(b)) => integer(
            node,
            match op {
                BinaryOp::Add => a.checked_add(b),
                BinaryOp::Subtract => a.checked_sub(b),
                BinaryOp::Multiply => a.checked_mul(b),
                BinaryOp::Divide => a.checked_div(b),
                // In i64::MIN % -1 only the quotient overflows; the remainder is 0.
                _ => Some(a.wrapping_rem(b)),
            },
        ),
        _ => {
            let (a, b) = (a.to_float(), b.to_float());
            float(
                node,
                match op {
                    BinaryOp::Add => a + b,
                    BinaryOp::Subtract => a - b,
                    BinaryOp::Multiply => a * b,
                    BinaryOp::Divide => a / b,
                    _ => a % b,
                },
            )
        }
    }
}

/// Returns true for operators that need numbers and return a bool.
fn compares(op: BinaryOp) -> bool {
    matches!(op, BinaryOp::Less | BinaryOp::LessEqual | BinaryOp::Greater | BinaryOp::GreaterEqual)
}

fn equal(right: &Node, symbol: &str, a: Value, b: Value) -> Result<bool, ExprError> {
    Ok(match (a, b) {
        (Value::Bool(a), Value::Bool(b)) => a == b,
        (Value::Text(a), Value::Text(b)) => a == b,
        (Value::Int(a), Value::Int(b)) => a == b,
        (Value::Int(a), Value::Float(b)) => a as f64 == b,
        (Value::Float(a), Value::Int(b)) => a == b as f64,
        (Value::Float(a), Value::Float(b)) => a == b,
        (a, b) => {
            let message = format!("{symbol} compares {} with {}", type_name(&a), type_name(&b));
            return Err(ExprError::new(message, right.place()));
        }
    })
}

fn shift(node: &Node, op: BinaryOp, right: &Node, value: i64, by: i64) -> Result<Value, ExprError> {
    if !(0..64).contains(&by) {
        return Err(ExprError::new(format!("a shift by {by}: it must be from 0 to 63"), right.place()));
    }
    if op == BinaryOp::ShiftRight {
        return Ok(Value::Int(value >> by));
    }
    let shifted = value << by;
    // Shifting back detects lost bits and a changed sign.
    integer(node, (shifted >> by == value).then_some(shifted))
}

fn call(node: &Node, function: Function, arguments: &[Node], values: Vec<Value>) -> Result<Value, ExprError> {
    let who = format!("`{}`", function.name());
    let numbers = || {
        let pairs = arguments.iter().zip(values.iter().cloned());
        pairs.map(|(argument, value)| number(argument, value, &who)).collect::<Result<Vec<_>, _>>()
    };
    match function {
        Function::CeilDiv => {
            let a = whole(&arguments[0], values[0].clone(), &who)?;
            let b = whole(&arguments[1], values[1].clone(), &who)?;
            if b == 0 {
                return Err(division_by_zero(&arguments[1]));
            }
            // Division truncates towards zero, so only a positive inexact quotient must be rounded up.
            let round_up = a.wrapping_rem(b) != 0 && (a < 0) == (b < 0);
            integer(node, a.checked_div(b).map(|quotient| quotient + i64::from(round_up)))
        }
        Function::Min | Function::Max => {
            let numbers = numbers()?;
            let whole: Option<Vec<i64>> =
                numbers.iter().map(|n| if let Number::Int(v) = n { Some(*v) } else { None }).collect();
            let least = function == Function::Min;
            match whole {
                Some(whole) => {
                    integer(node, if least { whole.into_iter().min() } else { whole.into_iter().max() })
                }
                None => {
                    let pick = if least { f64::min } else { f64::max };
                    let first = if least { f64::INFINITY } else { f64::NEG_INFINITY };
                    float(node, numbers.into_iter().map(Number::to_float).fold(first, pick))
                }
            }
        }
        Function::Clamp => {
            let numbers = numbers()?;
            let empty = |low: &dyn std::fmt::Display, high: &dyn std::fmt::Display| {
                let place = arguments[1].start..arguments[2].end;
                ExprError::new(format!("the range of this `clamp` is empty: {low} is above {high}"), place)
            };
            match numbers[..] {
                [Number::Int(_), Number::Int(low), Number::Int(high)] if low > high => {
                    Err(empty(&low, &high))
                }
                [Number::Int(x), Number::Int(low), Number::Int(high)] => Ok(Value::Int(x.clamp(low, high))),
                _ => {
                    let [x, low, high] = [0, 1, 2].map(|i| numbers[i].to_float());
                    if low > high {
                        return Err(empty(&low, &high));
                    }
                    float(node, x.max(low).min(high))
                }
            }
        }
        Function::Abs => match numbers()?[0] {
            Number::Int(v) => integer(node, v.checked_abs()),
            Number::Float(v) => float(node, v.abs()),
        },
        Function::Log2Ceil => {
            let n = whole(&arguments[0], values[0].clone(), &who)?;
            if n < 1 {
                let message = format!("`log2_ceil` needs an integer from 1 on, not {n}");
                return Err(ExprError::new(message, arguments[0].place()));
            }
            // The bit length of n - 1 is the smallest k with 2^k >= n.
            Ok(Value::Int(i64::from(64 - (n - 1).leading_zeros())))
        }
        Function::Float => match values[0] {
            Value::Bool(v) => Ok(Value::Float(f64::from(u8::from(v)))),
            _ => float(node, numbers()?[0].to_float()),
        },
        Function::Int => match values[0] {
            Value::Bool(v) => Ok(Value::Int(i64::from(v))),
            _ => match numbers()?[0] {
                Number::Int(v) => Ok(Value::Int(v)),
                Number::Float(v) => {
                    // 2^63 is exact as a float; i64::MAX is not.
                    let limit = (1u64 << 63) as f64;
                    integer(node, (-limit..limit).contains(&v).then_some(v as i64))
                }
            },
        },
    }
}

fn integer(node: &Node, value: Option<i64>) -> Result<Value, ExprError> {
    value
        .map(Value::Int)
        .ok_or_else(|| ExprError::new("the result does not fit in a 64-bit integer", node.place()))
}

fn float(node: &Node, value: f64) -> Result<Value, ExprError> {
    if value.is_finite() {
        Ok(Value::Float(value))
    } else {
        Err(ExprError::new("the result is not a finite number", node.place()))
    }
}

fn division_by_zero(divisor: &Node) -> ExprError {
    ExprError::new("division by zero", divisor.place())
}

/// Converts a value to a number. In the error for another type, `who` names the operator or function.
fn number(node: &Node, value: Value, who: &str) -> Result<Number, ExprError> {
    match value {
        Value::Int(v) => Ok(Number::Int(v)),
        Value::Float(v) => Ok(Number::Float(v)),
        other => Err(wrong_type(node, &other, who, "a number")),
    }
}

fn whole(node: &Node, value: Value, who: &str) -> Result<i64, ExprError> {
    match value {
        Value::Int(v) => Ok(v),
        Value::Float(_) => {
            Err(wrong_type(node, &value, who, "an integer").with_help("`int(x)` truncates the fraction"))
        }
        other => Err(wrong_type(node, &other, who, "an integer")),
    }
}

fn truth(node: &Node, value: Value, who: &str) -> Result<bool, ExprError> {
    match value {
        Value::Bool(v) => Ok(v),
        Value::Int(_) | Value::Float(_) => {
            Err(wrong_type(node, &value, who, "a bool").with_help("compare it, for instance with `!= 0`"))
        }
        other => Err(wrong_type(node, &other, who, "a bool")),
    }
}

fn wrong_type(node: &Node, value: &Value, who: &str, wanted: &str) -> ExprError {
    ExprError::new(format!("{who} needs {wanted}, and this is {}", type_name(value)), node.place())
}

fn type_name(value: &Value) -> &'static str {
    match value {
        Value::Bool(_) => "a bool",
        Value::Int(_) => "an integer",
        Value::Float(_) => "a float",
        Value::Text(_) => "a string",
    }
}

/// Maximum number of names that an error lists if none is similar.
const MAX_LISTED_NAMES: usize = 32;

/// Returns the message for a name that is not in scope.
fn unknown_name(name: &str) -> String {
    format!("there is no value named `{name}`")
}

/// Returns the name that a message of [`unknown_name`] is about; `None` for another message.
pub(crate) fn name_unknown_in(message: &str) -> Option<&str> {
    message.strip_prefix("there is no value named `")?.strip_suffix('`')
}

fn unknown(node: &Node, name: &str, scope: &dyn Scope) -> ExprError {
    let error = ExprError::new(unknown_name(name), node.place());
    if Function::named(name).is_some() {
        return error.with_help(format!("`{name}` is a function: write `{name}(...)`"));
    }
    let names = scope.names();
    if let Some(near) = nearest(name, names.iter().map(String::as_str).chain(["true", "false"])) {
        return error.with_help(format!("did you mean `{near}`?"));
    }
    if (1..=MAX_LISTED_NAMES).contains(&names.len()) {
        return error.with_help(format!("the names here are {}", names.join(", ")));
    }
    error
}
