//! Generates the preprocessor defines for a graph's constants.

use std::collections::BTreeMap;
use std::fmt;

use super::scope::Names;
use crate::ir::{Domain, Param, ParamBinding, ParamSet, Value, to_f32};

/// The constants of a graph, by their names in shaders (in capitals).
#[derive(Debug, Default)]
pub(super) struct Constants {
    /// Names and texts of constants that are 32-bit literals.
    pub defines: Vec<(String, String)>,
    /// Names and values of numbers beyond 32 bits. A shader that mentions one is an error.
    pub unfit: Vec<(String, String)>,
    /// For each name, the parameters that its value depends on. Includes names without a define.
    pub params: BTreeMap<String, ParamSet>,
    /// For each name, the constants of the graph that it stands for.
    pub of: BTreeMap<String, Vec<Constant>>,
}

/// The meaning of a name in shaders: a constant, an option of a choice, or a live parameter.
///
/// A live parameter is a variable, not a define, and keeps its name.
#[derive(Debug)]
pub(super) struct Constant {
    pub name: String,
    /// The value of the choice `name` for which a constant stands; `None` for `name` itself.
    pub option: Option<String>,
}

impl fmt::Display for Constant {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match &self.option {
            Some(option) => write!(f, "the value `{option}` of `{}`", self.name),
            None => write!(f, "`{}`", self.name),
        }
    }
}

/// Converts a name to its form in shaders: capitals, with `_` for all characters but ASCII letters and digits.
pub(super) fn capital(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' }).collect()
}

/// Returns the name in shaders of an option of a choice.
pub(super) fn option_define(choice: &str, option: &str) -> String {
    format!("{}_{}", capital(choice), capital(option))
}

/// Lists the constants of a graph: facts, constant parameters and `let`s, except texts.
///
/// A choice has the index of its option as its value. Its options become constants as well, so that a shader can write
/// `#if BLEND == BLEND_BACK_TO_FRONT`.
pub(super) fn defines(names: &Names, params: &[Param]) -> Constants {
    let Constants { mut defines, mut unfit, mut of, .. } = Constants::default();
    let mut add = |define: String, name: &String, option: Option<&String>| {
        let constant = Constant { name: name.clone(), option: option.cloned() };
        of.entry(define).or_default().push(constant);
    };
    for (name, value) in &names.values {
        let choices = params.iter().find(|p| p.name == *name).and_then(|p| match &p.domain {
            Domain::Choice(of) => Some(of),
            _ => None,
        });
        if !matches!(value, Value::Text(_)) || choices.is_some() {
            add(capital(name), name, None);
        }
        if let (Some(of), Value::Text(text)) = (choices, value) {
            for (i, choice) in of.iter().enumerate() {
                add(option_define(name, choice), name, Some(choice));
                defines.push((option_define(name, choice), i.to_string()));
                if choice == text {
                    defines.push((capital(name), i.to_string()));
                }
            }
        } else if let Some(text) = define_text(value) {
            defines.push((capital(name), text));
        } else if matches!(value, Value::Int(_) | Value::Float(_)) {
            unfit.push((capital(name), value.to_string()));
        }
    }
    for live in params.iter().filter(|param| param.binding != ParamBinding::Const) {
        add(live.name.clone(), &live.name, None);
    }
    let mut behind: BTreeMap<String, ParamSet> = BTreeMap::new();
    for (name, params) in &names.params {
        // Several names may be equal in capitals.
        behind.entry(capital(name)).or_default().extend(params);
    }
    Constants { defines, unfit, params: behind, of }
}

/// Formats a value as a GLSL literal; `None` for texts and numbers beyond 32 bits.
fn define_text(value: &Value) -> Option<String> {
    match value {
        Value::Bool(v) => Some(i32::from(*v).to_string()),
        Value::Int(v) if i32::try_from(*v).is_ok() => Some(v.to_string()),
        Value::Int(v) => u32::try_from(*v).ok().map(|v| format!("{v}u")),
        Value::Float(v) => to_f32(*v).map(|_| format!("{v:?}")),
        Value::Text(_) => None,
    }
}
