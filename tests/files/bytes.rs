//! Names that are not valid UTF-8: commands read and write such files, and spell the names with U+FFFD.

use crate::place::Place;
use serde_json::Value;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;

/// Runs a line in which `@` stands for two bytes that are not valid UTF-8. It must exit with `code`. Returns standard
/// output and standard error.
fn run(place: &Place, line: &str, code: i32) -> (String, String) {
    let mut command = place.program("");
    for word in line.split(' ') {
        command.arg(OsStr::from_bytes(&word.bytes().flat_map(raw).collect::<Vec<_>>()));
    }
    let output = command.output().expect("the program runs");
    let [text, errors] =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert_eq!(output.status.code(), Some(code), "{line}: {text}{errors}");
    (text, errors)
}

fn done(place: &Place, line: &str) -> (String, String) {
    run(place, line, 0)
}

fn raw(byte: u8) -> Vec<u8> {
    if byte == b'@' { vec![0xff, 0xfe] } else { vec![byte] }
}

#[test]
fn names_that_are_not_valid_utf_8_are_read_written_and_reported() {
    let place = Place::new();
    place.cameras(&["one"]);
    let own = OsStr::from_bytes(b"\xff\xfe.cameras.json");
    fs::rename(place.at("cameras.json"), place.at(own)).expect("renamed");
    fs::rename(place.at("scene.ply"), place.at(OsStr::from_bytes(b"\xff\xfe.ply"))).expect("renamed");

    for line in ["info @.ply --json", "advise @.ply --json", "convert @.ply --price --size 16x12 --json"] {
        let (text, errors) = done(&place, line);
        let found: Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(found["scene"], "\u{fffd}\u{fffd}.ply", "{line}: {errors}");
    }
    assert!(run(&place, "info @@.ply", 1).1.contains("\u{fffd}\u{fffd}\u{fffd}\u{fffd}.ply"));
    let (_, errors) = done(&place, "render @.ply -p unsorted -o @/a.png");
    assert!(errors.contains("the camera is the first of \u{fffd}\u{fffd}.cameras.json"), "{errors}");
    fs::copy(place.at(OsStr::from_bytes(b"\xff\xfe/a.png")), place.at(OsStr::from_bytes(b"\xff\xfe/@.png")))
        .expect("copied");
    let compared: Value = serde_json::from_str(&done(&place, "compare @/ @/ --json").0).expect("JSON");
    assert_eq!(compared["pictures"].as_array().map(Vec::len), Some(2), "{compared}");
    assert_eq!(compared["pictures"][0]["a"], "\u{fffd}\u{fffd}/@.png", "{compared}");

    // Different bytes are different names, though they are spelled alike.
    for (folder, name) in [("x", b"\xff.png"), ("y", b"\xfe.png")] {
        fs::create_dir(place.at(folder)).expect("a folder");
        let copy = place.at(folder).join(OsStr::from_bytes(name));
        fs::copy(place.at(OsStr::from_bytes(b"\xff\xfe/a.png")), copy).expect("copied");
    }
    run(&place, "compare x/ y/", 1);

    let line = "trade @.ply -p unsorted -o @t --size 16x12 --rounds 1 --frames 1 --only exact";
    done(&place, line);
    done(&place, &line.replace("@t", "@s --shard 0/1"));
    done(&place, "merge @s");
}

#[test]
fn an_option_whose_value_is_not_valid_utf_8_is_named() {
    let place = Place::empty();
    for option in ["-c", "--pipeline"] {
        let (_, errors) = run(&place, &format!("render scene.ply {option} @ -o a.png"), 2);
        assert_eq!(errors, format!("error: expected valid UTF-8, found {option} \u{fffd}\u{fffd}\n"));
    }
}
