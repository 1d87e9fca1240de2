//! Plans made by hand, run on a real device (lavapipe will do) with synchronization validation on.
//!
//! Every test opens a device of its own and ends with [`build::finish`], which closes it and wants no message: not of
//! the frames, and not of the closing.

mod build;
mod calibration;
mod compute;
mod draw;
mod frames;
mod loading;
mod sharing;
mod swapping;
