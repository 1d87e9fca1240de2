//! Runs `splatgraph lsp`: the language server for editors.

use super::outcome::Outcome;
use crate::lsp;
use anyhow::{Context, Result, ensure};
use lsp_server::Connection;

const EXAMPLES: &str = "Examples:
  splatgraph lsp                          # an editor runs this; docs/editors.md has settings for VS Code, Helix and Neovim
  splatgraph check my.ron --json          # the same diagnostics, once";

/// Run the language server for editors: errors, completion, values, barriers and renaming
///
/// Speaks the Language Server Protocol on standard input and output, and ends with the editor. No GPU is needed: graphs
/// are built for the least capable supported device and a million splats, as `check` does.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Use standard input and output. This is the only mode; some editors pass the option
    #[arg(long)]
    stdio: bool,
}

pub fn run(_: &Args) -> Result<Outcome> {
    let (connection, threads) = Connection::stdio();
    let is_ended = lsp::serve(&connection).context("the connection to the editor ended")?;
    // The writer thread ends once its channel is closed.
    drop(connection);
    threads.join().context("expected messages of the Language Server Protocol on standard input")?;
    ensure!(is_ended, "expected the request `shutdown` before the end of standard input, found none");
    Ok(Outcome::Done)
}
