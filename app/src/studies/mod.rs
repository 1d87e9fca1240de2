//! Measures graphs and settings over many frames. Most studies are a function `study` that returns numbers or a page.
//!
//! - [`mod@study`]: the subject of all studies, the listener that follows them, and their error;
//! - [`measurement`]: settings, and the time and the error of their pictures;
//! - [`metrics`]: differences between pictures;
//! - [`evaluation`]: scores against photographs;
//! - [`price`]: the bytes, the error and the loading time of each scene format;
//! - [`trade`]: the time and the error of each setting of a graph;
//! - [`mod@bench`]: time, memory and bytes of graphs, drawn interleaved;
//! - [`sweep`]: the time and the error of drawing fewer splats;
//! - [`advise`]: properties of a scene, and the cheapest setting within a budget;
//! - [`experiment`]: pages that demonstrate an equation on a scene;
//! - [`popping`]: the change of the error from frame to frame.

pub mod advise;
pub mod bench;
pub mod evaluation;
pub mod experiment;
pub mod measurement;
pub mod metrics;
pub mod popping;
pub mod price;
pub mod study;
pub mod sweep;
pub mod trade;
