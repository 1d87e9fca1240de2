//! Measures graphs against each other and against the device's copy limit.
//!
//! [`study()`] loads candidates (graphs with their parameters) side by side on one device. Their frames are
//! interleaved, so that a change of the device's clock affects all of them ([`measure`]). The bandwidth of each pass,
//! from an estimate of its bytes ([`bytes`]), is compared with the bandwidth of a copy ([`limit`]). [`report`] stores
//! the numbers of a run, [`table`] and [`plot`] show them, and [`sort`] measures the sort alone.

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

/// Names of the graphs that exist only for measurements: a copy, and a sort of random pairs.
pub const GRAPHS: [&str; 2] = [limit::GRAPH, sort::GRAPH];
