//! Parses by precedence climbing. Reads an operand, then every operator that binds at least as tightly as the minimum,
//! each with a right-hand side that binds more tightly.

use std::ops::Range;

use super::tree::{BinaryOp, ExprError, Function, Node, NodeKind, UnaryOp};
use crate::ir::Value;
use crate::source::nearest;

/// Maximum height of a tree, and maximum nesting of the text. Bounds the recursion of parsing, evaluating and dropping.
const MAX_DEPTH: usize = 128;

pub(super) fn parse(text: &str) -> Result<Node, ExprError> {
    let mut parser = Parser { text, at: 0, token: Token::End, start: 0, end: 0, last_end: 0, depth: 0 };
    parser.advance()?;
    if parser.token == Token::End {
        return Err(ExprError::new("the expression is empty", 0..text.len()));
    }
    let tree = parser.expression()?;
    match parser.token {
        Token::End => Ok(tree.node),
        Token::Symbol(")") => Err(parser.error_here("this `)` closes nothing")),
        _ => Err(parser.no_operator("an operator")),
    }
}

#[derive(Clone, Debug, PartialEq)]
enum Token {
    /// Value of the digits. The parser handles the sign, because `i64::MIN` has no positive counterpart.
    Int(u64),
    Float(f64),
    Text(String),
    Name(String),
    Symbol(&'static str),
    End,
}

/// Operators and brackets, the longer ones first, so that `<<` is not read as two `<`.
const SYMBOLS: [&str; 21] = [
    "<<", ">>", "==", "!=", "<=", ">=", "&&", "||", "+", "-", "*", "/", "%", "<", ">", "!", "?", ":", "(",
    ")", ",",
];

/// A tree with its height (at most [`MAX_DEPTH`]) and its place, which includes enclosing parentheses. An error about
/// an operation on `(a + b)` underlines the parentheses; an error about the sum itself does not.
struct Tree {
    node: Node,
    height: usize,
    place: Range<usize>,
}

impl Tree {
    fn through(&self, other: &Tree) -> Range<usize> {
        self.place.start..other.place.end
    }
}

struct Parser<'a> {
    text: &'a str,
    /// Offset after `token`, where [`Parser::advance`] continues.
    at: usize,
    token: Token,
    start: usize,
    end: usize,
    last_end: usize,
    /// Nesting depth: open parentheses, arguments, choices, `-` and `!`.
    depth: usize,
}

impl Parser<'_> {
    /// Parses a whole expression: operators, or `condition ? a : b`.
    fn expression(&mut self) -> Result<Tree, ExprError> {
        self.enter()?;
        let condition = self.binary(1)?;
        let tree = if self.take("?")? {
            let yes = self.expression()?;
            if !self.take(":")? {
                let message = format!("expected `:` and the alternative, found {}", self.found());
                return Err(self.error_here(message).with_help("a choice is written `condition ? a : b`"));
            }
            let no = self.expression()?;
            let place = condition.through(&no);
            let height = condition.height.max(yes.height).max(no.height);
            let parts = Box::new([condition.node, yes.node, no.node]);
            self.tree(NodeKind::Conditional(parts), place, height)?
        } else {
            condition
        };
        self.depth -= 1;
        Ok(tree)
    }

    /// Parses operands joined by operators that bind at least as tightly as `min_binding`.
    fn binary(&mut self, min_binding: u8) -> Result<Tree, ExprError> {
        let mut left = self.operand()?;
        while let Token::Symbol(symbol) = self.token
            && let Some(&(op, _, binding)) = BinaryOp::TABLE.iter().find(|entry| entry.1 == symbol)
            && binding >= min_binding
        {
            self.advance()?;
            let right = self.binary(binding + 1)?;
            let place = left.through(&right);
            let height = left.height.max(right.height);
            left = self.tree(NodeKind::Binary(op, Box::new([left.node, right.node])), place, height)?;
        }
        Ok(left)
    }

    fn operand(&mut self) -> Result<Tree, ExprError> {
        let place = self.start..self.end;
        let tree = match self.token.clone() {
            Token::Symbol("-") => {
                self.advance()?;
                if let Token::Int(digits) = self.token {
                    // `-9223372036854775808` fits; its digits without the sign do not.
                    let place = place.start..self.end;
                    self.advance()?;
                    let value = 0i64.checked_sub_unsigned(digits).ok_or_else(|| too_large(place.clone()))?;
                    self.tree(NodeKind::Literal(Value::Int(value)), place, 0)?
                } else {
                    self.unary(UnaryOp::Negate, place.start)?
                }
            }
            Token::Symbol("!") => {
                self.advance()?;
                self.unary(UnaryOp::Not, place.start)?
            }
            Token::Symbol("(") => {
                self.advance()?;
                let inner = self.expression()?;
                self.close(place.clone())?;
                Tree { place: place.start..self.last_end, ..inner }
            }
            Token::Int(digits) => {
                self.advance()?;
                let value = i64::try_from(digits).map_err(|_| too_large(place.clone()))?;
                self.tree(NodeKind::Literal(Value::Int(value)), place, 0)?
            }
            Token::Float(value) => {
                self.advance()?;
                self.tree(NodeKind::Literal(Value::Float(value)), place, 0)?
            }
            Token::Text(value) => {
                self.advance()?;
                self.tree(NodeKind::Literal(Value::Text(value)), place, 0)?
            }
            Token::Name(name) => {
                self.advance()?;
                match name.as_str() {
                    "true" => self.tree(NodeKind::Literal(Value::Bool(true)), place, 0)?,
                    "false" => self.tree(NodeKind::Literal(Value::Bool(false)), place, 0)?,
                    _ if self.token == Token::Symbol("(") => self.call(&name, place)?,
                    _ => self.tree(NodeKind::Name(name), place, 0)?,
                }
            }
            Token::Symbol(_) | Token::End => {
                return Err(self.error_here(format!("expected a value, found {}", self.found())));
            }
        };
        Ok(tree)
    }

    fn unary(&mut self, op: UnaryOp, start: usize) -> Result<Tree, ExprError> {
        self.enter()?;
        let operand = self.operand()?;
        self.depth -= 1;
        let place = start..operand.place.end;
        self.tree(NodeKind::Unary(op, Box::new(operand.node)), place, operand.height)
    }

    /// Parses the arguments of a call; `name` is at `place`, the next token is its `(`.
    fn call(&mut self, name: &str, place: Range<usize>) -> Result<Tree, ExprError> {
        let Some(function) = Function::named(name) else {
            let names = || Function::TABLE.iter().map(|f| f.1);
            let help = match (help_for(name), nearest(name, names())) {
                (Some(help), _) => help.into(),
                (None, Some(near)) => format!("did you mean `{near}`?"),
                (None, None) => format!("the functions are {}", names().collect::<Vec<_>>().join(", ")),
            };
            return Err(ExprError::new(format!("there is no function `{name}`"), place).with_help(help));
        };
        let open = self.start..self.end;
        self.advance()?;
        let (mut arguments, mut height) = (Vec::new(), 0);
        if self.token != Token::Symbol(")") {
            loop {
                let argument = self.expression()?;
                height = height.max(argument.height);
                arguments.push(argument.node);
                if !self.take(",")? {
                    break;
                }
            }
        }
        self.close(open)?;
        let place = place.start..self.last_end;
        let (_, _, fewest, most) = Function::TABLE[function as usize];
        if !(fewest..=most).contains(&arguments.len()) {
            let wanted = match (fewest, most) {
                (1, 1) => "1 argument".to_string(),
                (1, usize::MAX) => "at least 1 argument".to_string(),
                _ => format!("{fewest} arguments"),
            };
            let message = format!("`{name}` takes {wanted}, not {}", arguments.len());
            return Err(ExprError::new(message, place));
        }
        self.tree(NodeKind::Call(function, arguments), place, height)
    }

    /// Consumes the `)` that matches the `(` at `open`.
    fn close(&mut self, open: Range<usize>) -> Result<(), ExprError> {
        if self.take(")")? {
            return Ok(());
        }
        if self.token == Token::End {
            return Err(ExprError::new("this `(` is not closed", open));
        }
        Err(self.no_operator("an operator or `)`"))
    }

    fn tree(&self, kind: NodeKind, place: Range<usize>, height_below: usize) -> Result<Tree, ExprError> {
        let height = height_below + 1;
        if height > MAX_DEPTH {
            return Err(too_deep(place));
        }
        Ok(Tree { node: Node { kind, start: place.start, end: place.end }, height, place })
    }

    fn enter(&mut self) -> Result<(), ExprError> {
        self.depth += 1;
        if self.depth > MAX_DEPTH { Err(too_deep(self.start..self.end)) } else { Ok(()) }
    }

    fn take(&mut self, symbol: &'static str) -> Result<bool, ExprError> {
        let there = self.token == Token::Symbol(symbol);
        if there {
            self.advance()?;
        }
        Ok(there)
    }

    fn error_here(&self, message: impl Into<String>) -> ExprError {
        ExprError::new(message, self.start..self.end)
    }

    /// Returns the error for a token that follows a whole operand. The token, or the operand, may be an operator of
    /// another language.
    fn no_operator(&self, expected: &str) -> ExprError {
        let error = self.error_here(format!("expected {expected}, found {}", self.found()));
        let before = self.text[..self.last_end].rsplit(|c| !continues_name(c)).next();
        match [Some(&self.text[self.start..self.end]), before].into_iter().flatten().find_map(help_for) {
            Some(help) => error.with_help(help),
            None => error,
        }
    }

    fn found(&self) -> String {
        match self.token {
            Token::End => "the end of the expression".to_string(),
            _ => format!("`{}`", &self.text[self.start..self.end]),
        }
    }

    /// Replaces `token` by the next token of the text.
    fn advance(&mut self) -> Result<(), ExprError> {
        self.last_end = self.end;
        let rest = self.text[self.at..].trim_start();
        self.start = self.text.len() - rest.len();
        let (token, length) = match rest.chars().next() {
            None => (Token::End, 0),
            Some(c) if c.is_ascii_digit() => self.number(rest)?,
            Some('.') if rest[1..].starts_with(|c: char| c.is_ascii_digit()) => self.number(rest)?,
            Some(c) if starts_name(c) => {
                let length = rest.find(|c| !continues_name(c) && c != '.').unwrap_or(rest.len());
                let name = &rest[..length];
                if name.split('.').any(|part| !part.starts_with(starts_name)) {
                    let place = self.start..self.start + length;
                    return Err(ExprError::new(format!("`{name}` is not a name"), place)
                        .with_help("names are written like `digits` or `scene.count`"));
                }
                (Token::Name(name.to_string()), length)
            }
            Some('\'') => match rest[1..].find('\'') {
                Some(length) => (Token::Text(rest[1..1 + length].to_string()), length + 2),
                None => {
                    let place = self.start..self.text.len();
                    return Err(ExprError::new("this string is not closed", place)
                        .with_help("a string is written in single quotes: `'over'`"));
                }
            },
            Some(c) => match SYMBOLS.iter().find(|symbol| rest.starts_with(**symbol)) {
                Some(symbol) => (Token::Symbol(symbol), symbol.len()),
                None => return Err(self.unexpected(c)),
            },
        };
        self.token = token;
        self.end = self.start + length;
        self.at = self.end;
        Ok(())
    }

    fn unexpected(&self, c: char) -> ExprError {
        let error = ExprError::new(
            format!("unexpected `{}`", c.escape_debug()),
            self.start..self.start + c.len_utf8(),
        );
        match help_for(c.encode_utf8(&mut [0; 4])) {
            Some(help) => error.with_help(help),
            None => error,
        }
    }

    /// Reads a number; `rest` starts with a digit, or with a point and a digit.
    fn number(&self, rest: &str) -> Result<(Token, usize), ExprError> {
        let bytes = rest.as_bytes();
        let hexadecimal = rest.starts_with("0x") || rest.starts_with("0X");
        // Adjacent letters belong to the number, so that `12ab` is one bad number and not two tokens.
        let mut length = 0;
        while let Some(&byte) = bytes.get(length) {
            let after_exponent = length > 0 && !hexadecimal && matches!(bytes[length - 1], b'e' | b'E');
            if !(byte.is_ascii_alphanumeric()
                || matches!(byte, b'_' | b'.')
                || after_exponent && matches!(byte, b'+' | b'-'))
            {
                break;
            }
            length += 1;
        }
        let written = &rest[..length];
        let place = self.start..self.start + length;
        let plain = written.replace('_', "");
        let (digits, radix) = match plain.get(..2) {
            Some("0x" | "0X") => (&plain[2..], 16),
            Some("0b" | "0B") => (&plain[2..], 2),
            _ => (plain.as_str(), 10),
        };
        if !digits.is_empty() && digits.chars().all(|c| c.is_digit(radix)) {
            return match u64::from_str_radix(digits, radix) {
                Ok(value) if value <= 1 << 63 => Ok((Token::Int(value), length)),
                _ => Err(too_large(place)),
            };
        }
        let is_float = radix == 10
            && plain.bytes().all(|b| b.is_ascii_digit() || matches!(b, b'.' | b'e' | b'E' | b'+' | b'-'))
            && !plain.ends_with('.');
        match plain.parse::<f64>() {
            Ok(value) if is_float && value.is_finite() => Ok((Token::Float(value), length)),
            Ok(_) if is_float => Err(ExprError::new("this float is too large", place)),
            _ => Err(ExprError::new(format!("`{written}` is not a number"), place)),
        }
    }
}

/// Returns how to write what a word or a character means in other languages; `None` for other texts.
fn help_for(text: &str) -> Option<&'static str> {
    Some(match text {
        "=" => "values are compared with `==`",
        "&" | "and" => "and is written `&&`",
        "|" | "or" => "or is written `||`",
        "not" => "not is written `!`",
        "\"" => "a string is written in single quotes: `'over'`",
        "^" => "a power of two is written `1 << n`",
        _ => return None,
    })
}

fn starts_name(c: char) -> bool {
    c == '_' || c.is_alphabetic()
}

fn continues_name(c: char) -> bool {
    c == '_' || c.is_alphanumeric()
}

fn too_large(place: Range<usize>) -> ExprError {
    ExprError::new("this integer does not fit in 64 bits", place)
}

fn too_deep(place: Range<usize>) -> ExprError {
    ExprError::new(format!("the expression is nested more than {MAX_DEPTH} levels deep"), place)
        .with_help("name a part of it in `let`")
}
