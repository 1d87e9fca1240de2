//! Keeps printed lines out of a file that goes to standard output.

use super::options;
use crate::io::output::{is_standard_output, note, say};
use anyhow::Result;
use std::path::Path;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stdout {
    /// A file and nothing else; lines go to standard error.
    File,
    /// Lines that are the command's only result.
    Product,
    /// Lines that report on the files that the command writes.
    Notes,
}

impl Stdout {
    /// Returns the use of standard output in a command that writes these files; [`Stdout::Product`] without files.
    pub fn of<'a>(files: impl IntoIterator<Item = &'a Path>) -> Stdout {
        let mut files = files.into_iter();
        let Some(first) = files.next() else { return Stdout::Product };
        match is_standard_output(first) || files.any(is_standard_output) {
            true => Stdout::File,
            false => Stdout::Notes,
        }
    }

    pub fn line(self, line: &str) -> Result<()> {
        match self {
            Stdout::File => say(line),
            Stdout::Product => return options::print(line),
            Stdout::Notes => note(line),
        }
        Ok(())
    }
}
