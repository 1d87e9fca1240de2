//! Measures graphs and settings over many frames. Most studies are a function `study` that returns numbers or a page.

pub mod advise;
pub mod bench;
pub mod evaluation;
pub mod experiment;
pub mod measurement;
pub mod popping;
pub mod price;
pub mod provenance;
pub mod study;
pub mod sweep;
pub mod trade;
