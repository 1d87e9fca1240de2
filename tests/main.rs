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

#[cfg(not(target_os = "linux"))]
#[test]
fn tests_that_only_linux_can_run_are_counted_elsewhere() {
    common::not_run("every test behind `#[cfg(target_os = \"linux\")]`", "Linux");
    common::not_run("backends/vulkan/tests/gpu", "lavapipe");
}
