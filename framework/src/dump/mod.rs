//! Writes plans for people and programs.
//!
//! [`Dump`] is the plan with names in place of numbers, and the only source of all forms: [`json`], the canonical one,
//! [`text`] for the terminal, [`dot`] for Graphviz, [`html`] for an interactive page, and [`diff()`] to compare two
//! dumps. A dump lists the passes in execution order with the resources that each accesses, the memory and the
//! lifetime of each resource, and the dependencies of each pass. A backend adds the commands of its API. These are
//! either barriers ([`Dump::with_barriers`]), each with its hazards, its passes and the lines of the graph that cause
//! it, or encoders ([`DumpEncoders`], shown by [`encoders_text`]).
//!
//! The fields are documented here, in `docs/dump.md`, and for programs in `docs/dump.schema.json`. A test checks that
//! all three have the same fields.

mod diff;
mod diff_text;
mod dot;
mod encoders;
mod form;
mod from_plan;
mod html;
mod repeats;
#[cfg(test)]
mod tests;
mod text;

pub use diff::{
    BarrierChange, Diff, DiffSide, Differences, NamedChange, PropertyChange, ResourceSize, TotalChange, diff,
};
pub use diff_text::diff_text;
pub use dot::dot;
pub use encoders::encoders_text;
pub use form::*;
pub use from_plan::{dump, json};
pub use html::html;
pub use text::{barrier_line, bytes, cause_line, dependency_line, left_out_counts, text};
