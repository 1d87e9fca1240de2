//! Effects: what each parameter of a graph does in a plan.

use std::collections::BTreeSet;

use super::PassId;

/// Holds positions in the list of a graph's parameters.
pub type ParamSet = BTreeSet<usize>;

/// Says which part of a plan depends on a parameter.
///
/// A part depends on a parameter if the parameter's value entered it, directly or through other parameters, `let`s and
/// parameters of included graphs: the value was read when an expression was evaluated, is a define that the compiled text of a
/// shader depends on, or is a member of the live block that a compiled shader reads. What was not evaluated (a branch of `?:`,
/// an operand after one that decides) or not compiled (a branch of an `#if`, a pass whose `when` is false) does not count.
///
/// So without an effect means: with the other parameters as they are, every other value of this one that the graph can be built
/// with gives the same passes, shaders, memory and barriers, and the same bytes to all that shaders read. Conditions that read
/// the parameter are an effect even where both values would give the same.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Effect {
    /// The passes that depend on it, in the plan's order.
    pub passes: Vec<PassId>,
    /// A condition, the count of a repeat or a swap depends on it: the value decides which passes there are.
    pub shape: bool,
    /// Without an effect, the reason: a phrase such as `nothing in this plan depends on it`.
    pub none: Option<String>,
}
