//! hand-made plans, run on a real device (lavapipe will do) with synchronization validation on.
//!
//! Every test opens a device of its own and ends with [`build::finish`], which closes it and wants no message: not of
//! the frames, and not of the closing. Those of windows ([`screen`]) start an X server besides.
//!
//! Not on Apple's systems, which have no lavapipe.
#![cfg(not(target_vendor = "apple"))]

mod bounds;
mod build;
mod calibration;
mod compute;
mod draw;
mod frames;
mod given;
mod loading;
mod pictures;
#[cfg(unix)]
mod screen;
mod sharing;
mod swapping;
mod threads;
#[cfg(unix)]
mod x11;
