//! Defines reasons: the values that explain a parameter's value or an unmet requirement.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

use super::Value;

/// An expression with the values that determined its result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// The expression's text, as in the file.
    pub expression: String,
    /// Facts, parameters, `let`s and variables of repeats that the evaluation read, with their values.
    pub values: BTreeMap<String, Value>,
}

impl Reason {
    /// Returns true if the values include a fact: of the device, the scene, the viewport or the requested outputs.
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

/// A requirement of a graph that does not hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Unmet {
    /// The requirement in words, from the graph's file.
    pub needs: String,
    /// The condition that is false, with the values that it read.
    pub reason: Reason,
}

impl fmt::Display for Unmet {
    /// Writes the requirement and the values: `workgroups of 256 invocations (device.max_invocations = 128)`.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self.reason.values.is_empty() {
            true => write!(f, "{} (`{}` is false)", self.needs, self.reason.expression),
            false => write!(f, "{} ({})", self.needs, self.reason),
        }
    }
}

/// A graph that a choice rejected, and the graph that it tried next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fallback {
    /// The rejected graph.
    pub wanted: String,
    /// The next graph of the choice.
    pub taken: String,
    /// The requirements that do not hold; at least one.
    pub unmet: Vec<Unmet>,
    /// True if the unmet requirements are all the choice's own: the graph would run here, but another is preferred.
    pub preference: bool,
}

impl Fallback {
    /// Iterates over rejected graphs with unmet requirements of their own, not only of the choice.
    pub fn lacking(all: &[Fallback]) -> impl Iterator<Item = &Fallback> {
        all.iter().filter(|fallback| !fallback.preference)
    }
}

impl fmt::Display for Fallback {
    /// Writes a sentence such as: `splat` is used instead of `tiled`, which needs workgroups of 256 invocations
    /// (device.max_invocations = 128)
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let needs: Vec<String> = self.unmet.iter().map(Unmet::to_string).collect();
        write!(
            f,
            "`{}` is used instead of `{}`, which needs {}",
            self.taken,
            self.wanted,
            needs.join(" and ")
        )
    }
}
