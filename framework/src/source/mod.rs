//! Source texts of graphs and shaders, and diagnostics drawn under them.
//!
//! Everything that this crate reads (graphs, presets, shaders and what they include) is text, and everything
//! it complains about is a place in such a text. Four small things make that work:
//!
//! - a [`SourceMap`] finds files by name (in memory, on disk, built into the binary), reads each once and
//!   hands out a [`FileId`](crate::ir::FileId) for it. A [`Span`](crate::ir::Span) is a range of bytes in one such file;
//! - an [`Outline`] knows the span of every element of a RON text. `serde` builds the typed tree and forgets
//!   where things stood; the outline is asked afterwards, by [`Path`], when something turns out to be wrong
//!   with the meaning of an element rather than with its syntax;
//! - a [`Diagnostic`] says what is wrong, where, and what to do about it, and [`render`] draws a list of them
//!   as a compiler would. [`nearest`] finds the name that was probably meant;
//! - [`ron_error`] turns the `ron` crate's own errors into diagnostics.
//!
//! And what of the disk a build has seen, the map remembers as [`Wanted`] paths: as long as each of them holds the same
//! [`Content`], building again is of no use.

mod content;
mod diagnostic;
mod files;
mod outline;
mod ron_error;
#[cfg(test)]
mod tests;
mod token;

pub use content::{Content, Wanted};
pub use diagnostic::{Diagnostic, Label, nearest, render, render_warnings};
pub use files::{Kind, Library, NotFound, SourceMap};
pub use outline::{Outline, Path};
pub use ron_error::ron_error;
