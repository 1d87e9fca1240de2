//! Runs `splatgraph completions`: prints the completions of the command line for a shell.

use super::options;
use super::outcome::Outcome;
use anyhow::Result;
use clap_complete::Shell;

/// Print completions of the command line for a shell
///
/// They complete commands, options, values of options with a fixed list of values, such as `--format`, and file names.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  splatgraph completions bash > ~/.local/share/bash-completion/completions/splatgraph
  splatgraph completions fish > ~/.config/fish/completions/splatgraph.fish
  splatgraph completions zsh > ~/.zfunc/_splatgraph        # into a folder of $fpath")]
pub struct Args {
    /// The shell
    shell: Shell,
}

/// Runs the command. `program` defines the program's command line.
pub fn run(args: &Args, mut program: clap::Command) -> Result<Outcome> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut program, "splatgraph", &mut text);
    options::write_text(None, &String::from_utf8(text)?)?;
    Ok(Outcome::Done)
}
