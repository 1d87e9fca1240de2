//! Replaces `splatgraph view` in a program that was built without its window.

use super::outcome::Outcome;
use anyhow::{Result, bail};
use std::ffi::OsString;

/// Open a window on a scene (not in this program: it was built without the feature `window`)
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Any options of `view`, so that the error is about the window, not about them
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _words: Vec<OsString>,
}

pub fn run(_: &Args) -> Result<Outcome> {
    bail!("expected a program with a window, found one that was built without the feature `window`")
}

#[cfg(test)]
mod tests {
    use super::super::parsed;
    use super::*;

    #[test]
    fn view_with_any_options_says_that_the_program_has_no_window() {
        for line in ["view", "view scene.ply --compare key16", "view --frames 2 scene.ply -p my.ron"] {
            let args: Args = parsed(line.split(' ')).unwrap_or_else(|error| panic!("{line}: {error}"));
            assert!(run(&args).unwrap_err().to_string().contains("without the feature `window`"), "{line}");
        }
    }
}
