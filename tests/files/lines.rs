//! Random command lines for the real program. It must exit with code 0, 1 or 2, and destroy no file that it reads.

use super::words::{self, Random};
use crate::common::{long, say};
use crate::place::Place;
use std::collections::BTreeMap;
use std::fs;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Number of command lines: in a long run, and by default.
const LINES: (u64, u64) = (4_000, 150);

const TIME_LIMIT: Duration = Duration::from_secs(120);

/// Counts the words that name `file`. The scene and its links count as one file.
fn named(words: &[String], file: &str) -> usize {
    let scene = ["scene.ply", "link.ply", "hard.ply"];
    let is_it = |word: &&String| {
        let word = word.rsplit_once('=').map_or(word.as_str(), |(_, value)| value);
        let word = word.split_once('#').map_or(word, |(path, _)| path);
        let word = word.trim_start_matches("./").trim_start_matches("-o");
        word == file || scene.contains(&file) && scene.contains(&word)
    };
    words.iter().filter(is_it).count()
}

#[test]
fn no_command_line_ends_the_program_otherwise_or_destroys_a_file_that_it_reads() {
    let lines = if long() { LINES.0 } else { LINES.1 };
    let place = Place::new();
    words::write_files(&place.at(""));
    let before = place.files(".");
    let mut codes: BTreeMap<i32, u32> = BTreeMap::new();
    for number in 0..lines {
        let words = words::line(&mut Random(number));
        // Standard output may be a picture, so it is discarded. Without a device, no command draws.
        let args: Vec<&str> = words.iter().map(String::as_str).collect();
        let mut child = place
            .program(&args)
            .env("VK_DRIVER_FILES", "/nonexistent")
            .env("VK_ICD_FILENAMES", "/nonexistent")
            .env("XDG_CACHE_HOME", place.at("cache"))
            .stdout(Stdio::null())
            .stderr(fs::File::create(place.at("stderr")).expect("a file"))
            .spawn()
            .expect("it starts");
        let begun = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait().expect("asked") {
                break status;
            }
            if begun.elapsed() > TIME_LIMIT {
                let _ = child.kill();
                panic!("line {number} hangs: {words:?}");
            }
            std::thread::sleep(Duration::from_millis(1));
        };
        let errors = fs::read_to_string(place.at("stderr")).unwrap_or_default();
        fs::remove_file(place.at("stderr")).expect("removed");
        let code = status.code().unwrap_or(-1);
        assert!((0..=2).contains(&code), "line {number} ends with {status}: {words:?}\n{errors}");
        assert!(!errors.contains('\x1b'), "line {number}: {words:?}\n{errors}");
        *codes.entry(code).or_default() += 1;
        let after = place.files(".");
        if after == before {
            continue;
        }
        for (name, bytes) in &before {
            let uses = named(&words, name.trim_start_matches("./"));
            let changed = after.get(name) != Some(bytes);
            assert!(!changed || uses == 1, "line {number} destroys {name}: {words:?}\n{errors}");
        }
        assert!(!after.keys().any(|name| name.contains(".splatgraph-")), "line {number}: {words:?}");
        for name in after.keys().filter(|name| !before.contains_key(*name)) {
            fs::remove_file(place.at(name)).expect("removed");
        }
        let _ = fs::remove_dir_all(place.at("new"));
        words::write_files(&place.at(""));
    }
    say(&format!("command lines: {lines}, by exit code {codes:?}"));
    assert!((0..=2).all(|code| codes.get(&code).is_some_and(|count| *count > 0)), "{codes:?}");
}
