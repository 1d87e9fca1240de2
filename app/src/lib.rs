//! Draws scenes with render graphs and measures the cost of the pictures.
//!
//! This library joins a scene from `splatgraph-assets`, a plan that `splatgraph-framework` built from a graph file, and
//! a device that executes it:
//!
//! - [`io`]: the program's input and output: picture files, pages, terminal text;
//! - [`draw`]: frames of a scene: devices, facts, plans, sessions, their pictures and times;
//! - [`studies`]: measurements over many frames, each a function that returns numbers or a page;
//! - [`view`]: the interactive viewer;
//! - [`lsp`]: the language server for editors;
//! - [`cli`]: the program `splatgraph`.
//!
//! A module imports only modules before it in this list.

#![deny(missing_docs)]
// Tests may write and print; the program does so through `io::output` alone.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_macros))]

/// Compiles the code blocks of `docs/rust.md`.
#[cfg(doctest)]
#[doc = include_str!("../../docs/rust.md")]
mod rust_page {}

pub mod cli;
pub mod draw;
pub mod io;
pub mod lsp;
#[cfg(test)]
#[path = "../../tests/numbers.rs"]
mod numbers;
pub mod studies;
#[cfg(feature = "window")]
pub mod view;
