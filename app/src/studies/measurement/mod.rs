//! Measures the error and the time of settings, for all studies.
//!
//! [`settings`] lists the settings to compare, and [`plans`] finds settings with equal plans. [`view`] draws a camera's
//! picture and compares it with the truth ([`error`]). [`time`] interleaves frames with a baseline's, so that changes
//! of the device's clock cancel out. [`noise`] finds the differences in time that exceed the noise.

pub mod error;
pub mod noise;
pub mod plans;
pub mod settings;
pub mod time;
pub mod view;
