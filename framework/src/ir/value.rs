//! Defines the values of parameters, facts and expressions.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The value of a parameter, a fact or an expression.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// `true` or `false`.
    Bool(bool),
    /// A signed integer of 64 bits.
    Int(i64),
    /// A double-precision float.
    Float(f64),
    /// A name or other text.
    Text(String),
}

impl Value {
    /// Converts an integer or a float to a float; `None` for other values.
    pub fn as_f64(&self) -> Option<f64> {
        match self {
            Value::Int(v) => Some(*v as f64),
            Value::Float(v) => Some(*v),
            Value::Bool(_) | Value::Text(_) => None,
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Value::Bool(v) => write!(f, "{v}"),
            Value::Int(v) => write!(f, "{v}"),
            Value::Float(v) => write!(f, "{v:?}"),
            Value::Text(v) => write!(f, "{v}"),
        }
    }
}

/// Rounds to a 32-bit float. Returns `None` for NaN, on overflow, and if a nonzero value underflows to 0.
pub fn to_f32(v: f64) -> Option<f32> {
    let rounded = v as f32;
    (rounded.is_finite() && (rounded != 0.0 || v == 0.0)).then_some(rounded)
}
