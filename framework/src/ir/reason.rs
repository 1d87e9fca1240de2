//! Defines reasons: the values that explain a parameter's value or an unmet requirement.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

use super::Value;

/// The reason for an expression's value: its text, and the values of the names that it used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// The expression, as in the file.
    pub expression: String,
    /// The facts, parameters and `let`s that the expression's evaluation read, with their values.
    pub values: BTreeMap<String, Value>,
}

impl Reason {
    /// Returns true if a fact of the device, the scene or the viewport is among the values.
    pub fn has_fact(&self) -> bool {
        // Names of facts contain a dot; other names do not.
        self.values.keys().any(|name| name.contains('.'))
    }
}

impl fmt::Display for Reason {
    /// Writes the values: `device.subgroup_size = 8, scene.count = 1000`.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for (index, (name, value)) in self.values.iter().enumerate() {
            write!(f, "{}{name} = {value}", if index == 0 { "" } else { ", " })?;
        }
        Ok(())
    }
}

/// An unmet requirement of a graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Unmet {
    /// The requirement in words, as in the file.
    pub needs: String,
    /// The condition, with the values that made it false.
    pub reason: Reason,
}

impl fmt::Display for Unmet {
    /// Writes the requirement and the reason: `workgroups of 256 invocations (device.max_invocations = 128)`.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} ({})", self.needs, self.reason)
    }
}

/// A graph that a choice passed over, and the next one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fallback {
    /// The graph whose requirements do not hold.
    pub wanted: String,
    /// The next graph of the choice, which is tried instead.
    pub taken: String,
    /// The unmet requirements, at least one.
    pub unmet: Vec<Unmet>,
    /// True if all unmet requirements are the choice's own: the graph would run, but another is preferred.
    pub preference: bool,
}

impl Fallback {
    /// Iterates over graphs that the device cannot run, without graphs that a choice merely ranks lower.
    pub fn lacking(all: &[Fallback]) -> impl Iterator<Item = &Fallback> {
        all.iter().filter(|fallback| !fallback.preference)
    }
}

impl fmt::Display for Fallback {
    /// Writes a sentence such as: `splat` stands in for `tiled`, which needs workgroups of 256 invocations
    /// (device.max_invocations = 128)
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let needs: Vec<String> = self.unmet.iter().map(Unmet::to_string).collect();
        write!(f, "`{}` stands in for `{}`, which needs {}", self.taken, self.wanted, needs.join(" and "))
    }
}
