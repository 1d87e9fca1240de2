//! Parses the options of the exact renderer.

use crate::draw::truth::{Map, rule_list};
use crate::io::image::Format;
use std::path::{Path, PathBuf};

/// Lists the rules under `--rule`.
pub fn rule_help() -> String {
    format!(
        "Change a rule of the exact renderer; may be repeated\n\nThe rules, with their values and their place in the published rasteriser:\n{}",
        crate::cli::help::two_columns(rule_list())
    )
}

/// Parses `NAME=FILE.npy`.
pub fn map(text: &str) -> Result<(Map, PathBuf), String> {
    let (name, file) =
        text.split_once('=').ok_or("expected NAME=FILE.npy, for instance contributors=count.npy")?;
    if Format::of(Path::new(file)) != Some(Format::Npy) {
        return Err("expected a file name with the extension .npy".into());
    }
    Ok((name.parse()?, file.into()))
}
