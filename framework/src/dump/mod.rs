//! Writes plans for people and programs.
//!
//! [`Dump`] is the plan with names in place of numbers. All forms come from it: [`json`], the canonical one, [`text`]
//! for the terminal, [`dot`] for Graphviz, [`html`] for an interactive page, and [`diff()`] to compare two dumps. A
//! backend adds its synchronisation: barriers ([`Dump::with_barriers`]) or encoders ([`DumpEncoders`], shown by
//! [`encoders_text`]).
//!
//! Tests check that the fields here, in `docs/dump.md` and in `docs/dump.schema.json` agree.

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

pub use crate::ir::bytes;
pub use diff::{
    BarrierChange, Diff, DiffSide, Differences, NamedChange, PropertyChange, ResourceSize, TotalChange, diff,
};
pub use diff_text::diff_text;
pub use dot::dot;
pub use encoders::encoders_text;
pub use form::*;
pub use from_plan::{dump, json};
pub use html::html;
pub use text::{barrier_line, cause_line, dependency_line, left_out_counts, text};
