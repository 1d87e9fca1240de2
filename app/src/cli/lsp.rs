//! Runs `splatgraph lsp`: the language server for editors.

use super::Outcome;
use crate::lsp;
use anyhow::{Context, Result};
use lsp_server::Connection;

pub const EXAMPLES: &str = "Examples:
  splatgraph lsp                          # an editor runs this; docs/editors.md has settings for VS Code, Helix and Neovim
  splatgraph check my.ron --json          # the same diagnostics, once";

/// Serve an editor: errors, completion, values, barriers and renaming while a graph is typed
///
/// It speaks the Language Server Protocol on standard input and output, and ends with the editor. No GPU is needed: graphs are
/// built for the smallest supported device and a million splats, as `check` does.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Speak on standard input and output, as always; some editors add this
    #[arg(long)]
    stdio: bool,
}

pub fn run(_: &Args) -> Result<Outcome> {
    let (connection, threads) = Connection::stdio();
    lsp::serve(&connection).context("the editor ended the connection")?;
    // The writer ends when nobody can send to it any more.
    drop(connection);
    threads.join().context("standard input or output cannot be used")?;
    Ok(Outcome::Done)
}
