//! Writes the program's outputs: files, lines for the terminal, and data on standard output.
//!
//! A file is either complete or absent: [`write()`] fills an unnamed file and names it once its contents are on the
//! disk, so that a full disk, an error or a signal leaves an existing file unchanged ([`mod@file`], [`signals`]). Only
//! a [`Log`] grows in place. [`names`] gives each camera a unique file name, and [`guard`] rejects an output that is
//! also an input, before anything is drawn. Text for the terminal passes through [`terminal`], which escapes control
//! characters.

pub mod claim;
pub(crate) mod faults;
pub mod file;
pub mod guard;
pub mod log;
pub mod names;
pub mod signals;
pub mod terminal;

pub use claim::{Claim, claim, lock};
pub use file::{OutputError, is_standard_output, remove, write, write_bytes, write_new, write_new_bytes};
pub use guard::OutputGuard;
pub use log::Log;
pub use terminal::{harmless, note, one_line, print, say, say_styled, shell_word};
