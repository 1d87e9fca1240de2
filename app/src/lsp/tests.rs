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

#[test]
fn a_mistake_is_shown_as_it_is_typed_and_goes_when_it_is_mended() {
    let editor = Editor::start();
    editor.open("graph.ron", GRAPH);
    assert_eq!(editor.published(), (editor.uri("graph.ron"), vec![]));
    editor.change("graph.ron", &GRAPH.replace("\"Table\": \"table\"", "\"Table\": \"tabel\""));
    let (uri, found) = editor.published();
    assert_eq!(uri, editor.uri("graph.ron"));
    let message = found[0]["message"].as_str().expect("text");
    assert_eq!(message, "there is no resource `tabel`: not declared\nhelp: did you mean `table`?");
    let line = GRAPH.lines().nth(4).expect("a line");
    let character = line.find("\"table\"").expect("there") + 1;
    assert_eq!(found[0]["range"]["start"], json!({ "line": 4, "character": character }));
    assert_eq!(found[0]["range"]["end"], json!({ "line": 4, "character": character + 5 }));
    editor.change("graph.ron", GRAPH);
    assert_eq!(editor.published(), (editor.uri("graph.ron"), vec![]));
    editor.end();
}

#[test]
fn a_mistake_in_the_text_of_a_shader_that_is_not_saved_is_shown_in_the_shader() {
    let editor = Editor::start();
    editor.open("graph.ron", GRAPH);
    assert!(editor.published().1.is_empty());
    editor.open("show.comp", &SHADER.replace("vec4(table[0])", "vec4(tabel[0])"));
    let (uri, found) = editor.published();
    assert_eq!(uri, editor.uri("show.comp"));
    assert_eq!(
        (&found[0]["range"]["start"]["line"], &found[0]["severity"]),
        (&json!(3), &json!(1)),
        "{found:?}"
    );
    // Closing the file discards the editor's text. The file on disk has no error.
    editor.notify("textDocument/didClose", json!({ "textDocument": { "uri": uri } }));
    assert_eq!(editor.published(), (editor.uri("show.comp"), vec![]));
    editor.end();
}

#[test]
fn a_uri_with_brackets_that_the_editor_left_as_they_are_names_its_file() {
    let mut editor = Editor::start();
    let name = "a[1]|^ {ä}.ron";
    editor.write(name, GRAPH);
    let uri = format!("file://{}", editor.path(name).display());
    editor.open_at(&uri, GRAPH);
    assert_eq!(editor.published(), (editor.uri(name), vec![]));
    let position = text::position_of(GRAPH, GRAPH.find("2 * width").expect("there") + 4);
    let place = json!({ "textDocument": { "uri": uri }, "position": position });
    let hover = editor.hover(place);
    assert!(hover.starts_with("`width`: "), "{hover}");
    editor.end();
}

#[test]
fn a_notification_that_cannot_be_parsed_is_logged_and_changes_nothing() {
    let editor = Editor::start();
    editor.open_at("file:///100%.ron", "");
    let Message::Notification(log) = editor.connection.receiver.recv().expect("a message") else {
        panic!("the server logs what it ignores");
    };
    assert_eq!((log.method.as_str(), &log.params["type"]), ("window/logMessage", &json!(2)));
    let message = log.params["message"].as_str().expect("text");
    assert!(
        message.starts_with("expected the parameters of textDocument/didOpen, found others: "),
        "{message}"
    );
    editor.open("graph.ron", GRAPH);
    assert_eq!(editor.published(), (editor.uri("graph.ron"), vec![]));
    editor.end();
}

#[test]
fn a_shader_that_changes_on_the_disk_is_checked_again() {
    let editor = Editor::start_with(json!({
        "workspace": { "didChangeWatchedFiles": { "dynamicRegistration": true } },
    }));
    let Message::Request(request) = editor.connection.receiver.recv().expect("a message") else {
        panic!("the server asks for the changes of files");
    };
    assert_eq!(request.method, "client/registerCapability");
    assert_eq!(request.params["registrations"][0]["method"], "workspace/didChangeWatchedFiles");
    editor.open("graph.ron", GRAPH);
    assert!(editor.published().1.is_empty());
    for (text, count) in [(SHADER.replace("vec4(table[0])", "vec4(tabel[0])"), 1), (SHADER.to_owned(), 0)] {
        editor.write("show.comp", &text);
        let changes = json!([{ "uri": editor.uri("show.comp"), "type": 2 }]);
        editor.notify("workspace/didChangeWatchedFiles", json!({ "changes": changes }));
        let (uri, found) = editor.published();
        assert_eq!((uri, found.len()), (editor.uri("show.comp"), count));
    }
    editor.end();
}

#[test]
fn blocks_resources_names_and_formats_are_offered_where_each_can_stand() {
    let mut editor = Editor::start();
    editor.open("graph.ron", GRAPH);
    assert!(editor.published().1.is_empty());
    let mut offered = |from: &str, to: &str| {
        let (text, place) = editor.at("graph.ron", &GRAPH.replacen(from, to, 1));
        editor.change("graph.ron", &text);
        editor.offered(place)
    };
    assert_eq!(offered("\"Table\": \"table\"", "\"|"), ["Table", "picture"]);
    let resources = offered("\"Table\": \"table\"", "\"Table\": \"ta|\"");
    assert_eq!(resources, ["picture", "table"]);
    let names = offered("words + 1", "words + sce|");
    for name in ["width", "words", "scene.count", "viewport.width", "device.subgroup_size"] {
        assert!(names.iter().any(|other| other == name), "{name} is not in {names:?}");
    }
    assert_eq!(offered("rgba8", "|")[..2], ["depth32f", "r32f"]);
    let shaders = offered("show.comp", "|");
    assert!(shaders.iter().any(|s| s == "show.comp") && shaders.iter().any(|s| s == "sort/scatter.comp"));
    assert!(shaders.iter().all(|s| s.ends_with(".comp")), "{shaders:?}");
    let shaders =
        offered("Dispatch(name: \"show\", shader: \"show.comp\"", "Draw(name: \"show\", vertex: \"|\"");
    assert!(!shaders.is_empty() && shaders.iter().all(|s| s.ends_with(".vert")), "{shaders:?}");
    editor.end();
}

#[test]
fn a_completion_replaces_the_name_around_the_cursor_and_no_other() {
    let mut editor = Editor::start();
    editor.open("graph.ron", GRAPH);
    assert!(editor.published().1.is_empty());
    for (from, marked, name, after) in [
        ("words + 1", "wo|rds + 1", "width", "width + 1"),
        (": \"table\"", ": \"width > 5 ? 'picture' : 'ta|ble'\"", "table", "width > 5 ? 'picture' : 'table'"),
        (": \"table\"", ": \"wi| > 5 ? 'picture' : 'table'\"", "words", "words > 5 ? 'picture' : 'table'"),
        (": \"table\"", ": \"front(ta|b)\"", "table", "front(table)"),
        (
            "show.comp",
            "width > 5 ? 'sort/sc|.comp' : 'show.comp'",
            "show.comp",
            "width > 5 ? 'show.comp' : 'show.comp'",
        ),
        ("show.comp\"", "sh| , size", "show.comp", "\"show.comp , size"),
    ] {
        let (text, place) = editor.at("graph.ron", &GRAPH.replacen(from, marked, 1));
        editor.change("graph.ron", &text);
        let items = editor.request("textDocument/completion", place);
        let item = items.as_array().expect("a list").iter().find(|item| item["label"] == name);
        let edit = item.unwrap_or_else(|| panic!("{name} is not in {items}"))["textEdit"].clone();
        let edit: lsp_types::TextEdit = serde_json::from_value(edit).expect("an edit");
        let mut edited = text.clone();
        let at = |position| text::offset_of(&text, position);
        edited.replace_range(at(edit.range.start)..at(edit.range.end), &edit.new_text);
        assert!(edited.contains(after), "{marked}: {edited}");
    }
    editor.end();
}

#[test]
fn names_are_offered_in_a_graph_that_was_never_valid() {
    let mut editor = Editor::start();
    let broken = GRAPH.replace("stride: 4", "stride: ");
    let place = editor.place("graph.ron", &broken.replace(": \"table\"", ": \"ta|ble\""));
    assert_eq!(editor.offered(place), ["picture", "table"]);
    let place = editor.at("graph.ron", &broken.replace("words + 1", "wo|rds + 1")).1;
    let names = editor.offered(place);
    for name in ["width", "words", "scene.count"] {
        assert!(names.iter().any(|other| other == name), "{name} is not in {names:?}");
    }
    editor.end();
}

#[test]
fn a_shader_and_a_part_that_are_open_alone_are_checked_with_a_closed_graph() {
    let editor = Editor::start();
    let broken = SHADER.replace("vec4(table[0])", "vec4(tabel[0])");
    editor.open("show.comp", &broken);
    let (uri, found) = editor.published();
    assert_eq!((uri, found.len()), (editor.uri("show.comp"), 1));
    editor.change("show.comp", SHADER);
    assert_eq!(editor.published(), (editor.uri("show.comp"), vec![]));
    editor.end();

    let editor = Editor::start();
    let part = GRAPH.replace("resources: {", "ports: { \"to\": Image(format: \"rgba8\") }, resources: {");
    let outer = OUTER.replace("name: \"inner\",", "name: \"inner\", with: { \"to\": \"copy\" },");
    editor.write("outer.ron", &outer);
    editor.open("graph.ron", &part.replace("words + 1", "wrods + 1"));
    assert_eq!(editor.published(), (editor.uri("graph.ron"), vec![]));
    let (uri, found) = editor.published();
    let message = found[0]["message"].as_str().expect("text");
    assert_eq!(uri, editor.uri("graph.ron"));
    assert!(message.contains("wrods"), "{message}");
    editor.end();
}

#[test]
fn new_files_are_checked_before_they_are_saved() {
    let editor = Editor::start();
    editor.open("new.ron", &GRAPH.replace("show.comp", "new.comp"));
    let (uri, found) = editor.published();
    assert_eq!((uri, found.len()), (editor.uri("new.ron"), 1), "{found:?}");
    editor.open("new.comp", &SHADER.replace("vec4(table[0])", "vec4(tabel[0])"));
    let found = BTreeMap::from([editor.published(), editor.published()]);
    assert!(found[&editor.uri("new.ron")].is_empty(), "{found:?}");
    assert_eq!(found[&editor.uri("new.comp")][0]["range"]["start"]["line"], 3);
    editor.end();
}

#[test]
fn ron_that_is_no_graph_has_no_errors() {
    let editor = Editor::start();
    for (name, text) in [
        ("scenes.ron", "Scenes([Scene(file: \"garden.ply\")])"),
        ("settings.ron", "#![enable(implicit_some)]\n(window: (width: 3))"),
    ] {
        editor.open(name, text);
        assert_eq!(editor.published(), (editor.uri(name), vec![]));
    }
    editor.open("typo.ron", &GRAPH.replace("Graph(", "Grahp("));
    let (uri, found) = editor.published();
    assert_eq!((uri, found.len()), (editor.uri("typo.ron"), 1));
    editor.open("marked.ron", &format!("\u{feff}{GRAPH}"));
    assert_eq!(editor.published(), (editor.uri("marked.ron"), vec![]));
    editor.end();
}

#[test]
fn after_shutdown_requests_are_refused_and_other_messages_ignored() {
    let mut editor = Editor::start();
    editor.request("shutdown", Value::Null);
    let response = lsp_server::Response::new_ok(RequestId::from("client/registerCapability".to_owned()), ());
    editor.connection.sender.send(response.into()).expect("the server listens");
    editor.open("graph.ron", GRAPH);
    let refused = editor.answer("textDocument/hover", Value::Null);
    assert_eq!(refused["error"]["code"], -32600);
    editor.notify("exit", Value::Null);
    editor.server.join().expect("the server ends");
}

#[test]
fn hovering_tells_the_value_of_a_name_and_of_the_expression_around_it() {
    let mut editor = Editor::start();
    editor.open("graph.ron", GRAPH);
    assert!(editor.published().1.is_empty());
    let mut told = |from: &str, to: &str| {
        let (_, place) = editor.at("graph.ron", &GRAPH.replacen(from, to, 1));
        editor.hover(place)
    };
    let words = told("words + 1", "wo|rds + 1");
    assert!(words.starts_with("`words` = 8\n\n`words + 1` = 9\n\n*for 1,000,000 splats"), "{words}");
    let width = told("2 * width", "2 * wi|dth");
    assert!(
        width.starts_with("`width`: a constant parameter, here 4. ring width\n\n`2 * width` = 8"),
        "{width}"
    );
    let table = told("\"Table\": \"table\"", "\"Table\": \"ta|ble\"");
    assert!(table.starts_with("`table`: a buffer of 9 x 4 bytes"), "{table}");
    let declared = told("\"words\": ", "\"wo|rds\": ");
    assert!(declared.starts_with("`words` = 8"), "{declared}");
    // The name of a shader's block, and free texts, are no names of the graph.
    for (from, to) in [
        ("summary: \"\"", "summary: \"|\""),
        ("\"picture\": \"picture\"", "\"pic|ture\": \"picture\""),
        ("summary: \"\"", "summary: \"the ta|ble\""),
        ("ring width", "ring wi|dth"),
    ] {
        assert_eq!(told(from, to), "", "{to}");
    }
    editor.end();
}

#[test]
fn a_graph_whose_requirements_the_nominal_device_does_not_meet_is_checked_all_the_same() {
    let editor = Editor::start();
    let needy = GRAPH.replace("summary: \"\",", "summary: \"\", require: [(\"device.int64\", \"longs\")],");
    editor.open("graph.ron", &needy);
    assert_eq!(editor.published(), (editor.uri("graph.ron"), vec![]));
    let message = |found: &[Value]| found[0]["message"].as_str().expect("text").to_owned();
    editor.change("graph.ron", &needy.replace("Groups(1)", "Groups(\"8 / 0\")"));
    let found = editor.published().1;
    assert_eq!(message(&found), "this expression has no value: division by zero");
    editor.end();
}

#[test]
fn a_mistake_in_a_graph_of_a_choice_that_is_not_drawn_is_shown_in_that_graph() {
    let editor = Editor::start();
    editor.write("broken.ron", &GRAPH.replace("Groups(1)", "Groups(\"8 / 0\")"));
    let choice = r#"Choice(summary: "", of: [(graph: "graph.ron"), (graph: "broken.ron")])"#;
    editor.write("choice.ron", choice);
    editor.open("choice.ron", choice);
    let mut found = BTreeMap::from([editor.published(), editor.published()]);
    assert_eq!(found.remove(&editor.uri("choice.ron")), Some(vec![]));
    let broken = found.into_values().next().expect("another file");
    assert_eq!(broken[0]["message"], "this expression has no value: division by zero");
    editor.end();
}

#[test]
fn the_output_of_an_include_and_the_parameters_that_it_sets_are_known() {
    let mut editor = Editor::start();
    let outer = OUTER.replace("inner.picture", "inner.pic|ture");
    let place = editor.place("outer.ron", &outer);
    assert!(editor.published().1.is_empty());
    let line = GRAPH.lines().position(|line| line.contains("resources: ")).expect("there") as u64;
    let column = GRAPH.lines().nth(line as usize).expect("there").find("\"picture\"").expect("there") as u64;
    assert_eq!(editor.defined(place.clone()), [("graph.ron".into(), line, column + 1)]);
    let text = editor.hover(place.clone());
    assert!(
        text.starts_with("`inner.picture`: an image of 8 x 8, rgba8: the output of `graph.ron`"),
        "{text}"
    );
    assert_eq!(editor.offered(place.clone()), ["copy", "inner.picture", "inner.table"]);
    for marked in ["set: { \"wi|dth\"", "expose: Only([\"wi|dth\"])"] {
        let outer = OUTER.replace(&marked.replace('|', ""), marked);
        let (_, place) = editor.at("outer.ron", &outer);
        assert_eq!(editor.offered(place.clone()), ["width"]);
        let text = editor.hover(place);
        assert!(text.starts_with("`width`: a constant parameter, here 4. ring width"), "{text}");
    }
    editor.end();
}

#[test]
fn the_lets_of_an_include_that_choose_a_resource_are_offered() {
    let mut editor = Editor::start();
    let inner =
        GRAPH.replacen("2 * width\"", "2 * width\", \"shown\": \"words > 1 ? 'picture' : 'table'\"", 1);
    editor.write("graph.ron", &inner);
    let place = editor.place("outer.ron", &OUTER.replace("inner.picture", "inner.sh|own"));
    assert!(editor.published().1.is_empty());
    assert_eq!(editor.offered(place.clone()), ["copy", "inner.picture", "inner.shown", "inner.table"]);
    let text = editor.hover(place);
    assert!(text.starts_with("`inner.shown`: an image of 8 x 8, rgba8: `shown` of `graph.ron`"), "{text}");
    editor.end();
}

#[test]
fn a_part_is_no_mistake_because_it_has_no_output() {
    let editor = Editor::start();
    let part = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/parts/sort.ron");
    let uri = text::uri_of(&part.canonicalize().expect("there")).expect("a URI");
    let text = std::fs::read_to_string(&part).expect("text");
    editor.open_at(uri.as_str(), &text);
    assert_eq!(editor.published(), (uri.as_str().to_owned(), vec![]));
    editor.end();
}

#[test]
fn a_mistake_in_a_shader_of_the_folder_beside_is_shown_under_its_plain_path() {
    let editor = Editor::start();
    for folder in ["pipelines", "shaders"] {
        std::fs::create_dir(editor.path(folder)).expect("writable");
    }
    let broken = SHADER.replace("vec4(table[0])", "vec4(tabel[0])");
    editor.write("shaders/paint.comp", &broken);
    let graph = GRAPH.replace("show.comp", "paint.comp");
    editor.write("pipelines/graph.ron", &graph);
    editor.open("pipelines/graph.ron", &graph);
    let mut found = BTreeMap::from([editor.published(), editor.published()]);
    assert_eq!(found.remove(&editor.uri("pipelines/graph.ron")), Some(vec![]));
    let shader = editor.path("shaders/paint.comp").canonicalize().expect("there");
    let uri = text::uri_of(&shader).expect("a URI").as_str().to_owned();
    assert_eq!(found.remove(&uri).map(|found| found.len()), Some(1), "{found:?}");
    editor.end();
}

#[test]
fn renaming_a_parameter_changes_the_graph_its_includer_and_the_constants_of_their_shaders() {
    let mut editor = Editor::start();
    let place = editor.place("graph.ron", &GRAPH.replace("2 * width", "2 * wi|dth"));
    let prepared = editor.request("textDocument/prepareRename", place.clone());
    assert_eq!(prepared["placeholder"], "width");
    let expected = BTreeMap::from([
        ("graph.ron".to_owned(), GRAPH.replace("\"width\"", "\"side\"").replace("2 * width", "2 * side")),
        (
            "outer.ron".to_owned(),
            OUTER.replace("\"width\"", "\"side\"").replace("\"width / 2\"", "\"side / 2\""),
        ),
        ("copy.comp".to_owned(), COPY.replace("WIDTH", "SIDE")),
    ]);
    assert_eq!(editor.renamed(place, "side"), Ok(expected.clone()));
    // Rename from the shader, where the name is a constant in capitals.
    let place = editor.place("copy.comp", &COPY.replace("WIDTH", "WI|DTH"));
    assert_eq!(editor.renamed(place, "SIDE"), Ok(expected));
    editor.end();
}

#[test]
fn resources_includes_and_passes_are_renamed_where_dotted_names_use_them() {
    let mut editor = Editor::start();
    let place = editor.place("graph.ron", &GRAPH.replace(": \"table\"", ": \"ta|ble\""));
    let renamed = editor.renamed(place, "ring").expect("renamed");
    assert_eq!(renamed.keys().collect::<Vec<_>>(), ["graph.ron", "outer.ron"]);
    assert_eq!(renamed["graph.ron"], GRAPH.replace("\"table\"", "\"ring\""));
    assert_eq!(renamed["outer.ron"], OUTER.replace("inner.table", "inner.ring"));
    let place = editor.place("outer.ron", &OUTER.replace("inner.picture", "in|ner.picture"));
    let renamed = editor.renamed(place, "scene").expect("renamed");
    assert_eq!(renamed, BTreeMap::from([("outer.ron".to_owned(), OUTER.replace("inner", "scene"))]));
    // A pass and a resource can have the same name: only the pass is renamed.
    let place = editor.place("outer.ron", &OUTER.replace("name: \"copy\"", "name: \"co|py\""));
    let renamed = editor.renamed(place, "paste").expect("renamed");
    assert_eq!(renamed["outer.ron"], OUTER.replace("name: \"copy\"", "name: \"paste\""));
    editor.end();
}

#[test]
fn a_rename_that_would_break_a_graph_is_refused_with_the_error() {
    let mut editor = Editor::start();
    let place = editor.place("graph.ron", &GRAPH.replace("\"width\"", "\"wi|dth\""));
    let error = editor.renamed(place.clone(), "words").expect_err("there is a `let` of that name");
    assert!(error.starts_with("renaming `width` to `words` would break "), "{error}");
    let error = editor.renamed(place, "a-b").expect_err("no name");
    assert_eq!(error, "expected a name of letters, digits and `_`, found `a-b`");
    let place = editor.place("graph.ron", &GRAPH.replace("rgba8", "rg|ba8"));
    assert_eq!(editor.request("textDocument/prepareRename", place), Value::Null);
    // The server still accepts changes after refused renames.
    editor.change("graph.ron", GRAPH);
    editor.end();
}

#[test]
fn a_rename_that_would_give_a_word_of_a_shader_another_meaning_is_refused() {
    let mut editor = Editor::start();
    let graph = GRAPH
        .replace(
            "Const(Int(default: 4, range: (1, 64), label: \"ring width\"))",
            "Live(Float(default: 4.0, range: (1, 64), label: \"\"))",
        )
        .replace("2 * width", "8");
    editor.write("graph.ron", &graph);
    let shader = SHADER
        .replace(
            "#version 460",
            "#version 460\n#extension GL_GOOGLE_include_directive : require\n#include \"live.glsl\"",
        )
        .replace("table[0] = 1;", "float ring = 2.0 / width; table[0] = uint(ring * width);");
    editor.write("show.comp", &shader);
    // The includer sets a constant, and is no longer valid.
    std::fs::remove_file(editor.path("outer.ron")).expect("there");
    let place = editor.place("graph.ron", &graph.replace("\"width\"", "\"wi|dth\""));
    let error = editor.renamed(place.clone(), "ring").expect_err("the shader has a variable of that name");
    assert!(error.contains("expected show.comp to compile to the same code, found other code"), "{error}");
    let renamed = editor.renamed(place, "side").expect("renamed");
    assert_eq!(renamed["show.comp"], shader.replace("width", "side"));
    editor.end();
}

#[test]
fn definitions_lead_to_declarations_files_and_blocks() {
    let mut editor = Editor::start();
    let at = |line: u64, text: &str, of: &str, name: &str| {
        let column = of.lines().nth(line as usize).expect("a line").find(text).expect("there") as u64;
        (name.to_owned(), line, column)
    };
    let defined = |editor: &mut Editor, file: &str, whole: &str, from: &str, to: &str| {
        let place = editor.place(file, &whole.replacen(from, to, 1));
        editor.defined(place)
    };
    let width = at(1, "width", GRAPH, "graph.ron");
    assert_eq!(
        defined(&mut editor, "outer.ron", OUTER, "width / 2", "wid|th / 2"),
        std::slice::from_ref(&width)
    );
    assert_eq!(defined(&mut editor, "copy.comp", COPY, "WIDTH", "|WIDTH"), [width]);
    let table = at(3, "table\": Buffer", GRAPH, "graph.ron");
    assert_eq!(defined(&mut editor, "outer.ron", OUTER, "inner.table", "inner.tab|le"), [table]);
    assert_eq!(
        defined(&mut editor, "outer.ron", OUTER, "graph.ron", "graph|.ron"),
        [("graph.ron".to_owned(), 0, 0)]
    );
    assert_eq!(
        defined(&mut editor, "outer.ron", OUTER, "copy.comp", "cop|y.comp"),
        [("copy.comp".to_owned(), 0, 0)]
    );
    let block = at(3, "Table", COPY, "copy.comp");
    assert_eq!(defined(&mut editor, "outer.ron", OUTER, "\"Table\"", "\"|Table\""), [block]);
    editor.write("help.glsl", "");
    let including = COPY.replace("void main", "#include \"help.glsl\"\nvoid main");
    let place = editor.place("copy.comp", &including.replace("help.glsl", "he|lp.glsl"));
    assert_eq!(editor.defined(place), [("help.glsl".to_owned(), 0, 0)]);
    // A built-in file has no path that an editor could open.
    let built_in = GRAPH.replace("show.comp", "sort/scan.comp");
    assert_eq!(defined(&mut editor, "graph.ron", &built_in, "sort/scan", "sort/sc|an"), []);
    editor.end();
}

#[test]
fn hints_show_what_a_pass_waits_for_and_the_value_of_a_let() {
    let refreshes = json!({ "workspace": { "inlayHint": { "refreshSupport": true } } });
    let mut editor = Editor::start_with(refreshes);
    editor.open("outer.ron", OUTER);
    // The hints depend on other files, so the editor must ask again after each build.
    let asked = loop {
        if let Message::Request(request) = editor.connection.receiver.recv().expect("a message") {
            break request.method;
        }
    };
    assert_eq!(asked, "workspace/inlayHint/refresh");
    let hints = |editor: &mut Editor, name: &str, lines: (u32, u32)| {
        let range = json!({ "start": { "line": lines.0, "character": 0 }, "end": { "line": lines.1, "character": 0 } });
        let document = json!({ "uri": editor.uri(name) });
        let found =
            editor.request("textDocument/inlayHint", json!({ "textDocument": document, "range": range }));
        let hint = |hint: &Value| {
            (
                hint["position"]["line"].as_u64().expect("a line"),
                hint["label"].as_str().expect("text").to_owned(),
            )
        };
        (found.as_array().expect("a list").iter().map(hint).collect::<Vec<_>>(), found)
    };
    let (found, all) = hints(&mut editor, "outer.ron", (0, 20));
    assert_eq!(found[0], (5, "waits for inner.show, export of the previous frame".into()));
    assert_eq!(found[1], (1, "= 4".into()));
    let tooltip = all[0]["tooltip"].as_str().expect("text");
    assert!(tooltip.contains("read after write on inner.table, after inner.show"), "{tooltip}");
    assert_eq!(hints(&mut editor, "outer.ron", (0, 2)).0, [(1, "= 4".into())]);
    // A graph with an error has no plan, and its lines may have moved, so it has no hints.
    editor.change("outer.ron", &OUTER.replace("inner.table", "inner.tabel"));
    assert_eq!(hints(&mut editor, "outer.ron", (0, 20)).0, []);
    // The barrier before `one` serves `two`, too.
    let two = |name: &str| {
        format!(
            "Dispatch(name: \"{name}\", shader: \"read.comp\", size: Groups(1), bind: {{ \"From\": \"table\", \"To\": \"{name}\" }}),\n"
        )
    };
    let graph = GRAPH
        .replace(
            "passes: [",
            &format!(
                "passes: [Fill(name: \"fill\", buffer: \"table\", value: 1),\n{}{}",
                two("one"),
                two("two")
            ),
        )
        .replace("\"Table\": \"table\"", "\"From\": \"one\", \"Table\": \"two\"")
        .replace(
            "resources: {",
            "resources: { \"one\": Buffer(stride: 4, count: 4), \"two\": Buffer(stride: 4, count: 4),",
        );
    let from = "#version 460\nlayout(set = 0, binding = 2, std430) readonly buffer From { uint from[]; };";
    let to = "layout(set = 0, binding = 3, std430) writeonly buffer To { uint to[]; };";
    editor.write("read.comp", &format!("{from}\n{to}\nvoid main() {{ to[0] = from[0]; }}"));
    let show = SHADER
        .replace("#version 460", from)
        .replace("table[0] = 1;", "")
        .replace("vec4(table[0])", "vec4(table[0] + from[0])");
    editor.write("show.comp", &show);
    editor.open("graph.ron", &graph);
    let found = hints(&mut editor, "graph.ron", (4, 20)).0.into_iter().map(|hint| hint.1);
    assert_eq!(
        found.collect::<Vec<_>>(),
        [
            "waits for export of the previous frame",
            "waits for fill, show of the previous frame",
            "waits for fill, show of the previous frame (no barrier here)",
            "waits for two, one, export of the previous frame",
        ]
    );
    editor.end();
}

#[test]
fn parameters_of_the_shipped_graphs_are_found_through_choices_and_shared_shaders() {
    let mut editor = Editor::start();
    let pipelines = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines").canonicalize().expect("there");
    let mut files_with = |part: &str| {
        let part = pipelines.join(part);
        let text = std::fs::read_to_string(&part).expect("text");
        let uri = text::uri_of(&part).expect("a URI").as_str().to_owned();
        editor.open_at(&uri, &text);
        let position = text::position_of(&text, text.find("\"digit_bits\"").expect("there") + 1);
        let context = json!({ "includeDeclaration": true });
        let place = json!({ "textDocument": { "uri": uri }, "position": position, "context": context });
        let found = editor.request("textDocument/references", place);
        let uris = found.as_array().expect("a list").iter().map(|l| l["uri"].as_str().expect("a URI"));
        uris.map(|uri| uri.rsplit('/').next().expect("a name").to_owned()).collect::<BTreeSet<_>>()
    };
    let of_the_sort = files_with("parts/sort.ron");
    for file in ["sort.ron", "tile_bins.ron", "depth_order.ron", "block.glsl"] {
        assert!(of_the_sort.contains(file), "{file} is not in {of_the_sort:?}");
    }
    // The preset sets the parameter of `depth_order.ron`, which is another declaration than the sort's.
    assert!(!of_the_sort.contains("digit4.ron"), "{of_the_sort:?}");
    let of_the_order = files_with("parts/depth_order.ron");
    assert!(of_the_order.contains("digit4.ron") && !of_the_order.contains("sort.ron"), "{of_the_order:?}");
    // Without the declaration, only uses are listed.
    let mut place = editor.place("graph.ron", &GRAPH.replace("2 * width", "2 * wi|dth"));
    for (is_declared, count) in [(true, 6), (false, 5)] {
        place["context"] = json!({ "includeDeclaration": is_declared });
        let found = editor.request("textDocument/references", place.clone());
        assert_eq!(found.as_array().expect("a list").len(), count, "{found}");
    }
    editor.end();
}
