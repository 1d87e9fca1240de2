//! Measures popping: the change of a renderer's error from frame to frame.
//!
//! A constant error is less visible than an error that comes and goes, which a single picture cannot show. The exact
//! renderer draws every frame of a path of cameras, and its changes between frames are the true ones: a renderer pops
//! where its picture changes differently ([`score`]). [`study`] draws the path with each variant of a graph, and
//! [`report`] makes the table, the CSV and the plot.

pub mod measure;
pub mod report;
pub mod score;

pub use measure::study;
