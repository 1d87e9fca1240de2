//! Small expressions that a graph may contain in place of numbers: `"ceil_div(n, 4096)"`, `"blend == 'over'"`.
//!
//! An [`Expr`] is parsed once, when the graph is read, and evaluated for every plan against a [`Scope`] that
//! knows the parameters, the facts and the `let`s. There are four types, those of [`Value`]: 64-bit integers,
//! floats, bools and texts. The only implicit conversion is from an integer to a float, beside a
//! float.
//!
//! Nothing wraps around, nothing is rounded silently and nothing becomes infinite. A size that overflows is a
//! mistake in the graph, so every such case is an [`ExprError`] that carries the place of the operand or
//! operation at fault.
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
//! 12  0x1f  1_000  1.5  1e-3  'text'  true  false  name  scene.count  (expr)
//! ceil_div(a, b)  min(a, ...)  max(a, ...)  clamp(x, low, high)  abs(x)  log2_ceil(n)  float(x)  int(x)
//! ```

mod eval;
mod parse;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::ops::Range;

use crate::ir::Value;

/// Holds a parsed expression.
#[derive(Clone, Debug, PartialEq)]
pub struct Expr {
    root: Node,
}

/// Describes a mistake in an expression, and its place: a range of bytes in the text.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ExprError {
    /// The message: one sentence without a full stop.
    pub message: String,
    /// Offset of the first byte.
    pub start: usize,
    /// Offset after the last byte.
    pub end: usize,
    /// A suggestion, if there is one.
    pub help: Option<String>,
}

impl ExprError {
    fn new(message: impl Into<String>, place: Range<usize>) -> Self {
        ExprError { message: message.into(), start: place.start, end: place.end, help: None }
    }

    fn with_help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }
}

/// Provides the values of an expression's names.
pub trait Scope {
    /// Returns the value of a name.
    fn get(&self, name: &str) -> Option<Value>;

    /// Lists every name, to suggest the nearest one for an unknown name.
    fn names(&self) -> Vec<String>;
}

impl Scope for BTreeMap<String, Value> {
    fn get(&self, name: &str) -> Option<Value> {
        BTreeMap::get(self, name).cloned()
    }

    fn names(&self) -> Vec<String> {
        self.keys().cloned().collect()
    }
}

impl Expr {
    /// Parses an expression. Fails on syntax errors, integers beyond 64 bits, unknown functions, wrong numbers
    /// of arguments, and expressions nested more than 128 levels deep (such as a sum
    /// of 129 terms).
    pub fn parse(text: &str) -> Result<Expr, ExprError> {
        Ok(Expr { root: parse::parse(text)? })
    }

    /// Lists every use of a name from the scope, in the order of the text, with its place. Functions are not
    /// included.
    pub fn names(&self) -> impl Iterator<Item = (&str, Range<usize>)> {
        let mut names = Vec::new();
        self.root.collect_names(&mut names);
        names.into_iter()
    }

    /// Evaluates the expression in `scope`.
    ///
    /// Fails, pointing at the operand or the operation, on unknown names, wrong types, overflow, division by
    /// zero, shifts by less than 0 or more than 63, and results that are not finite. `&&`, `||` and `?:`
    /// short-circuit, as in C.
    pub fn eval(&self, scope: &dyn Scope) -> Result<Value, ExprError> {
        eval::eval(&self.root, scope)
    }
}

/// A node of the tree, with its place in the text (without enclosing parentheses).
#[derive(Clone, Debug, PartialEq)]
struct Node {
    kind: NodeKind,
    start: usize,
    end: usize,
}

#[derive(Clone, Debug, PartialEq)]
enum NodeKind {
    Literal(Value),
    Name(String),
    Unary(UnaryOp, Box<Node>),
    Binary(BinaryOp, Box<[Node; 2]>),
    /// Condition, value if true, value if false.
    Conditional(Box<[Node; 3]>),
    Call(Function, Vec<Node>),
}

impl Node {
    fn place(&self) -> Range<usize> {
        self.start..self.end
    }

    fn collect_names<'a>(&'a self, names: &mut Vec<(&'a str, Range<usize>)>) {
        match &self.kind {
            NodeKind::Literal(_) => {}
            NodeKind::Name(name) => names.push((name, self.place())),
            NodeKind::Unary(_, operand) => operand.collect_names(names),
            NodeKind::Binary(_, operands) => operands.iter().for_each(|n| n.collect_names(names)),
            NodeKind::Conditional(parts) => parts.iter().for_each(|n| n.collect_names(names)),
            NodeKind::Call(_, arguments) => arguments.iter().for_each(|n| n.collect_names(names)),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum UnaryOp {
    Negate,
    Not,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BinaryOp {
    Or,
    And,
    Equal,
    NotEqual,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    ShiftLeft,
    ShiftRight,
    Add,
    Subtract,
    Multiply,
    Divide,
    Remainder,
}

impl BinaryOp {
    /// Text and precedence (higher binds tighter). All operators are left-associative.
    const TABLE: [(BinaryOp, &str, u8); 15] = [
        (BinaryOp::Or, "||", 1),
        (BinaryOp::And, "&&", 2),
        (BinaryOp::Equal, "==", 3),
        (BinaryOp::NotEqual, "!=", 3),
        (BinaryOp::Less, "<", 4),
        (BinaryOp::LessEqual, "<=", 4),
        (BinaryOp::Greater, ">", 4),
        (BinaryOp::GreaterEqual, ">=", 4),
        (BinaryOp::ShiftLeft, "<<", 5),
        (BinaryOp::ShiftRight, ">>", 5),
        (BinaryOp::Add, "+", 6),
        (BinaryOp::Subtract, "-", 6),
        (BinaryOp::Multiply, "*", 7),
        (BinaryOp::Divide, "/", 7),
        (BinaryOp::Remainder, "%", 7),
    ];

    fn symbol(self) -> &'static str {
        // The table must be in the order of the variants; a test checks this.
        Self::TABLE[self as usize].1
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Function {
    CeilDiv,
    Min,
    Max,
    Clamp,
    Abs,
    Log2Ceil,
    Float,
    Int,
}

impl Function {
    /// Name, minimum and maximum number of arguments.
    const TABLE: [(Function, &str, usize, usize); 8] = [
        (Function::CeilDiv, "ceil_div", 2, 2),
        (Function::Min, "min", 1, usize::MAX),
        (Function::Max, "max", 1, usize::MAX),
        (Function::Clamp, "clamp", 3, 3),
        (Function::Abs, "abs", 1, 1),
        (Function::Log2Ceil, "log2_ceil", 1, 1),
        (Function::Float, "float", 1, 1),
        (Function::Int, "int", 1, 1),
    ];

    fn name(self) -> &'static str {
        Self::TABLE[self as usize].1
    }

    fn named(name: &str) -> Option<Function> {
        Self::TABLE.iter().find(|f| f.1 == name).map(|f| f.0)
    }
}
