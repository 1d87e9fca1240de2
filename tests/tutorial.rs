//! The tutorial and the templates of `splatgraph new`: every graph is checked, drawn with validation, and shows its
//! effect. The tutorial's commands are run as well.

use serde_json::{Value, json};
use splatgraph::io::image::Image;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Stdio};

use crate::images::psnr;
use crate::place::Place;

fn tutorial() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/tutorial")
}

/// Checks a graph and draws it with validation, from the first camera. `more` holds further options.
fn drawn(place: &Place, graph: &str, more: &str) -> Image {
    let text = place.done(&format!("check {graph}"));
    assert!(text.contains(": OK\n"), "{text}");
    let line = "render scene.ply -c cameras.json#0 --size 128x72 --validate -o out.npy";
    place.done(&format!("{line} -p {graph} {more}"));
    place.image("out.npy")
}

fn pixels(image: &Image) -> impl Iterator<Item = [f32; 3]> + '_ {
    image.rgb.iter().copied()
}

#[test]
fn every_step_of_the_tutorial_draws_what_it_teaches() {
    let place = Place::demo(20000);
    let step = |name: &str, more: &str| {
        drawn(&place, &tutorial().join(name).with_extension("ron").display().to_string(), more)
    };
    let splat = drawn(&place, "splat", "");
    let auto = drawn(&place, "auto", "");
    let renderer = step("renderer", "");
    assert!(psnr(&renderer, &splat) > 50.0, "{}", psnr(&renderer, &splat));
    let white = "--background 1,1,1";
    assert!(psnr(&step("renderer", white), &drawn(&place, "splat", white)) > 50.0);
    let line = format!("render scene.ply --size 32x18 {white} -o out.npy -p");
    let told = |graph: &str| {
        place.said(&format!("{line} {}", tutorial().join(graph).with_extension("ron").display())).1
    };
    assert!(
        told("sorted")
            .contains("--background has no effect: no shader of the graph reads `camera.background`")
    );
    assert!(!told("renderer").contains("--background"));
    // The steps before `renderer` draw no harmonics, and those before `sorted` are unsorted too.
    let base = drawn(&place, "splat", "--set sh_degree=0");
    let sorted = step("sorted", "");
    assert!(psnr(&sorted, &base) > 50.0 && psnr(&sorted, &splat) < 45.0);
    assert!(psnr(&step("sorted", "--set sh_degree=3"), &renderer) > 60.0);
    let blended = step("blended", "");
    assert!(psnr(&blended, &sorted) < 30.0, "{}", psnr(&blended, &sorted));
    assert!(psnr(&step("ellipses", ""), &sorted) < 30.0);
    let points = step("points", "");
    let lit = pixels(&points).filter(|rgb| *rgb == [1.0, 0.8, 0.5]).count();
    let dark = pixels(&points).filter(|rgb| *rgb == [0.0; 3]).count();
    assert!(lit > 1000 && dark > 1000 && lit + dark == 128 * 72, "{lit} points, {dark} dark");
    let rings = step("paint", "");
    assert!(psnr(&rings, &step("paint", "--set width=40")) < 20.0, "the slider changes the rings");
    // Depth is shown in grey, brightest at the nearest splat.
    let depth = step("depth", "");
    assert!(pixels(&depth).all(|[r, g, b]| (r - g).abs() < 1e-5 && (g - b).abs() < 1e-5));
    let range = pixels(&depth).fold((1.0f32, 0.0f32), |(low, high), [r, ..]| (low.min(r), high.max(r)));
    assert!(range.0 < 0.4 && range.1 > 0.8 && range.1 < 1.01, "{range:?}");
    // With strength 0, the filters change nothing.
    assert_eq!(psnr(&step("post", "--set grey=0"), &auto), f64::INFINITY);
    assert!(
        pixels(&step("post", "--set grey=1")).all(|[r, g, b]| (r - g).abs() < 1e-5 && (g - b).abs() < 1e-5)
    );
    assert_eq!(psnr(&step("outlines", "--set strength=0"), &auto), f64::INFINITY);
    let outlined = step("outlines", "");
    assert!(
        pixels(&outlined)
            .zip(pixels(&auto))
            .all(|(with, without)| with.iter().zip(without).all(|(a, b)| *a <= b))
    );
    assert!(psnr(&outlined, &auto) < 40.0);
    // Both renderers follow a rule that they share, and no other view than a pinhole's can be drawn by both.
    let outlines = tutorial().join("outlines.ron");
    let line = format!("render scene.ply --size 32x18 -o out.png -p {}", outlines.display());
    place.refuses(&line, &[("--set projection=fisheye", 1, "projection")]);
    let look = format!("{line} --inspect depth.picture@outline=depth.npy --inspect scene.picture@outline");
    assert!(place.done(&look).contains(" after outline: 18 x 32 x 4 words"));
    let depth = place.bytes("depth.npy");
    place.done(&format!("{look} --set low_pass=none"));
    assert!(place.bytes("depth.npy") != depth, "`low_pass` changes the depth, too");
}

#[test]
fn the_keys_of_the_sorting_step_ascend_and_without_its_statistic_their_order_is_unknown() {
    let place = Place::demo(20000);
    let text = std::fs::read_to_string(tutorial().join("sorted.ron")).expect("there");
    let stats = "  stats: { \"in_view\": (\"order.args\", 12) },\n";
    assert!(text.contains(stats));
    for shader in ["ellipses.comp", "renderer.vert", "renderer.frag"] {
        place.write(shader, std::fs::read(tutorial().join(shader)).expect("there"));
    }
    place.write("sorted.ron", &text);
    place.write("bare.ron", text.replace(stats, ""));
    let look = |graph: &str| {
        place.done(&format!("render scene.ply -p {graph} --size 64x36 --inspect keys@scatter -o k.png"))
    };
    let sorted = look("sorted.ron");
    assert!(sorted.contains("\n  monotonic: the first "), "{sorted}");
    let bare = look("bare.ron");
    assert!(bare.contains("\n  unknown order: the first "), "{bare}");
    assert!(bare.contains("add `stats: { \"visible\": (\"order.args\", 12) }` to the graph"), "{bare}");
}

#[test]
fn every_start_is_written_checked_and_drawn() {
    let place = Place::demo(20000);
    for (start, name) in [("splat", "my.ron"), ("compute", "rings.ron"), ("post", "new/grey.ron")] {
        let text = place.done(&format!("new {name} --from {start}"));
        assert!(text.contains(&format!("splatgraph render -p {name} -o")), "{text}");
        let picture = drawn(&place, name, "");
        let first = picture.rgb[0];
        assert!(pixels(&picture).any(|rgb| rgb != first), "{start} draws one colour");
        let again = format!("new {name} --from {start}");
        place.refuses(&again, &[("", 2, name)]);
        place.done(&format!("{again} --force"));
    }
}

#[test]
fn a_graph_of_the_program_is_printed_as_it_is_and_checked_where_it_is_copied_to() {
    let place = Place::empty();
    let text = place.done("source filters/edges");
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/filters/edges.ron");
    assert_eq!(text, std::fs::read_to_string(file).expect("there"));
    place.write("mine.ron", text);
    assert!(place.done("check mine.ron").starts_with("mine.ron: OK"));
    let list = place.done("source");
    assert!(list.contains("  parts/depth_order ") && list.contains("  sort/scatter.comp "), "{list}");
    assert!(!list.contains('\u{1b}'), "a pipe gets no colours");
    place.refuses("source", &[("parts/depth_ordr", 1, "did you mean `parts/depth_order`?")]);
}

#[test]
fn parameters_are_listed_as_text_and_as_json_with_the_devices_defaults() {
    let place = Place::empty();
    let text = place.done("params filters/edges");
    assert!(text.contains("\n  strength ") && text.contains("live 0.0..4.0 [1.0]"), "{text}");
    let json = place.told("params --json");
    assert_eq!(json["graph"], "auto");
    let names: Vec<&str> =
        json["parameters"].as_array().expect("a list").iter().filter_map(|p| p["name"].as_str()).collect();
    assert!(names.contains(&"sh_degree") && names.contains(&"key_bits"), "{names:?}");
    // The help refers to `params` instead of listing the parameters.
    for command in ["render", "check"] {
        let help = place.done(&[command, "--help"]);
        assert!(help.contains("splatgraph params NAME") && !help.contains("jacobian_limit"), "{help}");
    }
}

#[test]
fn diagnostics_are_json_for_programs() {
    let place = Place::empty();
    let text = place.done("source filters/edges").replace("\"scene.picture\"", "\"scene.pictre\"");
    place.write("mine.ron", &text);
    let output = place.run("check mine.ron splat --json");
    assert_eq!(output.status.code(), Some(1));
    let json: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let found = &json[0]["diagnostics"][0];
    let line = 1 + text.lines().position(|line| line.contains("pictre")).expect("the mistake");
    assert_eq!(
        (found["file"].as_str(), found["line"].as_u64()),
        (Some("mine.ron"), Some(line as u64)),
        "{json:#}"
    );
    assert_eq!(found["severity"], "error");
    assert_eq!((&json[1]["graph"], &json[1]["ok"]), (&"splat".into(), &true.into()));
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// A language server, with the editor's ends of its pipes.
struct Server {
    process: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Server {
    fn start(place: &Place) -> Server {
        let process = place.program("lsp").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut process = process.expect("the program runs");
        let input = process.stdin.take().expect("piped");
        let output = BufReader::new(process.stdout.take().expect("piped"));
        let mut server = Server { process, input, output };
        server.send(&[request(1, "initialize", json!({ "capabilities": {} }))]);
        assert_eq!(server.received()["id"], 1);
        server.send(&[notification("initialized", json!({}))]);
        server
    }

    /// Sends messages in one write.
    fn send(&mut self, messages: &[Value]) {
        let framed = |message: &Value| {
            let message = message.to_string();
            format!("Content-Length: {}\r\n\r\n{message}", message.len())
        };
        let bytes: String = messages.iter().map(framed).collect();
        self.input.write_all(bytes.as_bytes()).expect("the server listens");
    }

    fn received(&mut self) -> Value {
        let mut length = 0;
        loop {
            let mut line = String::new();
            assert!(self.output.read_line(&mut line).expect("a line") > 0, "the server ended");
            match line.trim().strip_prefix("Content-Length: ") {
                Some(bytes) => length = bytes.parse().expect("a number"),
                None if line.trim().is_empty() => break,
                None => {}
            }
        }
        let mut bytes = vec![0; length];
        self.output.read_exact(&mut bytes).expect("the message");
        serde_json::from_slice(&bytes).expect("JSON")
    }

    fn end(mut self) {
        self.send(&[request(2, "shutdown", Value::Null)]);
        assert_eq!(self.received()["id"], 2);
        self.send(&[notification("exit", Value::Null)]);
        assert!(self.process.wait().expect("it ends").success());
    }
}

fn request(id: u32, method: &str, params: Value) -> Value {
    json!({ "jsonrpc": "2.0", "id": id, "method": method, "params": params })
}

fn notification(method: &str, params: Value) -> Value {
    json!({ "jsonrpc": "2.0", "method": method, "params": params })
}

/// Creates `my.ron` from the template `compute`. Returns its URI and its text.
fn graph_to_edit(place: &Place) -> (String, String) {
    place.done("new my.ron --from compute");
    let file = place.at("my.ron").canonicalize().expect("there");
    (format!("file://{}", file.display()), std::fs::read_to_string(&file).expect("text"))
}

#[test]
fn changes_that_an_editor_sends_in_quick_succession_are_built_once() {
    const CHANGES: u32 = 20;
    let place = Place::empty();
    let (uri, text) = graph_to_edit(&place);
    let document = json!({ "uri": uri, "languageId": "ron", "version": 0, "text": text });
    let change = |version: u32| {
        let text = text.replace("\"rgba32f\"", &format!("\"format{version}\""));
        let document = json!({ "uri": uri, "version": version });
        let changes = json!([{ "text": text }]);
        notification("textDocument/didChange", json!({ "textDocument": document, "contentChanges": changes }))
    };
    let mut server = Server::start(&place);
    server.send(&[notification("textDocument/didOpen", json!({ "textDocument": document }))]);
    assert_eq!(server.received()["params"]["diagnostics"], json!([]));
    server.send(&(1..=CHANGES).map(change).collect::<Vec<_>>());
    let mut builds = 0;
    loop {
        builds += 1;
        let published = server.received();
        let message = published["params"]["diagnostics"][0]["message"].as_str().expect("a mistake");
        if message.contains(&format!("no format `format{CHANGES}`")) {
            break;
        }
    }
    // On a busy machine, the messages may arrive with pauses.
    assert!(builds < CHANGES / 4, "{builds} builds of {CHANGES} changes");
    server.end();
}

#[test]
fn an_editor_that_disconnects_without_a_shutdown_is_an_error() {
    let mut server = Place::empty().program("lsp").stdin(Stdio::piped()).spawn().expect("the program runs");
    let mut input = server.stdin.take().expect("piped");
    for message in [
        r#"{ "jsonrpc": "2.0", "id": 1, "method": "initialize", "params": { "capabilities": {} } }"#,
        r#"{ "jsonrpc": "2.0", "method": "initialized", "params": {} }"#,
        r#"{ "jsonrpc": "2.0", "method": "exit" }"#,
    ] {
        write!(input, "Content-Length: {}\r\n\r\n{message}", message.len()).expect("the server listens");
    }
    assert_eq!(server.wait().expect("it ends").code(), Some(1));
}
