//! Reasons: the values that decided a parameter, or that a graph's requirement was held against.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

use super::Value;

/// Shows why an expression came to its value: the expression, and the values of the names that it used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// The expression, as in the file.
    pub expression: String,
    /// The facts, parameters and `let`s that its evaluation reached, with their values.
    pub values: BTreeMap<String, Value>,
}

impl Reason {
    /// Returns true if a fact of the device, the scene or the viewport is among the values.
    pub fn has_fact(&self) -> bool {
        // Names with a dot are facts: others are identifiers.
        self.values.keys().any(|name| name.contains('.'))
    }
}

impl fmt::Display for Reason {
    /// Writes for instance `device.subgroup_size = 8, scene.count = 1000`.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for (index, (name, value)) in self.values.iter().enumerate() {
            write!(f, "{}{name} = {value}", if index == 0 { "" } else { ", " })?;
        }
        Ok(())
    }
}

/// Names a requirement of a graph that does not hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Unmet {
    /// The need in words, as in the file.
    pub needs: String,
    /// The condition, with the values that made it false.
    pub reason: Reason,
}

impl fmt::Display for Unmet {
    /// Writes for instance `workgroups of 256 invocations (device.max_invocations = 128)`.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} ({})", self.needs, self.reason)
    }
}

/// Says that a choice passes a graph over, and takes the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fallback {
    /// The graph whose requirements do not hold.
    pub wanted: String,
    /// The next of the choice, which is taken; the graph wanted in the next entry, if there is one.
    pub taken: String,
    /// The requirements, at least one.
    pub unmet: Vec<Unmet>,
    /// The requirements are all the choice's own: the graph would run, and is preferred elsewhere.
    pub preference: bool,
}

impl Fallback {
    /// Iterates over graphs that the device cannot run; graphs that a choice merely ranks lower are left out.
    pub fn lacking(all: &[Fallback]) -> impl Iterator<Item = &Fallback> {
        all.iter().filter(|fallback| !fallback.preference)
    }
}

impl fmt::Display for Fallback {
    /// Writes for instance: `splat` stands in for `tiled`, which needs workgroups of 256 invocations (device.max_invocations = 128)
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let needs: Vec<String> = self.unmet.iter().map(Unmet::to_string).collect();
        write!(f, "`{}` stands in for `{}`, which needs {}", self.taken, self.wanted, needs.join(" and "))
    }
}
