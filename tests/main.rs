//! Tests that cross crates: the shipped graphs and shaders on a real driver, with its validation on.
//!
//! They use the machine's backend. On Linux that is Vulkan on lavapipe, Mesa's driver for the CPU, which `./x test`
//! installs and selects; on macOS it is Metal. A missing driver or layer is a failure. Captured scenes and their golden
//! images are found through `SPLATGRAPH_DATA`. Tests that need a missing data folder, and Linux tests on other systems,
//! report that they did not run.

// Tests may write files and lines directly; the program does so only through its module `output`.
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

use std::fs;
use std::path::Path;

#[cfg(target_os = "linux")]
mod advise;
mod again;
mod batch;
#[cfg(target_os = "linux")]
mod bench;
mod captures;
mod commands;
mod common;
mod covariance;
mod effects;
mod encoders;
mod evaluate;
#[cfg(target_os = "linux")]
mod exact;
#[cfg(target_os = "linux")]
mod experiment;
#[cfg(target_os = "linux")]
mod extremes;
#[cfg(target_os = "linux")]
mod files;
mod formats;
mod fuzz;
mod golden;
#[cfg(target_os = "linux")]
mod growth;
mod images;
mod mesh;
#[cfg(target_os = "linux")]
mod metal;
mod mistakes;
mod mutations;
mod numbers;
mod outputs;
mod page;
mod parameters;
mod parity;
mod pixel_order;
mod place;
mod plans;
#[cfg(target_os = "linux")]
mod popping;
mod projections;
mod random;
mod reference;
mod results;
mod scenes;
#[cfg(target_os = "linux")]
mod serial_tiles;
#[cfg(target_os = "linux")]
mod shard;
mod sort;
mod storage;
#[cfg(target_os = "linux")]
mod sweep;
mod tiles;
mod timeline;
#[cfg(target_os = "linux")]
mod trade;
mod tutorial;
mod video;
mod view;
mod walk;
mod window_graph;

/// Returns the names of the modules and tests behind `#[cfg(target_os = "linux")]` in a file's text.
fn left_out_elsewhere(text: &str) -> Vec<&str> {
    let (mut attributes, mut found) = (Vec::new(), Vec::new());
    for line in text.lines() {
        if line.starts_with("#[") {
            attributes.push(line);
            continue;
        }
        let test = || line.strip_prefix("fn ").filter(|_| attributes.contains(&"#[test]"));
        let name = line.strip_prefix("mod ").or_else(test).and_then(|rest| rest.split(['(', ';']).next());
        found.extend(name.filter(|_| attributes.contains(&"#[cfg(target_os = \"linux\")]")));
        attributes.clear();
    }
    found
}

#[test]
fn tests_that_only_linux_can_run_are_named_elsewhere() {
    let mut found = Vec::new();
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).expect("a text");
                found.extend(left_out_elsewhere(&text).into_iter().map(str::to_owned));
            }
        }
    }
    for known in [
        "metal",
        "soak",
        "bench_says_once_that_a_setting_has_no_effect",
        "a_picture_that_cannot_be_written_ends_the_batch_and_those_before_it_are_told_and_whole",
    ] {
        assert!(found.iter().any(|name| name == known), "{known}: {found:?}");
    }
    assert!(!found.iter().any(|name| name == "told"), "a function of a test: {found:?}");
    if !cfg!(target_os = "linux") {
        found.iter().for_each(|name| common::not_run(name, "Linux"));
        // The Vulkan backend's own tests compile only on Linux, so report them here.
        common::not_run("backends/vulkan/tests/gpu", "lavapipe");
    }
}
