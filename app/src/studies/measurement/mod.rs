//! Measures settings: the model that all studies share.
//!
//! [`settings`] lists the ways to draw with a graph, and [`plans`] finds settings that draw the same. [`view`] draws a
//! camera's picture and compares it with the truth ([`error`]); [`time`] draws frames interleaved with a baseline's, so
//! that a change of the device's clock cancels; [`noise`] finds the differences in time that exceed the noise.

pub mod error;
pub mod noise;
pub mod plans;
pub mod settings;
pub mod time;
pub mod view;
