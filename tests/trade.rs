//! `trade`: the ledger of what each setting saves and costs, as a command.

use crate::files::Place;
use serde_json::Value;
use splatgraph::image::Image;
use std::fs;

/// Two settings of two cameras, with as few frames as there can be.
const SHORT: [&str; 13] = [
    "trade",
    "scene.ply",
    "-c",
    "cameras.json",
    "--rounds",
    "1",
    "--frames",
    "1",
    "--only",
    "key_bits = 8",
    "--only",
    "preset unsorted",
    "-o",
];

fn ledger(place: &Place) -> Value {
    serde_json::from_slice(&fs::read(place.at("ledger/ledger.json")).expect("it is written")).expect("JSON")
}

#[test]
fn the_ledger_holds_each_setting_against_the_truth_and_goes_on_after_an_interruption() {
    let place = Place::new();
    place.cameras(&["one", "two"]);
    let args = [&SHORT[..], &["ledger"]].concat();
    let first = place.run(&args);
    let errors = String::from_utf8_lossy(&first.stderr);
    assert_eq!(first.status.code(), Some(0), "{errors}");
    let table = String::from_utf8_lossy(&first.stdout).into_owned();
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
    let csv = fs::read_to_string(place.at("ledger/ledger.csv")).expect("it is written");
    assert_eq!(csv.lines().count(), 4, "{csv}");
    let page = fs::read_to_string(place.at("ledger/ledger.html")).expect("it is written");
    assert!(page.contains("<svg") && page.contains("preset unsorted"), "{page}");
    let plot = Image::load(&place.at("ledger/ledger.png")).expect("a picture");
    assert!(plot.rgb.iter().any(|pixel| *pixel != plot.rgb[0]), "it is not empty");

    // What an interruption leaves: the first rows.
    let mut part = whole.clone();
    part["rows"].as_array_mut().expect("rows").truncate(2);
    place.write("ledger/ledger.json", part.to_string());
    let again = place.run(&args);
    assert!(String::from_utf8_lossy(&again.stderr).contains("2 rows of an earlier run are kept"));
    let complete = ledger(&place);
    assert_eq!(complete["rows"].as_array().map(Vec::len), Some(6));
    assert_eq!((&complete["rows"][0], &complete["rows"][1]), (&whole["rows"][0], &whole["rows"][1]));
}

#[test]
fn the_truth_can_be_pictures_of_a_folder_and_mistakes_are_told_before_anything_is_drawn() {
    let place = Place::new();
    place.cameras(&["one"]);
    let (code, errors) =
        place.code(&["render", "scene.ply", "-c", "cameras.json", "-o", "true", "--format", "npy"]);
    assert_eq!(code, Some(0), "{errors}");
    let short = ["trade", "scene.ply", "-c", "cameras.json", "--rounds", "1", "--frames", "1", "--only"];
    let output = place.run(&[&short[..], &["defaults", "--truth", "true"]].concat());
    let table = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = table.lines().find(|line| line.contains("defaults")).expect("a line");
    assert!(line.contains("equal"), "the defaults drew the truth: {table}");
    for (more, code, why) in [
        (&["nothing"][..], 2, "expected the begin of a setting's name"),
        (&["defaults", "--truth", "missing"], 1, "expected the picture one.npy, .exr or .png in missing"),
        (&["defaults", "--truth", "true", "--size", "32x32"], 1, "expected 32 x 32 pixels"),
        (&["defaults", "--rounds", "0"], 2, "--rounds"),
    ] {
        let found = place.code(&[&short[..], more].concat());
        assert!(found.0 == Some(code) && found.1.contains(why), "{more:?}: {found:?}");
    }
}
