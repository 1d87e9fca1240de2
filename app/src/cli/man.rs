//! Runs `splatgraph man`: writes the help of all commands as manual pages.

use super::outcome::{Outcome, Usage};
use crate::io::output::{self, OutputGuard, note};
use anyhow::Result;
use clap::Command;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};
use std::path::{Path, PathBuf};

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
    if args.folder == Path::new("-") {
        return Err(Usage("expected a folder for the pages, found `-`".into()).into());
    }
    let mut program = program.disable_help_subcommand(true);
    program.build();
    let mut pages = Vec::new();
    add(program, &mut pages);
    let mut guard = OutputGuard::default();
    let files: Vec<PathBuf> = pages.iter().map(|(page, _)| args.folder.join(page.get_filename())).collect();
    files.iter().try_for_each(|file| guard.output("FOLDER", file)).map_err(Usage::from)?;
    for (file, (page, end)) in files.iter().zip(&pages) {
        output::write(file, |mut out| {
            page.render(&mut out)?;
            Ok(end.to_writer(&mut out)?)
        })?;
    }
    note(format!("written: {} manual pages into {}", pages.len(), args.folder.display()));
    Ok(Outcome::Done)
}

/// Adds the pages of a command and of its subcommands: up to the options, and from there to the end.
fn add(mut command: Command, pages: &mut Vec<(Man, Roff)>) {
    command.get_subcommands().cloned().for_each(|command| add(command, pages));
    // By itself, clap_mangen would list every option without its value, and fill the lines of the examples.
    let usage = command.render_usage().to_string().replacen("Usage: ", "", 1);
    let end = command.get_after_help().map(|text| sections(&text.to_string())).unwrap_or_default();
    let command = command.override_usage(usage).after_help(None::<&str>);
    pages.push((Man::new(command).source(concat!("splatgraph ", env!("CARGO_PKG_VERSION"))), end));
}

/// Converts the text that follows the options in the help. Indented lines are examples and tables, and are not filled.
fn sections(text: &str) -> Roff {
    let mut roff = Roff::new();
    for paragraph in text.split("\n\n") {
        let lines = match paragraph.split_once(":\n") {
            Some((heading, lines)) if !heading.contains('\n') => {
                let title = match heading {
                    "Exit codes" => "EXIT STATUS",
                    "Environment variables" => "ENVIRONMENT",
                    _ => &heading.to_uppercase(),
                };
                roff.control("SH", [title]);
                lines
            }
            _ => {
                roff.control("PP", []);
                paragraph
            }
        };
        match lines.starts_with(' ') {
            true => roff.control("EX", []).text([roman(lines)]).control("EE", []),
            false => roff.text([roman(lines)]),
        };
    }
    roff
}
