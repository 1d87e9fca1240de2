//! Runs `splatgraph source`: prints the built-in graphs and shaders.

use super::options;
use super::outcome::Outcome;
use crate::draw::builtin;
use anyhow::{Result, bail};

const EXAMPLES: &str = "Examples:
  splatgraph source                            # every name, with a line on each
  splatgraph source splat                      # the graph of the preset `splat`
  splatgraph source parts/sort                 # a part that graphs include
  splatgraph source sort/scatter.comp          # a shader
  splatgraph source filters/edges > my.ron     # a copy to change; `splatgraph new` writes commented templates";

/// Print a built-in graph, part or shader
///
/// Without NAME, all names are listed. Graphs refer to parts and shaders by these names: `Include(graph:
/// "parts/sort.ron", ...)`, `shader: "sort/scatter.comp"`, and in a shader, `#include "camera.glsl"`. A file of that
/// name beside the graph takes precedence.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The file, with or without the extension .ron
    name: Option<String>,
}

pub fn run(args: &Args) -> Result<Outcome> {
    let Some(name) = &args.name else {
        options::print(&list())?;
        return Ok(Outcome::Done);
    };
    match builtin::find(name) {
        Ok(file) => options::write_text(None, file.text)?,
        Err(near) => bail!(unknown(name, &near)),
    }
    Ok(Outcome::Done)
}

fn list() -> String {
    let group = |(title, files): (&str, Vec<builtin::File>)| {
        let rows = files.into_iter().map(|file| (file.name.to_owned(), file.summary)).collect();
        format!("{title}:\n{}", super::help::two_columns(rows))
    };
    builtin::groups().into_iter().map(group).collect::<Vec<_>>().join("\n\n")
}

/// Formats the error about an unknown name. `near` lists similar names as suggestions.
fn unknown(name: &str, near: &[&str]) -> String {
    let generated = "it is generated for each graph; `splatgraph dump GRAPH --format json` has the `type` and `offset` of its members";
    let near: Vec<String> = near.iter().map(|name| format!("`{name}`")).collect();
    let help = match near.is_empty() {
        _ if name == "live.glsl" => generated.to_owned(),
        true => "`splatgraph source` lists all names".to_owned(),
        false => format!("did you mean {}?", near.join(" or ")),
    };
    format!("expected the name of a built-in file, found `{name}`: {help}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_has_every_name_under_its_group() {
        let text = list();
        let at = |needle: &str| text.find(needle).unwrap_or_else(|| panic!("no {needle} in\n{text}"));
        assert!(at("Graphs:\n") < at("\n  splat ") && at("\n  splat ") < at("Filters:\n"));
        assert!(at("Filters:\n") < at("filters/edges") && at("filters/edges") < at("Parts:\n"));
        assert!(at("Parts:\n") < at("parts/sort") && at("parts/sort") < at("Shaders:\n"));
        assert!(at("Shaders:\n") < at("sort/scatter.comp"));
    }

    #[test]
    fn a_misspelt_name_is_answered_with_the_nearest() {
        assert_eq!(
            unknown("splt", &["splat"]),
            "expected the name of a built-in file, found `splt`: did you mean `splat`?"
        );
        assert!(unknown("x", &[]).ends_with("`splatgraph source` lists all names"));
        assert!(unknown("live.glsl", &["lens.glsl"]).contains(": it is generated for each graph; "));
    }
}
