//! Tests that cross crates: the shipped graphs and shaders on a real driver, with its validation on.
//!
//! They use the machine's backend. On Linux that is Vulkan on lavapipe, Mesa's driver for the CPU, which `./x test`
//! installs and selects; on macOS it is Metal. A missing driver or layer is a failure. Captured scenes and their golden
//! images are found through `SPLATGRAPH_DATA`. Tests that need a missing data folder, and Linux tests on other systems,
//! report that they did not run.

// Tests may write files and lines directly; the program does so only through its module `output`.
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

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

/// Returns the names that follow `start`, up to `end`, behind `#[cfg(target_os = "linux")]`.
fn left_out_elsewhere<'a>(text: &'a str, start: &str, end: char) -> Vec<&'a str> {
    let start = format!("#[cfg(target_os = \"linux\")]\n{start}");
    let behind = text.split(start.as_str()).skip(1);
    behind.filter_map(|rest| Some(rest.split_once(end)?.0)).collect()
}

#[test]
fn tests_that_only_linux_can_run_are_named_elsewhere() {
    let modules = |text| left_out_elsewhere(text, "mod ", ';');
    let (here, view) = (modules(include_str!("main.rs")), modules(include_str!("view/mod.rs")));
    assert!(here.contains(&"metal") && view.contains(&"soak"), "{here:?}, {view:?}");
    let tests: Vec<&str> = [include_str!("commands.rs"), include_str!("effects.rs")]
        .iter()
        .flat_map(|text| left_out_elsewhere(text, "#[test]\nfn ", '('))
        .collect();
    for known in [
        "bench_says_once_that_a_setting_has_no_effect",
        "without_a_vulkan_driver_the_other_devices_are_listed_and_the_exit_code_says_so",
    ] {
        assert!(tests.contains(&known), "{tests:?}");
    }
    if !cfg!(target_os = "linux") {
        here.iter().for_each(|module| common::not_run(module, "Linux"));
        view.iter().for_each(|module| common::not_run(&format!("view::{module}"), "Linux"));
        tests.iter().for_each(|test| common::not_run(test, "Linux"));
        // The Vulkan backend's own tests compile only on Linux, so report them here.
        common::not_run("backends/vulkan/tests/gpu", "lavapipe");
    }
}
