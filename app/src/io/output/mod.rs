//! Writes everything that leaves the program: files, lines for the terminal, and data on standard output.
//!
//! A file is whole, or it is not there: [`write()`] fills a file without a name and names it once its contents are on the disk, so
//! that a full disk, an error or a signal leaves what was there before ([`mod@file`], [`signals`]). [`names`] gives each camera a
//! file name of its own, and [`guard`] refuses an output over an input, before anything is drawn. Text passes through
//! [`terminal`], which takes the escape sequences out of names from files, and which a closed pipe or a full device cannot stop.

pub mod file;
pub mod guard;
pub mod log;
pub mod names;
pub mod signals;
pub mod terminal;

pub use file::{OutputError, write, write_bytes};
pub use guard::OutputGuard;
pub use log::Log;
pub use terminal::{harmless, is_standard_output, note, one_line, print, say, say_styled, shell_word};
