//! Reads the source texts of graphs and shaders, and makes diagnostics that point into them.
//!
//! Everything that this crate reads (graphs, presets, shaders and their includes) is text, and every error refers to a
//! range of a text. This module has four parts:
//!
//! - a [`SourceMap`] finds files by name (in memory, on disk, built into the binary), reads each once and assigns it a
//!   [`FileId`](crate::ir::FileId). A [`Span`](crate::ir::Span) is a byte range in one such file;
//! - an [`Outline`] has the span of every element of a RON text. `serde` builds the typed tree without spans. To report
//!   an error about a value, later steps look up its [`Place`] in the outline;
//! - a [`Diagnostic`] is an error with its place and suggestions. [`render`] formats a list of them as a compiler
//!   would, [`GraphErrors`] is that text as an error, and [`nearest`] finds the name that was probably meant;
//! - [`ron_error`] converts errors of the `ron` crate to diagnostics.
//!
//! The map records every path that a build looked up on disk as [`Wanted`]. While each path has the same [`Content`],
//! another build would give the same result.

mod content;
mod diagnostic;
mod errors;
mod files;
mod outline;
mod paths;
mod place;
mod render;
mod ron_error;
#[cfg(test)]
mod tests;
mod token;

pub(crate) use content::Stamp;
pub use content::{Content, Wanted};
pub use diagnostic::{Diagnostic, Label, nearest};
pub use errors::{GraphErrors, PlainDiagnostic, Severity};
pub use files::{Kind, Library, NotFound, SourceMap, canonical};
pub use outline::Outline;
pub use place::Place;
pub(crate) use render::MAX_RENDERED;
pub use render::{render, render_warnings};
pub use ron_error::ron_error;
