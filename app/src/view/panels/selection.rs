//! Holds the selection that all tools share, and the plan's dump, which contains the selected item.

use crate::draw::backend;
use splatgraph_framework::dump::{Dump, DumpBarrier, DumpPass, DumpResource};
use splatgraph_framework::ir::Use;
use splatgraph_framework::plan::Plan;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

/// The selected item. A click in any tool selects it in all of them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Selection {
    /// A pass, by its name in the plan.
    Pass(String),
    /// A barrier, by its number in the dump.
    Barrier(u32),
    /// A resource, by its name in the plan.
    Resource(String),
    /// The picked splat.
    Splat,
}

impl FromStr for Selection {
    type Err = String;

    /// Parses `pass:NAME`, `barrier:NUMBER` or `resource:NAME`.
    fn from_str(text: &str) -> Result<Selection, String> {
        let expected = || format!("expected pass:NAME, barrier:NUMBER or resource:NAME, found `{text}`");
        match text.split_once(':').ok_or_else(expected)? {
            ("pass", name) if !name.is_empty() => Ok(Selection::Pass(name.to_owned())),
            ("resource", name) if !name.is_empty() => Ok(Selection::Resource(name.to_owned())),
            ("barrier", number) => number.parse().map(Selection::Barrier).map_err(|_| expected()),
            _ => Err(expected()),
        }
    }
}

impl fmt::Display for Selection {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Selection::Pass(name) => write!(f, "pass `{name}`"),
            Selection::Barrier(id) => write!(f, "barrier {id}"),
            Selection::Resource(name) => write!(f, "resource `{name}`"),
            Selection::Splat => f.write_str("splat"),
        }
    }
}

/// Cache of the dump of one plan.
#[derive(Default)]
pub struct Dumped {
    plan: Option<(Arc<Plan>, Dump)>,
}

impl Dumped {
    /// Returns the dump of `plan`, from the cache if it was the last one.
    pub fn of(&mut self, plan: &Arc<Plan>) -> &Dump {
        if !self.plan.as_ref().is_some_and(|(of, _)| Arc::ptr_eq(of, plan)) {
            self.plan = None;
        }
        &self.plan.get_or_insert_with(|| (plan.clone(), backend::dump(plan))).1
    }
}

impl Selection {
    /// Returns true if the plan contains the selected item. Always true for a splat.
    pub fn is_in(&self, dump: &Dump) -> bool {
        match self {
            Selection::Pass(name) => dump.pass(name).is_some(),
            Selection::Barrier(id) => barrier(dump, *id).is_some(),
            Selection::Resource(name) => resource(dump, name).is_some(),
            Selection::Splat => true,
        }
    }
}

/// Finds a barrier by its number.
pub fn barrier(dump: &Dump, id: u32) -> Option<&DumpBarrier> {
    dump.barriers().find(|barrier| barrier.id == id)
}

/// Finds a resource by its name.
pub fn resource<'a>(dump: &'a Dump, name: &str) -> Option<&'a DumpResource> {
    dump.resources.iter().find(|resource| resource.name == name)
}

/// Returns whether a pass reads a resource, and whether it writes it.
pub fn touches(pass: &DumpPass, resource: &str) -> (bool, bool) {
    let of = |touches: &[Use<String>]| touches.iter().any(|touch| touch.resource == resource);
    (of(&pass.reads), of(&pass.writes))
}

/// Returns the bytes of the resources that a pass reads, and of those that it writes. They are upper bounds of its
/// traffic if it accesses each byte at most once.
pub fn bound_bytes(dump: &Dump, pass: &DumpPass) -> (u64, u64) {
    let sum = |touches: &[Use<String>]| {
        touches.iter().filter_map(|touch| resource(dump, &touch.resource)).map(|r| r.bytes).sum()
    };
    (sum(&pass.reads), sum(&pass.writes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_selection_is_read_from_its_kind_and_name() {
        assert_eq!("pass:sort.scan[0]".parse(), Ok(Selection::Pass("sort.scan[0]".to_owned())));
        assert_eq!("barrier:8".parse(), Ok(Selection::Barrier(8)));
        let error = "barrier:x".parse::<Selection>().expect_err("x is no number");
        assert_eq!(error, "expected pass:NAME, barrier:NUMBER or resource:NAME, found `barrier:x`");
    }
}
