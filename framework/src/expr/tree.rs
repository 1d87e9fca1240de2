//! Defines the tree of an expression, its errors, and the scope that it is evaluated in.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::ir::Value;

/// An error in an expression, with its place: a byte range of the text.
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
    pub(super) fn new(message: impl Into<String>, place: Range<usize>) -> Self {
        ExprError { message: message.into(), start: place.start, end: place.end, help: None }
    }

    pub(super) fn with_help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }
}

/// The names that an expression can use, with their values.
pub trait Scope {
    /// Returns the value of a name; `None` for an unknown name.
    fn get(&self, name: &str) -> Option<Value>;

    /// Returns true for a known name.
    fn has(&self, name: &str) -> bool {
        self.get(name).is_some()
    }

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

/// A comparison with a text that the other operand cannot be.
#[derive(Debug)]
pub(crate) struct ImpossibleText<'a> {
    /// Place of the other operand.
    pub operand: Range<usize>,
    pub text: &'a str,
    /// Place of the text, with its quotes.
    pub place: Range<usize>,
    /// The possible texts of the other operand.
    pub expected: Vec<String>,
}

/// A node of the tree, with its place in the text, without enclosing parentheses.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Node {
    pub kind: NodeKind,
    pub start: usize,
    pub end: usize,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum NodeKind {
    Literal(Value),
    Name(String),
    Unary(UnaryOp, Box<Node>),
    Binary(BinaryOp, Box<[Node; 2]>),
    /// Condition, value if true, value if false.
    Conditional(Box<[Node; 3]>),
    Call(Function, Vec<Node>),
}

impl Node {
    pub fn place(&self) -> Range<usize> {
        self.start..self.end
    }

    pub fn operands(&self) -> &[Node] {
        match &self.kind {
            NodeKind::Literal(_) | NodeKind::Name(_) => &[],
            NodeKind::Unary(_, operand) => std::slice::from_ref(operand),
            NodeKind::Binary(_, operands) => &operands[..],
            NodeKind::Conditional(parts) => &parts[..],
            NodeKind::Call(_, arguments) => arguments,
        }
    }

    /// Converts the dividends to floats, so that integers divide as floats.
    pub fn divide_as_floats(&mut self) {
        match &mut self.kind {
            NodeKind::Literal(_) | NodeKind::Name(_) => {}
            NodeKind::Unary(_, operand) => operand.divide_as_floats(),
            NodeKind::Binary(op, operands) => {
                operands.iter_mut().for_each(Node::divide_as_floats);
                if *op == BinaryOp::Divide {
                    let left = operands[0].clone();
                    operands[0].kind = NodeKind::Call(Function::Float, vec![left]);
                }
            }
            NodeKind::Conditional(parts) => parts.iter_mut().for_each(Node::divide_as_floats),
            NodeKind::Call(_, arguments) => arguments.iter_mut().for_each(Node::divide_as_floats),
        }
    }

    /// Finds a comparison with a text that the other operand cannot be; see [`super::Expr::impossible_text`].
    pub fn impossible_text(&self, texts: &BTreeMap<String, Vec<String>>) -> Option<ImpossibleText<'_>> {
        if let NodeKind::Binary(BinaryOp::Equal | BinaryOp::NotEqual, operands) = &self.kind {
            let [left, right] = &**operands;
            for (operand, literal) in [(left, right), (right, left)] {
                if let NodeKind::Literal(Value::Text(text)) = &literal.kind
                    && !matches!(operand.kind, NodeKind::Literal(_))
                    && let Some(expected) = operand.texts(texts).filter(|all| !all.contains(text))
                {
                    let (operand, place) = (operand.place(), literal.place());
                    return Some(ImpossibleText { operand, text, place, expected });
                }
            }
        }
        self.operands().iter().find_map(|operand| operand.impossible_text(texts))
    }

    /// Lists the possible texts of the node; see [`super::Expr::texts`].
    pub fn texts(&self, texts: &BTreeMap<String, Vec<String>>) -> Option<Vec<String>> {
        match &self.kind {
            NodeKind::Literal(Value::Text(text)) => Some(vec![text.clone()]),
            NodeKind::Name(name) => texts.get(name).cloned(),
            NodeKind::Conditional(parts) => {
                let [_, yes, no] = &**parts;
                let mut all = yes.texts(texts)?;
                let others = no.texts(texts)?;
                all.extend(others.into_iter().filter(|text| !all.contains(text)).collect::<Vec<_>>());
                Some(all)
            }
            _ => None,
        }
    }

    pub fn collect_names<'a>(&'a self, names: &mut Vec<(&'a str, Range<usize>)>) {
        if let NodeKind::Name(name) = &self.kind {
            names.push((name, self.place()));
        }
        self.operands().iter().for_each(|n| n.collect_names(names));
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum UnaryOp {
    Negate,
    Not,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BinaryOp {
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
    pub const TABLE: [(BinaryOp, &str, u8); 15] = [
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

    pub fn symbol(self) -> &'static str {
        // The table must be in the order of the variants; a test checks this.
        Self::TABLE[self as usize].1
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Function {
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
    pub const TABLE: [(Function, &str, usize, usize); 8] = [
        (Function::CeilDiv, "ceil_div", 2, 2),
        (Function::Min, "min", 1, usize::MAX),
        (Function::Max, "max", 1, usize::MAX),
        (Function::Clamp, "clamp", 3, 3),
        (Function::Abs, "abs", 1, 1),
        (Function::Log2Ceil, "log2_ceil", 1, 1),
        (Function::Float, "float", 1, 1),
        (Function::Int, "int", 1, 1),
    ];

    pub fn name(self) -> &'static str {
        Self::TABLE[self as usize].1
    }

    pub fn named(name: &str) -> Option<Function> {
        Self::TABLE.iter().find(|f| f.1 == name).map(|f| f.0)
    }
}
