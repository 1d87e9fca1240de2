//! Effects: which passes of a plan depend on each parameter.

use std::collections::BTreeSet;

use super::PassId;

/// A set of indices into the list of a graph's parameters.
pub type ParamSet = BTreeSet<usize>;

/// Says which part of a plan depends on a parameter.
///
/// A part depends on a parameter if it used the parameter's value, directly or through other parameters, `let`s and
/// parameters of included graphs: evaluating an expression read the value, the compiled text of a shader depends on it as a
/// define, or a compiled shader reads it as a live parameter. Expressions that were not evaluated (a branch of `?:`, a
/// short-circuited operand) and code that was not compiled (a branch of an `#if`, a pass whose `when` is false) do not count.
///
/// Without an effect, every value of the parameter with which the graph builds gives the same passes, shaders, memory and
/// barriers, and shaders read the same bytes, as long as the other parameters stay unchanged. A condition that reads the
/// parameter is an effect, even if it gives the same result for all values.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Effect {
    /// The passes that depend on it, in the plan's order.
    pub passes: Vec<PassId>,
    /// True if a condition, the count of a repeat or a swap depends on it: the value decides which passes exist.
    pub shape: bool,
    /// Without an effect, the reason: a phrase such as `nothing in this plan depends on it`.
    pub none: Option<String>,
}
