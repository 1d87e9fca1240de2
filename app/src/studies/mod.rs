//! Measures graphs and settings over many frames. Most studies are a function `study` that returns numbers or a page.
//!
//! - [`mod@study`]: the subject of all studies, the listener that follows them, and their error;
//! - [`measurement`]: settings, and the time and the error of their pictures;
//! - [`metrics`]: differences between pictures;
//! - [`evaluation`]: scores against photographs;
//! - [`price`]: the cost of each scene format, in bytes, in accuracy and in loading time;
//! - [`trade`]: the cost of each setting, in time and in accuracy;
//! - [`mod@bench`]: time, memory and bytes of graphs, drawn interleaved;
//! - [`sweep`]: the cost of a budget of splats;
//! - [`advise`]: the needs of a scene, and the cheapest setting within a budget;
//! - [`experiment`]: pages that demonstrate an equation on a scene;
//! - [`popping`]: the error that changes from frame to frame.

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
