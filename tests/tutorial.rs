//! The tutorial and the templates of `splatgraph new`: every graph is checked, drawn with validation, and shows its
//! effect. The tutorial's commands are run as well.

use splatgraph::io::image::Image;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::Stdio;

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
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
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

#[test]
fn an_editor_is_told_the_mistakes_of_a_graph_on_standard_output() {
    let place = Place::empty();
    place.done("new my.ron --from compute");
    let file = place.at("my.ron").canonicalize().expect("there");
    let text = std::fs::read_to_string(&file).expect("text").replace("\"rgba32f\"", "\"Rgba32Float\"");
    let document = serde_json::json!({
        "uri": format!("file://{}", file.display()), "languageId": "ron", "version": 1, "text": text,
    });
    let mut server =
        place.program("lsp").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the program runs");
    let mut input = server.stdin.take().expect("piped");
    let mut send = |id: Option<u32>, method: &str, params: serde_json::Value| {
        let mut message = serde_json::json!({ "jsonrpc": "2.0", "method": method, "params": params });
        if let Some(id) = id {
            message["id"] = id.into();
        }
        let message = message.to_string();
        write!(input, "Content-Length: {}\r\n\r\n{message}", message.len()).expect("the server listens");
    };
    send(Some(1), "initialize", serde_json::json!({ "capabilities": {} }));
    send(None, "initialized", serde_json::json!({}));
    send(None, "textDocument/didOpen", serde_json::json!({ "textDocument": document }));
    let mut output = BufReader::new(server.stdout.take().expect("piped"));
    let mut received = || {
        let mut length = 0;
        loop {
            let mut line = String::new();
            assert!(output.read_line(&mut line).expect("a line") > 0, "the server ended");
            match line.trim().strip_prefix("Content-Length: ") {
                Some(bytes) => length = bytes.parse().expect("a number"),
                None if line.trim().is_empty() => break,
                None => {}
            }
        }
        let mut bytes = vec![0; length];
        output.read_exact(&mut bytes).expect("the message");
        serde_json::from_slice::<serde_json::Value>(&bytes).expect("JSON")
    };
    assert_eq!(received()["id"], 1);
    let published = received();
    assert_eq!(published["method"], "textDocument/publishDiagnostics");
    let message = published["params"]["diagnostics"][0]["message"].as_str().expect("a mistake");
    assert!(
        message.contains("no format `Rgba32Float`") && message.contains("did you mean `rgba32f`?"),
        "{message}"
    );
    send(Some(2), "shutdown", serde_json::Value::Null);
    assert_eq!(received()["id"], 2);
    send(None, "exit", serde_json::Value::Null);
    assert!(server.wait().expect("it ends").success());
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
