//! Runs `splatgraph merge`: joins the results of a command that several processes shared.

use super::job::{Manifest, Origin, is_present};
use super::outcome::{Outcome, Usage};
use super::{evaluate, render, sweep, trade};
use crate::io::output::{one_line, say};
use crate::io::own_file;
use anyhow::{Context, Result, bail};
use serde::de::DeserializeOwned;
use std::path::PathBuf;

/// Join the results of a command that several processes shared (--shard), and name missing views
///
/// For `trade` and `sweep`, the folder gets the files of the command; for `evaluate`, scores.json, as --json prints it. They
/// equal the files of a single process, except for times, which each process measured. For `render`, the views with all their
/// files are counted.
///
/// Processes that do not share a disk have a folder each: name all of them. The exit code is 1 if views are missing.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph render scene.ply -c garden/ -o out/ --shard 0/2   # on one machine
  splatgraph render scene.ply -c garden/ -o out/ --shard 1/2   # on another, sharing the disk
  splatgraph merge out/                                        # are all pictures there?
  splatgraph merge ledger-0/ ledger-1/ -o ledger/              # from machines with their own disks")]
pub struct Args {
    /// Folders of --output
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Folder of the joined files [default: the first folder]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// Reads the descriptions of all folders, checks that they agree, and returns the first.
pub(super) fn prepare(args: &Args) -> Result<Manifest> {
    let mut manifests =
        args.folders.iter().map(|folder| Manifest::read(folder)).collect::<Result<Vec<_>>>()?;
    let first = manifests.remove(0);
    for (manifest, folder) in manifests.iter().zip(&args.folders[1..]) {
        let changes = first.changes(manifest);
        if !changes.is_empty() {
            bail!(
                "{}: expected results of the same request as {}, found some that differ in {}",
                folder.display(),
                args.folders[0].display(),
                changes.join(" and ")
            );
        }
    }
    Ok(first)
}

pub fn run(args: &Args) -> Result<Outcome> {
    let first = prepare(args)?;
    let (mut found, mut missing) = (Vec::new(), Vec::new());
    for (view, files) in first.views.iter().zip(&first.files) {
        match (files.first(), args.folders.iter().find(|folder| is_present(folder, files))) {
            (Some(result), Some(folder)) => found.push(folder.join(result)),
            _ => missing.push(view.as_str()),
        }
    }
    say(format!("{} of {} views are present", found.len(), first.views.len()));
    for view in &missing {
        say(format!("missing: {}", one_line(view)));
    }
    if !found.is_empty() {
        join(&first.command, &first.origin, &found, args)?;
    }
    Ok(if missing.is_empty() { Outcome::Done } else { Outcome::Failed })
}

fn join(command: &str, origin: &Origin, found: &[PathBuf], args: &Args) -> Result<()> {
    let output = args.output.as_ref().unwrap_or(&args.folders[0]);
    match command {
        render::COMMAND if args.output.is_some() => {
            Err(Usage("expected no --output for pictures, which stay where they are".into()).into())
        }
        render::COMMAND => Ok(()),
        trade::COMMAND => trade::merge(origin, parts(found)?, found, output),
        sweep::COMMAND => sweep::merge(origin, parts(found)?, &args.folders, output),
        evaluate::COMMAND => evaluate::merge(origin, parts(found)?, output),
        other => bail!("expected results of render, trade, sweep or evaluate, found those of `{other}`"),
    }
}

fn parts<T: DeserializeOwned>(found: &[PathBuf]) -> Result<Vec<T>> {
    let read = |path: &PathBuf| -> Result<T> {
        let bytes = own_file::read(path).with_context(|| path.display().to_string())?;
        serde_json::from_slice(&bytes)
            .with_context(|| format!("{}: expected results of a view", path.display()))
    };
    found.iter().map(read).collect()
}
