//! Implements the language server: errors, completion and hints while a graph or a shader is edited.
//!
//! Diagnostics are the errors and warnings of `splatgraph check` for two subgroup sizes, without the replay of
//! barriers. A change rebuilds the open graphs that depend on the file, and closed graphs that use an open shader or
//! part. For open files, the editor's text replaces that on the disk.

mod complete;
mod cursor;
mod files;
mod graph;
mod hints;
mod index;
mod names;
mod rename;
mod scopes;
#[cfg(test)]
mod tests;
mod text;

use anyhow::{Result, ensure};
pub use files::nominal_catalog;
use graph::Workspace;
pub use graph::warn_of_unused;
use lsp_server::{Connection, ErrorCode, Message, Notification, Request, Response};
use lsp_types::notification::{
    DidChangeTextDocument, DidChangeWatchedFiles, DidCloseTextDocument, DidOpenTextDocument, Exit,
    LogMessage, Notification as _, PublishDiagnostics,
};
use lsp_types::request::{
    Completion, GotoDefinition, HoverRequest, InlayHintRefreshRequest, InlayHintRequest,
    PrepareRenameRequest, References, RegisterCapability, Rename, Request as _, Shutdown,
};
use lsp_types::{
    CompletionOptions, CompletionParams, CompletionResponse, Diagnostic, DidChangeTextDocumentParams,
    DidChangeWatchedFilesParams, DidCloseTextDocumentParams, DidOpenTextDocumentParams, GotoDefinitionParams,
    HoverParams, HoverProviderCapability, InitializeParams, InlayHint, InlayHintParams, LogMessageParams,
    MessageType, OneOf, PrepareRenameResponse, PublishDiagnosticsParams, ReferenceParams, RenameOptions,
    RenameParams, ServerCapabilities, TextDocumentPositionParams, TextDocumentSyncCapability,
    TextDocumentSyncKind, Uri,
};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Pause after a change before it is built. A build is slower than typing, so changes in quick succession are built
/// once.
const QUIET: Duration = Duration::from_millis(30);

/// Answers an editor until it ends the connection. Returns false if the messages ended before the request `shutdown`.
///
/// # Errors
/// The editor violates the protocol, or sends `exit` before it requests `shutdown`.
pub fn serve(connection: &Connection) -> Result<bool> {
    let capabilities = ServerCapabilities {
        text_document_sync: Some(TextDocumentSyncCapability::Kind(TextDocumentSyncKind::FULL)),
        completion_provider: Some(CompletionOptions {
            trigger_characters: Some(vec!["\"".into(), ".".into()]),
            ..CompletionOptions::default()
        }),
        hover_provider: Some(HoverProviderCapability::Simple(true)),
        definition_provider: Some(OneOf::Left(true)),
        references_provider: Some(OneOf::Left(true)),
        rename_provider: Some(OneOf::Right(RenameOptions {
            prepare_provider: Some(true),
            work_done_progress_options: Default::default(),
        })),
        inlay_hint_provider: Some(OneOf::Left(true)),
        ..ServerCapabilities::default()
    };
    let editor = match connection.initialize(serde_json::to_value(capabilities)?) {
        Err(error) if error.channel_is_disconnected() => return Ok(false),
        editor => serde_json::from_value::<InitializeParams>(text::with_strict_uris(editor?))?,
    };
    let workspace = editor.capabilities.workspace.unwrap_or_default();
    if workspace.did_change_watched_files.is_some_and(|watched| watched.dynamic_registration == Some(true)) {
        connection.sender.send(registration().into())?;
    }
    let mut server = Server {
        workspace: Workspace::default(),
        shown: BTreeMap::new(),
        build_at: Instant::now(),
        refreshes: workspace.inlay_hint.filter(|hints| hints.refresh_support == Some(true)).map(|_| 0),
        is_shut_down: false,
    };
    let folders = editor.workspace_folders.iter().flatten().filter_map(|folder| text::path_of(&folder.uri));
    server.workspace.folders = folders.map(|folder| files::canonical(&folder)).collect();
    loop {
        let received = match server.workspace.is_settled {
            true => connection.receiver.recv().map_err(Into::into),
            // Waiting messages are handled before the next graph is built.
            false => connection.receiver.recv_deadline(server.build_at),
        };
        match received {
            Err(error) if error.is_timeout() => server.build_next(connection)?,
            Err(_) => return Ok(server.is_shut_down),
            Ok(message) => {
                if server.take(message, connection)? {
                    return Ok(true);
                }
            }
        }
    }
}

/// Returns the request to report changes of graphs and shaders, because a shader can change without being open.
fn registration() -> Request {
    let options = json!({ "watchers": [{ "globPattern": "**/*.{ron,comp,vert,frag,glsl}" }] });
    let method = DidChangeWatchedFiles::METHOD;
    let registrations =
        json!({ "registrations": [{ "id": method, "method": method, "registerOptions": options }] });
    Request::new(method.to_owned().into(), RegisterCapability::METHOD.to_owned(), registrations)
}

type Answer = Result<Value, (ErrorCode, String)>;

/// Parses the parameters of a request, calls `answer`, and serialises its result.
fn answered<P: DeserializeOwned, R: serde::Serialize>(
    params: Value,
    answer: impl FnOnce(P) -> Result<R, String>,
) -> Answer {
    let params = serde_json::from_value(params);
    let params = params.map_err(|error| (ErrorCode::InvalidParams, error.to_string()))?;
    let result = answer(params).map_err(|message| (ErrorCode::RequestFailed, message))?;
    serde_json::to_value(result).map_err(|error| (ErrorCode::InternalError, error.to_string()))
}

struct Server {
    workspace: Workspace,
    /// Diagnostics that the editor shows, by file.
    shown: BTreeMap<PathBuf, Vec<Diagnostic>>,
    /// Earliest time of the next build: a pause after the last change.
    build_at: Instant,
    /// Number of requests to the editor to read the hints again; `None` if it does not support them.
    refreshes: Option<i32>,
    /// True after the request `shutdown`.
    is_shut_down: bool,
}

impl Server {
    /// Handles a message; returns true if it ended the connection.
    fn take(&mut self, message: Message, connection: &Connection) -> Result<bool> {
        match message {
            Message::Request(Request { id, .. }) if self.is_shut_down => {
                let message = "expected the notification `exit` after `shutdown`, found a request".to_owned();
                let refused = Response::new_err(id, ErrorCode::InvalidRequest as i32, message);
                connection.sender.send(refused.into())?;
            }
            Message::Request(request) if request.method == Shutdown::METHOD => {
                self.is_shut_down = true;
                // No further graphs are built.
                self.workspace.is_settled = true;
                connection.sender.send(Response::new_ok(request.id, ()).into())?;
            }
            Message::Request(request) => connection.sender.send(self.answer(request).into())?,
            Message::Notification(Notification { method, .. }) if method == Exit::METHOD => {
                ensure!(self.is_shut_down, "expected the request `shutdown` before `exit`, found none");
                return Ok(true);
            }
            Message::Notification(notification) if !self.is_shut_down => {
                let method = notification.method.clone();
                if let Err(error) = self.note(notification) {
                    let message = format!("expected the parameters of {method}, found others: {error}");
                    let log = LogMessageParams { typ: MessageType::WARNING, message };
                    connection.sender.send(Notification::new(LogMessage::METHOD.to_owned(), log).into())?;
                }
            }
            Message::Notification(_) | Message::Response(_) => {}
        }
        Ok(false)
    }

    /// Builds the next graph, if any, and sends the diagnostics that changed. After the last graph, asks an editor that
    /// supports this to read the hints again, because the hints of a file depend on other files, too.
    fn build_next(&mut self, connection: &Connection) -> Result<()> {
        self.workspace.is_settled = !self.workspace.build_next();
        if self.workspace.is_settled
            && std::mem::take(&mut self.workspace.has_built)
            && let Some(count) = &mut self.refreshes
        {
            *count += 1;
            let method = InlayHintRefreshRequest::METHOD.to_owned();
            let id = format!("{method} {count}");
            connection.sender.send(Request::new(id.into(), method, Value::Null).into())?;
        }
        for published in self.changed_diagnostics() {
            let method = PublishDiagnostics::METHOD.to_owned();
            connection.sender.send(Notification::new(method, published).into())?;
        }
        Ok(())
    }

    /// Records an opened, changed, closed or watched file; ignores other notifications. An error changes nothing.
    fn note(&mut self, notification: Notification) -> serde_json::Result<()> {
        let params = text::with_strict_uris(notification.params);
        match notification.method.as_str() {
            DidOpenTextDocument::METHOD => {
                let document = serde_json::from_value::<DidOpenTextDocumentParams>(params)?.text_document;
                self.set(&document.uri, Some(document.text));
            }
            DidChangeTextDocument::METHOD => {
                let mut change = serde_json::from_value::<DidChangeTextDocumentParams>(params)?;
                // The capabilities ask for full sync, so a change is the whole text.
                if let Some(last) = change.content_changes.pop() {
                    self.set(&change.text_document.uri, Some(last.text));
                }
            }
            DidCloseTextDocument::METHOD => {
                let closed: DidCloseTextDocumentParams = serde_json::from_value(params)?;
                self.set(&closed.text_document.uri, None);
            }
            DidChangeWatchedFiles::METHOD => {
                let changes = serde_json::from_value::<DidChangeWatchedFilesParams>(params)?.changes;
                for path in changes.iter().filter_map(|change| text::path_of(&change.uri)) {
                    // The server reads an open file from the editor, not from the disk.
                    if !self.workspace.open.contains_key(&path) {
                        self.workspace.changed(&path);
                        self.build_at = Instant::now() + QUIET;
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn set(&mut self, uri: &Uri, text: Option<String>) {
        // A document without a path, such as an unsaved one, has no folder to find its shaders in.
        let Some(path) = text::path_of(uri) else { return };
        // Positions count from after the byte order mark, as in a file on disk.
        let text = text.map(|text| text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text));
        self.workspace.set(path, text);
        self.build_at = Instant::now() + QUIET;
    }

    /// Lists the diagnostics of the files in which they changed, and records them as shown.
    fn changed_diagnostics(&mut self) -> Vec<PublishDiagnosticsParams> {
        let mut found = self.workspace.diagnostics();
        // The graph that gave these diagnostics was dropped, and is built again later.
        let waiting = self.shown.iter().filter(|(path, _)| self.workspace.is_waiting(path));
        found.extend(waiting.map(|(path, shown)| (path.clone(), shown.clone())));
        let gone = self.shown.keys().filter(|path| !found.contains_key(*path)).cloned().collect::<Vec<_>>();
        // Files with diagnostics of queued graphs are published once those graphs are built.
        let outdated =
            found.keys().filter(|path| self.workspace.is_outdated(path)).cloned().collect::<Vec<_>>();
        for path in outdated {
            match self.shown.get(&path) {
                Some(shown) => drop(found.insert(path, shown.clone())),
                None => drop(found.remove(&path)),
            }
        }
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
        let params = text::with_strict_uris(request.params);
        let result = match request.method.as_str() {
            Completion::METHOD => answered(params, |params: CompletionParams| {
                let place = self.place(&params.text_document_position);
                let items = place.map(|(path, offset)| self.workspace.completion(&path, offset));
                Ok(CompletionResponse::Array(items.unwrap_or_default()))
            }),
            HoverRequest::METHOD => answered(params, |params: HoverParams| {
                let place = self.place(&params.text_document_position_params);
                Ok(place.and_then(|(path, offset)| self.workspace.hover(&path, offset)))
            }),
            GotoDefinition::METHOD => answered(params, |params: GotoDefinitionParams| {
                let Some((path, offset)) = self.place(&params.text_document_position_params) else {
                    return Ok(Vec::new());
                };
                Ok(self.workspace.definitions(&path, offset))
            }),
            References::METHOD => answered(params, |params: ReferenceParams| {
                let Some((path, offset)) = self.place(&params.text_document_position) else {
                    return Ok(Vec::new());
                };
                Ok(self.workspace.references(&path, offset, params.context.include_declaration))
            }),
            PrepareRenameRequest::METHOD => answered(params, |params: TextDocumentPositionParams| {
                let place = self.place(&params);
                let name = place.and_then(|(path, offset)| self.workspace.renamed_name(&path, offset));
                Ok(name.map(|(range, placeholder)| PrepareRenameResponse::RangeWithPlaceholder {
                    range,
                    placeholder,
                }))
            }),
            Rename::METHOD => answered(params, |params: RenameParams| {
                let Some((path, offset)) = self.place(&params.text_document_position) else {
                    return Err("expected a file open in the editor, found another".to_owned());
                };
                let files = self.workspace.rename(&path, offset, &params.new_name)?;
                let changes = files.into_iter().map(|(uri, edits)| (uri.as_str().to_owned(), json!(edits)));
                Ok(json!({ "changes": changes.collect::<serde_json::Map<_, _>>() }))
            }),
            InlayHintRequest::METHOD => answered(params, |params: InlayHintParams| Ok(self.hints(&params))),
            method => Err((ErrorCode::MethodNotFound, format!("method {method} is not supported"))),
        };
        match result {
            Ok(result) => Response::new_ok(id, result),
            Err((code, message)) => Response::new_err(id, code as i32, message),
        }
    }

    fn hints(&mut self, params: &InlayHintParams) -> Vec<InlayHint> {
        let Some(path) = text::path_of(&params.text_document.uri) else { return Vec::new() };
        hints::within(self.workspace.hints(&path), params.range.start.line, params.range.end.line)
    }

    /// Resolves a position in an open file to the file's path and the byte offset; `None` if the file is not open.
    fn place(&mut self, at: &TextDocumentPositionParams) -> Option<(PathBuf, usize)> {
        // Closed files may have changed on the disk, and not every editor reports this.
        self.workspace.planner.forget_files();
        let path = text::path_of(&at.text_document.uri)?;
        let offset = text::offset_of(self.workspace.open.get(&path)?, at.position);
        Some((path, offset))
    }
}
