//! Advises how to draw a scene.
//!
//! The advice is the width of the scene's depth keys, the energy of its bands of harmonics, and the cheapest setting
//! within a budget.
//!
//! [`crate::draw::keys`] finds the width at which no two splats that overlap on the screen change places, for each
//! mapping of depth to keys. [`harmonics`] measures the energy of each band. [`search`] measures one parameter at a
//! time, predicts combinations, and draws the cheapest of them, so that every advised setting was measured.

pub mod harmonics;
pub mod search;
mod study;

pub use study::{Advice, Description, Wanted, describe, study};
