//! Tests that cross crates: the shipped graphs and shaders on a real driver, with its validation on.
//!
//! They run by whichever backend the machine has. On Linux that is Vulkan on lavapipe, Mesa's driver for the CPU, which `./x test`
//! installs and selects; on macOS it is Metal. A missing driver or layer is a failure. Captured scenes and golden images are found
//! through `SPLATGRAPH_DATA`; without it, the tests that need them say that they did not run, and so do the modules that only Linux has.

// Tests write files and lines as they like; the program does so through its module `output` alone.
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

#[cfg(target_os = "linux")]
mod advise;
#[cfg(target_os = "linux")]
mod batch;
mod bench;
#[cfg(target_os = "linux")]
mod builtin;
mod commands;
mod common;
mod covariance;
mod effects;
mod encoders;
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
#[cfg(target_os = "linux")]
mod growth;
mod images;
#[cfg(target_os = "linux")]
mod metal;
mod mistakes;
mod mutations;
mod numbers;
mod page;
mod parameters;
mod parity;
mod plans;
#[cfg(target_os = "linux")]
mod popping;
mod random;
mod reference;
mod results;
#[cfg(target_os = "linux")]
mod serial_tiles;
mod sort;
#[cfg(target_os = "linux")]
mod sweep;
mod tiles;
#[cfg(target_os = "linux")]
mod trade;
mod tutorial;
mod view;
mod walk;
mod window_graph;

/// Lists the modules of a file that only Linux has.
fn left_out_elsewhere(text: &str) -> Vec<&str> {
    let behind = text.split("#[cfg(target_os = \"linux\")]\nmod ").skip(1);
    behind.filter_map(|rest| Some(rest.split_once(';')?.0)).collect()
}

#[test]
fn modules_of_tests_that_only_linux_can_run_are_named_elsewhere() {
    let (here, view) =
        (left_out_elsewhere(include_str!("main.rs")), left_out_elsewhere(include_str!("view/mod.rs")));
    assert!(here.contains(&"metal") && view.contains(&"soak"), "{here:?}, {view:?}");
    if !cfg!(target_os = "linux") {
        here.iter().for_each(|module| common::not_run(module, "Linux"));
        view.iter().for_each(|module| common::not_run(&format!("view::{module}"), "Linux"));
        // It says the same of itself, where nobody sees it.
        common::not_run("backends/vulkan/tests/gpu", "lavapipe");
    }
}
