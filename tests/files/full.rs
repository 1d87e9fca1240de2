//! A limit on the size of files stands for a full disk. Each output is whole or the old file, no other file is left,
//! and the exit code reports the failure.

use super::system::limit;
use crate::place::{DRAW, Place};
use rustix::process::Resource;
use std::collections::BTreeMap;
use std::process::{Command, Output};

fn limited(mut command: Command, bytes: u64) -> Output {
    limit(&mut command, Resource::Fsize, bytes);
    command.env("MESA_SHADER_CACHE_DISABLE", "true").output().expect("the program runs")
}

#[test]
fn a_full_disk_leaves_old_files_whole_whatever_is_written() {
    let place = Place::new();
    place.cameras(&["one"]);
    splatgraph::io::image::Image::from_fn(64, 48, |x, y| [x as f32, y as f32, 0.5])
        .save(&place.at("a.npy"))
        .expect("written");
    let inputs = place.files(".");
    let render = format!("{DRAW} out.png --json=stats.json --inspect order@compact=seen.npy");
    for (args, outputs) in [
        ("synth demo --count 50 -o new.ply --cameras new.json", &["new.ply", "new.json"][..]),
        ("dump unsorted --format html -o plan.html", &["plan.html"]),
        ("compare a.npy a.npy --diff diff.exr", &["diff.exr"]),
        (&render, &["out.png", "seen.npy", "stats.json"]),
    ] {
        place.done(args);
        let finished = place.files(".");
        let sizes: Vec<u64> =
            outputs.iter().map(|name| finished[&format!("./{name}")].len() as u64).collect();
        let mut limits: Vec<u64> = sizes.iter().flat_map(|size| [0, size / 2, size - 1]).collect();
        limits.sort_unstable();
        limits.dedup();
        for limit in limits {
            // Existing files, whose contents differ from the new ones.
            for name in outputs {
                place.write(name, format!("the old {name}"));
            }
            let output = limited(place.program(args), limit);
            let errors = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(1), "{args:?} with {limit} bytes: {errors}");
            assert!(errors.contains("cannot be written"), "{args:?} with {limit} bytes: {errors}");
            assert!(outputs.iter().any(|name| errors.contains(name)), "{errors}");
            let found: BTreeMap<String, Vec<u8>> = place.files(".");
            assert_eq!(found.len(), finished.len(), "{args:?} with {limit} bytes: {:?}", found.keys());
            for (name, bytes) in &found {
                let old = format!("the old {}", name.trim_start_matches("./"));
                let is_output = outputs.contains(&name.trim_start_matches("./"));
                // Times vary between runs.
                let whole = if name == "./stats.json" {
                    serde_json::from_slice::<serde_json::Value>(bytes).is_ok()
                } else {
                    finished[name] == *bytes
                };
                assert!(
                    whole || is_output && old.as_bytes() == bytes,
                    "{args:?} with {limit} bytes: {name} is damaged"
                );
            }
        }
        for name in outputs {
            std::fs::remove_file(place.at(name)).expect("removed");
        }
    }
    assert!(place.files(".") == inputs);
}
