//! Defines the parameters of a graph: their values, how they reach the shaders, and their effects on the plan.

use std::collections::BTreeSet;

use super::{Origin, PassId, Reason, Value};

/// Binding number of the generated block of live parameters.
pub const LIVE_BINDING: u32 = 31;

/// Name of the generated block of live parameters.
pub const LIVE_BLOCK: &str = "Live";

/// A parameter of the graph, with its value.
#[derive(Clone, Debug, PartialEq)]
pub struct Param {
    /// Name in the graph.
    pub name: String,
    /// The value that the plan is built with.
    pub value: Value,
    /// Default value.
    pub default: Value,
    /// Reason for the value, if it comes from an expression in the default or in a preset.
    pub reason: Option<Reason>,
    /// The value at which the result is exact, if the graph names one.
    pub exact: Option<Value>,
    /// The statistic that the value grows with, if any: a frame whose statistic exceeds the value is incomplete.
    pub grows: Option<String>,
    /// The values that the parameter may take.
    pub domain: Domain,
    /// The way in which the value reaches the shaders.
    pub binding: ParamBinding,
    /// Position of the parameter's declaration.
    pub origin: Origin,
}

impl Param {
    /// Raises `value` to the parameter's minimum in `capacities`, but not above its range. Returns it unchanged if the
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
    /// `true` and `false`.
    Bool,
    /// Integers.
    Int {
        /// Minimum value.
        min: i64,
        /// Maximum value.
        max: i64,
    },
    /// Numbers.
    Float {
        /// Minimum value.
        min: f64,
        /// Maximum value.
        max: f64,
        /// The step of a slider.
        step: f64,
    },
    /// One of these names.
    Choice(Vec<String>),
}

/// The way in which a parameter's value reaches the shaders.
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

/// A set of parameters: indices into the graph's list.
pub type ParamSet = BTreeSet<usize>;

/// The parts of a plan that depend on a parameter.
///
/// A part depends on a parameter if it used the parameter's value, directly or through other parameters, `let`s and
/// parameters of included graphs: evaluating an expression read the value, the compiled text of a shader depends on it
/// as a define, or a compiled shader reads it as a live parameter. Expressions that were not evaluated (a branch of
/// `?:`, a short-circuited operand) and code that was not compiled (a branch of an `#if`, a pass whose `when` is false)
/// do not count.
///
/// Without an effect, every value of the parameter with which the graph builds gives the same passes, shaders, memory
/// and barriers, and shaders read the same bytes, as long as the other parameters stay unchanged. A condition that
/// reads the parameter is an effect, even if it gives the same result for all values.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Effect {
    /// The passes that depend on the parameter, in the plan's order.
    pub passes: Vec<PassId>,
    /// True if a condition, the count of a repeat or a swap depends on the parameter: the value decides which passes
    /// exist.
    pub shape: bool,
    /// The reason for no effect, a phrase such as `nothing in this plan depends on it`; `None` if there is an effect.
    pub none: Option<String>,
}
