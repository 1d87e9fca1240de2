//! Runs `splatgraph merge`: joins the results of a command that several processes shared.

use super::job::{Manifest, is_present};
use super::outcome::{Outcome, Usage};
use super::{evaluate, render, sweep, trade};
use crate::io::output::{one_line, say};
use crate::io::own_file;
use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use std::path::PathBuf;

/// Join the results of a command that several processes shared (--shard), and name missing views
///
/// For `trade` and `sweep`, the folder gets the files of the command; for `evaluate`, scores.json, as --json prints it.
/// They equal the files of a single process, except for times, which each process measured. For `render`, the views
/// with all their files are counted. Files that are found to be damaged count as missing.
///
/// Processes that do not share a disk have a folder each: name all of them. If views are missing, the files contain the
/// others and list the missing ones, scores.json has no means, and the exit code is 1.
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
    /// Folder of the joined files; not for `render` [default: the first folder]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// Reads the descriptions of all folders, and checks that they agree with the first.
pub(super) fn prepare(args: &Args) -> Result<Vec<Manifest>> {
    let manifests = args.folders.iter().map(|folder| Manifest::read(folder)).collect::<Result<Vec<_>>>()?;
    for (manifest, folder) in manifests.iter().zip(&args.folders).skip(1) {
        let changes = manifests[0].changes(manifest);
        if !changes.is_empty() {
            bail!(
                "{}: expected results of the same request as {}, found some that differ in {}",
                folder.display(),
                args.folders[0].display(),
                changes.join(" and ")
            );
        }
    }
    Ok(manifests)
}

pub fn run(args: &Args) -> Result<Outcome> {
    let manifests = prepare(args)?;
    let first = &manifests[0];
    let result = |view: usize| {
        // The paths of files outside of a folder are in the folder's own description.
        args.folders.iter().zip(&manifests).find_map(|(folder, own)| {
            let files = own.files.get(view).filter(|files| is_present(folder, files))?;
            Some(folder.join(files.first()?))
        })
    };
    let results: Vec<_> = (0..first.views.len()).into_par_iter().map(result).collect();
    let (mut found, mut missing) = (Vec::new(), Vec::new());
    for (view, (result, name)) in results.into_iter().zip(&first.views).enumerate() {
        match result {
            Some(result) => found.push(result),
            None => missing.push((view, name)),
        }
    }
    say(format!("{} of {} views are present", found.len(), first.views.len()));
    for (_, name) in &missing {
        say(format!("missing: {}", one_line(name)));
    }
    if !found.is_empty() {
        let missing: Vec<usize> = missing.iter().map(|(view, _)| *view).collect();
        join(&manifests, &found, &missing, args)?;
    }
    Ok(if missing.is_empty() { Outcome::Done } else { Outcome::Failed })
}

fn join(manifests: &[Manifest], found: &[PathBuf], missing: &[usize], args: &Args) -> Result<()> {
    let output = args.output.as_ref().unwrap_or(&args.folders[0]);
    let manifest = &manifests[0];
    match manifest.command.as_str() {
        render::COMMAND if args.output.is_some() => {
            Err(Usage("expected no --output for pictures, which stay where they are".into()).into())
        }
        render::COMMAND => Ok(()),
        trade::COMMAND => trade::merge(manifests, parts(found)?, found, output),
        sweep::COMMAND => sweep::merge(&manifest.origin, parts(found)?, &args.folders, output),
        evaluate::COMMAND => evaluate::merge(manifest, parts(found)?, missing, output),
        other => bail!("expected results of render, trade, sweep or evaluate, found those of `{other}`"),
    }
}

fn parts<T: DeserializeOwned>(found: &[PathBuf]) -> Result<Vec<T>> {
    let read = |path: &PathBuf| -> Result<T> {
        let bytes = own_file::read(path).with_context(|| path.display().to_string())?;
        serde_json::from_slice(&bytes).with_context(|| {
            format!(
                "{}: expected results of a view: remove the file, and run its shard again",
                path.display()
            )
        })
    };
    found.iter().map(read).collect()
}
