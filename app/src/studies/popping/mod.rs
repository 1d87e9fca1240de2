//! Measures popping: the error of a renderer that changes from frame to frame.
//!
//! A viewer tolerates a constant error, and notices one that comes and goes. A single picture cannot show the
//! difference, but a path of cameras can. The exact renderer draws every frame of the path, and its changes between
//! frames are the true ones: a renderer pops where its picture changes differently ([`score`]). [`study`] draws the
//! path with one variant of a graph after another, and [`report`] makes the table, the CSV and the plot.

pub mod measure;
pub mod report;
pub mod score;

pub use measure::study;
