//! Runs `splatgraph new`: writes a graph as a starting point.

use super::outcome::{Outcome, Usage};
use crate::io::output::{self, OutputGuard, note, shell_word};
use anyhow::Result;
use clap::ValueEnum;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  splatgraph new my.ron                     # a renderer for splats, with its four shaders
  splatgraph new rings.ron --from compute   # a picture from one compute shader
  splatgraph new grey.ron --from post       # a filter over the picture of `auto`, with a slider
  splatgraph check my.ron
  splatgraph render -p my.ron -o my.png
  splatgraph view -p my.ron                 # shows every change of the files as it is saved";

/// Write a graph to start from, with its shaders beside it
///
/// The new graph can be checked and drawn immediately. Its shaders are named after it. docs/tutorial.md explains each
/// template.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The graph to write
    #[arg(value_name = "FILE.ron")]
    file: PathBuf,
    /// The template
    #[arg(long, value_enum, default_value_t = Start::Splat)]
    from: Start,
    /// Overwrite existing files
    #[arg(long)]
    force: bool,
}

/// Template of a new graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Start {
    /// A splat renderer with its own projection and draw, and a built-in sort
    Splat,
    /// A picture from one compute shader
    Compute,
    /// A filter over the picture of `auto`
    Post,
}

macro_rules! tutorial {
    ($name:literal) => {
        ($name, include_str!(concat!("../../tutorial/", $name)))
    };
}

impl Start {
    /// Lists the template's files: names in the tutorial, and texts.
    fn files(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Start::Splat => &[
                tutorial!("renderer.ron"),
                tutorial!("renderer.comp"),
                tutorial!("renderer.clear.comp"),
                tutorial!("renderer.vert"),
                tutorial!("renderer.frag"),
            ],
            Start::Compute => &[tutorial!("paint.ron"), tutorial!("paint.comp")],
            Start::Post => &[tutorial!("post.ron"), tutorial!("post.comp")],
        }
    }
}

/// Lists the files to write, with their contents. Fails if the name is invalid, or if a file exists and
/// `--force` is not given.
pub(super) fn prepare(args: &Args) -> Result<Vec<(PathBuf, String)>, Usage> {
    let name = args.file.file_name().unwrap_or_default();
    let name = name
        .to_str()
        .ok_or_else(|| Usage(format!("expected a file name in UTF-8, found {}", args.file.display())))?;
    let stem = name.strip_suffix(".ron").filter(|stem| !stem.is_empty()).ok_or_else(|| {
        Usage(format!("expected a file name with the extension .ron, found {}", args.file.display()))
    })?;
    // The name appears in a string of the graph, where quotes and spaces would make it an expression.
    if !stem.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.')) {
        return Err(Usage(format!("expected a name of letters, digits, `_` and `-`, found `{stem}`")));
    }
    let files: Vec<(PathBuf, String)> = files(args.from, stem)
        .map(|(extension, text)| (args.file.with_file_name(format!("{stem}.{extension}")), text))
        .collect();
    let there: Vec<String> = files
        .iter()
        .filter(|(path, _)| path.symlink_metadata().is_ok())
        .map(|(path, _)| path.display().to_string())
        .collect();
    if !args.force && !there.is_empty() {
        return Err(Usage(format!(
            "expected an unused name, found {}: choose another, or overwrite with --force",
            there.join(", ")
        )));
    }
    let mut guard = OutputGuard::default();
    files.iter().try_for_each(|(path, _)| guard.output("FILE.ron", path))?;
    Ok(files)
}

/// Returns the files of a template as extension and text. The text refers to the shaders by their new names.
fn files(start: Start, stem: &str) -> impl Iterator<Item = (&'static str, String)> {
    let all = start.files();
    all.iter().map(move |(name, text)| {
        let renamed = all.iter().fold((*text).to_owned(), |text, (other, _)| {
            text.replace(&format!("\"{other}\""), &format!("\"{stem}.{}\"", extension(other)))
        });
        (extension(name), renamed)
    })
}

/// Returns the part of a file name after the first dot: `comp`, or `clear.comp`.
fn extension(name: &'static str) -> &'static str {
    name.split_once('.').unwrap_or_default().1
}

pub fn run(args: &Args) -> Result<Outcome> {
    let files = prepare(args)?;
    for (path, text) in &files {
        output::write_bytes(path, text.as_bytes())?;
    }
    let names: Vec<String> = files.iter().map(|(path, _)| path.display().to_string()).collect();
    note(format!("written: {}", names.join(", ")));
    let graph = shell_word(&args.file.display().to_string());
    let picture = shell_word(&args.file.with_extension("png").display().to_string());
    note(format!("draw it: splatgraph render -p {graph} -o {picture}"));
    Ok(Outcome::Done)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::facts;
    use crate::draw::planner::testing;

    fn args(file: PathBuf, from: Start) -> Args {
        Args { file, from, force: false }
    }

    #[test]
    fn every_start_is_a_graph_without_mistakes_under_any_name() {
        let folder = tempfile::tempdir().expect("a folder");
        for (from, shaders) in [(Start::Splat, 4), (Start::Compute, 1), (Start::Post, 1)] {
            let path = folder.path().join(format!("My-{from:?}_2.ron"));
            run(&args(path.clone(), from)).expect("written");
            for lanes in facts::SUBGROUP_SIZES {
                let plan = testing::plan(&path.display().to_string(), &[], lanes);
                let own = plan.shaders.iter().filter(|s| s.name.contains("My-")).count();
                assert_eq!(own, shaders, "{from:?}");
            }
        }
    }

    #[test]
    fn a_file_that_is_there_stays_unless_it_is_to_be_overwritten() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("my.ron");
        // An existing shader must not be overwritten either.
        let shader = folder.path().join("my.comp");
        std::fs::write(&shader, "mine").expect("writable");
        let error = run(&args(path.clone(), Start::Compute)).expect_err("the shader is there").to_string();
        assert!(error.contains("my.comp") && error.contains("--force"), "{error}");
        assert!(!path.exists());
        assert_eq!(std::fs::read_to_string(&shader).expect("there"), "mine");
        run(&Args { force: true, ..args(path.clone(), Start::Compute) }).expect("overwritten");
        assert!(path.exists() && std::fs::read_to_string(&shader).expect("there").starts_with("#version"));
    }

    #[test]
    fn names_that_a_graph_could_not_name_are_refused() {
        for name in ["my.txt", ".ron", "my graph.ron", "it's.ron", "my", "a\"b.ron"] {
            assert!(prepare(&args(name.into(), Start::Post)).is_err(), "{name}");
        }
        #[cfg(unix)]
        {
            use std::os::unix::ffi::OsStringExt;
            let name = std::ffi::OsString::from_vec(b"caf\xe9.ron".to_vec());
            let error = prepare(&args(name.into(), Start::Post)).expect_err("not UTF-8").to_string();
            assert_eq!(error, "expected a file name in UTF-8, found caf\u{fffd}.ron");
        }
    }
}
