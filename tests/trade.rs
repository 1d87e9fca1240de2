//! `trade` as a command: the ledger of each setting's savings and costs.

use crate::place::Place;
use serde_json::Value;

const SHORT: &str = "trade scene.ply -c cameras.json --rounds 1 --frames 1";

/// Draws the pictures that serve as truth, into `true/`.
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
    let found = |setting: &str, camera: &str| {
        let row = rows.iter().find(|row| row["setting"] == setting && row["camera"] == camera);
        row.map(|row| row["found"]["Ok"].clone()).expect("a row")
    };
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
    let short = format!("{SHORT} --only");
    let table = place.done(&format!("{short} defaults --truth true"));
    let line = table.lines().find(|line| line.contains("defaults")).expect("a line");
    assert!(line.contains("equal"), "the defaults drew the truth: {table}");
    place.refuses(
        &short,
        &[
            ("nothing", 2, "expected a prefix of one of these settings' names"),
            ("digit_bits", 2, "`digit_bits` is not measured: its declaration has no `exact` value"),
            ("defaults --truth missing", 1, "expected the picture one.npy, .exr or .png in missing"),
            ("defaults --truth true --size 32x32", 1, "expected 32 x 32 pixels"),
            ("defaults --rounds 0", 2, "--rounds"),
            ("defaults --truth ledger/pictures", 2, "choose another --output"),
        ],
    );
    place.write("out/pictures", "a file");
    place.refuses(&short, &[("defaults -o out", 2, "out/pictures")]);
}

/// Returns the PSNR of a setting's row in dB; `None` if its picture equals the truth.
fn psnr(place: &Place, setting: &str) -> Option<f64> {
    let ledger = ledger(place);
    let rows = ledger["rows"].as_array().expect("rows");
    let row = rows.iter().find(|row| row["setting"] == setting).expect("a row");
    row["found"]["Ok"]["error"]["psnr_db"].as_f64()
}

#[test]
fn a_ledger_is_not_resumed_with_the_rows_of_another_truth_graph_or_preset() {
    let place = Place::new();
    place.cameras(&["one"]);
    place.done(TRUTH);
    let trade = |more: &str| place.said(&format!("{SHORT} --only {more}")).1;
    let against = "defaults --truth true";
    trade(against);
    assert_eq!(psnr(&place, "defaults"), None, "the defaults drew the truth");
    assert!(trade(against).contains("2 rows of an earlier run are kept"));

    // Replaces the truth with other pictures under the same names.
    place.done(&format!("{TRUTH} --background 1,1,1"));
    let errors = trade(against);
    assert!(
        errors.contains("rows of an earlier run are measured again: measured with another truth")
            && !errors.contains("are kept"),
        "{errors}"
    );
    let resumed = psnr(&place, "defaults").expect("not equal");
    trade(&format!("{against} -o fresh"));
    place.write("ledger/ledger.json", place.bytes("fresh/ledger.json"));
    assert!(resumed < 30.0 && psnr(&place, "defaults") == Some(resumed), "{resumed}");

    // A preset in the folder overrides the built-in one. Editing it invalidates only its own row.
    let preset = |bits: u32| {
        let text = format!("Preset(graph: \"splat\", summary: \"Keys\", set: {{ \"key_bits\": {bits} }})");
        place.write("pipelines/key16.ron", text);
    };
    preset(16);
    trade("'preset key16'");
    assert!(trade("'preset key16'").contains("2 rows of an earlier run are kept"));
    let before = psnr(&place, "preset key16");
    preset(8);
    let errors = trade("'preset key16'");
    assert!(
        errors.contains("measured with another graph")
            && errors.contains("1 rows of an earlier run are kept"),
        "{errors}"
    );
    assert!(psnr(&place, "preset key16") < before);
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
    assert!(row.starts_with(' ') && row.ends_with("still views hide its cost"), "{table}");
    assert!(table.contains("`preset stale_order` is not judged"), "{table}");
    assert!(!table.contains("digit8"), "{table}");
    // One round is not enough to judge time.
    assert!(table.contains("too noisy to tell whether") && table.contains("at least 8 rounds"), "{table}");
    let csv = place.text("ledger/ledger.csv");
    assert!(
        csv.lines().any(|line| line.starts_with("\"preset stale_order\"") && line.contains("not judged")),
        "{csv}"
    );
}
