//! Tests that cross crates: the shipped graphs and shaders on a real driver, with its validation on.
//!
//! They run by whichever backend the machine has. On Linux that is Vulkan on lavapipe, Mesa's driver for the CPU, which `./x test`
//! installs and selects; on macOS it is Metal. A missing driver or layer is a failure. Captured scenes and golden images are found through `SPLATGRAPH_DATA`; without it, the tests that need them say
//! that they did not run.

// Tests write files and lines as they like; the program does so through its module `output` alone.
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

#[cfg(target_os = "linux")]
mod advise;
#[cfg(target_os = "linux")]
mod bench;
#[cfg(target_os = "linux")]
mod builtin;
mod commands;
mod common;
mod covariance;
mod encoders;
#[cfg(target_os = "linux")]
mod exact;
#[cfg(target_os = "linux")]
mod experiment;
#[cfg(target_os = "linux")]
mod extremes;
#[cfg(target_os = "linux")]
mod files;
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
mod view;
mod walk;
mod window_graph;
