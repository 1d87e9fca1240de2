//! Runs `splatgraph man`: writes the help of all commands as manual pages.

use super::outcome::{Outcome, Usage};
use crate::io::output::{self, OutputGuard, note};
use anyhow::Result;
use clap::Command;
use clap_mangen::Man;
use std::path::PathBuf;

/// Write the help of all commands as manual pages
///
/// The pages are called splatgraph.1, splatgraph-render.1 and so on, and replace files of these names.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph man ~/.local/share/man/man1
  man splatgraph-render")]
pub struct Args {
    /// The folder to write into; created if it does not exist
    folder: PathBuf,
}

/// Runs the command. `program` defines the program's command line.
pub fn run(args: &Args, program: Command) -> Result<Outcome> {
    let mut program = program.disable_help_subcommand(true);
    program.build();
    let mut pages = Vec::new();
    add(program, &mut pages);
    let mut guard = OutputGuard::default();
    let files: Vec<PathBuf> = pages.iter().map(|page| args.folder.join(page.get_filename())).collect();
    files.iter().try_for_each(|file| guard.output("FOLDER", file)).map_err(Usage::from)?;
    for (file, page) in files.iter().zip(&pages) {
        output::write(file, |mut out| Ok(page.render(&mut out)?))?;
    }
    note(format!("written: {} manual pages into {}", pages.len(), args.folder.display()));
    Ok(Outcome::Done)
}

/// Adds the pages of a command and of its subcommands.
fn add(command: Command, pages: &mut Vec<Man>) {
    command.get_subcommands().cloned().for_each(|command| add(command, pages));
    pages.push(Man::new(command).source(concat!("splatgraph ", env!("CARGO_PKG_VERSION"))));
}
