//! Keeps lines and files apart on standard output.

use crate::cli::options;
use crate::io::output::{is_standard_output, note, say};
use anyhow::Result;
use std::path::Path;

/// The use of standard output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stdout {
    /// A file is written there, which must be alone; lines go to standard error.
    File,
    /// Its lines are all that the command gives.
    Product,
    /// Its lines tell of the files that the command is for.
    Notes,
}

impl Stdout {
    /// Finds the use from the files that a command writes.
    pub fn of<'a>(mut files: impl Iterator<Item = &'a Path>) -> Stdout {
        let Some(first) = files.next() else { return Stdout::Product };
        match is_standard_output(first) || files.any(is_standard_output) {
            true => Stdout::File,
            false => Stdout::Notes,
        }
    }

    /// Prints a line where nobody takes it for a file.
    pub fn line(self, line: &str) -> Result<()> {
        match self {
            Stdout::File => say(line),
            Stdout::Product => return options::print(line),
            Stdout::Notes => note(line),
        }
        Ok(())
    }
}
