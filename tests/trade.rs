//! `trade` as a command: the ledger of each setting's savings and costs.

use crate::place::Place;
use serde_json::Value;
use splatgraph::io::image::save_rgba_png;
use std::fs;

const SHORT: &str = "trade scene.ply -c cameras.json --rounds 1 --frames 1";

/// Command that draws the true pictures into `true/`.
const TRUTH: &str = "render scene.ply -c cameras.json -o true --format npy";

fn ledger(place: &Place) -> Value {
    place.json("ledger/ledger.json")
}

#[test]
fn the_ledger_holds_each_setting_against_the_truth_and_goes_on_after_an_interruption() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    let line = format!("{SHORT} --only 'key_bits = 8' --only 'preset unsorted' -o ledger");
    let table = place.done(&line);
    for name in ["setting", "exact", "key_bits = 8", "preset unsorted"] {
        assert!(table.contains(name), "{table}");
    }
    let whole = ledger(&place);
    let rows = whole["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 6);
    let found = |setting: &str, camera: &str| found(&place, "ledger", setting, camera);
    // The buffer that reads the measured picture back does not count.
    let bench = place.told("bench scene.ply -c cameras.json -p unsorted --rounds 1 --frames 1 --json");
    let bytes = &bench["rows"][0]["found"]["Ok"]["memory_bytes"];
    assert_eq!(&found("preset unsorted", "one")["gpu_bytes"], bytes);
    for camera in ["one", "two"] {
        let psnr = |setting: &str| found(setting, camera)["error"]["psnr_db"].as_f64().expect("not equal");
        assert!(psnr("exact") > 70.0 && psnr("exact") > psnr("preset unsorted") + 20.0, "{table}");
        assert_eq!(found("exact", camera)["inversions"], 0, "{table}");
        assert!(found("preset unsorted", camera)["inversions"].as_u64() > Some(1000), "{table}");
        assert!(found("exact", camera)["time"]["gpu_ms"].as_f64() > Some(0.0), "{table}");
    }
    let csv = place.text("ledger/ledger.csv");
    assert_eq!(csv.lines().count(), 4, "{csv}");
    let page = place.text("ledger/ledger.html");
    assert!(page.contains("<svg") && page.contains("preset unsorted"), "{page}");
    for file in ["preset unsorted.png", "preset unsorted.difference.png", "truth.one.png"] {
        assert!(place.at(format!("ledger/pictures/{file}")).is_file(), "{file}");
    }
    assert!(page.contains("src=\"pictures/preset%20unsorted%2Edifference%2Epng\""), "{page}");
    let plot = place.image("ledger/ledger.png");
    assert!(plot.rgb.iter().any(|pixel| *pixel != plot.rgb[0]), "it is not empty");

    // An interrupted run leaves only the first rows.
    let mut part = whole.clone();
    part["rows"].as_array_mut().expect("rows").truncate(2);
    place.write("ledger/ledger.json", part.to_string());
    assert!(place.said(&line).1.contains("2 rows of an earlier run are kept"));
    let complete = ledger(&place);
    assert_eq!(complete["rows"].as_array().map(Vec::len), Some(6));
    assert_eq!((&complete["rows"][0], &complete["rows"][1]), (&whole["rows"][0], &whole["rows"][1]));
}

#[test]
fn the_truth_can_be_pictures_of_a_folder_and_mistakes_are_told_before_anything_is_drawn() {
    let place = Place::new();
    place.cameras(&["one"]);
    place.done(TRUTH);
    place.done("render scene.ply -c cameras.json -o upper/one.png");
    std::fs::rename(place.at("upper/one.png"), place.at("upper/one.PNG")).expect("renamed");
    let short = format!("{SHORT} --only");
    let table = place.done(&format!("{short} defaults --truth true"));
    let line = table.lines().find(|line| line.contains("defaults")).expect("a line");
    assert!(line.contains(" inf "), "the defaults drew the truth: {table}");
    place.refuses(
        &short,
        &[
            ("nothing", 2, "expected a prefix of one of these settings' names"),
            ("defaults --truth missing", 1, "expected the picture one.npy, .exr, .png or .jpg in missing"),
            ("defaults --truth true --size 32x32", 1, "expected 32 x 32 pixels"),
            ("defaults --truth upper --size 32x32", 1, "one.PNG: expected 32 x 32 pixels"),
            ("defaults --rounds 0", 2, "--rounds"),
            ("defaults --truth ledger/pictures", 2, "choose another --output"),
        ],
    );
    place.write("out/pictures", "a file");
    place.refuses(&short, &[("defaults -o out", 2, "out/pictures")]);
}

#[test]
fn photographs_are_found_by_any_end_of_their_names_and_their_alpha_is_blended_over_black() {
    let place = Place::new();
    place.cameras(&["images/one"]);
    place.done("render scene.ply -c cameras.json -o exact.png");
    let exact = place.image("exact.png");
    // Colours as bright as possible, and the alpha that makes them dark again.
    let values: Vec<f32> = exact.rgb.iter().flat_map(|&[r, g, b]| [r, g, b, r.max(g).max(b)]).collect();
    place.write("set/images/one.png", "");
    save_rgba_png(&place.at("set/images/one.png"), (exact.width, exact.height), &values).expect("written");
    for (folder, output) in [("set", "a"), ("set/images", "b")] {
        let line = format!("{SHORT} --only defaults --truth {folder} -o {output}");
        let told = place.said(&line).1;
        assert!(
            told.contains(&format!("{folder}: alpha is blended over black in 1 of 1 pictures")),
            "{told}"
        );
        let error = found(&place, output, "exact", "images/one")["error"].clone();
        assert!(error["psnr_db"].as_f64() > Some(50.0), "{error}");
    }
    place.cameras(&["left/one", "right/one"]);
    let refused = format!("{SHORT} --truth set/images -o c");
    place.refuses("", &[(&refused, 1, "expected a picture for each camera, found one for two cameras")]);
}

/// Returns a setting's measurements in the view of a camera; null if they failed. The ledger must have the row.
fn found(place: &Place, folder: &str, setting: &str, camera: &str) -> Value {
    let ledger = place.json(&format!("{folder}/ledger.json"));
    let rows = ledger["rows"].as_array().expect("rows");
    let row = rows.iter().find(|row| row["setting"] == setting && row["camera"] == camera).expect("a row");
    row["found"]["Ok"].clone()
}

#[test]
fn a_ledger_of_other_inputs_is_refused_and_rows_of_the_same_inputs_are_kept() {
    let place = Place::new();
    place.cameras(&["one"]);
    place.done(TRUTH);
    let short = format!("{SHORT} --only");
    let trade = |more: &str| place.said(&format!("{short} {more}"));
    trade("defaults --truth true");
    let same = found(&place, "ledger", "defaults", "one");
    assert_eq!(same["error"]["psnr_db"], "inf", "the defaults drew the truth");
    // The same files under other names, and numbers that another program has written.
    fs::copy(place.at("scene.ply"), place.at("other.ply")).expect("a copy");
    let text = place.text("ledger/ledger.json");
    place.write("ledger/ledger.json", text.replace(".0,\n", ",\n").replace(".0\n", "\n"));
    let other = SHORT.replace("scene.ply", "./other.ply");
    let told = place.said(&format!("{other} --only defaults --truth ./true/")).1;
    assert!(told.contains("2 rows of an earlier run are kept"), "{told}");

    let before = place.bytes("ledger/ledger.json");
    place.done(&format!("{TRUTH} --background 1,1,1"));
    let name_another = |what: &str| format!("measured with another {what}: keep the new one elsewhere");
    place.refuses(
        &short,
        &[
            ("defaults --truth true", 1, &name_another("truth")),
            ("defaults", 1, &name_another("truth")),
            (
                "defaults --truth true --no-robustness",
                1,
                &name_another("truth and another set of device options"),
            ),
        ],
    );
    assert!(place.bytes("ledger/ledger.json") == before);

    // A preset in the folder overrides the built-in one. Editing it invalidates only its own row.
    let preset = |bits: u32| {
        let text = format!("Preset(graph: \"splat\", summary: \"Keys\", set: {{ \"key_bits\": {bits} }})");
        place.write("pipelines/key16.ron", text);
    };
    let psnr = || found(&place, "new", "preset key16", "one")["error"]["psnr_db"].as_f64().expect("dB");
    preset(16);
    trade("'preset key16' -o new");
    let before = psnr();
    preset(8);
    let told = trade("'preset key16' -o new").1;
    assert!(
        told.contains(
            "1 rows of an earlier run are measured again or left out: their settings' plans have changed"
        ) && told.contains("1 rows of an earlier run are kept"),
        "{told}"
    );
    assert!(psnr() < before);
    // The table has the rows of both runs, as the file does.
    let table = trade("defaults -o new").0;
    assert!(table.contains("defaults") && table.contains("preset key16"), "{table}");
    assert_eq!(place.text("new/ledger.csv").lines().count(), 4);
    let commands = place.json("new/ledger.json")["commands"].clone();
    assert_eq!(commands.as_array().map(Vec::len), Some(2), "{commands}");
    assert!(place.text("new/ledger.html").contains("These commands made the page, in this order:"));
}

#[test]
fn a_preset_with_the_plan_of_its_graph_is_measured_by_the_name_of_the_graph() {
    let place = Place::new();
    place.cameras(&["one"]);
    // The scene has no mesh.
    let only = "--only 'preset mesh_quads' --only 'preset splat'";
    let table = place.done(&format!("{SHORT} {only}"));
    let row = table.lines().find(|line| line.contains("preset splat ")).expect("a row");
    assert!(row.ends_with("same plan: preset mesh_quads"), "{table}");
}

#[test]
fn a_view_without_splats_has_no_wrong_pair_and_an_infinite_psnr() {
    let place = Place::new();
    place.cameras(&["one", "away"]);
    let mut cameras = place.json("cameras.json");
    let away = &mut cameras[1];
    for axis in 0..3 {
        let [right, forward] = [0, 2].map(|at| -away["rotation"][axis][at].as_f64().expect("a number"));
        let position = away["position"][axis].as_f64().expect("a number");
        (away["rotation"][axis][0], away["rotation"][axis][2]) = (right.into(), forward.into());
        away["position"][axis] = (position + 1000.0 * forward).into();
    }
    place.write("cameras.json", cameras.to_string());
    let table = place.done(&format!("{SHORT} --only exact"));
    let found = found(&place, "ledger", "exact", "away");
    assert_eq!((&found["inversions"], &found["error"]["psnr_db"]), (&0.into(), &"inf".into()), "{table}");
    let csv = place.text("ledger/ledger.csv");
    let cell = |line: usize, name: &str| {
        let at = csv.lines().next().and_then(|head| head.split(',').position(|cell| cell == name));
        csv.lines().nth(line).and_then(|line| line.split(',').nth(at?)).map(str::to_owned)
    };
    assert_eq!(cell(1, "inversions").as_deref(), Some("0"), "{csv}");
}

#[test]
fn settings_with_the_plan_of_another_are_not_measured_and_a_stale_order_earns_no_mark() {
    let place = Place::new();
    place.cameras(&["one"]);
    place.write("pipelines/digit8.ron", "Preset(graph: \"splat\", summary: \"Nothing\", set: {})");
    let only = "--only defaults --only 'preset digit8' --only 'preset stale_order'";
    let (table, errors) = place.said(&format!("{SHORT} -p splat {only}"));
    assert!(errors.contains("not measured: `preset digit8` has the same plan as `defaults`"), "{errors}");
    let row = table.lines().find(|line| line.contains("preset stale_order")).expect("a row");
    assert!(row.starts_with(' ') && row.ends_with("reads the previous frame"), "{table}");
    assert!(table.contains("`preset stale_order` is not judged"), "{table}");
    let row = table.lines().find(|line| line.contains("defaults ")).expect("a row");
    assert!(row.ends_with("same plan: preset digit8") && table.matches("digit8").count() == 1, "{table}");
    assert_eq!(ledger(&place)["same_plan"], serde_json::json!({ "defaults": ["preset digit8"] }));
    // One round is not enough to judge time.
    assert!(table.contains("too noisy to tell whether") && table.contains("at least 8 frames"), "{table}");
    let csv = place.text("ledger/ledger.csv");
    assert!(
        csv.lines().any(|line| line.starts_with("\"preset stale_order\"") && line.contains("not judged")),
        "{csv}"
    );
}

#[test]
fn other_graphs_are_rows_of_the_ledger_and_stay_in_later_runs() {
    let place = Place::new();
    place.cameras(&["one"]);
    for (file, bits) in [("mine/a.ron", 8), ("b.ron", 12)] {
        place.write(
            file,
            format!("Preset(graph: \"splat\", summary: \"Coarse keys\", set: {{\"key_bits\": {bits}}})"),
        );
    }
    let short = format!("{SHORT} --only defaults -o ledger");
    let table = place.done(&format!("{short} --graph mine/a.ron --graph b.ron"));
    let of =
        |graph: &str| found(&place, "ledger", graph, "one")["error"]["psnr_db"].as_f64().expect("an error");
    assert!(of("graph mine/a.ron") < of("graph b.ron") && of("graph b.ron") < of("exact"), "{table}");
    let rows = || ledger(&place)["rows"].clone();
    let before = rows();
    place.done(&short);
    assert_eq!(rows(), before);
    place.write("b.ron", "Preset(graph: \"splat\", summary: \"Coarse keys\", set: {\"key_bits\": 13})");
    place.done(&short);
    assert_eq!(
        (&rows()[0], rows() == before),
        (&before[0], false),
        "only the edited graph is measured again"
    );
    place.write("wrong.ron", "Preset(graph: \"splat\", summary: \"Wrong\", set: {\"key_bit\": 8})");
    place.refuses(
        &short,
        &[
            ("--graph missing.ron", 1, "missing.ron"),
            ("--graph wrong.ron", 1, "wrong.ron:1"),
            ("--graph fisheye", 1, "fisheye: expected a graph for pinhole cameras"),
            ("--graph b.ron --set key_bits=9 --set record=f32", 1, "record"),
        ],
    );
}
