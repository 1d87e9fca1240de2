use super::*;
use lsp_server::{Message, RequestId};
use serde_json::{Value, json};
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

/// An editor with a server on another thread, and a folder with a graph and its shader.
struct Editor {
    connection: Connection,
    folder: tempfile::TempDir,
    server: thread::JoinHandle<()>,
    requests: i32,
}

impl Editor {
    fn start() -> Editor {
        let (server, connection) = Connection::memory();
        let server = thread::spawn(move || serve(&server).expect("the editor follows the protocol"));
        let folder = tempfile::tempdir().expect("a folder");
        let write =
            |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("writable");
        write("graph.ron", GRAPH);
        write("show.comp", SHADER);
        let mut editor = Editor { connection, folder, server, requests: 0 };
        let capabilities = editor.request("initialize", json!({ "capabilities": {} }));
        assert_eq!(capabilities["capabilities"]["hoverProvider"], true);
        editor.notify("initialized", json!({}));
        editor
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
        self.requests += 1;
        let id = RequestId::from(self.requests);
        let request = Request { id: id.clone(), method: method.into(), params };
        self.connection.sender.send(request.into()).expect("the server listens");
        loop {
            let message =
                serde_json::to_value(self.connection.receiver.recv().expect("an answer")).expect("JSON");
            if message["id"] == self.requests {
                assert!(message["error"].is_null(), "{message}");
                return message["result"].clone();
            }
        }
    }

    fn open(&self, name: &str, text: &str) {
        let document = json!({ "uri": self.uri(name), "languageId": "ron", "version": 1, "text": text });
        self.notify("textDocument/didOpen", json!({ "textDocument": document }));
    }

    fn change(&self, name: &str, text: &str) {
        let document = json!({ "uri": self.uri(name), "version": 2 });
        let changes = json!([{ "text": text }]);
        self.notify("textDocument/didChange", json!({ "textDocument": document, "contentChanges": changes }));
    }

    /// The diagnostics that are published next, of whichever file.
    fn published(&self) -> (String, Vec<Value>) {
        loop {
            let message = self.connection.receiver.recv().expect("a message");
            if let Message::Notification(Notification { params, .. }) = message {
                let uri = params["uri"].as_str().expect("a URI").to_owned();
                return (uri, params["diagnostics"].as_array().expect("a list").clone());
            }
        }
    }

    /// The position of a mark `|`, and the text without it.
    fn at(&self, marked: &str) -> (String, Value) {
        let text = marked.replacen('|', "", 1);
        let position = text::position_of(&text, marked.find('|').expect("a mark"));
        let document = json!({ "uri": self.uri("graph.ron") });
        (text, json!({ "textDocument": document, "position": position }))
    }

    /// The names that are offered where the mark stands.
    fn offered(&mut self, marked: &str) -> Vec<String> {
        let (text, place) = self.at(marked);
        self.change("graph.ron", &text);
        let items = self.request("textDocument/completion", place);
        items
            .as_array()
            .expect("a list")
            .iter()
            .map(|item| item["label"].as_str().expect("text").to_owned())
            .collect()
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
    // The file on disk is right, and counts once the editor closes it.
    editor.notify("textDocument/didClose", json!({ "textDocument": { "uri": uri } }));
    assert_eq!(editor.published(), (editor.uri("show.comp"), vec![]));
    editor.end();
}

#[test]
fn blocks_resources_names_and_formats_are_offered_where_each_can_stand() {
    let mut editor = Editor::start();
    editor.open("graph.ron", GRAPH);
    assert!(editor.published().1.is_empty());
    let replaced = |from: &str, to: &str| GRAPH.replacen(from, to, 1);
    assert_eq!(editor.offered(&replaced("\"Table\": \"table\"", "\"|")), ["Table", "picture"]);
    let resources = editor.offered(&replaced("\"Table\": \"table\"", "\"Table\": \"ta|\""));
    assert_eq!(resources, ["picture", "table"]);
    let names = editor.offered(&replaced("words + 1", "words + sce|"));
    for name in ["width", "words", "scene.count", "viewport.width", "device.subgroup_size"] {
        assert!(names.iter().any(|other| other == name), "{name} is not in {names:?}");
    }
    assert_eq!(editor.offered(&replaced("rgba8", "|"))[0], "r32f");
    let shaders = editor.offered(&replaced("show.comp", "|"));
    assert!(shaders.iter().any(|s| s == "show.comp") && shaders.iter().any(|s| s == "sort/scatter.comp"));
    editor.end();
}

#[test]
fn hovering_tells_the_value_of_a_name_and_of_the_expression_around_it() {
    let mut editor = Editor::start();
    editor.open("graph.ron", GRAPH);
    assert!(editor.published().1.is_empty());
    let mut told = |from: &str, to: &str| {
        let (_, place) = editor.at(&GRAPH.replacen(from, to, 1));
        editor.request("textDocument/hover", place)["contents"]["value"]
            .as_str()
            .unwrap_or_default()
            .to_owned()
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
    assert_eq!(told("summary: \"\"", "summary: \"|\""), "");
    editor.end();
}

#[test]
fn a_part_is_no_mistake_because_it_has_no_output() {
    let editor = Editor::start();
    let part = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/parts/sort.ron");
    let uri = text::uri_of(&part.canonicalize().expect("there")).expect("a URI");
    let text = std::fs::read_to_string(&part).expect("text");
    let document = json!({ "uri": uri.as_str(), "languageId": "ron", "version": 1, "text": text });
    editor.notify("textDocument/didOpen", json!({ "textDocument": document }));
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
    std::fs::write(editor.path("shaders/paint.comp"), broken).expect("writable");
    let graph = GRAPH.replace("show.comp", "paint.comp");
    std::fs::write(editor.path("pipelines/graph.ron"), &graph).expect("writable");
    editor.open("pipelines/graph.ron", &graph);
    let mut found = BTreeMap::from([editor.published(), editor.published()]);
    assert_eq!(found.remove(&editor.uri("pipelines/graph.ron")), Some(vec![]));
    let shader = editor.path("shaders/paint.comp").canonicalize().expect("there");
    let uri = text::uri_of(&shader).expect("a URI").as_str().to_owned();
    assert_eq!(found.remove(&uri).map(|found| found.len()), Some(1), "{found:?}");
    editor.end();
}
