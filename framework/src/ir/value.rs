//! Values, and the parameters' types.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::{Origin, Reason};

/// Holds the value of a parameter, a fact or an expression.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// `true` or `false`.
    Bool(bool),
    /// A signed integer of 64 bits.
    Int(i64),
    /// A double-precision float.
    Float(f64),
    /// A name or another text.
    Text(String),
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

/// Rounds a number to a 32-bit float. Returns `None` on overflow, and on underflow to zero.
pub fn to_f32(v: f64) -> Option<f32> {
    let rounded = v as f32;
    (rounded.is_finite() && (rounded != 0.0 || v == 0.0)).then_some(rounded)
}

/// Describes a parameter that the graph declares, with its value.
#[derive(Clone, Debug, PartialEq)]
pub struct Param {
    /// The name.
    pub name: String,
    /// The value that the plan is built with.
    pub value: Value,
    /// The default.
    pub default: Value,
    /// The reason for the value, if it is from an expression: of the default, or of a preset.
    pub reason: Option<Reason>,
    /// The value that costs no accuracy, if the graph names one.
    pub exact: Option<Value>,
    /// The statistic that the value grows with: a frame whose statistic exceeds the value is incomplete.
    pub grows: Option<String>,
    /// The values that it may take.
    pub domain: Domain,
    /// Way to the shaders.
    pub binding: ParamBinding,
    /// The declaration.
    pub origin: Origin,
}

impl Param {
    /// Raises the value of a growing parameter to the minimum in `capacities`, at most to the end of its range.
    pub fn with_room(&self, value: Value, capacities: &[(String, i64)]) -> Value {
        let least = capacities.iter().filter(|(name, _)| self.grows.is_some() && *name == self.name);
        match (value, &self.domain) {
            (Value::Int(value), Domain::Int { max, .. }) => {
                Value::Int(least.map(|(_, least)| *least.min(max)).fold(value, i64::max))
            }
            (value, _) => value,
        }
    }
}

/// Lists the values that a parameter may take. Ranges are inclusive.
#[derive(Clone, Debug, PartialEq)]
pub enum Domain {
    /// `true` and `false`.
    Bool,
    /// Integers.
    Int {
        /// The smallest.
        min: i64,
        /// The largest.
        max: i64,
    },
    /// Numbers.
    Float {
        /// The smallest.
        min: f64,
        /// The largest.
        max: f64,
        /// The step of a slider.
        step: f64,
    },
    /// Names.
    Choice(Vec<String>),
}

/// Says how a parameter reaches the shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParamBinding {
    /// A constant of the plan and a define of the shaders.
    Const,
    /// A member of the live uniform block. Every member has 4 bytes: a float, an int, or a uint for a bool or a choice.
    Live {
        /// Byte offset in the block.
        offset: u32,
    },
}
