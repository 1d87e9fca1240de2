//! Tests the answers to requests: completion, hover, renaming, definitions, references and hints.

use super::*;

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
    let imports = offered("resources:", "imports: { \"import\": (from: \"|\") }, resources:");
    assert!(imports.iter().any(|name| name == "scene.position"), "{imports:?}");
    assert!(files::nominal_catalog().buffers.keys().all(|name| imports.contains(name)), "{imports:?}");
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
fn blocks_of_all_shaders_that_an_expression_can_choose_are_known() {
    let mut editor = Editor::start();
    editor.write("copy.comp", &COPY.replace("void main", "# include <more.glsl>\nvoid main"));
    editor.write("more.glsl", "layout(set = 0, binding = 3, rgba8) uniform image2D more;\n");
    let graph = GRAPH.replace("\"show.comp\"", "\"width > 5 ? 'copy.comp' : 'show.comp'\"");
    let place = editor.place("graph.ron", &graph.replace("\"Table\"", "\"Ta|ble\""));
    assert_eq!(editor.offered(place.clone()), ["Table", "from", "more", "picture", "to"]);
    let files = editor.defined(place).into_iter().map(|(file, ..)| file);
    assert_eq!(files.collect::<Vec<_>>(), ["copy.comp", "show.comp"]);
    editor.end();
}

#[test]
fn own_files_in_the_folders_that_are_searched_are_offered_but_not_the_graph_itself() {
    let mut editor = Editor::start();
    for name in
        ["pipelines/my.ron", "pipelines/parts/mine.ron", "shaders/mine.comp", "shaders/sort/mine.comp"]
    {
        std::fs::create_dir_all(editor.path(name).parent().expect("a folder")).expect("writable");
        editor.write(name, "");
    }
    let offered = |editor: &mut Editor, text: &str| {
        let place = editor.place("pipelines/my.ron", text);
        let offered = editor.offered(place).into_iter();
        offered.filter(|name| name.contains("mine") || name == "my.ron").collect::<Vec<_>>()
    };
    let shaders = offered(&mut editor, "Graph(passes: [Dispatch(shader: \"|");
    assert_eq!(shaders, ["mine.comp", "sort/mine.comp"]);
    assert_eq!(offered(&mut editor, "Graph(passes: [Include(graph: \"|"), ["parts/mine.ron"]);
    editor.end();
}

#[test]
fn the_options_of_a_choice_are_offered_where_it_is_compared_or_set() {
    let mut editor = Editor::start();
    let style = "params: { \"style\": Const(Choice(default: \"plain\", of: [\"plain\", \"soft\"])), ";
    let graph = GRAPH.replace("params: { ", style);
    editor.write("graph.ron", &graph);
    for (from, marked, expected) in [
        (": \"table\"", ": \"style == '|' ? 'picture' : 'table'\"", vec!["plain", "soft"]),
        (": \"table\"", ": \"style == 'soft' ? 'pic|ture' : 'table'\"", vec!["picture", "table"]),
        ("\"show\"", "\"show\", when: \"'so|ft' != style\"", vec!["plain", "soft"]),
        ("\"show\"", "\"show\", when: \"width == '|'\"", vec![]),
    ] {
        let place = editor.place("graph.ron", &graph.replacen(from, marked, 1));
        assert_eq!(editor.offered(place), expected, "{marked}");
    }
    let preset = |value: &str| {
        format!("Preset(graph: \"graph.ron\", summary: \"\", set: {{ \"style\": \"{value}\" }})")
    };
    let place = editor.place("preset.ron", &preset("scene.count > 5 ? 'so|ft' : 'plain'"));
    assert_eq!(editor.offered(place), ["plain", "soft"]);
    let place = editor.place("preset.ron", &preset("so|"));
    let offered = editor.offered(place);
    assert!(
        ["plain", "soft", "scene.count"].iter().all(|name| offered.iter().any(|o| o == name)),
        "{offered:?}"
    );
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
    let with = r#"Graph(passes: [Include(name: "sort", graph: "parts/sort.ron", with: { "ke|" }"#;
    let place = editor.place("with.ron", with);
    assert_eq!(editor.offered(place), ["args", "keys", "values"]);
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
fn a_closed_file_is_read_again_for_each_request() {
    let mut editor = Editor::start();
    let place = editor.place("outer.ron", &OUTER.replace("width / 2", "wi|dth / 2"));
    assert!(editor.published().1.is_empty());
    // This editor does not report that files have changed.
    let copy = COPY.replace("void main", "// A line more.\nvoid main");
    editor.write("copy.comp", &copy);
    let renamed = editor.renamed(place, "side").expect("renamed");
    assert_eq!(renamed["copy.comp"], copy.replace("WIDTH", "SIDE"));
    editor.write("graph.ron", &GRAPH.replace("\"width\"", "\"side\"").replace("2 * width", "2 * side"));
    let (_, place) = editor.at("outer.ron", &OUTER.replace("{ \"width\"", "{ \"wi|dth\""));
    assert_eq!(editor.offered(place), ["side"]);
    editor.end();
}

#[test]
fn a_rename_is_refused_while_a_graph_that_may_use_the_name_cannot_be_parsed() {
    let mut editor = Editor::start();
    let folder = editor.folder.path().canonicalize().expect("there");
    let marked = GRAPH.replacen("\"table\"", "\"ta|ble\"", 1);
    let error = |name: &str, line: u32| {
        let place = folder.join(name);
        let place = place.display();
        Err(format!("renaming `table` to `ring` could miss uses: fix the error at {place}:{line} first"))
    };
    let place = editor.place("graph.ron", &marked.replace("\"show\"", "\"show"));
    assert_eq!(editor.renamed(place.clone(), "ring"), error("graph.ron", 5));
    editor.change("graph.ron", GRAPH);
    editor.write("outer.ron", &OUTER.replace("\"copy\", shader", "\"copy, shader"));
    assert_eq!(editor.renamed(place.clone(), "ring"), error("outer.ron", 6));
    editor.write("outer.ron", OUTER);
    editor.write("settings.ron", "(chair: \"table)");
    assert!(editor.renamed(place, "ring").is_ok());
    editor.end();
}

#[test]
fn a_file_that_a_shader_includes_is_renamed_with_it_however_the_include_is_spelled() {
    let mut editor = Editor::start();
    let extension = "#version 460\n#extension GL_GOOGLE_include_directive : require\n";
    let include = "#if WIDTH == 3\n#  include \"soft.glsl\"\n#endif\n";
    editor.write("copy.comp", &COPY.replace("#version 460\n", &format!("{extension}{include}")));
    editor.write("soft.glsl", "const uint SOFT = WIDTH;\n");
    let place = editor.place("graph.ron", &GRAPH.replace("2 * width", "2 * wi|dth"));
    let renamed = editor.renamed(place, "side").expect("renamed");
    assert_eq!(renamed["soft.glsl"], "const uint SOFT = SIDE;\n");
    editor.end();
}

#[test]
fn a_live_parameter_is_no_argument_and_no_member_of_the_same_name() {
    let mut editor = Editor::start();
    let common = "float disc(vec2 p, float extent) { return length(p) < extent ? 1.0 : 0.0; }\n";
    editor.write("common.glsl", common);
    let (from, _) = GRAPH.split_once("Const").expect("there");
    let graph = |name: &str| {
        let rest = GRAPH.split_once("ring width\"))").expect("there").1;
        let live = "Live(Float(default: 4.0, range: (1, 64)))";
        let whole = format!("{}{live}{rest}", from.replace("width", "extent"));
        whole.replace("2 * width", "8").replace("show.comp", name)
    };
    // The built-in `splat.glsl` has a struct with a member `extent`.
    let includes = "#version 460\n#extension GL_GOOGLE_include_directive : require\n#include \"live.glsl\"\n\
                    #include \"common.glsl\"\n#include \"splat.glsl\"\n";
    let shader = SHADER
        .replace("#version 460\n", includes)
        .replace("table[0] = 1", "table[0] = uint(disc(vec2(1), 2.0 * extent))");
    for (name, shown) in [("a.ron", "a.comp"), ("b.ron", "b.comp")] {
        editor.write(name, &graph(shown));
        editor.write(shown, &shader);
    }
    let place = editor.place("a.ron", &graph("a.comp").replace("\"extent", "\"ex|tent"));
    let expected = BTreeMap::from([
        ("a.ron".to_owned(), graph("a.comp").replace("extent", "size")),
        ("a.comp".to_owned(), shader.replace("extent", "size")),
    ]);
    assert_eq!(editor.renamed(place, "size"), Ok(expected));
    // A shader without `live.glsl` has no live parameters, but may have a member of the name.
    editor.write("c.ron", &graph("c.comp"));
    editor.write("c.comp", &SHADER.replace("table", "extent"));
    let place = editor.place("c.ron", &graph("c.comp").replace("\"extent", "\"ex|tent"));
    let expected = BTreeMap::from([("c.ron".to_owned(), graph("c.comp").replace("extent", "size"))]);
    assert_eq!(editor.renamed(place, "size"), Ok(expected));
    let place = editor.place("common.glsl", &common.replace("< extent", "< ex|tent"));
    assert_eq!(editor.defined(place), []);
    editor.end();
}

#[test]
fn a_rename_that_would_let_an_expression_choose_something_else_is_refused() {
    let mut editor = Editor::start();
    let dispatch = |image: &str| {
        format!(
            r#"Dispatch(name: "{image}", shader: "show.comp", size: Groups(1), bind: {{ "Table": "table", "picture": "{image}" }})"#
        )
    };
    let graph = format!(
        r#"Graph(version: 1, summary: "", output: "chosen",
  params: {{ "fast": Const(Bool(default: true)), "mode": Const(Choice(default: "slow", of: ["slow", "fine"])) }},
  let: {{ "chosen": "fast ? 'left' : 'right'" }},
  resources: {{
    "left": Image(format: "rgba8", size: (8, 8)), "right": Image(format: "rgba8", size: (8, 8)),
    "table": Buffer(stride: 4, count: 1),
  }},
  passes: [{}, {}],
)"#,
        dispatch("left"),
        dispatch("right")
    );
    editor.write("choosing.ron", &graph);
    for (from, to) in [("chosen", "right"), ("chosen", "left"), ("left", "chosen"), ("left", "fine")] {
        let place = editor.place("choosing.ron", &graph.replacen(from, &format!("|{from}"), 1));
        let error = editor.renamed(place, to).expect_err(to);
        assert!(error.starts_with(&format!("renaming `{from}` to `{to}` ")), "{error}");
    }
    let place = editor.place("choosing.ron", &graph.replacen("left", "|left", 1));
    let renamed = editor.renamed(place, "side").expect("renamed");
    let pass = "name: \"left\"";
    assert_eq!(renamed["choosing.ron"], graph.replace("left", "side").replace("name: \"side\"", pass));
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
    // The shader of a closed graph may include files of the graph's folder, outside of its own folder.
    std::fs::create_dir(editor.path("lib")).expect("writable");
    editor.write("deep.ron", &GRAPH.replace("show.comp", "lib/deep.comp"));
    let including = SHADER.replace("void main", "#include \"../help.glsl\"\nvoid main");
    let place = editor.place("lib/deep.comp", &including.replace("help.glsl", "he|lp.glsl"));
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
