//! Expressions that a graph may contain in place of numbers: `"ceil_div(n, 4096)"`, `"blend == 'over'"`.
//!
//! An [`Expr`] is parsed once, when the graph is read, and evaluated for each plan against a [`Scope`] of parameters,
//! facts and `let`s. There are four types, the variants of [`Value`]: 64-bit integers, floats, bools and texts. The
//! only implicit conversion is from integer to float, if another operand or argument is a float.
//!
//! Nothing wraps or becomes infinite. A size that overflows is a mistake in the graph, so every such case is an
//! [`ExprError`] with the place of the operand or operation.
//!
//! ```text
//! condition ? a : b          right to left            lowest precedence
//! ||
//! &&
//! ==  !=
//! <  <=  >  >=
//! <<  >>                     on integers, by 0 to 63
//! +  -
//! *  /  %                    on integers / truncates, as in C
//! -x  !x
//! 12  0x1f  0b101  1_000  1.5  1e-3  'text'  true  false  name  scene.count  (expr)
//! ceil_div(a, b)  min(a, ...)  max(a, ...)  clamp(x, low, high)  abs(x)  log2_ceil(n)  float(x)  int(x)
//! ```

mod eval;
mod parse;
#[cfg(test)]
mod tests;
mod tree;

use std::collections::BTreeMap;
use std::ops::Range;

use crate::ir::Value;
pub(crate) use eval::name_unknown_in;
pub(crate) use tree::ImpossibleText;
pub use tree::{ExprError, Scope};

/// A parsed expression.
#[derive(Clone, Debug, PartialEq)]
pub struct Expr {
    root: tree::Node,
}

impl Expr {
    /// Parses an expression.
    ///
    /// Fails on syntax errors, integers outside the range of `i64`, floats that overflow, unknown functions, wrong
    /// numbers of arguments, and nesting deeper than 128 levels (such as a sum of 129 terms).
    pub fn parse(text: &str) -> Result<Expr, ExprError> {
        Ok(Expr { root: parse::parse(text)? })
    }

    /// Changes `/` to divide integers as floats: `1 / 2` is 0.5 instead of 0. Graphs compute counts, so they truncate.
    #[must_use]
    pub fn dividing_as_floats(mut self) -> Expr {
        self.root.divide_as_floats();
        self
    }

    /// Lists every use of a name from the scope, in text order, with its place. Functions are not included.
    pub fn names(&self) -> impl Iterator<Item = (&str, Range<usize>)> {
        let mut names = Vec::new();
        self.root.collect_names(&mut names);
        names.into_iter()
    }

    /// Returns the error for the first name that the scope lacks, also in an operand that [`Expr::eval`] would skip.
    pub(crate) fn unknown_name(&self, scope: &dyn Scope) -> Option<ExprError> {
        eval::first_unknown(&self.root, scope)
    }

    /// Finds a comparison with a literal text that the other operand cannot be, such as `mode == 'fsat'`. `texts` has
    /// the possible texts of names.
    pub(crate) fn impossible_text(
        &self,
        texts: &BTreeMap<String, Vec<String>>,
    ) -> Option<ImpossibleText<'_>> {
        self.root.impossible_text(texts)
    }

    /// Lists the possible texts of the expression, from those of names; `None` if it can be something else.
    pub(crate) fn texts(&self, texts: &BTreeMap<String, Vec<String>>) -> Option<Vec<String>> {
        self.root.texts(texts)
    }

    /// Lists the values of the largest subexpressions that need no name. They are 49152 and 2 for `48 << 10 < 2 * n`.
    pub fn constants(&self) -> Vec<Value> {
        let mut found = Vec::new();
        eval::collect_constants(&self.root, &mut found);
        found
    }

    /// Evaluates the expression in `scope`.
    ///
    /// Fails, pointing at the operand or the operation, on unknown names, wrong types, overflow, division by zero,
    /// shifts by less than 0 or more than 63, `clamp` with an empty range, `log2_ceil` of less than 1, and results that
    /// are not finite. `&&`, `||` and `?:` short-circuit, as in C.
    pub fn eval(&self, scope: &dyn Scope) -> Result<Value, ExprError> {
        eval::eval(&self.root, scope)
    }
}
