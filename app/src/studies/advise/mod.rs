//! Advises how to draw a scene: the width of its depth keys, and the cheapest setting within a budget.
//!
//! For each mapping of depth to keys, [`crate::draw::keys`] finds the width at which no more than a given number of
//! pairs of overlapping splats are in the wrong order. [`harmonics`] measures the energy of each band. [`study()`]
//! measures one parameter at a time, and draws the combinations that [`search`] predicts to be the cheapest, so that
//! every advised setting was measured.

pub mod harmonics;
pub mod search;
mod study;

pub use study::{Advice, Description, Wanted, describe, study};
