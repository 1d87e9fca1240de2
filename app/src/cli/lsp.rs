//! Runs `splatgraph lsp`: the language server for editors.

use super::outcome::Outcome;
use crate::lsp;
use anyhow::{Context, Result};
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
    lsp::serve(&connection).context("the editor ended the connection")?;
    // The writer thread ends once its channel is closed.
    drop(connection);
    threads.join().context("standard input or output cannot be used")?;
    Ok(Outcome::Done)
}
