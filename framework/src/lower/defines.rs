//! Preprocessor defines for a graph's constants.

use super::scope::Names;
use crate::ir::{Domain, Param, Value};

/// Lists the defines of every value that fits a 32-bit literal, by its name in capitals.
///
/// The names of a choice become constants too, so that a shader can write `#if BLEND == BLEND_BACK_TO_FRONT`.
pub(super) fn defines(names: &Names, params: &[Param]) -> Vec<(String, String)> {
    let capital = |name: &str| -> String {
        name.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' }).collect()
    };
    let mut defines = Vec::new();
    for (name, value) in &names.values {
        let choices = params.iter().find(|p| p.name == *name).and_then(|p| match &p.domain {
            Domain::Choice(of) => Some(of),
            _ => None,
        });
        if let (Some(of), Value::Text(text)) = (choices, value) {
            for (i, choice) in of.iter().enumerate() {
                defines.push((format!("{}_{}", capital(name), capital(choice)), i.to_string()));
                if choice == text {
                    defines.push((capital(name), i.to_string()));
                }
            }
        } else if let Some(text) = define_text(value) {
            defines.push((capital(name), text));
        }
    }
    defines
}

/// A value as a GLSL literal; `None` where it is none or does not fit 32 bits.
pub(super) fn define_text(value: &Value) -> Option<String> {
    match value {
        Value::Bool(v) => Some(i32::from(*v).to_string()),
        Value::Int(v) if i32::try_from(*v).is_ok() => Some(v.to_string()),
        Value::Int(v) => u32::try_from(*v).ok().map(|v| format!("{v}u")),
        Value::Float(v) if v.is_finite() => Some(format!("{v:?}")),
        Value::Float(_) | Value::Text(_) => None,
    }
}
