//! Talks to the server as an editor does.

mod answers;
mod diagnostics;

use super::*;
use lsp_server::{Message, RequestId};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::Path;
use std::thread;

const GRAPH: &str = r#"Graph(version: 1, summary: "", output: "picture",
  params: { "width": Const(Int(default: 4, range: (1, 64), label: "ring width")) },
  let: { "words": "2 * width" },
  resources: { "picture": Image(format: "rgba8", size: (8, 8)), "table": Buffer(stride: 4, count: "words + 1") },
  passes: [Dispatch(name: "show", shader: "show.comp", size: Groups(1), bind: { "Table": "table", "picture": "picture" })],
)"#;

const SHADER: &str = "#version 460
layout(set = 0, binding = 0, std430) buffer Table { uint table[]; };
layout(set = 0, binding = 1, rgba8) writeonly uniform image2D picture;
void main() { table[0] = 1; imageStore(picture, ivec2(0), vec4(table[0])); }
";

/// A graph that includes [`GRAPH`], sets its parameter `width`, and uses the parameter in a `let`.
const OUTER: &str = r#"Graph(version: 1, summary: "", output: "copy",
  let: { "half": "width / 2" },
  resources: { "copy": Image(format: "rgba8", size: ("half * 4", 8)) },
  passes: [
    Include(graph: "graph.ron", name: "inner", expose: Only(["width"]), set: { "width": 8 }),
    Dispatch(name: "copy", shader: "copy.comp", size: Groups(1), bind: { "from": "inner.picture", "Table": "inner.table", "to": "copy" }),
  ],
)"#;

const COPY: &str = "#version 460
layout(set = 0, binding = 0, rgba8) readonly uniform image2D from;
layout(set = 0, binding = 1, rgba8) writeonly uniform image2D to;
layout(set = 0, binding = 2, std430) buffer Table { uint table[]; };
void main() { imageStore(to, ivec2(0), imageLoad(from, ivec2(0)) * table[WIDTH]); }
";

struct Editor {
    connection: Connection,
    folder: tempfile::TempDir,
    server: thread::JoinHandle<()>,
    requests: i32,
}

impl Editor {
    fn start() -> Editor {
        Editor::start_with(json!({}))
    }

    fn start_with(capabilities: Value) -> Editor {
        let (server, connection) = Connection::memory();
        let server = thread::spawn(move || assert!(serve(&server).expect("the editor follows the protocol")));
        let folder = tempfile::tempdir().expect("a folder");
        let mut editor = Editor { connection, folder, server, requests: 0 };
        for (name, text) in
            [("graph.ron", GRAPH), ("outer.ron", OUTER), ("show.comp", SHADER), ("copy.comp", COPY)]
        {
            editor.write(name, text);
        }
        let capabilities = editor.request("initialize", json!({ "capabilities": capabilities }));
        assert_eq!(capabilities["capabilities"]["hoverProvider"], true);
        editor.notify("initialized", json!({}));
        editor
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).expect("writable");
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn uri(&self, name: &str) -> String {
        text::uri_of(&self.path(name)).expect("a URI").as_str().to_owned()
    }

    fn notify(&self, method: &str, params: Value) {
        let notification = Notification { method: method.into(), params };
        self.connection.sender.send(notification.into()).expect("the server listens");
    }

    fn request(&mut self, method: &str, params: Value) -> Value {
        let message = self.answer(method, params);
        assert!(message["error"].is_null(), "{message}");
        message["result"].clone()
    }

    fn answer(&mut self, method: &str, params: Value) -> Value {
        self.requests += 1;
        let id = RequestId::from(self.requests);
        let request = Request { id: id.clone(), method: method.into(), params };
        self.connection.sender.send(request.into()).expect("the server listens");
        loop {
            let message =
                serde_json::to_value(self.connection.receiver.recv().expect("an answer")).expect("JSON");
            if message["id"] == self.requests {
                return message;
            }
        }
    }

    fn open(&self, name: &str, text: &str) {
        self.open_at(&self.uri(name), text);
    }

    fn open_at(&self, uri: &str, text: &str) {
        let document = json!({ "uri": uri, "languageId": "ron", "version": 1, "text": text });
        self.notify("textDocument/didOpen", json!({ "textDocument": document }));
    }

    fn change(&self, name: &str, text: &str) {
        let document = json!({ "uri": self.uri(name), "version": 2 });
        let changes = json!([{ "text": text }]);
        self.notify("textDocument/didChange", json!({ "textDocument": document, "contentChanges": changes }));
    }

    fn published(&self) -> (String, Vec<Value>) {
        loop {
            let message = self.connection.receiver.recv().expect("a message");
            if let Message::Notification(Notification { params, .. }) = message {
                let uri = params["uri"].as_str().expect("a URI").to_owned();
                return (uri, params["diagnostics"].as_array().expect("a list").clone());
            }
        }
    }

    /// Removes the mark `|` from a text. Returns the text, and the mark's position in a file.
    fn at(&self, name: &str, marked: &str) -> (String, Value) {
        let text = marked.replacen('|', "", 1);
        let position = text::position_of(&text, marked.find('|').expect("a mark"));
        (text, json!({ "textDocument": { "uri": self.uri(name) }, "position": position }))
    }

    /// Opens a file without its mark `|`. Returns the mark's position.
    fn place(&self, name: &str, marked: &str) -> Value {
        let (text, place) = self.at(name, marked);
        self.open(name, &text);
        place
    }

    /// Returns the text that is shown over a position; empty if there is none.
    fn hover(&mut self, place: Value) -> String {
        let hover = self.request("textDocument/hover", place);
        hover["contents"]["value"].as_str().unwrap_or_default().to_owned()
    }

    /// Renames the name at `place`. Returns the changed files, text by name, or the error message.
    fn renamed(&mut self, mut place: Value, new: &str) -> Result<BTreeMap<String, String>, String> {
        place["newName"] = json!(new);
        let answer = self.answer("textDocument/rename", place);
        if let Some(message) = answer["error"]["message"].as_str() {
            return Err(message.to_owned());
        }
        let changes = answer["result"]["changes"].as_object().expect("changes").clone();
        let apply = |(uri, edits): (String, Value)| {
            let uri: Uri = uri.parse().expect("a URI");
            let path = text::path_of(&uri).expect("a path");
            let mut text = std::fs::read_to_string(&path).expect("a file");
            let mut edits: Vec<lsp_types::TextEdit> = serde_json::from_value(edits).expect("edits");
            edits.sort_by_key(|edit| edit.range.start);
            for edit in edits.iter().rev() {
                let place = |at| text::offset_of(&text, at);
                text.replace_range(place(edit.range.start)..place(edit.range.end), &edit.new_text);
            }
            (path.file_name().expect("a name").to_string_lossy().into_owned(), text)
        };
        Ok(changes.into_iter().map(apply).collect())
    }

    /// Lists the places of a definition, sorted: file, line and column from 0.
    fn defined(&mut self, place: Value) -> Vec<(String, u64, u64)> {
        let found = self.request("textDocument/definition", place);
        let place = |location: &Value| {
            let start = &location["range"]["start"];
            let uri = location["uri"].as_str().expect("a URI");
            let name = uri.rsplit('/').next().expect("a name").to_owned();
            (name, start["line"].as_u64().expect("a line"), start["character"].as_u64().expect("a column"))
        };
        let mut found: Vec<_> = found.as_array().expect("a list").iter().map(place).collect();
        found.sort();
        found
    }

    /// Lists the completions that are offered at a position.
    fn offered(&mut self, place: Value) -> Vec<String> {
        let items = self.request("textDocument/completion", place);
        let items = items.as_array().expect("a list").iter();
        items.map(|item| item["label"].as_str().expect("text").to_owned()).collect()
    }

    fn end(mut self) {
        self.request("shutdown", Value::Null);
        self.notify("exit", Value::Null);
        self.server.join().expect("the server ends");
    }
}
