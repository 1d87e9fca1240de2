//! Measures graphs against each other and against the device's copy limit.
//!
//! [`study()`] measures candidates: graphs with their parameters. They are loaded side by side on one device and draw
//! their frames interleaved, so that a change of the device's clock affects all of them ([`measure`]). First, a copy
//! between buffers shows the device's best bandwidth ([`limit`]). The time of each pass is then compared with an
//! estimate of the bytes that it moves ([`bytes`]). [`report`] keeps the numbers of a run, [`table`] and [`plot`] show
//! them, and [`sort`] measures the sort alone.

pub mod bytes;
pub mod limit;
pub mod measure;
pub mod plot;
pub mod report;
pub mod sort;
mod study;
pub mod table;

pub use study::{Wanted, copy_limit, study};

/// Names of the graphs that measurements draw in addition to the candidates.
pub const GRAPHS: [&str; 2] = [limit::GRAPH, sort::GRAPH];
