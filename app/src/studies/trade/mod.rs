//! Measures what each setting of a graph saves, and what it costs in accuracy: the ledger.
//!
//! [`settings`] lists the ways to draw: the graph with every parameter at its exact value, the same with one parameter
//! changed, the graph's defaults, and the presets. [`plans`] leaves out those that draw the same. [`measure`] draws each, interleaved with
//! the exact settings so that a drift of the device's clock cancels, and holds its picture against the truth ([`error`]). [`noise`] tells
//! which differences in time are known. [`ledger`] keeps the rows in a file, so that an interrupted run goes on where it stopped;
//! [`table`] prints them, and [`page`] plots them.

pub mod error;
pub mod ledger;
pub mod measure;
pub mod noise;
pub mod page;
pub mod plans;
pub mod settings;
pub mod table;
