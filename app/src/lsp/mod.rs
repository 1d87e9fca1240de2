//! The language server: what an editor shows while a graph or a shader is typed.
//!
//! Diagnostics are those of `splatgraph check`, without the replay of barriers. Graphs that are open are built anew after
//! each change of a file that is open, with the editor's text in place of the file's. [`cursor`] tells what a text in a graph means, [`graph`] builds
//! graphs and answers, [`text`] converts positions and names of files.

mod cursor;
mod graph;
#[cfg(test)]
mod tests;
mod text;

use anyhow::Result;
use graph::Workspace;
use lsp_server::{Connection, ErrorCode, Message, Notification, Request, Response};
use lsp_types::notification::{
    DidChangeTextDocument, DidCloseTextDocument, DidOpenTextDocument, Notification as _, PublishDiagnostics,
};
use lsp_types::request::{Completion, HoverRequest, Request as _};
use lsp_types::{
    CompletionOptions, CompletionParams, CompletionResponse, Diagnostic, DidChangeTextDocumentParams,
    DidCloseTextDocumentParams, DidOpenTextDocumentParams, HoverParams, HoverProviderCapability,
    PublishDiagnosticsParams, ServerCapabilities, TextDocumentPositionParams, TextDocumentSyncCapability,
    TextDocumentSyncKind, Uri,
};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Answers an editor until it ends the connection.
///
/// # Errors
/// The editor does not follow the protocol, or ends without a word.
pub fn serve(connection: &Connection) -> Result<()> {
    let capabilities = ServerCapabilities {
        text_document_sync: Some(TextDocumentSyncCapability::Kind(TextDocumentSyncKind::FULL)),
        completion_provider: Some(CompletionOptions {
            trigger_characters: Some(vec!["\"".into(), ".".into()]),
            ..CompletionOptions::default()
        }),
        hover_provider: Some(HoverProviderCapability::Simple(true)),
        ..ServerCapabilities::default()
    };
    connection.initialize(serde_json::to_value(capabilities)?)?;
    let mut server = Server::default();
    for message in &connection.receiver {
        match message {
            Message::Request(request) if connection.handle_shutdown(&request)? => return Ok(()),
            Message::Request(request) => {
                connection.sender.send(server.answer(request).into())?;
            }
            Message::Notification(notification) => server.note(notification)?,
            Message::Response(_) => {}
        }
        // Typing is faster than building: only the last of the waiting texts is built.
        if server.changed && connection.receiver.is_empty() {
            for published in server.published_after_a_change() {
                let method = PublishDiagnostics::METHOD.to_owned();
                connection.sender.send(Notification::new(method, published).into())?;
            }
        }
    }
    Ok(())
}

/// The state of a connection.
#[derive(Default)]
struct Server {
    /// The texts that the editor holds.
    open: BTreeMap<PathBuf, String>,
    /// A text changed since the last build.
    changed: bool,
    workspace: Workspace,
    /// The diagnostics that the editor shows, by file.
    shown: BTreeMap<PathBuf, Vec<Diagnostic>>,
}

impl Server {
    fn note(&mut self, notification: Notification) -> Result<()> {
        let params = notification.params;
        match notification.method.as_str() {
            DidOpenTextDocument::METHOD => {
                let document = serde_json::from_value::<DidOpenTextDocumentParams>(params)?.text_document;
                self.set(&document.uri, Some(document.text));
            }
            DidChangeTextDocument::METHOD => {
                let mut change = serde_json::from_value::<DidChangeTextDocumentParams>(params)?;
                // The whole text, as the capabilities ask for.
                if let Some(last) = change.content_changes.pop() {
                    self.set(&change.text_document.uri, Some(last.text));
                }
            }
            DidCloseTextDocument::METHOD => {
                let closed: DidCloseTextDocumentParams = serde_json::from_value(params)?;
                self.set(&closed.text_document.uri, None);
            }
            _ => {}
        }
        Ok(())
    }

    fn set(&mut self, uri: &Uri, text: Option<String>) {
        // What has no path, such as a file that was never saved, has no folder for its shaders either.
        let Some(path) = text::path_of(uri) else { return };
        match text {
            Some(text) => drop(self.open.insert(path, text)),
            None => drop(self.open.remove(&path)),
        }
        self.changed = true;
    }

    /// Builds the open graphs, and lists the files whose diagnostics changed.
    fn published_after_a_change(&mut self) -> Vec<PublishDiagnosticsParams> {
        self.changed = false;
        let found = self.workspace.diagnostics(&self.open);
        let gone = self.shown.keys().filter(|path| !found.contains_key(*path)).cloned().collect::<Vec<_>>();
        let cleared = gone.into_iter().map(|path| (path, Vec::new()));
        let changed = found.iter().filter(|(path, all)| self.shown.get(*path) != Some(*all));
        let changed = changed.map(|(path, all)| (path.clone(), all.clone()));
        let published = changed.chain(cleared).filter_map(|(path, diagnostics)| {
            Some(PublishDiagnosticsParams { uri: text::uri_of(&path)?, diagnostics, version: None })
        });
        let published = published.collect();
        self.shown = found;
        published
    }

    fn answer(&mut self, request: Request) -> Response {
        let id = request.id;
        let result = match request.method.as_str() {
            Completion::METHOD => serde_json::from_value::<CompletionParams>(request.params)
                .map(|params| self.completion(&params.text_document_position))
                .and_then(serde_json::to_value),
            HoverRequest::METHOD => serde_json::from_value::<HoverParams>(request.params)
                .map(|params| {
                    let (path, text, offset) = self.place(&params.text_document_position_params)?;
                    self.workspace.hover(&path, &text, offset)
                })
                .and_then(serde_json::to_value),
            method => {
                let message = format!("the method {method} is not offered");
                return Response::new_err(id, ErrorCode::MethodNotFound as i32, message);
            }
        };
        match result {
            Ok(result) => Response::new_ok(id, result),
            Err(error) => Response::new_err(id, ErrorCode::InvalidParams as i32, error.to_string()),
        }
    }

    fn completion(&mut self, at: &TextDocumentPositionParams) -> CompletionResponse {
        let items =
            self.place(at).map(|(path, text, offset)| self.workspace.completion(&path, &text, offset));
        CompletionResponse::Array(items.unwrap_or_default())
    }

    /// The file, its text and the byte of a position in a graph that is open.
    fn place(&self, at: &TextDocumentPositionParams) -> Option<(PathBuf, String, usize)> {
        let path = text::path_of(&at.text_document.uri)?;
        let text = self.open.get(&path).filter(|_| graph::is_graph(&path))?.clone();
        let offset = text::offset_of(&text, at.position);
        Some((path, text, offset))
    }
}
