//! Measures graphs against each other and against the device's copy limit.
//!
//! [`study()`] loads candidates, graphs with their parameters, side by side on one device. They draw their frames
//! interleaved, so that a change of the device's clock affects all of them ([`measure`]). The time of each pass is
//! compared with an estimate of its bytes ([`bytes`]) at the bandwidth of a copy ([`limit`]). [`report`] keeps the
//! numbers of a run, [`table`] and [`plot`] show them, and [`sort`] measures the sort alone.

pub mod bytes;
pub mod limit;
pub mod measure;
pub mod plot;
pub mod report;
pub mod sort;
mod study;
pub mod table;

pub use limit::copy_limit;
pub use study::{Wanted, study};

/// Names of the graphs that measurements draw in addition to the candidates.
pub const GRAPHS: [&str; 2] = [limit::GRAPH, sort::GRAPH];
