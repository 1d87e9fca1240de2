//! Defines the parameters of a graph: their values, how they reach the shaders, and their effects on the plan.

use std::collections::BTreeSet;
use std::fmt;

use super::{Origin, PassId, Reason, Value};

/// Binding number, in set 0, of the generated uniform block of live parameters.
pub const LIVE_BINDING: u32 = 31;

/// GLSL name of the generated uniform block of live parameters.
pub const LIVE_BLOCK: &str = "Live";

/// A parameter of the graph, with its value.
#[derive(Clone, Debug, PartialEq)]
pub struct Param {
    /// Name in the graph. An exposed parameter of an included graph keeps its name.
    pub name: String,
    /// The value that the plan was built with.
    pub value: Value,
    /// The value if neither a preset nor the request sets one.
    pub default: Value,
    /// The expression in a default, a preset or an include's `set` that gave the value. `None` for an expression
    /// without names, a literal, a setting of the request, and a value raised to a capacity.
    pub reason: Option<Reason>,
    /// The value at which the result is exact, if the graph names one.
    pub exact: Option<Value>,
    /// The statistic that this capacity must cover, if any. A frame whose statistic exceeds the value is incomplete. Of
    /// several statistics ([`Stat::grows`](super::Stat::grows)), the first.
    pub grows: Option<String>,
    /// The values that the parameter may take.
    pub domain: Domain,
    /// The path by which the value reaches the shaders.
    pub binding: ParamBinding,
    /// Position of the parameter's declaration.
    pub origin: Origin,
}

impl Param {
    /// Raises `value` to the parameter's minimum in `capacities`, clamped to the end of its range. Unchanged if the
    /// parameter does not grow.
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

/// The values that a parameter may take. Ranges are inclusive.
#[derive(Clone, Debug, PartialEq)]
pub enum Domain {
    /// `true` or `false`.
    Bool,
    /// An integer from `min` to `max`.
    Int {
        /// Minimum value.
        min: i64,
        /// Maximum value.
        max: i64,
    },
    /// A finite number from `min` to `max`.
    Float {
        /// Minimum value.
        min: f64,
        /// Maximum value.
        max: f64,
        /// Increment of a slider for this parameter.
        step: f64,
    },
    /// One of these names.
    Choice(Vec<String>),
}

impl Domain {
    /// Returns the GLSL type of a live parameter with this domain. A bool is 0 or 1, a choice is the index of its name.
    pub(crate) fn glsl(&self) -> &'static str {
        match self {
            Domain::Float { .. } => "float",
            Domain::Int { .. } => "int",
            Domain::Bool | Domain::Choice(_) => "uint",
        }
    }
}

impl fmt::Display for Domain {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Domain::Bool => f.write_str("true or false"),
            Domain::Int { min, max } => write!(f, "an integer from {min} to {max}"),
            Domain::Float { min, max, .. } => write!(f, "a number from {min:?} to {max:?}"),
            Domain::Choice(of) => write!(f, "one of {}", of.join(", ")),
        }
    }
}

/// The path by which a parameter's value reaches the shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParamBinding {
    /// A constant of the plan and a define of the shaders.
    Const,
    /// A 4-byte member of the live uniform block: float, int, or uint (for a bool or a choice).
    Live {
        /// Byte offset in the block.
        offset: u32,
    },
}

/// A set of parameters, as indices into [`Plan::params`](crate::plan::Plan::params).
pub type ParamSet = BTreeSet<usize>;

/// The parts of a plan that depend on a parameter, directly or through other parameters, `let`s or included graphs.
///
/// A part depends on a parameter if an expression read the value, if the compiled text of a shader depends on its
/// define, or if a compiled shader reads it as a live parameter. Expressions that were not evaluated (an untaken branch
/// of `?:`, a short-circuited operand) do not count, and neither does code that was not compiled (an untaken branch of
/// an `#if`, a pass whose `when` is false).
///
/// If only a parameter without an effect changes, to any value with which the graph builds, then the passes, their
/// resources and the bytes that shaders read stay the same. A condition that reads the parameter counts as an effect,
/// even if it has the same result for all values.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Effect {
    /// The passes that depend on the parameter, in the plan's order.
    pub passes: Vec<PassId>,
    /// True if the value decides which passes exist. A condition or a repeat count depends on it, or the accesses of a
    /// culled pass do.
    pub shape: bool,
    /// Why the parameter has no effect, such as `nothing in this plan depends on it`; `None` if it has one.
    pub none: Option<String>,
}
