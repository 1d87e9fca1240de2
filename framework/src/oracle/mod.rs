//! Checks the dependencies of a plan against the accesses of its passes.
//!
//! The solver walks over the passes and tracks the state of memory. [`dependencies()`] tracks none: for each byte, it
//! lists the passes that access it, and looks back from each access. The two share nothing but the types of
//! [`crate::plan`] and [`crate::ir`], so a mistake goes unnoticed only if it is made twice. A backend checks its
//! lowering of the dependencies with a model of its API's rules.

mod dependencies;
pub mod stages;
#[cfg(test)]
mod tests;
pub mod trace;

pub use dependencies::{Objection, dependencies};
