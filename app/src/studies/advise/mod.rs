//! Advises how to draw a scene: what its depth keys need, what its bands of harmonics carry, and the cheapest setting within a
//! budget.
//!
//! [`crate::draw::keys`] finds the width at which no two splats that overlap on the screen change places, for each mapping of depth to
//! keys; [`harmonics`] measures the energy of each band; [`search`] measures one parameter at a time, predicts what they do
//! together, and draws the cheapest predictions, so that nothing is advised that was not measured.

pub mod harmonics;
pub mod search;
mod study;

pub use study::{Advice, Description, Wanted, describe, study};
