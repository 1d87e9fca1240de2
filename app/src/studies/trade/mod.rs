//! Measures the time and the error of each setting of a graph: the ledger.
//!
//! [`study()`] measures the graph with every parameter at its exact value, settings that change one parameter, the
//! graph's defaults, the presets, and other graphs, without settings whose plans equal an earlier setting's.
//! [`measure::Sessions`] makes the row of a setting in a view. [`ledger`] stores the rows in a file, so that an
//! interrupted run can resume; [`table`] formats them, [`page`] plots them, and [`pictures`] stores the pictures that
//! the page shows.

pub mod ledger;
pub mod measure;
pub mod page;
pub mod pictures;
mod study;
pub mod table;

pub use study::{Study, Wanted, study};
