//! Tests the diagnostics that the server publishes, and the protocol.

use super::*;

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
    editor.change("graph.ron", "// Draws splats.\n");
    let message = editor.published().1[0]["message"].as_str().expect("text").to_owned();
    assert!(message.starts_with("the file is empty"), "{message}");
    if cfg!(feature = "window") {
        // Only the viewer has this graph's imports.
        let window = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/view/window.ron");
        editor.open("window.ron", &std::fs::read_to_string(window).expect("a graph"));
        assert_eq!(editor.published(), (editor.uri("window.ron"), vec![]));
    }
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
fn a_shader_and_a_part_that_are_open_alone_are_checked_with_a_closed_graph() {
    let editor = Editor::start();
    let broken = SHADER.replace("vec4(table[0])", "vec4(tabel[0])");
    editor.open("show.comp", &broken);
    let (uri, found) = editor.published();
    assert_eq!((uri, found.len()), (editor.uri("show.comp"), 1));
    // Opening another file does not hide the errors for a while.
    editor.open("scenes.ron", "Scenes([])");
    assert_eq!(editor.published(), (editor.uri("scenes.ron"), vec![]));
    editor.change("show.comp", &broken.replace("table[0] = 1", "tabla[0] = 1"));
    let (uri, found) = editor.published();
    assert_eq!((uri, found.len()), (editor.uri("show.comp"), 1));
    assert!(found[0]["message"].as_str().expect("text").starts_with("`tabla`: "), "{found:?}");
    editor.change("show.comp", SHADER);
    assert_eq!(editor.published(), (editor.uri("show.comp"), vec![]));
    // A graph that is new on the disk is tried.
    editor.open("lone.comp", &broken);
    let new = GRAPH.replace("show.comp", "lone.comp");
    editor.write("new.ron", &new);
    let changes = json!([{ "uri": editor.uri("new.ron"), "type": 1 }]);
    editor.notify("workspace/didChangeWatchedFiles", json!({ "changes": changes }));
    let (uri, found) = editor.published();
    assert_eq!((uri, found.len()), (editor.uri("lone.comp"), 1));
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
fn a_graph_whose_requirements_the_nominal_device_does_not_meet_is_checked_all_the_same_with_its_outputs() {
    let editor = Editor::start();
    let needy = GRAPH.replace("summary: \"\",", "summary: \"\", require: [(\"device.int64\", \"longs\")],");
    editor.open("graph.ron", &needy);
    assert_eq!(editor.published(), (editor.uri("graph.ron"), vec![]));
    let message = |found: &[Value]| found[0]["message"].as_str().expect("text").to_owned();
    editor.change("graph.ron", &needy.replace("Groups(1)", "Groups(\"8 / 0\")"));
    let found = editor.published().1;
    assert_eq!(message(&found), "this expression has no value: division by zero");
    let fill = "passes: [Fill(name: \"more\", buffer: \"table\", value: \"8 / 0\", when: \"outputs.more\"), ";
    let output =
        needy.replace("passes: [", fill).replace("passes:", "outputs: { \"more\": \"picture\" }, passes:");
    editor.change("graph.ron", &output);
    let found = editor.published().1;
    let note = "help: with every output requested: more";
    assert_eq!(message(&found), format!("this expression has no value: division by zero\n{note}"));
    editor.end();
}

#[test]
fn a_parameter_that_nothing_uses_is_a_warning_until_a_shader_uses_it() {
    let editor = Editor::start();
    let live = "params: { \"gain\": Live(Int(default: 1, range: (0, 9))), ";
    editor.open("graph.ron", &GRAPH.replace("params: { ", live));
    let found = editor.published().1;
    let at = json!({ "start": { "line": 1, "character": 13 }, "end": { "line": 1, "character": 17 } });
    assert_eq!((found.len(), &found[0]["range"], &found[0]["severity"]), (1, &at, &json!(2)), "{found:?}");
    let using = SHADER
        .replace("vec4(table", "gain * vec4(table")
        .replace("layout(set = 0, binding = 0", "#include \"live.glsl\"\nlayout(set = 0, binding = 0");
    editor.open("show.comp", &using);
    assert_eq!(editor.published(), (editor.uri("graph.ron"), vec![]));
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
    assert_eq!(
        broken[0]["message"],
        "this expression has no value: division by zero\nhelp: the choice's graph `broken.ron`, which is not drawn here, has this error"
    );
    editor.end();
}

#[test]
fn the_requirements_of_a_choice_are_errors_if_no_device_meets_any() {
    let editor = Editor::start();
    let entry = |condition: &str| {
        format!(r#"(graph: "graph.ron", require: [("device.max_groups_x < {condition}", "wonders")])"#)
    };
    let choice = |other: &str| format!(r#"Choice(summary: "", of: [{}, {other}])"#, entry("0"));
    let severities = |(uri, found): (String, Vec<Value>)| {
        assert_eq!(uri, editor.uri("choice.ron"));
        found.iter().map(|found| found["severity"].as_u64().expect("a number")).collect::<Vec<_>>()
    };
    editor.open("choice.ron", &choice(r#"(graph: "graph.ron")"#));
    assert_eq!(severities(editor.published()), [2]);
    editor.change("choice.ron", &choice(&entry("-1")));
    assert_eq!(severities(editor.published()), [1, 1]);
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
