//! Checks the dependencies of a plan against the accesses of its passes.
//!
//! The solver walks over the passes and keeps the last accesses to each memory cell. [`dependencies()`] lists all
//! accesses to each cell, and looks back from each of them. The two share nothing but the types of
//! [`crate::plan`] and [`crate::ir`], so a mistake goes unnoticed only if it is made twice. A backend checks its
//! lowering of the dependencies with a model of its API's rules.

mod dependencies;
pub mod stages;
#[cfg(test)]
mod tests;
pub mod trace;

pub use dependencies::{Objection, dependencies};
