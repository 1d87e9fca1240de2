//! Tells which words of a shader mean a name that the shader itself declares: an argument, a variable or a member.

/// Words that are no types, so that a word after them is not declared.
const NO_TYPES: [&str; 4] = ["case", "do", "else", "return"];

/// The names in scope at a position in a shader, from the tokens before it.
///
/// A word after a type is declared: `float radius`, `float[4] radius`, and also `radius` in `float a = 1.0, radius`. It
/// is in scope from the end of its initialiser to the end of its block. Shaders are not preprocessed, so a declaration
/// under a condition, `#if`, counts only if its block is under the same one, or is a struct.
pub struct Scopes<'a> {
    /// The file and the open brackets in it.
    open: Vec<Block<'a>>,
    /// Names for the next body or statement: a function's arguments, and the variables of `for`.
    ahead: Vec<&'a str>,
    /// True directly after a body or statement with names ahead of it.
    is_behind: bool,
    /// The last declared name, until its initialiser ends, and the number of open brackets around it.
    pending: Option<(usize, &'a str)>,
    /// Number of open brackets around a declaration that a comma continues.
    list: Option<usize>,
    /// True if a word at the position is declared there.
    declares: bool,
    /// Number of `#if` around the position.
    conditions: usize,
    is_known: bool,
}

struct Block<'a> {
    /// The opening bracket; a blank for the file.
    bracket: char,
    /// Names that the block declares.
    names: Vec<&'a str>,
    /// True if there were names ahead of the block.
    is_body: bool,
    /// Number of `#if` around the opening bracket.
    conditions: usize,
    /// True for the members of a struct, of a buffer or of a uniform block.
    is_struct: bool,
}

impl<'a> Scopes<'a> {
    pub fn new() -> Scopes<'a> {
        Scopes {
            open: vec![Block {
                bracket: ' ',
                names: Vec::new(),
                is_body: false,
                conditions: 0,
                is_struct: false,
            }],
            ahead: Vec::new(),
            is_behind: false,
            pending: None,
            list: None,
            declares: false,
            conditions: 0,
            is_known: true,
        }
    }

    /// Takes the next word. Returns true if the shader declares it, at the position or before.
    pub fn word(&mut self, word: &'a str) -> bool {
        self.is_known &= !(std::mem::take(&mut self.is_behind) && word == "else");
        let is_declared = std::mem::replace(&mut self.declares, !NO_TYPES.contains(&word))
            && self.open.last().is_some_and(|b| b.is_struct || b.conditions == self.conditions);
        if is_declared {
            self.pending = Some((self.open.len(), word));
            self.list = Some(self.open.len());
        }
        is_declared || self.contains(word)
    }

    pub fn contains(&self, word: &str) -> bool {
        self.ahead.contains(&word) || self.open.iter().any(|block| block.names.contains(&word))
    }

    /// Takes the next character that is neither a blank nor part of a word or a comment.
    pub fn sign(&mut self, sign: char) {
        let declares = sign == ']' || sign == ',' && self.list == Some(self.open.len());
        let follows_name = std::mem::replace(&mut self.declares, declares);
        if matches!(sign, ',' | ';' | ')')
            && let Some((_, name)) = self.pending.take_if(|(depth, _)| *depth == self.open.len())
            && let Some(block) = self.open.last_mut()
        {
            block.names.push(name);
        }
        self.is_known &= !(std::mem::take(&mut self.is_behind) && sign == '{');
        match sign {
            ';' => {
                self.list = None;
                if self.open.last().is_some_and(|block| block.bracket != '(') {
                    self.is_behind = !self.ahead.is_empty();
                    self.ahead.clear();
                }
            }
            '(' | '[' | '{' => {
                let names = if sign == '{' { std::mem::take(&mut self.ahead) } else { Vec::new() };
                let (conditions, is_struct) = (self.conditions, sign == '{' && follows_name);
                let is_body = !names.is_empty();
                self.open.push(Block { bracket: sign, names, is_body, conditions, is_struct });
            }
            ')' | ']' | '}' => {
                let closed = self.open.pop();
                let bracket = closed.as_ref().map_or(' ', |block| block.bracket);
                self.is_known &= matches!((bracket, sign), ('(', ')') | ('[', ']') | ('{', '}'));
                self.is_behind = closed.as_ref().is_some_and(|block| block.is_body);
                if sign == ')' {
                    self.ahead.extend(closed.into_iter().flat_map(|block| block.names));
                }
                self.list = self.list.filter(|depth| *depth <= self.open.len());
            }
            _ => {}
        }
    }

    /// Takes the number sign of a directive, with the text after it.
    pub fn directive(&mut self, text: &str) {
        let name = text[1..].trim_start_matches([' ', '\t']);
        if name.starts_with("if") {
            self.conditions += 1;
        } else if name.starts_with("endif") {
            self.conditions = self.conditions.saturating_sub(1);
        }
    }

    /// Returns true at the end of a shader whose scopes are known: its brackets match, and names ahead of a body or a
    /// statement are not ahead of a second one, too. A shader that closes a bracket in both `#if` and `#else` is none.
    pub fn is_known(&self) -> bool {
        self.is_known && self.open.len() == 1
    }
}
